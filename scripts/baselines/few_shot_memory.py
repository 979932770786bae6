"""What memory is worth to a learner on `stage/FewShotTuning-v1`: one small policy, learned by CMA-ES, that reads past tries or not.

python scripts/baselines/few_shot_memory.py learn memory --runs 10 -o runs
python scripts/baselines/few_shot_memory.py learn none --runs 10 -o runs
python scripts/baselines/few_shot_memory.py submit runs/memory-*.json runs/none-*.json -o entries --splits train weak

A try's boldness b makes a move as in few_shot.py: the usual rates times b, the usual ramps divided by b. Its logarithm is
none     w0 + w1 distance + w2 try: what a policy can know that sees no try. Three numbers are learned. With w2 it may go from tame
         to bold in any case, and keep the best that held
memory   the same until a try was seen. Then, of the boldest try g that kept step by the encoder and the tamest l that did not:
         log g + w3 where none has lost steps, log l - w4 where none has kept them, else log g + w5 (log l - log g). Where g >= l
         it was luck, and is forgotten. Six numbers are learned, w3 to w5 from 0 up

Both have the same budget: GENERATIONS of POPULATION choices, each played on the same MACHINES machines of train, which are others
for each generation and each run; what CMA-ES then has as its middle is the policy. It begins at twice the usual speeds. Needs
the package cmaes (extra `rl`).
"""

from __future__ import annotations

import argparse
import csv
import json
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from stage import bench
from stage.envs.few_shot import action_of

ID, TASK = "stage/FewShotTuning-v1", "few-shot"
BEGINS = {"none": (0.7, 0.0, 0.0), "memory": (0.7, 0.0, 0.0, 0.2, 0.2, 0.5)}
"""Where CMA-ES begins: at twice the usual speeds."""
POPULATION, GENERATIONS, MACHINES = 10, 12, 8
SPREAD = 0.5  # of the first generation, of each number
TRIES = 8
CHEAPER = {"proofs": 1, "settle": 0.03}  # for learning; the test has the task's own
BOLDEST = 12.0


def action(boldness: float) -> np.ndarray:
    b = float(np.clip(boldness, 0.5, BOLDEST))
    return action_of(1000 * min(b, 1.5), 16_000 * b, 0.15 / b, 0.15 / b)


class Rule:
    """The policy with numbers w, on n machines at once."""

    def __init__(self, w: np.ndarray, n: int = 1):
        self.w, self.made = np.asarray(w, float), 0
        self.held, self.lost = np.full(n, -np.inf), np.full(n, np.inf)  # logarithms of boldness
        self.last = np.zeros(n)

    def see(self, kept: np.ndarray) -> None:
        """Whether the last try kept step by the encoder, (n,) bool."""
        self.held = np.where(kept, np.maximum(self.held, self.last), self.held)
        self.lost = np.where(kept, self.lost, np.minimum(self.lost, self.last))
        self.held = np.where(self.held >= self.lost, -np.inf, self.held)

    def __call__(self, distance: np.ndarray) -> np.ndarray:
        """Boldness of the next try, (n,). distance: as the observation has it."""
        w = self.w
        chosen = w[0] + w[1] * distance + w[2] * self.made / TRIES
        if len(w) > 3 and self.made:
            up, down, share = np.abs(w[3:])
            held, lost = np.isfinite(self.held), np.isfinite(self.lost)
            with np.errstate(invalid="ignore"):
                between = self.held + min(share, 1.0) * (self.lost - self.held)
            chosen = np.where(held & lost, between, np.where(held, self.held + up, self.lost - down))
        self.made, self.last = self.made + 1, np.clip(chosen, np.log(0.5), np.log(BOLDEST))
        return np.exp(self.last)


def play(envs: Any, w: np.ndarray, seed: int) -> np.ndarray:
    """Sums of rewards of an episode on the machines of seeds seed, seed + 1, ..., (n,)."""
    names = [e.name for e in envs.entries]
    seen, _ = envs.reset(seed=seed)
    rule, total = Rule(w, envs.num_envs), np.zeros(envs.num_envs)
    for k in range(TRIES):
        if k:
            rule.see(seen[:, names.index("kept")] > 0)
        rows = [action(b) for b in rule(seen[:, names.index("distance")])]
        seen, rewards, *_ = envs.step(np.stack(rows))
        total += rewards
    return total


def learn(method: str, run: int, folder: Path, generations: int = GENERATIONS, **settings: Any) -> None:
    from cmaes import CMA

    envs: Any = gymnasium.make_vec(
        ID, MACHINES, vectorization_mode="vector_entry_point", autoreset_mode="Disabled", memory="last", threads=1,
        **CHEAPER, **settings,
    ).unwrapped  # fmt: skip
    search = CMA(mean=np.array(BEGINS[method]), sigma=SPREAD, seed=run, population_size=POPULATION)
    begun, rows, moves = time.process_time(), [], 0
    for generation in range(generations):
        machines = 1000 * (run + 1) + MACHINES * generation
        asked = [search.ask() for _ in range(POPULATION)]
        worth = [float(play(envs, w, machines).mean()) for w in asked]
        search.tell([(w, -value) for w, value in zip(asked, worth, strict=True)])
        moves += POPULATION * MACHINES * TRIES
        episodes = POPULATION * MACHINES
        rows.append(
            (moves, f"{time.process_time() - begun:.1f}", episodes, f"{np.mean(worth):.4f}", f"{max(worth):.4f}")
        )
    envs.close()
    folder.mkdir(parents=True, exist_ok=True)
    cost = {"moves": moves, "processor_s": round(time.process_time() - begun, 1)}
    path = folder / f"{method}-{run}"
    path.with_suffix(".json").write_text(json.dumps({"w": search.mean.round(4).tolist(), "cost": cost}))
    with path.with_suffix(".csv").open("w", newline="") as file:
        csv.writer(file).writerows([("steps", "processor_s", "episodes", "return", "best"), *rows])
    print(
        f"{path}: {rows[0][3]} -> {rows[-1][3]}, {search.mean.round(2).tolist()}, {cost['processor_s']} s", flush=True
    )


class Policy:
    """What was learned, for stage.bench."""

    def __init__(self, w: list[float]):
        self.w = np.array(w)

    def reset(self, around: Any) -> None:
        self.distance, self.kept = (around.entries.index(name) for name in ("distance", "kept"))
        self.rule = Rule(self.w)

    def __call__(self, observation: np.ndarray, info: Any) -> np.ndarray:
        if self.rule.made:
            self.rule.see(observation[[self.kept]] > 0)
        return action(float(self.rule(observation[[self.distance]])[0]))


def submit(path: Path, splits: list[str], folder: Path) -> None:
    said, (method, run) = json.loads(path.read_text()), path.stem.split("-")
    folder.mkdir(parents=True, exist_ok=True)
    for split in splits:
        name, chosen = f"es, {'with' if method == 'memory' else 'without'} memory", {"memory": "last"}
        entry = bench.play(Policy(said["w"]), TASK, split, settings=chosen, name=name, run=int(run), cost=said["cost"])
        bench.submit(entry, folder / f"{TASK}-{split}-es-{method}-{run}.bench", overwrite=True)
        print(f"{split} {method} {run}: return {entry.scores['return'].mean():.3f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    p = commands.add_parser("learn")
    p.add_argument("method", choices=BEGINS)
    p.add_argument("--runs", type=int, default=10, metavar="N", help="of seeds 0 to N - 1")
    p.add_argument("-o", "--out", type=Path, required=True, metavar="FOLDER")
    p.set_defaults(run=lambda a: [learn(a.method, run, a.out) for run in range(a.runs)])
    p = commands.add_parser("submit")
    p.add_argument("policy", type=Path, nargs="+")
    p.add_argument("--splits", nargs="+", default=["train"])
    p.add_argument("-o", "--out", type=Path, required=True, metavar="FOLDER")
    p.set_defaults(run=lambda a: [submit(path, a.splits, a.out) for path in a.policy])
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
