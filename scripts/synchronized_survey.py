"""Survey of how straight a:b moves are: 200 random pairs of distances on emulated chips; all numbers of docs/synchronized.md.

python scripts/synchronized_survey.py                     the tables
python scripts/synchronized_survey.py --pictures          and docs/pictures/synchronized*.png
python scripts/synchronized_survey.py --s-curve           PCL240MS with S-curves; --s-curve 0.2: with a linear part
python scripts/synchronized_survey.py --automatic         PCL240MK with the automatic ramp-down point; or both
"""

import argparse
import random
import time

import numpy as np

from stage import ArgumentError
from stage.chips import PCL240K, PCL240MK, PCL240MS
from stage.firmware import Bench, plan, synchronized_move
from stage.firmware.path_deviation import compute_path_deviation
from stage.firmware.pcl240.emulated_preset_move import trace_preset_move
from stage.firmware.pcl240.preset_move_closed_form import compute_ramp_stretch, set_s_curve_registers

DELAYS = (1e-6, 1e-5, 1e-4)


class MovePlanner:
    """Planner of a:b moves of one chip with one shape of ramps.

    Args:
        chip: Class of the chips.
        **shape: Shape of the ramps, as arguments of the planner.
    """

    def __init__(self, chip=PCL240K, **shape):
        self.chip, self.shape = chip, shape

    def __call__(self, distances, bus_cycle=1e-6, **options):
        """Run one on new chips."""
        bench = Bench(**{n: self.chip() for n in distances}, bus_cycle=bus_cycle)
        return synchronized_move(distances, bench, **self.shape, **options)

    def plan(self, distances, **options):
        return plan(distances, chips=self.chip, **self.shape, **options)

    def row(self, *registers):
        """Return the registers as a row with the S-curve registers of this shape."""
        share = float(self.shape.get("s_curve", 0.0))
        row = np.array([*registers, *[0] * (2 * self.chip.S_CURVES)])
        set_s_curve_registers(row, min(share, 0.5))
        return row

    def __str__(self):
        shape = ", ".join(f"{k} {v:g}" if isinstance(v, float) else k for k, v in self.shape.items())
        return f"{self.chip.MAP.chip}{', ' + shape if shape else ''}"


def draw_random_distances(rng, names, low=100, high=50_000):
    return {n: rng.choice((-1, 1)) * rng.randint(low, high) for n in names}


def compute_common_multiplier_deviation(moves, line_plan):
    """Compute the deviation when both axes use one R7, the finest that reaches the rate.

    All other registers are rounded to the nearest value; R6 is Psd and 5 pulses of the longest axis.
    """
    long = line_plan.axes[line_plan.order[-1]]
    r7 = int(long.clock_hz * 8191 / (8192 * long.fh))
    step = long.clock_hz / (8192 * r7)
    pulses = []
    for axis in line_plan.axes.values():
        ratio = abs(axis.distance) / abs(long.distance)
        low, high = (max(1, round(ratio * rate / step)) for rate in (long.fl, long.fh))
        row = moves.row(abs(axis.distance), low, high, high, 2, 2, 0, r7)
        gain, limit = max(high - low, 1) * compute_ramp_stretch(row), axis.chip.MAP.register("R4").mask
        row[4], row[5] = (
            min(max(round(t * long.clock_hz / gain), 2), limit) for t in (long.accel_time, long.decel_time)
        )
        down = (high + low) * gain * row[5] / (16384 * r7)
        row[6] = min(int(down) + max(1, round(5 * ratio)), abs(axis.distance))
        pulses.append((trace_preset_move(row, axis.chip), 1))
    return compute_path_deviation(pulses, [abs(a.distance) for a in line_plan.axes.values()]).pulses


def print_row(name, values, unit=""):
    v = np.asarray(values)
    median, limit, top = np.percentile(v, (50, 95, 100))
    print(f"| {name:44} | {median:8.3g}{unit} | {limit:8.3g}{unit} | {top:8.3g}{unit} | {np.mean(v <= 2):6.1%} |")


def survey(moves, pairs, seed):
    rng = random.Random(seed)
    moves.plan({"x": 1000, "y": 700})  # compiles
    requests = [draw_random_distances(rng, "xy") for _ in range(pairs)]
    reports = [moves(d) for d in requests]
    exact = sum(r.axes[n].pulses == d[n] for r, d in zip(reports, requests, strict=True) for n in d)
    deviations = [r.deviation.pulses for r in reports]
    perfect = [r.plan.perfect for r in reports]
    common = [compute_common_multiplier_deviation(moves, r.plan) for r in reports]
    durations = []
    for d in requests:
        begin = time.process_time()
        moves.plan(d)
        durations.append(1e3 * (time.process_time() - begin))

    print(
        f"{moves}: {pairs} random pairs of 100 to 50,000 pulses, seed {seed}, rate 16,000 pps; {exact} of {2 * pairs} axes "
        f"exact\n"
    )
    print(
        f"| {'largest distance from the line, pulses':44} |   median |     95 % |  largest | <= 2   |\n|---|---|---|---|---|"
    )
    print_row("planned, run on emulated chips", deviations)
    print_row("perfect axes: rates exactly in ratio", perfect)
    print_row("one R7 for both axes, the finest", common)
    for delay in DELAYS[1:]:
        print_row(f"bus cycle {delay * 1e6:.0f} us, planned for", [moves(d, delay).deviation.pulses for d in requests])
        print_row(
            f"bus cycle {delay * 1e6:.0f} us, not planned for",
            [r.plan.with_bus_delay(delay).deviation for r in reports],
        )
    three = [moves(draw_random_distances(rng, "xyz")) for _ in range(pairs // 2)]
    print_row(f"three axes, {len(three)} moves", [r.deviation.pulses for r in three])
    print_row("three perfect axes", [r.plan.perfect for r in three])
    fast = [moves(d, rate=200_000, fl=4000, accel=0.1) for d in requests]
    print_row("rate 200,000 pps", [r.deviation.pulses for r in fast])
    wild, refused = survey_random_moves(moves, rng, pairs)
    print_row(f"anything, {len(wild)} moves", wild)
    long = [
        moves.plan(draw_random_distances(rng, "xy", 1_000_000, 16_777_215), rate=r)
        for _ in range(25)
        for r in (16_000, 200_000)
    ]
    print_row("over a million pulses, 16,000 pps, estimate", [p.deviation for p in long[::2]])
    print_row("over a million pulses, 200,000 pps, estimate", [p.deviation for p in long[1::2]])
    print(
        f"\nanything: 2 or 3 axes, 1 to 100,000 pulses, rate 50 to 240,000 pps, FL 5 to 5000 pps, ramps 2 ms to 2 s, all evenly\n"
        f"spread on a log scale; {refused} more were refused, with the reason"
    )
    errors, gaps = [r.ratio_error for r in reports], [1e3 * r.finish for r in reports]
    surprise = max(abs(r.plan.deviation - r.deviation.pulses) for r in reports)
    print(
        f"\nplanning takes {np.median(durations):.1f} ms of processor time, at most {max(durations):.1f} ms\n"
        f"ratio error: median {np.median(errors):.1e}, largest {max(errors):.1e}\n"
        f"last pulses are apart by {np.median(gaps):.2f} ms, at most {max(gaps):.2f} ms\n"
        f"planned distance and that of the emulated chips differ by at most {surprise:.3f} pulses"
    )
    return requests, deviations, perfect, common


def survey_random_moves(moves, rng, number):
    """Compute the deviations of moves with random values of everything, and count the refused ones."""

    def between(low, high):
        return low * (high / low) ** rng.random()

    deviations, refused = [], 0
    for _ in range(number):
        names = rng.choice(("xy", "xyz"))
        distances = {n: rng.choice((-1, 1)) * int(between(1, 100_000)) for n in names}
        rate = between(50, 240_000)
        ramps = {"accel": between(0.002, 2), "decel": between(0.002, 2)}
        if "automatic" in moves.shape:
            del ramps["decel"]
        try:
            report = moves(distances, rate=rate, fl=min(between(5, 5000), rate), **ramps)
        except ArgumentError:
            refused += 1
        else:
            deviations.append(report.deviation.pulses)
    return deviations, refused


def draw(requests, deviations, perfect, common, folder):
    from stage.support.plot_style import COLORS, MUTED_COLOR, TEXT_COLOR, make_figure, remove_frame, set_title

    blue, orange = COLORS[:2]
    fig = make_figure(10, 3.9)
    left, right = fig.subplots(1, 2, width_ratios=(1, 1.15))
    bins = np.geomspace(0.4, 1.2 * max(*common, 2), 46)
    left.hist(common, bins, color=orange, alpha=0.55, label="one R7 for both axes")
    left.hist(deviations, bins, color=blue, alpha=0.85, label="R7 free for each axis")
    left.axvline(2, color=MUTED_COLOR, linewidth=0.8, linestyle=(0, (4, 4)))
    left.set_xscale("log")
    left.set_xticks((0.5, 1, 2, 5), ("0.5", "1", "2", "5"))
    left.minorticks_off()
    left.set_xlim(bins[0], bins[-1])
    left.set_xlabel("largest distance from the line (pulses)", color=TEXT_COLOR)
    left.set_ylabel(f"moves of {len(deviations)}", color=TEXT_COLOR)
    ratio = [min(map(abs, d.values())) / max(map(abs, d.values())) for d in requests]
    right.scatter(ratio, deviations, s=14, color=blue, linewidths=0, label="planned, emulated")
    order = np.argsort(ratio)
    right.plot(
        np.array(ratio)[order],
        np.array(perfect)[order],
        color=MUTED_COLOR,
        linewidth=1,
        label="perfect axes, a common start",
    )
    x = np.linspace(0, 1, 100)
    right.plot(
        x,
        (1 + x) / 2 / np.hypot(1, x),
        color=MUTED_COLOR,
        linewidth=1,
        linestyle=(0, (2, 2)),
        label="half the staircase",
    )
    right.set_xlabel("ratio of the distances", color=TEXT_COLOR)
    right.set_ylabel("largest distance (pulses)", color=TEXT_COLOR)
    right.set_ylim(0.45, 1.08)
    right.set_xlim(0, 1.01)
    for ax in (left, right):
        ax.legend(frameon=False, fontsize=8, labelcolor=TEXT_COLOR, loc="upper right" if ax is left else "lower right")
        remove_frame(ax)
    set_title(left, "How far from the line, of all moves")
    set_title(right, "How far, over the ratio")
    fig.savefig(f"{folder}/synchronized.png", dpi=150)
    MovePlanner()({"x": 20_000, "y": -7_500}).plot(f"{folder}/synchronized_move.png", overwrite=True)
    MovePlanner(PCL240MS, s_curve=True, automatic=True)({"x": 20_000, "y": -7_500}, accel=0.3).plot(
        f"{folder}/synchronized_s_curve.png", "a:b move with S-curves, x +20,000, y -7,500 pulses", overwrite=True
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=240)
    parser.add_argument("--pictures", nargs="?", const="docs/pictures", metavar="FOLDER")
    parser.add_argument("--s-curve", nargs="?", type=float, const=True, metavar="SHARE")
    parser.add_argument("--automatic", action="store_true")
    args = parser.parse_args()
    shape = ({"s_curve": args.s_curve} if args.s_curve else {}) | ({"automatic": True} if args.automatic else {})
    chip = PCL240MS if args.s_curve else PCL240MK if args.automatic else PCL240K
    result = survey(MovePlanner(chip, **shape), args.pairs, args.seed)
    if args.pictures:
        draw(*result, args.pictures)
