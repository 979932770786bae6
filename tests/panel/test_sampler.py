"""The sampler: its memory against plain lists, windows and their ends, thinning, events, recordings and other samplers."""

import random
from types import SimpleNamespace

import numpy as np
import pytest

from stage import Stage, firmware
from stage.errors import ArgumentError
from stage.panel.sampler import FINE_HISTORY_S, INTERVAL_S, MAX_EVENTS, SampleBuffer, Sampler, find_traces, thin_curve
from stage.sim.engine_records import SAMPLE


def rows_at(times):
    rows = np.zeros((len(times), 2), SAMPLE)
    rows["time"] = np.asarray(times)[:, None]
    rows["lost_steps"] = [[round(t), -round(t)] for t in times]
    return rows


def run(session, seconds):
    session.do(lambda stage: session.run_unpaced(stage.run, seconds))
    publish(session)


def publish(session):
    session.do(lambda stage: session._publish_view())  # and all observers have been called


@pytest.mark.parametrize("seed", range(3))
def test_a_buffer_holds_the_end_of_a_list_whatever_is_added_and_forgotten(seed):
    print("seed", seed)
    rng, buffer, expected, time = random.Random(seed), SampleBuffer(16, 2), [], 0
    assert (buffer.first_time, buffer.last_time, len(buffer.rows)) == (float("inf"), -1.0, 0)
    for _ in range(150):
        if rng.random() < 0.8:
            n = rng.choice((1, 1, 3, 7, 15, 16, 17, 40))
            buffer.extend(rows_at(range(time, time + n)))
            expected = (expected + list(range(time, time + n)))[-16:]
            time += n
        elif expected:
            time = rng.randrange(max(0, expected[0] - 2), expected[-1] + 3)
            buffer.drop_samples_from(time)
            expected = [t for t in expected if t < time]
            time = max(time, expected[-1] + 1 if expected else time)
        assert buffer.rows["time"][:, 0].tolist() == expected
        assert buffer.rows["lost_steps"].tolist() == [[t, -t] for t in expected]
        assert (buffer.first_time, buffer.last_time) == (
            (expected[0], expected[-1]) if expected else (float("inf"), -1.0)
        )
        for at in (-1, *expected[:1], *expected[-1:], rng.uniform(0, time + 1)):
            assert buffer.count_before(at) == sum(t < at for t in expected)


@pytest.mark.parametrize(
    ("n", "points"), [(1, 1), (2, 1), (3, 1), (4, 2), (5, 2), (7, 2), (9, 4), (100, 7), (101, 50), (101, 51)]
)
def test_a_thinned_curve_has_the_least_and_the_greatest_of_each_stretch_in_their_order(n, points):
    times, values = np.arange(n) * 0.5, np.random.default_rng(n).normal(size=n)
    t, v = thin_curve(times, values, points)
    assert len(t) == len(v) <= max(2 * points, 2)
    expected = list(range(n))
    if n > 2 * points:
        size = -(-n // points)
        stretches = [range(k, min(k + size, n)) for k in range(0, n, size)]
        expected = [
            k for s in stretches for k in sorted((min(s, key=values.__getitem__), max(s, key=values.__getitem__)))
        ]
    assert t.tolist() == [times[k] for k in expected]
    assert v.tolist() == [values[k] for k in expected]


@pytest.mark.parametrize("points", [0, -1])
def test_a_curve_of_no_columns_of_pixels_is_refused(points):
    with pytest.raises(ArgumentError, match=f"pixel_columns={points}: 1 or more"):
        thin_curve(np.zeros(3), np.zeros(3), points)


def test_samples_are_those_of_a_recording(session, sampler):
    """Position, rate, a pin: equal to what a recording of the same program has, at its times."""
    session.act("move", lambda stage: session.run_unpaced(firmware.move, stage.axes["x"], 0.002)).result(30)
    reference = Stage("xy", visuals=False)
    with reference.record(every=2.5e-4) as recording:
        firmware.move(reference.axes["x"], 0.002)
    times, values = sampler.read_columns(["x/position", "x/rate", "x/org"], 0, 1.0)
    n = len(times)
    assert n > 500
    assert np.array_equal(times, recording.column("time")[:n])
    assert np.array_equal(values["x/position"], recording.column("x/position")[:n] * 1e3)  # mm
    assert np.array_equal(values["x/rate"], recording.column("x/rate")[:n])
    assert np.array_equal(values["x/org"], recording.column("x/org")[:n])
    assert values["x/rate"].max() > 5000


def test_samples_that_were_returned_stay_when_the_buffer_moves(session, sampler):
    run(session, 0.1)
    times, values = sampler.read_columns(["x/position", "x/load_angle", "x/lost_steps"], 0, 1.0)
    before = [times.copy(), *(v.copy() for v in values.values())]
    run(session, 2 * FINE_HISTORY_S)
    for now, then in zip([times, *values.values()], before, strict=True):
        assert np.array_equal(now, then)


def test_the_samples_of_long_windows_are_a_millisecond_apart_however_they_came(session, sampler):
    for k in range(30):
        run(session, 0.0102 + 0.00025 * (k % 5))
    run(session, FINE_HISTORY_S)
    times, _ = sampler.read_columns([], 0, 0.3)
    assert len(times) > 290
    assert np.diff(times) == pytest.approx(INTERVAL_S)


def test_a_window_has_both_its_ends_and_is_fine_where_physics_steps_are_kept(session, sampler):
    run(session, FINE_HISTORY_S + 0.5)
    fine, _ = sampler.read_columns([], 1.0, 1.1)
    assert (fine[0], fine[-1]) == pytest.approx((1.0, 1.1))
    assert np.diff(fine) == pytest.approx(sampler.dt)
    for end in (0.2, 2.0):
        coarse, _ = sampler.read_columns([], 0.1, end)
        assert np.diff(coarse) == pytest.approx(INTERVAL_S), "a window that begins earlier is of one kind"
    assert sampler.last_time == pytest.approx(FINE_HISTORY_S + 0.5)
    assert len(sampler.read_columns(["x/position"], 9.0, 10.0)[1]["x/position"]) == 0


def test_each_trace_is_thinned_for_itself(session, sampler):
    session.do(lambda stage: stage.place(x=0.01, y=-0.02))
    run(session, 0.5)
    names = ["x/position", "y/position", "x/org"]
    curves = sampler.read_thinned_columns(names, 0.1, 0.4, 10)
    times, values = sampler.read_columns(names, 0.1, 0.4)
    for name, curve in curves.items():
        assert [c.tolist() for c in curve] == [c.tolist() for c in thin_curve(times, values[name], 10)]
    assert curves["x/position"][1] == pytest.approx(10, abs=0.5)
    assert curves["y/position"][1] == pytest.approx(-20, abs=0.5)
    assert len(curves["x/org"][0]) == 20


def test_time_may_go_back(session, sampler):
    run(session, 0.01)
    snapshot = session.do(lambda stage: stage.snapshot())
    run(session, 0.02)
    session.do(lambda stage: stage.chips[0].write(0, 0x90))
    publish(session)
    assert len(sampler.events) == 1
    session.restore(snapshot)
    publish(session)
    assert sampler.last_time <= 0.0101
    assert not sampler.events, "that is still to come"
    run(session, 0.01)
    times, _ = sampler.read_columns([], 0, 1.0)
    assert np.all(np.diff(times) > 0)
    assert times[-1] == pytest.approx(0.02, abs=3e-4)
    session.reset()
    publish(session)
    assert len(sampler.read_columns([], 0, 1.0)[0]) <= 1


def test_diagnostics_are_events_of_their_chip_and_time_once_each_and_none_of_before(session):
    session.reset()
    session.do(lambda stage: stage.chips[0].write(0, 0x15))  # before the sampler begins
    sampler = Sampler(session)
    run(session, 0.01)
    assert not sampler.events
    for k, wrong in ((1, 0x15), (0, 0x90), (1, 0x90)):
        session.do(lambda stage, k=k, wrong=wrong: stage.chips[k].write(0, wrong))
        run(session, 0.01)
    noted = [(d.clock / chip.clock_hz, d.message) for chip in session.stage.chips for d in chip.diagnostics]
    expected = sorted((n for n in noted if n[0] > 0.009), key=lambda n: n[0])
    assert [(e.time, e.text) for e in sampler.events] == [(t, f"PCL240K: {m}") for t, m in expected]
    assert len(expected) >= 3
    assert sampler.events.maxlen == MAX_EVENTS == 500
    sampler.close()


def test_an_unknown_trace_is_refused_with_near_misses(sampler):
    with pytest.raises(ArgumentError, match="x/position"):
        sampler.read_columns(["x/positon"], 0, 1)


def test_nothing_is_left_of_a_sampler_that_was_closed(session):
    session.reset()
    observers = len(session._observers)
    sampler = Sampler(session)
    run(session, 0.01)
    assert session.stage.loop.recording is sampler
    last = sampler.last_time
    sampler.close()
    assert session.stage.loop.recording is None
    assert len(session._observers) == observers
    run(session, 0.01)
    assert sampler.last_time == last


def test_a_recording_takes_the_samplers_place_and_gives_it_back(session, sampler):
    for _ in range(2):  # the second recording is read from its begin
        with session.do(lambda stage: stage.record()) as recording:
            for _ in range(3):
                run(session, 0.01)
            assert len(recording) == 30
            at = session.stage.time
            times, _ = sampler.read_columns([], at - 0.0255, at)
            assert len(times) == pytest.approx(26, abs=1)
            assert np.diff(times) == pytest.approx(INTERVAL_S)
            session.do(lambda stage, recording=recording: recording.close())
    run(session, 0.01)
    assert sampler.last_time == pytest.approx(session.stage.time, abs=3e-4)
    assert session.stage.recording is None


def test_a_running_recording_is_read_from_its_start_and_not_disturbed(session):
    session.reset()
    recording = session.do(lambda stage: stage.record())
    run(session, 0.01)
    sampler = Sampler(session)
    run(session, 0.01)
    assert session.do(lambda stage: stage.recording is recording)
    assert sampler.last_time == pytest.approx(0.02, abs=1.1e-3)
    assert sampler.read_columns([], 0, 1.0)[0][0] <= 1.1e-3, "what was recorded before"
    sampler.close()
    run(session, 0.01)
    assert session.stage.recording is recording
    assert recording.column("time")[-1] == pytest.approx(0.03, abs=1.1e-3)
    session.do(lambda stage: recording.close())


def test_samplers_of_one_stage_have_the_same_samples(session, sampler):
    run(session, 0.01)
    second = Sampler(session)
    run(session, 0.01)
    third = Sampler(session)
    sampler.close()
    run(session, 0.01)
    assert sampler.last_time == pytest.approx(0.02, abs=3e-4), "it is closed"
    third.close()
    run(session, 0.01)
    assert third.last_time == pytest.approx(0.03, abs=3e-4)
    times, values = second.read_columns(["x/position"], 0, 1.0)
    assert np.diff(times) == pytest.approx(2.5e-4), "none is missing, none twice"
    assert times[0] == pytest.approx(0.0102, abs=3e-4)
    assert times[-1] == second.last_time == pytest.approx(0.04, abs=3e-4)
    assert len(values["x/position"]) == len(times)
    second.close()
    assert session.do(lambda stage: stage.loop.recording) is None


def test_a_stage_without_axes_has_no_samples():
    calls, state = [], SimpleNamespace(dt=250_000)
    stage = SimpleNamespace(
        axes={}, chips=[], model=SimpleNamespace(nq=0), state=state, loop=SimpleNamespace(recording=None)
    )
    session = SimpleNamespace(
        stage=stage, do=lambda order: calls.append(order) or order(stage), call_after_pacing_intervals=calls.append
    )
    sampler = Sampler(session)
    assert (sampler.traces, calls, sampler.last_time) == ({}, [], -1.0)
    sampler.close()


def test_traces_have_the_unit_of_their_axis_and_the_quantities_of_its_drive():
    traces = find_traces(Stage("xya", visuals=False))
    assert [traces[f"{a}/position"].unit for a in "xya"] == ["mm", "mm", "deg"]
    assert [traces[f"{a}/velocity"].unit for a in "xya"] == ["mm/s", "mm/s", "deg/s"]
    row = np.zeros(2, SAMPLE)
    row["velocity"], row["position"], row["torque"], row["current_a"], row["current_b"] = 0.5, 0.25, 3, 1, 2
    values = {name: trace.value(row)[0] for name, trace in traces.items() if not trace.pin}
    assert (values["x/velocity"], values["a/velocity"]) == (500, pytest.approx(np.degrees(0.5)))
    assert values["a/position"] == pytest.approx(np.degrees(0.25))
    assert (values["x/torque"], values["x/current_a"], values["x/current_b"]) == (3, 1, 2)
    assert (traces["a/position"].title, traces["a/position"].axis) == ("a position", 2)
    assert (traces["x/current_a"].places, traces["x/velocity"].places) == (4, 4)
    servo = find_traces(Stage("xy", chips="hctl1100", visuals=False))
    assert "x/current_a" not in servo
    assert {"x/torque", "x/velocity"} <= set(servo)
    assert (servo["x/rate"].title, servo["x/rate"].unit) == ("x commanded velocity", "counts/s")


def test_each_pin_is_its_own_bit_of_its_own_word():
    stage = Stage("xy", visuals=False)
    traces, chip = find_traces(stage), stage.chips[0]
    for field, pins in (("inputs", chip.INPUTS), ("outputs", chip.OUTPUTS)):
        for pin, bit in pins.items():
            rows = np.zeros(3, SAMPLE)
            rows[field] = [0, bit, ~bit & 0xFFFF]
            trace = traces[f"y/{pin}"]
            assert (trace.value(rows).tolist(), trace.pin, trace.axis, trace.unit) == ([0, 1, 0], True, 1, "")
