"""One line by several MCX514: pulses against a slow reference, stops of one chip that stop all, copies, recordings, a driver."""

import copy
import pickle

import numpy as np
import pytest
from reference.nova_multichip import pulses
from reference.nova_profile import SECOND
from support.covers import covers
from support.many_axes import rail_model
from support.nova_bench import SEED, Move, U, X, Y, Z, command, driving, examples, get, load, log_uniform, prepare, put

from stage import Fleet, Program, Stage, firmware
from stage.chips import MCX501, MCX512, MCX514
from stage.chips.journal import GrowingJournalReplay
from stage.errors import ArgumentError

MASTER, SLAVE, TX_GIVEN = 1 << 10, 2 << 10, 1 << 12
LINES, DECELERATE, CLEAR_STATUS, CLEAR_LONGEST, PAGE_1 = (None, 0x60, 0x61, 0x62, 0x63), 0x6D, 0x79, 0x7C, 0x7B
MCERR, ALL = 1 << 12, X | Y | Z | U
HLM_E, HLM_M, SLM_E, ALM_E, SLM_M = 0x0800, 0x1000, 0x2000, 0x0200, 0x8000
STEADY = Move(SV=10_000, DV=10_000)
PERIOD = SECOND // 10_000


def stage_of(*counts, bus_cycle=0.0, chip=MCX514, **options):
    """A stage with so many axes on each chip, whose chips are wired together; nothing of a bus cycle takes time."""
    makers = [lambda: chip() for _ in counts]
    names = [f"a{k}" for k in range(sum(counts))]
    of_axis = [maker for maker, n in zip(makers, counts, strict=True) for _ in range(n)]
    first = [names[sum(counts[:k])] for k in range(len(counts))]
    wiring = {"multichip": first} | options
    return Stage(rail_model(len(names)), chips=dict(zip(names, of_axis, strict=True)), bus_cycle=bus_cycle, **wiring)


@pytest.fixture(scope="module")
def five():
    """Axes 0 to 2 on the first chip, 3 and 4 on the second."""
    return stage_of(3, 2)


@pytest.fixture
def pair(five):
    five.reset()
    prepare(five.chips[0], STEADY)
    return five, *five.chips


def ready(chip, finish, ipm, go=True):
    """Write finish points and IPM, and then the command."""
    for axis, value in zip((X, Y, Z, U), finish, strict=False):
        load(chip, axis, TP=value)
    load(chip, IPM=(1 << len(finish)) - 1 | ipm)
    if go:
        command(chip, LINES[len(finish)], 0)


def begin(stage, *finish, ipm=0):
    """The chips' finish points; slaves first. The clock at which all begin."""
    master, *slaves = stage.chips
    for chip, points in zip(slaves, finish[1:], strict=True):
        ready(chip, points, SLAVE | ipm)
    command(master, DECELERATE, 0)
    ready(master, finish[0], MASTER | ipm)
    return master.clock


def nets(chip):
    return [chip.net(j) for j in range(4)]


def failed(chip):
    command(chip, PAGE_1, X)
    return bool(chip.read(3) & MCERR)


def pass_clocks(stage, clocks):
    stage.run(clocks / SECOND)


def pulse_count(journal, since):
    """List (clock since then, direction) of the pulses of a journal."""
    edges = journal.replay_waveforms(every_pulse=True).edges
    steps = np.diff(edges["net"], prepend=edges["net"][0])
    at = np.flatnonzero(steps)
    return list(zip((edges["clock"][at] - since).tolist(), steps[at].tolist(), strict=True))


# The pulses


def random_speeds(rng, max_length):
    sv = log_uniform(rng, 2_000, 20_000)
    return Move(
        SV=sv,
        DV=sv + log_uniform(rng, 1, 60_000),
        AC=log_uniform(rng, 100_000, 20_000_000),
        JK=log_uniform(rng, 100_000_000, 0x3FFFFFFF),
        s_curve=rng.random() < 0.4,
        P=max_length,
    )


def drawn(stage, rng):
    """A random line from rest: what the reference says, and what the journals of all axes do."""
    master = stage.chips[0]
    counts = [sum(axis.chip is chip for axis in stage.axes.values()) for chip in stage.chips]
    reach = log_uniform(rng, 1, 300)
    finish = [
        [rng.choice([-1, 1]) * log_uniform(rng, 1, reach) * (rng.random() < 0.85) for _ in range(n)] for n in counts
    ]
    finish[rng.randrange(len(finish))][0] = reach * rng.choice([-1, 1])
    max_finish_point = reach + rng.randint(0, 60) if rng.random() < 0.2 else 0
    for chip in stage.chips:
        load(chip, IPM=0)
        chip.write(6, max_finish_point)
        chip.write(7, 0)
        command(chip, 0x19 if max_finish_point else CLEAR_LONGEST, 0)
    move = random_speeds(rng, max(reach, max_finish_point))
    prepare(master, move)
    stage.run(rng.randint(1, 900) * 1e-7)
    journals = [[chip.journal(axis=j) for j in range(n)] for chip, n in zip(stage.chips, counts, strict=True)]
    since = begin(stage, *finish, ipm=TX_GIVEN if max_finish_point else 0)
    drive = move.reference()
    pass_clocks(stage, drive.end_clock + 200)
    note = f"{finish} TX {max_finish_point} {move} PULSESTAGE_SEED={SEED}"
    assert not any(driving(chip, ALL) for chip in stage.chips), note
    for group in journals:
        for journal in reversed(group):
            journal.close()
    result = [[pulse_count(journal, since) for journal in group] for group in journals]
    expected = pulses(finish, drive.pulse_times(), max_finish_point)
    for i, chip in enumerate(expected):
        for j, axis in enumerate(chip):
            assert result[i][j] == axis, f"chip {i} axis {j}: {first_difference(result[i][j], axis)}\n{note}"


def first_difference(a, b):
    return next(((k, x, y) for k, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), (len(a), len(b)))


@covers("MCX514", "LHK1", "LHK2", "LHK3", "TX", "MFPC")
def test_random_lines_of_several_chips_are_those_of_the_reference(five):
    for stage, share in ((five, 0.1), (stage_of(1, 1, 1), 0.05), (stage_of(2, 1, chip=MCX512), 0.05)):
        stage.reset()
        for rng in examples(share):
            drawn(stage, rng)


@pytest.mark.slow
def test_hundreds_of_random_lines_are_those_of_the_reference(five):
    for stage in (five, stage_of(4, 1), stage_of(1, 2, 3)):
        stage.reset()
        for rng in examples(8.0):
            drawn(stage, rng)


def test_five_axes_stay_within_half_a_pulse_of_the_line_at_each_pulse_of_the_longest(pair):
    """The longest axis is one of the slave."""
    stage, master, slave = pair
    finish = ((700, -333, 1), (-999, 512))
    began = begin(stage, *finish)
    for k in range(1, 1000):
        pass_clocks(stage, began + k * PERIOD - master.clock)
        assert slave.net(0) == -k
        places = nets(master)[:3] + nets(slave)[:2]
        ideal = [f * k / 999 for chip in finish for f in chip]
        assert max(abs(a - b) for a, b in zip(places, ideal, strict=True)) <= 0.5
    assert not driving(master)
    assert not driving(slave)


# Who waits for whom


def test_slaves_wait_for_their_master_and_all_are_driving_meanwhile(pair):
    stage, master, slave = pair
    ready(slave, (10, 5), SLAVE)
    pass_clocks(stage, 20 * PERIOD)
    assert driving(slave, X | Y)
    assert nets(slave) == [0] * 4
    ready(master, (20, 0, 0), MASTER)
    pass_clocks(stage, 10 * PERIOD + PERIOD // 2)
    assert (nets(master)[0], *nets(slave)[:2]) == (10, 5, 3)
    assert get(master, 0x39, 0) == get(slave, 0x39, 0) == 20, "TX reads as the maximum of all"
    pass_clocks(stage, 20 * PERIOD)
    assert not driving(slave)
    assert not driving(master)


def test_a_slave_commanded_after_the_start_is_refused_with_mcerr(pair):
    stage, master, slave = pair
    ready(master, (20, 0, 0), MASTER)
    pass_clocks(stage, PERIOD)
    ready(slave, (10, 5), SLAVE)
    assert "start slaves first" in slave.diagnostics[-1].message
    assert not driving(slave)
    assert failed(slave)
    assert not failed(master)
    command(slave, CLEAR_STATUS, X)
    assert not failed(slave)
    pass_clocks(stage, 30 * PERIOD)
    assert nets(master)[0] == 20
    assert nets(slave) == [0] * 4


def test_a_master_without_wires_interpolates_by_itself_and_a_slave_for_ever_waits():
    chip = MCX514()
    prepare(chip, STEADY)
    ready(chip, (20, 7), MASTER)
    assert "by itself" in chip.diagnostics[-1].message
    assert chip.advance(SECOND) == 27
    ready(chip, (20, 7), SLAVE)
    assert "no pulse of a master will come" in chip.diagnostics[-1].message
    assert chip.advance(SECOND) == 0
    assert driving(chip, X | Y)
    command(chip, 0x57, X)
    assert not driving(chip, X | Y)


@pytest.mark.parametrize(
    ("code", "ipm", "message"),
    [(0x64, MASTER, "only lines"), (0x61, MASTER | 0x100, "exclude each other"), (0x61, 3 << 10, "MLT = 3")],
)
def test_what_is_not_modeled_of_several_chips_is_said(pair, code, ipm, message):
    _, master, _ = pair
    ready(master, (20, 7), ipm, go=False)
    command(master, code, 0)
    assert message in " ".join(d.message for d in master.diagnostics)
    assert driving(master) == (code == 0x61)


def test_a_second_line_while_one_runs_is_refused(pair):
    stage, _master, slave = pair
    begin(stage, (100, 0, 0), (50, 50))
    pass_clocks(stage, PERIOD)
    ready(slave, (9, 9), SLAVE)
    assert "during a line of several chips" in slave.diagnostics[-1].message
    pass_clocks(stage, 200 * PERIOD)
    assert nets(slave)[:2] == [50, 50]


# Stops


def stopped(stage, master, slave, at):
    """All stand since that clock, where the line was."""
    pass_clocks(stage, 30 * PERIOD)
    assert not driving(master, ALL)
    assert not driving(slave, ALL)
    k = at // PERIOD
    assert nets(master)[:3] == [k, 0, 0]
    assert nets(slave)[0] == (k + 1) // 2


@pytest.mark.parametrize("cut", [0, 1, -1], ids=["at a pulse", "a clock after", "a clock before"])
@pytest.mark.parametrize("by", ["limit", "limit, decelerating", "alarm", "emergency", "57h", "56h"])
def test_what_stops_a_slave_stops_all_at_that_clock_and_is_mcerr_to_the_others(pair, by, cut):
    stage, master, slave = pair
    command(slave, 0x1F, X)
    slave.write(2, {"limit": HLM_E, "limit, decelerating": HLM_E | HLM_M, "alarm": ALM_E}.get(by, 0))
    began = begin(stage, (100, 0, 0), (50, 0))
    at = 10 * PERIOD + cut
    pass_clocks(stage, began + at - master.clock)
    if by in ("57h", "56h"):
        command(slave, int(by[:2], 16), X)
    elif by == "emergency":
        slave.pins.emg = True
    else:
        setattr(slave.axes[0].pins, "alarm" if by == "alarm" else "lmt_plus", True)
    stopped(stage, master, slave, at)
    assert failed(master)
    assert not failed(slave)


def test_a_software_limit_of_a_slave_stops_all_at_its_pulse(pair):
    stage, master, slave = pair
    command(slave, 0x1F, X)
    slave.write(2, SLM_E | SLM_M)
    put(slave, 0x0B, 6)  # SP: LP = 7 is beyond
    put(slave, 0x0C, -1)  # SM
    begin(stage, (100, 0, 0), (50, 0))
    stopped(stage, master, slave, 13 * PERIOD)
    command(slave, 0x1F, X)
    assert slave.read(2) & 1
    assert failed(master)


@pytest.mark.parametrize("error", [True, False])
def test_an_error_of_the_master_is_mcerr_to_its_slaves_and_a_stop_is_none(pair, error):
    stage, master, slave = pair
    command(master, 0x1F, X)
    master.write(2, HLM_E)
    begin(stage, (100, 0, 0), (50, 0))
    pass_clocks(stage, 10 * PERIOD)
    if error:
        master.axes[0].pins.lmt_plus = True
    else:
        command(master, 0x57, X)
    stopped(stage, master, slave, 10 * PERIOD)
    assert failed(slave) == error
    assert not failed(master)


def test_a_decelerating_stop_of_the_master_brakes_all_along_the_line(pair):
    stage, master, slave = pair
    prepare(master, Move(SV=1000, DV=8000, AC=50_000))
    begin(stage, (6000, 0, 0), (3000, -4500))
    stage.run(0.5)
    command(master, 0x56, X)
    before = master.net(0)
    stage.run(0.3)
    k = master.net(0)
    assert k - before == pytest.approx((8000**2 - 1000**2) / (2 * 50_000), abs=1)
    assert nets(slave)[:2] == [pytest.approx(k / 2, abs=0.5), pytest.approx(-k * 0.75, abs=0.5)]
    assert not driving(slave)
    assert not failed(slave)


def test_a_slave_on_a_limit_lets_nobody_begin(pair):
    stage, master, slave = pair
    command(slave, 0x1F, X)
    slave.write(2, HLM_E)
    slave.axes[0].pins.lmt_plus = True
    begin(stage, (100, 0, 0), (50, 0))
    stopped(stage, master, slave, 0)
    assert failed(master)


# Time, copies, recordings


def test_how_time_is_cut_and_who_copies_or_restores_it_does_not_matter(pair):
    stage, *_ = pair
    prepare(stage.chips[0], Move(SV=1000, DV=30_000, AC=1_000_000))
    begin(stage, (500, -20, 3), (777, 100))
    stage.run(0.011)
    before, twins = stage.snapshot(), [copy.deepcopy(stage), pickle.loads(pickle.dumps(stage))]
    stage.run(0.03)
    ends = [chip.state.tobytes() for chip in stage.chips]
    for replica in twins:
        for part in (0.0011, 0.00000013, 0.0123, 0.01659987):
            replica.run(part)
        assert replica.now == stage.now
        assert [chip.state.tobytes() for chip in replica.chips] == ends
    stage.restore(before)
    stage.run(0.03)
    assert [chip.state.tobytes() for chip in stage.chips] == ends


def test_a_fleet_of_linked_stages_gives_the_bits_of_stages_alone(pair):
    stage, *_ = pair
    prepare(stage.chips[0], Move(SV=1000, DV=30_000, AC=1_000_000))
    begin(stage, (500, -20, 3), (777, 100))
    stage.run(0.011)
    half = stage.snapshot()
    stages = [copy.deepcopy(stage) for _ in range(3)]
    for k, other in enumerate(stages):
        other.run(0.001 * k)  # each is elsewhere on its line
    snapshots = [other.snapshot() for other in stages]
    alone = []
    for other in stages:
        other.run(0.02)
        alone.append(other.snapshot().state.tobytes())
    for threads in (1, 2):
        for other, snapshot in zip(stages, snapshots, strict=True):
            other.restore(snapshot)
        fleet = Fleet(stages, threads)
        fleet.play([Program().wait(0.02)] * 3)
        fleet.close()
        assert [other.snapshot().state.tobytes() for other in stages] == alone
    fresh = stage_of(3, 2)
    fresh.restore(half)
    fresh.run(0.02)
    assert fresh.snapshot().state.tobytes() == alone[0], "a new stage goes on in the middle of a line"


def test_snapshots_know_which_chips_are_wired():
    with pytest.raises(ArgumentError, match="multichip lines"):
        stage_of(1, 1, multichip=None).restore(stage_of(1, 1).snapshot())


def test_a_recording_shows_the_pulses_and_the_rate_of_a_slave(pair):
    stage, _, slave = pair
    journal = slave.journal()
    with stage.record() as recording:
        begin(stage, (100, 0, 0), (-50, 0))
        stage.run(0.02)
    journal.close()
    replay = GrowingJournalReplay(journal)
    assert sum(len(edges) for edges in replay.replay_in_pieces()) < 250, "without every pulse: rates and pins"
    assert replay.state == slave.state.tobytes()
    columns = recording.columns
    assert columns["a3/pulses"][-1] == -50
    assert set(columns["a3/rate"].round().tolist()) == {0, 5_000}, "half the master's"


# The option and the driver


def older():
    """Make a chip whose clock has already run."""
    chip = MCX514()
    chip.advance(7)
    return chip


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"multichip": ["a0"]}, "on one chip"),
        ({"multichip": ["a0", "a1"], "chips": MCX501}, "an MCX501 has no lines of multichip interpolation"),
        ({"multichip": ["a0", "b"]}, "unknown axis 'b'"),
        ({"multichip": "a0"}, "an axis of each chip"),
        (
            {"multichip": ["a0", "a2"], "chips": {"a0": MCX514, "a1": MCX514, "a2": lambda: MCX514(8_000_000)}},
            "one clock",
        ),
        ({"multichip": ["a0", "a2"], "chips": {"a0": MCX514, "a1": MCX514, "a2": older}}, "at 7 of 16,000,000 Hz"),
    ],
)
def test_a_wrong_option_is_refused(options, message):
    with pytest.raises(ArgumentError, match=message):
        Stage(rail_model(3), **({"chips": MCX514} | options))


def test_the_driver_draws_a_line_over_two_chips():
    stage = stage_of(2, 1, bus_cycle=1e-6)
    axes = list(stage.axes.values())
    report = firmware.line(dict(zip(stage.axes, (800, -333, 1200), strict=True)), stage, pulses=True)
    assert report.ok
    assert [axis.chip.net(axis.chip_axis) for axis in axes] == [800, -333, 1200]
    with pytest.raises(ArgumentError, match="join the chips"):
        firmware.line({"a0": 8, "a2": 12}, stage_of(2, 1, multichip=None), pulses=True)
