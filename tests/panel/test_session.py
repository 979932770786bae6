"""A session: a stage in real time takes orders, is the stage that it would be without, and says what it refuses."""

import threading
import time
from concurrent.futures import TimeoutError as Late

import numpy as np
import pytest
from support.waiting import wait_until

from stage import Stage, firmware
from stage.errors import ArgumentError, StageError
from stage.panel.session import RECOVERY_S, UNPACED_SPEED, ActionStopped, Session
from stage.panel.snapshot_history import INTERVAL_S
from stage.panel.stage_thread import MAX_UNPACED_NS

PAUSED = pytest.mark.parametrize("session", [{"paused": True}], indirect=True, ids=["paused"])
PAUSED_IN_REAL_TIME = pytest.mark.parametrize("session", [{"paused": True, "speed": 1.0}], indirect=True, ids=["1 x"])


@pytest.fixture
def session(request):
    """Session of xy, as fast as it goes; PAUSED and PAUSED_IN_REAL_TIME begin otherwise."""
    with Session(Stage("xy", visuals=False), **{"speed": UNPACED_SPEED} | getattr(request, "param", {})) as session:
        yield session


def run_unpaced(session, seconds, times=1):
    """Let simulated time pass as fast as it goes, and remember each of the ends."""
    for _ in range(times):
        session.do(lambda stage: session.run_unpaced(stage.run, seconds))
        session.do(lambda stage: session._history.take_snapshot_if_due(stage))


def test_time_passes_without_a_program_except_while_paused(session):
    wait_until(lambda: session.view.time > 0.1)
    session.paused = True
    before = session.do(lambda stage: stage.now)
    time.sleep(0.05)
    assert session.do(lambda stage: stage.now) == before
    session.run_physics_steps(3)
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
    with Session(Stage("xy", visuals=False), speed=UNPACED_SPEED, paused=True) as session:
        future = session.act("move", lambda stage: firmware.move(stage.axes["x"], distance=0.002))
        assert not future.done()
        session.paused = False
        wait_until(lambda: session.do(lambda stage: future.done()) or session.view.action == "move")
        report = future.result(20)
        session.paused = True
    assert str(report) == str(expected)


def test_orders_are_carried_out_while_a_procedure_runs(session):
    session.speed = 1.0
    future = session.act("move", lambda stage: firmware.move(stage.axes["x"], distance=0.05))
    wait_until(lambda: session.view.action == "move")
    assert session.do(lambda stage: stage.axes["x"].chip.busy(0))
    assert not future.done()
    assert session.stop_actions()
    with pytest.raises(ActionStopped):
        future.result(5)
    assert session.do(lambda stage: stage.axes["x"].chip.busy(0)), "the chip goes on with what it does"


def test_the_same_future_follows_after_going_back(session):
    wait_until(lambda: session.view.time > 0.3)
    session.paused = True
    was = session.do(lambda stage: stage.now)
    assert session.history_s >= 0.2
    then = session.go_back(0.2)
    assert then <= was * 1e-9 - 0.2 + 1e-9
    assert then >= was * 1e-9 - 0.3
    assert session.do(lambda stage: stage.time) == then

    def on(stage):
        session.run_unpaced(stage.run_to, was)
        return stage.snapshot().state

    assert np.array_equal(session.do(on), session.do(lambda stage: (session.go_back(0.2), on(stage))[1]))
    session.reset()
    assert session.do(lambda stage: stage.now) == 0


def test_time_resumes_at_once_after_power_up(session):
    """And an action begins, whatever the time was before."""
    wait_until(lambda: session.view.time > 20)
    session.speed = 1.0
    session.reset()
    wait_until(lambda: session.view.time > 0.05, 5)
    assert session.act("move", lambda stage: firmware.move(stage.axes["x"], distance=0.0005)).result(5).ok


def test_restoring_a_snapshot_sets_its_time(session):
    wait_until(lambda: session.view.time > 0.3)
    session.paused = True
    then = session.go_back(0.1)
    assert session.go_back(0.0) == then


def test_after_a_reset_history_reaches_back_to_power_up(session):
    wait_until(lambda: session.view.time > 0.5)
    session.paused = True
    session.reset()
    session.do(lambda stage: stage.place(x=0.05))
    session.paused = False
    wait_until(lambda: session.view.time > 0.3)
    session.paused = True
    session.go_back(0.1)
    assert session.view.time > 0.1
    assert session.do(lambda stage: stage.axes["x"].position) == pytest.approx(0.05, abs=1e-4)


def test_going_back_during_a_recording_is_refused():
    """stage.run(1); then a panel, paused; power-up; a recording; back: nothing happened, and nobody was told"""
    stage = Stage("xy", visuals=False)
    stage.run(1.0)
    with Session(stage, speed=UNPACED_SPEED) as session:
        session.paused = True
        session.reset()
        with session.do(lambda stage: stage.record()), pytest.raises(StageError, match="close the recording"):
            session.go_back(5.0)
        assert session.go_back(5.0) == 0.0


def test_no_step_follows_a_single_step_until_time_is_resumed(session):
    session.run_physics_steps()
    assert session.paused


def test_an_order_at_the_end_of_the_session_gets_an_error():
    session, delayed = Session(Stage("xy", visuals=False), paused=True), []

    def ends(stage):
        if not delayed:
            delayed.append(session.post(lambda stage: stage.now))
            session.close()

    session.do(lambda stage: session.call_after_pacing_intervals(ends))
    wait_until(lambda: delayed)  # the observers are called after the order has its result
    with pytest.raises(StageError, match="this session is over"):
        delayed[0].result(10)


def test_an_error_of_an_order_comes_to_who_gave_it(session):
    with pytest.raises(ArgumentError, match="unknown axis"):
        session.do(lambda stage: stage.place(q=1))
    with pytest.raises(ZeroDivisionError):
        session.act("wrong", lambda stage: 1 / 0).result(5)
    wait_until(lambda: session.view.time > 0)


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


def test_a_divergence_pauses_the_session_which_can_recover(session):
    wait_until(lambda: session.view.time > 0.3)
    session.do(lambda stage: stage.data.qfrc_applied.__setitem__(0, 1e30))
    wait_until(lambda: session.view.trouble)
    assert "diverged" in session.view.trouble
    session.do(lambda stage: stage.data.qfrc_applied.__setitem__(0, 0.0))
    session.go_back(0.1)
    wait_until(lambda: not session.view.trouble)
    at = session.view.time
    wait_until(lambda: session.view.time > at)


def test_from_a_divergence_one_recovers_where_all_was_well(session):
    wait_until(lambda: session.view.time > 1.0)
    session.do(lambda stage: stage.data.qfrc_applied.__setitem__(0, 1e30))
    wait_until(lambda: session.view.trouble)
    diverged = session.view.time
    then = session.recover()
    assert diverged - 0.7 < then < diverged - 0.4
    assert session.paused
    assert not session.do(lambda stage: stage.data.qfrc_applied[0]), "the force came later than that"
    session.paused = False
    wait_until(lambda: session.view.time > diverged + 0.2)
    assert not session.view.trouble


def test_a_carriage_that_leaves_its_travel_stops_time_and_the_action(session):
    wait_until(lambda: session.view.time > 1.0)
    jog = session.act("wait", lambda stage: stage.run(1e6))
    wait_until(lambda: session.view.action)
    session.do(lambda stage: stage.data.qpos.__setitem__(0, -3.0))
    wait_until(lambda: session.view.trouble)
    assert session.view.trouble.startswith(
        "x is out of its travel, at -3000 mm: its end stops are at -158 mm and 158 mm."
    )
    with pytest.raises(ActionStopped):
        jog.result(5)
    at = session.view.time
    session.recover()
    assert session.view.time < at - 0.3
    assert not session.view.trouble
    session.paused = False
    wait_until(lambda: session.view.time > at + 0.1)
    assert not session.view.trouble


@PAUSED
def test_a_paused_session_answers_orders_at_once(session):
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
        wait_until(lambda: session.view.action == "wait")
        assert session.stop_actions()
        with pytest.raises(ActionStopped):
            move.result(5)
    assert time.monotonic() - begin < 1.2
    begin = time.monotonic()
    for _ in range(4):
        at = session.do(lambda stage: stage.time)
        time.sleep(0.02)
        session.paused = False
        wait_until(lambda a=at: session.view.time > a)
        session.paused = True
    assert time.monotonic() - begin < 1.2


@PAUSED
def test_an_order_is_awaited_for_the_given_timeout(session):
    with pytest.raises(Late):
        session.do(lambda stage: time.sleep(0.15), timeout=0.01)
    assert session.do(lambda stage: 5, timeout=5) == 5


@PAUSED
def test_within_an_order_another_is_done_at_once(session):
    observed = []
    session.do(lambda stage: (observed.append(1), session.do(lambda stage: observed.append(2)), observed.append(3)))
    assert observed == [1, 2, 3]


@PAUSED
def test_a_stage_has_one_session_at_a_time(session):
    with pytest.raises(StageError, match="this stage has a session already: close that one first"):
        Session(session.stage)
    assert session.do(lambda stage: stage.now) == 0
    session.close()
    with Session(session.stage, paused=True) as again:
        assert again.do(lambda stage: stage.now) == 0


def test_the_worker_may_close_the_session():
    session = Session(Stage("xy", visuals=False), speed=UNPACED_SPEED)
    session.post(lambda stage: session.close()).result(5)
    session._thread.join(5)
    assert not session._thread.is_alive()
    assert session.stage.loop.pace is None
    with pytest.raises(StageError, match="this session is over"):
        session.do(lambda stage: None)


@PAUSED
def test_the_requested_number_of_steps_passes(session):
    dt = session.stage.state.dt
    session.paused = False
    for n, arguments in ((1, ()), (4, (4,))):
        session.paused = True
        at = session.do(lambda stage: stage.now)
        session.run_physics_steps(*arguments)
        assert session.paused
        assert session.do(lambda stage: stage.now) == (at // dt + n) * dt
        session.paused = False
        wait_until(lambda a=at: session.view.time * 1e9 > a + 10 * dt)


@PAUSED
@pytest.mark.parametrize("seconds", [-1, -1e-9, float("nan")])
def test_going_back_by_a_negative_time_is_refused(session, seconds):
    with pytest.raises(ArgumentError, match=rf"^go_back\({seconds!r}\): seconds, 0 or more\.$"):
        session.go_back(seconds)


@PAUSED
def test_going_back_restores_the_previous_snapshot_and_forgets_later_ones(session):
    run_unpaced(session, INTERVAL_S, 12)
    at = session.do(lambda stage: stage.time)
    assert session.history_s == pytest.approx(at - INTERVAL_S)
    then = session.go_back(2.5 * INTERVAL_S)
    assert then == pytest.approx(at - 3 * INTERVAL_S) == session.do(lambda stage: stage.time)
    assert session.history_s == pytest.approx(then - INTERVAL_S)
    assert session.go_back(0) == then, "to where it is, which is remembered"
    assert session.go_back(1e3) == pytest.approx(INTERVAL_S), "as far as it goes"


@PAUSED
def test_recovery_goes_back_half_a_second_and_pauses(session):
    run_unpaced(session, INTERVAL_S, 16)
    at = session.do(lambda stage: stage.time)
    session._trouble = "something"
    session.paused = False
    assert session.recover() == pytest.approx(at - RECOVERY_S)
    assert session.paused
    assert session._trouble == ""


@PAUSED
@pytest.mark.parametrize("how", ["back", "reset", "restore", "recover"])
def test_restoring_a_time_ends_the_action(session, how):
    saved = session.do(lambda stage: stage.snapshot())
    session.paused = False
    move = session.act("wait", lambda stage: stage.run(1e6))
    wait_until(lambda: session.view.action == "wait" and session.view.time > 0)
    {"back": lambda: session.go_back(0.0), "reset": session.reset, "restore": lambda: session.restore(saved),
     "recover": session.recover}[how]()  # fmt: skip
    with pytest.raises(ActionStopped):
        move.result(5)
    wait_until(lambda: not session.busy)


def test_a_session_without_a_program_suspends_nothing():
    with Session(Stage("xy", visuals=False), speed=UNPACED_SPEED, paused=True) as session:
        session.suspend_program()
        assert not session.program_suspended
        assert not session.program_waits
    with Session(Stage("xy", visuals=False), speed=UNPACED_SPEED, paused=True, program="mine") as session:
        assert (session.program, session.program_suspended) == ("mine", False)
        session.suspend_program()
        assert session.program_suspended
        session.paused = False
        move = session.act("wait", lambda stage: stage.run(1e6))
        wait_until(lambda: session.view.action == "wait")
        session.resume_program()
        assert not session.program_suspended
        with pytest.raises(ActionStopped):
            move.result(5)
        session.suspend_program()
        session.detach_program()
        assert (session.program, session.program_suspended) == ("", False)


def test_a_program_that_lets_time_pass_otherwise_waits_for_real_time():
    stage = Stage("xy", visuals=False)
    with Session(stage, speed=0.2, program="a board") as session:
        session.catch_up()
        assert session.catch_up_interval_s == pytest.approx(0.02 * 0.2)
        begin = time.monotonic()
        session._clock.restart(stage.now - 20_000_000)  # 20 ms too far, which take 0.1 s
        session.catch_up()
        assert 0.08 < time.monotonic() - begin < 1
        assert stage.now == 0, "it waits, and lets nothing pass"


def assert_time_goes_on(session):
    """Assert that time continues from its present value at once, and in real time."""
    at = session.do(lambda stage: stage.time)
    begin = time.monotonic()
    session.paused = False
    wait_until(lambda: session.view.time > at + 0.03, 1.5)
    passed = session.view.time - at
    assert passed <= time.monotonic() - begin + 0.05
    session.paused = True


@PAUSED_IN_REAL_TIME
def test_real_time_resumes_after_an_unpaced_order(session):
    run_unpaced(session, 4.0)
    assert_time_goes_on(session)

    def fails(stage):
        stage.run(4.0)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        session.do(lambda stage: session.run_unpaced(fails, stage))
    assert session.do(lambda stage: stage.time) > 8
    assert_time_goes_on(session)


@PAUSED_IN_REAL_TIME
def test_time_continues_at_once_from_a_restored_snapshot(session):
    first = session.do(lambda stage: stage.snapshot())
    run_unpaced(session, 4.0)
    later = session.do(lambda stage: stage.snapshot())
    session.restore(first)
    session.paused = False
    wait_until(lambda: session.view.time > 0.02)
    for then, at in ((later, 4.0), (first, 0.0)):
        session.restore(then)  # time passes, and goes on doing so
        begin = time.monotonic()
        wait_until(lambda now=at: now + 0.03 < session.view.time < now + 2, 1.5)
        assert session.view.time - at <= time.monotonic() - begin + 0.2


@PAUSED_IN_REAL_TIME
def test_the_view_includes_a_finished_order(session):
    """Threads that wait for `changed` are notified when the view has the effect of the order."""
    wait_until(lambda: session.do(lambda stage: True))
    number, reported = session.view.number, threading.Event()

    def wait():
        with session.changed:
            session.changed.wait_for(lambda: session.view.qpos[0] > 0.009, 5)
        reported.set()

    waiting = threading.Thread(target=wait)
    waiting.start()
    session.do(lambda stage: stage.place(x=0.01))
    assert reported.wait(5)
    waiting.join()
    assert session.view.number > number
    assert session.view.qpos[0] == pytest.approx(0.01)


@PAUSED_IN_REAL_TIME
def test_an_action_pauses_and_ends_when_it_is_stopped(session):
    move = session.act("move", lambda stage: firmware.move(stage.axes["x"], distance=0.05))
    wait_until(lambda: session.view.action == "move")
    session.do(lambda stage: None)
    at = session.do(lambda stage: stage.now)
    assert at < 1_000_000, "bus cycles take their time"
    assert session.do(lambda stage: stage.now) == at
    assert session.busy
    assert session.stop_actions()
    with pytest.raises(ActionStopped):
        move.result(5)
    wait_until(lambda: session.view.action == "")
    assert not session.stop_actions(), "none is under way"


@PAUSED_IN_REAL_TIME
def test_trouble_remains_until_time_is_resumed_or_restored(session):
    def diverge(stage):
        stage.data.qfrc_applied[0] = 1e30

    for end in ("unpause", "reset"):
        session.do(diverge)
        session.paused = False
        wait_until(lambda: "diverged" in session.view.trouble)
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
        wait_until(lambda: not session.view.trouble and session.view.time > 0)
        session.reset()


def test_another_thread_may_give_short_orders_and_is_otherwise_refused():
    stage = Stage("xy", visuals=False)
    with Session(stage, speed=UNPACED_SPEED, program="a test") as session:
        stage.run(0.01)
        session._ending = True
        at = stage.now
        stage.run_to(at + MAX_UNPACED_NS // 2)
        assert stage.now == at + MAX_UNPACED_NS // 2, "a bus cycle ends"
        with pytest.raises(ActionStopped, match="the program ends"):
            stage.run(0.01)
        session._ending = False
        stage.run(0.01)
        session.detach_program()
        with pytest.raises(StageError, match="lives in a session"):
            stage.run(0.01)
    stage.run(0.01)


def test_trouble_that_a_program_has_ended_is_forgotten():
    stage = Stage("xy", visuals=False)
    with Session(stage, speed=UNPACED_SPEED, program="a test") as session:
        session.do(lambda stage: stage.data.qpos.__setitem__(0, -3.0))
        wait_until(lambda: session.view.trouble.startswith("x is out of its travel"))
        session.do(lambda stage: stage.place(x=0.0))
        wait_until(lambda: not session.view.trouble)


def test_a_programs_last_change_is_observed_and_in_the_history():
    stage = Stage("xy", visuals=False)
    with Session(stage, speed=UNPACED_SPEED, program="a test") as session:
        stage.run(0.2)
        wait_until(lambda: session.view.time == pytest.approx(0.2))
        assert session.history_s >= 0
        stage.run(0.2)
        wait_until(lambda: session.view.time == pytest.approx(0.4))
        then = session.go_back(0.1)
        assert then <= 0.3
        assert session.do(lambda stage: stage.time) == then
        assert stage.loop.pace is not None
    assert stage.loop.pace is None


@PAUSED_IN_REAL_TIME
def test_a_new_speed_holds_from_its_setting_on(session):
    session.speed = 0.001
    session.paused = False
    time.sleep(0.03)
    assert session.view.time < 0.01
    session.speed = UNPACED_SPEED
    wait_until(lambda: session.view.time > 1.0)
    session.speed = 1.0
    at, begin = session.view.time, time.monotonic()
    time.sleep(0.05)
    assert session.view.time - at <= time.monotonic() - begin + 0.1
