"""What a notebook shows of the objects that people look at, and what a prompt prints of them in a line."""

import re
import xml.etree.ElementTree as ElementTree

import pytest

from stage import Stage, firmware
from stage.chips import MCX304, PCL240K


@pytest.fixture(scope="module")
def displayed_objects():
    """Objects by name, after a short run of two axes."""
    stage = Stage("xy", chips=PCL240K, visuals=False)
    with stage.record() as recording:
        report = firmware.preset_move(stage.axes["x"], 800)
        both = firmware.synchronized_move({"x": 400, "y": -300}, stage.axes)
    return {
        "stage": stage, "axes": stage.axes, "axis": stage.axes["x"], "report": report, "both": both,
        "map": PCL240K.MAP, "large map": MCX304.MAP, "recording": recording, "snapshot": stage.snapshot(),
    }  # fmt: skip


SAYS = {
    "stage": ["Stage at 0.", "<td", "PCL240K", "17HS4401"],
    "axes": ["<th", "lost steps", "PCL240K"],
    "axis": ["mm", "registers", "R7"],
    "report": ["preset move on x: done", "data:image/png;base64,", "start, ramp to FH1"],
    "both": ["synchronized move: done", "data:image/png;base64,"],
    "map": ["PCL-240K", "down counter", "status"],
    "large map": ["commands", "MCX304"],
    "recording": ["samples of x, y", "data:image/png;base64,"],
}


@pytest.mark.parametrize("name", SAYS)
def test_the_html_representation_is_well_formed(displayed_objects, name):
    html = displayed_objects[name]._repr_html_()
    assert [part for part in SAYS[name] if part not in html] == []
    xml = re.sub(r"(<img[^>]*)>", r"\1/>", html)  # all that HTML leaves open and XML does not
    ElementTree.fromstring(f"<body>{xml}</body>")


@pytest.mark.parametrize("name", [*SAYS, "snapshot"])
def test_the_repr_is_one_short_line(displayed_objects, name):
    assert len(repr(displayed_objects[name])) < 130
    assert "\n" not in repr(displayed_objects[name])


def test_a_stage_says_what_is_broken_in_it(displayed_objects):
    from stage import faults

    with faults.jam(displayed_objects["axis"]):
        assert "faults: axis x: " in displayed_objects["stage"]._repr_html_()


def test_tab_offers_the_axes_and_nobody_adds_one(displayed_objects):
    """stage.axes[<Tab>"""
    axes = displayed_objects["axes"]
    assert axes._ipython_key_completions_() == ["x", "y"] == list(axes)
    assert [a.name for a in reversed(axes.values())] == ["y", "x"]
    assert "z" not in axes
    with pytest.raises(TypeError, match="does not support item assignment"):
        axes["z"] = axes["x"]


def test_tab_of_ipython_offers_the_axes(displayed_objects):
    completer = pytest.importorskip("IPython.core.completer")
    ip = completer.IPCompleter(namespace={"stage": displayed_objects["stage"]}, use_jedi=False)
    ip.use_jedi = False
    with completer.provisionalcompleter():
        offered = {c.text.strip("'\"]") for c in ip.completions('stage.axes["', len('stage.axes["'))}
    assert {"x", "y"} <= offered


def test_where_rerun_has_a_widget_the_dashboard_is_in_the_notebook_and_elsewhere_a_picture(
    displayed_objects, monkeypatch
):
    bundle = displayed_objects["recording"]._repr_mimebundle_()
    assert {"text/plain", "text/html"} <= bundle.keys()
    monkeypatch.setattr("stage.recording.rerun_viewer.is_installed", lambda library: False)
    assert displayed_objects["recording"]._repr_mimebundle_().keys() == {"text/plain", "text/html"}
    monkeypatch.undo()
    pytest.importorskip("rerun_notebook")
    assert "application/vnd.jupyter.widget-view+json" in bundle


def test_without_matplotlib_the_page_says_what_the_picture_needs(displayed_objects, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    html = displayed_objects["recording"]._repr_html_()
    assert "drawing needs matplotlib: pip install -e &#x27;.[plot]&#x27; in a checkout of PulseStage." in html
    assert "samples of x, y" in html
