"""What a trial measures. An objective is a function of an Optuna trial; here is one that is made of preset moves.

objective = PresetMoves(pulses=8000)
objective.measure({"R1": 20, "R2": 640, "R4": 400, "R5": 400, "R7": 12}, seed=1)      without Optuna
optuna.create_study().optimize(objective, n_trials=100)                               with
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from stage import Stage, firmware
from stage.chips import chip_class
from stage.chips.pcl240 import PCL240
from stage.errors import ArgumentError, unknown_name_error
from stage.firmware import Profile
from stage.support.argument_checks import explain_arguments, explain_constructor

if TYPE_CHECKING:
    from optuna import Trial

SAMPLE_INTERVAL_S = 0.25e-3  # s between samples
FAILURE_PENALTY_S = 10.0  # s of score for a move that did not do as asked
START_SPREAD_M = 1e-4  # m, by which the start is drawn
MEASURE_NAMES = "score", "duration", "lost_steps", "reached", "vibration"


Space = Mapping[str, str | int]
"""What each register takes: 12 | "10,20,40" | "400:2800" | "60:800:log", a range looked for evenly on a log scale."""

SPACE: Space = {"R1": "4:100:log", "R2": "400:2800", "R4": "60:800:log", "R5": "60:800:log", "R7": 12}
"""A space to search: 0.2 to 5 kpps of FL, 20 to 140 kpps of FH1, ramps of 5 ms to 0.45 s."""

_local = threading.local()


class Range(NamedTuple):
    """Every whole number from low to high."""

    low: int
    high: int
    log: bool


def parse_values(name: str, text: str | int) -> Range | tuple[int, ...]:
    """Return the values that a register may take, by its text in a space.

    Raises:
        ArgumentError: The text is no value, no list of values and no range.
    """
    try:
        if ":" not in str(text):
            values = tuple(int(v) for v in str(text).split(","))
            if min(values) < 0:
                raise ValueError
            return values
        low, high, *log = str(text).split(":")
        span = Range(int(low), int(high), log == ["log"])
        if log not in ([], ["log"]) or not 0 <= span.low <= span.high or (span.log and not span.low):
            raise ValueError
        return span
    except ValueError:
        raise ArgumentError(
            f"{name}={text}: a register takes one value (12), some (10,20,40) or a range (400:2800, or 60:800:log evenly on a "
            f"log scale, from 1 up)."
        ) from None


@explain_arguments
def suggest_registers(trial: Trial, space: Space) -> dict[str, int]:
    """Return the register values of a trial; the trial's `params` hold them all.

    Raises:
        ArgumentError: A text of the space is no value, no list of values and no range.
    """
    registers = {}
    for name, text in space.items():
        values = parse_values(name, text)
        if isinstance(values, Range):
            registers[name] = trial.suggest_int(name, values.low, values.high, log=values.log)
        elif len(values) == 1:
            registers[name] = trial.suggest_int(name, values[0], values[0])
        else:
            registers[name] = trial.suggest_categorical(name, values)
    return registers


@explain_arguments
def derive_seed(trial: Trial, seed: int = 0) -> int:
    """Return a seed for whatever else a trial draws: it follows from `seed` and the number of the trial alone."""
    words = np.random.SeedSequence(seed, spawn_key=(trial.number, 1)).generate_state(1, np.uint64)[0]
    return int(words >> np.uint64(1))


@explain_constructor
@dataclass(frozen=True)
class PresetMoves:
    """Preset moves of one axis with a trial's R1, R2, R4, R5, R7 (R3: R2; R14, R15: spans of S-curves), one after the other.

    The start is random within 0.1 mm, by the trial's seed: the result does not depend on one rotor angle. R6 is by the data sheet.
    A trial's user attributes are its seed and all that `measure` returns.

    Args:
        space: what the registers take.
        goals: which measures to minimize; with several, a study finds their Pareto front.
        model, axis, chips: `xyz`, `x`, `pcl240k`; `pcl240mk`, `pcl240ms`, too.
        pulses: of one move, or of some, one after the other; with more than one a pruner may end a trial in between.
        start: m. band: m, the tool is quiet while within it of its place. rest: s of observation after a move; a camera on a mast
            needs 4.
        seed: of the seeds of the trials.
    Raises ArgumentError: a register or an option that is not known.
    """

    space: Space = field(default_factory=lambda: SPACE)
    goals: Sequence[str] = ("score",)
    model: str = "xyz"
    axis: str = "x"
    chips: str = "pcl240k"
    pulses: int | Sequence[int] = 16_000
    start: float = -0.13
    band: float = 20e-6
    rest: float = 0.3
    seed: int = 0

    def __post_init__(self) -> None:
        for goal in self.goals:
            if goal not in MEASURE_NAMES:
                raise unknown_name_error("goal", goal, MEASURE_NAMES)
        if not self.goals:
            raise ArgumentError(f"goals=(): one at least of {', '.join(MEASURE_NAMES)}.")
        if not issubclass(self._chip, PCL240):
            raise ArgumentError(
                f"chips={self.chips!r}: PresetMoves writes registers of the PCL-240 family: pcl240k, pcl240mk, pcl240ms. The "
                "environment stage/RegisterTuning-v0 tunes moves of any chip that has a driver."
            )
        check_registers(self.space, self._chip)
        for name, text in self.space.items():
            parse_values(name, text)
        stage, _ = _get_stage(self.model, self._chip)
        if self.axis not in stage.axes:
            raise unknown_name_error("axis", self.axis, stage.axes)

    @property
    def _chip(self) -> Any:
        return chip_class(str(self.chips))

    def __call__(self, trial: Trial) -> float | tuple[float, ...]:
        """Measure a trial of an Optuna study: its goals' values. Raises optuna.TrialPruned."""
        registers, seed = suggest_registers(trial, self.space), derive_seed(trial, self.seed)
        trial.set_user_attr("seed", seed)

        def report(move: int, measures: dict[str, float]) -> None:
            trial.report(measures[self.goals[0]], move)
            if trial.should_prune():
                from optuna import TrialPruned

                raise TrialPruned(f"after {move + 1} moves")

        alone = len(self.goals) == 1  # Optuna prunes by one goal only
        measured = self.measure(registers, seed, report if alone else lambda move, measures: None)
        for name, value in measured.items():
            trial.set_user_attr(name, value)
        return measured[self.goals[0]] if alone else tuple(measured[goal] for goal in self.goals)

    def measure(
        self,
        registers: Mapping[str, int],
        seed: int,
        report: Callable[[int, dict[str, float]], None] = lambda k, m: None,
    ) -> dict[str, float]:
        """Make the moves with these registers: the same arguments give the same bits, in whatever process or thread.

        Args:
            registers: Register values by name.
            seed: Seed of the place at which the moves begin.
            report: Called after each move but the last, with its index from 0 on and the measures so far.

        Returns:
            score: s from a move's start until the tool stays within `band` of its place, the mean of the moves; 10 s more for a
                move after which it does not within `rest`, or that loses steps or ends elsewhere.
            duration: s from the first pulse to the last, all moves. lost_steps: of all. reached: moves that ended as asked.
            vibration: m, the largest half swing of the tool after a stop.

        Raises:
            ArgumentError: A register value is not legal.
            SimulationError: The simulation diverged.
        """
        profile = build_profile(registers, self._chip)
        stage, begin = _get_stage(self.model, self._chip)
        stage.restore(begin)
        start = self.start + np.random.default_rng(seed).uniform(-START_SPREAD_M, START_SPREAD_M)
        stage.place(**{self.axis: start})
        stage.run(0.05)
        pulses = [self.pulses] if isinstance(self.pulses, int) else self.pulses
        moves: list[dict[str, float]] = []
        for count in pulses:
            if moves:
                report(len(moves) - 1, _combine_measures(moves))
            moves.append(_measure_move(stage, self.axis, profile, count, self.band, self.rest))
        return _combine_measures(moves)


def _combine_measures(moves: list[dict[str, float]]) -> dict[str, float]:
    columns = {name: [m[name] for m in moves] for name in moves[0]}
    return {
        "score": float(np.mean(columns["score"])),
        "duration": float(sum(columns["duration"])),
        "lost_steps": int(sum(np.abs(columns["lost_steps"]))),
        "reached": int(sum(columns["reached"])),
        "vibration": float(max(columns["vibration"])),
    }


def check_registers(names: Mapping[str, object], chip: Any) -> None:
    """Raise ArgumentError for a speed register that is missing or unknown."""
    known = {"R1", "R2", "R3", "R4", "R5", "R7"} | ({"R14", "R15"} if chip.S_CURVES else set())
    for name in names:
        if name not in known:
            raise unknown_name_error(f"{chip.MAP.chip} speed register", name, known)
    if missing := sorted({"R1", "R2", "R4", "R5", "R7"} - set(names)):
        raise ArgumentError(
            f"a preset move needs {', '.join(missing)}, too: give one value at least, for example R7=12."
        )


def build_profile(registers: Mapping[str, int], chip: Any) -> Profile:
    """Return the speed registers as a Profile.

    Raises:
        ArgumentError: A register is missing or unknown.
    """
    check_registers(registers, chip)
    speeds = {k: v for k, v in registers.items() if k not in ("R14", "R15")}
    curved = "R14" in registers or "R15" in registers
    spans = (registers.get("R14", 0), registers.get("R15", 0)) if curved else None
    return Profile(**({"R3": registers["R2"]} | speeds), spans=spans, chip=chip)


def _get_stage(model: str, chip: Any) -> tuple[Stage, Any]:
    """Return a stage of this thread, and its snapshot at power-up."""
    stages = _local.__dict__.setdefault("stages", {})
    if (model, chip) not in stages:
        stage = Stage(model, chips=chip)
        stages[model, chip] = stage, stage.snapshot()
    return stages[model, chip]


def _measure_move(stage: Stage, name: str, profile: Profile, pulses: int, band: float, rest: float) -> dict[str, float]:
    axis: Any = stage.axes[name]
    goal = axis.commanded + pulses * axis.meters_per_pulse * np.sign(axis.gear)
    with stage.record(every=SAMPLE_INTERVAL_S) as recording:
        began = stage.time
        report = firmware.preset_move(axis, pulses, profile)
        stage.run(rest)
    seconds = recording.column("time") - began - report.began
    tool = recording.column(f"{name}/position") - goal + _measure_deflection(stage, recording, name)
    after = tool[seconds >= report.duration]
    outside = np.flatnonzero(abs(tool) > band)
    quiet = outside[-1] + 1 < len(tool) if len(outside) else True
    settled = seconds[min(outside[-1] + 1, len(tool) - 1)] if len(outside) else 0.0
    return {
        "score": max(float(settled), report.duration) + (0.0 if quiet and report.ok else FAILURE_PENALTY_S),
        "duration": report.duration,
        "lost_steps": report.lost_steps or 0,
        "reached": int(report.ok),
        "vibration": float(np.ptp(after)) / 2,
    }


def _measure_deflection(stage: Stage, recording: Any, name: str) -> Any:
    """Return how far the camera of xy_mast is off its carriage, m; 0 on stages without one."""
    joints = [stage.model.joint(k) for k in range(stage.model.njnt)]
    at = [j.qposadr[0] for j in joints if j.name == f"camera_{name}"]
    if not at:
        return 0.0
    return np.concatenate([piece["qpos"][:, at[0]] for piece in recording.pieces()])
