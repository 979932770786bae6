"""The HCTL-1100 on the fuzzer's bench, with a shaft that the outside turns."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from fuzzing.family import Family, Values, Work
from fuzzing.promises import Finding, demand
from stage.chips import Chip
from stage.chips.hctl1100 import core, state
from stage.chips.hctl1100.commutator import RING
from stage.chips.hctl1100.timer import STEP, T
from stage.chips.journal import Journal
from stage.native import COMPILED

LONG = 1 << 22  # clocks: a loop in motion works sample by sample
LONGEST = STEP << 8  # clocks of a sample
FEW = 1 << 18  # clocks: the edges of more are not looked for one by one
MODES = (0x00, 0x08, 0x0B, 0x0D)  # position; F0, F3, F5 set
RATES = (0.0, 1e-4, -1e-4, 0.003, -0.003, 0.1, -0.1, 0.5)  # counts a clock; the encoder's filter follows 1/3
HALF = 1 << 23  # of the positions' range
PORTS = range(-128, 128)


@cache
def counted_core() -> Work:
    """The loop's samples, wrapped once to be counted."""
    work = Work()
    sample = core._sample

    def counting_sample(c: Any, until: int) -> None:
        work.spend()
        work.calls += 1
        sample(c, until)

    core._sample = counting_sample
    return work


class HctlFamily(Family):
    def __init__(self, chip: type[Chip]):
        super().__init__(chip)
        self.work = None if COMPILED else counted_core()
        self.most_samples = 0

    def edge(self, chip: Any, low: int) -> None:
        """An input pin, or from 8 on the shaft: eight speeds from where it is, or eight jumps."""
        if low < 8:
            super().edge(chip, low)
        elif low < 24:
            chip.set_shaft(chip.encoder + (low >> 4 & 1) * (1 << 12), RATES[low & 7])
        else:
            chip.set_shaft((low - 28) * (1 << 21) + 0.5)

    def writes(self, kind: int, low: int, take: Callable[[int], int]) -> list[tuple[int, int]]:
        """A raw write to the lower or the upper half of the addresses, a position of three bytes, or a mode with all its data."""
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

    def said(self, chip: Chip, values: Values, address: int) -> int | None:
        return values.get(f"R{address & 0x3F:02X}")

    def silent(self, chip: Chip) -> bool:
        return True

    def clocks(self, chip: Chip, clocks: int) -> int:
        c = chip.state
        idle = c["mode"] == state.IDLE
        if c["rate"] and c["reg"][RING]:
            clocks = min(clocks, FEW)  # each count is an edge of the course, the phases'
        clocks = clocks if idle else min(clocks, LONG)
        shortest = STEP * (min(int(c["period"]), int(c["reg"][T])) + 1)
        self.most_samples = 0 if idle else clocks // shortest + 2
        return clocks

    def check(self, chip: Any, values: Values) -> None:
        super().check(chip, values)
        c, pins = chip.state, chip.output_word(0)
        held = (bool(pins & state.PROF), bool(pins & state.INIT))
        if held != (bool(values["R07"] & 0x10), bool(values["R07"] & 0x20)):
            raise Finding(f"R07 {values['R07']:02X}h, but the pins {pins:02X}h")
        if not (c["port"] in PORTS and c["pwm"] in PORTS and c["drive"] in PORTS and c["output"] in PORTS):
            raise Finding(f"motor commands {c['port']}, {c['pwm']}, {c['drive']}, {c['output']}")
        for name in ("command", "latch"):
            if not -HALF <= c[name] < 2 * HALF:
                raise Finding(f"{name} {c[name]} has more than 24 bits")
        if c["limited"] and c["mode"] != state.IDLE:
            raise Finding("a mode goes on although LIMIT has triggered")
        if not c["clock"] <= c["next"] and not c["held"]:
            raise Finding(f"a sample was due at {c['next']}, at {c['clock']}")

    def advanced(self, chip: Any, before: Any, after: Values, clocks: int, pulses: int) -> None:
        demand(after["R00"] in (before["R00"], before["R00"] & ~state.F0), "clocks clear F0 and no other flag")
        if clocks >= LONGEST and after["R00"] & state.F2 and chip.state["mode"] == state.CONTROL:
            demand(chip.motor_command >= 0, f"a unipolar motor command of {chip.motor_command} after a sample")
        if before["R00"] & state.F1:
            changed = {name for name in before if before[name] != after[name]} - {"R0F", "R14"}
            demand(not changed, f"clocks changed {changed} in Init/Idle")

    def course(self, chip: Any, journal: Journal, pulses: int) -> None:
        every = chip.clock < FEW
        edges = np.concatenate(list(journal.pieces(every_pulse=every, size=1024)))
        demand(bool((edges["clock"][1:] >= edges["clock"][:-1]).all()), "a course that runs back")
        last = edges[-1]
        is_at = (
            chip.clock,
            chip.net(),
            chip.command_position,
            chip.motor_command,
            chip.output_word(0),
            chip.input_word(0),
        )
        ends_at = tuple(int(last[name]) for name in ("clock", "net", "command", "motor", "outputs", "inputs"))
        demand(ends_at == is_at, f"a course that ends with {ends_at}, a chip with {is_at}")

    def most_work(self, chip: Any, pulses: int) -> int:
        """Samples of the loop, each once; in Init/Idle none."""
        return self.most_samples
