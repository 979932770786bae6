"""What the oscilloscope's controls say of what cannot be."""

import pytest

pytest.importorskip("nicegui")

from stage.errors import ArgumentError


@pytest.fixture(scope="module")
def page(served):
    page = served.visit()
    yield page
    served.leave()


def test_a_refused_trigger_is_reported(page, monkeypatch):
    (one,) = (e for e in page._all() if type(e).__name__ == "BrowserUpdates")
    scope = next(observe.__self__.scope for _, method, observe, _ in one._calls if method == "run_chart_method")

    def refuse(*wanted):
        raise ArgumentError("no such trigger.")

    for name, value in (("mode", "normal"), ("source", "x/rate"), ("edge", False), ("level", 120)):
        page.put(name, value)
    monkeypatch.setattr(scope, "set_trigger", refuse)
    page.put("level", 7)
    assert page.said == ["no such trigger."]
    assert (scope.mode, scope.source, scope.rising, scope.level) == ("normal", "x/rate", False, 120)


def test_other_traces_are_drawn_at_once_also_while_nothing_moves(page, monkeypatch):
    (one,) = (e for e in page._all() if type(e).__name__ == "BrowserUpdates")
    chart = next(observe.__self__ for _, method, observe, _ in one._calls if method == "run_chart_method")
    monkeypatch.setattr(one, "_calls", [])  # nobody else looks
    page.put("mode", "free")
    page.put("traces", ["x/position"])
    assert page.within(chart._build_next_message)
    assert page.within(chart._build_next_message) is None, "it rests"
    page.put("traces", ["x/position", "y/position"])
    method, message = page.within(chart._build_next_message)
    assert (method, len(message["series"])) == ("setOption", 2)
