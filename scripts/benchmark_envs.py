"""Throughput and memory of the environments, as ratios that are measured in one run: rounds interleaved, medians with spread.

python scripts/benchmark_envs.py [--most 512] [--ids RegisterTuning] [--rounds 5] [--json FILE]
python scripts/benchmark_envs.py --chips PCL240K MCX514 MCX304 --markdown      rows of the table of docs/envs.md
python scripts/benchmark_envs.py --overhead     what a step costs beside its physics: RegisterBus beside Gymnasium's MujocoEnv, a
                                                macro of BusMacros without effect
python scripts/benchmark_envs.py --reduced      moves a second with the reduced model, beside the whole machine

Every line is one environment with a number of stages under random actions. In each round, the same episodes (seeds and actions)
are played by our vector environment and by gymnasium.vector.SyncVectorEnv of our scalar one. A mujoco.batch.Batch of the bare
model makes the same number of physics steps on as many threads, with moving carriages and constant torques.
"""

import argparse
import gc
import json
import os
import time
from functools import partial
from importlib import import_module
from itertools import product
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
from bench import environment
from bench.figures import Run
from bench.machines import MujocoBatch
from bench.report import format_line
from bench.timing import (
    can_read_resident_memory,
    do_nothing,
    measure_alternately,
    measure_time,
    read_resident_memory,
    run_in_fresh_process,
)
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import stage.envs
from stage.chips import CHIPS

NUMBERS = (1, 8, 64, 512, 4096)
MODE = AutoresetMode.SAME_STEP  # every step is a step of every stage
SEED = 240
ENOUGH = 64  # stages, to tell how much memory one takes
COLUMNS = ("env steps/s", "physics steps/s", "times SyncVectorEnv", "of a bare Batch")


def make_vector_env(id_, n, threads=None, **settings):
    """Make our vector environment with n stages."""
    kind = {"vectorization_mode": "vector_entry_point", "autoreset_mode": MODE, "threads": threads}
    return gymnasium.make_vec(id_, num_envs=n, **kind, **settings)


def make_sync_vector_env(id_, n, **settings):
    """Make Gymnasium's SyncVectorEnv of n of our scalar environments."""
    return SyncVectorEnv([lambda: gymnasium.make(id_, disable_env_checker=True, **settings)] * n, autoreset_mode=MODE)


class RandomEpisodes:
    """Random actions from SEED on for at least some seconds, with the number of physics steps that they make.

    Args:
        envs: Vector environment on which the actions are drawn.
        seconds: Shortest computing time.
    """

    def __init__(self, envs, seconds):
        task, self.actions, self.physics = envs.unwrapped.task_instance, [], 0.0
        play, dt = task.play_actions, task.stages[0].model.opt.timestep * 1e9

        def counted():
            before = task.fleet.truth()["now"][:, 0]
            play()
            self.physics += float((task.fleet.truth()["now"][:, 0] - before).sum()) / dt

        task.play_actions = counted
        envs.action_space.seed(SEED)
        envs.reset(seed=SEED)
        passed = 0.0
        while passed < seconds:
            self.actions.append(envs.action_space.sample())
            passed += measure_time(lambda: envs.step(self.actions[-1]))
        task.play_actions = play

    def play(self, envs, clock):
        """Play the episodes on `envs`, and return the time that `clock` measures, without the first reset, s."""
        envs.reset(seed=SEED)
        return measure_time(lambda: [envs.step(a) for a in self.actions], clock)


def measure(id_, n, settings, args):
    """Measure the rates and ratios of one environment with n stages.

    Args:
        id_: Id of the environment.
        n: Number of stages.
        settings: Settings of the environment.
        args: Options of the command line.

    Returns:
        Values of each round, by column.
    """
    ours = make_vector_env(id_, n, args.threads, **settings)
    episodes = RandomEpisodes(ours, args.seconds)
    other = make_sync_vector_env(id_, n, **settings) if n <= args.most_sync else None
    bare = MujocoBatch(n, ours.unwrapped.task_instance.fleet.threads)
    steps = n * len(episodes.actions)
    bare.nstep = max(1, round(min(episodes.physics / n, args.bare)))
    seconds = {"ours": [], "sync": [], "bare": []}
    clock = time.process_time if args.cpu else time.perf_counter
    for _ in range(args.rounds):
        seconds["ours"].append(episodes.play(ours, clock))
        if other is not None:
            seconds["sync"].append(episodes.play(other, clock))
        bare.reset()
        seconds["bare"].append(measure_time(bare.step, clock))
    for envs in (ours, other):
        if envs is not None:
            envs.close()
    t = {name: np.array(values) for name, values in seconds.items()}
    rows = {"env steps/s": steps / t["ours"], "physics steps/s": episodes.physics / t["ours"]}
    if other is not None:
        rows["times SyncVectorEnv"] = t["sync"] / t["ours"]
    rows["of a bare Batch"] = rows["physics steps/s"] / (bare.nstep * n / t["bare"])
    return rows


def repeat_step(envs, action, count):
    """Make the same step several times."""
    for _ in range(count):
        envs.step(action)


def measure_overhead(rounds):
    """Print what steps cost beside their physics."""
    for figure in environment.measure(Run(rounds)):
        print(format_line(figure), flush=True)
    works, many = {}, 64
    steps = {"scalar": 100, "vector of 64": 10, "SyncVectorEnv of 64": 1}  # short turns
    for kind in steps:
        n = many if "64" in kind else 1
        settings = {"macros": 10**9, "time_limit": 1e6}
        if n == 1:
            envs = gymnasium.make("stage/BusMacros-v1", disable_env_checker=True, **settings).unwrapped
        else:
            make = make_sync_vector_env if "Sync" in kind else make_vector_env
            envs = make("stage/BusMacros-v1", n, **settings)
        _, info = envs.reset(seed=SEED)
        masked = np.argmin(info["action_mask"], axis=-1)
        action = int(masked) if n == 1 else masked
        works[kind] = do_nothing, partial(repeat_step, envs, action, steps[kind])
    gc.freeze()  # else it would look through all that these environments consist of
    seconds = measure_alternately(works, rounds, 200, np.min)
    per_step = {kind: s / steps[kind] / (many if "64" in kind else 1) for kind, s in seconds.items()}
    for kind, s in per_step.items():
        print(f"  BusMacros, masked macro, {kind}: {' '.join(format_spread(s * 1e6))} us an environment")
    ratio = per_step["SyncVectorEnv of 64"] / per_step["vector of 64"]
    print(f"  SyncVectorEnv / vector, 64 environments: {' '.join(format_spread(ratio))} times")


def measure_reduced(args):
    """Print how many times as many moves tasks of one axis make in a second with the reduced model."""
    clock = time.process_time if args.cpu else time.perf_counter
    for id_ in select_ids(args.ids):
        if not hasattr(import_module(f"stage.envs.{stage.envs.IDS[id_].split(':')[0]}").Config, "reduced"):
            continue
        complete, reduced = (make_vector_env(id_, 16, args.threads, reduced=on) for on in (False, True))
        episodes = RandomEpisodes(complete, args.seconds)
        seconds = np.array([[episodes.play(envs, clock) for envs in (complete, reduced)] for _ in range(args.rounds)])
        moves, ratio = 16 * len(episodes.actions) / seconds, seconds[:, 0] / seconds[:, 1]
        rates = " and ".join(format_spread(column)[0] for column in moves.T)
        print(f"{id_:28} {' '.join(format_spread(ratio))} times: {rates} moves/s", flush=True)


def measure_growth(kind, id_, n, settings):
    """Measure the memory of each of n further stages after a step.

    Args:
        kind: Kind of vector environment.
        id_: Id of the environment.
        n: Number of stages.
        settings: Settings of the environment.

    Returns:
        KiB for one stage.
    """
    make = {
        "ours": lambda k: make_vector_env(id_, k, **settings),
        "sync": lambda k: make_sync_vector_env(id_, k, **settings),
        "bare": lambda k: MujocoBatch(k, 0),
    }[kind]

    def stepped(number):
        envs = make(number)
        envs.reset(seed=SEED)
        envs.step(None if kind == "bare" else envs.action_space.sample())
        return envs

    created = [stepped(1)]
    before = read_resident_memory()
    created.append(stepped(n))
    return (read_resident_memory() - before) / n / 1024


def select_ids(ids):
    """Return the ids of the environments that the user selected; None: all."""
    return [id_ for id_ in stage.envs.IDS if not ids or any(name in id_ for name in ids)]


def format_spread(values, digits=3):
    """Format the median of values with their smallest and largest."""
    low, middle, high = np.min(values), np.median(values), np.max(values)
    return f"{middle:,.{digits}g}" if middle < 1000 else f"{middle:,.0f}", f"({low:.{digits}g} .. {high:.{digits}g})"


def format_markdown_row(rows, first, n):
    """Format a row of the table of docs/envs.md."""
    cells = [" ".join(format_spread(rows[name])) if name in rows else "" for name in COLUMNS]
    cells[1] = cells[1].split()[0]
    return f"| {first} | {n} | {' | '.join(cells)} |"


def print_row(rows, id_, n, settings, max_sync):
    """Print a line of the table, and return the KiB of a stage."""
    kinds = ("ours", "bare", *["sync"] * (n <= max_sync)) if n >= ENOUGH and can_read_resident_memory() else ()
    kib = {kind: run_in_fresh_process(measure_growth, kind, id_, n, settings) for kind in kinds}
    cells = {name: " ".join(format_spread(values)) for name, values in rows.items()}
    print(
        f"{n:6}  {cells['env steps/s']:>28}  {cells['physics steps/s']:>30}  "
        f"{cells.get('times SyncVectorEnv', '-'):>24}  {cells['of a bare Batch']:>22}  "
        f"{' '.join(f'{kib[k]:9.0f}' if k in kib else '        -' for k in ('ours', 'sync', 'bare')):>30}",
        flush=True,
    )
    return kib


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ids", nargs="*", help="parts of the names of environments; default all")
    parser.add_argument("--chips", nargs="*", default=["PCL240K"], choices=CHIPS, metavar="CHIP", help=", ".join(CHIPS))
    parser.add_argument("--least", type=int, default=1, help="stages at least, of 1, 8, 64, 512, 4096")
    parser.add_argument("--most", type=int, default=512, help="stages at most")
    parser.add_argument("--most-sync", type=int, default=64, help="environments at most in SyncVectorEnv, slow to make")
    parser.add_argument("--threads", type=int, help="default one a processor")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=1.0, help="of our steps in a round, at least")
    parser.add_argument(
        "--bare", type=int, default=4000, help="physics steps of each bare simulation in a round, at most"
    )
    parser.add_argument("--cpu", action="store_true", help="seconds of processor time: for a machine that others use")
    parser.add_argument("--settings", type=json.loads, default={}, help="of the environments, as JSON")
    parser.add_argument("--json")
    parser.add_argument("--markdown", action="store_true", help="rows of a table in place of columns, without memory")
    parser.add_argument("--overhead", action="store_true", help="what a step costs beside its physics")
    parser.add_argument("--reduced", action="store_true", help="moves a second with the reduced model")
    args = parser.parse_args()
    if args.overhead:
        measure_overhead(args.rounds)
        return
    if args.reduced:
        measure_reduced(args)
        return
    table = {}
    print(f"{os.cpu_count()} processors, MuJoCo {mujoco.__version__}, {args.rounds} rounds; median (least .. most)"
          f"{'; a second is one of processor time' if args.cpu else ''}")  # fmt: skip
    for id_, chip in product(select_ids(args.ids), args.chips):
        settings = {"chip": chip} | args.settings
        name = id_ if chip == "PCL240K" else f"{id_} {chip}"
        if not args.markdown:
            print(f"\n{name}\n{'stages':>6}  {'env steps/s':>28}  {'physics steps/s':>30}  {'times SyncVectorEnv':>24}  "
                  f"{'of a bare Batch':>22}  {'KiB a stage: ours, sync, bare':>30}")  # fmt: skip
        first = name.removeprefix("stage/").replace("-v0", "")
        for n in (n for n in NUMBERS if args.least <= n <= args.most):
            rows = measure(id_, n, settings, args)
            if args.markdown:
                print(format_markdown_row(rows, first, n), flush=True)
                first, kib = "", {}
            else:
                kib = print_row(rows, id_, n, settings, args.most_sync)
            table[f"{name} {n}"] = {name: values.tolist() for name, values in rows.items()} | {"KiB a stage": kib}
            if args.json:
                Path(args.json).write_text(json.dumps(table, indent=1))


if __name__ == "__main__":
    main()
