"""The naming contract: a model that keeps it works; one that does not is told what is missing, where, and the line to add."""

import importlib.util
import os
import re
from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np
import pytest

from stage import ArgumentError, ModelError, Stage, faults, firmware
from stage.chips import HCTL1100, PCL240K
from stage.sim import plant
from stage.sim.model_fingerprint import compute_model_digest, iterate_settings
from stage.sim.plant import model_preparation, naming_contract
from stage.sim.plant.model_proposals import Proposal
from stage.sim.plant.naming_contract_errors import ModelProblems
from stage.sim.plant.new_model import NewAxis, build_model_text

ROOT = Path(__file__).parent.parent


def read_example_xml():
    """The stage of scripts/own_stage.py, which the documentation points to."""
    text = (ROOT / "scripts" / "own_stage.py").read_text()
    return text.split('XML = """')[1].split('"""')[0]


def bind(xml):
    return plant.bind_axes(mujoco.MjModel.from_xml_string(xml), ["x"])


def test_a_users_mjcf_makes_a_stage_from_a_path_a_spec_or_a_model(tmp_path):
    path = tmp_path / "own.xml"
    path.write_text(read_example_xml())
    for source in (path, str(path), mujoco.MjSpec.from_string(read_example_xml())):
        stage = Stage(source)
        stage.run(0.01)
        assert list(stage.axes) == ["x"]
    with_room = read_example_xml().replace("<option", '<size nuserdata="400"/><option')
    stage = Stage(mujoco.MjModel.from_xml_string(with_room))
    stage.run(0.01)


def test_the_userdata_of_a_model_is_left_alone():
    spec = mujoco.MjSpec.from_string(read_example_xml().replace("<option", '<size nuserdata="7"/><option'))
    stage = Stage(spec)
    stage.data.userdata[:7] = np.arange(7)
    stage.run(0.1)
    assert (stage.data.userdata[:7] == np.arange(7)).all()


def test_a_compiled_model_without_room_says_how_much_it_needs():
    with pytest.raises(ModelError, match=r'<size nuserdata="\d+"/>'):
        Stage(mujoco.MjModel.from_xml_string(read_example_xml()))


@pytest.mark.parametrize(
    ("old", "new", "message", "line"),
    [
        ('joint name="x"', 'joint name="xx"', "axis x: no joint 'x' .there is 'xx'", '<joint name="x" type="slide"'),
        ('<motor name="x"', '<motor name="x1"', "axis x: no actuator 'x' .there is 'x1'", '<motor name="x" joint="x"'),
        ('name="x_org"', 'name="x_orig"', "no contact sensor 'x_org' .there is 'x_orig'", '<contact name="x_org"'),
        ('"sd_plus sd_minus"', '"sd_plus"', "no contact sensor 'x_sd_minus'", '<contact name="x_sd_minus"'),
        ('"sd_plus sd_minus"', '"sd_plus sd_minus sd"', "names 'sd'", ""),
        ('range="-0.1 0.1"', "", "has no range", "range="),
        ('gear="628.3185307"', 'gear="0"', "not a <motor>", "gear="),
        ('pos="-.0905 .06 0"', 'pos="-.0905 .9 0"', "switch org: the vane cannot reach it", ""),
        ('margin="-0.03" gap="0.04"/>\n    <pair geom1="vane" geom2="left"',
         'margin="-0.03" gap="0.0301"/>\n    <pair geom1="vane" geom2="left"', "does not see its vane", "<pair geom1"),
        ('margin="-0.03" gap="0.04"/>\n    <pair geom1="vane" geom2="left"',
         'margin="0.0" gap="0.04"/>\n    <pair geom1="vane" geom2="left"', "pushes its vane", 'margin="-0.03"'),
    ],
)  # fmt: skip
def test_what_breaks_the_contract_is_named_with_axis_and_line(old, new, message, line):
    assert old in read_example_xml()
    with pytest.raises(ModelError, match=message) as caught:
        bind(
            read_example_xml()
            .replace(old, new, 1)
            .replace('joint="x"', 'joint="xx"' if "joint name" in old else 'joint="x"')
        )
    assert line in "\n".join(caught.value.missing)
    assert line in str(caught.value)


def test_a_switch_at_the_wrong_end_is_noticed():
    swapped = (
        read_example_xml()
        .replace("x_el_plus", "x_tmp")
        .replace("x_el_minus", "x_el_plus")
        .replace("x_tmp", "x_el_minus")
    )
    with pytest.raises(ModelError, match="wrong end") as caught:
        bind(swapped)
    for side in ("plus", "minus"):
        assert f"el_{side} trips when the joint moves away from {side}: is it at the wrong end" in str(caught.value)


def test_all_problems_are_reported_at_once():
    xml = read_example_xml().replace('name="x_org"', 'name="a"').replace('name="x_el_plus"', 'name="b"')
    with pytest.raises(ModelError) as caught:
        bind(xml)
    sensors = [line for line in caught.value.missing if line.startswith("<contact")]
    assert [re.search('name="(.*?)"', line)[1] for line in sensors] == ["x_el_plus", "x_org"]


def test_a_model_without_axes_says_what_an_axis_is():
    xml = "<mujoco><worldbody><body><joint name='j' type='slide'/><geom size='.1'/></body></worldbody></mujoco>"
    with pytest.raises(ModelError, match="no axis: a joint and an actuator of the same name"):
        Stage(mujoco.MjSpec.from_string(xml))


def test_a_hinge_can_be_an_axis():
    xml = (
        read_example_xml()
        .replace('type="slide" axis="1 0 0"', 'type="hinge" axis="0 0 1"')
        .replace('armature="2.2"', 'armature="1e-4"')
    )
    xml = (
        xml.replace('gear="628.3185307"', 'gear="6"')
        .replace('range="-0.1 0.1"', 'range="-1 1"')
        .replace('damping="20"', 'damping="1e-3"')
    )
    xml = xml.replace('frictionloss="2"', "").replace('pos=".1005 .06 0"', 'pos="-.0424 .0424 0"')
    xml = xml.replace('pos="-.1005 .06 0"', 'pos=".0424 .0424 0"').replace('pos="-.0905 .06 0"', 'pos=".035 .0487 0"')
    axis = bind(xml)[0]
    assert axis.hinge
    assert {s.pin for s in axis.switches} == {"el_plus", "el_minus", "org"}
    assert all(s.slope != 0 for s in axis.switches)


def test_unknown_models_and_broken_files_have_different_errors(tmp_path):
    with pytest.raises(ArgumentError, match=r"Did you mean .*'xyz'"):
        plant.open_spec("xzy")
    with pytest.raises(ModelError, match="no MJCF file"):
        plant.open_spec(tmp_path / "none.xml")
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbuddy/></mujoco>")
    with pytest.raises(ModelError, match=r"broken\.xml is no MJCF"):
        plant.open_spec(broken)
    with pytest.raises(ArgumentError, match="a path, an MjSpec or an MjModel"):
        plant.open_spec(42)


def test_describe_is_a_table_of_the_axes():
    text = plant.format_axes(plant.open_spec("xyz").compile())
    assert [line.split()[0] for line in text.splitlines()] == ["axis", "x", "y", "z"]
    assert "el_plus 150.00" in text


def test_the_example_program_runs():
    spec = importlib.util.spec_from_file_location("own_stage", ROOT / "scripts" / "own_stage.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.machine.axes["x"].chip.pins.org


# --- the complete model of docs/models.md, and everything that can be wrong with it ---


def read_documented_xml():
    return (ROOT / "docs" / "models.md").read_text().split("```xml\n")[1].split("```")[0]


def edit_documented_xml(*changes):
    xml = read_documented_xml()
    for old, new in changes:
        assert xml.count(old) == 1, f"{xml.count(old)} times in docs/models.md: {old}"
        xml = xml.replace(old, new)
    return xml


def get_model_error(xml, axes=("x",)):
    with pytest.raises(ModelError) as caught:
        plant.bind_axes(mujoco.MjModel.from_xml_string(xml), axes)
    return caught.value


def test_the_model_in_the_documentation_is_complete_and_homes(tmp_path):
    from stage import firmware

    path = tmp_path / "one_axis.xml"
    path.write_text(read_documented_xml())
    stage = Stage(path)
    (axis,) = plant.bind_axes(stage.model)
    touches = {s.pin: s.touch for s in axis.switches}
    assert touches == pytest.approx(
        {"el_plus": 0.05, "el_minus": -0.05, "sd_plus": 0.04, "sd_minus": -0.035, "org": -0.045}
    )
    assert axis.motor == "17HS4401"
    assert firmware.origin_return(stage.axes["x"]).stopped_by == "ORG"


def test_what_bind_finds_is_where_mujoco_puts_it():
    model = mujoco.MjModel.from_xml_string(read_documented_xml())
    (axis,) = plant.bind_axes(model)
    assert (axis.joint, axis.qpos, axis.dof, axis.actuator) == (0, 0, 0, 0)
    assert axis.travel == (-0.057, 0.057)
    assert [s.pin for s in axis.switches] == list(plant.SWITCH_PINS)
    for s in axis.switches:
        assert model.sensor(s.sensor).name == f"x_{s.pin}"
        assert (s.found, s.dist) == (model.sensor_adr[s.sensor], model.sensor_adr[s.sensor] + 1)
        assert s.slope == pytest.approx(-1 if s.pin.endswith("plus") else 1)
        assert s.lookahead == pytest.approx(0.010, abs=1e-6)


def test_sensors_may_report_more_fields_than_required():
    xml = edit_documented_xml(
        ('geom2="org_beam" num="1" data="found dist"', 'geom2="org_beam" num="1" data="found force dist normal"')
    )
    s = plant.bind_axes(mujoco.MjModel.from_xml_string(xml))[0].switches[-1]
    assert s.dist == s.found + 4


def test_a_motor_may_be_left_handed():
    xml = edit_documented_xml(('gear="628.3185307"', 'gear="-628.3185307"'))
    assert plant.bind_axes(mujoco.MjModel.from_xml_string(xml))[0].gear == pytest.approx(-2 * np.pi / 0.01)


@pytest.mark.parametrize(("model", "chip"), [("xy", "PCL240K"), ("xyz_servo", "HCTL1100")])
def test_an_axis_with_a_left_hand_screw_follows_pulses_of_the_opposite_sign(model, chip):
    """firmware.move(axis, 3e-3) on a model with gear="-628.3185307" """
    spec = plant.open_spec(model)
    next(a for a in spec.actuators if a.name == "x").gear[0] *= -1
    stage = Stage(spec, chips=chip, visuals=False)
    x = stage.axes["x"]
    assert x.meters_per_pulse > 0
    assert " 10.000 mm" in plant.format_axes(stage.model).splitlines()[1]
    report = firmware.move(x, 3e-3)
    assert report.ok
    assert report.pulses == -round(3e-3 / x.meters_per_pulse)
    assert x.position == pytest.approx(3e-3, abs=25e-6)
    if chip == "PCL240K":
        with faults.jam(x):
            assert firmware.move(x, 3e-3).lost_steps == -60
            assert x.position == pytest.approx(3e-3, abs=50e-6)
        assert firmware.move(x, 1e-3).lost_steps == 0, "those before are not its own"


def test_the_origin_may_be_a_short_vane_narrower_than_the_scan():
    narrow = (
        '<geom name="vane"',
        '<geom name="tab" type="box" size="0.00005 0.004 0.004" pos="0.00005 0.08 0"/><geom name="vane"',
    )
    beam = 'name="org_beam" class="beam" pos="-0.0755 0.05 0"', 'name="org_beam" class="beam" pos="-0.0311 0.08 0"'
    pair = 'geom1="vane" geom2="org_beam"/>', 'geom1="tab" geom2="org_beam"/>'
    sensor = '<contact name="x_org" geom1="vane"', '<contact name="x_org" geom1="tab"'
    s = plant.bind_axes(mujoco.MjModel.from_xml_string(edit_documented_xml(narrow, beam, pair, sensor)))[0].switches[-1]
    assert s.touch == pytest.approx(-0.0306, abs=1e-9), "its edge on the plus side"
    assert s.slope == pytest.approx(1)


MOTOR = '<motor name="x" joint="x" gear="628.3185307"/>'
ORG = '<contact name="x_org" geom1="vane" geom2="org_beam" num="1" data="found dist"/>'
ORG_LINE = '<contact name="x_org" geom1="vane" geom2="org_beam" num="1" reduce="mindist" data="found dist"/>'
EL = 'name="el_plus_beam" class="beam" pos="0.0805 0.05 0"'


@pytest.mark.parametrize(
    ("changes", "message", "line"),
    {
        "a ball joint": (
            [('type="slide" axis="1 0 0" range="-0.057 0.057" limited="false" damping="60" frictionloss="4" armature="3.711"',
              'type="ball"'), (MOTOR, '<motor name="x" joint="x" gear="1 0 0"/>')],
            "axis x: joint 'x' is neither slide nor hinge", '<joint name="x" type="slide"'),
        "a position servo": (
            [(MOTOR, '<position name="x" joint="x" kp="9"/>')],
            "axis x: actuator 'x' is not a <motor> on joint 'x'", MOTOR),
        "a filtered motor": (
            [(MOTOR, '<general name="x" joint="x" gear="628" dyntype="filter" dynprm="0.1"/>')],
            "is not a <motor> on joint 'x'", '<motor name="x" joint="x" gear="628"/>'),
        "a motor that makes two of one": (
            [(MOTOR, '<general name="x" joint="x" gear="628" gainprm="2"/>')],
            "is not a <motor> on joint 'x'", '<motor name="x" joint="x" gear="628"/>'),
        "a motor on another joint": (
            [('<joint name="x"', '<joint name="a" type="slide" axis="0 1 0"/><joint name="x"'),
             (MOTOR, '<motor name="x" joint="a" gear="628"/>')],
            "is not a <motor> on joint 'x'", '<motor name="x" joint="x" gear="628"/>'),
        "a sensor of another kind": (
            [(ORG, '<distance name="x_org" geom1="vane" geom2="org_beam" cutoff="1"/>')],
            "sensor 'x_org' is not a <contact> sensor", 'data="found dist"/>'),
        "a sensor between bodies": (
            [(ORG, '<contact name="x_org" body1="carriage" geom2="org_beam" num="1" data="found dist"/>')],
            "sensor 'x_org' must name geom1 .vane. and geom2 .switch.", '<contact name="x_org"'),
        "a sensor without distance": (
            [(ORG, ORG.replace("found dist", "found force"))], "sensor 'x_org' needs data=.found dist.", ORG_LINE),
        "a name in capitals": (
            [(ORG, ORG.replace("x_org", "X_ORG"))], "no contact sensor 'x_org' .there is 'X_ORG': a slip", '<contact name="x_org"'),
        "no pair": (
            [('<pair class="switch" geom1="vane" geom2="org_beam"/>', "")],
            "sensor 'x_org' does not see its vane 0.5 mm before the touch: no pair",
            '<pair geom1="vane" geom2="org_beam" margin="-0.03" gap="0.04"/>'),
        "a thick vane": (
            [('size="0.03 0.0005 0.005"', 'size="0.03 0.035 0.035"'), ('margin="-0.03" gap="0.04"', 'margin="-0.005" gap="0.04"')],
            "switch el_plus pushes its vane: the margin must be negative", '<pair geom1="vane" geom2="el_plus_beam"'),
        "a sensor that reads another contact": (
            [(ORG, ORG.replace('geom1="vane"', 'geom1="long"')),
             ('<geom name="vane"', '<geom name="long" type="box" size="0.03 0.002 0.1" pos="0 0.05 0.3"/><geom name="vane"'),
             ('<geom name="org_beam" class="beam" pos="-0.0755 0.05 0"/>',
              '<geom name="org_beam" type="box" size="0.01 0.004 0.3" pos="-0.0855 0.05 0.3" euler="0 -1 0"/>'),
             ('<pair class="switch" geom1="vane" geom2="org_beam"/>', '<pair class="switch" geom1="long" geom2="org_beam"/>')],
            "sensor 'x_org' reads .* mm where vane and switch are 0.500 mm apart", 'reduce="mindist"'),
        "always asserted": (
            [('name="org_beam" class="beam" pos="-0.0755 0.05 0"', 'name="org_beam" class="beam" pos="0 0.05 0"'),
             ('size="0.03 0.0005 0.005"', 'size="0.06 0.0005 0.005"')],
            "switch org: the vane trips it over the whole range -0.057 to 0.057", ""),
        "out of reach": (
            [(EL, EL.replace("0.0805", "0.0905"))],
            "switch el_plus: the vane cannot reach it: nearest at 0.057, 3 mm away", ""),
        "EL lets go": (
            [('size="0.03 0.0005 0.005"', 'size="0.002 0.0005 0.005"'), (EL, EL.replace("0.0805", "0.0505")),
             ('pos="-0.0805', 'pos="-0.0505'), ('pos="0.0705', 'pos="0.0405'), ('pos="-0.0655', 'pos="-0.0355'),
             ('pos="-0.0755', 'pos="-0.0455')],
            "switch el_plus trips at 0.048 but lets go again before", ""),
        "a stop before EL": (
            [('size="0.006" pos="0.091 0 0"', 'size="0.006" pos="0.081 0 0"')],
            "the hard stop .'bumper_plus' and 'carriage' touch. comes before el_plus, which trips at 0.05", ""),
        "SD beyond EL": (
            [('pos="0.0705', 'pos="0.0815')], "sd_plus trips at 0.051, el_plus at 0.05: in this order it can slow nothing", ""),
        "SD beyond EL of minus": (
            [('pos="-0.0655', 'pos="-0.0815')],
            "el_minus trips at -0.05, sd_minus at -0.051: in this order it can slow nothing", ""),
        "ORG beyond EL of plus": (
            [('pos="-0.0755', 'pos="0.0215')], "org trips at 0.052, el_plus at 0.05: in this order the origin is never", ""),
        "ORG beyond EL": (
            [('pos="-0.0755', 'pos="-0.0825')], "el_minus trips at -0.05, org at -0.052: in this order the origin is never", ""),
        "an unfitted switch misspelt": (
            [('<text name="x_motor"', '<text name="x_unfitted" data="sdplus"/><text name="x_motor"')],
            "the text x_unfitted names 'sdplus' .meant 'sd_plus'", ""),
    }.values(),
)  # fmt: skip
def test_every_fault_is_reported_with_what_where_and_the_line(changes, message, line):
    error = get_model_error(edit_documented_xml(*changes))
    assert re.search(message, str(error)), str(error)
    assert line in "\n".join(error.missing), error.missing
    assert all(text in str(error) for text in error.missing)


def test_a_joint_of_another_kind_gets_one_error_alone():
    """Replace a slide by a ball, which has neither range nor switches nor motor: consequences, not errors."""
    ball = ('type="slide" axis="1 0 0" range="-0.057 0.057" limited="false" damping="60" frictionloss="4" armature="3.711"',
            'type="ball"')  # fmt: skip
    error = get_model_error(edit_documented_xml(ball, (MOTOR, '<motor name="x" joint="x" gear="1 0 0"/>')))
    assert str(error).count("axis x: ") == 1
    assert "no range" not in str(error)


@pytest.mark.parametrize("flag", ["contact", "constraint", "sensor"])
def test_switches_need_contacts_and_sensors(flag):
    error = get_model_error(edit_documented_xml(("<option ", f'<option><flag {flag}="disable"/></option><option ')))
    assert 'Remove contact="disable", constraint="disable" and sensor="disable"' in str(error)


def test_an_unfitted_switch_is_not_required():
    xml = edit_documented_xml(
        (ORG, ""), ('<text name="x_motor"', '<text name="x_unfitted" data="org"/><text name="x_motor"')
    )
    assert "org" not in [s.pin for s in plant.bind_axes(mujoco.MjModel.from_xml_string(xml))[0].switches]


def test_a_joint_without_a_motor_is_an_axis_only_when_named():
    xml = edit_documented_xml(
        ('<joint name="x"', '<joint name="tilt" type="hinge" axis="0 1 0" stiffness="1e6"/><joint name="x"')
    )
    model = mujoco.MjModel.from_xml_string(xml)
    assert [a.name for a in plant.bind_axes(model)] == ["x"]
    error = get_model_error(xml, ["tilt"])
    assert "axis tilt: no actuator 'tilt'" in str(error)
    assert error.missing == ('<motor name="tilt" joint="tilt" gear="10"/>',), "a hinge is no screw"


def test_axes_can_be_selected_where_another_joint_has_a_servo():
    hand = (
        "</body>\n  </worldbody>",
        '<body><joint name="hand" type="slide"/><geom size="0.01" mass="1"/></body></body>\n  </worldbody>',
    )
    xml = edit_documented_xml(hand, (MOTOR, MOTOR + '<position name="hand" joint="hand" kp="9"/>'))
    assert [a.name for a in plant.bind_axes(mujoco.MjModel.from_xml_string(xml), ["x"])] == ["x"]
    assert "if 'hand' is no axis of a chip, name those that are" in str(get_model_error(xml, None))


def test_a_loose_part_is_no_hard_stop():
    part = '<body pos="0.078 0 0"><freejoint/><geom name="part" type="sphere" size="0.002" mass="0.01"/></body>'
    pair = '<pair geom1="carriage" geom2="part"/>'
    xml = edit_documented_xml(
        ('<body name="carriage">', part + '<body name="carriage">'), ("</contact>\n  <act", pair + "</contact>\n  <act")
    )
    assert plant.bind_axes(mujoco.MjModel.from_xml_string(xml))


def test_a_slip_between_actuator_and_joint_is_pointed_out():
    with pytest.raises(ModelError, match=r"no axis: .* Actuator 'X' and joint 'x': a slip\? Joints: x; actuators: X\."):
        plant.find_axis_names(
            mujoco.MjModel.from_xml_string(edit_documented_xml((MOTOR, MOTOR.replace('name="x"', 'name="X"'))))
        )


def test_the_error_for_a_missing_file_names_the_shipped_model_of_that_name(tmp_path):
    with pytest.raises(ModelError, match=r"no MJCF file at .*xyz\.xml\. Did you mean the shipped model 'xyz'\?"):
        plant.open_spec(tmp_path / "xyz.xml")


def test_a_compile_error_of_mujoco_has_the_models_name():
    spec = mujoco.MjSpec.from_string(edit_documented_xml(('geom2="org_beam"/>', 'geom2="orb_beam"/>')))
    with pytest.raises(ModelError, match=r"(?s)cannot compile the model 'one axis': .*orb_beam"):
        plant.compile_spec(plant.open_spec(spec), 3)


def test_userdata_begins_after_that_of_the_model_and_the_source_is_unchanged():
    spec = mujoco.MjSpec.from_string(edit_documented_xml(("<option ", '<size nuserdata="7"/><option ')))
    model, offset = plant.compile_spec(plant.open_spec(spec), 5)
    assert (model.nuserdata, offset, spec.nuserdata) == (12, 7, 7)
    assert plant.compile_spec(plant.open_spec(model), 5)[1] == 7
    assert plant.compile_spec(plant.open_spec("xy"), 5)[1] == 0


@pytest.mark.parametrize("timestep", ["inf", "nan", "1e300", "1e-8", "2"])
def test_a_timestep_that_is_no_time_is_refused(timestep):
    spec = plant.open_spec("xy")
    spec.option.timestep = float(timestep)
    with pytest.raises(ArgumentError, match=r"timestep .* needs 800 ns to 1 s"):
        Stage(spec)


def make_spec_with_step(step, xml=None):
    xml = read_documented_xml() if xml is None else xml
    option = '<option timestep="0.00025" integrator="implicitfast"/>'
    assert option in xml
    return mujoco.MjSpec.from_string(xml.replace(option, f'<option timestep="{step}"/>' if step else ""))


@pytest.mark.parametrize("step", [None, 0.002, 0.001])
def test_a_step_that_is_too_long_for_a_stepper_is_refused_with_the_line_to_add(step):
    """Stage("no_option_timestep.xml"): MuJoCo's 2 ms were taken, and a move lost 156 steps"""
    with pytest.raises(ModelError, match=r"too long: axis x on its 17HS4401 oscillates at up to 180 Hz") as caught:
        Stage(make_spec_with_step(step))
    assert caught.value.missing == ('<option timestep="0.00025"/>',)
    assert ("where a model says nothing" in str(caught.value)) is (step != 0.001)


def test_a_time_step_near_the_maximum_loses_no_steps():
    """The move that loses 1328 steps with 2 ms."""
    from stage import firmware

    for step in (0.00088, 0.0005):
        x = Stage(make_spec_with_step(step), visuals=False).axes["x"]
        x.stage.place(x=-0.03)
        firmware.preset_move(x, 16_000)
        assert x.lost_steps == 0
        assert x.position == pytest.approx(x.commanded, abs=4 * x.meters_per_pulse)


def test_the_time_step_proposed_is_well_below_the_maximum():
    """Expect the largest of 5, 2.5 and 1 times a power of ten that is at most 0.7 of the maximum."""
    parts = []
    for mass in np.geomspace(0.02, 0.4, 6):
        light = (
            read_documented_xml().replace('armature="3.711"', 'armature="0.001"').replace('mass="2"', f'mass="{mass}"')
        )
        with pytest.raises(ModelError, match="a time step of") as caught:
            Stage(make_spec_with_step(0.001, light))
        maximum = float(re.search(r"takes steps of (\S+) s at most", str(caught.value))[1])
        step = float(re.search('timestep="(.*?)"', caught.value.missing[0])[1])
        parts.append(step / maximum)
    assert 0.26 < min(parts) < 0.5
    assert 0.5 < max(parts) < 0.75


def test_how_long_a_step_may_be_depends_on_the_motor_and_on_what_it_moves():
    light = read_documented_xml().replace('armature="3.711"', 'armature="0.01"').replace('mass="2"', 'mass="0.001"')
    with pytest.raises(ModelError, match=r"a time step of 0\.00025 s is too long") as caught:
        Stage(make_spec_with_step(0.00025, light.replace('data="17HS4401"', 'data="none"').replace("x_motor", "note")))
    (line,) = caught.value.missing
    Stage(make_spec_with_step(re.search(r'"(.+)"', line)[1], light.replace("x_motor", "note")), visuals=False).run(0.01)
    Stage(make_spec_with_step(0.001, read_documented_xml().replace('mass="2"', 'mass="9"')), visuals=False)
    Stage(make_spec_with_step(0.001), drives="SS2422-5041", visuals=False)


def test_a_step_that_is_too_long_for_a_dc_motor_is_refused():
    """Stage(spec_of_4_ms, chips=HCTL1100): position control never came to rest"""
    spec = plant.open_spec("xyz_servo")
    for step in (0.004, 0.002):
        spec.option.timestep = step
        with pytest.raises(ModelError, match=r"too long: axis [yz] on its 14201S003 has a time constant of 0\.01"):
            Stage(spec, chips="hctl1100")


@pytest.mark.parametrize("integrator", ["RK4"])
def test_an_integrator_that_is_no_leapfrog_is_refused(integrator):
    """<option integrator="RK4"/>: -11.4 mm for 5, 328 steps lost"""
    spec = plant.open_spec("xy")
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    with pytest.raises(ModelError, match="integrator is RK4") as caught:
        Stage(spec)
    assert caught.value.missing == ('<option integrator="implicitfast"/>',)


@pytest.mark.parametrize("integrator", ["EULER", "IMPLICIT"])
def test_the_other_integrators_move_as_ours(integrator):
    from stage import firmware

    spec = plant.open_spec("xy")
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    x = Stage(spec, visuals=False).axes["x"]
    firmware.preset_move(x, 1600)
    assert x.position == pytest.approx(0.005, abs=2 * x.meters_per_pulse)
    assert x.lost_steps == 0


@pytest.mark.parametrize("gear", ["inf", "nan", "1e300", "1e-300"])
def test_a_gear_that_no_machine_has_is_refused(gear):
    spec = plant.open_spec("xy")
    spec.actuator("x").gear[0] = float(gear)
    with pytest.raises(ModelError, match="gear of 1e-6 to 1e9"):
        Stage(spec)


@pytest.mark.parametrize("armature", ["-1e-3", "-0.5", "inf", "nan"])
def test_an_armature_that_is_no_inertia_is_refused(armature):
    spec = plant.open_spec("xy")
    spec.joint("y").armature = float(armature)
    with pytest.raises(ModelError, match=r"axis y: joint 'y' has an armature of .* inertia is 0 to 1e9"):
        Stage(spec)


def test_an_armature_smaller_than_the_rotor_of_its_motor_is_an_error_where_a_lighter_motor_makes_it_negative():
    spec = plant.open_spec("xy")
    spec.joint("y").armature = 0.0
    with pytest.raises(ModelError, match=r"axis y: the model names motor .* armature of 0, but .* makes [23]\.\d+"):
        Stage(spec, drives={"y": "SS2422-5041"})


@pytest.mark.parametrize("index", ["inf", "nan", "1e300", "-1.01e6"])
def test_an_index_pulse_at_no_position_is_refused(index):
    spec = plant.open_spec("xy")
    spec.add_numeric(name="x_index", data=[float(index)], size=1)
    with pytest.raises(ModelError, match=r"x_index is .* give turns"):
        Stage(spec)


def test_text_that_is_not_utf_8_is_an_unknown_motor(tmp_path):
    for part in (Path(__file__).parent.parent / "models").glob("*.xml"):
        (tmp_path / part.name).write_bytes(part.read_bytes().replace(b'data="17HS4401"', b'data="17HS\xe44401"'))
    with pytest.raises(ArgumentError, match="unknown motor '17HS\N{REPLACEMENT CHARACTER}4401"):
        Stage(tmp_path / "xy.xml")


def test_text_of_a_compiled_model_that_is_not_utf_8_is_an_unknown_motor_too(tmp_path):
    file = tmp_path / "it.xml"
    file.write_bytes(b'<mujoco><custom><text name="x_motor" data="17HS\xe44401"/></custom></mujoco>')
    for source in (mujoco.MjModel.from_xml_path(str(file)), mujoco.MjSpec.from_file(str(file))):
        assert plant.find_motor_names(source) == {"x": "17HS\N{REPLACEMENT CHARACTER}4401"}


def test_a_spec_that_was_changed_is_nobody_elses():
    spec = plant.open_spec("xyz")
    spec.geom("x_org_vane").pos[0] += 0.01
    for source, moved in ((spec, 0.01), ("xyz", 0.0)):
        model, _ = plant.compile_spec(plant.open_spec(source), 0)
        current_place = next(s for s in plant.bind_axes(model)[0].switches if s.pin == "org")
        assert abs(current_place.touch - (-0.12 - moved)) < 2e-4, "the switch trips where the vane is"


def test_a_model_that_was_changed_is_measured_again():
    model, _ = plant.compile_spec(plant.open_spec("xyz"), 0)
    before = plant.bind_axes(model)
    assert plant.bind_axes(model) is before, "the same model is measured once"
    model.geom("x_org_vane").pos[0] += 0.01
    after = plant.bind_axes(model)
    assert [s.touch for s in after[1].switches] == [s.touch for s in before[1].switches]
    org, moved = (next(s.touch for s in axes[0].switches if s.pin == "org") for axes in (before, after))
    assert abs(moved - org + 0.01) < 1e-6


@pytest.mark.parametrize("model", ["xyz", "xyz_servo"])
def test_actuators_may_stand_in_any_order(model, tmp_path):
    for file in (ROOT / "models").glob("*.xml"):
        text = file.read_text()
        if file.stem == model:
            begin, actuators, end = re.split(r"(?<=<actuator>)(.*)(?=</actuator>)", text, flags=re.DOTALL)
            x, *others = actuators.strip().splitlines()
            text = begin + "\n".join([*others, x]) + end
        (tmp_path / file.name).write_text(text)
    stage = Stage(tmp_path / f"{model}.xml", chips=HCTL1100 if model == "xyz_servo" else PCL240K, visuals=False)
    assert [stage.model.actuator(k).name for k in range(3)] == ["y", "z", "x"]
    for axis in stage.axes.values():
        assert stage.model.actuator(axis.plant.actuator).name == stage.model.joint(axis.plant.joint).name == axis.name
    stage.data.qpos[:] = 0.001, 0.002, 0.003
    assert {n: round(a.position, 6) for n, a in stage.axes.items()} == {"y": 0.002, "z": 0.003, "x": 0.001}


def test_every_number_of_a_model_is_in_its_fingerprint_and_no_colour_of_a_texture():
    model = plant.open_spec("xy").compile()
    observed = {compute_model_digest(model)}
    for array in (
        model.geom_pos,
        model.geom_size,
        model.jnt_range,
        model.dof_damping,
        model.actuator_gear,
        model.opt.gravity,
    ):
        array.flat[array.size - 1] += 1e-6
        observed.add(compute_model_digest(model))
    model.opt.timestep *= 2
    observed.add(compute_model_digest(model))
    assert len(observed) == 8
    if model.ntexdata:
        model.tex_data[0] ^= 1
    assert compute_model_digest(model) in observed


def test_a_line_that_mends_two_axes_is_proposed_once():
    problems = ModelProblems()
    for axis in "xy":
        problems.add_problem(axis, "site 'work' is missing", Proposal("in <worldbody>", '<site name="work"/>'))
    with pytest.raises(ModelError, match=r"axis x: .*\n.*axis y: ") as caught:
        problems.raise_if_any()
    assert caught.value.missing == ('<site name="work"/>',)


def test_the_line_to_add_names_the_geoms_that_the_file_has():
    """Remove a sensor: the contract proposed geom2="x_org_switch" where the file has x_org_beam, and took a_org for a slip"""
    text = build_model_text([NewAxis.parse("x:slide:300mm"), NewAxis.parse("a:hinge:90deg")])
    lines = [line for line in text.splitlines() if '<contact name="x_org"' not in line]
    with pytest.raises(ModelError) as caught:
        plant.bind_axes(mujoco.MjModel.from_xml_string("\n".join(lines)))
    assert "slip" not in str(caught.value)
    (line,) = caught.value.missing
    assert 'geom1="x_org_vane" geom2="x_org_beam"' in line
    lines.insert(next(k for k, target in enumerate(lines) if "<contact name=" in target), line)
    assert [s.pin for s in plant.bind_axes(mujoco.MjModel.from_xml_string("\n".join(lines)))[0].switches] == list(
        plant.SWITCH_PINS
    ), "and it mends the model"


@pytest.mark.parametrize("revolutions", [0.0, 0.3, -2.75])
def test_the_index_pulse_is_where_the_model_says_else_half_a_turn_from_the_origin_switch(revolutions):
    """<custom><numeric name="x_index" data="0.3"/></custom>"""
    numeric = f'<numeric name="x_index" data="{revolutions}"/><text name="x_motor"'
    (argument,) = plant.bind_axes(
        mujoco.MjModel.from_xml_string(edit_documented_xml(('<text name="x_motor"', numeric)))
    )[:1]
    assert argument.index == revolutions
    (axis,) = plant.bind_axes(mujoco.MjModel.from_xml_string(read_documented_xml()))[:1]
    touch = next(s.touch for s in axis.switches if s.pin == "org")
    assert axis.index == pytest.approx((touch * axis.gear / (2 * np.pi) + 0.5) % 1.0)
    (other,) = plant.bind_axes(mujoco.MjModel.from_xml_string(read_documented_xml().replace('gear="', 'gear="-')))[:1]
    assert other.index == pytest.approx((touch * other.gear / (2 * np.pi) + 0.5) % 1.0) == pytest.approx(1 - axis.index)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        (
            "frictionloss",
            300,
            'a friction of 300 N, and .* pushes with 251.3 N at most: it never moves. Write frictionloss="10"',
        ),
        (
            "damping",
            3e4,
            'a damping of 30000 N s/m: at one turn a second of the motor that is 300 N, .* Write damping="300"',
        ),
    ],
)
def test_losses_that_the_motor_cannot_overcome_are_refused_with_a_number_to_write(field, value, words):
    spec = plant.open_spec("xy")
    actuator = next(a for a in spec.actuators if a.name == "y")
    one = [1.0, 0.0, 0.0] if field == "damping" else 1.0
    for _ in range(2):
        actuator.gear[0] *= -1
        setattr(spec.joint("y"), field, np.multiply(value, one))
        with pytest.raises(ModelError, match=rf"axis y: its joint has {words}"):
            Stage(spec)
        setattr(spec.joint("y"), field, np.multiply(0.8 * value, one))
        assert Stage(spec, visuals=False).axes["y"].lost_steps == 0


def test_friction_and_damping_that_only_together_are_too_much_are_refused_as_damping():
    spec = plant.open_spec("xy")
    spec.joint("y").frictionloss, spec.joint("y").damping = 150.0, [1.5e4, 0.0, 0.0]
    with pytest.raises(
        ModelError, match=r"axis y: its joint has a damping of 15000 N s/m: .* that is 150 N, and .* 251\.3 N"
    ):
        Stage(spec)


def test_each_kind_of_file_that_is_no_model_has_a_separate_error(tmp_path, monkeypatch):
    """stage view folder.xml said "no MJCF file" of a folder, and of a file without permission"""
    (tmp_path / "folder.xml").mkdir()
    (tmp_path / "empty.xml").touch()
    for name, text in (
        ("none.xml", "no MJCF file at"),
        ("folder.xml", "is a folder"),
        ("empty.xml", "is empty, and no MJCF"),
    ):
        with pytest.raises(ModelError, match=text):
            plant.open_spec(tmp_path / name)
    (tmp_path / "mine.xml").write_text("<mujoco/>")
    monkeypatch.setattr("os.access", lambda path, mode: False)
    with pytest.raises(ModelError, match=r"mine\.xml cannot be read: no permission"):
        plant.open_spec(tmp_path / "mine.xml")


def test_a_switch_of_either_side_is_detected_from_the_same_distance():
    """The pair's margin and gap show a vane 10 mm before the touch, whichever way the joint comes."""
    switches = {s.pin: s for s in plant.bind_axes(mujoco.MjModel.from_xml_string(read_documented_xml()))[0].switches}
    observed = {pin: s.lookahead for pin, s in switches.items()}
    assert observed == pytest.approx(dict.fromkeys(observed, 0.01), rel=1e-3)
    assert {pin: s.slope for pin, s in switches.items()} == pytest.approx(
        {"el_plus": -1, "el_minus": 1, "sd_plus": -1, "sd_minus": 1, "org": 1}
    )


def test_a_joint_without_an_armature_is_an_axis_if_no_motor_is_named():
    xml = edit_documented_xml(('armature="3.711"', 'armature="0"'), ('<text name="x_motor" data="17HS4401"/>', ""))
    stage = Stage(mujoco.MjSpec.from_string(xml), visuals=False)
    assert stage.model.dof_armature[stage.axes["x"].plant.dof] == 0


def test_a_shipped_model_that_is_edited_is_read_again(tmp_path, monkeypatch):
    """Edit a model of a checkout; models are cached because reading takes a hundred times as long as copying."""
    for file in files("stage.models").iterdir():
        if file.name.endswith(".xml"):
            (tmp_path / file.name).write_text(file.read_text())
    monkeypatch.setattr(plant.model_preparation, "_find_model_folder", lambda: tmp_path)
    before = plant.open_spec("xy").option.timestep, Stage("xy").model.opt.timestep
    path = tmp_path / "_common.xml" if "timestep" in (tmp_path / "_common.xml").read_text() else tmp_path / "xy.xml"
    path.write_text(path.read_text().replace('timestep="0.00025"', 'timestep="0.000125"'))
    os.utime(path, ns=(1, 1))
    assert before == (0.00025, 0.00025)
    assert (plant.open_spec("xy").option.timestep, Stage("xy").model.opt.timestep) == (0.000125, 0.000125)


@pytest.mark.parametrize("is_displayed", [True, False])
@pytest.mark.parametrize(
    ("name", "chips"), [("xyz", PCL240K), ("xyz", {"x": HCTL1100, "z": PCL240K}), ("xyz_servo", PCL240K)]
)
def test_a_stage_of_a_shipped_model_has_the_model_of_its_file_alone(name, chips, is_displayed):
    """Compiled models are kept for later stages: nothing that a user changes in one reaches another, or its spec."""
    expected = compute_model_digest(Stage(plant.open_spec(name), chips, visuals=is_displayed).model)
    for _ in range(2):
        model = Stage(name, chips, visuals=is_displayed).model
        assert compute_model_digest(model) == expected
        for _, _, value in iterate_settings(model):
            if isinstance(value, np.ndarray):
                value[...] = 7
        model.opt.timestep = 0.5
    assert compute_model_digest(Stage(name, chips, visuals=not is_displayed).model) != expected
    assert compute_model_digest(Stage(name, HCTL1100, visuals=is_displayed).model) != expected
    assert plant.open_spec(name).option.timestep == 0.00025


def test_the_cache_of_compiled_models_is_bounded(monkeypatch):
    monkeypatch.setattr(model_preparation, "_compiled", {})
    monkeypatch.setattr(model_preparation, "MAX_SHARED_MODELS", 2)
    for axes in ("x", "y", "xy", "yx"):
        Stage("xy", {axis: PCL240K for axis in axes}, visuals=False)
        assert 1 <= len(model_preparation._compiled) <= 2


def test_the_cache_of_measured_models_is_bounded(monkeypatch):
    monkeypatch.setattr(naming_contract, "_bound", {})
    monkeypatch.setattr(naming_contract, "MAX_CACHED_PLANTS", 2)
    for k in range(4):
        model = mujoco.MjModel.from_xml_string(edit_documented_xml(('damping="60"', f'damping="{60 + k}"')))
        assert plant.bind_axes(model) is plant.bind_axes(model)
        assert 1 <= len(naming_contract._bound) <= 2


def test_a_dc_motor_with_a_bias_or_a_state_is_none_for_a_servo():
    spec = plant.open_spec("xyz_servo")
    next(a for a in spec.actuators if a.name == "y").biasprm[1] = -3.0
    with pytest.raises(
        ModelError, match="axis y: actuator 'y' is not a <motor> on joint 'y', nor a <dcmotor> with voltage"
    ):
        plant.bind_axes(spec.compile())


def test_inertias_from_geoms_are_from_geoms_without_visuals_too(tmp_path):
    """<compiler inertiafromgeom="true"/> and a body that says another inertia, which then counts for nothing"""
    path = tmp_path / "own.xml"
    text = read_documented_xml().replace("<worldbody>", '<compiler inertiafromgeom="true"/><worldbody>', 1)
    words_read = (
        '<inertial pos="0 0 0" mass="77" diaginertia="1 1 1"/><geom size="0.02" contype="0" conaffinity="0" mass="3"/>'
    )
    text = text.replace('<body name="carriage">', f'<body name="carriage">{words_read}', 1)
    path.write_text(text)
    bare, full = (Stage(path, visuals=displayed).model for displayed in (False, True))
    assert bare.body("carriage").mass[0] == full.body("carriage").mass[0] < 77
    assert bare.ngeom < full.ngeom
