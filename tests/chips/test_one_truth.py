"""Masks, values of fields, command codes and addresses stand in the register maps, and nowhere else."""

import ast
from pathlib import Path

import pytest

from stage import chips, firmware
from stage.chips import CHIPS
from stage.chips.pcl240 import state
from stage.chips.register_map import Field
from stage.errors import ArgumentError
from stage.firmware.pcl240 import chip_port

FIELDS = {
    f"{name} {place.name} {f.name}": f
    for name, chip in ((name, CHIPS[name]) for name in CHIPS.built_in)
    for place in chip.MAP.places
    for f in place.fields
}
SHAPES = {0xFF, 0xFF00, 0xFFFF, 0xFFFFFF, 0xFFFFFFFF}
"""Masks of whole bytes: no field's."""
FOLDERS = [
    Path(package.__path__[0], folder) for package in (chips, firmware) for folder in ("pcl240", "hctl1100", "nova")
]


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda f: f"{f.parent.name}/{f.name}")
def test_a_family_types_no_mask_code_or_address_but_in_its_map(folder):
    result = []
    for path in sorted(folder.rglob("*.py")):
        text = path.read_text()
        lines = text.splitlines()
        if path.name != "maps.py" and path.parent.name != "registers":
            result += [
                f"{path.name}:{node.lineno}: {typed}"
                for node in ast.walk(ast.parse(text))
                if isinstance(node, ast.Constant)
                and isinstance(node.value, int)
                and (typed := lines[node.lineno - 1][node.col_offset : node.end_col_offset]).startswith("0x")
                and node.value not in SHAPES
            ]
    assert result == []


def test_the_values_of_every_field_fit_its_bits_and_have_distinct_meanings():
    for name in FIELDS:
        assert fits(name), name


def fits(name):
    f = FIELDS[name]
    low, high = f.legal or (0, f.mask >> f.low)
    if f.values and name.split()[-1] != "group":
        assert 0 <= min(f.values) <= max(f.values) <= f.mask >> f.low
        assert all(text and text.isascii() and text.isprintable() for text in f.values.values())
        assert f.legal is None or set(f.values) <= set(range(low, high + 1))
        if f.high - f.low < 2 and name.split()[-1] != "speed":  # of the speed select the sheet does not say 10
            assert set(f.values) == set(range(low, high + 1)), "complete, so that one can choose"
    return bool(f.meaning or f.values)


@pytest.mark.parametrize(
    ("f", "text", "message"),
    [
        (Field("D", 3, 3, "direction", values={0: "plus", 1: "minus"}), "direction: 0 plus, 1 minus", {1: "direction: minus"}),
        (Field("S", 2, 2, "", values={0: "linear", 1: "S-curve"}), "0 linear, 1 S-curve", {0: "linear", 1: "S-curve"}),
        (Field("A", 1, 0, "ramps at", values={0: "A, K", 1: "D"}, note="DSNDE"), "ramps at: 0 A, K; 1 D; DSNDE",
         {1: "ramps at: D", 2: ""}),
        (Field("E", 5, 5, "it stops", note="at once"), "it stops; at once", {0: "", 1: "it stops"}),
        (Field("N", 7, 4, "count"), "count", {3: ""}),
    ],
)  # fmt: skip
def test_a_field_is_described_by_its_meaning_and_its_values(f, text, message):
    assert f.description == text
    assert {v: f.describe_value(v) for v in message} == message


def test_a_value_is_found_by_its_words_in_place():
    f = Field("SPD", 7, 6, "vector speed", values={0: "off", 2: "three axes"})
    assert f.find_code("three axes") == 0x80
    with pytest.raises(ArgumentError, match="three axes"):
        f.find_code("three axis")


def test_the_commands_of_the_pcl240_are_those_of_its_data_sheet():
    """The codes here are copied from section 3, not from the map."""
    assert (
        chip_port.RESET,
        chip_port.SLOW_DOWN["FH1"],
        chip_port.SLOW_DOWN["FH2"],
        chip_port.STOP_INTERRUPT_BIT,
    ) == (0x08, 0x1D, 0x1F, 0x20)
    assert chip_port.START == {"FL": 0x10, "FH1": 0x11, "FH2": 0x13}
    assert chip_port.RAMP_START_COMMANDS == {"FL": 0x14, "FH1": 0x15, "FH2": 0x17}
    assert (
        chip_port.ORIGIN,
        chip_port.SD,
        chip_port.PRESET,
        chip_port.MINUS,
        chip_port.AUTOMATIC,
        chip_port.POSITION,
    ) == (1, 2, 4, 8, 0x10, 0x20)
    assert (chip_port.CONTROL, chip_port.SELECT, chip_port.OUTPUT) == (0x40, 0x80, 0xC0)
    assert (chip_port.COLLECTIVE, chip_port.EXTENSION, chip_port.EXTERNAL) == (0x20, 0x08, 0x10)
    assert (chip_port.encode_index_pulse_number(1), chip_port.encode_index_pulse_number(16)) == (
        1 << 21 | 1 << 20,
        1 << 21 | 1 << 20 | 15 << 16,
    )
    assert chip_port.EZ_SIGNAL == 1 << 20
    assert (chip_port.UNCORRECTED, state.LINEAR, state.SPAN, state.COUNTER_MASK) == (
        0x8000,
        0x1000,
        0xFFF,
        0xFFFFFF,
    )
    assert (state.R10, state.R13, state.R14, state.R15, state.R17) == (8, 11, 12, 13, 15)
