"""Promises of `Chip` and its map where nobody else looks: names as people write them, writes that are only tried, a bus left."""

from dataclasses import replace

import numpy as np
import pytest

from stage.chips import CHIPS, MCX304, MCX514, PCL240K, chip_class
from stage.chips.cycle_descriptions import FieldDescriber
from stage.chips.register_map import Field, Register, dump
from stage.errors import ArgumentError


@pytest.mark.parametrize("name", ["PCL240K", "pcl240k", "PCL-240K", "pcl_240k", "P-C_L240k"])
def test_a_chip_is_found_by_its_name_in_any_case_with_hyphens_and_underscores(name):
    assert name in CHIPS
    assert CHIPS[name] is chip_class(name) is PCL240K


@pytest.mark.parametrize("value", [1.5, 100.0000001, float("nan"), float("inf"), "many", None])
def test_a_register_takes_no_fractions(value):
    """PCL240K.MAP.check_value("R4", 1.5); 100.0 is a whole number"""
    assert PCL240K.MAP.check_value("R4", 100.0) == 100
    with pytest.raises(ArgumentError, match=rf"cannot be {value!r}: it takes a whole number from 2 to 16383"):
        PCL240K.MAP.check_value("R4", value)


def test_a_dump_marks_the_bits_that_can_only_be_read_where_others_of_the_register_are_written():
    fields = (Field("on", 0, 0, "on"), Field("seen", 1, 1, "seen", access="R"))
    mixed, read = (
        Register(name, k, 8, access, "title", fields=fields)
        for k, (name, access) in enumerate([("A", "RW"), ("B", "R")])
    )
    lines = dump(replace(PCL240K.MAP, registers=(mixed, read), words=())).splitlines()
    marked = [line for line in lines if line.endswith(" (read only)")]
    assert [line.split()[1] for line in marked] == ["seen"]
    assert lines.index(marked[0]) < next(k for k, line in enumerate(lines) if line.startswith("B "))


def test_starts_considers_only_the_address_and_data_lines_of_the_chip():
    """chip.would_start_drive(address, value): lines above those of the bus are not there"""
    chip = PCL240K()
    for name, value in {"R1": 100, "R2": 1000, "R4": 100, "R5": 100, "R7": 60}.items():
        for cycle in chip.register_cycles(name, value):
            chip.write(*cycle)
    before = chip.state.tobytes()
    for address, value in ((0, 0x15), (4, 0x15), (0, 0x115), (0x100, 0xFF15)):
        assert chip.would_start_drive(address, value), (address, value)
    assert not chip.would_start_drive(1, 0x15)
    assert not chip.would_start_drive(0, 0x08)
    assert chip.state.tobytes() == before
    chip.write(0, 0x15)
    assert not chip.would_start_drive(0, 0x15), "it drives already"


@pytest.mark.parametrize(
    ("kind", "run", "registers"),
    [
        (MCX514, "DRVVP", {"SV": 100, "DV": 1000, "AC": 5000}),
        (MCX304, "C_DRV_P", {"R": 400_000, "SV": 100, "V": 100, "A": 100}),
    ],
)
def test_starts_considers_only_the_axis_asked_about(kind, run, registers):
    chip = kind()
    for name, value in registers.items():
        for axis in (0, 2):
            for cycle in chip.register_cycles(name, value, axis):
                chip.write(*cycle)
    (write,) = chip.command_cycles(run, 2)
    assert [chip.would_start_drive(*write, axis) for axis in range(4)] == [False, False, True, False]
    chip.write(*write)
    assert not chip.would_start_drive(*write, 2)
    (other,) = chip.command_cycles(run, 0)
    assert chip.would_start_drive(*other, 0), "another drives"


class Line:
    """A bus that nothing hangs on."""

    def cycle(self):
        pass

    ensure_powered = prepare_change = cycle


def test_a_chip_that_leaves_its_bus_is_as_it_was_before_and_alone():
    chip = PCL240K()
    for cycle in chip.register_cycles("R0", 1234):
        chip.write(*cycle)
    before = chip.state.tobytes()
    rows = np.zeros(1, chip.CORE.STATE)
    chip.attach(Line(), rows)
    assert chip.attached
    assert rows.tobytes() == before
    for cycle in chip.register_cycles("R0", 99):
        chip.write(*cycle)
    assert rows["reg"][0][0] == 99
    chip.detach()
    assert not chip.attached
    assert chip.state.tobytes() == before
    rows["reg"][0][0] = 7
    assert chip.values()["R0"] == 1234
    assert chip.advance(10) == 0
    chip.detach()
    assert chip.values()["R0"] == 1234


def test_the_same_bits_with_another_end_of_their_sentence_are_another_sentence():
    fields = FieldDescriber(PCL240K.MAP.word("status"))
    message = fields.describe("status", 0xC0)
    assert fields.describe("status", 0xC0, "; and more") == message + "; and more"
    assert fields.describe("status", 0xC0) == message
    assert fields.describe("read", 0xC0) == message.replace("status", "read", 1)


def test_a_replica_has_the_options_and_the_state_of_its_chip_but_no_diagnostics():
    chip = PCL240K(clock_hz=20_000_000)
    chip.write(0, 0x85)
    chip.write(1, 7)
    assert chip.diagnostics, "its clock is too fast"
    replica = chip.make_replica()
    assert (replica.options(), replica.state.tobytes()) == (chip.options(), chip.state.tobytes())
    assert [d.message for d in replica.diagnostics] == [d.message for d in PCL240K(clock_hz=20_000_000).diagnostics]
    replica.write(1, 9)
    assert chip.values()["R5"] == 7


def test_a_registered_chip_class_is_available_under_any_spelling_until_it_is_removed():
    CHIPS["my-Chip"] = PCL240K
    assert "MYCHIP" in CHIPS
    assert CHIPS["my_chip"] is PCL240K
    assert "MYCHIP" in list(CHIPS)
    del CHIPS["My-chip"]
    assert "my-chip" not in CHIPS


def test_clearing_the_registry_ends_and_every_chip_stays_known(monkeypatch):
    """CHIPS.clear() loaded and dropped the first chip for ever"""
    monkeypatch.setattr(CHIPS, "_loaded", {})
    names = list(CHIPS)
    CHIPS["MINE"] = PCL240K
    assert CHIPS.popitem() == ("MINE", PCL240K)
    with pytest.raises(KeyError, match="stay"):
        CHIPS.popitem()
    CHIPS["MINE"] = PCL240K
    CHIPS.clear()
    assert list(CHIPS) == names
    assert CHIPS["pcl-240k"] is PCL240K
