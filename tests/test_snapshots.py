"""A snapshot goes back only where it belongs, and only whole; everything else is refused in words, and nothing has changed."""

import copy
import pickle
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from support.examples import SEED

from stage import ArgumentError, Drive, Stage
from stage.chips import PCL240K, PCL240MS
from stage.sim import plant
from stage.support import snapshots
from stage.support.snapshots import SnapshotHeader, hash_layout


@pytest.fixture(scope="module")
def module_stage():
    return Stage("xy", visuals=False)


@pytest.fixture
def xy(module_stage):
    module_stage.reset()
    return module_stage


def change_spec(change):
    spec = plant.open_spec("xy")
    change(spec)
    return spec


def damp(spec):
    spec.joint("x").damping = [12, 0, 0]


def halve_step(spec):
    spec.option.timestep = 1.25e-4


def flip_bit(data: bytes, bit: int) -> bytes:
    other = bytearray(data)
    other[bit // 8] ^= 1 << bit % 8
    return bytes(other)


@pytest.mark.parametrize(
    ("other", "says"),
    {
        "microsteps": (lambda: Stage("xy", drives=Drive(microsteps=64), visuals=False),
                       r"drive of axis x: 17HS4401, 1/64 steps .* there, 17HS4401, 1/16 steps"),
        "supply": (lambda: Stage("xy", drives={"y": Drive(bus_voltage=48)}, visuals=False), "drive of axis y: "),
        "bus": (lambda: Stage("xy", bus_cycle=0, visuals=False), "bus cycle: 0 ns there, 1000 ns here"),
        "chips": (lambda: Stage("xy", chips=PCL240MS, visuals=False), "chip of axis x: PCL240MS at .* there, PCL240K at"),
        "axes": (lambda: Stage("xy", chips={"y": PCL240K}, visuals=False), "axes: y there, x, y here"),
        "mechanics": (lambda: Stage(change_spec(damp), visuals=False), "mechanics of the model: "),
        "time step": (lambda: Stage(change_spec(halve_step), visuals=False), "time step: 125000 ns there, 250000 ns here"),
    }.values(),
)  # fmt: skip
def test_a_snapshot_of_another_stage_is_refused_and_says_what_differs(xy, other, says):
    """Stage("xy").restore(Stage("xy", drives=Drive(microsteps=64)).snapshot())"""
    before = xy.snapshot()
    with pytest.raises(ArgumentError, match=f"(?s)cannot be restored here, for it is another's: {says}"):
        xy.restore(other().snapshot())
    assert xy.snapshot().state.tobytes() == before.state.tobytes()


def test_what_is_only_looked_at_payloads_and_copies_make_no_other_stage(xy):
    begin = xy.snapshot()
    replica, observed = copy.deepcopy(xy), Stage("xy")
    xy.set_payload(0.5)
    for stage in (xy, replica, observed, copy.deepcopy(xy)):
        for snapshot in (
            begin,
            xy.snapshot(),
            observed.snapshot(),
            pickle.loads(pickle.dumps(begin)),
            copy.copy(begin),
        ):
            stage.restore(snapshot)
    xy.set_payload(0)


@pytest.mark.parametrize(
    "other",
    [
        [("b", "i4"), ("a", "i4", 2)],
        [("a", "i4"), ("b", "u4", 2)],
        [("a", "i4", 2), ("b", "i4")],
        "V12",
        [("a", "i4", 3)],
    ],
)
def test_records_that_lie_otherwise_in_the_same_room_have_another_layout(other):
    kind = np.dtype([("a", "i4"), ("b", "i4", 2)])
    assert np.dtype(other).itemsize == kind.itemsize
    assert hash_layout(np.dtype(other)) != hash_layout(kind) == hash_layout(np.dtype(kind.descr))
    assert hash_layout(np.dtype([("in", other)])) != hash_layout(np.dtype([("in", kind)])), "however deep it lies"


@pytest.mark.parametrize("argument", ["x", None, 7, b"\0" * 9000])
def test_what_is_no_snapshot_is_refused_in_words(xy, argument):
    """stage.restore("x")"""
    for who, what in ((xy, "a stage"), (PCL240K(), "a chip")):
        with pytest.raises(ArgumentError, match=f"cannot be restored into {what}: give what") as caught:
            who.restore(argument)
        assert len(str(caught.value)) < 200


def test_chips_and_stages_do_not_take_each_others_snapshots(xy):
    """stage.restore(stage.axes["x"].chip.snapshot())"""
    with pytest.raises(ArgumentError, match="a snapshot of a chip cannot be restored into a stage"):
        xy.restore(xy.axes["x"].chip.snapshot())
    with pytest.raises(ArgumentError, match="a snapshot of a stage cannot be restored into a chip"):
        PCL240K().restore(xy.snapshot())


def test_a_snapshot_of_another_chip_says_which(xy):
    """PCL240K().restore(PCL240MS().snapshot())"""
    with pytest.raises(ArgumentError, match="chip: PCL240MS at 4915200 Hz there, PCL240K at 4915200 Hz here"):
        PCL240K().restore(PCL240MS().snapshot())
    with pytest.raises(ArgumentError, match="chip: PCL240K at 1000 Hz there"):
        PCL240K().restore(PCL240K(clock_hz=1000).snapshot())


def test_no_flipped_bit_of_a_state_gets_into_a_stage_or_a_chip(xy):
    """stage.restore(dataclasses.replace(snapshot, state=flipped)): 11,591 of 11,630 were taken without a word"""
    seed = SEED
    print("seed", seed)
    rng = np.random.default_rng(seed)
    chips = (PCL240K(), PCL240MS())
    for who, full in [(who, who.snapshot()) for who in (xy, *chips)]:
        data = bytes(full.state)
        for bit in rng.integers(0, 8 * len(data), 200):
            state = flip_bit(data, int(bit))
            other = replace(full, state=np.frombuffer(state) if who is xy else state)
            with pytest.raises(ArgumentError, match="is damaged"):
                who.restore(other)
        with pytest.raises(ArgumentError, match="is damaged"):
            who.restore(replace(full, state=None))
        assert bytes(who.snapshot().state) == data


def test_a_state_in_memory_cannot_be_written_to(xy):
    """stage.snapshot().state[7] = 1e300"""
    with pytest.raises(ValueError, match="read-only"):
        xy.snapshot().state[7] = 1e300


def test_a_pickled_snapshot_with_a_flipped_bit_is_refused(xy):
    """stage.restore(pickle.loads(flipped)): refused when it is loaded, or when it is restored, or it is whole all the same"""
    seed = SEED
    print("seed", seed)
    rng = np.random.default_rng(seed)
    chip = PCL240K()
    chip.write(0, 0x10)
    refused = 0
    for who, full in ((xy, xy.snapshot()), (chip, chip.snapshot())):
        packed = pickle.dumps(full)
        state = packed.index(bytes(full.state)[:64])
        inside = rng.integers(8 * state, 8 * (state + len(bytes(full.state))), 200)
        for bit in (*inside, *rng.integers(0, 8 * len(packed), 200)):
            try:
                other = pickle.loads(flip_bit(packed, int(bit)))
                who.restore(other)
            except Exception as error:
                refused += isinstance(error, ArgumentError)
            else:
                assert (bytes(other.state), other.diagnostics) == (bytes(full.state), full.diagnostics)
    assert refused >= 400, "all those in the state, in words"


def test_a_snapshot_of_another_version_says_that_it_is_one(xy):
    """pickle.loads(open("of_the_last_release.pickle", "rb").read())"""
    rebuild, (cls, version, *rest) = xy.snapshot().__reduce__()
    with pytest.raises(ArgumentError, match=rf"of format {version + 1}, and this PulseStage reads format {version}"):
        rebuild(cls, version + 1, *rest)
    with pytest.raises(ArgumentError, match=rf"of format {version - 1}, and"):
        rebuild(cls, version - 1, *rest)
    with pytest.raises(ArgumentError, match="is damaged"):
        rebuild(cls, version, None, rest[1])
    with pytest.raises(ArgumentError, match="from before snapshots had a header"):
        cls.__new__(cls).__setstate__({"kind": (), "state": None, "diagnostics": ()})


def test_a_callback_that_changes_the_state_changes_nothing_of_a_restored_one(xy):
    """mujoco.set_mjcb_control(control), control adds to data.qfrc_applied; stage.restore(snapshot)"""

    def control(_, data):
        data.qfrc_applied[0] += 1.0

    snapshot = xy.snapshot()
    mujoco.set_mjcb_control(control)
    try:
        xy.restore(snapshot)
    finally:
        mujoco.set_mjcb_control(None)
    assert xy.data.qfrc_applied[0] == 0.0
    assert np.array_equal(xy.snapshot().state, snapshot.state)


def test_a_layout_is_another_where_a_field_lies_elsewhere():
    """two records of the same names and types, one with room between them"""
    names, formats = ["a", "b"], ["i4", "i4"]
    kinds = [
        np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": 16})
        for offsets in ([0, 4], [0, 8], [4, 0])
    ]
    kinds += [
        np.dtype([("a", "i4"), ("c", "i4")]),
        np.dtype([("a", "i4"), ("b", "u4")]),
        np.dtype([("a", "i4"), ("b", "i4", 2)]),
    ]
    assert len({hash_layout(kind) for kind in kinds}) == len(kinds)
    assert hash_layout(np.dtype([("a", "i4")])) == hash_layout(np.dtype([("a", "<i4")]))


def test_a_state_that_would_mean_something_else_now_is_another_ones(monkeypatch):
    """VERSION is counted up: a header of the same words has another checksum"""
    now = SnapshotHeader((("chip", "PCL240K"),)).checksum
    monkeypatch.setattr(snapshots, "STATE_VERSION", snapshots.STATE_VERSION + 1)
    assert SnapshotHeader((("chip", "PCL240K"),)).checksum != now
