"""Every public function refuses an argument of a wrong type or value in an error of the project, whichever argument it is."""

import contextlib
import inspect
import io
import math
import os
from importlib import import_module

import pytest

from stage import Fleet, Program, Stage, StageError, firmware
from stage.agents import Toolbox
from stage.board import Board
from stage.chips import PCL240K
from stage.firmware import Bench

WRONG = ("1", None, math.nan, math.inf, -1, -1.5, [], {}, object(), b"x", "nosuch", 3.5, True, ["q"], {"q": 1})

MODULES = {
    name: import_module(name)
    for name in (
        "stage",
        "stage.agents",
        "stage.board",
        "stage.firmware",
        "stage.recording",
        "stage.sim.faults",
        "stage.study",
        "stage.testing",
        "stage.tune",
    )
}
NOT_CALLED_BY_USERS = {
    "stage.firmware.Axis": "a protocol",
    "stage.firmware.AxisAction": "begin_move() and others make it",
    "stage.recording.Recording": "Stage.record() makes it",
    "stage.recording.SavedRecording": "stage.recording.read() makes it",
    "Stage.note_fault": "faults call it",
    "Stage.begin_recording": "recordings call it",
    "Stage.panel": "opens a page",
    "Recording.close": "ends the recording that the other cases read",
    "Recording.take_rows": "the engine calls it",
    "Recording.stream": "once in the life of a recording",
    "Toolbox.release": "ends the toolbox that the other cases call",
}
"""Public names that this test leaves out, and why."""
VALID = {"axis": lambda s: s.axes["x"], "axes": lambda s: s.axes, "stage": lambda s: s, "distance": lambda s: 1e-5}
"""Values of required arguments by their names; 1 for any other."""


def list_functions():
    """Yield (name, function or class) for every public one of the modules."""
    for module_name, module in MODULES.items():
        public_names = [n for n, o in vars(module).items() if not n.startswith("_") and inspect.getmodule(o) is module]
        for name in getattr(module, "__all__", public_names):
            value = getattr(module, name)
            if callable(value) and not (inspect.isclass(value) and issubclass(value, BaseException)):
                yield f"{module_name}.{name}", value


def list_methods(value):
    """Yield (name, method) for every public method of an object."""
    for name in dir(type(value)):
        if not name.startswith("_") and inspect.isroutine(getattr(value, name)):
            yield f"{type(value).__name__}.{name}", getattr(value, name)


def make_wrong_calls(function, stage):
    """Yield (parameter, args, kwargs) with one wrong value among arguments that are right as far as their names tell."""
    parameters = [p for p in inspect.signature(function).parameters.values() if p.name not in ("self", "cls")]
    for wrong in parameters:
        for value in WRONG:
            args, kwargs = [], {}
            for p in parameters:
                if p is not wrong and (p.default is not p.empty or p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD)):
                    continue
                argument = value if p is wrong else VALID.get(p.name, lambda s: 1)(stage)
                if p.kind in (p.VAR_POSITIONAL, p.POSITIONAL_ONLY):
                    args.append(argument)
                else:
                    kwargs["x" if p.kind is p.VAR_KEYWORD else p.name] = argument
            yield wrong.name, args, kwargs


def assert_refuses_in_words(name, function, stage):
    with contextlib.redirect_stdout(io.StringIO()):
        for parameter, args, kwargs in make_wrong_calls(function, stage):
            try:
                function(*args, **kwargs)
            except (StageError, AssertionError):
                pass
            except Exception as error:
                pytest.fail(f"{name}, wrong {parameter}: args={args} kwargs={kwargs} raise {error!r}")


@pytest.fixture
def stage():
    return Stage("xy", visuals=False)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return os.fspath(tmp_path)


TAKES_SECONDS = {
    "stage.firmware.continuous_move", "stage.firmware.home", "stage.firmware.origin_return", "Recording", "Report",
}  # fmt: skip
"""Where many of the wrong values are right for some argument, and each of them moves an axis for long or writes files."""


def mark_slow_names(names):
    """Return the names as parameters of a test, those that take seconds for the slow suite."""
    return [pytest.param(n, id=n, marks=pytest.mark.slow if n in TAKES_SECONDS else ()) for n in names]


FUNCTIONS = {name: function for name, function in list_functions() if name not in NOT_CALLED_BY_USERS}


@pytest.mark.parametrize("name", mark_slow_names(FUNCTIONS))
def test_a_public_function_refuses_a_wrong_argument_in_words(name, stage):
    assert_refuses_in_words(name, FUNCTIONS[name], stage)


def make_recording(stage):
    with stage.record() as recording:
        stage.run(0.002)
    return recording


OBJECTS = {
    "Stage": lambda s: s,
    "Axis": lambda s: s.axes["x"],
    "Recording": make_recording,
    "Program": lambda s: Program(),
    "Snapshot": lambda s: s.snapshot(),
    "Fleet": lambda s: Fleet([s]),
    "Board": Board,
    "Bench": lambda s: Bench(PCL240K()),
    "Toolbox": Toolbox,
    "Report": lambda s: firmware.move(s.axes["x"], pulses=10),
}


@pytest.mark.parametrize("kind", mark_slow_names(OBJECTS))
def test_a_method_refuses_a_wrong_argument_in_words(kind, stage):
    value = OBJECTS[kind](stage)
    for name, method in list_methods(value):
        if name not in NOT_CALLED_BY_USERS:
            assert_refuses_in_words(name, method, stage)


def test_the_names_left_out_exist():
    known = {name for name, _ in list_functions()} | {
        f"{type(value).__name__}.{name}"
        for stage in [Stage("xy", visuals=False)]
        for value in (stage, make_recording(stage), Toolbox(stage))
        for name in dir(value)
    }
    assert set(NOT_CALLED_BY_USERS) <= known
