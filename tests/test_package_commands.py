"""Commands of `stage` that other packages bring by the entry points "pulsestage.commands"."""

import json
import re

import pytest
from support.packages import installed

from stage.cli import main, package_commands

MODULE = """
from stage.cli.command_interface import add_command, add_facts, parse_integer

def run(args):
    print(f"{args.times} times")
    add_facts(args, times=args.times)
    return 0 if args.times else 1

def add(commands):
    p = add_command(commands, "greet", run, "greet so often", "Greet so often.", ("stage greet 3", "three times"))
    p.add_argument("times", type=parse_integer)

def fail(commands):
    raise RuntimeError("no network card")
"""


@pytest.fixture
def greeting(monkeypatch, tmp_path):
    """A package with three entry points: one works, one fails, one has the name of PulseStage's own command."""
    (tmp_path / "greetings.py").write_text(MODULE)
    brings = {"greet": "greetings:add", "grumble": "greetings:fail", "move": "greetings:fail"}
    installed(monkeypatch, tmp_path, "greetings", group="pulsestage.commands", **brings)


def test_a_command_of_a_package_is_a_command_of_stage(greeting, capsys):
    assert main(["greet", "0x3"]) == 0
    assert capsys.readouterr().out == "3 times\n"
    assert main(["greet", "0", "--json"]) == 1
    assert json.loads(capsys.readouterr().out) == {"times": 0}
    with pytest.raises(SystemExit):
        main(["greet", "--help"])
    assert "stage greet 3  three times" in capsys.readouterr().out


def test_help_lists_commands_of_packages_and_reports_those_that_cannot_load(greeting, capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    out, err = capsys.readouterr()
    assert re.search(r"^ +greet +greet so often$", out, re.M)
    assert (
        "package greetings 1.0 (grumble = 'greetings:fail') cannot be loaded: RuntimeError: no network card. Repair"
        in err
    )


def test_a_built_in_command_takes_precedence_over_one_of_a_package(greeting, capsys):
    assert main(["list", "models"]) == 0
    assert capsys.readouterr().err == ""
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "PulseStage has a command `stage move` of its own, which takes precedence." in capsys.readouterr().err


def test_a_command_whose_package_is_missing_says_in_one_sentence_which_brings_it(monkeypatch, capsys):
    monkeypatch.setitem(package_commands.PACKAGE_BY_COMMAND, "levitate", "antigravity")
    with pytest.raises(SystemExit) as ended:
        main(["levitate", "x", "--height", "8mm"])
    assert ended.value.code == 2
    assert capsys.readouterr().err == (
        "stage: `stage levitate` comes with the package pulsestage-antigravity, which is not installed: run "
        "`pip install ./packages/antigravity` in a checkout of PulseStage.\n"
    )
