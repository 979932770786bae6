"""What a drawing is made of: the report as its reader may see it, of a line the axis that went farthest."""

import pytest

from stage.agents.host_diagnostics import find_readable_pins
from stage.agents.picture_tool import hide_truth
from stage.firmware import operation_pattern_figure


@pytest.fixture
def figures(monkeypatch):
    """Stand-ins of drawings, in order."""
    created = []

    class Figure:
        def __init__(self, report, pins):
            self.report, self.pins = report, pins
            created.append(self)

        def savefig(self, out, format, dpi):
            self.saved = (format, dpi)
            out.write(b"drawing %d" % len(created))

    monkeypatch.setattr(
        operation_pattern_figure, "draw_operation_pattern", lambda report, pins=None: Figure(report, pins)
    )
    return created


LINE = {"distances": {"x": "0.2mm", "y": "-0.5mm"}, "accel": 0.01}


def test_the_picture_in_host_mode_hides_the_true_state(make_box, figures):
    for mode in ("host", "truth"):
        box = make_box(mode=mode)
        box.call("move", {"axis": "x", "pulses": 40, "accel": 0.01})
        answer = box.call("picture")
        assert answer.text == f"preset move on axis x: pulse rate over time, {box.report.duration:.4f} s"
        figure = figures[-1]
        assert (answer.png, figure.saved) == (b"drawing %d" % len(figures), ("png", 90))
        if mode == "host":
            assert figure.report == hide_truth(box.report)
            assert (figure.report.start, figure.report.position, figure.report.lost_steps) == (None, None, None)
            assert figure.pins == find_readable_pins(type(box.get_axis("x").chip))
        else:
            assert figure.report is box.report
            assert figure.pins is None


def test_the_picture_of_a_line_shows_the_axis_with_the_most_pulses(make_box, figures):
    box = make_box()
    box.call("line", LINE)
    assert box.call("picture").text.startswith("synchronized move on axis y")
    assert figures[-1].report.pulses == -160


def test_of_a_line_the_truth_shows_how_straight_it_was(make_box, figures, monkeypatch):
    box = make_box(mode="truth")
    box.call("line", LINE)
    monkeypatch.setattr(
        type(box.report), "plot", lambda report: operation_pattern_figure.draw_operation_pattern(report)
    )
    assert box.call("picture").text == "a line: its distance from the straight one, and the rates"
    assert figures[-1].report is box.report


def test_a_write_that_was_lost_is_a_command_to_a_host_and_all_else_stays(make_box):
    box = make_box()
    box.call("move", {"axis": "x", "pulses": 40, "accel": 0.01})
    first, *others = box.report.statements
    object.__setattr__(box.report, "statements", (first._replace(kind="lost", meaning="LOST: start"), *others))
    observed = hide_truth(box.report).statements
    assert (observed[0].kind, observed[0].meaning, observed[0].clock) == ("command", "start", first.clock)
    assert list(observed[1:]) == others


def test_a_picture_before_any_move_is_refused(box):
    assert "no move to draw yet" in box.call("picture").text
