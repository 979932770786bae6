"""HCTL-1100: the commutator, INDEX and Align."""

import re

import numpy as np
import pytest
from support.hctl1100_bench import SAMPLE, bench, position, write_all
from support.hctl1100_programs import ALIGN, COMMAND, IDLE, begin, clear_flags, word

FOUR, FULL = 0x02, 0x04


def commutator(x, y, phases=3, status=0, offset=0, maximum=0, timer=0):
    """Make a chip whose commutator ring fits X and Y."""
    return bench(
        [(0x07, status | (FOUR if phases == 4 else 0)), (0x18, phases * (x + y)), (0x1A, x), (0x1B, y)],
        [(0x1C, offset & 0xFF), (0x1F, maximum), (0x19, timer)],
    )


def phases(chip):
    return "".join(name[-1].upper() for name in ("pha", "phb", "phc", "phd") if getattr(chip.pins, name))


def turn(chip, counts):
    """Return the phases at each of these encoder counts."""
    observed = []
    for count in counts:
        chip.encoder = count
        observed.append(phases(chip))
    return observed


def test_three_phases_follow_each_other_x_alone_and_y_together():
    chip = commutator(x=2, y=1)
    cycle = ["A", "A", "AB", "B", "B", "BC", "C", "C", "AC"]
    assert turn(chip, range(18)) == cycle * 2
    assert turn(chip, range(-9, 0)) == cycle
    assert not chip.diagnostics


def test_four_phases():
    chip = commutator(x=1, y=1, phases=4)
    assert turn(chip, range(8)) == ["A", "AB", "B", "BC", "C", "CD", "D", "AD"]


def test_a_motor_of_two_phases_takes_the_four_outputs_in_turn():
    """Two windings, each driven both ways: A and C one, B and D the other; they are never on together without overlap."""
    chip = commutator(x=3, y=0, phases=4)
    assert turn(chip, range(12)) == ["A"] * 3 + ["B"] * 3 + ["C"] * 3 + ["D"] * 3


def test_full_counts_are_four_quadrature_counts():
    chip = commutator(x=2, y=1, status=FULL)
    assert turn(chip, range(36)) == [p for p in ["A", "A", "AB", "B", "B", "BC", "C", "C", "AC"] for _ in range(4)]


@pytest.mark.parametrize("offset", [-5, -1, 0, 1, 4])
def test_the_offset_shifts_the_commutation_cycle(offset):
    unmodified, turned = commutator(x=2, y=1), commutator(x=2, y=1, offset=offset)
    assert turn(turned, range(20)) == turn(unmodified, range(offset, 20 + offset))


def test_a_ring_of_0_drives_no_phase():
    assert turn(bench([(0x1A, 3)]), range(5)) == [""] * 5
    assert turn(bench([(0x18, 3)]), range(5)) == [""] * 5


def test_index_resets_the_ring_when_it_becomes_asserted():
    chip = commutator(x=2, y=1)
    chip.encoder = 4
    assert phases(chip) == "B"
    chip.pins.index = True
    assert phases(chip) == "A"
    chip.encoder = 7
    assert phases(chip) == "B"
    chip.pins.index = False
    assert phases(chip) == "B"
    assert position(chip) == 7, "the actual position knows nothing of it"


@pytest.mark.parametrize(("rate", "shift"), [(0.0, 0), (0.01, 3), (-0.01, -3), (0.05, 8), (-0.05, -8)])
def test_the_phase_advance_is_the_distance_in_the_time_of_its_timer_up_to_the_maximum(rate, shift):
    """Time 16 (19 + 1) = 320 clocks."""
    chip = commutator(x=4, y=3, maximum=8, timer=19)
    chip.set_shaft(0.5, rate)
    unmodified = commutator(x=4, y=3)
    unmodified.encoder = shift
    assert phases(chip) == phases(unmodified)


def test_a_held_commutator_stops_and_resumes_from_its_count():
    chip = commutator(x=2, y=1)
    chip.encoder = 3
    chip.write(0x00, 0x0C)
    assert turn(chip, range(3, 12)) == ["B"] * 9
    chip.write(0x1C, 3)
    assert phases(chip) == "C", "stepped by the offset"
    chip.write(0x1C, 0)
    chip.write(0x00, 0x04)
    assert turn(chip, range(11, 17)) == ["B", "B", "BC", "C", "C", "AC"]


def test_a_commutator_of_full_counts_resumes_from_its_held_count():
    chip = commutator(x=2, y=1, status=FULL)
    chip.encoder = 12
    chip.write(0x00, 0x0C)
    assert turn(chip, range(12, 40)) == ["B"] * 28
    chip.write(0x00, 0x04)
    assert turn(chip, range(39, 52)) == ["B"] * 8 + ["BC"] * 4 + ["C"]


def test_index_resets_a_held_commutator_which_resumes_from_0():
    chip = commutator(x=2, y=1)
    chip.encoder = 3
    chip.write(0x00, 0x0C)
    chip.pins.index = True
    assert phases(chip) == "A"
    chip.encoder = 100
    chip.write(0x00, 0x04)
    assert turn(chip, range(100, 106)) == ["A", "A", "AB", "B", "B", "BC"]


def test_the_waveforms_have_every_change_of_the_phases():
    chip = commutator(x=2, y=1)
    chip.set_shaft(0.5, 0.01)
    journal = chip.journal()
    chip.advance(2000)
    journal.close()
    edges = journal.replay_waveforms().edges
    changes = edges["clock"][1:-1]
    assert len(changes) == 13
    assert (np.diff(changes) % 100 == 0).all()


# --- Align ---


def aligning(phases=3):
    chip = commutator(x=2, y=1, phases=phases)
    write_all(chip, clear_flags(), [(0x13, 0)], word(COMMAND, 0), [(0x05, ALIGN)])
    assert not chip.diagnostics
    return chip


@pytest.mark.parametrize(("count", "last"), [(3, "C"), (4, "D")])
def test_align_energises_the_first_phase_then_the_last_then_position_control_begins(count, last):
    chip = aligning(count)
    assert not chip.pins.init
    assert chip.read(0x08) == 0xFF
    chip.advance(2048 * SAMPLE - 1)
    assert phases(chip) == "A"
    chip.advance(1)
    assert phases(chip) == last
    chip.advance(2048 * SAMPLE - 1)
    assert phases(chip) == last
    chip.encoder = -2
    chip.advance(1)
    assert phases(chip) == "A", "the ring is at 0 where the rotor was left"
    assert chip.motor_command == 0
    chip.advance(SAMPLE)
    assert chip.motor_command == 0x40 * 2 // 4, "position control to 0"


def test_align_can_be_left():
    for leave in (lambda chip: chip.write(0x05, IDLE), lambda chip: setattr(chip.pins, "limit", True)):
        chip = aligning()
        chip.advance(100 * SAMPLE)
        leave(chip)
        assert chip.pins.init
        assert chip.motor_command == 0
        chip.advance(5000 * SAMPLE)
        assert chip.pins.init


@pytest.mark.parametrize(
    ("first", "message"),
    [
        ([(0x18, 0)], "by the commutator, whose ring R18 is 0"),
        (word(COMMAND, 5), "both positions 0"),
        ([(0x00, 0x08)], "F0, F3, F5 clear"),
        ([(0x18, 10)], r"the ring R18 = 10 is not 3 \(X \+ Y\) = 3 \(2 \+ 1\)"),
    ],
)
def test_an_align_that_cannot_come_out_right_has_a_diagnostic(first, message):
    chip = commutator(x=2, y=1)
    write_all(chip, first)
    chip.diagnostics.clear()
    chip.write(0x05, ALIGN)
    assert re.search(message, chip.diagnostics[0].message)


def test_a_commutator_whose_offset_and_advance_leave_eight_bits_has_a_diagnostic():
    chip = commutator(x=20, y=10, offset=0, maximum=0)
    write_all(chip, begin("position"))
    assert "leaves -128 to 127" in chip.diagnostics[0].message
    for x, y, offset, maximum, good in [
        (20, 10, -20, 10, True), (20, 10, -18, 10, True), (20, 10, -18, 11, False), (20, 10, -17, 10, False),
        (1, 0, -128, 4, True), (1, 0, -128, 5, False), (1, 0, 127, 0, False), (2, 0, -128, 9, True), (2, 0, -128, 10, False),
    ]:  # fmt: skip
        chip = commutator(x=x, y=y, offset=offset, maximum=maximum)
        write_all(chip, begin("position"))
        assert (not chip.diagnostics) == good, (x, y, offset, maximum)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("maximum", [0, 3, 5])
def test_a_fast_shaft_advances_the_phase_by_at_most_r1f_in_both_directions(direction, maximum):
    """As an offset by R1F would, at rest."""
    for count in range(12):
        fast, still = bench(), bench()
        for chip, offset in ((fast, 0), (still, direction * maximum)):
            for address, value in (
                (0x18, 12),
                (0x1A, 1),
                (0x1B, 3),
                (0x19, 255),
                (0x1F, maximum),
                (0x1C, offset & 0xFF),
            ):
                chip.write(address, value)
        fast.set_shaft(float(count), direction / 4)
        still.set_shaft(float(count), 0.0)
        assert [getattr(fast.pins, f"ph{k}") for k in "abcd"] == [getattr(still.pins, f"ph{k}") for k in "abcd"]
