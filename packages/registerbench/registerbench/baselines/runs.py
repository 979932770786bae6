"""The runs of results.py: a search, the proofs of its best moves, and the answer with its test. A Parquet file holds every move.

    MethodRuns.read("data/results.parquet").runs[3].answer

A test consists of moves that neither the search nor a proof has made: other rotor angles, other payloads, both directions,
other distances, and payloads beyond the margin. Nothing is chosen by a test.
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

from registerbench.baselines import formula, searches, tool_loop
from registerbench.baselines.move_tuning import (
    CANDIDATES,
    LANES,
    MARGIN,
    MAX_HOLDING,
    MODEL,
    MoveLog,
    MoveTuning,
    best,
    prove,
)
from stage.firmware.pcl240.driver import TUNED_REGISTERS as REGISTERS

FIRST_SEED = 1  # with seed 0 the settings were chosen
TEST_SEED = 1_000  # of no search, and of no proof
NEW, SHORTER = "new", "shorter"
MIN_DISTANCE = 12_800  # pulses, 40 mm
HEAVIER = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)  # kg on top of the payload


class TestContext(NamedTuple):
    """Moves of a part of a test.

    Attributes:
        moves: Number of moves.
        heavier: Mass that each move has on top of the payload, kg.
        more: Mass that may come on top at random, kg.
        min_distance: Pulses from which distances are drawn; None: nearly equal distances.
    """

    moves: int
    heavier: float = 0.0
    more: float = 0.0
    min_distance: int | None = None


CONTEXTS = {
    NEW: TestContext(128, more=MARGIN),
    SHORTER: TestContext(64, more=MARGIN, min_distance=MIN_DISTANCE),
    **{f"+{kg:g} kg": TestContext(16, heavier=kg) for kg in HEAVIER},
}
"""Of a test. In each every second move goes the other way."""


@dataclass(frozen=True)
class Method:
    """Search or learner that is compared.

    Attributes:
        name: Name in the tables.
        search: Function (moves, seed) that spends the budget of moves.
        color: Color in the picture.
        fixed: Number of moves that does not grow with --budget, for a method without chance.
        space: "registers" or "knobs".
        lanes: Number of moves made at once.
        part: Share of the budget.
    """

    name: str
    search: Callable[[MoveTuning, int], None]
    color: str
    fixed: int | None = None
    space: str = "knobs"
    lanes: int = LANES
    part: float = 1.0  # of the budget

    def moves(self, budget: int) -> int:
        return self.fixed or max(int(budget * self.part), 1)


def load_search_lazily(name: str) -> Callable[[MoveTuning, int], None]:
    """Return a search of sb3_searches.py that is imported when it is called, because its extra may not be installed."""
    return lambda moves, seed: getattr(import_module("registerbench.baselines.sb3_searches"), name)(moves, seed)


FORMULA = Method("formula", formula.search, "#66717d", 1, "registers", 1)
BOLDEST = Method("formula, boldest", formula.boldest, "#1d2733", len(formula.FACTORS), "registers", 1)
METHODS = (
    FORMULA,
    BOLDEST,
    Method("agent loop", tool_loop.search, "#8a6bb8", 64, "registers", 1),
    Method("random", searches.search_randomly, "#d9a441"),
    Method("CMA-ES", searches.search_by_cma_es, "#17508f", lanes=8),
    Method("PPO", load_search_lazily("search_by_ppo"), "#d1571f"),
    Method("SAC", load_search_lazily("search_by_sac"), "#4f9d69"),
    Method("random, raw registers", searches.search_randomly, "#c9d1da", space="registers", part=1 / 4),
    Method("CMA-ES, raw registers", searches.search_by_cma_es, "#9fc3e6", space="registers", lanes=8, part=1 / 4),
)
QUICK = ("formula", "formula, boldest", "agent loop", "random", "CMA-ES")


@dataclass(eq=False)
class MethodRun:
    """One run of a method.

    Attributes:
        method: Name of the method.
        payload: Name of the payload.
        seed: Seed of the search.
        search: Moves of the search.
        proofs: Moves of the proof of each of the best moves, by the number of the move.
        test: Moves of the answer's test, by context.
    """

    method: str
    payload: str
    seed: int
    search: MoveLog
    proofs: dict[int, MoveLog] = field(default_factory=dict)
    test: dict[str, MoveLog] = field(default_factory=dict)

    @classmethod
    def from_search(cls, method: str, payload: str, seed: int, search: MoveLog, mass: float, model: str) -> MethodRun:
        run = cls(method, payload, seed, search)
        ranked = search.ranking[:CANDIDATES]
        if ranked:
            rows = [search.registers[k] for k in ranked]
            run.proofs = dict(
                zip(ranked, prove(rows, mass, model=model, margin=MARGIN, needed=MAX_HOLDING), strict=False)
            )
        if run.answer is not None:
            run.test = make_test(search.registers[run.answer], mass, model)
        return run

    @property
    def answer(self) -> int | None:
        """Number of the move that is the answer; None if no move holds that was tried again."""
        which = best(list(self.proofs.values()))
        return None if which is None else list(self.proofs)[which]

    @property
    def registers(self) -> dict[str, int]:
        return dict(zip(REGISTERS, self.search.registers[self.answer], strict=True)) if self.answer is not None else {}

    @property
    def lucky_moves(self) -> int:
        """Number of moves with a higher reward that are not the answer."""
        return list(self.proofs).index(self.answer) if self.answer is not None else len(self.proofs)

    @property
    def kept_share(self) -> float:
        """Share of the moves of the search that kept step."""
        return float(np.mean(self.search.kept_step))

    def compute_mean(self, name: str, kept_step_only: bool = False) -> float:
        """Compute the mean of a column over the new moves of the answer's test.

        Args:
            name: "reward" (ms), "duration" (ms) or "vibration" (um).
            kept_step_only: Whether to leave out the moves that lost steps.
        """
        if not self.test:
            return np.nan
        log = self.test[NEW]
        values = np.array(getattr(log, name))[log.kept_step if kept_step_only else slice(None)]
        return {"vibration": 1e6}.get(name, 1e3) * float(np.mean(values))

    def count_lost(self, context: str) -> int:
        """Count the moves of its test that did not keep step."""
        return self.test[context].kept_step.count(False)

    @property
    def reward_excess(self) -> float:
        """Reward, ms, by which the proof was better than the test."""
        return (
            1e3 * float(np.mean(self.proofs[self.answer].reward)) - self.compute_mean("reward")
            if self.answer is not None
            else np.nan
        )

    @property
    def spare_payload(self) -> float:
        """Mass on top of the payload, kg, up to which no move of the test lost a step."""
        holding = 0.0
        for kg in HEAVIER if self.test else ():
            if self.count_lost(f"+{kg:g} kg"):
                return holding
            holding = kg
        return holding if self.test else np.nan

    @cached_property
    def table(self) -> pyarrow.Table:
        """Moves of the run, in order."""
        parts = [("search", "", None, self.search)]
        parts += [("proof", "", number, log) for number, log in self.proofs.items()]
        parts += [("test", context, self.answer, log) for context, log in self.test.items()]
        return pyarrow.concat_tables([rows(self, *part) for part in parts])


def make_test(registers: list[int], payload: float, model: str) -> dict[str, MoveLog]:
    """Make the moves of the test with an answer; they are the same for every method.

    Args:
        registers: Registers of the answer.
        payload: Mass on the table, kg.
        model: Name of the model.
    """
    logs = {}
    for seed, (name, c) in enumerate(CONTEXTS.items(), TEST_SEED):
        settings: dict[str, Any] = {
            "seed": seed,
            "model": model,
            "more": c.more,
            "min_distance": c.min_distance,
            "both_directions": True,
        }
        with MoveTuning(payload + c.heavier, c.moves, "registers", **settings) as moves:
            action = moves.registers.to_action(np.array(registers))
            while moves.left:
                moves.make_actions(np.tile(action, (moves.lanes, 1)))
        logs[name] = moves.log
    return logs


# The file: a row a move

WORDS = pyarrow.dictionary(pyarrow.int8(), pyarrow.string())
UNITS = {
    "kg": "kg on the table",
    "angle": "electrical turns",
    "distance": "pulses",
    "vibration_um": "um",
    "duration_s": "s",
}
SCHEMA = pyarrow.schema(
    [
        *((name, WORDS) for name in ("payload", "method", "part", "context")),
        ("seed", pyarrow.int16()),
        ("of", pyarrow.int16()),  # the number of the move of the search whose registers these are
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


def rows(run: MethodRun, part: str, context: str, number: int | None, log: MoveLog) -> pyarrow.Table:
    count = len(log)
    order = list(range(count))
    distance, kg, angle = zip(*log.drawn, strict=True)
    columns: dict[str, Any] = {
        "payload": [run.payload] * count, "method": [run.method] * count, "part": [part] * count, "context": [context] * count,
        "seed": [run.seed] * count, "of": order if number is None else [number] * count, "number": order, "distance": distance,
        "kg": kg, "angle": angle, **dict(zip(REGISTERS, zip(*log.registers, strict=True), strict=True)), "reward": log.reward,
        "duration_s": log.duration, "vibration_um": [1e6 * v for v in log.vibration], "lost_steps": log.lost, "kept": log.kept_step,
    }  # fmt: skip
    arrays = [pyarrow.array(columns[f.name], pyarrow.string() if f.type == WORDS else f.type) for f in SCHEMA]
    return pyarrow.table([a.cast(f.type) for a, f in zip(arrays, SCHEMA, strict=True)], schema=SCHEMA)


def make_log(columns: dict[str, list[Any]], begin: int, end: int) -> MoveLog:
    """Make a log of the moves of these rows."""
    c = {name: values[begin:end] for name, values in columns.items()}
    registers = [list(row) for row in zip(*(c[name] for name in REGISTERS), strict=True)]
    drawn = list(zip(c["distance"], c["kg"], c["angle"], strict=True))
    vibration = [1e-6 * v for v in c["vibration_um"]]
    return MoveLog(c["reward"], c["duration_s"], c["lost_steps"], vibration, c["kept"], registers, drawn)


@dataclass
class MethodRuns:
    """All runs of all methods; `took` is in seconds, `versions` has the versions of the packages."""

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
            log = make_log(columns, begin, end)
            if part == "search":
                all_.runs.append(MethodRun(method, payload, seed, log))
            elif part == "proof":
                all_.runs[-1].proofs[of[begin]] = log
            else:
                all_.runs[-1].test[context] = log
            begin = end
        return all_

    def write(self, path: Path) -> None:
        """Write the runs; equal runs give equal bytes."""
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
        """Make the runs that are still missing.

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
            for seed in range(FIRST_SEED, FIRST_SEED + (1 if method.fixed else self.seeds)):
                if (payload, method.name, seed) not in done:
                    self.run(payload, method, seed)
                    if keep:
                        self.write(keep)

    @property
    def methods(self) -> list[Method]:
        return [m for m in METHODS if not self.quick or m.name in QUICK]

    def run(self, payload: str, method: Method, seed: int) -> None:
        began, mass = time.perf_counter(), self.payloads[payload]
        settings: dict[str, Any] = {"lanes": method.lanes, "seed": seed, "model": self.model}
        with MoveTuning(mass, method.moves(self.budget), method.space, **settings) as moves:
            method.search(moves, seed)
        run = MethodRun.from_search(method.name, payload, seed, moves.log, mass, self.model)
        took = time.perf_counter() - began
        self.runs.append(run)
        self.took += took
        text = "none holds"
        if run.test:
            lost = f"{run.count_lost(NEW)} and {run.count_lost(SHORTER)} moves of the test lost"
            reward, duration = run.compute_mean("reward"), run.compute_mean("duration")
            text = f"{reward:.1f} ms, {duration:.1f} of it time; {lost}, {run.spare_payload:.1f} kg to spare"
        print(
            f"{payload:6}{run.method:22} seed {seed}: {len(run.search):4} moves, {run.kept_share:4.0%} kept step, "
            f"{len(run.proofs)} tried again; {text}; took {took:.0f} s",
            flush=True,
        )
