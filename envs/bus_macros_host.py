"""Host of `stage/BusMacros-v1`: the macros that are allowed now, what the host has written and read, and a scripted policy.

The host knows only what it has written and read. The values in this file follow from that knowledge alone; bus_macros.py draws
the episodes and judges the actions.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stage.envs import machine_contexts
from stage.envs.hidden_machine_task import MachineTask
from stage.envs.macro_programs import MACROS_WITHOUT_VALUES, RATES, MacroTable
from stage.envs.observation_features import HOST, Feature
from stage.native import record
from stage.sim.fleet import PlayedPrograms
from stage.support import portable_math

SWITCHES = ("org", "el_minus", "el_plus")
AXIS_STATE = record(
    [(name, "i8") for name in "rates distance running fresh known zero seen target lost limit".split()]
    + [("goal", "f8"), *((name, "?") for name in SWITCHES)]
)
"""State of an axis. Memory of the host: rates, distance (indices; -1: not written), running, fresh, known, zero and seen (pulses).
State of the judge: target (pulses), goal (m), lost (largest number of lost full steps), limit (whether an end limit is on)."""
EPISODE = record(
    [(name, "i8") for name in "level selected began before limits".split()]
    + [(name, "f8") for name in "potential usual start loan left".split()]
)
"""State of an episode: began, before (time at its beginning and at that of the step, ns); limits (end limits hit); potential (the
last one); usual (time of the formula, s); start (potential at the beginning); loan (paid so far, for a discount below 1);
left (costs that are left, charged already)."""


class MacroHostTask(MachineTask[Any]):
    """Base of tasks whose actions are macros: the memory of the host, its observations and its scripted policy.

    Attributes:
        axes: Axes of the first stage, m of them.
        switch_masks: Bits of SWITCHES in the inputs of each axis' chip.
        macro_table: Programs of all macros.
        axis_states: Memory of the host, AXIS_STATE records, (n, m).
        episodes: State of each episode, EPISODE records, (n,).
    """

    axes: list[Any]
    switch_masks: list[list[int]]
    macro_table: MacroTable
    axis_states: np.ndarray
    episodes: np.ndarray
    _valid: np.ndarray
    OBSERVATION = (
        Feature("known", HOST, "1 if the origin of the selected axis is known"),
        Feature("running", HOST, "1 if a move was started and not waited for"),
        Feature("fresh", HOST, "1 while the last values read are still valid"),
        Feature("rates", HOST, "rates that are written, one of 3"),
        Feature("distance", HOST, "distance that is written, one of the grid"),
        Feature("left", HOST, "distance to the target as last read / the longest; 0 while the origin is not known"),
        Feature("left_log", HOST, "the same by its logarithm, with its sign"),
        *(Feature(name, HOST, f"1 if {name} was asserted when last read") for name in SWITCHES),
        Feature("used", HOST, "1 if the axis takes part", "axis"),
        Feature("selected", HOST, "1 if macros act on the axis", "axis"),
        Feature("moves", HOST, "1 if a move was started and not waited for", "axis"),
        Feature("arrived", HOST, "1 if the origin is known and no distance is left, as last read", "axis"),
        Feature("level", HOST, "level / 3"),
        Feature("macros", HOST, "macros left / `macros`"),
        Feature("time", HOST, "time left / `time_limit`"),
        *machine_contexts.OBSERVATION_FEATURES,
    )

    def list_all_features(self) -> list[Feature]:
        of_axes = [e for e in self.OBSERVATION if e.each]
        at = self.OBSERVATION.index(of_axes[0])
        often = {"rates": len(RATES), "distance": len(self.config.grid)}
        one = [e for e in self.OBSERVATION[:at] for _ in range(often.get(e.name, 1))]
        return [*one, *of_axes * len(self.axes), *self.OBSERVATION[at + len(of_axes) :]]

    # --- macros ---

    @property
    def uses_axis(self) -> np.ndarray:
        """Mask of the axes that take part in each stage's episode, (stages, axes) bool."""
        return (np.arange(len(self.axes)) == 0) | (self.episodes["level"] >= 2)[:, None]

    def action_masks(self) -> np.ndarray:
        """Return which macros have an effect now, (stages, actions) int8."""
        s, c, e = self.selected_axis_state, self.config, self.episodes
        idle = s["running"] == 0
        able = idle & (s["rates"] >= 0) & (s["distance"] >= 0)
        columns = [
            *(idle & (s["rates"] != r) for r in range(len(RATES))), *(idle & (s["distance"] != d) for d in range(len(c.grid))),
            able, able, idle & (e["level"] == 3), ~idle, s["fresh"] == 0,
            *(self.uses_axis[:, a] & (e["selected"] != a) for a in range(len(self.axes))),
        ]  # fmt: skip
        return np.stack(columns, axis=1).astype(np.int8)

    @property
    def selected_axis_state(self) -> np.ndarray:
        """AXIS records of the selected axis of each stage, (n,): what the host remembers of it."""
        return self.axis_states[np.arange(self.n), self.episodes["selected"]]

    def make_programs(self) -> np.ndarray:
        to_registers, every = self.actions, np.arange(self.n)
        self._valid = self.action_masks()[every, to_registers] != 0
        return self.macro_table.select_programs(
            to_registers, self.episodes["selected"], self.selected_axis_state, self._valid & self.active
        )

    # --- what it remembers and sees ---

    def _update_memory(self, played: PlayedPrograms, truth: np.ndarray) -> None:
        """Update the host's memory after the macros that were played.

        Args:
            played: Results of the macros.
            truth: True state of the axes, (n, m).
        """
        done = self._valid & self.undiverged_stages
        for kind, mask in self.macro_table.is_kind.items():
            rows = np.flatnonzero(done & mask[self.actions])
            if not len(rows):
                continue
            axis = self.episodes["selected"][rows]
            if kind == "select":
                self.episodes["selected"][rows] = self.macro_table.value[self.actions[rows]]
                continue
            s = self.axis_states[rows, axis]
            if kind in ("rates", "distance"):
                s[kind] = self.macro_table.value[self.actions[rows]]
            elif kind in ("plus", "minus"):
                s["running"], s["fresh"] = 1, 0
            elif kind == "wait":
                s["running"], s["fresh"] = played.results[rows, 0] < 0, 0
            elif kind == "read":
                self._store_read_values(s, truth[rows, axis], axis)
            else:
                self._store_home_results(s, played.results[rows], truth[rows, axis], axis)
            self.axis_states[rows, axis] = s

    def _store_read_values(self, axis_states: np.ndarray, truth: np.ndarray, axis: np.ndarray) -> None:
        """Store what the macro `read` shows: the pulse counter and the switches.

        Args:
            axis_states: Memory to fill, AXIS_STATE records, (k,).
            truth: True state of the axes that were read, (k,).
            axis: Index of the axis, (k,).
        """
        axis_states["fresh"], axis_states["seen"] = 1, truth["pulses"]
        pins = np.array(self.switch_masks)[axis]
        for j, name in enumerate(SWITCHES):
            axis_states[name] = truth["inputs"] & pins[:, j] != 0

    def _store_home_results(
        self, axis_states: np.ndarray, results: np.ndarray, truth: np.ndarray, axis: np.ndarray
    ) -> None:
        """Store the results of origin returns. The position becomes the new zero, and the chip's registers count as unwritten.

        Args:
            axis_states: Memory to fill, AXIS_STATE records, (k,).
            results: Results of the programs, (k, operations).
            truth: True state of the axes, (k,).
            axis: Index of the axis, (k,).
        """
        for a in np.unique(axis):
            mask = axis == a
            axis_states["known"][mask] = self.macro_table.find_returns_at_origin(int(a), results[mask])
        axis_states["zero"], axis_states["rates"], axis_states["distance"] = truth["pulses"], -1, -1
        self._store_read_values(axis_states, truth, axis)

    def compute_observations(self) -> np.ndarray:
        c, s, e, every, used = self.config, self.axis_states, self.episodes, self.selected_axis_state, self.uses_axis
        distances_left = np.where(s["known"] != 0, s["target"] - (s["seen"] - s["zero"]), 0)
        left, farthest = distances_left[np.arange(self.n), e["selected"]], c.max_target_pulses
        log = (
            np.sign(left)
            * portable_math.log1p(np.abs(left) / c.grid[0])
            / portable_math.log1p(2 * farthest / c.grid[0])
        )
        one = [
            every["known"] != 0, every["running"] != 0, every["fresh"] != 0, *(every["rates"] == r for r in range(len(RATES))),
            *(every["distance"] == d for d in range(len(c.grid))), left / farthest, log, *(every[name] for name in SWITCHES),
        ]  # fmt: skip
        selected = e["selected"][:, None] == np.arange(len(self.axes))
        arrived = (s["known"] != 0) & (distances_left == 0)
        of_axes = np.stack([used, selected, s["running"] != 0, arrived], axis=2) * used[:, :, None]
        time = (e["before"] - e["began"]) * 1e-9
        rest = [e["level"] / 3.0, 1.0 - self.steps / c.macros, 1.0 - time / c.time_limit]
        columns = [np.stack(one, axis=1), of_axes.reshape(self.n, -1), np.stack(rest, axis=1)]
        return np.clip(np.concatenate([*columns, self.machine_features], axis=1), -1.0, 1.0).astype(np.float32)

    # --- a host ---

    def scripted_action(self) -> np.ndarray:
        """Return the next actions of a host that approaches the targets by long distances, one axis after the other."""
        return np.array([self._choose_action(k) for k in range(self.n)], np.int64)

    def _choose_action(self, stage_index: int) -> int:
        """Choose the next action of the scripted policy on one stage."""
        c, selected = self.config, int(self.episodes[stage_index]["selected"])
        at = {name: j for j, name in enumerate((*RATES, *c.grid, *MACROS_WITHOUT_VALUES))}
        for a, s in enumerate(self.axis_states[stage_index]):
            left = int(s["target"] - (s["seen"] - s["zero"]))
            if not self.uses_axis[stage_index, a] or (s["known"] and left == 0 and s["fresh"]):
                continue
            if a != selected:
                return self.macro_table.macros_per_axis + a
            if s["running"]:
                return at["wait"]
            if not s["fresh"]:
                return at["read"]
            if not s["known"] and not s["org"]:
                return at["home"]
            if s["rates"] < 0:
                return at["usual"]
            wanted = int(np.argmin(np.abs(np.array(c.grid) - abs(left)))) if s["known"] else len(c.grid) - 1
            if s["distance"] != wanted:
                return at[c.grid[wanted]]
            return at["minus" if s["known"] and left < 0 else "plus"]
        return int(np.argmax(self.action_masks()[stage_index]))
