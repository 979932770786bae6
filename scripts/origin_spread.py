"""Spread of the end of a hundred origin returns: at the ORG switch, and at an index pulse (EZ) of the motor after it.

python scripts/origin_spread.py [--returns N] [--seed N] [--picture FILE.png]

Each return starts at a random position. In the second column, the ORG switch drifts: before each return, its beam is shifted by
up to 0.1 mm, as dirt, heat or a loose screw would do.
"""

import argparse

import numpy as np

from stage import ExtraMissing, Stage, firmware
from stage.chips import PCL240MS
from stage.support.extras import import_extra

DRIFT = 1e-4  # m
METHODS = {"ORG": None, "EZ, 2nd pulse": 2}


def measure_end_positions(machine, name, ez, drift, returns, rng):
    """Make origin returns, and return their end positions, pulses.

    Args:
        machine: Stage of the axis.
        name: Name of the axis.
        ez: Number of the index pulse after ORG, or None.
        drift: Largest shift of the switch, m.
        returns: Number of returns.
        rng: Random generator.
    """
    axis, beam = machine.axes[name], machine.model.geom(f"{name}_org_switch").pos
    low, high = (next(s.touch for s in axis.plant.switches if s.pin == pin) for pin in ("el_minus", "el_plus"))
    home, ends, method = beam.copy(), [], "xyz".index(name)
    for _ in range(returns):
        machine.reset()
        beam[method] = home[method] + rng.uniform(-drift, drift)
        machine.place(**{name: rng.uniform(low + 5e-4, high - 5e-4)})
        report = firmware.origin_return(axis, ez=ez)
        assert report.ok, report
        ends.append(report.position / axis.meters_per_pulse)
        beam[:] = home
    return np.array(ends)


def draw_histograms(positions, path):
    from stage.support.plot_style import COLORS, make_figure, remove_frame, set_title

    rng = np.random.default_rng(0)
    fig = make_figure(9, 3.6)
    panels = fig.subplots(1, 2)
    for ax, drift in zip(panels, (0.0, DRIFT), strict=True):
        for k, name in enumerate("xyz"):
            for shift, method, colour in ((-0.16, "ORG", COLORS[0]), (0.16, "EZ, 2nd pulse", COLORS[1])):
                ends = positions[name, method, drift]
                ax.plot(
                    k + shift + rng.uniform(-0.08, 0.08, len(ends)), ends - np.median(ends), "o", ms=3, alpha=0.6,
                    color=colour, mec="none", label=method if k == 0 else None,
                )  # fmt: skip
        ax.set_xticks(range(3), "xyz")
        remove_frame(ax)
        set_title(ax, "The switch stays" if not drift else f"The switch drifts by ±{DRIFT * 1e3:g} mm")
        ax.set_ylabel("final position from the median, pulses")
        ax.grid(False, axis="x")
    fig.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=2, frameon=False, fontsize=9)
    fig.savefig(path, dpi=130)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--returns", type=int, default=100)
    parser.add_argument("--seed", type=int, default=240)
    parser.add_argument("--picture", metavar="FILE.png")
    args = parser.parse_args()
    if args.picture:
        try:
            import_extra("matplotlib", "the picture")
        except ExtraMissing as missing:
            parser.exit(2, f"{missing}\n")
    machine, positions = Stage("xyz", chips=PCL240MS), {}
    print(f"{args.returns} returns each, seed {args.seed}; largest minus smallest final position, pulses of 3.125 um")
    print(f"{'axis':6}{'ends at':16}{'switch stays':>14}{f'drifts {DRIFT * 1e3:g} mm':>16}")
    for name in machine.axes:
        for k, (method, ez) in enumerate(METHODS.items()):
            spreads = []
            for drift in (0.0, DRIFT):
                rng = np.random.default_rng([args.seed, ord(name), k])
                positions[name, method, drift] = ends = measure_end_positions(
                    machine, name, ez, drift, args.returns, rng
                )
                spreads.append(np.ptp(ends))
            print(f"{name:6}{method:16}{spreads[0]:>14.2f}{spreads[1]:>16.2f}", flush=True)
    if args.picture:
        draw_histograms(positions, args.picture)


if __name__ == "__main__":
    main()
