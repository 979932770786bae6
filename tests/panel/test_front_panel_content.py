"""What front panels show and take, from register maps alone."""

from dataclasses import replace

import pytest

from stage import units
from stage.chips import CHIPS, HCTL1100, MCX514, PCL240K, PCL240MS
from stage.errors import ArgumentError
from stage.panel.front_panel_content import (
    BusCycle,
    FrontPanel,
    describe_lamp,
    describe_range,
    describe_value,
    find_weakest_evidence,
    format_value,
    list_completions,
    parse_line,
    parse_number,
    replace_field,
)


@pytest.mark.parametrize(
    ("typed", "value"),
    [
        ("8000", 8000),
        ("1F40h", 8000),
        ("0x1f40", 8000),
        ("0b101", 5),
        ("8_000", 8000),
        ("-1", -1),
        ("+7", 7),
        ("-10h", -16),
    ],
)
def test_a_number_is_typed_as_sheets_and_programs_write_it(typed, value):
    assert parse_number(typed, 13) == value


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("", "a number is missing: write for example 100, 64h, 0x64"),
        ("-", "a number is missing"),
        ("1F", r"'1F' is not a decimal number. Did you mean 1Fh \(31\)\?"),
        ("1O0", r"'1O0' is not a number. Did you mean 100\?"),
        ("12.5", r"registers hold whole numbers. Did you mean 12\?"),
        ("abcx", "'abcx' is not a number"),
        ("8192", "8192 needs more than 13 bits: -4096 to 8191 fit"),
        ("-4097", "needs more than 13 bits"),
        ("9" * 5000, "a number of 5000 characters needs more than 13 bits"),  # x: R2 <- 999...: a bare ValueError
    ],
)
def test_an_invalid_number_is_refused_with_a_suggestion(typed, message):
    with pytest.raises(ArgumentError, match=message):
        parse_number(typed, 13)


def test_every_command_of_every_chip_has_a_button_or_a_row():
    for kind in map(CHIPS.get, CHIPS.built_in):
        front = FrontPanel(kind)
        buttons = [b for group in front.buttons.values() for b in group]
        sent = {b.symbol for b in buttons} | {r.name for r in front.registers} | {w.name for w in front.forms}
        assert {c.symbol for c in kind.MAP.commands} <= sent
        for b in buttons:
            assert kind.command_cycles(b.symbol, kind.AXES - 1, 0 if b.data_bits else b.datum), b
            assert b.title
            assert b.label


def test_a_chip_that_does_not_say_how_its_commands_are_sent_has_no_buttons():
    class ChipWithoutCommandCycles(MCX514):
        @classmethod
        def command_cycles(cls, symbol, axis=0, datum=None):
            raise NotImplementedError("Mute does not say how its commands are sent.")

    assert FrontPanel(ChipWithoutCommandCycles).buttons == {}
    with pytest.raises(ArgumentError, match=r"Mute does not say how its commands are sent\. Write its bytes: `0: 15`"):
        parse_line(ChipWithoutCommandCycles, "DRVRL")


def test_bytes_that_a_word_has_by_name_carry_its_fixed_bits():
    buttons = {b.label: b for group in FrontPanel(PCL240K).buttons.values() for b in group}
    assert (buttons["15h"].title, buttons["81h"].title) == ("start with a ramp to FH1", "R1")
    assert PCL240K.command_cycles("select", 0, buttons["81h"].datum) == [(0, 0x81)]


def test_values_are_formatted_and_described_by_the_map():
    r14, lp = PCL240MS.MAP.register("R14"), MCX514.MAP.register("LP")
    assert (format_value(r14, 0x9005), describe_value(r14, 0x1000)) == ("9005h", "linear ramps")
    assert (format_value(lp, -20), describe_value(lp, -20)) == ("-20", "FFFFFFECh")
    linear = PCL240MS.MAP.field("R14", "linear")
    assert replace_field(0x8005, linear, 1) == 0x9005
    assert replace_field(0x8005, linear, 3) == 0x9005, "the bits beside it stay"
    assert format_value(CHIPS["PCL240MK"].MAP.register("R13"), 5) == "000005h", "of 23 bits"
    assert describe_range(MCX514.MAP.register("LX")) == "1 to 2147483647 or 4294967295"
    assert describe_range(lp) == f"{lp.range[0]} to {lp.range[1]}{'' if lp.legal else ' (32 bits)'}"
    operating = PCL240K.MAP.field("status", "operating")
    assert [describe_lamp(operating, v) for v in (0, 1)] == [("not operating", False), ("operating", True)]
    pending = PCL240K.MAP.field("status", "no_int")
    assert [describe_lamp(pending, v) for v in (0, 1)] == [("/INT pending", True), ("no /INT pending", False)]


def test_the_evidence_of_several_fields_is_the_weakest():
    field = PCL240K.MAP.field("status", "operating")
    parts = [replace(field, evidence=letter) for letter in ("I", "S", "D")]
    assert [find_weakest_evidence(tuple(parts[k:])) for k in range(3)] == ["I", "D", "D"]


@pytest.mark.parametrize("line", ["read 99999", "99999: 1", "read 4", "4: 1", "read -1", "read 0 4"])
def test_an_address_that_the_chip_has_not_is_refused_of_reads_and_of_writes(line):
    with pytest.raises(ArgumentError, match=r"PCL-?240K has the addresses 0 to 3h"):
        parse_line(PCL240K, line)


@pytest.mark.parametrize("line", ["R2 <- \u0663", "R2 <- 1\u0663", "0: \u0663", "\u0663: 1", "read \u0663"])
def test_digits_of_another_script_are_none(line):
    """x: R2 <- \u0663
    wrote 3; the agents' tools refuse it"""
    with pytest.raises(ArgumentError, match=r"is not a (hexadecimal )?number"):
        parse_line(PCL240K, line)


@pytest.mark.parametrize("typed", ["\u0663", "1\u0663.5", "1O\u0663", "\u00b2"])
def test_nor_is_anything_with_them_proposed(typed):
    """x: R2 <- 1O\u0663"""
    with pytest.raises(ArgumentError, match="is not a number: write for example 100, 64h"):
        parse_number(typed, 13)
    assert units.parse_integer(typed) is None


@pytest.mark.parametrize("line", ["1FF", "2: 100", "15 99999"])
def test_what_is_wider_than_the_bus_is_refused(line):
    with pytest.raises(ArgumentError, match="takes 0 to FFh in one cycle"):
        parse_line(PCL240K, line)


def writes(*cycles):
    return tuple(BusCycle(False, *cycle) for cycle in cycles)


@pytest.mark.parametrize(
    ("kind", "line", "cycles"),
    [
        (PCL240K, "10 15h 0x1D", writes((0, 0x10), (0, 0x15), (0, 0x1D))),
        (PCL240K, "2: 1F 20", writes((2, 0x1F), (2, 0x20))),
        (PCL240K, "r1 <- 100", writes((0, 0x81), (2, 0), (1, 100))),
        (PCL240K, "R1=64h", writes((0, 0x81), (2, 0), (1, 100))),
        (PCL240K, "read 3 2", (BusCycle(True, 3), BusCycle(True, 2))),
        (PCL240K, "operate 15h", writes((0, 0x15))),
        (PCL240MS, "R14.linear <- 1", writes((0, 0x94), (2, 0x10), (1, 5))),
        (HCTL1100, "mode 3", writes((5, 3))),
        (HCTL1100, "final_position <- -2", writes((0x2B, 0xFF), (0x2A, 0xFF), (0x29, 0xFE))),
        (MCX514, "DRVRL", writes((0, 0x0450))),
        (MCX514, "dv 8000", writes((6, 8000), (7, 0), (0, 0x0405))),
        (MCX514, "WR3 <- 4", writes((0, 0x041F), (3, 4))),
        (MCX514, "RST", writes((0, 0xFF))),
    ],
)
def test_a_line_of_the_console_becomes_bus_cycles(kind, line, cycles):
    assert parse_line(kind, line, min(2, kind.AXES - 1), {"R14": 5}).cycles == cycles


@pytest.mark.parametrize(
    ("kind", "line", "message"),
    [
        (PCL240K, "", "`help` lists what can be written here"),
        (PCL240K, "reed 0", r"'reed' is no name of PCL240K and no byte. Did you mean read"),
        (PCL240K, "R9 <- 1", "no register or word of PCL240K is called 'R9'. Did you mean R"),
        (PCL240K, "R1 <- 1OO", "Did you mean 100"),
        (PCL240K, "read", "an address is missing, 0 to 3h"),
        (PCL240K, "2:", "the data are missing"),
        (PCL240K, "x: 10", "'x' is not a hexadecimal number"),
        (PCL240K, "operate", "takes 8 bits"),
        (PCL240MS, "R14.lin <- 1", "Did you mean 'linear'"),
        (MCX514, "drvl", "Did you mean DRVRL"),
        (MCX514, "CV <- 1", "CV .* can only be read"),
        (MCX514, "help DRVR", "Did you mean DRVRL"),
    ],
)
def test_a_meaningless_line_is_refused_with_a_suggestion(kind, line, message):
    with pytest.raises(ArgumentError, match=message):
        parse_line(kind, line)


def test_the_console_answers_without_bus_cycles():
    assert parse_line(MCX514, "AC", 0, {"AC": 77}) == ((), "AC = 77 pps/s (4Dh): acceleration")
    assert "R1 <- 100" in parse_line(PCL240K, "help").answer
    assert parse_line(PCL240K, "help r1").answer == "R1: FL speed; 1 to 8191 speed steps"
    assert ".linear" in parse_line(PCL240MS, "help R14").answer
    assert list_completions(MCX514, "drvv") == ["DRVVP", "DRVVM"]
    assert list_completions(MCX514, "") == []
