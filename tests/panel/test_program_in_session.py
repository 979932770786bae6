"""A program drives a stage that lives in a session: its run is that without one, and it waits while the session has the stage."""

import threading
import time

import numpy as np
import pytest
from support.waiting import wait_until

from stage import Stage, firmware
from stage.errors import StageError
from stage.panel.session import UNPACED_SPEED, ActionStopped, Session
from stage.panel.stage_observer import BusTrace


def program(stage):
    """Use a stage as a program of a user does."""
    x = stage.axes["x"]
    firmware.move(x, distance=0.002)
    x.chip.write(0, 0x81)
    stage.run(0.01)
    return stage.snapshot().state


@pytest.fixture
def session():
    with Session(Stage("xy", visuals=False), speed=UNPACED_SPEED, program="a test") as session:
        yield session


class Driver(threading.Thread):
    """A program in a thread of its own; result() waits for it."""

    def __init__(self, what):
        super().__init__(daemon=True)
        self._what, self._found = what, None
        self.start()

    def run(self):
        self._found = self._what()

    def result(self, seconds=20.0):
        self.join(seconds)
        assert not self.is_alive()
        return self._found


def test_its_run_is_that_without_a_session_whatever_is_looked_at_meanwhile(session):
    expected = program(Stage("xy", visuals=False))
    looked = threading.Event()
    driver = Driver(lambda: (looked.wait(20), program(session.stage))[1])
    while driver.is_alive():
        session.do(lambda stage: stage.axes["x"].position)
        looked.set()
    assert np.array_equal(driver.result(), expected)


def test_no_time_passes_but_by_the_program_and_it_is_in_real_time(session):
    begin = time.monotonic()
    session.speed = 1.0
    time.sleep(0.05)
    assert session.do(lambda stage: stage.now) == 0
    session.stage.run(0.2)  # from this very thread
    assert time.monotonic() - begin > 0.17  # it catches up with what it was late, and goes ahead by a slice
    assert session.stage.time == 0.2
    wait_until(lambda: session.view.time == 0.2)


def test_a_suspended_program_waits_and_then_continues(session):
    stage = session.stage
    session.suspend_program()
    wait_until(lambda: session.view.time > 0.05)  # the session lets time pass
    driver = Driver(lambda: program(stage))
    wait_until(lambda: session.program_waits)
    at = session.do(lambda stage: stage.axes["x"].commanded)
    move = session.act("move", lambda stage: firmware.move(stage.axes["y"], distance=0.001)).result(20)
    assert move.ok
    assert session.do(lambda stage: stage.axes["x"].commanded) == pytest.approx(at, abs=1e-9)
    assert driver.is_alive()
    session.resume_program()
    driver.result()
    assert stage.axes["x"].commanded == pytest.approx(at + 0.002)
    assert not session.program_waits
    at = session.do(lambda stage: stage.now)
    time.sleep(0.03)
    assert session.do(lambda stage: stage.now) == at


def test_a_program_may_call_its_session_while_the_session_drives(session):
    stage = session.stage
    stage.run(0.001)
    session.suspend_program()
    assert session.do(lambda stage: stage.axes["x"].position) == pytest.approx(0.0)
    requested = []
    driver = Driver(
        lambda: stage.run_until(lambda: requested.append(session.do(lambda s: s.time)) or len(requested) > 2, 1.0)
    )
    wait_until(lambda: session.program_waits)
    session.resume_program()
    driver.result()
    assert len(requested) == 3


def test_a_paused_session_lets_no_time_pass(session):
    session.paused = True
    driver = Driver(lambda: session.stage.run(0.05))
    time.sleep(0.05)
    assert session.stage.now == 0
    session.paused = False
    driver.result()
    assert session.stage.time == 0.05


@pytest.mark.parametrize("end", ["close", "dismiss"])
def test_a_program_that_waits_is_let_go_at_the_end(session, end):
    session.suspend_program()
    wait_until(lambda: session.view.time > 0)
    driver = Driver(lambda: session.stage.axes["x"].chip.read(0) if end == "close" else session.catch_up())
    wait_until(lambda: session.program_waits)
    getattr(session, {"close": "close", "dismiss": "detach_program"}[end])()
    driver.result()


@pytest.mark.parametrize("state", ["runs", "paused", "taken over"])
def test_a_program_that_is_to_end_does_at_once_whatever_it_waits_for(session, state):
    session.speed = 1.0
    if state == "taken over":
        session.suspend_program()
        wait_until(lambda: session.view.time > 0)
    session.paused = state == "paused"
    end_times = []

    def drive():
        try:
            session.stage.run(600.0)
        except ActionStopped:
            end_times.append(time.monotonic())

    driver = Driver(drive)
    time.sleep(0.05)
    begin = time.monotonic()
    session.end_program()
    driver.result(5)
    assert end_times
    assert end_times[0] - begin < 2


def test_dismissed_it_is_refused_and_the_session_lets_time_pass(session):
    session.stage.run(0.001)
    session.detach_program()
    wait_until(lambda: session.view.time > 0.05)
    with pytest.raises(StageError, match="lives in a session"):
        session.stage.run(0.01)


def test_no_bus_cycle_is_cut_into(session):
    """Thousands of cycles, while the session looks as often as it can: the trace has each, in order."""
    trace = session.do(lambda stage: BusTrace(stage.chips[0]))
    x, sent, observers = session.stage.axes["x"], [], []

    def drive():
        while len(sent) < 3000 or (len(observers) < 10 and len(sent) < 1_000_000):  # a machine at work looks seldom
            sent.append(len(sent) & 0xFF)
            x.chip.write(3, sent[-1])

    driver = Driver(drive)
    while driver.is_alive():
        observers.append(session.do(lambda stage: trace.add_new_entries()))
    session.do(lambda stage: trace.add_new_entries())
    assert len(observers) >= 10
    assert trace.lines[-1].number == len(sent)
    assert [line.datum for line in trace.lines] == sent[-len(trace.lines) :]
