"""The NOVA family on the fuzzer's bench."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from fuzzing.family import Family, Values, Work
from fuzzing.rows import make_record
from stage.chips import Chip
from stage.chips.chip import Pins
from stage.chips.nova import MCX514, core, lint, state
from stage.chips.nova.functions import split_pulse, timer
from stage.chips.nova.interpolation import circle as circular
from stage.chips.nova.interpolation import interpolator as interpolation
from stage.chips.nova.interpolation import line as linear
from stage.chips.nova.motion import profile_planner as plan
from stage.chips.nova.motion import single_axis_drive
from stage.native import COMPILED

BYTES = 16  # byte addresses of the 8-bit bus
OFF = 0xFFFFFFFF
MODES, HOME_MODES = 0x20, 0x60  # codes
LONG = 1 << 18  # clocks, where work is by the tick
SHARED_PINS = ("lmt_plus", "lmt_minus", "stop0", "stop1", "stop2")
AXIS_PINS = (("inpos", "alarm", "pio0"), ("eca", "ecb", "pio4"), ("inpos", "alarm", "pio1"), ("alarm", "pio5", "pio2"))
"""Of each axis, so that five bits tell them all; EMG of the chip takes the place of the very last one."""
FIRST_GENERATION = {
    "pio0": "exp_plus",
    "pio1": "exp_plus",
    "pio2": "exp_plus",
    "pio4": "exp_minus",
    "pio5": "exp_minus",
}
"""Pins in place of those that it has not."""
MODES_514 = ((2, (0, 0x0800, 0x1800, 0x2800, 0xA800, 0x0AAA, 0x0880, 0x0A0A)), (3, (0, 4, 6, 1, 0x2000, 2, 0x1000, 5)))
MODES_304 = ((2, (0, 4, 1, 3, 0x2000, 0x8000, 0x0018, 0)), (3, (0, 4, 6, 1, 0x20, 2, 0x100, 5)))
SPEEDS_514 = (1, 100, 4000, 20_000, 100_000, 1_000_000, 4_000_000, 8_000_000)
SPEEDS_304 = (1, 2, 50, 400, 1000, 3000, 5000, 8000)
RATES = (1, 1000, 100_000, 1_000_000, 10_000_000, 100_000_000, 400_000_000, 536_870_911)
RANGES = (8_000_000, 800_000, 80_000, 16_000)
STARTS_514 = ("DRVRL", "DRVNR", "DRVVP", "DRVVM", "DRVAB", "HMSRC", "LHK2", "LHK3", "CHKCW", "CHKCCW", "BHK2", "HLCW")
STARTS_300 = ("F_DRV_P", "F_DRV_M", "C_DRV_P", "C_DRV_M", "IP_2ST", "IP_CW", "IP_CCW", "IP_2BP", "IP_3ST", "IP_3BP")
INTERPOLATION_AXES = (0x03, 0x07, 0x0F, 0x05, 0x43, 0x87, 0x103, 0x203)  # IPM


@cache
def counted_core() -> Work:
    """Return a counter of events and of steps that may cause one, for which the core's functions are wrapped at the first call."""
    work = Work()
    lint.LintState.copy_record = lambda self: make_record(self._record, state.STATE)  # type: ignore[method-assign]

    def counting(module: Any, name: str, calls: int = 0, steps: int = 0) -> None:
        function = getattr(module, name)

        def counted(*args: Any) -> Any:
            work.spend()
            work.calls += calls
            work.steps += steps
            return function(*args)

        setattr(module, name, counted)

    counting(core, "_process_due_events", calls=1)
    for module, name in (
        (single_axis_drive, "note_event"), (timer, "note_event"), (split_pulse, "note_event"), (plan, "_append_open_piece"),
        (interpolation, "begin_interpolation_tick"),
    ):  # fmt: skip
        counting(module, name, steps=1)
    for module, name in ((linear, "step_line"), (circular, "step_arc"), (circular, "_find_nearest_coordinate")):
        counting(module, name)
    return work


class NovaFamily(Family):
    """NOVA chips on the fuzzer's bench: registers by commands, two data buses, and limits for the work of their cores."""

    FEW = 2000
    PULSED = state.PLS | state.DIR

    def __init__(self, chip: type[Chip]):
        super().__init__(chip)
        self.work = None if COMPILED else counted_core()
        self.new = issubclass(chip, MCX514)
        self.codes = sorted(chip.MAP.by_code)
        self.all = (1 << chip.AXES) - 1
        self.symbols = {command.symbol for command in chip.MAP.commands}
        self.starts = tuple(filter(self.symbols.__contains__, STARTS_514 if self.new else STARTS_300))

    # --- bytes as bus writes ---

    def _code(self, symbol: str) -> int:
        return self.chip.MAP.command(symbol).code

    def _data(self, code: int, value: int, axes: int) -> list[tuple[int, int]]:
        return [(6, value & 0xFFFF), (7, value >> 16 & 0xFFFF), (0, (axes & self.all) << 8 | code)]

    def make_writes(self, kind: int, low: int, take: Callable[[int], int]) -> list[tuple[int, int]]:
        """Return a raw word (8-bit bus: a byte), a mode, a register with a number of any size, a command, or a whole start."""
        if kind == 0 and low & 24 == 8:
            what, value = take(1), take(2)
            return self._data((MODES if self.new else HOME_MODES) + (what >> 4), value, what)
        if kind == 0:
            return [(low, take(2))]
        if kind == 1:
            how, value = take(1), take(2)
            value <<= 2 * (how >> 4 & 7)
            return self._data(low, -value if how & 0x80 else value, how)
        if kind == 2:
            code = take(1)
            return [(0, (low & self.all) << 8 | (code if low & 16 else self.codes[code % len(self.codes)]))]
        return self._start(low, take)

    def _start(self, low: int, take: Callable[[int], int]) -> list[tuple[int, int]]:
        """Return the writes of modes, speeds, distances and a start command, as a driver makes them."""
        axes, modes, speeds, rate = low & self.all, take(1), take(1), take(1)
        order, pulses, centre = take(1), take(2), take(2)
        pulses, centre = pulses - (pulses >> 15 << 16), centre - (centre >> 15 << 16)
        start = self.starts[order % len(self.starts)]
        writes = [(0, axes << 8 | self._code("NOP"))]
        for k, (word, choices) in enumerate(MODES_514 if self.new else MODES_304):
            writes.append((word, choices[modes >> 3 * k & 7]))
        table, common = (SPEEDS_514, {}) if self.new else (SPEEDS_304, {"R": RANGES[modes >> 6]})
        sv, dv, rates = table[speeds & 7], table[speeds >> 3 & 7], RATES[rate & 7]
        if self.new:
            values = {
                "SV": sv, "DV": dv, "AC": rates, "DC": RATES[rate >> 3 & 7], "JK": rates, "TP": pulses, "CP": centre,
            }  # fmt: skip
        else:
            values = {
                "SV": sv, "V": dv, "A": 1 + rate * 31, "D": 1 + speeds * 31, "K": 1 + rate * 15, "P": pulses & 0xFFFFF,
            }  # fmt: skip
            if "C" in self.symbols:
                values |= {"P": pulses, "C": centre}
        for name, value in (common | values).items():
            if name in self.symbols:
                writes += self._data(self._code(name), value, axes)
        if "HK" in start or start.startswith("HL"):
            writes += self._data(self._code("IPM"), INTERPOLATION_AXES[order >> 5], 0)
            return [*writes, (0, self._code("DECEN" if order & 16 else "DECDIS")), (0, self._code(start))]
        if start.startswith("IP"):
            return [*writes, (5, 4 | order >> 7 << 8), (0, self._code(start))]
        return [*writes, (0, axes << 8 | self._code(start))]

    def write(self, chip: Chip, address: int, value: int) -> None:
        if address >= BYTES and isinstance(chip, MCX514):
            chip.write_byte(address, value)
        else:
            chip.write(address, value)

    def read(self, chip: Chip, address: int) -> int:
        if address & BYTES and isinstance(chip, MCX514):
            return chip.read_byte(address)
        return chip.read(address)

    def _pins(self, pins: Pins, k: int) -> list[str]:
        names = (*SHARED_PINS, *AXIS_PINS[k])
        return [name if hasattr(pins, name) else FIRST_GENERATION[name] for name in names]

    def pins(self, chip: Chip) -> list[tuple[Pins, str]]:
        result = [(axis.pins, name) for k, axis in enumerate(chip.axes) for name in self._pins(axis.pins, k)]
        result[-1] = (Pins(chip, chip.AXES, state.COMMON_INPUTS, state.COMMON_OUTPUTS), "emg")
        return result

    # --- what must hold ---

    def predict_read(self, chip: Chip, values: Values, address: int) -> int | None:
        c, n = chip.state, address & 7
        if self.new and address & BYTES:
            return None
        lowest = next((j for j in range(chip.AXES) if c["selected"] >> j & 1), 0)
        return values[f"RR3-{c['status_pages'] >> lowest & 1}" if n == 3 and self.new else f"RR{n}"]

    def is_silent(self, chip: Chip) -> bool:
        """Return whether nothing drives and nothing can begin a drive by itself, or the emergency stop is active."""
        c = chip.state
        axes = [c["ax"][j] for j in range(chip.AXES)]
        return bool(c["emg_pin"]) or not (
            values_of(axes, "driving home_state interpolates enabled_sets due_sets launch_direction")
        )

    def limit_clocks(self, chip: Chip, clocks: int) -> int:
        """Return fewer clocks if an interpolation, a timer or a ring counter is active, because each of their steps is work."""
        c = chip.state
        busy = "timer_end enabled_sets split_running home_state"
        rings = self.new and any(c["ax"][j]["reg"][state.LX] != OFF for j in range(chip.AXES))
        works = rings or c["interpolating"] or values_of([c["ax"][j] for j in range(chip.AXES)], busy)
        return min(clocks, LONG) if works else clocks

    def read_end_values(self, chip: Chip) -> dict[str, int]:
        """Return the chip's own values, except PLS and DIR: they carry pulses, which have entries of their own in a waveform."""
        return super().read_end_values(chip) | {"counter": int(chip.state["ax"][0]["reg"][state.LP])}

    def compute_max_work(self, chip: Chip, pulses: int) -> int:
        """Return the largest number of event rounds.

        A round may be caused by an event in the journal, a segment of a speed profile, a step of an interpolation, a turn of a ring
        counter with its comparisons, or an input's filter, but never by clocks or pulses alone.
        """
        rings = [int(chip.state["ax"][j]["reg"][state.LX]) for j in range(chip.AXES)] if self.new else [OFF]
        revolutions = sum(pulses // (maximum + 1) for maximum in rings if maximum >= 0)
        return 3 * self.work.steps + 10 * revolutions + 64  # type: ignore[union-attr]


def values_of(axes: list, names: str) -> bool:
    """Return whether any of some fields, given by name, of any axis is not 0."""
    return any(x[name] for x in axes for name in names.split())
