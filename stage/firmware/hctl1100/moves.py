"""Moves of a servo axis with an HCTL-1100: a position step, a trapezoid, and the two velocity modes.

    x = set_up_servo(stage.axes["x"], FilterTuning(gain=0x40))
    print(move_by_step(x, 100))
    print(move_by_trapezoid(x, 20_000, velocity=40_000, acceleration=400_000))
    print(run_in_integral_velocity_mode(x, 20_000, seconds=0.5))

Positions are counts of the encoder, and rates are counts/s. The registers hold rates in counts per sample, so rates are rounded,
and the reports contain the rounded rates. After each procedure the axis is in position control, or in Init/Idle if LIMIT has ended
the procedure. See homing.py for home, position_streaming.py for motion commanded sample by sample.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stage.chips.hctl1100.maps import FLAG, MINIMUM_T, NUMBERS, find_reset_value
from stage.errors import ArgumentError, ExceededLimit
from stage.firmware.axis import Axis
from stage.firmware.hctl1100.chip_port import LIMIT, MODE_FLAGS, PROFILE, SAFE_MARGIN_COUNTS, STOP, ChipPort
from stage.firmware.hctl1100.position_streaming import stream_positions, wait_for_next_sample

SETTLED_DWELL_S = 0.02  # s within the deadband: settled
MAX_SAMPLE_CLOCKS = 16 * 256  # clocks of a sample
SPEED_SAMPLES = 3  # samples: positions are whole counts, and a slow profile moves on by less in one sample


@dataclass(frozen=True)
class FilterTuning:
    """Tuning of the HCTL-1100: filter D(z) = K/4 (z - A/256) / (z + B/256) and sample timer T. Defaults: values after a reset.

    Attributes:
        gain: K.
        zero: A.
        pole: B.
        timer: T.
    """

    gain: int = find_reset_value("gain")
    zero: int = find_reset_value("zero")
    pole: int = find_reset_value("pole")
    timer: int = find_reset_value("timer")


@dataclass(frozen=True)
class ServoMoveReport:
    """Report of a position step or a trapezoid of a servo axis.

    Attributes:
        axis: Name of the axis.
        asked: Commanded counts.
        velocity: Velocity in the register, counts/s; 0 for a step.
        acceleration: Acceleration in the register, counts/s2; 0 for a step.
        profile: Seconds until the host read that the profile had ended; 0 for a step.
        settled: Seconds after which the axis stayed within the deadband.
        error: Command position minus actual position at the end, counts.
        deadband: Largest error of a settled axis, counts.
        limited: True if LIMIT has triggered and ended the move.
    """

    axis: str
    asked: int
    velocity: float
    acceleration: float
    profile: float
    settled: float
    error: int
    deadband: int
    limited: bool = False

    @property
    def ok(self) -> bool:
        """True if the servo axis is within the deadband of its command position."""
        return not self.limited and abs(self.error) <= self.deadband

    def __str__(self) -> str:
        if self.limited:
            return f"{self.axis}: {self.asked:+d} counts: ended by LIMIT after {self.settled:.3f} s"
        flag = f"profile {self.profile:.3f} s, " if self.profile else ""
        where = f"error {self.error} counts (deadband {self.deadband})"
        return f"{self.axis}: {self.asked:+d} counts: {flag}settled after {self.settled:.3f} s, {where}"


@dataclass(frozen=True)
class VelocityReport:
    """Report of a run of a servo axis in one of the two velocity modes.

    Attributes:
        axis: Name of the axis.
        mode: Control mode.
        asked: Velocity in the register, counts/s.
        reached: Mean velocity over the second half, counts/s.
        ended: Input that ended the run: "LIMIT" (the axis is then in Init/Idle), "STOP" (only in integral velocity mode), or "".
    """

    axis: str
    mode: str
    asked: float
    reached: float
    ended: str = ""

    def __str__(self) -> str:
        end = f", ended by {self.ended}" if self.ended else ""
        return f"{self.axis}: {self.mode} velocity {self.asked:+.0f} counts/s asked, {self.reached:+.0f} reached{end}"


def set_up_servo(axis: Axis, tuning: FilterTuning | None = None) -> ChipPort:
    """Load the filter and the sample time, and switch to position control at the present position.

    Args:
        axis: Axis whose chip is an HCTL-1100.
        tuning: Filter and sample timer; None: those after a reset.

    Returns:
        The port of the axis.

    Raises:
        ArgumentError: The chip is no HCTL-1100, a value does not fit its register, or LIMIT is asserted.
    """
    port = ChipPort(axis)
    port.enter_init_idle_mode()
    load_filter(port, tuning or FilterTuning())
    if not port.clear_status() & LIMIT:
        raise ArgumentError(
            f"axis {axis.name} stands on a limit switch, where the chip takes no control mode: see leave_limit."
        )
    port.hold_position()
    axis.wait(MAX_SAMPLE_CLOCKS / port.chip.clock_hz)  # the new T is used after the sample in progress
    return port


def load_filter(port: ChipPort, tuning: FilterTuning) -> None:
    """Load the HCTL-1100's filter and sample timer T. Raises ArgumentError for values that do not fit their registers."""
    port.write_quantities(timer=tuning.timer, gain=tuning.gain, zero=tuning.zero, pole=tuning.pole)


def move_by_step(port: ChipPort, counts: int, *, deadband: int = 3, timeout: float = 2.0) -> ServoMoveReport:
    """Move by a step of the command position, without a profile.

    Args:
        port: Port of the axis.
        counts: Signed distance, counts.
        deadband: Distance from the command within which the axis has settled, counts.
        timeout: Simulated seconds to wait.

    Returns:
        The report.

    Raises:
        RunTimeout: The axis does not settle.
    """
    begin = port.axis.time
    port.write_command_position(port.read_command_position() + counts)
    return wait_until_settled(port, begin, counts, deadband, timeout)


def move_by_trapezoid(
    port: ChipPort,
    counts: int,
    *,
    velocity: float = 40_000,
    acceleration: float = 400_000,
    deadband: int = 3,
    timeout: float = 10.0,
) -> ServoMoveReport:
    """Move by a trapezoidal profile.

    Args:
        port: Port of the axis.
        counts: Signed distance, counts.
        velocity: Maximum velocity, counts/s.
        acceleration: Acceleration, counts/s2.
        deadband: Distance from the command within which the axis has settled, counts.
        timeout: Simulated seconds that the profile may take, and that the settling may take.

    Returns:
        The report.

    Raises:
        ArgumentError: The chip does not have these rates at this sample time.
        RunTimeout: The axis does not settle.
    """
    begin, v, a = start_trapezoid(port, counts, velocity, acceleration)
    wait_for_profile_end(port, timeout)
    return wait_until_settled(port, begin, counts, deadband, timeout, (v, a, port.axis.time - begin))


def start_trapezoid(port: ChipPort, counts: int, velocity: float, acceleration: float) -> tuple[float, float, float]:
    """Start a trapezoidal profile, and do not wait for its end.

    Args:
        port: Port of the axis.
        counts: Signed distance, counts.
        velocity: Maximum velocity, counts/s.
        acceleration: Acceleration, counts/s2.

    Returns:
        Time of the start, s; velocity, counts/s, and acceleration, counts/s2, after rounding to the registers.

    Raises:
        ArgumentError: The chip does not have these rates at this sample time.
    """
    v = convert_velocity_to_register(port, velocity, "maximum_velocity", 1)
    a = convert_acceleration_to_register(port, acceleration)
    port.write_quantities(final_position=port.read_command_position() + counts, acceleration=a, maximum_velocity=v)
    begin = port.axis.time
    port.set_control_mode("trapezoid")
    return begin, v / port.sample, a / 256 / port.sample**2


def brake_trapezoid(port: ChipPort) -> None:
    """Slow a trapezoid down to rest at its own acceleration; the axis is then in position control.

    The host may not write the data of a profile while it runs. So it ends the profile (F0) and commands the ramp itself, with a new
    position in each sample. If a sample is too short for this, the axis stops at once.
    """
    if port.t < MINIMUM_T["trapezoid"] + SAFE_MARGIN_COUNTS:
        port.hold_position()
        return
    acceleration, final = port.read_acceleration(), port.read_final_position()
    wait_for_next_sample(port, "trapezoid")
    before, since = port.read_command_position(), port.axis.time
    port.axis.wait(SPEED_SAMPLES * port.sample)
    wait_for_next_sample(port, "trapezoid")
    begin = port.read_command_position()
    speed = abs(begin - before) / round((port.axis.time - since) / port.sample)
    distance = min(speed**2 / (2 * acceleration), abs(final - begin))
    samples = math.ceil(2 * distance / speed) if speed else 0
    rest = 1 - np.arange(1, samples + 1) / max(samples, 1)
    positions = np.rint(np.copysign(distance, final - begin) * (1 - rest**2)).astype(int)
    port.chip.write(FLAG, MODE_FLAGS["trapezoid"])
    if samples:
        port.write_quantities(command_position=begin + int(positions[0]))
        stream_positions([port], positions[1:, None] - positions[0])


def wait_for_profile_end(port: ChipPort, timeout: float) -> None:
    """Wait until the trapezoidal profile has ended or LIMIT has stopped it.

    Args:
        port: Port of the axis.
        timeout: Simulated seconds to wait.

    Raises:
        RunTimeout: The profile was not over after `timeout`.
    """
    port.wait_until(
        lambda: not port.read_status() & PROFILE or port.is_limit_latched(), timeout, "the end of its profile"
    )


def wait_until_settled(
    port: ChipPort,
    begin: float,
    counts: int,
    deadband: int,
    timeout: float,
    rates: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> ServoMoveReport:
    """Wait until the axis has been within the deadband of its command for SETTLED_DWELL_S, or LIMIT has ended the move.

    Args:
        port: Port of the axis.
        begin: Time at which the move began, s.
        counts: Commanded counts of the move.
        deadband: Distance from the command within which the axis has settled, counts.
        timeout: Simulated seconds to wait.
        rates: Velocity, acceleration and end of the profile, for the report.

    Returns:
        The report of the move.

    Raises:
        RunTimeout: The axis does not settle.
    """
    goal, since, error = port.read_command_position(), port.axis.time, 0
    limited = False

    def is_settled() -> bool:
        """Return whether the axis has stayed within the deadband for SETTLED_DWELL_S, or LIMIT has triggered."""
        nonlocal since, error, limited
        error, now = goal - port.read_position(), port.axis.time
        limited = port.is_limit_latched()
        if abs(error) > deadband:
            since = now
        return limited or now - since >= SETTLED_DWELL_S

    port.wait_until(is_settled, timeout, f"rest within {deadband} counts")
    return ServoMoveReport(port.axis.name, counts, *rates, since - begin, error, deadband, limited)


def run_in_proportional_velocity_mode(port: ChipPort, rate: float, seconds: float = 0.5) -> VelocityReport:
    """Turn the motor in proportional velocity mode, then stop it. Nothing integrates the velocity error due to friction.

    Args:
        port: Port of the axis.
        rate: Velocity, counts/s.
        seconds: Time of the run, s.

    Returns:
        The report.

    Raises:
        ArgumentError: The chip does not have this rate at this sample time.
    """
    word = convert_velocity_to_register(port, rate, "proportional_velocity", 16)
    port.wait_for_safe_part_of_sample()
    port.write_quantities(proportional_velocity=0)
    port.set_control_mode("proportional velocity")

    def write_velocity(value: int) -> None:
        """Write the command velocity of the motor, in sixteenths of a count per sample."""
        port.wait_for_safe_part_of_sample("proportional velocity")
        port.write_quantities(proportional_velocity=value)

    write_velocity(word)
    reached = _measure_mean_velocity(port, seconds)
    write_velocity(0)
    port.axis.wait(port.sample)
    port.wait_until(lambda: not port.read_velocity() or port.is_limit_latched(), 2.0, "rest")
    ended = "LIMIT" if port.is_limit_latched() else ""
    if not ended:
        port.hold_position()
    return VelocityReport(port.axis.name, "proportional", word / 16 / port.sample, reached, ended)


def run_in_integral_velocity_mode(
    port: ChipPort, rate: float, seconds: float = 0.5, acceleration: float = 400_000
) -> VelocityReport:
    """Turn the motor in integral velocity mode with ramps, then stop it. The command position advances in each sample.

    Args:
        port: Port of the axis.
        rate: Velocity, counts/s.
        seconds: Time of the run, s.
        acceleration: Acceleration, counts/s2.

    Returns:
        The report.

    Raises:
        ArgumentError: The chip does not have these rates at this sample time.
    """
    word, ramp = start_integral_velocity_mode(port, rate, acceleration)
    port.axis.wait(ramp)
    reached = _measure_mean_velocity(port, seconds)
    ended = "LIMIT" if port.is_limit_latched() else "" if port.read_status() & STOP else "STOP"
    if ended != "LIMIT":
        write_command_velocity(port, 0)
        port.axis.wait(ramp)
        port.set_control_mode("position")
    return VelocityReport(port.axis.name, "integral", word / port.sample, reached, ended)


def start_integral_velocity_mode(port: ChipPort, rate: float, acceleration: float) -> tuple[int, float]:
    """Start the motor in integral velocity mode.

    Args:
        port: Port of the axis.
        rate: Velocity, counts/s.
        acceleration: Acceleration, counts/s2.

    Returns:
        Velocity in the register, counts per sample, and the seconds until the axis reaches it.

    Raises:
        ArgumentError: The chip does not have these rates at this sample time.
    """
    word = convert_velocity_to_register(port, rate, "integral_velocity", 1)
    a = convert_acceleration_to_register(port, acceleration)
    port.clear_status()
    port.write_quantities(acceleration=a, integral_velocity=0)
    port.set_control_mode("integral velocity")
    write_command_velocity(port, word)
    return word, (abs(word) * 256 / a + 2) * port.sample


def write_command_velocity(port: ChipPort, velocity: int) -> None:
    """Write a command velocity for integral velocity mode, counts per sample, in the safe part of a sample."""
    port.wait_for_safe_part_of_sample("integral velocity")
    port.write_quantities(integral_velocity=velocity)


def _measure_mean_velocity(port: ChipPort, seconds: float) -> float:
    """Measure the mean velocity over the second half of `seconds`, counts/s."""
    port.axis.wait(0.5 * seconds)
    begin, first = port.axis.time, port.read_position()
    port.axis.wait(0.5 * seconds)
    return (port.read_position() - first) / (port.axis.time - begin)


def convert_velocity_to_register(port: ChipPort, rate: float, name: str, scale: int) -> int:
    """Convert a velocity to the value of a register.

    Args:
        port: Port of the axis.
        rate: Velocity, counts/s.
        name: Name of the register's number.
        scale: Number of register units in one count per sample.

    Raises:
        ArgumentError: The value does not fit the register, or it is 0.
    """
    return _round_to_register(port, name, rate, port.sample * scale, "speed", "counts/s")


def convert_acceleration_to_register(port: ChipPort, acceleration: float) -> int:
    """Convert an acceleration, counts/s2, to the value of R27:R26. Raises ArgumentError if the value is 0 or too large."""
    return _round_to_register(port, "acceleration", acceleration, port.sample**2 * 256, "acceleration", "counts/s2")


def _round_to_register(port: ChipPort, name: str, requested: float, scale: float, quantity: str, unit: str) -> int:
    """Return `requested` times `scale`, rounded to the integer for a register. Raises ArgumentError if it cannot hold it."""
    rate = requested * scale
    number, value = NUMBERS[name], round(rate) if math.isfinite(rate) else 0
    if value == 0 or not number.minimum <= value <= number.maximum:
        raise ArgumentError(
            f"{requested:g} {unit} are {value} in the register of {name} at samples of {port.sample * 1e6:g} us: "
            f"{max(number.minimum, 1)} to {number.maximum} it holds. Choose another rate, or another T."
        ).with_limit(ExceededLimit(quantity, requested, max(number.minimum, 1) / scale, number.maximum / scale))
    return value
