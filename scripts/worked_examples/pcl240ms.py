"""PCL-240MS: "Differences between PCL-240MK and PCL-240MS"."""

from __future__ import annotations

from functools import partial
from math import floor, sqrt

import numpy as np

from stage.chips import PCL240MS
from worked_examples.pcl240k import CLOCK, FH1, FH1_RAMPS, FL_RAMPS, MANUAL, PRESET
from worked_examples.table import compute_highest_rate, example, find_clock, write_registers

sheet = partial(example, "PCL-240MS")
AUTOMATIC, ORIGIN = PRESET | 0x10, 0x41
RETURN_BY_INDEX = 1 << 21  # of R13


def start_chip(control: int, **registers: int) -> PCL240MS:
    """Make a chip, write its registers and start it at high speed.

    Args:
        control: Control mode command.
        **registers: Values by name.
    """
    chip = PCL240MS(CLOCK)
    chip.write(0, control)
    write_registers(chip, **registers)
    chip.write(0, FH1_RAMPS)
    return chip


def start_ramp_down(**registers: int) -> PCL240MS:
    """Return a chip that was at FH and has just begun to ramp down to FL."""
    chip = start_chip(MANUAL, **registers)
    chip.advance(4 * CLOCK)
    chip.write(0, FL_RAMPS)
    chip.advance(1)
    return chip


def compute_s_curve_span(clocks: np.ndarray, fl: float) -> float:
    """Compute from the pulses of a ramp how many pps above `fl` the acceleration has reached its final value.

    Below that rate, the square of the acceleration is proportional to the increase of the rate.

    Args:
        clocks: Clock of each pulse.
        fl: Start rate, pps.
    """
    t = clocks[:: max(len(clocks) // 1000, 1)] / CLOCK
    rate, middle = (len(clocks) // (len(t) - 1)) / np.diff(t), (t[1:] + t[:-1]) / 2
    growth, gained = np.diff(rate) / np.diff(middle), (rate[1:] + rate[:-1]) / 2 - fl
    final = np.median(growth[(gained > 0.4 * gained.max()) & (gained < 0.6 * gained.max())])
    below = (growth > 0.4 * final) & (growth < 0.8 * final) & (gained < 0.4 * gained.max())
    return float(np.median(gained[below] * (final / growth[below]) ** 2))


TEN = {"R1": 10, "R2": 5000, "R4": 1000, "R5": 1000, "R7": 60}  # x 10: 100 to 50,000 pps
TWENTY = {"R1": 25, "R2": 5000, "R4": 1000, "R5": 1000, "R7": 30}  # x 20: 500 to 100,000 pps
FITTED = "found from the times of the pulses"


@sheet("3-1, example", "x 10, 100 to 50,000 pps, R14 = 1000: S of the ramp up", 10_000, "pps", 100, FITTED)
def _s_up() -> float:
    chip = start_chip(MANUAL, R14=1000, **TEN)
    return compute_s_curve_span(chip.trace(CLOCK)["clock"], 100)


@sheet("3-2, example", "x 20, 500 to 100,000 pps, R15 = 1000: S of the ramp down", 20_000, "pps", 200, FITTED)
def _s_down() -> float:
    chip = start_ramp_down(R15=1000, **TWENTY)
    return compute_s_curve_span(-chip.trace((4975 + 2 * 1000) * 1000 // 2)["clock"][::-1], 500)


STEPS = TEN["R2"] - TEN["R1"]


@sheet("3-3", "Tsu without linear part: R1 = 10, R2 = 5000, R4 = 1000", STEPS * 1000 / CLOCK, "s")
def _tsu() -> float:
    return find_clock(start_chip(MANUAL, **TEN), lambda c: not c.pins.fup, 4 * CLOCK) / CLOCK


@sheet("3-3", "Tsd without linear part, R5 = 1000", STEPS * 1000 / CLOCK, "s")
def _tsd() -> float:
    return (1 + find_clock(start_ramp_down(**TEN), lambda c: not c.pins.fdown, 4 * CLOCK)) / CLOCK


@sheet("3-3", "Tsu with R14 = 1000", (STEPS + 2000) * 1000 / (2 * CLOCK), "s")
def _tsu_linear() -> float:
    return find_clock(start_chip(MANUAL, R14=1000, **TEN), lambda c: not c.pins.fup, 4 * CLOCK) / CLOCK


@sheet("3-3", "Tsd with R15 = 500", (STEPS + 1000) * 1000 / (2 * CLOCK), "s")
def _tsd_linear() -> float:
    return (1 + find_clock(start_ramp_down(R15=500, **TEN), lambda c: not c.pins.fdown, 4 * CLOCK)) / CLOCK


MOVE = {"R1": 100, "R2": 4000, "R4": 300, "R5": 300, "R7": 60}  # automatic deceleration is on R4
LEAST = (4000**2 - 100**2) * 600 / (60 * 16384)
MEAN = "mean of 16 pulses"


@sheet("3-4.1", "automatic, R0 one more than the least of a trapezoid: the highest rate", 40_000, "pps", 50, MEAN)
def _just_trapezoid() -> float:
    return compute_highest_rate(start_chip(AUTOMATIC, R0=floor(LEAST) + 1, R6=5, **MOVE).trace(4 * CLOCK), CLOCK)


@sheet(
    "3-4.1", "half of that: the highest rate, by the revised R2",
    10 * floor(sqrt(floor(LEAST / 2) * 60 * 16384 / 600 + 100**2)), "pps", 40, MEAN,
)  # fmt: skip
def _revised() -> float:
    return compute_highest_rate(start_chip(AUTOMATIC, R0=floor(LEAST / 2), R6=5, **MOVE).trace(4 * CLOCK), CLOCK)


SPAN = 500
LINEAR = (100 + SPAN) * SPAN * 600 / (60 * 4096)
TRAPEZOID = (100 + 4000) * ((4000 - 100) * 600 + 2 * 600 * SPAN) / (60 * 32768)
BETWEEN = floor((LINEAR + TRAPEZOID) / 2)


@sheet(
    "3-4.2", "R14 = R15 = 500, R0 between the two minima: the highest rate, by the revised R2",
    10 * floor(-SPAN + sqrt((SPAN - 100) ** 2 + BETWEEN * 60 * 32768 / 600)), "pps", 40,
    f"{MEAN}; the formula's misprint corrected: + in the root, R4 + R5 below R0 R7 32768",
)  # fmt: skip
def _revised_linear() -> float:
    chip = start_chip(AUTOMATIC, R0=BETWEEN, R6=5, R14=SPAN, R15=SPAN, **MOVE)
    return compute_highest_rate(chip.trace(4 * CLOCK), CLOCK)


def count_pulses_left(offset: int) -> int:
    """Return R0 where the automatic ramp-down of a long move begins.

    Args:
        offset: Value of R6.
    """
    chip = start_chip(AUTOMATIC, R0=60_000, R6=offset & 0xFFFFFF, **MOVE)
    chip.advance(CLOCK)
    find_clock(chip, lambda c: c.pins.fdown, CLOCK * 6 // 10)
    return 60_000 - chip.net()


sheet("3-4, R6", "automatic: pulses by which R6 = 100 begins the ramp down earlier than R6 = 0", 100, "pulses")(
    lambda: count_pulses_left(100) - count_pulses_left(0)
)
sheet("3-4, R6", "and R6 = 800000h + 8388508 (-100)", -100, "pulses")(
    lambda: count_pulses_left(-100) - count_pulses_left(0)
)


@sheet(
    "3-4.1",
    "R6 = (R2² - R1²) R5 / (16384 R7), not automatic: R0 left when the ramp down has ended",
    0,
    "pulses",
    3,
    "the staircase makes fewer",
)
def _r6() -> float:
    r6 = (4000**2 - 100**2) * 300 // (16384 * 60)
    chip = start_chip(PRESET, R0=30_000, R6=r6, **MOVE)
    chip.advance(CLOCK // 2)
    rates = CLOCK / np.diff(chip.trace(4 * CLOCK)["clock"])
    return float((rates[-50:] < 1000.5).sum())


@sheet("2-4", "R17's counter after ORG and two index pulses, 3 to let pass", 1)
def _counter() -> int:
    chip = PCL240MS(CLOCK)
    write_registers(chip, R1=100, R2=1000, R7=60, R13=RETURN_BY_INDEX | 3 << 16)
    chip.write(0, ORIGIN)
    chip.write(0, FH1)
    chip.pins.org = True
    for _ in range(2):
        for level in (True, False):
            chip.pins.ez = level
            chip.advance(1000)
    return chip.values()["R17"] >> 16 & 15
