"""The rerun file, verified by rerun and read back: entities, times, values, states, words."""

import sys
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import scaled
from support.programs import load_registers
from support.recording_bench import ONE_AXIS, feed, make_bench, read_rrd, rerun_cli, stage_of

from stage import Drive
from stage.chips import PCL240K
from stage.chips.journal_entries import INPUT
from stage.recording import Recording, pin_signals, rerun_geoms
from stage.recording.axis_series import SERIES, select_series
from stage.recording.line_thinning import mark_needed_samples

PCL = SimpleNamespace(chip=PCL240K, drive=Drive())


@pytest.fixture(scope="module")
def read(rrd):
    return read_rrd(rrd)


@pytest.mark.skipif(sys.platform != "linux", reason="where rerun keeps its settings is another place elsewhere")
def test_rerun_leaves_nothing_in_the_home_of_who_runs_the_tests(rrd, tmp_path, monkeypatch):
    """rerun rrd verify demo.rrd"""
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("XDG_CONFIG_HOME", "PULSESTAGE_RERUN_ANALYTICS", "CI"):
        monkeypatch.delenv(name, raising=False)
    assert rerun_cli("rrd", "verify", rrd).returncode == 0
    assert list(tmp_path.rglob("*.json")) == []


def test_rerun_finds_no_fault_with_the_file(rrd):
    done = rerun_cli("rrd", "verify", rrd)
    assert done.returncode == 0, done.stderr
    assert "1 file verified without error" in done.stdout + done.stderr


def test_every_axis_has_its_series_lanes_and_bus(read):
    for axis in "xyz":
        have = {e.removeprefix(f"/axes/{axis}/") for e in read if e.startswith(f"/axes/{axis}/")}
        lanes = {"phase", "switches", *(f"switches/{pin}" for pin in pin_signals.SWITCHES)}
        assert have >= {*select_series(PCL), *lanes}
        assert ("bus" in have) == (axis != "z"), "nothing was written to Z"
    assert "PulseStage xyz" in read["/about"]["TextDocument:text"][1][0][0]


@pytest.mark.parametrize("series", select_series(PCL))
def test_lines_pass_within_the_tolerance_of_every_sample(run, read, series):
    spec = SERIES[series]
    columns = run.recording.columns
    for axis in "xyz":
        times, values = read[f"/axes/{axis}/{series}"]["Scalars:scalars"]
        drawn = np.interp(columns["time"], times * 1e-9, np.concatenate(values))
        sampled = columns[f"{axis}/{series}"] * spec.scales[0]
        assert np.abs(drawn - sampled).max() <= spec.tolerance * 1.001 + 1e-9
        assert len(times) <= len(sampled)
    assert len(read["/axes/z/rate"]["Scalars:scalars"][0]) == 2, "nothing happened on Z: two points"


def test_bodies_move_as_the_joints_did(run, read):
    model, columns = run.stage.model, run.recording.columns
    times, values = read["/stage/y"]["Transform3D:translation"]
    data = mujoco.MjData(model)
    rows = np.concatenate([p["qpos"] for p in run.recording.pieces()])
    for t, v in list(zip(times * 1e-9, values, strict=True))[1:]:
        data.qpos[:] = rows[np.argmin(np.abs(columns["time"] - t))]
        mujoco.mj_kinematics(model, data)
        assert v[0] == pytest.approx(data.body("y").xpos, abs=2e-6)
    assert times[0] == pytest.approx(run.recording.began * 1e9, abs=1), "no body is lost before the first sample"
    assert np.diff(times).min() >= 0.9e9 / 60
    assert len(times) <= run.recording.duration * 63 + 2


def test_what_senses_or_is_hidden_is_not_drawn(read):
    drawn = [e for e in read if e.startswith("/stage/")]
    assert "/stage/world/boxes" in drawn
    assert "/stage/x/boxes" in drawn
    assert not any("planes" in e for e in drawn), "the floor is a grid"
    assert any("path" in e for e in drawn)
    assert len(read["/stage/directions"]["Arrows3D:vectors"][1][0]) == 3


def test_a_body_of_the_frame_is_at_its_place_in_the_model(tmp_path):
    """<body name="post" pos="0.1 0.2 0.3" euler="0 0 90">: it has no joint, and is placed once."""
    post = '<body name="post" pos=".1 .2 .3" euler="0 0 90"><geom type="box" size=".1 .1 .1"/></body></worldbody>'
    bench = make_bench(mjcf=ONE_AXIS.replace("</worldbody>", post))
    feed(bench.recording, 2)
    bench.recording.close()
    read = read_rrd(bench.recording.save(tmp_path / "post.rrd"))
    pose = read["/stage/post"]
    times, values = pose["Transform3D:translation"]
    assert times is None
    assert values[0][0] == pytest.approx([0.1, 0.2, 0.3])
    assert np.abs(pose["Transform3D:quaternion"][1][0][0]) == pytest.approx([0, 0, 0.5**0.5, 0.5**0.5])
    (corner,) = read["/stage/directions"]["Arrows3D:origins"][1][0]
    beside = 0.01 * bench.model.stat.extent
    assert corner == pytest.approx([beside, 0.1 + beside, 0.2]), "the front corner of the post, not of what moves"


def test_lanes_change_at_the_instants_of_the_edges(run, read):
    chip, journal = run.stage.axes["x"].chip, run.recording.journals["x"]
    levels = [(e.clock, bool(e.b & chip.INPUTS["el_minus"])) for e in journal.entries if e.kind == INPUT]
    (tripped, let_go) = (c for k, (c, on) in enumerate(levels) if on != (k > 0 and levels[k - 1][1]))
    times, states = read["/axes/x/switches/el_minus"]["StateChange:state"]
    assert [s[0] for s in states] == ["off", "EL-", "off"]
    assert times[1:].tolist() == [pytest.approx(c * 1e9 / chip.clock_hz, abs=1) for c in (tripped, let_go)]
    times_of_el = times[1]
    times, states = read["/axes/x/phase"]["StateChange:state"]
    assert [s[0] for s in states] == ["hold", "up", "keep", "hold", "up", "keep", "down", "keep", "hold"]
    slowest = 1e9 / 1500  # ns; a pulse at FL
    assert 0 <= times[3] - times_of_el <= slowest, "EL- ends the run as soon as the pulse is complete"
    _, together = read["/axes/x/switches"]["StateChange:state"]
    assert "EL- ORG SD-" in {s[0] for s in together}


def test_a_lamp_lights_with_its_switch(read):
    (path,) = [e for e in read if e.endswith("/lamp_x_el_minus")]
    times, radii = read[path]["Points3D:radii"]
    assert [r[0] < -5 for r in radii] == [False, True, False]
    assert times.tolist() == read["/axes/x/switches/el_minus"]["StateChange:state"][0].tolist()


def test_the_bus_is_logged_in_words(tmp_path):
    bench = make_bench()
    load_registers(bench.chip, R2=8000)
    bench.chip.advance(4_915_200)
    bench.chip.write(0, 0x15)
    bench.chip.reset()
    bench.recording.close()
    times, message = read_rrd(bench.recording.save(tmp_path / "x.rrd"))["/axes/x/bus"]["TextLog:text"]
    assert times.tolist() == [0, 10**9, 10**9]
    assert [s[0].split(None, 2)[2] for s in message] == [
        "82 00 1F 40  R2 <- 8000 (FH1 speed)",
        "15  start, ramp to FH1",
        "/RESET  reset pin",
    ]


def test_names_that_no_file_format_likes_are_escaped_in_entity_paths(tmp_path):
    axis = SimpleNamespace(
        name="my x/1", chip=PCL240K(), index=0, joint=0, gear=1.0, meters_per_pulse=1e-3, unit="rad",
        chip_axis=0, drive=Drive(),
        switches=SimpleNamespace(as_dict=lambda: {"org": False}),
    )  # fmt: skip
    xml = '<mujoco><worldbody><body name="a body"><joint name="my x/1"/><geom size="1"/></body></worldbody></mujoco>'
    recording = Recording(stage_of(mujoco.MjModel.from_xml_string(xml), {"my x/1": axis}))
    feed(recording, 10)
    recording.close()
    entities = set(read_rrd(recording.save(tmp_path / "x.rrd")))
    assert entities >= {
        "/axes/my_u20_x_u2f_1/position", "/axes/my_u20_x_u2f_1/switches/org", "/stage/a_u20_body/spheres"
    }  # fmt: skip
    assert "$scope module my_u20_x_u2f_1 $end" in recording.to_vcd(tmp_path / "x.vcd").read_text()
    assert "my x/1/position" in recording.columns


SHAPES = """
<mujoco><asset>
<mesh name="wedge" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/>
<material name="glass" rgba="1 1 1 0"/><material name="teal" rgba="0 .5 .5 1"/></asset>
<worldbody>
<geom name="floor" type="plane" size="0 0 1"/>
<body name="b"><joint type="slide"/>
<geom type="box" size=".1 .2 .3" pos="1 0 0" rgba="1 0 0 1"/><geom type="box" size=".1 .1 .1" group="3"/>
<geom type="sphere" size=".1" material="teal"/><geom type="ellipsoid" size=".1 .2 .3"/>
<geom type="cylinder" size=".1 .2"/><geom type="capsule" size=".1 .2" pos="0 0 1"/><geom type="mesh" mesh="wedge"/>
<geom type="box" size="1 1 1" rgba="1 1 1 0"/><geom type="box" size="1 1 1" material="glass"/>
</body><body><geom type="plane" size=".5 0 .1" euler="90 0 0"/></body></worldbody></mujoco>
"""


def test_a_geom_has_the_mean_color_of_its_texture():
    flat = '<texture name="{0}" type="2d" builtin="flat" rgb1="{1}" width="{2}" height="4"/><material name="{0}" texture="{0}"/>'
    texts = flat.format("red", "1 0 0", 4), flat.format("blue", "0 0 1", 8), flat.format("grey", ".4 .4 .4", 2)
    body = "".join(f'<geom size=".1" material="{name}"/>' for name in ("grey", "red", "blue"))
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><asset>{''.join(texts)}</asset><worldbody>{body}</worldbody></mujoco>"
    )
    colours = [rerun_geoms.find_color(model, g).tolist() for g in range(3)]
    assert colours == [[102, 102, 102, 255], [255, 0, 0, 255], [0, 0, 255, 255]]


def test_geoms_of_every_kind_have_their_shape_size_and_colour():
    model = mujoco.MjModel.from_xml_string(SHAPES)
    assert rerun_geoms.find_floor(model) == 0
    plane = '<geom name="floor" type="plane" size="0 0 1"/>'
    for other, result in [("", None), ('euler="0 5 0"', None), ('quat="-1 0 0 0"', 0), ('euler="0 0 90"', None)]:
        xml = SHAPES.replace(plane, plane.replace("/>", f" {other}/>") if other else "")
        assert rerun_geoms.find_floor(mujoco.MjModel.from_xml_string(xml)) == result, other
    assert dict(rerun_geoms.list_shapes(model, 0)) == {}
    shapes = dict(rerun_geoms.list_shapes(model, 1))
    kinds = {"boxes", "spheres", "ellipsoids", "cylinders", "capsules"}
    mesh = next(name for name in shapes if name.startswith("mesh"))
    assert set(shapes) == kinds | {mesh}
    assert shapes["boxes"].half_sizes.as_arrow_array().to_pylist() == [pytest.approx([0.1, 0.2, 0.3])], "one is hidden"
    assert shapes["boxes"].colors.as_arrow_array().to_pylist() == [0xFF0000FF]
    assert shapes["spheres"].colors.as_arrow_array().to_pylist() == [0x008080FF]
    assert shapes["cylinders"].lengths.as_arrow_array().to_pylist() == pytest.approx([0.4])
    assert shapes["capsules"].translations.as_arrow_array().to_pylist() == [pytest.approx([0, 0, 0.8])]
    vertices = np.array(shapes[mesh].vertex_positions.as_arrow_array().to_pylist())
    wall = dict(rerun_geoms.list_shapes(model, 2))["planes"]
    assert wall.half_sizes.as_arrow_array().to_pylist() == [
        pytest.approx([0.5, 2 * model.stat.extent, rerun_geoms.PLANE_THICKNESS_M])
    ]
    assert sorted(map(tuple, np.unique(vertices.round(5) + 0.0, axis=0))) == [
        (0, 0, 0),
        (0, 0, 1),
        (0, 1, 0),
        (1, 0, 0),
    ]


@settings(max_examples=scaled(20), deadline=None)
@given(
    values=st.lists(st.floats(-1e6, 1e6, width=32), min_size=1, max_size=60),
    repeats=st.integers(1, 5),
    tolerance=st.sampled_from([0.0, 0.5, 1e3]),
)
def test_thinning_keeps_the_line(values, repeats, tolerance):
    v = np.repeat(np.array(values, float), repeats)
    t = np.arange(len(v)) * 1e-3
    keep = np.empty(len(v), np.bool_)
    mark_needed_samples(t, v, tolerance, keep)
    assert np.abs(np.interp(t, t[keep], v[keep]) - v).max() <= tolerance + 1e-6
    assert keep[0]
    assert keep[-1]


def test_thinning_takes_what_is_straight():
    t = np.arange(10_000) * 1e-3
    keep = np.empty(len(t), np.bool_)
    for v, limit in ((0 * t, 2), (3 * t - 7, 2), (np.where(t < 5, 0.0, 100.0), 4), (np.sin(t), 200)):
        mark_needed_samples(t, v, 1e-3, keep)
        assert keep.sum() <= limit
