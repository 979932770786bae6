"""Below the panel's page: the clock, what is queued, the past, units of fields; each by itself, without a thread."""

from math import inf, radians
from types import SimpleNamespace

import numpy as np
import pytest

from stage import Stage
from stage.errors import ArgumentError, StageError
from stage.panel import clock as clocks
from stage.panel import past as pasts
from stage.panel.clock import BEHIND, FREE, SLICE, Clock
from stage.panel.fields import Field, WrongField, distance_of, parsed, scale, speeds_of, where
from stage.panel.past import EVERY, KEPT, Past
from stage.panel.queues import Queues
from stage.panel.travel import outside, strongest_push
from stage.panel.view import Views
from stage.panel.words import place

MS = 1_000_000  # ns


@pytest.fixture
def real(monkeypatch):
    """Real time, s, that stands still: real.now."""
    time = SimpleNamespace(now=100.0)
    monkeypatch.setattr(clocks, "perf_counter", lambda: time.now)
    return time


@pytest.mark.parametrize(("speed", "slice_"), [(1.0, 20), (0.5, 10), (4.0, 80)])
def test_a_slice_is_what_passes_in_a_fiftieth_of_a_second(real, speed, slice_):
    clock = Clock(speed, 5 * MS)
    assert clock.piece == pytest.approx(slice_ * 1e-3) == pytest.approx(SLICE * speed)
    assert clock.goal(5 * MS, 1000 * MS, 1) == (5 + slice_) * MS
    assert clock.goal(5 * MS, 7 * MS, 1) == 7 * MS, "no farther than asked"
    assert clock.goal(5 * MS, 1000 * MS, 300 * MS) == 305 * MS, "but a step at least"
    assert clock.goal(5 * MS, 1000 * MS, 1, ahead=0.1) == (5 + 5 * slice_) * MS


def test_what_is_early_waits_and_what_is_late_hurries_until_it_is_given_up(real):
    clock = Clock(2.0, 0)
    assert clock.early(100 * MS, 0) == pytest.approx(0.05)
    real.now += 0.03
    assert clock.early(100 * MS, 0) == pytest.approx(0.02)
    real.now += 0.1
    assert clock.early(100 * MS, 60 * MS) == pytest.approx(-0.08), "it may catch up"
    real.now += BEHIND
    assert clock.early(100 * MS, 60 * MS) < -BEHIND
    assert clock.early(100 * MS, 60 * MS) == pytest.approx(0.02), "and from now on as if nothing were late"


def test_as_fast_as_it_goes_is_never_early(real):
    clock = Clock(FREE, 0)
    assert (clock.piece, clock.early(10**12, 0)) == (SLICE, 0.0)
    assert clock.goal(0, 10**12, 1) == 20 * MS
    assert clock.goal(0, 5 * MS, 1) == 5 * MS


def test_a_pace_is_measured_over_a_quarter_of_a_second_and_more(real):
    clock = Clock(3.0, 0)
    assert clock.pace == 3.0
    real.now += 0.2
    clock.measure(100 * MS)
    assert clock.pace == 3.0
    real.now += 0.2
    clock.measure(100 * MS)
    assert clock.pace == pytest.approx(0.25)
    real.now += 0.5
    clock.measure(1100 * MS)
    assert clock.pace == pytest.approx(2.0), "since the last that was taken"


def test_the_ends_of_a_speed_are_speeds():
    for speed in (0.001, 1000.0, FREE, 1):
        assert Clock(speed, 0).speed == speed
    for wrong in (0.0009, 1000.1, -inf, float("nan")):
        with pytest.raises(ArgumentError, match=r"0\.001 to 1000 simulated seconds a second"):
            Clock(wrong, 0)


# --- the past ---


class Passing:
    """A stage of which snapshots are numbers."""

    def __init__(self):
        self.now, self.machine = 0, "a"

    def snapshot(self):
        return SimpleNamespace(at=self.now, header=self.machine)


def remembered(ms, past=None):
    past, stage = past or Past(), Passing()
    for at in ms:
        stage.now = at * MS
        past.remember(stage)
    return past


def test_the_past_has_a_snapshot_every_twentieth_of_a_second():
    past = remembered(range(0, 400, 10))
    assert [at // MS for at, _ in past._kept] == list(range(0, 400, round(EVERY * 1e3)))
    assert past.before(199 * MS).at == 150 * MS
    assert past.before(200 * MS).at == 200 * MS
    assert past.before(10**12).at == 350 * MS
    assert past.before(-1).at == 0, "the oldest, where none is as old"
    assert past.seconds(390 * MS) == pytest.approx(0.39)
    assert (Past().before(0), Past().seconds(5)) == (None, 0.0)


def test_the_past_goes_back_half_a_minute():
    past = remembered(range(0, 40_000, 100))
    assert past.seconds(39_900 * MS) == pytest.approx(KEPT)
    assert past.before(0).at == 9_900 * MS
    late = remembered([0, 100_000])
    assert [at // MS for at, _ in late._kept] == [100_000]


def test_who_goes_back_forgets_what_comes_after():
    past = remembered(range(0, 400, 50))
    past.forget_after(200 * MS)
    assert past.before(10**12).at == 200 * MS
    past.forget_after(-1)
    assert past.before(0) is None


def test_the_past_of_another_machine_is_told_apart():
    past, stage = Past(), Passing()
    for k, stage.machine in enumerate("abba" + "aab"):
        stage.now = 100 * k * MS
        past.remember(stage)
    assert past.oldest_of("b").at == 600 * MS
    past.forget_after(500 * MS)
    assert past.oldest_of("a").at == 300 * MS
    assert past.oldest_of("b") is None
    assert pasts.EVERY < 0.1


# --- what waits ---


def test_orders_are_carried_out_in_their_order_and_each_error_goes_to_its_own():
    queues, seen = Queues(), []
    futures = [queues.post(lambda stage, k=k: seen.append(k) or 1 / (k - 1)) for k in range(3)]
    gone = queues.post(lambda stage: seen.append("gone"))
    gone.cancel()
    assert queues.orders
    assert not queues.busy
    assert queues.carry_out(None)
    assert seen == [0, 1, 2]
    assert [futures[0].result(), futures[2].result()] == [-1, 1]
    assert isinstance(futures[1].exception(), ZeroDivisionError)
    assert not queues.carry_out(None)
    assert not queues.orders


def test_actions_are_one_at_a_time_and_busy_until_the_last_is_done():
    queues, seen = Queues(), []
    first = queues.act("first", lambda stage: seen.append(queues.acting.name) or 7)
    second = queues.act("second", lambda stage: 1 / 0)
    assert queues.busy
    assert not queues.abandon(), "none is under way"

    def look():
        seen.append(queues.acting and queues.acting.name)

    queues.perform(None, look)
    assert (first.result(), second.done(), queues.busy) == (7, False, True)
    queues.perform(None, look)
    assert isinstance(second.exception(), ZeroDivisionError)
    assert seen == ["first", "first", None, "second", None]
    assert (queues.busy, queues.actions, queues.acting) == (False, False, None)
    third = queues.act("third", lambda stage: queues.abandon() and queues.acting.abandoned)
    assert not third.done()
    queues.perform(None, look)
    assert third.result() is True
    never = queues.act("never", lambda stage: seen.append("never"))
    never.cancel()
    queues.perform(None, look)
    assert "never" not in seen[-3:-2]
    assert seen[-2:] == ["never", None], "it was shown, and not done"


def test_what_waits_at_the_end_is_told_and_nothing_more_is_taken():
    queues = Queues()
    waiting = [queues.post(lambda stage: 1), queues.act("a", lambda stage: 1), queues.act("b", lambda stage: 1)]
    queues.refuse()
    for late in (lambda: queues.post(print), lambda: queues.act("c", print)):
        with pytest.raises(StageError, match="this session is over"):
            late()
    gone = queues._orders[0][1]
    gone.cancel()
    queues.end()
    assert gone.cancelled()
    del waiting[0]
    assert ["over" in str(f.exception()) for f in waiting] == [True] * 2, "also behind one for which nobody waits"


def test_a_look_that_has_ended_is_not_called_and_the_others_are():
    stage, seen = Stage("xy", visuals=False), []
    views = Views(stage, 1.0)
    assert (views.at, views.last.number) == (-1, 0)
    ends = [views.on_slice(lambda stage, k=k: seen.append(k) or (k == 1 and ends[1]())) for k in range(3)]
    views.publish(stage, 0.5, "move", "")
    ends[0]()
    ends[0]()
    views.publish(stage, 2.0, "", "trouble")
    assert seen == [0, 1, 2, 2]
    assert (views.at, views.last.number, views.last.pace, views.last.doing) == (stage.now, 2, 2.0, "")
    assert views.last.trouble == "trouble"
    stage.place(x=0.01)
    assert views.last.qpos[0] == 0, "what was there then"


# --- numbers of people ---


@pytest.fixture(scope="module")
def axes():
    return Stage("xya", visuals=False).axes


def test_a_place_is_told_in_the_unit_of_its_axis():
    said = place("m", 0.0123456, 0.0125, -4).splitlines()
    assert [line.split()[-2:] for line in said[:3]] == [["12.3456", "mm"], ["12.5000", "mm"], ["0.1544", "mm"]]
    assert said[3].split() == ["lost", "steps", "-4"]
    turned = place("rad", radians(-30), radians(-30.5), 0).splitlines()
    assert [line.split()[-2:] for line in turned[:3]] == [["-30.0000", "deg"], ["-30.5000", "deg"], ["-0.5000", "deg"]]


def test_texts_of_a_form_are_numbers_with_a_point_or_a_comma():
    fields = [Field("a", "A", "mm", "3"), Field("b", "B"), Field("c", "C", choices=("x", "y"), default="y")]
    assert parsed(fields, {"a": " 2,5 ", "b": ""}) == {"a": 2.5, "c": "y"}
    assert parsed(fields, {"b": "-1e3", "c": "x", "more": "1"}) == {"a": 3.0, "b": -1000.0, "c": "x"}
    for given, name, said in (
        ({"a": "two"}, "a", "'two' is not a number of mm."),
        ({"b": "two"}, "b", "'two' is not a number."),
        ({"b": "inf"}, "b", "'inf': a finite number."),
        ({"c": "z"}, "c", "'z': x, y."),
    ):
        with pytest.raises(WrongField) as wrong:
            parsed(fields, given)
        assert (wrong.value.field, str(wrong.value), where(wrong.value, fields)) == (name, said, name)
    assert [where(ArgumentError(t), fields) for t in ("b=3: no.", "b: no.", "bb: no.", "no b")] == ["b", "b", "", ""]


@pytest.mark.parametrize(("name", "unit", "k"), [("x", "mm", 1e-3), ("a", "deg", radians(1))])
def test_distances_and_speeds_of_people_are_metres_and_radians(axes, name, unit, k):
    axis = axes[name]
    pulse = axis.meters_per_pulse / k
    assert scale(axis) == (unit, pytest.approx(k))
    assert distance_of(axis, "distance", -2.0) == pytest.approx(-2 * k)
    assert distance_of(axis, "distance", 0.6 * pulse) == pytest.approx(0.6 * axis.meters_per_pulse)
    most = (10 if name == "x" else 100) * (axis.travel[1] - axis.travel[0]) / k
    assert distance_of(axis, "distance", -most) == pytest.approx(-most * k)
    for wrong, said in ((0.4 * pulse, "less than a pulse"), (-1.01 * most, f"up to {most:g} {unit}")):
        with pytest.raises(WrongField, match=said.replace(".", r"\.").replace("+", r"\+")):
            distance_of(axis, "distance", wrong)
    made = speeds_of(axis, {"speed": 3.0, "start_speed": 0.5, "accel": 0.2, "other": 9})
    assert made == pytest.approx({"speed": 3 * k, "start_speed": 0.5 * k, "accel": 0.2})
    assert speeds_of(axis, {"accel": 60.0, "speed": 1.01 * pulse})["accel"] == 60
    for given, field, said in (
        ({"speed": 0.0}, "speed", "more than 0"),
        ({"accel": 60.1}, "accel", "up to 60 s"),
        ({"accel": -1.0}, "accel", "more than 0"),
        ({"start_speed": 0.9 * pulse}, "start_speed", f"{unit}/s, a pulse a second, or more"),
    ):
        with pytest.raises(WrongField, match=said) as wrong:
            speeds_of(axis, given)
        assert wrong.value.field == field


def test_a_carriage_is_out_of_its_travel_beyond_a_tenth_of_it_on_either_side():
    stage = Stage("xya", visuals=False)
    for name in ("x", "y"):
        axis = stage.axes[name]
        low, high = axis.travel
        for at, out in (
            (low - 0.099 * (high - low), False), (low - 0.101 * (high - low), True),
            (high + 0.099 * (high - low), False), (high + 0.101 * (high - low), True), (0.0, False),
        ):  # fmt: skip
            stage.data.qpos[axis.plant.qpos] = at
            assert bool(outside(stage)) == out
            assert outside(stage).startswith(f"{name} is out of its travel") == out
    stage.data.qpos[stage.axes["a"].plant.qpos] = 1e3
    assert outside(stage) == "", "a table turns without end"
    x = stage.axes["x"]
    assert strongest_push(x) == pytest.approx(2 * x.drive.peak_torque * abs(x.gear))
    assert np.isfinite(strongest_push(x))
