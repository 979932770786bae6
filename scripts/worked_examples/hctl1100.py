"""HCTL-1100: page 24 of the data sheet, the sample timer."""

from __future__ import annotations

from functools import partial

from stage.chips import HCTL1100
from worked_examples.table import example

sheet = partial(example, "HCTL-1100")
TIMER = 0x0F


def measure_sample_time(clock_hz: int, t: int) -> float:
    """Measure the time between two reloads of the sample timer, s, by reading the timer.

    Args:
        clock_hz: Clock of the chip, Hz.
        t: Value of the timer's register.
    """
    chip = HCTL1100(clock_hz)
    chip.write(TIMER, t)
    reloads, last = [], chip.read(TIMER)
    while len(reloads) < 4:
        chip.advance(1)
        if (now := chip.read(TIMER)) > last:
            reloads.append(chip.clock)
        last = now
    return (reloads[-1] - reloads[-2]) / clock_hz


for mhz, t, microseconds in ((2, 0x07, 64), (2, 0xFF, 2048), (1, 0x07, 128), (1, 0xFF, 4096)):
    sheet("p. 24", f"sample time at {mhz} MHz, R0F = {t:02X}h", microseconds * 1e-6, "s", 1e-12, "rounding")(
        partial(measure_sample_time, mhz * 1_000_000, t)
    )


@sheet("p. 24, example 1", "the timer after reset", 0x40)
def _reset() -> int:
    return HCTL1100().read(TIMER)


@sheet("p. 24, example 2", "the lowest value read in a sample time", 0)
def _lowest() -> int:
    chip = HCTL1100()
    return min(chip.read(TIMER) for _ in range(200) if chip.advance(16) is not None)


MODES = (
    ("position", ()),
    ("proportional velocity", (0x0B,)),
    ("trapezoidal profile", (0x08,)),
    ("integral velocity", (0x0D,)),
)
LEAST = (0x07, 0x07, 0x0F, 0x0F)


def find_minimum_timer(flags: tuple[int, ...]) -> int:
    """Find the smallest R0F with which a mode begins without a diagnostic about the sample time.

    Args:
        flags: Flags of the mode.
    """
    for t in range(256):
        chip = HCTL1100()
        chip.write(0x26, 1)  # an acceleration and
        chip.write(0x28, 1)  # a velocity, for the trapezoid
        chip.write(TIMER, t)
        chip.write(0x05, 0x03)  # to the control modes
        for flag in flags:
            chip.write(0x00, flag)
        if not any(d.message.startswith("T = ") for d in chip.diagnostics):
            return t
    return 256


for (mode, flags), least in zip(MODES, LEAST, strict=True):
    sheet("p. 24, Table 4", f"least R0F of {mode} control, by the diagnostics", least)(
        partial(find_minimum_timer, flags)
    )
