"""The naming contract: a model that keeps it works; one that does not is told what is missing, where, and the line to add."""

import importlib.util
from pathlib import Path

import mujoco
import numpy as np
import pytest

from stage import ArgumentError, ModelError, Stage, plant

ROOT = Path(__file__).parent.parent


def own_xml():
    """The stage of scripts/own_stage.py, which the documentation points to."""
    text = (ROOT / "scripts" / "own_stage.py").read_text()
    return text.split('XML = """')[1].split('"""')[0]


def bind(xml):
    return plant.bind(mujoco.MjModel.from_xml_string(xml), ["x"])


def test_an_mjcf_of_ones_own_makes_a_stage_from_a_path_a_spec_or_a_model(tmp_path):
    path = tmp_path / "own.xml"
    path.write_text(own_xml())
    for source in (path, str(path), mujoco.MjSpec.from_string(own_xml())):
        stage = Stage(source)
        stage.run(0.01)
        assert list(stage.axes) == ["x"]
    with_room = own_xml().replace("<option", '<size nuserdata="400"/><option')
    stage = Stage(mujoco.MjModel.from_xml_string(with_room))
    stage.run(0.01)


def test_a_models_own_userdata_is_left_alone():
    spec = mujoco.MjSpec.from_string(own_xml().replace("<option", '<size nuserdata="7"/><option'))
    stage = Stage(spec)
    stage.data.userdata[:7] = np.arange(7)
    stage.run(0.1)
    assert (stage.data.userdata[:7] == np.arange(7)).all()


def test_a_compiled_model_without_room_says_how_much_it_needs():
    with pytest.raises(ModelError, match=r'<size nuserdata="\d+"/>'):
        Stage(mujoco.MjModel.from_xml_string(own_xml()))


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
    assert old in own_xml()
    with pytest.raises(ModelError, match=message) as caught:
        bind(own_xml().replace(old, new, 1).replace('joint="x"', 'joint="xx"' if "joint name" in old else 'joint="x"'))
    assert line in "\n".join(caught.value.missing)
    assert line in str(caught.value)


def test_a_switch_at_the_wrong_end_is_noticed():
    swapped = own_xml().replace("x_el_plus", "x_tmp").replace("x_el_minus", "x_el_plus").replace("x_tmp", "x_el_minus")
    with pytest.raises(ModelError, match="wrong end"):
        bind(swapped)


def test_all_problems_are_told_at_once():
    xml = own_xml().replace('name="x_org"', 'name="a"').replace('name="x_el_plus"', 'name="b"')
    with pytest.raises(ModelError) as caught:
        bind(xml)
    assert len(caught.value.missing) == 2


def test_a_model_without_axes_says_what_an_axis_is():
    xml = "<mujoco><worldbody><body><joint name='j' type='slide'/><geom size='.1'/></body></worldbody></mujoco>"
    with pytest.raises(ModelError, match="no axis: a joint and an actuator of the same name"):
        Stage(mujoco.MjSpec.from_string(xml))


def test_a_hinge_can_be_an_axis():
    xml = (
        own_xml()
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


def test_unknown_models_and_broken_files_are_told_apart(tmp_path):
    with pytest.raises(ArgumentError, match="Did you mean .*'xyz'"):
        plant.open_spec("xzy")
    with pytest.raises(ModelError, match="no MJCF file"):
        plant.open_spec(tmp_path / "none.xml")
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbuddy/></mujoco>")
    with pytest.raises(ModelError, match="broken.xml is no MJCF"):
        plant.open_spec(broken)
    with pytest.raises(ArgumentError, match="a path, an MjSpec or an MjModel"):
        plant.open_spec(42)


def test_describe_is_a_table_of_the_axes():
    text = plant.describe(plant.open_spec("xyz").compile())
    assert [line.split()[0] for line in text.splitlines()] == ["axis", "x", "y", "z"]
    assert "el_plus 150.00" in text


def test_the_example_program_runs():
    spec = importlib.util.spec_from_file_location("own_stage", ROOT / "scripts" / "own_stage.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.stage.axes["x"].chip.pins.org
