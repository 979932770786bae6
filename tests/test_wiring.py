"""Sensors of positive logic: chips read them by their polarity bits, drivers set these, a host with a wrong one finds out."""

import copy
import pickle

import pytest
from support.pcl240ms_bench import load

from stage import ArgumentError, RunTimeout, Stage, firmware
from stage.chips import HCTL1100, MCX304, MCX314AS, MCX514, PCL240K, PCL240MK, PCL240MS, core_interface
from stage.cli import build_parser
from stage.cli.stage_setup import make_stage
from stage.firmware.hctl1100.chip_port import ChipPort
from stage.sim.stage_snapshot import Snapshot
from stage.support.axis_value_parsing import parse_wiring

POSITIVE = {"org": "positive", "ez": "positive"}
LIMITS = {"el_plus": "positive", "el_minus": "positive"}
HOMES = [(PCL240MS, POSITIVE, "ORG"), (MCX304, POSITIVE | LIMITS, "ORG"), (MCX514, POSITIVE | LIMITS, "ORG"),
         (MCX314AS, POSITIVE | LIMITS, "ORG")]  # fmt: skip


def make_wired_stage(chips, sensors, **more):
    stage = Stage("xy", chips=chips, wiring={"x": sensors} if sensors else None, visuals=False, **more)
    org = next(s.touch for s in stage.axes["x"].plant.switches if s.pin == "org")
    stage.place(x=org + 0.003)
    return stage, stage.axes["x"]


@pytest.mark.parametrize(("chips", "sensors", "by"), HOMES)
def test_a_driver_sets_the_bits_that_suit_the_wiring_and_finds_home_at_the_same_place(chips, sensors, by):
    usual, x = (make_wired_stage(chips, which)[1] for which in ({}, sensors))
    assert x.wiring == sensors
    reports = [firmware.home(axis) for axis in (usual, x)]
    assert [report.stopped_by for report in reports] == [by, by]
    assert x.position == pytest.approx(usual.position, abs=1.1 * usual.meters_per_pulse)
    assert x.switches.org
    assert not x.pins.org if chips is PCL240MS else not x.pins.stop1
    assert not x.chip.diagnostics


@pytest.mark.parametrize(("chips", "sensors", "by"), HOMES)
@pytest.mark.parametrize("wired", [True, False], ids=["bit missing", "bit too many"])
def test_firmware_with_a_wrong_polarity_bit_does_not_find_home(chips, sensors, by, wired):
    _, x = make_wired_stage(chips, sensors if wired else {})
    x.wiring = {} if wired else sensors  # what the firmware believes
    try:
        result = firmware.home(x, timeout=4.0).stopped_by
    except RunTimeout:
        result = "never"
    assert result != by or abs(x.position - find_org_position(x)) > 20e-6


def find_org_position(axis):
    return next(s.touch for s in axis.plant.switches if s.pin == "org")


def test_an_hctl1100_has_no_polarity_bit_a_limit_of_positive_logic_keeps_it_in_idle():
    """LIMIT is low while nobody is on the switch: status D7 = 0, and control mode is refused."""
    _, x = make_wired_stage(HCTL1100, LIMITS)
    port = ChipPort(x)
    assert port.is_limit_latched()
    x.chip.write(0x05, 0x03)
    assert x.pins.init
    assert "LIMIT" in x.chip.diagnostics[-1].message
    _, usual = make_wired_stage(HCTL1100, {})
    usual.chip.write(0x05, 0x03)
    assert not usual.pins.init


def test_the_sensors_of_an_hctl1100_can_be_of_positive_logic_all_the_same():
    """STOP triggers at power-up, before anything has moved: a homing program that looks at it finds out."""
    _, x = make_wired_stage(HCTL1100, {"org": "positive", "ez": "positive"})
    assert not ChipPort(x).read_status() & 0x40


@pytest.mark.parametrize("sensors", [{"org": "positive"}, LIMITS], ids=["org", "limits"])
def test_an_hctl1100_refuses_sensors_of_positive_logic(sensors):
    """Refuse sensors that the chip cannot read: it took EL- for ORG, and a move of 5 mm ended behind EL+ without an error."""
    _, x = make_wired_stage(HCTL1100, sensors)
    for drive in (firmware.home, lambda axis: firmware.move(axis, 5e-3)):
        with pytest.raises(ArgumentError, match="is of positive logic, and an HCTL1100 cannot read it so"):
            drive(x)
    _, x = make_wired_stage(HCTL1100, {"ez": "positive"})
    with pytest.raises(ArgumentError, match="ez is of positive logic"):
        firmware.home(x, index=True)


@pytest.mark.parametrize("chips", [PCL240K, PCL240MK])
def test_a_chip_without_the_bit_is_not_sent_home_with_such_a_sensor(chips):
    _, x = make_wired_stage(chips, {"org": "positive"})
    with pytest.raises(
        ArgumentError, match=r"org is of positive logic, and a PCL240M?K cannot read it so; a PCL240MS can"
    ):
        firmware.home(x)


def test_a_limit_of_positive_logic_keeps_a_pcl240_from_starting_and_the_note_says_so():
    _, x = make_wired_stage(PCL240K, LIMITS)
    assert x.pins.el_plus
    assert not x.switches.el_plus
    report = firmware.move(x, pulses=100)
    assert report.stopped_by == "EL+"
    assert any("limit switch" in d.message for d in x.chip.diagnostics)


def test_one_level_bit_for_both_limits_takes_no_two_logics():
    _, x = make_wired_stage(MCX514, {"el_plus": "positive"})
    with pytest.raises(ArgumentError, match="HLM-L: give both one logic"):
        firmware.move(x, pulses=100)


def test_an_index_of_positive_logic_inverts_its_pin():
    stages = [make_wired_stage(PCL240MS, which)[0] for which in ({}, {"ez": "positive"})]
    observed = {(stages[0].axes["x"].pins.ez, stages[1].axes["x"].pins.ez)}
    for _ in range(40):
        for stage in stages:
            stage.place(x=stage.axes["x"].position + 0.0002)
        observed.add((stages[0].axes["x"].pins.ez, stages[1].axes["x"].pins.ez))
    assert observed == {(False, True), (True, False)}


def test_faults_switches_copies_and_snapshots_know_the_wiring():
    stage, x = make_wired_stage(PCL240MS, {"org": "positive"})
    assert (x.switches.org, x.pins.org) == (False, True)
    x.switches.stick("org", True)
    assert (x.switches.org, x.pins.org) == (True, False)
    x.switches.stick("org", None)
    for replica in (copy.deepcopy(stage), pickle.loads(pickle.dumps(stage))):
        assert replica.axes["x"].wiring == {"org": "positive"}
        assert replica.axes["x"].pins.org
        replica.restore(stage.snapshot())
    other, _ = make_wired_stage(PCL240MS, {})
    snapshot = stage.snapshot()
    assert isinstance(snapshot, Snapshot)
    with pytest.raises(ArgumentError, match="wiring of axis x"):
        other.restore(snapshot)


def test_a_recording_shows_the_switch_and_the_wire(tmp_path):
    """The status bit is what the chip reads, the wire is high while the sensor is on."""
    stage, x = make_wired_stage(PCL240MS, {"org": "positive"})
    with stage.record() as recording:
        firmware.home(x)
    path = tmp_path / "home.vcd"
    recording.to_vcd(path)
    text = path.read_text()
    assert "ORG_n" in text


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ({"wiring": {"q": {}}}, "unknown axis 'q'"),
        ({"wiring": {"x": {"orgg": "positive"}}}, "Did you mean 'org'"),
        ({"wiring": {"x": {"org": "high"}}}, "'high' is no logic"),
        ({"wiring": "x"}, "a mapping axis -> sensor -> logic"),
        ({"wiring": {"x": "org"}}, "a mapping axis -> sensor -> logic"),
        ({"chips": HCTL1100, "wiring": {"x": {"el_plus": "positive"}}}, "el_minus is on the same pin"),
        ({"chips": PCL240K, "wiring": {"x": {"ez": "positive"}}}, "ez of axis x: no pin of a PCL240K is wired to it"),
        ({"chips": MCX304, "wiring": {"x": {"sd_plus": "positive"}}}, "no pin of an MCX304"),
        ({"syni": {"y": "y"}}, "follows"),
        ({"syni": {"y": "z"}}, "unknown axis 'z'"),
        ({"syni": {"y": "x", "x": "y"}}, "one leader"),
        ({"syni": "yx"}, "a mapping follower -> leader"),
        ({"chips": HCTL1100, "syni": {"y": "x"}}, "has no SYNI"),
        (
            {"chips": {"x": lambda: PCL240K(4_000_000), "y": PCL240K}, "syni": {"y": "x"}},
            "4,915,200 Hz, the leader's 4,000,000",
        ),
    ],
)
def test_a_wiring_that_cannot_be_is_refused(argument, message):
    with pytest.raises(ArgumentError, match=message):
        Stage("xy", visuals=False, **({"chips": PCL240MS} | argument))


# SYNO and SYNI


def start_all_axes(stage):
    for axis in stage.axes.values():
        load(axis.chip, R0=0xFFFFFF, R1=100, R2=800, R4=300, R5=300)
        axis.chip.write(0, 0x40)
        axis.chip.write(0, 0x10)


def test_a_follower_chip_counts_the_clock_of_its_leader():
    """Set R7 of the follower to 0, without effect: it makes the leader's pulses, and twice as many at half the leader's R7."""
    stage = Stage("xy", chips=PCL240K, syni={"y": "x"}, visuals=False)
    x, y = (stage.axes[name].chip for name in "xy")
    assert y.syni is x
    load(x, R7=60)
    start_all_axes(stage)
    stage.run(0.1)
    assert y.net() == x.net() == 100
    load(x, R7=30)
    stage.run(0.1)
    assert y.net() == x.net() == 300
    assert y.values()["R7"] == 0
    replica = pickle.loads(pickle.dumps(stage))
    for each in (stage, replica):
        load(each.axes["x"].chip, R7=60)
        each.run(0.1)
        assert each.axes["y"].chip.net() == 400
    assert not y.diagnostics, "its R7 of 0 is no mistake"


def test_a_recording_replays_a_follower():
    stage = Stage("xy", chips=PCL240K, syni={"y": "x"}, visuals=False)
    y = stage.axes["y"].chip
    journal = y.journal()
    load(stage.axes["x"].chip, R7=60)
    start_all_axes(stage)
    stage.run(0.02)
    load(stage.axes["x"].chip, R7=20)
    stage.run(0.02)
    profile = journal.replay_waveforms()
    assert profile.edges["net"][-1] == y.net() > 50


def test_the_bits_of_a_wire_between_chips_leave_room_for_all_pins():
    for chip in (PCL240K, PCL240MK, PCL240MS):
        assert max(chip.INPUTS.values()) < 1 << core_interface.WIRE_BIT


@pytest.mark.parametrize(("item", "message"), [("x.org", "AXIS.SENSOR=LOGIC"), ("org=positive", "AXIS.SENSOR=LOGIC")])
def test_the_commands_option_says_how_it_is_written(item, message):
    with pytest.raises(ArgumentError, match=message):
        parse_wiring([item])
    assert parse_wiring(["x.org=positive", "x.ez=negative"]) == {"x": {"org": "positive", "ez": "negative"}}


def make_stage_from_options(*options):
    return make_stage(build_parser().parse_args(["move", "x", "1", "--model", "xy", *options]), visuals=False)


def test_the_commands_connect_chips_as_the_stage_does():
    stage = make_stage_from_options("--chips", "x=mcx514,y=mcx512", "--multichip", "x, y")
    assert ("multichip lines", "x, y") in stage.snapshot().header.parts
    assert [int(chip.state["wire_word"]) & 1 for chip in stage.chips] == [1, 1], "there are wires"
    follower = make_stage_from_options("--chips", "x=pcl240ms,y=pcl240mk", "--syni", "y=x")
    assert follower.axes["y"].chip.syni is follower.axes["x"].chip
    both = make_stage_from_options("--model", "xyz", "--chips", "pcl240k", "--syni", "y=x, z=x")
    assert {both.axes[name].chip.syni for name in "yz"} == {both.axes["x"].chip}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--multichip", "x,"], "AXIS,AXIS, for example x,z"),
        (["--multichip", "x,q"], "unknown axis 'q'"),
        (["--multichip", "x,y", "--chips", "mcx514"], "Here are x, y on one MCX514: axes share a chip"),
        (["--syni", "y"], "FOLLOWER=LEADER"),
        (["--syni", "y=x", "--syni", "y=x"], "axis y already has x"),
    ],
)
def test_wires_between_chips_that_are_none_are_refused(options, message):
    with pytest.raises(ArgumentError, match=message):
        make_stage_from_options("--chips", "x=mcx514,y=mcx512", *options)
