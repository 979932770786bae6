"""Guards for MuJoCo's Python callbacks (`mujoco.set_mjcb_control` and others) while compiled code steps the physics.

MuJoCo calls these callbacks in the middle of a step. It cannot pass on an exception and would end the process. A guard therefore
stores the exception, lets the step complete without further callbacks, and then raises the exception in the caller of the step.
`forward_guarded` is mj_forward with such a guard.

This module also stops the step timers of MuJoCo (`MjData.timer`), for which its Python binding reads a clock some thirty times a
step: a tenth of the time of a stage. `mujoco.set_mjcb_time(None)` starts them again.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import mujoco

from stage.errors import SimulationError
from stage.sim.mujoco_function_addresses import load_mujoco_library

CALLBACK_NAMES = ("passive", "control", "contactfilter", "sensor", "time", "act_dyn", "act_gain", "act_bias")
_CALLBACK_POINTERS = [ctypes.c_void_p.in_dll(load_mujoco_library(), f"mjcb_{name}") for name in CALLBACK_NAMES]
CALLBACK_ADDRESSES = [ctypes.addressof(pointer) for pointer in _CALLBACK_POINTERS]
"""Addresses at which MuJoCo stores the pointers of its callbacks."""
NATIVE_CALLBACKS = [
    0 if callable(getattr(mujoco, f"get_mjcb_{name}")()) else pointer.value or 0
    for name, pointer in zip(CALLBACK_NAMES, _CALLBACK_POINTERS, strict=True)
]
"""Pointers of the callbacks while no Python callback is set: 0, or the function of MuJoCo's binding that reads a clock."""

_lock = threading.Lock()
_installed: dict[str, tuple[Any, Any]] = {}  # name -> what the user set, and the guard in its place
_guards: dict[int, Callable[[BaseException | None], bool]] = {}  # by thread


def stop_step_timers() -> None:
    """Take away the clock of MuJoCo's step timers, unless a user has set a clock in Python."""
    if not callable(mujoco.get_mjcb_time()):
        _CALLBACK_POINTERS[CALLBACK_NAMES.index("time")].value = None


stop_step_timers()


@contextmanager
def guard_callbacks(take_error: Callable[[BaseException | None], bool]) -> Iterator[None]:
    """Catch the exceptions of MuJoCo's Python callbacks in this context and thread.

    Args:
        take_error: Function of an exception, or of None. It stores the exception, and returns whether one has been stored.
    """
    me = threading.get_ident()
    try:
        with _lock:
            if not _guards:
                for name in CALLBACK_NAMES:
                    callback = getattr(mujoco, f"get_mjcb_{name}")()
                    if callable(callback):
                        _installed[name] = callback, _make_guard(callback)
                        getattr(mujoco, f"set_mjcb_{name}")(_installed[name][1])
            _guards[me] = take_error
        yield
    finally:
        with _lock:
            _guards.pop(me, None)
            if not _guards:
                for name, (callback, guard) in _installed.items():
                    if getattr(mujoco, f"get_mjcb_{name}")() is guard:  # it may have taken itself away
                        getattr(mujoco, f"set_mjcb_{name}")(callback)
                _installed.clear()


def forward_guarded(
    model: mujoco.MjModel, data: mujoco.MjData, restore_state: Callable[[], None] | None = None
) -> None:
    """Let MuJoCo compute all quantities that depend on the state (mj_forward).

    Args:
        model: Model.
        data: State of the model.
        restore_state: Function that restores the former state, called if a callback raises.

    Raises:
        SimulationError: A callback raises.
    """
    with guard_forward(data) as errors:
        mujoco.mj_forward(model, data)
        if errors and restore_state is not None:
            restore_state()
            mujoco.mj_forward(model, data)


@contextmanager
def guard_forward(data: mujoco.MjData) -> Iterator[list[BaseException]]:
    """Raise the first exception of a callback at the end of this context, in which functions of MuJoCo compute without a step.

    Args:
        data: State with which they compute.

    Yields:
        The exceptions so far. After the first one, no callback is called.

    Raises:
        SimulationError: A callback raises.
    """
    errors: list[BaseException] = []

    def take_error(error: BaseException | None) -> bool:
        if error is not None:
            errors.append(error)
        return bool(errors)

    with guard_callbacks(take_error):
        yield errors
    if errors:
        raise make_callback_error(errors[0], data.time, "Nothing has changed.")


def make_callback_error(error: BaseException | None, seconds: float, state_text: str) -> BaseException:
    """Make the error for an exception of a callback. For Ctrl-C, which may come while a callback runs, return it unchanged.

    Args:
        error: The exception.
        seconds: Simulated time, s.
        state_text: Description of the present state of the stage, for the message.
    """
    if not isinstance(error, Exception):
        return error or KeyboardInterrupt()
    text = f"a callback that MuJoCo calls raised {type(error).__name__}: {error} (at {seconds:.6f} s). {state_text}"
    error_of_callback = SimulationError(text, seconds, "")
    error_of_callback.__cause__ = error
    return error_of_callback


def _make_guard(callback: Callable) -> Callable:
    """Return a callback that stores exceptions of another callback."""

    def call(*args: Any) -> Any:
        failed = _guards.get(threading.get_ident())
        if failed is None:  # somebody else steps a model of his own
            return callback(*args)
        if failed(None):
            return 0
        try:
            return callback(*args)
        except BaseException as error:
            failed(error)
            return 0

    return call
