"""The control laws of the HCTL-1100, which run once a sample; compiled.

    MC(n) = (256 K X(n) - A K X(n-1) - 4 B MC(n-1)) / 1024      D(z) = K (z - A/256) / 4 (z + B/256)

and in proportional velocity mode MC(n) = K/4 Y(n). Divisions round down. The command is limited, and the law remembers the limited
value.
"""

from __future__ import annotations

from stage.chips.hctl1100 import motor, profile
from stage.chips.hctl1100.encoder import read_count
from stage.chips.hctl1100.maps import GAIN, INTEGRAL_VELOCITY, POLE, PROPORTIONAL_HIGH, PROPORTIONAL_LOW, ZERO
from stage.chips.hctl1100.state import (
    CONTROL,
    INTEGRAL,
    MIN_TIMER_VALUES,
    PROPORTIONAL,
    TRAPEZOID,
    find_control_mode,
    to_signed,
)
from stage.chips.hctl1100.timer import CLOCKS_PER_COUNT
from stage.native import hot


@hot
def clear_history(c):
    """Clear what the control law remembers of earlier samples."""
    c.error = c.output = c.velocity = c.fraction = c.computing_until = 0
    c.last_count = read_count(c)


@hot
def _compute_command(c, x):
    """Compute the motor command MC(n) for the position error X(n) = x."""
    k = c.reg[GAIN]
    return motor.clip_command(c, (256 * k * x - c.reg[ZERO] * k * c.error - 4 * c.reg[POLE] * c.output) >> 10)


@hot
def _compute_velocity_command(c):
    """Compute the motor command MC(n) of proportional velocity control. The velocity is in 16ths of counts, as R24, R23 are."""
    y = to_signed(c.reg[PROPORTIONAL_HIGH] << 8 | c.reg[PROPORTIONAL_LOW], 16) - 16 * c.actual_velocity
    return motor.clip_command(c, (c.reg[GAIN] * y) >> 6)


@hot
def run_sample(c):
    """Run the control law of one sample, at its first clock.

    Returns:
        Whether the sample has changed nothing. In that case no later sample changes anything, as long as the shaft rests and
        the host writes nothing.
    """
    mode, count = find_control_mode(c.flag_bits), read_count(c)
    command, fraction, velocity, error, output = c.command, c.fraction, c.velocity, c.error, c.output
    still = c.shaft_rate == 0.0 and count == c.last_count and mode != TRAPEZOID
    c.computing_until = c.clock + CLOCKS_PER_COUNT * MIN_TIMER_VALUES[mode]
    if mode == PROPORTIONAL:
        c.actual_velocity = to_signed(count - c.last_count, 16)
        c.output = _compute_velocity_command(c)
    else:
        if mode == TRAPEZOID:
            profile.run_trapezoid_sample(c)
        elif mode == INTEGRAL:
            profile.run_integral_sample(c)
        x = to_signed(c.command - (count - c.position_origin), 24)
        c.output = _compute_command(c, x)
        c.error = x
    c.last_count = count
    motor.set_command(c, c.output)
    still = still and c.command == command and c.fraction == fraction and c.velocity == velocity
    return still and c.error == error and c.output == output


@hot
def _is_computing(c):
    """Return whether the chip still computes the control law of the present sample."""
    return c.mode == CONTROL and c.clock < c.computing_until


@hot
def apply_early_position(c, command):
    """Apply a command position that the host wrote before the computation of the sample was finished.

    The law runs once more with the new low byte and the old upper bytes; the ports keep its result until the next sample.
    """
    if _is_computing(c) and find_control_mode(c.flag_bits) != PROPORTIONAL:
        torn = c.command & ~0xFF | command & 0xFF
        motor.set_command(c, _compute_command(c, to_signed(torn - (c.last_count - c.position_origin), 24)))


@hot
def apply_early_velocity(c, mode):
    """Apply a command velocity that the host wrote before the computation of the sample was finished.

    If the velocity is that of the present mode, its law runs once more: in proportional velocity mode with the bytes as they
    are now, in integral velocity mode with the new velocity in place of the velocity that the ramp has reached.
    """
    if not _is_computing(c) or find_control_mode(c.flag_bits) != mode:
        return
    if mode == PROPORTIONAL:
        motor.set_command(c, _compute_velocity_command(c))
    else:
        jump = ((to_signed(c.reg[INTEGRAL_VELOCITY], 8) << 8) - c.velocity) >> 8
        motor.set_command(c, _compute_command(c, to_signed(c.error + jump, 24)))
