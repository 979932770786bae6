"""A PCL-240MS or MK on the bench: section 3 of its data sheet as functions, random legal registers, whole moves.

The formulas take `Registers` and return clocks or pulses as exact fractions. Where the automatic ramp-down point is on, R4 stands
for R5: give them `automatic(registers)`. No pytest here, so that scripts/ramp_down_survey.py can use it.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from stage.chips import PCL240MK, PCL240MS

LINEAR, NO_CORRECTION = 0x1000, 0x8000  # bits of R14
AUTOMATIC = 0x54  # control mode: preset, automatic ramp-down point
MAX_CLOCKS = 1 << 45


class Registers(NamedTuple):
    """The speed pattern. R14 and R15 are spans here, without the bits of R14."""

    R1: int
    R2: int
    R4: int
    R5: int
    R7: int
    R14: int = 0
    R15: int = 0


def automatic(r: Registers) -> Registers:
    """R4 in place of R5."""
    return r._replace(R5=r.R4)


# section 3-3


def tsu(r: Registers) -> Fraction:
    """Acceleration time in clocks, with no linear part."""
    return Fraction((r.R2 - r.R1) * r.R4)


def tsd(r: Registers) -> Fraction:
    return Fraction((r.R2 - r.R1) * r.R5)


def tsu_with_linear(r: Registers) -> Fraction:
    return Fraction((r.R2 - r.R1 + r.R14 * 2) * r.R4, 2)


def tsd_with_linear(r: Registers) -> Fraction:
    return Fraction((r.R2 - r.R1 + r.R15 * 2) * r.R5, 2)


# section 3-4.1, no linear part


def minimum_trapezoid(r: Registers) -> Fraction:
    return Fraction((r.R2**2 - r.R1**2) * (r.R4 + r.R5), r.R7 * 16384)


def revised_r2(r: Registers, r0: int) -> int:
    """The largest whole number that the formula allows."""
    return math.isqrt(r0 * r.R7 * 16384 // (r.R4 + r.R5) + r.R1**2)


def r6(r: Registers) -> Fraction:
    return Fraction((r.R2**2 - r.R1**2) * r.R5, r.R7 * 16384)


# section 3-4.2, with a linear part


def minimum_trapezoid_with_linear(r: Registers) -> Fraction:
    ramps = (r.R2 - r.R1) * (r.R4 + r.R5) + 2 * (r.R4 * r.R14 + r.R5 * r.R15)
    return Fraction((r.R1 + r.R2) * ramps, r.R7 * 32768)


def minimum_linear(r: Registers) -> Fraction:
    """Pulses above which a short move has a linear part."""
    if r.R14 == r.R15:
        return Fraction((r.R1 + r.R14) * r.R14 * (r.R4 + r.R5), r.R7 * 4096)
    if r.R14 > r.R15:
        return Fraction((r.R1 + r.R14) * (r.R5 * (r.R14 + r.R15) + 2 * r.R4 * r.R14), r.R7 * 8192)
    return Fraction((r.R1 + r.R15) * (r.R4 * (r.R14 + r.R15) + 2 * r.R5 * r.R15), r.R7 * 8192)


def revised_r2_with_linear(r: Registers, r0: int) -> int:
    """The formula of R14 = R15 as the normative model reads it (plus, and divided inside the root)."""
    if r.R14 == r.R15:
        return math.isqrt((r.R14 - r.R1) ** 2 + r0 * r.R7 * 32768 // (r.R4 + r.R5)) - r.R14
    a, b = r.R4 * r.R14 + r.R5 * r.R15, r.R4 + r.R5
    return (math.isqrt((a - b * r.R1) ** 2 + b * r0 * r.R7 * 32768) - a) // b


def r6_with_linear(r: Registers) -> Fraction:
    return Fraction((r.R1 + r.R2) * (r.R2 - r.R1 + r.R15 * 2) * r.R5, r.R7 * 32768)


def has_linear(r: Registers) -> bool:
    """Both spans lie between 1 and less than half the ramp."""
    return 0 < r.R14 < (r.R2 - r.R1) / 2 and 0 < r.R15 < (r.R2 - r.R1) / 2


def corrected_r2(r: Registers, r0: int) -> int:
    """The FH that a preset move of `r0` pulses gets, automatic point and FH correction on."""
    r = automatic(r)
    if not has_linear(r):
        return revised_r2(r, r0) if r0 <= minimum_trapezoid(r) else r.R2
    if r0 > minimum_trapezoid_with_linear(r):
        return r.R2
    return revised_r2(r, r0) if r0 <= minimum_linear(r) else revised_r2_with_linear(r, r0)


# the shape


def span_of(setting: int, gain: int) -> float:
    """The S-curve span of a ramp over `gain` speed steps."""
    return setting if 0 < setting < gain / 2 else gain / 2


def step_clocks(gain: int, span: float, rate: int) -> np.ndarray:
    """Return the times at which a ramp makes its steps, in clocks from its start, the 0 of the start first."""
    k = np.arange(gain + 1)
    end = (gain + 2 * span) * rate / 2
    falling = end - rate * np.sqrt((gain - k) * span)
    return np.select(
        [k <= span, k <= gain - span], [rate * np.sqrt(k * span), rate * span + (k - span) * rate / 2], falling
    )


# on the bus


def load(chip, **values):
    """Write registers by name, R10 to R17 too (octal), high byte first."""
    for name, value in values.items():
        number = int(name[1:], 8)
        chip.write(0, 0x80 | number & 7 | (number & 8) << 1)
        for address in (3, 2, 1):
            chip.write(address, value >> 8 * (address - 1) & 0xFF)


def started(r: Registers, r0=0xFFFFFF, r6=0, control=AUTOMATIC, start=0x15, bits=0, cls=PCL240MS, fh2=None):
    """A chip that was just started with these registers, FH2 = FH1 unless given. `bits`: those of R14 beside its span."""
    chip = cls()
    load(chip, **r._replace(R14=r.R14 | bits)._asdict(), R3=r.R2 if fh2 is None else fh2, R0=r0, R6=r6)
    chip.write(0, control)
    chip.write(0, start)
    return chip


class RecordedMove:
    """A preset move that was just started, to its end: clock (0 at the start), speed and R0 after each change; `end`: the
    clock of its last pulse."""

    def __init__(self, chip):
        journal = chip.journal()
        for _ in range(64):
            if not chip.read(0) & 0x40:
                break
            chip.advance(MAX_CLOCKS)
        assert not chip.read(0) & 0x40, "it never ends"
        journal.close()
        waveform = journal.replay_waveforms()
        edges = waveform.edges
        last = np.flatnonzero(edges["speed"])[-1] + 1
        self.clock = edges["clock"][:last] - edges["clock"][0]
        self.speed, self.r0 = edges["speed"][:last], edges["counter"][:last]
        self.pin = lambda name: waveform.pin(name)[:last]
        self.pulses = abs(int(edges["net"][-1] - edges["net"][0]))
        self.end = int(edges["clock"][edges["counter"] == 0][0] - edges["clock"][0])

    def clocks(self, pin: str) -> int:
        """Return how many clocks a pin was asserted."""
        return int(np.diff(self.clock, append=self.end)[self.pin(pin)].clip(0).sum())

    def steps(self) -> tuple[np.ndarray, np.ndarray]:
        """Clock and new speed of each speed step."""
        at = np.flatnonzero(np.diff(self.speed)) + 1
        return self.clock[at], self.speed[at]

    @property
    def peak(self) -> int:
        return int(self.speed.max())


def random_registers(rng, linear: bool, min_pulses=200, max_pulses=2_000_000) -> Registers:
    """Legal ones, both ramps together of some `least` to `most` pulses, S-curves with or without a linear part."""
    while True:
        fl, fh = sorted(rng.integers(1, 8192, 2))
        r = Registers(int(fl), int(fh), *(log_uniform(rng, 2, 65535) for _ in range(2)), log_uniform(rng, 2, 1023))
        half = (r.R2 - r.R1) / 2
        if half < 10:
            continue
        low, high = (1, math.ceil(half)) if linear else (math.ceil(half), 4096)
        up, down = (int(rng.integers(low, min(high, 4096))) if low < 4096 else 0 for _ in range(2))
        if not linear and rng.random() < 0.5:
            up = 0
        if not linear and rng.random() < 0.5:
            down = 0
        r = r._replace(R14=up, R15=down)
        if all(min_pulses <= minimum_trapezoid(x) <= max_pulses for x in (r, automatic(r))):
            return r


def log_uniform(rng, low: int, high: int) -> int:
    return min(high, int(low * ((high + 1) / low) ** rng.random()))


# moves with the automatic ramp-down point


class Move(NamedTuple):
    """A preset move. `offset`: R6, signed. `bits`: those of R14 beside its span."""

    cls: type
    r0: int
    registers: Registers
    offset: int = 0
    bits: int = 0
    minus: bool = False

    @property
    def linear(self) -> bool:
        return self.cls is PCL240MK or bool(self.bits & LINEAR)

    @property
    def correction(self) -> bool:
        return self.cls is PCL240MS and not self.bits & NO_CORRECTION

    @property
    def fh(self) -> int:
        """The speed it may reach, as the sheet revises it."""
        r = self.registers
        if not self.correction or r.R2 <= r.R1:
            return r.R2
        return corrected_r2(r._replace(R14=0, R15=0) if self.linear else r, self.r0)


class MoveEnd(NamedTuple):
    """End of a move. `r0`, `speed`: at its last pulse; `at_fl`: pulses at FL after the ramp-down; `left`: pulses that the
    rest of the ramp-down would have taken until FL; `own`: those that its last step takes, at FL."""

    r0: int
    pulses: int
    speed: int
    peak: int
    at_fl: int
    left: float
    last_step: float

    @property
    def delay(self) -> float:
        """Pulses from the end of the whole ramp-down, its last step at FL included, to the last pulse; negative before it."""
        return self.at_fl - self.last_step - self.left


def random_move(rng) -> Move:
    """Any legal registers, 1 pulse to 16 million, mostly on a log scale; R6 = 0 mostly, or an offset of a few pulses."""
    cls = PCL240MK if rng.random() < 0.2 else PCL240MS
    rates = 16383 if cls is PCL240MK else 65535
    speeds = [log_uniform(rng, 1, 8191), int(rng.integers(1, 8192))]
    if rng.random() < 0.95:
        speeds.sort()
    up, down = (log_uniform(rng, 2, rates) for _ in range(2))
    spans = [0 if rng.random() < 0.3 else log_uniform(rng, 1, 4095) for _ in range(2)]
    if rng.random() < 0.5:
        spans[1] = spans[0]
    return Move(
        cls,
        log_uniform(rng, 1, 0xFFFFFF),
        Registers(*speeds, up, down, log_uniform(rng, 2, 1023), *spans),
        int(rng.integers(-20, 21)) if rng.random() < 0.3 else 0,
        int(rng.choice([0, 0, LINEAR])) | int(rng.choice([0, NO_CORRECTION])),
        bool(rng.random() < 0.5),
    )


def run_move(move: Move) -> MoveEnd:
    """Run a move on a fresh chip."""
    r = move.registers
    width = 20 if move.cls is PCL240MK else 24
    control = AUTOMATIC | (0x08 if move.minus else 0)
    chip = started(r, move.r0, move.offset % (1 << width), control, bits=move.bits, cls=move.cls)
    recorded = RecordedMove(chip)
    speed, peak = int(recorded.speed[-1]), recorded.peak
    above = np.flatnonzero(recorded.speed > r.R1)
    at_fl = 0
    if speed <= r.R1:
        at_fl = int(recorded.r0[above[-1] + 1]) if len(above) else move.r0
    return MoveEnd(chip.values()["R0"], recorded.pulses, speed, peak, at_fl, *ramp_down(move, recorded))


def ramp_down(move: Move, recorded: RecordedMove) -> tuple[float, float]:
    """Pulses that the ramp-down still lacked at the last pulse, and those of its last step."""
    r, peak = move.registers, recorded.peak
    gain = peak - r.R1
    if gain <= 0:
        return 0.0, 0.0
    due = np.arange(gain + 1) * r.R4 if move.linear else step_clocks(gain, span_of(r.R15, gain), r.R4)
    falling = np.flatnonzero(recorded.speed == peak)[-1] + 1
    gone = recorded.end - recorded.clock[falling] if falling < len(recorded.speed) else 0
    clocks = np.clip(due[1:] - np.maximum(due[:-1], gone), 0, None) * (recorded.speed[-1] > r.R1)
    pulses = clocks * (peak - np.arange(1, gain + 1)) / (8192 * r.R7)
    return float(pulses[:-1].sum()), float((due[-1] - due[-2]) * r.R1 / (8192 * r.R7))


def excuse(move: Move, end: MoveEnd) -> str:
    """Why the move may end above FL with more of its ramp-down left than rounding makes; empty if it may not."""
    r, gain = move.registers, move.fh - move.registers.R1
    if move.offset < 0:
        return "R6 is negative: a later start"
    if move.linear:
        return ""
    if not move.correction and end.peak < move.fh:
        return "triangle, FH correction off"
    if span_of(r.R15, gain) > span_of(r.R14, gain):
        return "ramp-down longer than ramp-up, R15 > R14"
    return ""
