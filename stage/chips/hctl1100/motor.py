"""HCTL-1100, compiled: the motor command at its two ports, the 8-bit port R08 and the PWM port R09."""

from __future__ import annotations

from stage.chips.hctl1100.state import F2, INHIBIT, NEVER, PULSE_ON, SIGN
from stage.native import greatest, hot, least

FULL_DRIVE = 100
PWM_PERIOD = 100  # clocks


@hot
def clipped(c, value):
    """A motor command as the ports can hold it; F2 leaves one sign."""
    return least(greatest(value, 0 if c.flag & F2 else -128), 127)


@hot
def _drive(c, value):
    """Drive the motor with a command from now on."""
    if c.status & INHIBIT and c.drive * value < 0:
        c.dead = c.clock + PWM_PERIOD
    c.drive = value


@hot
def command(c, value):
    """Put a command on both ports."""
    c.port = c.pwm = value
    _drive(c, value)


@hot
def to_port(c, value):
    """A write to R08."""
    c.port = value
    _drive(c, value)


@hot
def to_pwm(c, value):
    """A write to R09."""
    c.pwm = value
    _drive(c, value)


@hot
def share(drive):
    """The part of full drive that a command is, in hundredths: the PWM is full at 100 and beyond."""
    return least(greatest(drive, -FULL_DRIVE), FULL_DRIVE)


@hot
def spend(c, until):
    """The motor is driven until then."""
    live = until - greatest(c.clock, least(c.dead, until))
    c.moment += share(c.drive) * live


@hot
def _on(c):
    """Clocks of a PWM period for which PULSE is on."""
    return abs(share(c.pwm))


@hot
def pins(c):
    """SIGN and PULSE: on for the command's share of every period of 100 clocks, from its start on, the first period at clock 0."""
    word = SIGN if c.pwm < 0 else 0
    return word | (PULSE_ON if c.clock % PWM_PERIOD < _on(c) and c.clock >= c.dead else 0)


@hot
def next_edge(c):
    """The clock after now at which PULSE may turn on or off, were there no sample and no bus write."""
    on, period_start = _on(c), c.clock - c.clock % PWM_PERIOD
    if on == 0 or (on == PWM_PERIOD and c.clock >= c.dead):
        return NEVER
    return period_start + on if c.clock < period_start + on else period_start + PWM_PERIOD
