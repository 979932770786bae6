"""What happens at the very moment of a flush is in the file as without one; samples that go back in one buffer are found out."""

import pytest
from support.recording_bench import feed

from stage import Stage, faults
from stage.recording import RecordingError, read


@pytest.mark.parametrize("flushed", [True, False])
def test_a_switch_that_trips_as_the_file_is_flushed_is_on_from_then_on(tmp_path, flushed):
    pytest.importorskip("rerun")
    stage, path = Stage("xy", chips="pcl240ms", visuals=False), tmp_path / "x.rrd"
    with stage.record(path=path) as recording:
        stage.run(0.01)
        if flushed:
            recording.flush()
        with faults.switch_stuck(stage.axes["y"], "org", True):
            stage.run(0.02)
            if flushed:
                recording.flush()
        stage.run(0.01)
    times, states = read(path).states["y/org"]
    assert states.tolist() == ["off", "ORG", "off"]
    assert times.tolist() == pytest.approx([0.0, 0.01, 0.03], abs=1e-6)


def test_samples_that_go_back_in_one_buffer_are_detected(bench):
    feed(bench.recording, 10)
    bench.recording.require_forward_time()
    bench.recording.samples["time"][7:10] -= 0.005
    with pytest.raises(RecordingError, match=r"went back in time while it was recorded \(axis x\)"):
        bench.recording.require_forward_time()
