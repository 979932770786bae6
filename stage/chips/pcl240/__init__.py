"""Nippon Pulse PCL-240K, PCL-240MK, PCL-240MS: one family, one core; variants differ by their register maps and two flags."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np

from stage.chips.chip import Chip
from stage.chips.pcl240 import core, state
from stage.chips.pcl240.cycle_descriptions import CycleDescriber, Decoder
from stage.chips.pcl240.lint import EffectPredictors, lint_command, lint_data
from stage.chips.pcl240.maps import (
    CONTROL,
    OPERATING_MODE,
    PCL240K_MAP,
    PCL240MK_MAP,
    PCL240MS_MAP,
    PHASES,
    SELECT,
    STATUS,
    WIRES,
)
from stage.chips.write_diagnostics import Finding
from stage.errors import ArgumentError, StageError
from stage.support.argument_checks import explain_arguments

__all__ = ["OPERATING_MODE", "STATUS", "PCL240", "PCL240K", "PCL240MK", "PCL240MS"]

MAX_MOVE_CLOCKS = 1 << 42
MAX_START_DELAY_CLOCKS = 1 << 26
"""A start waits no longer for its first pulse, even with a step of R4 = 65535 from speed 0 and 8192 R7 clocks at speed 1."""


class PCL240(Chip):
    """Base class of the PCL-240 family.

    A write to bus address 0 is a command, a read of it returns the status. Addresses 1, 2 and 3 are the bytes of the selected
    register, low to high; reads return R0, or in the extension mode of MK and MS the selected register.
    """

    CORE: ClassVar = core
    INPUTS: ClassVar = core.INPUTS
    OUTPUTS: ClassVar = core.OUTPUTS
    WIRES: ClassVar = WIRES
    PHASES: ClassVar = PHASES
    IRQ: ClassVar = (0, core.OUTPUTS["irq"])
    DRIVER: ClassVar = "stage.firmware.pcl240.driver:Pcl240Driver"
    DEFAULT_CLOCK_HZ: ClassVar = 4_915_200
    CLOCK_RANGE: ClassVar = (1, 8_064_516)
    CLOCK_SOURCE: ClassVar = "section 1-5, clock cycle of 124 ns or more"
    BUSY: ClassVar = (0, state.S_OPERATING)
    COUNTER: ClassVar = ("R0", 24)
    READING_ACTS: ClassVar = frozenset({3})  # latches the register in collective mode
    SYNCHRO: ClassVar = True
    EXTENDED: ClassVar[bool] = True
    S_CURVES: ClassVar[bool] = False
    LINEAR_RAMPS: ClassVar = state.LINEAR
    """Bit of R14."""

    _leader: PCL240 | None = None

    def _configure(self, record: Any) -> None:
        record["extended"], record["s_curves"] = self.EXTENDED, self.S_CURVES
        for k, r in enumerate(self.MAP.registers):
            record["writable_bits"][k] = r.writable
        record["offset_sign_bit"] = (self.MAP.register("R6").mask + 1) // 2

    @classmethod
    def find_syno_address(cls, rows: np.ndarray) -> int:
        """Return the address of R7 in the state. SYNO outputs the reference clock divided by 8192 R7."""
        at: int = rows["reg"][0, 7:8].ctypes.data
        return at

    @property
    def syni(self) -> PCL240 | None:
        """Leader: the chip whose output SYNO clocks this chip through its input SYNI. None: the chip uses its own clock.

        An assignment connects a chip that belongs to no stage, or raises ArgumentError or StageError; on a stage see
        `Stage(syni=...)`. Each write and each `advance` uses the leader's R7 at that time. Copies of the chip are not connected;
        they keep the last R7 of the leader.
        """
        return self._leader

    @syni.setter
    def syni(self, leader: PCL240 | None) -> None:
        """Leader: the chip whose output SYNO clocks this chip through its input SYNI. None: the chip uses its own clock.

        An assignment connects a chip that belongs to no stage, or raises ArgumentError or StageError; on a stage see
        `Stage(syni=...)`. Each write and each `advance` uses the leader's R7 at that time. Copies of the chip are not connected;
        they keep the last R7 of the leader.
        """
        if self.attached:
            raise StageError('a chip of a stage is connected where the stage is made: Stage(syni={"y": "x"}).')
        fits = isinstance(leader, PCL240) and leader is not self and leader.clock_hz == self.clock_hz
        if leader is not None and not fits:
            raise ArgumentError(
                f"syni={leader!r}: another chip of the PCL-240 family with a clock of {self.clock_hz:,} Hz, or None."
            )
        self._leader = leader
        self._update_syni()

    def _update_syni(self) -> None:
        """Copy the leader's present R7 to the input SYNI of this chip."""
        word = self.input_word(0) & state.ALL_INPUTS
        if self._leader is not None:
            word |= int(self._leader.state["reg"][7]) + 1 << state.SYNI_SHIFT
        if word != self.input_word(0):
            self.set_input_word(0, word)
            if self.open_journal is not None:
                self.open_journal.note_input(self.clock, 0, word)

    def _write(self, address: int, value: int, requested: tuple[int, int]) -> None:
        if self._leader is not None and not self.attached:
            self._update_syni()
        super()._write(address, value, requested)

    def _find_end_clock(self, clocks: int) -> int:
        until = super()._find_end_clock(clocks)
        if self._leader is not None:
            self._update_syni()
        return until

    @classmethod
    @explain_arguments
    def register_cycles(cls, name: str, value: int, axis: int = 0) -> list[tuple[int, int]]:
        """Return a select command and the bytes of the register, high to low.

        The silicon has no latch. In this order a value that is increased in motion is never below the old value between two
        writes (data sheet, section 4).

        Args:
            name: Name of the register.
            value: Its value.
            axis: 0.
        """
        cls._check_axis(axis)
        r = cls.MAP.register(name)
        bytes_ = [(1 + k, value >> 8 * k & 0xFF) for k in reversed(range((r.bits + 7) // 8))]
        return [(0, SELECT | r.number), *bytes_]

    @classmethod
    def is_driving(cls, edges: np.ndarray) -> np.ndarray:
        return (edges["outputs"] & cls.OUTPUTS["hold"]) == 0

    @classmethod
    def find_selected_direction(cls, address: int, value: int) -> bool | None:
        """Return the direction in a control mode command, True for minus; None for other writes."""
        return bool(value & state.MINUS) if address == 0 and value & state.GROUP == CONTROL else None

    def decoder(self, axis: int = 0) -> Decoder:
        self._check_axis(axis)
        return Decoder(self.MAP)

    def make_describer(self) -> CycleDescriber:
        return CycleDescriber(self.MAP, self.state)

    def values(self) -> dict[str, int]:
        return {
            r.name: core.read_register_value.with_gil(self.pointer, k) for k, r in enumerate(self.MAP.registers)
        } | {"status": core.read.with_gil(self.pointer, 0)}

    def lint(self, address: int, value: int) -> Iterator[Finding]:
        if address:
            return lint_data(self.MAP, self._record, address, value)
        predictions = EffectPredictors(self._makes_pulses, self._predict_last_speed, self.clock_hz)
        return lint_command(self.MAP, self._record, predictions, value)

    def _makes_pulses(self, command: int) -> bool:
        """Return whether a command leads to pulses, if neither a write nor a change of an input follows it."""
        rows = copy.deepcopy(self._rows[self._i : self._i + 1])
        core.write(rows, 0, command)
        return bool(core.advance(rows, self.clock + MAX_START_DELAY_CLOCKS) > 0)

    def _predict_last_speed(self, command: int) -> int | None:
        """Predict the speed, in speed steps, at the end of the run that a command begins; None if the run never ends by itself."""
        rows = copy.deepcopy(self._rows[self._i : self._i + 1])
        core.write(rows, 0, command)
        core.advance(rows, self.clock + MAX_MOVE_CLOCKS)
        return None if core.is_busy(rows, 0) else int(rows[0]["speed"])


class PCL240K(PCL240):
    """Nippon Pulse PCL-240K: R0 to R7, linear ramps, preset, continuous and origin-return runs."""

    MAP: ClassVar = PCL240K_MAP
    INPUTS: ClassVar = {name: bit for name, bit in core.INPUTS.items() if name != "ez"}
    READING_ACTS: ClassVar = frozenset()
    EXTENDED: ClassVar = False


class PCL240MK(PCL240):
    """Nippon Pulse PCL-240MK: a PCL-240K with the registers R10 to R17 and the functions that they control.

    These are read-back, collective transfers, a position counter, EZ counting and the automatic ramp-down point.
    """

    MAP: ClassVar = PCL240MK_MAP


class PCL240MS(PCL240):
    """Nippon Pulse PCL-240MS: a PCL-240MK with S-curve ramps, correction of FH and wider R4, R5, R6."""

    MAP: ClassVar = PCL240MS_MAP
    S_CURVES: ClassVar = True
