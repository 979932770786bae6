"""Recordings of a session: columns for reading, and files in one folder and nowhere else."""

import numpy as np
import pytest

from stage.agents import Toolbox
from stage.agents.recording_tools import MAX_SAMPLES, StageRecorderTools, thin_out
from stage.errors import ArgumentError, StageError


@pytest.fixture
def recording(make_box, tmp_path):
    folder = tmp_path / "given"
    folder.mkdir()
    box = make_box(mode="truth", folder=str(folder))
    return box


def record_move(box):
    assert box.call("record", {"on": True}).ok
    assert box.call("move", {"axis": "x", "pulses": 1000}).ok
    return box.call("record", {"on": False})


def test_a_host_reads_the_profile_of_its_last_move(make_box):
    box = make_box()
    assert "record" not in box.tools
    with pytest.raises(StageError, match="Nothing has been recorded"):
        box.recordings.tabulate_last_recording()
    box.call("move", {"axis": "x", "pulses": 1000})
    columns = box.recordings.tabulate_last_recording()["columns"]
    assert columns["pulses"][-1] == 1000
    assert len(columns["seconds"]) == len(columns["pulses"]) <= MAX_SAMPLES


def test_who_sees_the_truth_records_it(recording):
    finished = record_move(recording)
    assert finished.data["seconds"] > 0.1
    columns = recording.recordings.tabulate_last_recording()["columns"]
    assert columns
    assert all(len(c) <= MAX_SAMPLES for c in columns.values())


def test_files_are_written_into_the_folder_only(recording, tmp_path):
    record_move(recording)
    assert recording.call("save_recording", {"name": "a.vcd"}).data["bytes"] > 100
    assert (tmp_path / "given" / "a.vcd").is_file()
    (tmp_path / "given" / "link.vcd").symlink_to(tmp_path / "outside.vcd")
    for name in ("../a.vcd", "/tmp/a.vcd", "a.vcd/../b.vcd", ".a.vcd", "a.txt", "a\0.vcd", "", "link.vcd", "a.vcd"):
        assert not recording.call("save_recording", {"name": name}).ok
    assert sorted(p.name for p in tmp_path.rglob("*.vcd")) == ["a.vcd", "link.vcd"]
    assert not (tmp_path / "outside.vcd").exists()


def test_without_a_folder_no_file_is_written(make_box):
    box = make_box(mode="truth")
    assert "save_recording" not in box.tools
    with pytest.raises(ArgumentError, match="is no folder"):
        StageRecorderTools(box, "/nowhere/at/all")


def test_a_recording_ends_by_itself(recording, monkeypatch):
    monkeypatch.setattr("stage.agents.recording_tools.MAX_DURATION_S", 0.1)
    recording.call("record", {"on": True})
    recording.call("wait", {"seconds": 0.2})
    assert recording.stage.recording is None
    assert "Nothing is being recorded" in recording.call("record", {"on": False}).text


def test_time_in_a_recording_runs_forward_only(recording):
    recording.call("record", {"on": True})
    assert "runs forward only" in recording.call("restore", {"name": "power-up"}).text


def test_recorded_pulses_of_a_move_begin_at_zero(make_box):
    box = make_box()
    for pulses in (1000, -300):
        box.call("move", {"axis": "x", "pulses": pulses})
        columns = box.recordings.tabulate_last_recording()["columns"]
        assert (columns["pulses"][0], columns["pulses"][-1]) == (0, pulses)


def test_a_column_is_thinned_to_so_many_with_both_its_ends():
    assert thin_out(np.arange(MAX_SAMPLES)) == list(range(MAX_SAMPLES))
    long = thin_out(np.arange(MAX_SAMPLES + 1))
    assert (len(long), long[0], long[-1]) == (MAX_SAMPLES, 0, MAX_SAMPLES)
    assert thin_out(np.array([1.0, np.nan, np.inf, -0.5])) == [1.0, None, None, -0.5]


def test_a_session_writes_so_many_files_and_no_more(recording, monkeypatch):
    monkeypatch.setattr("stage.agents.recording_tools.MAX_FILES", 2)
    record_move(recording)
    assert [recording.call("save_recording", {"name": f"{k}.vcd"}).ok for k in range(3)] == [True, True, False]
    assert "A session writes at most 2 files" in recording.call("save_recording", {"name": "4.vcd"}).text


def test_a_recording_continues_from_call_to_call(recording):
    recording.call("record", {"on": True})
    for _ in range(3):
        recording.call("wait", {"seconds": 0.1})
        assert recording.stage.recording is not None
        assert "The recording still runs" in recording.call("save_recording", {"name": "a.vcd"}).text
    assert recording.call("record", {"on": False}).data["seconds"] == pytest.approx(0.3, abs=0.01)
    assert "seconds" in recording.recordings.tabulate_last_recording(), "of the recording"
    recording.call("move", {"axis": "x", "pulses": 10})
    assert recording.recordings.tabulate_last_recording()["axis"] == "x", "a move since then is the last"


def test_the_end_of_a_session_ends_the_recording_that_it_has_started_and_no_other(make_box):
    box = make_box(mode="truth")
    stage = box.stage
    assert box.call("record", {"on": True}).ok
    box.close()
    assert stage.recording is None

    with stage.record() as recording:
        Toolbox(stage, "truth").close()
        assert stage.recording is recording


def test_an_agent_may_end_the_recording_of_the_stages_owner(make_box):
    box = make_box(mode="truth")
    with box.stage.record():
        box.stage.run(0.01)
        assert box.call("record", {"on": False}).data["seconds"] == pytest.approx(0.01)
        assert box.stage.recording is None
