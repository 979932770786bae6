"""The motor command of the HCTL-1100 at its two ports, the 8-bit port R08 and the PWM port R09; compiled."""

from __future__ import annotations

from stage.chips.hctl1100.state import F2, INHIBIT, NEVER, PULSE_ON, SIGN
from stage.native import greatest, hot, least

FULL_DRIVE = 100
PWM_PERIOD = 100  # clocks


@hot
def clip_command(c, value):
    """Limit a motor command to what the ports hold, -128 to 127, or 0 to 127 if F2 selects unipolar commands."""
    return least(greatest(value, 0 if c.flag_bits & F2 else -128), 127)


@hot
def _drive_motor(c, value):
    """Drive the motor with a command from now on."""
    if c.status & INHIBIT and c.motor_command * value < 0:
        c.pulse_off_until = c.clock + PWM_PERIOD
    c.motor_command = value


@hot
def set_command(c, value):
    """Put a motor command on both ports."""
    c.port = c.pwm = value
    _drive_motor(c, value)


@hot
def write_port(c, value):
    """Execute a write to the motor port R08."""
    c.port = value
    _drive_motor(c, value)


@hot
def write_pwm(c, value):
    """Execute a write to the PWM port R09."""
    c.pwm = value
    _drive_motor(c, value)


@hot
def clip_to_full_drive(drive):
    """Limit a motor command to +-100, hundredths of full drive: the PWM is fully on at 100 and above."""
    return least(greatest(drive, -FULL_DRIVE), FULL_DRIVE)


@hot
def accumulate_drive(c, until):
    """Add the motor command, times the clocks up to `until`, to the integral that gives the mean for the stage."""
    live = until - greatest(c.clock, least(c.pulse_off_until, until))
    c.drive_integral += clip_to_full_drive(c.motor_command) * live


@hot
def _compute_pulse_width(c):
    """Return for how many clocks of each PWM period PULSE is on."""
    return abs(clip_to_full_drive(c.pwm))


@hot
def compute_pins(c):
    """Compute the levels of SIGN and PULSE.

    PULSE is on from the start of each period of 100 clocks, for as many clocks as the command has hundredths. The first period
    begins at clock 0.
    """
    word = SIGN if c.pwm < 0 else 0
    return word | (PULSE_ON if c.clock % PWM_PERIOD < _compute_pulse_width(c) and c.clock >= c.pulse_off_until else 0)


@hot
def find_next_pulse_edge(c):
    """Return the next clock at which PULSE may change, if no sample and no bus write comes before it."""
    on, period_start = _compute_pulse_width(c), c.clock - c.clock % PWM_PERIOD
    if on == 0 or (on == PWM_PERIOD and c.clock >= c.pulse_off_until):
        return NEVER
    return period_start + on if c.clock < period_start + on else period_start + PWM_PERIOD
