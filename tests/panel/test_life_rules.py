"""How a stage lives in its thread: real time begins anew after each jump, haste ends, orders are seen, trouble and its end."""

import threading
import time

import pytest

from stage import Stage, firmware
from stage.errors import StageError
from stage.panel.admission import SHORTEST
from stage.panel.session import FREE, Abandoned, Session


@pytest.fixture
def session():
    with Session(Stage("xy", visuals=False), speed=1.0, paused=True) as session:
        yield session


def until(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def hurried(session, seconds):
    session.do(lambda stage: session._life.at_once(stage.run, seconds))


def goes_on(session):
    """Time passes from where it is at once, and in real time."""
    at = session.do(lambda stage: stage.time)
    begin = time.monotonic()
    session.paused = False
    until(lambda: session.view.time > at + 0.03, 1.5)
    passed = session.view.time - at
    assert passed <= time.monotonic() - begin + 0.05
    session.paused = True


def test_after_what_is_done_at_once_time_goes_on_in_real_time(session):
    hurried(session, 4.0)
    goes_on(session)

    def fails(stage):
        stage.run(4.0)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        session.do(lambda stage: session._life.at_once(fails, stage))
    assert session.do(lambda stage: stage.time) > 8
    goes_on(session)


def test_who_goes_to_a_snapshot_goes_on_from_there_at_once_whether_it_is_later_or_earlier(session):
    first = session.do(lambda stage: stage.snapshot())
    hurried(session, 4.0)
    later = session.do(lambda stage: stage.snapshot())
    session.restore(first)
    session.paused = False
    until(lambda: session.view.time > 0.02)
    for then, at in ((later, 4.0), (first, 0.0)):
        session.restore(then)  # time passes, and goes on doing so
        begin = time.monotonic()
        until(lambda now=at: now + 0.03 < session.view.time < now + 2, 1.5)
        assert session.view.time - at <= time.monotonic() - begin + 0.2


def test_an_order_is_seen_when_it_is_done(session):
    """Whoever waits for `changed` is told of it, with what it has left."""
    until(lambda: session.do(lambda stage: True))
    number, told = session.view.number, threading.Event()

    def wait():
        with session.changed:
            session.changed.wait_for(lambda: session.view.qpos[0] > 0.009, 5)
        told.set()

    waiting = threading.Thread(target=wait)
    waiting.start()
    session.do(lambda stage: stage.place(x=0.01))
    assert told.wait(5)
    waiting.join()
    assert session.view.number > number
    assert session.view.qpos[0] == pytest.approx(0.01)


def test_what_is_under_way_stands_still_while_paused_and_ends_when_it_is_abandoned(session):
    move = session.act("move", lambda stage: firmware.move(stage.axes["x"], distance=0.05))
    until(lambda: session.view.doing == "move")
    session.do(lambda stage: None)
    at = session.do(lambda stage: stage.now)
    assert at < 1_000_000, "bus cycles take their time"
    assert session.do(lambda stage: stage.now) == at
    assert session.busy
    assert session.abandon()
    with pytest.raises(Abandoned):
        move.result(5)
    until(lambda: session.view.doing == "")
    assert not session.abandon(), "none is under way"


def test_trouble_stands_until_time_is_let_on_or_gone_back(session):
    def diverge(stage):
        stage.data.qfrc_applied[0] = 1e30

    for end in ("unpause", "reset"):
        session.do(diverge)
        session.paused = False
        until(lambda: "diverged" in session.view.trouble)
        at = session.do(lambda stage: stage.now)
        time.sleep(0.03)
        assert session.do(lambda stage: stage.now) == at, "time stands still"
        session.paused = True
        assert session.view.trouble
        if end == "unpause":
            session.do(lambda stage: stage.reset())
            session.paused = False
        else:
            session.reset()
            session.paused = False
        until(lambda: not session.view.trouble and session.view.time > 0)
        session.reset()


def test_a_program_beside_it_does_what_is_short_also_at_its_end_and_else_is_refused():
    stage = Stage("xy", visuals=False)
    with Session(stage, speed=FREE, program="a test") as session:
        stage.run(0.01)
        session._life.ending = True
        at = stage.now
        stage.run_to(at + SHORTEST // 2)
        assert stage.now == at + SHORTEST // 2, "a bus cycle ends"
        with pytest.raises(Abandoned, match="the program ends"):
            stage.run(0.01)
        session._life.ending = False
        stage.run(0.01)
        session.dismiss()
        with pytest.raises(StageError, match="lives in a session"):
            stage.run(0.01)
    stage.run(0.01)


def test_trouble_that_a_program_has_mended_is_forgotten():
    stage = Stage("xy", visuals=False)
    with Session(stage, speed=FREE, program="a test") as session:
        session.do(lambda stage: stage.data.qpos.__setitem__(0, -3.0))
        until(lambda: session.view.trouble.startswith("x is out of its travel"))
        session.do(lambda stage: stage.place(x=0.0))
        until(lambda: not session.view.trouble)


def test_what_a_program_did_last_is_seen_and_can_be_gone_back_to():
    stage = Stage("xy", visuals=False)
    with Session(stage, speed=FREE, program="a test") as session:
        stage.run(0.2)
        until(lambda: session.view.time == pytest.approx(0.2))
        assert session.remembered >= 0
        stage.run(0.2)
        until(lambda: session.view.time == pytest.approx(0.4))
        then = session.back(0.1)
        assert then <= 0.3
        assert session.do(lambda stage: stage.time) == then
        assert stage.loop.pace is not None
    assert stage.loop.pace is None


def test_time_goes_on_as_fast_as_is_said_from_when_it_is_said(session):
    session.speed = 0.001
    session.paused = False
    time.sleep(0.03)
    assert session.view.time < 0.01
    session.speed = FREE
    until(lambda: session.view.time > 1.0)
    session.speed = 1.0
    at, begin = session.view.time, time.monotonic()
    time.sleep(0.05)
    assert session.view.time - at <= time.monotonic() - begin + 0.1
