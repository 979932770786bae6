"""The profile generator of the HCTL-1100, which moves the command position once a sample; compiled.

Velocities are in 256ths of counts per sample, accelerations in 256ths of counts per sample squared.

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
def read_acceleration(chip):
    """Return the acceleration R27, R26 in 256ths of counts per sample squared."""
    return chip.reg[maps.ACCELERATION_WHOLE] << 8 | chip.reg[maps.ACCELERATION_FRACTION]


@hot
def read_final_position(chip):
    """Return the final position R2B to R29, sign extended."""
    return to_signed(chip.reg[maps.FINAL_HIGH] << 16 | chip.reg[maps.FINAL_MIDDLE] << 8 | chip.reg[maps.FINAL_LOW], 24)


@hot
def _move_command_position(chip, distance):
    """Move the command position by a signed distance in 256ths of counts. The position wraps at 24 bits."""
    at = (chip.command << 8 | chip.fraction) + distance
    chip.command, chip.fraction = to_signed(at >> 8, 24), at & 0xFF


@hot
def _compute_braking_distance(velocity, acceleration):
    """Return the distance in 256ths of counts in which `velocity` falls to 0 if each sample reduces it by `acceleration`."""
    n = (velocity - 1) // acceleration
    return n * velocity - acceleration * (n * (n + 1) // 2)


@hot
def run_trapezoid_sample(chip):
    """Run one sample of a move to the final position: accelerate as long as the remaining distance allows the chip to brake."""
    a, goal = read_acceleration(chip), read_final_position(chip)
    rest = ((goal - chip.command) << 8) - chip.fraction
    direction, v = (1 if rest >= 0 else -1), abs(chip.velocity)
    if a:
        faster = least(v + a, chip.reg[maps.MAX_VELOCITY] << 8)
        v = faster if abs(rest) - faster >= _compute_braking_distance(faster, a) else greatest(v - a, a)
    if v >= abs(rest):
        chip.command, chip.fraction, chip.velocity = goal, 0, 0
        chip.flag_bits &= ~F0
        return
    chip.velocity = direction * v
    _move_command_position(chip, chip.velocity)


@hot
def run_integral_sample(chip):
    """Run one sample of integral velocity control, on the ramp to the command velocity or at it. STOP sets this velocity to 0."""
    if chip.stop_triggered:
        chip.reg[maps.INTEGRAL_VELOCITY] = 0
    goal, a = to_signed(chip.reg[maps.INTEGRAL_VELOCITY], 8) << 8, read_acceleration(chip)
    chip.velocity = least(chip.velocity + a, goal) if chip.velocity < goal else greatest(chip.velocity - a, goal)
    _move_command_position(chip, chip.velocity)
