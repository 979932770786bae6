"""A stage that lives in real time takes orders, and is the stage that it would be without."""

import threading
import time

import numpy as np
import pytest

from stage import Stage, firmware
from stage.errors import ArgumentError, StageError
from stage.panel.session import FREE, Abandoned, Session


@pytest.fixture
def session():
    with Session(Stage("xy", visuals=False), speed=FREE) as session:
        yield session


def until(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def test_time_passes_by_itself_and_stands_still_while_paused(session):
    until(lambda: session.view.time > 0.1)
    session.paused = True
    before = session.do(lambda stage: stage.now)
    time.sleep(0.05)
    assert session.do(lambda stage: stage.now) == before
    session.single_step(3)
    assert session.do(lambda stage: stage.now) - before == pytest.approx(
        3 * session.stage.state.dt, abs=session.stage.state.dt
    )


def test_no_more_time_passes_than_is_due():
    begin = time.monotonic()
    with Session(Stage("xy", visuals=False), speed=0.5) as session:
        time.sleep(0.3)
        view = session.view
    assert 0 < view.time <= 0.5 * (time.monotonic() - begin) + 0.02


def test_a_procedure_in_a_session_is_the_procedure_alone():
    """Cut into slices, with orders that only look between them: the same bits."""
    alone = Stage("xy", visuals=False)
    expected = firmware.move(alone.axes["x"], distance=0.002)
    with Session(Stage("xy", visuals=False), speed=FREE, paused=True) as session:
        future = session.act("move", lambda stage: firmware.move(stage.axes["x"], distance=0.002))
        assert not future.done()
        session.paused = False
        until(lambda: session.do(lambda stage: future.done()) or session.view.doing == "move")
        report = future.result(20)
        session.paused = True
    assert str(report) == str(expected)


def test_orders_are_carried_out_while_a_procedure_runs(session):
    session.speed = 1.0
    future = session.act("move", lambda stage: firmware.move(stage.axes["x"], distance=0.05))
    until(lambda: session.view.doing == "move")
    assert session.do(lambda stage: stage.axes["x"].chip.busy(0))
    assert not future.done()
    assert session.abandon()
    with pytest.raises(Abandoned):
        future.result(5)
    assert session.do(lambda stage: stage.axes["x"].chip.busy(0)), "the chip goes on with what it does"


def test_one_goes_back_and_the_same_future_comes_again(session):
    until(lambda: session.view.time > 0.3)
    session.paused = True
    was = session.do(lambda stage: stage.now)
    assert session.remembered >= 0.2
    then = session.back(0.2)
    assert then <= was * 1e-9 - 0.2 + 1e-9
    assert then >= was * 1e-9 - 0.3
    assert session.do(lambda stage: stage.time) == then

    def on(stage):
        session._life.at_once(stage.run_to, was)
        return stage.snapshot().state

    assert np.array_equal(session.do(on), session.do(lambda stage: (session.back(0.2), on(stage))[1]))
    session.reset()
    assert session.do(lambda stage: stage.now) == 0


def test_time_goes_on_at_once_after_power_up(session):
    """And an action begins, whatever the time was before."""
    until(lambda: session.view.time > 20)
    session.speed = 1.0
    session.reset()
    until(lambda: session.view.time > 0.05, 5)
    assert session.act("move", lambda stage: firmware.move(stage.axes["x"], distance=0.0005)).result(5).ok


def test_who_goes_back_to_a_snapshot_is_at_it(session):
    until(lambda: session.view.time > 0.3)
    session.paused = True
    then = session.back(0.1)
    assert session.back(0.0) == then


def test_after_a_reset_one_goes_back_to_what_was_since(session):
    until(lambda: session.view.time > 0.5)
    session.paused = True
    session.reset()
    session.do(lambda stage: stage.place(x=0.05))
    session.paused = False
    until(lambda: session.view.time > 0.3)
    session.paused = True
    session.back(0.1)
    assert session.view.time > 0.1
    assert session.do(lambda stage: stage.axes["x"].position) == pytest.approx(0.05, abs=1e-4)


def test_going_back_while_a_recording_goes_on_is_refused_also_at_once_after_power_up():
    """stage.run(1); then a panel, paused; power-up; a recording; back: nothing happened, and nobody was told"""
    stage = Stage("xy", visuals=False)
    stage.run(1.0)
    with Session(stage, speed=FREE) as session:
        session.paused = True
        session.reset()
        with session.do(lambda stage: stage.record()), pytest.raises(StageError, match="close the recording"):
            session.back(5.0)
        assert session.back(5.0) == 0.0


def test_a_single_step_is_the_last_until_time_goes_on(session):
    session.single_step()
    assert session.paused


def test_an_order_that_comes_as_the_session_ends_is_told():
    session, late = Session(Stage("xy", visuals=False), paused=True), []

    def ends(stage):
        if not late:
            late.append(session.post(lambda stage: stage.now))
            session.close()

    session.do(lambda stage: session.on_slice(ends))
    with pytest.raises(StageError, match="this session is over"):
        late[0].result(10)


def test_an_error_of_an_order_comes_to_who_gave_it(session):
    with pytest.raises(ArgumentError, match="unknown axis"):
        session.do(lambda stage: stage.place(q=1))
    with pytest.raises(ZeroDivisionError):
        session.act("wrong", lambda stage: 1 / 0).result(5)
    until(lambda: session.view.time > 0)


@pytest.mark.parametrize("speed", [0, -1, 1e9, float("nan")])
def test_a_speed_that_is_none_is_refused(session, speed):
    with pytest.raises(ArgumentError, match="simulated seconds a second"):
        session.speed = speed


def test_nobody_else_runs_the_stage_and_afterwards_it_is_his_again():
    stage = Stage("xy", visuals=False)
    session = Session(stage)
    with pytest.raises(StageError, match="lives in a session"):
        stage.run(0.1)
    with pytest.raises(StageError, match="has a session already"):
        Session(stage)
    session.close()
    stage.run(0.1)
    with pytest.raises(StageError, match="over"):
        session.do(lambda stage: 1)
    assert not any(thread.name == "pulsestage session" for thread in threading.enumerate())


def test_a_simulation_that_diverges_stands_still_and_says_so_and_one_goes_back(session):
    until(lambda: session.view.time > 0.3)
    session.do(lambda stage: stage.data.qfrc_applied.__setitem__(0, 1e30))
    until(lambda: session.view.trouble)
    assert "diverged" in session.view.trouble
    session.do(lambda stage: stage.data.qfrc_applied.__setitem__(0, 0.0))
    session.back(0.1)
    until(lambda: not session.view.trouble)
    at = session.view.time
    until(lambda: session.view.time > at)


def test_from_a_divergence_one_recovers_where_all_was_well(session):
    until(lambda: session.view.time > 1.0)
    session.do(lambda stage: stage.data.qfrc_applied.__setitem__(0, 1e30))
    until(lambda: session.view.trouble)
    diverged = session.view.time
    then = session.recover()
    assert diverged - 0.7 < then < diverged - 0.4
    assert session.paused
    assert not session.do(lambda stage: stage.data.qfrc_applied[0]), "the force came later than that"
    session.paused = False
    until(lambda: session.view.time > diverged + 0.2)
    assert not session.view.trouble


def test_a_carriage_that_leaves_its_travel_stops_time_and_what_is_under_way(session):
    until(lambda: session.view.time > 1.0)
    jog = session.act("wait", lambda stage: stage.run(1e6))
    until(lambda: session.view.doing)
    session.do(lambda stage: stage.data.qpos.__setitem__(0, -3.0))
    until(lambda: session.view.trouble)
    assert session.view.trouble.startswith(
        "x is out of its travel, at -3000 mm: its end stops are at -158 mm and 158 mm."
    )
    with pytest.raises(Abandoned):
        jog.result(5)
    at = session.view.time
    session.recover()
    assert session.view.time < at - 0.3
    assert not session.view.trouble
    session.paused = False
    until(lambda: session.view.time > at + 0.1)
    assert not session.view.trouble
