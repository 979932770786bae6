"""The HCTL-1100 on the fuzzer's bench, with a shaft that the outside turns."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from fuzzing.family import Family, Values, Work
from stage.chips import Chip
from stage.chips.hctl1100 import core, state
from stage.chips.hctl1100.commutator import RING
from stage.chips.hctl1100.sample_timer import CLOCKS_PER_COUNT, T
from stage.native import COMPILED

LONG = 1 << 22  # clocks: a loop in motion works sample by sample
MODES = (0x00, 0x08, 0x0B, 0x0D)  # position; F0, F3, F5 set
RATES = (0.0, 1e-4, -1e-4, 0.003, -0.003, 0.1, -0.1, 0.5)  # counts a clock; the encoder's filter follows 1/3


@cache
def counted_core() -> Work:
    """Return a counter of the control loop's samples, for which the core is wrapped at the first call."""
    work = Work()
    sample = core._run_sample

    def counting_sample(c: Any, until: int) -> None:
        work.spend()
        work.calls += 1
        sample(c, until)

    core._run_sample = counting_sample
    return work


class HctlFamily(Family):
    """The HCTL-1100 on the fuzzer's bench: whole profiles, a shaft that turns, and the samples of its control loop."""

    FEW_CLOCKS = 1 << 18

    def __init__(self, chip: type[Chip]):
        super().__init__(chip)
        self.work = None if COMPILED else counted_core()
        self.max_samples = 0

    def toggle_pin(self, chip: Any, low: int) -> None:
        """Change an input pin, or from 8 on the shaft: eight speeds from its present position, or eight jumps."""
        if low < 8:
            super().toggle_pin(chip, low)
        elif low < 24:
            chip.set_shaft(chip.encoder + (low >> 4 & 1) * (1 << 12), RATES[low & 7])
        else:
            chip.set_shaft((low - 28) * (1 << 21) + 0.5)

    def make_writes(self, kind: int, low: int, take: Callable[[int], int]) -> list[tuple[int, int]]:
        """Return a raw write to either half of the addresses, a position of three bytes, or a mode with all its data."""
        if kind < 2:
            return [(kind << 5 | low, take(1))]
        if kind == 2:
            first = (0x0C, 0x15, 0x29)[low % 3]
            value = take(3)
            return [(first + k, value >> 8 * (k if first == 0x29 else 2 - k) & 0xFF) for k in range(3)]
        return self._start(low, take)

    def _start(self, low: int, take: Callable[[int], int]) -> list[tuple[int, int]]:
        period, zero, pole, gain, rate, speed, final = (take(n) for n in (1, 1, 1, 1, 2, 1, 2))
        final -= final >> 15 << 16
        writes = [(0x05, 0x01), *((0x00, flag) for flag in (0, 2, 3, 5)), (0x0F, period), (0x20, zero), (0x21, pole)]
        writes += [(0x22, gain), (0x26, rate & 0xFF), (0x27, rate >> 8), (0x28, speed), (0x3C, speed), (0x23, speed)]
        writes += [(0x29, final & 0xFF), (0x2A, final >> 8 & 0xFF), (0x2B, final >> 16 & 0xFF)]
        if low & 4:
            writes += [(0x13, 0), (0x0C, 0), (0x0D, 0), (0x0E, 0)]
        if low & 8:
            writes.append((0x00, 0x0A))
        return [*writes, (0x00, MODES[low & 3]), (0x05, 0x02 if low & 16 else 0x03)]

    # --- what must hold ---

    def predict_read(self, chip: Chip, values: Values, address: int) -> int | None:
        return values.get(f"R{address & 0x3F:02X}")

    def is_silent(self, chip: Chip) -> bool:
        return True

    def limit_clocks(self, chip: Chip, clocks: int) -> int:
        c = chip.state
        idle = c["mode"] == state.IDLE
        if c["shaft_rate"] and c["reg"][RING]:
            clocks = min(clocks, self.FEW_CLOCKS)  # each count is an edge of the course, the phases'
        clocks = clocks if idle else min(clocks, LONG)
        min_clocks = CLOCKS_PER_COUNT * (min(int(c["period"]), int(c["reg"][T])) + 1)
        self.max_samples = 0 if idle else clocks // min_clocks + 2
        return clocks

    def read_end_values(self, chip: Any) -> dict[str, int]:
        """Return the chip's own values."""
        return super().read_end_values(chip) | {"command": chip.command_position, "motor": chip.motor_command}

    def compute_max_work(self, chip: Any, pulses: int) -> int:
        """Return the number of samples of the control loop, each counted once; 0 in Init/Idle."""
        return self.max_samples
