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
from stage.support.snapshot_files import DIGEST_BYTES, LENGTHS, MAGIC, SnapshotError


@pytest.fixture(scope="module")
def moved():
    """In the middle of a move, with a mistake that its chip has noted."""
    stage = Stage("xy", visuals=False)
    firmware.preset_move(stage.axes["x"], 400)
    stage.axes["x"].chip.write(0, 0x15)  # a start with an empty counter
    stage.run(0.0101)
    return stage


@pytest.fixture(scope="module")
def kept(moved, tmp_path_factory):
    return moved.snapshot().save(tmp_path_factory.mktemp("kept") / "moved.snapshot")


def resealed(data: bytes) -> bytes:
    """With the sum of what it now has."""
    return data[:-DIGEST_BYTES] + hashlib.sha256(data[:-DIGEST_BYTES]).digest()


def with_head(data: bytes, **changes) -> bytes:
    """With other things in its head."""
    form, head, state = LENGTHS.unpack_from(data, len(MAGIC))
    begin = len(MAGIC) + LENGTHS.size
    told = json.dumps(json.loads(data[begin : begin + head]) | changes).encode()
    return resealed(MAGIC + LENGTHS.pack(form, len(told), state) + told + data[begin + head :])


PROGRAM = """
import sys
from stage import Snapshot, Stage
stage = Stage("xy")
stage.restore(Snapshot.load(sys.argv[1]))
stage.run(0.05)
print(stage.snapshot().state.tobytes().hex())
"""


def test_another_process_goes_on_from_a_file_bit_for_bit(moved, kept):
    there = subprocess.run([sys.executable, "-c", PROGRAM, kept], capture_output=True, text=True, check=True).stdout
    twin = Stage("xy", visuals=False)
    twin.restore(moved.snapshot())
    twin.run(0.05)
    assert there.strip() == twin.snapshot().state.tobytes().hex()


def test_what_comes_back_is_what_went_with_all_that_the_chips_have_noted(moved, kept):
    before, after = moved.snapshot(), Snapshot.load(kept)
    assert (after.header, after.diagnostics, after.checksum) == (before.header, before.diagnostics, before.checksum)
    assert any(before.diagnostics), "or nothing is compared"
    assert np.array_equal(after.state, before.state)
    with pytest.raises(ValueError, match="read-only"):
        after.state[0] = 1


def test_a_chip_goes_to_a_file_too_and_kinds_are_not_mixed(kept, tmp_path):
    chip = PCL240MS()
    chip.write(0, 0x15)
    path = chip.snapshot().save(tmp_path / "chip.snapshot")
    twin = PCL240MS()
    twin.restore(ChipSnapshot.load(path))
    assert twin.snapshot() == chip.snapshot()
    with pytest.raises(SnapshotError, match=r"is a snapshot of a chip, and was loaded as one of a stage"):
        Snapshot.load(path)
    with pytest.raises(SnapshotError, match=r"is a snapshot of a stage, and was loaded as one of a chip"):
        ChipSnapshot.load(kept)
    with pytest.raises(ArgumentError, match="chip: PCL240MS at 4915200 Hz there, PCL240K at 4915200 Hz here"):
        PCL240K().restore(ChipSnapshot.load(path))


def test_a_file_of_another_stage_is_refused_by_restore_as_ever(kept):
    with pytest.raises(ArgumentError, match=r"axes: x, y there, x, y, z here"):
        Stage("xyz", visuals=False).restore(Snapshot.load(kept))


def test_a_file_that_exists_stays_unless_overwriting_is_asked_for(moved, tmp_path):
    path = tmp_path / "mine.snapshot"
    path.write_text("mine")
    with pytest.raises(FileError, match=r"mine\.snapshot exists\. Choose another name, or say overwrite=True"):
        moved.snapshot().save(path)
    moved.snapshot().save(path, overwrite=True)
    assert Snapshot.load(path).header == moved.snapshot().header


def test_no_flipped_bit_and_no_missing_or_further_byte_gets_by(kept, tmp_path):
    data, seed = kept.read_bytes(), SEED
    print("seed", seed)
    rng = np.random.default_rng(seed)
    bits = [*range(8 * 40), *rng.integers(0, 8 * len(data), 200).tolist(), 8 * len(data) - 1]
    broken = [data[: bit // 8] + bytes([data[bit // 8] ^ 1 << bit % 8]) + data[bit // 8 + 1 :] for bit in bits]
    broken += [data[:n] for n in (0, 1, 19, 20, 35, 36, 67, 68, len(data) // 2, len(data) - 1)] + [
        data + b"\0",
        data * 2,
    ]
    path = tmp_path / "broken.snapshot"
    for one in broken:
        path.write_bytes(one)
        with pytest.raises(SnapshotError, match=r"broken\.snapshot is ") as said:
            Snapshot.load(path)
        assert len(str(said.value)) < 300


class Trap:
    """Whoever unpickles it makes a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_what_is_no_snapshot_is_named_and_never_run(tmp_path, kept):
    """Snapshot.load("of_somebody.pickle")"""
    trap, path = tmp_path / "sprung", tmp_path / "foreign"
    (tmp_path / "folder").mkdir()
    for content in (pickle.dumps(Trap(trap)), b"PK\3\4" * 100, b"{}", bytes(10_000)):
        path.write_bytes(content)
        with pytest.raises(SnapshotError, match=r"foreign is no snapshot of PulseStage: it does not begin as one"):
            Snapshot.load(path)
    assert not trap.exists()
    (tmp_path / "empty").touch()
    for name, said in (("nothing", "there is no snapshot .*nothing"), ("folder", "folder is a folder. Name a file in it"),
                       ("empty", "empty is empty, and no snapshot")):  # fmt: skip
        with pytest.raises(SnapshotError, match=said) as caught:
            Snapshot.load(tmp_path / name)
        assert ".." not in str(caught.value)
    with pytest.raises(SnapshotError, match=r"^3\.5 is no path"):
        Snapshot.load(3.5)
    with pytest.raises(SnapshotError, match=r"cannot be read: embedded null byte|there is no snapshot"):
        Snapshot.load("a\0b")


@pytest.mark.parametrize(
    ("changes", "said"),
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
def test_a_head_that_was_changed_with_its_sum_is_refused_too(kept, tmp_path, changes, said):
    path = tmp_path / "changed.snapshot"
    path.write_bytes(with_head(kept.read_bytes(), **changes))
    with pytest.raises(SnapshotError, match=said):
        Snapshot.load(path)


def test_another_format_of_the_file_says_that_it_is_one(kept, tmp_path):
    data, path = kept.read_bytes(), tmp_path / "next.snapshot"
    _, head, state = LENGTHS.unpack_from(data, len(MAGIC))
    path.write_bytes(resealed(MAGIC + LENGTHS.pack(2, head, state) + data[len(MAGIC) + LENGTHS.size :]))
    with pytest.raises(SnapshotError, match="of file format 2, and this PulseStage reads format 1"):
        Snapshot.load(path)
