"""A layout in a file: what it says is where the chips are, and what is wrong in it is said with the line to write."""

from __future__ import annotations

import json
import pickle
import re
from pathlib import Path

import pytest
from support.compiled_firmware import firmware

from stage import Stage
from stage.board import LAYOUTS, Board
from stage.board.bus_layouts import read_layout
from stage.chips import MCX304, MCX514, PCL240K
from stage.cli import main
from stage.errors import ArgumentError
from stage.support.files import FileError

PAGE = Path(__file__).parents[2] / "docs" / "layouts.md"
INTERLEAVED = """
chip = "PCL240K"
base = 0x240
stride = 1
ports = ["byte 0", "none", "byte 1", "none", "byte 2", "none", "byte 3", "none"]
chips = 8
own = ["interrupts"]
"""


@pytest.fixture
def card(tmp_path):
    path = tmp_path / "card.toml"
    path.write_text(INTERLEAVED)
    return path


@pytest.fixture(scope="module")
def stage():
    return Stage("xy", chips=PCL240K, visuals=False)


def test_chips_lie_where_the_file_says(card):
    board = Board(Stage("xy", chips=PCL240K, visuals=False), layout=card)
    x, y = (board.stage.axes[name].chip for name in "xy")
    for port, chip in ((0x240, x), (0x241, y)):
        board.out8(port, 0x81)
        board.out8(port + 2, 77)
        assert chip.values()["R1"] == 77
    assert (board.in8(0x248), board.in8(0x249)) == (0, 0xFF)
    assert [c.port for c in board.strays] == [0x249]
    assert pickle.loads(pickle.dumps(board.options["layout"])) == board.options["layout"]


def test_the_stride_of_a_layout_file_defaults_to_its_ports(tmp_path):
    path = tmp_path / "card.toml"
    strides = {}
    for more in (
        "",
        'ports = ["byte 0", "byte 1", "byte 2", "byte 3", "none"]',
        'ports = ["byte 0"]\nstride = 9',
        "stride = 9",
    ):
        path.write_text(f'like = "pcl240"\n{more}\n')
        built = read_layout(path)
        strides[more] = built.stride, len(built.ports)
    assert list(strides.values()) == [(4, 4), (5, 5), (9, 1), (9, 4)]


def test_the_page_shows_files_that_are_as_it_says(tmp_path):
    written = re.findall(r"```(toml|json)\n(.*?)```", PAGE.read_text(), re.S)
    assert {kind for kind, _ in written} == {"toml", "json"}
    for n, (kind, text) in enumerate(written):
        path = tmp_path / f"card{n}.{kind}"
        path.write_text(text)
        layout = read_layout(path)
        Board(Stage("xyz", chips=layout.kind, visuals=False), layout=path)


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_shipped_layout_can_be_written_as_a_file(name, tmp_path):
    words = ["none", "byte", "word", "upper", "latch", "data", "interrupts"]
    shipped = LAYOUTS[name]

    def text(port):
        return words[port[0]] + (f" {port[1]}" if 1 <= port[0] <= 3 else "")

    path = tmp_path / f"{name}.json"
    kind = {"PCL240": "PCL240K", "Nova": "MCX304"}.get(shipped.kind.__name__, shipped.kind.__name__)
    argument = {
        "chip": kind, "title": shipped.title, "base": hex(shipped.base),
        "stride": shipped.stride, "ports": [*map(text, shipped.ports)], "own": [*map(text, shipped.own)], "chips": shipped.chips,
    }  # fmt: skip
    path.write_text(json.dumps(argument))
    again = read_layout(path)
    for field in ("name", "title", "ports", "stride", "base", "own", "chips"):
        assert getattr(again, field) == getattr(shipped, field)
    path.write_text(json.dumps({"like": name, "base": 0x100}))
    assert (read_layout(path).ports, read_layout(path).base, read_layout(path).kind) == (
        shipped.ports,
        0x100,
        shipped.kind,
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ports = []", r'there is no line that names the class of the chips. Add for example: chip = "PCL240K"'),
        ('chip = "PCL240K"', r'Add for example: ports = \["byte 0", .*or: like = "pcl240"'),
        ('chip = "PCL241"', r"unknown chip 'PCL241'. Did you mean 'PCL240"),
        ('like = "isa"', r"unknown layout 'isa'"),
        ('chip = "PCL240K"\nport = []', r"unknown key 'port'. Did you mean 'ports'"),
        ('chip = "PCL240K"\nports = ["bite 0"]', r"ports, entry 1, 'bite 0': a port reaches one of .*Did you mean 'byte'"),
        ('chip = "PCL240K"\nports = ["byte"]', r"an address of a PCL240K follows, 0 to 3. Write for example \"byte 0\""),
        ('chip = "PCL240K"\nports = ["byte 4"]', r"0 to 3"),
        ('chip = "PCL240K"\nports = ["word 0"]', r"the bus of a PCL240K has 8 bits"),
        ('chip = "MCX304"\nports = ["word 1", "upper 2"]', r'the entry before it has to be "word 2"'),
        ('chip = "HCTL1100"\nports = ["data", "latch"]', r'entry 1, "data": the entry before it has to be "latch"'),
        ('chip = "HCTL1100"\nports = ["latch 1"]', r'no address follows. Write "latch"'),
        ('like = "pcl240"\nbase = 4294967296', r"base = 4294967296: a whole number from 0 to \d+"),
        ('like = "pcl240"\nstride = "four"', r"stride = 'four': a whole number"),
        ('like = "pcl240"\nstride = true', r"stride = True: a whole number"),
        ('like = "pcl240"\nown = ["interrupts"]', r"nothing says how many. Add for example: chips = 4"),
        ('chip = "PCL240K"\nports = "byte 0"', r"a list of what each port reaches"),
        ("chip = ", r"is no TOML: Invalid value"),
    ],
)  # fmt: skip
def test_an_error_in_a_layout_file_suggests_the_line_to_write(text, message, tmp_path, stage):
    path = tmp_path / "card.toml"
    path.write_text(text)
    with pytest.raises(ArgumentError, match=message) as error:
        Board(stage, layout=path)
    assert str(path) in str(error.value)


def test_a_missing_or_unsuitable_layout_file_is_refused(tmp_path, stage, card):
    with pytest.raises(FileError, match=r"there is no layout .*none.toml"):
        Board(stage, layout=str(tmp_path / "none.toml"))
    with pytest.raises(ArgumentError, match=r"ends in .toml or .json"):
        Board(stage, layout="card.yaml")
    with pytest.raises(ArgumentError, match=r"layout card: it is for a PCL240K, and this stage has an MCX304"):
        Board(Stage("xyz", chips=MCX304, visuals=False), layout=card)
    (tmp_path / "card.json").write_text("[1]")
    with pytest.raises(ArgumentError, match=r"keys with values are wanted"):
        read_layout(tmp_path / "card.json")


def test_stage_run_takes_the_file_a_clock_and_a_patience(card, capsys):
    library = str(firmware("PULSESTAGE_MAIN { ps_out8(0x240, 0x81); return ps_in8(0x248); }"))
    options = ["--model", "xy", "--layout", str(card), "--in-process"]
    assert main(["run", library, *options, "--clock", "4000000", "--patience", "3"]) == 0
    assert "reached no chip" not in capsys.readouterr().out
    assert main(["run", library, *options, "--clock", "0"]) == 2
    assert "a reference clock is a whole number" in capsys.readouterr().err
    assert main(["run", library, *options, "--patience", "0"]) == 2
    assert "patience=0.0: seconds of real time, more than 0" in capsys.readouterr().err


def test_clock_applies_to_chips_named_by_class_or_text():
    assert [chip.clock_hz for chip in Stage("xy", clock=4_000_000, visuals=False).chips] == [4_000_000] * 2
    mixed = Stage("xy", chips={"x": "PCL240K", "y": lambda: MCX514(clock_hz=8_000_000)}, clock=1_000_000, visuals=False)
    assert [mixed.axes[name].chip.clock_hz for name in "xy"] == [1_000_000, 8_000_000]
    fast, slow = (Stage("xy", clock=hz, visuals=False) for hz in (4_000_000, 2_000_000))
    for stage in (fast, slow):
        chip = stage.axes["x"].chip
        for register, value in ((1, 100), (7, 300)):
            chip.write(0, 0x80 | register)
            chip.write(2, value >> 8)
            chip.write(1, value & 0xFF)
        chip.write(0, 0x10)
        stage.run(0.5)
    ratio = fast.axes["x"].commanded / slow.axes["x"].commanded
    assert ratio == pytest.approx(2, abs=0.05)
