"""Procedures on the page by a browser's events, without a browser: what is ordered, what is said, and where."""

from types import SimpleNamespace

import pytest

from stage import Stage, firmware
from stage.errors import RunTimeout, StageError
from stage.panel.procedure_forms import FORMS
from stage.panel.session import UNPACED_SPEED


@pytest.fixture(scope="module")
def page(served):
    """One that looks at the forms, and has the controls."""
    return served.visit()


@pytest.fixture(autouse=True)
def _drawn_quickly(monkeypatch):
    """Patterns are drawn elsewhere: here they only say of what they are."""
    monkeypatch.setattr("stage.panel.procedure_page.render_operation_pattern_svg", lambda report: f"<svg>{report}")


@pytest.fixture
def session(served, page):
    """At power-up; time passes as fast as it goes."""
    session = served.session
    session.reset()
    page.within(served.panel.reports._outcomes.clear)
    session.speed, session.paused = UNPACED_SPEED, False
    page.put("procedure-axis", "y")
    page.put("procedure-axis", "x")  # the forms are as at first
    tab(page, "move")
    yield session
    served.leave(but=1)
    session.stop_actions()
    page.until(lambda: not session.busy)
    session.paused = True


@pytest.fixture
def ordered(session, monkeypatch):
    """Titles of the actions that the session gets."""
    names, act = [], session.act
    monkeypatch.setattr(session, "act", lambda name, order: names.append(name) or act(name, order))
    return names


def tab(page, name):
    tabs = page.find(f"tab-{name}").parent_slot.parent
    page.within(lambda: setattr(tabs, "value", name))


def fill(page, **values):
    for name, value in values.items():
        page.put(name.replace("__", "-"), value)


def go(page, form, says="pulses"):
    """Press the button; the report."""
    reports = page.panel.reports
    before = reports.find_outcome(form)
    tab(page, form)
    page.click(f"go-{form}")
    outcome = page.until(lambda: says in (now := reports.find_outcome(form)).text and now is not before and now)
    page.until(lambda: page.text("report") == outcome.text)
    return outcome.text


def has_failed(page):
    """Return whether the report is shown as an error."""
    return "text-negative" in page.find("report").classes


def test_a_move_is_of_the_selected_axis_with_the_values_of_its_fields(page, session, ordered):
    page.put("procedure-axis", "y")
    fill(page, move__distance="-3", move__speed="25", move__start_speed="5", move__accel="0,1", move__s_curve="S-curve")
    report = go(page, "move")
    y = Stage("xy", chips="pcl240ms", visuals=False).axes["y"]
    alone = firmware.move(y, distance=-0.003, speed=0.025, start_speed=0.005, accel=0.1, s_curve=True)
    assert report.splitlines()[:2] == str(alone).splitlines()[:2]
    assert ordered == ["Move y"]
    assert not has_failed(page)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_each_field_has_its_title_its_unit_and_its_default(served, page, session, axis):
    page.put("procedure-axis", axis)
    displayed = [f for f in FORMS.values() if f.is_available(session.stage, axis)]
    assert {e.props["name"] for e in page._all() if str(e.props.get("data-test")).startswith("tab-")} == {
        *(f.name for f in displayed), "jog",
    }  # fmt: skip
    for form in displayed:
        for field in form.list_fields(session.stage, axis):
            widget = page.find(f"{form.name}-{field.name}")
            assert (widget.value, widget.props["label"]) == (field.default, field.title)
            assert widget.props.get("suffix", "") == field.unit
            assert tuple(getattr(widget, "options", ())) == field.choices
    assert [page.all(f"jog-{name}") != [] for name in ("speed", "accel", "distance", "start_speed")] == [
        True,
        True,
        False,
        False,
    ]


def test_a_line_is_of_no_axis_alone(page, session, ordered):
    fill(page, line__x="-2", line__y="1.5")
    go(page, "line", "carriages")
    assert ordered == ["Line"]
    ends = session.do(lambda stage: [a.commanded for a in stage.axes.values()])
    assert ends == pytest.approx([-0.002, 0.0015], abs=5e-6)


def test_enter_in_any_field_of_a_form_begins_it(page, session, ordered):
    for field in ("move-distance", "move-accel"):
        fill(page, move__distance="1")
        before = len(ordered)
        page.fire(field, "keydown.enter")
        page.until(lambda n=before: len(ordered) > n and not session.busy)
    assert ordered == ["Move x"] * 2


def test_an_error_remains_at_its_field_until_the_next_attempt_without_a_report(page, session, ordered):
    assert "done" in go(page, "move")
    fill(page, move__distance='a"b\\c')
    page.click("go-move")
    page.until(lambda: page.error("move-distance"))
    assert page.error("move-distance") == "'a'b\\\\c' is not a number of mm."
    fill(page, move__distance="1", move__speed="-1")
    page.click("go-move")
    page.until(lambda: page.error("move-speed"))
    assert page.error("move-speed") == "-1 mm/s: a speed is more than 0, and one pulse a second, 0.00313 mm/s, or more."
    assert not page.error("move-distance")
    assert ordered == ["Move x"], "nothing of it was begun"
    fill(page, move__speed="1e9")
    page.click("go-move")
    message = page.until(lambda: "makes" in page.error("move-speed") and page.error("move-speed"))
    assert message.startswith("1e+09 mm/s: a PCL240MS makes up to")
    page.until(lambda: page.text("report") == "")
    fill(page, move__speed="")
    assert "done" in go(page, "move")
    assert not page.error("move-speed")


def test_a_second_press_during_an_action_is_ignored(page, session, ordered):
    session.paused = True
    tab(page, "move")
    page.click("go-move")
    page.click("go-move")
    page.until(lambda: page.text("report") == "Move x ...")
    page.until(lambda: not page.find("go-move").enabled)
    assert not page.find("go-line").enabled
    tab(page, "jog")
    page.fire("jog-plus", "pointerdown")
    page.until(lambda: page.said)
    assert page.said.pop() == "Move x is under way: resume time, or stop it."
    assert page.text("busy-move") == page.text("busy-line") == "Move x is under way: resume time, or stop it."
    session.paused = False
    page.until(lambda: page.find("go-move").enabled)
    assert ordered == ["Move x"]


def test_a_report_is_shown_under_its_form_in_every_browser(served, page, session):
    fill(page, two_rates__distance="20", two_rates__dwell="0.05")
    reports = {"move": go(page, "move"), "two_rates": go(page, "two_rates", "dual-rate")}
    second = served.visit()
    assert second.find("procedure-axis").value == "x"
    for form, report in reports.items():
        tab(page, form)
        page.until(lambda r=report: page.text("report") == r)
        tab(second, form)
        second.until(lambda r=report: second.text("report") == r)
        second.until(lambda r=report: second.find("pattern").content == f"<svg>{r}")
    tab(page, "home")
    page.until(lambda: not page.text("report") and not page.find("pattern").content)


def test_selecting_an_axis_leaves_the_same_form_open(page, session):
    tab(page, "two_rates")
    page.put("procedure-axis", "y")
    assert page.find("tab-move").parent_slot.parent.value == "two_rates"


def test_an_axis_of_a_beam_says_with_whom_it_carries_it(page, session, monkeypatch):
    assert not page.all("tied")
    monkeypatch.setattr(
        "stage.panel.procedure_page.find_coupled_axes", lambda stage, axis: {"y": ["x", "z"]}.get(axis, [])
    )
    page.put("procedure-axis", "y")
    assert page.text("tied").startswith("y carries one beam with x and z: ")
    page.put("procedure-axis", "x")
    assert not page.all("tied")


@pytest.mark.parametrize(
    ("form", "stopped_by", "result"),
    [("home", "ORG", ["y"]), ("home", "EL-", []), ("home", None, []), ("move", "R0 = 0", [])],
)
def test_an_origin_is_noted_for_the_axis_whose_return_reached_it(
    served, page, session, monkeypatch, form, stopped_by, result
):
    axes, done = [], []

    async def perform(*requested):
        page.find("procedure-axis").value = "x"  # somebody looks at another meanwhile
        done.append(requested[0])
        return SimpleNamespace(stopped_by=stopped_by) if stopped_by else None

    page.put("procedure-axis", "y")
    monkeypatch.setattr(served.panel.reports, "perform", perform)
    monkeypatch.setattr(served.panel.observer, "reset_lost_steps", lambda axis, stage: axes.append(axis))
    tab(page, form)
    page.click(f"go-{form}")
    page.until(lambda: done)
    page.settled()
    session.do(lambda stage: None)  # and orders so far are carried out
    assert (done, axes) == ([form], result)


@pytest.mark.parametrize(("name", "at_once"), [("stop", False), ("stop-at-once", True)])
def test_stop_stops_all_axes_and_ends_the_action(page, session, ordered, monkeypatch, name, at_once):
    stopped, stop = [], firmware.procedures.stop
    monkeypatch.setattr(
        firmware.procedures, "stop", lambda axis, how: stopped.append((axis.name, how)) or stop(axis, how)
    )
    session.paused = True
    page.click("go-move")
    page.until(lambda: session.view.action == "Move x")
    page.click(name)
    page.until(lambda: page.panel.reports.find_outcome("move").text == "Move x: stopped.")
    page.until(lambda: page.text("report") == "Move x: stopped." and not session.busy)
    assert ordered == ["Move x", "stop"]
    assert sorted(stopped) == [("x", at_once), ("y", at_once)]
    assert not has_failed(page)


def test_a_refused_stop_is_reported(page, session, monkeypatch):
    def refuse(name, order):
        raise StageError("this session is over.")

    page.said.clear()
    monkeypatch.setattr(session, "act", refuse)
    page.click("stop")
    page.until(lambda: page.said == ["this session is over."])


def test_a_report_from_before_a_power_up_is_marked_and_one_of_the_past_is_not(page, session):
    report = go(page, "move")
    session.paused = True
    session.go_back(0.0)
    page.settled()
    assert page.text("undone") == ""
    session.reset()
    page.until(lambda: page.text("undone") == "from before the power-up")
    assert page.text("report") == report
    assert "former" in page.find("report").classes
    session.paused = False
    go(page, "move")
    page.until(lambda: page.text("undone") == "" and "former" not in page.find("report").classes)


def test_a_procedure_that_a_power_up_ends_leaves_no_report(page, session):
    session.speed = 0.1
    fill(page, move__distance="100")
    page.click("go-move")
    page.until(lambda: session.view.action and session.view.time > 0.01)
    session.reset()
    page.until(lambda: not session.busy)
    page.until(lambda: page.text("report") == "")


def test_an_axis_stopped_with_a_ramp_decelerates_to_rest(page, session):
    fill(page, move__distance="100", move__speed="20")
    session.speed = 1.0
    page.click("go-move")
    page.until(lambda: session.do(lambda stage: stage.axes["x"].commanded) > 1e-4)
    session.speed = UNPACED_SPEED
    page.click("stop")
    page.until(lambda: not session.busy)
    at, busy = session.do(lambda stage: (stage.axes["x"].commanded, stage.axes["x"].chip.busy(0)))
    assert not busy
    assert 0 < at < 0.09


@pytest.mark.parametrize(("button", "sign"), [("jog-plus", 1), ("jog-minus", -1)])
@pytest.mark.parametrize(("down", "up"), [("pointerdown", "pointerup"), ("keydown.space.prevent", "keyup")])
def test_an_axis_jogs_in_its_direction_while_a_button_is_down(page, session, ordered, button, sign, down, up):
    session.speed = 5.0
    page.put("procedure-axis", "y")
    tab(page, "jog")
    fill(page, jog__speed="5", jog__accel="0.02")
    page.fire(button, down)
    page.fire(button, down)  # a key that repeats
    page.until(lambda: abs(session.do(lambda stage: stage.axes["y"].commanded)) > 1e-4)
    page.fire(button, up)
    page.until(lambda: "decelerating stop" in page.panel.reports.find_outcome("jog").text)
    at, other = session.do(lambda stage: [stage.axes[a].commanded * sign for a in "yx"])
    assert at > 1e-4
    assert other == pytest.approx(0, abs=1e-12)
    assert ordered == ["jog y"]
    page.fire(button, down)
    page.until(lambda: len(ordered) == 2 and session.view.action)
    page.fire(button, "blur")
    page.until(lambda: not session.busy)


def test_who_loses_the_controls_lets_go_of_his_jog(served, page, session):
    second = served.visit()
    session.speed = 1.0
    tab(page, "jog")
    page.fire("jog-plus", "pointerdown")
    page.until(lambda: session.view.action == "jog x")
    second.click("controls")
    page.until(lambda: not session.busy)
    served.leave(but=1)
    assert served.panel.controls.holder == page.client.id


def test_an_error_of_a_jog_is_at_its_field_or_below(page, session, ordered):
    tab(page, "jog")
    fill(page, jog__speed="slow")
    page.fire("jog-plus", "pointerdown")
    page.until(lambda: page.error("jog-speed"))
    assert page.error("jog-speed") == "'slow' is not a number of mm/s."
    assert not ordered
    fill(page, jog__speed="")
    session.do(lambda stage: stage.place(x=stage.axes["x"].travel[1] * 0.985))
    page.fire("jog-plus", "pointerdown")
    page.until(lambda: "x stands on its end limit" in page.text("report"))
    assert has_failed(page)
    assert not page.error("jog-speed")
    page.fire("jog-minus", "pointerdown")
    page.until(lambda: session.busy or "decelerating" in page.text("report"))
    page.fire("jog-minus", "pointerup")
    page.until(lambda: "decelerating" in page.text("report"))
    assert not has_failed(page)


def test_a_failed_report_is_red_and_a_timeout_includes_the_report(served, page, session):
    reports = served.panel.reports

    def ends(outcome):
        def order(stage):
            if isinstance(outcome, Exception):
                raise outcome
            return outcome

        return page.within(lambda: reports.perform("move", "Move x", order))

    bad = SimpleNamespace(ok=False, __str__=None)
    assert ends(bad) is bad
    assert (reports.find_outcome("move").text, reports.find_outcome("move").has_failed) == (str(bad), True)
    page.until(lambda: has_failed(page))
    delayed = RunTimeout("too long.")
    delayed.report = "as far as this"
    assert ends(delayed) is None
    assert reports.find_outcome("move")[:2] == ("too long.\nas far as this", True)
    good = SimpleNamespace(ok=True)
    assert ends(good) is good
    assert reports.find_outcome("move")[1:3] == (False, "")
    page.until(lambda: not has_failed(page))
    with pytest.raises(StageError, match="not begun"):
        ends(StageError("not begun"))
    assert reports.find_outcome("move") == reports.find_outcome("nothing so far")


def test_a_picture_is_of_the_report_that_it_was_drawn_of(served, page, session, monkeypatch):
    """And where it cannot be drawn, the report says why."""
    reports, pictures = served.panel.reports, {"first": "<svg>1", "second": StageError("no matplotlib.")}

    def picture(report):
        if report.name == "first":
            reports.set_outcome("home", "newer")  # the next has begun meanwhile
        if isinstance(result := pictures[report.name], Exception):
            raise result
        return result

    monkeypatch.setattr("stage.panel.procedure_page.render_operation_pattern_svg", picture)

    def perform(name):
        outcome = SimpleNamespace(ok=True, name=name, plot=None)
        page.within(lambda: reports.perform("home", "Home", lambda stage: outcome))

    perform("first")
    page.until(lambda: reports.find_outcome("home").text == "newer")
    page.settled()
    assert reports.find_outcome("home").picture == ""
    perform("second")
    page.until(lambda: reports.find_outcome("home").text.endswith("\nno matplotlib."))
    assert not reports.find_outcome("home").has_failed
