"""Moves, by bus cycles only: preset, continuous, interrupt and resume, external count.

The procedures follow section 5 of the PCL-240K data sheet: reset command, registers, control mode, start; they serve the
whole family and use what a chip offers. Arguments are checked before the first bus cycle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from stage.chips.pcl240.state import COUNTER_MASK
from stage.chips.sharing import exclusive
from stage.errors import ArgumentError, StageError, a_or_an
from stage.firmware.axis import Axis
from stage.firmware.driver import SETTLE
from stage.firmware.pcl240 import bus
from stage.firmware.pcl240.bus import Port, check
from stage.firmware.pcl240.clock import name_leader, require_clock
from stage.firmware.pcl240.procedure import Procedure
from stage.firmware.pcl240.profile import Profile
from stage.firmware.report import Report
from stage.support.arguments import patience, told

AUTOMATIC_OFFSET = 2  # pulses; the counts of ramp-up and ramp-down differ by one or two, and this way FL is reached


@told
@exclusive
def preset_move(
    axis: Axis,
    pulses: int,
    profile: Profile | None = None,
    *,
    high_speed: bool = True,
    fh2: bool = False,
    s_curve: bool | float | None = None,
    automatic: bool | None = None,
    fh_correction: bool = True,
    down_point: int | None = None,
    slow_down: bool = False,
    interrupt: bool = False,
    timeout: float | None = None,
) -> Report:
    """Move by `pulses` (signed: the sign is the direction) and stop on the last one (data sheet section 5 b, c).

    high speed, 15h           ______ FH1          constant speed, 11h     ______ FH1
                             /      \\                                    |      |
                         FL /        \\ FL                                |      |
                           |    R6 -> |\\ 0                         ______|      |______
    R0 counts down, and the ramp-down begins where it falls below R6.

    Args:
        high_speed: with ramps, to FH1 or (fh2) FH2; otherwise constant speed FH1 or FH2.
        s_curve: True for S-curves throughout, a share (above 0, up to 0.5) of FH - FL for curved ends, False
            for linear ramps, in the ramp times of the profile; default: as the profile says. S-curves need a PCL240MS.
        automatic: the chip finds the ramp-down point itself, and decelerates on R4 (MK and MS). Default: where it can and
            the profile's R5 is its R4.
        fh_correction: with the automatic point a PCL240MS lowers the FH of a move too short to reach it; False: a triangle.
        down_point: R6; default by the data sheet's formula, triangular for a short move, so that it ends at FL. With
            `automatic` a signed offset, default 2: pulses by which the ramp-down begins earlier than the count of the ramp-up.
        slow_down: the SD switch of the direction slows the axis to FL while it is asserted.
        interrupt: /INT at the stop.
        timeout: s; default half as much again as the move can take, and one.
    Raises ArgumentError (0, or more than 16777215 pulses; a register out of its range), RunTimeout.
    """
    profile, count = profile_for(axis, profile), whole_count(pulses)
    patience(timeout)
    if s_curve is not None:
        profile = profile.shaped(s_curve, fh2)
    if automatic is None:
        automatic = high_speed and profile.chip.EXTENDED and profile.R4 == profile.R5
        automatic = automatic and down_point is None and not slow_down
    control = bus.PRESET | _sd(slow_down) | minus_bit(pulses)
    if automatic:
        point = _offset(profile, AUTOMATIC_OFFSET if down_point is None else down_point)
        control |= bus.AUTOMATIC
    else:
        profile = profile.within(count, fh2)
        point = profile.down_point(count, fh2) if down_point is None else profile.chip.MAP.checked("R6", down_point)
    with Procedure(axis, "preset move" if high_speed else "constant-speed preset move") as p:
        prepare(p.port, profile, control)
        if profile.chip.S_CURVES and not fh_correction:
            p.port.write_register("R14", profile.registers()["R14"] | bus.UNCORRECTED)
        p.port.write_register("R0", count)
        if high_speed:
            p.port.write_register("R6", point)
        p.port.command(_start(high_speed, fh2) | _int(interrupt))
        p.port.wait_until_stopped(time_limit(timeout, profile, count))
        axis.wait(SETTLE)
        return p.report(p.stop_reason(), pulses)


def start_preset(port: Port, profile: Profile, pulses: int) -> None:
    """Begin a high-speed preset move with FH1 and the data sheet's ramp-down point, and do not wait. Raises ArgumentError."""
    count = whole_count(pulses)
    profile = profile.within(count)
    prepare(port, profile, bus.PRESET | minus_bit(pulses))
    port.write_registers(R0=count, R6=profile.down_point(count))
    port.command(_start(True, False))


def _offset(profile: Profile, offset: int) -> int:
    """R6 as the signed offset of the automatic ramp-down point."""
    half = (profile.chip.MAP.register("R6").mask + 1) // 2
    if not profile.chip.EXTENDED:
        raise ArgumentError(
            f"{a_or_an(profile.chip.MAP.chip)} has no automatic ramp-down point: a PCL240MK or PCL240MS has."
        )
    if int(offset) != offset or not -half <= offset < half:
        raise ArgumentError(f"down_point={offset!r}: as an offset R6 takes whole pulses from {-half} to {half - 1}.")
    return int(offset) % (2 * half)


@told
@exclusive
def continuous_move(
    axis: Axis,
    seconds: float,
    direction: int = 1,
    profile: Profile | None = None,
    *,
    high_speed: bool = True,
    fh2: bool = False,
    slow_down: bool = False,
    immediate: bool = False,
    interrupt: bool = False,
) -> Report:
    """Run for `seconds`, then stop (data sheet section 5 d, e).

    15h           ______  1Dh                     15h           ______  08h
                 /      \\                                      /      |
             FL /        \\ FL                              FL /       |
     __________|          |_______                 __________|        |_______

    A high-speed run is stopped decelerating (1Dh, 1Fh) or, `immediate`, by the reset command; a constant-speed run always
    by the reset command. The other arguments are those of `preset_move`. Raises ArgumentError.
    """
    profile = profile_for(axis, profile)
    direction, seconds = either_way(direction), some_seconds(seconds)
    slow = high_speed and not immediate
    with Procedure(axis, "continuous move" if high_speed else "constant-speed continuous move") as p:
        prepare(p.port, profile, _sd(slow_down) | minus_bit(direction))
        p.port.command(_start(high_speed, fh2) | _int(interrupt))
        axis.wait(seconds)
        if p.port.status().operating:
            stop = (bus.SLOW_DOWN_FH2 if fh2 else bus.SLOW_DOWN_FH1) if slow else bus.RESET
            p.port.command(stop | _int(interrupt))
        p.port.wait_until_stopped(2 * profile.decel(fh2) + 1)
        axis.wait(SETTLE)
        return p.report(p.stop_reason())


@told
@exclusive
def interrupted_move(
    axis: Axis,
    pulses: int,
    profile: Profile | None = None,
    *,
    fh2: bool = False,
    after: float = 0.3,
    pause: float = 0.2,
    timeout: float | None = None,
) -> Report:
    """Ramp down and interrupt: a preset move is brought to a decelerating stop after `after` seconds, tells so by /INT, rests
    for `pause` seconds, and goes on with its residual pulses, which R0 kept (data sheet section 4, R0; section 6).

    The reset command re-arms the start and takes /INT back; the ramp-down point is set anew, in case the rest is too short to
    reach the high rate again. Raises ArgumentError, RunTimeout.
    """
    patience(timeout)
    whole, count = profile_for(axis, profile), whole_count(pulses)
    profile = whole.within(count, fh2)
    after, pause, point = some_seconds(after), some_seconds(pause), profile.down_point(count, fh2)
    rate = "FH2" if fh2 else "FH1"
    with Procedure(axis, "interrupted move") as p:
        prepare(p.port, profile, bus.PRESET | minus_bit(pulses))
        p.port.write_registers(R0=count, R6=point)
        p.port.command(bus.RAMP[rate])
        axis.wait(after)
        if p.port.status().operating:
            p.port.command((bus.SLOW_DOWN_FH2 if fh2 else bus.SLOW_DOWN_FH1) | bus.INTERRUPT)
        p.port.wait_until_stopped(time_limit(timeout, profile, count))
        if residual := p.port.counter():
            axis.wait(pause)
            p.port.command(bus.RESET)
            rest = whole.within(residual, fh2)
            if rest != profile:
                p.port.write_registers(**rest.registers())
            p.port.write_register("R6", rest.down_point(residual, fh2))
            p.port.command(bus.RAMP[rate])
            p.port.wait_until_stopped(time_limit(timeout, profile, residual))
        axis.wait(SETTLE)
        return p.report(p.stop_reason(), pulses)


@told
@exclusive
def external_count(
    axis: Axis,
    pulses: int,
    profile: Profile | None = None,
    *,
    rate: float = 1000.0,
    direction: int = 1,
    source: Callable[[Axis], bool] | Iterator | None = None,
    timeout: float = 60.0,
) -> Report:
    """Run at constant FL until EXTP has counted R0 = `pulses` edges down to 0 (output mode D4, data sheet section 4, R0).

    Args:
        pulses: external ones; the axis makes as many as fit in their time.
        source: makes external pulses on `axis.chip.pins.extp` (active low, counted as it lets go) and lets their time pass by
            `axis.wait`: a function of the axis which makes one pulse and returns False when there are no more, or a
            generator that yields after each one. Default: a square wave of `rate` Hz.
        timeout: s, after which the reset command ends the run ("timeout").
    Raises ArgumentError.
    """
    profile = profile_for(axis, profile)
    patience(timeout)
    count, direction = whole_count(pulses), either_way(direction)
    if pulses < 0:
        raise ArgumentError(f"pulses={pulses!r}: external pulses are counted from 1 on; direction=-1 runs backwards.")
    if source is None and not 0 < rate <= axis.chip.clock_hz / 4:
        raise ArgumentError(f"rate={rate!r} Hz: EXTP is sampled by the clock; more than 0 and up to a quarter of it.")
    make = _one_by_one(source) if source is not None else lambda a: _square_wave(a, rate)
    with Procedure(axis, "external count") as p:
        prepare(p.port, profile, bus.PRESET | minus_bit(direction), output=bus.EXTERNAL)
        p.port.write_register("R0", count)
        p.port.command(bus.START["FL"])
        end, more = axis.time + timeout, True
        while p.port.status().operating and axis.time < end and more:
            more = make(axis)
        status = p.port.status()
        # while the last pulse is completed EXTP goes on, and R0 through 0
        status = status._replace(zero=status.zero or p.port.counter() > count)
        if status.operating and not status.zero:
            p.port.command(bus.RESET)
        p.port.wait_until_stopped(1 / profile.fl + 1)
        p.port.command(bus.OUTPUT)
        axis.wait(SETTLE)
        if status.operating and not status.zero:
            return p.report("timeout" if more else "reset command")
        return p.report(p.stop_reason())


def _square_wave(axis: Axis, rate: float) -> bool:
    for level in (True, False):
        axis.chip.axes[0].pins.extp = level
        axis.wait(0.5 / rate)
    return True


def _one_by_one(source: Callable[[Axis], bool] | Iterator) -> Callable[[Axis], bool]:
    if callable(source):
        return source
    if not isinstance(source, Iterator):
        raise ArgumentError(
            f"source={source!r}: give a function of the axis, or a generator that yields after each pulse."
        )
    return lambda axis: next(source, StopIteration) is not StopIteration


def prepare(port: Port, profile: Profile, control: int, output: int = 0) -> None:
    """Reset command, speed data, output mode, control mode (data sheet section 5 a). Refuses a moving axis."""
    if port.status().operating:
        raise StageError(f"axis {port.axis.name} is moving: wait until it stops, or stop it with 08h.")
    port.command(bus.RESET)
    port.write_registers(**profile.registers())
    port.command(bus.OUTPUT | output)
    port.control(control)


def profile_for(axis: Axis, profile: Profile | None) -> Profile:
    """Return what was given, if it fits the axis' chip and clock; else the usual one.

    Raises ArgumentError; StageError where the chip follows another (SYNI) that makes no clock.
    """
    chip, multiplier = check(axis), require_clock(axis)
    if profile is None:
        return Profile.of(clock_hz=axis.chip.clock_hz, chip=chip, multiplier=multiplier)
    if not isinstance(profile, Profile):
        raise ArgumentError(f"profile={profile!r}: give a Profile, for example Profile.of(fl=500, fh1=16000).")
    if profile.clock_hz != axis.chip.clock_hz:
        raise ArgumentError(
            f"the profile is for a chip at {profile.clock_hz} Hz, axis {axis.name}'s runs at {axis.chip.clock_hz} Hz: "
            f"Profile.of(..., clock_hz={axis.chip.clock_hz})."
        )
    if multiplier not in (None, profile.R7):
        raise ArgumentError(
            f"the profile has R7 = {profile.R7}, and axis {axis.name} counts the clock of {name_leader(axis)} (SYNI), which has "
            f"R7 = {multiplier}: Profile.of(..., multiplier={multiplier})."
        )
    return profile.on(chip)


def whole_count(pulses: int) -> int:
    """How many pulses, whichever way. Raises ArgumentError."""
    if not isinstance(pulses, int | float) or not 1 <= abs(pulses) <= COUNTER_MASK or int(pulses) != pulses:
        raise ArgumentError(f"pulses={pulses!r}: R0 counts 1 to 16777215 pulses; the sign is the direction.")
    return abs(int(pulses))


def either_way(direction: int) -> int:
    """1 or -1. Raises ArgumentError."""
    if direction not in (1, -1):
        raise ArgumentError(f"direction={direction!r}: +1 or -1.")
    return direction


def some_seconds(seconds: float) -> float:
    """0 or more. Raises ArgumentError."""
    if not 0 <= seconds < 1e9:
        raise ArgumentError(f"seconds={seconds!r}: time runs forward, by 0 to 1e9 s.")
    return seconds


def minus_bit(direction: int) -> int:
    """Of the control command, for a direction or signed pulses."""
    return bus.MINUS if direction < 0 else 0


def _sd(slow_down: bool) -> int:
    return bus.SD if slow_down else 0


def _int(interrupt: bool) -> int:
    return bus.INTERRUPT if interrupt else 0


def _start(high_speed: bool, fh2: bool) -> int:
    return (bus.RAMP if high_speed else bus.START)["FH2" if fh2 else "FH1"]


def time_limit(timeout: float | None, profile: Profile, count: int) -> float:
    """Seconds: what was given, or half as much again as the move can take, and one."""
    return 1.5 * profile.seconds(count) + 1 if timeout is None else timeout
