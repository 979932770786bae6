"""The commutator and the Align mode of the HCTL-1100, compiled.

The ring is a counter of encoder counts modulo R18. With the offset and the phase advance it selects the phases:

    PHA ####==            #    X alone, Y (=) with the next phase
    PHB     ==####==
    PHC           ==####==     ring = phases (X + Y)
"""

from __future__ import annotations

from stage.chips.hctl1100 import digital_filter as law
from stage.chips.hctl1100 import motor_port
from stage.chips.hctl1100.encoder import compute_filtered_rate, read_count
from stage.chips.hctl1100.maps import MAX_ADVANCE, OFFSET, PHASE_TIMER, RING, X, Y
from stage.chips.hctl1100.state import ALIGN, CONTROL, F4, FOUR, FULL, PHA, to_signed
from stage.native import greatest, hot, least

ALIGN_SAMPLES = 2048  # of each of two phases
ALIGN_COMMAND = 127


@hot
def count_phases(chip):
    """Return the number of motor phases that the HCTL-1100's commutator drives, 3 or 4."""
    return 4 if chip.status & FOUR else 3


@hot
def _compute_encoder_counts_per_ring_count(chip):
    """Return the number of encoder counts that move the ring by one: 4 if the ring counts full counts, else 1."""
    return 4 if chip.status & FULL else 1


@hot
def compute_unwrapped_ring_count(chip):
    """Compute the count of the commutation ring before the modulo by the ring's length R18."""
    return (
        chip.ring_position
        if chip.flag_bits & F4
        else (read_count(chip) - chip.ring_origin) // _compute_encoder_counts_per_ring_count(chip)
    )


@hot
def restart_ring(chip):
    """Set the count of the HCTL-1100's commutation ring to 0."""
    chip.ring_origin, chip.ring_position = read_count(chip), 0


@hot
def hold_ring(chip):
    """Hold the commutation ring at its present count while F4 is set. Call this before F4 is set."""
    chip.ring_position = compute_unwrapped_ring_count(chip)


@hot
def release_ring(chip):
    """Let the commutation ring continue from the count at which it was held. Call this before F4 is cleared."""
    chip.ring_origin = read_count(chip) - chip.ring_position * _compute_encoder_counts_per_ring_count(chip)


@hot
def compute_phase_advance(chip):
    """Compute the phase advance: ring counts that the shaft turns during the time of R19, limited to +-R1F."""
    turned = (
        compute_filtered_rate(chip)
        * (16.0 * (chip.reg[PHASE_TIMER] + 1))
        / _compute_encoder_counts_per_ring_count(chip)
    )
    max_advance = float(chip.reg[MAX_ADVANCE])
    return int(least(greatest(turned, -max_advance), max_advance))


@hot
def compute_phase_pins(chip):
    """Compute the levels of the pins PHA to PHD."""
    last = count_phases(chip) - 1
    if chip.mode == ALIGN:
        return PHA if chip.aligning > ALIGN_SAMPLES else PHA << last
    ring, slot = chip.reg[RING], chip.reg[X] + chip.reg[Y]
    if ring == 0 or slot == 0:
        return 0
    at = (compute_unwrapped_ring_count(chip) + to_signed(chip.reg[OFFSET], 8) + compute_phase_advance(chip)) % ring
    k = at // slot % (last + 1)
    word = PHA << k
    return word | PHA << (k + 1) % (last + 1) if at % slot >= chip.reg[X] else word


@hot
def start_align(chip):
    """Start the Align mode (R05 = 02h): the first phase, then the last phase, pull the rotor to the index mark."""
    chip.mode, chip.aligning = ALIGN, 2 * ALIGN_SAMPLES
    motor_port.set_command(chip, ALIGN_COMMAND)


@hot
def run_align_sample(chip):
    """Run one sample of the Align mode. After its last sample the ring is at 0, and the control mode begins."""
    chip.aligning -= 1
    if chip.aligning == 0:
        restart_ring(chip)
        chip.mode = CONTROL
        law.clear_history(chip)
        motor_port.set_command(chip, 0)
