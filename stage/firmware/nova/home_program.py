"""Origin return of the NOVA chips as a program, which uses their automatic home search."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.errors import ArgumentError, add_article
from stage.firmware.home_program import HomeProgram, HomeResults
from stage.firmware.parameter_ranges import ParameterRanges, get_register_range
from stage.sim.program import Program

if TYPE_CHECKING:
    from stage.firmware.nova.driver import NovaDriver


class HomeSearchProgram(HomeProgram):
    """Origin return by a fixed-pulse drive out of ORG, and the chip's automatic home search.

    The search leaves ORG, turns at end limits and approaches by itself.
    """

    def __init__(self, driver: NovaDriver, settings: Any):
        self.driver, self.settings = driver, settings
        if settings.ez not in (0, 1):
            raise ArgumentError(
                f"ez={settings.ez!r}: {add_article(driver.map.chip)} ends at the first index pulse after ORG, or at ORG."
            )
        speeds = {name: get_register_range(driver.map, name) for name in (*driver.SPEEDS, "HV")}
        self.choices = ParameterRanges(
            {**speeds, "leave": (0, settings.leave), **driver.get_home_search_ranges()}, cubed=("leave",)
        )
        self.result_indices = {}
        self._bits: dict[str, tuple[int, bool]] = {}
        self.write_program(self.choices.low)

    def find_nearest_row(
        self, fl: float, fh: float, ramp: float, approach: float, leave: int, back_off: int
    ) -> list[int]:
        registers = self.driver.compute_move_registers(fl, fh, ramp, ramp, 1 << 20, s_curve=False)
        slow = self.driver.compute_move_registers(approach, fh, ramp, ramp, 1 << 20, s_curve=False)[
            self.driver.SPEEDS[0]
        ]
        return self._round_to_ranges({**registers, "HV": slow, "leave": leave, "step1": 1, "timer": 1})

    def write_program(self, row: Sequence[int] | np.ndarray) -> Program:
        c, driver = self.settings, self.driver
        values = self.choices.to_dict(row)
        p = driver.add_drive_modes(Program())
        for name in (*driver.SPEEDS, "HV"):
            driver.add_register_write(p, name, values[name])
        self._store_result_index("leave time", driver.add_drive(p, values["leave"])).until_stopped(
            [driver.index], c.limit
        )
        driver.add_command(p, driver.STOP).wait(c.settle if values["leave"] else 0.0)
        self._add_position_reads(p, "left")
        driver.add_end_status_clear(p)  # a limit that the leaving has met
        polls = driver.add_home_search(p, bool(values["step1"]), values.get("timer", 0), bool(c.ez), c.limit, c.settle)
        self.result_indices |= {f"home time {k}": at for k, at in enumerate(polls)}
        for name, (at, mask, high) in driver.add_input_level_reads(p).items():
            self.result_indices[name], self._bits[name] = at, (mask, high)
        self._add_position_reads(p, "ended")
        return p

    def _add_position_reads(self, program: Program, name: str) -> None:
        """Add the reads of both words of the logical position, and store their indices under `name`."""
        self.driver.add_command(program, "R-LP")
        for address in (6, 7):
            self._store_result_index(f"{name} {address}", program).read(self.driver.index, address)

    def decode_results(self, results: np.ndarray, rows: np.ndarray) -> HomeResults:
        marked = {name: results[:, at] for name, at in self.result_indices.items()}
        timed_out = np.any([marked[name] < 0 for name in marked if "time" in name], axis=0)
        left, end_position = (
            _join_signed_words(marked[f"{name} 6"], marked[f"{name} 7"]) for name in ("left", "ended")
        )
        flag = {name: (marked[name] & mask != 0) == high for name, (mask, high) in self._bits.items()}
        arrived = flag["stop2" if self.settings.ez else "stop1"]
        released = ~flag["error"]
        short = left != rows[:, list(self.choices.ranges).index("leave")]
        end_limit = ~timed_out & (short | ~arrived)
        return HomeResults(
            timed_out, ~timed_out & released & arrived, end_limit, released, left - end_position, np.zeros(len(results))
        )


def _join_signed_words(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Join two 16-bit words to a signed 32-bit number."""
    return (high << 16 | low) - (high >> 15 << 32)
