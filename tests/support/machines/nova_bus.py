"""What a host knows of a NOVA chip from its own bus writes alone, what it may expect of the chip, and programs for it as
strategies. Bits are those of the spec pages; the traffic takes its codes from the register map.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import ClassVar

from hypothesis import strategies as st

from stage.chips.nova import MCX312, MCX314AS, MCX514

Writes = list[tuple[int, int]]
BYTES = 16  # from here on: byte addresses of the 8-bit bus of the MCX514
SECOND = 16_000_000  # clocks; 1 pps is the slowest there is
ERRORS_304 = 0x00BF  # of RR2
MCX304_STOP_CAUSES = 0xC000  # of RR1: by ALARM, by EMG


@dataclass(frozen=True)
class Axis:
    """Registers last written for one axis."""

    wr: tuple[int, int, int, int] = (0, 0, 0, 0)
    filters: int = 0
    ring: int = 0xFFFFFFFF


@dataclass(frozen=True)
class NovaHost:
    """Modes by what was written.

    acts: since the last reset it was told something that lets it begin drives, or write LP, by itself: synchronous actions, a home
    search; interpolates: an interpolation; patterns: WR2 to WR5 of the MCX312 may have been something else.
    """

    BLINKING: ClassVar = ("lmt_plus", "lmt_minus") * 4 + ("stop0", "stop1", "eca", "ecb")
    PULSE_PINS: ClassVar = ("pls", "dir")
    MAKES_PULSES: ClassVar = True
    FOR_A_STAGE: ClassVar = tuple(
        f"ax{k}.{name}" for k in range(4) for name in ("pulse_clock_sum", "recent_net", "first_pulse_clock")
    )

    axes: tuple[Axis, ...]
    mcx514: bool
    has_patterns: bool = False
    selected: int = 1
    low: int = 0
    high: int = 0
    first: int = 0
    acts: bool = False
    interpolates: bool = False
    patterns: bool = False

    ADDRESSES: ClassVar = range(8)

    @staticmethod
    def put(chip, address: int, value: int) -> None:
        """One bus write cycle."""
        if address < BYTES:
            chip.write(address, value)
        else:
            chip.write_byte(address - BYTES, value)

    # --- what it knows ---

    def reset(self) -> NovaHost:
        return replace(
            self, axes=tuple(Axis() for _ in self.axes), selected=1, low=0, high=0, acts=False, interpolates=False,
            patterns=False,
        )  # fmt: skip

    def advanced(self, inputs: list[dict[str, bool]]) -> NovaHost:
        """Time alone tells it nothing."""
        return self

    def written(self, address: int, value: int) -> NovaHost:
        """After a bus write."""
        if address >= BYTES:
            return self._byte_written(address - BYTES, value)
        if address == 0:
            return self._commanded(value)
        if address <= 3:
            return self._of_selected(
                self.selected, lambda a: replace(a, wr=(*a.wr[:address], value, *a.wr[address + 1 :]))
            )
        return replace(self, low=value) if address == 6 else replace(self, high=value) if address == 7 else self

    def _byte_written(self, address: int, value: int) -> NovaHost:
        n, high = divmod(address, 2)
        lowest = next(k for k in range(4) if self.selected >> k & 1)
        old = self.first if n == 0 else self.axes[lowest].wr[n] if n <= 3 else self.low if n == 6 else self.high
        word = old & 0xFF | value << 8 if high else old & 0xFF00 | value
        return replace(self, first=word) if n == 0 and high else self.written(n, word)

    def _of_selected(self, axes: int, change) -> NovaHost:
        return replace(self, axes=tuple(change(a) if axes >> k & 1 else a for k, a in enumerate(self.axes)))

    def _commanded(self, value: int) -> NovaHost:
        code, axes = value & 0xFF, value >> 8 & (1 << len(self.axes)) - 1
        if (code == 0xFF and not axes) if self.mcx514 else value == 0x8000:
            return self.reset()
        host = replace(self, selected=axes or self.selected)
        if not self.mcx514:
            ip = self.has_patterns and 0x30 <= code <= 0x3D
            return replace(
                host, acts=host.acts or code == 0x62, interpolates=host.interpolates or ip,
                patterns=host.patterns or (ip and code == 0x36),
            )  # fmt: skip
        if code == 0x0E:
            return host._of_selected(axes, lambda a: replace(a, ring=self.high << 16 | self.low))
        if code == 0x25:
            return host._of_selected(axes, lambda a: replace(a, filters=self.low))
        return replace(
            host, acts=host.acts or 0x26 <= code <= 0x29 or code == 0x5A,
            interpolates=host.interpolates or 0x60 <= code <= 0x6F,
        )  # fmt: skip

    def forbidden(self, inputs: list[dict[str, bool]], j: int) -> set[int]:
        """The ways that limits forbid to axis `j`: those that are asserted, enabled, stop at once and are not filtered."""
        _, _, w2, w3 = self.axes[j].wr
        if self.mcx514:
            on = w2 & 0x0800 and not w2 & 0x1000 and not self.axes[j].filters & 2
        else:
            on = not w2 & 0x0004 and not w3 & 0x0100 and not self.patterns
        pins = ["lmt_plus", "lmt_minus"]
        if self.mcx514 and w3 & 0x1000:
            pins.reverse()
        return {direction for direction, pin in zip((1, -1), pins, strict=True) if on and inputs[j][pin]}

    # --- what it may expect ---

    def refuses(self, chip) -> bool:
        """At rest between two limits, all axes: whatever is written next, no drive begins."""
        if self.acts or chip.read(0) & 0xF:
            return False
        inputs = [{name: getattr(a.pins, name) for name in chip.INPUTS} for a in chip.axes]
        return all(len(self.forbidden(inputs, j)) == 2 for j in range(len(self.axes)))

    def check(self, chip) -> None:
        """Assert what holds at any moment."""
        status = chip.read(0)
        chip_copy = copy.copy(chip)
        for j, axis in enumerate(chip.axes):
            driving = bool(status >> j & 1)
            assert axis.pins.drive == driving, "n-DRV of RR0 agrees with its pin"
            assert driving or not (axis.pins.asnd or axis.pins.cnst or axis.pins.dsnd), "a speed without a drive"
            errors = self._errors(chip_copy, j)
            assert bool(status >> 4 + j & 1) == bool(errors), (
                f"axis {j}: n-ERR of RR0 agrees with the errors {errors:04X}"
            )

    def _errors(self, chip_copy, j: int) -> int:
        """The error bits of an axis; they answer for the axis that is selected."""
        if self.mcx514:
            chip_copy.write(0, 0x1F | 0x100 << j)
            return chip_copy.read(2) & 0xFF
        chip_copy.write(0, 0x0F | 0x100 << j)
        return chip_copy.read(2) & ERRORS_304 | chip_copy.read(1) & MCX304_STOP_CAUSES

    def observe(self, chip) -> dict:
        """Return what `check_interval` needs of the moment before time passes."""
        return {"lp": self._positions(chip), "driving": chip.read(0) & 0xF}

    def _positions(self, chip) -> list[int]:
        """LP of each axis, as the bus reads it."""
        chip_copy, positions = copy.copy(chip), []
        for j in range(len(self.axes)):
            chip_copy.write(0, (0x30 if self.mcx514 else 0x10) | 0x100 << j)
            position = chip_copy.read(6) | chip_copy.read(7) << 16
            positions.append(position - (position >> 31 << 32))
        return positions

    def check_interval(self, interval, chip) -> None:
        """Assert what holds after a time in which the pins stayed as they were. course: a `Course`."""
        driving, still = interval.observation["driving"], chip.read(0) & 0xF
        total_pulses = sum(abs(n) for n in interval.moved)
        assert total_pulses <= interval.pulses, "no way without pulses"
        assert (total_pulses - interval.pulses) % 2 == 0
        if not (self.acts or self.interpolates):
            assert total_pulses == interval.pulses, "a drive goes one way"
        if not (driving or self.acts):
            assert interval.pulses == 0, "pulses without n-DRV"
        for j, (moved, before, now) in enumerate(
            zip(interval.moved, interval.observation["lp"], self._positions(chip), strict=True)
        ):
            ring = self.axes[j].ring
            if not self.acts and (ring <= 0x7FFFFFFF or ring == 0xFFFFFFFF):
                modulus = 1 << 32 if ring == 0xFFFFFFFF else ring + 1
                assert (now - before - moved) % modulus == 0, f"axis {j}: pulses out are the change of LP"
            if interval.pulses == 0 and not self.acts:
                assert now == before
            for forbidden in self.forbidden(interval.inputs, j):
                assert moved * forbidden <= 0, f"axis {j}: {moved} pulses towards an asserted limit"
            assert abs(moved) <= interval.clocks // 2 + 1, "faster than 8 Mpps"
            if driving & still & 1 << j and interval.clocks > SECOND and not self._waits(j):
                assert moved, f"axis {j}: n-DRV, but no pulse in a second"

    def _waits(self, j: int) -> bool:
        """n-DRV may be on without pulses: INPOS is awaited, or it is not known what the chip does."""
        return self.acts or self.interpolates or bool(self.axes[j].wr[2] & (0x80 if self.mcx514 else 0x8000))


def host(cls) -> NovaHost:
    """The host's view of a chip at power-up."""
    return NovaHost(tuple(Axis() for _ in range(cls.AXES)), issubclass(cls, MCX514), issubclass(cls, MCX312))


# --- traffic ---


def _code(cls, symbol: str) -> int:
    return cls.MAP.command(symbol).code


def data(code: int, value: int, axes: int) -> Writes:
    """A data-writing command."""
    return [(6, value & 0xFFFF), (7, value >> 16 & 0xFFFF), (0, axes << 8 | code)]


def load(cls, axes: int, **values: int) -> Writes:
    """Registers by name."""
    return [w for name, value in values.items() for w in data(_code(cls, name), value, axes)]


def some_axes(cls) -> st.SearchStrategy[int]:
    return st.one_of(st.sampled_from([1 << j for j in range(cls.AXES)]), st.integers(0, (1 << cls.AXES) - 1))


def raw_words() -> st.SearchStrategy[Writes]:
    """Any word at any address."""
    return st.tuples(st.integers(0, 7), st.integers(0, 0xFFFF)).map(lambda w: [w])


def raw_bytes() -> st.SearchStrategy[Writes]:
    """Any byte at any byte address."""
    return st.tuples(st.integers(BYTES, BYTES + 15), st.integers(0, 255)).map(lambda w: [w])


@st.composite
def register_loads(draw, cls) -> Writes:
    """One register with a value that is small, legal or any that fits."""
    r = draw(st.sampled_from([r for r in cls.MAP.registers if "W" in r.access]))
    low, high = r.legal or (0, r.mask)
    value = draw(st.one_of(st.integers(0, min(40, r.mask)), st.integers(low, high), st.integers(0, r.mask)))
    return data(r.number, value, draw(some_axes(cls)))


def commands(cls) -> st.SearchStrategy[Writes]:
    """Every command that there is, home searches, synchronous actions and interpolation among them."""
    codes = [code for code in range(256) if code in cls.MAP.by_code]
    return st.tuples(some_axes(cls), st.sampled_from(codes)).map(lambda c: [(0, c[0] << 8 | c[1])])


speeds = st.one_of(st.integers(1, 2000), st.integers(20_000, 1_000_000), st.sampled_from([4_000_000, 8_000_000]))
pulses = st.one_of(st.integers(0, 3), st.integers(1, 300), st.integers(1, 30_000))
small = st.integers(-100, 100)


def _select(cls, axes: int) -> tuple[int, int]:
    return 0, axes << 8 | _code(cls, "NOP")


@st.composite
def _starts_514(draw, cls) -> Writes:
    axes = draw(st.integers(1, 15))
    w2 = draw(st.sampled_from([0, 0x0800, 0x0800, 0x1800, 0x0A0A, 0x2800, 0xA800, 0x0AAA, 0x0880]))
    w3 = draw(st.sampled_from([0, 0x0004, 0x0006, 0x0001, 0x2000, 0x0002, 0x1000, 0x0005]))
    named = {
        "SV": draw(speeds), "DV": draw(speeds), "AC": draw(st.integers(100_000, 500_000_000)),
        "DC": draw(st.integers(100_000, 500_000_000)), "JK": draw(st.integers(10_000_000, 1_000_000_000)),
        "DJ": draw(st.integers(10_000_000, 1_000_000_000)), "TP": draw(pulses) * draw(st.sampled_from([1, -1])),
    }  # fmt: skip
    if w2 & 0x2000:
        named |= {"SP": draw(small), "SM": draw(small)}
    if w3 & 1:
        named["DP"] = draw(pulses)
    if draw(st.booleans()):
        named |= {
            "AO": draw(st.integers(-20, 60)),
            "LP": draw(small),
            "LX": draw(st.sampled_from([0xFFFFFFFF, 50, 999])),
        }
    start = draw(st.sampled_from(["DRVRL", "DRVRL", "DRVNR", "DRVVP", "DRVVM", "DRVAB"]))
    return [_select(cls, axes), (2, w2), (3, w3), *load(cls, axes, **named), (0, axes << 8 | _code(cls, start))]


@st.composite
def _starts_304(draw, cls) -> Writes:
    axes = draw(st.integers(1, (1 << cls.AXES) - 1))
    w2 = draw(st.sampled_from([0, 0, 0x0004, 0x0001, 0x0003, 0x2000]))
    w3 = draw(st.sampled_from([0, 0x0004, 0x0006, 0x0001, 0x0020, 0x0002]))
    speed = st.integers(1, 8000)
    named = {
        "R": draw(st.sampled_from([16_000, 80_000, 800_000, 8_000_000])), "SV": draw(speed), "V": draw(speed),
        "A": draw(speed), "D": draw(speed), "K": draw(st.integers(1, 3000)), "P": draw(pulses),
    }  # fmt: skip
    if w2 & 3:
        named |= {"CP": draw(small), "CM": draw(small)}
    if w3 & 1:
        named["DP"] = draw(pulses)
    if draw(st.booleans()):
        named |= {"AO": draw(st.integers(-20, 60)), "LP": draw(small)}
    start = draw(st.sampled_from(["F_DRV_P", "F_DRV_M", "C_DRV_P", "C_DRV_M"]))
    writes = [_select(cls, axes), (1, draw(st.sampled_from([0, 0x0A, 0x2A]))), (2, w2), (3, w3)]
    return [*writes, *load(cls, axes, **named), (0, axes << 8 | _code(cls, start))]


def starts(cls) -> st.SearchStrategy[Writes]:
    """A run as a driver starts it: modes, speeds, pulses, start. Fast, so that short advances see pulses."""
    return _starts_514(cls) if issubclass(cls, MCX514) else _starts_304(cls)


@st.composite
def changes_on_the_fly(draw, cls) -> Writes:
    """A new speed, a new number of pulses, a stop, as they come while driving."""
    axes = draw(some_axes(cls))
    if issubclass(cls, MCX514):
        value = {"DV": draw(speeds), "TP": draw(pulses) * draw(st.sampled_from([1, -1]))}
        orders = ["DRVSBRK", "DRVFBRK", "VINC", "VDEC", "DHOLD", "DFREE", "R2CLR", "RR3P0", "RR3P1"]
    else:
        value, orders = (
            {"V": draw(st.integers(1, 8000)), "P": draw(pulses)},
            ["STOP_DEC", "STOP_SUDDEN", "START_HOLD", "START_FREE"],
        )
    name = draw(st.sampled_from([*value, *orders]))
    return load(cls, axes, **{name: value[name]}) if name in value else [(0, axes << 8 | _code(cls, name))]


@st.composite
def _actions(draw, cls) -> Writes:
    """A timer, a split pulse, a comparison or a synchronous action of the MCX514."""
    axes, m = draw(some_axes(cls)), draw(st.integers(0, 3))
    writes = load(
        cls, axes, TM=draw(st.integers(1, 500)), SP1=draw(st.integers(1, 20)) << 16 | draw(st.integers(2, 40)),
        SP2=draw(st.integers(0, 30)), MRM=draw(st.integers(0, 0xFFFF)), IV=draw(st.integers(1, 100_000)),
        **{f"MR{m}": draw(st.one_of(small, speeds))},
    )  # fmt: skip
    sets = draw(st.integers(0, 15)) | draw(st.integers(0, 24)) << 8 | draw(st.integers(0, 0x7F)) << 9 & 0xFE00
    writes += data(0x26 + m, sets, axes)
    return [
        *writes,
        *(
            (0, axes << 8 | draw(st.sampled_from([0x73, 0x74, 0x75, 0x76, 0x80 | 1 << m, 0xA0 | 1 << m])))
            for _ in range(2)
        ),
    ]


@st.composite
def _home_searches(draw, cls) -> Writes:
    axes = draw(some_axes(cls))
    if issubclass(cls, MCX514):
        named = {
            "H1M": draw(st.integers(0, 0xFFFF)),
            "H2M": draw(st.integers(0, 0x7F)),
            "HV": draw(speeds),
            "DV": draw(speeds),
        }
        return [*load(cls, axes, **named), (0, axes << 8 | 0x5A)]
    home = "EM" if issubclass(cls, MCX314AS) else "HM"
    named = {
        home: draw(st.integers(0, 0xFFFF)) << (16 if home == "EM" else 0),
        "HV": draw(st.integers(1, 8000)),
        "R": 80_000,
    }
    return [*load(cls, axes, **named), (0, axes << 8 | 0x62)]


@st.composite
def _interpolations(draw, cls) -> Writes:
    """Finish points and a centre, then an interpolation, or a bit pattern."""
    both = (1 << cls.AXES) - 1
    if issubclass(cls, MCX514):
        writes = data(_code(cls, "IPM"), draw(st.sampled_from([0x03, 0x05, 0x07, 0x0F, 0x43, 0x0103])), 0)
        writes += load(cls, both, SV=draw(speeds), DV=draw(speeds), AC=draw(st.integers(100_000, 500_000_000)))
        for j in range(cls.AXES):
            writes += load(cls, 1 << j, TP=draw(small), CP=draw(small))
        return [*writes, (0, draw(st.sampled_from([0x6D, 0x6E]))), (0, draw(st.integers(0x60, 0x6C)))]
    writes = [
        (5, draw(st.sampled_from([0x04, 0x01, 0x0104]))),
        *load(cls, both, R=80_000, V=draw(st.integers(1, 8000))),
    ]
    for j in range(cls.AXES):
        writes += load(cls, 1 << j, P=draw(small), C=draw(small))
    if draw(st.booleans()):
        words = [(k, draw(st.integers(0, 0xFFFF))) for k in (2, 3, 4, 5)]
        writes += [(0, 0x36), *words, (0, 0x38), (0, 0x37)]
    return [*writes, (0, draw(st.sampled_from([0x30, 0x32, 0x33, 0x34])))]


def programs(cls) -> st.SearchStrategy[Writes]:
    """Return a strategy for bus programs of any kind, autonomous ones less often: they allow few expectations."""
    strategies = [starts(cls)] * 3 + [changes_on_the_fly(cls)] * 4 + [register_loads(cls), commands(cls), raw_words()]
    strategies.append(_home_searches(cls))
    if issubclass(cls, MCX514):
        strategies += [_actions(cls), raw_bytes()] + [_interpolations(cls)] * (cls.AXES > 1)
    elif issubclass(cls, (MCX312, MCX314AS)):
        strategies.append(_interpolations(cls))
    return st.one_of(strategies)


def clocks() -> st.SearchStrategy[int]:
    """Nothing, single clocks, short, long, more than a second."""
    return st.one_of(
        st.integers(0, 3), st.integers(0, 5000), st.integers(0, 400_000), st.sampled_from([1_600_000, SECOND + 2])
    )


def cruise(cls, axis: int, plus: bool) -> Writes:
    """At 4000 pps, which the motors follow; limits stop at once."""
    axes = 1 << axis
    if issubclass(cls, MCX514):
        speeds_, w2, order = {"SV": 4000, "DV": 4000}, 0x0800, "DRVVP" if plus else "DRVVM"
    else:
        speeds_, w2, order = {"R": 8_000_000, "SV": 4000, "V": 4000}, 0, "C_DRV_P" if plus else "C_DRV_M"
    return [_select(cls, axes), (2, w2), (3, 0), *load(cls, axes, **speeds_), (0, axes << 8 | _code(cls, order))]
