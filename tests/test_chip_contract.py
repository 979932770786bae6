"""What a chip's class, and its driver, lack is told by its name, before anything is done with the chip."""

import dataclasses
from abc import abstractmethod
from types import SimpleNamespace

import numpy as np
import pytest

from stage import ArgumentError, Stage, firmware
from stage.board import bus_layouts
from stage.chips import HCTL1100, MCX304, MCX514, PCL240K, Chip, contract_check
from stage.chips.register_map import Field, Register, Word
from stage.firmware.pcl240.driver import Pcl240Driver

REGISTERS = PCL240K.MAP.registers


def change_map(**change):
    return {"MAP": dataclasses.replace(PCL240K.MAP, **change)}


def change_core(**change):
    """That of the PCL240K, with something else in it."""
    return SimpleNamespace(**vars(PCL240K.CORE) | change)


@pytest.mark.parametrize(
    ("lacks", "message"),
    [
        ({"BUSY": ("status", "busy")}, "BUSY is .*address, and the bit of axis 0"),
        ({"BUSY": (0,)}, "BUSY is"),
        ({"COUNTER": ("COUNT",)}, "COUNTER is .*a register's name, and its bits"),
        ({"ADDRESSES": "64"}, "ADDRESSES is '64'"),
        ({"DATA_MASK": None}, "DATA_MASK is None"),
        ({"AXES": True}, "AXES is True"),
        ({"AXES": 2}, r"AXES is 2, and its MAP is of 1: RegisterMap\(..., axes=2\)"),
        ({"DEFAULT_CLOCK_HZ": 0}, "DEFAULT_CLOCK_HZ is 0: 1 to 100,000,000 Hz"),
        ({"INPUTS": {"el_plus": 1, "org": 1}}, "pin org of INPUTS has a bit that another one has: 1h"),
        ({"INPUTS": {"el_plus": 3, "org": 2}}, "pin org of INPUTS has a bit that another one has: 2h"),
        ({"INPUTS": {"up": 1, "low": 2, "org": 1}}, "pin org of INPUTS has a bit that another one has: 1h"),
        ({"INPUTS": {"up": 1}, "OUTPUTS": {"up": 1}}, "pin up is an input and an output"),
        ({"INPUTS": {"org": 0}}, "pin org has no bit: a number above 0"),
        ({"ADDRESSES": 8, "ADDRESS_MASK": 6}, "ADDRESS_MASK 6h does not reach all of its 8 ADDRESSES"),
        ({"DATA_MASK": 0}, "DATA_MASK is 0"),
        ({"BUSY": (-1, 1)}, "BUSY is"),
        ({"BUSY": (0, 0)}, "BUSY is"),
        ({"COUNTER": ("R0", 0)}, "COUNTER is"),
        ({"DEFAULT_CLOCK_HZ": 100_000_001}, "DEFAULT_CLOCK_HZ is 100000001: 1 to 100,000,000 Hz"),
        ({"MICROSTEPS": 257}, "MICROSTEPS is 257: 1 to 256 pulses of the chip a full step, or 0"),
        ({"MICROSTEPS": 2.5}, "MICROSTEPS is 2.5"),
        ({"DRIVER": "package.module"}, "DRIVER is 'package.module': write 'package.module:Class'"),
        ({"ENCODERS": True}, "has no answer scan_edges_and_shafts"),
        ({"CORE": change_core(STATE=np.dtype([("clock", "i8"), ("x", "i4")]))}, "has 12 bytes: a multiple of 8"),
        (
            {"CORE": change_core(STATE=np.dtype([("x", "i8"), ("clock", "i8")]))},
            r"does not begin with \('clock', 'i8'\)",
        ),
        (
            {"CORE": change_core(STATE=np.dtype([("clock", "i8"), ("ax", [("data", "i8")], (2,))]))},
            "field 'data' of STATE .* has the name of an attribute of NumPy's records",
        ),
        ({"CORE": change_core(STATE=np.dtype([("clock", "f8")]))}, r"does not begin with \('clock', 'i8'\)"),
        (
            change_map(registers=(*REGISTERS, Register("P", 5, 8, "RW", "p", (-129, 0)))),
            "P takes -129 to 0, and 8 bits do not",
        ),
        ({"PHASES": {"upp": "up"}}, "PHASES names 'upp', and OUTPUTS has no such pin"),
        (change_map(registers=(*REGISTERS, REGISTERS[0])), "its MAP has two registers R0"),
        (
            change_map(registers=(*REGISTERS, Register("P", 5, 8, "RW", "p", (0, 256)))),
            "P takes 0 to 256, and 8 bits do not",
        ),
        (
            change_map(words=(Word("w", "w", (Field("f", 1, 2, "f"),)),)),
            r"field f of w has bits 1..2: the higher first",
        ),
        (
            change_map(words=(Word("w", "w", (Field("e", 3, 0, "e"), Field("f", 4, 3, "f"))),)),
            "field f of w has bits that another one has: 4..3",
        ),
        (
            change_map(words=(Word("w", "w", (Field("e", 3, 0, "e"), Field("g", 7, 4, "g"), Field("f", 0, 0, "f"))),)),
            "field f of w has bits that another one has: 0",
        ),
    ],
)
def test_what_a_class_has_wrong_is_named(lacks, message):
    with pytest.raises(ArgumentError, match=f"BAD breaks the contract of chips: .*{message}"):
        contract_check.check_chip_class(type("BAD", (PCL240K,), lacks), Chip)


@pytest.mark.parametrize(
    "has",
    [
        {"MICROSTEPS": 256},
        {"DEFAULT_CLOCK_HZ": 1},
        {"DEFAULT_CLOCK_HZ": 100_000_000},
        {"ADDRESSES": 4, "ADDRESS_MASK": 3},
        {"INPUTS": {"a": 1, "b": 2}},
        change_map(registers=(*REGISTERS, Register("P", 5, 8, "RW", "p", (-128, 255)))),
    ],
)
def test_values_at_the_bounds_are_accepted(has):
    contract_check.check_chip_class(type("GOOD", (PCL240K,), has), Chip)


class NoStop(Pcl240Driver):
    @abstractmethod
    def halt(self, at_once=False): ...

    @abstractmethod
    def write_stop(self, program): ...


class DriverWithoutPolarity(Pcl240Driver):
    INVERTIBLE_SENSORS = ()


@pytest.mark.parametrize(
    ("driver", "message"),
    [
        ("nowhere.driver:X", "DRIVER = 'nowhere.driver:X', its driver, cannot be loaded: ModuleNotFoundError"),
        ("stage.firmware.pcl240.driver:X", "cannot be loaded: AttributeError: .*'X'"),
        ("stage.board.bus_layouts:LAYOUTS", "is no class below stage.firmware.driver.Driver"),
        (f"{__name__}:NoStop", r"its driver NoStop has no halt\(\), write_stop\(\)"),
    ],
)
def test_a_wrong_driver_is_refused_with_its_reason(driver, message):
    bench = firmware.Bench(x=type("BAD", (PCL240K,), {"DRIVER": driver})())
    with pytest.raises(ArgumentError, match=f"BAD: .*{message}"):
        firmware.move(bench.axes["x"], pulses=10)


def test_a_wrong_layout_is_refused_with_its_name(monkeypatch):
    monkeypatch.setattr(bus_layouts, "LAYOUTS", {})  # a shipped family has its own
    with pytest.raises(
        ArgumentError, match=r"LAYOUT = 'stage.board.bus_layouts:BYTE' is no stage.board.bus_layouts.Layout"
    ):
        bus_layouts.make_default_layout(type("BAD", (PCL240K,), {"LAYOUT": "stage.board.bus_layouts:BYTE"})())


def test_a_driver_without_invertible_sensors_refuses_positive_logic():
    chip = type("PLAIN", (PCL240K,), {"DRIVER": f"{__name__}:DriverWithoutPolarity"})
    stage = Stage("xy", chips={"x": chip}, wiring={"x": {"org": "positive"}}, visuals=False)
    with pytest.raises(ArgumentError, match=r"axis x: org is of positive logic, and a PCL240K cannot read it so. Wire"):
        firmware.move(stage.axes["x"], pulses=10)


@pytest.mark.parametrize(
    "cycle", [("write", 0, None), ("write", 0, float("nan")), ("write", "x", 0), ("read", None), ("read", float("inf"))]
)
@pytest.mark.parametrize("make", [PCL240K, MCX304, HCTL1100])
def test_a_bus_cycle_with_what_is_no_number_is_refused(make, cycle):
    chip = make()
    with pytest.raises(ArgumentError, match=rf"{cycle[0]}\(.*whole number"):
        getattr(chip, cycle[0])(*cycle[1:])


@pytest.mark.parametrize("cycle", [("write_byte", 0, None), ("write_byte", "x", 0), ("read_byte", float("nan"))])
def test_a_byte_cycle_of_a_wide_bus_with_what_is_no_number_is_refused(cycle):
    with pytest.raises(ArgumentError, match=rf"{cycle[0]}\(.*whole number"):
        getattr(MCX514(), cycle[0])(*cycle[1:])


def test_a_fraction_and_a_wide_address_give_different_diagnostics():
    chip = PCL240K()
    chip.write(1, 3.7)
    chip.write(5, 0)
    assert [d.message for d in chip.diagnostics] == [
        "value 3.7 acts as 03h: the bus has whole numbers",
        "address 05h acts as 01h: the bus is no wider",
    ]


def test_an_error_counts_all_mistakes_and_names_the_first_four():
    lacks = {"BUSY": (-1, 1), "COUNTER": ("R0", 0), "MICROSTEPS": 257, "DRIVER": "x", "DEFAULT_CLOCK_HZ": 0}
    with pytest.raises(ArgumentError) as caught:
        contract_check.check_chip_class(type("BAD", (PCL240K,), lacks), Chip)
    message = str(caught.value)
    assert "BUSY is" in message.partition(" (and 4 more: ")[0]
    assert [name in message.partition(" (and 4 more: ")[2] for name in ("COUNTER", "DEFAULT_CLOCK_HZ", "MICROSTEPS", "DRIVER")] == [
        True, True, True, False,
    ]  # fmt: skip


def test_a_class_that_was_checked_without_its_methods_is_checked_with_them_later():
    class Mute(PCL240K):
        make_describer = Chip.make_describer

    contract_check.check_chip_class(Mute, Chip, check_methods=False)
    for _ in range(2):
        with pytest.raises(
            ArgumentError, match=r"the class has no make_describer\(\), what bus cycles say, for traces"
        ):
            contract_check.check_chip_class(Mute, Chip)
