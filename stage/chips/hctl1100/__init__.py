"""Agilent HCTL-1100 (HCTL-1000 and HCTL-1101 work alike): a closed-loop DC servo axis on one chip.

    chip = HCTL1100()
    chip.write(0x05, 0x03)            Init/Idle -> position control
    chip.set_shaft(0, rate=0.01)            the shaft turns, in counts of the encoder a clock
    chip.advance(1040)                one sample

The motor is then driven by `chip.motor_command`.
"""

from __future__ import annotations

from collections.abc import Iterator
from operator import index
from typing import ClassVar

import numpy as np

from stage.chips.chip import Chip
from stage.chips.hctl1100 import core
from stage.chips.hctl1100.cycle_descriptions import CycleDescriber, Decoder
from stage.chips.hctl1100.lint import lint_write
from stage.chips.hctl1100.maps import ACTUAL_LOW, ADDRESS_COUNT, MAP, NUMBERS, STATUS
from stage.chips.write_diagnostics import Finding
from stage.support.argument_checks import explain_arguments

__all__ = ["HCTL1100"]

INIT, PROFILE = MAP.masks("R07", "init", "profile")


class HCTL1100(Chip):
    """Agilent HCTL-1100: digital filter, profile generator and commutator for one axis.

    The bus addresses are the numbers of the registers, 0 to 63; the chip ignores higher address bits. The chip makes no pulses:
    `trace` returns an empty array, and `net` returns the encoder count that corresponds to the command position. The input pins are
    low when asserted, the output pins high.
    """

    MAP: ClassVar = MAP
    CORE: ClassVar = core
    INPUTS: ClassVar = core.INPUTS
    OUTPUTS: ClassVar = core.OUTPUTS
    WIRING: ClassVar = {"el_plus": "limit", "el_minus": "limit", "org": "stop", "ez": "index"}
    WIRES: ClassVar = {name: (f"{name.upper()}_n", 0) for name in core.INPUTS}
    PHASES: ClassVar = {"init": "idle", "prof": "profile"}
    SERVO: ClassVar = True
    IN_POSITION: ClassVar = 10.0  # counts: a filter without an integral holds a weight by an error
    READING_ACTS: ClassVar = frozenset({ACTUAL_LOW})
    DEFAULT_CLOCK_HZ: ClassVar = 2_000_000
    CLOCK_RANGE: ClassVar = (100_000, 2_000_000)
    CLOCK_SOURCE: ClassVar = "AC characteristics"
    ADDRESSES: ClassVar = ADDRESS_COUNT
    BUSY: ClassVar = (STATUS, PROFILE)
    COUNTER: ClassVar = ("R14", 24)
    DRIVER: ClassVar = "stage.firmware.hctl1100.driver:Hctl1100Driver"
    TRACED: ClassVar = {"R0E": ("command", 24), "MC": ("motor", 8)}
    ADDRESS_MASK: ClassVar = ADDRESSES - 1

    @classmethod
    @explain_arguments
    def register_cycles(cls, name: str, value: int, axis: int = 0) -> list[tuple[int, int]]:
        """Return the write cycles to the addresses of a register or number.

        A number of several bytes has a name in `maps.NUMBERS`, which also defines the order of its bytes.

        Args:
            name: Name of the register or number.
            value: Its value.
            axis: 0.
        """
        cls._check_axis(axis)
        if isinstance(name, str) and name in NUMBERS:
            addresses = NUMBERS[name].addresses
            return [(a, value >> 8 * (len(addresses) - 1 - k) & 0xFF) for k, a in enumerate(addresses)]
        return [(cls.MAP.register(name).number, index(value))]

    @classmethod
    def compute_rates(cls, edges: np.ndarray) -> np.ndarray:
        """Compute the rates of the profile generator; if a host writes command positions, the mean rates between two of them.

        Args:
            edges: EDGE records of the core.
        """
        rates = np.abs(edges["rate"])
        moved = np.flatnonzero(np.diff(edges["net"]))
        if rates.any() or len(moved) < 2:
            return rates
        steps, clocks = np.abs(np.diff(edges["net"]))[moved], edges["clock"][moved + 1]
        rates[moved[0] + 1 : moved[-1] + 1] = np.repeat(steps[1:] / np.maximum(np.diff(clocks), 1), np.diff(moved))
        return rates

    @property
    def motor_command(self) -> int:
        """Motor command, -128 to 127, last set by the control law or by a write to R08 or R09."""
        return int(self.state["motor_command"])

    @property
    def encoder(self) -> int:
        """Raw count of the encoder. An assignment puts the shaft at this count, at rest."""
        return core.read_encoder.with_gil(self.pointer)

    @encoder.setter
    def encoder(self, count: int) -> None:
        """Raw count of the encoder. An assignment puts the shaft at this count, at rest."""
        lost = core.compute_missed_counts.with_gil(self.pointer)
        self.set_shaft(count + lost + 0.5 if lost else count)  # between two counts, where rounding does not matter

    @property
    def missed_counts(self) -> float:
        """Net number of encoder counts that the input filter has dropped: position of the shaft minus `encoder`.

        The filter drops counts that come faster than one in three clocks.
        """
        return core.compute_missed_counts.with_gil(self.pointer)

    @property
    def shaft(self) -> tuple[float, float]:
        """Position (counts) and rate (counts per clock) of the shaft in the last call of `set_shaft`."""
        return float(self.state["shaft_count"]), float(self.state["shaft_rate"])

    def get_shaft(self, axis: int) -> tuple[float, float]:
        self._check_axis(axis)
        return self.shaft

    @property
    def command_position(self) -> int:
        """Command position R0C to R0E, sign extended, in counts of the actual position."""
        return int(self.state["command"])

    def busy(self, axis: int = 0) -> bool:
        """Read by one bus cycle whether a trapezoid is in progress.

        If LIMIT ends a trapezoid, the flag of the trapezoid stays set in Init/Idle.
        """
        self._check_axis(axis)
        return self.read(STATUS) & (INIT | PROFILE) == PROFILE

    def net(self, axis: int = 0) -> int:
        """Return the command position as a raw count of the encoder, which `encoder` equals when the shaft has arrived."""
        self._check_axis(axis)
        return core.read_net_count.with_gil(self.pointer, 0)

    def values(self) -> dict[str, int]:
        return {r.name: core.read_register_value.with_gil(self.pointer, r.number) for r in self.MAP.registers}

    def decoder(self, axis: int = 0) -> Decoder:
        self._check_axis(axis)
        return Decoder(self.MAP)

    def make_describer(self) -> CycleDescriber:
        return CycleDescriber(self.MAP, self.state)

    def lint(self, address: int, value: int) -> Iterator[Finding]:
        return lint_write(self._record, lambda: self.encoder, address, value)
