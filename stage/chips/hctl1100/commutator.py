"""The commutator and the Align mode of the HCTL-1100, compiled.

The ring is a counter of encoder counts modulo R18. With the offset and the phase advance it selects the phases:

    PHA ####==            #    X alone, Y (=) with the next phase
    PHB     ==####==
    PHC           ==####==     ring = phases (X + Y)
"""

from __future__ import annotations

from stage.chips.hctl1100 import filter as law
from stage.chips.hctl1100 import motor
from stage.chips.hctl1100.encoder import compute_filtered_rate, read_count
from stage.chips.hctl1100.maps import MAX_ADVANCE, OFFSET, PHASE_TIMER, RING, X, Y
from stage.chips.hctl1100.state import ALIGN, CONTROL, F4, FOUR, FULL, PHA, to_signed
from stage.native import greatest, hot, least

ALIGN_SAMPLES = 2048  # of each of two phases
ALIGN_COMMAND = 127


@hot
def count_phases(c):
    """Return the number of motor phases, 3 or 4."""
    return 4 if c.status & FOUR else 3


@hot
def _encoder_counts_per_ring_count(c):
    """Return how many encoder counts move the ring by one: 4 if it counts full counts, else 1."""
    return 4 if c.status & FULL else 1


@hot
def compute_ring_position(c):
    """Compute the count of the ring, before the modulo by its length R18."""
    return c.ring_position if c.flag_bits & F4 else (read_count(c) - c.ring_origin) // _encoder_counts_per_ring_count(c)


@hot
def restart_ring(c):
    """Set the count of the ring to 0."""
    c.ring_origin, c.ring_position = read_count(c), 0


@hot
def hold_ring(c):
    """Store the count of the ring, at which it stays while F4 is set. Call it before F4 is set."""
    c.ring_position = compute_ring_position(c)


@hot
def release_ring(c):
    """Let the ring count on from the count that it was held at. Call it before F4 is cleared."""
    c.ring_origin = read_count(c) - c.ring_position * _encoder_counts_per_ring_count(c)


@hot
def compute_phase_advance(c):
    """Compute the counts of the ring that the shaft turns during the time of R19, limited to +-R1F."""
    turned = compute_filtered_rate(c) * (16.0 * (c.reg[PHASE_TIMER] + 1)) / _encoder_counts_per_ring_count(c)
    max_advance = float(c.reg[MAX_ADVANCE])
    return int(least(greatest(turned, -max_advance), max_advance))


@hot
def compute_phase_pins(c):
    """Compute the levels of the pins PHA to PHD."""
    last = count_phases(c) - 1
    if c.mode == ALIGN:
        return PHA if c.aligning > ALIGN_SAMPLES else PHA << last
    ring, slot = c.reg[RING], c.reg[X] + c.reg[Y]
    if ring == 0 or slot == 0:
        return 0
    at = (compute_ring_position(c) + to_signed(c.reg[OFFSET], 8) + compute_phase_advance(c)) % ring
    k = at // slot % (last + 1)
    word = PHA << k
    return word | PHA << (k + 1) % (last + 1) if at % slot >= c.reg[X] else word


@hot
def start_align(c):
    """Start the Align mode (R05 = 02h): the first phase, then the last phase, pull the rotor to the index mark."""
    c.mode, c.aligning = ALIGN, 2 * ALIGN_SAMPLES
    motor.set_command(c, ALIGN_COMMAND)


@hot
def run_align_sample(c):
    """Run one sample of Align. After the last one the ring is at 0, and the control mode begins."""
    c.aligning -= 1
    if c.aligning == 0:
        restart_ring(c)
        c.mode = CONTROL
        law.clear_history(c)
        motor.set_command(c, 0)
