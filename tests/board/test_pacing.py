"""A run in real time sleeps while it is ahead of wall-clock time, and measures by how much it is behind."""

from types import SimpleNamespace

import pytest

from stage.board import pacing

MS = 1_000_000  # ns


@pytest.fixture
def clock(monkeypatch):
    """A wall clock that only sleeps and the test advance."""
    clock = SimpleNamespace(now=100.0, slept=[])

    def sleep(seconds: float) -> None:
        clock.slept.append(seconds)
        clock.now += seconds

    monkeypatch.setattr(pacing, "time", SimpleNamespace(perf_counter=lambda: clock.now, sleep=sleep))
    return clock


def test_it_sleeps_until_wall_clock_time_has_reached_simulated_time(clock):
    pace = pacing.RealTimePace()
    pace.start(20 * MS)
    clock.now += 0.002
    pace.wait(25 * MS)
    assert clock.slept == [pytest.approx(0.003)]
    pace.wait(30 * MS)
    assert clock.now == pytest.approx(100.010)
    assert (pace.lag_s, pace.largest_lag_s) == (0, pytest.approx(0, abs=1e-9))


def test_it_keeps_the_largest_lag_and_catches_up_without_sleep(clock):
    pace = pacing.RealTimePace()
    pace.start(0)
    clock.now += 0.100
    for now, lag in ((5, 0.095), (60, 0.040), (99, 0.001)):
        pace.wait(now * MS)
        assert pace.lag_s == pytest.approx(lag, abs=1e-9)
    assert pace.largest_lag_s == pytest.approx(0.095)
    assert clock.slept == []
    pace.start(1000 * MS)
    pace.wait(105 * MS)
    assert clock.slept == [pytest.approx(0.005)], "a run begins once"
