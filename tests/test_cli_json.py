"""`--json`: one JSON object of what a command has to say, for every command that has something to say."""

import argparse
import json
import math
import shutil
from types import SimpleNamespace

import pytest
from support.extras import needs_rerun

from stage.cli import build_parser, main
from stage.cli.command_interface import to_json, warn
from stage.cli.package_commands import PACKAGE_BY_COMMAND

CHECKS = {
    "home": (["home", "x"], lambda f: f["reports"][0]["stopped_by"] == "ORG"),
    "move": (["move", "x", "800"], lambda f: (f["reports"][0]["pulses"], f["reports"][0]["ok"]) == (800, True)),
    "dual-rate": (["dual-rate", "x", "12000"], lambda f: f["reports"][0]["writes"][0][1:] != []),
    "sync": (["sync", "x=400", "y=-100"], lambda f: [r["pulses"] for r in f["reports"]] == [400, -100]),
    "fault": (["fault"], lambda f: "jam" in f),
    "example": (["example"], lambda f: f["stall"].startswith("A motor")),
    "list": (["list", "models"], lambda f: f["xyz"] == ["x", "y", "z"]),
    "chips": (["chips"], lambda f: f[0]["name"] == "PCL240K"),
    "registers": (["registers", "mcx304"], lambda f: f["chip"] == "MCX304" and f["registers"][0]["fields"] is not None),
    "include": (["include"], lambda f: f["include"].endswith("board")),
    "new-model": (["new-model", "--axes", "x:slide:50mm"], lambda f: "<mujoco" in f["mjcf"]),
    "view": (["view", "xy"], lambda f: [a["name"] for a in f["axes"]] == ["x", "y"]),
}  # fmt: skip
ELSEWHERE = {"run", "replay", "export", "tune"}
"""Commands of which tests below, of board/ and of tune/ read the JSON."""
LONG = {"demo": ["demo"], "erratum": ["erratum"], "pullout": ["pullout"]}
TEXT_ALONE = {"serve", "mcp", "panel", "ioc", "completion"}
"""Commands that serve, or print what a shell is to have."""


def print_json(capsys, *argv, code=0):
    """Run a command with --json and return its output, parsed as strict JSON."""
    assert main([*argv, "--json"]) == code
    out, err = capsys.readouterr()
    assert err == ""

    def never(text):
        raise AssertionError(f"{text} is no JSON")

    return json.loads(out, parse_constant=never)


def test_every_command_but_those_that_print_text_has_json():
    (commands,) = (a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction))
    parsers = {name: p for name, p in commands.choices.items() if name not in PACKAGE_BY_COMMAND}
    has = {name for name, p in parsers.items() if "--json" in p._option_string_actions}
    assert parsers.keys() - has == TEXT_ALONE
    assert has == {*CHECKS, *LONG, *ELSEWHERE}, "who has it is tried here"


@pytest.mark.parametrize("name", CHECKS)
def test_a_command_says_in_json_what_it_says_in_words(name, capsys):
    argv, right = CHECKS[name]
    assert right(print_json(capsys, *argv))


@pytest.mark.slow
@pytest.mark.parametrize("name", LONG)
def test_a_long_command_says_in_json_what_it_says_in_words(name, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    facts = print_json(capsys, *LONG[name])
    assert facts[{"demo": "reports", "erratum": "as_claimed", "pullout": "pull_out"}[name]]


def test_view_prints_the_travel_per_motor_revolution_of_each_axis(capsys):
    """stage view xya --json: screws of 10 mm, and a table behind a gear of 18"""
    axes = {a["name"]: a["per_turn"] for a in print_json(capsys, "view", "xya")["axes"]}
    assert axes == pytest.approx({"x": 0.01, "y": 0.01, "a": 2 * math.pi / 18})


def test_a_report_has_its_numbers_in_si_and_its_writes(capsys):
    """stage move x 800 --json"""
    report = print_json(capsys, "move", "x", "800")["reports"][0]
    assert report["position"] == pytest.approx(2.5e-3, abs=1e-5)
    assert (report["unit"], report["lost_steps"], report["residual"]) == ("m", 0, 0)
    assert report["writes"][-1][1:] == ["15", "start, ramp to FH1"]


def test_the_exit_code_stays_and_the_json_says_what_happened(capsys):
    """stage move x 8000 --from 148 --json: into EL+"""
    report = print_json(capsys, "move", "x", "8000", "--from", "148", code=1)["reports"][0]
    assert (report["ok"], report["stopped_by"]) == (False, "EL+")


def test_files_that_were_written_are_named(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    facts = print_json(capsys, "move", "x", "80", "--vcd", "a.vcd", "--plot", "a.png")
    assert facts["files"] == ["a.png", "a.vcd"]
    assert {p.name for p in tmp_path.iterdir()} == {"a.png", "a.vcd"}


@needs_rerun
def test_json_names_the_recording_and_its_columns(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert print_json(capsys, "move", "x", "80", "--record", "a.rrd")["files"] == ["a.rrd"]
    facts = print_json(capsys, "export", "a.rrd")
    assert (facts["model"], facts["columns"]["x/position"]) == ("PulseStage xyz", "m")


@pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler: cc is not on the PATH")
def test_json_of_a_firmware_run_has_axes_log_and_diagnostics(capsys, tmp_path):
    source = tmp_path / "driver.c"
    source.write_text('#include <pulsestage.h>\nPULSESTAGE_MAIN { ps_log("hello"); ps_out8(0x300, 0x15); return 3; }\n')
    facts = print_json(capsys, "run", str(source), code=1)
    assert (facts["returned"], facts["error"], facts["log"][0][1]) == (3, None, "hello")
    assert [a["axis"] for a in facts["axes"]] == ["x", "y", "z"]
    assert facts["diagnostics"]["x"], "a start without a reset"


@pytest.mark.parametrize(
    ("argv", "message", "kind"),
    [
        ("move q 80 --json", "unknown axis 'q'. Known: x, y, z.", "ArgumentError"),
        ("move x 80 --json --plot a.foo", "a.foo: a figure is no 'foo'.", "FileError"),
        (
            "list --json",
            "stage list: the following arguments are required: what. Known: chips, motors, power-stages, models.",
            "usage",
        ),
        (
            "serve --json",
            "stage serve: --json: `stage serve` has no JSON output: it serves clients",
            "usage",
        ),
    ],
)
def test_an_error_is_json_on_standard_error_and_nothing_is_on_standard_output(argv, message, kind, capsys):
    """stage move q 80 --json"""
    try:
        code = main(argv.split())
    except SystemExit as end:
        code = end.code
    out, err = capsys.readouterr()
    facts = json.loads(err)
    assert (code, out, facts["type"], facts["error"].startswith(message)) == (2, "", kind, True), facts


def test_a_warning_is_one_of_the_facts(capsys):
    """stage move x 8000 --from 148 --json"""
    facts = print_json(capsys, "move", "x", "8000", "--from", "148", code=1)
    assert facts["warnings"] == ["axis x reaches from -150 to 150 mm, and this move goes to 173 mm."]


def test_every_warning_is_one_of_the_facts_in_its_order(capsys):
    args = SimpleNamespace(json=True)
    for text in ("one", "two", "three"):
        warn(args, text)
    assert args.warnings == ["one", "two", "three"]
    assert capsys.readouterr().err == ""
    warn(SimpleNamespace(json=False), "four")
    assert capsys.readouterr().err == "stage: warning: four\n"


@pytest.mark.parametrize("option", ["--web", "--trace -"])
def test_json_refuses_options_that_print_text(option, capsys):
    """stage run driver.so --trace - --json"""
    argv = ["run", "nothing.so", *option.split()] if "trace" in option else ["move", "x", "80", option]
    assert main([*argv, "--json"]) == 2
    assert f"{option}: it prints text, and --json prints JSON." in capsys.readouterr().err


def test_values_without_a_json_type_become_null_or_text(tmp_path):
    from pathlib import Path

    import numpy as np

    values = {1: np.float64(math.inf), "a": (np.int64(3), np.array([1.0, math.nan])), "p": Path("x"), "b": True}
    assert to_json(values) == {"1": None, "a": [3, [1.0, None]], "p": "x", "b": True}
