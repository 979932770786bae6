"""Every drive of an MCX514 against the exact reference: pulse by pulse, clock by clock.

PULSESTAGE_EXAMPLES scales the number of random drives, PULSESTAGE_SEED repeats a run.
"""

from itertools import pairwise, product

import pytest
from reference.nova_profile import SECOND, mp
from support.covers import covers
from support.nova_bench import (
    DSNDE,
    SEED,
    Move,
    U,
    X,
    Y,
    assert_move_matches_reference,
    assert_pulses,
    command,
    draw_clock,
    driving,
    examples,
    get,
    get_signed,
    intervene,
    load,
    log_uniform,
    played,
    prepare,
    random_move,
    set_wr3,
    start,
)

from stage.chips import MCX514

MS = SECOND // 1000
ASND, CNST, DSND = 0x10, 0x20, 0x40  # of RR3, page 1
PHASES = {"accelerating": ASND, "constant": CNST, "decelerating": DSND}
LINEAR = Move(SV=1000, DV=7000, AC=1_000_000, P=400)
CURVE = Move(SV=1000, DV=9000, AC=100_000, JK=10_000_000, P=3000, s_curve=True)
NAMED = {
    "constant": Move(SV=1000, DV=1000, P=300),
    "DV below SV": Move(SV=5000, DV=300, P=20),
    "DV below SV, S-curve": Move(SV=5000, DV=300, P=20, s_curve=True),
    "fastest": Move(SV=8_000_000, DV=8_000_000, P=500),
    "slowest": Move(SV=1, DV=1, P=3),
    "one pulse": Move(SV=100, DV=20_000, AC=50_000, P=1),
    "trapezoid": LINEAR,
    "asymmetric trapezoid": LINEAR._replace(DC=300_000, asymmetric=True),
    "asymmetric values without DSNDE": LINEAR._replace(DC=300_000, DJ=7),
    "triangle prevention": LINEAR._replace(P=48, DV=8000),
    "triangle": LINEAR._replace(P=48, DV=8000, triangle_prevention=False),
    "triangle of odd pulses": LINEAR._replace(P=35, DV=8000, triangle_prevention=False),
    "asymmetric triangle prevention": LINEAR._replace(P=90, DV=20_000, DC=2_500_000, asymmetric=True),
    "asymmetric triangle": LINEAR._replace(P=90, DV=20_000, DC=300_000, asymmetric=True, triangle_prevention=False),
    "S-curve with a linear part": CURVE,
    "S-curve without": CURVE._replace(AC=0x1FFFFFFF, JK=3184),
    "S-curve without a linear part that just touches AC": CURVE._replace(AC=200_000, JK=5_000_000),
    "short S-curve": CURVE._replace(P=300),
    "short S-curve, prevention off": CURVE._replace(P=300, triangle_prevention=False),
    "asymmetric S-curve": CURVE._replace(DC=70_000, DJ=5_000_000, asymmetric=True),
    "short asymmetric S-curve": CURVE._replace(DC=70_000, DJ=5_000_000, P=250, asymmetric=True),
    "manual point": LINEAR._replace(DP=350),
    "manual point early": LINEAR._replace(DP=200),
    "manual point late": LINEAR._replace(DP=395),
    "manual point in the ramp": LINEAR._replace(DP=10),
    "manual point 0": LINEAR._replace(DP=0),
    "manual point behind the end": LINEAR._replace(DP=500),
    "manual point in a rising S-curve": CURVE._replace(DP=200),
    "AO": LINEAR._replace(AO=8),
    "AO of a short move": LINEAR._replace(P=48, DV=8000, AO=12),
    "AO of an S-curve": CURVE._replace(AO=50),
    "negative AO": LINEAR._replace(AO=-5),
    "AO beyond the move": LINEAR._replace(AO=500),
}
named = pytest.mark.parametrize("move", NAMED.values(), ids=NAMED)


# Fixed pulses


@named
@pytest.mark.parametrize("minus", [False, True], ids=["plus", "minus"])
def test_named_drives_are_the_references(move, minus):
    chip = MCX514()
    assert_move_matches_reference(chip, move, minus=minus)
    assert get_signed(chip, 0x30) == (-move.P if minus else move.P)


def test_round_speeds_put_each_pulse_on_its_own_round_clock():
    for speed, period in ((1000, 16_000), (10_000, 1600), (16_000, 1000), (8_000_000, 2), (1, 16_000_000)):
        chip = MCX514()
        began = start(chip, Move(SV=speed, DV=speed, P=40))
        assert (chip.trace(40 * period)["clock"] - began).tolist() == [period * k for k in range(1, 41)]
        assert not driving(chip)


def test_round_points_of_a_linear_ramp_are_on_round_clocks():
    chip = MCX514()
    began = start(chip, LINEAR._replace(P=None))
    clocks = chip.trace(6 * MS)["clock"] - began
    assert len(clocks) == 24
    assert clocks[[3, 11, 23]].tolist() == [2 * MS, 4 * MS, 6 * MS]


def test_a_drive_of_no_pulses_ends_at_once():
    chip = MCX514()
    start(chip, LINEAR._replace(P=0))
    assert not driving(chip)
    assert chip.advance(SECOND) == 0


def test_any_fixed_pulse_drive_is_the_references():
    for rng in examples(0.15):
        assert_move_matches_reference(MCX514(), random_move(rng, fixed=True), minus=rng.random() < 0.5)


@covers("MCX514", "DP")
def test_the_deceleration_begins_after_the_pulses_of_the_manual_point():
    chip = MCX514()
    began = start(chip, LINEAR._replace(DP=200))
    command(chip, 0x7B)
    last = int(chip.make_replica().trace(SECOND)["clock"][199])
    chip.advance(last - began - 1)
    assert chip.read(3) & (ASND | CNST | DSND) == CNST
    chip.advance(2)
    assert chip.read(3) & (ASND | CNST | DSND) == DSND


def test_n_drv_falls_with_the_last_pulse():
    chip = MCX514()
    start(chip, LINEAR)
    end = LINEAR.reference().end_clock
    chip.advance(end - 1)
    assert driving(chip)
    assert chip.advance(1) == 1
    assert not driving(chip)


def test_counter_relative_and_absolute_drives_are_the_same_drive():
    for code, target, sign in ((0x51, 400, -1), (0x51, -400, 1), (0x54, 700, 1), (0x54, -100, -1)):
        chip = MCX514()
        load(chip, LP=300)
        prepare(chip, LINEAR)
        load(chip, TP=target)
        command(chip, code)
        pulses = played(chip, (), LINEAR.reference().end_clock)
        assert_pulses([clock for clock, _ in pulses], LINEAR.reference(), f"{code:02X}h to {target}")
        assert get_signed(chip, 0x30) == 300 + 400 * sign


def test_axes_drive_at_the_same_time_with_separate_parameters():
    chip = MCX514()
    prepare(chip, LINEAR, X)
    prepare(chip, CURVE, U)
    load(chip, X, TP=LINEAR.P)
    load(chip, U, TP=-CURVE.P)
    command(chip, 0x50, X | U)
    trace = chip.trace(CURVE.reference().end_clock)
    assert_pulses(trace["clock"][trace["axis"] == 0].tolist(), LINEAR.reference(), "X")
    assert_pulses(trace["clock"][trace["axis"] == 3].tolist(), CURVE.reference(), "U")
    assert not driving(chip)


def test_parameters_written_to_several_axes_at_once_reach_each():
    chip = MCX514()
    start(chip, LINEAR, X | Y)
    trace = chip.trace(LINEAR.reference().end_clock)
    for axis in (0, 1):
        assert_pulses(trace["clock"][trace["axis"] == axis].tolist(), LINEAR.reference(), f"axis {axis}")


# Interventions


@pytest.mark.parametrize("kind", ["up", "down"])
def test_a_new_drive_speed_acts_at_once_in_any_phase(kind):
    for rng in examples(0.1):
        move = random_move(rng)
        interventions, drive = [], move.reference()
        for _ in range(rng.randint(1, 3)):
            clock = draw_clock(rng, drive)
            if interventions and clock < interventions[-1][0]:
                continue
            low, high = (drive.DV, 3 * drive.DV) if kind == "up" else (move.SV, drive.DV)
            interventions.append((clock, "DV", log_uniform(rng, int(low), int(high))))
            drive = move.reference(*interventions)
        until = None if move.P else interventions[-1][0] + 1000 * SECOND // int(drive.DV)
        assert_move_matches_reference(MCX514(), move, interventions, until=until)


DOUBLED = [(0, "accelerating"), (1, "constant"), (2, "decelerating")]


@pytest.mark.parametrize("s_curve", [False, True], ids=["linear", "S-curve"])
@pytest.mark.parametrize("dv", [3000, 20_000])
@pytest.mark.parametrize(("index", "phase"), DOUBLED, ids=[phase for _, phase in DOUBLED])
def test_a_new_drive_speed_acts_at_once_in_each_phase(index, phase, dv, s_curve):
    move = CURVE._replace(s_curve=s_curve)
    unmodified = move.reference()
    clock = next(int((p.t + p.length / 2) * SECOND) for p in unmodified.pieces if p.phase == phase)
    assert_move_matches_reference(MCX514(), move, [(clock, "DV", dv)])


def test_a_drive_speed_lowered_shortly_before_the_deceleration_point_still_lets_the_drive_end_at_sv():
    """The point lies where the S-curve to the new speed is about to flatten."""
    move = Move(SV=13, DV=46, AC=246, DC=246, JK=4589, DJ=1835, P=22, s_curve=True, asymmetric=True)
    assert_move_matches_reference(MCX514(), move, [(5_492_589, "DV", 25)])


@pytest.mark.parametrize("clock", [2 * MS, 8 * MS], ids=["accelerating", "constant"])
def test_writing_the_present_value_changes_nothing(clock):
    """In a short move with triangle prevention, too."""
    short = LINEAR._replace(P=48, DV=8000)
    assert short.reference((clock, "P", 48)).pulse_clocks() == short.reference().pulse_clocks()
    for what, value in (("P", short.P), ("DV", short.DV)):
        assert_move_matches_reference(MCX514(), short, [(clock, what, value)])


def test_triangle_prevention_holds_for_a_drive_speed_raised_in_motion():
    for clock in (1, 2 * MS, 8 * MS):
        assert_move_matches_reference(MCX514(), LINEAR._replace(P=100, DV=4000), [(clock, "DV", 20_000)])


def test_a_new_output_pulse_number_acts_at_once():
    for rng in examples(0.1):
        move = random_move(rng, fixed=True)._replace(DP=None)
        clock = draw_clock(rng, move.reference())
        assert_move_matches_reference(
            MCX514(), move, [(clock, "P", log_uniform(rng, 1, 4000))], minus=rng.random() < 0.5
        )


@pytest.mark.parametrize("passed", [1, 50, 99])
@pytest.mark.parametrize("minus", [False, True], ids=["plus", "minus"])
def test_a_target_already_passed_stops_the_drive_at_once(minus, passed):
    move = LINEAR
    clock = move.reference().pulse_clocks()[99] + 7
    chip = MCX514()
    assert_move_matches_reference(chip, move, [(clock, "P", passed)], minus=minus)
    assert abs(get_signed(chip, 0x30)) == 100


def test_the_end_of_a_counter_relative_drive_can_be_moved_too():
    chip = MCX514()
    prepare(chip, LINEAR)
    load(chip, TP=400)
    command(chip, 0x51)
    pulses = played(chip, [(30 * MS, "P", 500)], SECOND)
    assert_pulses([c for c, _ in pulses], LINEAR.reference((30 * MS, "P", 500)), "51h")


def test_a_decelerating_stop_brakes_to_sv_from_any_phase():
    for rng in examples(0.1):
        move = random_move(rng)
        clock = draw_clock(rng, move.reference())
        drive = assert_move_matches_reference(MCX514(), move, [(clock, "slow")])
        assert drive.end_clock is not None


@pytest.mark.parametrize(
    "move",
    [LINEAR._replace(AO=80), CURVE._replace(AO=80), LINEAR._replace(DP=200)],
    ids=["AO", "AO of an S-curve", "DP"],
)
def test_a_decelerating_stop_ends_the_creep_at_sv(move):
    """Written while the drive creeps, or in the ramp-down before."""
    drive = move.reference()
    creep = drive.pieces[-1]
    for clock in (int(creep.t * SECOND) - 10, int(creep.t * SECOND) + 5 * MS):
        stopped = assert_move_matches_reference(MCX514(), move, [(clock, "slow")])
        assert stopped.end_clock < drive.end_clock


def test_an_instant_stop_ends_the_drive_at_its_clock_in_any_phase():
    for rng in examples(0.06):
        move = random_move(rng)
        clock = draw_clock(rng, move.reference())
        chip = MCX514()
        start(chip, move)
        pulses = [c for c, _ in played(chip, [(clock, "stop")], clock)]
        assert not driving(chip)
        assert chip.advance(SECOND) == 0
        assert_pulses(pulses, move.reference((clock, "stop")), f"{move} {clock} PULSESTAGE_SEED={SEED}")


@pytest.mark.parametrize("s_curve", [False, True], ids=["linear", "S-curve"])
@pytest.mark.parametrize("what", ["slow", "stop"])
@pytest.mark.parametrize("phase", PHASES)
def test_both_stops_act_in_each_phase(phase, what, s_curve):
    move = CURVE._replace(s_curve=s_curve)
    clock = next(int((p.t + p.length / 2) * SECOND) for p in move.reference().pieces if p.phase == phase)
    assert_move_matches_reference(MCX514(), move, [(clock, what)])


@covers("MCX514", "IV", "VINC", "VDEC")
def test_iv_steps_the_drive_speed():
    move = LINEAR._replace(P=2000)
    for (code, sign), clock in product([(0x70, 1), (0x71, -1)], (3 * MS, 20 * MS)):
        chip = MCX514()
        load(chip, IV=1500)
        start(chip, move)
        pulses = played(chip, [(clock, "IV")], SECOND, lambda chip, what, code=code: command(chip, code))
        drive = move.reference((clock, "DV", 7000 + sign * 1500))
        assert_pulses([c for c, _ in pulses], drive, f"{code:X}h at {clock}")


@covers("MCX514", "SV", "AC", "DC", "JK", "DJ", "AO")
@pytest.mark.parametrize("name", ["SV", "AC", "DC", "JK", "DJ"])
def test_other_parameters_act_at_the_next_drive(name):
    chip, move = MCX514(), CURVE._replace(asymmetric=True)
    start(chip, move)
    pulses = played(
        chip, [(10 * MS, name)], move.reference().end_clock, lambda chip, what: load(chip, **{name: 33_333})
    )
    assert_pulses([c for c, _ in pulses], move.reference(), f"{name} written in motion")
    command(chip, 0x50)
    changed = move._replace(**{name: 33_333})
    pulses = played(chip, (), changed.reference().end_clock)
    assert_pulses([c for c, _ in pulses], changed.reference(), f"{name} at the next drive")


def test_wr3_written_in_motion_acts_at_the_next_drive():
    chip, move = MCX514(), LINEAR._replace(DC=300_000)
    start(chip, move)
    pulses = played(chip, [(2 * MS, "WR3")], move.reference().end_clock, lambda chip, what: set_wr3(chip, DSNDE))
    assert_pulses([c for c, _ in pulses], move.reference(), "DSNDE written in motion")


# Advancing and looking


def test_advancing_in_pieces_is_advancing_at_once():
    for rng in examples(0.06):
        move = random_move(rng, fixed=True)
        drive = move.reference()
        one, many = MCX514(), MCX514()
        for chip in (one, many):
            start(chip, move)
        cuts = sorted(rng.randint(0, drive.end_clock) for _ in range(rng.randint(1, 12)))
        pieces = [b - a for a, b in pairwise([0, *cuts, drive.end_clock + 5])]
        uncut = one.trace(sum(pieces))["clock"].tolist()
        assert [c for n in pieces for c in many.trace(n)["clock"].tolist()] == uncut, f"{move} {pieces}"
        assert one.snapshot().record == many.snapshot().record, f"{move} {pieces}"


def test_advance_counts_what_trace_lists():
    for rng in examples(0.04):
        move = random_move(rng, fixed=True)
        clock = rng.randint(0, move.reference().end_clock)
        one, other = MCX514(), MCX514()
        for chip in (one, other):
            start(chip, move)
        assert one.advance(clock) == len(other.trace(clock)), f"{move} {clock}"
        assert one.snapshot().record == other.snapshot().record, f"{move} {clock}"


@covers("MCX514", "CV", "CA")
def test_speed_acceleration_and_phase_read_as_the_profile_says():
    for rng in examples(0.1):
        move = random_move(rng)
        chip, drive = MCX514(), move.reference()
        interventions = []
        if rng.random() < 0.5:
            interventions = [(draw_clock(rng, drive), "DV", log_uniform(rng, int(move.SV) + 1, 3 * int(move.DV)))]
            drive = move.reference(*interventions)
        samples = sorted(draw_clock(rng, drive) for _ in range(8))
        start(chip, move)
        start_clock = chip.clock
        for clock in samples:
            while interventions and interventions[0][0] <= clock:
                at, *what = interventions.pop()
                chip.advance(start_clock + at - chip.clock)
                intervene(chip, *what)
            chip.advance(start_clock + clock - chip.clock)
            assert_shows(chip, drive, clock, f"{move} at {clock}: {drive.phase(clock)} PULSESTAGE_SEED={SEED}")


def assert_shows(chip, drive, clock, note):
    if drive.end_clock is not None and clock >= drive.end_clock:
        return
    assert abs(get(chip, 0x32) - drive.speed(clock)) <= 1, note
    if min((abs(clock - boundary) for boundary in drive.boundaries()), default=mp.inf) < 2:
        return  # at a boundary either side may be shown
    assert abs(get(chip, 0x33) - abs(drive.acceleration(clock))) <= 1, note
    command(chip, 0x7B)
    assert chip.read(3) & (ASND | CNST | DSND) == PHASES[drive.phase(clock)], note
    pins = chip.axes[0].pins
    assert [pins.asnd, pins.cnst, pins.dsnd] == [bit == PHASES[drive.phase(clock)] for bit in (ASND, CNST, DSND)], note


def test_looking_changes_nothing():
    for rng in examples(0.04):
        move = random_move(rng, fixed=True)
        chip = MCX514()
        began, clocks = start(chip, move), []
        end = move.reference().end_clock
        while chip.clock < began + end:
            step = min(rng.randint(1, end), began + end - chip.clock)
            clocks += (chip.trace(step)["clock"] - began).tolist()
            for code in (0x30, 0x32, 0x33, 0x45, 0x7A, 0x7B):
                get(chip, code)
        assert_pulses(clocks, move.reference(), f"{move} PULSESTAGE_SEED={SEED}")
