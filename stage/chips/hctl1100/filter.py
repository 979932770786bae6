"""HCTL-1100, compiled: the control laws, once a sample.

    MC(n) = (256 K X(n) - A K X(n-1) - 4 B MC(n-1)) / 1024      D(z) = K (z - A/256) / 4 (z + B/256)

and in proportional velocity MC(n) = K/4 Y(n). Divisions round down; the result is clipped, and so is what is remembered of it.
"""

from __future__ import annotations

from stage.chips.hctl1100 import motor, profile
from stage.chips.hctl1100.encoder import raw
from stage.chips.hctl1100.maps import GAIN, INTEGRAL_VELOCITY, POLE, PROPORTIONAL_HIGH, PROPORTIONAL_LOW, ZERO
from stage.chips.hctl1100.state import CONTROL, INTEGRAL, MIN_T, PROPORTIONAL, TRAPEZOID, control_mode, signed
from stage.chips.hctl1100.timer import STEP
from stage.native import hot


@hot
def enter(c):
    """Nothing is remembered of what was before."""
    c.error = c.output = c.velocity = c.fraction = c.computing = 0
    c.last = raw(c)


@hot
def _law(c, x):
    """MC(n) for X(n) = x."""
    k = c.reg[GAIN]
    return motor.clipped(c, (256 * k * x - c.reg[ZERO] * k * c.error - 4 * c.reg[POLE] * c.output) >> 10)


@hot
def _velocity_law(c):
    """MC(n) of proportional velocity: the command is 12.4, so the velocity counts in 16ths, too."""
    y = signed(c.reg[PROPORTIONAL_HIGH] << 8 | c.reg[PROPORTIONAL_LOW], 16) - 16 * c.speed
    return motor.clipped(c, (c.reg[GAIN] * y) >> 6)


@hot
def sample(c):
    """The control law of one sample, at its first clock. Whether nothing has changed: then, as long as the shaft stands, and nobody
    interferes, no later sample changes anything."""
    mode, count = control_mode(c.flag), raw(c)
    command, fraction, velocity, error, output = c.command, c.fraction, c.velocity, c.error, c.output
    still = c.rate == 0.0 and count == c.last and mode != TRAPEZOID
    c.computing = c.clock + STEP * MIN_T[mode]
    if mode == PROPORTIONAL:
        c.speed = signed(count - c.last, 16)
        c.output = _velocity_law(c)
    else:
        if mode == TRAPEZOID:
            profile.trapezoid(c)
        elif mode == INTEGRAL:
            profile.integral(c)
        x = signed(c.command - (count - c.zero), 24)
        c.output = _law(c, x)
        c.error = x
    c.last = count
    motor.command(c, c.output)
    still = still and c.command == command and c.fraction == fraction and c.velocity == velocity
    return still and c.error == error and c.output == output


@hot
def _computes(c):
    """The law of the present sample is at work."""
    return c.mode == CONTROL and c.clock < c.computing


@hot
def tear(c, command):
    """A command position written too early: the law runs once more with its low byte and the upper bytes of before, and the ports
    hold that until the next sample."""
    if _computes(c) and control_mode(c.flag) != PROPORTIONAL:
        torn = c.command & ~0xFF | command & 0xFF
        motor.command(c, _law(c, signed(torn - (c.last - c.zero), 24)))


@hot
def tear_velocity(c, mode):
    """The command velocity of a mode, written too early: if that is the mode, its law runs once more, in proportional velocity with
    the bytes as they are just now, in integral velocity with the new velocity in place of the ramp's."""
    if not _computes(c) or control_mode(c.flag) != mode:
        return
    if mode == PROPORTIONAL:
        motor.command(c, _velocity_law(c))
    else:
        jump = ((signed(c.reg[INTEGRAL_VELOCITY], 8) << 8) - c.velocity) >> 8
        motor.command(c, _law(c, signed(c.error + jump, 24)))
