"""Registers for an a:b move: every axis at a rate in the ratio of the distances, ramps together, stops together.

The data sheet's scheme (Q & A): FL and FH in the ratio a:b, equal ramp times. An axis' pulses after its ramp are

    n(t) = FH t - D / 2        D = (FH - FL) Tsu = (R2 - R1)^2 R4 / (8192 R7)

so besides the ratio of the rates it is the ratio of the D that keeps the axes on the line; equal ramp times keep them
there during the ramps too. R7 is free per axis, which gives every follower a thousand grids to choose its registers from; the best by
this estimate are then run on emulated chips, and the one that stays closest to the line is taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stage.chips import PCL240K
from stage.errors import ArgumentError
from stage.firmware.path import path_deviation
from stage.firmware.profile import ACCEL, FH1, FL

CANDIDATES = 10
TAIL = 5  # pulses of the longest axis at FL after its ramp-down, as in the data sheet's R6 = Psd + 5
ROOM = 0.8  # of a short move may be ramps


@dataclass(frozen=True)
class AxisPlan:
    """One axis: signed distance in pulses, and its registers R0 to R7."""

    distance: int
    registers: dict[str, int]
    clock_hz: int

    @property
    def step(self) -> float:
        return self.clock_hz / (8192 * self.registers["R7"])

    @property
    def fl(self) -> float:
        return self.registers["R1"] * self.step

    @property
    def fh(self) -> float:
        return self.registers["R2"] * self.step

    @property
    def ramps(self) -> bool:
        return self.registers["R2"] > self.registers["R1"]

    @property
    def accel(self) -> float:
        return (self.registers["R2"] - self.registers["R1"]) * self.registers["R4"] / self.clock_hz

    @property
    def decel(self) -> float:
        return (self.registers["R2"] - self.registers["R1"]) * self.registers["R5"] / self.clock_hz


@dataclass(frozen=True)
class Plan:
    """Registers for every axis, and how good they are.

    ratio_error: largest relative error of the FH ratios. deviation: largest distance from the line in pulses when all axes
    start at once, found by running emulated chips. seconds: duration.
    """

    axes: dict[str, AxisPlan]
    ratio_error: float
    deviation: float
    seconds: float
    notes: tuple[str, ...] = field(default=())

    def __str__(self) -> str:
        head = f"{'axis':6}{'pulses':>10}" + "".join(f"{'R' + str(k):>7}" for k in range(1, 8))
        lines = [head + f"{'FL pps':>10}{'FH pps':>11}{'up ms':>8}{'down ms':>8}"]
        for name, a in self.axes.items():
            r = a.registers
            lines.append(
                f"{name:6}{a.distance:>10}"
                + "".join(f"{r[f'R{k}']:>7}" for k in range(1, 8))
                + f"{a.fl:>10.2f}{a.fh:>11.2f}{a.accel * 1e3:>8.2f}{a.decel * 1e3:>8.2f}"
            )
        lines.append(
            f"ratio error {self.ratio_error:.1e}; on chips started together {self.deviation:.2f} pulses from the line; "
            f"{self.seconds:.3f} s"
        )
        return "\n".join([*lines, *self.notes])


def plan(
    distances: Mapping[str, int],
    *,
    rate: float = FH1,
    fl: float = FL,
    accel: float = ACCEL,
    decel: float | None = None,
    clock_hz: int | Mapping[str, int] = PCL240K.DEFAULT_CLOCK_HZ,
) -> Plan:
    """Plan a move along a straight line.

    distances: axis -> signed pulses, 1 to 16,777,215. rate, fl: FH and FL of the longest axis, pps. accel, decel: seconds.
    A move too short for `rate` peaks lower, on all axes at once; a very short one runs at constant FL.
    Raises ArgumentError with the reason when no registers can do it.
    """
    moving = {n: int(d) for n, d in distances.items() if d}
    _check(distances, moving, rate, fl, accel, accel if decel is None else decel)
    hz = {n: clock_hz if isinstance(clock_hz, int) else clock_hz[n] for n in moving}
    longest = max(moving, key=lambda n: abs(moving[n]))
    length = abs(moving[longest])
    fh, tu, td, notes = _shorten(length, rate, fl, accel, accel if decel is None else decel)
    _reach(moving, longest, fh, fl, hz)
    best: tuple[float, Any] | None = None
    for master in _masters(length, fh, fl, tu, td, hz[longest]):
        trace = _run(master, length)
        chosen, worst = {longest: master}, 0.0
        for name in moving:
            if name != longest:
                regs, far = _follow(abs(moving[name]), length, master, trace, hz[name], hz[longest])
                chosen[name], worst = regs, max(worst, far)
        if best is None or worst < best[0]:
            best = (worst, (chosen, trace))
        if worst <= 1.0:
            break
    assert best is not None
    chosen, _ = best[1]
    axes = {n: AxisPlan(moving[n], dict(chosen[n].registers), hz[n]) for n in moving}
    traces = [_run(chosen[n], abs(moving[n])) for n in moving]
    far = path_deviation([(t, np.ones(len(t), np.int64)) for t in traces], [abs(d) for d in moving.values()])
    top = axes[longest].fh / length
    error = max(abs(a.fh / abs(a.distance) / top - 1) for a in axes.values())
    return Plan(axes, error, far.pulses, float(max(t[-1] for t in traces)), tuple(notes))


@dataclass(frozen=True)
class _Registers:
    registers: dict[str, int]
    hz: int

    def __getitem__(self, name: str) -> int:
        return self.registers[name]


def _check(distances: Any, moving: dict, rate: float, fl: float, accel: float, decel: float) -> None:
    if not moving:
        raise ArgumentError(f"distances={dict(distances)!r}: nothing moves; give at least one axis pulses to make.")
    for name, d in moving.items():
        if d != distances[name] or abs(d) > 0xFFFFFF:
            raise ArgumentError(f"{name}={distances[name]!r}: R0 counts whole pulses, 1 to 16777215.")
    if not 0 < fl <= rate:
        raise ArgumentError(f"fl={fl!r}, rate={rate!r}: FL is more than 0 and at most the rate, in pps.")
    for name, value in {"accel": accel, "decel": decel}.items():
        if not 0 < value <= 25:
            raise ArgumentError(f"{name}={value!r} s: R4 and R5 make ramps of more than 0 and up to 25 s.")


def _shorten(length: int, rate: float, fl: float, accel: float, decel: float) -> tuple[float, float, float, list[str]]:
    """The peak rate and ramp times that a move of `length` pulses has room for, at the slopes asked for."""
    if rate <= fl:
        return fl, 0.0, 0.0, []
    inverse = (accel + decel) / (rate - fl)
    peak = (fl * fl + 2 * ROOM * length / inverse) ** 0.5
    if peak >= rate:
        return rate, accel, decel, []
    if peak < 1.2 * fl:
        return fl, 0.0, 0.0, ["too short for a ramp: constant FL"]
    part = (peak - fl) / (rate - fl)
    return peak, accel * part, decel * part, [f"too short for {rate:.0f} pps: peaks at {peak:.0f} pps"]


def _reach(moving: dict, longest: str, fh: float, fl: float, hz: dict) -> None:
    most = hz[longest] * 8191 / (8192 * 2)
    if fh > most:
        raise ArgumentError(f"rate={fh:.0f} pps: a chip at {hz[longest]} Hz makes at most {most:.0f} pps (R7 = 2).")
    for name, d in moving.items():
        least = hz[name] / (8192 * 1023)
        own = abs(d) / abs(moving[longest])
        if own * fh < least:
            raise ArgumentError(
                f"axis {name} would have to run at {own * fh:.3f} pps, and the slowest a chip makes is {least:.3f} pps "
                f"(R1 = 1, R7 = 1023). Raise the rate to {least / own:.0f} pps, or move {name} by itself."
            )


def _registers(hz: int, r0: int, fl: int, fh: int, up: int, down: int, r6: int, r7: int) -> _Registers:
    values = {"R0": r0, "R1": fl, "R2": fh, "R3": fh, "R4": up, "R5": down, "R6": r6, "R7": r7}
    return _Registers({k: int(v) for k, v in values.items()}, hz)


def _masters(length: int, fh: float, fl: float, tu: float, td: float, hz: int) -> list[_Registers]:
    """Registers for the longest axis, on coarse to fine grids: a fine one fits rates, a coarse one ramp times."""
    found = []
    finest = min(1023, int(hz * 8191 / (8192 * fh)))
    for r7 in np.unique(np.clip(np.geomspace(finest, max(2, finest / 16), 6).round().astype(int), 2, 1023))[::-1]:
        step = hz / (8192 * r7)
        high, low = max(1, min(8191, round(fh / step))), max(1, round(fl / step))
        span = high - low
        if tu == 0 or span < 1:
            found.append(_registers(hz, length, high, high, 2, 2, 0, r7))
            continue
        up, down = (int(np.clip(round(t * hz / span), 2, 16383)) for t in (tu, td))
        r6 = min(int((high**2 - low**2) * down / (16384 * r7)) + TAIL, 0xFFFFF, length)
        found.append(_registers(hz, length, low, high, up, down, r6, r7))
    return found


def _follow(d: int, length: int, master: _Registers, trace: np.ndarray, hz: int, master_hz: int) -> tuple[_Registers, float]:
    """The registers with which an axis of `d` pulses keeps closest to the line, and how close that is, in pulses."""
    rho = d / length
    estimates = _estimate(rho, master, float(trace[-1]), hz, master_hz)
    ramps = master["R2"] > master["R1"]
    begin = trace[min(max(length - master["R6"], 0), length - 1)] if ramps else 0.0  # when the master's ramp-down begins
    best: tuple[_Registers, float] | None = None
    for low, high, up, down, r7 in estimates:
        tries = [0]
        if high > low:
            made = int(np.searchsorted(_run(_registers(hz, d, low, high, up, down, 0, r7), d), begin, side="right"))
            tries = sorted({int(np.clip(d - made + k, 1, min(d, 0xFFFFF))) for k in (0, 1)})
        for r6 in tries:
            regs = _registers(hz, d, low, high, up, down, r6, r7)
            own = _run(regs, d)
            pair = [(trace, np.ones(len(trace), np.int64)), (own, np.ones(len(own), np.int64))]
            far = path_deviation(pair, [length, d]).pulses
            if best is None or far < best[1]:
                best = (regs, far)
    assert best is not None
    return best


def _estimate(rho: float, master: _Registers, seconds: float, hz: int, master_hz: int) -> list[tuple[int, ...]]:
    """The most promising (FL, FH, R4, R5, R7), by the closed form."""
    low, high, r7 = master["R1"], master["R2"], master["R7"]
    fh, fl = (rho * v * master_hz / (8192 * r7) for v in (high, low))
    tu, td = ((high - low) * master[r] / master_hz for r in ("R4", "R5"))
    grid = np.arange(2, 1024)
    step = hz / (8192.0 * grid)
    own_high = np.clip(np.rint(fh / step), 1, 8191)
    if high == low:
        score = np.abs(own_high * step - fh) * seconds
        pick = np.argsort(score, kind="stable")[:CANDIDATES]
        return [(int(own_high[k]), int(own_high[k]), 2, 2, int(grid[k])) for k in pick]
    rows = []
    for shift in range(-2, 3):
        ideal = np.maximum((fh - fl) / step, 1)
        up = np.clip(np.rint(tu * hz / ideal) + shift, 2, 16383)
        span = np.clip(np.rint(np.sqrt((fh - fl) * tu * hz / (step * up))), 1, np.maximum(own_high - 1, 1))
        own_low = np.maximum(own_high - span, 1)
        span = np.maximum(own_high - own_low, 0)
        down = np.clip(np.rint(td * hz / np.maximum(span, 1)), 2, 16383)
        score = np.abs(own_high * step - fh) * seconds
        score += np.abs(span * step * span * up / hz - (fh - fl) * tu) / 2
        score += np.abs(span * step * span * down / hz - (fh - fl) * td) / 2
        score += fh * np.abs(span * up / hz - tu) / 8 + fh * np.abs(span * down / hz - td) / 8
        score += np.abs(own_low * step - fl) * tu / 4
        rows += list(zip(score, own_low, own_high, up, down, grid, strict=True))
    rows.sort(key=lambda r: r[0])
    return [tuple(int(v) for v in r[1:]) for r in rows[:CANDIDATES]]


def _run(regs: _Registers, count: int) -> np.ndarray:
    """Times in s, from the start command on, of the pulses that a chip makes with these registers."""
    chip = PCL240K(regs.hz)
    for k in range(8):
        chip.write(0, 0x80 | k)
        for a in (3, 2, 1):
            chip.write(a, regs[f"R{k}"] >> 8 * (a - 1) & 0xFF)
    chip.write(0, 0x44)
    chip.write(0, 0x15 if regs["R2"] > regs["R1"] else 0x11)
    return chip.trace(1 << 40)["clock"] / regs.hz
