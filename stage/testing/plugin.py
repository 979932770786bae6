"""The pytest plugin: fixtures `stage`, `board` and `host`, their markers, and the files of a failed test. See docs/testing.md.

pytest loads this module in every session of an environment that has PulseStage. Slow imports are made by the fixtures, so a test
without these fixtures is not affected. It has no assert statements: PYTEST_DONT_REWRITE.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest

from stage.testing.settings import OPTIONS, setting

if TYPE_CHECKING:
    from stage.board import Board
    from stage.board.host import Host
    from stage.sim.stage import Stage

MARKERS = (
    "stage(model='xyz', chips='PCL240K', drives=None, bus_cycle=1e-6, clock=None, visuals=False, record=True, encoders=None): the "
    "stage of a test",
    "model(name): the model of its stage, as stage(model=name)",
    "chips(name) or chips(x=name, y=name): the chips of its stage, as stage(chips=...)",
    "board(layout=None, base=None, stride=None, keep_cycles=100000, devices=()): the chips on the host's bus, and devices",
    "firmware(*sources, flags=(), platform=None, isolated=True, patience=20.0, cost=0.0, mcu=None, map=(), mcu_clock=None): C or "
    "C++ sources, a library, or a program of another processor, for the fixture `host`",
)
WATCH: pytest.StashKey[Any] = pytest.StashKey()
"""The evidence.Watch of a test."""


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("pulsestage", "PulseStage: tests of motion firmware")
    for name, (choices, text) in OPTIONS.items():
        group.addoption(f"--pulsestage-{name}", choices=choices, metavar=None if choices else "DIR", help=text)
        parser.addini(f"pulsestage_{name}", text)


def pytest_configure(config: pytest.Config) -> None:
    for line in MARKERS:
        config.addinivalue_line("markers", line)
    for name, (choices, _) in OPTIONS.items():
        if choices and (given := config.getini(f"pulsestage_{name}")) and given not in choices:
            raise pytest.UsageError(f"pulsestage_{name} = {given}: known are {', '.join(choices)}.")


@pytest.fixture
def stage(request: pytest.FixtureRequest) -> Iterator[Stage]:
    """A motion stage, new for each test; @pytest.mark.stage(...) says which."""
    with _plainly():
        from stage.testing import evidence, markers
        from stage.testing.watched import WatchedStage

        arguments = markers.stage_arguments(request.node)
        recorded = arguments.pop("record", True) and setting(request.config, "record") != "off"
        made = WatchedStage(**arguments)
        watch = evidence.Watch(request.node, made, arguments.get("model", "xyz"))
        watch.clear()
    request.node.stash[WATCH] = watch
    if recorded:
        made.watch()
    yield made
    made.unwatch()


@pytest.fixture
def board(request: pytest.FixtureRequest, stage: Stage) -> Board:
    """The chips of `stage` behind the ports of a host's bus; @pytest.mark.board(...) says where."""
    with _plainly():
        from stage.board import Board
        from stage.testing import markers

        made = Board(stage, **markers.board_arguments(request.node))
    if (watch := request.node.stash.get(WATCH, None)) is not None:
        watch.board = made
    return made


@pytest.fixture
def host(request: pytest.FixtureRequest, board: Board) -> Iterator[Host]:
    """The firmware of @pytest.mark.firmware("driver.c"), ready to run on `board`. Built once a session, with cc."""
    with _plainly():
        from stage.board import NativeHost
        from stage.testing import markers, sources

        arguments = markers.firmware_arguments(request.node)
        path = sources.library_of(request, arguments)
        if arguments.get("mcu"):
            from stage.targets import TargetHost

            made: Host = TargetHost(path, board, **arguments)
        else:
            made = NativeHost(path, board, **arguments)
    with made:
        yield made


@contextmanager
def _plainly() -> Iterator[None]:
    """What a user has to mend is said without the traceback of this package; without compiler or emulator it is skipped."""
    from stage.errors import StageError

    try:
        yield
    except StageError as error:
        from stage.board import NoCompilerError
        from stage.targets import NoEmulatorError

        if isinstance(error, NoCompilerError | NoEmulatorError):
            raise pytest.skip.Exception(str(error)) from None
        raise pytest.fail.Exception(f"{type(error).__name__}: {error}", pytrace=False) from None


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo) -> Generator[None, Any, None]:
    watch = item.stash.get(WATCH, None)
    if watch is not None and call.excinfo is not None and not item.config.getoption("fulltrace", False):
        watch.shorten(call.excinfo.value)
    outcome = yield
    if watch is None:
        return
    report = outcome.get_result()
    wanted = report.failed or (call.when == "call" and setting(item.config, "keep") == "all")
    if wanted and (text := watch.keep()):
        report.sections.append(("PulseStage", text))
    if call.when == "teardown":
        del item.stash[WATCH]
