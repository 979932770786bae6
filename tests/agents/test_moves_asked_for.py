"""What an agent asks of a move comes to the driver as it was asked, in pulses and seconds; and what an axis is told by default."""

from dataclasses import replace

import pytest

from stage import Stage
from stage.agents import Toolbox, motion_tools
from stage.agents.motion_tools import MIN_RATE_PPS, describe_report
from stage.errors import StageError
from stage.firmware import procedures
from stage.firmware.driver import DEFAULT_RAMP_S


class RecordingDriver:
    """Driver that only records its calls."""

    def __init__(self, fails=()):
        self.calls, self._fails = [], fails

    def list_homing_methods(self):
        return ("switch", "index")

    def check_homing(self, method, index=False):
        assert method in self.list_homing_methods()

    def __getattr__(self, name):
        def noted(*arguments):
            self.calls.append((name, *arguments))
            if name != "halt":
                raise StageError("noted.")

        return noted


def make_recorder(box):
    driver = box._drivers["x"] = RecordingDriver()

    def created(name, **arguments):
        driver.calls.clear()
        answer = box.call(name, {"axis": "x", **arguments})
        assert answer.ok or answer.text == "noted.", answer.text
        return driver.calls[0]

    created.box = box
    return created


@pytest.fixture
def requested(make_box):
    """asked(tool, arguments) -> what the driver was told, on an axis of 3.125 um a pulse."""
    return make_recorder(make_box())


PULSE = 3.125e-6  # m


def test_a_distance_is_signed_pulses_and_a_timeout_is_the_driver_s(requested):
    for arguments, pulses in (
        ({"pulses": -50}, -50),
        ({"distance": "10mm"}, 3200),
        ({"distance": "-0.001 m"}, -320),
        ({"distance": f"{0.6 * PULSE}m"}, 1),
    ):
        name, wanted, speeds, timeout = requested("move", **arguments)
        assert (name, wanted, timeout) == ("move", pulses, None)
        assert (speeds.up, speeds.down, speeds.s_curve) == (DEFAULT_RAMP_S, DEFAULT_RAMP_S, False)
        assert requested("move", timeout=3, **arguments)[3] == 3.0
        assert requested("start", **arguments)[:2] == ("start", pulses)


def test_speeds_are_pulses_a_second_and_ramps_seconds(requested):
    speeds = requested("move", pulses=100, speed=0.05, start_speed="0.0025", accel=0.2, decel=0.4, s_curve=True)[2]
    assert (speeds.start, speeds.drive) == pytest.approx((800, 16_000))
    assert (speeds.up, speeds.down, speeds.s_curve) == (0.2, 0.4, True)
    speeds = requested("start", pulses=100, accel=0.3)[2]
    assert (speeds.up, speeds.down) == (0.3, 0.3)
    assert (
        requested("move", pulses=100, speed=MIN_RATE_PPS * PULSE * 1.0001, start_speed=MIN_RATE_PPS * PULSE * 1.0001)[0]
        == "move"
    )
    refused = requested.box.call("move", {"axis": "x", "pulses": 100, "start_speed": 0.99 * MIN_RATE_PPS * PULSE})
    assert refused.text.startswith("start_speed: ")
    assert "is too slow; the least is 3.125e-08 m/s, 0.01 pulses a second" in refused.text


def test_home_passes_direction_method_speed_and_timeout_to_the_driver(make_box):
    requested = make_recorder(make_box("MCX514"))
    assert requested("home")[:3] == ("home_by", "switch", -1)
    assert requested("home", direction="plus", by="INDEX")[:3] == ("home_by", "index", 1)
    assert requested("home")[4] == 60.0
    assert requested("home", timeout=5)[4] == 5.0
    assert requested("home", speed=0.05)[3].drive == pytest.approx(16_000)


def test_a_stop_is_with_a_ramp_unless_it_is_at_once(requested):
    assert requested("stop") == ("halt", False)
    assert requested("stop", at_once=True) == ("halt", True)


def test_a_failed_start_leaves_no_move_to_wait_for(requested):
    requested("start", pulses=100)
    del requested.box._drivers["x"]
    assert requested.box.call("wait_until_stopped", {"axis": "x"}).data["at_rest"]
    assert not requested.box.call("report").ok


@pytest.mark.parametrize("both", [{}, {"distance": "1mm", "pulses": 5}])
def test_one_of_distance_and_pulses_is_required(requested, both):
    assert "one of the two" in requested.box.call("move", {"axis": "x", **both}).text
    assert "no pulse: a pulse of axis x is 3.125e-06 m" in requested.box.call("move", {"axis": "x", "pulses": 0}).text


def test_a_line_has_its_speeds_its_curve_and_its_timeout(make_box, monkeypatch):
    box, noted = make_box(), []

    def line(distances, axes, **how):
        noted.append((distances, how))
        raise StageError("noted.")

    monkeypatch.setattr(procedures, "line", line)
    arguments = {"distances": {"x": "1mm", "Y": "-2mm"}, "speed": 0.02, "s_curve": True, "timeout": 4, "accel": 0.2}
    assert box.call("line", arguments).text == "noted."
    distances, how = noted[0]
    assert distances == {"x": pytest.approx(1e-3), "y": pytest.approx(-0.002)}
    assert how == {"speed": 0.02, "s_curve": True, "timeout": 4.0, "accel": 0.2}


def test_a_line_succeeds_only_if_all_its_axes_do(make_box):
    box = make_box()
    assert box.call("line", {"distances": {"x": "1mm", "y": "1mm"}}).data["as_asked"]
    report = box.report
    for name in ("x", "y"):
        short = replace(report.axes[name], pulses=report.axes[name].pulses - 1)
        assert describe_report(replace(report, axes={**report.axes, name: short}), "host")["as_asked"] is False
    assert "off_the_line_pulses" in describe_report(report, "truth")
    assert "off_the_line_pulses" not in describe_report(report, "host")


def test_what_is_left_of_a_move_is_reported_though_it_is_nothing(make_box):
    box = make_box("PCL240K", "truth")
    data = box.call("move", {"axis": "x", "pulses": 100}).data
    assert data["R0_left"] == 0
    assert (data["as_asked"], data["lost_steps"]) == (True, 0)
    assert describe_report(replace(box.report, lost_steps=4), "truth")["as_asked"] is False
    assert describe_report(replace(box.report, lost_steps=4), "host")["as_asked"] is True
    assert describe_report(replace(box.report, pulses=99), "host")["as_asked"] is False


def test_an_axis_that_moves_is_not_moved_otherwise(make_box):
    box = make_box()
    assert box.call("start", {"axis": "x", "pulses": 20_000}).ok
    for name, arguments in (
        ("move", {"axis": "x", "pulses": 5}),
        ("home", {"axis": "x"}),
        ("start", {"axis": "x", "pulses": 5}),
        ("line", {"distances": {"y": "1mm", "x": "1mm"}}),
    ):
        assert "axis x is moving" in box.call(name, arguments).text, name
    assert box.call("move", {"axis": "y", "pulses": 50}).ok, "the other one is"
    finished = box.call("stop", {"axis": "x"}).data
    assert 0 < finished["counted_pulses"] < 20_000
    assert not finished["as_asked"]


def test_a_stop_after_the_last_pulse_is_not_the_end_of_the_move(make_box):
    """Send a stop command after the last pulse."""
    box = make_box()
    assert box.call("start", {"axis": "x", "pulses": 200}).ok
    assert box.call("wait", {"seconds": 1.0}).ok
    assert box.call("write_bytes", {"axis": "x", "address": 0, "values": ["11h"]}).ok
    finished = box.call("wait_until_stopped", {"axis": "x"}).data
    assert finished["counted_pulses"] == finished["asked_pulses"] == 200
    assert "stopped by the host" not in finished["stopped_by"]


def test_home_squares_a_gantry_with_the_requested_direction_and_timeout(monkeypatch):
    box, requested = Toolbox(Stage("gantry", visuals=False)), []
    monkeypatch.setattr(motion_tools, "square_gantry_at_speeds", lambda *arguments: requested.append(arguments) or [])
    for axis, arguments in (("y", {}), ("w", {"direction": "plus", "timeout": 7, "speed": 0.05})):
        assert box.call("home", {"axis": axis, **arguments}).ok
    (first, other) = requested
    assert [[a.name for a in axes] for axes, *_ in requested] == [["y", "w"], ["w", "y"]]
    assert (first[1], first[3]) == (-1, 60.0)
    assert (other[1], other[3]) == (1, 7.0)
    assert other[2].drive == pytest.approx(16_000)


@pytest.mark.parametrize("tool", ["move", "start"])
def test_a_distance_needs_a_unit_and_fits_into_the_travel(make_box, tool):
    """move(axis="x", distance=10) drove x into EL+ at its full speed: the agent meant 10 mm, and got 10 m"""
    box = make_box()
    for distance in (10, "10", 0.01, "-3."):
        text = box.call(tool, {"axis": "x", "distance": distance}).text
        assert "has no unit; write a text such as '10mm' or '30deg'." in text
    text = box.call(tool, {"axis": "x", "distance": "10m"}).text
    assert "10000 mm is more than the travel of axis x, -150 to 150 mm." in text
    assert box.get_axis("x").position == 0.0
