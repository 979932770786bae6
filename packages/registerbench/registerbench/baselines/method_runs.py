"""Runs of the methods that baseline_comparison.py compares: a search, the proofs of its best moves, and a test of its answer.

    MethodRuns.read("data/results.parquet").runs[3].answer_number

A Parquet file stores every move. A test consists of moves that neither the search nor a proof has made: other rotor angles,
other payloads, both directions, other distances, and payloads beyond the margin. Nothing is chosen by a test.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module, metadata
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow
import pyarrow.parquet

from registerbench.baselines import formula, searches, tool_calling_agent
from registerbench.baselines.move_tuning import (
    CANDIDATES,
    MAX_HOLDING_MOVES,
    MODEL,
    PARALLEL_ENVS,
    PAYLOAD_MARGIN_KG,
    MoveLog,
    MoveTuning,
    find_best_proof,
    prove_rows,
)
from stage.firmware.pcl240.driver import TUNED_REGISTERS as REGISTERS

FIRST_SEED = 1  # the settings were chosen with seed 0
TEST_SEED = 1_000  # used by no search and no proof
NEW_MOVES, SHORTER_MOVES = "new", "shorter"
MIN_DISTANCE_PULSES = 12_800  # pulses, 40 mm
EXTRA_PAYLOADS_KG = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)  # kg on top of the payload


class TestConditions(NamedTuple):
    """Kind of moves in the test of an answer: their number, additional masses and distances.

    Attributes:
        moves: Number of moves.
        extra_kg: Constant mass on top of the payload, kg.
        max_extra_kg: Largest random mass on top of that, kg.
        min_distance: Shortest random distance, pulses; None: nearly equal distances.
    """

    moves: int
    extra_kg: float = 0.0
    max_extra_kg: float = 0.0
    min_distance: int | None = None


TEST_CONDITIONS = {
    NEW_MOVES: TestConditions(128, max_extra_kg=PAYLOAD_MARGIN_KG),
    SHORTER_MOVES: TestConditions(64, max_extra_kg=PAYLOAD_MARGIN_KG, min_distance=MIN_DISTANCE_PULSES),
    **{f"+{kg:g} kg": TestConditions(16, extra_kg=kg) for kg in EXTRA_PAYLOADS_KG},
}
"""Kinds of moves in a test, by name. Every second move goes in the minus direction."""


@dataclass(frozen=True)
class Method:
    """Search or learner whose answers the baseline comparison compares.

    Attributes:
        name: Name in the tables.
        search: Function (moves, seed) that spends the budget of moves.
        color: Color in the picture.
        fixed_moves: Number of moves that does not grow with --budget, for a method without chance.
        space: "registers" or "knobs".
        lanes: Number of moves made at once.
        budget_share: Share of the budget.
    """

    name: str
    search: Callable[[MoveTuning, int], None]
    color: str
    fixed_moves: int | None = None
    space: str = "knobs"
    lanes: int = PARALLEL_ENVS
    budget_share: float = 1.0  # of the budget

    def count_moves(self, budget: int) -> int:
        """Return the number of moves that the method makes with a budget."""
        return self.fixed_moves or max(int(budget * self.budget_share), 1)


def load_search_lazily(name: str) -> Callable[[MoveTuning, int], None]:
    """Return a search of sb3_searches.py that is imported when it is called, because its extra may not be installed."""
    return lambda moves, seed: getattr(import_module("registerbench.baselines.sb3_searches"), name)(moves, seed)


FORMULA = Method("formula", formula.make_formula_move, "#66717d", 1, "registers", 1)
BOLDEST_FORMULA_METHOD = Method(
    "formula, boldest", formula.try_safety_factors, "#1d2733", len(formula.SAFETY_FACTORS), "registers", 1
)
METHODS = (
    FORMULA,
    BOLDEST_FORMULA_METHOD,
    Method("agent loop", tool_calling_agent.search_by_scripted_agent, "#8a6bb8", 64, "registers", 1),
    Method("random", searches.search_randomly, "#d9a441"),
    Method("CMA-ES", searches.search_by_cma_es, "#17508f", lanes=8),
    Method("PPO", load_search_lazily("search_by_ppo"), "#d1571f"),
    Method("SAC", load_search_lazily("search_by_sac"), "#4f9d69"),
    Method("random, raw registers", searches.search_randomly, "#c9d1da", space="registers", budget_share=1 / 4),
    Method(
        "CMA-ES, raw registers", searches.search_by_cma_es, "#9fc3e6", space="registers", lanes=8, budget_share=1 / 4
    ),
)
QUICK_METHODS = ("formula", "formula, boldest", "agent loop", "random", "CMA-ES")


@dataclass(eq=False)
class MethodRun:
    """Run of a method with one payload and seed.

    Attributes:
        method: Name of the method.
        payload: Name of the payload.
        seed: Seed of the search.
        search_log: Moves of the search.
        proof_logs: Moves of each proof, by the number of the move in the search that it repeats.
        test_logs: Moves of the answer's test, by the name of the test context.
    """

    method: str
    payload: str
    seed: int
    search_log: MoveLog
    proof_logs: dict[int, MoveLog] = field(default_factory=dict)
    test_logs: dict[str, MoveLog] = field(default_factory=dict)

    @classmethod
    def from_search(cls, method: str, payload: str, seed: int, search: MoveLog, mass: float, model: str) -> MethodRun:
        """Make the run of a finished search: prove its best moves, and test the answer.

        Args:
            method: Name of the method.
            payload: Name of the payload.
            seed: Seed of the search.
            search: Moves of the search.
            mass: Payload, kg.
            model: Name of the model.
        """
        run = cls(method, payload, seed, search)
        ranked = search.ranking[:CANDIDATES]
        if ranked:
            rows = [search.registers[k] for k in ranked]
            run.proof_logs = dict(
                zip(
                    ranked,
                    prove_rows(rows, mass, model=model, margin=PAYLOAD_MARGIN_KG, needed=MAX_HOLDING_MOVES),
                    strict=False,
                )
            )
        if run.answer_number is not None:
            run.test_logs = run_test(search.registers[run.answer_number], mass, model)
        return run

    @property
    def answer_number(self) -> int | None:
        """Number of the move that is the answer; None if no repeated move holds."""
        which = find_best_proof(list(self.proof_logs.values()))
        return None if which is None else list(self.proof_logs)[which]

    @property
    def registers(self) -> dict[str, int]:
        """Registers of the answer by name."""
        return (
            dict(zip(REGISTERS, self.search_log.registers[self.answer_number], strict=True))
            if self.answer_number is not None
            else {}
        )

    @property
    def lucky_move_count(self) -> int:
        """Number of proved moves that rank above the answer by their reward in the search; all of them if none holds."""
        return (
            list(self.proof_logs).index(self.answer_number) if self.answer_number is not None else len(self.proof_logs)
        )

    @property
    def in_step_share(self) -> float:
        """Share of the moves of the search that kept step."""
        return float(np.mean(self.search_log.in_step))

    def compute_mean(self, name: str, in_step_only: bool = False) -> float:
        """Compute the mean of a column over the new moves of the answer's test.

        Args:
            name: "reward" (ms), "duration" (ms) or "vibration" (um).
            in_step_only: Whether to leave out the moves that lost steps.
        """
        if not self.test_logs:
            return np.nan
        log = self.test_logs[NEW_MOVES]
        values = np.array(getattr(log, name))[log.in_step if in_step_only else slice(None)]
        return {"vibration": 1e6}.get(name, 1e3) * float(np.mean(values))

    def count_failed_moves(self, context: str) -> int:
        """Count the moves of the test that lost steps or did not make all their pulses.

        Args:
            context: Name of the test context.
        """
        return self.test_logs[context].in_step.count(False)

    @property
    def reward_excess(self) -> float:
        """Mean reward of the answer's proof minus that of its test, in ms of move time: a reward of 1 stands for 1 s."""
        return (
            1e3 * float(np.mean(self.proof_logs[self.answer_number].reward)) - self.compute_mean("reward")
            if self.answer_number is not None
            else np.nan
        )

    @property
    def spare_payload(self) -> float:
        """Largest mass on top of the payload, kg, up to which no move of the test lost a step."""
        holding = 0.0
        for kg in EXTRA_PAYLOADS_KG if self.test_logs else ():
            if self.count_failed_moves(f"+{kg:g} kg"):
                return holding
            holding = kg
        return holding if self.test_logs else np.nan

    @cached_property
    def table(self) -> pyarrow.Table:
        """Moves of the run, in order, as a table of PyArrow."""
        parts = [("search", "", None, self.search_log)]
        parts += [("proof", "", number, log) for number, log in self.proof_logs.items()]
        parts += [("test", context, self.answer_number, log) for context, log in self.test_logs.items()]
        return pyarrow.concat_tables([make_table(self, *part) for part in parts])


def run_test(registers: list[int], payload: float, model: str) -> dict[str, MoveLog]:
    """Make the moves of the test with an answer; every method makes the same moves.

    Args:
        registers: Registers of the answer.
        payload: Mass on the table, kg.
        model: Name of the model.

    Returns:
        Moves by the name of the test context.
    """
    logs = {}
    for seed, (name, c) in enumerate(TEST_CONDITIONS.items(), TEST_SEED):
        settings: dict[str, Any] = {
            "seed": seed,
            "model": model,
            "max_extra_kg": c.max_extra_kg,
            "min_distance": c.min_distance,
            "both_directions": True,
        }
        with MoveTuning(payload + c.extra_kg, c.moves, "registers", **settings) as moves:
            action = moves.registers.to_action(np.array(registers))
            while moves.moves_left:
                moves.measure_rewards_of_actions(np.tile(action, (moves.lanes, 1)))
        logs[name] = moves.log
    return logs


# The Parquet file has a row for each move.

DICTIONARY_STRING_TYPE = pyarrow.dictionary(pyarrow.int8(), pyarrow.string())
UNITS = {
    "kg": "kg on the table",
    "angle": "electrical turns",
    "distance": "pulses",
    "vibration_um": "um",
    "duration_s": "s",
}
SCHEMA = pyarrow.schema(
    [
        *((name, DICTIONARY_STRING_TYPE) for name in ("payload", "method", "part", "context")),
        ("seed", pyarrow.int16()),
        ("of", pyarrow.int16()),  # number of the move in the search that has these registers
        ("number", pyarrow.int16()),
        ("distance", pyarrow.int32()),
        *((name, pyarrow.float32()) for name in ("kg", "angle")),
        *((name, pyarrow.int32()) for name in REGISTERS),
        *((name, pyarrow.float32()) for name in ("reward", "duration_s", "vibration_um")),
        ("lost_steps", pyarrow.int32()),
        ("kept", pyarrow.bool_()),
    ]
)
BYTE_SPLIT_COLUMNS = ("kg", "angle", "reward", "duration_s", "vibration_um")
DICTIONARY_COLUMNS = [f.name for f in SCHEMA if f.name not in BYTE_SPLIT_COLUMNS]


def make_table(run: MethodRun, part: str, context: str, number: int | None, log: MoveLog) -> pyarrow.Table:
    """Make the Parquet rows of the moves of one part of a run.

    Args:
        run: Run of a method.
        part: Part of the run: search, proof or test.
        context: Name of the test context; "" for other parts.
        number: Number of the move in the search that a proof repeats, or None.
        log: Moves of the part.
    """
    count = len(log)
    order = list(range(count))
    distance, kg, angle = zip(*log.drawn, strict=True)
    columns: dict[str, Any] = {
        "payload": [run.payload] * count, "method": [run.method] * count, "part": [part] * count, "context": [context] * count,
        "seed": [run.seed] * count, "of": order if number is None else [number] * count, "number": order, "distance": distance,
        "kg": kg, "angle": angle, **dict(zip(REGISTERS, zip(*log.registers, strict=True), strict=True)), "reward": log.reward,
        "duration_s": log.duration, "vibration_um": [1e6 * v for v in log.vibration], "lost_steps": log.lost, "kept": log.in_step,
    }  # fmt: skip
    arrays = [
        pyarrow.array(columns[f.name], pyarrow.string() if f.type == DICTIONARY_STRING_TYPE else f.type) for f in SCHEMA
    ]
    return pyarrow.table([a.cast(f.type) for a, f in zip(arrays, SCHEMA, strict=True)], schema=SCHEMA)


def make_move_log(columns: dict[str, list[Any]], begin: int, end: int) -> MoveLog:
    """Make a log of the moves in a range of rows.

    Args:
        columns: Columns of the file.
        begin: First row.
        end: Row after the last one.
    """
    c = {name: values[begin:end] for name, values in columns.items()}
    registers = [list(row) for row in zip(*(c[name] for name in REGISTERS), strict=True)]
    drawn = list(zip(c["distance"], c["kg"], c["angle"], strict=True))
    vibration = [1e-6 * v for v in c["vibration_um"]]
    return MoveLog(c["reward"], c["duration_s"], c["lost_steps"], vibration, c["kept"], registers, drawn)


@dataclass
class MethodRuns:
    """All runs of all methods.

    Attributes:
        budget: Moves of a search.
        seeds: Number of seeds.
        payloads: Payloads, kg, by name.
        model: Name of the model.
        quick: Whether only the methods of QUICK_METHODS run.
        took: Duration of all runs, s.
        versions: Versions of the packages by name.
        runs: The runs.
    """

    budget: int
    seeds: int
    payloads: dict[str, float]
    model: str = MODEL
    quick: bool = False
    took: float = 0.0
    versions: dict[str, str] = field(default_factory=dict)
    runs: list[MethodRun] = field(default_factory=list)

    @classmethod
    def read(cls, path: Path) -> MethodRuns:
        """Read runs from a Parquet file."""
        table = pyarrow.parquet.read_table(path)
        all_ = cls(**json.loads(table.schema.metadata[b"results"]))
        columns = {name: table[name].to_pylist() for name in table.column_names}
        keys = list(zip(*(columns[n] for n in ("payload", "method", "seed", "part", "context")), strict=True))
        of = columns["of"]
        begin = 0
        for end in range(1, len(keys) + 1):
            if end < len(keys) and keys[end] == keys[begin] and (keys[end][3] == "search" or of[end] == of[begin]):
                continue
            payload, method, seed, part, context = keys[begin]
            log = make_move_log(columns, begin, end)
            if part == "search":
                all_.runs.append(MethodRun(method, payload, seed, log))
            elif part == "proof":
                all_.runs[-1].proof_logs[of[begin]] = log
            else:
                all_.runs[-1].test_logs[context] = log
            begin = end
        return all_

    def write(self, path: Path) -> None:
        """Write the runs to a Parquet file; equal runs give equal bytes."""
        about = {
            name: getattr(self, name) for name in ("budget", "seeds", "payloads", "model", "quick", "took", "versions")
        }
        metadata_ = {b"results": json.dumps(about).encode(), b"units": json.dumps(UNITS).encode()}
        table = pyarrow.concat_tables([run.table for run in self.runs]).replace_schema_metadata(metadata_)
        pyarrow.parquet.write_table(
            table,
            path,
            compression="zstd",
            compression_level=19,
            use_dictionary=DICTIONARY_COLUMNS,
            use_byte_stream_split=list(BYTE_SPLIT_COLUMNS),
        )

    def run_all(self, keep: Path | None) -> None:
        """Make the missing runs of all methods.

        Args:
            keep: File to which all runs are written after each run, or None.
        """
        done = {(r.payload, r.method, r.seed) for r in self.runs}
        packages = (
            "pulsestage",
            "mujoco",
            "numpy",
            "optuna",
            "cmaes",
            *(() if self.quick else ("stable-baselines3", "torch")),
        )
        self.versions = self.versions or {p: metadata.version(p) for p in packages}
        for payload, method in product(self.payloads, self.methods):
            for seed in range(FIRST_SEED, FIRST_SEED + (1 if method.fixed_moves else self.seeds)):
                if (payload, method.name, seed) not in done:
                    self.run_method(payload, method, seed)
                    if keep:
                        self.write(keep)

    @property
    def methods(self) -> list[Method]:
        """Methods that are compared: all, or those of QUICK_METHODS."""
        return [m for m in METHODS if not self.quick or m.name in QUICK_METHODS]

    def run_method(self, payload: str, method: Method, seed: int) -> None:
        """Make one run of a method, and append it.

        Args:
            payload: Name of the payload.
            method: Method to run.
            seed: Seed of the search.
        """
        began, mass = time.perf_counter(), self.payloads[payload]
        settings: dict[str, Any] = {"lanes": method.lanes, "seed": seed, "model": self.model}
        with MoveTuning(mass, method.count_moves(self.budget), method.space, **settings) as moves:
            method.search(moves, seed)
        run = MethodRun.from_search(method.name, payload, seed, moves.log, mass, self.model)
        took = time.perf_counter() - began
        self.runs.append(run)
        self.took += took
        text = "none holds"
        if run.test_logs:
            lost = f"{run.count_failed_moves(NEW_MOVES)} and {run.count_failed_moves(SHORTER_MOVES)} moves of the test lost"
            reward, duration = run.compute_mean("reward"), run.compute_mean("duration")
            text = f"{reward:.1f} ms, {duration:.1f} of it time; {lost}, {run.spare_payload:.1f} kg to spare"
        print(
            f"{payload:6}{run.method:22} seed {seed}: {len(run.search_log):4} moves, {run.in_step_share:4.0%} kept step, "
            f"{len(run.proof_logs)} repeated; {text}; took {took:.0f} s",
            flush=True,
        )
