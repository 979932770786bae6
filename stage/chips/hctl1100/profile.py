"""HCTL-1100, compiled: the profile generator, which moves the command position once a sample. Velocities in 256ths of counts.

    trapezoid          integral velocity
       ____                 ______ R3C
      /    \\               /      \\
    _/      \\_           _/        \\___ STOP
"""

from __future__ import annotations

from stage.chips.hctl1100 import maps
from stage.chips.hctl1100.state import F0, signed
from stage.native import greatest, hot, least


@hot
def acceleration(c):
    """256ths of counts per sample2."""
    return c.reg[maps.WHOLE] << 8 | c.reg[maps.FRACTION]


@hot
def final_position(c):
    """R2B to R29, sign extended."""
    return signed(c.reg[maps.FINAL_HIGH] << 16 | c.reg[maps.FINAL_MIDDLE] << 8 | c.reg[maps.FINAL_LOW], 24)


@hot
def _move(c, direction):
    """Move the command position by `way`, round the 24 bits."""
    at = (c.command << 8 | c.fraction) + direction
    c.command, c.fraction = signed(at >> 8, 24), at & 0xFF


@hot
def _braking(v, a):
    """The way of v - a, v - 2 a ... as long as they are above 0."""
    n = (v - 1) // a
    return n * v - a * (n * (n + 1) // 2)


@hot
def trapezoid(c):
    """One sample of a move to the final position: faster as long as the rest allows to brake then."""
    a, goal = acceleration(c), final_position(c)
    rest = ((goal - c.command) << 8) - c.fraction
    direction, v = (1 if rest >= 0 else -1), abs(c.velocity)
    if a:
        faster = least(v + a, c.reg[maps.MAX_VELOCITY] << 8)
        v = faster if abs(rest) - faster >= _braking(faster, a) else greatest(v - a, a)
    if v >= abs(rest):
        c.command, c.fraction, c.velocity = goal, 0, 0
        c.flag &= ~F0
        return
    c.velocity = direction * v
    _move(c, c.velocity)


@hot
def integral(c):
    """One sample at the command velocity, or on the ramp towards it. STOP makes it 0."""
    if c.stopped:
        c.reg[maps.INTEGRAL_VELOCITY] = 0
    goal, a = signed(c.reg[maps.INTEGRAL_VELOCITY], 8) << 8, acceleration(c)
    c.velocity = least(c.velocity + a, goal) if c.velocity < goal else greatest(c.velocity - a, goal)
    _move(c, c.velocity)
