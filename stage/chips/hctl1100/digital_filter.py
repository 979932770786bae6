"""Control laws of the HCTL-1100, compiled: each sample computes the motor command from the position or velocity error.

    MC(n) = (256 K X(n) - A K X(n-1) - 4 B MC(n-1)) / 1024      D(z) = K (z - A/256) / 4 (z + B/256)

and in proportional velocity mode MC(n) = K/4 Y(n). X is the position error, Y the velocity error, K the gain, A the zero, B the
pole. Divisions round down. The command is limited, and the limited value is the MC(n-1) of the next sample.
"""

from __future__ import annotations

from stage.chips.hctl1100 import motion_profile, motor_port
from stage.chips.hctl1100.encoder import read_count
from stage.chips.hctl1100.maps import GAIN, INTEGRAL_VELOCITY, POLE, PROPORTIONAL_HIGH, PROPORTIONAL_LOW, ZERO
from stage.chips.hctl1100.sample_timer import CLOCKS_PER_COUNT
from stage.chips.hctl1100.state import (
    CONTROL,
    INTEGRAL,
    MIN_TIMER_VALUES,
    PROPORTIONAL,
    TRAPEZOID,
    find_control_mode,
    to_signed,
)
from stage.native import hot


@hot
def clear_history(chip):
    """Clear the values of earlier samples that the control law uses, X(n-1) and MC(n-1)."""
    chip.error = chip.output = chip.velocity = chip.fraction = chip.computing_until = 0
    chip.last_count = read_count(chip)


@hot
def _compute_command(chip, position_error):
    """Compute the motor command MC(n) for the position error X(n), in counts."""
    k = chip.reg[GAIN]
    return motor_port.clip_command(
        chip, (256 * k * position_error - chip.reg[ZERO] * k * chip.error - 4 * chip.reg[POLE] * chip.output) >> 10
    )


@hot
def _compute_velocity_command(chip):
    """Compute the motor command MC(n) of proportional velocity control, with velocities in 16ths of counts per sample."""
    y = to_signed(chip.reg[PROPORTIONAL_HIGH] << 8 | chip.reg[PROPORTIONAL_LOW], 16) - 16 * chip.actual_velocity
    return motor_port.clip_command(chip, (chip.reg[GAIN] * y) >> 6)


@hot
def run_sample(chip):
    """Run the control law of one sample, at its first clock.

    Returns:
        Whether the sample has changed nothing. In that case no later sample changes anything, as long as the shaft rests and
        the host writes nothing.
    """
    mode, count = find_control_mode(chip.flag_bits), read_count(chip)
    command, fraction, velocity, error, output = chip.command, chip.fraction, chip.velocity, chip.error, chip.output
    still = chip.shaft_rate == 0.0 and count == chip.last_count and mode != TRAPEZOID
    chip.computing_until = chip.clock + CLOCKS_PER_COUNT * MIN_TIMER_VALUES[mode]
    if mode == PROPORTIONAL:
        chip.actual_velocity = to_signed(count - chip.last_count, 16)
        chip.output = _compute_velocity_command(chip)
    else:
        if mode == TRAPEZOID:
            motion_profile.run_trapezoid_sample(chip)
        elif mode == INTEGRAL:
            motion_profile.run_integral_sample(chip)
        x = to_signed(chip.command - (count - chip.position_origin), 24)
        chip.output = _compute_command(chip, x)
        chip.error = x
    chip.last_count = count
    motor_port.set_command(chip, chip.output)
    still = still and chip.command == command and chip.fraction == fraction and chip.velocity == velocity
    return still and chip.error == error and chip.output == output


@hot
def _is_computing(chip):
    """Return whether the chip still computes the control law of the present sample."""
    return chip.mode == CONTROL and chip.clock < chip.computing_until


@hot
def apply_position_written_during_computation(chip, command):
    """Apply a command position that the host wrote before the computation of the sample was finished.

    The control law runs once more with the new low byte and the old upper bytes. The ports keep this result until the next sample.
    """
    if _is_computing(chip) and find_control_mode(chip.flag_bits) != PROPORTIONAL:
        torn = chip.command & ~0xFF | command & 0xFF
        motor_port.set_command(
            chip, _compute_command(chip, to_signed(torn - (chip.last_count - chip.position_origin), 24))
        )


@hot
def apply_velocity_written_during_computation(chip, mode):
    """Apply a command velocity that the host wrote before the computation of the sample was finished.

    If the present mode uses this velocity, its control law runs once more: in proportional velocity mode with the present bytes, in
    integral velocity mode with the new velocity in place of the velocity that the ramp has reached.
    """
    if not _is_computing(chip) or find_control_mode(chip.flag_bits) != mode:
        return
    if mode == PROPORTIONAL:
        motor_port.set_command(chip, _compute_velocity_command(chip))
    else:
        jump = ((to_signed(chip.reg[INTEGRAL_VELOCITY], 8) << 8) - chip.velocity) >> 8
        motor_port.set_command(chip, _compute_command(chip, to_signed(chip.error + jump, 24)))
