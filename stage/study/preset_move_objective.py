"""An Optuna objective that makes preset moves with the register values of a trial and scores them.

objective = PresetMoves(pulses=8000)
objective.measure({"R1": 20, "R2": 640, "R4": 400, "R5": 400, "R7": 12}, seed=1)      without Optuna
optuna.create_study().optimize(objective, n_trials=100)                               with Optuna
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

_thread_stages = threading.local()


class RegisterRange(NamedTuple):
    """Whole numbers from `low` to `high`, both inclusive; `log`: sampled evenly on a logarithmic scale."""

    low: int
    high: int
    log: bool


def parse_register_values(name: str, text: str | int) -> RegisterRange | tuple[int, ...]:
    """Return the values that a register may take.

    Args:
        name: Name of the register, for errors.
        text: A value, a list of values or a range, in the form of a `Space`.

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
        span = RegisterRange(int(low), int(high), log == ["log"])
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
    """Let Optuna choose the register values of a trial.

    Every register is a parameter of the trial, even one with a single possible value.

    Args:
        trial: Optuna trial.
        space: Possible values of each register.

    Returns:
        Values by the names of the registers.

    Raises:
        ArgumentError: A text of the space is no value, no list of values and no range.
    """
    registers = {}
    for name, text in space.items():
        values = parse_register_values(name, text)
        if isinstance(values, RegisterRange):
            registers[name] = trial.suggest_int(name, values.low, values.high, log=values.log)
        elif len(values) == 1:
            registers[name] = trial.suggest_int(name, values[0], values[0])
        else:
            registers[name] = trial.suggest_categorical(name, values)
    return registers


@explain_arguments
def derive_seed(trial: Trial, seed: int = 0) -> int:
    """Return a seed for everything random in a trial except its parameters.

    It depends only on `seed` and the number of the trial.
    """
    words = np.random.SeedSequence(seed, spawn_key=(trial.number, 1)).generate_state(1, np.uint64)[0]
    return int(words >> np.uint64(1))


@explain_constructor
@dataclass(frozen=True)
class PresetMoves:
    """Optuna objective: one or more preset moves of an axis with the R1, R2, R4, R5 and R7 of a trial.

    R3 equals R2, R6 follows the data sheet, and on chips with S-curves R14 and R15 are their spans. The start position is random
    within 0.1 mm, so that the result does not depend on one rotor angle. The user attributes of a trial are its seed and all
    results of `measure`.

    Args:
        space: Possible values of each register.
        goals: Names of the measures to minimize. With several goals a study finds their Pareto front.
        model: Name of the model.
        axis: Name of the axis.
        chips: Name of the chip: pcl240k, pcl240mk or pcl240ms.
        pulses: Pulses of the move, or of each of several successive moves. With several moves a pruner may end a trial between
            them.
        start: Nominal start position, m.
        band: The tool is quiet while it is within this distance of its final position, m.
        rest: Time of observation after each move, s; a camera on a mast needs 4 s.
        seed: Seed from which the seeds of the trials follow.

    Raises:
        ArgumentError: A register, a goal or an axis does not exist, or the chip is of another family.
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
        check_speed_registers(self.space, self._chip)
        for name, text in self.space.items():
            parse_register_values(name, text)
        stage, _ = _get_thread_stage(self.model, self._chip)
        if self.axis not in stage.axes:
            raise unknown_name_error("axis", self.axis, stage.axes)

    @property
    def _chip(self) -> Any:
        return chip_class(str(self.chips))

    def __call__(self, trial: Trial) -> float | tuple[float, ...]:
        """Measure a trial and return the value of its goal, or a tuple of values if there are several goals.

        Raises:
            optuna.TrialPruned: The pruner of the study ends the trial.
        """
        registers, seed = suggest_registers(trial, self.space), derive_seed(trial, self.seed)
        trial.set_user_attr("seed", seed)

        def report(move: int, measures: dict[str, float]) -> None:
            """Report the measures after a move to Optuna, and end the trial if the pruner decides so."""
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
        """Make the moves with these registers. Equal arguments give equal results, bit for bit, in any process or thread.

        Args:
            registers: Register values by name.
            seed: Seed of the random start position.
            report: Function that is called after each move except the last one, with the index of the move (from 0) and the
                measures so far.

        Returns:
            score: mean time from the start of a move until the tool stays within `band`, s; plus 10 s for each move that loses
                steps, ends elsewhere, or after which the tool is not quiet within `rest`.
            duration: time from the first pulse to the last, summed over the moves, s. lost_steps: sum over the moves.
            reached: number of moves that ended at their target. vibration: largest half swing of the tool after a stop, m.

        Raises:
            ArgumentError: A register value is not legal.
            SimulationError: The simulation diverged.
        """
        profile = build_profile(registers, self._chip)
        stage, begin = _get_thread_stage(self.model, self._chip)
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
    """Combine the measures of single moves into those of a trial."""
    columns = {name: [m[name] for m in moves] for name in moves[0]}
    return {
        "score": float(np.mean(columns["score"])),
        "duration": float(sum(columns["duration"])),
        "lost_steps": int(sum(np.abs(columns["lost_steps"]))),
        "reached": int(sum(columns["reached"])),
        "vibration": float(max(columns["vibration"])),
    }


def check_speed_registers(names: Mapping[str, object], chip: Any) -> None:
    """Raise ArgumentError if a speed register is missing, or a name is not one of the chip's speed registers."""
    known = {"R1", "R2", "R3", "R4", "R5", "R7"} | ({"R14", "R15"} if chip.S_CURVES else set())
    for name in names:
        if name not in known:
            raise unknown_name_error(f"{chip.MAP.chip} speed register", name, known)
    if missing := sorted({"R1", "R2", "R4", "R5", "R7"} - set(names)):
        raise ArgumentError(
            f"a preset move needs {', '.join(missing)}, too: give one value at least, for example R7=12."
        )


def build_profile(registers: Mapping[str, int], chip: Any) -> Profile:
    """Build the Profile that has these values of the speed registers.

    Raises:
        ArgumentError: A register is missing or unknown.
    """
    check_speed_registers(registers, chip)
    speeds = {k: v for k, v in registers.items() if k not in ("R14", "R15")}
    curved = "R14" in registers or "R15" in registers
    spans = (registers.get("R14", 0), registers.get("R15", 0)) if curved else None
    return Profile(**({"R3": registers["R2"]} | speeds), spans=spans, chip=chip)


def _get_thread_stage(model: str, chip: Any) -> tuple[Stage, Any]:
    """Return the stage that this thread uses for a model and a chip, and the stage's snapshot at power-up."""
    stages = _thread_stages.__dict__.setdefault("stages", {})
    if (model, chip) not in stages:
        stage = Stage(model, chips=chip)
        stages[model, chip] = stage, stage.snapshot()
    return stages[model, chip]


def _measure_move(stage: Stage, name: str, profile: Profile, pulses: int, band: float, rest: float) -> dict[str, float]:
    """Make one preset move and return its measures."""
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
    """Return the deflection of the camera on xy_mast from its carriage at each sample, m; 0 for stages without a mast."""
    joints = [stage.model.joint(k) for k in range(stage.model.njnt)]
    at = [j.qposadr[0] for j in joints if j.name == f"camera_{name}"]
    if not at:
        return 0.0
    return np.concatenate([piece["qpos"][:, at[0]] for piece in recording.pieces()])
