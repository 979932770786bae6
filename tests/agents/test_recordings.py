"""Recordings of a session: columns for reading, and files in one folder and nowhere else."""

import pytest

from stage.agents.recordings import SAMPLES, Recordings
from stage.errors import ArgumentError, StageError


@pytest.fixture
def recording(make_box, tmp_path):
    folder = tmp_path / "given"
    folder.mkdir()
    box = make_box(mode="truth")
    Recordings(box, str(folder)).join()
    yield box
    if box.stage.recording is not None:
        box.stage.recording.close()


def a_recording(box):
    assert box.call("record", {"on": True}).ok
    assert box.call("move", {"axis": "x", "pulses": 1000}).ok
    return box.call("record", {"on": False})


def test_a_host_reads_the_course_of_its_last_move(make_box):
    box = make_box()
    Recordings(box).join()
    assert "record" not in box.tools
    with pytest.raises(StageError, match="nothing has been recorded"):
        box.recordings.last()
    box.call("move", {"axis": "x", "pulses": 1000})
    columns = box.recordings.last()["columns"]
    assert columns["pulses"][-1] == 1000
    assert len(columns["seconds"]) == len(columns["pulses"]) <= SAMPLES


def test_who_sees_the_truth_records_it(recording):
    ended = a_recording(recording)
    assert ended.data["seconds"] > 0.1
    columns = recording.recordings.last()["columns"]
    assert columns
    assert all(len(c) <= SAMPLES for c in columns.values())


def test_files_are_written_into_the_folder_only(recording, tmp_path):
    a_recording(recording)
    assert recording.call("save_recording", {"name": "a.vcd"}).data["bytes"] > 100
    assert (tmp_path / "given" / "a.vcd").is_file()
    (tmp_path / "given" / "link.vcd").symlink_to(tmp_path / "outside.vcd")
    for name in ("../a.vcd", "/tmp/a.vcd", "a.vcd/../b.vcd", ".a.vcd", "a.txt", "a\0.vcd", "", "link.vcd", "a.vcd"):
        assert not recording.call("save_recording", {"name": name}).ok
    assert sorted(p.name for p in tmp_path.rglob("*.vcd")) == ["a.vcd", "link.vcd"]
    assert not (tmp_path / "outside.vcd").exists()


def test_without_a_folder_no_file_is_written(make_box):
    box = make_box(mode="truth")
    Recordings(box).join()
    assert "save_recording" not in box.tools
    with pytest.raises(ArgumentError, match="is no folder"):
        Recordings(box, "/nowhere/at/all")


def test_a_recording_ends_by_itself(recording, monkeypatch):
    monkeypatch.setattr("stage.agents.recordings.LONGEST", 0.1)
    recording.call("record", {"on": True})
    recording.call("wait", {"seconds": 0.2})
    assert recording.stage.recording is None
    assert "nothing is being recorded" in recording.call("record", {"on": False}).text


def test_time_in_a_recording_runs_forward_only(recording):
    recording.call("record", {"on": True})
    assert "runs forward only" in recording.call("restore", {"name": "power-up"}).text
