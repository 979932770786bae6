"""The proposals of an error about a model: pasted where it says, each compiles, and together they make a stage."""

import re
import xml.etree.ElementTree as ET
from itertools import count
from pathlib import Path

import mujoco
import numpy as np
import pytest

from stage import ModelError, Stage, firmware
from stage.cli import main
from stage.sim import plant
from stage.sim.plant.new_model import NewAxis, build_model_text

ROOT = Path(__file__).parent.parent
DOCUMENTED = (ROOT / "docs" / "models.md").read_text().split("```xml\n")[1].split("```")[0]


def find_parent(root, element):
    return next(parent for parent in root.iter() if element in list(parent))


def find_body(root, joint):
    return find_parent(root, next(j for j in root.iter("joint") if j.get("name") == joint))


def paste(xml, message):
    """Paste the elements of an error into a model, each at the place that the error names, and compile after each place."""
    root = ET.fromstring(xml)
    _, _, ending = message.partition("elements to paste into the model:")
    assert ending, message
    place = ""
    for line in ending.strip("\n").splitlines():
        if not line.lstrip().startswith("<"):
            place = line.strip().rstrip(":")
            continue
        element = ET.fromstring(line)
        if m := re.fullmatch(r"in place of (joint|actuator|sensor|text) '(.*)'", place):
            section = {"actuator": root.iter("actuator"), "sensor": root.iter("sensor"), "text": root.iter("custom")}
            parents = [root.find("worldbody")] if m[1] == "joint" else list(section[m[1]])
            (old,) = (
                e for p in parents for e in p.iter() if e.get("name") == m[2] and (m[1] != "joint" or e.tag == "joint")
            )
        elif m := re.fullmatch(r"in place of the pair of '(.*)' and '(.*)'", place):
            (old,) = (e for e in root.iter("pair") if {e.get("geom1"), e.get("geom2")} == {m[1], m[2]})
        elif m := re.fullmatch(r"in the <body> of joint '(.*)'", place):
            find_body(root, m[1]).append(element)
            continue
        elif m := re.fullmatch(r"around the <body> of joint '(.*)'", place):
            find_parent(root, find_body(root, m[1])).append(element)
            continue
        elif m := re.fullmatch(r'in <body name="(.*)">', place):
            next(b for b in root.iter("body") if b.get("name") == m[1]).append(element)
            continue
        else:
            m = re.fullmatch("in <(worldbody|actuator|sensor|contact|custom)>", place)
            assert m, place
            section = root.find(m[1])
            (section if section is not None else ET.SubElement(root, m[1])).append(element)
            continue
        parent = find_parent(root, old)
        parent[list(parent).index(old)] = element
    text = ET.tostring(root, encoding="unicode")
    mujoco.MjModel.from_xml_string(text)
    return text


def repair(xml, rounds=2):
    """Paste what the errors propose until the model makes a stage; return the model and the stage."""
    for k in count():
        try:
            return xml, Stage(mujoco.MjSpec.from_string(xml))
        except ModelError as error:
            if k >= rounds:
                raise
            xml = paste(xml, str(error))


def leave_out(xml, *parts):
    for part in parts:
        xml, n = re.subn(part, "", xml)
        assert n, part
    return xml


CONTACTS = r'<pair class="switch".*?/>|<contact name.*?/>'
FLAGS = r'<geom name="\w+" class="beam".*?/>|<geom name="vane".*?/>'
VANE = '<geom name="x_org_vane_{}" type="box" size="0.03 0.0005 0.005" pos="0 0.05 0"/>'
DAMAGES = {
    "no switch": leave_out(DOCUMENTED, CONTACTS, FLAGS),
    "no sensors, other geoms": leave_out(DOCUMENTED, CONTACTS),
    "no ORG": leave_out(DOCUMENTED, r'<contact name="x_org".*?/>'),
    "no ORG, and a geom of its name": leave_out(DOCUMENTED, r'<contact name="x_org".*?/>').replace(
        '"bumper_plus"', '"x_org_vane"'
    ),
    "no ORG, and two vanes": leave_out(DOCUMENTED, r'<contact name="x_org".*?/>')
    .replace("org_beam", "x_org_beam")
    .replace('<geom name="vane"', f'{VANE.format("b")}{VANE.format("a")}<geom name="vane"'),
    "no EL+": leave_out(DOCUMENTED, r'<contact name="x_el_plus".*?/>'),
    "no EL, no hard stops": leave_out(DOCUMENTED, r'<contact name="x_el_.*?/>', r'<pair class="stop".*?/>'),
    "no pair": leave_out(DOCUMENTED, r'<pair class="switch" geom1="vane" geom2="org_beam"/>'),
    "a thick vane": DOCUMENTED.replace("0.03 0.0005 0.005", "0.03 0.035 0.035").replace('margin="-0.03"', 'margin="-0.005"'),
    "margin 0": DOCUMENTED.replace('margin="-0.03"', 'margin="0"'),
    "no range": leave_out(DOCUMENTED, r'range="-0.057 0.057"'),
    "no range, no hard stops": leave_out(DOCUMENTED, r'range="-0.057 0.057"', r'<pair class="stop".*?/>', CONTACTS),
    "no motor": leave_out(DOCUMENTED, r"<motor .*?/>"),
    "a motor of another name": DOCUMENTED.replace('<motor name="x"', '<motor name="X"').replace("628.", "1256."),
    "a position servo": DOCUMENTED.replace('<motor name="x" joint="x" gear="628.3185307"/>', '<position name="x" joint="x"/>'),
    "an infinite gear": DOCUMENTED.replace('gear="628.3185307"', 'gear="1e10"'),
    "a ball joint": DOCUMENTED.replace('type="slide" axis="1 0 0" range="-0.057 0.057" limited="false"', 'type="ball"').replace(
        'gear="628.3185307"', 'gear="628.3185307 0 0"'
    ),
    "sensor without distance": DOCUMENTED.replace('geom2="org_beam" num="1" data="found dist"', 'geom2="org_beam" data="found"'),
    "sensor of bodies": DOCUMENTED.replace('"x_org" geom1="vane"', '"x_org" body1="carriage"'),
    "distance sensor": DOCUMENTED.replace(
        '<contact name="x_org" geom1="vane" geom2="org_beam" num="1" data="found dist"/>',
        '<distance name="x_org" geom1="vane" geom2="org_beam"/>',
    ),
    "no axis": '<mujoco><option timestep="0.00025"/></mujoco>',
    "a joint alone": '<mujoco><option timestep="0.00025"/><worldbody><body><joint name="q" type="slide" damping="50"/>'
    '<geom size="0.02" mass="1"/></body></worldbody></mujoco>',
    "a hinge alone": '<mujoco><option timestep="0.00025"/><worldbody><body pos="0 0 .2" euler="30 40 50"><joint name="q" '
    'axis="0 1 1" range="-60 70" damping="0.02"/><geom type="box" size="0.02 0.03 0.04" mass="1"/></body></worldbody></mujoco>',
    "an endless hinge": '<mujoco><option timestep="0.00025"/><worldbody><body><joint name="q" axis="0 0 1" damping="0.02"/>'
    '<geom type="box" size="0.02 0.03 0.04" mass="1"/></body></worldbody></mujoco>',
    "unnamed bodies": """<mujoco><option timestep="0.00025"/><worldbody><body quat="1 1 0 0">
        <joint name="b" type="slide" axis="0 1 0" range="-.1 .2"/><geom type="box" size=".2 .3 .01" mass="1"/>
        <body pos="0 0 .1"><joint name="a" axis="1 0 0" type="slide" range="-.3 .1"/><geom size="0.02" mass="1"/></body>
        </body></worldbody>
        <actuator><motor name="a" joint="a" gear="628"/><motor name="b" joint="b" gear="628"/></actuator></mujoco>""",
}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGES)
def test_every_proposal_compiles_and_together_they_make_a_stage(damage):
    xml = DAMAGES[damage]
    with pytest.raises(ModelError):
        Stage(mujoco.MjSpec.from_string(xml))
    _, stage = repair(xml, 3)
    for axis in stage.axes.values():
        assert firmware.home(axis).stopped_by in ("ORG", "EZ")


@pytest.mark.parametrize("model", ["xy", "xyz", "xy_mast", "xya", "gantry"])
@pytest.mark.parametrize("part", ["contact", "sensor", "range", "motor"])
def test_every_part_of_a_shipped_model_that_is_missing_is_proposed(model, part):
    xml = plant.open_spec(model).to_xml()
    names = plant.find_axis_names(mujoco.MjSpec.from_string(xml))
    for name in names:
        pattern = {
            "contact": rf'<pair geom1="{name}_org_vane".*?/>',
            "sensor": rf'<contact name="{name}_.*?/>',
            "range": rf'(?<=<joint name="{name}")(.*?) range="\S+ \S+"',
            "motor": rf'<(?:general|motor) name="{name}".*?/>',
        }[part]
        xml = re.sub(pattern, r"\1" if part == "range" else "", xml)
    _, stage = repair(xml)
    assert list(stage.axes) == names or part == "motor"


def test_a_proposed_joint_keeps_the_attributes_of_the_one_that_it_replaces():
    """Take the range from a Y axis: it must not become an X axis, nor lose what its maker wrote."""
    joint = (
        '<joint name="y" type="slide" axis="0 1 0" pos="0 0 0.01" damping="33" frictionloss="2.5" armature="1.25" '
        'stiffness="0.5" springref="0.01"/>'
    )
    xml = re.sub(r"<joint name=\"x\".*?/>", joint, DOCUMENTED).replace('"x"', '"y"').replace('"x_', '"y_')
    with pytest.raises(ModelError) as caught:
        Stage(mujoco.MjSpec.from_string(xml))
    line = ET.fromstring(caught.value.missing[0])
    assert line.attrib | {"range": "", "limited": ""} == ET.fromstring(joint).attrib | {"range": "", "limited": ""}


@pytest.mark.parametrize("unit", ["degree", "radian"])
def test_angles_of_a_proposed_hinge_are_in_the_unit_of_the_file(unit):
    """Misspell a joint that has limits and a reference: the proposal renames it, and it stays where it was."""
    text = build_model_text([NewAxis.parse("a:hinge:90deg")]).replace('angle="radian"', f'angle="{unit}"')
    attributes = (
        'limited="true" ref="5" springref="7"' if unit == "degree" else 'limited="true" ref="0.1" springref="0.2"'
    )
    text = re.sub(
        r'(<joint name=)"a"(.*?)range="\S+ \S+" limited="false"', rf'\1"aa"\2range="-0.9 0.8" {attributes}', text
    )
    spec = mujoco.MjSpec.from_string(text.replace('joint="a"', 'joint="aa"'))
    before = spec.compile()
    with pytest.raises(ModelError) as caught:
        plant.bind_axes(before, ["a"], spec)
    after = mujoco.MjModel.from_xml_string(paste(text.replace('joint="a"', 'joint="aa"'), str(caught.value)))
    assert after.joint("a").range == pytest.approx(before.joint("aa").range)
    assert (after.qpos0[0], after.qpos_spring[0]) == pytest.approx((before.qpos0[0], before.qpos_spring[0]))


@pytest.mark.parametrize("unit", ["degree", "radian"])
def test_the_range_of_a_proposed_hinge_ends_at_its_hard_stops(unit):
    text = build_model_text([NewAxis.parse("a:hinge:90deg")]).replace('angle="radian"', f'angle="{unit}"')
    xml, n = re.subn(r' range="\S+ \S+"', "", text)
    assert n == 1
    _, stage = repair(xml)
    low, high = np.degrees(stage.model.joint("a").range)
    assert (low, high) == pytest.approx((-48, 48), abs=0.5), "the hard stops"


def test_proposed_switches_stand_in_order_between_the_hard_stops():
    _, stage = repair(DAMAGES["no switch"])
    (axis,) = plant.bind_axes(stage.model)
    trips = [s.touch for s in sorted(axis.switches, key=lambda s: s.touch)]
    order = [s.pin for s in sorted(axis.switches, key=lambda s: s.touch)]
    assert order == ["el_minus", "org", "sd_minus", "sd_plus", "el_plus"]
    assert -0.055 < trips[0] < -0.045
    assert 0.045 < trips[-1] < 0.055, "hard stops are at 55 mm"


def test_a_new_model_is_well_formed_for_every_xml_reader():
    """`--` inside a comment is read by MuJoCo, and by no other reader."""
    assert ET.fromstring(build_model_text([NewAxis.parse("x:slide:100mm")])).tag == "mujoco"


def test_view_prints_elements_that_can_be_pasted(tmp_path, capsys):
    """stage view --text my.xml, paste, again, until it prints the axes"""
    path = tmp_path / "my.xml"
    path.write_text(DAMAGES["unnamed bodies"])
    assert main(["view", "--text", str(path)]) == 2
    path.write_text(paste(path.read_text(), capsys.readouterr().err))
    assert main(["view", "--text", str(path)]) == 0
    assert "el_plus 94.00" in capsys.readouterr().out
