"""Survey of how well the automatic ramp-down point ends a move: thousands of random moves; all numbers of docs/ramp_down.md.

python scripts/ramp_down_survey.py                 the tables, and docs/pictures/ramp_down.png
python scripts/ramp_down_survey.py --moves 2000 --seed 7 --picture ramp_down.png
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))
from support.pcl240ms_bench import excuse, random_move, run_move, span_of  # noqa: E402

SHAPES = "linear", "S, no linear part", "S with linear part", "S, R15 shorter", "S, R15 longer"
TOPS = "trapezoid", "FH corrected", "triangle"
ROUNDING = "rounding to whole pulses"


def classify_ramps(move):
    """Return the name in SHAPES of a move's ramps: linear, equal S-curves, or a ramp-down of another length."""
    r, gain = move.registers, move.fh - move.registers.R1
    up, down = span_of(r.R14, gain), span_of(r.R15, gain)
    if move.linear:
        return SHAPES[0]
    if up == down:
        return SHAPES[1 if up == gain / 2 else 2]
    return SHAPES[3 if up > down else 4]


def classify_top(move, ending):
    """Return the name in TOPS of the highest rate of a move."""
    if move.fh < move.registers.R2:
        return "FH corrected"
    return "trapezoid" if ending.peak == move.fh else "triangle"


def ends_above(move, ending):
    """Return whether a move ends above FL."""
    return ending.speed > move.registers.R1


def compute_ramp_down_pulses(move, ending):
    """Compute the pulses of the ramp-down by the data sheet's formula for R6."""
    r = move.registers._replace(R2=ending.peak)
    gain = r.R2 - r.R1
    span = gain / 2 if move.linear else span_of(r.R15, gain)
    return (r.R1 + r.R2) * (gain + 2 * span) * r.R4 / (r.R7 * 32768)


def print_row(*cells):
    print("| " + " | ".join(str(c) for c in cells) + " |")


def format_quantiles(values, percents, digits=0):
    return " / ".join(f"{v:,.{digits}f}" for v in np.percentile(values, percents))


def survey(count, seed):
    rng = np.random.default_rng(seed)
    moves = [random_move(rng)._replace(offset=0) for _ in range(count)]
    endings = [run_move(move) for move in moves]
    exact = sum(e.r0 == 0 and e.pulses == m.r0 for m, e in zip(moves, endings, strict=True))
    runs = [(m, e) for m, e in zip(moves, endings, strict=True) if e.peak > m.registers.R1]
    print(
        f"{count} random moves, seed {seed}, R6 = 0: {exact} ended exactly at R0 = 0; {count - len(runs)} had no ramp\n"
    )
    print_row("ramps", "moves", "pulses at FL: median / 90 % / maximum", "late by: 10 % / median / 90 %", "above FL")
    print_row("---", *["--:"] * 4)
    for kind in SHAPES[:3]:
        for end in TOPS:
            print_group(
                f"{kind}, {end}", [(m, e) for m, e in runs if classify_ramps(m) == kind and classify_top(m, e) == end]
            )
    for kind in SHAPES[3:]:
        print_group(kind, [(m, e) for m, e in runs if classify_ramps(m) == kind])
    print_group("all", runs)
    short = [e.peak < m.fh for m, e in runs if classify_ramps(m) == SHAPES[3] and classify_top(m, e) == TOPS[1]]
    print(
        f"\nof {len(short)} FH corrected moves with R15 shorter, {np.mean(short):.0%} start down before the revised R2"
    )
    count_reasons(runs)
    return runs


def print_group(name, group):
    if not group:
        return
    above = f"{np.mean([ends_above(m, e) for m, e in group]):.0%}"
    delays = format_quantiles([e.delay for _, e in group], (10, 50, 90), 1)
    print_row(name, f"{len(group):,}", format_quantiles([e.at_fl for _, e in group], (50, 90, 100)), delays, above)


def count_reasons(runs):
    print()
    print_row("ends above FL", "R6 = 0", "R6 = 2", "pulses of the ramp left: median / 90 % / maximum")
    print_row("---", *["--:"] * 3)
    above = [(m, e, excuse(m, e) or ROUNDING) for m, e in runs if ends_above(m, e)]
    two = [(m, run_move(m._replace(offset=2))) for m, _ in runs]
    still = Counter(excuse(m, e) or ROUNDING for m, e in two if ends_above(m, e))
    for why, moves in Counter(why for *_, why in above).most_common():
        lefts = format_quantiles([e.left for _, e, reason in above if reason == why], (50, 90, 100), 2)
        print_row(why, f"{100 * moves / len(runs):.1f} %", f"{100 * still[why] / len(runs):.1f} %", lefts)
    shares = [
        100 * (e.speed - m.registers.R1) / (e.peak - m.registers.R1)
        for m, e, why in above
        if why == ROUNDING and compute_ramp_down_pulses(m, e) >= 100
    ]
    print(
        f"\nwhere rounding alone is why and the ramp has 100 pulses or more, the last pulse comes at\n"
        f"{format_quantiles(shares, (50, 90, 100), 1)} % of the way from FL to the top speed (median / 90 % / most)"
    )


def draw(runs, path):
    from stage.support.plot_style import COLORS, MUTED_COLOR, TEXT_COLOR, make_figure, remove_frame, set_title

    colors = dict(zip(SHAPES, (MUTED_COLOR, COLORS[0], COLORS[2], COLORS[1]), strict=False))
    fig = make_figure(10, 3.9)
    left, right = fig.subplots(1, 2, width_ratios=(1.1, 1))
    for kind, color in colors.items():
        values = np.sort([e.at_fl for m, e in runs if classify_ramps(m) == kind and not excuse(m, e)])
        left.plot(
            values, np.linspace(0, 100, len(values)), drawstyle="steps-pre", color=color, linewidth=1.6, label=kind
        )
    left.set_xscale("symlog", linthresh=1, linscale=0.5)
    left.set_xlim(0, None)
    left.set_ylim(0, 101)
    left.set_xlabel("pulses at FL at the end", color=TEXT_COLOR)
    left.set_ylabel("% of the moves", color=TEXT_COLOR)
    left.legend(frameon=False, fontsize=8, labelcolor=TEXT_COLOR, loc="lower right")
    alike = SHAPES[:3]
    delays = [[e.delay for m, e in runs if classify_ramps(m) == k and not excuse(m, e)] for k in alike]
    right.hist(delays, np.linspace(-2, 4, 61), stacked=True, color=[colors[k] for k in alike], label=alike)
    right.axvline(0, color=TEXT_COLOR, linewidth=0.8, linestyle=(0, (4, 4)))
    right.set_xlabel("pulses from the end of the ramp-down to the last pulse", color=TEXT_COLOR)
    right.set_ylabel("moves", color=TEXT_COLOR)
    right.legend(frameon=False, fontsize=8, labelcolor=TEXT_COLOR, loc="upper right")
    for ax in (left, right):
        remove_frame(ax)
    set_title(left, "How long the end at FL is")
    set_title(right, "When the last pulse comes")
    fig.savefig(path, dpi=150)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moves", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=240)
    parser.add_argument("--picture", default=str(ROOT / "docs/pictures/ramp_down.png"))
    args = parser.parse_args()
    draw(survey(args.moves, args.seed), args.picture)
