"""Interpolation of the MCX514: what ends it, single steps, errors and interrupts of the pre-buffer, state in mid-segment."""

import math
from itertools import pairwise

import pytest
from reference.nova_paths import circle_errors, line_errors, points
from reference.nova_profile import SECOND
from support.covers import covers
from support.nova_bench import U, X, Y, Z, command, driving, get, get_signed, load, put
from support.nova_interpolation_bench import DECELERATE, ENOUGH, PERIOD, STEADY, arc, line, prepared, ticks

from stage.chips import MCX514
from stage.chips.nova import core

RAMP = STEADY._replace(SV=1000, DV=8000, AC=50_000)
STOP_SLOW, STOP_NOW, CLEAR_STATUS, SINGLE_STEP, RESET = 0x56, 0x57, 0x79, 0x6F, 0xFF
SP0_E, ALM_E, HLM_E, HLM_M, SLM_E, SLM_M = 0x0002, 0x0200, 0x0800, 0x1000, 0x2000, 0x8000
CERR, HLMT_PLUS, HLMT_MINUS, SLMT_PLUS, E_ALARM, E_EMG = 0x80, 0x04, 0x08, 0x01, 0x10, 0x20
ENDED_STOP0, ENDED_LMT_PLUS, ENDED_LMT_MINUS, ENDED_ALARM, ENDED_EMG = 0x0200, 0x1000, 0x2000, 0x4000, 0x8000
D_STA, D_END = 0x10, 0x80


def set_wr(chip, number, bits, axes):
    command(chip, 0x1F, axes)
    chip.write(number, bits)


def status(chip, number, axis):
    command(chip, 0x1F, axis)
    return chip.read(number)


def assert_over(chip, axes=X | Y):
    assert not driving(chip, axes)
    assert chip.advance(SECOND) == 0


# Ends


def test_a_direction_command_during_a_segment_changes_no_direction_signal():
    chip = prepared()
    set_wr(chip, 3, 1 << 3, X | Y)  # DPMD: pulse and direction
    line(chip, (50, -30))
    chip.advance(10 * PERIOD + PERIOD // 2)
    for code in (0x58, 0x59):  # plus, minus
        command(chip, code, X | Y)
        assert [axis.pins.dir for axis in chip.axes[:2]] == [False, True]  # True: -


@covers("MCX514", "LHK2", "DRVFBRK")
@pytest.mark.parametrize("axis", [X, Y], ids=["main", "other"])
def test_an_instant_stop_of_any_axis_that_takes_part_ends_all(axis):
    chip = prepared()
    line(chip, (1000, 500))
    chip.advance(100 * PERIOD)
    command(chip, STOP_NOW, axis)
    assert_over(chip)
    assert [get_signed(chip, 0x30, a) for a in (X, Y)] == [100, 50]


@covers("MCX514", "LHK2", "DRVSBRK")
@pytest.mark.parametrize("axis", [X, Y], ids=["main", "other"])
def test_a_decelerating_stop_brakes_along_the_line_until_sv(axis):
    chip = prepared(main=RAMP)
    line(chip, (6000, 3000))
    _, steps = ticks(chip, SECOND // 2)
    assert get(chip, 0x32) == 8000
    command(chip, STOP_SLOW, axis)
    when, more = ticks(chip, ENOUGH)
    braked = (8000**2 - 1000**2) / (2 * 50_000)
    assert len(when) == pytest.approx(braked, abs=1)
    assert when[-1] == pytest.approx(SECOND * (8000 - 1000) / 50_000, abs=SECOND / 1000)
    assert max(line_errors(points(steps + more), (6000, 3000))) <= 0.5
    assert_over(chip)


@covers("MCX514", "CHKCCW", "DRVSBRK")
def test_a_decelerating_stop_drops_the_segments_that_wait():
    chip = prepared(main=RAMP)
    arc(chip, (-1000, 0), (0, 0), False)
    for _ in range(3):
        line(chip, (1000, 0))
    chip.advance(SECOND // 2)
    command(chip, STOP_SLOW, Y)
    chip.advance(SECOND)
    assert_over(chip)
    assert chip.read(0) == 0


@covers("MCX514", "LHK2", "DRVSBRK")
def test_a_decelerating_stop_continues_into_the_next_segment():
    chip = prepared(main=RAMP)
    for finish in ((2000, 0), (2000, 1000)):
        line(chip, finish)
    chip.advance(SECOND // 4)
    while chip.axes[0].chip.net(0) < 1900:
        chip.advance(PERIOD)
    command(chip, STOP_SLOW, X)
    chip.advance(SECOND)
    assert 2000 < chip.net(0) < 2600
    assert chip.net(1) == pytest.approx((chip.net(0) - 2000) / 2, abs=0.5)
    assert_over(chip)


@pytest.mark.parametrize(
    ("pin", "wr2", "cause"),
    [("alarm", ALM_E, E_ALARM | ENDED_ALARM), ("lmt_plus", HLM_E, HLMT_PLUS | ENDED_LMT_PLUS)],
)
@pytest.mark.parametrize("axis", [0, 1], ids=["main", "other"])
def test_alarm_or_a_limit_of_any_axis_stops_all_at_once_and_its_status_says_so(axis, pin, wr2, cause):
    chip = prepared()
    set_wr(chip, 2, wr2, X | Y)
    line(chip, (1000, 500))
    chip.advance(100 * PERIOD)
    setattr(chip.axes[axis].pins, pin, True)
    assert_over(chip)
    result = [status(chip, 2, a) for a in (X, Y)]
    assert result[axis] == cause
    assert result[1 - axis] == 0


def test_emergency_stop_ends_the_axes_that_take_part():
    chip = prepared(X | Z)
    line(chip, (1000, 500), X | Z)
    chip.advance(100 * PERIOD)
    chip.set_input_word(chip.AXES, 1)
    assert_over(chip, 0xF)
    assert [status(chip, 2, a) & 0xFFFF for a in (X, Y, Z)] == [E_EMG | ENDED_EMG, 0, E_EMG | ENDED_EMG]


@pytest.mark.parametrize("slow", [False, True], ids=["instant", "decelerating"])
def test_a_stop_input_brakes_and_a_limit_does_as_hlm_m_says(slow):
    chip = prepared(main=RAMP)
    set_wr(chip, 2, HLM_E | (HLM_M if slow else 0), X | Y)
    line(chip, (6000, -6000))
    chip.advance(SECOND // 4)
    chip.axes[1].pins.lmt_minus = True
    more = chip.advance(SECOND)
    assert more == pytest.approx(2 * 630, abs=4) if slow else more == 0
    assert status(chip, 2, Y) == HLMT_MINUS | ENDED_LMT_MINUS
    chip = prepared(main=RAMP)
    set_wr(chip, 2, SP0_E, X | Y)
    line(chip, (6000, -6000))
    chip.advance(SECOND // 4)
    chip.axes[1].pins.stop0 = True
    assert chip.advance(SECOND) == pytest.approx(2 * 630, abs=4)
    assert status(chip, 2, Y) == ENDED_STOP0
    assert_over(chip)


def test_a_limit_stops_an_arc_before_the_first_pulse_towards_it():
    chip = prepared()
    set_wr(chip, 2, HLM_E, X | Y)
    arc(chip, (0, 500), (0, 0), False)  # x rises first, then falls
    chip.axes[0].pins.lmt_minus = True
    _, steps = ticks(chip)
    assert points(steps)[-1][0] == pytest.approx(500, abs=1)
    assert min(x for x, _ in steps) == 0
    assert status(chip, 2, X) == HLMT_MINUS | ENDED_LMT_MINUS


def test_a_limit_of_an_axis_that_rests_stops_nothing():
    chip = prepared()
    set_wr(chip, 2, HLM_E, X | Y)
    chip.axes[1].pins.lmt_plus = True
    line(chip, (100, 0))
    assert chip.advance(ENOUGH) == 100
    line(chip, (100, 1))
    assert_over(chip)


@covers("MCX514", "SP", "LHK2")
@pytest.mark.parametrize("instant", [False, True])
def test_a_software_limit_of_the_other_axis_ends_the_line_where_it_is_passed(instant):
    chip = prepared(main=RAMP)
    set_wr(chip, 2, SLM_E | (SLM_M if instant else 0), Y)
    chip.write(6, 0)
    load(chip, Y, LP=0)
    for code, limit in ((0x0B, 300), (0x0C, -1000)):
        chip.write(6, limit & 0xFFFF)
        chip.write(7, limit >> 16 & 0xFFFF)
        command(chip, code, Y)
    line(chip, (3000, 1500))
    chip.advance(SECOND)
    assert chip.net(1) == 301 if instant else 301 < chip.net(1) < 301 + 330
    assert status(chip, 2, Y) & 0xFF == SLMT_PLUS
    assert_over(chip)


def test_axes_note_their_start_and_end():
    chip = prepared(X | U)
    line(chip, (5, -3), X | U)
    assert [status(chip, 1, a) & (D_STA | D_END) for a in (X, Y, U)] == [D_STA, 0, D_STA]
    chip.advance(ENOUGH)
    assert [status(chip, 1, a) & (D_STA | D_END) for a in (X, Y, U)] == [D_END, 0, D_END]


@covers("MCX514", "RST", "LHK2")
def test_reset_ends_an_interpolation():
    chip = prepared()
    line(chip, (1000, 10))
    line(chip, (1000, 10))
    chip.advance(10 * PERIOD)
    command(chip, RESET, 0)
    assert chip.read(0) == 0
    assert_over(chip)


# While it runs


def test_drives_and_parameters_do_not_disturb_an_interpolation():
    alone, disturbed = prepared(), prepared()
    for chip in (alone, disturbed):
        arc(chip, (-50, 20), (0, 0), True)
    disturbed.advance(30 * PERIOD)
    for axis in (X, Y):
        load(disturbed, axis, TP=77, CP=3)
        command(disturbed, 0x50, axis)
        command(disturbed, 0x52, axis)
        put(disturbed, 0x23, 0x0C, axis)  # H1M: steps 2 and 3
        command(disturbed, 0x5A, axis)  # a home search
    alone.advance(30 * PERIOD)
    assert ticks(alone) == ticks(disturbed)


def test_another_axis_drives_by_itself_meanwhile_and_the_trace_is_in_order():
    chip = prepared(X | Z)
    load(chip, Y, SV=7000, DV=7000, TP=-60)
    line(chip, (100, 40), X | Z)
    command(chip, 0x50, Y)
    trace = chip.trace(SECOND)
    assert [(trace["axis"] == a).sum() for a in range(3)] == [100, 60, 40]
    order = list(zip(trace["clock"].tolist(), trace["axis"].tolist(), strict=True))
    assert order == sorted(order)


def test_a_new_drive_speed_of_the_main_axis_acts_at_once():
    chip = prepared(main=STEADY._replace(SV=1000, DV=5000, AC=1_000_000))
    line(chip, (10_000, 3000))
    chip.advance(SECOND // 10)
    load(chip, X, DV=2500)
    chip.advance(SECOND // 10)
    assert get(chip, 0x32) == 2500
    when, _ = ticks(chip, SECOND // 10)
    assert {b - a for a, b in pairwise(when)} == {SECOND // 2500}


@covers("MCX514", "CLRSTEP", "LHK2")
def test_single_steps_come_by_command_only():
    chip = prepared(ipm=0x200)
    line(chip, (4, 2))
    assert chip.advance(SECOND) == 0
    steps = []
    while driving(chip):
        before = chip.net(0), chip.net(1)
        command(chip, SINGLE_STEP, 0)
        steps.append((chip.net(0) - before[0], chip.net(1) - before[1]))
        assert chip.advance(PERIOD) == 0
    assert sum(x for x, _ in steps) == 4 == len(steps)
    assert sum(y for _, y in steps) == 2


@pytest.mark.parametrize("axis", [X, Y], ids=["main", "other"])
def test_a_decelerating_stop_between_single_steps_ends_the_path_at_once(axis):
    """There is no speed to come down from."""
    chip = prepared(main=RAMP, ipm=0x200)
    line(chip, (40, 20))
    for _ in range(3):
        chip.advance(SECOND // 20)
        command(chip, SINGLE_STEP, 0)
    command(chip, STOP_SLOW, axis)
    assert_over(chip)
    assert chip.net(0) == 3
    command(chip, SINGLE_STEP, 0)
    assert chip.net(0) == 3


# The pre-buffer


def test_a_segment_for_too_few_axes_is_an_error_of_the_pre_buffer_only_while_a_path_is_drawn():
    chip = prepared()
    load(chip, IPM=X)
    command(chip, 0x61, 0)
    assert status(chip, 2, X) == 0
    assert not driving(chip)
    load(chip, IPM=X | Y)
    line(chip, (10, 5))
    load(chip, IPM=X)
    command(chip, 0x61, 0)
    assert status(chip, 2, X) == CERR


def test_a_ninth_segment_is_lost_and_an_error():
    chip = prepared()
    for k in range(9):
        line(chip, (10, k))
    assert status(chip, 2, X) == 0
    line(chip, (100, 0))
    assert status(chip, 2, X) == CERR
    assert chip.read(0) & 0x10
    chip.advance(ENOUGH)
    assert (chip.net(0), chip.net(1)) == (90, sum(range(9)))
    command(chip, CLEAR_STATUS, X)
    assert status(chip, 2, X) == 0


@covers("MCX514", "IPM", "LHK2", "LHK3")
def test_a_segment_for_other_axes_is_lost_and_an_error():
    chip = prepared(X | Y)
    line(chip, (10, 5))
    load(chip, IPM=X | Z)
    command(chip, 0x61, 0)
    assert status(chip, 2, X) == CERR
    load(chip, IPM=X | Y)
    command(chip, CLEAR_STATUS, X)
    command(chip, 0x62, 0)
    assert status(chip, 2, X) == CERR
    assert chip.advance(ENOUGH) == 15


def test_an_interpolation_does_not_start_while_an_axis_drives():
    chip = prepared()
    load(chip, Y, SV=100, DV=100)
    command(chip, 0x52, Y)
    line(chip, (10, 5))
    assert not driving(chip, X)


@pytest.mark.parametrize(("bit", "waiting"), [(0x4000, 3), (0x8000, 7)])
def test_int1_is_asserted_when_segments_leave_the_pre_buffer_until_it_is_cleared(bit, waiting):
    chip = prepared(ipm=bit)
    for _ in range(9):
        line(chip, (10, 1))
    while not chip.output_word(chip.AXES) & 2:
        chip.advance(PERIOD)
        assert driving(chip)
    assert chip.read(0) >> 12 == waiting
    command(chip, SINGLE_STEP, 0)
    assert not chip.output_word(chip.AXES) & 2
    chip.advance(ENOUGH)
    assert not chip.output_word(chip.AXES) & 2


def test_segments_without_a_tick_pass_at_once():
    chip = prepared()
    line(chip, (5, 0))
    line(chip, (0, 0))
    line(chip, (0, 5))
    when, steps = ticks(chip)
    assert when == [PERIOD * k for k in range(1, 11)]
    assert points(steps)[-1] == (5, 5)


@covers("MCX514", "DECEN", "DECDIS", "LHK2")
def test_a_segment_that_slows_ends_at_sv_and_the_next_accelerates_again():
    chip = prepared(main=RAMP)
    command(chip, DECELERATE, 0)
    line(chip, (2000, 0))
    command(chip, 0x6E, 0)
    line(chip, (2000, 0))
    when, _ = ticks(chip)
    rates = [SECOND / (b - a) for a, b in pairwise([0, *when])]
    assert rates[1999] == pytest.approx(1000, rel=0.05)
    assert rates[2001] == pytest.approx(1000, rel=0.2)
    assert max(rates[2000:]) == rates[-1] == pytest.approx(8000, rel=0.01)


# Paths


@pytest.mark.parametrize("finish", [(1000, 300), (-77, 1000), (100, 99)])
def test_equalized_pulses_of_the_short_axis_come_evenly(finish):
    chip = prepared(ipm=0x100)
    line(chip, finish)
    trace = chip.trace(ENOUGH)
    long = max(map(abs, finish))
    for axis, pulses in enumerate(map(abs, finish)):
        clocks = trace["clock"][trace["axis"] == axis].tolist()
        assert len(clocks) == pulses
        gaps = [b - a for a, b in pairwise(clocks)]
        assert max(abs(gap - PERIOD * long / pulses) for gap in gaps) <= PERIOD / 8 + 1


@covers("MCX514", "TX", "R-TX", "IPM")
def test_a_maximum_finish_point_set_by_the_host_reads_back():
    chip = prepared(ipm=0x1000)
    load(chip, X, TP=300)
    put(chip, 0x19, 5000, 0)
    assert get(chip, 0x39, 0) == 5000
    line(chip, (300, 200))
    assert get(chip, 0x39, 0) == 5000


@covers("MCX514", "R-TX")
def test_before_a_line_tx_reads_the_longest_distance_of_the_axes_that_interpolate():
    chip = prepared()
    for axis, pulses in ((X, 300), (Y, -700), (Z, 9000)):
        load(chip, axis, TP=pulses)
    assert get(chip, 0x39, 0) == 700


def test_an_equalized_circle_stays_within_one_lsb_and_closes():
    chip = prepared(ipm=0x100)
    arc(chip, (-120, 35), (0, 0), False)
    _, steps = ticks(chip)
    waveforms = points(steps)
    assert waveforms[-1] == (0, 0)
    assert max(circle_errors(waveforms, (-120, 35))) <= 1


def test_exchanged_axes_mirror_the_arc():
    unmodified, exchanged = prepared(), prepared(ipm=0x10)
    arc(unmodified, (-60, 20), (-60, 20 + round(math.hypot(60, 20))), False)
    arc(exchanged, (20, -60), (20 + round(math.hypot(60, 20)), -60), False)
    assert [(y, x) for x, y in ticks(exchanged)[1]] == ticks(unmodified)[1]


def test_a_full_circle_of_the_largest_radius_is_planned_quickly():
    chip = prepared(main=RAMP)
    command(chip, DECELERATE, 0)
    arc(chip, (1_073_741_823, -1_073_741_823), (0, 0), True)
    assert chip.advance(SECOND // 100) > 0
    command(chip, 0x6B, 0)
    command(chip, STOP_NOW, X)
    command(chip, 0x6B, 0)
    assert get(chip, 0x3B) == 2_147_483_646  # as much as HLV holds


@covers("MCX514", "LHK2", "TX", "R-TX", "MFPC")
def test_the_maximum_finish_point_makes_the_line_slower():
    chip = prepared(ipm=0x1000)
    chip.write(6, 1000)
    chip.write(7, 0)
    command(chip, 0x19, 0)
    line(chip, (500, 250))
    assert get(chip, 0x39, 0) == 1000
    when, steps = ticks(chip)
    assert points(steps)[-1] == (500, 250)
    assert when[-1] in (999 * PERIOD, 1000 * PERIOD)
    command(chip, 0x7C, 0)  # automatic again
    line(chip, (500, 250))
    assert ticks(chip)[0][-1] == 500 * PERIOD


# State


def test_advancing_in_two_pieces_is_advancing_at_once_and_a_snapshot_in_between_changes_nothing():
    uncut, parts = prepared(main=RAMP), prepared(main=RAMP)
    for chip in (uncut, parts):
        arc(chip, (-200, 77), (0, 0), True)
        command(chip, DECELERATE, 0)
        line(chip, (-300, 123))
    clocks = SECOND // 4
    expected = uncut.trace(clocks).tolist()
    for n in (1, PERIOD, clocks // 3):
        one = MCX514()
        one.restore(parts.snapshot())
        result = one.trace(n).tolist()
        two = MCX514()
        two.restore(one.snapshot())
        result += two.trace(clocks - n).tolist()
        assert result == expected
        assert two.snapshot().record == uncut.snapshot().record


def test_two_chips_interpolate_at_the_same_time_without_a_trace_of_each_other():
    alone = [prepared(), prepared(main=RAMP)]
    together = [prepared(), prepared(main=RAMP)]
    for first, second in (alone, together):
        arc(first, (-90, 0), (0, 0), False)
        line(second, (400, -150))
    expected = [chip.trace(SECOND // 8).tolist() for chip in alone]
    result: list[list] = [[], []]
    for _ in range(50):
        for chip, pulses in zip(together, result, strict=True):
            pulses += chip.trace(SECOND // 400).tolist()
    assert result == expected


def run(chip, clocks):
    """Run as a stage does, which reads the mean afterwards."""
    core.run(chip._rows[0], chip.clock + clocks)


def test_the_mean_count_is_exact_where_pulses_are_interpolated():
    chip, replica = (prepared(main=RAMP._replace(DV=90_000, AC=900_000)) for _ in range(2))
    for c in (chip, replica):
        arc(c, (-300, 40), (0, 0), False)
    window = 7001
    while driving(chip):
        before, began = [chip.net(j) for j in range(2)], chip.clock
        run(chip, window)
        pulses = replica.trace(window).tolist()
        for j in range(2):
            exact = (
                before[j]
                + sum(direction * (chip.clock - clock) for clock, axis, direction in pulses if axis == j) / window
            )
            assert core.compute_drive_input(chip._rows[0], j, before[j], window) == pytest.approx(exact, abs=1e-12)
        assert chip.clock == began + window


def test_the_mean_count_distinguishes_interpolated_pulses_from_others():
    chip = prepared()
    run(chip, ENOUGH)
    line(chip, (100, 0))
    run(chip, 100 * PERIOD)
    core.compute_drive_input(chip._rows[0], 0, 0, 100 * PERIOD)
    line(chip, (5, 0))
    run(chip, 5 * PERIOD)
    load(chip, X, TP=45)
    command(chip, 0x50, X)
    run(chip, 45 * PERIOD)
    expected = 105 + 45 - sum(range(1, 6)) / 50 - 45 / 2  # the drive is over: its pulses came evenly over the window
    assert core.compute_drive_input(chip._rows[0], 0, 100, 50 * PERIOD) == pytest.approx(expected)
    run(chip, ENOUGH)
    line(chip, (30, 0))
    run(chip, 31 * PERIOD)
    assert core.compute_drive_input(chip._rows[0], 0, 180, PERIOD) == 180  # nobody asked while they came
