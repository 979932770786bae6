"""Promises about moves that begin at once and go on while time passes: several axes, stops, and the chip's own counter."""

from __future__ import annotations

import numpy as np

from stage.chips import Chip
from stage.errors import ArgumentError, StageError
from stage.firmware.axis_actions import AxisAction
from stage.firmware.axis_state import AxisState, read_axis_state
from stage.firmware.chip_bench import Bench, BenchAxis
from stage.firmware.driver import get_driver
from stage.firmware.procedures import begin_move, begin_stop
from stage.testing.promise_trial import BrokenPromise, PromiseTrial

WAIT_INTERVAL_S = 1e-3
MAX_MOVE_S = 30.0
MIN_PULSES, MAX_PULSES, LONG_PULSES = 200, 4_000, 40_000


def check_actions(trial: PromiseTrial) -> None:
    """Check that moves of the driver begin at once, go on side by side, can be stopped, and that `is_moving` tells the truth.

    Also check that reading the state of an axis changes nothing, and that the chip's own counter counts and can be set.
    """
    if not trial.chip_class.DRIVER:
        return
    for rng in trial.make_seeded_generators():
        bench = Bench(x=trial.make(), y=trial.make())
        pulses = {name: int(rng.integers(MIN_PULSES, MAX_PULSES)) * sign for name, sign in (("x", 1), ("y", -1))}
        for axis in bench.axes.values():
            _require_moving(axis, False, "before its first move")
        counters = {name: _read_state(axis).counter for name, axis in bench.axes.items()}
        try:
            actions = {name: begin_move(axis, pulses=pulses[name]) for name, axis in bench.axes.items()}
        except ArgumentError:  # this driver makes no moves by itself
            return
        _require_refusal(bench.axes["x"])
        _wait_for_end(bench, actions, trial)
        for name, axis in bench.axes.items():
            _require_moving(axis, False, f"after its move of {pulses[name]} pulses")
            _check_counter(axis, counters[name], pulses[name], trial)
            if trial.counts_pulses and (made := actions[name].report.pulses) != pulses[name]:
                raise BrokenPromise(f"a move of {pulses[name]} pulses beside that of another axis made {made}")
        _check_stop(bench.axes["x"], rng)


def _check_stop(axis: BenchAxis, rng: np.random.Generator) -> None:
    """Check that a stop ends a move in its course, and that the axis is at rest when the stop is done."""
    move = begin_move(axis, pulses=LONG_PULSES)
    end, goal = axis.time + MAX_MOVE_S, axis.chip.net(axis.chip_axis) + int(rng.integers(1, MAX_PULSES))
    while axis.chip.net(axis.chip_axis) < goal and axis.time < end:
        axis.wait(WAIT_INTERVAL_S)
    _require_moving(axis, True, "in the middle of a move")
    stop = begin_stop(axis, at_once=bool(rng.integers(2)))
    if not move.was_cancelled:
        raise BrokenPromise("begin_stop in the middle of a move does not cancel the move")
    seconds = 0.0
    while not stop.is_done and seconds < MAX_MOVE_S:
        axis.wait(WAIT_INTERVAL_S)
        seconds += WAIT_INTERVAL_S
    _require_moving(axis, False, "after a stop")


def _wait_for_end(bench: Bench, actions: dict[str, AxisAction], trial: PromiseTrial) -> None:
    """Let time pass until no axis moves. A servo on a bench has no motor and never settles: its profile is enough."""
    seconds = 0.0
    while not all(action.is_done for action in actions.values()):
        for name, axis in bench.axes.items():
            if trial.counts_pulses and not actions[name].is_done:
                _require_moving(axis, True, "while its move is under way")
        bench.wait(WAIT_INTERVAL_S)
        seconds += WAIT_INTERVAL_S
        if trial.chip_class.SERVO and not any(get_driver(axis).is_moving for axis in bench.axes.values()):
            for action in actions.values():
                action.cancel()
        if seconds > MAX_MOVE_S:
            raise BrokenPromise(f"moves of up to {MAX_PULSES} pulses still go on after {MAX_MOVE_S:g} s")
    for action in actions.values():
        if action.error is not None:
            raise BrokenPromise(f"a move beside that of another axis ends with {action.error!r}")


def _check_counter(axis: BenchAxis, before: int | None, pulses: int, trial: PromiseTrial) -> None:
    """Check that the controller's own counter has counted a move, and that it can be set if the driver says so."""
    driver = get_driver(axis)
    try:
        counted = driver.read_position_counter()
    except ArgumentError:  # none that this driver reads
        return
    if before is not None and trial.counts_pulses and counted - before != pulses:
        raise BrokenPromise(f"{driver.position_counter} has gone by {counted - before} in a move of {pulses} pulses")
    if driver.can_set_position_counter:
        for value in (0, -1234):
            driver.write_position_counter(value)
            read, peeked = driver.read_position_counter(), driver.peek_position_counter()
            if (read, peeked) != (value, value):
                raise BrokenPromise(
                    f"{driver.position_counter} is set to {value}: it reads {read}, and without a bus cycle {peeked}"
                )


def _require_refusal(axis: BenchAxis) -> None:
    """Raise BrokenPromise unless a second action of an axis is refused."""
    try:
        begin_move(axis, pulses=MIN_PULSES)
    except ArgumentError as error:
        raise BrokenPromise(f"a second move of an axis is refused by {error!r}, not because one is under way") from None
    except StageError:
        return
    raise BrokenPromise("a second move of an axis begins while the first one is under way")


def _require_moving(axis: BenchAxis, expected: bool, when: str) -> None:
    """Raise BrokenPromise unless `is_moving` has the expected value."""
    chip, driver = axis.chip, get_driver(axis)
    is_driving = bool(chip.CORE.is_busy.with_gil(chip.pointer, axis.chip_axis))
    if _read_state(axis).is_moving != expected or (is_driving and not driver.is_moving):
        raise BrokenPromise(f"is_moving is {driver.is_moving} {when}")


def _read_state(axis: BenchAxis) -> AxisState:
    """Read the state of an axis, and check that this changes nothing."""
    chip: Chip = axis.chip
    before, clock = chip.state.tobytes(), chip.clock
    state = read_axis_state(axis)
    if (chip.state.tobytes(), chip.clock) != (before, clock):
        raise BrokenPromise("reading the state of an axis changes the chip")
    return state
