"""A TOY with one defect each: what `chip_conformance` has to find."""

from __future__ import annotations

import faulthandler
import os
import signal
from dataclasses import replace
from itertools import count
from types import SimpleNamespace
from typing import Any, ClassVar

from stage.native import COMPILED
from toy import TOY, TOY8, answers, core, eight, maps
from toy.driver import ToyDriver


def a_core(**answers: Any) -> Any:
    return SimpleNamespace(**{**vars(core), **answers})


def with_core(**answers: Any) -> type:
    return type("TOY", (TOY,), {"CORE": a_core(**answers)})


def with_eight(**answers: Any) -> type:
    return type("TOY8", (TOY8,), {"CORE": SimpleNamespace(**{**vars(eight), **answers})})


class Remembers(TOY):  # outside its record
    def __init__(self, **options: Any):
        super().__init__(**options)
        self.kept = SimpleNamespace(last=0)

    def write(self, address: int, value: int) -> None:
        self.kept.last += 1
        super().write(address, value)

    def values(self) -> dict[str, int]:
        return super().values() | {"RATE": self.kept.last}


class PoliteDriver(ToyDriver):
    """Sets polarities by the wiring of the axis."""

    def write_move(self, program: Any, values: Any, pulses: int) -> None:
        assert not dict(self.axis.wiring)
        super().write_move(program, values, pulses)


class Polite(TOY):
    DRIVER: ClassVar = "toy.defects:PoliteDriver"


class Raises(TOY):
    def lint(self, address: int, value: int) -> tuple[()]:
        if address & 3 == 0:
            maps.MAP.by_code[value]
        return ()


class TakesAllLines(TOY):
    CORE: ClassVar = a_core(write=answers.takes_all_lines)

    def write(self, address: int, value: int) -> None:
        self.CORE.write(self.state, int(address) & 3, int(value) & 0xFFFFF)


class Shared(TOY):  # all chips of the class share it
    numbers = count()

    def read(self, address: int) -> int:
        return super().read(address) ^ (next(self.numbers) & 1)


class Silent(TOY):
    def listener(self) -> Any:
        return SimpleNamespace(write=lambda address, value: "", read=lambda address, value: "")


class BeyondTheBus(TOY):
    @classmethod
    def register_cycles(cls, name: str, value: int, axis: int = 0) -> list[tuple[int, int]]:
        return [(cls.MAP.register(name).number + 8, value)]


class Turns(TOY):
    @classmethod
    def read_direction(cls, address: int, value: int) -> bool | None:
        return value == core.PLUS if address == 0 and value in (core.PLUS, core.MINUS) else None


class OneAxisShown(TOY8):
    """An axis' registers have one name, and values() shows those of axis 0 for every axis."""

    MAP: ClassVar = replace(maps.MAP, axes=TOY8.AXES)

    @classmethod
    def register_cycles(cls, name: str, value: int, axis: int = 0) -> list[tuple[int, int]]:
        return [(cls.MAP.register(name).number + 2 * axis, value)]


class Unsent(TOY):
    @classmethod
    def command_cycles(cls, symbol: str, axis: int = 0, datum: int | None = None) -> list[tuple[int, int]]:
        return [(0, {}[symbol])]


class Latches(TOY):
    """Nothing shows it yet, but it is lost in a copy."""

    latch = 0

    def write(self, address: int, value: int) -> None:
        self.latch = int(value) & 0xFF
        super().write(address, value)


class Narrow(TOY):
    """A snapshot of another chip is restored without the highest bit of a register."""

    def restore(self, snapshot: Any) -> None:
        super().restore(snapshot)
        if self.diagnostics == [] and self.clock == 0:
            self.state["rate"] &= 0x7FFF


class Endless(TOY):
    """A read never returns."""

    def read(self, address: int) -> int:
        while True:
            pass


class Wild(TOY):
    """A read ends the process, as a core does that reads beyond an array."""

    def read(self, address: int) -> int:
        faulthandler.disable()  # no dump among the tests' lines
        os.kill(os.getpid(), signal.SIGSEGV)
        return 0


class Elsewhere(TOY):
    """As plain Python its clock is another one."""

    def _configure(self, record: Any) -> None:
        record["hz"] = self.clock_hz if COMPILED else self.clock_hz + 1


class Beyond(TOY):
    """As plain Python an index is seen to be too large."""

    def _configure(self, record: Any) -> None:
        super()._configure(record)
        if not COMPILED:
            raise IndexError("beyond")


FORGETS = {"run": answers.forgets_the_phase, "advance": answers.forgets_the_phase_too}


class AnyPin(TOY):  # a misspelt pin is set, and nobody is told
    def __init__(self, **options: Any):
        super().__init__(**options)
        pins = type(self.axes[0].pins)

        class Pins(pins):  # type: ignore[misc, valid-type]
            def __setattr__(self, name: str, value: Any) -> None:
                if name != "no_such_pin":
                    super().__setattr__(name, value)

        for axis in self.axes:
            object.__setattr__(axis.pins, "__class__", Pins)


DEFECTS: dict[str, tuple[type, str, str]] = {
    "any pin can be set": (AnyPin, "pins_by_name", "pin no_such_pin, no input, can be set"),
    "time cut": (with_core(**FORGETS), "cut_time", "the state differs in due|makes .* pulses, and"),
    "cut at a pulse": (with_core(advance=answers.late_by_a_clock), "cut_time", "the state differs in due"),
    "advance counts wrong": (with_core(advance=answers.one_at_most), "traced", "says 1 pulses, and the axes' net go by"),
    "trace's direction": (with_core(trace=answers.the_other_way), "traced", "net of axis 0 goes from"),
    "the end for the mean": (with_core(drive_input=answers.the_end), "drive_inputs", "and the mean of the .* pulses"),
    "a slice left out": (with_core(window=answers.without_the_first_slice), "windows", "window gives the means"),
    "never busy": (with_core(busy=answers.never_busy), "courses", "its core says at rest"),
    "the counter": (with_core(counter=answers.counts_twice), "courses", "counter has gone by"),
    "a reset that keeps": (with_core(power_up=answers.keeps_the_rate), "resets", "RATE .*, and after power-up 0"),
    "a read that clears": (with_core(read=answers.clears_what_it_reads), "reads", "changes left"),
    "a course without end": (with_core(scan=answers.sees_no_end), "journals", "the course shows"),
    "state beside the record": (Remembers, "snapshots", "restored, after .* acts it shows"),
    "a bit lost by a snapshot": (Narrow, "snapshots", "with the most in every register, .* the state differs in rate"),
    "a lint that raises": (Raises, "diagnostics", "raises KeyError"),
    "20 data lines": (TakesAllLines, "bus_lines", "a read of address 1h gives|reads"),
    "shared by all": (Shared, "determinism", "beside another chip"),
    "two pins, one bit": (
        type("TOY", (TOY,), {"INPUTS": {**TOY.INPUTS, "sd": TOY.INPUTS["org"]}}),
        "has_what_every_chip_has", "pin sd of INPUTS has a bit that another one has"),
    "no words": (Silent, "words", "says ''"),
    "a cycle beside the bus": (BeyondTheBus, "register_cycles", "is not on the bus"),
    "half the rate": (with_core(pulse_rate=answers.half_the_rate), "drive_inputs", "pulse_rate is .* a second, and"),
    "a reset that counts anew": (with_core(power_up=answers.clears_the_count), "resets", "changes the count"),
    "a read beyond the data lines": (
        with_core(read=answers.wider_than_the_bus, peek=answers.wider_than_the_bus), "reads", r"read\(0h\) gives 65537"),
    "what is due at the end": (with_eight(run=answers.leaves_what_is_due_at_the_end), "windows", "after run and advance"),
    "minus not counted": (with_eight(advance=answers.counts_plus_only), "traced", "and the axes' net go by"),
    "inputs of all axes": (with_eight(set_input=answers.all_axes_at_once), "pins_by_name", "inputs of another axis"),
    "a look that acts": (with_eight(peek=answers.looks_and_touches), "reads", r"after peek\(10h\), the state differs in ax"),
    "no end in a coarse course": (with_eight(scan=answers.sees_pulses_and_no_ends), "journals", "output runs at another"),
    "a switch that stops nothing": (
        with_core(set_input=answers.only_keeps), "limit_switches", "goes on to its end, though el_(plus|minus) is asserted"),
    "switches exchanged": (
        type("TOY", (TOY,), {"WIRING": {"el_plus": "el_minus", "el_minus": "el_plus"}}),
        "limit_switches", "goes on to its end, though el_plus is asserted"),
    "the direction exchanged": (Turns, "limit_switches", "axis 0 goes (plus|minus), and `turns` says (plus|minus)"),
    "a stop for all": (with_eight(write=answers.stops_all), "axes_alone", "the driver's stop of axis . changes the pulses"),
    "values of one axis": (OneAxisShown, "axes_alone", "RATE = 1 written to axis 0 changes what values_of gives for another axis"),
    "a trace that loses": (with_eight(trace=answers.one_a_clock), "traced", "says .* pulses, and trace lists"),
    "a scan beyond its array": (with_core(scan=answers.one_too_many), "journals", "writes behind `out`, which holds 8"),
    "a command that cannot be sent": (Unsent, "command_cycles", r"command_cycles\('.*'\), a command, raises KeyError"),
    "an attribute beside the record": (Latches, "snapshots", "change its attribute 'latch' to .*: a snapshot does not have it"),
    "an interrupt at no pin": (
        type("TOY", (TOY,), {"IRQ": (0, 64)}), "has_what_every_chip_has", r"IRQ is \(0, 0x40\): .* bits of OUTPUTS"),
    "an answer missing": (with_core(drive_input=None), "has_what_every_chip_has", "has no answer drive_input"),
}  # fmt: skip
"""Defect -> (the class, the promise that it breaks, words of the message)."""
