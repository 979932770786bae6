"""Layout of a lane's records in GPU memory, and the tables that all copies of a stage share.

The words of a record of one lane are not side by side: word k of lane 0, 1, 2 ... are, as the threads of a warp read memory best. A
lane copies its words to memory of its own, works on them as records, and copies them back.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stage.drives.stepper import DRIVE
from stage.native import record
from stage.sim import engine_records
from stage.sim.stage import Stage

THREADS_PER_WARP = 32
PLAYING = -1
"""`status` of a PROGRAM_STATE whose program goes on; otherwise how it ended, see `stage.sim.program_player`."""
PROGRAM_STATE = record(
    [(name, "i8") for name in "op started until begin left poll status stepped frozen".split()]
    + [(name, "f8") for name in "x0 y0 z0 x1 y1 z1".split()]
)
"""State of the host that plays a program: the operation in progress, and whether it has begun; the time at which it continues (ns);
of an AWAIT_STOP or AWAIT_STOP_OR_LOST_STEP the time of its begin (ns), the axes in motion and the next of them to poll; how the
program ended; 1 where physics has moved the copy since; 1 where the program is over and the copy's coordinates are frozen; the
smallest box that contains the path of a measured point (m)."""
LANE_ROW = record([("axes", "i8"), ("hz", "i8"), ("ticks", "f8")])
"""Constants of a lane's chip: number of axes in use, clock in Hz, clocks in a slice."""
AXIS_INDICES = record([(name, "i8") for name in "lane axis qpos dof".split()])
"""Position of an axis of the stage: its lane, its number in the lane, its indices in qpos and qvel."""


class LaneLayout:
    """Layout in GPU memory of the lanes of all copies of one stage. A lane is one chip of one copy with its axes.

    Attributes:
        lanes: Number of lanes of a copy, its chips.
        axes: Largest number of axes of a lane.
        switches: Largest number of switches of a lane.
        words: Number of 8-byte words of a lane.
        rows, axis_numbers, places, tables, switch_tables: Arguments of the kernel, see `lane_kernel.advance_lanes`.
    """

    def __init__(self, stage: Stage):
        state = self._state = stage.state
        self.lanes = len(state.chip_table)
        self._axes = [
            [int(own.axis) for own in state.chip_axes[i][: state.chip_table[i].axes]] for i in range(self.lanes)
        ]
        spans = [[(int(t.first_switch), int(t.end_switch)) for t in state.axis_table[own]] for own in self._axes]
        self._switches = [[k for first, end in span for k in range(first, end)] for span in spans]
        self.axes = max(map(len, self._axes))
        self.switches = max(1, *map(len, self._switches))
        self._parts = (
            ("chip", stage.chips[0].CORE.STATE, 1), ("axes", engine_records.AXIS, self.axes), ("drives", DRIVE, self.axes),
            ("switches", engine_records.SWITCH, self.switches), ("world", engine_records.STAGE_TIME, 1), ("host", PROGRAM_STATE, 1),
        )  # fmt: skip
        self.words = sum(dtype.itemsize // 8 * n for _, dtype, n in self._parts)
        self._set_tables(spans)

    def _set_tables(self, spans: list[list[tuple[int, int]]]) -> None:
        """Set the tables that the lanes of all copies share."""
        state = self._state
        self.rows = np.zeros(self.lanes, LANE_ROW)
        self.axis_numbers = np.zeros((self.lanes, self.axes), np.int64)
        self.places = np.zeros(len(state.axis_table), AXIS_INDICES)
        self.tables = np.zeros((self.lanes, self.axes), engine_records.AXIS_ROW)
        self.switch_tables = np.zeros((self.lanes, self.switches), engine_records.SWITCH_ROW)
        for i, (own, span) in enumerate(zip(self._axes, spans, strict=True)):
            chip = state.chip_table[i]
            self.rows[i] = chip.axes, chip.hz, chip.ticks
            self.axis_numbers[i, : len(own)] = own
            self.switch_tables[i, : len(self._switches[i])] = state.switch_table[self._switches[i]]
            switch = 0
            for j, (axis, (first, end)) in enumerate(zip(own, span, strict=True)):
                table = self.tables[i, j : j + 1]
                table[:] = state.axis_table[axis]
                table["first_switch"], table["end_switch"] = switch, switch + end - first
                switch += end - first
                self.places[axis] = i, j, table["qpos"][0], table["dof"][0]

    def count_threads(self, copies: int) -> int:
        """Count the threads that a number of copies needs. The lanes of a copy are always in one warp."""
        return -(-copies // (THREADS_PER_WARP // self.lanes)) * THREADS_PER_WARP

    def _number_threads(self, copies: int) -> np.ndarray:
        """Return the thread of each lane, (copies, lanes)."""
        in_warp = THREADS_PER_WARP // self.lanes
        k = np.arange(copies)
        first = k // in_warp * THREADS_PER_WARP + k % in_warp * self.lanes
        return first[:, None] + np.arange(self.lanes)

    def pack(self, copies: int) -> np.ndarray:
        """Return the words of all lanes, (words, threads) int64, with each copy in the present state of the stage."""
        out = np.zeros((self.words, self.count_threads(copies)), np.int64)
        out[:, self._number_threads(copies)] = np.stack([self._pack_lane(i) for i in range(self.lanes)], axis=1)[
            :, None
        ]
        return out

    def _pack_lane(self, lane_index: int) -> np.ndarray:
        """Return the words of one lane in the present state of the stage."""
        state, pieces, axes = self._state, [], self._axes[lane_index]
        host = np.zeros(1, PROGRAM_STATE)
        host["status"] = engine_records.REACHED
        present = {
            "chip": state.chips[lane_index], "axes": state.axes[axes], "drives": state.drives[axes],
            "switches": state.switches[self._switches[lane_index]], "world": state.world, "host": host,
        }  # fmt: skip
        for name, dtype, n in self._parts:
            rows = np.zeros(n, dtype)
            rows[: len(present[name])] = present[name]
            pieces.append(rows.view(np.int64))
        return np.concatenate(pieces)

    def unpack(self, words: np.ndarray, copies: int) -> dict[str, np.ndarray]:
        """Convert the words of all lanes to records by name.

        Args:
            words: Words of all lanes, (words, threads) int64.
            copies: Number of copies.

        Returns:
            Arrays of records: "chip" (copies, lanes), "world" and "host" (copies,), and further names of `stage_state.State`.
        """
        lane_words = words[:, self._number_threads(copies)]
        records_by_name: dict[str, np.ndarray] = {}
        at = 0
        for name, dtype, n in self._parts:
            size = dtype.itemsize // 8 * n
            records_by_name[name] = np.ascontiguousarray(np.moveaxis(lane_words[at : at + size], 0, -1)).view(dtype)
            at += size
        for name, rows in (("axes", self._axes), ("drives", self._axes), ("switches", self._switches)):
            all_of_them = np.zeros((copies, sum(map(len, rows))), records_by_name[name].dtype)
            for i, own in enumerate(rows):
                all_of_them[:, own] = records_by_name[name][:, i, : len(own)]
            records_by_name[name] = all_of_them
        return {
            **records_by_name,
            "chip": records_by_name["chip"][:, :, 0],
            "world": records_by_name["world"][:, 0, 0],
            "host": records_by_name["host"][:, 0, 0],
        }

    def find_host_words(self) -> tuple[int, Any]:
        """Return the row at which the words of a PROGRAM_STATE record begin, and these words at the start of a program."""
        host = np.zeros(1, PROGRAM_STATE)
        host["status"] = PLAYING
        words = host.view(np.int64)
        return self.words - len(words), words
