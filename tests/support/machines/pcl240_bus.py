"""What a host knows of a PCL-240 from its own bus writes and input edges alone, what it may expect of the chip, and programs for
it as strategies. Nothing here looks into the chip: a mode is what was written last.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hypothesis import strategies as st

COUNTER = 1 << 24
Writes = list[tuple[int, int]]


@dataclass(frozen=True)
class Pcl240Host:
    """Modes by what was written, inputs by what was set; `extp`: EXTP as the last tick saw it."""

    BLINKING: ClassVar = ("extp",) * 4  # inputs that rather blink, whose edges count, by weight
    ADDRESSES: ClassVar = range(4)
    PULSE_PINS: ClassVar = ("pout", "pdir")
    MAKES_PULSES: ClassVar = True

    control: int = 0
    output: int = 0
    extp: bool = False

    def written(self, address: int, value: int) -> Pcl240Host:
        """After a bus write."""
        if address == 0 and value >> 6 == 1:
            return Pcl240Host(value, self.output, self.extp)
        if address == 0 and value >> 6 == 3:
            return Pcl240Host(self.control, value, self.extp)
        return self

    def reset(self) -> Pcl240Host:
        """After /RESET: the pins stay as they were."""
        return Pcl240Host(extp=self.extp)

    def advanced(self, inputs: list[dict[str, bool]]) -> Pcl240Host:
        """After at least one tick with these inputs, axis by axis."""
        return Pcl240Host(self.control, self.output, inputs[0].get("extp", False))

    @property
    def direction(self) -> int:
        return -1 if self.control & 0x08 else 1

    def counted(self, pulses: int, inputs: dict[str, bool]) -> int:
        """Return the number by which R0 falls while `pulses` are output and the inputs are these."""
        if self.output & 0x10:
            return int(self.extp and not inputs.get("extp", False))
        return pulses

    def position_counts(self, registers: dict[str, int]) -> bool:
        """R10 follows the pulses."""
        return "R10" in registers and bool(self.control & 0x20)

    def limit(self) -> str:
        """The input that forbids pulses now."""
        return "el_minus" if self.control & 0x08 else "el_plus"

    def status(self, pins: dict[str, bool]) -> int:
        """The status byte that goes with these pins (data sheet; normative bits b7 to b0)."""
        sd = pins["sd_minus" if self.control & 0x08 else "sd_plus"]
        bits = (
            not pins["irq"],
            not pins["hold"],
            pins["fkeep"],
            pins["lt"],
            pins["zero"],
            sd,
            pins["org"],
            pins["ins"],
        )
        return sum(bool(bit) << 7 - k for k, bit in enumerate(bits))

    @staticmethod
    def put(chip, address: int, value: int) -> None:
        """One bus write cycle."""
        chip.write(address, value)

    def refuses(self, chip) -> bool:
        """At rest, and the limit of the direction is asserted: whatever is written next, no drive begins."""
        return chip.pins.hold and getattr(chip.pins, self.limit())

    def check(self, chip) -> None:
        """Assert what holds at any moment."""
        assert chip.values()["status"] == self.status(chip.pins.as_dict()), "the status byte agrees with the pins"
        assert not (chip.pins.hold and chip.pins.pout), "HOLD before the last pulse is complete"

    def observe(self, chip) -> dict:
        """Return what `check_interval` needs of the moment before time passes."""
        return {"registers": chip.values(), "hold": chip.pins.hold}

    def check_interval(self, before, chip) -> None:
        """Assert what holds after a time in which the pins stayed as they were. before: a `Course`."""
        (inputs,), registers, values = before.inputs, before.observation["registers"], chip.values()
        if before.clocks:
            fell = (registers["R0"] - values["R0"]) % COUNTER
            assert fell == self.counted(before.pulses, inputs) % COUNTER, "pulses out are the change of the counter"
        if "R10" in registers:
            moved = (values["R10"] - registers["R10"]) % COUNTER
            expected = before.pulses * self.direction if self.position_counts(registers) else 0
            assert moved == expected % COUNTER, "pulses out are the change of position"
        if before.pulses:
            assert before.moved == [before.pulses * self.direction], "pulses go the way that was asked for"
            assert not inputs[self.limit()], f"{before.pulses} pulses towards an asserted limit"
            assert not before.observation["hold"], f"{before.pulses} pulses while HOLD is asserted"
        assert chip.pins.hold or not before.observation["hold"], "HOLD ends by itself"


def host(cls) -> Pcl240Host:
    """The host's view of a chip at power-up."""
    return Pcl240Host()


def load(cls, name: str, value: int) -> Writes:
    """A whole register, high byte first."""
    r = cls.MAP.register(name)
    return [(0, 0x80 | r.number), *((k + 1, value >> 8 * k & 0xFF) for k in reversed(range(3)))]


def raw_bytes() -> st.SearchStrategy[Writes]:
    """Any byte at any address."""
    return st.tuples(st.integers(0, 3), st.integers(0, 255)).map(lambda w: [w])


def register_loads(cls) -> st.SearchStrategy[Writes]:
    """One register with a value that is small, legal or any that fits."""

    def values(r):
        low, high = r.legal or (0, r.mask)
        return st.one_of(st.integers(0, min(40, r.mask)), st.integers(low, high), st.integers(0, r.mask))

    return st.sampled_from(cls.MAP.registers).flatmap(lambda r: values(r).map(lambda v: load(cls, r.name, v)))


@st.composite
def starts(draw, cls) -> Writes:
    """A run as a driver starts it: registers, reset command, modes, start. Fast, so that short advances see pulses."""
    named = {
        "R1": draw(st.integers(1, 8191)), "R2": draw(st.integers(1, 8191)), "R3": draw(st.integers(1, 8191)),
        "R4": draw(st.integers(2, 60)), "R5": draw(st.integers(2, 60)), "R6": draw(st.integers(0, 60)),
        "R7": draw(st.integers(2, 12)), "R0": draw(st.one_of(st.integers(1, 300), st.integers(0, COUNTER - 1))),
    }  # fmt: skip
    writes: Writes = [(0, 0xC0 | draw(st.sampled_from([0x00, 0x01, 0x08, 0x10, 0x11, 0x20])))]
    if any(r.name == "R13" for r in cls.MAP.registers) and draw(st.booleans()):
        named["R13"] = draw(st.integers(0, 63)) << 16
        named["R14"], named["R15"] = draw(st.integers(0, 400)), draw(st.integers(0, 400))
    writes.append((0, 0x08))
    for name, value in named.items():
        writes += load(cls, name, value)
    writes.append((0, 0x40 | draw(st.integers(0, 0x3F))))
    return [*writes, (0, draw(st.sampled_from([0x10, 0x11, 0x13, 0x15, 0x17, 0x31, 0x35])))]


def commands() -> st.SearchStrategy[Writes]:
    """Stops, speed changes, resets, mode changes."""
    known = [0x08, 0x10, 0x11, 0x13, 0x14, 0x15, 0x17, 0x18, 0x1D, 0x1F, 0x28, 0x35, 0x3D]
    return st.one_of(st.sampled_from(known), st.integers(0x40, 0x7F), st.integers(0xC0, 0xFF)).map(lambda c: [(0, c)])


def programs(cls) -> st.SearchStrategy[Writes]:
    """Any of them."""
    return st.one_of(starts(cls), starts(cls), register_loads(cls), commands(), raw_bytes())


def clocks() -> st.SearchStrategy[int]:
    """Nothing, single ticks, short, long."""
    return st.one_of(
        st.integers(0, 3), st.integers(0, 5000), st.integers(0, 400_000), st.sampled_from([4_915_200, 1 << 27])
    )


def cruise(cls, axis: int, plus: bool) -> Writes:
    """At 4000 pps, which the motors follow."""
    writes = [w for name, value in (("R0", 1000), ("R1", 400), ("R7", 60)) for w in load(cls, name, value)]
    return [*writes, (0, 0x08), (0, 0x40 if plus else 0x48), (0, 0x10)]
