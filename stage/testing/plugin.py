"""The pytest plugin: fixtures `stage`, `board`, `host` and `ioc`, their markers, and the files of a failed test.

See docs/testing.md.

pytest loads this module in every session of an environment that has PulseStage. Slow imports are made by the fixtures, so a test
without these fixtures is not affected. It has no assert statements: PYTEST_DONT_REWRITE.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest

from stage.support.extras import format_install_command
from stage.testing.marker_arguments import read_setting

if TYPE_CHECKING:
    from stage.board import Board
    from stage.board.native_host import Host
    from stage.sim.stage import Stage
    from stage.testing.ioc_process import IocProcess

MARKERS = (
    "stage(model='xyz', chips='PCL240K', drives=None, bus_cycle=1e-6, clock=None, visuals=False, record=True, encoders=None): the "
    "stage of a test",
    "model(name): the model of its stage, as stage(model=name)",
    "chips(name) or chips(x=name, y=name): the chips of its stage, as stage(chips=...)",
    "board(layout=None, base=None, stride=None, keep_cycles=100000, devices=()): the chips on the host's bus, and devices",
    "firmware(*sources, flags=(), platform=None, libraries=(), isolated=True, patience=20.0, cost=0.0, mcu=None, map=(), "
    "pins=(), mcu_clock=None): C or C++ sources, a library, or a program of another processor, for the fixture `host`",
    "ioc(model='xyz', chips='PCL240K', prefix='STAGE:', pace='free', options=()): the IOC of a module, for the fixture `ioc`",
)
OPTIONS = {
    "output": (None, "folder for what failed tests leave: recording, waveforms, bus trace (default: .pulsestage)"),
    "record": (("on", "off"), "record every test with a stage while it runs (default: on)"),
    "firmware": (
        ("isolated", "in-process"),
        "firmware in a process of its own, or here, for debuggers (default: isolated)",
    ),
    "keep": (("failed", "all"), "whose recordings are kept (default: failed)"),
}
EVIDENCE_KEY: pytest.StashKey[Any] = pytest.StashKey()
"""Key of the `evidence.Evidence` of a test."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of the pytest plugin."""
    group = parser.getgroup("pulsestage", "PulseStage: tests of motion firmware")
    for name, (choices, text) in OPTIONS.items():
        group.addoption(f"--pulsestage-{name}", choices=choices, metavar=None if choices else "DIR", help=text)
        parser.addini(f"pulsestage_{name}", text)


def pytest_configure(config: pytest.Config) -> None:
    """Register the markers, and check the settings of the ini file."""
    for line in MARKERS:
        config.addinivalue_line("markers", line)
    for name, (choices, _) in OPTIONS.items():
        if choices and (given := config.getini(f"pulsestage_{name}")) and given not in choices:
            raise pytest.UsageError(f"pulsestage_{name} = {given}: known are {', '.join(choices)}.")


@pytest.fixture
def stage(request: pytest.FixtureRequest) -> Iterator[Stage]:
    """Yield a new motion stage; @pytest.mark.stage(...) says of which model and chips."""
    with _report_without_traceback():
        from stage.testing import failed_test_files, marker_arguments

        arguments = marker_arguments.read_stage_arguments(request.node)
        recorded = arguments.pop("record", True) and read_setting(request.config, "record") != "off"
        stage = failed_test_files.WatchedStage(**arguments)
        watch = failed_test_files.FailedTestFiles(request.node, stage, arguments.get("model", "xyz"))
        watch.clear()
    request.node.stash[EVIDENCE_KEY] = watch
    if recorded:
        stage.watch()
    yield stage
    stage.unwatch()


@pytest.fixture
def board(request: pytest.FixtureRequest, stage: Stage) -> Board:
    """Put the chips of `stage` behind the ports of a host's bus; @pytest.mark.board(...) says where."""
    with _report_without_traceback():
        from stage.board import Board
        from stage.testing import marker_arguments

        board = Board(stage, **marker_arguments.read_board_arguments(request.node))
    if (watch := request.node.stash.get(EVIDENCE_KEY, None)) is not None:
        watch.board = board
    return board


@pytest.fixture
def host(request: pytest.FixtureRequest, board: Board) -> Iterator[Host]:
    """Yield the firmware of @pytest.mark.firmware("driver.c"), ready to run on `board`; it is built once a session, with cc."""
    with _report_without_traceback():
        from stage.board import NativeHost
        from stage.testing import firmware_builds, marker_arguments

        arguments = marker_arguments.read_firmware_arguments(request.node)
        path = firmware_builds.build_library(request, arguments)
        if arguments.get("mcu"):
            from stage.targets import TargetHost

            host: Host = TargetHost(path, board, **arguments)
        else:
            host = NativeHost(path, board, **arguments)
    with host:
        yield host


@pytest.fixture(scope="module")
def ioc(request: pytest.FixtureRequest) -> Iterator[IocProcess]:
    """Yield an EPICS IOC with the motor records of a stage, in a process of its own.

    @pytest.mark.ioc(...) of the module says which stage. Clients of this process find this IOC and no other one. Without
    caproto, the tests of the module are skipped.
    """
    pytest.importorskip("caproto", reason=f"needs the extra epics: {format_install_command('epics')}")
    with _report_without_traceback():
        from stage.testing import marker_arguments
        from stage.testing.ioc_process import IocProcess

        process = IocProcess(**marker_arguments.read_ioc_arguments(request.node))
    with process:
        yield process


@contextmanager
def _report_without_traceback() -> Iterator[None]:
    """Report an error of the user without the traceback of this package; skip the test without compiler or emulator."""
    from stage.errors import StageError

    try:
        yield
    except StageError as error:
        from stage.board import NoCompilerError
        from stage.targets import NoEmulatorError

        if isinstance(error, NoCompilerError | NoEmulatorError):
            raise pytest.skip.Exception(str(error)) from None
        raise pytest.fail.Exception(f"{type(error).__name__}: {error}", pytrace=False) from None


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, Any, Any]:
    """Fail a test that passes although its firmware drives STEP/DIR axes at other pins than `pins` names."""
    result = yield
    host = getattr(item, "funcargs", {}).get("host")
    if item.get_closest_marker("firmware") and (problems := getattr(host, "wiring_problems", ())):
        raise pytest.fail.Exception(
            "\n".join(["the pins of @pytest.mark.firmware are wrong:", *problems]), pytrace=False
        )
    return result


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo) -> Generator[None, Any, None]:
    """Save the files of a failed test, and name them in its report."""
    watch = item.stash.get(EVIDENCE_KEY, None)
    if watch is not None and call.excinfo is not None and not item.config.getoption("fulltrace", False):
        watch.shorten_traceback(call.excinfo.value)
    outcome = yield
    if watch is None:
        return
    report = outcome.get_result()
    wanted = report.failed or (call.when == "call" and read_setting(item.config, "keep") == "all")
    if wanted and (text := watch.save()):
        report.sections.append(("PulseStage", text))
    if call.when == "teardown":
        del item.stash[EVIDENCE_KEY]
