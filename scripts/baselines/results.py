"""All baselines, compared: runs every one with its budget and seeds, for a light and a heavy payload.

python scripts/baselines/results.py                  docs/results.md, pictures/results.png, data/results.csv.gz; some two hours
python scripts/baselines/results.py --quick --out build/results      without PPO and SAC, 64 moves, one payload
python scripts/baselines/results.py --model xy --payload 2 5 --out build/results

Needs the extras `rl` and `plot`.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import io
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache
from importlib import import_module, metadata
from itertools import product
from pathlib import Path
from typing import Any

import formula
import numpy as np
import random_search
import tool_loop
from common import (
    BUDGET,
    CANDIDATES,
    DISTANCE,
    HELD,
    LANES,
    LIMIT,
    MARGIN,
    MODEL,
    PAYLOADS,
    REPEATS,
    TOLERANCE,
    Log,
    Moves,
    answer,
)
from matplotlib import rc_context
from matplotlib.figure import Figure

from stage import Stage, firmware
from stage.bench.statistics import interval, iqm
from stage.firmware.pcl240.driver import TUNED as REGISTERS
from stage.firmware.report import Report, rates
from stage.pictures import bare, title

SEEDS = 10  # fewer say nothing of who beats whom
STEP, MOST = 0.1, 3.0  # kg: payloads on top of the given one with which registers are tried again
DOCS = Path(__file__).parents[2] / "docs"


@dataclass(frozen=True)
class Method:
    """search(moves, seed) spends a budget; `fixed` is one that does not grow with --budget, of a method without chance."""

    name: str
    search: Callable[[Moves, int], None]
    color: str
    fixed: int | None = None
    space: str = "knobs"
    lanes: int = LANES
    part: float = 1.0  # of the budget

    def moves(self, budget: int) -> int:
        return self.fixed or max(int(budget * self.part), 1)


def lazily(name: str) -> Callable[[Moves, int], None]:
    """The search of a baseline whose extra may not be installed."""
    return lambda moves, seed: import_module(name).search(moves, seed)


FORMULA = Method("formula", formula.search, "#66717d", 1, "registers", 1)
BOLDEST = Method("formula, boldest", formula.boldest, "#1d2733", len(formula.FACTORS), "registers", 1)
METHODS = (
    FORMULA,
    BOLDEST,
    Method("agent loop", tool_loop.search, "#8a6bb8", 64, "registers", 1),
    Method("random", random_search.search, "#d9a441"),
    Method("CMA-ES", lazily("cma_es"), "#17508f", lanes=8),
    Method("PPO", lazily("ppo"), "#d1571f"),
    Method("SAC", lazily("sac"), "#4f9d69"),
    Method("random, raw registers", random_search.search, "#c9d1da", space="registers", part=1 / 4),
    Method("CMA-ES, raw registers", lazily("cma_es"), "#9fc3e6", space="registers", lanes=8, part=1 / 4),
)
QUICK = ("formula", "formula, boldest", "agent loop", "random", "CMA-ES")
DRAWN = [m for m in METHODS if m.space == "knobs"]


@dataclass
class Run:
    """One search and its answer (common.answer): registers, mean s and um of vibration in its proof.

    spare: kg more on the table with which it still keeps step. None and NaN where it found none. lucky: moves with a higher reward
    that are not the answer. kept: the share of its moves that lost no step. curve: see Log.curve.
    """

    method: str
    payload: str
    seed: int
    moves: int
    kept: float
    curve: list[float]
    registers: dict[str, int] | None = None
    duration: float = np.nan
    vibration: float = np.nan
    spare: float = np.nan
    lucky: int = 0

    @classmethod
    def of(cls, method: Method, payload: str, seed: int, log: Log, mass: float, model: str) -> Run:
        run = cls(method.name, payload, seed, len(log), float(np.mean(log.kept)), log.curve().tolist())
        rows = [log.registers[k] for k in log.ranking[:CANDIDATES]]
        proven = answer(rows, mass, model=model) if rows else None
        run.lucky = proven[0] if proven else len(rows)
        if proven:
            run.registers = dict(zip(REGISTERS, rows[run.lucky], strict=True))
            run.duration, run.vibration = (float(np.mean(v)) for v in (proven[1].duration, proven[1].vibration))
            run.vibration *= 1e6
            run.spare = spare(run.registers, mass, model)
        return run


@cache
def power_up(model: str) -> tuple[Stage, Any]:
    stage = Stage(model)
    stage.place(x=-DISTANCE / 2 * stage.axes["x"].meters_per_pulse)
    return stage, stage.snapshot()


def again(registers: dict[str, int], payload: float, model: str = MODEL) -> Report:
    """The move made by firmware, with its course."""
    stage, begin = power_up(model)
    stage.restore(begin)
    stage.set_payload(payload)
    r = registers
    profile = firmware.Profile(r["R1"], r["R2"], r["R2"], r["R4"], r["R5"], r["R7"])
    return firmware.preset_move(stage.axes["x"], DISTANCE, profile, down_point=r["R6"])


def spare(registers: dict[str, int], payload: float, model: str = MODEL) -> float:
    """kg that may be added, in steps of STEP, up to MOST, until the registers lose steps for the first time."""
    for k in range(1, round(MOST / STEP) + 1):
        if again(registers, payload + k * STEP, model).lost_steps:
            return (k - 1) * STEP
    return MOST


@dataclass
class Runs:
    """Everything that was run, kept in a file where one is given: what is in it is not run again."""

    budget: int
    seeds: int
    took: float
    runs: list[Run]
    payloads: dict[str, float]
    model: str = MODEL
    quick: bool = False

    @classmethod
    def read(cls, path: Path) -> Runs:
        kept = json.loads(path.read_text())
        return cls(**kept | {"runs": [Run(**r) for r in kept["runs"]]})

    def run_all(self, keep: Path | None) -> None:
        done = {(r.payload, r.method, r.seed) for r in self.runs}
        for payload, method in product(self.payloads, self.methods):
            for seed in range(1 if method.fixed else self.seeds):
                if (payload, method.name, seed) not in done:
                    self.run(payload, method, seed)
                    if keep:
                        keep.write_text(json.dumps(asdict(self)))

    @property
    def methods(self) -> list[Method]:
        return [m for m in METHODS if not self.quick or m.name in QUICK]

    def run(self, payload: str, method: Method, seed: int) -> None:
        began, mass = time.perf_counter(), self.payloads[payload]
        made: dict[str, Any] = {"lanes": method.lanes, "seed": seed, "model": self.model}
        with Moves(mass, method.moves(self.budget), method.space, **made) as moves:
            method.search(moves, seed)
        run = Run.of(method, payload, seed, moves.log, mass, self.model)
        took = time.perf_counter() - began
        self.runs.append(run)
        self.took += took
        print(
            f"{payload:6}{run.method:22} seed {seed}: {run.moves:4} moves, {run.kept:4.0%} kept step, {run.lucky:2} lucky; "
            f"{run.duration:.4f} s, {run.vibration:5.1f} um, {run.spare:.1f} kg to spare; took {took:.0f} s",
            flush=True,
        )


# The page


def of(runs: list[Run], payload: str, method: Method) -> list[Run]:
    return [r for r in runs if (r.payload, r.method) == (payload, method.name)]


def spread(values: list[float], form: str) -> str:
    """IQM, and its 95 % interval where there are several."""
    known = [v for v in values if v == v]
    if not known:
        return "none"
    middle = format(iqm(np.array(known)), form)
    low, high = (format(v, form) for v in interval(np.array(known)[:, None]))
    return middle if len(known) == 1 else f"{middle} ({low} to {high})"


def table(runs: list[Run], payload: str) -> list[str]:
    lines = [
        "| method | moves | seeds | duration, ms | steps lost | vibration, um | spare, kg | moves that kept step | lucky |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for method in METHODS:
        rs = of(runs, payload, method)
        if not rs:
            continue
        found = [r for r in rs if r.registers]
        some = f", {len(rs) - len(found)} of {len(rs)} found none" if len(found) < len(rs) else ""
        lines.append(
            f"| {method.name} | {rs[0].moves} | {'-' if method.fixed else len(rs)} "
            f"| {spread([1e3 * r.duration for r in rs], '.1f')}{some} | {0 if found else '-'} "
            f"| {spread([r.vibration for r in rs], '.0f')} | {spread([r.spare for r in rs], '.1f')} "
            f"| {np.mean([r.kept for r in rs]):.0%} | {spread([r.lucky for r in rs], '.0f')} |"
        )
    return lines


def verdict(runs: list[Run], payload: str, against: Method) -> str:
    """Which methods beat the formula: the interval of their gain is above 0, in SEEDS runs or more that all found an answer."""
    (base,) = of(runs, payload, against)
    if not base.registers:
        return f"**{payload}**: {against.name} found no move that can be repeated."
    yes, no, few = [], [], []
    for method in METHODS:
        durations = np.array([1e3 * r.duration for r in of(runs, payload, method)])
        if method in (FORMULA, BOLDEST) or not len(durations) or np.isnan(durations).all():
            continue
        gains = 1e3 * base.duration - durations[~np.isnan(durations)]
        text = f"{method.name} {iqm(gains):+.1f}"
        if len(durations) < SEEDS:
            few.append(f"{text} ({len(durations)} run{'s'[: len(durations) > 1]})")
            continue
        low, high = interval(gains[:, None])
        text += f" (95 % {low:+.1f} to {high:+.1f})"
        (yes if low > 0 and len(gains) == len(durations) else no).append(text)
    beaten, others = ("; ".join(side) or "none" for side in (yes, no))
    alone = f" Fewer than {SEEDS} runs, hence no verdict: {'; '.join(few)}." if few else ""
    return f"**{payload}, against {against.name}** ({1e3 * base.duration:.1f} ms): beaten by {beaten}. Not by {others}.{alone}"


def page(all_: Runs) -> str:
    runs, payloads_ = all_.runs, all_.payloads
    packages = (
        "pulsestage",
        "mujoco",
        "numpy",
        "optuna",
        "cmaes",
        *(() if all_.quick else ("stable-baselines3", "torch")),
    )
    versions = ", ".join(f"{p} {metadata.version(p)}" for p in packages)
    payloads = " and ".join(f"{kg:g} kg ({name})" for name, kg in payloads_.items())
    tables = [line for p, kg in payloads_.items() for line in (f"### {kg:g} kg, {p}", "", *table(runs, p), "")]
    verdicts = [f"- {verdict(runs, p, against)}" for p in payloads_ for against in (FORMULA, BOLDEST)]
    return TEXT.format(
        distance=DISTANCE, mm=DISTANCE * 3.125e-3, payloads=payloads, budget=all_.budget, seeds=all_.seeds, limit=LIMIT,
        tables="\n".join(tables), verdicts="\n".join(verdicts), versions=versions, minutes=all_.took / 60,
        moves=sum(r.moves for r in runs), safety=formula.SAFETY, step=STEP, most=MOST, held=HELD, margin=MARGIN,
        tolerance=TOLERANCE, repeats=REPEATS, candidates=CANDIDATES, model=all_.model, quick=" --quick" if all_.quick else "",
    )  # fmt: skip


def raw(all_: Runs) -> bytes:
    """Every run, a CSV packed by gzip: equal runs give equal bytes."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow("payload kg method seed moves kept duration_s vibration_um spare_kg lucky registers curve_s".split())
    for r in all_.runs:
        curve = " ".join(f"{v:.6f}" for v in r.curve)
        rows.writerow(
            [r.payload, all_.payloads[r.payload], r.method, r.seed, r.moves, r.kept, r.duration, r.vibration, r.spare, r.lucky,
             json.dumps(r.registers), curve]
        )  # fmt: skip
    return gzip.compress(text.getvalue().encode(), mtime=0)


TEXT = """# Learned and searched registers against the data sheet's formula

Made by `python scripts/baselines/results.py{quick} --budget {budget} --seeds {seeds}` (extras `rl`, `plot`): {moves} moves and the
proofs, {minutes:.0f} minutes on two cores. Do not edit.

The task is `stage/RegisterTuning-v0` on the X axis of `{model}`: one preset move of {distance} pulses ({mm:g} mm) with a PCL-240K,
with {payloads} on the table, at most {limit:g} s. As on a bench, each move begins at another rotor angle within
an electrical turn, and the payload is up to {tolerance:.0%} more or less. The reward is - duration - 1 ms for each um of vibration
(peak to peak, in the 0.1 s after the stop) - 5 for a lost step or pulses not made.

A method's answer, by the same rule for all: of its moves that kept step, the highest reward first, the first {held} (of up to
{candidates}) are taken that lose no step in {repeats} more moves with {margin:g} kg more on the table. Of these it is the one
with the highest mean reward in its proof. So every answer has the same margin, and no single lucky move decides. **lucky** counts
the moves with a higher reward that are not the answer. Interquartile means over the seeds (95 % interval by the bootstrap). All
runs:
[data/results.csv.gz](data/results.csv.gz).

![Learning curves, and the moves found](pictures/results.png)

{tables}
### Does it beat the formula?

Time in ms by which a method is faster than the formula: the interquartile mean over the seeds, with its interval. It beats the
formula where the interval is above 0, in ten seeds or more that all found an answer:

{verdicts}

## How to read it

- **formula** is an engineer's answer without a trial: pull-out torque, reflected inertia, friction, safety factor {safety}, and
  the best top rate for the distance ([formula.py](../scripts/baselines/formula.py)). **boldest** is the same formula after trials
  on the machine: safety factors from 2 down to 1, each tried once; the answer is
  found by the rule above. A search must beat this, not the textbook's factor.
- **random, CMA-ES, PPO, SAC** choose five factors on the formula's answer: FL, FH, acceleration, deceleration, ramp-down point.
  All but random begin at the formula's answer. **Raw registers** begin without it: R1, R2, R4, R5, R6, R7 over their
  whole legal ranges, where nearly every move loses steps or takes too long.
- The learning curves show the fastest move among those that had the highest reward of their seed when they were made.
- PPO and SAC learn a policy, here for one situation only; their result is the best of the moves that they made while learning.
- **agent loop** is a scripted agent that changes one register at a time, by tools alone (scripts/baselines/tool_loop.py).
- **spare** is the payload that may be added, in steps of {step:g} kg up to {most:g} kg, before the same registers lose steps for
  the first time. The reward does not include it, and a fast move has little of it: the formula's safety factor is of use. Losing
  steps is not monotonic: ramps pass resonances, and a faster or heavier move may keep step where a slower or lighter one does not.
- **What was tuned beforehand.** The safety factor is the textbook's. The formula's FL (an eighth of pull-in) and shortest ramp
  (four periods) were chosen after trials on these same stages; so were the ranges of the five factors, narrowed twice, CMA-ES's
  8 moves a generation (the rest are Optuna's defaults) and, mostly on the light payload, the settings of PPO and SAC. These trials
  had seed 0, which is one of the seeds here, and are not in any budget.
- **Steps lost are 0 by selection**: an answer that loses a step is refused. After {repeats} moves without a loss, up to one move in
  16 may still lose steps (95 % confidence), and more where several candidates were tried; the last two columns show how often
  moves lose some.

Budgets: {budget} moves a seed, {seeds} seeds (raw registers: a quarter of that). {versions}.
"""


# The picture


def draw(all_: Runs, path: Path) -> None:
    runs, payloads = all_.runs, all_.payloads
    figure = Figure(figsize=(6.25 * len(payloads), 8.4), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.12)
    with rc_context({"font.size": 10}):
        for (top, bottom), (payload, mass) in zip(
            figure.subplots(2, len(payloads), squeeze=False).T, payloads.items(), strict=True
        ):
            draw_the_learning(top, runs, payload)
            draw_the_moves(bottom, runs, payload, mass, all_.model)
            title(top, f"{mass:g} kg: fastest of the best moves so far", 12)
            title(bottom, f"{mass:g} kg: the moves found", 12)
            for ax in (top, bottom):
                bare(ax, size=9)
        handles, labels = bottom.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False, fontsize=11)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=140)


def draw_the_learning(ax: Any, runs: list[Run], payload: str) -> None:
    for base, style in ((FORMULA, "--"), (BOLDEST, ":")):
        (run,) = of(runs, payload, base)
        ax.axhline(run.duration * 1e3, color=base.color, ls=style, lw=1.6)
    for method in DRAWN:
        mine = of(runs, payload, method)
        if not mine:
            continue
        curves = np.minimum.accumulate(1e3 * np.nan_to_num(np.array([r.curve for r in mine]), nan=np.inf), axis=1)
        known = np.isfinite(curves).all(axis=0)
        at = np.arange(1, curves.shape[1] + 1)[known]
        ax.plot(at, np.median(curves[:, known], axis=0), color=method.color, lw=2)
        ax.fill_between(
            at, curves[:, known].min(axis=0), curves[:, known].max(axis=0), color=method.color, alpha=0.13, lw=0
        )
    ax.set(xlabel="moves made (median and span of the seeds)", ylabel="duration (ms)", xscale="log", xlim=(1, None))


def draw_the_moves(ax: Any, runs: list[Run], payload: str, mass: float, model: str) -> None:
    for method in (FORMULA, BOLDEST, *DRAWN):
        found = [r for r in of(runs, payload, method) if r.registers]
        if not found:
            continue
        best = sorted(found, key=lambda r: r.duration)[len(found) // 2]  # the median seed
        course = again(best.registers or {}, mass, model).course
        running = np.flatnonzero(~course.pin("hold"))
        t, rate = (course.seconds - course.seconds[running[0]]) * 1e3, rates(course) / 1e3
        shown = slice(running[0], running[-1] + 2)
        style = {FORMULA.name: "--", BOLDEST.name: ":"}.get(method.name, "-")
        ax.plot(np.r_[0, t[shown]], np.r_[0, rate[shown]], style, color=method.color, lw=1.7, label=method.name)
    ax.set(xlabel="time (ms; the seed in the middle)", ylabel="pulse rate (kpps)", ylim=(0, None), xlim=(0, None))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--budget", type=int, default=BUDGET, metavar="N", help="moves a seed")
    parser.add_argument("--seeds", type=int, default=SEEDS, metavar="N")
    parser.add_argument(
        "--out", type=Path, default=DOCS, metavar="FOLDER", help="of results.md and pictures/results.png"
    )
    parser.add_argument("--keep", type=Path, metavar="FILE", help="keep the runs there, and go on with what is there")
    parser.add_argument("--quick", action="store_true", help=f"{', '.join(QUICK)} alone, 64 moves, one payload")
    parser.add_argument("--model", default=MODEL, metavar="NAME", help="of the stage, or an MJCF file")
    parser.add_argument("--payload", type=float, nargs="+", metavar="KG", help="on the table (default: 0.5 and 10)")
    args = parser.parse_args()
    payloads = {f"{kg:g} kg": kg for kg in args.payload} if args.payload else PAYLOADS
    if args.quick:
        payloads, args.budget = dict([*payloads.items()][:1]), min(args.budget, 64)
    all_ = Runs(args.budget, args.seeds, 0.0, [], dict(payloads), args.model, args.quick)
    if args.keep and args.keep.exists():
        all_ = Runs.read(args.keep)
    all_.run_all(args.keep)
    draw(all_, args.out / "pictures" / "results.png")
    (args.out / "results.md").write_text(page(all_))
    (args.out / "data").mkdir(exist_ok=True)
    (args.out / "data" / "results.csv.gz").write_bytes(raw(all_))
    print(f"{args.out}: results.md, pictures/results.png and data/results.csv.gz written")


if __name__ == "__main__":
    main()
