"""Moves that change their pulse rate: two rates, any number of rates, ramps of several segments (data sheet section 5 h, 6, Q & A).

A chip has FL and two high rates. The host can rewrite the register that is not selected during the motion and then select it, so
any number of rates is possible. It does not write R0 and R6 during the motion, as the Q & A demands: the ramp-down point suits the
last rate, and the procedures refuse a move that is too short to reach this rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from stage.chips.exclusive_access import exclusive
from stage.errors import ArgumentError, ExceededLimit
from stage.firmware.axis import Axis, check_direction, check_seconds
from stage.firmware.move_report import Report
from stage.firmware.pcl240 import chip_port
from stage.firmware.pcl240.chip_port import ChipPort, Status
from stage.firmware.pcl240.moves import (
    check_pulses_and_drop_sign,
    choose_profile,
    compute_time_limit,
    encode_direction,
    write_move_setup,
)
from stage.firmware.pcl240.procedure_observer import Pcl240Observer
from stage.firmware.pcl240.speed_profile import Profile, compute_down_point, compute_ramp_pulses
from stage.support.argument_checks import explain_arguments

MAX_RAMP_S = 60.0  # R4 and R5 make no more than 27
POLL_DELAY_S = 1e-3  # by which a host that polls may be late at each rate


@explain_arguments
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
    """Move through several rates: FL, FH1 and FH2 in the order of `rates`, each for `dwell` seconds after its ramp.

                     17h ____ 15h
        15h  _______/ FH2    \\_______ FH1
            / FH1                    \\
        FL /                          \\ FL, R0 = 0

    A first rate "FL" starts at constant FL (10h), as the data sheet's dual rate pattern does, and 14h turns ramps on before the
    next rate; in motion FL is 14h.

    Args:
        axis: Axis whose chip is a PCL-240.
        pulses: Signed pulses of a preset move, whose last rate lasts until the ramp-down point; None with `seconds`.
        profile: Rates and ramps.
        rates: Names of the rates, "FL", "FH1" and "FH2".
        dwell: Time at each rate but the last, s.
        seconds: Time at the last rate of a continuous move in `direction`, which a decelerating stop ends, s.
        direction: 1 or -1, of a continuous move.
        timeout: Simulated seconds to wait; default: half as much again as the move can take, and one.

    Returns:
        What the host could observe, and the true state of the stage beside it.

    Raises:
        ArgumentError: A value is out of its range, or the pulses do not suffice for the rates.
        RunTimeout: The chip still moved after `timeout`.
    """
    profile = choose_profile(axis, profile)
    if (pulses is None) == (seconds is None):
        raise ArgumentError("give pulses for a preset move or seconds for a continuous one, not both.")
    rates = _check_rates(rates)
    check_seconds(dwell)
    if pulses is not None:
        speeds = [{"FL": profile.R1, "FH1": profile.R2, "FH2": profile.R3}[rate] for rate in rates]
        point = _find_down_point(profile, speeds, check_pulses_and_drop_sign(pulses), dwell)
        control = chip_port.PRESET | encode_direction(pulses)
    else:
        check_direction(direction)
        check_seconds(seconds or 0.0)
        control = encode_direction(direction)
    with Pcl240Observer(axis, "dual-rate move") as p:
        write_move_setup(p.port, profile, control)
        if pulses is not None:
            p.port.write_registers(R0=check_pulses_and_drop_sign(pulses), R6=point)
        status = _run_through_rates(p, rates, dwell)
        if pulses is None and status.operating:
            axis.wait(seconds or 0.0)
            if p.port.read_status().operating:
                p.port.write_command(chip_port.SLOW_DOWN["FH2" if rates[-1] == "FH2" else "FH1"])
                return p.finish(MAX_RAMP_S)
        return p.finish(
            compute_time_limit(timeout, profile, check_pulses_and_drop_sign(pulses) if pulses else 1), pulses
        )


def _check_rates(rates: Sequence[str]) -> list[str]:
    """Return the names of rates (FL, FH1, FH2) as a list. Raises ArgumentError for an empty sequence or an unknown name."""
    for rate in rates:
        if rate not in chip_port.RAMP_START_COMMANDS:
            raise ArgumentError(f"rate {rate!r}: a chip has FL, FH1 and FH2.")
    if not rates:
        raise ArgumentError("rates is empty: give at least one of FL, FH1, FH2.")
    return list(rates)


def _run_through_rates(observer: Pcl240Observer, rates: list[str], dwell: float) -> Status:
    """Start a move at the first rate, change to each further rate, and return the last status, which may show a stop."""
    constant = rates[0] == "FL"
    observer.port.write_command(chip_port.START["FL"] if constant else chip_port.RAMP_START_COMMANDS[rates[0]])
    status = _wait_for_rate(observer.port)
    for rate in rates[1:]:
        observer.axis.wait(dwell if status.operating else 0.0)
        status = observer.port.read_status()
        if not status.operating:
            break
        if constant:  # section 5 h, note: set bit 2 before the rate changes
            observer.port.write_command(chip_port.RAMP_START_COMMANDS["FL"])
        constant = False
        observer.port.write_command(chip_port.RAMP_START_COMMANDS[rate])
        status = _wait_for_rate(observer.port)
    return status


@explain_arguments
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
    """Make a preset move through any number of rates, each for `dwell` seconds after its ramp (data sheet section 5 h).

    For each change, the host rewrites the speed register that is not in use and then selects it.

    Args:
        axis: Axis whose chip is a PCL-240.
        pulses: Signed number of output pulses.
        rates: Rates in order, pps.
        profile: FL and ramps.
        dwell: Time at each rate except the last, s.
        timeout: Simulated seconds to wait; default: half as much again as the move can take, and one.

    Returns:
        What the host could observe, and the true state of the stage beside it.

    Raises:
        ArgumentError: A value is out of its range, or the pulses do not suffice for the rates.
        RunTimeout: The chip still moved after `timeout`.
    """
    profile = choose_profile(axis, profile)
    speeds, count = _convert_rates(axis, profile, rates), check_pulses_and_drop_sign(pulses)
    check_seconds(dwell)
    point = _find_down_point(profile, speeds, count, dwell)
    with Pcl240Observer(axis, "speed change in motion") as p:
        write_move_setup(p.port, replace(profile, R2=speeds[0]), chip_port.PRESET | encode_direction(pulses))
        p.port.write_registers(R0=count, R6=point)
        p.port.write_command(chip_port.RAMP_START_COMMANDS["FH1"])
        for k, speed in enumerate(speeds[1:], 1):
            axis.wait(dwell if _wait_for_rate(p.port).operating else 0.0)
            if not p.port.read_status().operating:
                break
            _change_speed(p.port, k, speed)
        return p.finish(compute_time_limit(timeout, _replace_high_rates(profile, min(speeds)), count), pulses)


@explain_arguments
@exclusive
def curved_ramp_move(
    axis: Axis,
    pulses: int,
    pieces: Sequence[tuple[float, float]],
    profile: Profile | None = None,
    *,
    timeout: float | None = None,
) -> Report:
    """Make a preset move whose ramp-up consists of linear segments, each to a rate in pps within a time in seconds.

    The chip itself ramps only linearly. During a ramp that is long compared with a bus cycle, the host writes the acceleration
    rate (R4) and the speed register again and again (data sheet, Q & A). The rates must rise. The ramp-down is a single line to
    FL, with the
    profile's R5.

    Args:
        axis: Axis whose chip is a PCL-240.
        pulses: Signed number of output pulses.
        pieces: Segments of the ramp: pairs of a rate, pps, and the time to reach it, s.
        profile: FL and the ramp-down.
        timeout: Simulated seconds to wait; default: half as much again as the move can take, and one.

    Returns:
        What the host could observe, and the true state of the stage beside it.

    Raises:
        ArgumentError: A value is out of its range, or the pulses do not suffice.
        RunTimeout: The chip still moved after `timeout`.
    """
    profile = replace(choose_profile(axis, profile), spans=None)
    count = check_pulses_and_drop_sign(pulses)
    speeds, ramps = _convert_pieces(axis, profile, pieces)
    all_speeds = [profile.R1, *speeds]
    climb = sum(compute_ramp_pulses(a, b, r, profile.R7) for (a, b), r in zip(pairwise(all_speeds), ramps, strict=True))
    fall = compute_ramp_pulses(profile.R1, speeds[-1], profile.R5, profile.R7)
    _refuse_short_move(count, climb + fall + len(speeds) * POLL_DELAY_S * speeds[-1] * profile.rate_per_speed_step)
    point = axis.chip.MAP.check_value(
        "R6", compute_down_point(count, profile.R1, speeds[-1], 0, profile.R5, profile.R7)
    )
    with Pcl240Observer(axis, "curved ramp") as p:
        write_move_setup(
            p.port, replace(profile, R2=speeds[0], R4=ramps[0]), chip_port.PRESET | encode_direction(pulses)
        )
        p.port.write_registers(R0=count, R6=point)
        p.port.write_command(chip_port.RAMP_START_COMMANDS["FH1"])
        for k, (speed, ramp) in enumerate(zip(speeds[1:], ramps[1:], strict=True), 1):
            if not _wait_for_rate(p.port).operating:
                break
            p.port.write_register("R4", ramp)
            _change_speed(p.port, k, speed)
        return p.finish(compute_time_limit(timeout, _replace_high_rates(profile, min(speeds)), count), pulses)


def _wait_for_rate(port: ChipPort) -> Status:
    """Wait until the PCL-240 has reached the selected rate, or the axis has stopped."""
    return port.wait_until(lambda s: s.fkeep or not s.operating, MAX_RAMP_S, expected_event="the end of the ramp")


def _change_speed(port: ChipPort, index: int, speed: int) -> None:
    """Make the k-th change of speed: write the unused register (FH2 and FH1 alternate), and ramp to its speed."""
    register, rate = ("R3", "FH2") if index % 2 else ("R2", "FH1")
    port.write_register(register, speed)
    port.write_command(chip_port.RAMP_START_COMMANDS[rate])


def _convert_rates(axis: Axis, profile: Profile, rates: Sequence[float]) -> list[int]:
    """Convert rates in pps to speed steps. Raises ArgumentError for a rate that the profile's R7 cannot make."""
    if not len(rates):
        raise ArgumentError("no rates given: give at least one, in pps.")
    for rate in rates:
        if not profile.fl * 0.999 <= rate <= profile.rate_per_speed_step * 8191:
            raise ArgumentError(
                f"rate {rate!r} pps: with R7 = {profile.R7} this move makes {profile.fl:.0f} (FL) to "
                f"{profile.rate_per_speed_step * 8191:.0f} pps."
            )
    return [axis.chip.MAP.check_value("R2", max(round(r / profile.rate_per_speed_step), profile.R1)) for r in rates]


def _convert_pieces(axis: Axis, profile: Profile, pieces: Sequence[tuple[float, float]]) -> tuple[list[int], list[int]]:
    """Convert the segments of a ramp to speed steps and values of R4. Raises ArgumentError if the rates do not rise."""
    if not all(isinstance(piece, Sequence) and len(piece) == 2 for piece in pieces):
        raise ArgumentError(f"pieces={pieces!r}: give pairs of a rate in pps and the time to reach it in seconds.")
    speeds = _convert_rates(axis, profile, [rate for rate, _ in pieces])
    steps = [b - a for a, b in pairwise([profile.R1, *speeds])]
    if min(steps) <= 0:
        raise ArgumentError(f"pieces={list(pieces)!r}: each rate must be above the one before it, the first above FL.")
    ramps = [
        axis.chip.MAP.check_value("R4", round(seconds * profile.clock_hz / count))
        for count, (_, seconds) in zip(steps, pieces, strict=True)
    ]
    return speeds, ramps


def _find_down_point(profile: Profile, speeds: list[int], count: int, dwell: float) -> int:
    """Compute R6, the ramp-down point, for the last speed. Raises ArgumentError if the move ends before this speed is reached."""
    delay = POLL_DELAY_S * max(speeds) * profile.rate_per_speed_step * len(speeds)
    if len(speeds) > 1:
        _refuse_short_move(count, profile.compute_pulses_through(speeds, dwell) + delay)
    return replace(profile, R2=max(speeds[-1], profile.R1)).compute_ramp_down_point(count)


def _refuse_short_move(count: int, needed: float) -> None:
    """Raise ArgumentError for a move with fewer pulses than its rates need."""
    if count < needed + 5:
        raise ArgumentError(
            f"pulses={count}: these rates take at least {int(needed) + 6} pulses; give more, dwell less, or ask for fewer rates."
        ).with_limit(ExceededLimit("pulses", count, int(needed) + 6))


def _replace_high_rates(profile: Profile, speed: int) -> Profile:
    """Return the speed profile with one speed, in speed steps, as both high rates."""
    return replace(profile, R2=speed, R3=speed)
