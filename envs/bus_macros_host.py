"""Host of `stage/BusMacros-v1`: its macros, its observations, and a scripted policy.

The host knows only what it has written and read. bus_macros.py draws the episodes; bus_macros_core.py plays and judges the macros,
and keeps the memory of the host.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stage.envs import bus_macros_core as core
from stage.envs import machine_contexts
from stage.envs.bus_macros_core import SWITCHES
from stage.envs.compiled_task import CompiledTask
from stage.envs.hidden_machine_task import HiddenMachineTask
from stage.envs.macro_programs import MACROS_WITHOUT_VALUES, RATES, MacroTable
from stage.envs.observation_features import HOST, Feature


class MacroHostTask(HiddenMachineTask[Any], CompiledTask[Any]):
    """Base of tasks whose actions are macros: their programs, the observations of the host and its scripted policy.

    Attributes:
        axes: Axes of the first stage, m of them.
        macro_table: Programs of all macros.
        axis_states: Memory of the host, AXIS_STATE records, (n, m).
        episodes: State of each episode, EPISODE records, (n,).
        names: Names of the macros.
    """

    axes: list[Any]
    macro_table: MacroTable
    axis_states: np.ndarray
    episodes: np.ndarray
    _homed: np.ndarray
    names: tuple[str, ...]
    _lasts: np.ndarray
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
        return (np.arange(len(self.axes)) == 0) | (self.episodes["level"] >= core.LEVEL_AXES)[:, None]

    def action_masks(self) -> np.ndarray:
        """Return which macros have an effect now, (stages, actions) int8."""
        return self.results["info"]["action_mask"].copy()

    def set_action(self, stage_index: int, action: Any) -> None:
        if type(action) in (int, np.int64) and 0 <= action < len(self.names):
            self.actions[stage_index] = action
        else:
            super().set_action(stage_index, action)

    def run_step(self) -> bool:
        if self._lasts.take(self.actions, mode="clip").any():
            self.fleet.run_on_threads(self.step_stages, interruptible=True)
        else:  # threads would take more time than they save
            self.fleet.stop_background()
            self.step_stages(0, self.n)
        return any(self._status.tolist())

    def decode_results(self, stage_index: int) -> None:
        axis, results = int(self.episodes["selected"][stage_index]), self._values[stage_index : stage_index + 1]
        self._homed[stage_index] = self.macro_table.find_returns_at_origin(axis, results)[0]

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
