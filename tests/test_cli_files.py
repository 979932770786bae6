"""Files that commands write and read: what cannot be, is said before the work, each in its own words."""

import pytest

from stage import firmware
from stage.cli import main


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--record x.mp4", "stage: x.mp4: a recording is no 'mp4'. Name a file that ends in .rrd.\n"),
        ("--record x", "stage: x: the name has no ending, and that says the format. Name a file that ends in .rrd.\n"),
        ("--vcd x.rrd", "stage: x.rrd: a file of waveforms is no 'rrd'. Name a file that ends in .vcd.\n"),
        (
            "--plot move",
            "stage: move: the name has no ending, and that says the format. Name a file that ends in .png, ",
        ),
        ("--picture q.jpg", "stage: q.jpg: a rendered picture is no 'jpg'. Name a file that ends in .png.\n"),
        ("--plot nowhere/a.png", "stage: nowhere is no folder. Make it first, or choose another.\n"),
    ],
)
def test_a_file_of_another_kind_is_refused_before_the_run(options, said, here, capsys, monkeypatch):
    """stage move x 100 --record x.mp4 wrote an .rrd named so"""
    monkeypatch.setattr(firmware, "preset_move", None)
    assert main(["move", "x", "100", *options.split()]) == 2
    assert capsys.readouterr().err.startswith(said)
    assert not list(here.iterdir())


def test_a_new_model_is_printed_where_its_file_is_a_dash(here, capsys):
    """stage new-model -o - wrote a file named -"""
    assert main(["new-model", "-o", "-"]) == 0
    assert capsys.readouterr().out.startswith("<!-- A stage for PulseStage")
    assert main(["new-model", "-o", "my"]) == 2
    assert "Name a file that ends in .xml" in capsys.readouterr().err
    assert not list(here.iterdir())


def test_a_picture_of_a_model_is_checked_before_it_is_drawn(here, capsys):
    assert main(["view", "xy", "--picture", "a.gif"]) == 2
    assert "a rendered picture is no 'gif'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        ("agent diagnosis:late -o a.txt", "a.txt: a transcript is no 'txt'. Name a file that ends in .jsonl."),
        ("agent one-shot --entry a.zip", "a.zip: an entry is no 'zip'. Name a file that ends in .bench."),
        ("bench-submit random -o a", "Name a file that ends in .bench."),
    ],
)
def test_what_is_played_is_not_lost_to_a_name(argv, said, here, capsys):
    assert main(argv.split()) == 2
    assert said in capsys.readouterr().err
