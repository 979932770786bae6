"""A servo axis on a limit switch, which its chip has one pin for: not further in by any procedure, and out by each."""

import pytest
from support.waiting import wait_until

from stage import RunTimeout, Stage, faults, firmware
from stage.chips import HCTL1100
from stage.errors import ArgumentError, StageError
from stage.firmware.driver import Speeds, get_driver
from stage.firmware.hctl1100.chip_port import ChipPort
from stage.firmware.hctl1100.homing import leave_limit
from stage.firmware.move_report import ProcedureObserver
from stage.panel.procedure_forms import Jog
from stage.panel.session import UNPACED_SPEED, Session
from stage.sim import plant

ENDS = {"EL+": ("el_plus", 1), "EL-": ("el_minus", -1)}
INSIDE = 0.3e-3  # m behind the edge of a limit switch
COUNT = 5e-6  # m
SETTLED = 15 * COUNT


def left_handed():
    spec = plant.open_spec("xyz_servo")
    for name in "xz":
        next(a for a in spec.actuators if a.name == name).gear[0] *= -1
    return spec


@pytest.fixture(scope="module")
def stages():
    return {
        "xyz_servo": Stage("xyz_servo", chips=HCTL1100, visuals=False),
        "left-handed": Stage(left_handed(), chips=HCTL1100, visuals=False),
    }


@pytest.fixture(params=["xyz_servo", "left-handed"])
def stage(stages, request):
    stages[request.param].reset()
    return stages[request.param]


@pytest.fixture
def servo(stages):
    stages["xyz_servo"].reset()
    return stages["xyz_servo"]


def find_switch_edge(axis, pin):
    return next(s.touch for s in axis.plant.switches if s.pin == pin)


def place_on(axis, end, inside=INSIDE):
    """Put the axis on an end limit; returns the carriage's direction into it, and where it stands."""
    pin, direction = ENDS[end]
    axis.stage.place(**{axis.name: find_switch_edge(axis, pin) + direction * inside})
    assert getattr(axis.switches, pin)
    return direction, axis.position


def start_and_wait(axis, direction):
    driver = get_driver(axis)
    driver.prepare()
    with ProcedureObserver(axis, "start") as p:
        driver.start(round(direction * 5e-3 / axis.meters_per_pulse) * (-1 if axis.gear < 0 else 1), Speeds())
        return p.make_report(driver.wait(3.0))


FURTHER = {
    "move": lambda axis, direction: firmware.move(axis, direction * 5e-3),
    "start": start_and_wait,
    "jog": lambda axis, direction: firmware.jog(axis, 0.2, direction * 0.02, accel=0.05),
    "line": lambda axis, direction: firmware.line({axis.name: direction * 5e-3, "y": 5e-3}, axis.stage).axes[axis.name],
    "home": lambda axis, direction: firmware.home(axis, direction * (-1 if axis.gear < 0 else 1)),
}


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("call", ["move", "start", "jog", "line"])
def test_no_drive_into_an_active_limit_starts(stage, call, end):
    """firmware.move(axis, 5e-3) on EL+"""
    x, y = stage.axes["x"], stage.axes["y"]
    direction, at = place_on(x, end)
    report = FURTHER[call](x, direction)
    assert (report.stopped_by, report.pulses, report.ok) == (end, 0, False)
    assert report.start == pytest.approx(at, abs=1e-9)
    assert report.position == x.position == pytest.approx(at, abs=1e-9)
    assert y.position == pytest.approx(0, abs=1e-9), "nor is the other axis of a line"
    assert stage.time < 0.21, "the time of the jog, and no more"
    assert not x.chip.diagnostics


@pytest.mark.parametrize("end", ENDS)
def test_homing_towards_an_active_limit_ends_at_once(servo, end):
    """Towards plus from EL-, where ORG is on, it would have to go back out of ORG first: further in."""
    x = servo.axes["x"]
    _, at = place_on(x, end)
    report = firmware.home(x, 1)
    assert (report.stopped_by, report.pulses, report.ok) == (end, 0, False)
    assert report.start == report.position == pytest.approx(at, abs=1e-9)
    assert servo.time < 0.01


@pytest.mark.parametrize("end", ENDS)
def test_homing_that_starts_on_a_limit_leaves_it(servo, end):
    """firmware.home(axis, -1) from EL+, and from EL-, where ORG is on and it goes back out of ORG first"""
    x = servo.axes["x"]
    direction, at = place_on(x, end)
    with servo.record(every=1e-3) as recording:
        report = firmware.home(x, -1)
    assert report.stopped_by == "ORG"
    assert report.start == pytest.approx(at, abs=1e-9)
    assert x.position == pytest.approx(find_switch_edge(x, "org"), abs=60e-6)
    assert (direction * (recording.columns["x/position"] - at)).max() < 1e-9, "never further in"


def test_homing_that_backs_into_a_limit_stops_at_it(servo):
    """firmware.home(axis, 1) between ORG and EL-: back out of ORG leads to EL-"""
    x = servo.axes["x"]
    servo.place(x=find_switch_edge(x, "el_minus") + 3e-3)
    assert firmware.home(x, 1).stopped_by == "EL-"
    assert servo.time < 2, "and not after its timeout of 60 s"


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("name", ["x", "z"])
def test_a_move_out_of_a_limit_has_the_requested_distance_from_its_start(stage, name, end):
    """firmware.move(axis, -20e-3) on EL+"""
    axis = stage.axes[name]
    direction, at = place_on(axis, end)
    report = firmware.move(axis, -direction * 20e-3)
    assert report.ok
    assert abs(report.pulses) == 4000
    assert report.start == pytest.approx(at, abs=1e-5), "z sinks while its chip is set up"
    assert axis.position == pytest.approx(at - direction * 20e-3, abs=2 * SETTLED)


@pytest.mark.parametrize("end", ENDS)
def test_a_line_out_of_a_limit_reaches_its_end(stage, end):
    x, y = stage.axes["x"], stage.axes["y"]
    direction, at = place_on(x, end)
    report = firmware.line({"x": -direction * 5e-3, "y": 4e-3}, stage)
    assert report.ok
    assert report.axes["x"].start == pytest.approx(at, abs=1e-9)
    assert x.position == pytest.approx(at - direction * 5e-3, abs=SETTLED)
    assert y.position == pytest.approx(4e-3, abs=SETTLED)


def test_a_jog_out_of_a_limit_runs(stage):
    x = stage.axes["x"]
    _, at = place_on(x, "EL+")
    report = firmware.jog(x, 0.3, -0.02)
    assert report.stopped_by == "decelerating stop"
    assert at - 0.02 * 0.7 < x.position < at - 0.02 * 0.25
    assert report.start == pytest.approx(at, abs=1e-9)


@pytest.mark.parametrize("pin", ["el_plus", "el_minus"])
def test_both_active_limits_block_both_directions_and_are_named_separately(servo, pin):
    x = servo.axes["x"]
    for name in ("el_plus", "el_minus"):
        x.switches.stick(name, True)
    try:
        servo.run(1e-3)
        for end, (_, direction) in ENDS.items():
            for call in FURTHER.values():
                assert call(x, direction).stopped_by == end
        assert x.position == pytest.approx(0, abs=1e-9)
    finally:
        for name in ("el_plus", "el_minus"):
            x.switches.stick(name, None)


@pytest.mark.parametrize("end", ENDS)
def test_a_stuck_limit_does_not_drive_the_axis_to_its_other_end(servo, end):
    pin, direction = ENDS[end]
    x = servo.axes["x"]
    with faults.switch_stuck(x, pin, True):
        servo.run(1e-3)
        for call in ("move", "jog", "line"):
            servo.place(x=0.0)
            with pytest.raises(RunTimeout, match=r"its limit switch is still on 4000 counts away, at .* stuck"):
                FURTHER[call](x, -direction)
            assert x.chip.motor_command == 0
            servo.run(0.2)
            assert 20e-3 <= -direction * x.position < 25e-3


def test_rates_beyond_the_registers_are_refused_before_an_axis_leaves_its_limit(servo):
    x = servo.axes["x"]
    _, at = place_on(x, "EL+")
    calls = (
        lambda: firmware.move(x, -20e-3, speed=1e3),
        lambda: firmware.jog(x, 0.1, -1e3),
        lambda: firmware.home(x, speed=1e3),
        lambda: get_driver(x).start(-4000, Speeds(drive=1.0)),
    )
    for call in calls:
        with pytest.raises(ArgumentError, match="Choose another rate, or another T"):
            call()
        assert x.position == pytest.approx(at, abs=1e-9)


# --- the name of the limit that has ended a drive ---


@pytest.mark.parametrize(
    ("call", "end"),
    [(call, end) for call in ("move", "start", "jog", "line") for end in ENDS],
)
def test_the_limit_that_ends_a_drive_is_named_also_by_another_driver(stage, call, end):
    """firmware.line({"x": -5e-3, "y": 5e-3}, stage) that meets EL-; get_driver(axis).read_stop_reason()."""
    x = stage.axes["x"]
    direction, _ = place_on(x, end)
    stage.place(x=x.position - direction * 0.8e-3)
    report = FURTHER[call](x, direction)
    assert report.stopped_by == end
    assert not report.ok
    assert abs(report.position - find_switch_edge(x, ENDS[end][0])) < 1e-3
    assert get_driver(x).read_stop_reason() == end


def test_a_limit_that_was_left_is_named_by_the_drive_that_it_stopped(servo):
    """Axis Z sinks without a motor command out of EL+."""
    z = servo.axes["z"]
    servo.place(z=find_switch_edge(z, "el_plus") - 0.5e-3)
    assert firmware.move(z, 5e-3).stopped_by == "EL+"
    servo.run(0.3)
    assert not z.switches.el_plus
    assert get_driver(z).read_stop_reason() == "EL+"


def test_a_limit_ends_a_drive_in_its_other_direction_too_and_is_named(servo):
    """LIMIT is one pin: EL+ that comes on stops a move towards minus."""
    x = servo.axes["x"]
    driver = get_driver(x)
    driver.start(-4000, Speeds())
    servo.run(0.1)
    with faults.switch_stuck(x, "el_plus", True):
        assert driver.wait(3.0) == "EL+"


# --- from the panel ---


@pytest.mark.parametrize("end", ENDS)
def test_the_panel_jogs_out_of_a_limit_and_refuses_to_jog_further_in(servo, end):
    x = servo.axes["x"]
    direction, at = place_on(x, end)
    with pytest.raises(StageError, match=f"x stands on its end limit, {end[:2]}\\{end[2]}, and does not go"):
        Jog(x, direction, {"speed": "20"}).run(servo)
    assert x.position == pytest.approx(at, abs=1e-9)
    jog = Jog(x, -direction, {"speed": "20"})
    jog.release()
    jog.run(servo)
    assert -direction * (x.position - at) > INSIDE


def test_a_stop_ends_a_drive_out_of_a_limit():
    """session.stop_actions(), as the panel's stop does, while the host's motor command pushes"""
    stage = Stage("xyz_servo", chips=HCTL1100, visuals=False)
    x = stage.axes["x"]
    x.switches.stick("el_plus", True)
    stage.run(1e-3)
    with Session(stage, speed=UNPACED_SPEED, paused=True) as session:
        left = session.act("leave", lambda stage: leave_limit(ChipPort(x), -1, max_counts=10**9, timeout=1e6))
        session.paused = False
        wait_until(lambda: session.view.time > 0.05)
        assert x.chip.motor_command == -15
        session.stop_actions()
        session.act("stop", lambda stage: firmware.stop(stage.axes["x"])).result(20)
        assert left.exception(20)
        assert x.chip.motor_command == 0


def test_the_panel_stops_a_line_whose_host_waits_for_less_than_a_millisecond_at_a_time():
    """A servo's line waits for a sample, 0.52 ms, after each command."""
    stage = Stage("xyz_servo", chips=HCTL1100, visuals=False)
    x = stage.axes["x"]
    with Session(stage, speed=UNPACED_SPEED, paused=True) as session:
        line = session.act("line", lambda stage: firmware.line({"x": 0.1, "y": 0.05}, stage, speed=0.01))
        session.paused = False
        wait_until(lambda: session.view.time > 0.3)
        assert session.stop_actions()
        session.stop().result(20)
        assert isinstance(line.exception(20), StageError)
        session.paused = True
        assert 2e-3 < x.position < 50e-3


def test_a_released_limit_that_ended_no_drive_is_named_by_its_pin(servo):
    x = servo.axes["x"]
    driver = get_driver(x)
    driver.prepare()
    with faults.switch_stuck(x, "el_plus", True):
        servo.run(1e-3)
    assert not x.switches.el_plus
    assert driver.port.is_limit_latched()
    assert driver.read_stop_reason() == "LIMIT"
