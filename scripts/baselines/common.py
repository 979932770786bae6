"""What the baselines share: one move to be tuned, a log of the moves made, the proof of the best, and the command line.

The task is `stage/RegisterTuning-v0` with one distance and one payload, as a bench has them: each move begins at another angle of
the rotor and weighs up to 3 % more or less. A move is an episode of one step, and a budget is a number of moves. What a
method chooses is an array in [-1, 1]^n, of one of two spaces:

registers   the environment's own action: of a PCL-240 R1, R2, R4, R5, R6, R7, each over its legal range
knobs       factors on the data sheet's answer, 0 for 1: FL, FH, acceleration, of a PCL-240 also deceleration and ramp-down point;
            the chip's formulas make registers of them (formula.py)

Any chip that has a driver (`stage.firmware.driver`) can be tuned: --chip MCX514.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import formula
import gymnasium
import numpy as np

from stage import Stage
from stage.chips import CHIPS, chip_class
from stage.envs.registers import RegisterBox
from stage.firmware.driver import driver_of

DISTANCE = 32_000  # pulses, 100 mm on the default stage
PAYLOADS = {"light": 0.5, "heavy": 10.0}  # kg on the table of the X axis
TURN = 64  # pulses of an electrical turn: distances vary by so many, and places by half as many, more and less
TOLERANCE = 0.03  # of the payload
LIMIT = 1.0  # s, a move may take; twice what the formula needs
BUDGET = 1_024  # moves
LANES = 16  # moves made at once
CHIP, MODEL = "PCL240K", "xyz"
CANDIDATES, REPEATS, PROOF_SEED = 100, 48, 99  # a method's best moves that are tried again, and how often each
MARGIN = 0.5  # kg that every method's answer has beyond the payload
HELD = 5  # moves that hold, of which the best by its mean reward is the answer
SPACES = ("registers", "knobs")


@dataclass
class Log:
    """Every move made, in order: reward, s, full steps, m, and the registers. `kept`: no step lost, all pulses made."""

    reward: list[float] = field(default_factory=list)
    duration: list[float] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)
    vibration: list[float] = field(default_factory=list)
    kept: list[bool] = field(default_factory=list)
    registers: list[list[int]] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.reward)

    def note(self, *move: Any) -> None:
        """Append a move: a value for each field."""
        for f, value in zip(fields(self), move, strict=True):
            getattr(self, f.name).append(value)

    @property
    def ranking(self) -> list[int]:
        """Which moves kept step, the highest reward first."""
        return sorted(np.flatnonzero(self.kept).tolist(), key=lambda k: -self.reward[k])

    def curve(self) -> np.ndarray:
        """Of the best move so far: its duration, s, after each move; NaN before the first that kept step."""
        out, best = np.full(len(self), np.nan), -np.inf
        for k, (reward, kept) in enumerate(zip(self.reward, self.kept, strict=True)):
            better = kept and reward > best
            best = reward if better else best
            out[k] = self.duration[k] if better else out[k - 1] if k else np.nan
        return out


class Moves:
    """One move of one payload, made again and again with other registers, `lanes` at a time.

    Attributes: log; size, the numbers of a choice; env, the vector environment; registers, its RegisterBox; axis, with
    just the payload, for whoever reckons.
    """

    def __init__(
        self,
        payload: float,
        budget: int = BUDGET,
        space: str = "knobs",
        distance: int = DISTANCE,
        lanes: int = LANES,
        seed: int = 0,
        chip: str = CHIP,
        model: str = MODEL,
    ):
        self.payload, self.distance, self.budget, self.lanes, self.model = payload, distance, budget, lanes, model
        self.env: Any = gymnasium.make_vec(
            "stage/RegisterTuning-v0",
            num_envs=lanes,
            vectorization_mode="vector_entry_point",
            model=model,
            chip=chip,
            s_curve=False,
            distances=(distance - TURN, distance + TURN),
            payloads=(payload * (1 - TOLERANCE), payload * (1 + TOLERANCE)),
            moves=budget + lanes,
            limit=LIMIT,
        )
        self.observation, _ = self.env.reset(seed=1000 * seed)
        nominal = Stage(model, chips=chip_class(chip))
        nominal.set_payload(payload, self.env.unwrapped._task.carrier)
        self.axis = nominal.axes["x"]
        self.registers = RegisterBox(self.axis.chip.MAP, driver_of(self.axis).tuned_by(s_curve=False))
        self.knobs = formula.Knobs(self.axis, distance) if space == "knobs" else None
        self.size = len(self.knobs.ranges) if self.knobs else len(self.registers)
        self.log = Log()

    @property
    def left(self) -> int:
        """Moves that may still be made."""
        return self.budget - len(self.log)

    def make(self, choices: np.ndarray) -> np.ndarray:
        """Make a move for each of up to `lanes` choices, (k, size). Returns rewards, (k,); NaN beyond the budget."""
        choices = np.clip(np.asarray(choices, float), -1, 1)
        if self.knobs:
            choices = np.stack([self.registers.to_action(self.knobs.registers(row)) for row in choices])
        return self.make_actions(choices)

    def make_actions(self, actions: np.ndarray) -> np.ndarray:
        """The same of the environment's actions."""
        n = min(len(actions), self.left)
        rewards = np.full(len(actions), np.nan)
        if n:
            rows = np.resize(actions[:n].astype(np.float32), (self.lanes, len(self.registers)))
            self.observation, given, _, _, info = self.env.step(rows)
            rewards[:n] = given[:n]
            self._note(given[:n], info, n)
        return rewards

    def _note(self, rewards: np.ndarray, info: dict[str, Any], n: int) -> None:
        parts = info["reward_parts"]
        kept = (parts["lost"] == 0) & (parts["limit"] == 0) & (info["cause"] != "diverged")
        columns = rewards, info["duration"], info["lost_steps"], info["vibration"], kept, info["registers"]
        for move in zip(*(column[:n].tolist() for column in columns), strict=True):
            self.log.note(*move)

    def close(self) -> None:
        self.env.close()

    def __enter__(self) -> Moves:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def prove(
    rows: Sequence[Sequence[int]],
    payload: float,
    distance: int = DISTANCE,
    repeats: int = REPEATS,
    chip: str = CHIP,
    model: str = MODEL,
) -> tuple[int, Log] | None:
    """Make moves with each row of registers, `repeats` of them from as many angles of the rotor, until one row loses no step: which
    it is, and these moves. None: none did. payload: with the margin that the move is to have."""
    return next(iter(_proven(rows, payload, 1, distance, repeats, chip, model)), None)


def answer(
    rows: Sequence[Sequence[int]],
    payload: float,
    distance: int = DISTANCE,
    repeats: int = REPEATS,
    chip: str = CHIP,
    model: str = MODEL,
    margin: float = MARGIN,
) -> tuple[int, Log] | None:
    """The answer of a method, by the same rule for all. rows: its moves that kept step, the highest reward first.

    Of the first HELD that lose no step in `repeats` moves with `margin` kg more, the one with the highest mean reward in these:
    which it is, and these moves. None: none holds.
    """
    held = _proven(rows, payload + margin, HELD, distance, repeats, chip, model)
    return max(held, key=lambda h: float(np.mean(h[1].reward)), default=None)


def _proven(
    rows: Sequence[Sequence[int]], payload: float, most: int, distance: int, repeats: int, chip: str, model: str
) -> list[tuple[int, Log]]:
    """The first of these rows that lose no step in so many moves, `most` at most, with the moves."""
    held: list[tuple[int, Log]] = []
    with Moves(payload, repeats * len(rows), "registers", distance, seed=PROOF_SEED, chip=chip, model=model) as moves:
        for k, row in enumerate(rows):
            moves.log = Log()
            action = moves.registers.to_action(np.array(row))
            while len(moves.log) < repeats and all(moves.log.kept):
                moves.make_actions(np.tile(action, (moves.lanes, 1)))
            if all(moves.log.kept):
                held.append((k, moves.log))
            if len(held) == most:
                break
    return held


def told(
    log: Log,
    names: Sequence[str],
    payload: float,
    distance: int,
    chip: str = CHIP,
    model: str = MODEL,
    margin: float = MARGIN,
) -> str:
    """The answer of a method (see `answer`), in a line."""
    candidates = log.ranking[:CANDIDATES]
    rows = [log.registers[k] for k in candidates]
    proven = answer(rows, payload, distance, chip=chip, model=model, margin=margin) if rows else None
    if proven is None:
        return f"{len(log)} moves, {np.mean(log.kept):.0%} kept step; none of the best {len(candidates)} does so again and again"
    k, again = candidates[proven[0]], proven[1]
    registers = " ".join(f"{n}={v}" for n, v in zip(names, log.registers[k], strict=True))
    return (
        f"{len(log)} moves, {np.mean(log.kept):.0%} kept step. "
        f"Best that did in {len(again)} more with {margin:g} kg more: number {k + 1}, "
        f"{np.mean(again.duration):.4f} s, {np.mean(again.vibration) * 1e6:.1f} um vibration; {registers}"
    )


def run(doc: str | None, search: Callable[[Moves, int], None]) -> None:
    """The command line of a search: make the moves, tell the best."""
    args = arguments(doc).parse_args()
    made = {"seed": args.seed, "chip": args.chip, "model": args.model}
    with Moves(args.payload, args.budget, args.space, args.distance, **made) as moves:
        search(moves, args.seed)
    print(told(moves.log, moves.registers.names, args.payload, args.distance, args.chip, args.model, args.margin))


def arguments(doc: str | None, searches: bool = True, chips: bool = True) -> argparse.ArgumentParser:
    """The options that all baselines have."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--payload", type=float, default=PAYLOADS["light"], metavar="KG", help="on the table")
    parser.add_argument("--distance", type=int, default=DISTANCE, metavar="PULSES", help="of the move")
    if chips:
        parser.add_argument("--chip", choices=CHIPS, default=CHIP)
    parser.add_argument("--model", default=MODEL, metavar="NAME", help="of the stage, or an MJCF file")
    parser.add_argument(
        "--margin", type=float, default=MARGIN, metavar="KG", help="that the proof has beyond the payload"
    )
    if searches:
        parser.add_argument("--budget", type=int, default=BUDGET, metavar="N", help="moves")
        parser.add_argument("--seed", type=int, default=0)
        parser.add_argument("--space", choices=SPACES, default="knobs", help="what is chosen")
    return parser
