"""`stage/OriginReturn-v0`: find the origin from an unknown position, fast and repeatably.

A step is one whole origin return of an axis that was powered up anywhere between its end limits, before ORG, on it or beyond:

    leave      plus by a preset distance (0: not at all), because the chip refuses an origin return that starts on ORG
    search     minus, fast, until ORG; with SD enabled, at FL from the SD switch on
    back off   plus by a preset distance, at FL
    approach   minus, at another FL, until ORG, or (ez = N) until the N-th index pulse after it

with `settle` seconds of rest after each. The host reads the chip's status during the runs, but no decision depends on it.

action        Box [-1, 1]^7, see register_scaling.py; with actions="registers" the integers themselves, MultiDiscrete:
              R1 FL and R2 FH1 of leaving, search and backing off, R4 their rate (R5 is the same), approach (R1 of the approach),
              leave and back_off (pulses), sd (1 uses SD). A unit of R1, R2 and approach is clock / (8192 R7) pps, 20 by default.
              NOVA chips do search, backing off and approach by themselves, in the automatic home search. MCX514, Box [-1, 1]^7:
              SV, DV, AC, HV of the approach, leave, step1 (1: the fast search to ORG comes first), timer (between steps: 0 none,
              1 to 8 of H2M). MCX304, MCX302, MCX312, Box [-1, 1]^6: SV, V, A, HV in units of 20 pps, leave, step1 (a continuous
              drive to ORG). Their search continues from an end limit, and may take three times `limit`.
observation   float32: 0 ORG asserted now    1 SD+ asserted now    2 returns left / returns
              3 payload, 4 friction, -1 to 1 over their ranges (friction by its logarithm)
              and of the last return, as a host knows it (0 before the first)
              5 there was one    6 ended at the origin    7 ran into an end limit    8 a run took longer than `limit`
              9 ORG released after backing off (NOVA: no error of the home search)    10 duration / 4 limits
              11 pulses of the search / those from EL to EL
              12 pulses of the approach beyond those of backing off / 64: how far the search overran (NOVA: 0)
              An observation does not contain the position of the carriage.
reward        the sum of
              time     - time_weight x s
              error    - error_weight x pulses between the carriage and the place where ORG trips (or the N-th index
                         pulse after it), at most 64
              spread   - spread_weight x pulses by which this return widened the range of the episode's end positions
              missed   - missed_weight if the return did not end at the origin
              limit    - limit_weight if a run ended neither after its pulses nor at ORG: an end limit, or its time limit
              lost     - lost_weight if a full step was lost
episode       `returns` returns, then truncated. Payload and friction are drawn for the episode, start positions for each return.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from stage import Stage
from stage.chips import Chip, chip_class
from stage.envs import settings
from stage.envs.observation_features import HOST, TRUTH, Feature
from stage.envs.origin_switch import OriginSwitch
from stage.envs.reduced_model import reduce_model
from stage.envs.register_scaling import RegisterBox
from stage.envs.scaling import scale_linear, scale_log
from stage.envs.stage_env import StageEnv, StageVectorEnv
from stage.envs.task import MoveTask
from stage.errors import unknown_name_error
from stage.firmware.driver import get_driver
from stage.sim.engine_records import INDEX
from stage.sim.fleet import PlayedPrograms
from stage.sim.payload_and_judged_point import find_payload_body
from stage.sim.program import Program
from stage.support import portable_math

START_LIMIT_CLEARANCE_M = 5e-4  # smallest distance between the start of a return and an end limit
MAX_ERROR_PULSES = 64.0  # an electrical period of a motor with 1/16 microsteps


@dataclass(frozen=True)
class Config(settings.Settings):
    """Settings of OriginReturn.

    Attributes:
        model: Name of the model.
        chip: Name or class of the chip.
        axis: Name of the axis.
        reduced: Whether the other axes are locked and left out of the physics, see reduced_model.py.
        actions: "box": numbers from -1 to 1; "registers": the integers themselves.
        returns: Number of returns in an episode.
        payloads: Smallest and largest payload, kg, drawn evenly.
        payload_on: Body that carries the payload, or a site on it; None: see `find_payload_body`.
        frictions: Range of the factor on the friction and damping of the axis, drawn evenly by its logarithm.
        drift: Largest distance between the nominal position of ORG and the one at which it trips, m, drawn for each return.
        ez: Number of the index pulse after ORG at which a return ends (PCL240MK, PCL240MS; NOVA chips: 1); 0: at ORG.
        multiplier: R7 of a PCL-240.
        leave: Largest distance by which an action can leave ORG, pulses.
        back_off: Largest distance by which an action can back off, pulses, for a PCL-240.
        limit: Longest simulated time of each of the four runs, s.
        settle: Simulated time after each run, s.
        time_weight: Cost of a simulated second.
        error_weight: Cost of a pulse between carriage and origin, up to MAX_ERROR_PULSES pulses.
        spread_weight: Cost of a pulse by which a return widens the range of the end positions.
        missed_weight: Cost of a return that does not end at the origin.
        limit_weight: Cost of a run that ends at an end limit or at its time limit.
        lost_weight: Cost of a return that loses a full step.
        bus_cycle: Duration of a bus cycle, s.
        truth: Whether observation and info have values that no host can know: True (both), "info" (info alone), False (neither).
    """

    model: str = "xyz"
    chip: str | type[Chip] = "PCL240K"
    axis: settings.AxisName = "x"
    reduced: settings.Boolean = False
    actions: settings.ActionKind = "box"
    returns: settings.Count = 5
    payloads: settings.PayloadRange = (0.0, 10.0)
    payload_on: settings.AxisName | None = None
    frictions: Annotated[settings.Pair, settings.RangeSetting(1e-3)] = (0.5, 2.0)
    drift: Annotated[float, settings.NumberSetting(high=START_LIMIT_CLEARANCE_M)] = 0.0
    ez: Annotated[int, settings.NumberSetting(high=16, integer=True)] = 0
    multiplier: settings.Count = 30
    leave: settings.Count = 16_000
    back_off: settings.Count = 3_200
    limit: settings.Seconds = 20.0
    settle: settings.Seconds = 0.05
    time_weight: settings.Weight = 1.0
    error_weight: settings.Weight = 0.05
    spread_weight: settings.Weight = 0.2
    missed_weight: settings.Weight = 20.0
    limit_weight: settings.Weight = 2.0
    lost_weight: settings.Weight = 2.0
    bus_cycle: settings.BusCycleSeconds = 1e-6
    truth: settings.TruthOption = True


class OriginReturn(MoveTask[Config]):
    """Rules of stage/OriginReturn-v0. The module docstring states them."""

    Config = Config
    OPTIONS = ("start", "payload", "friction")
    """Options of a reset, which replace drawn values. start: start of the first return, m."""
    PARTS = ("time", "error", "spread", "missed", "limit", "lost")
    STATE = ("payload", "friction", "place", "shift", "ends", "last")
    RESTARTS = True
    OBSERVATION = (
        Feature("org", HOST, "1 if ORG is asserted now"),
        Feature("sd", HOST, "1 if SD+ is asserted now"),
        Feature("left", HOST, "returns left / `returns`"),
        Feature("payload", TRUTH, "from -1 to 1 over `payloads`"),
        Feature("friction", TRUTH, "by its logarithm from -1 to 1 over `frictions`"),
        Feature("last", HOST, "1 if there was a return; the following numbers describe it"),
        Feature("last_home", HOST, "1 if it ended at the origin, by the chip"),
        Feature("last_end_limit", HOST, "1 if it ran into an end limit"),
        Feature("last_late", HOST, "1 if a run took longer than `limit`"),
        Feature("last_released", HOST, "1 if ORG was released after backing off (NOVA: no error of the home search)"),
        Feature("last_duration", HOST, "duration / 4 `limit`"),
        Feature("last_searched", HOST, "pulses of the search / those from EL to EL"),
        Feature("last_overrun", HOST, "pulses of the approach beyond those of backing off / 64 (NOVA: 0)"),
    )
    INFO = (
        Feature("payload", TRUTH, "kg, of the episode; in the info of a reset"),
        Feature("friction", TRUTH, "times the nominal friction, of the episode; in the info of a reset"),
        Feature("duration", HOST, "s", kind=float),
        Feature("error", TRUTH, "pulses between the carriage and the origin", kind=float),
        Feature("spread", TRUTH, "pulses, the episode's largest minus smallest error", kind=float),
        Feature("home", HOST, "the return ended at the origin, by the chip", kind=bool),
        Feature("end_limit", HOST, "a run ended at an end limit", kind=bool),
        Feature("late", HOST, "a run took longer than `limit`", kind=bool),
        Feature("lost_steps", TRUTH, "full steps", kind=int),
        Feature("start", TRUTH, "m, where the return began", kind=float),
        Feature("registers", HOST, "registers of the action", kind=int),
    )

    def make_stage(self, visuals: bool) -> Stage:
        c = self.config
        model = reduce_model(c.model, c.axis) if c.reduced else c.model
        new_stage = Stage(model, chips=chip_class(c.chip), bus_cycle=c.bus_cycle, visuals=visuals)
        if c.axis not in new_stage.axes:
            raise unknown_name_error("axis", c.axis, new_stage.axes)
        return new_stage

    def make_spaces_and_arrays(self) -> None:
        c, n, first = self.config, self.n, self.stages[0]
        self.axis = first.axes[c.axis]
        self.carrier = find_payload_body(first, c.axis, c.payload_on)
        self.search = get_driver(self.axis).build_home_program(c)
        self.switch = OriginSwitch(first, self.axis)
        self.per_pulse = self.axis.meters_per_pulse
        self.origin = self._compute_origin()
        self.dof = self.axis.plant.dof
        self.friction0 = float(first.model.dof_frictionloss[self.dof]), float(first.model.dof_damping[self.dof])
        choices = self.search.choices
        self.register_box = RegisterBox(list(choices.ranges), choices.ranges.values(), choices.cubed)
        self.action_space = self.register_box.box if c.actions == "box" else self.register_box.discrete
        self.observation_space = self.make_observation_space()
        self.shapes = {"registers": (len(self.register_box),)}
        self.payload, self.friction, self.place, self.shift = np.zeros(n), np.ones(n), np.zeros(n), np.zeros(n)
        self.ends = np.zeros((n, 2))
        self.last = np.zeros((n, 8))

    def _compute_origin(self) -> float:
        """Compute the position at which a perfect return ends, m: that of ORG, or the ez-th index pulse after ORG."""
        touch, ez = self.switch.position, self.config.ez
        if not ez:
            return touch
        turn = 2 * np.pi / self.axis.gear
        first, turn = self.axis.plant.index * turn + 0.5 * INDEX * abs(turn), abs(turn)
        return float(first + (np.floor((touch - first) / turn) - (ez - 1)) * turn)

    def begin_episode(self, stage_index: int, options: Mapping[str, Any]) -> None:
        c, rng = self.config, self.rngs[stage_index]
        payload, friction = (
            float(rng.uniform(*c.payloads)),
            float(portable_math.exp(rng.uniform(*portable_math.log(c.frictions)))),
        )
        self.payload[stage_index] = settings.read_number_option(options, "payload", payload, c.payloads)
        self.friction[stage_index] = settings.read_number_option(options, "friction", friction, c.frictions)
        self._apply_payload_and_friction(stage_index)
        self.ends[stage_index], self.last[stage_index] = (np.inf, -np.inf), 0.0
        self._draw_move(stage_index, options)

    def prepare_next_step(self) -> None:
        for k in np.flatnonzero(self.undiverged_stages):
            self._draw_move(int(k), {})

    def _draw_move(self, stage_index: int, options: Mapping[str, Any]) -> None:
        """Draw the start of a stage's next return and the shift of ORG, and put the carriage at the start.

        Args:
            stage_index: Index of the stage.
            options: Options of the reset; "start", m, replaces the drawn start.
        """
        c, rng, stage = self.config, self.rngs[stage_index], self.stages[stage_index]
        drawn = float(
            rng.uniform(self.switch.low + START_LIMIT_CLEARANCE_M, self.switch.high - START_LIMIT_CLEARANCE_M)
        )
        self.place[stage_index] = settings.read_number_option(options, "start", drawn, self.axis.travel)
        self.shift[stage_index] = rng.uniform(-c.drift, c.drift) if c.drift else 0.0
        self._shift_switch(stage_index)
        stage.restore(self.start)
        stage.place(**{c.axis: float(self.place[stage_index])})

    def apply_machine(self, stage_index: int) -> None:
        self._apply_payload_and_friction(stage_index)
        self._shift_switch(stage_index)

    def _apply_payload_and_friction(self, stage_index: int) -> None:
        """Apply the payload and the friction of the episode to a stage."""
        model = self.stages[stage_index].model
        self.stages[stage_index].set_payload(float(self.payload[stage_index]), self.carrier)
        model.dof_frictionloss[self.dof], model.dof_damping[self.dof] = (
            np.array(self.friction0) * self.friction[stage_index]
        )

    def _shift_switch(self, stage_index: int) -> None:
        """Shift the ORG switch of a stage by the distance that was drawn for its next return."""
        if self.config.drift:
            self.switch.shift(self.stages[stage_index], self.shift[stage_index])

    def describe_episode(self, stage_index: int) -> dict[str, Any]:
        return {"payload": float(self.payload[stage_index]), "friction": float(self.friction[stage_index])}

    def to_registers(self, actions: np.ndarray) -> np.ndarray:
        """Convert actions to integers, (stages, numbers), in the order of `register_box.names`."""
        return self.register_box.from_action(actions) if self.config.actions == "box" else actions.astype(np.int64)

    def make_programs(self) -> list[Program]:
        return [self.search.write_program(row) for row in self.to_registers(self.actions)]

    def judge(self, played: PlayedPrograms, truth: np.ndarray) -> None:
        c, t = self.config, truth[:, self.axis.index]
        rows = self.to_registers(self.actions)
        outcome = self.search.decode_results(played.results, rows)
        timed_out, home, end_limit = outcome.timed_out, outcome.home, outcome.end_limit
        duration = t["now"] * 1e-9  # since power-up
        error = np.clip((t["position"] - self.origin) / self.per_pulse, -1e6, 1e6)
        lost = np.abs(t["lost_steps"])
        ends = np.where(
            home[:, None],
            np.stack([np.minimum(self.ends[:, 0], error), np.maximum(self.ends[:, 1], error)], axis=1),
            self.ends,
        )
        spread, before = _compute_spread(ends), _compute_spread(self.ends)
        parts = {
            "time": -c.time_weight * duration,
            "error": -c.error_weight * np.minimum(np.abs(error), MAX_ERROR_PULSES),
            "spread": -c.spread_weight * np.minimum(spread - before, MAX_ERROR_PULSES),
            "missed": np.where(home, 0.0, -c.missed_weight),
            "limit": np.where(end_limit | timed_out, -c.limit_weight, 0.0),
            "lost": np.where(lost > 0, -c.lost_weight, 0.0),
        }
        info = {
            "duration": duration, "error": error, "spread": spread, "home": home, "end_limit": end_limit, "late": timed_out,
            "lost_steps": lost, "start": self.place, "registers": rows,
        }  # fmt: skip
        travel_pulses = (self.switch.high - self.switch.low) / self.per_pulse
        now = [
            self.active,
            home,
            end_limit,
            timed_out,
            outcome.released,
            duration / (4 * c.limit),
            outcome.searched / travel_pulses,
            outcome.overrun / MAX_ERROR_PULSES,
        ]
        good = self.undiverged_stages
        self.ends[good] = ends[good]
        self.last[good] = np.clip(np.nan_to_num(np.stack(now, axis=1)), -1.0, 1.0)[good]
        self.set_results(parts, info, False, self.steps >= c.returns)

    def compute_observations(self) -> np.ndarray:
        c, inputs = self.config, self.fleet.truth()["inputs"][:, self.axis.index]
        columns = [
            inputs & self.axis.chip.find_switch_input("org") != 0,
            inputs & self.axis.chip.find_switch_input("sd_plus") != 0,
            1.0 - self.steps / c.returns,
            scale_linear(self.payload, c.payloads),
            scale_log(self.friction, c.frictions),
        ]
        now = np.concatenate([np.stack(columns, axis=1), self.last], axis=1)
        return np.clip(now, -1.0, 1.0).astype(np.float32)


def _compute_spread(ends: np.ndarray) -> np.ndarray:
    """Return the range of the positions at which the origin returns have ended so far, pulses, (stages,); 0 before the first.

    Args:
        ends: Smallest and largest end position, pulses, (n, 2).
    """
    return np.where(ends[:, 1] >= ends[:, 0], ends[:, 1] - ends[:, 0], 0.0)


class OriginReturnEnv(StageEnv):
    """Gymnasium environment stage/OriginReturn-v0: find the origin from an unknown position, one return a step."""

    task = OriginReturn

    @property
    def register_box(self) -> RegisterBox:
        """Converter between actions and the integers that they stand for, by name."""
        return self._task.register_box  # type: ignore[attr-defined]


class OriginReturnVectorEnv(StageVectorEnv):
    """Vector environment stage/OriginReturn-v0: find the origin from an unknown position, one return a step."""

    task = OriginReturn

    @property
    def register_box(self) -> RegisterBox:
        """Converter between actions and the integers that they stand for, by name."""
        return self._task.register_box  # type: ignore[attr-defined]
