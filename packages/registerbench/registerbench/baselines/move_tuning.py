"""One move that searches tune: the moves with chosen registers, their log, the proof of the best ones, and the command line.

The task is `stage/RegisterTuning-v0` with one distance and one payload, as on a test bench: each move begins at another angle of
the rotor, and its payload varies by up to 3 %. A move is an episode of one step, and a budget is a number of moves. A method
chooses an array in [-1, 1]^n, in one of two spaces:

registers   the action of the environment: R1, R2, R4, R5, R6 and R7 of a PCL-240, each over its legal range
knobs       factors on the formula's answer, where 0 means a factor of 1: FL, FH and acceleration, for a PCL-240 also deceleration
            and ramp-down point; the chip's formulas convert them to registers (formula_knobs.py)

Any chip with a host driver (`stage.firmware.driver`) can be tuned, for example with --chip MCX514.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import gymnasium
import numpy as np

from registerbench.baselines.formula_knobs import FormulaKnobs
from stage import Stage
from stage.chips import CHIPS, chip_class
from stage.envs.register_scaling import RegisterBox
from stage.envs.register_tuning import RegisterTuning
from stage.envs.stage_env import StageVectorEnv
from stage.firmware.driver import get_driver

DISTANCE_PULSES = 32_000  # pulses; 100 mm on the default stage
PAYLOADS_KG = {"light": 0.5, "heavy": 10.0}  # kg on the table of the X axis
TURN = 64  # pulses of an electrical turn: distances vary by up to +-TURN, starting positions by up to +-TURN / 2
PAYLOAD_TOLERANCE = 0.03  # share by which the payload varies
MAX_MOVE_TIME_S = 1.0  # s, longest duration of a move; twice what the formula needs
BUDGET = 1_024  # moves
PARALLEL_ENVS = 16  # moves made at once
CHIP, MODEL = "PCL240K", "xyz"
CANDIDATES, REPEATS, PROOF_SEED = 100, 48, 99  # number of best moves that a proof repeats, and repetitions of each
PAYLOAD_MARGIN_KG = 0.5  # kg: the moves of a proof carry from 0 to PAYLOAD_MARGIN_KG beyond the payload
MAX_HOLDING_MOVES = 5  # moves that hold in their proof, of which the answer is the one with the highest mean reward
SPACES = ("registers", "knobs")


class BothDirectionsTuning(RegisterTuning):
    """RegisterTuning in which every second machine moves in the minus direction; used to test answers, not to find them."""

    def draw_distance(self, stage_index: int, options: Mapping[str, Any]) -> int:
        """Draw the distance of the next move; stages with an odd index move in the minus direction."""
        return super().draw_distance(stage_index, options) * (-1 if stage_index % 2 else 1)


class BothDirectionsVectorEnv(StageVectorEnv):
    """Vector environment of BothDirectionsTuning."""

    task = BothDirectionsTuning


@dataclass
class MoveLog:
    """Log of the moves of a search: a list for each measured quantity, with an entry for each move.

    Attributes:
        reward: Reward of the environment.
        duration: Seconds.
        lost: Full steps lost.
        vibration: Peak-to-peak vibration after the stop, m.
        in_step: Whether the move lost no step and made all its pulses.
        registers: Values of the tuned registers.
        drawn: Randomly drawn distance in pulses, payload in kg, and angle of the rotor in electrical turns.
    """

    reward: list[float] = field(default_factory=list)
    duration: list[float] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)
    vibration: list[float] = field(default_factory=list)
    in_step: list[bool] = field(default_factory=list)
    registers: list[list[int]] = field(default_factory=list)
    drawn: list[tuple[int, float, float]] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.reward)

    def append_move(self, *move: Any) -> None:
        """Append a move: one value for each attribute, in their order."""
        for f, value in zip(fields(self), move, strict=True):
            getattr(self, f.name).append(value)

    @property
    def ranking(self) -> list[int]:
        """Indices of the logged moves that kept step, the highest reward first."""
        return sorted(np.flatnonzero(self.in_step).tolist(), key=lambda k: -self.reward[k])

    def compute_best_rewards_so_far(self) -> np.ndarray:
        """Return the highest reward of a move that kept step, after each move; -inf before the first."""
        return np.maximum.accumulate(np.where(self.in_step, self.reward, -np.inf))


class MoveTuning:
    """Move with one payload that is repeated with other registers, `lanes` moves at a time.

    Args:
        payload: Mass on the table, kg.
        budget: Number of moves.
        space: "registers" or "knobs".
        distance: Length of the move, pulses.
        lanes: Number of moves made at once.
        seed: Seed of distances, payloads and rotor angles.
        chip: Name of the chip.
        model: Name of the model.
        max_extra_kg: Largest random mass on top of the payload, kg.
        min_distance: Shortest random distance, pulses; None: nearly equal distances.
        both_directions: Whether every second lane moves in the minus direction.

    Attributes:
        log: Moves so far.
        size: Number of values in a choice.
        env: Vector environment.
        registers: Registers that are tuned.
        axis: Axis that carries exactly the payload, for formulas.
    """

    def __init__(
        self,
        payload: float,
        budget: int = BUDGET,
        space: str = "knobs",
        distance: int = DISTANCE_PULSES,
        lanes: int = PARALLEL_ENVS,
        seed: int = 0,
        chip: str = CHIP,
        model: str = MODEL,
        max_extra_kg: float = 0.0,
        min_distance: int | None = None,
        both_directions: bool = False,
    ):
        self.payload, self.distance, self.budget, self.lanes, self.model = payload, distance, budget, lanes, model
        settings: dict[str, Any] = {
            "model": model,
            "chip": chip,
            "s_curve": False,
            "distances": (min_distance or distance - TURN, distance + TURN),
            "payloads": (payload * (1 - PAYLOAD_TOLERANCE), (payload + max_extra_kg) * (1 + PAYLOAD_TOLERANCE)),
            "moves": budget + lanes,
            "limit": MAX_MOVE_TIME_S,
        }
        self.env: Any = (
            BothDirectionsVectorEnv(num_envs=lanes, **settings)
            if both_directions
            else gymnasium.make_vec("stage/RegisterTuning-v0", lanes, "vector_entry_point", **settings)
        )
        self._seed = 1000 * seed
        self.restart()
        nominal = Stage(model, chips=chip_class(chip))
        nominal.set_payload(payload, self.env.unwrapped.task_instance.carrier)
        self.axis = nominal.axes["x"]
        self.registers = RegisterBox.of_registers(
            self.axis.chip.MAP, get_driver(self.axis).list_move_registers(s_curve=False)
        )
        self.knobs = FormulaKnobs(self.axis, distance) if space == "knobs" else None
        self.size = len(self.knobs.ranges) if self.knobs else len(self.registers)

    def restart(self) -> None:
        """Empty the log of moves, and restart the random draws with the same seed."""
        self.log = MoveLog()
        self.observation, _ = self.env.reset(seed=self._seed)

    @property
    def moves_left(self) -> int:
        """Number of moves that are left in the budget of the search."""
        return self.budget - len(self.log)

    def measure_rewards(self, choices: np.ndarray) -> np.ndarray:
        """Make a move for each of up to `lanes` choices.

        Args:
            choices: Choices from -1 to 1, (k, size).

        Returns:
            Rewards, (k,); NaN beyond the budget.
        """
        choices = np.clip(np.asarray(choices, float), -1, 1)
        if self.knobs:
            choices = np.stack([self.registers.to_action(self.knobs.compute_registers(row)) for row in choices])
        return self.measure_rewards_of_actions(choices)

    def measure_rewards_of_actions(self, actions: np.ndarray) -> np.ndarray:
        """Make a move for each action of the environment.

        Args:
            actions: Actions, (k, registers).

        Returns:
            Rewards, (k,); NaN beyond the budget.
        """
        n = min(len(actions), self.moves_left)
        rewards = np.full(len(actions), np.nan)
        if n:
            rows = np.resize(actions[:n].astype(np.float32), (self.lanes, len(self.registers)))
            self.observation, new_rewards, _, _, info = self.env.step(rows)
            rewards[:n] = new_rewards[:n]
            self._log_moves(new_rewards[:n], info, n)
        return rewards

    def _log_moves(self, rewards: np.ndarray, info: dict[str, Any], n: int) -> None:
        """Append the first n moves of a step to the log.

        Args:
            rewards: Rewards of the step, (lanes,).
            info: Info of the step.
            n: Number of moves that count.
        """
        parts = info["reward_parts"]
        in_step = (parts["lost"] == 0) & (parts["limit"] == 0) & (info["cause"] != "diverged")
        columns = rewards, info["duration"], info["lost_steps"], info["vibration"], in_step, info["registers"]
        drawn = zip(*(info[name][:n].tolist() for name in ("distance", "payload", "angle")), strict=True)
        for move in zip(*(column[:n].tolist() for column in columns), drawn, strict=True):
            self.log.append_move(*move)

    def close(self) -> None:
        self.env.close()

    def __enter__(self) -> MoveTuning:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def prove_rows(
    rows: Sequence[Sequence[int]],
    payload: float,
    distance: int = DISTANCE_PULSES,
    repeats: int = REPEATS,
    chip: str = CHIP,
    model: str = MODEL,
    margin: float = 0.0,
    needed: int = 1,
) -> list[MoveLog]:
    """Repeat moves with each row of registers, one row after the other, until `needed` rows have kept step in all repeats.

    A row holds if it loses no step in `repeats` moves from different rotor angles, with up to `margin` kg more. All rows make the
    same moves; a row ends with its first lost step.

    Args:
        rows: Rows of registers.
        payload: Mass on the table, kg.
        distance: Length of the move, pulses.
        repeats: Number of moves of a proof.
        chip: Name of the chip.
        model: Name of the model.
        margin: Mass beyond the payload, kg.
        needed: Number of rows that must hold.

    Returns:
        The moves of each row that was repeated.
    """
    proofs: list[MoveLog] = []
    with MoveTuning(
        payload, repeats, "registers", distance, seed=PROOF_SEED, chip=chip, model=model, max_extra_kg=margin
    ) as moves:
        for row in rows:
            moves.restart()
            action = moves.registers.to_action(np.array(row))
            while moves.moves_left and all(moves.log.in_step):
                moves.measure_rewards_of_actions(np.tile(action, (moves.lanes, 1)))
            proofs.append(moves.log)
            if sum(all(log.in_step) for log in proofs) == needed:
                break
    return proofs


def find_best_proof(proofs: Sequence[MoveLog]) -> int | None:
    """Return the index of the row of registers that holds with the highest mean reward in its proof; None if none holds."""
    holding = [k for k, log in enumerate(proofs) if all(log.in_step)]
    return max(holding, key=lambda k: float(np.mean(proofs[k].reward)), default=None)


def choose_answer(
    rows: Sequence[Sequence[int]],
    payload: float,
    distance: int = DISTANCE_PULSES,
    repeats: int = REPEATS,
    chip: str = CHIP,
    model: str = MODEL,
    margin: float = PAYLOAD_MARGIN_KG,
) -> tuple[int, MoveLog] | None:
    """Choose the answer of a method, by the same rule for all methods.

    Args:
        rows: Registers of its moves that kept step, the highest reward first.
        payload: Mass on the table, kg.
        distance: Length of the move, pulses.
        repeats: Number of moves of a proof.
        chip: Name of the chip.
        model: Name of the model.
        margin: Mass beyond the payload, kg.

    Returns:
        Index of the best of the first MAX_HOLDING_MOVES rows that hold, and the moves of its proof; None if no row holds.
    """
    proofs = prove_rows(rows, payload, distance, repeats, chip, model, margin, MAX_HOLDING_MOVES)
    which = find_best_proof(proofs)
    return None if which is None else (which, proofs[which])


def format_answer(
    log: MoveLog,
    names: Sequence[str],
    payload: float,
    distance: int,
    chip: str = CHIP,
    model: str = MODEL,
    margin: float = PAYLOAD_MARGIN_KG,
) -> str:
    """Choose the answer of a method by `choose_answer`, and format it as one line.

    Args:
        log: Moves of the method.
        names: Names of the registers.
        payload: Mass on the table, kg.
        distance: Length of the move, pulses.
        chip: Name of the chip.
        model: Name of the model.
        margin: Mass beyond the payload, kg.
    """
    candidates = log.ranking[:CANDIDATES]
    rows = [log.registers[k] for k in candidates]
    proven = choose_answer(rows, payload, distance, chip=chip, model=model, margin=margin) if rows else None
    if proven is None:
        failed = f"none of the best {len(candidates)} keeps step in every repetition"
        return f"{len(log)} moves, {np.mean(log.in_step):.0%} kept step; {failed}"
    k, again = candidates[proven[0]], proven[1]
    registers = " ".join(f"{n}={v}" for n, v in zip(names, log.registers[k], strict=True))
    return (
        f"{len(log)} moves, {np.mean(log.in_step):.0%} kept step. "
        f"Best that kept step in {len(again)} repetitions with up to {margin:g} kg more: number {k + 1}, "
        f"{np.mean(again.duration):.4f} s, {np.mean(again.vibration) * 1e6:.1f} um vibration; {registers}"
    )


def run_command_line(doc: str | None, searches: Mapping[str, Callable[[MoveTuning, int], None]]) -> None:
    """Run the command line of a module of searches: run one search, and print its answer.

    Args:
        doc: Description of the program.
        searches: Functions (moves, seed) by name.
    """
    parser = make_parser(doc)
    parser.add_argument("search", choices=searches)
    args = parser.parse_args()
    settings = {"seed": args.seed, "chip": args.chip, "model": args.model}
    with MoveTuning(args.payload, args.budget, args.space, args.distance, **settings) as moves:
        searches[args.search](moves, args.seed)
    print(
        format_answer(moves.log, moves.registers.names, args.payload, args.distance, args.chip, args.model, args.margin)
    )


def make_parser(doc: str | None, searches: bool = True, chips: bool = True) -> argparse.ArgumentParser:
    """Make a parser with the options that all baselines share.

    Args:
        doc: Description of the program.
        searches: Whether to add the options --budget, --seed and --space of a search.
        chips: Whether the chip is an option.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--payload", type=float, default=PAYLOADS_KG["light"], metavar="KG", help="mass on the table")
    parser.add_argument("--distance", type=int, default=DISTANCE_PULSES, metavar="PULSES", help="length of the move")
    if chips:
        parser.add_argument("--chip", choices=CHIPS, default=CHIP)
    parser.add_argument("--model", default=MODEL, metavar="NAME", help="model of the stage, or an MJCF file")
    parser.add_argument(
        "--margin",
        type=float,
        default=PAYLOAD_MARGIN_KG,
        metavar="KG",
        help="largest mass beyond the payload in the proof",
    )
    if searches:
        parser.add_argument("--budget", type=int, default=BUDGET, metavar="N", help="number of moves")
        parser.add_argument("--seed", type=int, default=0)
        parser.add_argument("--space", choices=SPACES, default="knobs", help="space of the choices")
    return parser
