"""A switch trips where its flag begins and lets go where it ends, to the pulse, whatever the width, the direction and the speed."""

import copy
import math
import random

import mujoco
import numpy as np
import pytest
from support.examples import SEED, scaled

from stage import Stage, faults, firmware
from stage.errors import ModelError
from stage.firmware.driver import Speeds, get_driver

HYSTERESIS = 25e-6  # m, rad on a hinge: docs/engine.md
RADIUS = 0.08  # m, from the hinge to the beam
GEAR = {"slide": 628.3185307, "hinge": 18.0}
TRAVEL = {"slide": 0.1, "hinge": 3.14159265}
BODY = {
    "slide": """
      <joint name="a" type="slide" axis="1 0 0" range="{low} {high}" limited="false" damping="20" frictionloss="2"
        armature="2"/>
      <geom type="box" size="0.03 0.04 0.01" mass="0.5"/>""",
    "hinge": """
      <joint name="a" type="hinge" axis="0 0 1" range="{low} {high}" limited="false" damping="0.25" frictionloss="0.3"
        armature="0.00175"/>
      <geom type="cylinder" size="0.08 0.007" mass="0.5"/>""",
}
MODEL = """
<mujoco model="one switch">
  <compiler angle="radian"/>
  <option timestep="{step}" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0" mass="0"/></default>
  <worldbody>
    <geom name="beam" type="sphere" size="{beam}" pos="{at}"/>
    <body name="carriage">{body}
      <geom name="vane" type="box" size="{size}" pos="{radius} 0 0.05" euler="0 0 {turned}"/>
    </body>
  </worldbody>
  <contact><pair geom1="vane" geom2="beam" margin="-0.03" gap="0.04" condim="1"/></contact>
  <actuator><motor name="a" joint="a" gear="{gear}"/></actuator>
  <sensor><contact name="a_org" geom1="vane" geom2="beam" num="1" data="found dist"/></sensor>
  <custom><text name="a_motor" data="17HS4401"/><text name="a_unfitted" data="el_plus el_minus sd_plus sd_minus"/></custom>
</mujoco>"""


def make_stage(joint, size, beam, aside=0.0, turned=0.0, step=0.00025, travel=None):
    """Return a stage of one axis.

    Args:
        joint: "slide" or "hinge"; travel: Of the joint to each side, m or rad; or from where to where.
        size: Half sizes of the vane, m; turned: The vane's angle around z, rad.
        beam: Radius of the beam, m; aside: The beam's y, m.
    """
    radius = 0.0 if joint == "slide" else RADIUS
    travel = travel or TRAVEL[joint]
    low, high = travel if isinstance(travel, tuple) else (-travel, travel)
    xml = MODEL.format(
        body=BODY[joint].format(low=low, high=high),
        gear=GEAR[joint],
        radius=radius,
        beam=beam,
        at=f"{radius} {aside} 0.05",
        step=step,
        turned=turned,
        size=" ".join(map(str, size)),
    )
    return Stage(mujoco.MjSpec.from_string(xml))


def make_stage_with_flag(joint, width, step=0.00025, travel=None):
    """Return a stage of one axis whose flag is `width` m wide, and the joint position where the beam leaves it towards plus."""
    beam = min(width / 4, 0.0005)
    length = width / 2 - beam
    size = (length, 0.0005, 0.004) if joint == "slide" else (0.006, length, 0.0005)
    stage = make_stage(joint, size, beam, step=step, travel=travel)
    return stage, width / 2 if joint == "slide" else math.asin(width / 2 / RADIUS)


class Passage:
    """Positions of a joint while it is driven, and the changes of its ORG.

    Attributes:
        edges: (s, asserted) of each change that reached the chip.
    """

    def __init__(self, stage, name="a"):
        self.stage, self.axis = stage, stage.axes[name]
        self._journal, self._times, self._positions = self.axis.chip.journal(), [], []

    def drive(self, speed, until, accel=0.05):
        """Run at `speed`, m/s or rad/s, until the joint has come to position `until`."""
        rate = abs(speed) / self.axis.meters_per_pulse
        get_driver(self.axis).start_continuous_move(
            1 if speed > 0 else -1, Speeds(min(500.0, rate), rate, accel, accel)
        )
        self.observe(lambda q: q * speed >= until * speed)
        return self

    def observe(self, until, steps=40_000):
        """Step until the joint has come to a position for which `until` is true."""
        for _ in range(steps):
            self.stage.step()
            half = self.stage.state.dt // 2  # a position in qpos is that of a window's center: docs/engine.md
            self._times.append((self.stage.state.start + half) * 1e-9)
            self._positions.append(float(self.stage.data.qpos[self.axis.plant.qpos]))
            if until(self._positions[-1]):
                return
        raise AssertionError(f"the axis stands at {self._positions[-1]}")

    def end(self):
        self._journal.close()
        passage = self._journal.replay_waveforms()
        level = passage.pin("org")
        k = np.flatnonzero(level[1:] != level[:-1]) + 1
        self.edges = [(float(passage.edges["clock"][i]) / self.axis.chip.clock_hz, bool(level[i])) for i in k]
        return self

    def assert_edges(self, places, what=""):
        """ORG has changed at these joint positions, to the pulse, and nowhere else; the first time it went on."""
        assert [on for _, on in self.edges] == [k % 2 == 0 for k in range(len(places))], what
        for (time, _), place in zip(self.edges, places, strict=True):
            off = float(np.interp(time, self._times, self._positions)) - place
            assert abs(off) <= self.axis.meters_per_pulse, f"{what}: {off / self.axis.meters_per_pulse:.2f} pulses off"


def drive_past_switch(stage, start, speed, until, accel=0.05):
    stage.reset()
    stage.place(a=start)
    return Passage(stage).drive(speed, until, accel).end()


@pytest.mark.parametrize("joint", BODY)
@pytest.mark.parametrize("ramp", [False, True], ids=["constant speed", "ramp"])
def test_a_flag_of_any_width_is_detected_from_edge_to_edge(joint, ramp):
    rng = random.Random(SEED)
    print(f"seed {SEED}")
    for _ in range(scaled(12)):
        speed = rng.uniform(0.02, 0.17) if joint == "slide" else rng.uniform(0.8, 6.0)
        crossing = 100e-6 * 10 ** rng.uniform(0, 2)
        width = max(speed * crossing * (1 if joint == "slide" else RADIUS), 4e-6)
        stage, edge = make_stage_with_flag(joint, width)
        for direction in (1, -1):
            accel = 0.2 if ramp else 0.05
            start = edge + speed * accel / 2 * (rng.uniform(0.2, 0.9) if ramp else 1.5)
            end = edge + 4 * HYSTERESIS + speed * 2e-3
            passage = drive_past_switch(stage, -direction * start, direction * speed, direction * end, accel)
            what = f"{joint}, {width * 1e6:.1f} um, {direction * speed:.4f}, {'ramp' if ramp else 'constant'}, from {start:.5f}"
            passage.assert_edges([-direction * edge, direction * (edge + HYSTERESIS)], what)


@pytest.mark.parametrize(("width", "speed"), [(400e-6, 0.17), (150e-6, 0.17), (60e-6, 0.1)])
@pytest.mark.parametrize("direction", [1, -1])
def test_a_short_flag_is_detected_as_long_as_the_carriage_needs_to_cross_it(width, speed, direction):
    stage, edge = make_stage_with_flag("slide", width)
    passage = drive_past_switch(stage, -direction * 0.015, direction * speed, direction * 0.005)
    (begins, _), (ends, _) = passage.edges
    assert (ends - begins) * speed == pytest.approx(width + HYSTERESIS, abs=2 * passage.axis.meters_per_pulse)
    passage.assert_edges([-direction * edge, direction * (edge + HYSTERESIS)])


@pytest.mark.parametrize("joint", BODY)
def test_a_flag_may_begin_and_end_within_one_physics_step(joint):
    step = 0.0005
    speed = 0.17 if joint == "slide" else 4.0
    stage, edge = make_stage_with_flag(joint, 40e-6 if joint == "slide" else 80e-6, step)
    within = 0
    for k in range(6):
        passage = drive_past_switch(stage, -speed / 20 - k * speed * step / 6, speed, 10 * speed * step)
        passage.assert_edges([-edge, edge + HYSTERESIS])
        begins, ends = (int(time / step) for time, _ in passage.edges)
        within += begins == ends
    assert within


@pytest.mark.parametrize("speed", [3.0, 6.0])
@pytest.mark.parametrize("direction", [1, -1])
def test_the_origin_of_xya_begins_and_ends_where_its_vane_does(speed, direction):
    """The vane is 28 mm long, the beam 1 mm thick and 14.5 mm beside the vane's center, both 86.7 mm from the axis: A is in it
    from 0 to -18.989 degrees."""
    stage = Stage("xya", visuals=False)
    low, high = -2 * math.atan(14.5 / 86.7), 0.0
    assert math.degrees(low) == pytest.approx(-18.989, abs=1e-3)
    near, leaves = (low, high) if direction > 0 else (high, low)
    stage.place(a=near - direction * speed * 0.1)
    passage = Passage(stage, "a").drive(direction * speed, leaves + direction * 0.1, 0.1).end()
    passage.assert_edges([near, leaves + direction * HYSTERESIS])


def test_neighboring_edges_of_a_flag_are_used_over_equal_distances():
    """Each distance that the sensor of xya measures belongs to one edge."""
    (origin,) = (s for s in Stage("xya", visuals=False).axes["a"].plant.switches if s.pin == "org")
    enters, leaves = origin.edges
    assert enters.above * abs(enters.slope) == pytest.approx(-leaves.below * abs(leaves.slope))
    assert leaves.above * abs(leaves.slope) == pytest.approx(-enters.below * abs(enters.slope))


def test_a_table_homes_to_the_same_pulse_from_everywhere():
    """stage home a --model xya"""
    stage, places = Stage("xya", visuals=False), []
    a = stage.axes["a"]
    for start in (-2.5, -0.36, -0.2, 1.1):
        stage.reset()
        stage.place(a=start)
        assert firmware.home(a).ok
        stage.run(0.1)
        places.append(math.remainder(a.position, 2 * math.pi))
    assert max(places) - min(places) <= 2 * a.meters_per_pulse


@pytest.mark.parametrize("joint", BODY)
def test_a_reversal_inside_a_flag_leaves_it_where_it_was_entered(joint):
    speed = 0.05 if joint == "slide" else 1.5
    stage, edge = make_stage_with_flag(joint, 0.02)
    for direction in (1, -1):
        stage.reset()
        stage.place(a=-direction * (edge + speed * 0.1))
        passage = Passage(stage).drive(direction * speed, direction * 0.1 * edge)
        get_driver(passage.axis).halt()
        passage.drive(-direction * speed, -direction * (edge + speed * 0.01)).end()
        passage.assert_edges([-direction * edge, -direction * (edge + HYSTERESIS)])


@pytest.mark.parametrize("joint", BODY)
def test_an_axis_that_begins_on_its_flag_leaves_it_at_either_edge(joint):
    speed = 0.02 if joint == "slide" else 0.8
    stage, edge = make_stage_with_flag(joint, 0.002)
    for direction in (1, -1):
        stage.reset()
        stage.place(a=0.2 * direction * edge)
        assert stage.axes["a"].switches.org
        passage = Passage(stage).drive(direction * speed, direction * 1.5 * edge).end()
        assert [on for _, on in passage.edges] == [False]
        passage.edges.insert(0, (0.0, True))
        passage.assert_edges([0.2 * direction * edge, direction * (edge + HYSTERESIS)])


@pytest.mark.parametrize("direction", [1, -1])
def test_a_table_without_end_meets_its_flag_at_each_turn(direction):
    stage, edge = make_stage_with_flag("hinge", 200e-6)
    passage = drive_past_switch(stage, -direction * 1.0, direction * 6.0, direction * (6 * math.pi + 1.0), 0.1)
    revolutions = [2 * math.pi * k for k in range(4)]
    passage.assert_edges(
        [direction * place for turn in revolutions for place in (turn - edge, turn + edge + HYSTERESIS)]
    )


@pytest.mark.parametrize("direction", [1, -1])
def test_a_joint_beyond_its_range_detects_its_flag_as_well(direction):
    """range="-1.5 1.5", and a table that nothing stops"""
    stage, edge = make_stage_with_flag("hinge", 400e-6, travel=1.5)
    passage = drive_past_switch(stage, -direction * 1.0, direction * 6.0, direction * (2 * math.pi + 1.0), 0.1)
    passage.assert_edges(
        [direction * place for turn in (0, 2 * math.pi) for place in (turn - edge, turn + edge + HYSTERESIS)]
    )


def test_a_slanted_flag_has_an_edge_on_each_side():
    """A square of 0.6 mm, turned by 30 degrees; the beam, 0.05 mm thick, passes 0.2 mm beside its center: one face is met at 30
    degrees, the other at 60, and the place where the contact's direction changes is not in the middle."""
    half, beam, aside, turned = 0.3e-3, 0.05e-3, 0.2e-3, math.pi / 6
    stage = make_stage("slide", (half, half, 0.004), beam, aside=aside, turned=turned)
    by_x = (half + beam - aside * math.sin(turned)) / math.cos(turned)  # the beam's x as it leaves the face in plus
    by_y = (aside * math.cos(turned) - half - beam) / math.sin(turned)
    low, high = -by_x, -by_y  # of the joint: the vane moves
    for speed in (0.17, 0.05):
        passage = drive_past_switch(stage, low - speed * 0.04, speed, high + 0.002)
        passage.assert_edges([low, high + HYSTERESIS])
        passage = drive_past_switch(stage, high + speed * 0.04, -speed, low - 0.002)
        passage.assert_edges([high, low - HYSTERESIS])


@pytest.mark.parametrize("joint", BODY)
@pytest.mark.parametrize("moved", [0.3e-3, -0.7e-3, 15e-3])
def test_a_switch_that_was_moved_trips_where_it_is_now(joint, moved):
    """stage.model.geom("beam").pos is changed on a stage that is built, as environments do"""
    width, speed = 0.2e-3, 0.1 if joint == "slide" else 2.0
    stage, edge = make_stage_with_flag(joint, width)
    if joint == "slide":
        stage.model.geom("beam").pos[0] += moved
        low, high = moved - edge, moved + edge
    else:
        stage.model.geom("beam").pos[1] += moved
        middle, reach = math.atan(moved / RADIUS), math.asin(width / 2 / math.hypot(RADIUS, moved))
        low, high = middle - reach, middle + reach
    for direction in (1, -1):
        near, leaves = (low, high) if direction > 0 else (high, low)
        passage = drive_past_switch(
            stage, near - direction * speed * 0.2, direction * speed, leaves + direction * speed * 0.01
        )
        passage.assert_edges([near, leaves + direction * HYSTERESIS])


def test_a_snapshot_between_the_two_edges_of_one_physics_step_keeps_the_second():
    stage, _ = make_stage_with_flag("slide", 40e-6, step=0.0005)
    for k in range(12):
        stage.reset()
        stage.place(a=-0.008 - k * 1e-5)
        replica = copy.deepcopy(stage)
        passage = Passage(stage).drive(0.17, 0.001).end()
        (begins, _), (ends, _) = passage.edges
        if int(begins / 0.0005) == int(ends / 0.0005):
            break
    get_driver(replica.axes["a"]).start_continuous_move(
        1, Speeds(500.0, 0.17 / replica.axes["a"].meters_per_pulse, 0.05, 0.05)
    )
    replica.run(0.5 * (begins + ends) - replica.time)
    assert replica.axes["a"].switches.org
    other, _ = make_stage_with_flag("slide", 40e-6, step=0.0005)
    other.restore(replica.snapshot())
    for again in (replica, other):
        again.run(ends - again.time - 1e-6)
        assert again.axes["a"].switches.org
        again.run(2e-6)
        assert not again.axes["a"].switches.org
    assert replica.snapshot().state.tobytes() == other.snapshot().state.tobytes()


def test_a_stuck_switch_that_is_cleared_after_a_short_flag_reports_no_edge():
    stage, edge = make_stage_with_flag("slide", 100e-6)
    a = stage.axes["a"]
    stage.place(a=-0.005)
    fault = faults.switch_stuck(a, "org", False)
    passage = Passage(stage).drive(0.1, edge + 2 * HYSTERESIS)
    fault.clear()
    passage.observe(lambda q: q > 0.002)
    assert passage.end().edges == []


def test_a_contact_that_bounces_on_a_short_flag_comes_to_rest_open():
    stage, edge = make_stage_with_flag("slide", 200e-6)
    with faults.bounce(stage.axes["a"], "org", seconds=5e-3, toggles=4):
        passage = drive_past_switch(stage, -0.015, 0.1, 0.01)
    levels = [on for _, on in passage.edges]
    assert levels == [k % 2 == 0 for k in range(10)], "an edge and four toggles for each end of the flag"
    passage.edges = passage.edges[:1]
    passage.assert_edges([-edge])


def test_a_flag_much_narrower_than_the_travel_is_detected():
    """8 um of 200 mm: a carriage at 80 mm/s needs 100 us to cross it"""
    stage, edge = make_stage_with_flag("slide", 8e-6)
    drive_past_switch(stage, -0.005, 0.08, 0.002).assert_edges([-edge, edge + HYSTERESIS])


@pytest.mark.parametrize("travel", [5.0, 20.0], ids="{:g} m to each side".format)
def test_a_short_flag_of_a_long_slide_trips_at_its_edges(travel):
    stage, edge = make_stage_with_flag("slide", 10e-6, travel=travel)
    drive_past_switch(stage, -0.005, 0.08, 0.002).assert_edges([-edge, edge + HYSTERESIS])


@pytest.mark.parametrize("travel", [7.0, 180.0], ids="{:g} rad to each side".format)
@pytest.mark.parametrize("revolution", [0, 1])
def test_a_short_flag_of_a_table_trips_at_its_edges_for_any_range(travel, revolution):
    """range="-180 180" of a joint without limits is in radians, though the model's angles are in degrees"""
    stage, edge = make_stage_with_flag("hinge", 20e-6, travel=travel)
    place = 2 * math.pi * revolution
    passage = drive_past_switch(stage, place - 0.1, 2.0, place + 0.1, 0.02)
    passage.assert_edges([place - edge, place + edge + HYSTERESIS])


@pytest.mark.parametrize("joint", BODY)
@pytest.mark.parametrize("share", [0.0, 0.1, 0.3, 0.45, 0.9])
def test_a_short_flag_near_an_end_of_the_travel_is_detected(joint, share):
    """share: of a four-hundredth of the travel, in which positions are tried; a turn ends where the next one begins"""
    travel = 0.2 if joint == "slide" else 2 * math.pi
    ends = share * travel / 400 + (50e-6 if joint == "slide" else 1e-3)
    speed, run_up = (0.08, 0.02) if joint == "slide" else (2.0, 0.1)
    for side in (1, -1):
        low, high = sorted((side * ends, side * (ends - travel)))
        stage, edge = make_stage_with_flag(joint, 30e-6, travel=(low, high))
        passage = drive_past_switch(
            stage, -side * run_up, side * speed, side * (edge + 4 * HYSTERESIS + speed * 2e-3), 0.02
        )
        passage.assert_edges([-side * edge, side * (edge + HYSTERESIS)], f"{joint}, {low} to {high}")


def test_a_flag_on_both_sides_of_the_place_where_a_turn_begins_is_one_flag():
    stage, edge = make_stage_with_flag("hinge", 2e-3, travel=(0.3e-3, 2 * math.pi + 0.3e-3))
    drive_past_switch(stage, 0.3, -2.0, -0.1, 0.02).assert_edges([edge, -edge - HYSTERESIS])


def test_a_flag_beyond_the_travel_is_no_flag_of_it():
    with pytest.raises(ModelError, match=r"cannot reach it: nearest at -0\.0003, "):
        make_stage_with_flag("slide", 100e-6, travel=(-0.2003, -0.0003))


def test_a_hinge_without_range_is_answered_with_the_line_of_a_hinge():
    with pytest.raises(
        ModelError, match=r'has no range[^$]*<joint name="a" type="hinge" axis="0 0 1" range="-3.1416 3.1416"'
    ):
        make_stage_with_flag("hinge", 1e-3, travel=(0.0, 0.0))
