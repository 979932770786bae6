"""The row on top and the gate by a browser's events, without a browser: who may do what, and what it does."""

import io
import zipfile

import pytest

from stage.panel.session import UNPACED_SPEED

pytest.importorskip("nicegui")
from stage.panel import page as panel_page


@pytest.fixture(scope="module")
def page(served):
    """The first who comes, who has the controls."""
    return served.visit()


@pytest.fixture
def session(served, page):
    """At power-up, alone, and looked at by that one; who comes later leaves at the end."""
    served.session.reset()
    served.session.speed, served.session.paused = UNPACED_SPEED, True
    page.said.clear()
    page.sent.clear()
    yield served.session
    served.session.detach_program()
    served.leave(but=1)
    assert served.panel.controls.holder == page.client.id


def inert(page, name):
    """Return whether an element is shown as unusable."""
    return any("inert" in e.props for e in page.find(name).ancestors(include_self=True))


MACHINE = ("play", "speed", "payload")
DRIVING = ("step", "back-1", "reset", "reset-confirm", "stop", "stop-at-once", "go-move", "console", "value-0-R1")
FREE_TO_ALL = ("dark", "save-panel", "tour-skip", "run")
HIDDEN = {True: ("abandon", "recover"), False: ("take-over",)}
"""Nobody hears these before they are seen. True: they drive."""


def test_orders_of_an_observer_are_ignored(served, session, page, monkeypatch):
    second, received = served.visit(), []
    for name in (*MACHINE, *DRIVING, *FREE_TO_ALL):
        for one in (page, second):
            monkeypatch.setattr(one.find(name), "_handle_event", lambda msg, n=name, o=one: received.append((o, n)))

    def press_all(one):
        received.clear()
        for name in (*MACHINE, *DRIVING, *FREE_TO_ALL):
            element = one.find(name)
            one.within(lambda e=element: one.client.handle_event({"id": e.id, "listener_id": "any", "args": []}))
        return [n for o, n in received if o is one]

    everything = [*MACHINE, *DRIVING, *FREE_TO_ALL]
    assert press_all(page) == everything
    assert press_all(second) == list(FREE_TO_ALL)
    for one, may in ((page, True), (second, False)):
        one.until(lambda o=one, m=may: all(inert(o, n) is not m for n in (*MACHINE, *DRIVING)))
        assert {inert(one, n) for names in HIDDEN.values() for n in names} == {not may}
        assert not any(inert(one, n) for n in FREE_TO_ALL)
    served.panel.controls.give_controls_to(second.client.id)
    assert press_all(page) == list(FREE_TO_ALL)
    assert press_all(second) == everything
    second.until(lambda: not any(inert(second, n) for n in (*MACHINE, *DRIVING)))
    page.until(lambda: all(inert(page, n) for n in (*MACHINE, *DRIVING)))
    session.program = "a program"
    assert press_all(second) == [*MACHINE, *FREE_TO_ALL], "beside a program: what is not driving"
    second.until(lambda: all(inert(second, n) for n in DRIVING))
    assert not any(inert(second, n) for n in MACHINE)
    for drives, names in HIDDEN.items():
        assert [inert(second, n) for n in names] == [drives] * len(names)
    session.suspend_program()
    assert press_all(second) == everything
    assert press_all(page) == list(FREE_TO_ALL)
    second.until(lambda: not any(inert(second, n) for n in (*MACHINE, *DRIVING)))
    second.client.handle_event({"listener_id": "of nothing"})  # nothing is heard, and nothing breaks
    second.client.handle_event({"id": 10**9})


def test_the_controls_pass_on_when_they_are_taken_or_their_holder_leaves(served, session, page):
    controls = served.panel.controls
    page.until(lambda: not page.find("controls").visible)
    second = served.visit()
    second.until(lambda: second.text("controls") == "Take the controls")
    assert second.find("controls").visible
    page.until(lambda: page.text("controls") == "2 watching")
    assert page.find("controls").visible
    second.click("controls")
    page.until(lambda: page.text("controls") == "Take the controls")
    second.until(lambda: second.text("controls") == "2 watching")
    assert (controls.holder, controls.browser_count) == (second.client.id, 2)
    second.within(lambda: second.client.handle_disconnect(second._socket))
    assert (controls.holder, controls.browser_count) == (page.client.id, 1)
    page.until(lambda: not page.find("controls").visible)
    second.within(second._come)
    assert (controls.holder, controls.browser_count) == (page.client.id, 2), "he is back, and looks"


def test_one_button_pauses_and_resumes(session, page):
    for paused, icon in ((False, "pause"), (True, "play_arrow")):
        page.click("play")
        assert session.paused is paused
        page.until(lambda i=icon: page.find("play").props["icon"] == i)


def test_the_list_sets_each_speed_and_shows_others_as_the_nearest(session, page):
    for speed in panel_page.SPEEDS:
        page.put("speed", speed)
        assert session.speed == speed
    for speed, nearest in (
        (UNPACED_SPEED, UNPACED_SPEED),
        (0.01, 0.01),
        (1.0, 1.0),
        (0.3, 0.25),
        (1000.0, 5.0),
        (3.4, 2.0),
        (0.001, 0.01),
    ):
        assert panel_page.find_nearest_speed(speed) == nearest


def test_a_page_that_is_opened_later_shows_the_speed_that_is(served, session):
    session.speed = 0.5
    assert served.visit().find("speed").value == 0.5


def test_a_single_step_advances_one_step_and_pauses(session, page):
    session.paused = False
    page.click("step")
    page.until(lambda: session.paused)
    before = session.do(lambda stage: stage.now)
    page.click("step")
    page.settled()
    assert session.do(lambda stage: stage.now) - before == session.stage.state.dt


@pytest.mark.parametrize("seconds", panel_page.REWIND_CHOICES_S)
def test_the_button_goes_back_by_its_time(session, page, monkeypatch, seconds):
    requested = []
    monkeypatch.setattr(session, "go_back", lambda by: requested.append(by))
    page.click(f"back-{seconds:g}")
    page.until(lambda: requested)
    assert requested == [seconds]


def test_a_refused_way_back_is_reported(session, page):
    recording = session.do(lambda stage: stage.record())
    page.click("back-5")
    message = page.until(lambda: page.said)
    assert "recording" in message[0]
    session.do(lambda stage: recording.close())


def test_power_up_resets_the_stage_and_the_stop_button_ends_an_action(session, page):
    session.do(lambda stage: (stage.place(x=0.01), session.run_unpaced(stage.run, 0.01)))
    page.click("reset")
    page.settled()
    assert session.do(lambda stage: stage.now) > 0, "it asks first"
    page.click("reset-confirm")
    page.until(lambda: session.do(lambda stage: stage.now) == 0)
    assert session.do(lambda stage: stage.axes["x"].position) == pytest.approx(0)
    assert not page.find("abandon").visible
    doing = session.act("a long way", lambda stage: stage.run(1e6))
    page.until(lambda: page.text("doing") == "a long way")
    page.until(lambda: page.find("abandon").visible)
    assert not page.find("recover").visible
    page.click("abandon")
    page.until(doing.done)
    page.until(lambda: not page.find("abandon").visible and page.text("doing") == "")


def test_trouble_is_shown_first_with_a_button_to_recover(session, page):
    session.do(lambda stage: (session.run_unpaced(stage.run, 0.06), session._history.take_snapshot_if_due(stage)))
    session.do(lambda stage: stage.data.qpos.__setitem__(0, -3.0))
    page.until(lambda: page.text("doing").startswith("x is out of its travel"))
    page.until(lambda: page.find("recover").visible)
    assert "trouble" in page.find("doing").classes
    page.click("recover")
    page.until(lambda: not session.view.trouble and page.text("doing") == "")
    assert "trouble" not in page.find("doing").classes
    page.until(lambda: not page.find("recover").visible)
    assert session.paused


def test_the_page_suspends_a_program_and_lets_it_continue(session, page, monkeypatch):
    program = page.find("take-over")
    page.until(lambda: not program.visible)
    session.program = "mine.py"
    page.until(lambda: program.visible and program.text == "Take over")
    assert page.text("program") == "mine.py has the stage"
    page.click("take-over")
    page.until(lambda: program.text == "Give back")
    assert session.program_suspended
    assert page.text("program") == "mine.py"
    with monkeypatch.context() as waiting:
        waiting.setattr(type(session.lock), "has_waiting", True)
        page.until(lambda: page.text("program") == "mine.py waits")
    page.click("take-over")
    page.until(lambda: program.text == "Take over")
    assert not session.program_suspended


def test_light_and_dark_are_turned_from_what_the_browser_prefers(session, page):
    dark = next(e for e in page._all() if type(e).__name__ == "DarkMode")
    observed = [dark.value]
    for _ in range(3):
        page.click("dark")
        observed.append(dark.value)
    assert observed == [None, True, False, None]


def test_what_was_done_is_saved_under_its_name_as_what_it_says(served, session, page, monkeypatch):
    page.click("save-c")
    page.until(lambda: page.said)
    assert page.said == [
        "a program of yours has made this stage, and only that knows how: save everything in its place."
    ]
    page.click("save-panel")
    page.until(lambda: page.sent)
    ((name, data),) = page.sent
    assert name == "panel.zip"
    assert {"panel.json", "now.snapshot"} <= set(zipfile.ZipFile(io.BytesIO(data)).namelist())
    monkeypatch.setattr(
        "stage.panel.saved_panel.format_program", lambda panel, name: f"{name} of {panel is served.panel}"
    )
    names = {"save-program": "program.py", "save-c": "program.c", "save-test_program": "test_program.py"}
    for mark, name in names.items():
        page.sent.clear()
        page.click(mark)
        page.until(lambda: page.sent)
        assert page.sent == [(name, f"{name} of True".encode())]


def test_the_clock_and_the_pace_are_those_of_the_session(session, page):
    session.do(lambda stage: session.run_unpaced(stage.run, 0.12345))
    (live,) = (e for e in page._all() if type(e).__name__ == "BrowserUpdates")
    texts = {element.props.get("data-test"): observe() for element, observe in live._texts.values()}
    assert texts["time"] == f"{session.view.time:.4f} s" == "0.1235 s"
    assert texts["pace"] == "stands still"


def test_the_tour_begins_when_it_is_opened_and_skips_steps(session, page):
    page.click("tour")
    for k, title in enumerate(("First pulse", "Ramp")):
        page.until(lambda n=k, t=title: page.text("tour-title") == f"{n + 1} of 6: {t}")
        assert page.text("tour-task")
        page.click("tour-skip")
    for _ in range(4):
        page.click("tour-skip")
    page.until(lambda: page.text("tour-skip") == "Begin again")
    assert page.text("tour-title").startswith("That was the tour.")
    assert len([e for e in page._all() if str(e.props.get("data-test")).startswith("tour-then-")]) == 3
    page.click("tour-skip")
    page.until(lambda: page.text("tour-title") == "1 of 6: First pulse")
    observers = len(session._observers)
    page.click("tour")
    assert len(session._observers) == observers - 1


def test_the_row_names_the_program(page):
    assert "PulseStage" in [getattr(element, "text", None) for element in page._all()]
