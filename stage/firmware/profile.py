"""Speeds in registers: the data sheet's formulas, and `Profile`, which picks R1 to R5 and R7 for rates in pps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stage.chips import PCL240K
from stage.errors import ArgumentError

_MAP = PCL240K.MAP
FL, FH1, FH2 = 1_000.0, 16_000.0, 32_000.0
ACCEL = 0.15


def ramp_seconds(low: int, high: int, rate: int, clock_hz: int) -> float:
    """Tsu, Tsd = (FH - FL) rate / clock, s (data sheet section 4, R4 and R5)."""
    return (high - low) * rate / clock_hz


def ramp_pulses(low: int, high: int, rate: int, r7: int) -> float:
    """Psu, Psd = (FH^2 - FL^2) rate / (16384 R7), pulses (data sheet section 4, R6; Q & A)."""
    return (high * high - low * low) * rate / (16384 * r7)


def down_point(r0: int, low: int, high: int, r4: int, r5: int, r7: int) -> int:
    """R6: Psd + 5; for a move too short to reach FH the triangular drive's R0 R5 / (R4 + R5) (section 4, Q & A)."""
    if r0 < ramp_pulses(low, high, r4 + r5, r7):
        return min(r0 * r5 // (r4 + r5), 0xFFFFF)
    return min(int(ramp_pulses(low, high, r5, r7)) + 5, 0xFFFFF)


@dataclass(frozen=True)
class Profile:
    """The speed registers of a move. Every value is checked against the register map: ArgumentError names the register.

    R1 FL, R2 FH1, R3 FH2: speed steps of clock_hz / (8192 R7) pps; R4, R5: clocks per speed step.
    """

    R1: int
    R2: int
    R3: int
    R4: int
    R5: int
    R7: int
    clock_hz: int = PCL240K.DEFAULT_CLOCK_HZ

    def __post_init__(self):
        for name, value in self.registers().items():
            _MAP.checked(name, value)

    @classmethod
    def of(
        cls,
        fl: float = FL,
        fh1: float = FH1,
        fh2: float | None = None,
        accel: float = ACCEL,
        decel: float | None = None,
        clock_hz: int = PCL240K.DEFAULT_CLOCK_HZ,
    ) -> Profile:
        """The registers nearest to rates in pps and ramp times in s (from FL to the highest rate, and back).

        fh2 defaults to twice fh1 where the chip reaches that. The multiplier R7 is the one that makes the largest relative
        error of all five values least.
        """
        most = clock_hz * 8191 / (8192 * 2)
        fh2 = min(2 * fh1, most) if fh2 is None else fh2
        decel = accel if decel is None else decel
        for name, value in {"fl": fl, "fh1": fh1, "fh2": fh2}.items():
            if not 0 < value <= most:
                raise ArgumentError(f"{name}={value!r} pps: a chip at {clock_hz} Hz makes up to {most:.0f} pps (R7 = 2).")
        for name, value in {"accel": accel, "decel": decel}.items():
            if not 0 < value <= 100:
                raise ArgumentError(f"{name}={value!r}: ramps take more than 0 and up to about 27 s.")
        r7 = np.arange(2, 1024)
        step = clock_hz / (8192.0 * r7)
        speeds = [np.clip(np.rint(v / step), 1, 8191) for v in (fl, fh1, fh2)]
        span = np.maximum(np.maximum(speeds[1], speeds[2]) - speeds[0], 1)
        reached = np.maximum(np.rint(fh1 / step), np.rint(fh2 / step)) <= 8191
        rates = [np.clip(np.rint(t * clock_hz / span), 2, 16383) for t in (accel, decel)]
        errors = [np.abs(r * step / v - 1) for r, v in zip(speeds, (fl, fh1, fh2), strict=True)]
        errors += [np.abs(r * span / clock_hz / t - 1) for r, t in zip(rates, (accel, decel), strict=True)]
        worst = np.where(reached, np.max(errors, axis=0), np.inf)
        best = len(r7) - 1 - int(np.argmin(worst[::-1].round(6)))
        r1, r2, r3 = (int(s[best]) for s in speeds)
        return cls(r1, r2, r3, int(rates[0][best]), int(rates[1][best]), int(r7[best]), clock_hz)

    def registers(self) -> dict[str, int]:
        return {"R1": self.R1, "R2": self.R2, "R3": self.R3, "R4": self.R4, "R5": self.R5, "R7": self.R7}

    @property
    def step(self) -> float:
        """pps of one speed step: clock / (8192 R7) (section 4, R7)."""
        return self.clock_hz / (8192 * self.R7)

    @property
    def fl(self) -> float:
        return self.R1 * self.step

    @property
    def fh1(self) -> float:
        return self.R2 * self.step

    @property
    def fh2(self) -> float:
        return self.R3 * self.step

    def high(self, fh2: bool = False) -> int:
        """The speed register's value of FH1, or FH2."""
        return self.R3 if fh2 else self.R2

    def accel(self, fh2: bool = False) -> float:
        """Seconds from FL to FH1, or FH2."""
        return ramp_seconds(self.R1, self.high(fh2), self.R4, self.clock_hz)

    def decel(self, fh2: bool = False) -> float:
        return ramp_seconds(self.R1, self.high(fh2), self.R5, self.clock_hz)

    def down_point(self, pulses: int, fh2: bool = False) -> int:
        """R6 for a preset move of so many pulses."""
        return down_point(pulses, self.R1, max(self.high(fh2), self.R1), self.R4, self.R5, self.R7)

    def seconds(self, pulses: int) -> float:
        """An upper bound of a move's duration: all of it at FL or at FH1, whichever is slower, and two ramps."""
        return pulses / min(self.fl, self.fh1, self.fh2) + 2 * max(self.accel(True), self.decel(True), 0.0)

    def __str__(self) -> str:
        return (
            f"FL {self.fl:.1f}, FH1 {self.fh1:.1f}, FH2 {self.fh2:.1f} pps; FL to FH1 in {self.accel() * 1e3:.1f} ms, "
            f"back in {self.decel() * 1e3:.1f} ms; {' '.join(f'{k}={v}' for k, v in self.registers().items())}"
        )
