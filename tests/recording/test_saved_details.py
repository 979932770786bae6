"""What is read back of a file: each column from what was drawn of it, whatever the order in the file and the units of the axis."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from stage.errors import ArgumentError
from stage.recording.axis_series import FORMAT_VERSION, SERIES
from stage.recording.recording import RecordingError
from stage.recording.saved_recording import SavedRecording

TICK = 1_000_000  # ns


def entities(**more):
    """x, a slide, and a, the hinge of a servo, with a sample every ms"""
    columns = {
        "axes": ["x", "a"],
        "units": ["m", "rad"],
        "servos": [False, True],
        "format": [FORMAT_VERSION],
        "every_ns": [TICK],
    }
    return {
        "/__properties/columns": {name: (None, [values]) for name, values in columns.items()},
        "/__properties/axes": {"x": (None, [["a chip, begun"], ["a chip, ended"]]), "a": (None, [["a servo"]])},
        "/__properties/stage": {"model": (None, [["bench"]])},
        **more,
    }


def drawn(times, values):
    return {"Scalars:scalars": (np.array(times, np.int64) * TICK, [[v] for v in values])}


def lane(times, states):
    return {"StateChange:state": (np.array(times, np.int64) * TICK, [[s] for s in states])}


def saved(**more):
    return SavedRecording(Path("of/a run.rrd"), entities(**more))


def test_the_last_state_of_each_axis_is_in_the_file():
    run = saved(**{"/axes/x/rate": drawn([0, 9], [0, 0])})
    assert (run.axes, run.model) == ({"x": "a chip, ended", "a": "a servo"}, "bench")
    assert repr(run) == "<SavedRecording a run.rrd, 10 samples of x, a, 0.010 s>"
    assert (len(run), run.every) == (10, pytest.approx(1e-3))


def test_samples_cover_every_tick_between_the_first_and_the_last_point():
    """one series from 2 to 5 ms, another from 3 to 7: six samples; of nothing none"""
    run = saved(**{"/axes/x/rate": drawn([2, 5], [0, 0]), "/axes/a/rate": drawn([3, 7], [0, 0])})
    assert run.column("time").tolist() == pytest.approx([0.002, 0.003, 0.004, 0.005, 0.006, 0.007])
    assert len(saved()) == 0
    assert repr(saved()) == "<SavedRecording a run.rrd, 0 samples of x, a, 0.000 s>"


def test_points_in_any_order_are_the_same_line():
    forth = saved(**{"/axes/x/rate": drawn([0, 2, 4], [0, 20, 0])}).column("x/rate")
    back = saved(**{"/axes/x/rate": drawn([4, 0, 2], [0, 0, 20])}).column("x/rate")
    assert forth.tolist() == back.tolist() == [0, 10, 20, 10, 0]


def test_a_column_is_in_the_unit_of_its_axis_and_counts_are_integers():
    """drawn in mm, degrees, um, mdeg; a counter between 2 and 3, of which 2.75 is 3, and -0.75 is -1"""
    degrees = math.degrees(1)
    run = saved(
        **{
            "/axes/x/position": drawn([0, 1], [1000, 2000]), "/axes/a/position": drawn([0, 1], [degrees, 2 * degrees]),
            "/axes/x/following_error": drawn([0, 1], [1e6, 2e6]), "/axes/a/following_error": drawn([0, 1], [1e3 * degrees, 0]),
            "/axes/x/counter": drawn([0, 1], [2.75, -0.75]), "/axes/x/lost_steps": drawn([0, 1], [3.9, 4]),
            "/axes/a/current": drawn([0, 1], [0.5, 0.25]), "/axes/x/load_angle": drawn([0, 1], [90, 180]),
        }
    )  # fmt: skip
    read = {name: run.column(name).tolist() for name in run.units if name != "time"}
    assert read == {
        "x/position": [1, 2], "x/following_error": [1, 2], "x/load_angle": pytest.approx([math.pi / 2, math.pi]),
        "x/lost_steps": [4, 4], "x/counter": [3, -1], "a/position": pytest.approx([1, 2]),
        "a/following_error": pytest.approx([1, 0]), "a/current_a": [0.5, 0.25],
    }  # fmt: skip
    assert run.column("x/counter").dtype == run.column("x/lost_steps").dtype == np.int64
    assert run.units == {
        "time": "s", "x/position": "m", "x/following_error": "m", "x/load_angle": "rad", "x/lost_steps": "full steps",
        "x/counter": "pulses", "a/position": "rad", "a/following_error": "rad", "a/current_a": "A",
    }  # fmt: skip
    assert list(run.columns) == list(run.units)
    assert set(SERIES) >= {"position", "current", "counter"}
    with pytest.raises(ArgumentError, match=r"Did you mean 'x/counter'"):
        run.column("x/counted")


def test_a_switch_is_on_from_the_sample_of_its_edge_on_and_a_phase_is_text():
    """edges at 2 and 4 ms, in another order in the file; before the first edge it is as the first says"""
    run = saved(
        **{
            "/axes/x/rate": drawn([0, 5], [0, 0]), "/axes/x/switches/org": lane([4, 0, 2], ["off", "off", "ORG"]),
            "/axes/x/phase": lane([1, 3], ["up", "hold"]), "/faults": lane([3], ["jammed"]),
        }
    )  # fmt: skip
    assert run.column("x/org").tolist() == [False, False, True, True, False, False]
    assert run.column("x/phase").tolist() == ["up", "up", "up", "hold", "hold", "hold"]
    assert set(run.states) == {"x/org", "x/phase", "faults"}
    times, states = run.states["x/org"]
    assert (times.tolist(), states.tolist()) == (pytest.approx([0, 0.002, 0.004]), ["off", "ORG", "off"])
    assert run.units == {"time": "s", "x/rate": "pps", "x/phase": "", "x/org": ""}


def test_the_bus_of_all_axes_is_in_the_order_of_its_times_without_the_time_in_the_text():
    def text(*lines):
        return {
            "TextLog:text": (np.array([t for t, _ in lines], np.int64), [[f"   {t * 1e-9:.6f}  {s}"] for t, s in lines])
        }

    run = saved(
        **{"/axes/x/bus": text((1000, "x  first"), (9000, "x  last")), "/axes/a/bus": text((5000, "a  between"))}
    )
    assert run.bus == [
        (pytest.approx(1e-6), "x  first"),
        (pytest.approx(5e-6), "a  between"),
        (pytest.approx(9e-6), "x  last"),
    ]


def test_a_file_of_another_format_says_which_it_is_and_which_is_read():
    of = entities()
    of["/__properties/columns"]["format"] = (None, [[FORMAT_VERSION + 6]])
    with pytest.raises(
        RecordingError, match=rf"is of format {FORMAT_VERSION + 6}, and this PulseStage reads format {FORMAT_VERSION}:"
    ):
        SavedRecording(Path("x.rrd"), of)
    with pytest.raises(RecordingError, match="it does not say what its columns are"):
        SavedRecording(Path("x.rrd"), {})
