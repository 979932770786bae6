"""What the rerun file says beside its curves: lanes and their colours, faults, the bus, the facts about each axis, and shapes."""

from __future__ import annotations

import os
import sys
import threading
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from support.programs import start_preset
from support.recording_bench import ONE_AXIS, feed, make_bench, read_rrd, stage_of

from stage import Stage, faults
from stage.chips import HCTL1100
from stage.recording import rerun_geoms, rerun_log, rerun_scene, rerun_viewer, saved_recording
from stage.recording.recording import BUFFER_ROWS, Recording, RecordingError
from stage.recording.rerun_log import STATE_COLORS, StateLaneLogger

pytest.importorskip("rerun")
RED, BLUE = STATE_COLORS["fault"], STATE_COLORS["keep"]


def number(colour):
    red, green, blue = colour
    return red << 24 | green << 16 | blue << 8 | 255


@pytest.fixture(scope="module")
def streamed(tmp_path_factory):
    """A file that was flushed between two faults; a command, a lost write, a reset, a register that nothing follows."""
    bench, path = make_bench(), tmp_path_factory.mktemp("rrd") / "x.rrd"
    recording, chip = bench.recording, bench.chip
    recording.stream(path)
    feed(recording, 2)
    recording.add_fault_change(0.001, "axis x: jammed: begins", ("jammed", "slips"))
    chip.write(0, 0x15)
    recording.flush()
    feed(recording, 3)
    recording.add_fault_change(0.002, "axis x: jammed: ends", ("slips",))
    recording.add_fault_change(0.004, "axis x: slips: ends", ())
    chip.reset()
    recording.flush()
    for address, value in ((0, 0x82), (1, 0x40), (2, 0x1F), (3, 0x00)):
        chip.write(address, value)
    recording.close()
    return read_rrd(path)


def test_each_fault_is_logged_once_with_those_in_force(streamed):
    times, states = streamed["/faults"]["StateChange:state"]
    assert times.tolist() == [1_000_000, 2_000_000, 4_000_000]
    assert [s[0] for s in states] == ["jammed; slips", "slips", "none"]
    names, colours = (streamed["/faults"][f"StateConfiguration:{name}"][1][-1] for name in ("values", "colors"))
    assert dict(zip(names, colours, strict=True)) == {
        "jammed; slips": number(RED), "slips": number(RED), "none": number(STATE_COLORS["off"]),
    }  # fmt: skip
    times, texts = streamed["/faults/log"]["TextLog:text"]
    assert times.tolist() == [1_000_000, 2_000_000, 4_000_000]
    assert [t[0].split("  FAULT  ")[1] for t in texts] == [
        "axis x: jammed: begins",
        "axis x: jammed: ends",
        "axis x: slips: ends",
    ]


def test_each_line_of_the_bus_is_logged_once_with_its_level(streamed):
    bus = streamed["/axes/x/bus"]
    message = [
        (text[0].split("  x  ")[1], level[0])
        for text, level in zip(bus["TextLog:text"][1], bus["TextLog:level"][1], strict=True)
    ]
    assert message[:2] == [("15  start, ramp to FH1", "DEBUG"), ("/RESET  reset pin", "WARN")]
    assert len(message) == 3, "a register whose write nothing followed is told at the end"
    assert message[2][1] == "INFO"
    assert "R2 <- 8000" in message[2][0]
    assert rerun_log.LEVELS["lost"] == "ERROR"


def test_bus_lines_are_neutral_and_only_a_lost_write_is_red(monkeypatch):
    logged = []
    monkeypatch.setattr(rerun_log.rr, "TextLog", SimpleNamespace(columns=lambda **columns: columns), raising=False)
    recording = SimpleNamespace(seconds=lambda name, clocks: clocks * 1e-6)
    lanes = StateLaneLogger.__new__(StateLaneLogger)
    lanes._recording, lanes._name = recording, "x"
    out = SimpleNamespace(send_columns=lambda path, indexes, columns: logged.extend(columns["color"]))
    kinds = ("register", "command", "reset", "lost")
    lanes._log_bus(out, [SimpleNamespace(kind=kind, clock=k) for k, kind in enumerate(kinds)])
    neutral = (*rerun_log.NEUTRAL, 255)
    assert logged == [neutral, neutral, neutral, (*RED, 255)]
    assert max(neutral[:3]) - min(neutral[:3]) < 20, "a gray"


@pytest.mark.parametrize("has_mistakes", [False, True])
def test_red_lines_of_a_file_are_mistakes_and_all_others_are_gray(tmp_path, has_mistakes):
    stage = Stage("xy", visuals=False)
    x = stage.axes["x"]
    with stage.record() as recording:
        if has_mistakes:
            faults.lost_write(x, value=0x15)
            x.chip.write(0, 0x15)
        start_preset(x.chip, 10)
        stage.run(0.01)
        x.chip.reset()
    read = read_rrd(recording.save(tmp_path / "run.rrd"))
    lines = []
    for entity in (entity for entity in read.values() if "TextLog:text" in entity):
        columns = (entity[f"TextLog:{name}"][1] for name in ("text", "level", "color"))
        lines += [(text, level, color) for (text,), (level,), (color,) in zip(*columns, strict=True)]
    assert {color for *_, color in lines} <= {number(RED), number(rerun_log.NEUTRAL)}
    red = sorted(text.split(maxsplit=1)[1] for text, _, color in lines if color == number(RED))
    assert red == [text.split(maxsplit=1)[1] for text, level, _ in sorted(lines) if level == "ERROR"]
    if has_mistakes:
        begin, lost = red
        assert begin.startswith("FAULT  axis x: a bus write of 15h gets lost: begins")
        assert lost.startswith("x  15  LOST: ")
        assert any(": cleared" in text for text, *_ in lines), "the end of a fault is no mistake"
    else:
        assert red == []
    assert sum("start, ramp to FH1" in text for text, _, color in lines if color != number(RED)) == 1
    assert any("reset pin" in text for text, *_ in lines)


def test_the_command_is_dark_and_wide_below_the_position(streamed):
    def style(series):
        result = streamed[f"/axes/x/{series}"]
        return [result[f"SeriesLines:{name}"][1][0][0] for name in ("colors", "names", "widths")]

    (red, green, blue) = (240, 96, 84)
    assert style("position") == [number((red, green, blue)), "x", 1.5]
    assert style("commanded") == [number((red // 2, green // 2, blue // 2)), "x cmd", 3.5]


def test_the_facts_are_those_of_each_axis_and_the_length_that_of_the_end(tmp_path):
    """a slide, and the hinge of a servo; the file is begun with none of the 5 samples, 2 ms apart"""
    bench = make_bench(2)
    servo = bench.axes["y"]
    servo.chip, servo.unit, servo.drive = HCTL1100(), "rad", SimpleNamespace(title="a motor", has_encoder=True)
    recording = Recording(stage_of(bench.model, bench.axes), 2e-3)
    path = tmp_path / "x.rrd"
    recording.stream(path)
    feed(recording, 5)
    recording.close()
    read = read_rrd(path)
    text = read["/about"]["TextDocument:text"][1][-1][0]
    hz = HCTL1100().clock_hz
    assert "| x | PCL240K | 4,915,200 Hz | 17HS4401, 1/16 steps | 3.125 um a pulse |" in text
    assert f"| y | HCTL1100 | {hz:,} Hz | a motor | 0.179 mdeg a count |" in text
    assert "0.010 s, a sample every 2 ms; physics step 2000 us." in text
    run = saved_recording.read(path)
    assert run.axes == {
        "x": "PCL240K at 4915200 Hz, 17HS4401, 1/16 steps, 3.125 um a pulse",
        "y": f"HCTL1100 at {hz} Hz, a motor, 0.179 mdeg a count",
    }  # fmt: skip
    assert (run.every, len(run), run.model) == (2e-3, 5, "bench")
    assert (run.units["x/position"], run.units["y/position"]) == ("m", "rad")
    assert (run.units["x/rate"], run.units["y/rate"]) == ("pps", "counts/s")
    assert run._read_property("stage", "samples") == "5"


def test_a_lane_continues_and_combined_switches_have_the_most_important_color(monkeypatch):
    """EL+ and ORG come and go, in two lots, of which the second begins with the last edge of the first"""
    logged, sent = [], []
    fake = SimpleNamespace(
        StateConfiguration=lambda values, colors: dict(zip(values, colors, strict=True)),
        StateChange=SimpleNamespace(columns=lambda state: state),
    )
    monkeypatch.setattr(rerun_log, "rr", fake)
    monkeypatch.setattr(rerun_scene, "to_time_column", lambda seconds: np.rint(np.asarray(seconds) * 1e6).tolist())
    out = SimpleNamespace(
        log=lambda path, what, static: logged.append((path.removeprefix("axes/x/"), what)),
        send_columns=lambda path, indexes, columns: sent.append((path.removeprefix("axes/x/"), indexes[0], columns)),
    )
    bench = make_bench()
    axis, chip = bench.axes["x"], bench.chip
    axis.switches = SimpleNamespace(as_dict=lambda: {"org": False, "el_plus": False})
    lanes = StateLaneLogger(bench.recording, "x")
    org, end, hold, up = (
        chip.find_switch_input("org"),
        chip.find_switch_input("el_plus"),
        chip.OUTPUTS["hold"],
        chip.OUTPUTS["fup"],
    )
    edges = np.zeros(6, [("clock", "i8"), ("inputs", "i8"), ("outputs", "i8")])
    edges["clock"] = np.arange(6) * chip.clock_hz
    edges["inputs"] = [0, org, org | end, end, 0, org]
    edges["outputs"] = [hold, up, up, hold, hold, hold]
    lanes._log_edges(out, edges[:4])
    lanes._first = False
    lanes._log_edges(out, edges[3:])
    second = 1_000_000
    assert sent == [
        ("phase", [0, second, 3 * second], ["hold", "up", "hold"]),
        ("switches/org", [0, second, 3 * second], ["off", "ORG", "off"]),
        ("switches/el_plus", [0, 2 * second], ["off", "EL+"]),
        ("switches", [0, second, 2 * second, 3 * second], ["", "ORG", "ORG EL+", "EL+"]),
        ("switches/org", [5 * second], ["ORG"]),
        ("switches/el_plus", [4 * second], ["off"]),
        ("switches", [4 * second, 5 * second], ["", "ORG"]),
    ]
    together = [what for path, what in logged if path == "switches"]
    assert together == [
        {"": STATE_COLORS["off"], "ORG": STATE_COLORS["org"], "ORG EL+": STATE_COLORS["el"], "EL+": STATE_COLORS["el"]}
    ], "once"
    assert dict(logged)["switches/org"] == {"ORG": STATE_COLORS["org"], "off": STATE_COLORS["off"]}
    assert dict(logged)["phase"] == {name: STATE_COLORS[name] for name in ("up", "keep", "down", "hold")}


def test_a_full_buffer_that_went_back_in_time_is_detected_later(tmp_path):
    """one full buffer goes back, the next does not"""
    bench = make_bench()
    for back in (True, False):
        bench.recording.samples["time"][:, 0] = np.arange(BUFFER_ROWS) * 1e-3
        if back:
            bench.recording.samples["time"][7, 0] = 9.0
        bench.recording.take_rows(BUFFER_ROWS)
    with pytest.raises(RecordingError, match="went back in time"):
        bench.recording.save(tmp_path / "x.rrd")


def test_a_stream_is_flushed_at_the_requested_interval(tmp_path):
    """once in 1e9 s is the longest; of a recording of nothing there is no picture"""
    bench = make_bench()
    assert "<img" not in bench.recording._repr_html_()
    assert "<svg" not in bench.recording._repr_html_()
    assert bench.recording.stream(tmp_path / "x.rrd", seconds=1e9) is bench.recording
    bench.recording.close()


def test_a_chip_that_continued_after_going_back_is_detected(tmp_path):
    """before = chip.snapshot(); a write at 1000; chip.restore(before); a write at 0; then on to 5000"""
    bench = make_bench()
    before = bench.chip.snapshot()
    bench.chip.advance(1000)
    bench.chip.write(0, 0x08)
    bench.chip.restore(before)
    bench.chip.write(0, 0x08)
    bench.chip.advance(5000)
    with pytest.raises(RecordingError, match=r"went back in time while it was recorded \(axis x\)"):
        bench.recording.save(tmp_path / "x.rrd")


def test_an_existing_pipe_gets_the_bytes_of_a_file(tmp_path):
    """mkfifo x.rrd; cat x.rrd > y.rrd & stage.record(path="x.rrd")"""
    bench, path, got = make_bench(), tmp_path / "x.rrd", []
    os.mkfifo(path)
    reader = threading.Thread(target=lambda: got.append(path.read_bytes()), daemon=True)
    reader.start()
    bench.recording.stream(path)
    feed(bench.recording, 2)
    bench.recording.close()
    reader.join(10)
    assert got[0].startswith(saved_recording.MAGIC)
    assert path.is_fifo()


def test_a_file_that_can_grow_no_further_is_closed_and_nobody_collects_for_it(tmp_path, monkeypatch):
    bench = make_bench()
    bench.recording.stream(tmp_path / "x.rrd")
    log = bench.recording._log

    def full():
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(log, "write_new_samples", full)
    with pytest.raises(RecordingError, match=r"No space left on device.*It ends with the last flush"):
        bench.recording.flush()
    assert log._sink._file.closed
    assert not log._sink._thread.is_alive()


def test_a_notebook_gets_the_dashboard_of_what_is_neither_nothing_nor_too_much(monkeypatch):
    """a recording of no sample, of one, of the most, of one more"""

    class Run:
        def __init__(self, n):
            self.n = n

        def __len__(self):
            return self.n

        def save(self, path):
            raise InterruptedError("it is sent")

    monkeypatch.setattr(rerun_viewer, "is_installed", lambda library: True)
    monkeypatch.setitem(sys.modules, "rerun_notebook", SimpleNamespace())
    for n in (0, rerun_viewer.MAX_WIDGET_SAMPLES + 1):
        assert rerun_viewer.build_widget(Run(n)) == {}
    for n in (1, rerun_viewer.MAX_WIDGET_SAMPLES):
        with pytest.raises(InterruptedError, match="it is sent"):
            rerun_viewer.build_widget(Run(n))
    monkeypatch.setattr(rerun_viewer, "is_installed", lambda library: library != "rerun_notebook")
    assert rerun_viewer.build_widget(Run(1)) == {}


# --- shapes ---


def model_of(world, assets=""):
    return mujoco.MjModel.from_xml_string(f"<mujoco><asset>{assets}</asset><worldbody>{world}</worldbody></mujoco>")


def arrays(shape, *names):
    return [np.array(getattr(shape, name).as_arrow_array().to_pylist()) for name in names]


def test_the_floor_is_level_and_of_the_world():
    """a plane of a body, a wall, then the floor, turned round its own axis by half a turn"""
    plane = '<geom type="plane" size="1 1 1" {}/>'
    inside = f'<body pos="0 0 1">{plane.format("")}</body>'
    assert rerun_geoms.find_floor(model_of(inside)) is None
    model = model_of(plane.format('euler="0 90 0"') + plane.format('quat="-1 0 0 0"') + plane.format("") + inside)
    assert rerun_geoms.find_floor(model) == 1


def test_a_plane_is_a_slab_of_its_size_or_of_the_models_where_it_is_endless():
    """a wall that faces +x: its slab lies behind it"""
    model = model_of('<body><geom type="plane" size="0.5 900 .1" pos="3 0 0" euler="0 90 0"/><geom size=".1"/></body>')
    ((_, shape),) = [s for s in rerun_geoms.list_shapes(model, 1) if s[0] == "planes"]
    far = 2 * float(model.stat.extent)
    assert far < 900
    half, centre, turn = arrays(shape, "half_sizes", "centers", "quaternions")
    assert half[0] == pytest.approx([0.5, far, rerun_geoms.PLANE_THICKNESS_M], rel=1e-6)
    assert centre[0] == pytest.approx([3 - rerun_geoms.PLANE_THICKNESS_M, 0, 0], abs=1e-6)
    assert turn[0] == pytest.approx([0, 0.5**0.5, 0, 0.5**0.5], abs=1e-6), "x y z w"


def test_a_mesh_is_rotated_and_placed_with_outward_faces():
    """two wedges, the second turned by 90 degrees round z and moved by 5 along x"""
    wedge = '<mesh name="{}" vertex="0 0 0  {s} 0 0  0 {s} 0  0 0 {s}"/>'
    model = model_of(
        '<body><geom type="mesh" mesh="small" pos="-9 0 0"/>'
        '<geom name="named" type="mesh" mesh="large" pos="5 0 0" euler="0 0 90"/></body>',
        wedge.format("small", s=1) + wedge.format("large", s=2),
    )
    shapes = dict(rerun_geoms.list_shapes(model, 1))
    assert list(shapes) == ["mesh_0", "mesh_named"]
    for name, corners in (
        ("mesh_0", [(-9, 0, 0), (-8, 0, 0), (-9, 1, 0), (-9, 0, 1)]),
        ("mesh_named", [(5, 0, 0), (5, 2, 0), (3, 0, 0), (5, 0, 2)]),
    ):
        vertices, normals = arrays(shapes[name], "vertex_positions", "vertex_normals")
        assert {tuple(v) for v in vertices.round(4).tolist()} == {tuple(map(float, c)) for c in corners}
        middle = np.mean(corners, axis=0)
        outwards = np.einsum("ij,ij->i", normals, vertices - middle)
        assert outwards.min() > 0
        assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(len(normals)))
        triangles = vertices.reshape(-1, 3, 3)
        edges = triangles[:, 1:] - triangles[:, :1]
        assert np.einsum("ij,ij->i", np.cross(edges[:, 0], edges[:, 1]), normals[::3]).min() > 0


def test_a_capsule_begins_at_its_lower_end_and_a_sphere_is_round():
    """a capsule that lies along x; a sphere and an ellipsoid, each of its own half axes"""
    model = model_of(
        '<body><geom type="capsule" size=".1 .4" pos="1 2 3" euler="0 90 0"/><geom type="cylinder" size=".2 .3" pos="4 5 6"/>'
        '<geom type="sphere" size=".5"/><geom type="ellipsoid" size=".1 .2 .3"/></body>'
    )
    shapes = dict(rerun_geoms.list_shapes(model, 1))
    lengths, radii, at = arrays(shapes["capsules"], "lengths", "radii", "translations")
    assert (lengths[0], radii[0]) == pytest.approx((0.8, 0.1))
    assert at[0] == pytest.approx([0.6, 2, 3], abs=1e-6)
    lengths, radii, at = arrays(shapes["cylinders"], "lengths", "radii", "centers")
    assert (lengths[0], radii[0]) == pytest.approx((0.6, 0.2))
    assert at[0] == pytest.approx([4, 5, 6])
    assert arrays(shapes["spheres"], "half_sizes")[0][0] == pytest.approx([0.5] * 3)
    assert arrays(shapes["ellipsoids"], "half_sizes")[0][0] == pytest.approx([0.1, 0.2, 0.3])


def test_a_colour_is_clipped_rounded_and_that_of_the_first_material_too():
    model = model_of(
        '<geom size="1" rgba=".501 2 -1 1"/><geom size="1" material="first" rgba="1 1 1 1"/>',
        '<material name="first" rgba="0 1 0 .5"/>',
    )
    assert rerun_geoms.find_color(model, 0).tolist() == [128, 255, 0, 255]
    assert rerun_geoms.find_color(model, 1).tolist() == [0, 255, 0, 128]


def test_poses_are_those_of_each_row():
    """two rows of a slide along x: bodies and sites, quaternions as x y z w"""
    model = mujoco.MjModel.from_xml_string(ONE_AXIS.replace("<geom", '<site name="s" pos="0 .5 0"/><geom'))
    xpos, xquat, sites = rerun_geoms.compute_poses(model, np.array([[0.1], [0.3]]))
    assert xpos[:, 1, 0] == pytest.approx([0.1, 0.3])
    assert xquat[:, 1].tolist() == [[0, 0, 0, 1]] * 2
    assert sites[:, 0].tolist() == [pytest.approx([0.1, 0.5, 0]), pytest.approx([0.3, 0.5, 0])]
