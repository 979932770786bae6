"""What charts see is what the stage did, in memory that does not grow, also when time goes back."""

import numpy as np
import pytest

from stage import Stage, firmware
from stage.errors import ArgumentError
from stage.panel import sampler as sampling
from stage.panel.sampler import SampleBuffer, Sampler, thin_curve
from stage.sim.records import SAMPLE


def run(session, seconds):
    session.do(lambda stage: session.run_unpaced(stage.run, seconds))
    looked(session)


def looked(session):
    session.do(lambda stage: session._publish())  # and everybody has had his look


def test_samples_are_those_of_a_recording(session, sampler):
    """Position, rate, a pin: equal to what a recording of the same program has, at its times."""

    def program(stage):
        session.run_unpaced(firmware.move, stage.axes["x"], 0.002)

    session.act("move", program).result(30)
    twin = Stage("xy", visuals=False)
    with twin.record(every=2.5e-4) as recording:
        firmware.move(twin.axes["x"], 0.002)
    times, seen = sampler.columns(["x/position", "x/rate", "x/org"], 0, 1.0)
    n = len(times)
    assert n > 500
    assert np.array_equal(times, recording.column("time")[:n])
    assert np.array_equal(seen["x/position"], recording.column("x/position")[:n] * 1e3)  # mm
    assert np.array_equal(seen["x/rate"], recording.column("x/rate")[:n])
    assert np.array_equal(seen["x/org"], recording.column("x/org")[:n])
    assert seen["x/rate"].max() > 5000


def test_the_samples_of_long_windows_are_a_millisecond_apart_however_they_came(session, sampler):
    for k in range(30):
        run(session, 0.0102 + 0.00025 * (k % 5))
    run(session, sampling.FINE)
    times, _ = sampler.columns([], 0, 0.3)
    assert len(times) > 290
    assert np.diff(times) == pytest.approx(sampling.COARSE)


def test_time_may_go_back(session, sampler):
    run(session, 0.01)
    snapshot = session.do(lambda stage: stage.snapshot())
    run(session, 0.02)
    session.do(lambda stage: stage.chips[0].write(0, 0x90))
    looked(session)
    assert len(sampler.events) == 1
    session.restore(snapshot)
    looked(session)
    assert sampler.last <= 0.0101
    assert not sampler.events, "that is still to come"
    run(session, 0.01)
    times, _ = sampler.columns([], 0, 1.0)
    assert np.all(np.diff(times) > 0)
    assert times[-1] == pytest.approx(0.02, abs=3e-4)
    session.reset()
    looked(session)
    assert len(sampler.columns([], 0, 1.0)[0]) <= 1


def test_a_recording_takes_its_place_and_gives_it_back(session, sampler):
    with session.do(lambda stage: stage.record()) as recording:
        run(session, 0.01)
        assert len(recording) == 10
        times, _ = sampler.columns([], 0, 1.0)
        assert times[-1] == pytest.approx(0.01, abs=1.1e-3)
        session.do(lambda stage: recording.close())
    looked(session)
    run(session, 0.01)
    assert sampler.last == pytest.approx(0.02, abs=3e-4)
    assert session.stage.recording is None


def test_diagnostics_are_events(session, sampler):
    axis = session.stage.axes["x"]
    session.do(lambda stage: axis.chip.write(0, 0x90))
    looked(session)
    said = session.do(lambda stage: [d.message for d in axis.chip.diagnostics])
    assert said
    assert [e.text.split(": ", 1)[1] for e in sampler.events] == said


def test_wrong_names_are_said_with_near_misses(sampler):
    with pytest.raises(ArgumentError, match="x/position"):
        sampler.columns(["x/positon"], 0, 1)


def test_a_ring_forgets_what_is_old():
    buffer = SampleBuffer(10, 2)
    for k in range(7):
        rows = np.zeros((4, 2), SAMPLE)
        rows["time"] = (4 * k + np.arange(4))[:, None]
        rows["lost_steps"] = [[k, 10 * k]] * 4
        buffer.extend(rows)
    assert (buffer.first, buffer.last) == (18, 27)
    a, b = buffer.find(20), buffer.find(26)
    assert list(buffer.times(a, b)) == [20, 21, 22, 23, 24, 25]
    assert list(buffer.axis(1, a, b)["lost_steps"]) == [50] * 4 + [60] * 2
    buffer.forget_from(24.0)
    assert buffer.last == 23


def test_thinning_keeps_every_peak():
    values = np.zeros(100_000)
    values[[3, 77_777]] = 1, -2
    times, v = thin_curve(np.arange(100_000.0), values, 300)
    assert len(v) <= 600
    assert (v.max(), v.min()) == (1, -2)
    assert np.all(np.diff(times) >= 0)
    assert times[v.argmin()] == 77_777


def test_traces_of_a_stage_have_units(sampler):
    assert sampler.traces["x/position"].unit == "mm"
    assert sampler.traces["y/org"].pin
    assert "x/current_a" in sampler.traces
    assert sampling.MAX_AGE_S == 60


def test_a_recording_that_goes_on_is_not_disturbed(session):
    recording = session.do(lambda stage: stage.record())
    run(session, 0.01)
    sampler = Sampler(session)
    run(session, 0.01)
    assert session.do(lambda stage: stage.recording is recording)
    assert len(recording) == 20
    assert sampler.last == pytest.approx(0.02, abs=1.1e-3)
    assert sampler.columns([], 0, 1.0)[0][0] <= 1.1e-3, "what was recorded before is seen, too"
    session.do(lambda stage: recording.close())
    run(session, 0.01)
    assert sampler.last == pytest.approx(0.03, abs=3e-4)
    sampler.close()


def test_samplers_of_one_stage_see_the_same_whoever_comes_and_goes(session, sampler):
    run(session, 0.01)
    second = Sampler(session)
    run(session, 0.01)
    third = Sampler(session)
    sampler.close()
    run(session, 0.01)
    assert sampler.last == pytest.approx(0.02, abs=3e-4), "it is closed"
    third.close()
    run(session, 0.01)
    assert third.last == pytest.approx(0.03, abs=3e-4)
    times, seen = second.columns(["x/position"], 0, 1.0)
    assert np.diff(times) == pytest.approx(2.5e-4), "none is missing, none twice"
    assert times[0] == pytest.approx(0.0102, abs=3e-4)
    assert times[-1] == second.last == pytest.approx(0.04, abs=3e-4)
    assert len(seen["x/position"]) == len(times)
    second.close()
    assert session.do(lambda stage: stage.loop.recording) is None
