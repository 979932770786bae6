"""Sessions: each its own stage; bounded in number, time and life; a late caller is told."""

import threading
import time

import pytest

from stage import Stage
from stage.agents import Budget
from stage.agents.server.client_sessions import ClientSessions, ToolboxFactory
from stage.errors import StageError


@pytest.fixture(scope="module")
def maker():
    return ToolboxFactory(lambda: Stage("xy", visuals=False), budget=Budget(moves=3))


class ManualClock:
    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return ManualClock()


def test_each_session_has_a_separate_stage(maker):
    sessions = ClientSessions(maker)
    sessions.get_toolbox("a").call("move", {"axis": "x", "pulses": 500})
    assert sessions.get_toolbox("a").stage.axes["x"].chip.net() == 500
    assert sessions.get_toolbox("b").stage.axes["x"].chip.net() == 0
    assert sessions.get_toolbox("b").call("budget").data["left"]["moves"] == 3
    assert sessions.get_toolbox("a") is sessions.get_toolbox("a")
    sessions.close_all()
    assert len(sessions) == 0


def test_a_server_that_ends_opens_no_session_for_a_new_call(maker):
    sessions = ClientSessions(maker)
    sessions.get_toolbox("a")
    sessions.close_all()
    assert sessions.get_toolbox("b").stage.time == 0, "closed sessions alone end no server"
    sessions.shut_down()
    with pytest.raises(StageError, match="The server ends"):
        sessions.get_toolbox("new")
    assert len(sessions) == 0


def test_the_first_stage_and_the_catalogue_stay_at_power_up(maker):
    sessions = ClientSessions(maker)
    sessions.get_toolbox("a").call("move", {"axis": "x", "pulses": 500})
    assert maker.original_stage.time == maker.catalog.stage.time == 0
    assert list(maker.catalog.tools) == list(sessions.get_toolbox("a").tools)


def test_a_silent_session_ends_and_a_later_caller_is_reported(maker, clock):
    sessions = ClientSessions(maker, idle_s=60, clock=clock)
    box = sessions.get_toolbox("a")
    clock.now = 59
    assert sessions.close_expired() == 0
    sessions.get_toolbox("a")
    clock.now = 120
    assert sessions.close_expired() == 1
    assert box.closed
    with pytest.raises(StageError, match="This session has ended"):
        sessions.get_toolbox("a")


def test_a_client_that_has_gone_may_come_back_for_a_while(maker, clock):
    sessions = ClientSessions(maker, grace_s=10, clock=clock)
    sessions.get_toolbox("a")
    sessions.note_disconnect("a")
    sessions.note_disconnect("nobody")
    clock.now = 9
    assert sessions.close_expired() == 0
    sessions.get_toolbox("a")  # it is back
    clock.now = 30
    assert sessions.close_expired() == 0
    sessions.note_disconnect("a")
    clock.now = 41
    assert sessions.close_expired() == 1


def test_a_session_does_not_live_for_ever(maker, clock):
    sessions = ClientSessions(maker, life_s=100, clock=clock)
    for clock.now in range(0, 100, 10):
        sessions.get_toolbox("a")
    clock.now = 101
    assert sessions.close_expired() == 1


def test_sessions_beyond_the_limit_are_refused_until_one_is_idle(maker, clock):
    sessions = ClientSessions(maker, limit=2, idle_s=60, clock=clock)
    sessions.get_toolbox("a"), sessions.get_toolbox("b")
    with pytest.raises(StageError, match="2 sessions are open"):
        sessions.get_toolbox("c")
    clock.now = 61  # the others have fallen silent
    assert sessions.get_toolbox("c").call("budget").ok


def test_a_session_that_is_closed_ends_the_call_that_it_makes(maker):
    sessions = ClientSessions(maker)
    box, answers = sessions.get_toolbox("a"), []
    thread = threading.Thread(target=lambda: answers.append(box.call("wait", {"seconds": 120})))
    thread.start()
    while not box.stage.loop.pace:
        time.sleep(0.001)
    sessions.close("a")
    thread.join(10)
    assert "session ended during this call" in answers[0].text
    assert "This session has ended" in box.call("budget").text


def test_a_call_computes_for_no_longer_than_its_patience():
    created = ToolboxFactory(lambda: Stage("xy", visuals=False), patience=1e-3)
    assert "compute for 0.001 s" in created().call("wait", {"seconds": 60}).text
