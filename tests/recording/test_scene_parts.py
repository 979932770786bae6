"""The scene of a recording: lamps that two switches share, the tool's path on the work, pictures 60 times a second."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from support.recording_bench import read_rrd

from stage.recording import pin_signals, rerun_scene
from stage.recording.rerun_geoms import compute_poses, is_visible
from stage.recording.rerun_scene import SceneLogger, make_body_entity_path

rr = pytest.importorskip("rerun")

MODEL = """<mujoco><statistic extent="2"/><worldbody>
<geom type="box" size=".1 .1 .1" pos="1 0 0"/><geom type="box" size=".2 .2 .2" pos="-1 -2 .5" quat="0 0 0 1"/>
<body name="frame" quat=".5 .5 .5 .5"><geom name="org_x" type="sphere" size=".01" pos=".1 .2 .3"/>
<geom name="el_x" type="sphere" size=".01" pos=".4 .2 .3"/></body>
<body name="work" pos="0 0 1"><joint name="x" type="slide" axis="1 0 0"/><joint name="a" type="hinge" axis="0 0 1"/>
<geom name="flag" type="sphere" size=".01"/>{work}</body>
<body><joint name="z" type="slide" axis="0 0 1"/><geom type="sphere" size=".01"/>{tool}</body></worldbody>
<sensor><distance name="x_org" geom1="flag" geom2="org_x" cutoff="1"/>
<distance name="x_el_plus" geom1="el_x" geom2="flag" cutoff="1"/>
</sensor></mujoco>"""
WORK, TOOL = '<site name="work"/>', '<site name="tool" pos=".3 .4 .5"/>'


class Out:
    """Keeps what is logged."""

    def __init__(self):
        self.logged, self.sent = {}, {}

    def log(self, path, what, static=False):
        self.logged[path] = what

    def send_columns(self, path, indexes, columns):
        assert path not in self.sent
        self.sent[path] = (indexes[0], columns)


def model_of(work=WORK, tool=TOOL):
    return mujoco.MjModel.from_xml_string(MODEL.format(work=work, tool=tool))


class Chip:
    clock_hz = 1000

    def find_switch_input(self, pin):
        return {"org": 1, "el_plus": 1}.get(pin, 0)

    def __init__(self):
        self.OUTPUTS = {}


def bench(every=1e-3, began=0.0, model=None):
    axis = SimpleNamespace(
        chip=Chip(), joint=0, switches=SimpleNamespace(as_dict=lambda: {"org": 0, "el_plus": 0}),
        plant=SimpleNamespace(
            qpos=0, switches=[SimpleNamespace(pin="org", touch=0.1), SimpleNamespace(pin="el_plus", touch=0.4)]
        ),
    )  # fmt: skip
    return SimpleNamespace(
        model=model or model_of(), axes={"x": axis}, every=every, began=began, seconds=lambda name, clock: clock / 1000
    )


def rows(model, times, x):
    piece = np.zeros(len(times), [("axes", [("time", "f8")], (1,)), ("qpos", "f8", (model.nq,))])
    piece["axes"]["time"][:, 0], piece["qpos"][:, 0] = times, x
    return piece


def test_poses_are_logged_60_times_a_second_for_any_pieces(monkeypatch):
    """a sample every 4 ms: each fourth is a picture, in pieces of 3, 1 and 6 rows as in one; the first is when it began"""
    moved = []
    monkeypatch.setattr(rerun_scene, "_log_poses", lambda out, path, time, *_: moved.append((path, time.tolist())))
    times = 0.004 * (1 + np.arange(10))
    for cuts in ((0, 10), (0, 3, 4, 10), (0, 1, 5, 10)):
        moved.clear()
        recording = bench(every=0.004, began=0.001)
        created = SceneLogger(recording)
        for begin, end in pairwise(cuts):
            created.log_poses(Out(), rows(recording.model, times[begin:end], times[begin:end]))
        of_work = [t for path, ts in moved if path == "stage/work" for t in ts]
        assert of_work == pytest.approx([0.001, 0.020, 0.036])
        assert {path for path, _ in moved} == {"stage/work", "stage/body3"}, "the frame does not move"


def test_a_body_is_sent_where_it_moved_and_to_the_nanosecond(tmp_path):
    """five pictures: it stands, moves along one axis by less than can be seen, by more, turns, and stands"""
    out = Out()
    position = np.array([[0, 0, 0], [0, 0, 1e-7], [0, 0, 1e-3], [0, 0, 1e-3], [0, 0, 1e-3]])
    quaternion = np.array([[0, 0, 0, 1]] * 3 + [[0, 0, 0.6, 0.8]] * 2)
    rerun_scene._log_poses(out, "b", np.array([0, 1, 2, 3, 4]) + 1.6e-9, position, quaternion)
    stream = rr.RecordingStream("test")
    stream.save(tmp_path / "b.rrd")
    stream.send_columns("b", indexes=[out.sent["b"][0]], columns=out.sent["b"][1])
    stream.disconnect()
    times, values = read_rrd(tmp_path / "b.rrd")["/b"]["Transform3D:translation"]
    assert times.tolist() == [2, 2_000_000_002, 3_000_000_002]
    assert [v[0][2] for v in values] == pytest.approx([0, 1e-3, 1e-3])


def test_of_two_switches_on_one_pin_that_lamp_is_lit_to_whose_switch_the_carriage_is_nearer():
    """org trips at 0.1 m and el_plus at 0.4; the pin is on at 0.12 and at 0.39, in two lots"""
    recording = bench(every=1.0)
    created = SceneLogger(recording)
    times = np.array([0.0, 1.0, 2.0, 3.0])
    edge = np.zeros(4, [("clock", "i8"), ("inputs", "i8"), ("outputs", "i8")])
    edge["clock"], edge["inputs"] = [0, 1000, 2000, 3000], [0, 1, 0, 1]
    created.log_poses(Out(), rows(recording.model, times, [0.2, 0.12, 0.25, 0.39]))
    lit = {pin: created._is_nearest_switch("x", edge, pin, rivals) & pin_signals.is_switch_on(recording.axes["x"], edge, pin)
           for _, _, pin, _, rivals in created._lamps["x"]}  # fmt: skip
    assert {pin: on.tolist() for pin, on in lit.items()} == {
        "org": [False, True, False, False], "el_plus": [False, False, False, True],
    }  # fmt: skip
    created.forget_old_positions()
    later = edge[3:].copy()
    assert created._is_nearest_switch("x", later, "el_plus", ("org",)).tolist() == [True], (
        "where it stood last is not forgotten"
    )
    assert created._is_nearest_switch("x", later, "org", ("el_plus",)).tolist() == [False]


def test_a_lit_lamp_is_bright_and_its_first_state_is_logged_once(tmp_path):
    recording = bench()
    created = SceneLogger(recording)
    edge = np.zeros(3, [("clock", "i8"), ("inputs", "i8"), ("outputs", "i8")])
    edge["clock"], edge["inputs"] = [10, 20, 30], [0, 1, 0]
    out = Out()
    stream = rr.RecordingStream("test")
    stream.save(tmp_path / "l.rrd")
    created.log_lamps(out, "x", edge, True)
    (path,) = [p for p in out.sent if "org" in p]
    stream.send_columns("first", indexes=[out.sent[path][0]], columns=out.sent[path][1])
    out.sent.clear()
    created.log_lamps(out, "x", edge, False)
    stream.send_columns("then", indexes=[out.sent[path][0]], columns=out.sent[path][1])
    out.sent.clear()
    created.log_lamps(out, "x", edge[:1], False)
    assert out.sent == {}, "nothing has changed"
    stream.disconnect()
    read = read_rrd(tmp_path / "l.rrd")
    assert read["/first"]["Points3D:radii"][0].tolist() == [10_000_000, 20_000_000, 30_000_000]
    assert [r[0] for r in read["/first"]["Points3D:radii"][1]] == [-2.5, -6.0, -2.5]
    full = rerun_scene.LAMPS["org"]
    displayed = [tuple(c[0] >> shift & 0xFF for shift in (24, 16, 8)) for c in read["/first"]["Points3D:colors"][1]]
    dark = tuple(int(rerun_scene.DIM_FACTOR * c) for c in full)
    assert displayed == [dark, full, dark]
    assert read["/then"]["Points3D:radii"][0].tolist() == [20_000_000, 30_000_000]


def test_a_lamp_is_above_its_switch_on_the_frame():
    """the flag rides with the carriage; the frame is turned, and above is still up"""
    recording = bench()
    lamps = {pin: (path, place) for path, place, pin, _, _ in rerun_scene._list_lamps(recording, "x")}
    up = rerun_scene.LAMP_HEIGHT * 2
    assert {pin: path for pin, (path, _) in lamps.items()} == {
        "org": "stage/frame/lamp_x_org", "el_plus": "stage/frame/lamp_x_el_plus",
    }  # fmt: skip
    data = mujoco.MjData(recording.model)
    mujoco.mj_kinematics(recording.model, data)
    turn = data.body("frame").xmat.reshape(3, 3)
    for name, (_, place) in zip(("org_x", "el_x"), (lamps["org"], lamps["el_plus"]), strict=True):
        assert turn @ place - data.geom(name).xpos == pytest.approx([0, 0, up], abs=1e-12)
    rivals = {pin: rivals for *_, pin, _, rivals in rerun_scene._list_lamps(recording, "x")}
    assert rivals == {"org": ("el_plus",), "el_plus": ("org",)}
    recording.axes["x"].chip.find_switch_input = lambda pin: {"org": 1}.get(pin, 0)
    assert [lamp[2] for lamp in rerun_scene._list_lamps(recording, "x")] == ["org"], "the other is wired to nothing"


def test_the_path_is_where_the_tool_was_on_the_work():
    """the work slides by 0.1 and turns by 90 degrees under a tool that stands still"""
    model = model_of()
    qpos = np.zeros((2, model.nq))
    qpos[1, :2] = 0.1, np.pi / 2
    points = rerun_scene._to_work_frame(model, *compute_poses(model, qpos))
    assert points[0] == pytest.approx([0.3, 0.4, -0.5])
    assert points[1] == pytest.approx([0.4, -0.2, -0.5]), "turned back with the work"
    out = Out()
    rerun_scene._log_tool_path_points(out, model, points)
    assert list(out.logged) == ["stage/work/path"]


def test_a_tool_that_rides_with_the_work_leaves_its_path_in_the_world_and_no_tool_leaves_none():
    riding = model_of(work=WORK + TOOL, tool="")
    qpos = np.zeros((3, riding.nq))
    qpos[1:, 0] = 0.1
    points = rerun_scene._to_work_frame(riding, *compute_poses(riding, qpos))
    assert points[:, 0] == pytest.approx([0.3, 0.4, 0.4])
    out = Out()
    rerun_scene._log_tool_path_points(out, riding, points)
    assert list(out.logged) == ["stage/world/path"]
    (strip,) = out.logged["stage/world/path"].strips.as_arrow_array().to_pylist()
    assert len(strip) == 2, "where it stands there is one point"
    none = model_of(tool="")
    out = Out()
    rerun_scene._log_tool_path_points(out, none, rerun_scene._to_work_frame(none, *compute_poses(none, qpos)))
    rerun_scene._log_tool_path_points(out, riding, points[:1])
    assert out.logged == {}
    unmodified = model_of(work="")
    assert rerun_scene._to_work_frame(unmodified, *compute_poses(unmodified, qpos))[1] == pytest.approx(
        [0.3, 0.4, 0.5]
    ), "without a work it is the world"


def test_the_arrows_point_along_plus_from_the_front_corner_of_what_does_not_move():
    recording = bench()
    recording.axes["z"] = SimpleNamespace(joint=2)
    out = Out()
    rerun_scene._log_directions(out, recording, {"x": (1, 2, 3), "z": (4, 5, 6)})
    arrows = out.logged["stage/directions"]
    assert arrows.vectors.as_arrow_array().to_pylist() == [pytest.approx([0.2, 0, 0]), pytest.approx([0, 0, 0.2])]
    corner = [-1.2 + 0.02, -2.2 + 0.02, 0.0]
    lowest = min(0.5 - 0.2, -0.1)
    assert lowest < 0
    assert arrows.origins.as_arrow_array().to_pylist() == [pytest.approx(corner, abs=1e-6)] * 2
    assert arrows.labels.as_arrow_array().to_pylist() == ["x", "z"]


def test_a_body_without_a_name_is_called_by_its_number():
    model = model_of()
    assert [make_body_entity_path(model, k) for k in range(model.nbody)] == [
        "stage/world",
        "stage/frame",
        "stage/work",
        "stage/body3",
    ]


@pytest.mark.parametrize(
    ("arguments", "observed"),
    [('group="2"', True), ('group="3"', False), ('rgba="1 1 1 0.001"', False), ('rgba="1 1 1 0.01"', True),
     ('material="first"', False), ('material="second" rgba="1 1 1 0"', True), ('material="first" rgba="1 1 1 1"', False)],
)  # fmt: skip
def test_hidden_and_transparent_geoms_are_not_drawn(arguments, observed):
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><asset><material name="first" rgba="1 1 1 0"/><material name="second" rgba="1 1 1 1"/></asset>'
        f'<worldbody><geom size="1" {arguments}/></worldbody></mujoco>'
    )
    assert is_visible(model, 0) is observed
