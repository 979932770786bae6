"""Moves of the PCL-240 family: preset, continuous, interrupted and resumed, and by external count.

The procedures follow section 5 of the PCL-240K data sheet: reset command, registers, control mode, start. They work with all chips
of the family, and check their arguments before the first bus cycle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from stage.chips.exclusive_access import exclusive
from stage.chips.pcl240.state import COUNTER_MASK
from stage.errors import ArgumentError, StageError, add_article
from stage.firmware.axis import Axis, check_direction, check_seconds
from stage.firmware.driver import SETTLING_TIME_S
from stage.firmware.move_report import Report
from stage.firmware.pcl240 import chip_port
from stage.firmware.pcl240.chip_port import ChipPort, check_chip_family, describe_leader, require_clock
from stage.firmware.pcl240.procedure_observer import Pcl240Observer
from stage.firmware.pcl240.speed_profile import Profile
from stage.support.argument_checks import check_timeout, explain_arguments

RAMP_DOWN_OFFSET_PULSES = 2  # the counts of ramp-up and ramp-down differ by one or two, and this way FL is reached


@explain_arguments
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
    r"""Move by `pulses` (signed: the sign is the direction) and stop on the last one (data sheet section 5 b, c).

    high speed, 15h           ______ FH1          constant speed, 11h     ______ FH1
                             /      \                                    |      |
                         FL /        \ FL                                |      |
                           |    R6 -> |\ 0                         ______|      |______
    R0 counts down, and the ramp-down begins where it falls below R6.

    Args:
        axis: Axis whose chip is a PCL-240.
        pulses: Signed number of output pulses, 1 to 16,777,215 in magnitude.
        profile: Rates and ramps; default: those of `Profile.of`.
        high_speed: True for ramps to FH1 or (fh2) FH2; False for constant speed FH1 or FH2.
        fh2: FH2 in place of FH1.
        s_curve: True for S-curves throughout, a fraction (above 0, up to 0.5) of FH - FL for curved ends, False for linear ramps,
            in the ramp times of the profile; default: as the profile says. S-curves need a PCL240MS.
        automatic: True: the chip finds the ramp-down point itself, and decelerates on R4 (MK and MS). Default: True if the chip
            supports this and the profile's R5 equals R4.
        fh_correction: True: with the automatic point, a PCL240MS lowers the FH of a move that is too short to reach it. False:
            such a move is a triangle.
        down_point: R6; default by the data sheet's formula, triangular for a short move, so that it ends at FL. With `automatic`
            a signed offset, default 2: pulses by which the ramp-down begins earlier than the count of the ramp-up.
        slow_down: Whether the SD switch of the direction slows the axis to FL while it is asserted.
        interrupt: Whether the chip asserts /INT at the stop.
        timeout: Simulated seconds to wait; default: half as much again as the move can take, and one.

    Returns:
        What the host could observe, and the true state of the stage beside it.

    Raises:
        ArgumentError: 0, or more than 16,777,215 pulses; a register out of its range.
        StageError: The axis is moving.
        RunTimeout: The chip still moved after `timeout`.
    """
    profile, count = choose_profile(axis, profile), check_pulses_and_drop_sign(pulses)
    check_timeout(timeout)
    if s_curve is not None:
        profile = profile.with_ramp_shape(s_curve, fh2)
    if automatic is None:
        can_be_automatic = high_speed and profile.chip.EXTENDED and profile.R4 == profile.R5
        automatic = can_be_automatic and down_point is None and not slow_down
    control = chip_port.PRESET | (chip_port.SD if slow_down else 0) | encode_direction(pulses)
    if automatic:
        point = encode_ramp_down_offset(profile, RAMP_DOWN_OFFSET_PULSES if down_point is None else down_point)
        control |= chip_port.AUTOMATIC
    else:
        profile = profile.for_distance(count, fh2)
        point = (
            profile.compute_ramp_down_point(count, fh2)
            if down_point is None
            else profile.chip.MAP.check_value("R6", down_point)
        )
    with Pcl240Observer(axis, "preset move" if high_speed else "constant-speed preset move") as p:
        write_move_setup(p.port, profile, control)
        if profile.chip.S_CURVES and not fh_correction:
            p.port.write_register("R14", profile.registers()["R14"] | chip_port.UNCORRECTED)
        p.port.write_register("R0", count)
        if high_speed:
            p.port.write_register("R6", point)
        p.port.write_command(_encode_start(high_speed, fh2, interrupt))
        return p.finish(compute_time_limit(timeout, profile, count), pulses)


def start_preset_move(port: ChipPort, profile: Profile, pulses: int) -> None:
    """Start a high-speed preset move with FH1 and the data sheet's ramp-down point, and do not wait for its end.

    Raises:
        ArgumentError: A value does not fit its register.
        StageError: The axis is moving.
    """
    count = check_pulses_and_drop_sign(pulses)
    profile = profile.for_distance(count)
    write_move_setup(port, profile, chip_port.PRESET | encode_direction(pulses))
    port.write_registers(R0=count, R6=profile.compute_ramp_down_point(count))
    port.write_command(chip_port.RAMP_START_COMMANDS["FH1"])


def encode_ramp_down_offset(profile: Profile, offset: int) -> int:
    """Encode the signed offset of the automatic ramp-down point, in pulses, as the value of R6.

    Raises:
        ArgumentError: The chip has no such point, or R6 does not hold the offset.
    """
    half = (profile.chip.MAP.register("R6").mask + 1) // 2
    if not profile.chip.EXTENDED:
        raise ArgumentError(
            f"{add_article(profile.chip.MAP.chip)} has no automatic ramp-down point: a PCL240MK or PCL240MS has."
        )
    if int(offset) != offset or not -half <= offset < half:
        raise ArgumentError(f"down_point={offset!r}: as an offset R6 takes whole pulses from {-half} to {half - 1}.")
    return int(offset) % (2 * half)


@explain_arguments
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
    r"""Run for `seconds`, then stop (data sheet section 5 d, e).

    15h           ______  1Dh                     15h           ______  08h
                 /      \                                      /      |
             FL /        \ FL                              FL /       |
     __________|          |_______                 __________|        |_______

    A high-speed run ends with a decelerating stop (1Dh, 1Fh) or, if `immediate` is set, with the reset command. A constant-speed
    run always ends with the reset command.

    Args:
        axis: Axis whose chip is a PCL-240.
        seconds: Simulated time from the start command to the stop command, s.
        direction: 1 or -1.
        profile: Rates and ramps.
        high_speed: Whether the run has ramps.
        fh2: FH2 in place of FH1.
        slow_down: Whether the SD switch of the direction slows the axis to FL while it is asserted.
        immediate: Whether the reset command stops the run.
        interrupt: Whether the chip asserts /INT at the stop.

    Returns:
        What the host could observe, and the true state of the stage beside it.

    Raises:
        ArgumentError: A value is out of its range.
        StageError: The axis is moving.
    """
    profile = choose_profile(axis, profile)
    check_direction(direction)
    check_seconds(seconds)
    with Pcl240Observer(axis, "continuous move" if high_speed else "constant-speed continuous move") as p:
        write_move_setup(p.port, profile, (chip_port.SD if slow_down else 0) | encode_direction(direction))
        p.port.write_command(_encode_start(high_speed, fh2, interrupt))
        axis.wait(seconds)
        if p.port.read_status().operating:
            stop = chip_port.SLOW_DOWN["FH2" if fh2 else "FH1"] if high_speed and not immediate else chip_port.RESET
            p.port.write_command(stop | (chip_port.STOP_INTERRUPT_BIT if interrupt else 0))
        return p.finish(2 * profile.get_decel_time(fh2) + 1)


@explain_arguments
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
    """Interrupt a preset move by a decelerating stop, and resume it with its residual pulses (data sheet section 4, R0; section 6).

    /INT reports the stop. The reset command enables the next start and releases /INT. The ramp-down point is written again, in
    case the rest of the move is too short to reach the high rate.

    Args:
        axis: Axis whose chip is a PCL-240.
        pulses: Signed number of output pulses.
        profile: Rates and ramps.
        fh2: FH2 in place of FH1.
        after: Time from the start command to the stop command, s.
        pause: Time of rest, s.
        timeout: Simulated seconds to wait for the end of each part; default: half as much again as the move can take, and one.

    Returns:
        What the host could observe, and the true state of the stage beside it.

    Raises:
        ArgumentError: A value is out of its range.
        RunTimeout: The chip still moved after `timeout`.
    """
    check_timeout(timeout)
    full_profile, count = choose_profile(axis, profile), check_pulses_and_drop_sign(pulses)
    profile = full_profile.for_distance(count, fh2)
    check_seconds(after)
    check_seconds(pause)
    point = profile.compute_ramp_down_point(count, fh2)
    rate = "FH2" if fh2 else "FH1"
    with Pcl240Observer(axis, "interrupted move") as p:
        write_move_setup(p.port, profile, chip_port.PRESET | encode_direction(pulses))
        p.port.write_registers(R0=count, R6=point)
        p.port.write_command(chip_port.RAMP_START_COMMANDS[rate])
        axis.wait(after)
        if p.port.read_status().operating:
            p.port.write_command(chip_port.SLOW_DOWN[rate] | chip_port.STOP_INTERRUPT_BIT)
        p.port.wait_until_stopped(compute_time_limit(timeout, profile, count))
        if residual := p.port.read_counter():
            axis.wait(pause)
            p.port.write_command(chip_port.RESET)
            rest = full_profile.for_distance(residual, fh2)
            if rest != profile:
                p.port.write_registers(**rest.registers())
            p.port.write_register("R6", rest.compute_ramp_down_point(residual, fh2))
            p.port.write_command(chip_port.RAMP_START_COMMANDS[rate])
            p.port.wait_until_stopped(compute_time_limit(timeout, profile, residual))
        axis.wait(SETTLING_TIME_S)
        return p.make_report(p.find_stop_reason(), pulses)


@explain_arguments
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
        axis: Axis whose chip is a PCL-240.
        pulses: Number of external pulses; the axis makes as many as fit in their time.
        profile: Rates and ramps, of which FL is used.
        rate: Frequency of the usual square wave, Hz.
        direction: 1 or -1.
        source: Function that makes one external pulse on `axis.chip.pins.extp` (active low, counted at its release), lets its time
            pass by `axis.wait`, and returns False when there are no more; or a generator that yields after each one. Default: a
            square wave of `rate` Hz.
        timeout: Simulated seconds after which the reset command ends the run ("timeout").

    Returns:
        What the host could observe, and the true state of the stage beside it.

    Raises:
        ArgumentError: A value is out of its range.
    """
    profile = choose_profile(axis, profile)
    check_timeout(timeout)
    count = check_pulses_and_drop_sign(pulses)
    check_direction(direction)
    if pulses < 0:
        raise ArgumentError(f"pulses={pulses!r}: external pulses are counted from 1 on; direction=-1 runs backwards.")
    if source is None and not 0 < rate <= axis.chip.clock_hz / 4:
        raise ArgumentError(f"rate={rate!r} Hz: EXTP is sampled by the clock; more than 0 and up to a quarter of it.")
    make_pulse = _make_external_pulse_function(source) if source is not None else lambda a: _make_square_pulse(a, rate)
    with Pcl240Observer(axis, "external count") as p:
        write_move_setup(p.port, profile, chip_port.PRESET | encode_direction(direction), output=chip_port.EXTERNAL)
        p.port.write_register("R0", count)
        p.port.write_command(chip_port.START["FL"])
        end, more = axis.time + timeout, True
        while p.port.read_status().operating and axis.time < end and more:
            more = make_pulse(axis)
        status = p.port.read_status()
        # while the last pulse is completed EXTP goes on, and R0 through 0
        counted = status.zero or p.port.read_counter() > count
        if status.operating and not counted:
            p.port.write_command(chip_port.RESET)
        p.port.wait_until_stopped(1 / profile.fl + 1)
        p.port.write_command(chip_port.OUTPUT)
        axis.wait(SETTLING_TIME_S)
        if status.operating and not counted:
            return p.make_report("timeout" if more else "reset command")
        return p.make_report(p.find_stop_reason())


def _make_square_pulse(axis: Axis, rate: float) -> bool:
    """Make one period of a square wave of `rate` Hz on EXTP."""
    for level in (True, False):
        axis.chip.axes[0].pins.extp = level
        axis.wait(0.5 / rate)
    return True


def _make_external_pulse_function(source: Callable[[Axis], bool] | Iterator) -> Callable[[Axis], bool]:
    """Return a function of the axis that makes one external pulse, and returns False when there are no more."""
    if callable(source):
        return source
    if not isinstance(source, Iterator):
        raise ArgumentError(
            f"source={source!r}: give a function of the axis, or a generator that yields after each pulse."
        )
    return lambda axis: next(source, StopIteration) is not StopIteration


def write_move_setup(port: ChipPort, profile: Profile, control: int, output: int = 0) -> None:
    """Write the reset command, the speed data, the output mode and the control mode (data sheet section 5 a).

    Raises:
        StageError: The axis is moving.
    """
    if port.read_status().operating:
        raise StageError(f"axis {port.axis.name} is moving: wait until it stops, or stop it with 08h.")
    port.write_command(chip_port.RESET)
    port.write_registers(**profile.registers())
    port.write_command(chip_port.OUTPUT | output)
    port.write_control_mode(control)


def choose_profile(axis: Axis, profile: Profile | None) -> Profile:
    """Return the user's speed profile if it fits the axis' chip and clock; for None the default profile.

    Raises:
        ArgumentError: The profile does not fit.
        StageError: The chip takes its clock from another chip (SYNI), and that chip outputs none.
    """
    chip, multiplier = check_chip_family(axis), require_clock(axis)
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
            f"the profile has R7 = {profile.R7}, and axis {axis.name} counts the clock of "
            f"{describe_leader(axis)} (SYNI), which has R7 = {multiplier}: Profile.of(..., multiplier={multiplier})."
        )
    return profile.for_chip(chip)


def check_pulses_and_drop_sign(pulses: int) -> int:
    """Check a number of pulses, and return it without its sign. Raises ArgumentError for a number that R0 cannot count."""
    if not isinstance(pulses, int | float) or not 1 <= abs(pulses) <= COUNTER_MASK or int(pulses) != pulses:
        raise ArgumentError(f"pulses={pulses!r}: R0 counts 1 to 16777215 pulses; the sign is the direction.")
    return abs(int(pulses))


def encode_direction(direction: int) -> int:
    """Return the direction bit of the PCL-240's control mode command for a direction or signed pulses."""
    return chip_port.MINUS if direction < 0 else 0


def _encode_start(high_speed: bool, fh2: bool, interrupt: bool) -> int:
    """Return the start command of the PCL-240 for a speed, with or without an interrupt at the stop."""
    start = (chip_port.RAMP_START_COMMANDS if high_speed else chip_port.START)["FH2" if fh2 else "FH1"]
    return start | (chip_port.STOP_INTERRUPT_BIT if interrupt else 0)


def compute_time_limit(timeout: float | None, profile: Profile, count: int) -> float:
    """Return `timeout`; for None 1.5 times the longest duration of a move of `count` pulses plus one second, s."""
    return 1.5 * profile.estimate_seconds(count) + 1 if timeout is None else timeout
