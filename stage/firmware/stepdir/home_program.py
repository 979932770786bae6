"""The origin return of a STEP/DIR axis as a program: leave ORG, run to it, back off, approach it slowly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.chips.stepdir.maps import CONTROL_ADDRESS, MAP
from stage.chips.stepdir.step_timer import AT_ONCE
from stage.errors import ArgumentError
from stage.firmware.home_program import HomeProgram, HomeResults
from stage.firmware.parameter_ranges import ParameterRanges, get_register_range
from stage.sim.program import Program

if TYPE_CHECKING:
    from stage.firmware.stepdir.driver import StepDirDriver

ORG, END_LIMITS = MAP.mask("status", "org"), sum(MAP.masks("status", "plus_limit", "minus_limit"))
POSITION = MAP.register("POSITION")
PHASE_NAMES = ("leave", "search", "back_off", "approach")


class OrgHomeProgram(HomeProgram):
    """Origin return by four moves of the step timer, towards minus."""

    def __init__(self, driver: StepDirDriver, settings: Any):
        if settings.ez:
            raise ArgumentError(f"ez={settings.ez!r}: a STEP/DIR axis has no input for an encoder's index pulse.")
        self.driver, self.settings, self.result_indices = driver, settings, {}
        ranges = {name: get_register_range(MAP, name) for name in ("START", "RATE", "UP", "DOWN")}
        travel = {"leave": (1, max(1, settings.leave)), "back_off": (1, max(1, settings.back_off))}
        self.choices = ParameterRanges(
            {**ranges, "approach": get_register_range(MAP, "RATE"), **travel}, cubed=("leave",)
        )
        self.write_program(self.choices.low)

    def find_nearest_row(
        self, fl: float, fh: float, ramp: float, approach: float, leave: int, back_off: int
    ) -> list[int]:
        registers = self.driver.compute_move_registers(fl, fh, ramp, ramp, leave)
        return self._round_to_ranges({**registers, "approach": approach, "leave": leave, "back_off": back_off})

    def write_program(self, row: Sequence[int] | np.ndarray) -> Program:
        values = self.choices.to_dict(row)
        program = Program()
        for name in ("START", "RATE", "UP", "DOWN"):
            self._add_register_write(program, name, values[name])
        self._add_move(program, "leave", "MOVE+", values["leave"])
        self._add_move(program, "search", "HOME-", 0)
        self._add_move(program, "back_off", "MOVE+", values["back_off"])
        self._add_register_write(program, "START", values["approach"])
        self._add_register_write(program, "RATE", values["approach"])
        self._add_move(program, "approach", "HOME-", 0)
        return program

    def _add_register_write(self, program: Program, name: str, value: int) -> None:
        """Add the write of a register by name."""
        program.register(self.driver.index, self.driver.chip, name, value)

    def _add_move(self, program: Program, phase: str, command: str, steps: int) -> None:
        """Add one move, a wait for its end, and reads of the status and the position."""
        index = self.driver.index
        self._add_register_write(program, "STEPS", steps)
        program.command(index, MAP.command(command).code)
        self._store_result_index(f"{phase} time", program).until_stopped([index], self.settings.limit)
        program.command(index, AT_ONCE).wait(self.settings.settle)
        self._store_result_index(f"{phase} status", program).read(index, CONTROL_ADDRESS)
        self._store_result_index(f"{phase} position", program).read(index, POSITION.number)

    def decode_results(self, results: np.ndarray, rows: np.ndarray) -> HomeResults:
        columns = {name: results[:, at] for name, at in self.result_indices.items()}
        timed_out = np.any([columns[f"{phase} time"] < 0 for phase in PHASE_NAMES], axis=0)
        at_origin = {phase: columns[f"{phase} status"] & ORG != 0 for phase in PHASE_NAMES}
        at_limit = np.any([columns[f"{phase} status"] & END_LIMITS != 0 for phase in PHASE_NAMES], axis=0)
        released = ~at_origin["back_off"]
        searched = _wrap_to_signed(columns["leave position"] - columns["search position"])
        home = ~timed_out & ~at_limit & released & at_origin["approach"]
        return HomeResults(timed_out, home, ~timed_out & at_limit, released, searched, np.zeros(len(rows), np.int64))


def _wrap_to_signed(difference: np.ndarray) -> np.ndarray:
    """Return differences of 32-bit positions as signed numbers."""
    return (difference + (1 << 31)) % (1 << 32) - (1 << 31)
