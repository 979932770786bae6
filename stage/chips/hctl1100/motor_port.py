"""Motor command of the HCTL-1100 at its two outputs, the 8-bit port R08 and the PWM port R09; compiled."""

from __future__ import annotations

from stage.chips.hctl1100.state import F2, INHIBIT, NEVER, PULSE_ON, SIGN
from stage.native import greatest, hot, least

FULL_DRIVE = 100
PWM_PERIOD = 100  # clocks


@hot
def clip_command(chip, value):
    """Limit a motor command to the range of the motor ports: -128 to 127, or 0 to 127 if F2 selects unipolar commands."""
    return least(greatest(value, 0 if chip.flag_bits & F2 else -128), 127)


@hot
def _drive_motor(chip, value):
    """Drive the motor of the HCTL-1100 with a command from now on."""
    if chip.status & INHIBIT and chip.motor_command * value < 0:
        chip.pulse_off_until = chip.clock + PWM_PERIOD
    chip.motor_command = value


@hot
def set_command(chip, value):
    """Put a motor command on both motor ports of the HCTL-1100."""
    chip.port = chip.pwm = value
    _drive_motor(chip, value)


@hot
def write_port(chip, value):
    """Execute a write to the motor port R08."""
    chip.port = value
    _drive_motor(chip, value)


@hot
def write_pwm(chip, value):
    """Execute a write to the PWM port R09."""
    chip.pwm = value
    _drive_motor(chip, value)


@hot
def clip_to_full_drive(drive):
    """Limit a motor command to +-100, hundredths of full drive: the PWM is fully on at 100 and above."""
    return least(greatest(drive, -FULL_DRIVE), FULL_DRIVE)


@hot
def integrate_motor_command(chip, until):
    """Integrate the motor command over the clocks up to `until`; the stage computes the mean command from the integral."""
    live = until - greatest(chip.clock, least(chip.pulse_off_until, until))
    chip.drive_integral += clip_to_full_drive(chip.motor_command) * live


@hot
def _compute_pulse_width(chip):
    """Return the number of clocks of each PWM period for which PULSE is on."""
    return abs(clip_to_full_drive(chip.pwm))


@hot
def compute_pins(chip):
    """Compute the levels of the pins SIGN and PULSE of the HCTL-1100.

    PULSE is on from the start of each period of 100 clocks, for as many clocks as the command has hundredths. The first period
    begins at clock 0.
    """
    word = SIGN if chip.pwm < 0 else 0
    return word | (
        PULSE_ON if chip.clock % PWM_PERIOD < _compute_pulse_width(chip) and chip.clock >= chip.pulse_off_until else 0
    )


@hot
def find_next_pulse_edge(chip):
    """Return the next clock at which PULSE may change, if no sample and no bus write comes before it."""
    on, period_start = _compute_pulse_width(chip), chip.clock - chip.clock % PWM_PERIOD
    if on == 0 or (on == PWM_PERIOD and chip.clock >= chip.pulse_off_until):
        return NEVER
    return period_start + on if chip.clock < period_start + on else period_start + PWM_PERIOD
