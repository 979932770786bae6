"""Comparison of all baselines: runs every method with its budget and seeds, for a light and a heavy payload, and writes the page.

python -m registerbench.baselines.baseline_comparison            writes docs/results.md, which states the duration, picture and data
python -m registerbench.baselines.baseline_comparison --draw     writes page and picture from data/results.parquet in seconds
python -m registerbench.baselines.baseline_comparison --quick --out build/results      no PPO and SAC, 64 moves, one payload
python -m registerbench.baselines.baseline_comparison --model xy --payload 2 5 --out build/results

Needs the extras `rl`, `plot` and `data`.
"""

from __future__ import annotations

import argparse
import shlex
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from registerbench.baselines import formula
from registerbench.baselines.method_runs import (
    BOLDEST_FORMULA_METHOD,
    EXTRA_PAYLOADS_KG,
    FORMULA,
    METHODS,
    MIN_DISTANCE_PULSES,
    NEW_MOVES,
    QUICK_METHODS,
    SHORTER_MOVES,
    TEST_CONDITIONS,
    Method,
    MethodRun,
    MethodRuns,
)
from registerbench.baselines.move_tuning import (
    CANDIDATES,
    DISTANCE_PULSES,
    MAX_HOLDING_MOVES,
    MAX_MOVE_TIME_S,
    MODEL,
    PAYLOAD_MARGIN_KG,
    PAYLOAD_TOLERANCE,
    PAYLOADS_KG,
    REPEATS,
)
from registerbench.score_statistics import compute_interval, compute_iqm
from stage import Stage, firmware
from stage.firmware.move_report import Report, compute_rates
from stage.support.plot_style import remove_frame, set_title

BUDGET, SEEDS = 256, 10  # moves for each seed; fewer seeds allow no verdict
MM_PER_PULSE = 3.125e-3  # travel for one pulse, mm
DOCS = Path(__file__).parents[2] / "docs"
PLOTTED_METHODS = [m for m in METHODS if m.space == "knobs"]


@cache
def get_power_up_state(model: str) -> tuple[Stage, Any]:
    """Return a stage of a model and its snapshot at power-up."""
    stage = Stage(model)
    stage.place(x=-DISTANCE_PULSES / 2 * stage.axes["x"].meters_per_pulse)
    return stage, stage.snapshot()


def repeat_move(registers: dict[str, int], payload: float, model: str = MODEL) -> Report:
    """Repeat the move of an answer with `stage.firmware`.

    Args:
        registers: Registers of the answer by name.
        payload: Mass on the table, kg.
        model: Name of the model.

    Returns:
        The report with the waveform.
    """
    stage, begin = get_power_up_state(model)
    stage.restore(begin)
    stage.set_payload(payload)
    r = registers
    profile = firmware.Profile(r["R1"], r["R2"], r["R2"], r["R4"], r["R5"], r["R7"])
    return firmware.preset_move(stage.axes["x"], DISTANCE_PULSES, profile, down_point=r["R6"])


# The page


def select_runs(runs: list[MethodRun], payload: str, method: Method) -> list[MethodRun]:
    """Return the runs of a method with a payload."""
    return [r for r in runs if (r.payload, r.method) == (payload, method.name)]


def format_iqm_with_interval(values: list[float], form: str) -> str:
    """Format the interquartile mean, with its 95 % interval if there are several runs.

    Args:
        values: Value of each run; NaN for a run without an answer.
        form: Format specification of a number.
    """
    known = [v for v in values if v == v]
    if not known:
        return "none"
    middle = format(compute_iqm(np.array(known)), form)
    low, high = (format(v, form) for v in compute_interval(np.array(known)[:, None]))
    return middle if len(known) == 1 else f"{middle} ({low} to {high})"


def format_loss_counts(runs: list[MethodRun], context: str) -> str:
    """Format the number of moves that lost steps in all tests, and the number of answers with such a move.

    Args:
        runs: Runs of one method and payload.
        context: Name of the test context.
    """
    lost = [r.count_failed_moves(context) for r in runs if r.test_logs]
    if not lost:
        return "none"
    some = f", {np.count_nonzero(lost)} of {len(lost)} answers" if any(lost) and len(lost) > 1 else ""
    return f"{sum(lost)} of {len(lost) * TEST_CONDITIONS[context].moves}{some}"


def format_table(runs: list[MethodRun], payload: str) -> list[str]:
    """Return the lines of the table of all methods for a payload."""
    lines = [
        "| method | moves | seeds | reward, ms | time, ms | vibration, um | lost: new moves | lost: shorter moves | spare, kg "
        "| moves that kept step | lucky |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for method in METHODS:
        rs = select_runs(runs, payload, method)
        if not rs:
            continue
        none = sum(r.answer_number is None for r in rs)
        some = f", {none} of {len(rs)} found none" if none else ""
        lines.append(
            f"| {method.name} | {len(rs[0].search_log)} | {'-' if method.fixed_moves else len(rs)} "
            f"| {format_iqm_with_interval([r.compute_mean('reward') for r in rs], '.1f')}{some} "
            f"| {format_iqm_with_interval([r.compute_mean('duration') for r in rs], '.1f')} "
            f"| {format_iqm_with_interval([r.compute_mean('vibration') for r in rs], '.0f')} "
            f"| {format_loss_counts(rs, NEW_MOVES)} | {format_loss_counts(rs, SHORTER_MOVES)} "
            f"| {format_iqm_with_interval([r.spare_payload for r in rs], '.1f')} "
            f"| {np.mean([r.in_step_share for r in rs]):.0%} | "
            f"{format_iqm_with_interval([r.lucky_move_count for r in rs], '.0f')} |"
        )
    return lines


class GainOverFormula(NamedTuple):
    """Milliseconds by which a method is better than a formula.

    Attributes:
        beats: Whether the method beats the formula; None if there are too few runs for a verdict.
        loses: Whether the formula beats the method.
        text: Gain with its interval, for the table.
    """

    beats: bool | None
    loses: bool
    text: str


def compute_gain(runs: list[MethodRun], base: MethodRun, name: str, in_step: bool = False) -> GainOverFormula:
    """Compute the interquartile mean of the gain over the runs that found an answer.

    Args:
        runs: Runs of one method and payload.
        base: Run of the formula.
        name: "reward" or "duration".
        in_step: Whether to leave out the moves that lost steps.
    """
    sign = 1 if name == "reward" else -1
    values = sign * np.array([r.compute_mean(name, in_step) - base.compute_mean(name, in_step) for r in runs])
    known = values[~np.isnan(values)]
    if len(runs) < SEEDS:
        return GainOverFormula(None, False, f"{compute_iqm(known):+.1f}")
    low, high = compute_interval(known[:, None])
    return GainOverFormula(
        bool(low > 0 and len(known) == len(runs)),
        bool(high < 0),
        f"{compute_iqm(known):+.1f} ({low:+.1f} to {high:+.1f})",
    )


def compute_gains(
    runs: list[MethodRun], payload: str, against: Method
) -> dict[Method, tuple[GainOverFormula, GainOverFormula, GainOverFormula]]:
    """Compute each method's gains in reward, in time, and in reward without the moves that lost steps."""
    (base,) = select_runs(runs, payload, against)
    some = {m: select_runs(runs, payload, m) for m in METHODS if m not in (FORMULA, BOLDEST_FORMULA_METHOD)}
    return {
        m: (
            compute_gain(rs, base, "reward"),
            compute_gain(rs, base, "duration"),
            compute_gain(rs, base, "reward", in_step=True),
        )
        for m, rs in some.items()
        if any(r.answer_number is not None for r in rs)
    }


def describe_verdict(runs: list[MethodRun], payload: str, against: Method) -> str:
    """Describe in a paragraph which methods beat a formula.

    Args:
        runs: All runs.
        payload: Name of the payload.
        against: FORMULA or BOLDEST.
    """
    (base,) = select_runs(runs, payload, against)
    if base.answer_number is None:
        return f"**{payload}**: {against.name} found no move that can be repeated."
    every = compute_gains(runs, payload, against)

    def list_names(which: int, beats: bool, loses: bool) -> str:
        """List the names of the methods with a verdict on one of the gains, in words.

        Args:
            which: Index of the gain, as in `compute_gains`.
            beats: Whether to list methods that beat the formula.
            loses: Whether to list methods that the formula beats.
        """
        some = [m.name for m, g in every.items() if (g[which].beats, g[which].loses) == (beats, loses)]
        return ", ".join(some) or "none"

    few = [m.name for m, g in every.items() if g[0].beats is None]
    alone = f" Fewer than {SEEDS} runs, hence no verdict: {', '.join(few)}." if few else ""
    return (
        f"**{payload}, against {against.name}** ({base.compute_mean('reward'):.1f} ms, "
        f"time {base.compute_mean('duration'):.1f} ms): "
        f"by reward it is beaten by {list_names(0, True, False)}; better than {list_names(0, False, True)}; "
        f"open: {list_names(0, False, False)}. "
        f"In time it is beaten by {list_names(1, True, False)}; better than {list_names(1, False, True)}; "
        f"open: {list_names(1, False, False)}.{alone}"
    )


def format_gain_table(runs: list[MethodRun], payloads: dict[str, float]) -> list[str]:
    """Format the table of the gain of each method over the two formulas, from which the page draws its verdicts."""
    lines = [
        "| payload | against | method | runs | by reward, ms | in time, ms | by reward where steps were kept, ms |",
        "|---|---|---|---|---|---|---|",
    ]
    for payload in payloads:
        for against in (FORMULA, BOLDEST_FORMULA_METHOD):
            if select_runs(runs, payload, against)[0].answer_number is not None:
                for method, some in compute_gains(runs, payload, against).items():
                    count = len(select_runs(runs, payload, method))
                    text = " | ".join(g.text for g in some)
                    lines.append(f"| {payload} | {against.name} | {method.name} | {count} | {text} |")
    return lines


def describe_reward_excess(runs: list[MethodRun]) -> str:
    """Describe by how much the rewards in proofs exceed those in tests, leaving out the formula."""
    excesses = [r.reward_excess for r in runs if r.test_logs and r.method != FORMULA.name]
    (formula_excess, *_) = [r.reward_excess for r in runs if r.method == FORMULA.name]
    return (
        f"In its proof, by which it was\nchosen, an answer had {np.mean(excesses):.0f} ms more reward than in its test (median "
        f"{np.median(excesses):.1f}; the formula, of which nothing is chosen, {formula_excess:.1f}):\n"
        "nearly all of this difference comes from steps lost only in the test."
    )


def describe_price_of_losses(runs: list[MethodRun]) -> str:
    """Describe how much reward a lost step costs, from the new moves that lost steps."""
    logs = [r.test_logs[NEW_MOVES] for r in runs if r.test_logs]
    lost = [(log.reward[k], log.drawn[k][0]) for log in logs for k in np.flatnonzero(~np.array(log.in_step))]
    if not lost:
        return "Here no new move lost a step."
    reward, back = float(np.mean([reward for reward, _ in lost])), sum(distance < 0 for _, distance in lost)
    return (
        f"Of the {len(lost)} new moves that lost steps {back} went in\n"
        "  the other direction, which no search and no proof has tried. Such a move has a reward of "
        f"{reward:.0f} s on average, 5 of them the price and\n  most of the rest its shaking: one in "
        f"{TEST_CONDITIONS[NEW_MOVES].moves} takes {-1e3 * reward / TEST_CONDITIONS[NEW_MOVES].moves:.0f} ms off a "
        f"mean. So losses, "
        "rare as they are, decide who is ahead by reward."
    )


def format_command(method_runs: MethodRuns) -> str:
    """Return the command line that makes the page."""
    words = ["python", "-m", "registerbench.baselines.baseline_comparison", *(["--quick"] if method_runs.quick else [])]
    words += ["--model", method_runs.model] if method_runs.model != MODEL else []
    if not method_runs.payloads.items() <= PAYLOADS_KG.items():
        words += ["--payload", *(f"{kg:g}" for kg in method_runs.payloads.values())]
    return shlex.join([*words, "--budget", str(method_runs.budget), "--seeds", str(method_runs.seeds)])


def format_page(method_runs: MethodRuns) -> str:
    """Return the text of docs/results.md."""
    runs, payloads_ = method_runs.runs, method_runs.payloads
    versions = ", ".join(f"{p} {v}" for p, v in method_runs.versions.items())
    payloads = " and ".join(f"{kg:g} kg ({name})" for name, kg in payloads_.items())
    tables = [line for p, kg in payloads_.items() for line in (f"### {kg:g} kg, {p}", "", *format_table(runs, p), "")]
    verdicts = [
        f"- {describe_verdict(runs, p, against)}" for p in payloads_ for against in (FORMULA, BOLDEST_FORMULA_METHOD)
    ]
    return TEXT.format(
        made_by=format_command(method_runs), distance=DISTANCE_PULSES, mm=DISTANCE_PULSES * MM_PER_PULSE, payloads=payloads,
        budget=method_runs.budget, seeds=method_runs.seeds,
        limit=MAX_MOVE_TIME_S, tables="\n".join(tables), verdicts="\n".join(verdicts),
        comparison="\n".join(format_gain_table(runs, payloads_)),
        versions=versions, minutes=method_runs.took / 60, moves=sum(len(r.search_log) for r in runs),
        more=sum(len(log) for r in runs for log in (*r.proof_logs.values(), *r.test_logs.values())), safety=formula.SAFETY_FACTOR,
        held=MAX_HOLDING_MOVES, margin=PAYLOAD_MARGIN_KG, tolerance=PAYLOAD_TOLERANCE, repeats=REPEATS,
        candidates=CANDIDATES, model=method_runs.model,
        new=TEST_CONDITIONS[NEW_MOVES].moves, shorter=TEST_CONDITIONS[SHORTER_MOVES].moves,
        shortest=MIN_DISTANCE_PULSES * MM_PER_PULSE,
        each=TEST_CONDITIONS[f"+{EXTRA_PAYLOADS_KG[0]:g} kg"].moves, step=EXTRA_PAYLOADS_KG[0], most=EXTRA_PAYLOADS_KG[-1],
        flattered=describe_reward_excess(runs),
        enough=SEEDS,
        priced=describe_price_of_losses(runs),
    )  # fmt: skip


TEXT = """# Learned and searched registers against the data sheet's formula

Made by `{made_by}` (extras `rl`, `plot`, `data`): {moves} moves of
searches, {more} more of proofs and tests, {minutes:.0f} minutes on two cores. Do not edit.

**Made with physics 1**, in which motors had no core loss. Since physics 2 every stepper is weaker at speed
([drives.md](../../../docs/drives.md)): moves take longer than here, and another method may lead.

The task is `stage/RegisterTuning-v0` on the X axis of `{model}`: one preset move of {distance} pulses ({mm:g} mm) with a PCL-240K,
with {payloads} on the table, at most {limit:g} s. As on a bench, each move begins at another rotor angle within
an electrical turn, and the payload is up to {tolerance:.0%} more or less. **The reward** is - time - 1 ms for each um of vibration
(peak to peak, in the 0.1 s after the stop) - 5 s for a lost step or pulses not made; this page states it in ms. Searches and
learners maximize it, and answers are chosen and judged by it; the tables also show time and vibration.

**A method's answer** follows from the same rule for all methods. Of its moves that kept step, the highest reward first, the rule
takes the first {held} (of up to {candidates}) that lose no step in {repeats} more moves, each with 0 to {margin:g} kg more on the
table. The answer is the one of these with the highest mean reward in this proof.

**The results** come from a test, the same for all, which neither a search nor a proof has used, and by which nothing is
chosen: {new} new moves, half of them in the other direction, with other rotor angles and payloads, 0 to {margin:g} kg more;
and {shorter} shorter ones ({shortest:g} to {mm:g} mm) with the same registers, of which only losses are counted. Numbers are
interquartile means over the seeds (95 % interval by the bootstrap over seeds). {flattered}
Every move of searches, proofs and tests: [data/results.parquet](data/results.parquet).

![Learning curves, and the moves found](pictures/results.png)

{tables}
### Does it beat the formula?

The table shows by how many ms a method is better than the formula in the test: the interquartile mean over the seeds, with its
interval. A method beats the formula if the interval is above 0, in {enough} seeds or more that all found an answer; the formula is
better if the interval is below 0; otherwise it is open. Such an interval covers the seeds, on these moves and this machine. The
last column omits the moves that lost steps: it is the gain of a method while all goes well.

{verdicts}

{comparison}

## How to read it

- **formula** is an engineer's answer without a trial: pull-out torque, reflected inertia, friction, safety factor {safety}, and
  the best top rate for the distance ([formula.py](../registerbench/baselines/formula.py)). **boldest** is the same formula
  after trials on the machine: safety factors from 2 down to 1, each tried once; the rule above, which uses the reward, finds the
  answer. It is therefore not the fastest of the factors that work: it may be slower than the plain formula if it causes less
  vibration. A search must beat this, not the textbook's factor.
- **random, CMA-ES, PPO, SAC** choose five factors on the formula's answer: FL, FH, acceleration, deceleration, ramp-down point.
  All except random begin at the formula's answer. **Raw registers** begin without it: R1, R2, R4, R5, R6, R7 over their
  whole legal ranges, where nearly every move loses steps or takes too long.
- The learning curves show the highest reward of a single move so far that kept step. It is higher than that of an answer, because
  such a move may have been lucky. The horizontal lines are the results of the formulas in the test.
- PPO and SAC learn a policy, here for one situation only; their result is the best of the moves that they made during learning.
- **agent loop** is a scripted agent that changes one register at a time, by tools alone (tool_calling_agent.py). It contains no
  chance: one run.
- **lucky** counts the moves with a higher reward that are not the answer; **moves that kept step** are those of the search.
- **The promise** of an answer is that no step was lost in the {repeats} moves of its proof, with 0 to {margin:g} kg more. That
  is a sample: up to one move in 16 may still lose steps (95 % confidence), and more if several candidates were tried. The
  columns **lost** count them. {priced}
- **spare** is tested, not promised: the payload, in steps of {step:g} kg up to {most:g} kg, that was added without a loss
  in {each} moves each, in both directions. Neither reward nor proof covers more than {margin:g} kg, and a fast move has little
  spare: this is the use of the formula's safety factor.
- Losing steps is not monotonic: ramps pass resonances, and a faster or heavier move may keep step where a slower or lighter one
  does not. A proof with just {margin:g} kg more therefore proves nothing for less: with such a proof, four published answers lost
  steps at once with less, one of them (random, light) in 66 of 96 moves with the payload itself.
- **Tuning beforehand.** The safety factor is the textbook's. We chose the formula's FL (an eighth of pull-in) and shortest ramp
  (four periods) after trials on these same stages; in the same way we chose the ranges of the five factors, narrowed twice,
  CMA-ES's 8 moves per generation (the rest are Optuna's defaults) and, mostly on the light payload, the settings of PPO and SAC.
  These trials had seed 0, which is none of the seeds here (1 to {seeds}). They used the same two payloads, and are
  not part of any budget.

Budgets: {budget} moves per seed, {seeds} seeds (raw registers: a quarter of the moves). {versions}.
"""


# The picture


def draw_comparison(method_runs: MethodRuns, path: Path) -> None:
    """Draw the learning curves and the moves of all methods into one PNG file."""
    runs, payloads = method_runs.runs, method_runs.payloads
    figure = Figure(figsize=(6.25 * len(payloads), 8.4), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.12)
    with rc_context({"font.size": 10}):
        for (top, bottom), (payload, mass) in zip(
            figure.subplots(2, len(payloads), squeeze=False).T, payloads.items(), strict=True
        ):
            draw_learning_curves(top, runs, payload)
            draw_move_rates(bottom, runs, payload, mass, method_runs.model)
            set_title(top, f"{mass:g} kg: highest reward of a move so far", 12)
            set_title(bottom, f"{mass:g} kg: the moves found", 12)
            for ax in (top, bottom):
                remove_frame(ax, size=9)
        handles, labels = bottom.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False, fontsize=11)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=140)


def draw_learning_curves(ax: Any, runs: list[MethodRun], payload: str) -> None:
    """Draw the highest reward after each move of each method, for a payload."""
    for base, style in ((FORMULA, "--"), (BOLDEST_FORMULA_METHOD, ":")):
        (run,) = select_runs(runs, payload, base)
        ax.axhline(run.compute_mean("reward"), color=base.color, ls=style, lw=1.6)
    for method in PLOTTED_METHODS:
        selected_runs = select_runs(runs, payload, method)
        if not selected_runs:
            continue
        curves = 1e3 * np.array([r.search_log.compute_best_rewards_so_far() for r in selected_runs])
        known = np.isfinite(curves).all(axis=0)
        at = np.arange(1, curves.shape[1] + 1)[known]
        ax.plot(at, np.median(curves[:, known], axis=0), color=method.color, lw=2)
        ax.fill_between(
            at, curves[:, known].min(axis=0), curves[:, known].max(axis=0), color=method.color, alpha=0.13, lw=0
        )
    ax.set(xlabel="moves made (median and span of the seeds)", ylabel="reward (ms)", xscale="log", xlim=(1, None))


def draw_move_rates(ax: Any, runs: list[MethodRun], payload: str, mass: float, model: str) -> None:
    """Draw the pulse rates of the answers' moves over time, for a payload.

    Args:
        ax: Axes of Matplotlib.
        runs: All runs.
        payload: Name of the payload.
        mass: Payload, kg.
        model: Name of the model.
    """
    for method in (FORMULA, BOLDEST_FORMULA_METHOD, *PLOTTED_METHODS):
        answered = [r for r in select_runs(runs, payload, method) if r.answer_number is not None]
        if not answered:
            continue
        middle = sorted(answered, key=lambda r: r.compute_mean("reward"))[len(answered) // 2]
        waveform = repeat_move(middle.registers, mass, model).waveforms
        running = np.flatnonzero(~waveform.pin("hold"))
        t, rate = (waveform.seconds - waveform.seconds[running[0]]) * 1e3, compute_rates(waveform) / 1e3
        moving = slice(running[0], running[-1] + 2)
        style = {FORMULA.name: "--", BOLDEST_FORMULA_METHOD.name: ":"}.get(method.name, "-")
        ax.plot(np.r_[0, t[moving]], np.r_[0, rate[moving]], style, color=method.color, lw=1.7, label=method.name)
    ax.set(xlabel="time (ms; the seed in the middle)", ylabel="pulse rate (kpps)", ylim=(0, None), xlim=(0, None))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--budget", type=int, default=BUDGET, metavar="N", help="moves a seed")
    parser.add_argument("--seeds", type=int, default=SEEDS, metavar="N")
    parser.add_argument("--out", type=Path, default=DOCS, metavar="FOLDER", help="of page, picture and data")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="keep the runs there, and go on with what is there")
    parser.add_argument("--quick", action="store_true", help=f"{', '.join(QUICK_METHODS)} alone, 64 moves, one payload")
    parser.add_argument("--model", default=MODEL, metavar="NAME", help="of the stage, or an MJCF file")
    parser.add_argument("--payload", type=float, nargs="+", metavar="KG", help="on the table (default: 0.5 and 10)")
    parser.add_argument(
        "--draw", action="store_true", help="page and picture from data/results.parquet; nothing is run"
    )
    args = parser.parse_args()
    payloads = {f"{kg:g} kg": kg for kg in args.payload} if args.payload else PAYLOADS_KG
    if args.quick:
        payloads, args.budget = dict([*payloads.items()][:1]), min(args.budget, 64)
    data = args.out / "data" / "results.parquet"
    if not args.draw:
        all_ = MethodRuns(args.budget, args.seeds, dict(payloads), args.model, args.quick)
        if args.keep and args.keep.exists():
            all_ = MethodRuns.read(args.keep)
        all_.run_all(args.keep)
        data.parent.mkdir(parents=True, exist_ok=True)
        all_.write(data)
    all_ = MethodRuns.read(data)  # what is published is what the page says
    draw_comparison(all_, args.out / "pictures" / "results.png")
    (args.out / "results.md").write_text(format_page(all_))
    print(f"{args.out}: results.md and pictures/results.png written, from data/results.parquet")


if __name__ == "__main__":
    main()
