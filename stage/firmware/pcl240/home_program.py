"""Origin return of the PCL-240 family as a program of four runs without branches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.chips.pcl240.state import COUNTER_MASK, S_OPERATING, S_ORG, S_ZERO
from stage.errors import ArgumentError, add_article
from stage.firmware.home_program import HomeProgram, HomeResults
from stage.firmware.parameter_ranges import ParameterRanges, get_register_range
from stage.firmware.pcl240 import chip_port
from stage.sim.program import Program

if TYPE_CHECKING:
    from stage.firmware.pcl240.driver import Pcl240Driver

RUN_NAMES = ("leave", "search", "back off", "approach")


class FourRunHomeProgram(HomeProgram):
    """Origin return in four runs: leave, search, back off, approach.

    The program reads the chip's status during the runs, but makes no decision by it.
    """

    def __init__(self, driver: Pcl240Driver, settings: Any):
        self.driver, self.settings = driver, settings
        chip, ez = driver.chip, settings.ez
        if ez and not chip.EXTENDED:
            raise ArgumentError(
                f"ez={ez!r}: {add_article(chip.MAP.chip)} does not count EZ: a PCL240MK or PCL240MS does."
            )
        chip.MAP.check_value("R7", settings.multiplier)
        rates = {name: get_register_range(chip.MAP, name) for name in ("R1", "R2", "R4")}
        travel = {"leave": (0, settings.leave), "back_off": (1, settings.back_off), "sd": (0, 1)}
        self.choices = ParameterRanges(
            {**rates, "approach": get_register_range(chip.MAP, "R1"), **travel}, cubed=("leave",)
        )
        self.result_indices = {}
        self.write_program(self.choices.low)

    def find_nearest_row(
        self, fl: float, fh: float, ramp: float, approach: float, leave: int, back_off: int
    ) -> list[int]:
        unit = self.driver.chip.clock_hz / (8192 * self.settings.multiplier)  # pps
        rate = self.driver.chip.clock_hz * ramp * unit / max(fh - fl, unit)
        rates = {"R1": fl / unit, "R2": fh / unit, "R4": rate, "approach": approach / unit}
        return self._round_to_ranges({**rates, "leave": leave, "back_off": back_off, "sd": 0})

    def write_program(self, row: Sequence[int] | np.ndarray) -> Program:
        c, a, chip = self.settings, self.driver.index, self.driver.chip
        fl, fh, rate, approach, leave, back_off, sd = np.asarray(row).tolist()
        p = Program().command(a, chip_port.RESET)
        logic = chip_port.compute_polarity_bits(self.driver.axis)
        values = {"R1": fl, "R2": fh, "R4": rate, "R5": rate, "R7": c.multiplier, **logic}
        if chip.S_CURVES:
            values["R14"] = chip.LINEAR_RAMPS
        for name, value in values.items():
            p.register(a, chip, name, value)
        p.command(a, chip_port.OUTPUT)
        ramp_down = max(fh * fh - fl * fl, 0) * rate // (16384 * c.multiplier) + 5
        p.register(a, chip, "R6", min(leave // 2 + 2, ramp_down))
        self._add_run(
            p, "leave", chip_port.PRESET, chip_port.RAMP_START_COMMANDS["FH1"], leave, rest_s=c.settle if leave else 0.0
        )
        control = chip_port.ORIGIN | chip_port.MINUS | (chip_port.SD if sd else 0)
        self._add_run(p, "search", control, chip_port.RAMP_START_COMMANDS["FH1"], 0, c.settle)
        self._add_run(p, "back off", chip_port.PRESET, chip_port.START["FL"], back_off, c.settle)
        p.register(a, chip, "R1", approach)
        if c.ez:
            p.register(a, chip, "R13", logic.get("R13", 0) | chip_port.encode_index_pulse_number(c.ez))
        self._add_run(p, "approach", chip_port.ORIGIN | chip_port.MINUS, chip_port.START["FL"], 0, c.settle)
        if c.ez and not chip_port.has_ez_monitor(
            chip
        ):  # a start at speed step 1, taken back at once, is accepted: no end limit
            p.register(a, chip, "R1", 1).command(a, chip_port.CONTROL | chip_port.MINUS).command(
                a, chip_port.START["FL"]
            )
            self._store_result_index("index", p).read(a, 0).command(a, chip_port.RESET).register(
                a, chip, "R1", approach
            )
        elif c.ez:  # the index pulse, as R17 shows it: bit 20, in the high byte
            p.command(a, chip_port.OUTPUT | chip_port.EXTENSION)
            p.command(a, chip_port.SELECT | chip_port.COLLECTIVE | chip.MAP.register("R17").number)
            self._store_result_index("index", p).read(a, 3).command(a, chip_port.OUTPUT)
        return p

    def _add_run(self, program: Program, name: str, control: int, start: int, r0: int, rest_s: float) -> None:
        """Add one run: control mode, R0, start command, wait for the end, wait of `rest_s` seconds, and reads of status and R0."""
        a = self.driver.index
        program.register(a, self.driver.chip, "R0", r0).command(a, chip_port.CONTROL | control).command(a, start)
        self._store_result_index(f"{name} time", program).until_stopped([a], self.settings.limit).command(
            a, chip_port.RESET
        ).wait(rest_s)
        for address in (0, 3, 2, 1):
            self._store_result_index(f"{name} {address}", program).read(a, address)

    def decode_results(self, results: np.ndarray, rows: np.ndarray) -> HomeResults:
        marked = {name: results[:, at] for name, at in self.result_indices.items()}
        status = {name: marked[f"{name} 0"] for name in RUN_NAMES}
        counted = {
            name: -(marked[f"{name} 3"] << 16 | marked[f"{name} 2"] << 8 | marked[f"{name} 1"]) & COUNTER_MASK
            for name in ("search", "approach")
        }
        timed_out = np.any([marked[f"{name} time"] < 0 for name in RUN_NAMES], axis=0)
        on_org = {name: s & S_ORG != 0 for name, s in status.items()}
        arrived = on_org["approach"]
        if self.settings.ez:
            at_index = chip_port.EZ_SIGNAL >> 16 if chip_port.has_ez_monitor(self.driver.chip) else S_OPERATING
            arrived = marked["index"] & at_index != 0
        released = ~on_org["back off"]
        short = (status["leave"] & S_ZERO == 0) | (status["back off"] & S_ZERO == 0)
        end_limit = ~timed_out & (short | ~on_org["search"] | (released & ~arrived))
        overrun = counted["approach"] - rows[:, list(self.choices.ranges).index("back_off")]
        return HomeResults(timed_out, ~timed_out & released & arrived, end_limit, released, counted["search"], overrun)
