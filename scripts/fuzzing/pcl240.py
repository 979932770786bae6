"""The PCL-240 family on the fuzzer's bench."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import ClassVar

from fuzzing.family import Family, Values, Work
from stage.chips import Chip
from stage.chips.pcl240 import core, motion
from stage.chips.pcl240.state import EXTENSION
from stage.native import COMPILED

WRAP = 1 << 24  # pulses in which R0 comes round, and passes 0 and R6 again


@cache
def counted_core() -> Work:
    """Return a counter of the calls between two events, for which the core's functions are wrapped at the first call."""
    work = Work()
    run_to_event, run_at_constant_speed = motion.run_to_event, motion._run_at_constant_speed
    run_ramp_steps, finish_step = motion._run_ramp_steps, motion.finish_step

    def counting_run_to_event(c, n):
        work.spend()
        work.calls += 1
        speed = c.speed
        ran = run_to_event(c, n)
        work.steps += c.speed != speed
        return ran

    def counting_run_at_constant_speed(c, until):
        work.calls += 1
        run_at_constant_speed(c, until)

    def counting_run_ramp_steps(c, until):
        work.calls += 1
        run_ramp_steps(c, until)

    def counting_finish_step(c):
        work.spend()  # the step is due; only the number of calls of run_ramp_steps counts
        finish_step(c)

    motion.run_to_event = core.run_to_event = counting_run_to_event
    motion._run_at_constant_speed = counting_run_at_constant_speed
    motion._run_ramp_steps, motion.finish_step = counting_run_ramp_steps, counting_finish_step
    return work


class Pcl240(Family):
    """Chips of the PCL-240 family on the fuzzer's bench: bytes at four addresses, and limits for the work of their cores."""

    FREE: ClassVar = ("quiet_until",)

    def __init__(self, chip: type[Chip]):
        super().__init__(chip)
        self.work = None if COMPILED else counted_core()

    def make_writes(self, kind: int, low: int, take: Callable[[int], int]) -> list[tuple[int, int]]:
        """Return a raw write, or the writes of a whole register."""
        if kind < 3:
            return [(low, take(1))]
        value = take(3)
        return [(0, 0x80 | low), (3, value >> 16), (2, value >> 8 & 0xFF), (1, value & 0xFF)]

    def predict_read(self, chip: Chip, values: Values, address: int) -> int | None:
        """Return a byte of the status or of a register; None for latches of a collective read, which `values` does not have."""
        c, byte = chip.state, address & 3
        if not byte:
            return values["status"]
        name = self.limits[int(c["selected_register"])][0] if c["extended"] and c["output_mode"] & EXTENSION else "R0"
        return None if c["collective"] else values[name] >> 8 * (byte - 1) & 0xFF

    def is_silent(self, chip: Chip) -> bool:
        """Return whether the chip is at rest, or at an end limit of its direction."""
        return chip.pins.hold or (chip.pins.el_minus if chip.state["minus"] else chip.pins.el_plus)

    def read_end_values(self, chip: Chip) -> dict[str, int]:
        """Return the chip's own values."""
        return super().read_end_values(chip) | {"counter": int(chip.state["reg"][0])}

    def compute_max_work(self, chip: Chip, pulses: int) -> int:
        """Return two calls for each event.

        Events are speed steps outside closed-form ramps, three for each wrap of R0 (below R6, 0, wrapped), and some for starts,
        stops and direction changes, but never clocks or pulses alone.
        """
        return 2 * (self.work.steps + 3 * (pulses // WRAP) + 8)  # type: ignore[union-attr]
