"""`stage tune`: each option reaches the task or the search in SI units, and the exit code reports the end."""

import re
from types import SimpleNamespace

import pytest

import stage.tune
from stage import Stage
from stage.chips import HCTL1100, MCX514
from stage.cli import main
from stage.cli.output_and_progress import rewrite_line
from stage.cli.tune import _SearchProgress, parse_spare, propose_distance_unit
from stage.errors import ArgumentError


@pytest.fixture
def run_tune_command(monkeypatch):
    """Function (words of the command line) -> (exit code, arguments of Task, arguments of tune)."""
    monkeypatch.setattr("stage.tune.search.import_optuna", lambda: None)

    def run_command(*typed, stopped=False):
        arguments = []

        def task(*values):
            arguments.append(values)
            return "task"

        def tune(task, **settings):
            arguments.append((task, settings))
            return SimpleNamespace(interrupted=stopped, c_source=lambda: "// C\n", json=lambda: {"won": "formula"})

        monkeypatch.setattr(stage.tune, "Task", task)
        monkeypatch.setattr(stage.tune, "tune", tune)
        code = main(["tune", *typed])
        return code, *arguments

    return run_command


def test_options_that_are_missing_have_their_defaults(run_tune_command):
    code, task, (arguments, settings) = run_tune_command("xy", "--distance", "8000")
    machine, axis, pulses, *rest = task
    assert (code, axis, pulses, arguments) == (0, "x", 8000, "task")
    assert list(machine.axes) == ["x", "y"]
    assert rest == [0.0, None, None, 0.05, None, None, None]
    reports = settings.pop("on_progress")
    assert isinstance(reports, _SearchProgress)
    assert settings == {"by": "search", "trials": 200, "seed": 0, "workers": None, "moves": 96}


def test_every_option_reaches_its_argument_in_si_units(run_tune_command):
    code, task, (_, settings) = run_tune_command(
        "xyz", "--axis", "y", "--distance", "-10mm", "--payload", "2", "--payload-on", "tool", "--spare", "50%",
        "--settle", "20um", "100ms", "--overshoot", "0.1mm", "--site", "work", "--by", "formula", "--trials", "7", "--moves", "9",
        "--seed", "5", "--workers", "3", "--chips", "mcx514", "--microsteps", "8", "--bus-voltage", "36V", "--bus-cycle", "2us",
        stopped=True,
    )  # fmt: skip
    machine, *arguments = task
    y = machine.axes["y"]
    pulses = -round(0.01 / y.meters_per_pulse)
    assert arguments == [
        "y",
        pulses,
        2.0,
        1.0,
        pytest.approx(2e-5),
        pytest.approx(0.1),
        pytest.approx(1e-4),
        "work",
        "tool",
    ]
    assert (type(y.chip), y.drive.microsteps, y.drive.bus_voltage, machine.bus_cycle) == (
        MCX514,
        8,
        36.0,
        pytest.approx(2e-6),
    )
    del settings["on_progress"]
    assert settings == {"by": "formula", "trials": 7, "seed": 5, "workers": 3, "moves": 9}
    assert code == 130, "Ctrl-C has ended it"


@pytest.mark.parametrize(
    ("text", "payload", "kg"),
    [("30%", 2.0, 0.6), ("30 %", 2.0, 0.6), ("0%", 2.0, 0.0), ("30%", 0.0, None), ("0.6", 2.0, 0.6), ("0.6", 0.0, 0.6),
     ("600g", 0.0, 0.6), ("0", 5.0, 0.0), ("150%", 2.0, 3.0)],
)  # fmt: skip
def test_a_margin_is_a_share_of_the_payload_or_kilograms(text, payload, kg):
    assert parse_spare(text, payload) == (None if kg is None else pytest.approx(kg))


@pytest.mark.parametrize("text", ["-1", "-5%", "30%%", "5% kg", "%", "much", "1e400", "nan"])
def test_an_invalid_margin_is_refused(text):
    with pytest.raises(
        ArgumentError, match=f"^--spare {re.escape(text)}: give percent of the payload, such as 30%, or kg, "
    ):
        parse_spare(f" {text}", 2.0)


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        (["--settle", "0um", "50ms"], "--settle 0um: must be greater than 0"),
        (["--settle", "20um", "-1s"], "--settle -1s: must be greater than 0, in one of"),
        (
            ["--overshoot", "5ms"],
            "--overshoot 5ms: must be greater than 0, in one of nm, um, mm, cm, m; for example 50um",
        ),
        (["--seed", "-1"], "--seed -1: must be a whole number, 0 or more"),
    ],
)
def test_invalid_options_are_refused_before_the_search(run_tune_command, capsys, typed, message):
    code, *arguments = run_tune_command("xy", "--distance", "1mm", *typed)
    assert (code, arguments) == (2, [])
    assert message in capsys.readouterr().err


def test_a_seed_of_0_is_allowed(run_tune_command):
    assert run_tune_command("xy", "--distance", "1mm", "--seed", "0")[0] == 0


def test_the_error_of_a_distance_without_a_unit_proposes_the_unit_of_the_axis():
    stage = Stage("xya", chips={"x": HCTL1100, "y": MCX514, "a": MCX514}, visuals=False)
    message = [propose_distance_unit(stage.axes[name], "100") for name in "xya"]
    assert [s.split("did you mean ")[1] for s in message] == ["100mm?", "100mm?", "100deg?"]
    assert ["counts" in s for s in message] == [True, False, False]
    assert propose_distance_unit(stage.axes["x"], "100mm") == ""
    assert propose_distance_unit(stage.axes["y"], " -100") == "--distance -100 is -100 pulses: did you mean -100mm?"


def test_progress_is_shown_only_on_a_terminal(capsys, monkeypatch):
    for terminal in (True, False):
        monkeypatch.setattr("sys.stderr.isatty", lambda terminal=terminal: terminal, raising=False)
        progress = _SearchProgress(200)
        progress("the formula", 0.0, None)
        progress("searching", 0.25, 0.1234)
        rewrite_line("")
        lines = capsys.readouterr().err.split("\r\033[K")
        assert lines == (
            ["", "the formula ...", "searching 50 of 200 trials, best 123.4 ms ...", ""] if terminal else [""]
        )
