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
from stage.chips.chip import Diagnostic
from stage.cli import build_parser, demo, fault, files, main, moves, progress, setup
from stage.cli.erratum import Shown
from stage.cli.firmware import report as print_report
from stage.cli.quantities import Quantity
from stage.firmware.driver import driver_of, usual_speeds
from stage.firmware.pcl240.driver import Pcl240Driver
from stage.recording import viewer
from stage.support import opengl
from stage.support.files import FileError


@pytest.fixture(scope="module")
def made():
    return Stage("xy", visuals=False)


@pytest.fixture
def bench(made, monkeypatch, tmp_path):
    """The commands get this stage; no file of a test lies about."""
    made.reset()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(moves, "make_stage", lambda args: made)
    return made


def parsers():
    commands = next(a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction))
    return commands.choices


def test_each_default_is_the_one_that_its_help_tells():
    told = 0
    for name, parser in parsers().items():
        for action in parser._actions:
            said = re.search(r"\(default: ([\w.,-]+)\)", action.help or "")
            if said and (action.type in (int, float) or isinstance(action.type, Quantity)) and action.dest != "start":
                told += 1
                assert float(said[1].replace(",", "")) == action.default, (name, action.dest)
    assert told >= 30


def test_what_the_commands_do_without_options():
    p = build_parser()
    asked = vars(p.parse_args(["move", "x", "100"]))
    expected = {
        "model": "xyz",
        "chips": "PCL240K",
        "bus_voltage": 24.0,
        "microsteps": 16,
        "bus_cycle": 1e-6,
        "port": 9090,
    }
    assert expected.items() <= asked.items()
    assert not any(
        asked[k] for k in ("constant", "force", "view", "web", "automatic", "s_curve", "motor", "fl", "start")
    )
    assert (asked["axis"], asked["distance"]) == ("x", "100")
    assert p.parse_args(["run", "a.c"]).timeout == 60
    assert p.parse_args(["run", "a.c"]).keep == 1_000_000
    assert p.parse_args(["demo"]).default_record == "demo.rrd"
    assert p.parse_args(["erratum"]).chips == "MCX304"
    pullout = p.parse_args(["pullout"])
    assert (pullout.motor, pullout.bus_voltage, pullout.microsteps) == ("17HS4401", 24.0, 16)
    assert p.parse_args(["view"]).model == "xyz"


def test_the_bench_options_make_the_stage():
    options = "--model xy --chips pcl240mk --motor 17HS15-1504S --microsteps 8 --bus-voltage 36 --bus-cycle 2e-6"
    stage = setup.make_stage(build_parser().parse_args(["move", "x", "1", *options.split()]))
    x = stage.axes["x"]
    assert list(stage.axes) == ["x", "y"]
    assert (type(x.chip).__name__, stage.state.bus) == ("PCL240MK", 2000)
    assert (x.drive.motor.name, x.drive.microsteps, x.drive.bus_voltage) == ("17HS15-1504S", 8, 36)


def report(**more):
    drawn = lambda path, overwrite: None  # noqa: E731
    return SimpleNamespace(
        **{"ok": True, "plot": drawn, "listing": str, "stopped_by": "ORG", "lost_steps": 0, "plan": ""} | more
    )


def test_an_encoder_counts_a_metre_or_a_turn_of_the_motor():
    made = setup._encoder("y=-200000")
    assert (made.axis, made.per_metre, made.per_turn) == ("y", -200_000.0, None)
    made = setup._encoder("x=2000/turn")
    assert (made.axis, made.per_metre, made.per_turn) == ("x", None, 2000.0)
    for wrong in ("x=0", "=5", "x=", "x=2000/revolution", "x=inf", "x=many"):
        with pytest.raises(ArgumentError, match="write AXIS=COUNTS"):
            setup._encoder(wrong)


@pytest.mark.parametrize(
    ("options", "axes", "expected"),
    [
        ("", "xy", {}),
        ("y", "y", {}),
        ("y x --plus", "yx", {"direction": +1}),
        ("x --constant", "x", {"high_speed": False}),
        ("x --fast-only", "x", {"slow_approach": False}),
        ("x --ez 3", "x", {"ez": 3}),
        ("x --by switch", "x", {}),
        ("x --by index --chips pcl240mk", "x", {"ez": 1}),
        ("x --by index --ez 2 --chips pcl240mk", "x", {"ez": 2}),
    ],
)
def test_home_searches_as_the_options_say(bench, monkeypatch, options, axes, expected):
    asked = []

    def origin_return(axis, direction, profile, **how):
        asked.append((axis.name, {"direction": direction} | how))
        return report()

    monkeypatch.setattr("stage.firmware.pcl240.driver.origin_return", origin_return)
    if "--chips" in options:
        monkeypatch.setattr(moves, "make_stage", lambda args: setup.make_stage(args, visuals=False))
    assert main(["home", *options.split(), "--model", "xy"]) == 0
    usual = {"direction": -1, "high_speed": True, "slow_approach": True, "ez": None, "timeout": 60.0}
    assert asked == [(axis, usual | expected) for axis in axes]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ("", ("home", -1, False)),
        ("--plus", ("home", 1, False)),
        ("--ez 1", ("home", -1, True)),
        ("--by switch", ("home_by", "switch", -1)),
        ("--by index --plus", ("home_by", "index", 1)),
    ],
)
def test_home_of_other_chips_goes_by_what_was_said(monkeypatch, options, expected):
    stage, told = Stage("xy", chips="mcx514", visuals=False), []
    report = SimpleNamespace(stopped_by="ORG", lost_steps=0, plot=None, json=lambda: {})
    driver = driver_of(stage.axes["x"])
    driver.home = lambda direction, speeds, index: told.append(("home", direction, index)) or report
    driver.home_by = lambda by, direction, speeds: told.append(("home_by", by, direction)) or report
    driver.check_homing = lambda *of: None
    monkeypatch.setattr(moves, "make_stage", lambda args: stage)
    monkeypatch.setattr("stage.firmware.driver.driver_of", lambda axis: driver)
    assert main(["home", "x", *options.split()]) == 0
    assert told == [expected]


@pytest.mark.parametrize("options", ["", "--s-curve"])
def test_a_line_of_other_chips_is_curved_where_asked(monkeypatch, options):
    stage, told = Stage("xy", chips="mcx514", visuals=False), []
    report = SimpleNamespace(ok=True, plan=None, plot=None, json=lambda: {})
    driver = driver_of(stage.axes["x"])
    driver.line = lambda drivers, distances, wanted: told.append((distances, wanted)) or report
    monkeypatch.setattr(moves, "make_stage", lambda args: stage)
    monkeypatch.setattr("stage.firmware.driver.driver_of", lambda axis: driver)
    assert main(["sync", "x=400", "y=-1mm", "--rate", "5000", "--accel", "0.2", *options.split()]) == 0
    ((distances, wanted),) = told
    assert distances == {"x": 400, "y": -320}
    assert (wanted.drive, wanted.up, wanted.down, wanted.s_curve) == (5000, 0.2, 0.2, bool(options))


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
        with files.kept(args, bench, every=2.5e-4) as recording:
            assert (recording is None) == (every is None)
            assert recording is None or recording.every == pytest.approx(every)


def test_home_draws_the_first_axis(bench, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        "stage.firmware.pcl240.driver.origin_return",
        lambda axis, *_, **__: report(plot=lambda path, overwrite: drawn.append(axis.name)),
    )
    assert main(["home", "y", "x", "--plot", "a.png"]) == 0
    assert drawn == ["y"]


def typed(**more):
    return argparse.Namespace(**dict.fromkeys(("fl", "fh1", "accel", "decel")) | more)


def test_speeds_that_are_typed_are_completed_by_the_usual_ones(bench):
    """--accel alone is both ramps; a rate below the usual start speed is the start speed, too"""
    x = bench.axes["x"]
    usual = setup.speeds(typed(), x)
    assert usual == usual_speeds(x.chip)._replace(second=2 * usual.drive), "FH2 is twice FH1"
    assert setup.speeds(typed(accel=0.4), x) == usual._replace(up=0.4, down=0.4)
    assert setup.speeds(typed(accel=0.4, decel=0.2), x) == usual._replace(up=0.4, down=0.2)
    assert setup.speeds(typed(decel=0.2), x) == usual._replace(down=0.2)
    slow = usual.start / 2
    assert setup.speeds(typed(fh1=slow), x) == usual._replace(start=slow, drive=slow, second=2 * slow)
    assert setup.speeds(typed(fh1=slow, fl=2 * slow), x) == usual._replace(start=2 * slow, drive=slow, second=2 * slow)
    for name in ("fl", "fh1", "accel", "decel"):
        for value in (0.0, -1.0, math.inf, math.nan):
            with pytest.raises(ArgumentError, match=f"--{name} {value:g}: more than 0"):
                setup.speeds(typed(**{name: value}), x)


def test_distances_are_typed_in_units_of_the_axis(bench):
    x = bench.axes["x"]
    hinge = SimpleNamespace(
        unit="rad", name="t", meters_per_pulse=math.radians(1e-6), gear=1.0, chip=x.chip, drive=x.drive
    )
    per_mm = 1e-3 / x.meters_per_pulse
    for text, mm in (("10mm", 10), ("-1cm", -10), ("0.02m", 20), ("500um", 0.5), ("50000nm", 0.05)):
        assert setup.distance(x, text) == round(mm * per_mm), text
    assert (setup.distance(x, "0x10"), setup.distance(x, " -7 ")) == (16, -7)
    for text, degrees in (("10deg", 10), ("-0.5deg", -0.5), ("1rad", math.degrees(1)), ("20mrad", math.degrees(0.02)),
                          ("300urad", math.degrees(3e-4))):  # fmt: skip
        assert setup.distance(hinge, text) == round(degrees * 1e6), text
    for axis, wrong in ((x, "1deg"), (hinge, "1mm"), (x, "1.5"), (x, "mm")):
        with pytest.raises(ArgumentError, match="goes a whole number of pulses, or a distance in"):
            setup.distance(axis, wrong)


def test_two_outputs_may_share_a_device_and_no_file(tmp_path):
    kinds = ("record", "vcd", "picture", "plot", "trace")
    given = argparse.Namespace(**dict.fromkeys(kinds), force=False, web=False)
    given.vcd = given.trace = "/dev/null"
    files.outputs(given)
    given.vcd, given.trace = str(tmp_path / "a"), str(tmp_path / "b" / ".." / "a")
    (tmp_path / "b").mkdir()
    with pytest.raises(FileError, match="--vcd and --trace both write"):
        files.outputs(given)


def test_a_usual_name_is_the_next_that_is_free_and_with_force_always_itself(bench, monkeypatch):
    for name in ("stage.rrd", "stage-2.rrd"):
        open(name, "w").close()
    assert [files._free("stage.rrd", force) for force in (False, True)] == ["stage-3.rrd", "stage.rrd"]
    saved = []
    recording = SimpleNamespace(
        save=lambda path, overwrite: (open(path, "w").close(), saved.append(path)), duration=0.0
    )

    @contextlib.contextmanager
    def record():
        yield recording
        open("stage-3.rrd", "w").close()  # another command has taken the name meanwhile

    monkeypatch.setattr(bench, "record", record)
    monkeypatch.setattr(viewer, "open_viewer", lambda path: saved.append(f"view {path}"))
    monkeypatch.setattr(viewer, "check_screen", lambda what: None)
    args = argparse.Namespace(
        record=None, vcd=None, picture=None, plot=None, trace=None, view=True, web=False, force=False, wrote=[]
    )
    with files.recorded(args, bench):
        pass
    assert saved == ["stage-4.rrd", "view stage-4.rrd"]


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        (["move", "x", "1", "--chips", "x=pcl240k,x=mcx304"], "axis x is given two chips"),
        (["run", "a.c", "--place", "x=1", "--place", "x=2", "--model", "xy"], "axis x has got a place already"),
        (
            ["home", "x", "--chips", "mcx304", "--model", "xy", "--ez", "0"],
            "--ez 0: an MCX304 ends at the first index pulse",
        ),
    ],
)
def test_what_is_typed_twice_or_is_nothing_is_refused(capsys, typed, said):
    assert main(typed) == 2
    assert said in capsys.readouterr().err


def test_a_report_of_mistakes_has_the_first_of_each_kind_and_strays_by_their_times(capsys):
    said = [Diagnostic(clock, 0, 0x11, text, "page") for clock, text in ((5, "a"), (7, "b"), (9, "a"), (11, "a"))]
    chip = SimpleNamespace(diagnostics=said, clock_hz=1)
    stray = SimpleNamespace(times=3)
    stage = SimpleNamespace(axes={}, chips=[chip])
    print_report(SimpleNamespace(stage=stage, strays=[stray, SimpleNamespace(times=4)], name_of=lambda k: "x"))
    out = capsys.readouterr().out
    assert "chip of x: 4 writes" in out
    assert re.findall(r"(\d+)\.000000 s, address 0 <- 11h: (.*)", out) == [
        ("5", "a [page] (3 times)"),
        ("7", "b [page]"),
    ]
    assert "7 bus cycles reached no chip" in out


def test_a_run_gives_the_signal_that_ends_it_back(bench):
    from stage.cli.firmware import _told_of_the_end

    before = signal.getsignal(signal.SIGTERM)
    with _told_of_the_end(SimpleNamespace(), threading.Event()):
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
    reports = iter([report(stopped_by=by, lost_steps=lost) for by, lost in ends])
    monkeypatch.setattr("stage.firmware.pcl240.driver.origin_return", lambda *_, **__: next(reports))
    assert main(["home"]) == code


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ([], {}),
        (["--constant"], {"constant": True}),
        (["--s-curve"], {"s_curve": True}),
        (["--s-curve", "0.3"], {"s_curve": 0.3}),
        (["--automatic"], {"automatic": True}),
        (["--no-automatic"], {"automatic": False}),
    ],
)
def test_move_ramps_as_the_options_say(bench, monkeypatch, options, expected):
    asked = []

    def move(driver, pulses, speeds, **how):
        asked.append((driver.axis.name, pulses, how | {"s_curve": speeds.s_curve}))
        return report()

    monkeypatch.setattr(Pcl240Driver, "move", move)
    monkeypatch.setattr(Pcl240Driver, "describe_speeds", lambda driver, speeds: "")
    assert main(["move", "y", "-250", *options]) == 0
    ((axis, pulses, how),) = asked
    assert (axis, pulses) == ("y", -250)
    assert {"constant": False, "automatic": None, "s_curve": False} | how == {
        "constant": False, "automatic": None, "s_curve": False,
    } | expected  # fmt: skip


def test_speeds_and_places_are_in_pps_s_and_mm(bench, monkeypatch, capsys):
    asked = []

    def dual_rate_move(axis, pulses, profile, *, rates, dwell):
        assert (list(rates), dwell) == (["FH1", "FH2", "FH1"], 0.1)
        asked.append((axis.name, pulses, profile, bench.axes["y"].position))
        return report(ok=False)

    monkeypatch.setattr("stage.firmware.pcl240.driver.dual_rate_move", dual_rate_move)
    speeds = {"fl": 700, "fh1": 9000, "fh2": 15_000, "accel": 0.2, "decel": 0.4}
    options = [word for name, value in speeds.items() for word in (f"--{name}", str(value))]
    assert main(["dual-rate", "y", "3000", *options, "--from", "-12.5"]) == 1, "it did not go as asked"
    profile = firmware.Profile.of(**speeds)
    assert asked == [("y", 3000, profile, pytest.approx(-0.0125))]
    assert str(profile) in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ("", {}),
        ("--rate 9000 --fl 500 --accel 0.3", {"rate": 9000, "fl": 500, "accel": 0.3, "decel": 0.3}),
        ("--s-curve 0.2 --no-automatic", {"s_curve": 0.2, "automatic": False}),
    ],
)
def test_sync_gives_what_was_given(bench, monkeypatch, options, expected):
    asked = []
    monkeypatch.setattr(
        "stage.firmware.pcl240.driver.synchronized_move",
        lambda d, axes, **how: asked.append((d, how)) or report(ok=not expected, plan=None),
    )
    assert main(["sync", "y=-30", "x=40", *options.split()]) == (1 if expected else 0)
    usual = {
        "rate": 16_000,
        "fl": 1000,
        "accel": 0.15,
        "decel": 0.15,
        "s_curve": False,
        "automatic": None,
        "timeout": None,
    }
    assert asked == [({"y": -30, "x": 40}, usual | expected)]


def test_the_board_of_run_lies_where_the_options_say(monkeypatch):
    asked = []

    def board(*given, **more):
        asked.append((given[1:], more))
        raise ArgumentError("enough")

    monkeypatch.setattr("stage.board.Board", board)
    where = "--layout pcl240-card --base 0x2A0 --stride 16 --keep 77 --model xy --device uart:0x3F8 --device latch:7"
    assert main(["run", "a.c", *where.split()]) == 2
    assert asked == [(("pcl240-card", 0x2A0, 16), {"keep_cycles": 77, "devices": ["uart:0x3F8", "latch:7"]})]


@pytest.mark.parametrize(("lost", "code"), [(4, 1), (0, 0)])
def test_a_firmware_that_loses_steps_ends_with_1(monkeypatch, lost, code):
    asked = []
    done = SimpleNamespace(code=0, seconds=0.0, cycles=0)
    host = SimpleNamespace(path=SimpleNamespace(name="a"), run=lambda timeout: asked.append(timeout) or done)
    stage = SimpleNamespace(axes={"x": SimpleNamespace(lost_steps=lost)})
    monkeypatch.setattr("stage.cli.setup.make_stage", lambda args: stage)
    monkeypatch.setattr("stage.cli.firmware.report", lambda *_: None)
    monkeypatch.setattr("stage.board.Board", lambda *_, **__: SimpleNamespace(log=[], stage=stage))
    monkeypatch.setattr("stage.board.NativeHost", lambda *_, **__: host)
    assert main(["run", "a.c", "--timeout", "1.5"]) == code
    assert asked == [1.5]


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

    monkeypatch.setattr("stage.cli.tools.registers", end)
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
def test_a_recording_is_opened_where_asked(bench, monkeypatch, options, expected):
    opened = []
    monkeypatch.setattr(viewer, "open_viewer", lambda *given: opened.append(("viewer", *given)))
    monkeypatch.setattr(viewer, "check_screen", lambda what: opened.append("screen"))
    monkeypatch.setattr(viewer, "serve_web", lambda *given: opened.append(("web", *given)))
    monkeypatch.setattr("stage.firmware.pcl240.moves.preset_move", lambda axis, *_, **__: axis.wait(1e-3) or report())
    assert main(["move", "x", "10", *options.split()]) == 0
    screen = ["screen"] if expected and expected[0] == "viewer" else []
    assert opened == screen + ([expected] if expected else [])


@needs_rerun
@pytest.mark.parametrize(
    ("options", "screen", "viewed"),
    [("", True, True), ("", False, False), ("--no-view", True, False), ("--web", True, False), ("--view", False, True)],
)
def test_the_demo_opens_the_viewer_where_there_is_a_screen(bench, monkeypatch, options, screen, viewed):
    seen = []

    def recorded(args, stage):
        seen.append((args.view, [round(axis.position, 6) for axis in stage.axes.values()]))
        raise ArgumentError("enough")

    monkeypatch.setattr("stage.support.opengl.has_screen", lambda: screen)
    monkeypatch.setattr("stage.cli.demo.make_stage", lambda args: bench)
    monkeypatch.setattr("stage.cli.demo.recorded", recorded)
    assert main(["demo", *options.split()]) == 2
    assert seen == [(viewed, [0.062, -0.031])], "where the carriages happen to stand"


@pytest.mark.parametrize(("ends", "code"), [("yes yes", 0), ("yes NO", 1), ("NO yes", 1)])
def test_a_demo_of_which_one_move_fails_ends_with_1(bench, monkeypatch, capsys, ends, code):
    def story(stage, rows):
        rows += [("x", "move", "+1", "+1", "0.1", "1", "0 mm", "0", "R0 = 0", end) for end in ends.split()]

    monkeypatch.setattr("stage.cli.demo.make_stage", lambda args: bench)
    monkeypatch.setattr("stage.cli.demo.recorded", lambda args, stage: contextlib.nullcontext())
    monkeypatch.setattr("stage.cli.demo.story", story)
    assert main(["demo", "--no-view"]) == code


class Made:
    """What drivers answer: a move of one axis or a line, with the end that is asked for."""

    stopped_by, ok, lost_steps = "ORG", True, 0

    def __init__(self, axis):
        self.axis, self.name = axis, axis.name

    def report(self, procedure, asked):
        return argparse.Namespace(
            axis=self.name, procedure=procedure, asked=asked, pulses=asked or -5, duration=0.1, peak_rate=1e3, position=1e-3,
            unit=self.axis.unit, lost_steps=0, ok=self.ok, stopped_by=self.stopped_by if asked is None else "R0 = 0",
        )  # fmt: skip

    def home(self, direction, speeds):
        return self.report("origin return", None)

    def two_rates(self, pulses, *speeds):
        return self.report("move", pulses)

    def move(self, pulses, speeds):
        return self.report("move", pulses)

    def line(self, drivers, pulses, speeds):
        axes = {n: drivers[n].report("line", p) for n, p in pulses.items()}
        return argparse.Namespace(axes=axes, deviation=argparse.Namespace(pulses=0.82), skew=1.25e-6)


@pytest.mark.parametrize(
    ("ok", "stopped_by", "good"),
    [(True, "ORG", "yes yes yes yes yes yes"), (True, "EL-", "NO NO yes yes yes yes"), (False, "ORG", "NO NO NO NO NO NO")],
)  # fmt: skip
def test_the_table_of_the_demo_says_which_moves_did_not_do_as_asked(bench, monkeypatch, capsys, ok, stopped_by, good):
    """A home that an end limit ended is no home, though nothing was lost"""
    monkeypatch.setattr("stage.firmware.driver.driver_of", Made)
    monkeypatch.setattr(Made, "ok", ok)
    monkeypatch.setattr(Made, "stopped_by", stopped_by)
    rows = []
    demo.story(bench, rows)
    assert [row[-1] for row in rows] == good.split()
    assert [(row[0], row[2]) for row in rows[:2]] == [("y", "to ORG"), ("x", "to ORG")], "the last axis first"
    assert "0.82 pulses from the straight line at most, started within 1.2 us of each other" in capsys.readouterr().out


def test_a_demo_of_axes_that_draw_no_line_together_says_so(monkeypatch, capsys):
    stage = Stage("xy", chips={"x": "PCL240K", "y": "MCX304"}, visuals=False)
    monkeypatch.setattr("stage.firmware.driver.driver_of", Made)
    rows = []
    demo.story(stage, rows)
    assert [row[1] for row in rows] == ["origin return"] * 2 + ["move"] * 2
    assert "axes x and y have different chips, which draw no line together" in capsys.readouterr().out


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_progress_is_told_on_a_terminal_and_in_no_pipe(monkeypatch):
    """stage pullout on a terminal: one line that counts up"""
    for screen, told in (
        (Terminal(), "writing ...\n\rpull-out   0%\rpull-out  50%\rpull-out 100%\n"),
        (io.StringIO(), ""),
    ):
        monkeypatch.setattr("sys.stderr", screen)
        progress.note("writing ...")
        for done in (0, 0.5, 1.0):
            progress.progress("pull-out", done)
        assert screen.getvalue() == told


MOVED = {"n-DRV 2 s later": 0, "pulses past the target": 0, "lost steps": 0}
RAN_AWAY = {"n-DRV 2 s later": 1, "pulses past the target": 9000, "lost steps": 4}


@pytest.mark.parametrize(
    ("mended", "bare", "guarded", "claimed"),
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
def test_the_erratum_is_as_claimed_where_all_its_figures_are(mended, bare, guarded, claimed):
    assert Shown("MCX304", mended, (bare, guarded), (None, None)).as_claimed == claimed


def test_pullout_measures_the_drive_that_was_asked_for(monkeypatch, capsys, tmp_path):
    asked = []
    monkeypatch.setattr(
        "stage.drives.dynamometer.pull_out_table", lambda drive, progress: asked.append(drive) or "table"
    )
    monkeypatch.setattr("stage.drives.picture.plot_pull_out", lambda *given, **how: asked.append((given[2], how)))
    plot = str(tmp_path / "p.png")
    assert main(["pullout", "--motor", "17HS15-1504S", "--bus-voltage", "36", "--microsteps", "8", "--plot", plot]) == 0
    likely = "its core loss is likely 0.00023 to 0.00072 N m s/rad"
    table, _, sentence, drawn = capsys.readouterr().out.splitlines()
    assert (table, drawn) == ("table", f"{plot}: drawn")
    assert sentence.startswith(f"No pull-out curve of the 17HS15-1504S is at hand: {likely}, simulated with ")
    assert (asked[0].motor.name, asked[0].bus_voltage, asked[0].microsteps) == ("17HS15-1504S", 36, 8)
    assert asked[1] == (plot, {"overwrite": False})


def test_view_prints_the_axes_of_the_model_that_was_asked_for(capsys):
    assert main(["view", "xy", "--text"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["axis", "x", "y"]


def test_fault_lists_them_all_and_what_does_not_happen_as_claimed_ends_with_1(monkeypatch, capsys, tmp_path):
    assert main(["fault"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed] == list(fault.DEMOS)
    assert all(demo.claim in line for demo, line in zip(fault.DEMOS.values(), listed, strict=True))
    for happened, code, says in ((True, 0, "happened as claimed"), (False, 1, "did NOT happen as claimed")):
        demo = fault.Demo("a claim", "a notice", lambda *_: {"n": 1}, lambda *_, h=happened: h)
        monkeypatch.setattr(fault, "show", lambda *_, d=demo: fault.Shown("jam", d, ({"n": 1}, {"n": 2}), (None, None)))
        assert main(["fault", "jam"]) == code
        said = capsys.readouterr().out.splitlines()
        assert (said[0], said[-1]) == ("jam: a claim", says)
        assert "How a host can tell: a notice" in said


@pytest.mark.skipif(sys.platform in ("darwin", "win32"), reason="there is a screen always")
@pytest.mark.parametrize(
    ("display", "wayland", "screen"),
    [(None, None, False), ("", "", False), (":0", None, True), (None, "wayland-0", True)],
)
def test_there_is_a_screen_where_x_or_wayland_is(monkeypatch, display, wayland, screen):
    for name, value in (("DISPLAY", display), ("WAYLAND_DISPLAY", wayland)):
        monkeypatch.delenv(name, raising=False)
        if value is not None:
            monkeypatch.setenv(name, value)
    assert opengl.has_screen() is screen
    if not screen:
        with pytest.raises(StageError, match=r"no screen here for MuJoCo's viewer\. Do this\.$"):
            opengl.check_window("Do this.")
    monkeypatch.setattr(opengl, "_glfw", lambda: "broken")
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
    assert [setup.distance(axis, text) for text in texts] == [20_000] * len(texts)
    assert setup.distance(axis, "-" + texts[1]) == -20_000
