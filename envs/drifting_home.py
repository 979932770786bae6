"""`stage/DriftingHome-v1`: repeated origin returns on a machine that drifts and may have a fault, which the agent can report.

An episode has one hidden machine (machine_contexts.py), which may have one fault (machine_faults.py). ORG trips at a slightly
different position at each return: it moves by up to `walk` from one return to the next, its contact scatters by `noise`, and it
bounces for a time that is drawn for the machine. A step is one whole origin return, as one program of bus cycles, or the report
of a fault, which ends the episode. The result of one return helps to choose the next.

action        Box [-1, 1]^6: rate of the search (pps), its ramps (s) and rate of the approach (pps), by their logarithms over
              ACTION_RANGES; pulses by which ORG is left before the search, by their cube root; pulses by which the host
              backs off before
              the approach, by their logarithm; and the report: above 0 it states that the machine has a fault, and no return is
              made. The driver of the chip computes the registers, so one policy can act through every chip.
observation   float32, -1 to 1, only what a host knows (truth=True adds machine and fault)
              ORG asserted now; returns left / returns; distance that the host has moved away from the last origin / `reach`, 0
              without an origin;
              and of the last return, 0 before the first: there was one; it ended at the origin, by the chip; it hit an end limit;
              a run took too long; ORG was released before the approach; duration / 4 limits; pulses of the search / those from EL
              to EL; pulses of the approach beyond those of backing off / 64; counted pulses between this origin and the last one
              / 64; number of last returns in a row that did not end at the origin / returns
reward        the sum of
              time       - time_weight x s
              error      - error_weight x pulses between the carriage and the place where ORG trips this time, at most 64
              missed     - missed_weight if the carriage is 64 pulses or more from the origin, or the chip did not find it
              damage     - damage_weight if steps were lost, and if a run ended at an end limit
              report     report_weight for the report of an existing fault. For a false report - false_weight, and - missed_weight
                         for each return that was left, so that a false report pays no better than going on. - unreported_weight
                         / returns for each return on a machine with a fault
              The weights are such that no episode costs as much as a divergence, which ends it with -10.
episode       `returns` returns, then truncated; terminated by a report. Each return begins anywhere within `reach` of ORG, on
              either side, but not beyond an end limit.
score         success: an existing fault was reported; or there was none, none was reported, and each return ended within
              `tolerance` of ORG. time: mean seconds of a return; with a reported fault the seconds up to the report, at least
              those of the formula. formula: the same returns at the usual rates (8000 pps, approach 400 pps), in closed form.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Annotated, Any

import gymnasium
import numpy as np

from stage.envs import machine_contexts, machine_faults
from stage.envs.hidden_machine_task import MachineSettings, MachineTask
from stage.envs.observation_features import HOST, TRUTH, Feature
from stage.envs.origin_switch import OriginSwitch
from stage.envs.settings import (
    AxisName,
    Boolean,
    Count,
    NumberSetting,
    Pair,
    PositiveNumber,
    RangeSetting,
    Seconds,
    Weight,
)
from stage.envs.stage_env import StageEnv, StageVectorEnv
from stage.envs.step_results import SCORE_FEATURE, write_scores
from stage.errors import ArgumentError
from stage.firmware.driver import get_driver
from stage.sim.fleet import PlayedPrograms
from stage.sim.program import Program
from stage.support import portable_math

ACTION_RANGES = {"search": (1000.0, 30_000.0), "ramp": (0.01, 0.2), "approach": (100.0, 4000.0)}  # pps, s, pps
LEAVE, BACK_OFF = 9_600, (64, 1600)  # pulses: largest distance; smallest and largest distance
USUAL_RETURN = {"search": 8000.0, "ramp": 0.1, "approach": 400.0, "leave": 0, "back_off": 200}
SCRIPTED_RETURN: dict[str, Any] = {"search": 9000.0, "ramp": 0.1, "approach": 1000.0, "back_off": 64}
LEAVE_MARGIN = 500  # pulses beyond ORG from which a search finds it again
START_RATE_SHARE = 0.125  # start rate, as a share of the rate of the search
MAX_ERROR_PULSES = 64.0  # an electrical period of a motor with 1/16 microsteps
START_LIMIT_CLEARANCE_M = 1e-3  # smallest distance between the start of a return and an end limit
LAST_RETURN_FEATURES = 10  # numbers of an observation that describe the last return


@dataclass(frozen=True)
class Config(MachineSettings):
    """Settings of DriftingHome, in addition to those of `MachineSettings`.

    Attributes:
        axis: Name of the axis.
        reduced: Whether the other axes are locked and left out of the physics, see reduced_model.py.
        healthy: Share of the machines that have no fault.
        walk: Largest distance by which ORG moves between two returns, m; these distances add up.
        noise: Largest random distance, at one return, between the place of ORG and the position at which it trips, m.
        bounces: Smallest and largest time for which the contact of ORG bounces, s.
        reach: Largest distance between ORG and the start of a return, m.
        returns: Number of returns in an episode.
        limit: Longest simulated time of each of the four runs of a return, s.
        settle: Simulated time after each run, s.
        tolerance: Largest distance between carriage and ORG at the end of a successful return, pulses.
        time_weight: Cost of a simulated second.
        error_weight: Cost of a pulse between the carriage and ORG, up to MAX_ERROR_PULSES pulses.
        missed_weight: Cost of a return that does not end at the origin.
        damage_weight: Cost of lost steps, and of a run that ends at an end limit.
        report_weight: Reward for the report of a fault that exists.
        false_weight: Cost of the report of a fault that does not exist.
        unreported_weight: Cost of a fault that was not reported in the episode, paid in equal parts by its returns.
    """

    FAULTS = machine_faults.DISABLING_FAULTS
    axis: AxisName = "x"
    reduced: Boolean = False
    healthy: Annotated[float, NumberSetting(high=1.0)] = 0.6
    walk: Annotated[float, NumberSetting(high=1e-3)] = 2e-5
    noise: Annotated[float, NumberSetting(high=1e-3)] = 5e-6
    bounces: Annotated[Pair, RangeSetting(high=0.1)] = (0.0, 1e-3)
    reach: Annotated[float, NumberSetting(1e-3, high=1.0)] = 0.02
    returns: Count = 6
    limit: Seconds = 3.0
    settle: Seconds = 0.05
    tolerance: PositiveNumber = 12.0
    time_weight: Weight = 0.05
    error_weight: Weight = 0.005
    missed_weight: Weight = 0.3
    damage_weight: Weight = 0.1
    report_weight: Weight = 1.0
    false_weight: Weight = 1.0
    unreported_weight: Weight = 1.0


def make_action(
    search: float = 8000.0,
    ramp: float = 0.1,
    approach: float = 400.0,
    leave: int = 0,
    back_off: int = 200,
    report: bool = False,
) -> np.ndarray:
    """Return the action that stands for these values of an origin return. A value beyond its range counts as the end of the range.

    Args:
        search: Rate of the search, pps.
        ramp: Duration of each ramp of the search, s.
        approach: Rate of the approach, pps.
        leave: Distance by which the axis leaves ORG before the search, pulses.
        back_off: Distance by which the host backs off before the approach, pulses.
        report: Whether to report a fault instead of making a return.

    Returns:
        Action, (6,) float32.
    """
    low, high = portable_math.log(np.array(list(ACTION_RANGES.values()))).T
    rates = 2 * (portable_math.log((search, ramp, approach)) - low) / (high - low) - 1
    leave_share = 2 * portable_math.cbrt(leave / LEAVE) - 1
    b0, b1 = portable_math.log(BACK_OFF)
    back = 2 * (portable_math.log(back_off) - b0) / (b1 - b0) - 1
    return np.clip([*rates, leave_share, back, 1.0 if report else -1.0], -1, 1).astype(np.float32)


class DriftingHome(MachineTask[Config]):
    """Rules of stage/DriftingHome-v1. The module docstring states them."""

    Config = Config
    OPTIONS = ("start", *machine_contexts.RESET_OPTION_NAMES)
    """Options of a reset. start: start of the first return, m; fault: a name, or "none"; and values of the machine."""
    PARTS = ("time", "error", "missed", "damage", "report")
    STATE = ("context", "place", "shift", "last", "away", "last_end", "sums", "bounce")
    RESTARTS = True
    OBSERVATION = (
        Feature("org", HOST, "1 if ORG is asserted now"),
        Feature("left", HOST, "returns left / `returns`"),
        Feature("away", HOST, "distance that the host has moved from the last origin / `reach`; 0 without an origin"),
        Feature("last", HOST, "1 if there was a return; the following numbers describe it"),
        Feature("last_home", HOST, "1 if it ended at the origin, by the chip"),
        Feature("last_end_limit", HOST, "1 if it ran into an end limit"),
        Feature("last_late", HOST, "1 if a run took longer than `limit`"),
        Feature("last_released", HOST, "1 if ORG was released before the approach (NOVA: no error of the home search)"),
        Feature("last_duration", HOST, "duration / 4 `limit`"),
        Feature("last_searched", HOST, "pulses of the search / those from EL to EL"),
        Feature("last_overrun", HOST, "pulses of the approach beyond those of backing off / 64 (NOVA: 0)"),
        Feature("last_off", HOST, "counted pulses between this origin and the last one / 64"),
        Feature("failed", HOST, "number of last returns in a row that did not end at the origin / `returns`"),
        *machine_contexts.OBSERVATION_FEATURES,
    )
    INFO = (
        *machine_contexts.INFO_FEATURES,
        Feature("reported", HOST, "the step was a report", kind=bool),
        Feature("duration", HOST, "s", kind=float),
        Feature("error", TRUTH, "pulses between the carriage and where ORG trips", kind=float),
        Feature("home", HOST, "the return ended at the origin, by the chip", kind=bool),
        Feature("end_limit", HOST, "a run ended at an end limit", kind=bool),
        Feature("late", HOST, "a run took longer than `limit`", kind=bool),
        Feature("lost_steps", TRUTH, "full steps", kind=int),
        Feature("start", TRUTH, "m, where the return began", kind=float),
        Feature("choices", HOST, "parameters that the driver's search computes from the action", kind=int),
        SCORE_FEATURE,
    )

    def make_spaces_and_arrays(self) -> None:
        c, n, first = self.config, self.n, self.stages[0]
        self.axis = first.axes[c.axis]
        self.prepare_contexts()
        self.switch = OriginSwitch(first, self.axis)
        self.search = get_driver(self.axis).build_home_program(
            SimpleNamespace(multiplier=30, leave=LEAVE, back_off=BACK_OFF[1], limit=c.limit, settle=c.settle, ez=0)
        )
        self.origin, self.per_pulse = self.switch.position, self.axis.meters_per_pulse
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (6,), np.float32)
        self.observation_space = self.make_observation_space()
        self.shapes = {"choices": (len(self.search.choices.ranges),)}
        self.place, self.shift = np.zeros(n), np.zeros((n, 2))  # m: the start; the walk of ORG, and where it trips
        self.last, self.away, self.last_end = np.zeros((n, LAST_RETURN_FEATURES)), np.zeros(n), np.full(n, np.nan)
        self.bounce = np.zeros(n)  # s
        self.sums = np.zeros((n, 5))  # s, s by the formula, returns that missed, full steps lost, limits hit

    # --- machines and places ---

    def begin_episode(self, stage_index: int, options: Mapping[str, Any]) -> None:
        c, rng = self.config, self.rngs[stage_index]
        self.draw_machine(stage_index, options)
        self.bounce[stage_index] = rng.uniform(*c.bounces)
        self.last[stage_index], self.sums[stage_index], self.shift[stage_index], self.last_end[stage_index] = (
            0.0,
            0.0,
            0.0,
            np.nan,
        )
        self._begin_return(stage_index, options)

    def make_fault_rng(self, stage_index: int) -> np.random.Generator:
        """Return the generator of the stage itself: in this task, every machine may have a fault."""
        return self.rngs[stage_index]

    def prepare_next_step(self) -> None:
        for k in np.flatnonzero(self.undiverged_stages & ~self.results["terminated"]):
            self._begin_return(int(k), {})

    def _begin_return(self, stage_index: int, options: Mapping[str, Any]) -> None:
        """Begin the next return of a stage: ORG drifts, and the carriage starts elsewhere.

        Args:
            stage_index: Index of the stage.
            options: Options of the reset, among them "start", m; empty for later returns.
        """
        c, rng, stage = self.config, self.rngs[stage_index], self.stages[stage_index]
        low, high = self.switch.low + START_LIMIT_CLEARANCE_M, self.switch.high - START_LIMIT_CLEARANCE_M
        walk, noise, at = rng.uniform(-1, 1, 3)
        self.shift[stage_index, 0] += c.walk * walk
        self.shift[stage_index, 1] = self.shift[stage_index, 0] + c.noise * noise
        drawn = float(np.clip(self.origin + c.reach * at, low, high))
        start = options.get("start", drawn)
        if isinstance(start, bool) or not isinstance(start, int | float | np.number) or not low <= start <= high:
            raise ArgumentError(f"option start={start!r}: m, from {low:g} to {high:g}.")
        self.place[stage_index] = start
        self.away[stage_index] = (
            0.0 if np.isnan(self.last_end[stage_index]) else self.place[stage_index] - self.last_end[stage_index]
        )
        stage.restore(self.start)
        self.apply_machine(stage_index)
        stage.place(**{c.axis: float(self.place[stage_index])})

    def apply_machine(self, stage_index: int) -> None:
        stage = self.stages[stage_index]
        self.switch.shift(stage, self.shift[stage_index, 1])
        self.apply_machine_to(stage, stage_index, bounce=float(self.bounce[stage_index]))

    def describe_episode(self, stage_index: int) -> dict[str, Any]:
        return self.describe_machine(stage_index)

    # --- returns ---

    def to_registers(self, actions: np.ndarray) -> np.ndarray:
        """Compute the parameters of the driver's origin return that actions stand for, (n, choices)."""
        low, high = portable_math.log(np.array(list(ACTION_RANGES.values()))).T
        b0, b1 = portable_math.log(BACK_OFF)
        rows = []
        for action in np.asarray(actions, np.float64):
            u = (action + 1) / 2
            search, ramp, approach = portable_math.exp(low + (high - low) * u[:3]).tolist()
            approach = min(approach, search)
            leave, back_off = round(float(LEAVE * u[3] ** 3)), round(float(portable_math.exp(b0 + (b1 - b0) * u[4])))
            rows.append(
                self.search.find_nearest_row(
                    max(START_RATE_SHARE * search, 100.0), search, ramp, approach, leave, back_off
                )
            )
        return np.array(rows, np.int64)

    @property
    def report_mask(self) -> np.ndarray:
        """Mask of the stages whose action reports a fault of the machine, shape (stages,)."""
        return self.actions[:, 5] > 0

    def make_programs(self) -> list[Program]:
        rows, reports = self.to_registers(self.actions), self.report_mask
        return [Program() if told else self.search.write_program(row) for row, told in zip(rows, reports, strict=True)]

    def judge(self, played: PlayedPrograms, truth: np.ndarray) -> None:
        c, t, reports = self.config, truth[:, self.axis.index], self.report_mask
        rows, returned = self.to_registers(self.actions), ~reports
        width = max(self.search.result_indices.values()) + 1
        results = np.zeros((self.n, max(width, played.results.shape[1])), np.int64)
        results[:, : played.results.shape[1]] = played.results
        outcome = self.search.decode_results(results, rows)
        home, end_limit, timed_out = outcome.home & returned, outcome.end_limit & returned, outcome.timed_out & returned
        duration = np.where(returned, t["now"] * 1e-9, 0.0)
        trips = self.origin + self.shift[:, 1]
        error = np.where(returned, np.clip((t["position"] - trips) / self.per_pulse, -1e6, 1e6), 0.0)
        lost = np.where(returned, np.abs(t["lost_steps"]), 0)
        missed = returned & ~(home & (np.abs(error) < MAX_ERROR_PULSES))
        broken, over = self.context["fault"] != 0, self.steps >= c.returns
        false = -c.false_weight - c.missed_weight * (c.returns - self.steps + 1)
        parts = {
            "time": -c.time_weight * duration,
            "error": -c.error_weight * np.minimum(np.abs(error), MAX_ERROR_PULSES),
            "missed": np.where(missed, -c.missed_weight, 0.0),
            "damage": -c.damage_weight * ((lost > 0) * 1.0 + end_limit),
            "report": np.where(
                reports,
                np.where(broken, c.report_weight, false),
                np.where(broken, -c.unreported_weight / c.returns, 0.0),
            ),
        }
        info = {
            **self.machine_info, "reported": reports,
            "duration": duration, "error": error, "home": home, "end_limit": end_limit, "late": timed_out,
            "lost_steps": lost, "start": self.place, "choices": rows,
        }  # fmt: skip
        good = self.undiverged_stages
        self._store_last_return(outcome, home, t, duration, good & returned)
        bad = missed | (np.abs(error) > c.tolerance)
        more = np.stack([duration, returned * self._compute_usual_times(), bad, lost, end_limit], axis=1)
        self.sums[good] += more[good]
        self.set_results(parts, info, reports, over & ~reports)
        self._score_episodes(reports, broken)

    def _store_last_return(
        self, outcome: Any, at_origin: np.ndarray, truth: np.ndarray, duration: np.ndarray, valid: np.ndarray
    ) -> None:
        """Store what a host can observe of the last return, for the next observation.

        Args:
            outcome: Outcomes of the returns, as the driver reads them, (n,) each.
            at_origin: Mask of the returns that ended at the origin, by the chip.
            truth: True state of the axis on each stage, (n,).
            duration: Durations of the returns, s.
            valid: Mask of the stages that made a return.
        """
        travel_pulses = (self.switch.high - self.switch.low) / self.per_pulse
        known = at_origin & ~np.isnan(self.last_end)
        counted = truth["pulses"] + np.sign(self.axis.gear) * self.away / self.per_pulse
        now = [
            valid, at_origin, outcome.end_limit, outcome.timed_out, outcome.released, duration / (4 * self.config.limit),
            outcome.searched / travel_pulses, outcome.overrun / MAX_ERROR_PULSES, np.where(known, counted / MAX_ERROR_PULSES, 0.0),
            np.where(at_origin, 0.0, self.last[:, -1] + 1 / self.config.returns),
        ]  # fmt: skip
        self.last[valid] = np.clip(np.nan_to_num(np.stack(now, axis=1)), -1.0, 1.0)[valid]
        self.last_end[valid] = np.where(at_origin, truth["position"], np.nan)[valid]

    def _compute_usual_times(self) -> np.ndarray:
        """Compute how long a return from each start position takes at the usual rates, s, (n,)."""
        u, settled = USUAL_RETURN, 3 * self.config.settle
        distance = np.abs(self.place - self.origin) / self.per_pulse
        return (
            distance / u["search"]
            + u["ramp"]
            + u["back_off"] * (1 / (START_RATE_SHARE * u["search"]) + 1 / u["approach"])
            + settled
        )

    def _score_episodes(self, reports: np.ndarray, broken: np.ndarray) -> None:
        """Write the scores of the episodes of all stages; only those of episodes that end now are used.

        Args:
            reports: Mask of the stages whose action reports a fault, (n,).
            broken: Mask of the machines that have a fault, (n,).
        """
        seconds, usual, bad, lost, limits = self.sums.T
        returns = np.maximum(self.steps - reports, 1)
        success = np.where(broken, reports, ~reports & (bad == 0))
        usual = np.where(usual > 0, usual, self._compute_usual_times())
        time = np.where(success, np.where(reports, np.maximum(seconds, usual), seconds / returns), np.inf)
        write_scores(self.results["score"], time, np.where(reports, usual, usual / returns), self.steps, lost, limits)

    def compute_observations(self) -> np.ndarray:
        c, inputs = self.config, self.fleet.truth()["inputs"][:, self.axis.index]
        columns = [
            inputs & self.axis.chip.find_switch_input("org") != 0,
            1.0 - self.steps / c.returns,
            self.away / c.reach,
        ]
        now = np.concatenate([np.stack(columns, axis=1), self.last, self.machine_features], axis=1)
        return np.clip(now, -1.0, 1.0).astype(np.float32)

    # --- a host ---

    def scripted_action(self) -> np.ndarray:
        """Return the actions of a scripted host, which makes its origin returns at brisk rates.

        The host leaves ORG by as far as it has moved beyond the last origin and LEAVE_MARGIN more, searches at the rates of
        SCRIPTED_RETURN, and reports a fault after a return that failed.
        """
        on_org = self.fleet.truth()["inputs"][:, self.axis.index] & self.axis.chip.find_switch_input("org") != 0
        beyond = np.where(np.isnan(self.last_end), self.config.reach, np.maximum(-self.away, 0.0)) / self.per_pulse
        leave = np.where(on_org, np.minimum(np.rint(beyond) + LEAVE_MARGIN, LEAVE), 0).astype(int)
        has_failed = self.last[:, -1] > 0
        return np.stack(
            [
                make_action(**SCRIPTED_RETURN, leave=pulses, report=failed)
                for pulses, failed in zip(leave.tolist(), has_failed.tolist(), strict=True)
            ]
        )


class DriftingHomeEnv(StageEnv):
    """Gymnasium environment stage/DriftingHome-v1: repeat origin returns on a machine that drifts and may have a fault."""

    task = DriftingHome


class DriftingHomeVectorEnv(StageVectorEnv):
    """Vector environment stage/DriftingHome-v1: repeat origin returns on machines that drift and may have a fault."""

    task = DriftingHome
