"""A STEP/DIR axis: the lines of a power stage, driven by firmware that makes its own steps.

    axis = STEPDIR()
    axis.dir = False
    axis.step = True                  a rising edge: one step plus
    axis.advance(2_000)               2 us of a clock of 1 GHz
    axis.step = False

A host without firmware writes the registers of a step timer, which then drives the lines: see maps.py.
"""

from __future__ import annotations

from operator import index
from typing import Any, ClassVar

from stage.chips.chip import Chip
from stage.chips.stepdir import core
from stage.chips.stepdir.cycle_descriptions import CycleDescriber, Decoder
from stage.chips.stepdir.line_names import DRIVEN_LINE_PINS, READ_LINE_PINS, Line
from stage.chips.stepdir.lint import TIMES as TIME_RULES
from stage.chips.stepdir.lint import describe_violation, lint_write
from stage.chips.stepdir.maps import ADDRESS_MASK, CONTROL_ADDRESS, DATA_MASK, MAP
from stage.chips.stepdir.state import EDGE_TIME_COUNT, ENABLE
from stage.chips.stepdir.step_timer import GO, MINUS
from stage.chips.write_diagnostics import Diagnostic
from stage.errors import find_similar_names
from stage.support.argument_checks import explain_arguments

__all__ = ["STEPDIR"]


class STEPDIR(Chip):
    """STEP, DIR and ENABLE of one axis' power stage, the axis' switches, and a step timer for hosts without firmware.

    All pins are True when asserted; polarity belongs to the wires. ENABLE is asserted from power-up on, as most power stages are
    enabled while nothing is connected to this pin. Edges are exact to a clock of 1 ns.
    """

    MAP: ClassVar = MAP
    CORE: ClassVar = core
    INPUTS: ClassVar = core.INPUTS
    OUTPUTS: ClassVar = core.OUTPUTS
    PHASES: ClassVar = {"up": "up", "down": "down", "busy": "keep"}
    DEFAULT_CLOCK_HZ: ClassVar = 1_000_000_000
    MAX_CLOCK_HZ: ClassVar = 1_000_000_000
    CLOCK_RANGE: ClassVar = (1, 1_000_000_000)
    ADDRESSES: ClassVar = ADDRESS_MASK + 1
    ADDRESS_MASK: ClassVar = ADDRESS_MASK
    DATA_MASK: ClassVar = DATA_MASK
    BUSY: ClassVar = (CONTROL_ADDRESS, MAP.mask("status", "busy"))
    COUNTER: ClassVar = ("POSITION", 32)
    DRIVER: ClassVar = "stage.firmware.stepdir.driver:StepDirDriver"

    power_stage = "power stage"
    """Name of the power stage that demands the times between edges, for diagnostics."""

    step, dir, enable = Line("step"), Line("dir"), Line("enable")
    limit, limit_plus, limit_minus = Line("limit"), Line("limit_plus"), Line("limit_minus")
    origin, probe = Line("origin"), Line("probe")

    def _configure(self, record: Any) -> None:
        record["hz"], record["inputs"], record["counts_disabled"] = self.clock_hz, ENABLE, 1

    @property
    def diagnostics(self) -> list[Diagnostic]:
        """Messages about writes that break a rule, and about times between edges that were too short for the power stage.

        Times of one kind, such as the width of STEP pulses, have one message.
        """
        diagnostics = super().diagnostics
        c = self.state
        for which in range(EDGE_TIME_COUNT):
            if c["violations"][which]:
                observed_s, required_s = (int(c[name][which]) / self.clock_hz for name in ("shortest", "required"))
                finding = describe_violation(which, observed_s, required_s, self.power_stage, bool(c["drops_edges"]))
                self.diagnose(int(c["first_violation"][which]), 0, 0, [finding])
        return diagnostics

    def count_edges_of(self, diagnostic: Diagnostic) -> int:
        keys = [TIME_RULES[which][0].key for which in range(EDGE_TIME_COUNT)]
        return int(self.state["violations"][keys.index(diagnostic.key)]) if diagnostic.key in keys else 0

    @classmethod
    @explain_arguments
    def register_cycles(cls, name: str, value: int, axis: int = 0) -> list[tuple[int, int]]:
        cls._check_axis(axis)
        return [(cls.MAP.register(name).number, index(value))]

    @classmethod
    @explain_arguments
    def command_cycles(cls, symbol: str, axis: int = 0, datum: int | None = None) -> list[tuple[int, int]]:
        cls._check_axis(axis)
        what, datum = cls.MAP.find_command_or_word(symbol, datum)
        return [(CONTROL_ADDRESS, getattr(what, "code", datum))]

    @classmethod
    def find_selected_direction(cls, address: int, value: int) -> bool | None:
        return bool(value & MINUS) if address == CONTROL_ADDRESS and value & GO else None

    def fit_drive(self, drive: Any, axis: int = 0) -> None:
        """Store the amplitude of the phase currents and the minimum times between edges of the axis' power stage."""
        self._check_axis(axis)
        power_stage, c = drive.power_stage, self._record
        c["amplitude"], c["drops_edges"] = drive.amplitude, drive.drops_edges
        c["counts_disabled"] = power_stage.counts_disabled
        c["required"] = [round(seconds * self.clock_hz) for seconds in power_stage.times]
        self.power_stage = power_stage.title

    def list_configured_outputs(self) -> tuple[str, ...]:
        """Return the names of the outputs that a host has set up, so that it has to read them to find what they show."""
        return ()

    def explain_output_mistake(self, name: str) -> str:
        """Return why an output that a host reads cannot show what it is read for, as a clause; "" if it can, or nobody knows."""
        return ""

    def _explain_unknown_attribute(self, name: str) -> str:
        lines = ", ".join(DRIVEN_LINE_PINS)
        similar = find_similar_names(name, DRIVEN_LINE_PINS | READ_LINE_PINS)
        hint = f" Did you mean {similar[0]}?" if similar else ""
        return (
            f"The STEPDIR has no attribute {name!r}.{hint} Lines that a host drives: {lines}; that it reads: "
            f"{', '.join(READ_LINE_PINS)}."
        )

    def explain_missing_current(self, axis: int = 0) -> str:
        self._check_axis(axis)
        return "" if self.pins.enable else "ENABLE is not asserted"

    def lint(self, address: int, value: int) -> Any:
        return lint_write(self._record, address, value)

    def decoder(self, axis: int = 0) -> Decoder:
        self._check_axis(axis)
        return Decoder()

    def make_describer(self) -> CycleDescriber:
        return CycleDescriber()

    def values(self) -> dict[str, int]:
        return {r.name: r.value(core.peek.with_gil(self.pointer, r.number)) for r in self.MAP.registers}
