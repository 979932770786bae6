"""The sampler's memory: rings against plain lists, windows and their ends, thinning, events, and what it leaves behind."""

import random
from types import SimpleNamespace

import numpy as np
import pytest

from stage import Stage
from stage.errors import ArgumentError
from stage.panel import sampler as sampling
from stage.panel.sampler import COARSE, FINE, SampleBuffer, Sampler, find_traces, thin_curve
from stage.sim.records import SAMPLE


def rows(times, value=0):
    made = np.zeros((len(times), 2), SAMPLE)
    made["time"] = np.asarray(times)[:, None]
    made["lost_steps"] = [[round(t) + value, -round(t)] for t in times]
    return made


@pytest.mark.parametrize("seed", range(3))
def test_a_ring_is_the_end_of_a_list_whatever_comes_and_goes(seed):
    print("seed", seed)
    dice, buffer, kept, time = random.Random(seed), SampleBuffer(16, 2), [], 0
    assert (buffer.first, buffer.last, len(buffer.times(0, 0))) == (float("inf"), -1.0, 0)
    for _ in range(150):
        if dice.random() < 0.8:
            n = dice.choice((1, 1, 3, 7, 15, 16, 17, 40))
            buffer.extend(rows(range(time, time + n)))
            kept = (kept + list(range(time, time + n)))[-16:]
            time += n
        elif kept:
            time = dice.randrange(max(0, kept[0] - 2), kept[-1] + 3)
            buffer.forget_from(time)
            kept = [t for t in kept if t < time]
            time = max(time, kept[-1] + 1 if kept else time)
        assert buffer.end - buffer.begin == len(kept) <= 16
        assert (buffer.first, buffer.last) == ((kept[0], kept[-1]) if kept else (float("inf"), -1.0))
        assert buffer.times(buffer.begin, buffer.end).tolist() == kept
        assert buffer.axis(0, buffer.begin, buffer.end)["lost_steps"].tolist() == kept
        assert buffer.axis(1, buffer.begin, buffer.end)["lost_steps"].tolist() == [-t for t in kept]
        for at in (-1, *kept[:1], *kept[-1:], dice.uniform(0, time + 1)):
            assert buffer.find(at) - buffer.begin == sum(t < at for t in kept)
        if kept:
            a, b = sorted(dice.choices(range(buffer.begin, buffer.end + 1), k=2))
            part = buffer.times(a, b)
            assert part.tolist() == kept[a - buffer.begin : b - buffer.begin]
            part[:] = -5
            assert buffer.times(buffer.begin, buffer.end).tolist() == kept, "what is given is a copy"


def test_the_newest_sample_is_the_last_that_is_before_where_time_went_back():
    buffer = SampleBuffer(8, 2)
    buffer.extend(rows([1, 2, 3]))
    buffer.forget_from(3.5)
    assert buffer.last == 3
    buffer.forget_from(3)
    assert buffer.last == 2
    buffer.forget_from(0.5)
    assert (buffer.last, buffer.first) == (-1.0, float("inf"))


@pytest.mark.parametrize(
    ("n", "points"), [(1, 1), (2, 1), (3, 1), (4, 2), (5, 2), (7, 2), (9, 4), (100, 7), (101, 50), (101, 51)]
)
def test_a_thinned_curve_has_the_least_and_the_greatest_of_each_stretch_in_their_order(n, points):
    dice = np.random.default_rng(n)
    times, values = np.arange(n) * 0.5, dice.normal(size=n)
    t, v = thin_curve(times, values, points)
    assert len(t) == len(v) <= max(2 * points, 2)
    if n <= 2 * points:
        assert (t.tolist(), v.tolist()) == (times.tolist(), values.tolist())
        return
    size = -(-n // points)
    expected = []
    for k in range(0, n, size):
        part = values[k : k + size]
        expected += sorted((k + int(part.argmin()), k + int(part.argmax())))
    assert t.tolist() == [times[k] for k in expected]
    assert v.tolist() == [values[k] for k in expected]


def test_no_columns_of_pixels_are_refused():
    for points in (0, -1):
        with pytest.raises(ArgumentError, match=f"points={points}: 1 or more"):
            thin_curve(np.zeros(3), np.zeros(3), points)


def run(session, seconds):
    session.do(lambda stage: session.run_unpaced(stage.run, seconds))
    session.do(lambda stage: session._publish())


def test_a_window_has_both_its_ends_and_is_fine_where_that_is_remembered(session, sampler):
    run(session, FINE + 0.5)
    dt = sampler.dt
    fine, _ = sampler.columns([], 1.0, 1.1)
    assert (fine[0], fine[-1]) == pytest.approx((1.0, 1.1))
    assert np.diff(fine) == pytest.approx(dt)
    coarse, _ = sampler.columns([], 0.1, 0.2)
    assert np.diff(coarse) == pytest.approx(COARSE)
    begins, _ = sampler.columns([], 0.1, 2.0)
    assert np.diff(begins) == pytest.approx(COARSE), "a window that begins earlier is of one kind"
    assert sampler.last == pytest.approx(FINE + 0.5)
    assert len(sampler.columns(["x/position"], 9.0, 10.0)[1]["x/position"]) == 0


def test_what_is_drawn_is_each_trace_for_itself(session, sampler):
    session.do(lambda stage: stage.place(x=0.01, y=-0.02))
    run(session, 0.5)
    drawn = sampler.thinned_columns(["x/position", "y/position", "x/org"], 0.1, 0.4, 10)
    times, values = sampler.columns(["x/position", "y/position", "x/org"], 0.1, 0.4)
    for name, (t, v) in drawn.items():
        for mine, its in zip((t, v), thin_curve(times, values[name], 10), strict=True):
            assert mine.tolist() == its.tolist()
    assert drawn["x/position"][1] == pytest.approx(10, abs=0.5)
    assert drawn["y/position"][1] == pytest.approx(-20, abs=0.5)
    assert len(drawn["x/org"][0]) == 20


def test_events_are_of_their_chip_and_time_once_each_and_none_of_before(session):
    session.reset()
    session.do(lambda stage: stage.chips[0].write(0, 0x15))  # before it looks
    sampler = Sampler(session)
    run(session, 0.01)
    assert not sampler.events
    for k, wrong in ((1, 0x15), (0, 0x90), (1, 0x90)):
        session.do(lambda stage, k=k, wrong=wrong: stage.chips[k].write(0, wrong))
        run(session, 0.01)
    noted = [(d.clock / chip.clock_hz, d.message) for chip in session.stage.chips for d in chip.diagnostics]
    noted = sorted(n for n in noted if n[0] > 0.009)
    assert [(e.time, e.text) for e in sampler.events] == [(t, f"PCL240K: {m}") for t, m in noted]
    assert len(sampler.events) == 3
    sampler.close()


def test_after_it_nobody_samples_and_nobody_looks(session):
    session.reset()
    looks = len(session._observers)
    sampler = Sampler(session)
    run(session, 0.01)
    at = sampler.last
    assert session.stage.loop.recording is sampler
    sampler.close()
    assert session.stage.loop.recording is None
    assert len(session._observers) == looks
    run(session, 0.01)
    assert sampler.last == at


def test_it_leaves_the_recording_of_another_alone(session):
    session.reset()
    sampler = Sampler(session)
    recording = session.do(lambda stage: stage.record())
    run(session, 0.02)
    sampler.close()
    assert session.stage.recording is recording
    run(session, 0.01)
    assert recording.column("time")[-1] == pytest.approx(0.03, abs=1.1e-3)
    session.do(lambda stage: recording.close())


def test_a_second_recording_is_read_from_its_begin(session, sampler):
    for _ in range(2):
        with session.do(lambda stage: stage.record()) as recording:
            for _ in range(3):
                run(session, 0.01)
            at = session.stage.time
            times, _ = sampler.columns([], at - 0.0255, at)
            assert len(times) == pytest.approx(26, abs=1)
            assert np.diff(times) == pytest.approx(1e-3)
            session.do(lambda stage, r=recording: r.close())


def test_where_there_is_no_axis_there_is_nothing_to_see():
    asked = []
    stage = SimpleNamespace(
        axes={},
        chips=[],
        model=SimpleNamespace(nq=0),
        state=SimpleNamespace(dt=250_000),
        loop=SimpleNamespace(recording=None),
    )
    sampler = Sampler(
        SimpleNamespace(stage=stage, do=lambda order: asked.append(order) or order(stage), on_slice=asked.append)
    )
    assert (sampler.traces, asked, sampler.last) == ({}, [], -1.0)
    sampler.close()


def test_what_there_is_to_see_has_the_unit_of_its_axis_and_the_parts_of_its_drive():
    turning = find_traces(Stage("xya", visuals=False))
    assert [turning[f"{a}/position"].unit for a in "xya"] == ["mm", "mm", "deg"]
    assert [turning[f"{a}/velocity"].unit for a in "xya"] == ["mm/s", "mm/s", "deg/s"]
    row = np.zeros(2, SAMPLE)
    row["velocity"], row["position"], row["torque"], row["current_a"], row["current_b"] = 0.5, 0.25, 3, 1, 2
    values = {name: turning[name].value(row).tolist() for name in turning if not turning[name].pin}
    assert values["x/velocity"] == [500, 500]
    assert values["a/velocity"] == pytest.approx([np.degrees(0.5)] * 2)
    assert values["a/position"] == pytest.approx([np.degrees(0.25)] * 2)
    assert (values["x/torque"][0], values["x/current_a"][0], values["x/current_b"][0]) == (3, 1, 2)
    assert (turning["a/position"].title, turning["a/position"].axis) == ("a position", 2)
    assert turning["x/current_a"].places == 4
    assert turning["x/velocity"].places == 4
    servo = find_traces(Stage("xy", chips="hctl1100", visuals=False))
    assert "x/current_a" not in servo
    assert {"x/torque", "x/velocity"} <= set(servo)


def test_each_pin_is_its_own_bit_of_its_own_word():
    stage = Stage("xy", visuals=False)
    seen, chip = find_traces(stage), stage.chips[0]
    for field, pins in (("inputs", chip.INPUTS), ("outputs", chip.OUTPUTS)):
        for pin, bit in pins.items():
            row = np.zeros(3, SAMPLE)
            row[field] = [0, bit, ~bit & 0xFFFF]
            trace = seen[f"y/{pin}"]
            assert (trace.value(row).tolist(), trace.pin, trace.axis, trace.unit) == ([0, 1, 0], True, 1, "")
    assert sampling.EVENTS == 500
