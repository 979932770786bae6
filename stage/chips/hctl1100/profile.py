"""The profile generator of the HCTL-1100, which moves the command position once a sample; compiled.

Velocities are in 256ths of counts per sample.

    trapezoid          integral velocity
       ____                 ______ R3C
      /    \\               /      \\
    _/      \\_           _/        \\___ STOP
"""

from __future__ import annotations

from stage.chips.hctl1100 import maps
from stage.chips.hctl1100.state import F0, to_signed
from stage.native import greatest, hot, least


@hot
def read_acceleration(c):
    """Return the acceleration R27, R26 in 256ths of counts per sample squared."""
    return c.reg[maps.ACCELERATION_WHOLE] << 8 | c.reg[maps.ACCELERATION_FRACTION]


@hot
def read_final_position(c):
    """Return the final position R2B to R29, sign extended."""
    return to_signed(c.reg[maps.FINAL_HIGH] << 16 | c.reg[maps.FINAL_MIDDLE] << 8 | c.reg[maps.FINAL_LOW], 24)


@hot
def _move_command_position(c, direction):
    """Move the command position by 256ths of counts; it wraps at 24 bits."""
    at = (c.command << 8 | c.fraction) + direction
    c.command, c.fraction = to_signed(at >> 8, 24), at & 0xFF


@hot
def _compute_braking_distance(v, a):
    """Return the distance in which velocity v falls to 0 in steps of a: the sum of v - a, v - 2 a ... above 0."""
    n = (v - 1) // a
    return n * v - a * (n * (n + 1) // 2)


@hot
def run_trapezoid_sample(c):
    """Run one sample of a move to the final position: accelerate as long as the remaining distance allows the chip to brake."""
    a, goal = read_acceleration(c), read_final_position(c)
    rest = ((goal - c.command) << 8) - c.fraction
    direction, v = (1 if rest >= 0 else -1), abs(c.velocity)
    if a:
        faster = least(v + a, c.reg[maps.MAX_VELOCITY] << 8)
        v = faster if abs(rest) - faster >= _compute_braking_distance(faster, a) else greatest(v - a, a)
    if v >= abs(rest):
        c.command, c.fraction, c.velocity = goal, 0, 0
        c.flag_bits &= ~F0
        return
    c.velocity = direction * v
    _move_command_position(c, c.velocity)


@hot
def run_integral_sample(c):
    """Run one sample at the integral command velocity, or on the ramp to it. STOP sets this velocity to 0."""
    if c.stop_triggered:
        c.reg[maps.INTEGRAL_VELOCITY] = 0
    goal, a = to_signed(c.reg[maps.INTEGRAL_VELOCITY], 8) << 8, read_acceleration(c)
    c.velocity = least(c.velocity + a, goal) if c.velocity < goal else greatest(c.velocity - a, goal)
    _move_command_position(c, c.velocity)
