"""The real-time clock and the snapshot history of a session, each by itself, without a thread."""

from math import inf
from types import SimpleNamespace

import pytest

from stage.errors import ArgumentError
from stage.panel import real_time_clock
from stage.panel.real_time_clock import MAX_LAG_S, PACING_INTERVAL_S, UNPACED_SPEED, RealTimeClock
from stage.panel.snapshot_history import INTERVAL_S, MAX_AGE_S, SnapshotHistory

MS = 1_000_000  # ns


@pytest.fixture
def real(monkeypatch):
    """Real time, s, that stands still: real.now."""
    time = SimpleNamespace(now=100.0)
    monkeypatch.setattr(real_time_clock, "perf_counter", lambda: time.now)
    return time


@pytest.mark.parametrize(("speed", "slice_"), [(1.0, 20), (0.5, 10)])
def test_a_slice_is_what_passes_in_a_fiftieth_of_a_second(real, speed, slice_):
    clock = RealTimeClock(speed, 5 * MS)
    assert clock.pacing_interval_s == pytest.approx(slice_ * 1e-3) == pytest.approx(PACING_INTERVAL_S * speed)
    assert clock.plan_pacing_interval(5 * MS, 1000 * MS, 1) == (5 + slice_) * MS
    assert clock.plan_pacing_interval(5 * MS, 7 * MS, 1) == 7 * MS, "no farther than asked"
    assert clock.plan_pacing_interval(5 * MS, 1000 * MS, 300 * MS) == 305 * MS, "but a step at least"


def test_early_times_wait_and_late_ones_catch_up_within_limits(real):
    clock = RealTimeClock(2.0, 0)
    assert clock.compute_seconds_until(100 * MS, 0) == pytest.approx(0.05)
    real.now += 0.03
    assert clock.compute_seconds_until(100 * MS, 0) == pytest.approx(0.02)
    real.now += 0.1
    assert clock.compute_seconds_until(100 * MS, 60 * MS) == pytest.approx(-0.08), "it may catch up"
    real.now += MAX_LAG_S
    assert clock.compute_seconds_until(100 * MS, 60 * MS) < -MAX_LAG_S
    assert clock.compute_seconds_until(100 * MS, 60 * MS) == pytest.approx(0.02), (
        "and from now on as if nothing were late"
    )


def test_an_unlimited_speed_never_waits(real):
    clock = RealTimeClock(UNPACED_SPEED, 0)
    assert (clock.pacing_interval_s, clock.compute_seconds_until(10**12, 0)) == (PACING_INTERVAL_S, 0.0)
    assert clock.plan_pacing_interval(0, 10**12, 1) == 20 * MS
    assert clock.plan_pacing_interval(0, 5 * MS, 1) == 5 * MS


def test_a_slow_machine_gets_shorter_slices_so_that_orders_are_checked_as_often(real):
    """At 1000 x a slice would be 20 s of simulated time; a machine that computes 50 x gets one of 0.5 s."""
    clock, now, lengths = RealTimeClock(1000.0, 0), 0, []
    for _ in range(8):
        goal = clock.plan_pacing_interval(now, 10**15, 1)
        lengths.append((goal - now) / MS)
        clock.start_pacing_interval(now)
        real.now += (goal - now) * 1e-9 / 50
        now = goal
    assert lengths == pytest.approx([20, 40, 80, 160, 320, 500, 500, 500]), "it begins with what any machine can"
    clock.plan_pacing_interval(now, 10**15, 1)
    real.now += 5.0  # somebody has paused meanwhile
    assert clock.plan_pacing_interval(now, 10**15, 1) - now == pytest.approx(500 * MS)


def test_a_pace_is_measured_over_a_quarter_of_a_second_and_more(real):
    clock = RealTimeClock(3.0, 0)
    assert clock.achieved_speed == 3.0
    real.now += 0.2
    clock.update_achieved_speed(100 * MS)
    assert clock.achieved_speed == 3.0
    real.now += 0.2
    clock.update_achieved_speed(100 * MS)
    assert clock.achieved_speed == pytest.approx(0.25)
    real.now += 0.5
    clock.update_achieved_speed(1100 * MS)
    assert clock.achieved_speed == pytest.approx(2.0), "since the last that was taken"


def test_the_ends_of_a_speed_are_speeds():
    for speed in (0.001, 1000.0, UNPACED_SPEED, 1):
        assert RealTimeClock(speed, 0).speed == speed
    for wrong in (0.0009, 1000.1, -inf, float("nan")):
        with pytest.raises(ArgumentError, match=r"0\.001 to 1000 simulated seconds a second"):
            RealTimeClock(wrong, 0)


class NumberedStage:
    """A stage of which snapshots are numbers."""

    def __init__(self):
        self.now, self.machine = 0, "a"

    def snapshot(self):
        return SimpleNamespace(at=self.now, header=self.machine)


def remembered(ms, past=None):
    past, stage = past or SnapshotHistory(), NumberedStage()
    for at in ms:
        stage.now = at * MS
        past.take_snapshot_if_due(stage)
    return past


def test_the_past_has_a_snapshot_every_twentieth_of_a_second():
    past = remembered(range(0, 400, 10))
    assert [at // MS for at, _ in past._snapshots] == list(range(0, 400, round(INTERVAL_S * 1e3)))
    assert past.find_latest_before(199 * MS).at == 150 * MS
    assert past.find_latest_before(200 * MS).at == 200 * MS
    assert past.find_latest_before(10**12).at == 350 * MS
    assert past.find_latest_before(-1).at == 0, "the oldest, where none is as old"
    assert (390 * MS - past.oldest) * 1e-9 == pytest.approx(0.39)
    assert (SnapshotHistory().find_latest_before(0), SnapshotHistory().oldest) == (None, None)


def test_history_covers_half_a_minute():
    past = remembered(range(0, 40_000, 100))
    assert (39_900 * MS - past.oldest) * 1e-9 == pytest.approx(MAX_AGE_S)
    assert past.find_latest_before(0).at == 9_900 * MS
    delayed = remembered([0, 100_000])
    assert [at // MS for at, _ in delayed._snapshots] == [100_000]


def test_going_back_forgets_later_snapshots():
    past = remembered(range(0, 400, 50))
    past.forget_after(200 * MS)
    assert past.find_latest_before(10**12).at == 200 * MS
    past.forget_after(-1)
    assert past.find_latest_before(0) is None


def test_history_distinguishes_machines():
    past, stage = SnapshotHistory(), NumberedStage()
    for k, stage.machine in enumerate("abba" + "aab"):
        stage.now = 100 * k * MS
        past.take_snapshot_if_due(stage)
    assert past.find_oldest_of("b").at == 600 * MS
    past.forget_after(500 * MS)
    assert past.find_oldest_of("a").at == 300 * MS
    assert past.find_oldest_of("b") is None
    assert INTERVAL_S < 0.1
