"""Lines, arcs, helices and paths of an MCX514 on the stage: where the tool goes, by the stage's own carriages."""

import numpy as np
import pytest
from support.covers import covers

from stage import ArgumentError, RunTimeout, Stage
from stage.chips import MCX304, MCX514
from stage.firmware.nova.path_interpolation import (
    ArcSegment,
    HelixSegment,
    LineSegment,
    PathSpeed,
    _encode_segment,
    move_along_path,
)

RADIUS = 1600  # pulses
SPEED = PathSpeed(8_000)
CARRIAGE = 50e-6  # m, by which motors lag and ring: a full step
AT_REST = 8e-6


@pytest.fixture
def stage():
    return Stage("xyz", chips=MCX514, visuals=False)


def draw_and_record(stage, segments, names="xy", speed=SPEED):
    """Draw a path, and return its report and the columns of a recording."""
    with stage.record() as recording:
        report = move_along_path(segments, *(stage.axes[n] for n in names), speed=speed)
        stage.run(0.3)
    return report, recording.columns


def compute_circle_deviation(columns, column, scale, radius=RADIUS, direction=1):
    """Compute the distance outside the circle whose center is `radius` from the start, in the unit of the column times scale."""
    x, y = (columns[f"{n}/{column}"] * scale for n in "xy")
    return np.hypot(x - x[0], y - y[0] - direction * radius) - radius


@covers("MCX514", "SV", "DV", "AC", "TP", "CP", "IPM", "DECEN")
@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("even", [False, True])
def test_a_circle_ends_where_it_began_and_the_carriages_keep_its_radius(stage, clockwise, even):
    report, columns = draw_and_record(
        stage, [ArcSegment((0, RADIUS), clockwise=clockwise)], speed=PathSpeed(8_000, even=even)
    )
    assert report.ok
    assert report.pulses == {"x": 0, "y": 0}
    assert abs(compute_circle_deviation(columns, "pulses", 1)).max() <= 1
    m = stage.axes["x"].meters_per_pulse
    off = compute_circle_deviation(columns, "position", 1, RADIUS * m)
    assert abs(off).max() < CARRIAGE
    for n in "xy":
        assert abs(columns[f"{n}/position"][-1] - columns[f"{n}/position"][0]) < AT_REST
        assert stage.axes[n].lost_steps == 0
    at = np.searchsorted(columns["time"], report.seconds / 4)
    assert (columns["x/pulses"][at] > 0) == (not clockwise), "from the lowest point, counter-clockwise is to the right"
    assert not stage.chips[0].diagnostics


def test_constant_vector_speed_makes_a_circle_last_as_long_as_its_steps_are(stage):
    """Ticks of both axes last sqrt(2) as long: of a circle's 4 sqrt(2) R ticks (8 - 4 sqrt(2)) R are such."""
    slow = PathSpeed(8_000, initial=8_000)
    even, _ = draw_and_record(stage, [ArcSegment((0, RADIUS))], speed=slow)
    plain, _ = draw_and_record(stage, [ArcSegment((0, RADIUS))], speed=PathSpeed(8_000, initial=8_000, even=False))
    ticks, both = 4 * np.sqrt(2) * RADIUS, (8 - 4 * np.sqrt(2)) * RADIUS
    assert plain.seconds == pytest.approx(ticks / 8_000, abs=3e-3)
    assert even.seconds == pytest.approx((ticks + (np.sqrt(2) - 1) * both) / 8_000, abs=3e-3)


@covers("MCX514", "HLN", "HLPCCW", "R-HLV", "HLV", "HLCCW")
@pytest.mark.parametrize("rotations", [0, 1, 3])
def test_a_helix_rises_evenly_and_each_revolution_closes(stage, rotations):
    report, columns = draw_and_record(stage, [HelixSegment((0, RADIUS), (960,), rotations)], "xyz")
    revolutions = max(rotations, 1)
    assert report.ok
    assert report.pulses == {"x": 0, "y": 0, "z": 960 * revolutions}
    x, y, z = (columns[f"{n}/pulses"] - columns[f"{n}/pulses"][0] for n in "xyz")
    angle = np.unwrap(np.arctan2(y - RADIUS, x)) + np.pi / 2
    assert angle[-1] == pytest.approx(2 * np.pi * revolutions, abs=1e-3)
    assert abs(z - 960 * angle / (2 * np.pi)).max() < 0.03 * 960, "a tick is not always the same angle"
    assert (
        abs(compute_circle_deviation(columns, "position", 1, RADIUS * stage.axes["x"].meters_per_pulse)).max()
        < CARRIAGE
    )
    assert not stage.chips[0].diagnostics


@covers("MCX514", "CHKCCW", "LHK2", "DECDIS", "DECEN")
def test_a_path_keeps_its_speed_between_segments(stage):
    path = [LineSegment(3200, 0), ArcSegment((0, 1600), (1600, 1600)), LineSegment(0, 3200)]
    report, columns = draw_and_record(stage, path)
    assert report.ok
    assert (report.segments, report.pulses) == (3, {"x": 4800, "y": 4800})
    v = np.hypot(np.diff(columns["x/pulses"][::10]), np.diff(columns["y/pulses"][::10])) / 10e-3
    length = 6400 + np.pi / 2 * 1600
    ramp = (SPEED.drive - SPEED.initial) / SPEED.acceleration
    inside = slice(int(ramp / 10e-3) + 2, int((report.seconds - ramp) / 10e-3) - 2)
    assert v[inside].min() > 0.9 * SPEED.drive, "no stop between segments"
    assert v[inside].max() < 1.03 * SPEED.drive
    assert report.seconds > length / SPEED.drive
    assert {stage.axes[n].lost_steps for n in "xy"} == {0}


def test_more_segments_than_the_pre_buffer_holds_are_fed_as_it_empties(stage):
    rng = np.random.default_rng(20)
    print("seed 20")
    corners = rng.integers(150, 400, (25, 2)) * rng.choice([-1, 1], (25, 2))
    report, _ = draw_and_record(stage, [LineSegment(*map(int, p)) for p in corners], speed=PathSpeed(3_000))
    assert report.ok
    assert report.pulses == dict(zip("xy", corners.sum(axis=0).tolist(), strict=True))
    assert not stage.chips[0].diagnostics


@covers("MCX514", "CHKCW", "HLCW", "HLPCW")
def test_clockwise_arcs_and_helices_have_the_opposite_direction(stage):
    for segment in (
        ArcSegment((0, 800), (800, 800), clockwise=True),
        HelixSegment((0, 800), (300,), 0, (800, 800), clockwise=True),
    ):
        report, columns = draw_and_record(stage, [segment], "xyz")
        assert report.ok
        assert (report.pulses["x"], report.pulses["y"]) == (800, 800)
        x = columns["x/pulses"] - columns["x/pulses"][0]
        assert x.min() == -800, "the long way round"


@covers("MCX514", "LHK3", "CHKCCW", "HLCCW")
def test_lines_of_three_axes_and_arcs_of_their_first_two_make_one_path(stage):
    report, _ = draw_and_record(
        stage,
        [
            LineSegment(800, 400, -300),
            ArcSegment((0, 800), (800, 800)),
            HelixSegment((-800, 0), (500,), 2),
            LineSegment(9, -900, 0),
        ],
        "xyz",
    )
    assert report.ok
    assert report.pulses == {"x": 1609, "y": 300, "z": 700}


def test_a_limit_ends_the_path_and_pending_segments_are_not_drawn(stage):
    x = stage.axes["x"]
    stage.place(x=x.travel[1] - 0.02)
    report, _ = draw_and_record(
        stage, [LineSegment(32_000, 0)] + [LineSegment(-2_000, 500)] * 12, speed=PathSpeed(16_000)
    )
    assert not report.ok
    assert report.errors["x"] == ("HLMT+",)
    assert report.pulses["y"] == 0
    assert x.switches.el_plus


@pytest.mark.parametrize(
    ("segment", "names", "message"),
    [
        (LineSegment(1, 2, 3), "xy", "a finish point for each of 2 axes"),
        (HelixSegment((0, 9), (9,)), "xy", "`along` for each"),
        (HelixSegment((0, 9), ()), "xyz", "`along` for each"),
        (HelixSegment((0, 9), ()), "xy", "`along` for each of the axes but the first two; 2 axes"),
        (LineSegment(1), "x", "interpolates 2 to 4"),
        (ArcSegment((0, 2**31)), "xy", "CP"),
    ],
)
def test_segments_that_do_not_suit_the_axes_are_refused(stage, segment, names, message):
    with pytest.raises(ArgumentError, match=message):
        move_along_path([segment], *(stage.axes[n] for n in names), speed=SPEED)
    assert not stage.chips[0].busy(0)


def test_axes_of_other_chips_and_nothing_to_draw_are_refused(stage):
    x, y = stage.axes["x"], stage.axes["y"]
    with pytest.raises(ArgumentError, match="no segments"):
        move_along_path([], x, y, speed=SPEED)
    with pytest.raises(ArgumentError, match="different axes of one MCX514"):
        move_along_path([LineSegment(1, 1)], x, x, speed=SPEED)
    other = Stage("xyz", chips=MCX514, visuals=False)
    with pytest.raises(ArgumentError, match="different axes of one MCX514"):
        move_along_path([LineSegment(1, 1)], x, other.axes["y"], speed=SPEED)
    old = Stage("xyz", chips=MCX304, visuals=False)
    with pytest.raises(ArgumentError, match="no MCX514"):
        move_along_path([LineSegment(1, 1)], old.axes["x"], old.axes["y"], speed=SPEED)


def test_a_path_beyond_its_timeout_is_stopped_with_an_error(stage):
    with pytest.raises(RunTimeout, match=r"0\.1 s"):
        move_along_path([LineSegment(8000, 8000)], stage.axes["x"], stage.axes["y"], speed=PathSpeed(1000), timeout=0.1)
    assert not stage.chips[0].busy(0)


def test_a_line_of_two_to_four_axes_is_one_command():
    """draw([Line(100, -200, 50, 9)], x, y, z, u, speed=...)"""
    for finish in ((100, -200), (100, -200, 50), (100, -200, 50, 9)):
        assert _encode_segment(LineSegment(*finish), len(finish)) == (
            f"LHK{len(finish)}",
            {},
            [{"TP": v} for v in finish],
        )
    for axes in (1, 5):
        with pytest.raises(ArgumentError, match=f"{axes} axes: an MCX514 interpolates 2 to 4"):
            _encode_segment(LineSegment(*[100] * axes), axes)


def test_a_helix_with_more_pulses_along_its_axis_than_ticks_is_refused_before_it_moves():
    """Helix(centre=(0, 50), along=(333,)): the circle has 284 ticks, and 49 pulses were lost without a word"""
    stage = Stage("xyz", chips=MCX514, visuals=False)
    axes = list(stage.axes.values())
    with pytest.raises(ArgumentError, match="along=-333 of z: beside this circle an axis makes 284 pulses at most"):
        move_along_path([HelixSegment(centre=(0, 50), along=(-333,))], *axes, speed=PathSpeed(1000))
    assert [axis.chip.net(axis.chip_axis) for axis in axes] == [0, 0, 0]
    assert move_along_path([HelixSegment(centre=(0, 50), along=(284,))], *axes, speed=PathSpeed(1000)).pulses == {
        "x": 0,
        "y": 0,
        "z": 284,
    }
