"""Snapshots go to files and come back bit for bit; whatever else a file holds is refused in words, and never run."""

import hashlib
import json
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.examples import SEED

from stage import ArgumentError, Snapshot, Stage, firmware
from stage.chips import PCL240K, PCL240MS
from stage.chips.chip import Snapshot as ChipSnapshot
from stage.support.files import FileError
from stage.support.snapshot_files import DIGEST_BYTES, LENGTHS_STRUCT, MAGIC, SnapshotError


@pytest.fixture(scope="module")
def moving_stage():
    """Stage in the middle of a move whose chip has recorded a diagnostic."""
    stage = Stage("xy", visuals=False)
    firmware.preset_move(stage.axes["x"], 400)
    stage.axes["x"].chip.write(0, 0x15)  # a start with an empty counter
    stage.run(0.0101)
    return stage


@pytest.fixture(scope="module")
def snapshot_file(moving_stage, tmp_path_factory):
    return moving_stage.snapshot().save(tmp_path_factory.mktemp("kept") / "moved.snapshot")


def update_checksum(data: bytes) -> bytes:
    """Replace the checksum at the end of a file by that of its present content."""
    return data[:-DIGEST_BYTES] + hashlib.sha256(data[:-DIGEST_BYTES]).digest()


def replace_header_fields(data: bytes, **changes) -> bytes:
    """Replace fields of the header of a snapshot file and update its checksum."""
    form, head, state = LENGTHS_STRUCT.unpack_from(data, len(MAGIC))
    begin = len(MAGIC) + LENGTHS_STRUCT.size
    header = json.dumps(json.loads(data[begin : begin + head]) | changes).encode()
    return update_checksum(MAGIC + LENGTHS_STRUCT.pack(form, len(header), state) + header + data[begin + head :])


PROGRAM = """
import sys
from stage import Snapshot, Stage
stage = Stage("xy")
stage.restore(Snapshot.load(sys.argv[1]))
stage.run(0.05)
print(stage.snapshot().state.tobytes().hex())
"""


def test_another_process_continues_from_a_file_bit_for_bit(moving_stage, snapshot_file):
    state_of_process = subprocess.run(
        [sys.executable, "-c", PROGRAM, snapshot_file], capture_output=True, text=True, check=True
    ).stdout
    replica = Stage("xy", visuals=False)
    replica.restore(moving_stage.snapshot())
    replica.run(0.05)
    assert state_of_process.strip() == replica.snapshot().state.tobytes().hex()


def test_a_loaded_snapshot_equals_the_saved_one_with_its_diagnostics(moving_stage, snapshot_file):
    before, after = moving_stage.snapshot(), Snapshot.load(snapshot_file)
    assert (after.header, after.diagnostics, after.checksum) == (before.header, before.diagnostics, before.checksum)
    assert any(before.diagnostics), "or nothing is compared"
    assert np.array_equal(after.state, before.state)
    with pytest.raises(ValueError, match="read-only"):
        after.state[0] = 1


def test_a_snapshot_file_of_a_chip_is_refused_as_one_of_a_stage(snapshot_file, tmp_path):
    chip = PCL240MS()
    chip.write(0, 0x15)
    path = chip.snapshot().save(tmp_path / "chip.snapshot")
    replica = PCL240MS()
    replica.restore(ChipSnapshot.load(path))
    assert replica.snapshot() == chip.snapshot()
    with pytest.raises(SnapshotError, match=r"is a snapshot of a chip, and was loaded as one of a stage"):
        Snapshot.load(path)
    with pytest.raises(SnapshotError, match=r"is a snapshot of a stage, and was loaded as one of a chip"):
        ChipSnapshot.load(snapshot_file)
    with pytest.raises(ArgumentError, match="chip: PCL240MS at 4915200 Hz there, PCL240K at 4915200 Hz here"):
        PCL240K().restore(ChipSnapshot.load(path))


def test_restore_refuses_the_file_of_another_stage(snapshot_file):
    with pytest.raises(ArgumentError, match=r"axes: x, y there, x, y, z here"):
        Stage("xyz", visuals=False).restore(Snapshot.load(snapshot_file))


def test_a_snapshot_file_is_overwritten_only_on_request(moving_stage, tmp_path):
    path = tmp_path / "mine.snapshot"
    path.write_text("mine")
    with pytest.raises(FileError, match=r"mine\.snapshot exists\. Choose another name, or say overwrite=True"):
        moving_stage.snapshot().save(path)
    moving_stage.snapshot().save(path, overwrite=True)
    assert Snapshot.load(path).header == moving_stage.snapshot().header


def test_flipped_bits_and_missing_or_extra_bytes_are_refused(snapshot_file, tmp_path):
    data, seed = snapshot_file.read_bytes(), SEED
    print("seed", seed)
    rng = np.random.default_rng(seed)
    bits = [*range(8 * 40), *rng.integers(0, 8 * len(data), 200).tolist(), 8 * len(data) - 1]
    broken = [data[: bit // 8] + bytes([data[bit // 8] ^ 1 << bit % 8]) + data[bit // 8 + 1 :] for bit in bits]
    broken += [data[:n] for n in (0, 1, 19, 20, 35, 36, 67, 68, len(data) // 2, len(data) - 1)] + [
        data + b"\0",
        data * 2,
    ]
    path = tmp_path / "broken.snapshot"
    for damaged in broken:
        path.write_bytes(damaged)
        with pytest.raises(SnapshotError, match=r"broken\.snapshot is ") as caught:
            Snapshot.load(path)
        assert len(str(caught.value)) < 300


class FileMakingPickle:
    """Pickle that creates a file when it is loaded."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_a_file_that_is_no_snapshot_is_refused_and_never_unpickled(tmp_path, snapshot_file):
    """Snapshot.load("of_somebody.pickle")"""
    trap, path = tmp_path / "sprung", tmp_path / "foreign"
    (tmp_path / "folder").mkdir()
    for content in (pickle.dumps(FileMakingPickle(trap)), b"PK\3\4" * 100, b"{}", bytes(10_000)):
        path.write_bytes(content)
        with pytest.raises(SnapshotError, match=r"foreign is no snapshot of PulseStage: it does not begin as one"):
            Snapshot.load(path)
    assert not trap.exists()
    (tmp_path / "empty").touch()
    for name, message in (("nothing", "there is no snapshot .*nothing"), ("folder", "folder is a folder. Name a file in it"),
                       ("empty", "empty is empty, and no snapshot")):  # fmt: skip
        with pytest.raises(SnapshotError, match=message) as caught:
            Snapshot.load(tmp_path / name)
        assert ".." not in str(caught.value)
    with pytest.raises(SnapshotError, match=r"^3\.5 is no path"):
        Snapshot.load(3.5)
    with pytest.raises(SnapshotError, match=r"cannot be read: embedded null byte|there is no snapshot"):
        Snapshot.load("a\0b")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": 0}, "is of version 0 of a stage's state, and this PulseStage reads version 1: take it anew"),
        ({"version": 2}, "is of version 2 of a stage's state, and this PulseStage reads version 1: take it anew"),
        ({"checksum": 1}, "its description does not fit its state"),
        ({"parts": [["axes", "y"]]}, "its description does not fit its state"),
        ({"parts": 7}, "its description does not fit its state"),
        ({"noted": [[[1, 2, "x", 3, 4]]]}, "its description does not fit its state"),
        ({"noted": [[[1, 2]]]}, "its description does not fit its state"),
    ],
)
def test_a_header_that_contradicts_the_state_is_refused(snapshot_file, tmp_path, changes, message):
    path = tmp_path / "changed.snapshot"
    path.write_bytes(replace_header_fields(snapshot_file.read_bytes(), **changes))
    with pytest.raises(SnapshotError, match=message):
        Snapshot.load(path)


def test_another_version_of_the_file_format_is_refused(snapshot_file, tmp_path):
    data, path = snapshot_file.read_bytes(), tmp_path / "next.snapshot"
    _, head, state = LENGTHS_STRUCT.unpack_from(data, len(MAGIC))
    path.write_bytes(
        update_checksum(MAGIC + LENGTHS_STRUCT.pack(2, head, state) + data[len(MAGIC) + LENGTHS_STRUCT.size :])
    )
    with pytest.raises(SnapshotError, match="of file format 2, and this PulseStage reads format 1"):
        Snapshot.load(path)
