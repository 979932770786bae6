"""Formulas of the data sheets for speeds, and `Profile`, which chooses R1 to R5, R7 and the S-curve for rates in pps.

profile = Profile.of(fl=500, fh1=16_000, accel=0.2)
print(profile)                              the true rates and times, after rounding to registers
profile.compute_ramp_down_point(20_000)     R6
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import isqrt

import numpy as np

from stage.chips import PCL240K
from stage.chips.pcl240 import PCL240
from stage.chips.pcl240.state import SPAN
from stage.errors import ArgumentError, ExceededLimit
from stage.firmware.driver import DEFAULT_DRIVE_PPS, DEFAULT_RAMP_S, DEFAULT_START_PPS
from stage.support.argument_checks import explain_arguments, explain_constructor

FL, FH1, FH2 = DEFAULT_START_PPS, DEFAULT_DRIVE_PPS, 2 * DEFAULT_DRIVE_PPS
"""Default rates, pps: 3.125, 50 and 100 mm/s on the default stage, where 17HS4401 at 24 V pulls out far above."""
DEFAULT_RAMP_TIME_S = DEFAULT_RAMP_S
"""Default ramp, seconds from FL to the highest rate."""
RATE_TOLERANCE, TIME_TOLERANCE = 2e-4, 1e-2
"""Relative errors of rates and times within which finer speed steps are better than more exact values."""
TAIL_PULSES = 5  # pulses at FL after a ramp-down (data sheet section 4, R6)
LINEAR = PCL240.LINEAR_RAMPS

MAX_SPEED_STEPS = 8191
"""Largest value of a rate register, R1 to R3."""


def compute_pulse_rate(speed: float, r7: int, clock_hz: int = PCL240K.DEFAULT_CLOCK_HZ) -> float:
    """Compute the output pulse rate Fout = Rf clock / (8192 R7), pps (data sheet section 4, equation 4).

    Args:
        speed: Rf, speed steps.
        r7: Multiplier R7.
        clock_hz: Reference clock, Hz.
    """
    return speed * clock_hz / (8192 * r7)


def compute_equivalent_linear_ramp_steps(low: int, high: int, curved_end_steps: int | None = None) -> float:
    """Compute the speed steps of a linear ramp that takes as long as a ramp with curved ends.

    The result is (K + 2 S) / 2 with K = high - low and S = curved_end_steps. An S of 0, or of more than half the ramp, means half
    the ramp (data sheet MS, 3-1).

    Args:
        low: Speed at the begin of the ramp, speed steps.
        high: Speed at its end, speed steps.
        curved_end_steps: Speed steps of each curved end; None: a linear ramp, which takes as long as an S-curve that is curved
            throughout.
    """
    height = high - low
    return (
        float(height) if not curved_end_steps or 2 * curved_end_steps > height else (height + 2 * curved_end_steps) / 2
    )


def compute_ramp_seconds(
    low: int, high: int, rate: int, clock_hz: int = PCL240K.DEFAULT_CLOCK_HZ, curved_end_steps: int | None = None
) -> float:
    """Compute the duration of a ramp, Tsu or Tsd = (FH - FL) rate / clock, s (data sheet section 4, R4, and R5, equation 3).

    An S-curve with a linear part takes (FH - FL + 2 S) rate / (2 clock) with S = curved_end_steps (data sheet MS, 3-3).

    Args:
        low: FL, speed steps.
        high: FH, speed steps.
        rate: R4 or R5.
        clock_hz: Reference clock, Hz.
        curved_end_steps: Speed steps of each curved end; None for linear ramps.
    """
    return compute_equivalent_linear_ramp_steps(low, high, curved_end_steps) * rate / clock_hz


def compute_ramp_pulses(low: int, high: int, rate: float, r7: int, curved_end_steps: int | None = None) -> float:
    """Compute the pulses of a ramp, Psu or Psd = (FH^2 - FL^2) rate / (16384 R7) (data sheet section 4, R6, and Q & A).

    An S-curve with a linear part makes (FL + FH) (FH - FL + 2 S) rate / (32768 R7) with S = curved_end_steps (data sheet MS,
    3-4.2). This is the area of the trapezoid; the chip's staircase makes (FH - FL) rate / (16384 R7) fewer.

    Args:
        low: FL, speed steps.
        high: FH, speed steps.
        rate: R4 or R5.
        r7: Multiplier R7.
        curved_end_steps: Speed steps of each curved end; None for linear ramps.
    """
    return (high + low) * compute_equivalent_linear_ramp_steps(low, high, curved_end_steps) * rate / (16384 * r7)


def is_triangular_move(r0: int, low: int, high: int, r4: int, r5: int, r7: int) -> bool:
    """Return whether a move with linear ramps is too short to reach FH: R0 < Psu + Psd (Q & A; its 18384 is a misprint of 16384).

    Args:
        r0: Pulses of the move.
        low: FL, speed steps.
        high: FH, speed steps.
        r4: Acceleration rate R4.
        r5: Deceleration rate R5.
        r7: Multiplier R7.
    """
    return r0 < compute_ramp_pulses(low, high, r4, r7) + compute_ramp_pulses(low, high, r5, r7)


def compute_linear_part_pulses(low: int, r4: int, r5: int, r7: int, up: int, down: int) -> float:
    """Return the pulses above which a move too short for FH still has a linear part (data sheet MS, 3-4.2).

    The data sheet's three cases are one, by the longer span.
    """
    longer, of_longer, other = (up, r4, r5) if up > down else (down, r5, r4)
    return (low + longer) * (other * (up + down) + 2 * of_longer * longer) / (8192 * r7)


def compute_revised_high_speed(
    r0: int, low: int, high: int, r4: int, r5: int, r7: int, up: int | None = None, down: int | None = None
) -> int:
    """Compute the FH that a move of `r0` pulses just reaches, at most `high` ("revised R2", data sheet MS, 3-4.1 and 3-4.2)."""
    if r0 > compute_ramp_pulses(low, high, r4, r7, up) + compute_ramp_pulses(low, high, r5, r7, down):
        return high
    straight = up and down and 2 * max(up, down) < high - low
    if straight and up and down and r0 > compute_linear_part_pulses(low, r4, r5, r7, up, down):
        a, b = r4 * up + r5 * down, r4 + r5
        return min(high, (isqrt((a - b * low) ** 2 + b * r0 * r7 * 32768) - a) // b)
    return min(high, isqrt(r0 * r7 * 16384 // (r4 + r5) + low * low))


def compute_triangular_down_point(r0: int, r4: int, r5: int) -> float:
    """Compute R6 = R0 R5 / (R4 + R5) for a triangular drive (Q & A)."""
    return r0 * r5 / (r4 + r5)


def compute_down_point(r0: int, low: int, high: int, r4: int, r5: int, r7: int, down: int | None = None) -> int:
    """Compute R6 for a move of `r0` pulses that ends at FL, whatever its length.

    Psd + 5 (section 4, R6), or the triangular drive's R0 R5 / (R4 + R5) + 2: rounding down takes up to one pulse, and R0 < R6 is
    met one pulse after R0 = R6. As printed, without the 2, the triangle ends a little above FL. An S-curve needs an FH that it
    reaches, see
    `compute_revised_high_speed`.

    Args:
        r0: Pulses of the move.
        low: FL, speed steps.
        high: FH, speed steps.
        r4: Acceleration rate R4.
        r5: Deceleration rate R5.
        r7: Multiplier R7.
        down: Speed steps of each curved end of an S-curve; None for linear ramps.
    """
    if down is None and is_triangular_move(r0, low, high, r4, r5, r7):
        return int(compute_triangular_down_point(r0, r4, r5)) + 2
    return int(compute_ramp_pulses(low, high, r5, r7, down)) + TAIL_PULSES


def get_default_second_rate(fh1: float, clock_hz: int, multiplier: int | None = None) -> float:
    """Return the usual FH2 for an FH1: twice the FH1 if the chip reaches that with R7 = `multiplier` (None: any R7), else FH1's
    limit."""
    return min(2 * fh1, compute_pulse_rate(MAX_SPEED_STEPS, multiplier or 2, clock_hz))


@explain_constructor
@dataclass(frozen=True)
class Profile:
    """Speed registers of a move. The constructor checks every value against the register map.

    Attributes:
        R1, R2, R3: FL, FH1 and FH2, speed steps of clock_hz / (8192 R7) pps.
        R4, R5: Clocks per speed step.
        R7: Multiplier.
        clock_hz: Reference clock, Hz.
        spans: Speed steps of the curved ends of the ramps up and down, 0 for curved throughout; None for linear ramps.
        chip: Class of chip whose registers these are.

    Raises:
        ArgumentError: A value does not fit its register; the message names the register.
    """

    R1: int
    R2: int
    R3: int
    R4: int
    R5: int
    R7: int
    clock_hz: int = PCL240K.DEFAULT_CLOCK_HZ
    spans: tuple[int, int] | None = None
    chip: type[PCL240] = PCL240K

    def __post_init__(self) -> None:
        if self.spans is not None and not self.chip.S_CURVES:
            raise ArgumentError(f"{self.chip.MAP.chip} has linear ramps only; S-curves need a PCL240MS.")
        for name, span in zip(("R14", "R15"), self.spans or (), strict=False):
            if not 0 <= span <= SPAN:
                raise ArgumentError(f"{name} span {span!r}: an S-curve's end takes 0 to 4095 speed steps.")
        for name, value in self.registers().items():
            self.chip.MAP.check_value(name, value)

    @classmethod
    @explain_arguments
    def of(
        cls,
        fl: float | None = None,
        fh1: float = FH1,
        fh2: float | None = None,
        accel: float = DEFAULT_RAMP_TIME_S,
        decel: float | None = None,
        multiplier: int | None = None,
        clock_hz: int = PCL240K.DEFAULT_CLOCK_HZ,
        s_curve: bool | float = False,
        chip: type[PCL240] = PCL240K,
    ) -> Profile:
        """Compute the registers nearest to rates and ramp times.

        Args:
            fl: FL, pps; default: 1000 pps, or the lowest high rate if that is less.
            fh1: FH1, pps.
            fh2: FH2, pps; default: twice fh1, where the chip reaches that.
            accel: Time from FL to the highest rate, s.
            decel: Time back, s; default: `accel`.
            multiplier: R7; default: the largest, hence the finest speed steps, which gives the rates to 0.02 % and the ramps to 1
                %, or where none does, the one that comes closest.
            clock_hz: Reference clock, Hz.
            s_curve: True for S-curves throughout, or the share (above 0, up to 0.5) of FH1 - FL that each curved end takes; needs
                a PCL240MS.
            chip: Class of chip.

        Returns:
            The profile.

        Raises:
            ArgumentError: A rate that the chip does not reach, an FL above a high rate, or a ramp that R4 or R5 cannot hold.
        """
        if multiplier is not None:
            chip.MAP.check_value("R7", multiplier)
        slowest = chip.MAP.register("R4").mask
        r7 = np.arange(2, 1024) if multiplier is None else np.array([multiplier])
        max_rate = compute_pulse_rate(MAX_SPEED_STEPS, int(r7[0]), clock_hz)
        fh2 = get_default_second_rate(fh1, clock_hz, multiplier) if fh2 is None else fh2
        fl = min(FL, fh1, fh2) if fl is None else fl
        decel = accel if decel is None else decel
        for name, value in {"fh1": fh1, "fh2": fh2, "fl": fl}.items():
            if not 0 < value <= max_rate:
                raise ArgumentError(
                    f"{name}={round(value, 3)!r} pps: a chip at {clock_hz} Hz makes up to {max_rate:.0f} pps (R7 = {r7[0]})."
                ).with_limit(
                    ExceededLimit({"fh1": "speed", "fh2": "fast", "fl": "start_speed"}[name], value, 0.0, max_rate)
                )
        if fl > min(fh1, fh2):
            raise ArgumentError(
                f"fl={round(fl, 3)!r} pps is above a high rate ({fh1:g}, {fh2:g}): ramps lead from FL upwards."
            ).with_limit(ExceededLimit("start_speed", fl, 0.0, min(fh1, fh2)))
        for name, value in {"accel": accel, "decel": decel}.items():
            if not 0 < value <= 100:
                raise ArgumentError(f"{name}={value!r} s: a ramp takes more than 0 and up to about 27 s.")
        wanted = np.array([fl, fh1, fh2])
        step = clock_hz / (8192.0 * r7)
        exact = np.rint(wanted[:, None] / step)
        speeds = np.clip(exact, 1, MAX_SPEED_STEPS)
        span = np.maximum(speeds.max(axis=0) - speeds[0], 1)
        times = np.array([accel, decel])
        rates = np.clip(np.rint(times[:, None] * clock_hz / span), 2, slowest)
        rate_error = np.abs(speeds * step / wanted[:, None] - 1).max(axis=0)
        time_error = np.abs(rates * span / clock_hz / times[:, None] - 1).max(axis=0)
        if fl == max(fh1, fh2):
            time_error[:] = 0  # nothing to ramp
        missed = np.maximum(rate_error / RATE_TOLERANCE, time_error / TIME_TOLERANCE)
        missed[exact.max(axis=0) > MAX_SPEED_STEPS] = np.inf  # the top rate is reached, whatever it costs the others
        fine = np.flatnonzero(missed <= 1)
        best = int(fine[-1] if len(fine) else np.argmin(missed))
        (r1, r2, r3), (r4, r5) = speeds[:, best].astype(int).tolist(), rates[:, best].astype(int).tolist()
        result = cls(r1, r2, r3, r4, r5, int(r7[best]), clock_hz, None, chip)
        if fl < max(fh1, fh2):
            result._refuse_clipped_ramps({"R4": (accel, result.R4), "R5": (decel, result.R5)}, float(span[best]))
        return result.with_ramp_shape(s_curve) if s_curve else result

    def _refuse_clipped_ramps(self, ramps: dict[str, tuple[float, int]], span: float) -> None:
        """Raise ArgumentError for ramp times that R4 or R5 cannot hold."""
        for register, (seconds, rate) in ramps.items():
            wanted = seconds * self.clock_hz / span
            max_rate = self.chip.MAP.register(register).mask
            if rate == max_rate and wanted > 1.01 * rate:
                raise ArgumentError(
                    f"a ramp of {seconds} s from {self.fl:.0f} pps on needs {register} = {wanted:.0f}: it takes 2 to {max_rate}. "
                    f"Between these rates a ramp takes at most {span * max_rate / self.clock_hz:.3f} s."
                ).with_limit(ExceededLimit("accel", seconds, 0.0, span * max_rate / self.clock_hz))

    def with_ramp_shape(self, s_curve: bool | float, fh2: bool = False) -> Profile:
        """Return the profile with ramps of another shape.

        The rates and, as near as R4 and R5 allow, the ramp times to FH1 (or FH2) stay.

        Args:
            s_curve: False for linear ramps, True for S-curves throughout, or the share (0 to 0.5) of FH - FL that each curved end
                takes, with a linear part between.
            fh2: The ramp times are those to FH2.

        Raises:
            ArgumentError: Another share, or a chip without S-curves.
        """
        if not isinstance(s_curve, bool) and not 0 < s_curve <= 0.5:
            raise ArgumentError(
                f"s_curve={s_curve!r}: True, False, or the share of the ramp at each end, above 0, up to 0.5."
            )
        height = max(self.get_high_speed(fh2) - self.R1, 0)
        span = 0 if s_curve is True or s_curve == 0.5 else max(1, round(s_curve * height))
        spans = None if s_curve is False else (span, span)
        steps = compute_equivalent_linear_ramp_steps(self.R1, self.R1 + height, span if spans else None)
        if not steps:
            return replace(self, spans=spans)
        r4, r5 = (
            max(2, round(t * self.clock_hz / steps)) for t in (self.get_accel_time(fh2), self.get_decel_time(fh2))
        )
        return replace(self, R4=r4, R5=r5, spans=spans)

    def for_chip(self, chip: type[PCL240]) -> Profile:
        """Return the profile for another chip of the PCL-240 family.

        Raises:
            ArgumentError: The profile does not fit the chip; the message names the register.
        """
        return self if chip is self.chip else replace(self, chip=chip)

    def registers(self) -> dict[str, int]:
        """Return the register values by name, with R14 and R15 on a chip with S-curves."""
        linear = {"R1": self.R1, "R2": self.R2, "R3": self.R3, "R4": self.R4, "R5": self.R5, "R7": self.R7}
        if not self.chip.S_CURVES:
            return linear
        up, down = self.spans or (LINEAR, 0)
        return linear | {"R14": up, "R15": down}

    @property
    def _up_curved_end_steps(self) -> int | None:
        """Number of speed steps in each curved end of an S-curve ramp up; None for a linear ramp."""
        return self.spans[0] if self.spans else None

    @property
    def _down_curved_end_steps(self) -> int | None:
        """Number of speed steps in each curved end of an S-curve ramp down; None for a linear ramp."""
        return self.spans[1] if self.spans else None

    @property
    def rate_per_speed_step(self) -> float:
        """Rate of one speed step, pps."""
        return compute_pulse_rate(1, self.R7, self.clock_hz)

    @property
    def fl(self) -> float:
        """Low rate FL, at which a move begins and ends, pps."""
        return self.R1 * self.rate_per_speed_step

    @property
    def fh1(self) -> float:
        """High rate FH1, pps."""
        return self.R2 * self.rate_per_speed_step

    @property
    def fh2(self) -> float:
        """Second high rate FH2, pps."""
        return self.R3 * self.rate_per_speed_step

    def get_high_speed(self, fh2: bool = False) -> int:
        """Return FH1 of the profile, or FH2, in speed steps: the value of its speed register."""
        return self.R3 if fh2 else self.R2

    def get_accel_time(self, fh2: bool = False) -> float:
        """Return the duration of the ramp from FL to FH1, or to FH2, s."""
        return compute_ramp_seconds(
            self.R1, self.get_high_speed(fh2), self.R4, self.clock_hz, self._up_curved_end_steps
        )

    def get_decel_time(self, fh2: bool = False) -> float:
        """Return the duration of the ramp from FH1, or from FH2, to FL, s."""
        return compute_ramp_seconds(
            self.R1, self.get_high_speed(fh2), self.R5, self.clock_hz, self._down_curved_end_steps
        )

    def compute_ramp_down_point(self, pulses: int, fh2: bool = False) -> int:
        """Compute R6, the ramp-down point of a preset move. Raises ArgumentError where R6 cannot hold it.

        Args:
            pulses: Pulses of the move.
            fh2: The move is to FH2.

        Returns:
            Value of R6.
        """
        high = max(self.get_high_speed(fh2), self.R1)
        point = compute_down_point(pulses, self.R1, high, self.R4, self.R5, self.R7, self._down_curved_end_steps)
        return self.chip.MAP.check_value("R6", point)

    def for_distance(self, pulses: int, fh2: bool = False) -> Profile:
        """Return the profile with FH lowered to the highest rate that an S-curve move of so many pulses can reach.

        The data sheet calls this rate "revised R2" (MS, 3-4). Linear ramps stay unchanged, because they can end anywhere.

        Args:
            pulses: Pulses of the move.
            fh2: The move is to FH2.
        """
        if self.spans is None or self.get_high_speed(fh2) <= self.R1:
            return self
        up, down = self._up_curved_end_steps or 0, self._down_curved_end_steps or 0
        high = compute_revised_high_speed(
            pulses, self.R1, self.get_high_speed(fh2), self.R4, self.R5, self.R7, up, down
        )
        high = max(high, self.R1)
        return replace(self, R3=high) if fh2 else replace(self, R2=high)

    def compute_pulses_through(self, speeds: Iterable[int], dwell: float = 0.0) -> float:
        """Compute the pulses of a run from FL through several speeds, and then to FL again.

        Args:
            speeds: Speeds in order, register values.
            dwell: Time at each speed but the last, s.
        """
        speed_before, total, stops = self.R1, 0.0, [*speeds, self.R1]
        for k, speed in enumerate(stops):
            low, high = sorted((speed_before, speed))
            rate, span = (
                (self.R4, self._up_curved_end_steps) if speed > speed_before else (self.R5, self._down_curved_end_steps)
            )
            total += compute_ramp_pulses(low, high, rate, self.R7, span)
            total += dwell * speed * self.rate_per_speed_step if k < len(stops) - 2 else 0.0
            speed_before = speed
        return total

    def estimate_seconds(self, pulses: int) -> float:
        """Return an upper bound of a move's duration, s: all pulses at FL or FH1, whichever is slower, and two ramps."""
        return pulses / min(self.fl, self.fh1, self.fh2) + 2 * max(
            self.get_accel_time(True), self.get_decel_time(True), 0.0
        )

    def __str__(self) -> str:
        shape = "" if self.spans is None else "S-curves; "
        return (
            f"{shape}FL {self.fl:.1f}, FH1 {self.fh1:.1f}, FH2 {self.fh2:.1f} pps; "
            f"FL to FH1 in {self.get_accel_time() * 1e3:.1f} ms, back in "
            f"{self.get_decel_time() * 1e3:.1f} ms; {' '.join(f'{k}={v}' for k, v in self.registers().items())}"
        )
