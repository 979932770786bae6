"""The picture of a recording: which panels there are, in which units, and that no short edge is left out."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from stage import Drive
from stage.chips import HCTL1100, PCL240K
from stage.drives.dc_motors import Servo
from stage.recording.recording_plot import MAX_POINTS, draw_recording
from stage.support import plot_style

pytest.importorskip("matplotlib")


class FakeRecording:
    """A recording of `n` samples from 1 s on whose columns are given; any other is zero."""

    def __init__(self, axes, n=20, **columns):
        self.axes = {
            name: SimpleNamespace(chip=chip(), unit=unit, name=name, drive=Servo() if chip is HCTL1100 else Drive())
            for name, (chip, unit) in axes.items()
        }
        self.n, self.began, self.duration = n, 1.0, n / 1000
        self.values_by_column = {name.replace("__", "/"): values for name, values in columns.items()}

    def __len__(self):
        return self.n

    def column(self, name):
        if name == "time":
            return 1.0 + np.arange(1, self.n + 1) / 1000
        pin = name.rpartition("/")[2] in {**PCL240K.INPUTS}
        return np.asarray(self.values_by_column.get(name, np.zeros(self.n, bool if pin else float)))


SLIDE, HINGE, SERVO = (PCL240K, "m"), (PCL240K, "rad"), (HCTL1100, "m")


def labels(fig):
    return [ax.get_ylabel().split("\n") for ax in fig.axes]


def test_lost_steps_have_a_plot_only_where_some_were_lost():
    usual = [["pulse rate", "pps"], ["position", "mm"], ["following error", "um"]]
    assert labels(draw_recording(FakeRecording({"x": SLIDE}))) == [*usual, [""]]
    lost = draw_recording(FakeRecording({"x": SLIDE, "y": SLIDE}, y__lost_steps=np.arange(20) // 10 * 4))
    assert labels(lost) == [*usual, ["lost steps", "full steps"], [""]]
    assert labels(draw_recording(FakeRecording({"x": SERVO})))[0] == ["commanded velocity", "counts/s"]


def test_curves_are_in_the_units_of_their_axes_with_the_command_below():
    ramp = np.arange(20) / 10
    fig = draw_recording(
        FakeRecording(
            {"x": SLIDE, "a": HINGE}, x__position=ramp, a__position=ramp, x__commanded=2 * ramp, x__following_error=ramp
        )
    )
    place, error = fig.axes[1], fig.axes[2]
    lines = [(line.get_ydata(), line.get_alpha(), line.get_color()) for line in place.lines]
    assert [alpha for _, alpha, _ in lines] == [0.35, None, 0.35, None]
    assert [colour for *_, colour in lines] == [plot_style.COLORS[0]] * 2 + [plot_style.COLORS[1]] * 2
    assert lines[0][0] == pytest.approx(2000 * ramp)
    assert lines[1][0] == pytest.approx(1000 * ramp)
    assert lines[3][0] == pytest.approx(np.degrees(ramp))
    assert error.lines[0].get_ydata() == pytest.approx(1e6 * ramp)
    assert place.get_ylabel() == "position\nmm | deg"
    assert fig.axes[0].get_xlim() == pytest.approx((1.0, 1.02)), "from where it began to the last sample"
    assert [text.get_text() for text in fig.texts] == ["Recording of x, a", "PCL240K; 0.020 s"]


def test_several_axes_have_a_legend_and_a_single_one_has_none():
    assert draw_recording(FakeRecording({"x": SLIDE})).axes[0].get_legend() is None
    both = draw_recording(FakeRecording({"x": SLIDE, "y": SLIDE})).axes[0].get_legend()
    assert [text.get_text() for text in both.get_texts()] == ["x", "y"]


def test_switches_lie_from_the_top_in_the_order_of_the_axes_and_each_has_the_colour_of_its_kind():
    on = np.arange(20) > 10
    fig = draw_recording(FakeRecording({"x": SLIDE, "y": SLIDE}, x__el_minus=on, x__sd_plus=on, y__org=~on))
    lanes = fig.axes[-1]
    assert [label.get_text() for label in lanes.get_yticklabels()] == ["y ORG", "x SD+", "x EL-"], "from the bottom"
    assert lanes.get_ylim() == (0, 3)
    colours = [patch.get_facecolor()[0] for patch in lanes.collections]
    from matplotlib.colors import to_rgba

    assert [tuple(c) for c in colours] == [to_rgba(plot_style.SWITCH_COLORS[kind]) for kind in ("org", "sd", "el")]
    heights = [patch.get_paths()[0].vertices[:, 1] for patch in lanes.collections]
    assert [(h.min(), h.max()) for h in heights] == [pytest.approx((k + 0.14, k + 0.8)) for k in range(3)]


def test_a_long_recording_is_drawn_by_few_points_with_every_short_edge():
    """a switch that is on for one sample of 10,001, between those that are drawn"""
    n = 2 * MAX_POINTS + 2001
    on = np.zeros(n, bool)
    on[5000] = True
    fig = draw_recording(FakeRecording({"x": SLIDE}, n=n, x__org=on, x__rate=np.arange(n)))
    drawn = fig.axes[0].lines[0].get_ydata()
    assert len(drawn) <= MAX_POINTS
    assert drawn.tolist() == list(range(0, n, 3))
    heights = fig.axes[-1].collections[0].get_paths()[0].vertices[:, 1]
    assert heights.max() == pytest.approx(0.8)
    assert len(draw_recording(FakeRecording({"x": SLIDE}, n=MAX_POINTS)).axes[0].lines[0].get_ydata()) == MAX_POINTS
