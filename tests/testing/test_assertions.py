"""The assertions of stage.testing: what passes, what does not, and what a failure says."""

import copy
import json
import re
import traceback
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from support.examples import SEED

from stage import ArgumentError, Stage, faults, firmware
from stage.board import Board
from stage.chips import MCX304, PCL240K
from stage.testing import (
    assert_at,
    assert_no_diagnostics,
    assert_no_lost_steps,
    assert_no_strays,
    assert_path_within,
    assert_pins,
    assert_stopped,
)
from stage.testing.assertions import format_ranges
from stage.testing.failed_test_files import FailedTestFiles, WatchedStage, choose_test_folder
from stage.testing.path_assertion import _measure_distances

SLOW = firmware.Profile.of(fh1=8000, accel=0.05)
TOO_FAST = firmware.Profile.of(fh1=200_000, accel=0.01)


@pytest.fixture
def stage():
    return Stage("xy", visuals=False)


def run_on(axis):
    """A continuous move, plus, with the registers of the last one."""
    for command in (0x08, 0x40, 0x15):
        axis.chip.write(0, command)
    axis.wait(0.02)


def says(assertion, *arguments, **keywords):
    """The message of an assertion that fails."""
    with pytest.raises(AssertionError) as caught:
        assertion(*arguments, **keywords)
    return str(caught.value)


def test_a_move_within_the_torque_of_the_motor_loses_no_steps(stage):
    firmware.preset_move(stage.axes["x"], 1600, SLOW)
    for what in (stage, stage.axes["x"], stage.axes.values(), list(stage.axes.values())):
        assert_no_lost_steps(what)


def test_lost_steps_are_reported_axis_by_axis(stage):
    x = stage.axes["x"]
    firmware.preset_move(x, 20_000, TOO_FAST)
    assert x.lost_steps
    assert_no_lost_steps(stage.axes["y"])
    message = says(assert_no_lost_steps, stage)
    assert f"x is {x.lost_steps} full steps behind its pulses: commanded 62.5000 mm, is at " in message
    assert f"at {stage.time:.6f} s" in message
    assert "x/lost_steps" in message
    assert "y is" not in message


def test_what_is_no_axis_is_refused():
    with pytest.raises(ArgumentError, match=r"3 is no axis: give a stage, stage\.axes"):
        assert_no_lost_steps(3)


def test_a_carriage_is_where_it_is_and_nowhere_else(stage):
    x = stage.axes["x"]
    firmware.preset_move(x, 1600, SLOW)
    stage.run(0.1)
    assert_at(x, 0.005)
    assert_at(x, x.position, within=0)
    message = says(assert_at, x, 0.0051, within=50e-6)
    assert "expected  5.1000 mm +- 50.0 um" in message
    assert re.search(r"is at     \d\.\d{4} mm: -\d+\.\d um, short of it", message)
    assert "commanded 5.0000 mm by its pulses, 0 full steps lost" in message
    assert "wrong number of them" in message
    assert "beyond it" in says(assert_at, x, 0.0049)
    firmware.preset_move(x, -3200, SLOW)
    for where, text in [(-0.0051, "short of it"), (-0.0049, "beyond it")]:
        assert text in says(assert_at, x, where)


def test_the_message_names_a_carriage_that_still_moves_lost_steps_or_swings(stage):
    x = stage.axes["x"]
    firmware.preset_move(x, 1600, SLOW)
    assert "still swings" in says(assert_at, x, x.commanded, within=0)
    run_on(x)
    assert "It still moves, +" in says(assert_at, x, 0.01)
    x.chip.write(0, 0x08)
    stage.reset()
    firmware.preset_move(x, 20_000, TOO_FAST)
    stage.run(0.5)
    assert "lost its steps: see assert_no_lost_steps" in says(assert_at, x, 0.0625)


@pytest.mark.parametrize("within", [-1e-6, float("nan")])
def test_a_tolerance_is_a_length(stage, within):
    with pytest.raises(ArgumentError, match="0 m or more"):
        assert_at(stage.axes["x"], 0.0, within=within)


def test_an_axis_has_stopped_when_it_gets_no_pulses_and_does_not_move(stage):
    x = stage.axes["x"]
    assert_stopped(stage)
    firmware.origin_return(x)
    run_on(x)
    message = says(assert_stopped, stage)
    assert re.search(
        r"  x gets \+[\d,]+ pulses a second and moves at \+\d+\.\d{3} mm/s, at -1\d\d\.\d{4} mm; switches", message
    )
    assert "y gets" not in message
    assert_stopped(stage.axes["y"])
    x.chip.write(0, 0x08)
    stage.run(1.0)
    assert_stopped(x)


def test_an_axis_at_rest_is_slower_than_a_centimeter_a_second_by_default(stage):
    x = stage.axes["x"]
    dof = x.plant.dof
    for speed, options, stands in (
        (0.0099, {}, True),
        (0.0101, {}, False),
        (-0.0101, {}, False),
        (0.0101, {"speed": 0.02}, True),
    ):
        stage.data.qvel[dof] = speed
        if stands:
            assert_stopped(x, **options)
        else:
            assert "x gets +0 pulses a second" in says(assert_stopped, x)
    stage.data.qvel[dof] = 0.0


@pytest.mark.parametrize("direction", [1, -1])
def test_an_axis_that_slides_without_pulses_has_not_stopped(stage, direction):
    x = stage.axes["x"]
    stage.data.qvel[x.plant.dof] = 0.3 * direction
    assert f"x gets +0 pulses a second and moves at {300 * direction:+.3f} mm/s" in says(assert_stopped, x)
    stage.reset()
    assert_stopped(x)


def test_an_axis_that_creeps_has_not_stopped(stage):
    x = stage.axes["x"]
    firmware.ChipPort(x).write_registers(R1=20, R7=30)
    for command in (0x08, 0x40, 0x10):
        x.chip.write(0, command)
    x.wait(0.1)
    assert "x gets +400 pulses a second" in says(assert_stopped, stage)


def test_pins_are_reported_with_their_expected_levels(stage):
    x = stage.axes["x"]
    assert_pins(x, org=False, el_plus=False)
    stage.place(x=-0.13)
    assert_pins(x, org=True, el_minus=False)
    message = says(assert_pins, x, org=False, el_minus=False, hold=True)
    assert "org is asserted, expected not asserted" in message
    assert "el_minus is" not in message
    assert "x is at -130.0000 mm; asserted are: " in message
    with pytest.raises(AttributeError, match="unknown PCL240K pin 'home'"):
        assert_pins(x, home=True)


def test_writes_that_a_data_sheet_reader_would_call_mistakes_are_listed(stage):
    assert_no_diagnostics(stage)
    stage.axes["y"].chip.write(0, 0x11)  # a start without the reset command before
    stage.run(0.001)
    text = stage.axes["y"].chip.diagnostics
    message = says(assert_no_diagnostics, stage)
    assert message.startswith("1 bus write that a reader")
    for d in text:
        assert f"y: address 0 W 11h  {d.message} ({d.source})" in message
    assert re.search(r"^  0\.\d{9} s  y: ", message, re.M)


def test_diagnostics_of_all_chips_are_reported_in_order_with_the_axes_of_the_chip_and_four_digits():
    stage = Stage("xyz", chips={"x": PCL240K, "y": MCX304, "z": MCX304}, visuals=False)
    stage.axes["z"].chip.write(0, 0x7F01)
    stage.axes["x"].chip.write(0, 0x11)
    stage.axes["y"].chip.write(0, 0x7F)
    lines = [line.split("  ")[2] for line in says(assert_no_diagnostics, stage).splitlines()[1:-1]]
    writes = list(dict.fromkeys(lines))  # a write may be more than one mistake
    assert writes == ["yz: address 0 W 7F01h", "x: address 0 W 11h", "yz: address 0 W 007Fh"]


def test_long_lists_are_cut(stage):
    board = Board(stage)
    for port in range(30):
        board.out8(0x100 + port, port)
        text = says(assert_no_strays, board)
        assert text.count("nothing is here") == min(port + 1, 20)
        assert (f"... and {port - 19} more" in text) == (port >= 20)


def test_cycles_that_reach_no_chip_are_reported_with_the_ports_of_the_chips(stage):
    board = Board(stage, base={"x": 0x300, "y": 0x320})
    board.out8(0x300, 0x08)
    assert_no_strays(board)
    board.in8(0x310)
    message = says(assert_no_strays, board)
    assert message.startswith("1 bus cycle reached no chip")
    assert "310h R FFh" in message
    assert "Chips are at 300h to 303h, 320h to 323h" in message
    assert format_ranges([0x2F8, 0x300, 0x301, 0x303]) == ["2F8h", "300h to 301h", "303h"]


@pytest.fixture(scope="module")
def corner():
    """A recording: x by 5 mm, then y by 5 mm."""
    stage = Stage("xy", visuals=False)
    stage.run(0.01)
    with stage.record() as recording:
        for name in "xy":
            firmware.preset_move(stage.axes[name], 1600, SLOW)
            stage.run(0.05)
    return recording


def test_a_path_keeps_to_its_line(corner):
    assert_path_within(corner, [(0, 0), (5e-3, 0), (5e-3, 5e-3)], within=60e-6)
    assert_path_within(corner, [(0, 0), (0, 5e-3), (5e-3, 5e-3)], within=60e-6, axes="yx")


def test_a_path_off_its_line_is_reported_with_place_and_time(corner):
    message = says(assert_path_within, corner, [(0, 0), (5e-3, 5e-3)], within=100e-6)
    off = float(re.search(r"was ([\d,.]+) um off", message)[1].replace(",", ""))
    assert off == pytest.approx(5000 / np.sqrt(2), abs=20)
    seconds, x, y = map(float, re.search(r"at   ([\d.]+) s: x ([-\d.]+) mm, y ([-\d.]+) mm", message).groups())
    assert (x, y) == pytest.approx((5, 0), abs=0.05)
    at = np.searchsorted(corner.column("time"), seconds - 1e-7)
    assert corner.column("x/position")[at] * 1e3 == pytest.approx(x, abs=1e-4)
    assert re.search(r"line x 2\.\d+ mm, y 2\.\d+ mm, the nearest point", message)


def test_a_path_that_ends_early_does_not_pass(corner):
    message = says(assert_path_within, corner, [(0, 0), (5e-3, 0), (5e-3, 6e-3)], within=100e-6)
    assert "did not pass point 2 of it" in message
    assert re.search(r"was (9\d\d|1,0\d\d)\.\d um off", message)
    assert "is the whole move inside?" in message


def test_a_part_of_a_recording_is_judged_alone(corner):
    half = float(corner.column("time")[np.argmax(corner.column("y/position") > 1e-4)]) - 0.02
    assert_path_within(corner, [(0, 0), (5e-3, 0)], within=60e-6, end=half)
    assert_path_within(corner, [(5e-3, 0), (5e-3, 5e-3)], within=60e-6, begin=half)


def test_distances_from_a_polyline_are_those_of_a_dense_search():
    from stage.testing.path_assertion import _measure_distances

    seed = SEED
    print(f"seed {seed}")
    draw = np.random.default_rng(seed)
    line, points = draw.normal(size=(6, 3)), draw.normal(size=(40, 3))
    line[3] = line[2]  # a segment without length
    off, foot = _measure_distances(points, line)
    dense = np.concatenate([a + np.linspace(0, 1, 2001)[:, None] * (b - a) for a, b in pairwise(line)])
    nearest = np.sqrt(((points[:, None] - dense) ** 2).sum(axis=-1)).min(axis=1)
    assert (off <= nearest + 1e-12).all()
    assert off == pytest.approx(nearest, abs=1e-4)
    assert np.sqrt(((points - foot) ** 2).sum(axis=-1)) == pytest.approx(off)


@pytest.mark.parametrize(
    ("line", "keywords", "message"),
    [
        ([(0, 0)], {}, r"line of shape \(1, 2\): two points or more"),
        ([0, 1], {}, r"line of shape \(2,\)"),
        ([(0, 0, 0, 0)] * 2, {}, "each of two or three numbers"),
        ([(0, 0), (np.nan, 0)], {}, "two points or more"),
        ([(0, 0), (1, 0)], {"axes": ["x"]}, "the points of the line have 2 numbers"),
        ([(0, 0), (1, 0)], {"axes": ["x", "q"]}, "unknown axis 'q'"),
        ([(0, 0), (1, 0)], {"begin": 1e6}, "nothing to judge"),
    ],
    ids=["one point", "flat", "four axes", "nan", "too few axes", "no such axis", "no samples"],
)
def test_a_line_that_is_none_is_refused(corner, line, keywords, message):
    with pytest.raises(ArgumentError, match=message):
        assert_path_within(corner, line, within=1e-3, **keywords)


def test_the_report_has_the_last_log_lines_and_the_number_of_stray_cycles(stage):
    watch = object.__new__(FailedTestFiles)
    watch.stage, watch.board = stage, Board(stage)
    assert watch._describe_log() == ""
    for k in range(12):
        watch.board.add_log_line(f"line {k}")
        assert ("lines before" in watch._describe_log()) == (k >= 10)
    displayed = watch._describe_log().splitlines()
    assert displayed[:2] == ["log of the firmware:", "  ... 2 lines before"]
    assert [line.split("  ")[-1] for line in displayed[2:]] == [f"line {k}" for k in range(2, 12)]
    for _ in range(3):
        watch.board.in8(0x777)
    with faults.switch_stuck(stage.axes["x"], "org", True):
        state = watch._describe_state()
    assert "3 bus cycles reached no chip" in state
    assert "fault in force: axis x: org stuck closed" in state
    assert "asserted: org" in state
    assert "mistakes" not in state
    firmware.preset_move(stage.axes["x"], 10, SLOW)
    run_on(stage.axes["x"])
    stage.axes["y"].chip.write(0, 0x15)  # a start without any rate
    x, y, text = [line for line in watch._describe_state().splitlines() if line.startswith("  ")][:3]
    assert re.match(r"  x \(PCL240K\) at .* mm, commanded .* mm, 0 full steps lost, \+[\d,]+ pulses/s$", x)
    assert y.endswith("no pulses")
    assert re.match(r"  1 bus write that a data-sheet reader would call mistakes: assert_no_diagnostics", text)


def test_two_tests_never_share_a_folder_and_one_has_always_the_same(tmp_path):
    """test_a[x y] and test_a[x_y]; ids longer than a folder's name"""

    def named(nodeid, given=""):
        options = {"pulsestage_output": given}
        config = SimpleNamespace(
            getoption=options.get,
            getini=lambda name: "",
            rootpath=tmp_path,
            invocation_params=SimpleNamespace(dir=tmp_path / "here"),
        )
        return choose_test_folder(config, nodeid)

    reference = "tests/a/test_b.py::test_c"
    assert named(reference) == named(reference) == tmp_path / ".pulsestage" / "tests.a.test_b.py.test_c"
    assert named(reference, "out").parent == tmp_path / "here" / "out"
    assert named("t::" + "a" * 117).name == "t." + "a" * 117, "120 characters, all of them"
    many = [
        reference,
        f"{reference}[x y]",
        f"{reference}[x_y]",
        f"{reference}[x/y]",
        *("t::" + "a" * 118 + end for end in ("", "b", "c")),
    ]
    assert len({named(n) for n in many}) == len(many)
    assert max(len(named(n).name) for n in many) < 130


def test_a_watched_stage_keeps_what_came_before_a_recording_of_the_test_that_recording_and_what_came_after():
    """stage.record() and stage.restore(snapshot) in a test that has the fixture `stage`"""
    watched = WatchedStage("xy", visuals=False)
    watched.watch()
    first = watched.recording
    with watched.record() as first_result:
        assert watched.recording is first_result
        watched.run(0.01)
    assert list(watched.recordings) == [first_result, watched.recording], "in the first one nothing happened"
    assert watched.recording not in (first, first_result)
    before, snapshot = watched.recording, watched.snapshot()
    watched.run(0.02)
    watched.restore(snapshot)
    assert list(watched.recordings) == [first_result, before, watched.recording]
    watched.axes["x"].chip.write(0, 0x08)  # a bus cycle is something
    last = watched.recording
    with watched.record() as another:
        watched.run(0.01)
    assert list(watched.recordings) == [last, another, watched.recording], "the last three"
    assert [len(r) > 0 for r in (first_result, before, another)] == [True] * 3
    with pytest.raises(ArgumentError):
        watched.record(every=-1)
    assert watched.recording is not None, "it goes on"
    theirs = watched.record()
    watched.unwatch()
    assert watched.recording is None
    assert "closed" in repr(theirs)


def test_a_copy_of_a_watched_stage_is_not_watched():
    """copy.deepcopy(stage).record(), of the fixture `stage`: "'WatchedStage' object has no attribute '_recent'" """
    watched = WatchedStage("xy", visuals=False)
    watched.watch()
    assert watched.recording.on_error == "warn", "a full disk is not the test's fault"
    copied = copy.deepcopy(watched)
    assert copied.recording is None
    copied.place(x=0.01)
    with copied.record() as recording:
        copied.run(1e-3)
    assert len(recording) > 0
    assert copied.recording is None
    assert watched.recording is not None
    watched.unwatch()
    assert watched.recording is None


def test_only_the_traceback_of_an_error_of_the_package_ends_in_the_test():
    def ends_in(call):
        try:
            call()
        except Exception as error:
            FailedTestFiles.shorten_traceback(object.__new__(FailedTestFiles), error)
            return [frame.name for frame in traceback.extract_tb(error.__traceback__)]

    def helper():
        Stage("nothing", visuals=False)

    def other():
        json.loads("{")

    assert ends_in(helper) == ["ends_in", "helper"]
    assert ends_in(other)[:2] == ["ends_in", "other"]
    assert len(ends_in(other)) > 2


def test_distances_from_a_long_line_are_those_from_its_nearest_piece_whatever_the_order():
    """1000 points, 1100 pieces: more than are looked at once"""
    rng = np.random.default_rng(5)
    points, line = rng.uniform(-1, 1, (1000, 2)), np.cumsum(rng.normal(0, 0.05, (1101, 2)), axis=0)
    off, foot = _measure_distances(points, line)
    back, _ = _measure_distances(points, line[::-1])
    assert off == pytest.approx(back, abs=1e-12)
    assert off == pytest.approx(np.hypot(*(points - foot).T), abs=1e-12)
    ends = np.min(np.hypot(*(points[:50, None] - line[None]).transpose(2, 0, 1)), axis=1)
    assert np.all(off[:50] <= ends + 1e-12)
    assert np.all(off[:50] >= ends - np.hypot(*np.diff(line, axis=0).T).max())
