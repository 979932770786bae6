"""`StageLoop`: advances the time of a stage by calls of the engine, and writes the engine's logs to journals and recordings.

A long run is made in pieces of some hundredths of a second of real time, so that Ctrl-C works. After each piece the inputs of the
chips go to their journals and the samples to the recording. A step that diverged, or in which a callback failed, is undone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from time import perf_counter
from typing import Any, TypeVar

import mujoco
import numpy as np

from stage.chips import Chip
from stage.chips.exclusive_access import SessionLock
from stage.chips.journal_entries import LOAD, PACKED, SHAFT
from stage.chips.observer_attributes import make_observer_attribute
from stage.errors import ArgumentError, SimulationError, StageError
from stage.sim import engine, engine_records, mujoco_callback_guards
from stage.sim.compiled_stage_access import make_claim_token
from stage.sim.procedure_threads import MIN_WAIT_NS, ProcedureSchedule
from stage.sim.stage_state import POWERED, SAVED_STATE_SPEC, START, State

MIN_PIECE_S, MAX_PIECE_S = 0.025, 0.1  # s of real time, a piece of a long run takes between them
FIRST_CALL_STEPS = 16  # physics steps
IN_USE_MESSAGE = (
    "this stage is in use, by another thread or by the run that has called MuJoCo's callback: one thread at a time runs a stage "
    "or changes it. Give each thread a stage of its own, copy.deepcopy(stage); stage.sim.fleet.Fleet plays many on threads."
)

T = TypeVar("T")
READ_RETRY_S = 1e-3
"""Real seconds after which a thread that wants to read a stage tries again by itself."""


class StageLoop:
    """Loop that advances the time of a stage. It is also the bus of the stage's chips, see `stage.chips.chip.Bus`.

    Attributes:
        state: Records of the stage.
        chips: Chips of the stage.
        recording: Receiver of the engine's samples: the recording in progress, or an observer with the same buffers and method
            `take_rows`, or None. With an observer, whose REQUIRES_FORWARD_TIME is False, time may go back, and a new recording
            replaces the observer.
        time_refusal: Reason why no time may pass and no other state may be loaded; "" if both are allowed.
        state_refusal: Reason why no other state may be loaded, though time may pass; "" if it is allowed.
        pace: Function that decides when time may pass. `pace(until)` is called before a run to `until` (ns), may wait, and returns
            the time up to which the run may go now; then it is called again. Before any other change of the stage it is called with
            the present time. None: time passes without a pace.
        each_cycle: Function that is called before each bus cycle that Python makes, and may refuse it by an error; or None.
        lock: Lock that users of the stage take while a session is open, see stage.chips.exclusive_access; or None.
        procedures: Procedures of a host that go on while time passes, see stage.sim.procedure_threads.
    """

    recording: Any = make_observer_attribute("_recording", "Receiver of the engine's samples, or None.")

    def __init__(self, state: State, chips: Sequence[Chip], power_up: Callable[[], None]):
        """Make the loop of a stage.

        Args:
            state: Records of the stage.
            chips: Chips of the stage.
            power_up: Function that resets the stage to power-up, called when MuJoCo has cleared its state.
        """
        self.state, self.chips = state, chips
        self.recording = None
        self.time_refusal = self.state_refusal = ""
        self.pace: Callable[[int], int] | None = None
        self.each_cycle: Callable[[], None] | None = None
        self.lock: SessionLock | None = None
        self.procedures = ProcedureSchedule(self)
        self._words, self._pointer, self._advance = state.words, state.pointer, engine.advance.c
        self._power_up, self._dt, self._bus = power_up, state.dt, state.bus
        self._opt = state.model.opt
        self._built = self._opt.timestep, self._opt.integrator
        self._piece = FIRST_CALL_STEPS * state.dt
        self._failure: BaseException | None = None
        self._reads: deque[tuple[Callable[[], Any], Future]] = deque()

    # --- the bus of the chips ---

    def cycle(self) -> None:
        """Let the time of one bus cycle pass; chips call it before each read and write."""
        if self.each_cycle is not None:
            self.each_cycle()
        if self._bus:
            self._run_bus_cycle(self._words.item(0) + self._bus)
        else:
            self.prepare_change()

    def ensure_powered(self) -> None:
        """Power the stage up if MuJoCo has cleared userdata with the state of chips and drives, as mj_resetData does.

        During a recording the state stays cleared, because the time of the recording would go back.
        """
        if not self._words.item(POWERED) and (self.recording is None or not self.recording.REQUIRES_FORWARD_TIME):
            self._power_up()

    def prepare_change(self) -> None:
        """Prepare a change of the stage's state.

        Raises:
            StageError: Another thread runs the stage.
        """
        if (pace := self.pace) is not None:
            pace(self._words.item(0))
        if self.state.clockwork["busy"].item(0):
            raise StageError(IN_USE_MESSAGE)
        self.ensure_powered()

    @contextmanager
    def claim(self) -> Iterator[None]:
        """Claim the stage for this thread within a context, so that other threads cannot run it.

        Raises:
            StageError: Another thread runs the stage now.
        """
        token = make_claim_token()
        try:
            if not engine.claim_stage.with_gil(self._pointer, token):
                raise StageError(IN_USE_MESSAGE)
            yield
        finally:
            engine.release_stage.with_gil(self._pointer, token)

    # --- time ---

    def check_time_allowed(self) -> None:
        """Check that time may pass.

        Raises:
            StageError: Time may not pass, see `time_refusal`.
        """
        if (pace := self.pace) is not None:
            pace(self._words.item(0))
        if self.time_refusal:
            raise StageError(self.time_refusal)

    def check_state_change_allowed(self) -> None:
        """Check that another state may be loaded, or firmware run.

        Raises:
            StageError: No state may be loaded, see `state_refusal`.
        """
        if (pace := self.pace) is not None:
            pace(self._words.item(0))
        if self.time_refusal or self.state_refusal:
            raise StageError(self.time_refusal or self.state_refusal)

    def check_integration_options(self) -> None:
        """Check that the model has the time step and the integrator with which the stage was built.

        Raises:
            StageError: The time step or the integrator has changed.
        """
        opt, built = self._opt, self._built
        if opt.timestep == built[0] and opt.integrator == built[1]:
            return
        now = f"timestep={opt.timestep:g}, integrator={mujoco.mjtIntegrator(opt.integrator).name}"
        then = f"timestep={built[0]:g}, integrator={mujoco.mjtIntegrator(built[1]).name}"
        raise StageError(
            f"model.opt has {now}, and this stage was built with {then}: its motors are computed for that. Put it back, or build a "
            "stage of a model that has it: Stage(stage.model) checks it."
        )

    def run_to(self, until: int) -> None:
        """Let time pass up to `until`, ns since power-up.

        Raises:
            SimulationError: The simulation diverges, see `Stage.run`.
            StageError: No time may pass now, or another thread runs the stage.
        """
        procedures, now = self.procedures, self._words.item(0)
        if procedures.running is not None:
            procedures.running.wait_until(now, until)
        takes_turns = procedures.running is None and until - now >= MIN_WAIT_NS
        while True:
            if self.time_refusal:
                raise StageError(self.time_refusal)
            goal = until if (pace := self.pace) is None or procedures.running else min(pace(until), until)
            if procedures.waiting and (takes_turns or procedures.is_overdue(self._words.item(0))):
                goal = procedures.resume_due_procedures(self._words.item(0), goal)
            self._run_to(goal)
            if goal >= until:
                return

    def _run_bus_cycle(self, until: int) -> None:
        """Let time pass up to the end of a bus cycle, ns. No procedure goes on between the bytes of a number."""
        if self.time_refusal:
            raise StageError(self.time_refusal)
        while (pace := self.pace) is not None and self.procedures.running is None and (goal := pace(until)) < until:
            self._run_to(goal)
        self._run_to(until)

    def read_between_runs(self, read: Callable[[], T]) -> T:
        """Call a function that reads the state of the stage, from any thread, at a moment at which no compiled code runs.

        Args:
            read: Function without arguments that changes nothing and makes no bus cycle.

        Returns:
            The result of `read`.
        """
        busy = self.state.clockwork["busy"]
        while True:
            if not busy.item(0):
                before, value = self._words.item(0), read()
                if not busy.item(0) and self._words.item(0) == before:
                    return value
            request: Future[T] = Future()
            self._reads.append((read, request))
            with suppress(TimeoutError):
                return request.result(READ_RETRY_S)
            request.cancel()

    def _answer_reads(self) -> None:
        """Call the functions of other threads that wait in `read_between_runs`."""
        while self._reads:
            read, request = self._reads.popleft()
            if request.set_running_or_notify_cancel():
                try:
                    request.set_result(read())
                except Exception as error:
                    request.set_exception(error)

    @contextmanager
    def use_advance_function(self, advance: Callable[[int, int], int]) -> Iterator[None]:
        """Let time pass by another compiled function than `engine.advance` within this context.

        Args:
            advance: Function of the address of the stage's HANDLE and a time (ns). It calls `engine.advance`, and returns its
                result.
        """
        before, self._advance = self._advance, advance
        try:
            yield
        finally:
            self._advance = before

    def _run_to(self, until: int) -> None:
        """Run the engine in pieces up to a time, ns, and process its logs after each piece."""
        recording, piece = self.recording, self._piece
        while True:
            goal = until
            if long := until - self._words.item(START) > piece:
                goal, begin = self._words.item(START) + piece, perf_counter()
            if recording is not None:
                self.state.handle["filled"] = recording.filled
            try:
                status = self._advance(self._pointer, goal)
            except BaseException:  # Ctrl-C while compiled code ran: it has come to its end
                self._process_engine_status(int(self.state.handle["status"]), 0)
                raise
            if status or recording is not None or self.state.handle["noted"]:
                self._process_engine_status(status, until)
            if self._reads:
                self._answer_reads()
            if long:
                if status == engine_records.REACHED:
                    self._piece = piece = self._choose_next_call_ns(perf_counter() - begin)
            elif status == engine_records.REACHED:
                return

    def _choose_next_call_ns(self, last_duration_s: float) -> int:
        """Choose the simulated time of the next piece of a long run, ns, from the real time of the last piece, s."""
        if last_duration_s < MIN_PIECE_S:
            return min(2 * self._piece, 1 << 60)
        return max(self._piece // 2, self._dt) if last_duration_s > MAX_PIECE_S else self._piece

    def _process_engine_status(self, status: int, until: int) -> None:
        """Process the engine's logs after it has returned before `until`, and handle or raise the cause of its stop."""
        h, recording = self.state.handle, self.recording
        error: BaseException | None = None
        if status == engine_records.DIVERGED:
            error = self.undo_divergence(self._pointer)
        elif status == engine_records.FAILED:
            error = self._undo_failure()
        elif status == engine_records.IN_USE:
            raise StageError(IN_USE_MESSAGE)
        if h["noted"]:
            self.journal_edges(int(h["noted"]))
            h["noted"] = 0
        if recording is not None:
            recording.take_rows(int(h["filled"]))
        if error is not None:
            raise error
        if status == engine_records.WIPED:
            if recording is not None and recording.REQUIRES_FORWARD_TIME:
                raise StageError(
                    "the stage's state was cleared (mj_resetData?) in the middle of a recording, whose time runs forward only: "
                    "close the recording; the stage is at power-up then."
                )
            self._power_up()
        elif status == engine_records.UNGUARDED:
            self._run_guarded(until)

    def _run_guarded(self, until: int) -> None:
        """Run to `until` a physics step at a time, so that a step in which a callback fails can be undone."""
        clockwork = self.state.clockwork[0]

        def take_error(error: BaseException | None) -> bool:
            if error is not None:
                self._failure, clockwork.failed = error, 1
            return bool(clockwork.failed)

        try:
            with mujoco_callback_guards.guard_callbacks(take_error):
                clockwork.guarded = 1
                while self.state.now < until:
                    self.run_to(min(until, self.state.start + self._dt))
        finally:
            clockwork.guarded = clockwork.failed = 0

    def load_state(self, saved: np.ndarray) -> None:
        """Load a state of the stage: a copy of `State.saved` from another time or from an equal stage."""
        self.check_time_allowed()
        state = self.state
        with self.claim():
            self.apply_change(lambda: mujoco.mj_setState(state.model, state.data, saved, SAVED_STATE_SPEC))
            mujoco.mj_setState(state.model, state.data, saved, SAVED_STATE_SPEC)

    def apply_change(self, change: Callable[[], None]) -> None:
        """Call `change`, which changes MuJoCo's state, and update all dependent quantities. The caller has claimed the stage.

        Raises:
            SimulationError: A callback of MuJoCo raises; the state has then not changed.
        """
        model, data = self.state.model, self.state.data
        if not engine.has_unguarded_callback.with_gil(self._pointer):
            change()
            mujoco.mj_forward(model, data)
            return
        before = np.empty_like(self.state.saved)
        mujoco.mj_getState(model, data, before, SAVED_STATE_SPEC)
        change()
        mujoco_callback_guards.forward_guarded(
            model, data, lambda: mujoco.mj_setState(model, data, before, SAVED_STATE_SPEC)
        )

    # --- what the engine has noted ---

    def journal_edges(self, edge_count: int) -> None:
        """Write the first `edge_count` records of `state.edges` into the journals of the chips that received them."""
        noting = [(k, j) for k, chip in enumerate(self.chips) if (j := chip.open_journal) is not None]
        if not noting:
            return
        edges = self.state.edges[:edge_count]
        chip_of = self.state.axis_table["chip"][edges["axis"]]
        for k, journal in noting:
            indices = np.flatnonzero(chip_of == k)
            if not len(indices):
                continue
            packed = np.zeros(len(indices), PACKED)
            for name in ("clock", "kind", "a", "b"):
                packed[name] = edges[name][indices]
            with_values = np.flatnonzero((packed["kind"] == SHAFT) | (packed["kind"] == LOAD))
            if len(with_values):
                packed["axis"][with_values] = packed["a"][with_values]
                packed["a"][with_values] = edges["count"][indices[with_values]].view(np.int64)
                packed["b"][with_values] = edges["rate"][indices[with_values]].view(np.int64)
            journal.extend(packed)

    def update_switches(self, axis: int) -> None:
        """Apply a change of SWITCH_ROW to the switches of the axis with this index, from now on.

        Raises:
            ArgumentError: There is no such axis.
        """
        if not 0 <= axis < len(self.state.axis_table):
            raise ArgumentError(f"axis={axis!r}: the stage has axes 0 to {len(self.state.axis_table) - 1}.")
        self.ensure_powered()
        with self.claim():
            engine.update_switches.with_gil(self._pointer, axis)
        if n := int(self.state.handle["noted"]):
            self.journal_edges(n)
            self.state.handle["noted"] = 0

    # --- steps that are undone ---

    def _undo_failure(self) -> BaseException:
        """Return to the state before the step in which a callback failed."""
        state = self.state
        mujoco.mj_setState(state.model, state.data, state.saved, SAVED_STATE_SPEC)
        state.clockwork[0].failed = 0
        failure, self._failure = self._failure, None
        return mujoco_callback_guards.make_callback_error(
            failure, state.now * 1e-9, "The stage holds the state before that physics step."
        )

    def undo_divergence(self, pointer: int) -> SimulationError:
        """Return to the beginning of the engine's last run, and run again up to the step before the diverging one.

        Args:
            pointer: Address of the HANDLE with which the engine ran.

        Returns:
            The error to raise.
        """
        state, model = self.state, self.state.model
        speeds = np.abs(state.data.qvel)
        bad = int(np.argmax(np.where(np.isfinite(speeds), speeds, np.inf)))
        joint = model.joint(int(model.dof_jntid[bad])).name or f"degree of freedom {bad}"
        good = state.start - self._dt
        mujoco.mj_setState(model, state.data, state.saved, SAVED_STATE_SPEC)
        self._advance(pointer, good)
        seconds = state.now * 1e-9
        return SimulationError(
            f"the simulation diverged at {seconds:.6f} s on axis {joint!r}: its speed left "
            f"+-{engine_records.MAX_JOINT_SPEED:g} per "
            f"second. The stage holds the state before that step. Usual causes: a timestep too long for the motor's "
            f"stiffness (now {model.opt.timestep} s), a mass near zero, or an external force that is not finite.",
            seconds,
            joint,
        )
