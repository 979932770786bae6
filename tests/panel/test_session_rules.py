"""A session's small print: orders in a pause, what is waited for, what is refused, whose the stage is, and its end."""

import time
from concurrent.futures import TimeoutError as Late

import pytest

from stage import Stage
from stage.errors import ArgumentError, StageError
from stage.panel.past import EVERY
from stage.panel.session import FREE, RECOVERED, Abandoned, Session


@pytest.fixture
def session():
    with Session(Stage("xy", visuals=False), speed=FREE, paused=True) as session:
        yield session


def until(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def hurried(session, seconds, pieces=1):
    for _ in range(pieces):
        session.do(lambda stage: session._life.at_once(stage.run, seconds))
        session.do(lambda stage: session._life.past.remember(stage))


def test_in_a_pause_nobody_waits_for_the_next_look(session):
    """The thread of a session that rests looks again after half a second: who wants something wakes it."""
    session.do(lambda stage: None)
    begin = time.monotonic()
    for _ in range(6):
        session.do(lambda stage: None)
        assert session.act("nothing", lambda stage: 7).result(5) == 7
    assert time.monotonic() - begin < 1.5

    begin = time.monotonic()
    for _ in range(4):
        move = session.act("wait", lambda stage: stage.run(1.0))
        until(lambda: session.view.doing == "wait")
        assert session.abandon()
        with pytest.raises(Abandoned):
            move.result(5)
    assert time.monotonic() - begin < 1.2
    begin = time.monotonic()
    for _ in range(4):
        at = session.do(lambda stage: stage.time)
        time.sleep(0.02)
        session.paused = False
        until(lambda a=at: session.view.time > a)
        session.paused = True
    assert time.monotonic() - begin < 1.2


def test_an_order_is_waited_for_as_long_as_was_said(session):
    with pytest.raises(Late):
        session.do(lambda stage: time.sleep(0.15), timeout=0.01)
    assert session.do(lambda stage: 5, timeout=5) == 5


def test_within_an_order_another_is_done_at_once(session):
    seen = []
    session.do(lambda stage: (seen.append(1), session.do(lambda stage: seen.append(2)), seen.append(3)))
    assert seen == [1, 2, 3]


def test_a_stage_has_one_session_at_a_time(session):
    with pytest.raises(StageError, match="this stage has a session already: close that one first"):
        Session(session.stage)
    assert session.do(lambda stage: stage.now) == 0
    session.close()
    with Session(session.stage, paused=True) as again:
        assert again.do(lambda stage: stage.now) == 0


def test_its_own_thread_may_end_it():
    session = Session(Stage("xy", visuals=False), speed=FREE)
    session.post(lambda stage: session.close()).result(5)
    session._life.thread.join(5)
    assert not session._life.thread.is_alive()
    assert session.stage.loop.pace is None
    with pytest.raises(StageError, match="this session is over"):
        session.do(lambda stage: None)


def test_so_many_steps_pass_as_are_asked_for_and_then_time_stands(session):
    dt = session.stage.state.dt
    session.paused = False
    for n, given in ((1, ()), (4, (4,))):
        session.paused = True
        at = session.do(lambda stage: stage.now)
        session.single_step(*given)
        assert session.paused
        assert session.do(lambda stage: stage.now) == (at // dt + n) * dt
        session.paused = False
        until(lambda a=at: session.view.time * 1e9 > a + 10 * dt)


@pytest.mark.parametrize("seconds", [-1, -1e-9, float("nan")])
def test_nobody_goes_back_by_less_than_nothing(session, seconds):
    with pytest.raises(ArgumentError, match=rf"^back\({seconds!r}\): seconds, 0 or more\.$"):
        session.back(seconds)


def test_one_goes_back_to_the_snapshot_before_and_forgets_what_came_after(session):
    hurried(session, EVERY, 12)
    at = session.do(lambda stage: stage.time)
    assert session.remembered == pytest.approx(at - EVERY)
    then = session.back(2.5 * EVERY)
    assert then == pytest.approx(at - 3 * EVERY) == session.do(lambda stage: stage.time)
    assert session.remembered == pytest.approx(then - EVERY)
    assert session.back(0) == then, "to where it is, which is remembered"
    assert session.back(1e3) == pytest.approx(EVERY), "as far as it goes"


def test_one_recovers_by_half_a_second_and_time_stands(session):
    hurried(session, EVERY, 16)
    at = session.do(lambda stage: stage.time)
    session._life.trouble = "something"
    session.paused = False
    assert session.recover() == pytest.approx(at - RECOVERED)
    assert session.paused
    assert session._life.trouble == ""


@pytest.mark.parametrize("how", ["back", "reset", "restore", "recover"])
def test_who_goes_elsewhere_in_time_abandons_what_is_under_way(session, how):
    kept = session.do(lambda stage: stage.snapshot())
    session.paused = False
    move = session.act("wait", lambda stage: stage.run(1e6))
    until(lambda: session.view.doing == "wait" and session.view.time > 0)
    {"back": lambda: session.back(0.0), "reset": session.reset, "restore": lambda: session.restore(kept),
     "recover": session.recover}[how]()  # fmt: skip
    with pytest.raises(Abandoned):
        move.result(5)
    until(lambda: not session.busy)


def test_only_a_program_can_be_made_to_wait():
    with Session(Stage("xy", visuals=False), speed=FREE, paused=True) as session:
        session.take_over()
        assert not session.taken
        assert not session.waits
    with Session(Stage("xy", visuals=False), speed=FREE, paused=True, program="mine") as session:
        assert (session.program, session.taken) == ("mine", False)
        session.take_over()
        assert session.taken
        session.paused = False
        move = session.act("wait", lambda stage: stage.run(1e6))
        until(lambda: session.view.doing == "wait")
        session.give_back()
        assert not session.taken
        with pytest.raises(Abandoned):
            move.result(5)
        session.take_over()
        session.dismiss()
        assert (session.program, session.taken) == ("", False)


def test_a_program_that_lets_time_pass_otherwise_waits_for_real_time():
    stage = Stage("xy", visuals=False)
    with Session(stage, speed=0.2, program="a board") as session:
        session.catch_up()
        assert session.piece == pytest.approx(0.02 * 0.2)
        begin = time.monotonic()
        session._life.clock.restart(stage.now - 20_000_000)  # 20 ms too far, which take 0.1 s
        session.catch_up()
        assert 0.08 < time.monotonic() - begin < 1
        assert stage.now == 0, "it waits, and lets nothing pass"
