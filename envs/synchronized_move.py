"""`stage/SynchronizedMove-v0`: choose the registers that bring two or three axes along a straight line together.

A step is one whole move of random signed distances, from rest to rest. The middle of the move is the middle of the travel, up to
the angles of the rotors at the start, which are drawn over an electrical turn. How the axes are kept on the line depends on the
family: its line programs in stage/firmware write the registers and start the axes.
    PCL-240           the a:b scheme. Nothing couples the chips except their registers, R0 and R1 to R7 of each, and their start
                      commands, a bus cycle apart, the longest axis last: they deviate from the line by their different rounding.
    MCX514, MCX312    linear interpolation by the chip if it has all axes; it takes the speeds of one axis and all finish points.
    MCX304, MCX302    the a:b scheme by ranges: R in inverse ratio to the distances. The axes of a chip start at one clock. An
                      MCX312 with axes on two chips does the same.
    others            as the `lines` of their driver define it, for example by velocities and accelerations in the ratio of the
                      distances.

action        flat, the registers of the first axis, then of the next: PCL-240 R1 R2 R4 R5 R6 R7, MCX304 and MCX302 R SV V A, with
              S-curves K. A chip that interpolates has one row for all axes: MCX514 SV DV AC, with S-curves JK, MCX312 SV V A,
              with K. Distances and finish points are those of the move. Setting `actions`:
              "corrections"  Box [-1, 1]: counts added to the data sheet's a:b registers
                             (`compute_data_sheet_registers`); 0 is the engineer's answer. A correction of 1 is the number of
                             counts (at least one) that moves the axis by `reach` pulses along the line. For R7 it is
                             `multiplier_reach` counts; the other registers are computed for that R7, and the ramp times of all
                             axes for that of the longest. If the chip interpolates, factors from 1/2 to 2.
              "box"          Box [-1, 1]: the registers, see register_scaling.py
              "registers"    MultiDiscrete: the registers themselves
observation   float32, -1 to 1. 0: rate on a log scale over its range (0 if it is fixed). Then for each axis
              0 signed distance / longest distance possible; and by how many pulses (/ 2 `reach`, clipped) the data sheet's
              registers take the axis off its share of the longest axis' pulses, by the closed form: 1 ahead after the ramp-up,
              2 further ahead at the ramp-down, 3 ramp-down earlier, 4 ramp-down shorter; 0 if the chip interpolates.
              Last, of the move before (0 at first): path deviation / `far`, carriage deviation / (itself + 0.1 mm),
              duration / `limit`, 1 if it was finished.
reward        the sum of
              path       - path_weight x largest distance between the pulse counts and the line, pulses, at most `far`;
                         `far` if the move was not finished. Copies of the chips are run to compute it.
              carriages  - carriage_weight x largest distance between the carriages and the line / 0.1 mm, at most 10,
                         sampled `looks` times from the first start to `settle` after the last pulse
              time       - time_weight x seconds from the first start command to the last pulse, at most `limit`
              lost       - lost_weight if an axis lost a full step
              limit      - limit_weight if the move was not finished: an end limit, or the time limit
episode       `moves` moves, one by default, then terminated. A move that was not finished also ends it. No time limit truncates it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from stage import Stage
from stage.chips import Chip, chip_class
from stage.envs import settings
from stage.envs.move_trials import StartPositions
from stage.envs.observation_features import HOST, TRUTH, Feature
from stage.envs.register_scaling import RegisterBox
from stage.envs.scaling import scale_log
from stage.envs.stage_env import StageEnv, StageVectorEnv
from stage.envs.task import MoveTask
from stage.errors import ArgumentError, unknown_name_error
from stage.firmware.driver import get_driver
from stage.firmware.line_programs import LineMoves, create_line_programs
from stage.firmware.path_deviation import compute_path_deviation
from stage.sim.engine_records import compute_clock_at
from stage.sim.fleet import PlayedPrograms
from stage.sim.program import SAMPLE_POSITION, WAIT
from stage.support import portable_math

ACTIONS = ("corrections", "box", "registers")
DISPLACEMENT_SCALE_M = 1e-4  # m


@dataclass(frozen=True)
class Config(settings.Settings):
    """Settings of SynchronizedMove.

    Attributes:
        model: Name of the model.
        chip: Name or class of the chip.
        axes: Names of the axes.
        actions: "corrections" of the data sheet's registers, "box" or "registers"; see the module.
        distances: Smallest and largest distance of each axis, pulses, drawn evenly by their logarithm, with a random sign.
        rate: Peak rate of the longest axis by the data sheet, pps: a number, or a range from which it is drawn in the same way.
        fl: Start rate of the longest axis, pps.
        accel: Duration of both ramps, s.
        s_curve: Whether all ramps are S-curves (PCL240MS and NOVA chips).
        reach: Distance along the line that a correction of 1 adds or removes, pulses.
        multiplier_reach: Counts of R7 that a correction of 1 adds.
        moves: Number of moves in an episode.
        limit: Longest simulated time of a move, s.
        settle: Simulated time after the last pulse until which the carriages are observed, s.
        looks: Number of samples of the carriages in a move.
        far: Largest path deviation that counts, pulses.
        path_weight: Cost of a pulse of path deviation.
        carriage_weight: Cost of 0.1 mm between the carriages and the line.
        time_weight: Cost of a simulated second.
        lost_weight: Cost of a move in which an axis loses a full step.
        limit_weight: Cost of a move that is not finished.
        bus_cycle: Duration of a bus cycle, s.
        truth: Whether observation and info have values that no host can know: True (both), "info" (info alone), False (neither).
    """

    model: str = "xyz"
    chip: str | type[Chip] = "PCL240K"
    axes: Annotated[tuple[str, ...], settings.NamesSetting(2)] = ("x", "y")
    actions: Annotated[str, settings.ChoiceSetting(ACTIONS)] = "corrections"
    distances: settings.CountRange = (4_000, 20_000)
    rate: Annotated[float | settings.Pair, settings.NumberOrRangeSetting(further_condition=", not below fl")] = (
        8_000.0,
        32_000.0,
    )
    fl: settings.PositiveNumber = 1_000.0
    accel: settings.Seconds = 0.1
    s_curve: settings.Boolean = False
    reach: settings.PositiveNumber = 4.0
    multiplier_reach: Annotated[int, settings.NumberSetting(integer=True)] = 1
    moves: settings.Count = 1
    limit: settings.Seconds = 4.0
    settle: settings.Seconds = 0.05
    looks: settings.Count = 100
    far: settings.PositiveNumber = 20.0
    path_weight: settings.Weight = 1.0
    carriage_weight: settings.Weight = 1.0
    time_weight: settings.Weight = 1.0
    lost_weight: settings.Weight = 10.0
    limit_weight: settings.Weight = 10.0
    bus_cycle: settings.BusCycleSeconds = 1e-6
    truth: settings.TruthOption = True

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "axes", tuple(self.axes))
        if not 0 < self.fl <= self.rates[0] <= self.rates[1] < np.inf:
            raise ArgumentError(
                f"fl={self.fl!r}, rate={self.rate!r}: a rate or (least, most), not below fl, which is above 0."
            )

    @property
    def rates(self) -> tuple[float, float]:
        """Smallest and largest peak rate of the longest axis, pps."""
        low, high = self.rate if isinstance(self.rate, tuple | list) else (self.rate, self.rate)
        return float(low), float(high)


LINE_FEATURES = (
    Feature(
        "deviation",
        HOST,
        "pulses off the line, which follow from the registers; infinite if not finished",
        kind=float,
    ),
    Feature("carriage_deviation", TRUTH, "m off the line", kind=float),
    Feature("duration", HOST, "s", kind=float),
)
"""Features of an info that describe how well and how fast a move followed its line."""
END_FEATURES = (
    Feature("lost_steps", TRUTH, "full steps of each axis", kind=int),
    Feature("finished", HOST, "all axes made their pulses", kind=bool),
)
"""Features of an info that describe how a move of several axes ended."""


class SynchronizedMove(MoveTask[Config]):
    """Rules of stage/SynchronizedMove-v0. The module docstring states them."""

    Config: ClassVar[type] = Config
    OPTIONS: ClassVar[tuple[str, ...]] = ("distances", "rate")
    PARTS: ClassVar[tuple[str, ...]] = ("path", "carriages", "time", "lost", "limit")
    STATE: ClassVar[tuple[str, ...]] = ("distances", "rate", "last")
    OBSERVATION: ClassVar[tuple[Feature, ...]] = (
        Feature("rate", HOST, "by its logarithm from -1 to 1 over `rate`; 0 if it is fixed"),
        Feature("distance", HOST, "signed distance / longest distance possible", "axis"),
        Feature("ahead", HOST, "by the closed form, pulses / 2 `reach`: ahead of its share after the ramp-up", "axis"),
        Feature("more_ahead", HOST, "in the same unit: further ahead at the ramp-down", "axis"),
        Feature("earlier", HOST, "in the same unit: by how much the ramp-down begins earlier", "axis"),
        Feature("shorter", HOST, "in the same unit: by how much the ramp-down is shorter", "axis"),
        Feature("last_deviation", HOST, "path deviation of the last move / `far`"),
        Feature("last_carriages", TRUTH, "its carriage deviation / (carriage deviation + 0.1 mm)"),
        Feature("last_duration", HOST, "its duration / `limit`"),
        Feature("last_finished", HOST, "1 if it was finished"),
    )
    INFO: ClassVar[tuple[Feature, ...]] = (
        *LINE_FEATURES,
        *END_FEATURES,
        Feature("distances", HOST, "pulses of each axis; in the info of a reset, those of the next move", kind=int),
        Feature("rate", HOST, "pps; in the info of a reset, that of the next move", kind=float),
        Feature("registers", HOST, "registers of the action", kind=int),
    )

    def make_stage(self, visuals: bool) -> Stage:
        c = self.config
        new_stage = Stage(c.model, chips=chip_class(c.chip), bus_cycle=c.bus_cycle, visuals=visuals)
        for name in c.axes:
            if name not in new_stage.axes:
                raise unknown_name_error("axis", name, new_stage.axes)
            if new_stage.axes[name].unit != "m":
                raise ArgumentError(f"axes={c.axes!r}: {name} turns, and a line is of slides.")
        return new_stage

    def make_spaces_and_arrays(self) -> None:
        c, first = self.config, self.stages[0]
        self.axes = [first.axes[name] for name in c.axes]
        self.index = [a.index for a in self.axes]
        self.signed_pulse_m = np.array([a.meters_per_pulse * np.sign(a.gear) for a in self.axes])
        self.line = create_line_programs([get_driver(a) for a in self.axes], c)
        self.hz = self.line.clock_hz
        self.start_positions = [StartPositions(a) for a in self.axes]
        for starts in self.start_positions:
            starts.require_room(c.distances, "pulses")
        if c.rates[1] > self.line.max_rate:
            raise ArgumentError(f"rate={c.rate!r}: up to {self.line.max_rate:.0f} pps here.")
        self.registers = RegisterBox.of_registers(self.line.chip.MAP, self.line.names * self.line.shape[0])
        self.action_space = self.registers.discrete if c.actions == "registers" else self.registers.box
        m = len(self.axes)
        self.observation_space = self.make_observation_space()
        self.shapes = {"distances": (m,), "lost_steps": (m,), "registers": self.line.shape}
        self.distances = np.ones((self.n, m), np.int64)
        self.rate, self.last = np.full(self.n, c.rates[0]), np.zeros((self.n, 4))
        self.path, self.seconds = np.zeros(self.n), np.zeros(self.n)

    def list_all_features(self) -> list[Feature]:
        rate, *of_moves = self.OBSERVATION
        of_axes, of_the_last = of_moves[:5], of_moves[5:]
        return [rate, *of_axes * len(self.axes), *of_the_last]

    def begin_episode(self, stage_index: int, options: Mapping[str, Any]) -> None:
        self.last[stage_index] = 0.0
        self._draw_move(stage_index, options)

    def describe_episode(self, stage_index: int) -> dict[str, Any]:
        return {"distances": self.distances[stage_index].copy(), "rate": float(self.rate[stage_index])}

    def prepare_next_step(self) -> None:
        for k in np.flatnonzero(self.undiverged_stages & ~self.results["terminated"]):
            self._draw_move(int(k), {})

    def _draw_move(self, stage_index: int, options: Mapping[str, Any]) -> None:
        """Draw the next move of a stage, and put its carriages at the start, with random angles of the rotors.

        Args:
            stage_index: Index of the stage.
            options: Options of the reset, which replace drawn values.
        """
        c, rng = self.config, self.rngs[stage_index]
        low, high = portable_math.log(c.distances)
        sizes = np.rint(portable_math.exp(rng.uniform(low, high, len(self.axes)))).astype(np.int64)
        self.distances[stage_index] = sizes * rng.choice([-1, 1], len(self.axes))
        self.rate[stage_index] = np.clip(portable_math.exp(rng.uniform(*portable_math.log(c.rates))), *c.rates)
        self._apply_options(stage_index, options)
        angles = rng.uniform(size=len(self.axes))
        begin = zip(self.start_positions, self.distances[stage_index].tolist(), angles.tolist(), strict=True)
        self.stages[stage_index].place(**{s.axis.name: s.find_start(d, angle) for s, d, angle in begin})

    def _apply_options(self, stage_index: int, options: Mapping[str, Any]) -> None:
        """Replace the drawn rate and distances of a stage by those of the options. Raises ArgumentError for values out of range."""
        c, names = self.config, self.config.axes
        if (rate := options.get("rate")) is not None:
            if not isinstance(rate, int | float | np.number) or not c.rates[0] <= rate <= c.rates[1]:
                raise ArgumentError(f"option rate={rate!r}: from {c.rates[0]:g} to {c.rates[1]:g} pps.")
            self.rate[stage_index] = rate
        if (given := options.get("distances")) is not None:
            low, high = c.distances
            if (
                not isinstance(given, Mapping)
                or set(given) != set(names)
                or not all(isinstance(d, int | np.integer) and low <= abs(int(d)) <= high for d in given.values())
            ):
                raise ArgumentError(
                    f"option distances={given!r}: whole pulses, {low} to {high} either way, for {names}."
                )
            self.distances[stage_index] = [given[name] for name in names]

    # --- registers ---

    @property
    def requested_lines(self) -> LineMoves:
        """Lines of all stages, each with its distances and its rate."""
        return LineMoves(self.distances, self.rate)

    def compute_data_sheet_registers(self) -> np.ndarray:
        """Compute the registers of the present moves by the formulas of the data sheet, (stages, *line.shape)."""
        return self.line.compute_registers(self.requested_lines)

    def to_registers(self, actions: np.ndarray) -> np.ndarray:
        """Convert actions to registers, (stages, *line.shape)."""
        shape = (len(actions), *self.line.shape)
        if self.config.actions == "registers":
            return actions.astype(np.int64).reshape(shape)
        if self.config.actions == "box":
            return self.registers.from_action(actions).reshape(shape)
        return self.line.apply_corrections(self.requested_lines, actions.astype(np.float64).reshape(shape))

    # --- the move ---

    def make_programs(self) -> np.ndarray:
        c = self.config
        registers = self.to_registers(self.actions)
        moves = self.line.write_programs(registers, self.requested_lines)
        self._truth_at_start = self.fleet.truth()[:, self.index]
        self.fleet.run_on_threads(lambda low, high: self._measure_paths(low, high, moves))
        length = np.minimum(self.seconds + self.line.compute_last_pulse_seconds(registers), c.limit) + c.settle
        every = 1 + len(self.index)  # operations of a sample: a wait, and one for each axis
        samples = np.zeros((self.n, c.looks, every, 4), np.int64)
        samples[:, :, 0, 0] = WAIT
        samples[:, :, 0, 1] = np.ceil(length * (1e9 / c.looks))[:, None]
        samples[:, :, 1:, 0], samples[:, :, 1:, 1] = SAMPLE_POSITION, self.index
        self._sample_slices = [slice(moves.shape[1] + 1 + a, None, every) for a in range(len(self.index))]
        return np.concatenate([moves, samples.reshape(self.n, -1, 4)], axis=1)

    def _measure_paths(self, low: int, high: int, moves: np.ndarray) -> None:
        """Measure the path deviation and the duration of moves by running copies of the chips.

        Args:
            low: First stage.
            high: Stage after the last one.
            moves: Programs of the moves, (stages, operations, 4).
        """
        cycle = round(self.config.bus_cycle * 1e9)
        for k in np.flatnonzero(self.active[low:high]) + low:
            began = (
                int(self._truth_at_start[k, 0]["now"])
                + (self.line.find_start_operations(self.distances[k]) + 1) * cycle
            )
            starts = [compute_clock_at(now, self.hz) for now in began.tolist()]
            paths = self.line.trace_pulses(moves[k], self.distances[k])
            paths = [t + (start - min(starts)) for t, start in zip(paths, starts, strict=True)]
            self.path[k] = compute_path_deviation([(t, 1) for t in paths], np.abs(self.distances[k])).pulses
            self.seconds[k] = max(float(t[-1]) for t in paths) / self.hz

    def judge(self, played: PlayedPrograms, truth: np.ndarray) -> None:
        c, t = self.config, truth[:, self.index]
        moved_pulses = t["pulses"] - self._truth_at_start["pulses"]
        finished = ((moved_pulses == self.distances) & (t["busy"] == 0)).all(axis=1)
        lost = t["lost_steps"] - self._truth_at_start["lost_steps"]
        deviation, duration = np.where(finished, self.path, np.inf), np.where(finished, self.seconds, c.limit)
        off_line = self._measure_carriage_deviations(played.results)
        parts = {
            "path": -c.path_weight * np.minimum(deviation, c.far),
            "carriages": -c.carriage_weight * np.minimum(off_line / DISPLACEMENT_SCALE_M, 10.0),
            "time": -c.time_weight * duration,
            "lost": np.where((lost != 0).any(axis=1), -c.lost_weight, 0.0),
            "limit": np.where(finished, 0.0, -c.limit_weight),
        }
        info = {
            "deviation": deviation, "carriage_deviation": off_line, "duration": duration, "lost_steps": lost,
            "finished": finished, "distances": self.distances, "rate": self.rate,
            "registers": self.to_registers(self.actions),
        }  # fmt: skip
        now = [
            np.minimum(deviation / c.far, 1.0),
            off_line / (off_line + DISPLACEMENT_SCALE_M),
            duration / c.limit,
            finished * 1.0,
        ]
        good, over = self.undiverged_stages, self.steps >= c.moves
        self.last[good] = np.clip(np.nan_to_num(np.stack(now, axis=1)), 0.0, 1.0)[good]
        self.set_results(parts, info, over | ~finished, False)

    def _measure_carriage_deviations(self, results: np.ndarray) -> np.ndarray:
        """Return the largest distance between the carriages and their line in each move, m, (stages,).

        Args:
            results: Results of the programs, (stages, operations), with samples of the positions.
        """
        line = self.signed_pulse_m * self.distances
        length2, dot = np.zeros(self.n), np.zeros((self.n, self.config.looks))
        off = []
        for a, samples in enumerate(self._sample_slices):
            off.append(results[:, samples] * 1e-12 - self._truth_at_start["position"][:, a, None])
            length2 += line[:, a] ** 2
            dot += off[a] * line[:, a, None]
        along, squared_distance = np.clip(dot / length2[:, None], 0.0, 1.0), np.zeros_like(dot)
        for a in range(len(off)):
            squared_distance += (off[a] - along * line[:, a, None]) ** 2
        return np.sqrt(squared_distance.max(axis=1))

    def compute_observations(self) -> np.ndarray:
        c = self.config
        rate = scale_log(self.rate, c.rates) if c.rates[1] > c.rates[0] else np.zeros(self.n)
        of_axes = np.concatenate(
            [
                (self.distances / c.distances[1])[:, :, None],
                self.line.compute_line_errors(self.requested_lines) / (2 * c.reach),
            ],
            axis=2,
        )
        observations = np.concatenate([rate[:, None], of_axes.reshape(self.n, -1), self.last], axis=1)
        return np.clip(observations, -1.0, 1.0).astype(np.float32)


class SynchronizedMoveEnv(StageEnv):
    """Gymnasium environment stage/SynchronizedMove-v0: choose registers with which axes move along a straight line."""

    task = SynchronizedMove


class SynchronizedMoveVectorEnv(StageVectorEnv):
    """Vector environment stage/SynchronizedMove-v0: choose registers with which axes move along a straight line."""

    task = SynchronizedMove
