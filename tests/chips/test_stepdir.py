"""STEP/DIR axis: counts, the step timer's profile and its ends, and the times that a power stage demands."""

import copy

import numpy as np
import pytest
from reference.stepdir import Profile, spread_steps
from support.examples import SEED

from stage.chips import STEPDIR
from stage.chips.stepdir import state
from stage.drives.motors import Drive
from stage.drives.power_stages import PowerStage
from stage.errors import ArgumentError

SECOND = 10**9
SLOW = PowerStage(
    "slow",
    "Slow Stage",
    2.0,
    5.0,
    50.0,
    {16: ""},
    step_high=5e-6,
    step_low=4e-6,
    dir_setup=3e-6,
    dir_hold=2e-6,
    enable_setup=1e-3,
)
"""A power stage whose times all differ."""


def make_axis(**drive):
    axis = STEPDIR()
    if drive:
        axis.fit_drive(Drive(**drive))
    return axis


def write(axis, command="", **registers):
    """Write registers, and send a command of the step timer."""
    for name, value in registers.items():
        axis.write(*axis.register_cycles(name, value)[0])
    if command:
        axis.write(*axis.command_cycles(command)[0])


def pulse(axis, high=10_000, low=10_000):
    axis.pins.step = True
    axis.advance(high)
    axis.pins.step = False
    axis.advance(low)


# --- lines ---


def test_a_rising_edge_of_step_counts_in_the_direction_of_dir():
    axis = STEPDIR()
    for _ in range(3):
        pulse(axis)
    assert axis.net() == 3
    axis.pins.dir = True
    pulse(axis)
    assert (axis.net(), axis.values()["POSITION"]) == (2, 2)
    axis.pins.step = True
    axis.pins.step = True  # a level, not an edge
    assert axis.net() == 1
    axis.reset()
    assert (axis.net(), axis.values()["POSITION"], axis.pins.step) == (1, 0, True)


def test_dir_and_step_that_change_together_make_a_step_in_the_new_direction():
    axis = STEPDIR()
    axis.set_input_word(0, axis.input_word(0) | state.DIR | state.STEP)
    assert axis.net() == -1


@pytest.mark.parametrize(("counts", "steps"), [(True, 3), (False, 2)])
def test_steps_without_enable_are_counted_where_the_power_stage_does(counts, steps):
    axis = make_axis(power_stage=PowerStage("p", "P", 2.0, 5.0, 50.0, {16: ""}, counts_disabled=counts))
    pulse(axis)
    axis.pins.enable = False
    pulse(axis)
    assert axis.CORE.read_motor_current.with_gil(axis.pointer, 0) == 0.0
    assert axis.explain_missing_current() == "ENABLE is not asserted"
    axis.pins.enable = True
    pulse(axis)
    assert axis.net() == steps
    assert axis.CORE.read_motor_current.with_gil(axis.pointer, 0) == pytest.approx(1.7)


def test_the_mean_count_of_a_slice_is_exact_for_up_to_sixteen_edges():
    rng = np.random.default_rng(SEED)
    print("seed", SEED)
    for _ in range(50):
        axis = STEPDIR()
        for _ in range(int(rng.integers(0, 20))):
            pulse(axis, int(rng.integers(1, 500)), int(rng.integers(1, 500)))
        before, begin, area, n = axis.net(), axis.clock, 0, int(rng.integers(0, 17))
        for _ in range(n):
            axis.pins.dir = bool(rng.integers(2))
            axis.pins.step = True
            high, low = (int(k) for k in rng.integers(1, 500, 2))
            axis.advance(high)
            axis.pins.step = False
            axis.advance(low)
            area += (axis.net() - before) * (high + low)
        axis.advance(1)
        area += axis.net() - before
        ticks = axis.clock - begin
        mean = axis.CORE.compute_drive_input.c(axis.pointer, 0, before, float(ticks))
        assert mean == pytest.approx(before + area / ticks, abs=1e-9)


def test_the_rate_of_a_hosts_edges_is_that_of_the_last_two_and_ends_with_them():
    axis = STEPDIR()
    axis.pins.dir = True
    for _ in range(3):
        pulse(axis, 50_000, 50_000)
    assert axis.CORE.read_pulse_rate.c(axis.pointer, 0, 1e9) == pytest.approx(-10_000)
    axis.advance(150_000)
    assert axis.CORE.read_pulse_rate.c(axis.pointer, 0, 1e9) == 0.0


# --- the step timer ---


def draw_move(rng):
    rate = int(rng.integers(100, 150_000))
    return dict(
        START=int(rng.integers(0, rate)), RATE=rate, UP=int(rng.integers(0, 300_000)), DOWN=int(rng.integers(0, 300_000)),
        CURVED=int(rng.choice([0, 0, 1, 17, 50])), STEPS=int(rng.integers(1, 3000)),
    )  # fmt: skip


def test_every_step_of_a_move_comes_when_the_reference_says():
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    for _ in range(25):
        move, minus = draw_move(rng), bool(rng.integers(2))
        print(move)
        axis = STEPDIR()
        axis.advance(int(rng.integers(1, 10**6)))
        begin = axis.clock
        write(axis, "MOVE-" if minus else "MOVE+", **move)
        trace = axis.trace(200 * SECOND)
        assert len(trace) == move["STEPS"]
        assert (trace["direction"] == (-1 if minus else 1)).all()
        profile = Profile(
            move["STEPS"], move["START"], move["RATE"], move["UP"] * 1e-6, move["DOWN"] * 1e-6, move["CURVED"] / 100
        )
        numbers = sorted(
            {1, 2, move["STEPS"], *rng.integers(1, move["STEPS"] + 1, 20).tolist()} & set(range(1, move["STEPS"] + 1))
        )
        expected = np.array(profile.step_times(numbers)) * 1e9
        actual = trace["clock"][np.array(numbers) - 1] - begin
        if np.diff(trace["clock"]).min() > 4_000:  # STEP stays low as long as it was high
            assert np.abs(actual - expected).max() < 3
        assert not axis.busy()


def test_a_move_with_equal_ramps_is_symmetric_in_time():
    axis = STEPDIR()
    write(axis, "MOVE+", START=500, RATE=20_000, UP=100_000, DOWN=100_000, CURVED=30, STEPS=5000)
    clocks = axis.trace(10 * SECOND)["clock"]
    assert np.abs(np.diff(clocks) - np.diff(clocks)[::-1]).max() <= 2


def test_the_steps_of_a_line_are_spread_by_bresenhams_rule():
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    for _ in range(20):
        events = int(rng.integers(1, 400))
        steps = int(rng.integers(1, events + 1))
        leader, follower = STEPDIR(), STEPDIR()
        for axis, count in ((leader, events), (follower, steps)):
            write(axis, "MOVE+", START=100, RATE=5000, UP=20_000, DOWN=30_000, STEPS=count, EVENTS=events)
        leader_clocks, follower_clocks = (axis.trace(20 * SECOND)["clock"] for axis in (leader, follower))
        assert follower_clocks.tolist() == leader_clocks[np.array(spread_steps(steps, events)) - 1].tolist()
        assert not follower.busy()


def test_step_stays_high_for_the_programmed_time_and_low_at_least_as_long():
    axis = STEPDIR()
    journal = axis.journal()
    write(axis, "MOVE+", START=200_000, RATE=200_000, STEPS=50, HIGH=4_000)
    axis.advance(SECOND)
    replayed = journal.replay_waveforms(every_pulse=True)
    edges = replayed.edges["clock"][np.flatnonzero(np.diff(replayed.pin("step").astype(int))) + 1]
    assert np.diff(edges)[::2].tolist() == [4_000] * 50
    assert np.diff(edges)[1::2].min() >= 4_000
    assert axis.net() == 50


@pytest.mark.parametrize(("limit", "command"), [("el_plus", "MOVE+"), ("el_minus", "MOVE-"), ("el_plus", "RUN+")])
def test_an_end_limit_ahead_stops_the_move_at_its_clock(limit, command):
    axis = STEPDIR()
    write(axis, command, START=1000, RATE=1000, STEPS=100)
    axis.advance(10_600_000)
    setattr(axis.pins, limit, True)
    assert abs(axis.net()) == 11  # steps at 0.5, 1.5 ... 10.5 ms
    assert not axis.busy()
    axis.advance(SECOND)
    assert abs(axis.net()) == 11
    write(axis, command)
    assert not axis.busy(), "a start towards the limit does nothing"
    write(axis, "MOVE-" if command.endswith("+") else "MOVE+")
    assert axis.busy(), "a start away from it does"


def test_a_run_to_the_origin_ends_with_the_ramp_down_after_its_switch():
    axis = STEPDIR()
    write(axis, "HOME-", START=1000, RATE=10_000, UP=100_000, DOWN=50_000)
    axis.advance(SECOND)
    before = axis.net()
    axis.pins.org = True
    axis.pins.org = False
    axis.advance(SECOND)
    assert before - axis.net() == pytest.approx((1000 + 10_000) / 2 * 0.05, abs=1)
    assert axis.MAP.field("status", "end").extract(axis.read(0)) == 4
    axis.pins.org = True
    write(axis, "HOME-")
    assert not axis.busy(), "it is there already"


def test_a_stop_with_the_ramp_down_takes_the_steps_of_the_ramp_from_any_rate():
    for seconds in (0.02, 0.06, 0.5):
        axis = STEPDIR()
        write(axis, "RUN+", START=0, RATE=10_000, UP=100_000, DOWN=100_000)
        axis.advance(round(seconds * SECOND))
        rate = min(seconds / 0.1, 1.0) * 10_000
        before = axis.net()
        write(axis, "SLOW")
        write(axis, "SLOW")  # the second one changes nothing
        axis.advance(SECOND)
        assert axis.net() - before == pytest.approx(rate**2 / (2 * 100_000), abs=1.01)
        assert not axis.busy()


def test_a_stop_at_once_finishes_the_pulse_in_progress_and_makes_no_other():
    axis = STEPDIR()
    write(axis, "RUN+", START=1000, RATE=1000, HIGH=100_000)
    axis.advance(510_000)
    write(axis, "STOP")
    assert (axis.net(), axis.pins.step, axis.busy()) == (1, True, False)
    axis.advance(100_000)
    assert (axis.net(), axis.pins.step) == (1, False)


def test_time_may_be_cut_anywhere_in_a_move():
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    for _ in range(10):
        uncut = STEPDIR()
        write(uncut, "MOVE+", **draw_move(rng) | {"STEPS": 200})
        pieces = copy.copy(uncut)
        end = int(rng.integers(1, 3 * SECOND))
        for cut in [*np.sort(rng.integers(0, end, 40)).tolist(), end]:
            pieces.advance(cut - pieces.clock)
            pieces = copy.copy(pieces)
        uncut.advance(end)
        assert pieces.state.tobytes() == uncut.state.tobytes()


def test_writes_that_do_nothing_have_a_diagnostic():
    axis = STEPDIR()
    write(axis, "MOVE+")
    write(axis, "MOVE+", RATE=100)
    write(axis, "MOVE+", STEPS=5, START=300)
    write(axis, "MOVE+")
    axis.write(9, 5)
    axis.write(12, 5)
    write(axis, HIGH=1)
    assert [d.key for d in axis.diagnostics] == [
        "no-steps", "no-steps", "no-ramp", "already-moving", "read-only", "no-register", "value-range",
    ]  # fmt: skip


# --- times that a power stage demands ---


def violate(axis, which, short):
    """Make two pulses with the shortest times that SLOW allows, of which one is shorter by `short` ns."""
    times = dict(
        zip(
            ("step_high", "step_low", "dir_setup", "dir_hold", "enable_setup"),
            axis.state["required"].tolist(),
            strict=True,
        )
    )
    times[which] -= short
    axis.pins.enable = False
    axis.advance(SECOND)
    axis.pins.enable = True
    axis.advance(times["enable_setup"] - times["dir_setup"])
    axis.pins.dir = True
    axis.advance(times["dir_setup"])
    axis.pins.step = True
    axis.advance(times["step_high"])
    axis.pins.step = False
    axis.advance(times["step_low"])
    axis.pins.step = True
    axis.advance(times["dir_hold"])
    axis.pins.dir = False
    axis.advance(SECOND)
    axis.pins.step = False


TIMES = {
    "step_high": ("step-high-time", "STEP was high for 4.999 us; the Slow Stage needs 5 us"),
    "step_low": ("step-low-time", "STEP was low for 3.999 us before an edge; the Slow Stage needs 4 us"),
    "dir_setup": ("dir-setup-time", "DIR changed 2.999 us before a rising edge of STEP; the Slow Stage needs 3 us"),
    "dir_hold": ("dir-hold-time", "DIR changed 1.999 us after a rising edge of STEP; the Slow Stage needs 2 us"),
    "enable_setup": ("enable-setup-time", "STEP rose 1000 us after ENABLE; the Slow Stage needs 1000 us"),
}


@pytest.mark.parametrize("which", TIMES)
def test_an_edge_that_is_one_nanosecond_too_early_has_a_diagnostic(which):
    axis = make_axis(power_stage=SLOW)
    violate(axis, which, 0)
    assert axis.diagnostics == []
    violate(axis, which, 1)
    key, message = TIMES[which]
    assert [(d.key, d.message) for d in axis.diagnostics] == [
        (key, f"{message}: silicon may lose the edge or step the other way")
    ]
    assert axis.net() == -4, "all edges count"


@pytest.mark.parametrize("which", TIMES)
def test_by_choice_such_an_edge_is_lost(which):
    axis = make_axis(power_stage=SLOW, drops_edges=True)
    violate(axis, which, 0)
    assert axis.net() == -2
    violate(axis, which, 1)
    assert axis.net() == -3
    assert axis.diagnostics[0].message.endswith("the edge was lost")
    assert axis.state["violations"].sum() == 1


def test_a_diagnostic_reports_the_minimum_time_and_the_first_violation():
    axis = make_axis(power_stage="drv8825")
    for high in (1_700, 700, 1_500):
        pulse(axis, high, 3_000)
    (d,) = axis.diagnostics
    assert d.message.startswith("STEP was high for 0.7 us; the Texas Instruments DRV8825 needs 1.9 us")
    assert d.clock == 1_700


@pytest.mark.parametrize(("pin", "level"), [("step", "no"), ("probe", "no"), ("dir", None), ("enable", 2)])
def test_a_pin_takes_true_or_false_only(pin, level):
    axis = STEPDIR()
    before = axis.state.tobytes()
    with pytest.raises(ArgumentError, match=rf"pins\.{pin} = .*: a pin is asserted or not; give True or False"):
        setattr(axis.pins, pin, level)
    assert axis.state.tobytes() == before
