"""What docs/testing.md promises of the pytest plugin, each in a small session of its own."""

import os
import re
import shutil
import sys
from importlib.metadata import entry_points
from pathlib import Path
from textwrap import dedent
from types import SimpleNamespace

import pytest
from _pytest.pytester import SysModulesSnapshot
from support.extras import needs_rerun
from support.odd_names import odd_model

import stage.models
from stage.board import build
from stage.support.files import FileError
from stage.testing.marker_arguments import read_firmware_arguments

pytest_plugins = ["pytester"]
needs_cc = pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler: cc is not on the PATH")
PAGE = Path(__file__).parents[2] / "docs" / "testing.md"
PLUGIN = () if "pulsestage" in entry_points(group="pytest11").names else ("-p", "stage.testing.plugin")
FEW = ("-p", "no:hypothesispytest", "-p", "no:cov")  # what a process need not load
HEAVY = ("mujoco", "numba", "numpy", "rerun", "stage.sim.stage", "stage.chips")

NUMBER = re.compile(r"\d[\d.,]*")

DRIVER = """
#include <pulsestage.h>
PULSESTAGE_MAIN
{
    static const long values[] = {400, 50, 500, 500, 1500, 1500, 800, 30};
    for (int n = 0; n < 8; n++) {
        ps_out8(0x300, 0x80 | n);
        for (int k = 3; k; k--)
            ps_out8(0x300 + k, values[n] >> 8 * (k - 1));
    }
    ps_out8(0x300, 0x08);
    ps_out8(0x300, 0x44);
    ps_out8(0x300, 0x15);
    ps_log("started");
    while (ps_in8(0x300) & 0x40)
        ;
    return 7;
}
"""


@pytest.fixture(autouse=True)
def _modules_stay(monkeypatch):
    """Keep the modules that an inner session imports for the next one: numba and MuJoCo cannot be imported twice."""
    monkeypatch.setattr(
        "_pytest.pytester.SysModulesSnapshot",
        lambda preserve: SysModulesSnapshot(lambda name: not name.startswith(("test_", "conftest"))),
    )
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)


@pytest.fixture
def session(pytester):
    """Runs pytest on a test file, in this process; returns the result and all that it printed.

    Its stages are of the small model "xy" where no test says otherwise; with model=None of the plugin's own choice.
    """

    def run(source, *options, model="xy", **keywords):
        small = f"pytestmark = pytest.mark.model({model!r})\n" if model else ""
        pytester.makepyfile(test_it=f"import pytest\nfrom stage.testing import *\n{small}" + dedent(source))
        result = pytester.runpytest_inprocess(*PLUGIN, *options, **keywords)
        return result, result.stdout.str()

    return run


@pytest.fixture
def driver(pytester):
    """driver.c beside the tests."""
    return pytester.makefile(".c", driver=DRIVER)


FAILS = """
@pytest.mark.firmware("driver.c")
def test_it_fails(stage, host):
    host.run(timeout=5)
    assert_at(stage.axes["x"], 0.02)
"""
TURNS = """
def test_it_fails(stage):
    stage.run(0.01)
    assert 0
"""
FOLDER = ".pulsestage/test_it.py.test_it_fails"


# --- sessions that have nothing to do with stages ---


def test_importing_the_plugin_takes_milliseconds_and_nothing_heavy(pytester):
    program = (
        "import sys, time, pytest; t = time.process_time(); import stage.testing.plugin; print(time.process_time() - t)"
    )
    show = f"print(*(name for name in {HEAVY} if name in sys.modules), sep=',')"
    seconds, heavy = pytester.run(sys.executable, "-c", f"{program}; {show}").outlines
    assert heavy == ""
    assert float(seconds) < 0.1  # 2 ms, from .pyc files


def test_a_session_without_stages_imports_nothing_heavy_and_user_fixtures_win(pytester):
    pytester.makeconftest(
        f"""
        import sys, pytest
        @pytest.fixture
        def stage(): return "mine"
        @pytest.fixture
        def host(stage): return stage + " too"
        def pytest_sessionfinish(): print("HEAVY", [name for name in {HEAVY} if name in sys.modules])
        """
    )
    pytester.makepyfile(
        """
        import pytest
        @pytest.mark.stage("to be deployed to")
        def test_mine(stage, host): assert (stage, host) == ("mine", "mine too")
        def test_failing(): assert 0
        """
    )
    result = pytester.runpytest_subprocess(*PLUGIN, *FEW, "-s", "--strict-markers")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines("*HEAVY []*")
    assert "PulseStage" not in result.stdout.str()
    assert not (pytester.path / ".pulsestage").exists()


def test_the_plugin_is_an_entry_point_of_the_package():
    assert 'pulsestage = "stage.testing.plugin"' in (PAGE.parents[1] / "pyproject.toml").read_text()


# --- fixtures and markers ---


@needs_cc
def test_firmware_runs_on_a_board_of_the_stage_and_a_test_that_passes_leaves_nothing(session, driver, pytester):
    result, _ = session(
        """
        @pytest.mark.firmware("driver.c")
        def test_it(stage, board, host):
            assert host.board is board and board.stage is stage
            assert host.run(timeout=5).code == 7
            assert [text for _, text in host.log] == ["started"]
            assert_at(stage.axes["x"], 400 * 3.125e-6)
            assert_no_lost_steps(stage)
            assert_no_strays(board)
        """,
    )
    result.assert_outcomes(passed=1)
    assert not (pytester.path / ".pulsestage").exists()


def test_markers_choose_model_chips_and_board_and_the_nearest_wins(session):
    result, _ = session(
        """
        pytestmark = pytest.mark.stage(model="xy", chips="pcl240ms", bus_cycle=2e-6)

        def test_module(stage, board):
            assert [type(axis.chip).__name__ for axis in stage.axes.values()] == ["PCL240MS"] * 2
            assert stage.bus_cycle == pytest.approx(2e-6)
            assert board.places[1].first == 0x304

        @pytest.mark.chips(x="PCL240K", y="PCL-240MK")
        class TestClass:
            def test_class(self, stage):
                assert [type(axis.chip).__name__ for axis in stage.axes.values()] == ["PCL240K", "PCL240MK"]

            @pytest.mark.model("xyz")
            @pytest.mark.chips("MCX304")
            def test_function(self, stage):
                assert len(stage.chips) == 1 and len(stage.axes) == 3

        from stage.chips import PCL240K
        @pytest.mark.stage(chips=PCL240K)
        @pytest.mark.board("pcl240-card", base=0x200, stride=4)
        def test_card(stage, board):
            assert board.places[0].layout.name == "pcl240-card" and board.places[1].first == 0x204
        """
    )
    result.assert_outcomes(passed=4)


@pytest.mark.parametrize(
    ("marker", "says"),
    [
        (
            'stage(chip="PCL240K")',
            "unknown argument of @pytest.mark.stage 'chip'. Did you mean 'chips'? Known: bus_cycle, chips,",
        ),
        ('stage(chips="PCL240X")', "unknown chip 'PCL240X'. Did you mean 'PCL240K'"),
        ('stage("xyz", model="xy")', "@pytest.mark.stage: model is given twice."),
        ('model("xyy")', "unknown model 'xyy'. Did you mean"),
        ("model()", "@pytest.mark.model(): it takes model."),
        ('model("mine.xml")', "model 'mine.xml': there is no such file, from "),
        ('chips("PCL240K", x="PCL240K")', "@pytest.mark.chips: one chip for all axes"),
        ('chips(q="PCL240K")', "unknown axis 'q'"),
        ('board(layout="isa")', "unknown layout 'isa'"),
        ("board(bas=0)", "unknown argument of @pytest.mark.board 'bas'. Did you mean 'base'"),
        ("board()", 'this test names none: @pytest.mark.firmware("driver.c")'),
        ('firmware("driver.c", flag="-g")', "unknown argument of @pytest.mark.firmware 'flag'. Did you mean 'flags'"),
        ('firmware("none.c")', "firmware 'none.c': there is no such file, from "),
        ("firmware(3)", "firmware 3: a path in quotes is wanted."),
        ('firmware("lib.so", "driver.c")', "lib.so"),
        ('firmware("lib.so", flags="-O3")', "one library without flags, or sources (.c"),
        ('firmware("lib.so")', "lib.so is no shared library"),
    ],
    ids=lambda value: re.sub(r"\W+", "-", value)[:30] if "(" in value else "",
)
def test_a_wrong_marker_says_what_is_allowed_without_a_traceback(session, driver, pytester, marker, says):
    pytester.makefile(".so", lib="no library")
    result, text = session(f"@pytest.mark.{marker}\ndef test_it(host): pass")
    if marker == 'firmware("lib.so", "driver.c")':
        assert "CompileError" in text or result.parseoutcomes().get("skipped")
        return
    result.assert_outcomes(errors=1)
    assert says in text
    assert "Traceback" not in text
    assert ".py:" not in text.partition("short test summary")[0]


@needs_cc
def test_firmware_is_in_the_folder_of_the_test_or_the_root(pytester, driver):
    pytester.makeini("[pytest]")
    folder = pytester.mkdir("inner")
    (folder / "near.c").write_text(DRIVER.replace("return 7", "return WHAT"))
    (folder / "test_inner.py").write_text(
        "import pytest\n"
        "@pytest.mark.parametrize('code', [pytest.param(7, marks=pytest.mark.firmware('driver.c')),\n"
        "    pytest.param(8, marks=pytest.mark.firmware('near.c', flags='-DWHAT=8'))])\n"
        "def test_it(host, code): assert host.run().code == code\n"
    )
    pytester.runpytest_inprocess(*PLUGIN).assert_outcomes(passed=2)


@needs_cc
def test_firmware_at_wrong_pins_never_passes(session, pytester):
    (pytester.path / "steps.c").write_text(
        "#include <pulsestage.h>\nPULSESTAGE_MAIN { for (int k = 0; k < 64; k++) { ps_pin_write(2, 1); ps_pin_write(3, 1);"
        "ps_delay_us(50); ps_pin_write(2, 0); ps_pin_write(3, 0); ps_delay_us(950); } return 0; }"
    )
    source = """
        from stage.testing import *
        pytestmark = [pytest.mark.stage("xy", chips="stepdir"), pytest.mark.firmware("steps.c", pins="x.step=5,y.step=3")]
        def test_nothing(host): assert host.run().code == 0
        def test_lost_steps(host, stage): host.run(); assert_no_lost_steps(stage); 1 / 0
        def test_diagnostics(host, stage): host.run(); assert_no_diagnostics(stage); 1 / 0
        def test_place(host, stage): host.run(); assert_at(stage.axes["x"], 0.0); 1 / 0
        def test_rest(host, stage): host.run(); assert_stopped(stage); 1 / 0
        def test_another_axis(host, stage): host.run(); assert_no_lost_steps(stage.axes["y"]); 1 / 0
        @pytest.mark.firmware(pins="x.step=2,y.step=3")
        def test_right_wiring(host, stage): host.run(); assert_no_lost_steps(stage)
        """
    result, text = session(source)
    result.assert_outcomes(passed=1, failed=6)
    assert text.count("x.step = 5 never changed; the program toggles 2. Name") >= 5
    assert text.count("E   ZeroDivisionError") == 1, "only y was asked about"


@needs_cc
def test_the_same_sources_and_flags_are_built_once_a_session(session, driver, pytester, monkeypatch):
    compiler = pytester.path / "mycc"
    compiler.write_text(f'#!/bin/sh\necho built >> {pytester.path}/builds\nexec {shutil.which("cc")} "$@"\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", str(compiler))
    source = """
        pytestmark = pytest.mark.firmware("driver.c")
        def test_one(host): pass
        def test_two(host): pass
        @pytest.mark.firmware(flags=["-O0"])
        def test_three(host): pass
        """
    for _ in range(2):
        session(source)[0].assert_outcomes(passed=3)
    assert (pytester.path / "builds").read_text().split() == ["built"] * 4


@needs_cc
def test_firmware_may_be_a_library_that_is_built_already(session, driver, pytester):
    build(driver, pytester.path / "ready.so")
    result, _ = session('@pytest.mark.firmware("ready.so")\ndef test_it(host): assert host.run().code == 7')
    result.assert_outcomes(passed=1)


@needs_cc
def test_a_compile_error_of_firmware_has_the_text_of_the_compiler(session, pytester):
    pytester.makefile(".c", driver="#include <pulsestage.h>\nPULSESTAGE_MAIN { return semicolon }")
    result, text = session('@pytest.mark.firmware("driver.c")\ndef test_it(host): pass')
    result.assert_outcomes(errors=1)
    assert "does not compile" in text
    assert "semicolon" in text
    assert "library.py" not in text


def test_without_a_compiler_tests_of_sources_are_skipped_and_say_so(session, driver, pytester, monkeypatch):
    monkeypatch.setenv("PATH", str(pytester.mkdir("empty")))
    for variable in ("CC", "CXX"):
        monkeypatch.delenv(variable, raising=False)
    result, text = session(FAILS + "def test_without_firmware(board): board.in8(0x300)\n", "-rs")
    result.assert_outcomes(skipped=1, passed=1)
    assert "no compiler for" in text
    assert "is on the PATH" in text


# --- what a failed test leaves ---


@needs_rerun
@needs_cc
def test_a_failed_test_leaves_recording_waveforms_and_bus_trace_and_names_them(session, driver, pytester):
    result, text = session(FAILS, model=None)
    result.assert_outcomes(failed=1)
    folder = pytester.path / FOLDER
    for opener, name in (("rerun", "recording.rrd"), ("gtkwave", "waveforms.vcd"), ("less", "bus.txt")):
        assert f"{opener} {FOLDER}/{name}\n" in text
        assert (folder / name).stat().st_size > 500
    RrdReader = pytest.importorskip("rerun.chunk").RrdReader
    entities = {chunk.entity_path for chunk in RrdReader(str(folder / "recording.rrd")).stream()}
    assert "/axes/x/position" in entities
    assert any(path.endswith("/cylinders") for path in entities)  # the stage as it looks, though the test ran without
    assert "POUT_n" in (folder / "waveforms.vcd").read_text()
    assert (pytester.path / ".pulsestage" / ".gitignore").read_text() == "*\n"


@needs_rerun
def test_a_failed_test_of_axes_of_any_name_leaves_its_files_too(session, pytester):
    (pytester.path / "odd.xml").write_text(odd_model().to_xml(), encoding="utf-8")
    result, printed = session(TURNS, model="odd.xml")
    result.assert_outcomes(failed=1)
    for name in ("recording.rrd", "waveforms.vcd"):
        assert f"{FOLDER}/{name}" in printed
        assert (pytester.path / FOLDER / name).stat().st_size > 500


@needs_cc
def test_the_report_shows_the_stage_the_log_and_the_last_bus_cycles(session, driver):
    _, text = session(FAILS)
    report = text[text.index("- PulseStage -") :]
    assert re.search(r"x \(PCL240K\) at 1\.2\d+ mm, commanded 1\.2500 mm, 0 full steps lost, no pulses", report)
    assert re.search(r"log of the firmware:\n +0\.0000\d+  started", report)
    cycles = re.findall(r"^ +\d\.\d{9}  30\dh [RW] ..h ", report, re.M)
    assert len(cycles) == 20


def test_without_a_board_the_bus_writes_are_described_in_words(session, pytester):
    session("def test_it_fails(stage):\n    stage.axes['x'].chip.write(0, 0x08)\n    stage.run(0.01)\n    assert 0")
    text = (pytester.path / FOLDER / "bus.txt").read_text()
    assert "x: 08  reset command" in text


@needs_rerun
def test_a_test_that_fails_in_a_user_fixture_leaves_files_as_well(session, pytester):
    result, text = session(
        "@pytest.fixture\ndef homed(stage):\n    stage.run(0.01)\n    assert 0\ndef test_it_fails(homed): pass"
    )
    result.assert_outcomes(errors=1)
    assert f"{FOLDER}/recording.rrd" in text
    assert (pytester.path / FOLDER / "recording.rrd").exists()


@needs_rerun
def test_two_tests_whose_long_names_begin_alike_have_a_folder_each(session, pytester):
    names = [f"test_{'long_' * 30}{end}" for end in ("one", "two")]
    session("".join(f"def {name}(stage):\n    stage.run(0.01)\n    assert 0\n" for name in names))
    folders = [path for path in (pytester.path / ".pulsestage").iterdir() if path.is_dir()]
    assert len(folders) == 2
    assert all((path / "recording.rrd").exists() for path in folders)


def test_the_folder_is_removed_when_the_test_passes_again(session, pytester):
    session(TURNS)
    assert (pytester.path / FOLDER).is_dir()
    session(TURNS.replace("assert 0", "assert True"))
    assert not (pytester.path / FOLDER).exists()


def test_the_folder_with_its_bus_trace_is_removed_when_the_test_passes_again(session, pytester):
    source = "def test_it_fails(stage):\n    stage.axes['x'].chip.write(0, 0x08)\n    stage.run(0.01)\n    assert 0"
    session(source)
    assert (pytester.path / FOLDER / "bus.txt").is_file()
    session(source.replace("assert 0", "assert True"))
    assert not (pytester.path / FOLDER).exists()


@needs_rerun
def test_the_folder_is_removed_with_several_recordings(session, pytester):
    source = """
        def test_it_fails(stage):
            start = stage.snapshot()
            stage.run(0.01)
            stage.restore(start)
            stage.run(0.01)
            assert 0
        """
    session(source)
    assert (pytester.path / FOLDER / "recording-2.rrd").is_file()
    session(source.replace("assert 0", "assert True"))
    assert not (pytester.path / FOLDER).exists()


@needs_rerun
def test_keep_all_keeps_those_of_passed_tests(session, pytester):
    result, _ = session(TURNS.replace("assert 0", "assert True"), "--pulsestage-keep=all")
    result.assert_outcomes(passed=1)
    assert (pytester.path / FOLDER / "recording.rrd").exists()


def test_output_is_in_the_folder_of_the_option_or_the_ini_file(session, pytester):
    pytester.makeini("[pytest]\npulsestage_output = build/left\n")
    session(TURNS)
    assert (pytester.path / "build/left/test_it.py.test_it_fails/recording.rrd").exists()
    first_result = pytester.mkdir("other") / "test_it.py.test_it_fails" / "notes.txt"
    first_result.parent.mkdir()
    first_result.write_text("keep me")
    session(TURNS, "--pulsestage-output=other")
    assert (first_result.parent / "recording.rrd").exists()
    session(TURNS.replace("assert 0", "assert True"), "--pulsestage-output=other")
    assert list(first_result.parent.iterdir()) == [first_result]
    assert not (pytester.path / "other" / ".gitignore").exists()  # the folder was there before


@pytest.mark.parametrize("how", ["option", "ini", "marker"])
def test_recording_can_be_off_and_the_report_says_so(session, pytester, how):
    if how == "ini":
        pytester.makeini("[pytest]\npulsestage_record = off\n")
    source = "@pytest.mark.stage(record=False)" + TURNS if how == "marker" else TURNS
    _, text = session(source, *(["--pulsestage-record=off"] if how == "option" else []))
    assert "no recording: it was off" in text
    assert not (pytester.path / FOLDER / "recording.rrd").exists()


def test_a_wrong_setting_ends_the_session_with_a_word(pytester):
    pytester.makeini("[pytest]\npulsestage_keep = some\n")
    result = pytester.runpytest_subprocess(*PLUGIN, *FEW)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines("*pulsestage_keep = some: known are failed, all.")


def test_an_error_of_the_folder_is_reported_and_hides_nothing(session, pytester):
    pytester.makefile(".txt", taken="a file")
    result, text = session(TURNS, "--pulsestage-output=taken.txt")
    result.assert_outcomes(failed=1)
    assert "nothing is saved: " in text
    assert "assert 0" in text


def test_an_error_of_a_file_is_reported_and_hides_nothing(session, pytester):
    for part in Path(stage.models.__path__[0]).glob("*.xml"):
        shutil.copy(part, pytester.path)
    result, text = session(
        """
        import os
        @pytest.mark.model("xy.xml")
        def test_it_fails(stage):
            stage.run(0.01)
            os.remove("xy.xml")
            assert not "at the end"
        """
    )
    result.assert_outcomes(failed=1)
    assert "at the end" in text
    assert "recording: not saved: no MJCF file at " in text
    assert "waveforms: gtkwave " in text


def test_a_recorded_test_may_restore_its_stage_and_record_it_itself(session, pytester):
    result, text = session(
        """
        import copy
        def test_it_fails(stage):
            start = stage.snapshot()
            stage.run(0.01)
            stage.restore(start)
            with stage.record() as recording:
                stage.run(0.02)
                with pytest.raises(Exception, match="close the recording"):
                    stage.reset()
            assert len(recording) == 20
            twin = copy.copy(stage)
            twin.run(0.1)
            stage.run(0.03)
            assert not "at the end"
        """
    )
    result.assert_outcomes(failed=1)
    assert "at the end" in text
    for k in (1, 2, 3):
        assert f"rerun {FOLDER}/recording-{k}.rrd" in text
        assert (pytester.path / FOLDER / f"waveforms-{k}.vcd").exists()


@needs_cc
def test_firmware_runs_again_to_the_same_bits_after_a_restore_and_recorded_or_not(session, driver, pytester):
    _, text = session(
        """
        from stage import Stage
        from stage.board import Board, NativeHost

        def bits(stage):
            chips = [chip.snapshot().record for chip in stage.chips]
            return stage.time, stage.data.qpos.tobytes(), stage.data.qvel.tobytes(), chips

        @pytest.mark.firmware("driver.c")
        def test_it_fails(stage, board, host):
            start = stage.snapshot()
            host.run()
            first = bits(stage)
            stage.restore(start)
            host.run()
            assert bits(stage) == first
            plain = Stage("xy")
            NativeHost(host.path, Board(plain)).run()
            assert bits(plain) == first
            assert_no_diagnostics(stage)
            assert not "at the end"
        """
    )
    assert "at the end" in text
    for k in (1, 2):
        assert (pytester.path / FOLDER / f"recording-{k}.rrd").exists()
        assert (pytester.path / FOLDER / f"waveforms-{k}.vcd").exists()


@needs_cc
def test_an_error_of_the_firmware_ends_its_traceback_in_the_test(session, driver):
    result, text = session('@pytest.mark.firmware("driver.c")\ndef test_it(host):\n    host.run(timeout=0.01)\n')
    result.assert_outcomes(failed=1)
    assert "HostTimeout: driver.so has not returned after 0.01 s" in text
    assert "test_it.py:" in text
    assert "native.py" not in text


@needs_cc
def test_ctrl_c_closes_the_recording_and_stops_the_firmware(session, driver, pytester):
    source = """
        import conftest
        @pytest.mark.firmware("driver.c")
        def test_it(stage, host):
            conftest.stage = stage
            host.run_for(0.01)
            raise KeyboardInterrupt
        """
    pytester.makeconftest(
        "def pytest_unconfigure():\n    print('LEFT', stage.recording, [' closed' in repr(r) for r in stage.recordings])\n"
    )
    result, text = session(source, "-s", no_reraise_ctrlc=True)
    assert result.ret == pytest.ExitCode.INTERRUPTED
    assert "LEFT None [True]" in text


@pytest.mark.slow
@needs_cc
def test_workers_of_xdist_share_builds_and_never_a_folder(pytester, driver, monkeypatch):
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    monkeypatch.delenv("PYTEST_XDIST_TESTRUNUID", raising=False)
    ids = ["a/b", "a:b", "A" * 200 + "1", "A" * 200 + "2", ""]
    pytester.makepyfile(
        f"""
        import pytest
        @pytest.mark.model("xy")
        @pytest.mark.firmware("driver.c")
        @pytest.mark.parametrize("which", {ids!r})
        def test_it(host, which):
            host.run()
            assert not which
        """
    )
    result = pytester.runpytest_subprocess(*PLUGIN, *FEW, "-n2", "--basetemp=temporary")
    result.assert_outcomes(passed=1, failed=4)
    result_found = {path.parent for path in (pytester.path / ".pulsestage").glob("*/recording.rrd")}
    assert len(result_found) == 4
    for folder in result_found:
        assert f"{folder.name}/recording.rrd" in result.stdout.str()
    assert len(list((pytester.path / "temporary" / "pulsestage-firmware").glob("*/driver.so"))) == 1


ENDS = {
    "exits": ("exit(0);", "driver.so ended its process with exit code 0; at *"),
    "aborts": ("abort();", "driver.so was ended by SIGABRT*"),
    "falls": ("raise(SIGSEGV);", "driver.so was ended by SIGSEGV*"),
}
TESTS = """
import pytest
@pytest.mark.model("xy")
@pytest.mark.firmware("driver.c")
def test_it_ends(host): host.run(timeout=5)
def test_after_it(): assert 0
"""


def ending(driver, call):
    head = "#include <signal.h>\n#include <stdlib.h>\n#include"
    driver.write_text(DRIVER.replace("return 7;", call).replace("#include", head, 1))


@needs_cc
@pytest.mark.skipif(os.name != "posix", reason="elsewhere firmware has no process of its own")
@pytest.mark.parametrize("how", ["exits", *(pytest.param(how, marks=pytest.mark.slow) for how in ("aborts", "falls"))])
def test_firmware_that_ends_its_process_fails_its_test_and_the_tests_after_it_run(how, pytester, driver):
    # pytest, with PULSESTAGE_MAIN { ... exit(0); } in driver.c
    call, text = ENDS[how]
    ending(driver, call)
    pytester.makepyfile(TESTS)
    result = pytester.runpytest_subprocess(*PLUGIN, *FEW)
    result.assert_outcomes(failed=2)
    assert result.ret == pytest.ExitCode.TESTS_FAILED
    result.stdout.fnmatch_lines(f"*HostError: {text}")


# --- the page ---


@needs_rerun
@needs_cc
def test_the_example_of_the_page_passes_and_its_broken_version_fails(pytester):
    page = PAGE.read_text()
    (source,) = re.findall(r"```c\n(/\* driver\.c.*?)```", page, re.S)
    (tests,) = re.findall(r"```python\n(# test_driver\.py.*?)```", page, re.S)
    pytester.makefile(".c", driver=source)
    pytester.makepyfile(test_driver=tests)
    pytester.runpytest_inprocess(*PLUGIN).assert_outcomes(passed=tests.count("def test_"))
    (pytester.path / "driver.c").write_text(source.replace("800, 30}", "800, 2}"))
    result = pytester.runpytest_inprocess(*PLUGIN)
    result.assert_outcomes(failed=1)
    output = result.stdout.str()
    for block in re.findall(r"says:\n\n((?: {4}.*\n)+)|and\n\n((?: {4}.*\n)+)", page, re.M):
        for line in "".join(block).splitlines():
            assert NUMBER.sub("#", line.strip()) in NUMBER.sub("#", output)


@pytest.mark.parametrize("argument", [{"isolated": True}, {"isolated": False}])
def test_a_marker_selects_whether_firmware_has_a_separate_process(argument, request):
    """@pytest.mark.firmware("driver.c", isolated=True)"""
    marks = [pytest.Mark("firmware", (__file__,), argument, _ispytest=True)]
    node = SimpleNamespace(path=Path(__file__), config=request.config, iter_markers=lambda: iter(marks))
    result = read_firmware_arguments(node)
    assert result["sources"] == [Path(__file__)]
    assert result.get("isolated", False) == argument["isolated"]


def test_arguments_that_a_marker_omits_are_those_of_the_command_line_or_the_ini_file(tmp_path):
    """pulsestage_firmware = in-process; the same name in the test's folder and in that of the session"""
    (tmp_path / "sub").mkdir()
    for folder, names in ((tmp_path, "ab"), (tmp_path / "sub", "bc")):
        for name in names:
            (folder / f"{name}.c").touch()
    text = {"option": None, "ini": None}
    config = SimpleNamespace(rootpath=tmp_path, getoption=lambda name: text["option"], getini=lambda name: text["ini"])
    marks = [pytest.Mark("firmware", ("a.c", "b.c", "c.c"), {}, _ispytest=True)]
    node = SimpleNamespace(path=tmp_path / "sub" / "test_it.py", config=config, iter_markers=lambda: iter(marks))
    isolated = []
    for option, ini in ((None, None), (None, "in-process"), ("in-process", None), ("isolated", "in-process")):
        text |= {"option": option, "ini": ini}
        result = read_firmware_arguments(node)
        isolated.append(result["isolated"])
    assert isolated == [os.name == "posix", False, False, os.name == "posix"]
    assert result["sources"] == [tmp_path / "a.c", tmp_path / "sub" / "b.c", tmp_path / "sub" / "c.c"]
    assert (result["flags"], result["platform"]) == ((), None)
    marks[0] = pytest.Mark("firmware", ("d.c",), {}, _ispytest=True)
    with pytest.raises(FileError, match=r"firmware 'd.c': there is no such file, from .*sub or "):
        read_firmware_arguments(node)


@pytest.mark.slow
def test_firmware_of_another_platform_is_built_for_it(session, pytester, driver):
    pytester.makefile(".c", program="#include <dos.h>\nvoid main(void) { delay(5); exit(3); }\n")
    pytester.makefile(".ino", sketch="void setup() { pulsestage::end(4); }\nvoid loop() {}\n")
    result, _ = session("""
        @pytest.mark.firmware("program.c", platform="dos")
        def test_dos(host):
            result = host.run(timeout=1)
            assert (result.code, result.seconds) == (3, 0.005)

        @pytest.mark.firmware("sketch.ino")
        def test_sketch(host):
            assert host.run(timeout=1).code == 4

        @pytest.mark.firmware("program.c", platform="windows")
        def test_none(host):
            pass
        """)
    result.assert_outcomes(passed=2, errors=1)
    assert "platform 'windows'" in result.stdout.str()
