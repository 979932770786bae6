"""Host of `stage/BusMacros-v1`: the macros that are allowed now, what the host has written and read, and a scripted policy.

It knows what it wrote and what it read: every answer here follows from these. bus_macros.py has the episodes and their judge.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stage.envs import machine_contexts
from stage.envs.hidden_machines import MachineTask
from stage.envs.macro_programs import OTHERS, RATES, MacroTable
from stage.envs.observation_features import HOST, Feature
from stage.native import record
from stage.sim.fleet import PlayedPrograms
from stage.support import portable_math

SWITCHES = ("org", "el_minus", "el_plus")
AXIS = record(
    [(name, "i8") for name in "rates distance running fresh known zero seen target lost limit".split()]
    + [("goal", "f8"), *((name, "?") for name in SWITCHES)]
)
"""What the host remembers of an axis (rates, distance: -1 none; zero, seen: pulses), its goal, and what the judge does: most steps
lost, whether it stands at an end limit."""
EPISODE = record(
    [(name, "i8") for name in "level selected began before limits".split()]
    + [(name, "f8") for name in "potential usual start loan".split()]
)
"""ns; end limits hit; the last potential; s, that the formula takes; the potential at the begin; with a
discount what has been lent."""


class BusHost(MachineTask[Any]):
    """The host's side of the task.

    Attributes: axes; wired, of each the bits of SWITCHES in its inputs; book, the macros; axis_states, (n, axes) AXIS; episodes,
    (n,) EPISODE.
    """

    axes: list[Any]
    wired: list[list[int]]
    book: MacroTable
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
        *machine_contexts.OBSERVATION,
    )

    def layout(self) -> list[Feature]:
        of_axes = [e for e in self.OBSERVATION if e.each]
        at = self.OBSERVATION.index(of_axes[0])
        often = {"rates": len(RATES), "distance": len(self.config.grid)}
        one = [e for e in self.OBSERVATION[:at] for _ in range(often.get(e.name, 1))]
        return [*one, *of_axes * len(self.axes), *self.OBSERVATION[at + len(of_axes) :]]

    # --- macros ---

    @property
    def uses_axis(self) -> np.ndarray:
        """Mask of the axes that take part, (n, m) bool."""
        return (np.arange(len(self.axes)) == 0) | (self.episodes["level"] >= 2)[:, None]

    def action_masks(self) -> np.ndarray:
        """Return which actions have an effect now, (n, actions) int8."""
        s, c, e = self.selected_state, self.config, self.episodes
        idle = s["running"] == 0
        able = idle & (s["rates"] >= 0) & (s["distance"] >= 0)
        columns = [
            *(idle & (s["rates"] != r) for r in range(len(RATES))), *(idle & (s["distance"] != d) for d in range(len(c.grid))),
            able, able, idle & (e["level"] == 3), ~idle, s["fresh"] == 0,
            *(self.uses_axis[:, a] & (e["selected"] != a) for a in range(len(self.axes))),
        ]  # fmt: skip
        return np.stack(columns, axis=1).astype(np.int8)

    @property
    def selected_state(self) -> np.ndarray:
        """Memory of the host for the selected axis, (n,)."""
        return self.axis_states[np.arange(self.n), self.episodes["selected"]]

    def make_programs(self) -> np.ndarray:
        to_registers, every = self.actions, np.arange(self.n)
        self._valid = self.action_masks()[every, to_registers] != 0
        return self.book.programs(
            to_registers, self.episodes["selected"], self.selected_state, self._valid & self.active
        )

    # --- what it remembers and sees ---

    def _update_memory(self, played: PlayedPrograms, t: np.ndarray) -> None:
        """Update the host's memory after the macros that were played."""
        done = self._valid & self.converged
        for kind, mask in self.book.is_kind.items():
            rows = np.flatnonzero(done & mask[self.actions])
            if not len(rows):
                continue
            axis = self.episodes["selected"][rows]
            if kind == "select":
                self.episodes["selected"][rows] = self.book.value[self.actions[rows]]
                continue
            s = self.axis_states[rows, axis]
            if kind in ("rates", "distance"):
                s[kind] = self.book.value[self.actions[rows]]
            elif kind in ("plus", "minus"):
                s["running"], s["fresh"] = 1, 0
            elif kind == "wait":
                s["running"], s["fresh"] = played.results[rows, 0] < 0, 0
            elif kind == "read":
                self._store_read_values(s, t[rows, axis], axis)
            else:
                self._store_home_results(s, played.results[rows], t[rows, axis], axis)
            self.axis_states[rows, axis] = s

    def _store_read_values(self, s: np.ndarray, t: np.ndarray, axis: np.ndarray) -> None:
        s["fresh"], s["seen"] = 1, t["pulses"]
        pins = np.array(self.wired)[axis]
        for j, name in enumerate(SWITCHES):
            s[name] = t["inputs"] & pins[:, j] != 0

    def _store_home_results(self, s: np.ndarray, results: np.ndarray, t: np.ndarray, axis: np.ndarray) -> None:
        for a in np.unique(axis):
            mask = axis == a
            s["known"][mask] = self.book.ends_at_origin(int(a), results[mask])
        s["zero"], s["rates"], s["distance"] = t["pulses"], -1, -1
        self._store_read_values(s, t, axis)

    def compute_observations(self) -> np.ndarray:
        c, s, e, every, used = self.config, self.axis_states, self.episodes, self.selected_state, self.uses_axis
        distances_left = np.where(s["known"] != 0, s["target"] - (s["seen"] - s["zero"]), 0)
        left = distances_left[np.arange(self.n), e["selected"]]
        log = (
            np.sign(left)
            * portable_math.log1p(np.abs(left) / c.grid[0])
            / portable_math.log1p(2 * c.longest / c.grid[0])
        )
        one = [
            every["known"] != 0, every["running"] != 0, every["fresh"] != 0, *(every["rates"] == r for r in range(len(RATES))),
            *(every["distance"] == d for d in range(len(c.grid))), left / c.longest, log, *(every[name] for name in SWITCHES),
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
        c, selected = self.config, int(self.episodes[stage_index]["selected"])
        at = {name: j for j, name in enumerate((*RATES, *c.grid, *OTHERS))}
        for a, s in enumerate(self.axis_states[stage_index]):
            left = int(s["target"] - (s["seen"] - s["zero"]))
            if not self.uses_axis[stage_index, a] or (s["known"] and left == 0 and s["fresh"]):
                continue
            if a != selected:
                return self.book.macros_per_axis + a
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
