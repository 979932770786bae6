"""move, jog and stop, one way for every chip that drives a motor: in metres, to the pulse, with an end that is told."""

import pytest
from examples import FIXED

from stage import RunTimeout, Stage, StageError, firmware
from stage.chips import CHIPS

FAR = 5e-3
EVERY = ("PCL240K", "MCX304", "MCX514", "HCTL1100") if FIXED else tuple(CHIPS)


@pytest.fixture(scope="module", params=EVERY)
def machine(request):
    chip = CHIPS[request.param]
    return Stage("xyz_servo" if chip.SERVO else "xyz", chips=chip, visuals=False)


@pytest.fixture
def x(machine):
    machine.reset()
    return machine.axes["x"]


@pytest.fixture
def stepper(x):
    if x.chip.SERVO:
        pytest.skip("of chips that make pulses")
    return x


def test_a_move_goes_as_far_as_was_said_and_back_and_takes_the_time_of_its_ramps(x):
    out = firmware.move(x, FAR, accel=0.2, decel=0.1)
    assert out.ok
    assert x.position == pytest.approx(FAR, abs=2e-5)
    assert out.asked == out.pulses == firmware.move(x, pulses=out.pulses).pulses
    assert x.position == pytest.approx(2 * FAR, abs=2e-5)
    firmware.move(x, -2 * FAR)
    assert x.position == pytest.approx(0, abs=2e-5)
    slower = firmware.move(x, FAR, speed=0.01, accel=0.2, decel=0.1)
    assert slower.duration > max(0.5, 1.2 * out.duration)


def test_a_move_that_takes_too_long_is_an_error_and_the_axis_can_be_stopped_and_moved_again(x):
    with pytest.raises(RunTimeout):
        firmware.move(x, 0.05, timeout=0.3)
    if not x.chip.SERVO:  # it holds where it is
        with pytest.raises(StageError, match="moving"):
            firmware.move(x, FAR)
    firmware.stop(x)
    if x.chip.SERVO:
        x.wait(0.3)  # the carriage follows its commanded position, which stands
    stands = x.position
    assert 1e-3 < stands < 0.05
    x.wait(0.05)
    assert x.position == pytest.approx(stands, abs=1e-4)
    firmware.move(x, -FAR)
    assert x.position == pytest.approx(stands - FAR, abs=2e-4)


@pytest.mark.parametrize("way", [1, -1])
def test_a_jog_runs_its_time_in_its_direction_and_tells_of_a_limit(x, machine, way):
    report = firmware.jog(x, 0.3, way * 0.02)
    assert report.stopped_by == "decelerating stop"
    assert way * x.position == pytest.approx(0.3 * 0.02, rel=0.3)
    if x.chip.SERVO:
        return  # its chip has one input for both limits
    pin = "el_plus" if way > 0 else "el_minus"
    machine.place(x=next(s.touch for s in x._plant.switches if s.pin == pin) - way * 1e-3)
    assert firmware.jog(x, 0.3, way * 0.02).stopped_by == ("EL+" if way > 0 else "EL-")


def test_stop_at_once_goes_no_further_and_with_a_ramp_it_does(stepper):
    x, ahead = stepper, []
    for at_once in (True, False):
        with pytest.raises(RunTimeout):
            firmware.move(x, 0.05, timeout=0.3)
        before = x.position
        firmware.stop(x, at_once=at_once)
        x.wait(0.05)
        ahead.append(x.position - before)
    assert ahead[0] < 0.3 * ahead[1]
