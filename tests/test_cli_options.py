"""Each option of the command line arrives where it is meant for; defaults and exit codes are those that the help tells."""

import argparse
import contextlib
import io
import math
import re
import signal
import sys
import threading
from types import SimpleNamespace

import pytest
from support.extras import needs_rerun

from stage import ArgumentError, Stage, StageError, firmware
from stage.chips.write_diagnostics import Cause, Diagnostic
from stage.cli import build_parser, demo, home, listing, main, move, output_and_progress, output_files, stage_setup
from stage.cli.erratum import ErratumResult
from stage.cli.fault import demonstrations
from stage.cli.options import QuantityParser
from stage.cli.run import print_report
from stage.firmware.driver import Speeds, get_default_speeds, get_driver
from stage.recording import rerun_viewer
from stage.support import opengl
from stage.support.files import FileError


@pytest.fixture(scope="module")
def shared_stage():
    return Stage("xy", visuals=False)


@pytest.fixture
def bench(shared_stage, monkeypatch, tmp_path):
    """Make the commands use one reset stage in a temporary folder."""
    shared_stage.reset()
    monkeypatch.chdir(tmp_path)
    for module in (home, move):
        monkeypatch.setattr(module, "make_stage", lambda args: shared_stage)
    return shared_stage


def list_parsers():
    commands = next(a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction))
    return commands.choices


def test_each_help_text_states_the_actual_default():
    checked = 0
    for name, parser in list_parsers().items():
        for action in parser._actions:
            match = re.search(r"\(default: ([\w.,-]+)\)", action.help or "")
            if (
                match
                and (action.type in (int, float) or isinstance(action.type, QuantityParser))
                and action.dest != "start"
            ):
                checked += 1
                assert float(match[1].replace(",", "")) == action.default, (name, action.dest)
    assert checked >= 30


def test_what_the_commands_do_without_options():
    p = build_parser()
    options = vars(p.parse_args(["move", "x", "100"]))
    expected = {
        "model": "xyz",
        "chips": "PCL240K",
        "bus_voltage": 24.0,
        "microsteps": 16,
        "bus_cycle": 1e-6,
        "port": 9090,
    }
    assert expected.items() <= options.items()
    assert not any(
        options[k] for k in ("constant", "force", "view", "web", "automatic", "s_curve", "motor", "fl", "start")
    )
    assert (options["axis"], options["distance"]) == ("x", "100")
    assert p.parse_args(["run", "a.c"]).timeout == 60
    assert p.parse_args(["run", "a.c"]).keep == 1_000_000
    assert p.parse_args(["demo"]).default_record == "demo.rrd"
    assert p.parse_args(["erratum"]).chips == "MCX304"
    pullout = p.parse_args(["pullout"])
    assert (pullout.motor, pullout.bus_voltage, pullout.microsteps) == ("17HS4401", 24.0, 16)
    assert p.parse_args(["view"]).model == "xyz"


def test_the_bench_options_make_the_stage():
    options = "--model xy --chips pcl240mk --motor 17HS15-1504S --microsteps 8 --bus-voltage 36 --bus-cycle 2e-6"
    stage = stage_setup.make_stage(build_parser().parse_args(["move", "x", "1", *options.split()]))
    x = stage.axes["x"]
    assert list(stage.axes) == ["x", "y"]
    assert (type(x.chip).__name__, stage.state.bus) == ("PCL240MK", 2000)
    assert (x.drive.motor.name, x.drive.microsteps, x.drive.bus_voltage) == ("17HS15-1504S", 8, 36)


def make_move_report(**more):
    drawn = lambda path, overwrite: None  # noqa: E731
    return SimpleNamespace(
        **{"ok": True, "plot": drawn, "listing": str, "stopped_by": "ORG", "lost_steps": 0, "plan": ""} | more
    )


def test_an_encoder_counts_a_metre_or_a_turn_of_the_motor():
    setting = stage_setup.parse_encoder("y=-200000")
    assert (setting.axis, setting.per_metre, setting.per_turn) == ("y", -200_000.0, None)
    setting = stage_setup.parse_encoder("x=2000/turn")
    assert (setting.axis, setting.per_metre, setting.per_turn) == ("x", None, 2000.0)
    for wrong in ("x=0", "=5", "x=", "x=2000/revolution", "x=inf", "x=many"):
        with pytest.raises(ArgumentError, match="write AXIS=COUNTS"):
            stage_setup.parse_encoder(wrong)


def note_calls(monkeypatch, name, **values):
    """Replace a procedure of stage.firmware; return the list of its calls, as positional and keyword arguments."""
    calls = []

    def procedure(*args, **kwargs):
        calls.append((args, kwargs))
        return make_move_report(**values)

    monkeypatch.setattr(firmware, name, procedure)
    return calls


@pytest.mark.parametrize(
    ("options", "axes", "direction", "index", "by"),
    [
        ("", "xy", -1, 0, None),
        ("y x --plus", "yx", 1, 0, None),
        ("x --ez 3 --chips pcl240mk", "x", -1, 3, None),
        ("x --by index --chips mcx514", "x", -1, 0, "index"),
        ("x --ez 1 --chips mcx514", "x", -1, 1, None),
    ],
)
def test_home_searches_as_the_options_say(monkeypatch, options, axes, direction, index, by):
    calls = note_calls(monkeypatch, "home")
    assert main(["home", *options.split(), "--model", "xy"]) == 0
    assert [args[0].name for args, _ in calls] == list(axes)
    for args, kwargs in calls:
        assert (args[1], kwargs["index"], kwargs["by"]) == (direction, index, by)


@pytest.mark.parametrize(
    ("options", "fields"),
    [
        ("home x", {}),
        ("home x --constant", {"constant": True}),
        ("home x --fast-only", {"approach": 0.0}),
        ("move x 100 --s-curve", {"s_curve": True}),
        ("move x 100 --s-curve 0.3", {"s_curve": 0.3}),
        ("move x 100 --automatic", {"automatic": True}),
        ("move x 100 --no-automatic", {"automatic": False}),
        ("move x 100 --fl 700 --fh1 9000 --fh2 15kpps --accel 200ms --decel 0.4", {
            "start": 700, "drive": 9000, "second": 15_000, "up": pytest.approx(0.2 * 14_300 / 8300),
            "down": pytest.approx(0.4 * 14_300 / 8300)}),
        ("move x 100 --accel 0.4", {"up": pytest.approx(0.4 * 31 / 15), "down": pytest.approx(0.4 * 31 / 15)}),
        ("move x 100 --decel 0.2", {"down": pytest.approx(0.2 * 31 / 15)}),
        ("move x 100 --speed 50mm/s --fl 150mm/min", {
            "start": pytest.approx(800), "drive": pytest.approx(16_000), "second": pytest.approx(32_000)}),
        ("move x 100 --fh1 500", {"start": 500, "drive": 500, "second": 1000}),
        ("move x 100 --fh2 500", {"start": 500, "second": 500}),
        ("move x 100 --chips mcx304 --model xy --fh1 4000", {"drive": 4000, "second": None}),
        ("sync x=5 y=4 --rate 9000 --fl 500 --accel 0.3", {
            "start": 500, "drive": 9000, "up": 0.3, "down": 0.3, "second": None}),
        ("sync x=5 y=4 --s-curve 0.2 --no-automatic", {"s_curve": 0.2, "automatic": False, "second": None}),
    ],
)  # fmt: skip
def test_speeds_are_as_the_options_say_and_else_the_usual_ones(bench, monkeypatch, options, fields):
    """stage move x 100 --accel 0.4: both ramps, to FH1; --fh1 500: also the rate at the start; FH2 is twice FH1"""
    if "--chips" in options:
        monkeypatch.setattr(move, "make_stage", stage_setup.make_stage)
    monkeypatch.setattr("stage.firmware.pcl240.driver.Pcl240Driver.describe_speeds", lambda *_: "")
    calls = note_calls(monkeypatch, {"sync": "line"}.get(command := options.split()[0], command))
    assert main(options.split()) == 0
    ((args, kwargs),) = calls
    usual = get_default_speeds(bench.axes["x"].chip)._replace(second=2 * get_default_speeds(bench.axes["x"].chip).drive)
    assert kwargs["speed"] == usual._replace(**fields)
    assert args[0] == {"x": 5, "y": 4} if command == "sync" else args[0].name == "x"


def test_home_refuses_an_index_pulse_that_the_chip_cannot_count(monkeypatch, capsys):
    assert main(["home", "x", "--by", "index", "--ez", "2", "--model", "xy", "--chips", "mcx514"]) == 2
    assert "--ez 2: an MCX514 ends at ORG, or at index pulse 1 after it." in capsys.readouterr().err


def test_a_plot_alone_has_as_many_samples_as_it_needs(bench, monkeypatch):
    usual = {
        "record": None,
        "view": False,
        "web": False,
        "picture": None,
        "vcd": None,
        "force": False,
        "plot": "a.png",
        "json": False,
    }
    for plot, every in (("a.png", 2.5e-4), (None, None)):
        args = argparse.Namespace(**usual | {"plot": plot, "port": 1, "default_record": None})
        with output_files.record_for_plot(args, bench, 2.5e-4) as recording:
            assert (recording is None) == (every is None)
            assert recording is None or recording.every == pytest.approx(every)


def test_home_draws_the_first_axis(bench, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        firmware, "home", lambda axis, *_, **__: make_move_report(plot=lambda path, overwrite: drawn.append(axis.name))
    )
    assert main(["home", "y", "x", "--plot", "a.png"]) == 0
    assert drawn == ["y"]


@pytest.mark.parametrize("option", ["--fl", "--fh1", "--fh2", "--accel", "--decel"])
@pytest.mark.parametrize("value", ["0", "-1", "inf", "nan"])
def test_speeds_and_ramps_are_greater_than_nothing_and_finite(option, value, capsys):
    with pytest.raises(SystemExit):
        main(["move", "x", "100", option, value])
    assert f"argument {option}: {value} must be greater than 0, and finite." in capsys.readouterr().err


def test_distances_are_typed_in_units_of_the_axis(bench):
    x = bench.axes["x"]
    hinge = SimpleNamespace(
        unit="rad", name="t", meters_per_pulse=math.radians(1e-6), gear=1.0, chip=x.chip, drive=x.drive
    )
    per_mm = 1e-3 / x.meters_per_pulse
    for text, mm in (("10mm", 10), ("-1cm", -10), ("0.02m", 20), ("500um", 0.5), ("50000nm", 0.05)):
        assert stage_setup.parse_distance(x, text) == round(mm * per_mm), text
    assert (stage_setup.parse_distance(x, "0x10"), stage_setup.parse_distance(x, " -7 ")) == (16, -7)
    for text, degrees in (("10deg", 10), ("-0.5deg", -0.5), ("1rad", math.degrees(1)), ("20mrad", math.degrees(0.02)),
                          ("300urad", math.degrees(3e-4))):  # fmt: skip
        assert stage_setup.parse_distance(hinge, text) == round(degrees * 1e6), text
    for axis, wrong in ((x, "1deg"), (hinge, "1mm"), (x, "1.5"), (x, "mm")):
        with pytest.raises(
            ArgumentError, match=r"give a whole number of pulses for axis ., such as 8000, or a distance in"
        ):
            stage_setup.parse_distance(axis, wrong)


def test_two_outputs_may_share_a_device_and_no_file(tmp_path):
    kinds = ("record", "vcd", "picture", "plot", "trace")
    args = argparse.Namespace(**dict.fromkeys(kinds), force=False, web=False)
    args.vcd = args.trace = "/dev/null"
    output_files.check_outputs(args)
    args.vcd, args.trace = str(tmp_path / "a"), str(tmp_path / "b" / ".." / "a")
    (tmp_path / "b").mkdir()
    with pytest.raises(FileError, match="--vcd and --trace both write"):
        output_files.check_outputs(args)


def test_a_usual_name_is_the_next_that_is_free_and_with_force_always_itself(bench, monkeypatch):
    for name in ("stage.rrd", "stage-2.rrd"):
        open(name, "w").close()
    assert [output_files.find_free_name("stage.rrd", force) for force in (False, True)] == ["stage-3.rrd", "stage.rrd"]
    saved = []
    recording = SimpleNamespace(
        save=lambda path, overwrite: (open(path, "w").close(), saved.append(path)), duration=0.0
    )

    @contextlib.contextmanager
    def record():
        yield recording
        open("stage-3.rrd", "w").close()  # another command has taken the name meanwhile

    monkeypatch.setattr(bench, "record", record)
    monkeypatch.setattr(rerun_viewer, "open_viewer", lambda path: saved.append(f"view {path}"))
    monkeypatch.setattr(rerun_viewer, "check_screen", lambda what: None)
    args = argparse.Namespace(
        record=None, vcd=None, picture=None, plot=None, trace=None, view=True, web=False, force=False, written_files=[]
    )
    with output_files.record_to_files(args, bench):
        pass
    assert saved == ["stage-4.rrd", "view stage-4.rrd"]


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        (["move", "x", "1", "--chips", "x=pcl240k,x=mcx304"], "axis x already has pcl240k"),
        (["run", "a.c", "--place", "x=1", "--place", "x=2", "--model", "xy"], "axis x already has a place"),
    ],
)
def test_what_is_typed_twice_or_is_nothing_is_refused(capsys, typed, message):
    assert main(typed) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(("command", "default"), [("run", "PCL240K"), ("serve", "PCL240K"), ("replay", "stepdir")])
def test_the_help_of_chips_lists_step_dir_axes_and_the_default_of_the_command(capsys, command, default):
    with pytest.raises(SystemExit):
        main([command, "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert re.search(
        rf"chip of every axis: PCL240K, .* HCTL1100, STEPDIR; .*x=CHIP,y=CHIP \(default: {default}\)", text
    )


def test_a_report_of_mistakes_has_the_first_of_each_kind_and_strays_by_their_times(capsys):
    diagnostics = [
        Diagnostic(clock, 0, 0x11, text, "page") for clock, text in ((5, "a"), (7, "b"), (9, "a"), (11, "a"))
    ]
    chip = SimpleNamespace(diagnostics=diagnostics, clock_hz=1, find_cause_of=lambda d: Cause("bus write", 1))
    stray = SimpleNamespace(times=3)
    stage = SimpleNamespace(axes={}, chips=[chip])
    print_report(SimpleNamespace(stage=stage, strays=[stray, SimpleNamespace(times=4)], join_axis_names=lambda k: "x"))
    out = capsys.readouterr().out
    assert "chip of x: 4 bus writes that" in out
    assert re.findall(r"(\d+)\.000000 s, address 0 <- 11h: (.*)", out) == [
        ("5", "a [page] (3 times)"),
        ("7", "b [page]"),
    ]
    assert "7 bus cycles reached no chip" in out


def test_a_run_gives_the_signal_that_ends_it_back(bench):
    from stage.cli.run import _raise_at_sigterm

    before = signal.getsignal(signal.SIGTERM)
    with _raise_at_sigterm(SimpleNamespace(), threading.Event()):
        assert signal.getsignal(signal.SIGTERM) is not before
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.parametrize(
    ("ends", "code"),
    [
        ((("ORG", 0), ("EZ", 0)), 0),
        ((("ORG", 0), ("EL", 0)), 1),
        ((("EL", 0), ("ORG", 0)), 1),
        ((("ORG", -4), ("ORG", 0)), 1),
    ],
)
def test_home_ends_with_1_if_one_axis_is_not_at_home(bench, monkeypatch, ends, code):
    reports = iter([make_move_report(stopped_by=by, lost_steps=lost) for by, lost in ends])
    monkeypatch.setattr("stage.firmware.pcl240.driver.origin_return", lambda *_, **__: next(reports))
    assert main(["home"]) == code


def test_a_dual_rate_move_prints_the_speeds_that_the_registers_reach(bench, monkeypatch, capsys):
    calls = []

    def two_rates(axis, *, pulses, speed, dwell, rates):
        calls.append((axis.name, pulses, speed, dwell, rates, axis.position))
        return make_move_report(ok=False)

    monkeypatch.setattr("stage.firmware.procedures.move_at_two_rates", two_rates)
    speeds = Speeds(700, 9000, 0.2, 0.4, second=15_000)
    options = "--fl 700 --fh1 9000 --fh2 15000 --accel 0.2 --decel 0.4 --from -12.5"
    assert main(["dual-rate", "y", "3000", *options.split()]) == 1, "it did not go as asked"
    assert calls == [("y", 3000, speeds, 0.1, ["FH1", "FH2", "FH1"], pytest.approx(-0.0125))]
    assert str(get_driver(bench.axes["y"]).build_profile(speeds)) in capsys.readouterr().out


def test_the_board_of_run_lies_where_the_options_say(monkeypatch):
    calls = []

    def board(*args, **more):
        calls.append((args[1:], more))
        raise ArgumentError("enough")

    monkeypatch.setattr("stage.board.Board", board)
    where = "--layout pcl240-card --base 0x2A0 --stride 16 --keep 77 --model xy --device uart:0x3F8 --device latch:7"
    assert main(["run", "a.c", *where.split()]) == 2
    assert calls == [(("pcl240-card", 0x2A0, 16), {"keep_cycles": 77, "devices": ["uart:0x3F8", "latch:7"]})]


@pytest.mark.parametrize(
    ("lost", "allowed", "code", "text"),
    [
        (4, None, 1, "x has lost 4 full steps: exit code 1. If it runs against a stop on purpose"),
        (0, None, 0, ""),
        (-4, "x=3", 1, "x has lost 4 full steps, and --allow-lost-steps allows 3: exit code 1."),
        (-4, "x=4", 0, ""),
        (4, "y=4", 2, ""),
        (4, "x=few", 2, ""),
    ],
)
def test_a_firmware_that_loses_more_steps_than_allowed_ends_with_1(monkeypatch, capsys, lost, allowed, code, text):
    timeouts = []
    done = SimpleNamespace(code=0, seconds=0.0, cycles=0)
    host = SimpleNamespace(
        path=SimpleNamespace(name="a"),
        run=lambda timeout: timeouts.append(timeout) or done,
        wiring_problems=(),
        wiring_findings=(),
    )
    chip = SimpleNamespace(explain_missing_current=lambda axis: "")
    stage = SimpleNamespace(axes={"x": SimpleNamespace(name="x", lost_steps=lost, chip=chip, chip_axis=0)})
    monkeypatch.setattr("stage.cli.stage_setup.make_stage", lambda args: stage)
    monkeypatch.setattr("stage.cli.run.print_report", lambda *_: None)
    monkeypatch.setattr("stage.board.Board", lambda *_, **__: SimpleNamespace(log=[], stage=stage))
    monkeypatch.setattr("stage.board.NativeHost", lambda *_, **__: host)
    assert main(["run", "a.c", "--timeout", "1.5", *(["--allow-lost-steps", allowed] if allowed else [])]) == code
    printed = capsys.readouterr().out
    assert text in printed
    assert ("has lost" in printed) == bool(text)
    assert timeouts == [1.5] * (code < 2)


@pytest.mark.parametrize(
    ("raised", "code", "says"),
    [
        (KeyboardInterrupt(), 130, "stage: interrupted.\n"),
        (PermissionError("no"), 2, "stage: no\n"),
        (FileNotFoundError("gone"), 2, "stage: gone\n"),
        (ArgumentError("so"), 2, "stage: so\n"),
    ],
    ids=lambda v: type(v).__name__,
)
def test_what_ends_a_command_is_its_exit_code(monkeypatch, capsys, raised, code, says):
    def end(args):
        raise raised

    monkeypatch.setattr(listing, "print_registers", end)
    assert main(["registers", "pcl240k"]) == code
    assert capsys.readouterr().err == says


def test_the_version_is_the_package_s(capsys):
    from stage import __version__

    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert (end.value.code, capsys.readouterr().out) == (0, f"pulsestage {__version__}\n")


@needs_rerun
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ("--view", ("viewer", "stage.rrd")),
        ("--web", ("web", "stage.rrd", 9090)),
        ("--web --view --port 8123 --record a.rrd", ("web", "a.rrd", 8123)),
        ("--record a.rrd", None),
    ],
)
def test_options_choose_the_viewer_of_a_recording(bench, monkeypatch, options, expected):
    opened = []
    monkeypatch.setattr(rerun_viewer, "open_viewer", lambda *args: opened.append(("viewer", *args)))
    monkeypatch.setattr(rerun_viewer, "check_screen", lambda what: opened.append("screen"))
    monkeypatch.setattr(rerun_viewer, "serve_web", lambda *args: opened.append(("web", *args)))
    monkeypatch.setattr(firmware, "move", lambda axis, *_, **__: axis.wait(1e-3) or make_move_report())
    assert main(["move", "x", "10", *options.split()]) == 0
    screen = ["screen"] if expected and expected[0] == "viewer" else []
    assert opened == screen + ([expected] if expected else [])


@needs_rerun
@pytest.mark.parametrize(
    ("options", "screen", "viewed"),
    [("", True, True), ("", False, False), ("--no-view", True, False), ("--web", True, False), ("--view", False, True)],
)
def test_the_demo_opens_the_viewer_if_a_screen_exists(bench, monkeypatch, options, screen, viewed):
    calls = []

    def recorded(args, stage):
        calls.append((args.view, [round(axis.position, 6) for axis in stage.axes.values()]))
        raise ArgumentError("enough")

    monkeypatch.setattr("stage.support.opengl.has_screen", lambda: screen)
    monkeypatch.setattr("stage.cli.demo.make_stage", lambda args: bench)
    monkeypatch.setattr("stage.cli.demo.record_to_files", recorded)
    assert main(["demo", *options.split()]) == 2
    assert calls == [(viewed, [0.062, -0.031])], "where the carriages happen to stand"


def make_report(axis, procedure="move", asked=5, **fields):
    values = {
        "axis": axis, "procedure": procedure, "asked": asked, "pulses": 5, "duration": 0.1, "peak_rate": 1e3, "position": 1e-3,
        "unit": "m", "lost_steps": 0, "lost_pulses": 0, "ok": True, "stopped_by": "ORG" if asked is None else "R0 = 0",
    }  # fmt: skip
    return SimpleNamespace(**values | fields)


@pytest.mark.parametrize(("ends", "code"), [((True, True), 0), ((True, False), 1), ((False, True), 1)])
def test_a_demo_of_which_one_move_fails_ends_with_1(bench, monkeypatch, capsys, ends, code):
    monkeypatch.setattr("stage.cli.demo.make_stage", lambda args: bench)
    monkeypatch.setattr("stage.cli.demo.record_to_files", lambda args, stage: contextlib.nullcontext())
    monkeypatch.setattr("stage.cli.demo.make_moves", lambda stage: [make_report("x", ok=end) for end in ends])
    assert main(["demo", "--no-view"]) == code


@pytest.mark.parametrize(
    ("fields", "good"),
    [
        ({"asked": None}, "yes"),
        ({"asked": None, "stopped_by": "EL-"}, "NO"),
        ({"asked": None, "ok": False}, "NO"),
        ({}, "yes"),
        ({"ok": False}, "NO"),
    ],
)
def test_the_table_of_the_demo_marks_moves_that_missed_their_target(fields, good):
    """Count an origin return that ended at a limit switch as missed, though no step was lost."""
    row = demo.format_row(make_report("y", **fields))
    assert (row[0], row[2], row[-1]) == ("y", "to ORG" if "asked" in fields else "+5", good)


def test_the_demo_homes_moves_at_two_rates_and_draws_a_line(bench, monkeypatch, capsys):
    line = SimpleNamespace(
        axes={n: make_report(n, "line") for n in "xy"}, deviation=SimpleNamespace(pulses=0.82), skew=1.25e-6
    )
    monkeypatch.setattr(firmware, "home", lambda axis, **_: make_report(axis.name, "origin return", None))
    monkeypatch.setattr(
        "stage.firmware.procedures.move_at_two_rates", lambda axis, **_: make_report(axis.name, "two rates")
    )
    monkeypatch.setattr(firmware, "move", lambda axis, **_: make_report(axis.name))
    monkeypatch.setattr(firmware, "line", lambda *_, **__: line)
    moves = [(r.axis, r.procedure) for r in demo.make_moves(bench)]
    assert moves == [
        ("y", "origin return"),
        ("x", "origin return"),
        ("x", "two rates"),
        ("y", "move"),
        ("x", "line"),
        ("y", "line"),
    ]
    assert "0.82 pulses from the straight line at most, started within 1.2 us of each other" in capsys.readouterr().out


def test_a_demo_of_axes_that_draw_no_line_together_says_so(monkeypatch, capsys):
    stage = Stage("xy", chips={"x": "PCL240K", "y": "MCX304"}, visuals=False)
    monkeypatch.setattr(firmware, "home", lambda axis, **_: make_report(axis.name, "origin return", None))
    assert [r.procedure for r in demo.make_moves(stage)] == ["origin return"] * 2 + ["dual-rate move", "move"]
    assert "no straight line: MCX304 and PCL240K draw no line together" in capsys.readouterr().out


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_progress_is_printed_on_a_terminal_but_not_in_a_pipe(monkeypatch):
    """stage pullout on a terminal: one line that counts up"""
    for screen, expected in (
        (Terminal(), "writing ...\n\rpull-out   0%\rpull-out  50%\rpull-out 100%\n"),
        (io.StringIO(), ""),
    ):
        monkeypatch.setattr("sys.stderr", screen)
        output_and_progress.show_status("writing ...")
        for done in (0, 0.5, 1.0):
            output_and_progress.show_progress("pull-out", done)
        assert screen.getvalue() == expected


MOVED = {"n-DRV 2 s later": 0, "pulses past the target": 0, "lost steps": 0}
RAN_AWAY = {"n-DRV 2 s later": 1, "pulses past the target": 9000, "lost steps": 4}


@pytest.mark.parametrize(
    ("corrected", "bare", "guarded", "claimed"),
    [
        (False, RAN_AWAY, MOVED, True),
        (True, MOVED, MOVED, True),
        (True, RAN_AWAY, MOVED, False),
        (False, MOVED, MOVED, False),
        *((False, RAN_AWAY | change, MOVED, False) for change in ({"n-DRV 2 s later": 0}, {"lost steps": 0})),
        *((False, RAN_AWAY, MOVED | {name: RAN_AWAY[name]}, False) for name in MOVED),
        *((True, MOVED | {name: RAN_AWAY[name]}, MOVED, False) for name in MOVED),
    ],
)
def test_the_erratum_is_as_claimed_where_all_its_figures_are(corrected, bare, guarded, claimed):
    assert ErratumResult("MCX304", corrected, (bare, guarded), (None, None)).as_claimed == claimed


def test_pullout_measures_the_drive_of_its_options(monkeypatch, capsys, tmp_path):
    calls = []
    monkeypatch.setattr(
        "stage.drives.dynamometer.tabulate_pull_out", lambda drive, progress: calls.append(drive) or "table"
    )
    monkeypatch.setattr("stage.drives.pull_out_plot.plot_pull_out", lambda *args, **how: calls.append((args[2], how)))
    plot = str(tmp_path / "p.png")
    assert main(["pullout", "--motor", "17HS15-1504S", "--bus-voltage", "36", "--microsteps", "8", "--plot", plot]) == 0
    likely = "its core loss is likely 0.00023 to 0.00072 N m s/rad"
    table, _, sentence, drawn = capsys.readouterr().out.splitlines()
    assert (table, drawn) == ("table", f"{plot}: drawn")
    assert sentence.startswith(f"No pull-out curve of the 17HS15-1504S is at hand: {likely}, simulated with ")
    assert (calls[0].motor.name, calls[0].bus_voltage, calls[0].microsteps) == ("17HS15-1504S", 36, 8)
    assert calls[1] == (plot, {"overwrite": False})


def test_view_prints_the_axes_of_the_selected_model(capsys):
    assert main(["view", "xy", "--text"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["axis", "x", "y"]


def test_fault_lists_them_all_and_what_does_not_happen_as_claimed_ends_with_1(monkeypatch, capsys, tmp_path):
    assert main(["fault"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed] == list(demonstrations.DEMOS)
    assert all(demo.claim in line for demo, line in zip(demonstrations.DEMOS.values(), listed, strict=True))
    for happened, code, says in ((True, 0, "happened as claimed"), (False, 1, "did NOT happen as claimed")):
        demo = demonstrations.Demo("a claim", "a notice", lambda *_: {"n": 1}, lambda *_, h=happened: h)
        monkeypatch.setattr(
            demonstrations,
            "run_demonstration",
            lambda *_, d=demo: demonstrations.DemoResult("jam", d, ({"n": 1}, {"n": 2}), (None, None)),
        )
        assert main(["fault", "jam"]) == code
        lines = capsys.readouterr().out.splitlines()
        assert (lines[0], lines[-1]) == ("jam: a claim", says)
        assert "How a host can detect it: a notice" in lines


@pytest.mark.skipif(sys.platform in ("darwin", "win32"), reason="there is a screen always")
@pytest.mark.parametrize(
    ("display", "wayland", "screen"),
    [(None, None, False), ("", "", False), (":0", None, True), (None, "wayland-0", True)],
)
def test_a_screen_exists_with_x11_or_wayland(monkeypatch, display, wayland, screen):
    for name, value in (("DISPLAY", display), ("WAYLAND_DISPLAY", wayland)):
        monkeypatch.delenv(name, raising=False)
        if value is not None:
            monkeypatch.setenv(name, value)
    assert opengl.has_screen() is screen
    if not screen:
        with pytest.raises(StageError, match=r"no screen here for MuJoCo's viewer\. Do this\.$"):
            opengl.check_window("Do this.")
    monkeypatch.setattr(opengl, "_find_glfw_failure", lambda: "broken")
    if screen:
        with pytest.raises(StageError, match="cannot open a window here: broken"):
            opengl.check_window("")


@pytest.mark.parametrize(
    ("unit", "texts"),
    [
        ("m", ("0.02m", "2cm", "20mm", "20000um", "20000000nm", "20000", "0x4e20")),
        ("rad", ("0.02rad", "20mrad", "20000urad", f"{math.degrees(0.02)}deg", "20000")),
    ],
)
def test_a_distance_may_be_typed_in_any_unit_of_its_axis(unit, texts):
    """stage move x 2cm; stage move q 20mrad"""
    axis = SimpleNamespace(name="x", unit=unit, meters_per_pulse=1e-6)
    assert [stage_setup.parse_distance(axis, text) for text in texts] == [20_000] * len(texts)
    assert stage_setup.parse_distance(axis, "-" + texts[1]) == -20_000
