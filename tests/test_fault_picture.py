"""The picture of a fault: lengths as its labels say, and the close-up where the switch is."""

from types import SimpleNamespace

import numpy as np
import pytest

from stage.cli.fault.demonstrations import Demo, DemoResult

pytest.importorskip("matplotlib")
TIME = np.arange(0.0, 1.0, 0.1)


def make_recording(org_from, begins=0.2):
    """Return a stand-in for a recording of axis x at 1 m/s, with ORG on from `org_from` in s."""
    edges = np.zeros(len(TIME), [("inputs", "i8"), ("outputs", "i8")])
    edges["inputs"] = org_from <= TIME
    waveform = SimpleNamespace(edges=edges, seconds=TIME)
    chip = SimpleNamespace(find_switch_input=lambda pin: 1, OUTPUTS={})
    return SimpleNamespace(
        axes={"x": SimpleNamespace(chip=chip)}, journals={"x": SimpleNamespace(replay_waveforms=lambda: waveform)}, began=0.0,
        fault_changes=[SimpleNamespace(time=begins, text="axis x: jammed: begins")],
        column=lambda name: TIME if name in ("time", "x/position") else 4 * TIME,
    )  # fmt: skip


def draw_result(draws, close_up=None, unit="m"):
    demo = Demo("", "", lambda stage, make_fault: {}, lambda h, f: True, draws, close_up)
    return DemoResult("jam", demo, ({}, {}), (make_recording(0.4), make_recording(0.6)), unit).plot()


def test_lengths_are_in_thousandths_and_counts_as_they_are():
    position, steps = draw_result(("position", "lost_steps")).axes
    assert position.lines[0].get_ydata() == pytest.approx(1e3 * TIME)
    assert position.get_ylabel() == "position, mm"
    assert steps.lines[0].get_ydata() == pytest.approx(4 * TIME)
    hinge = draw_result(("position", "lost_steps"), unit="rad").axes[0]
    assert hinge.get_ylabel() == "position, deg"
    assert hinge.lines[0].get_ydata() == pytest.approx(np.degrees(TIME))


@pytest.mark.parametrize(("draws", "moment"), [(("position", "org"), 0.6), (("position", "lost_steps"), 0.2)])
def test_a_close_up_shows_the_first_edge_of_a_switch_or_the_begin_of_the_fault(draws, moment):
    figure = draw_result(draws, (-0.1, 0.3))
    assert figure.axes[0].get_xlim() == pytest.approx((moment - 0.1, moment + 0.3))
    assert "Axis x: jammed" in [text.get_text() for text in figure.texts]
