"""Promises of `RegisterMap.sent`: what a host sends by its name, which data go with it, and which are refused in words."""

import pytest

from stage.chips.register_map import ChipCommand, Field, RegisterMap, Word
from stage.errors import ArgumentError

MODE = Word(
    "mode",
    "control mode",
    (
        Field("group", 7, 6, "", legal=(2, 2), access="W"),
        Field("speed", 5, 3, "speed", legal=(1, 3), access="W"),
        Field("on", 0, 0, "on", access="W"),
    ),
    address=3,
)
STATUS = Word("status", "what it does", (Field("busy", 0, 0, "drives", access="R"),), address=0)
GO, READ, STOP, PICK = COMMANDS = (
    ChipCommand(0x10, "GO", "go so far", "data write", bytes=1),
    ChipCommand(0x20, "R-GO", "read how far", "data read", bytes=1),
    ChipCommand(0x30, "STOP", "stop", "drive"),
    ChipCommand(0x40, "PICK", "pick", "other", choice=0b110, chooses=("A", "B")),
)
MAP = RegisterMap("ACME", "of nobody", "here", (), (MODE, STATUS), COMMANDS)


@pytest.mark.parametrize(("datum", "bits"), [(0, 0), (1, 1), (255, 255), (-1, 255), (-128, 128)])
def test_data_of_both_signs_go_as_bits_of_their_width(datum, bits):
    assert MAP.find_command_or_word("go", datum) == (GO, bits)
    assert MAP.find_command_or_word("Mode", datum) == (MODE, bits)


@pytest.mark.parametrize("datum", [-129, 256, 1.0, True, "1", None])
def test_data_that_do_not_fit_are_refused_with_what_it_takes(datum):
    was = "none was given" if datum is None else f"{datum!r} was given"
    with pytest.raises(ArgumentError, match=f"ACME GO takes 8 bits of data: go so far; {was}"):
        MAP.find_command_or_word("GO", datum)
    with pytest.raises(ArgumentError, match=f"ACME mode takes 8 bits: control mode; {was}"):
        MAP.find_command_or_word("mode", datum)


@pytest.mark.parametrize("command", [READ, STOP])
@pytest.mark.parametrize("datum", [0, 1, -1])
def test_a_command_without_data_takes_none_not_even_0(command, datum):
    assert MAP.find_command_or_word(command.symbol) == (command, 0)
    with pytest.raises(ArgumentError, match=rf"{command.symbol}: this command takes no data, and {datum} was given"):
        MAP.find_command_or_word(command.symbol, datum)


def test_a_command_with_a_choice_needs_at_least_one_valid_choice():
    assert [MAP.find_command_or_word("PICK", chosen) for chosen in (2, 4, 6)] == [
        (PICK, chosen) for chosen in (2, 4, 6)
    ]
    for datum in (0, 1, 3, 7, 8, None):
        with pytest.raises(ArgumentError, match="ACME PICK takes bits that choose among A, B"):
            MAP.find_command_or_word("PICK", datum)


def test_a_word_that_a_host_only_reads_is_nothing_to_send():
    with pytest.raises(ArgumentError, match=r"unknown ACME command 'STATUS'.*Known: GO, MODE, PICK, R-GO, STOP"):
        MAP.find_command_or_word("STATUS", 0)


def test_the_fixed_bits_of_a_word_are_those_of_fields_with_one_legal_value():
    assert MODE.fixed == 0b1000_0000
    assert STATUS.fixed == 0
