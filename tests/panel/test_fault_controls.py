"""Fault controls: what breaks is what stage.sim.faults makes, and mending leaves the machine as it was."""

import numpy as np
import pytest

from stage import Stage
from stage.drives.dc_motors import DC_MOTORS
from stage.drives.motors import MOTORS
from stage.errors import ArgumentError, StageError
from stage.panel.fault_controls import FaultControls, compute_user_push_limit, list_fault_functions
from stage.panel.procedure_forms import FieldError
from stage.panel.session import UNPACED_SPEED, Session
from stage.panel.stage_thread import describe_escape


@pytest.fixture(scope="module")
def session():
    with Session(Stage("xy", visuals=False), speed=UNPACED_SPEED, paused=True) as session:
        yield session


@pytest.fixture
def controls(session):
    session.reset()
    controls = FaultControls(session)
    yield controls
    for active in reversed(controls.faults_in_force):
        controls.clear_fault(active)
    controls.close()


def test_who_leaves_lets_go(session):
    controls, dof = FaultControls(session), session.stage.axes["x"].plant.dof
    controls.push("x", 5.0)
    assert session.stage.data.qfrc_applied[dof] == 5.0
    controls.close()
    assert session.stage.data.qfrc_applied[dof] == 0.0
    controls.close()  # has let go already


def test_every_fault_has_a_form_with_its_fields(controls):
    breakings = {b.name: b for b in controls.list_forms("x")}
    assert (
        set(breakings)
        == set(list_fault_functions())
        >= {"jam", "bounce", "phase_open", "bus_voltage", "lost_write", "payload"}
    )
    pin, closed = breakings["switch_stuck"].fields
    assert "org" in pin.choices
    assert closed.choices == ("yes", "no")


@pytest.mark.parametrize(
    ("name", "texts"),
    [
        ("switch_stuck", {"pin": "org", "closed": "yes"}), ("vane_missing", {"pin": "org"}),
        ("bounce", {"pin": "org", "toggles": "4"}), ("jam", {"force": ""}), ("bus_voltage", {"volts": "12"}),
        ("phase_open", {"phase": "b"}), ("motor", {"motor": "SS2422-5041"}),
        ("start_skew", {"seconds": "0.01"}), ("lost_write", {"address": "0", "value": "10h"}),
    ],
)  # fmt: skip
def test_each_fault_can_be_made_and_cleared(controls, session, name, texts):
    active = controls.make_fault(name, "x", texts)
    assert session.stage.faults == (active.text,)
    controls.clear_fault(active)
    assert session.stage.faults == ()
    assert controls.faults_in_force == []


def test_the_motors_of_an_axis_are_those_that_its_chip_can_drive(controls):
    def motors(controls):
        return next(b for b in controls.list_forms("x") if b.name == "motor").fields[0]

    assert motors(controls).choices == tuple(MOTORS)
    assert motors(controls).default != "17HS4401", "the one that it has"
    with Session(Stage("xyz_servo", chips="hctl1100", visuals=False), paused=True) as servo:
        assert motors(FaultControls(servo)).choices == tuple(DC_MOTORS)


def test_time_does_not_go_back_over_a_motor_that_was_changed(controls, session):
    def pass_time(seconds):
        session.do(lambda stage: session.run_unpaced(stage.run, seconds))
        session.do(session._history.take_snapshot_if_due)

    for _ in range(2):
        pass_time(0.1)
    active = controls.make_fault("motor", "x", {"motor": "SS2422-5041"})
    changed = session.do(lambda stage: stage.time)
    for _ in range(3):
        pass_time(0.1)
    before = session.do(lambda stage: stage.snapshot().state)
    with pytest.raises(StageError, match="the stage had another motor then"):
        session.go_back(30.0)
    assert np.array_equal(session.do(lambda stage: stage.snapshot().state), before)
    assert session.go_back(0.1) > changed
    assert session.recover() > changed, "as far as the machine is this one"
    controls.clear_fault(active)
    assert session.go_back(30.0) < changed
    session.reset()


def test_a_stuck_switch_reads_as_stuck(controls, session):
    controls.make_fault("switch_stuck", "x", {"pin": "org", "closed": "yes"})
    assert session.do(lambda stage: stage.axes["x"].switches.org)


def test_the_first_fault_may_be_cleared_first(controls, session):
    """24 V, then 12, then 8: mending the first leaves 8, mending both 24 again."""
    x = session.stage.axes["x"]
    nominal = x.faults.bus_voltage
    first, second = (
        controls.make_fault("bus_voltage", "x", {"volts": "12"}),
        controls.make_fault("bus_voltage", "x", {"volts": "8"}),
    )
    controls.clear_fault(first)
    assert x.faults.bus_voltage == 8
    controls.clear_fault(second)
    assert x.faults.bus_voltage == nominal


def test_clearing_in_any_order_leaves_the_effect_of_the_other_faults(controls, session):
    """A jam, then 12 V, then 8: with the jam mended, mending 8 leaves 12."""
    x = session.stage.axes["x"]
    nominal = x.faults.bus_voltage
    jam, low, lower = (
        controls.make_fault(*m) for m in (("jam", "x", {}), *(("bus_voltage", "x", {"volts": v}) for v in ("12", "8")))
    )
    controls.clear_fault(jam)
    controls.clear_fault(lower)
    assert x.faults.bus_voltage == 12
    controls.clear_fault(low)
    assert x.faults.bus_voltage == nominal


def test_a_push_moves_the_carriage_and_ends_with_the_hand(controls, session):
    def after(seconds):
        session.do(lambda stage: session.run_unpaced(stage.run, seconds))
        session.do(lambda stage: session._publish_view())
        return session.do(lambda stage: stage.axes["x"].position)

    rest = after(0.05)
    snapshot_before = session.do(lambda stage: stage.snapshot())
    controls.push("x", 20.0)
    pushed = after(0.05)
    assert pushed > rest + 1e-6  # against the motor's holding torque
    while_pushed = session.do(lambda stage: stage.snapshot())
    controls.push("x", 0.0)
    session.restore(while_pushed)
    assert after(0.2) == pytest.approx(rest, abs=0.3 * (pushed - rest))
    session.restore(snapshot_before)


def test_load_and_supply(controls, session):
    controls.set_payload(2.0)
    assert controls.payload == 2.0
    controls.set_payload(0.0)
    nominal = controls.supply
    controls.set_supply(12.0)
    controls.set_supply(10.0)
    assert {a.faults.bus_voltage for a in session.stage.axes.values()} == {10.0}
    assert len(controls.faults_in_force) == 1
    controls.set_supply(nominal)
    assert controls.faults_in_force == []
    assert controls.supply == nominal


@pytest.mark.parametrize(
    ("name", "texts", "field"),
    [
        ("bounce", {"pin": "org", "toggles": "2.5"}, "toggles"),
        ("bounce", {"pin": "ogr"}, "pin"),
        ("bus_voltage", {}, "volts"),
        ("lost_write", {"value": "1Gh"}, "value"),
    ],
)
def test_a_wrong_value_is_an_error_at_its_field(controls, name, texts, field):
    with pytest.raises(FieldError) as wrong:
        controls.make_fault(name, "x", texts)
    assert wrong.value.field == field
    assert controls.faults_in_force == []


def test_what_the_fault_refuses_is_passed_on(controls):
    with pytest.raises(ArgumentError, match="volts=900"):
        controls.make_fault("bus_voltage", "x", {"volts": "900"})
    with pytest.raises(ArgumentError, match="jam"):
        controls.make_fault("jamm", "x", {})


@pytest.mark.parametrize("model", ["xy", "xyz", "xyz_servo", "xya"])
def test_the_strongest_push_leaves_every_carriage_in_its_travel(model):
    """The fields bound what the end stops bear: as long as one likes, with nothing that brakes."""
    stage = Stage(model, visuals=False)
    for axis in stage.axes.values():
        for sign in (-1, 1):
            stage.reset()
            stage.prepare_change()
            stage.data.qfrc_applied[axis.plant.dof] = sign * compute_user_push_limit(axis)
            for _ in range(30):
                stage.run(0.01)
                assert describe_escape(stage) == ""


def test_a_stronger_push_is_refused(controls):
    with pytest.raises(FieldError, match="900000 N: up to 503 N") as wrong:
        controls.push("x", 9e5)
    assert wrong.value.field == "force"


def test_what_is_broken_already_is_not_broken_again(controls):
    requested = ("switch_stuck", "x", {"pin": "org", "closed": "yes"})
    active = controls.make_fault(*requested)
    with pytest.raises(ArgumentError, match="org stuck closed: this fault is in force already"):
        controls.make_fault(*requested)
    assert controls.faults_in_force == [active]
    controls.clear_fault(active)
    assert controls.make_fault(*requested).fault.in_force
