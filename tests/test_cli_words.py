"""What the command line says before and while it works: usage errors, examples, progress, an interrupt."""

import io
import shlex
import sys
import time
from types import SimpleNamespace

import pytest

from stage import ArgumentError, Stage, firmware
from stage.chips import CHIPS
from stage.cli import build_parser, main, output_and_progress
from stage.cli.argument_parser import Parser

COMMANDS = next(a.choices for a in build_parser()._actions if getattr(a, "choices", None))


def parse_examples(epilog):
    assert epilog.startswith("examples:\n")
    return [line.strip() for line in epilog.split("\n\n")[0].splitlines()[1:]]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_help_ends_with_examples_that_are_right(name, capsys):
    """stage move --help"""
    examples = parse_examples(COMMANDS[name].epilog)
    assert examples
    assert any(f"stage {name}" in line for line in examples)
    for line in examples:
        typed = line.split("  ")[0].split("$(")[-1].split(")")[0].split(" | ")[0]
        words = shlex.split(typed)[1:]
        args = build_parser(words).parse(words)
        assert args.run is not None, line
    with pytest.raises(SystemExit):
        main([name, "--help"])
    assert all(line in capsys.readouterr().out for line in examples[:1])


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("move", "stage move: the following arguments are required: AXIS, DISTANCE. `stage move --help` has examples."),
        ("moove x 10", "stage: unknown command 'moove'. Did you mean move? `stage --help` has examples."),
        ("move x 10 --recrd a.rrd", "stage move: unknown option '--recrd'. Did you mean --record"),
        ("move x 10 20", "stage move: unknown argument '20'. `stage move --help` has examples."),
        (
            "list motor",
            "stage list: unknown name 'motor'. Did you mean motors? Known: chips, motors, power-stages, models.",
        ),
        ("tune xy --by luck", "stage tune: unknown value of --by 'luck'. Known: search, formula."),
        ("move x 10 --microsteps a", "stage move: argument --microsteps: invalid int value: 'a'. `stage move --help`"),
        ("registers", "stage registers: the following arguments are required: CHIP."),
    ],
)
def test_wrong_usage_is_reported_in_one_line(typed, message, capsys):
    with pytest.raises(SystemExit) as end:
        main(shlex.split(typed))
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith(message)
    assert error.count("\n") == 1


@pytest.mark.parametrize("chip", ["pcl240k", "mcx514", "hctl1100"])
def test_a_register_map_begins_with_a_summary(chip, capsys):
    """stage registers mcx514"""
    assert main(["registers", chip]) == 0
    title, source, summary, *_ = capsys.readouterr().out.splitlines()
    map_ = CHIPS[chip.upper()].MAP
    assert title.startswith(map_.chip)
    assert source.startswith("source: ")
    assert summary.startswith(f"{len(map_.registers)} registers (")
    counts = [int(part.split()[0]) for part in summary.split(": ")[1].split(", ")]
    entries = [*map_.registers, *map_.commands, *(f for place in map_.places for f in place.fields)]
    assert sum(counts) == len(entries)


class FakeTerminal(io.StringIO):
    def isatty(self):
        return True


def test_a_terminal_displays_the_simulated_time(monkeypatch):
    stage = SimpleNamespace(data=SimpleNamespace(time=1.25))
    monkeypatch.setattr(output_and_progress, "FIRST_UPDATE_S", 0.01)
    monkeypatch.setattr(sys, "stderr", screen := FakeTerminal())
    with output_and_progress.show_simulated_time(stage):
        end = time.monotonic() + 20
        while "simulated" not in screen.getvalue() and time.monotonic() < end:
            time.sleep(0.01)
    assert "1.25 s simulated; Ctrl-C ends it" in screen.getvalue()
    assert screen.getvalue().endswith("\r\x1b[K"), "the line is gone at the end"
    monkeypatch.setattr(sys, "stderr", quiet := io.StringIO())
    with output_and_progress.show_simulated_time(stage):
        time.sleep(0.05)
    assert not quiet.getvalue(), "no terminal, no line"


def test_ctrl_c_writes_what_was_recorded(tmp_path, monkeypatch, capsys):
    """stage move x 100mm --vcd x.vcd, and Ctrl-C"""

    def interrupted(axis, **how):
        axis.stage.run(0.05)
        raise KeyboardInterrupt

    monkeypatch.setattr(firmware, "move", interrupted)
    file = tmp_path / "x.vcd"
    assert main(["move", "x", "100mm", "--vcd", str(file)]) == 130
    assert "interrupted after 0.05 s of simulated time; the recording up to then is written" in capsys.readouterr().out
    assert file.read_text().startswith("$")


def test_a_parser_of_ours_is_argparse_with_other_words():
    assert isinstance(build_parser(), Parser)
    assert all(isinstance(p, Parser) for p in COMMANDS.values())


@pytest.fixture(scope="module")
def without_origin(tmp_path_factory):
    file = tmp_path_factory.mktemp("model") / "a.xml"
    assert main(["new-model", "--axes", "a:hinge:360deg", "-o", str(file)]) == 0
    text = "\n".join(line for line in file.read_text().splitlines() if 'name="a_org"' not in line)
    file.write_text(
        text.replace('data="el_plus el_minus sd_plus sd_minus"', 'data="el_plus el_minus sd_plus sd_minus org"')
    )
    return str(file)


@pytest.mark.parametrize("chips", ["pcl240k", "mcx514", "hctl1100"])
def test_home_refuses_an_axis_without_an_origin_switch(chips, without_origin, capsys):
    """stage home a --model a.xml, of a model with a_unfitted "... org": it ran for ever"""
    assert main(["home", "a", "--model", without_origin, "--chips", chips]) == 2
    assert capsys.readouterr().err.startswith(
        "stage: axis a has no origin switch, so its run would not end: give the model a_org"
    )
    axis = Stage(without_origin, chips=chips, visuals=False).axes["a"]
    with pytest.raises(ArgumentError, match="axis a has no origin switch"):
        firmware.home(axis)
    if chips == "pcl240k":
        with pytest.raises(ArgumentError, match="axis a has no origin switch"):
            firmware.origin_return(axis)


def test_a_viewer_without_a_screen_is_refused_before_the_run(monkeypatch, capsys, tmp_path):
    """stage move x 10mm --view, by ssh"""
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(firmware, "move", None)
    assert main(["move", "x", "10mm", "--view"]) == 2
    assert "no screen here to show what --view asks for on. Serve it to a browser (--web)" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_an_option_is_proposed_once(capsys):
    """stage example stall -O X: "Did you mean --to or --to or --to?" """
    with pytest.raises(SystemExit):
        main(["home", "--models", "xy"])
    assert capsys.readouterr().err.count("--model") == 2  # what was given, what is proposed


@pytest.mark.parametrize("typed", [["help"], ["help", "move"]])
def test_help_is_a_word_too(typed, capsys):
    """stage help move"""
    with pytest.raises(SystemExit) as end:
        main(typed)
    assert end.value.code == 0
    assert f"usage: {' '.join(['stage', *typed[1:]])}" in capsys.readouterr().out
