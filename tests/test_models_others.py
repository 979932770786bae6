"""xya, with a rotary table, and gantry, with two motors on its long axis."""

import re
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest

from stage import Stage, firmware
from stage.cli import main
from stage.errors import ArgumentError, ModelError
from stage.firmware.gantry_homing import group_tandem_axes
from stage.sim import plant

OTHERS = ("xya", "gantry")
MODELS = Path(__file__).parents[1] / "models"


@pytest.fixture(scope="module", params=OTHERS)
def model(request):
    return plant.open_spec(request.param).compile()


def test_it_runs_under_gravity_without_a_warning_or_an_unwanted_contact(model, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 4000)
    assert not data.warning.number.any()
    assert not any(c.efc_address >= 0 for c in data.contact[: data.ncon]), "nothing touches"
    assert np.abs(data.qpos).max() < 1e-5, "it stands"
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_switches_are_detected_before_the_touch_and_exert_no_force(model):
    data = mujoco.MjData(model)
    for a in plant.bind_axes(model):
        stops = {model.geom(k).id for k in range(model.ngeom) if "bumper" in model.geom(k).name}
        for q in np.linspace(*a.travel, 60):
            mujoco.mj_resetData(model, data)
            data.qpos[a.qpos] = q
            mujoco.mj_forward(model, data)
            pushing = [c for c in data.contact[: data.ncon] if c.efc_address >= 0]
            assert all(stops & {int(c.geom1), int(c.geom2)} for c in pushing)
        assert all(s.lookahead >= 0.005 * (10 if a.hinge else 1) for s in a.switches)


@pytest.mark.parametrize("degrees", [40, -7, -40, 170])
def test_a_table_without_end_limits_homes_from_anywhere(degrees):
    """stage home a --model xya --from -40deg"""
    stage = Stage("xya", visuals=False)
    a = stage.axes["a"]
    stage.place(a=np.radians(degrees))
    report = firmware.home(a)
    assert (report.stopped_by, report.lost_steps) == ("ORG", 0)
    revolutions = 0 if degrees >= -19 else -1
    assert np.degrees(a.position) == pytest.approx(360 * revolutions, abs=0.01)


def test_a_revolution_is_57600_pulses_and_is_reported_in_degrees():
    stage = Stage("xya", visuals=False)
    report = firmware.move(stage.axes["a"], pulses=57_600)
    assert report.lost_steps == 0
    assert re.search(r"from 0\.0000 deg to (359\.99|360\.00)\d\d deg,", str(report))


def get_racking_angle(stage):
    return np.degrees(stage.data.joint("racking").qpos[0])


@pytest.mark.parametrize(
    ("chips", "y", "w"),
    [
        ("pcl240k", -0.040, -0.0388),
        ("pcl240k", -0.0695, -0.0705),
        ("mcx514", -0.104, -0.104),
        ("hctl1100", -0.065, -0.065),
    ],
)
def test_a_gantry_is_squared_from_anywhere_with_any_chip(chips, y, w):
    """stage home y --model gantry"""
    stage = Stage("gantry", chips=chips, visuals=False)
    stage.place(y=y, w=w)
    stage.run(0.1)
    reports = firmware.square_gantry(*(stage.axes[name] for name in ("y", "w")))
    assert [(r.axis, r.stopped_by, r.lost_steps) for r in reports] == [("y", "ORG", 0), ("w", "ORG", 0)]
    assert abs(get_racking_angle(stage)) < 2e-3
    assert firmware.line({"y": 20e-3, "w": 20e-3}, stage).axes["y"].lost_steps == 0
    assert abs(get_racking_angle(stage)) < 2e-3


def test_tandem_axes_know_each_other_and_form_a_group():
    stage = Stage("gantry", visuals=False)
    assert {name: axis.tandem for name, axis in stage.axes.items()} == {"y": ("w",), "w": ("y",), "x": ()}
    assert [[a.name for a in group] for group in group_tandem_axes(stage.axes.values())] == [["y", "w"], ["x"]]
    assert [[a.name for a in group] for group in group_tandem_axes([stage.axes["w"]])] == [["y", "w"]]
    alone = Stage("gantry", chips={"x": "PCL240K", "y": "PCL240K"}, visuals=False).axes
    assert alone["y"].tandem == (), "its other motor is no axis of the stage"
    assert [[a.name for a in group] for group in group_tandem_axes(alone.values())] == [["x"], ["y"]]


def test_a_tandem_of_what_is_no_other_axis_is_refused():
    spec = plant.open_spec("gantry")
    next(t for t in spec.texts if t.name == "y_tandem").data = "v y"
    with pytest.raises(ModelError, match=r"y_tandem names 'v'.*names other axes of one load(.|\n)*y_tandem names 'y'"):
        Stage(spec)


def test_squaring_one_axis_is_refused_and_so_is_a_direction_that_is_none():
    axes = Stage("gantry", visuals=False).axes
    with pytest.raises(ArgumentError, match="1 axes: tandem axes are two or more; use home for one"):
        firmware.square_gantry(axes["y"])
    with pytest.raises(ArgumentError, match="direction=2: "):
        firmware.square_gantry(axes["y"], axes["w"], direction=2)


def test_squaring_without_an_origin_ahead_ends_at_the_limit():
    stage = Stage("gantry", visuals=False)
    stage.place(y=-0.08, w=-0.08)
    for name in ("y", "w"):
        stage.axes[name].switches.stick("org", False)
    reports = firmware.square_gantry(stage.axes["y"], stage.axes["w"])
    assert {r.stopped_by for r in reports} == {"EL-"}


@pytest.mark.parametrize("model", OTHERS)
def test_the_demo_of_every_model_loses_no_step(model, capsys, tmp_path, monkeypatch):
    """stage demo --model gantry --no-view"""
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--model", model, "--no-view"]) == 0
    table = capsys.readouterr().out
    assert " NO" not in table
    assert table.count("origin return") == 3


def test_stage_home_takes_tandem_axes_together(capsys):
    """stage home w --model gantry --from 30; stage home y --model gantry --ez 1"""
    assert main(["home", "w", "--model", "gantry", "--from", "-50"]) == 0
    assert capsys.readouterr().out.count("stopped by ORG") == 2
    assert main(["home", "y", "--model", "gantry", "--ez", "1"]) == 2
    assert "--ez: axes y and w drive one load" in capsys.readouterr().err


def test_moving_one_of_two_tandem_axes_is_reported(capsys):
    """stage move y 2mm --model gantry"""
    main(["move", "y", "2mm", "--model", "gantry"])
    assert (
        "axis y drives one load with w, which stays behind: the load is twisted. To move all of them: stage sync y=2mm w=2mm"
        in capsys.readouterr().err
    )


def test_one_motor_of_a_gantry_alone_racks_the_beam_and_slips():
    stage = Stage("gantry", visuals=False)
    assert firmware.move(stage.axes["y"], 3e-3).ok
    assert abs(get_racking_angle(stage)) > 0.2
    assert firmware.move(stage.axes["y"], 37e-3).lost_steps


def test_one_of_two_tandem_axes_is_not_tuned(capsys):
    """stage tune gantry --axis y --distance 20mm"""
    assert main(["tune", "gantry", "--axis", "y", "--distance", "20mm"]) == 2
    assert "axis y drives one load with w: moved alone it loses steps" in capsys.readouterr().err


def test_a_line_that_leaves_a_tandem_axis_out_is_reported(capsys):
    """stage sync x=2mm y=2mm --model gantry"""
    main(["sync", "x=2mm", "y=2mm", "--model", "gantry"])
    err = capsys.readouterr().err
    assert "y drives one load with w, which stays behind" in err
    assert "stage sync x=2mm y=2mm w=2mm" in err
    main(["sync", "x=2mm", "y=2mm", "w=2mm", "--model", "gantry"])
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('name="y_tandem" data="w"', 'name="y_tandem" data="x"'),
        ('name="w" joint="w" gear="628.3185307"', 'name="w" joint="w" gear="314"'),
        ('joint name="w" class="slide"', 'joint name="w" class="slide" axis="-1 0 0"'),
    ],
)
def test_tandem_axes_are_side_by_side(old, new, tmp_path):
    """stage view --text gantry.xml, with a tandem of axes across each other, or of other screws"""
    file = copy_model("gantry", tmp_path)
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(
        ModelError, match=r"y_tandem names '[wx]', whose joint has another direction or another distance"
    ):
        Stage(str(file))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('timestep="0.00025"', 'timestep="0.002"', "timestep"),
        (
            '<motor name="x" joint="x"',
            '<motor name="X" joint="x"',
            "joint 'x' has switches, but no actuator is named 'x'",
        ),
        ('geom2="y_org_switch"', 'geom2="y_org_swich"', "cannot compile the model"),
    ],
)
def test_view_says_all_that_is_wrong_with_a_model(old, new, message, tmp_path, capsys):
    """stage view --text my.xml"""
    file = copy_model("gantry", tmp_path)
    texts = {f: f.read_text() for f in tmp_path.glob("*.xml")}
    changed = [f for f, text in texts.items() if old in text]
    assert changed, old
    for f in changed:
        f.write_text(texts[f].replace(old, new))
    code = main(["view", "--text", str(file)])
    reports = capsys.readouterr()
    assert message in reports.out + reports.err
    assert code == (0 if "no actuator" in message else 2)


def copy_model(model, folder):
    """A shipped model, to be changed."""
    for f in MODELS.glob("*.xml"):
        shutil.copy(f, folder)
    return folder / f"{model}.xml"


@pytest.mark.parametrize(
    "reports", [{"a": "b c"}, {"a": "b", "c": "b"}, {"c": "a", "b": "c"}, {"a": "b", "b": "c", "c": "a"}]
)
def test_three_axes_of_one_load_name_each_other_for_any_form_of_the_text(reports):
    bodies = "".join(
        f'<body pos="0 {k} 0"><geom size="0.1"/><joint name="{n}" type="slide" axis="1 0 0" range="-0.1 0.1"/></body>'
        for k, n in enumerate("abcd")
    )
    motors = "".join(f'<motor name="{n}" joint="{n}" gear="628"/>' for n in "abcd")
    texts = "".join(f'<text name="{n}_unfitted" data="el_plus el_minus sd_plus sd_minus org"/>' for n in "abcd")
    texts += "".join(f'<text name="{n}_tandem" data="{others}"/>' for n, others in reports.items())
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{bodies}</worldbody><actuator>{motors}</actuator><custom>{texts}</custom></mujoco>"
    )
    result = {axis.name: axis.tandem for axis in plant.bind_axes(model)}
    assert result == {"a": ("b", "c"), "b": ("a", "c"), "c": ("a", "b"), "d": ()}
