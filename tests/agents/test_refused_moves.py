"""What a move costs and what its report says: a refused one costs nothing, and a host's stop is no limit switch."""

import pytest

from stage import Stage
from stage.agents import Budget
from stage.firmware.driver import get_driver

STOPS = {"PCL240K": ("1Dh", "08h"), "PCL240MS": ("1Dh", "08h"), "MCX514": None, "MCX304": None}


@pytest.mark.parametrize("chips", [*STOPS, "HCTL1100"])
def test_a_move_that_is_refused_is_not_charged_and_says_what_to_call(make_box, chips):
    box = make_box(chips, budget=Budget(moves=2))
    assert box.call("start", {"axis": "x", "distance": "30mm"}).ok
    for name, arguments in (("move", {"distance": "1mm"}), ("start", {"distance": "1mm"}), ("home", {})):
        message = box.call(name, {"axis": "x", **arguments})
        assert message.text == "axis x is moving: wait_until_stopped waits for its end, and stop stops it."
    assert not box.call("line", {"distances": {"x": "1mm", "y": "1mm"}}).ok
    assert box.meter.moves == 1
    assert box.call("stop", {"axis": "x"}).data["stopped_by"] == "stopped by the host"


@pytest.mark.parametrize(("chips", "k"), [(c, k) for c in STOPS for k in (0, 1)])
def test_a_stop_that_the_host_has_written_is_named(make_box, chips, k):
    box = make_box(chips)
    box.call("start", {"axis": "x", "distance": "30mm"})
    box.call("wait", {"seconds": 0.2})
    if STOPS[chips]:
        box.call("write_bytes", {"axis": "x", "address": 0, "values": [STOPS[chips][k]]})
    else:
        driver = get_driver(box.get_axis("x"))
        box.call("command", {"axis": "x", "name": (driver.STOP, driver.SLOW_DOWN)[k]})
    message = box.call("wait_until_stopped", {"axis": "x"}).data
    assert message["stopped_by"].startswith("stopped by the host: ")
    assert not message["as_asked"]


def test_a_limit_switch_is_one_still(make_box):
    box = make_box()
    box.stage.place(x=0.14)
    box.call("start", {"axis": "x", "distance": "30mm"})
    assert box.call("wait_until_stopped", {"axis": "x"}).data["stopped_by"] == "EL+"


@pytest.mark.parametrize("ends", ["stop", "drop"])
def test_a_stop_that_the_host_wrote_into_one_move_is_none_of_the_next(make_box, ends):
    """start; write_bytes 1Dh; stop; place before the limit; start; wait_until_stopped"""
    box = make_box()
    box.call("start", {"axis": "x", "distance": "30mm"})
    box.call("wait", {"seconds": 0.2})
    box.call("write_bytes", {"axis": "x", "address": 0, "values": ["1Dh"]})
    if ends == "stop":
        box.call("stop", {"axis": "x"})
    else:
        box.call("wait", {"seconds": 1.0})
        box.motion.stop_watching_all()
    box.stage.place(x=0.14)
    box.call("start", {"axis": "x", "distance": "30mm"})
    assert box.call("wait_until_stopped", {"axis": "x"}).data["stopped_by"] == "EL+"


@pytest.mark.parametrize("speed", [1e-30, 1e-12, "1e-30"])
def test_a_speed_that_is_none_is_refused(box, speed):
    message = box.call("move", {"axis": "x", "distance": "1mm", "speed": speed})
    assert "too slow" in message.text
    assert box.meter.moves == 0


def test_an_example_of_a_move_is_a_move(box):
    for name in ("move", "start"):
        assert box.tools[name].write_example() == '{"axis": "x", "distance": "10mm"}'


def test_the_last_recording_is_of_the_last_move(make_box):
    box = make_box(mode="truth")
    saved = box.recordings
    box.call("record", {"on": True})
    box.call("move", {"axis": "x", "pulses": 100})
    box.call("record", {"on": False})
    assert "seconds" in saved.tabulate_last_recording()
    box.call("move", {"axis": "y", "pulses": 200})
    assert saved.tabulate_last_recording()["axis"] == "y"
    box.call("line", {"distances": {"x": "1mm", "y": "2mm"}})
    assert {n: a["columns"]["pulses"][-1] for n, a in saved.tabulate_last_recording()["axes"].items()} == {
        "x": 320,
        "y": 640,
    }


def test_another_axis_of_the_chip_is_not_stopped():
    driver = get_driver(Stage("xy", chips="mcx304", visuals=False).axes["x"])
    code = driver.map.command(driver.STOP).code
    assert driver.is_stop_command(0, 0x100 | code)
    assert not driver.is_stop_command(0, 0x200 | code)
    assert not driver.is_stop_command(1, 0x100 | code)
