"""`Loop`: advances a stage's time. It calls the engine again and again, and takes what the engine has noted.

A long run is made in pieces of some hundredths of a second of real time, so that Ctrl-C works. After each piece the inputs of the
chips go to their journals and the samples to the recording; a step that diverged, or in which a callback failed, is undone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from time import perf_counter
from typing import Any

import mujoco
import numpy as np

from stage.chips import Chip
from stage.chips.entries import LOAD, PACKED, SHAFT
from stage.chips.sharing import Lock
from stage.errors import ArgumentError, SimulationError, StageError
from stage.sim import callbacks, engine, records
from stage.sim.handle import make_token
from stage.sim.state import POWERED, SAVED, START, State

SHORT, LONG = 0.025, 0.1  # s of real time, a piece of a long run takes between them
FIRST_PIECE_STEPS = 16  # physics steps
IN_USE = (
    "this stage is in use, by another thread or by the run that has called MuJoCo's callback: one thread at a time runs a stage "
    "or changes it. Give each thread a stage of its own, copy.deepcopy(stage); stage.sim.fleet.Fleet plays many on threads."
)


class Loop:
    """Advances the time of a stage, and is the bus of its chips, see `stage.chips.chip.Bus`.

    Attributes:
        state: the stage's records.
        chips: of the stage.
        recording: what the engine samples for: the stage's recording in progress; or whoever looks on without one, with the same
            buffers and `take`, and FORWARD False: time may go back, and a recording takes his place; or None.
        time_refusal: why neither time may pass now nor another state be put in the place of this one; "" where both may.
        state_refusal: why no other state may be put there, though time may pass; "" where one may.
        pace: who says when time may pass: `pace(until)` is asked before a run to `until` (ns), may wait, let others do something
            meanwhile, and answers how far it may go now; then it is asked again. Before anything else that changes the stage it is
            asked with the time that is now. None: as fast as it goes.
        each_cycle: who is told before each bus cycle that Python makes, and may refuse it by an error; or None.
        lock: lock that whoever uses the stage takes while a session is open, see stage.chips.sharing; or None.
    """

    def __init__(self, state: State, chips: Sequence[Chip], power_up: Callable[[], None]):
        """power_up: called where the stage's state was cleared, to bring it to that after power-up."""
        self.state, self.chips = state, chips
        self.recording: Any = None
        self.time_refusal = self.state_refusal = ""
        self.pace: Callable[[int], int] | None = None
        self.each_cycle: Callable[[], None] | None = None
        self.lock: Lock | None = None
        self._words, self._pointer, self._advance = state.words, state.pointer, engine.advance.c
        self._power_up, self._dt, self._bus = power_up, state.dt, state.bus
        self._opt = state.model.opt
        self._built = self._opt.timestep, self._opt.integrator
        self._piece = FIRST_PIECE_STEPS * state.dt
        self._failure: BaseException | None = None

    # --- the bus of the chips ---

    def cycle(self) -> None:
        """Let the time of one bus cycle pass; chips call it before each read and write."""
        if self.each_cycle is not None:
            self.each_cycle()
        if self._bus:
            self.run_to(self._words.item(0) + self._bus)
        else:
            self.prepare_change()

    def ensure_powered(self) -> None:
        """Whoever looks at the stage sees a machine under power, also after mj_resetData, mj_resetDataKeyframe and the like: they
        clear userdata, where chips and drives live. Not in a recording, whose time would run backwards."""
        if not self._words.item(POWERED) and (self.recording is None or not self.recording.FORWARD):
            self._power_up()

    def prepare_change(self) -> None:
        """Somebody is about to change the stage's state. Raises StageError while another thread runs the stage."""
        if (pace := self.pace) is not None:
            pace(self._words.item(0))
        if self.state.clockwork["busy"].item(0):
            raise StageError(IN_USE)
        self.ensure_powered()

    @contextmanager
    def claimed(self) -> Iterator[None]:
        """Within this context no other thread runs the stage. Raises StageError if another thread runs it now."""
        token = make_token()
        try:
            if not engine.claim_stage.with_gil(self._pointer, token):
                raise StageError(IN_USE)
            yield
        finally:
            engine.release_stage.with_gil(self._pointer, token)

    # --- time ---

    def check_time_allowed(self) -> None:
        """Raises StageError while somebody has the stage stand still."""
        if (pace := self.pace) is not None:
            pace(self._words.item(0))
        if self.time_refusal:
            raise StageError(self.time_refusal)

    def check_state_allowed(self) -> None:
        """Raises StageError while nobody may put another state in the place of this one, or let firmware run."""
        if (pace := self.pace) is not None:
            pace(self._words.item(0))
        if self.time_refusal or self.state_refusal:
            raise StageError(self.time_refusal or self.state_refusal)

    def check_options(self) -> None:
        """Raises StageError if the model's time step or integrator is another than the stage was built with."""
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
        """Let time pass up to `until`, ns since power-up. Raises SimulationError, see `Stage.run`; StageError."""
        if self.time_refusal:
            raise StageError(self.time_refusal)
        while (pace := self.pace) is not None and (goal := pace(until)) < until:
            self._run_to(goal)
        self._run_to(until)

    def _run_to(self, until: int) -> None:
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
                self._account(int(self.state.handle["status"]), 0)
                raise
            if status or recording is not None or self.state.handle["noted"]:
                self._account(status, until)
            if long:
                if status == records.REACHED:
                    self._piece = piece = self._next_piece(perf_counter() - begin)
            elif status == records.REACHED:
                return

    def _next_piece(self, took: float) -> int:
        """ns of simulated time for the next piece of a long run, when the last took so many seconds."""
        if took < SHORT:
            return min(2 * self._piece, 1 << 60)
        return max(self._piece // 2, self._dt) if took > LONG else self._piece

    def _account(self, status: int, until: int) -> None:
        """After the engine has returned before `until`: takes its notes, and handles or raises what stopped it."""
        h, recording = self.state.handle, self.recording
        error: BaseException | None = None
        if status == records.DIVERGED:
            error = self.undo_divergence(self._pointer)
        elif status == records.FAILED:
            error = self._undo_failure()
        elif status == records.IN_USE:
            raise StageError(IN_USE)
        if h["noted"]:
            self.journal_edges(int(h["noted"]))
            h["noted"] = 0
        if recording is not None:
            recording.take(int(h["filled"]))
        if error is not None:
            raise error
        if status == records.WIPED:
            if recording is not None and recording.FORWARD:
                raise StageError(
                    "the stage's state was cleared (mj_resetData?) in the middle of a recording, whose time runs forward only: "
                    "close the recording; the stage is at power-up then."
                )
            self._power_up()
        elif status == records.UNGUARDED:
            self._run_guarded(until)

    def _run_guarded(self, until: int) -> None:
        """As `run_to`, if MuJoCo has callbacks: one physics step at a time, so that a failed step can be undone."""
        clockwork = self.state.clockwork[0]

        def failed(error: BaseException | None) -> bool:
            if error is not None:
                self._failure, clockwork.failed = error, 1
            return bool(clockwork.failed)

        try:
            with callbacks.guard_callbacks(failed):
                clockwork.guarded = 1
                while self.state.now < until:
                    self.run_to(min(until, self.state.start + self._dt))
        finally:
            clockwork.guarded = clockwork.failed = 0

    def load_state(self, saved: np.ndarray) -> None:
        """The stage is in this state, `State.saved` of another moment or of a stage alike."""
        self.check_time_allowed()
        state = self.state
        with self.claimed():
            self.apply_change(lambda: mujoco.mj_setState(state.model, state.data, saved, SAVED))
            mujoco.mj_setState(state.model, state.data, saved, SAVED)

    def apply_change(self, change: Callable[[], None]) -> None:
        """Make a change to MuJoCo's state, and all that follows from it. Raises SimulationError where one of its callbacks raises;
        the state is then as it was. For who has the stage `claimed`."""
        model, data = self.state.model, self.state.data
        if not engine.has_unguarded_callback.with_gil(self._pointer):
            change()
            mujoco.mj_forward(model, data)
            return
        before = np.empty_like(self.state.saved)
        mujoco.mj_getState(model, data, before, SAVED)
        change()
        callbacks.forward(model, data, lambda: mujoco.mj_setState(model, data, before, SAVED))

    # --- what the engine has noted ---

    def journal_edges(self, n: int) -> None:
        """The first `n` of `state.edges` go to the journals of the chips that they reached."""
        noting = [(k, j) for k, chip in enumerate(self.chips) if (j := chip.open_journal) is not None]
        if not noting:
            return
        edges = self.state.edges[:n]
        chip_of = self.state.axis_table["chip"][edges["axis"]]
        for k, journal in noting:
            own = np.flatnonzero(chip_of == k)
            if not len(own):
                continue
            packed = np.zeros(len(own), PACKED)
            for name in ("clock", "kind", "a", "b"):
                packed[name] = edges[name][own]
            seen = np.flatnonzero((packed["kind"] == SHAFT) | (packed["kind"] == LOAD))
            if len(seen):
                packed["axis"][seen] = packed["a"][seen]
                packed["a"][seen] = edges["count"][own[seen]].view(np.int64)
                packed["b"][seen] = edges["rate"][own[seen]].view(np.int64)
            journal.extend(packed)

    def update_switches(self, axis: int) -> None:
        """The table of switches has changed: what it means for the axis of this index, from now on. Raises ArgumentError."""
        if not 0 <= axis < len(self.state.axis_table):
            raise ArgumentError(f"axis={axis!r}: the stage has axes 0 to {len(self.state.axis_table) - 1}.")
        self.ensure_powered()
        with self.claimed():
            engine.update_switches.with_gil(self._pointer, axis)
        if n := int(self.state.handle["noted"]):
            self.journal_edges(n)
            self.state.handle["noted"] = 0

    # --- steps that are undone ---

    def _undo_failure(self) -> BaseException:
        """Go back to before the step in which a callback failed."""
        state = self.state
        mujoco.mj_setState(state.model, state.data, state.saved, SAVED)
        state.clockwork[0].failed = 0
        failure, self._failure = self._failure, None
        return callbacks.make_callback_error(
            failure, state.now * 1e-9, "The stage holds the state before that physics step."
        )

    def undo_divergence(self, pointer: int) -> SimulationError:
        """Go back to where the last run of the engine began, and run it again up to the step before the one that diverged.

        pointer: the address of the handle that it ran with.
        """
        state, model = self.state, self.state.model
        speeds = np.abs(state.data.qvel)
        bad = int(np.argmax(np.where(np.isfinite(speeds), speeds, np.inf)))
        joint = model.joint(int(model.dof_jntid[bad])).name or f"degree of freedom {bad}"
        good = state.start - self._dt
        mujoco.mj_setState(model, state.data, state.saved, SAVED)
        self._advance(pointer, good)
        seconds = state.now * 1e-9
        return SimulationError(
            f"the simulation diverged at {seconds:.6f} s on axis {joint!r}: its speed left +-{records.MAX_SPEED:g} per "
            f"second. The stage holds the state before that step. Usual causes: a timestep too long for the motor's "
            f"stiffness (now {model.opt.timestep} s), a mass near zero, or an external force that is not finite.",
            seconds,
            joint,
        )
