"""Fault controls, console, front panels and oscilloscope by a browser's events, without a browser."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("nicegui")
from support.served_panel import ServedPanel

from stage.errors import StageError
from stage.panel import chip_panel as chips
from stage.panel import oscilloscope_page as charts
from stage.panel.front_panel_content import BusCycle, FrontPanel
from stage.panel.oscilloscope import WINDOW_LENGTHS_S, OscilloscopeFrame
from stage.panel.page import READOUT, format_readout


@pytest.fixture(scope="module")
def page(served):
    return served.visit()


@pytest.fixture(autouse=True)
def _as_at_first(served, page):
    served.session.reset()
    page.said.clear()
    yield
    served.leave(but=1)
    for created in reversed(served.panel.fault_controls.faults_in_force):
        served.panel.fault_controls.clear_fault(created)
    served.panel.fault_controls.set_payload(0.0)


def call_on_stage(served, action):
    return served.session.do(action)


def pushes(served):
    return call_on_stage(
        served, lambda stage: [float(stage.data.qfrc_applied[a.plant.dof]) for a in stage.axes.values()]
    )


# --- axes ---


def test_a_card_of_each_axis_has_its_motor_its_place_and_its_switches(served, page):
    call_on_stage(served, lambda stage: stage.place(x=0.0123, y=stage.axes["y"].travel[1] * 0.985))
    served.panel.observer.request_registers(0, 0)
    call_on_stage(served, served.panel.observer.update_views)
    live, observer = live_of(page), served.panel.observer
    texts = {e.props.get("data-test"): now() for e, now in live._texts.values()}
    lamps = {e.props.get("data-test"): now() for e, now in live._lamps.values()}
    assert lamps["switch-y-el_plus"]
    for name, axis in served.session.stage.axes.items():
        observed = observer.axes[name]
        assert texts[f"motor-{name}"] == axis.drive.motor.name
        cells = tuple(texts[f"{title.split()[0]}-{name}"] for title in READOUT)
        assert cells == format_readout(axis.unit, observed.position, observed.commanded, observed.lost)
        assert {s: lamps[f"switch-{name}-{s}"] for s in axis.switches.as_dict()} == observed.switches
    assert texts["position-x"] != texts["position-y"]
    pins = observer.chips[0, 0]
    for pin, on in (pins.inputs | pins.outputs).items():
        assert lamps[f"pin-0-{pin}"] == on


# --- hands ---


def test_a_new_page_offers_every_fault(served):
    page, breakings = served.visit(), served.panel.fault_controls.list_forms("x")
    assert list(page.find("breaking").options) == [b.name for b in breakings]
    assert page.find("breaking").value == breakings[0].name
    for b in breakings:
        page.put("breaking", b.name)
        for field in b.fields:
            assert page.find(f"break-{field.name}").value == field.default
        assert page.all("break")
        assert b.title in {getattr(e, "text", "") for e in page._all()}


def test_load_and_supply_are_what_the_sliders_say_and_every_page_follows(served, page):
    second = served.visit()
    page.fire("payload", "change", 0.5)
    page.fire("supply", "change", 20)
    for one in (page, second):
        one.until(lambda o=one: o.text("payload-value") == "payload 0.5 kg" and o.find("payload").value == 0.5)
        one.until(lambda o=one: o.text("supply-value") == "supply 20 V" and o.find("supply").value == 20)
    assert call_on_stage(served, lambda stage: stage.payload()) == 0.5
    assert call_on_stage(served, lambda stage: [a.faults.bus_voltage for a in stage.axes.values()]) == [20, 20]
    page.fire("supply", "change", 24)
    page.until(lambda: not served.panel.fault_controls.faults_in_force)
    assert call_on_stage(served, lambda stage: [a.faults.bus_voltage for a in stage.axes.values()]) == [24, 24]
    page.fire("payload", "change", -1)
    page.until(lambda: page.said)
    assert call_on_stage(served, lambda stage: stage.payload()) == 0.5


@pytest.mark.parametrize(("button", "force"), [("push-plus", 2.5), ("push-minus", -2.5)])
@pytest.mark.parametrize(("down", "up"), [("pointerdown", "pointerleave"), ("keydown.enter.prevent", "keyup")])
def test_the_selected_axis_is_pushed_while_a_button_is_down(served, page, button, force, down, up):
    page.put("hands-axis", "y")
    page.put("push-force", "2,5")
    page.fire(button, down)
    page.until(lambda: pushes(served) == [0, force])
    page.fire("push-plus", down)  # one hand at a time
    page.put("hands-axis", "x")  # somebody looks at another meanwhile
    page.settled()
    assert pushes(served) == [0, force]
    page.fire(button, up)
    page.until(lambda: pushes(served) == [0, 0])


def test_who_loses_the_controls_takes_his_hand_away(served, page):
    second = served.visit()
    second.until(lambda: second.text("controls") == "Take the controls")
    page.fire("push-plus", "pointerdown")
    page.until(lambda: pushes(served)[0] > 0)
    second.click("controls")
    page.until(lambda: pushes(served) == [0, 0])
    served.panel.controls.give_controls_to(page.client.id)


def test_an_impossible_force_is_an_error_at_its_field_until_the_next_attempt(served, page):
    for typed, said in (("hard", "'hard' is not a number of N."), ("1e9", "1e+09 N: up to ")):
        page.put("push-force", typed)
        page.fire("push-plus", "pointerdown")
        page.until(lambda s=said: page.error("push-force").startswith(s))
        assert pushes(served) == [0, 0]
    page.put("push-force", "1")
    page.fire("push-plus", "pointerdown")
    page.until(lambda: pushes(served) == [1, 0])
    assert not page.error("push-force")
    page.fire("push-plus", "pointerup")
    page.until(lambda: pushes(served) == [0, 0])


def test_faults_are_of_the_selected_axis_and_cleared_one_by_one(served, page):
    fault_controls = served.panel.fault_controls
    page.put("breaking", "switch_stuck")
    for axis, pin, closed in (("x", "org", "no"), ("y", "el_plus", "yes"), ("y", "org", "yes")):
        page.put("hands-axis", axis)
        page.put("breaking", "switch_stuck")
        page.put("break-pin", pin)
        page.put("break-closed", closed)
        before = len(fault_controls.faults_in_force)
        page.click("break")
        page.until(lambda n=before: len(fault_controls.faults_in_force) == n + 1)
        assert fault_controls.faults_in_force[-1].request == ("switch_stuck", axis, {"pin": pin, "closed": closed})
    texts = [created.text for created in fault_controls.faults_in_force]
    page.until(lambda: len(page.all("clear-fault")) == 3)
    listed = [e.text for e in page.find("in-force").descendants() if getattr(e, "text", "") in texts]
    assert listed == texts
    page.click("break")
    messages = page.until(lambda: page.said)
    assert "is in force already" in messages[0]
    page.click("clear-fault", 1)
    page.until(lambda: [created.text for created in fault_controls.faults_in_force] == [texts[0], texts[2]])
    page.until(lambda: len(page.all("clear-fault")) == 2)
    assert page.all("clear-fault")[1].props["aria-label"] == f"clear {texts[2]}".replace('"', "'")


def test_an_error_of_a_fault_is_at_its_field(served, page):
    page.put("breaking", "bus_voltage" if "bus_voltage" in page.find("breaking").options else "friction")
    field = next(e.props["data-test"] for e in page._all() if str(e.props.get("data-test", "")).startswith("break-"))
    page.put(field, "much")
    page.click("break")
    page.until(lambda: "'much' is not a number" in page.error(field))
    assert not served.panel.fault_controls.faults_in_force


# --- console ---


def line(page, text, key="Enter"):
    if text is not None:
        page.put("console", text)
    page.fire("console", "keydown", key)
    page.settled()


def typed(page):
    return page.find("console").value


def test_a_line_of_the_console_is_sent_to_the_selected_chip(served, page):
    for index, value in ((1, 321), (0, 123)):
        page.put("console-target", index)
        line(page, f"R1 <- {value}")
        page.until(lambda: typed(page) == "")
    assert call_on_stage(served, lambda stage: [chip.axis_values(0)["R1"] for chip in stage.chips]) == [123, 321]


def test_a_line_that_is_wrong_stays_and_says_so_until_escape(served, page):
    line(page, "reed 0")
    page.until(lambda: "Did you mean read?" in page.error("console"))
    assert typed(page) == "reed 0"
    line(page, None, "Escape")
    page.until(lambda: typed(page) == "")
    assert not page.error("console")


def test_arrows_go_through_the_lines_before_and_the_same_twice_is_one(served, page):
    for text in ("R3 <- 77", "8", "8"):
        line(page, text)
        page.until(lambda: typed(page) == "")
    observed = []
    for key in ("ArrowUp", "ArrowUp", "ArrowDown", "ArrowDown", "ArrowDown", "ArrowUp"):
        line(page, None, key)
        observed.append(typed(page))
    assert observed == ["8", "R3 <- 77", "8", "", "", "8"]


def test_tab_completes_the_common_prefix(page):
    for text, completed in (("oper", "operate "), ("R", "R"), ("read oper", "read operate "), ("zz", "zz")):
        line(page, text, "Tab")
        page.until(lambda c=completed: typed(page) == c)


# --- front panels of a chip of several axes ---


@pytest.fixture(scope="module")
def wide():
    wide = ServedPanel(chips="mcx514")
    yield wide
    wide.close()


def test_rows_and_commands_are_of_the_selected_axis(wide):
    page, session = wide.visit(), wide.session
    assert page.find("chip-0").text.startswith("Front panel of x y: ")
    assert page.find("axis-of-0").options == {0: "x", 1: "y", 2: "(2)", 3: "(3)"}
    chip = session.stage.chips[0]

    def current():
        return session.do(lambda stage: [chip.axis_values(j)["DV"] for j in range(4)])

    before = current()
    for axis, value in ((1, 77), (0, 55)):
        page.put("axis-of-0", axis)
        page.until(lambda a=axis: page.find("value-0-DV").value == str(current()[a]))
        page.enter("value-0-DV", str(value))
        page.until(lambda a=axis, v=value: current()[a] == v)
        page.until(lambda v=value: page.find("value-0-DV").value == str(v))
    assert current() == [55, 77, *before[2:]]
    session.do(lambda stage: [chip.write(*cycle) for cycle in chip.register_cycles("SV", 123, 0)])
    page.until(lambda: page.find("value-0-SV").value == "123")  # then the update that may flash DV is over, too
    flashed = list(page.find("value-0-DV").classes)
    page.put("axis-of-0", 1)
    page.until(lambda: page.find("value-0-DV").value == "77")
    assert list(page.find("value-0-DV").classes) == flashed, "another axis is no change"


# --- oscilloscope ---


def test_each_command_button_sends_its_cycles_to_the_selected_axis(wide, monkeypatch):
    page, sent = wide.visit(), []
    kind = type(wide.session.stage.chips[0])

    async def send(panel, k, cycles):
        sent.append((panel is wide.panel, k, cycles))

    wide.panel.controls.give_controls_to(page.client.id)
    page.put("axis-of-0", 1)
    monkeypatch.setattr(chips, "make_bus_cycles", send)
    buttons = [b for group in FrontPanel(kind).buttons.values() for b in group if not b.data_bits]
    assert len(buttons) > 20
    for b in buttons:
        sent.clear()
        page.click(f"command-0-{b.symbol}" + (f"-{b.datum:X}" if b.datum is not None else ""))
        page.settled()
        assert sent == [(True, 0, [BusCycle(False, *c) for c in kind.command_cycles(b.symbol, 1, b.datum)])]


def test_cycles_are_made_in_order_and_reads_are_returned_and_traced(served, page):
    trace = served.panel.observer.traces[1]
    before, number = trace.lines[-1].number if trace.lines else 0, served.panel.observer.number
    cycles = [
        BusCycle(False, 0, 0x81),
        BusCycle(False, 1, 7),
        BusCycle(False, 2, 0),
        BusCycle(True, 1, None),
        BusCycle(True, 0, None),
    ]
    result = page.within(lambda: chips.make_bus_cycles(served.panel, 1, cycles))
    assert any(result)
    assert [(line.kind, line.address) for line in trace.get_lines_after(before)] == [
        ("W", 0),
        ("W", 1),
        ("W", 2),
        ("R", 1),
        ("R", 0),
    ]
    assert served.panel.observer.number > number
    assert result == call_on_stage(served, lambda stage: [stage.chips[1].read(address) for address in (1, 0)])
    assert call_on_stage(served, lambda stage: [chip.axis_values(0)["R1"] for chip in stage.chips]) == [0, 7]


def test_a_refused_cycle_is_reported(served, page, monkeypatch):
    async def refuse(*arguments):
        raise StageError("this session is over.")

    monkeypatch.setattr(chips, "make_bus_cycles", refuse)
    page.click("command-0-operate-8")
    page.until(lambda: page.said == ["this session is over."])


def test_the_trace_is_of_the_selected_chip(served, page, wide):
    other = wide.visit()
    for one, targets in ((page, {1: 1, 0: 2}), (other, {1: 0, 0: 0})):
        emptied = []
        one.find("trace").remove_all_lines = lambda e=emptied: e.append(1)
        for index, times in targets.items():
            one.put("console-target", index)
            assert len(emptied) == times, "axes of one chip have one bus"


def live_of(page):
    (live,) = (e for e in page._all() if type(e).__name__ == "BrowserUpdates")
    return live


def test_each_cycle_and_diagnostic_is_a_line_of_the_trace_with_errors_in_red(served, page):
    log, pushed = page.find("trace"), []
    page.put("console-target", 1)
    page.put("console-target", 0)
    log.append = lambda *arguments: pushed.append(arguments)
    line(page, "15")
    page.until(lambda: any(kind == "bad" for _, kind, *_ in pushed))
    trace = served.panel.observer.traces[0]
    reported = [(one.format(trace.digits), "bad" if one.kind == "!" else "", one.first) for one in trace.lines]
    page.until(lambda: [one for one in pushed if len(one) == 3][-2:] == reported[-2:])
    assert ("> 15", "own") in pushed


def chart_of(page):
    return next(look.__self__ for _, method, look, _ in live_of(page)._calls if method == "run_chart_method")


def test_each_unit_has_a_chart_and_each_pin_a_lane(served, page):
    chart = chart_of(page)
    page.put("traces", ["y/position", "x/rate", "x/position", "y/org", "x/org"])
    assert list(chart.scope.names) == ["y/position", "x/rate", "x/position", "y/org", "x/org"]
    options = chart.chart.options
    assert [y["name"] for y in options["yAxis"]] == ["mm", "pps", "y org", "x org"]
    assert [(s["name"], s["yAxisIndex"]) for s in options["series"]] == [
        ("y position", 0), ("x pulse rate", 1), ("x position", 0), ("y org", 2), ("x org", 3),
    ]  # fmt: skip
    assert [x["axisLabel"]["show"] for x in options["xAxis"]] == [False, False, False, True]
    assert options["legend"]["data"] == ["y position", "x pulse rate", "x position"]
    assert len({s["color"] for s in options["series"]}) == 5
    tops = [(g["top"], g["top"] + g["height"]) for g in options["grid"]]
    assert all(end < begin for (_, end), (begin, _) in pairwise(tops))


def test_a_curve_is_drawn_in_ms_or_s_from_the_trigger_or_from_power_up(served, page):
    chart = chart_of(page)
    page.put("traces", ["x/position", "y/org"])
    for begin, end, trigger, low, high, unit, first in (
        (2.0, 2.5, None, 2000, 2500, "ms", 2100), (2.0, 3.0, None, 2, 3, "s", 2.1),
        (2.0, 2.5, 2.2, -200, 300, "ms from the trigger", -100), (2.0, 5.0, 2.5, -0.5, 2.5, "s from the trigger", -0.4),
    ):  # fmt: skip
        curve = np.array([2.1, 2.2, 2.3, 2.4]), np.array([1.0, 1.0, 1.0, 3.0])
        message = chart._build_chart_message(
            OscilloscopeFrame(begin, end, {"x/position": curve, "y/org": curve}, trigger, "")
        )
        lower, upper = message["xAxis"]
        assert (lower["min"], lower["max"]) == pytest.approx((low, high)) == (upper["min"], upper["max"])
        assert "name" not in lower
        assert upper["name"] == unit
        for series in message["series"]:
            assert series["data"][0] == pytest.approx([first, 1])
            assert [y for _, y in series["data"]] == [1, 1, 3], "the middle of what is level is not needed"
            assert len({x for x, _ in series["data"]}) == 3


def test_what_rests_is_drawn_seldom_and_what_moves_as_it_comes(served, page, monkeypatch):
    chart, clock = chart_of(page), SimpleNamespace(now=1000.0)
    monkeypatch.setattr(live_of(page), "_calls", [])  # nobody else looks
    monkeypatch.setattr(charts, "perf_counter", lambda: clock.now)
    curves = {"flat": np.array([1.0, 1.0]), "up": np.array([1.0, 2.0])}
    displayed = SimpleNamespace(kind="up", end=1.0)

    def picture(points):
        return OscilloscopeFrame(
            displayed.end - 1, displayed.end, {"x/position": (np.array([0.1, 0.2]), curves[displayed.kind])}, None, ""
        )

    monkeypatch.setattr(chart.scope, "capture_frame", picture)
    monkeypatch.setattr(chart, "_drawn", None)

    def drawn(kind, after):
        displayed.kind, displayed.end = kind, displayed.end + 0.01
        clock.now += after
        return page.within(chart._build_next_message) is not None

    assert drawn("up", 0.0)
    assert drawn("up", 0.01)
    assert drawn("flat", 0.01), "that it rests is drawn at once"
    assert not drawn("flat", 0.9 * charts.FLAT_INTERVAL_S)
    assert drawn("flat", 0.2 * charts.FLAT_INTERVAL_S)
    assert not drawn("flat", 0.01)
    assert drawn("up", 0.01)
    displayed.end -= 0.01
    assert not drawn("up", 1.0), "the same picture again"


def test_window_trigger_and_run_are_those_of_the_controls(served, page, monkeypatch):
    chart, requested = chart_of(page), []
    for span in WINDOW_LENGTHS_S[:3]:
        page.put("span", span)
        assert chart.scope.window_s == span
    monkeypatch.setattr(chart.scope, "set_trigger", lambda *wanted: requested.append(wanted))
    page.put("mode", "single")
    page.put("source", "y/rate")
    page.put("edge", False)
    page.put("level", 300)
    page.put("level", None)
    assert requested[-1] == ("single", "y/rate", False, 0.5)
    assert requested[-2] == ("single", "y/rate", False, 300)
    n = len(requested)
    page.within(chart._set_trigger)
    assert len(requested) == n, "told again, nothing is caught anew"
    monkeypatch.undo()
    page.put("mode", "free")
    for running in (False, True):
        page.click("run")
        assert chart.scope.running is running
        page.until(lambda r=running: page.text("run") == ("Freeze" if r else "Follow"))


def test_what_the_window_shows_is_exported_under_its_end(served, page):
    served.session.do(lambda stage: (served.session.run_unpaced(stage.run, 0.5), served.session._publish_view()))
    chart = chart_of(page)
    page.put("traces", ["x/position", "y/org"])
    page.until(lambda: chart._frame is not None and chart._frame.end == pytest.approx(0.5))
    page.sent.clear()
    page.click("export-csv")
    page.until(lambda: page.sent)
    ((name, data),) = page.sent
    assert name == "pulsestage-0.500s.csv"
    assert data.decode().splitlines()[0] == "time (s),x position (mm),y org"
    page.put("traces", [])
    page.click("export-csv")
    page.until(lambda: page.said)
    assert page.said == ["nothing to export: choose a trace first."]
