"""Many threads share a stage: none is cut into, none starves, nothing deadlocks; stop and pause act at once in every procedure."""

import random
import threading
import time

import pytest
from support.examples import SEED

from stage import Stage, firmware
from stage.chips.journal_entries import WRITE
from stage.errors import ArgumentError, StageError
from stage.firmware.driver import get_driver
from stage.panel.real_time_clock import PACING_INTERVAL_S
from stage.panel.session import UNPACED_SPEED, ActionStopped, Session

MAX_WAIT_S = 10.0  # for one call, on a machine at work: a deadlock is for ever


class User(threading.Thread):
    """Does something to the stage again and again until `end`, and counts it; keeps the longest wait for a read, s."""

    def __init__(self, number, session, seed, end):
        super().__init__(daemon=True)
        self.number, self.session, self.end = number, session, end
        self.dice = random.Random(seed * 1000 + number)
        self.done = dict.fromkeys(("read", "move", "stop", "look", "write"), 0)
        self.longest, self.failed = 0.0, None
        self.start()

    def run(self):
        try:
            while not self.end.is_set():
                what = self.dice.choices(list(self.done), (6, 1, 1, 3, 4))[0]
                begin = time.monotonic()
                try:
                    getattr(self, f"_do_{what}")(self.session.stage)
                except ActionStopped:
                    pass
                except StageError as error:  # another thread moves this axis, or has stopped it
                    if "lives in a session" in str(error):
                        raise
                if what != "move":
                    self.longest = max(self.longest, time.monotonic() - begin)
                self.done[what] += 1
        except BaseException as error:
            self.failed = error

    def _axis(self, stage):
        return stage.axes[self.dice.choice("xy")]

    def _do_read(self, stage):
        self._axis(stage).chip.read(0)

    def _do_look(self, stage):
        self.session.do(lambda stage: stage.axes["x"].position, MAX_WAIT_S)

    def _do_write(self, stage):
        """A number of several bytes, as a driver writes it; it must come back whole."""
        chip = self._axis(stage).chip
        with stage.lock:
            value = self.dice.randrange(1, 8000)
            for cycle in chip.register_cycles("R1", value):
                chip.write(*cycle)
            assert chip.axis_values(0)["R1"] == value

    def _do_move(self, stage):
        firmware.move(self._axis(stage), self.dice.choice((-1, 1)) * 5e-4)

    def _do_stop(self, stage):
        firmware.stop(self._axis(stage), self.dice.random() < 0.5)


class CommandingUser(User):
    """User that gives orders: the session has the stage alone."""

    def _do_read(self, stage):
        self.session.do(super()._do_read, MAX_WAIT_S)

    def _do_write(self, stage):
        self.session.do(super()._do_write, MAX_WAIT_S)

    def _do_move(self, stage):
        axis, distance = self._axis(stage).name, self.dice.choice((-1, 1)) * 5e-4
        self.session.act("move", lambda stage: firmware.move(stage.axes[axis], distance)).result(MAX_WAIT_S)

    def _do_stop(self, stage):
        self.session.stop(self.dice.random() < 0.5).result(MAX_WAIT_S)


def share(kind, seconds, seed):
    """Eight threads for so many seconds, while somebody pauses, takes over and goes back; the threads."""
    print(f"PULSESTAGE_SEED={seed}")
    dice, end = random.Random(seed), threading.Event()
    with Session(
        Stage("xy", visuals=False), speed=UNPACED_SPEED, program="eight threads" if kind is User else ""
    ) as session:
        users = [kind(k, session, seed, end) for k in range(8)]
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            time.sleep(dice.uniform(0.02, 0.1))
            what = dice.choice(("pause", "take over", "nothing"))
            if what == "pause":
                session.paused = True
                time.sleep(0.02)
                session.paused = False
            elif what == "take over" and kind is User:
                session.suspend_program()
                session.do(lambda stage: stage.axes["x"].chip.read(0), MAX_WAIT_S)
                session.resume_program()
        end.set()
        for user in users:
            user.join(MAX_WAIT_S)
        stuck = [user.number for user in users if user.is_alive()]
        assert not stuck, f"threads {stuck} have not come back"
    for user in users:
        if user.failed is not None:
            raise user.failed
    for user in users:
        print(user.number, user.done, f"longest wait {user.longest * 1e3:.1f} ms")
    return users


@pytest.mark.parametrize("kind", [User, CommandingUser])
def test_eight_threads_that_read_move_and_stop_at_random_neither_deadlock_nor_starve(kind):
    users = share(kind, 0.8, SEED)
    assert all(sum(user.done.values()) > 5 for user in users)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [User, CommandingUser])
def test_eight_threads_share_a_stage_for_a_minute(kind):
    users = share(kind, 60.0, SEED)
    counts = [sum(user.done.values()) for user in users]
    assert min(counts) > max(counts) / 4, "none starves"
    assert all(count > 0 for user in users for count in user.done.values())


PROCEDURES = {
    "move": lambda x, y: firmware.move(x, 0.05),
    "home": lambda x, y: firmware.home(x),
    "line": lambda x, y: firmware.line({x: 0.05, y: 0.03}),
    "jog": lambda x, y: firmware.jog(x, 60.0),
    "two rates": lambda x, y: get_driver(x).move_at_two_rates(
        30_000, firmware.procedures.Speeds().with_second_rate(24_000), 0.4
    ),
}


@pytest.mark.parametrize("speed", [1.0, UNPACED_SPEED])
@pytest.mark.parametrize("chips", ["pcl240ms", "mcx514", "mcx304", "hctl1100"])
@pytest.mark.parametrize("name", PROCEDURES)
def test_pause_and_stop_act_within_two_slices_of_a_procedure(chips, name, speed):
    """A slice is 20 ms of real time: within 0.1 s. Counted in simulated time, however busy the machine is."""
    stage = Stage("xy", chips=chips, visuals=False)
    x, y = stage.axes.values()
    stage.place(x=0.02)
    requested: list[int] = []
    with Session(stage, speed=speed) as session:

        def interrupt(stage):
            """Interrupt the procedure by an order."""
            if not requested and session.view.action and stage.now > 20_000_000:
                session.paused = True
                requested.append(stage.now)

        session.call_after_pacing_intervals(interrupt)
        try:
            action = session.act(name, lambda stage: PROCEDURES[name](x, y))
            end = time.monotonic() + MAX_WAIT_S
            while not requested and not action.done():
                assert time.monotonic() < end
                time.sleep(0.001)
        except ArgumentError:
            pytest.skip(f"{chips} has no {name}")
        if action.done() and isinstance(action.exception(), ArgumentError):
            pytest.skip(f"{chips} has no {name}")
        at = session.do(lambda stage: stage.now)
        assert at - requested[0] <= 2 * PACING_INTERVAL_S * 1e9
        assert session.do(lambda stage: stage.now) - at < 1_000_000, "time stands still; bus cycles take theirs"
        assert session.stop_actions()
        with pytest.raises(ActionStopped):
            action.result(MAX_WAIT_S)
        session.paused = False
        session.speed = UNPACED_SPEED
        session.stop().result(MAX_WAIT_S)
        assert not any(session.do(lambda stage, a=a: get_driver(a).is_running()) for a in (x, y)) or chips == "hctl1100"


def test_a_stop_with_a_ramp_begins_on_all_axes_at_the_same_time():
    """One after the other, the second axis went on for as long as the ramp of the first"""
    stage = Stage("xy", chips="pcl240ms", visuals=False)
    with Session(stage, speed=UNPACED_SPEED) as session:
        for axis in stage.axes.values():
            session.do(
                lambda stage, a=axis: get_driver(a).start_continuous_move(
                    1, firmware.procedures.Speeds(up=0.3, down=0.3)
                )
            )
        session.do(lambda stage: session.run_unpaced(stage.run, 0.4))
        journals = session.do(lambda stage: [chip.journal() for chip in stage.chips])
        session.stop().result(MAX_WAIT_S)
        first = [next(e.clock for e in journal.entries if e.kind == WRITE) / 4_915_200 for journal in journals]
        assert max(first) - min(first) < 5e-3
        assert not any(session.do(lambda stage: [chip.busy(0) for chip in stage.chips]))


def test_a_recording_is_not_closed_within_a_sequence_of_another_thread():
    stage = Stage("xy", visuals=False)
    with Session(stage, speed=UNPACED_SPEED, program="a test"):
        recording = stage.record()
        with stage.lock:
            closing = threading.Thread(target=recording.close, daemon=True)
            closing.start()
            closing.join(0.1)
            assert stage.recording is recording
        closing.join(10)
        assert stage.recording is None
