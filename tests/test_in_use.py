"""Who may run a stage, and who may not: threads, callbacks, Ctrl-C."""

import copy
import signal
import threading
import time
from contextlib import contextmanager
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from support.programs import start_preset

from stage import Fleet, Program, SimulationError, Stage, StageError
from stage.board import Board
from stage.chips import MCX514, PCL240K
from stage.errors import ArgumentError
from stage.native import COMPILED
from stage.sim import faults, mujoco_callback_guards
from stage.sim import fleet as fleet_module


@pytest.fixture(autouse=True)
def callbacks_of_mujoco():
    yield
    mujoco.set_mjcb_control(None)


def get_state_bits(stage):
    return stage.snapshot().state.tobytes()


# --- threads ---

OPERATIONS = {
    "step": lambda s: s.step(),
    "run": lambda s: s.run(1e-3),
    "run_until": lambda s: s.run_until(lambda: s.time > 0.1, timeout=1),
    "write": lambda s: s.axes["x"].chip.write(0, 0x41),
    "read": lambda s: s.axes["x"].chip.read(0),
    "pin": lambda s: setattr(s.axes["x"].pins, "ins", True),
    "reset pin": lambda s: s.axes["x"].chip.reset(),
    "place": lambda s: s.place(x=0.01),
    "reset": lambda s: s.reset(),
    "snapshot": lambda s: s.snapshot(),
    "stick": lambda s: s.axes["x"].switches.stick("org", True),
    "record": lambda s: s.record(),
}


@pytest.mark.skipif(not COMPILED, reason="uncompiled, threads take turns by themselves")
@pytest.mark.parametrize("direction", OPERATIONS)
def test_a_stage_in_use_says_so_and_stays_as_it_was(xy, direction):
    start_preset(xy.axes["x"].chip, 1000)
    before = get_state_bits(xy)
    with xy.loop.claim(), pytest.raises(StageError, match="in use"):
        OPERATIONS[direction](xy)
    assert get_state_bits(xy) == before
    xy.run(1e-3)


@pytest.mark.skipif(not COMPILED, reason="uncompiled, threads take turns by themselves")
def test_without_bus_time_a_cycle_is_refused_as_well():
    stage = Stage("xy", chips=PCL240K, bus_cycle=0, visuals=False)
    with stage.loop.claim(), pytest.raises(StageError, match="in use"):
        stage.axes["x"].chip.read(0)
    stage.axes["x"].chip.read(0)


def test_two_threads_on_one_stage_do_no_harm(xy):
    """two threads: for _ in range(2000): stage.run(0.001)"""
    texts, left = [], [60, 60]

    def drive(me):
        while left[me]:
            left[me] -= 1
            try:
                xy.axes["x"].chip.write(1, left[me])
                xy.run(0.002)
            except StageError as error:
                texts.append(str(error))

    threads = [threading.Thread(target=drive, args=(k,)) for k in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all("in use" in text for text in texts)
    replica = copy.deepcopy(xy)
    xy.run(0.01)
    replica.run(0.01)
    assert get_state_bits(xy) == get_state_bits(replica)


def test_a_board_has_one_host_at_a_time(xy):
    board = Board(Stage("xy", chips=PCL240K, visuals=False))
    board.link.record["inside"] = 1
    if COMPILED:
        with pytest.raises(StageError, match="one host"):
            board.in8(0x300)
    board.link.record["inside"] = 0
    board.in8(0x300)
    assert board.link.record["inside"] == 0


def test_an_interrupt_hook_may_run_the_stage_inside_a_bus_cycle():
    """Run Python within a bus cycle: an interrupt hook that waits, and a fault that delays a write."""
    stage = Stage("xy", chips=PCL240K, visuals=False)
    board, calls = Board(stage), []

    def hook():
        calls.append(board.in8(0x303))
        stage.run(1e-4)
        stage.axes["x"].chip.write(0, 0x08)  # a reset command, which lets the line go
        stage.snapshot()

    board.on_interrupt(hook)
    with faults.start_skew(stage.axes["x"], 1e-3):
        for value in (0x81, 0x87):
            board.out8(0x300, value)
            for port in (3, 2, 1):
                board.out8(0x300 + port, 0x10)
        board.out8(0x300, 0x40)
        board.out8(0x300, 0x30)  # start, interrupt at stop
        board.delay_us(2000)
        board.out8(0x300, 0x28)  # stop
        board.delay_us(2000)
    assert stage.time > 4e-3
    assert calls


# --- MuJoCo's callbacks ---


def make_failing_control(after):
    left = [after]

    def control(model, data):
        left[0] -= 1
        if left[0] < 0:
            raise ZeroDivisionError("mine")

    return control


def test_a_callback_that_raises_is_a_simulation_error_and_the_stage_as_before_the_step(xy):
    """mujoco.set_mjcb_control(f), f raises: stage.run(0.1) ended the process"""
    start_preset(xy.axes["x"].chip, 1000)
    replica = copy.deepcopy(xy)
    with xy.record() as recording:
        control = make_failing_control(10)
        mujoco.set_mjcb_control(control)
        with pytest.raises(SimulationError, match="ZeroDivisionError: mine") as caught:
            xy.run(0.1)
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    assert mujoco.get_mjcb_control() is control, "it stays where it was set"
    assert len(recording) == 2
    mujoco.set_mjcb_control(None)
    assert caught.value.time == xy.time
    with replica.record():
        replica.run(xy.time - replica.time)
    assert 9 <= xy.state.world[0].steps <= 10
    assert get_state_bits(xy) == get_state_bits(replica)
    xy.run(0.1)
    replica.run(0.1)
    assert get_state_bits(xy) == get_state_bits(replica), "and goes on"


def test_a_callback_that_does_nothing_changes_nothing(xy):
    replica = copy.deepcopy(xy)
    observed = []
    for stage in (xy, replica):
        start_preset(stage.axes["x"].chip, 500)
        stage.run(0.05)
        mujoco.set_mjcb_control(lambda m, d: observed.append(d.time))
    mujoco.set_mjcb_control(None)
    assert len(observed) >= 200
    assert get_state_bits(xy) == get_state_bits(replica)


def test_the_step_timers_of_mujoco_stand_still_until_a_user_starts_them(xy, monkeypatch):
    """mjData.timer: a tenth of a stage's time"""
    replica = copy.deepcopy(xy)
    total = mujoco.mjtTimer.mjTIMER_STEP
    xy.run(0.1)
    assert xy.data.timer[total].number >= 100
    assert xy.data.timer[total].duration == 0
    mujoco.set_mjcb_time(None)
    monkeypatch.delattr(mujoco_callback_guards, "guard_callbacks")  # the clock of the binding needs no guard
    try:
        replica.run(0.1)
        assert replica.data.timer[total].duration > 0
    finally:
        mujoco_callback_guards.stop_step_timers()
    assert get_state_bits(xy) == get_state_bits(replica)
    begin = replica.data.timer[total].duration
    replica.run(0.1)
    assert replica.data.timer[total].duration == begin


MOVED = {
    "place": lambda s, began: s.place(x=0.05),
    "restore": lambda s, began: s.restore(began),
    "reset": lambda s, began: s.reset(),
    "motor": lambda s, began: faults.motor(s.axes["x"], "SS2422-5041"),
}


@pytest.mark.parametrize("direction", MOVED)
def test_a_callback_that_raises_while_the_stage_is_moved_is_a_simulation_error_too_and_nothing_has_changed(
    xy, direction
):
    """mujoco.set_mjcb_control(f), f raises: stage.place(x=0.05) raised a bare ZeroDivisionError, with the carriage at 0.05"""
    began = xy.snapshot()
    xy.run(0.01)
    before, armature = get_state_bits(xy), xy.model.dof_armature.copy()
    observed = xy.data.sensordata.copy(), xy.data.site_xpos.copy()
    mujoco.set_mjcb_control(make_failing_control(0))
    for _ in range(3):
        with pytest.raises(SimulationError, match=r"ZeroDivisionError: mine \(at 0.01.*Nothing has changed") as caught:
            MOVED[direction](xy, began)
        assert isinstance(caught.value.__cause__, ZeroDivisionError)
        assert get_state_bits(xy) == before
        assert np.array_equal(xy.model.dof_armature, armature)
        assert all(np.array_equal(a, b) for a, b in zip((xy.data.sensordata, xy.data.site_xpos), observed, strict=True))
    mujoco.set_mjcb_control(None)
    MOVED[direction](xy, began)
    xy.run(0.01)


def test_ctrl_c_in_a_callback_while_the_stage_is_moved_is_ctrl_c(xy):
    def interrupt_body(model, data):
        raise KeyboardInterrupt

    before = get_state_bits(xy)
    mujoco.set_mjcb_control(interrupt_body)
    with pytest.raises(KeyboardInterrupt):
        xy.place(x=0.05)
    assert get_state_bits(xy) == before


def test_a_callback_that_does_nothing_places_the_carriage_where_it_would_be(xy):
    replica, observed = copy.deepcopy(xy), []
    replica.place(x=0.05)
    mujoco.set_mjcb_control(lambda m, d: observed.append(d.qpos[0]))
    xy.place(x=0.05)
    mujoco.set_mjcb_control(None)
    assert observed == [0.05]
    assert get_state_bits(xy) == get_state_bits(replica)


@pytest.mark.parametrize("name", mujoco_callback_guards.CALLBACK_NAMES)
def test_every_callback_is_guarded(xy, name):
    def fail(*_):
        raise KeyError(name)

    before = getattr(mujoco, f"get_mjcb_{name}")()
    getattr(mujoco, f"set_mjcb_{name}")(fail)
    try:
        if name in ("passive", "control", "time"):
            with pytest.raises(SimulationError) as caught:
                xy.run(0.002)
            assert isinstance(caught.value.__cause__, KeyError)
        else:  # this model does not ask for it
            xy.run(0.002)
    finally:
        getattr(mujoco, f"set_mjcb_{name}")(before)


@pytest.mark.skipif(not COMPILED, reason="uncompiled, the stage may be run from within")
def test_a_callback_that_runs_the_stage_it_is_called_by_is_refused(xy):
    mujoco.set_mjcb_control(lambda m, d: xy.run(1e-3))
    with pytest.raises(SimulationError) as caught:
        xy.run(0.01)
    assert "in use" in str(caught.value.__cause__)


def test_ctrl_c_in_a_callback_is_ctrl_c(xy):
    def control(model, data):
        raise KeyboardInterrupt

    mujoco.set_mjcb_control(control)
    with pytest.raises(KeyboardInterrupt):
        xy.run(0.01)
    mujoco.set_mjcb_control(None)
    xy.run(0.01)


def test_a_fleet_and_a_board_report_a_callback_that_raises(xy):
    fleet, board = Fleet([copy.deepcopy(xy) for _ in range(3)], 2), Board(Stage("xy", chips=PCL240K, visuals=False))
    for work in (lambda: fleet.play([Program().wait(0.01)] * 3), lambda: board.delay_us(10_000)):
        mujoco.set_mjcb_control(make_failing_control(5))
        with pytest.raises(SimulationError, match="mine"):
            work()
        mujoco.set_mjcb_control(None)
        work()
    fleet.close()


# --- Ctrl-C ---

needs_timers = pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers here")
in_pieces = pytest.mark.skipif(not COMPILED, reason="uncompiled, a piece between two looks takes seconds")


@contextmanager
def interrupt_body(after=0.2):
    """Raise KeyboardInterrupt `after` seconds in the body, and check that it ends within 5 s."""

    def interrupt(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    began = time.monotonic()
    try:
        signal.setitimer(signal.ITIMER_REAL, after)
        with pytest.raises(KeyboardInterrupt):
            yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert time.monotonic() - began < 5


@needs_timers
@pytest.mark.parametrize("recorded", [False, True])
def test_ctrl_c_ends_a_long_run_and_the_stage_continues(xy, recorded):
    """stage.run(1e6)
    Ctrl-C."""
    start_preset(xy.axes["x"].chip, 20000)
    replica, recording = copy.deepcopy(xy), xy.record() if recorded else None
    with interrupt_body():
        xy.run(1e6)
    xy.run(0.01)
    if recording is not None:
        recording.close()
        assert np.diff(recording.columns["time"]) == pytest.approx(1e-3), "not a sample is lost"
        recording.require_forward_time()
        replica.record()
    replica.run(xy.time - replica.time)
    assert get_state_bits(xy) == get_state_bits(replica)


LONG = {
    "wait": Program().wait(1e6),
    "measure": Program().measure(1e6),
    "stop": Program().until_stopped([1], 1e6).until_stopped([0], 1e6, poll=1e3).wait(1e6),
}


@needs_timers
@in_pieces
@pytest.mark.parametrize(("threads", "n"), [(1, 1), (2, 3)])
@pytest.mark.parametrize("what", LONG)
def test_ctrl_c_ends_a_long_program_of_a_fleet_and_its_stages_continue(what, threads, n):
    """Fleet([Stage("xyz")], 1).play([Program().wait(1000)])
    Ctrl-C: it had not ended after 40 s."""
    fleet = Fleet([Stage("xy", visuals=False) for _ in range(n)], threads)
    for stage in fleet.stages:
        start_preset(stage.axes["x"].chip, 20000)
    replica = copy.deepcopy(fleet.stages[0])
    with interrupt_body():
        fleet.play([LONG[what]] * n)
    assert 0.1 < fleet.stages[0].time < 1e6
    before = [stage.now for stage in fleet.stages]
    fleet.play([Program().wait(0.01)] * n)  # shorter than what is looked for Ctrl-C
    assert [stage.now for stage in fleet.stages] == [now + 10_000_000 for now in before]
    fleet.play([Program().wait(0.25)] * n)
    if what == "wait":
        replica.run(fleet.stages[0].time - replica.time)
        assert get_state_bits(fleet.stages[0]) == get_state_bits(replica)
    fleet.close()


@needs_timers
@in_pieces
def test_a_second_ctrl_c_leaves_a_fleet_that_plays_on(monkeypatch):
    """Fleet([Stage("xyz")], 1).play([Program().wait(1000)])
    Ctrl-C Ctrl-C: nobody waits any more for what plays."""
    fleet, slept = Fleet([Stage("xy", visuals=False) for _ in range(3)], 2), []

    def interrupted_once(seconds):
        slept.append(seconds)
        if len(slept) == 1:
            raise KeyboardInterrupt
        time.sleep(seconds)

    monkeypatch.setattr(fleet_module, "time", SimpleNamespace(sleep=interrupted_once))
    with interrupt_body():
        fleet.play([Program().wait(1e6)] * 3)
    began = [stage.now for stage in fleet.stages]
    fleet.play([Program().wait(0.01)] * 3)
    assert all(stage.now >= now + 10_000_000 for stage, now in zip(fleet.stages, began, strict=True))
    fleet.close()


@in_pieces
def test_another_thread_does_not_end_what_the_main_thread_plays():
    """Thread(target=lambda: fleet.play([Program().wait(0.001)])).start(); fleet.play([Program().wait(5)])"""
    fleet, refused = Fleet([Stage("xy", visuals=False)], 1), []

    def plays_too():
        while fleet.stages[0].time == 0:
            time.sleep(0.001)
        try:
            fleet.play([Program().wait(0.001)])
        except StageError as error:
            refused.append(error)

    thread = threading.Thread(target=plays_too)
    thread.start()
    fleet.play([Program().wait(5)])
    thread.join()
    assert len(refused) in (0, 1), "0: it came when the other was over"
    assert fleet.stages[0].now == 5_000_000_000 + (0 if refused else 1_000_000)


@needs_timers
@in_pieces
def test_ctrl_c_ends_a_long_delay_of_a_board_and_its_stage_continues(xy):
    """Board(Stage("xyz")).delay_us(10**9)
    Ctrl-C: it had not ended after 40 s."""
    board, replica = Board(xy), copy.deepcopy(xy)
    with interrupt_body():
        board.delay_us(10**12)
    assert 0.1 < xy.time < 1e6
    board.delay_us(250_000)
    replica.run(xy.time - replica.time)
    assert get_state_bits(xy) == get_state_bits(replica)


def test_a_long_delay_is_as_long_as_it_says_whatever_hooks_take_of_it(xy):
    """board.on_timer(100_000, lambda: board.delay_us(60_000)); board.delay_us(250_000)
    It ends 250 ms later, or with the hook that is running then."""
    for us, ends in ((250_000, 260_000_000), (999_999.0, 999_999_000)):
        board, replica = Board(copy.deepcopy(xy)), copy.deepcopy(xy)
        board.on_timer(100_000, lambda board=board: board.delay_us(60_000))
        board.delay_us(us)
        assert board.stage.now == ends
        replica.run_to(board.stage.now)
        assert get_state_bits(board.stage) == get_state_bits(replica)


# --- indices ---


@pytest.mark.parametrize("axis", [4, -1, 10**8, 1.0, True])
def test_a_journal_is_of_an_axis_that_the_chip_has(axis):
    """MCX514().journal(4).replay_waveforms() read foreign memory, journal(10**8) ended the process"""
    chip = MCX514()
    with pytest.raises(ArgumentError, match="axes 0 to 3"):
        chip.journal(axis)
    with pytest.raises(ArgumentError, match="axes 0 to 3"):
        chip.net(axis)
    with pytest.raises(ArgumentError, match="one axis, 0"):
        PCL240K().journal(1)


def test_a_callback_that_removes_itself_stays_removed_and_another_is_restored(xy):
    def control(model, data):
        mujoco.set_mjcb_control(None)

    def passive(model, data):
        pass

    mujoco.set_mjcb_control(control)
    mujoco.set_mjcb_passive(passive)
    try:
        xy.run(0.002)
        assert mujoco.get_mjcb_control() is None
        assert mujoco.get_mjcb_passive() is passive
    finally:
        mujoco.set_mjcb_control(None)
        mujoco.set_mjcb_passive(None)
