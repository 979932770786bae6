"""Toy chips with one defect each, which `chip_conformance` must detect."""

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


def build_core(**answers: Any) -> Any:
    return SimpleNamespace(**{**vars(core), **answers})


def build_toy(**answers: Any) -> type:
    return type("TOY", (TOY,), {"CORE": build_core(**answers)})


def build_toy8(**answers: Any) -> type:
    return type("TOY8", (TOY8,), {"CORE": SimpleNamespace(**{**vars(eight), **answers})})


class UnsavedCounter(TOY):
    """A chip with a counter outside its record, which a snapshot loses."""

    def __init__(self, **options: Any):
        super().__init__(**options)
        self.unsaved = SimpleNamespace(last=0)

    def write(self, address: int, value: int) -> None:
        self.unsaved.last += 1
        super().write(address, value)

    def values(self) -> dict[str, int]:
        return super().values() | {"RATE": self.unsaved.last}


class WiringCheckDriver(ToyDriver):
    """A driver that requires an axis with default wiring."""

    def write_move(self, program: Any, values: Any, pulses: int) -> None:
        assert not dict(self.axis.wiring)
        super().write_move(program, values, pulses)


class ChecksWiring(TOY):
    DRIVER: ClassVar = "toy.defects:WiringCheckDriver"


class StillDriver(ToyDriver):
    """A driver that says that nothing ever moves."""

    @property
    def is_moving(self) -> bool:
        return self.chip.clock < 0


class UnstoppableDriver(ToyDriver):
    """A driver whose stop does not stop."""

    def halt(self, at_once: bool = False) -> None:
        pass


class Unstoppable(TOY):
    DRIVER: ClassVar = "toy.defects:UnstoppableDriver"


class RaisingLint(TOY):
    def lint(self, address: int, value: int) -> tuple[()]:
        if address & 3 == 0:
            maps.MAP.by_code[value]
        return ()


class UnmaskedDataLines(TOY):
    CORE: ClassVar = build_core(write=answers.write_without_masking)

    def write(self, address: int, value: int) -> None:
        self.CORE.write(self.state, int(address) & 3, int(value) & 0xFFFFF)


class SharedCounter(TOY):
    """A chip whose reads depend on a counter that all chips of the class share."""

    numbers = count()

    def read(self, address: int) -> int:
        return super().read(address) ^ (next(self.numbers) & 1)


class EmptyDescriptions(TOY):
    def make_describer(self) -> Any:
        return SimpleNamespace(write=lambda address, value: "", read=lambda address, value: "")


class AddressBeyondTheBus(TOY):
    @classmethod
    def register_cycles(cls, name: str, value: int, axis: int = 0) -> list[tuple[int, int]]:
        return [(cls.MAP.register(name).number + 8, value)]


class ReversedDirection(TOY):
    @classmethod
    def find_selected_direction(cls, address: int, value: int) -> bool | None:
        return value == core.PLUS if address == 0 and value in (core.PLUS, core.MINUS) else None


class FirstAxisValuesOnly(TOY8):
    """A chip whose values() returns the registers of axis 0 for every axis."""

    MAP: ClassVar = replace(maps.MAP, axes=TOY8.AXES)

    @classmethod
    def register_cycles(cls, name: str, value: int, axis: int = 0) -> list[tuple[int, int]]:
        return [(cls.MAP.register(name).number + 2 * axis, value)]


class UnknownCommand(TOY):
    @classmethod
    def command_cycles(cls, symbol: str, axis: int = 0, datum: int | None = None) -> list[tuple[int, int]]:
        return [(0, {}[symbol])]


class UnsavedLatch(TOY):
    """A chip with an attribute that no register shows and that a copy loses."""

    latch = 0

    def write(self, address: int, value: int) -> None:
        self.latch = int(value) & 0xFF
        super().write(address, value)


class TruncatedRestore(TOY):
    """A chip that loses the highest bit of RATE when it restores a snapshot of another chip."""

    def restore(self, snapshot: Any) -> None:
        super().restore(snapshot)
        if self.diagnostics == [] and self.clock == 0:
            self.state["rate"] &= 0x7FFF


class EndlessRead(TOY):
    """A chip whose read never returns."""

    def read(self, address: int) -> int:
        while True:
            pass


class CrashingRead(TOY):
    """A chip whose read ends the process, as a core does that reads beyond an array."""

    def read(self, address: int) -> int:
        faulthandler.disable()  # no traceback in the output of the tests
        os.kill(os.getpid(), signal.SIGSEGV)
        return 0


class UncompiledClockDiffers(TOY):
    """A chip whose clock rate differs when its code runs uncompiled."""

    def _configure(self, record: Any) -> None:
        record["hz"] = self.clock_hz if COMPILED else self.clock_hz + 1


class UncompiledIndexError(TOY):
    """A chip whose uncompiled code raises IndexError."""

    def _configure(self, record: Any) -> None:
        super()._configure(record)
        if not COMPILED:
            raise IndexError("beyond")


PERIOD_RESTARTS = {"run": answers.run_restarting_the_period, "advance": answers.advance_restarting_the_period}


class AcceptsUnknownPin(TOY):
    """A chip that silently accepts a misspelled pin."""

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
    "any pin can be set": (AcceptsUnknownPin, "pins_by_name", "pin no_such_pin, no input, can be set"),
    "a period restarted when time is divided": (
        build_toy(**PERIOD_RESTARTS), "cut_time", "the state differs in due|makes .* pulses, and"),
    "time divided at a pulse": (
        build_toy(advance=answers.advance_deferring_a_pulse_at_the_end), "cut_time", "the state differs in due"),
    "advance counts wrong": (
        build_toy(advance=answers.advance_counting_one_pulse), "traced",
        "says 1 pulses, and the axes' net go by"),
    "trace's direction": (build_toy(trace_pulses=answers.trace_with_reversed_direction), "traced", "net of axis 0 goes from"),
    "the final position instead of the mean": (
        build_toy(compute_drive_input=answers.drive_input_at_the_end), "drive_inputs", "and the mean of the .* pulses"),
    "a slice left out": (
        build_toy(run_window=answers.window_skipping_the_first_slice), "windows", "window gives the means"),
    "never busy": (build_toy(is_busy=answers.busy_always_false), "courses", "its core says at rest"),
    "the counter": (build_toy(read_counter=answers.counter_doubled), "courses", "counter has gone by"),
    "a reset that keeps": (
        build_toy(power_up=answers.power_up_keeping_the_rate), "resets", "RATE .*, and after power-up 0"),
    "a read that clears": (build_toy(read=answers.read_clearing_the_count), "reads", "changes left"),
    "a waveform without end": (build_toy(scan_edges=answers.scan_finding_no_edges), "journals", "the course shows"),
    "state outside the record": (UnsavedCounter, "snapshots", "restored, after .* acts it shows"),
    "a bit lost by a snapshot": (
        TruncatedRestore, "snapshots", "with the most in every register, .* the state differs in rate"),
    "a lint that raises": (RaisingLint, "diagnostics", "raises KeyError"),
    "20 data lines": (UnmaskedDataLines, "bus_lines", "a read of address 1h gives|reads"),
    "shared by all": (SharedCounter, "determinism", "beside another chip"),
    "two pins, one bit": (
        type("TOY", (TOY,), {"INPUTS": {**TOY.INPUTS, "sd": TOY.INPUTS["org"]}}),
        "has_what_every_chip_has", "pin sd of INPUTS has a bit that another one has"),
    "no words": (EmptyDescriptions, "words", "says ''"),
    "a cycle beyond the bus": (AddressBeyondTheBus, "register_cycles", "is not on the bus"),
    "half the rate": (
        build_toy(read_pulse_rate=answers.pulse_rate_halved), "drive_inputs", "pulse_rate is .* a second, and"),
    "a reset that clears the pulse count": (
        build_toy(power_up=answers.power_up_clearing_net), "resets", "changes the count"),
    "a read beyond the data lines": (
        build_toy(read=answers.read_wider_than_the_bus, peek=answers.read_wider_than_the_bus), "reads", r"read\(0h\) gives 65537"),
    "a pulse due at the end": (
        build_toy8(run=answers.run_omitting_pulses_at_the_end), "windows", "after run and advance"),
    "minus not counted": (build_toy8(advance=answers.advance_counting_plus_only), "traced", "and the axes' net go by"),
    "inputs of all axes": (
        build_toy8(set_input=answers.set_input_of_all_axes), "pins_by_name", "inputs of another axis"),
    "a peek that changes the state": (
        build_toy8(peek=answers.peek_delaying_the_last_axis), "reads", r"after peek\(10h\), the state differs in ax"),
    "no end in a waveform of edges": (
        build_toy8(scan_edges=answers.scan_omitting_ends_of_moves), "journals", "output runs at another"),
    "a switch that stops nothing": (
        build_toy(set_input=answers.set_input_without_stopping), "limit_switches",
        "goes on to its end, though el_(plus|minus) is asserted"),
    "switches exchanged": (
        type("TOY", (TOY,), {"WIRING": {"el_plus": "el_minus", "el_minus": "el_plus"}}),
        "limit_switches", "goes on to its end, though el_plus is asserted"),
    "the direction exchanged": (
        ReversedDirection, "limit_switches", "axis 0 goes (plus|minus), and `find_selected_direction` says (plus|minus)"),
    "a stop for all": (
        build_toy8(write=answers.write_stopping_all_axes), "axes_alone",
        "the driver's stop of axis . changes the pulses"),
    "a driver that never stops": (Unstoppable, "actions", "is_moving is True after a stop"),
    "an axis at rest for ever": (
        type("TOY", (TOY,), {"DRIVER": "toy.defects:StillDriver"}), "actions", "is_moving is False while its move is under way"),
    "values of one axis": (
        FirstAxisValuesOnly, "axes_alone", "RATE = 1 written to axis 0 changes what axis_values gives for another axis"),
    "a trace that loses": (
        build_toy8(trace_pulses=answers.trace_one_pulse_per_clock), "traced", "says .* pulses, and trace lists"),
    "a scan beyond its array": (
        build_toy(scan_edges=answers.scan_beyond_the_array), "journals", "writes behind `out`, which holds 8"),
    "a command that cannot be sent": (
        UnknownCommand, "command_cycles", r"command_cycles\('.*'\), a command, raises KeyError"),
    "an attribute outside the record": (
        UnsavedLatch, "snapshots", "change its attribute 'latch' to .*: a snapshot does not have it"),
    "an interrupt at no pin": (
        type("TOY", (TOY,), {"IRQ": (0, 64)}), "has_what_every_chip_has", r"IRQ is \(0, 0x40\): .* bits of OUTPUTS"),
    "an answer missing": (build_toy(compute_drive_input=None), "has_what_every_chip_has", "has no answer compute_drive_input"),
}  # fmt: skip
"""Defect -> (the class, the promise that it breaks, a regular expression of the message)."""
