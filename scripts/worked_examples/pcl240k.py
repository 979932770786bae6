"""PCL-240K: the data sheet and its Q & A."""

from __future__ import annotations

from functools import partial

from stage.chips import PCL240K
from worked_examples.table import compute_highest_rate, compute_intervals, example, find_clock, write_registers

CLOCK = 4_915_200  # Hz, the usual reference clock: section 1, (2)
RESET, FL, FH1, FH1_RAMPS, FL_RAMPS = 0x08, 0x10, 0x11, 0x15, 0x14
MANUAL, PRESET = 0x40, 0x44

sheet = partial(example, "PCL-240K")


def start_chip(control: int, start: int, **registers: int) -> PCL240K:
    """Make a chip, write its registers and start it.

    Args:
        control: Control mode command.
        start: Start command.
        **registers: Values by name.
    """
    chip = PCL240K(CLOCK)
    chip.write(0, control)
    write_registers(chip, **registers)
    chip.write(0, start)
    return chip


def count_pulses_in_a_second(**registers: int) -> int:
    """Count the pulses in the first second at constant FH1 speed."""
    return start_chip(MANUAL, FH1, R1=1, **registers).advance(CLOCK)


sheet("1 (6), R7", "R7 = 600, the 1x mode: pps at R2 = 8191", 8191, "pps")(
    lambda: count_pulses_in_a_second(R2=8191, R7=600)
)
sheet("4, R7", "R7 = 60, the 10x mode: pps at R2 = 1000", 10_000, "pps")(
    lambda: count_pulses_in_a_second(R2=1000, R7=60)
)
sheet("1 (6), R7", "R7 = 20, the 30x mode: pps at R2 = 8191", 245_730, "pps")(
    lambda: count_pulses_in_a_second(R2=8191, R7=20)
)
sheet("1 (5)", "R7 = 20: pps of one speed step", 30, "pps")(lambda: count_pulses_in_a_second(R2=1, R7=20))


@sheet("1 (3), R0", "the largest preset number: pulses made", 16_777_215)
def _all_of_them() -> int:
    return start_chip(PRESET, FH1, R0=0xFFFFFF, R1=1, R2=8191, R7=20).advance(70 * CLOCK)


@sheet("4, R0", "started with R0 = 0 in preset mode: pulses", 0)
def _none() -> int:
    return start_chip(PRESET, FH1, R0=0, R1=1, R2=8191, R7=20).advance(CLOCK)


@sheet("4, R0", "R0 after one pulse more than it held, manual mode", 0xFFFFFF)
def _counter_below_zero() -> int:
    chip = start_chip(MANUAL, FH1, R0=1, R1=1, R2=1, R7=600)
    chip.advance(2 * CLOCK + 1)
    chip.write(0, RESET)
    chip.advance(CLOCK)
    return sum(chip.read(address) << 8 * (address - 1) for address in (3, 2, 1))


@sheet("4, R0", "preset 1000, stopped by 08h on its way, started again: pulses in all", 1000)
def _resumed() -> int:
    chip = start_chip(PRESET, FH1, R0=1000, R1=1, R2=1000, R7=600)
    first = chip.advance(CLOCK // 3)
    chip.write(0, RESET)
    first += chip.advance(CLOCK)
    chip.write(0, FH1)
    return first + chip.advance(5 * CLOCK)


RAMP = {"R1": 100, "R2": 4000, "R4": 300, "R5": 500, "R7": 60}
STEPS = RAMP["R2"] - RAMP["R1"]
TRIANGLE = (RAMP["R2"] ** 2 - RAMP["R1"] ** 2) / (16384 * RAMP["R7"])
PSD = TRIANGLE * RAMP["R5"]
SHORT = int(TRIANGLE * (RAMP["R4"] + RAMP["R5"])) // 2
PEAK = 10 * (SHORT * 16384 * RAMP["R7"] / (RAMP["R4"] + RAMP["R5"]) + RAMP["R1"] ** 2) ** 0.5
A_CLOCK = "pulses begin at whole clocks"


@sheet("4, R4", "Tsu of R1 = 100, R2 = 4000, R4 = 300", STEPS * RAMP["R4"] / CLOCK, "s")
def _tsu() -> float:
    chip = start_chip(MANUAL, FH1_RAMPS, **RAMP)
    return find_clock(chip, lambda c: not c.pins.fup, CLOCK) / CLOCK


@sheet("4, R5, (3)", "Tsd of R5 = 500, between the same speeds", STEPS * RAMP["R5"] / CLOCK, "s")
def _tsd() -> float:
    chip = start_chip(MANUAL, FH1_RAMPS, **RAMP)
    chip.advance(CLOCK)
    chip.write(0, FL_RAMPS)
    chip.advance(1)
    return (1 + find_clock(chip, lambda c: not c.pins.fdown, CLOCK)) / CLOCK


@sheet("4, R6, (5)", "FLout of R1 = 100, R7 = 60", 100 * CLOCK / (8192 * 60), "pps", 0.1, A_CLOCK)
def _fl() -> float:
    return CLOCK / int(compute_intervals(start_chip(MANUAL, FL, **RAMP).trace(CLOCK))[-1])


@sheet("4, R6, (6)", "FH1out of R2 = 4000, R7 = 60", 4000 * CLOCK / (8192 * 60), "pps")
def _fh() -> int:
    chip = start_chip(MANUAL, FH1_RAMPS, **RAMP)
    chip.advance(CLOCK)
    return chip.advance(CLOCK)


@sheet(
    "4, R6",
    "Psd, the pulses of that ramp down",
    PSD,
    "pulses",
    2.5,
    "a staircase of (R2 - R1) R5 / (16384 R7) = 2 fewer",
)
def _psd() -> int:
    chip = start_chip(MANUAL, FH1_RAMPS, **RAMP)
    chip.advance(CLOCK)
    chip.write(0, FL_RAMPS)
    return chip.advance(STEPS * RAMP["R5"])


@sheet(
    "4, R6",
    "R6 = Psd + 5: pulses at FL speed in the end",
    5,
    "pulses",
    3,
    "as Psd; R6 is whole, and the ramp begins below it",
)
def _tail() -> int:
    chip = start_chip(PRESET, FH1_RAMPS, R0=30_000, R6=int(PSD) + 5, **RAMP)
    at_fl = CLOCK / 1000
    return int((compute_intervals(chip.trace(20 * CLOCK))[-100:] > 0.999 * at_fl).sum()) + 1


@sheet("4, R6", "R6 > R0 before a high-speed start: the highest rate is FL's", 1000, "pps", 0.1, A_CLOCK)
def _ramp_down_point_above_r0() -> float:
    chip = start_chip(PRESET, FH1_RAMPS, R0=500, R6=501, **RAMP)
    return CLOCK / int(compute_intervals(chip.trace(CLOCK)).min())


@sheet(
    "Q & A, triangle", "R6 = R0 R5 / (R4 + R5), R0 half of the triangle's limit: the highest rate", PEAK, "pps", 40,
    "mean of 16 pulses; speed steps of 10 pps",
)  # fmt: skip
def _triangle() -> float:
    chip = start_chip(PRESET, FH1_RAMPS, R0=SHORT, R6=SHORT * RAMP["R5"] // (RAMP["R4"] + RAMP["R5"]), **RAMP)
    return compute_highest_rate(chip.trace(CLOCK), CLOCK)


@sheet("3 d), POUT", "duty of the pulses", 50, "%")
def _duty() -> float:
    chip = start_chip(MANUAL, FH1, R1=1, R2=1, R7=600)
    chip.advance(CLOCK)
    return 100 * find_clock(chip, lambda c: not c.pins.pout, CLOCK) / CLOCK


@sheet(
    "Q & A, ratio", "a : b of 3 : 2 at constant speed, pulses of 100 s", 1.5, "", 1e-3, "the last pulse of either axis"
)
def _ratio() -> float:
    a, b = (start_chip(MANUAL, FH1, R1=1, R2=speed, R7=60).advance(100 * CLOCK) for speed in (300, 200))
    return a / b


@sheet(
    "Q & A, bit 6",
    "08h while POUT is low: bit 6 stays until the pulse is complete, clocks of a period of 4,915,200",
    CLOCK // 2,
)
def _complete() -> int:
    chip = start_chip(MANUAL, FH1, R1=1, R2=1, R7=600)
    chip.advance(CLOCK)
    chip.write(0, RESET)
    return find_clock(chip, lambda c: not c.read(0) & 0x40, CLOCK)
