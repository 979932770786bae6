"""Moves that change their pulse rate: dual rate, any number of rates, ramps in pieces (data sheet section 5 h, 6, Q & A).

A chip has FL and two high rates. The register that is not selected can be rewritten in motion without effect and then be
selected, so any number of rates is possible. R0 and R6 are not written in motion, as the Q & A demands: the
ramp-down point is that of the last rate, and a move too short to reach it is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from stage.chips.sharing import exclusive
from stage.errors import ArgumentError, Limit
from stage.firmware.axis import Axis
from stage.firmware.pcl240 import bus
from stage.firmware.pcl240.bus import Port, Status
from stage.firmware.pcl240.moves import (
    SETTLE,
    either_way,
    minus_bit,
    prepare,
    profile_for,
    some_seconds,
    time_limit,
    whole_count,
)
from stage.firmware.pcl240.procedure import Procedure
from stage.firmware.pcl240.profile import Profile, down_point, ramp_pulses
from stage.firmware.report import Report
from stage.support.arguments import told

LONGEST_RAMP = 60.0  # s; R4 and R5 make no more than 27
SLACK = 1e-3  # s by which a host that polls may be late at each rate


@told
@exclusive
def dual_rate_move(
    axis: Axis,
    pulses: int | None,
    profile: Profile | None = None,
    *,
    rates: Sequence[str] = ("FH1", "FH2", "FH1"),
    dwell: float = 0.1,
    seconds: float | None = None,
    direction: int = 1,
    timeout: float | None = None,
) -> Report:
    """A move through several rates: FL, FH1 and FH2 in the order of `rates`, each for `dwell` seconds after its ramp.

                     17h ____ 15h
        15h  _______/ FH2    \\_______ FH1
            / FH1                    \\
        FL /                          \\ FL, R0 = 0

    A preset move of `pulses` (signed): the last rate lasts until the ramp-down point. With `seconds` in place of pulses a
    continuous one in `direction`: the last rate lasts so long, then a decelerating stop.
    A first rate "FL" starts at constant FL (10h), as the data sheet's dual rate pattern does, and 14h turns ramps on
    before the next rate; in motion FL is 14h.
    Raises ArgumentError (also when the pulses do not suffice for the rates), RunTimeout.
    """
    profile = profile_for(axis, profile)
    if (pulses is None) == (seconds is None):
        raise ArgumentError("give pulses for a preset move or seconds for a continuous one, not both.")
    rates = list(rates)
    for rate in rates:
        if rate not in bus.RAMP:
            raise ArgumentError(f"rate {rate!r}: a chip has FL, FH1 and FH2.")
    if not rates:
        raise ArgumentError("rates is empty: give at least one of FL, FH1, FH2.")
    dwell = some_seconds(dwell)
    speeds = [{"FL": profile.R1, "FH1": profile.R2, "FH2": profile.R3}[r] for r in rates]
    if pulses is not None:
        direction, point = pulses, _down_point(profile, speeds, whole_count(pulses), dwell)
    else:
        direction, seconds = either_way(direction), some_seconds(seconds or 0.0)
    with Procedure(axis, "dual-rate move") as p:
        prepare(p.port, profile, (bus.PRESET if pulses is not None else 0) | minus_bit(direction))
        if pulses is not None:
            p.port.write_registers(R0=whole_count(pulses), R6=point)
        constant = rates[0] == "FL"
        p.port.command(bus.START["FL"] if constant else bus.RAMP[rates[0]])
        status = _kept(p.port)
        for rate in rates[1:]:
            axis.wait(dwell if status.operating else 0.0)
            if not (status := p.port.status()).operating:
                break
            if constant:  # section 5 h, note: set bit 2 before the rate changes
                p.port.command(bus.RAMP["FL"])
            constant = False
            p.port.command(bus.RAMP[rate])
            status = _kept(p.port)
        if pulses is None and status.operating:
            axis.wait(seconds or 0.0)
            status = p.port.status()
            if status.operating:
                p.port.command(bus.SLOW_DOWN_FH2 if rates[-1] == "FH2" else bus.SLOW_DOWN_FH1)
                p.port.wait_until_stopped(LONGEST_RAMP)
                axis.wait(SETTLE)
                return p.report(p.stop_reason())
        p.port.wait_until_stopped(time_limit(timeout, profile, whole_count(pulses) if pulses else 1))
        axis.wait(SETTLE)
        return p.report(p.stop_reason(), pulses)


@told
@exclusive
def speed_change_move(
    axis: Axis,
    pulses: int,
    rates: Sequence[float],
    profile: Profile | None = None,
    *,
    dwell: float = 0.1,
    timeout: float | None = None,
) -> Report:
    """A preset move through any number of rates in pps, each for `dwell` seconds after its ramp: the register that is not in
    use is rewritten, then selected (data sheet section 5 h).

    Raises ArgumentError (also when the pulses do not suffice for the rates), RunTimeout.
    """
    profile = profile_for(axis, profile)
    speeds, count, dwell = _speeds(axis, profile, rates), whole_count(pulses), some_seconds(dwell)
    point = _down_point(profile, speeds, count, dwell)
    with Procedure(axis, "speed change in motion") as p:
        prepare(p.port, replace(profile, R2=speeds[0]), bus.PRESET | minus_bit(pulses))
        p.port.write_registers(R0=count, R6=point)
        p.port.command(bus.RAMP["FH1"])
        for k, speed in enumerate(speeds[1:], 1):
            axis.wait(dwell if _kept(p.port).operating else 0.0)
            if not p.port.status().operating:
                break
            _select_new(p.port, k, speed)
        p.port.wait_until_stopped(time_limit(timeout, _slowest(profile, speeds), count))
        axis.wait(SETTLE)
        return p.report(p.stop_reason(), pulses)


@told
@exclusive
def curved_ramp_move(
    axis: Axis,
    pulses: int,
    pieces: Sequence[tuple[float, float]],
    profile: Profile | None = None,
    *,
    timeout: float | None = None,
) -> Report:
    """A preset move whose ramp-up is bent: linear pieces, each to a rate in pps within a time in seconds.

    The chip ramps linearly only; in a ramp that is long beside the host's bus cycles, acceleration rate (R4) and speed register
    are written successively (data sheet, Q & A). Rates rise. The ramp-down is one line to FL, at the profile's R5.
    Raises ArgumentError (also when the pulses do not suffice), RunTimeout.
    """
    profile = replace(profile_for(axis, profile), spans=None)
    count = whole_count(pulses)
    if not all(isinstance(piece, Sequence) and len(piece) == 2 for piece in pieces):
        raise ArgumentError(f"pieces={pieces!r}: give pairs of a rate in pps and the time to reach it in seconds.")
    speeds = _speeds(axis, profile, [rate for rate, _ in pieces])
    way = [profile.R1, *speeds]
    if any(b <= a for a, b in pairwise(way)):
        raise ArgumentError(f"pieces={list(pieces)!r}: each rate must be above the one before it, the first above FL.")
    ramps = [
        axis.chip.MAP.checked("R4", round(t * profile.clock_hz / (b - a)))
        for (a, b), (_, t) in zip(pairwise(way), pieces, strict=True)
    ]
    climbed = sum(ramp_pulses(a, b, r, profile.R7) for (a, b), r in zip(pairwise(way), ramps, strict=True))
    fall = ramp_pulses(profile.R1, speeds[-1], profile.R5, profile.R7)
    _refuse_short(count, climbed + fall + len(speeds) * SLACK * speeds[-1] * profile.step)
    point = down_point(count, profile.R1, speeds[-1], 0, profile.R5, profile.R7)
    axis.chip.MAP.checked("R6", point)
    with Procedure(axis, "curved ramp") as p:
        prepare(p.port, replace(profile, R2=speeds[0], R4=ramps[0]), bus.PRESET | minus_bit(pulses))
        p.port.write_registers(R0=count, R6=point)
        p.port.command(bus.RAMP["FH1"])
        for k, (speed, ramp) in enumerate(zip(speeds[1:], ramps[1:], strict=True), 1):
            if not _kept(p.port).operating:
                break
            p.port.write_register("R4", ramp)
            _select_new(p.port, k, speed)
        p.port.wait_until_stopped(time_limit(timeout, _slowest(profile, speeds), count))
        axis.wait(SETTLE)
        return p.report(p.stop_reason(), pulses)


def _kept(port: Port) -> Status:
    """Wait until the rate selected is reached, or the axis has stopped."""
    return port.wait_until(lambda s: s.fkeep or not s.operating, LONGEST_RAMP, what="the end of the ramp")


def _select_new(port: Port, k: int, speed: int) -> None:
    """The k-th change of speed: write the register not in use, FH2 and FH1 by turns, and ramp to it."""
    register, rate = ("R3", "FH2") if k % 2 else ("R2", "FH1")
    port.write_register(register, speed)
    port.command(bus.RAMP[rate])


def _speeds(axis: Axis, profile: Profile, rates: Sequence[float]) -> list[int]:
    if not len(rates):
        raise ArgumentError("no rates given: give at least one, in pps.")
    for rate in rates:
        if not profile.fl * 0.999 <= rate <= profile.step * 8191:
            raise ArgumentError(
                f"rate {rate!r} pps: with R7 = {profile.R7} this move makes {profile.fl:.0f} (FL) to {profile.step * 8191:.0f} pps."
            )
    return [axis.chip.MAP.checked("R2", max(round(r / profile.step), profile.R1)) for r in rates]


def _down_point(profile: Profile, speeds: list[int], count: int, dwell: float) -> int:
    """R6 for the last speed; refuses a move that would be over before it is reached."""
    late = SLACK * max(speeds) * profile.step * len(speeds)
    if len(speeds) > 1:
        _refuse_short(count, profile.pulses_through(speeds, dwell) + late)
    return replace(profile, R2=max(speeds[-1], profile.R1)).down_point(count)


def _refuse_short(count: int, needed: float) -> None:
    if count < needed + 5:
        raise ArgumentError(
            f"pulses={count}: these rates take at least {int(needed) + 6} pulses; give more, dwell less, or ask for fewer rates."
        ).of(Limit("pulses", count, int(needed) + 6))


def _slowest(profile: Profile, speeds: list[int]) -> Profile:
    return replace(profile, R2=min(speeds), R3=min(speeds))
