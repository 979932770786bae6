"""An MCX514 on the xyz stage: automatic home search with the stage's switches, then a circle, a helix and a contour without a stop.

python scripts/circles_and_helices.py                                  prints what the axes did
python scripts/circles_and_helices.py --record circles.rrd             a recording, with the tool's path: rerun circles.rrd
python scripts/circles_and_helices.py --picture docs/pictures/circles_and_helices.png
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from stage import Stage
from stage.chips import MCX514
from stage.firmware.nova.home_search import HomeSearchReport, home_search
from stage.firmware.nova.path_interpolation import ArcSegment, HelixSegment, LineSegment, PathSpeed, move_along_path
from stage.support.plot_style import GRID_COLOR, MUTED_COLOR, TEXT_COLOR, remove_frame

MM = 320  # pulses
STARTS = {"x": -0.101, "y": -0.0709, "z": 0.004}  # m: before ORG; on it; before it
CORNER = (-35 * MM, -17 * MM)  # where the contour begins, from the middle of the work
MIDDLE = (118 * MM, 68 * MM, 1 * MM)  # of the work, from home
CIRCLE, TURN = 12.5, 6.0  # mm, radii
PITCH, REVOLUTIONS = 4, 4  # mm, rotations
FAST = PathSpeed(24_000, acceleration=120_000)
FINE = PathSpeed(12_000, jerk=1_000_000)  # 37.5 mm/s on the path
COLOURS = {"circle": "#17508f", "uneven": "#8fb3d9", "helix": "#d1571f", "contour": "#2a8c55"}
AXES = {"x": "#c23b3b", "y": "#2a8c55", "z": "#3b6fc2"}
TRAVEL = "#aab4be"
LAMP = "#2fb457"
BINS = 120  # of the angle about the circle


class Run(NamedTuple):
    """Results of the demonstration.

    Attributes:
        machine: The stage at the end.
        homes: Report of the home search of each axis.
        parts: Begin and end of each part, s, by name.
        columns: Columns of the recording, by name.
        edges: Position at which ORG trips on each axis, m.
        recording: The recording.
    """

    machine: Stage
    homes: dict[str, HomeSearchReport]
    parts: dict[str, tuple[float, float]]
    columns: dict[str, np.ndarray]
    edges: dict[str, float]
    recording: Any


def make_rounded_rectangle(width: int, height: int, r: int) -> list[LineSegment | ArcSegment]:
    """Make the eight segments of a rectangle with rounded corners, counter-clockwise from the left end of its lower side.

    Args:
        width: Width, pulses.
        height: Height, pulses.
        r: Radius of the corners, pulses.
    """
    return [
        LineSegment(width - 2 * r, 0), ArcSegment((0, r), (r, r)), LineSegment(0, height - 2 * r), ArcSegment((-r, 0), (-r, r)),
        LineSegment(-(width - 2 * r), 0), ArcSegment((0, -r), (-r, -r)),
        LineSegment(0, -(height - 2 * r)), ArcSegment((r, 0), (r, -r)),
    ]  # fmt: skip


def run_demonstration() -> Run:
    """Run the home search, a circle with and one without constant vector speed, a helix and a contour."""
    machine = Stage("xyz", chips=MCX514)
    machine.place(**STARTS)
    x, y, z = (machine.axes[name] for name in "xyz")
    r, parts = round(CIRCLE * MM), {}

    def part(
        name: str, *segments: LineSegment | ArcSegment | HelixSegment, axes: Any = (x, y), speed: PathSpeed = FINE
    ) -> None:
        begin = machine.time
        print(f"{name}: {move_along_path(segments, *axes, speed=speed)}")
        parts[name] = begin, machine.time
        machine.run(0.1)

    with machine.record() as recording:
        homes = home_search(x, y, z)
        machine.run(0.1)
        parts["home"] = 0.0, machine.time
        print(*homes.values(), sep="\n")
        part("to the circle", LineSegment(MIDDLE[0] - 18 * MM, MIDDLE[1] - r, MIDDLE[2]), axes=(x, y, z), speed=FAST)
        part("circle", ArcSegment((0, r)))
        part("uneven", ArcSegment((0, r)), speed=PathSpeed(FINE.drive, jerk=FINE.jerk, even=False))
        part("to the helix", LineSegment(36 * MM, r - round(TURN * MM)), speed=FAST)
        part("helix", HelixSegment((0, round(TURN * MM)), (PITCH * MM,), REVOLUTIONS), axes=(x, y, z))
        away = CORNER[0] + 6 * MM - 18 * MM, CORNER[1] + round(TURN * MM), -PITCH * REVOLUTIONS * MM
        part("to the contour", LineSegment(*away), axes=(x, y, z), speed=FAST)
        part("contour", *make_rounded_rectangle(70 * MM, 34 * MM, 6 * MM))
    edges = {n: next(s.touch for s in a.plant.switches if s.pin == "org") for n, a in machine.axes.items()}
    return Run(machine, homes, parts, recording.columns, edges, recording)


def get_part_columns(run: Run, name: str, *columns: str) -> list[np.ndarray]:
    """Return columns of the recording during a part of the run."""
    begin, end = run.parts[name]
    rows = (run.columns["time"] >= begin) & (run.columns["time"] <= end)
    return [run.columns[column][rows] for column in columns]


def compute_circle_deviation(run: Run, name: str, what: str) -> tuple[np.ndarray, np.ndarray]:
    """Compute how far a part of the run deviates from the circle.

    Args:
        run: Results.
        name: Name of the part.
        what: "position" or "commanded".

    Returns:
        Angle about the center, rad, and distance outside the circle, m.
    """
    x, y, x0, y0 = get_part_columns(run, name, f"x/{what}", f"y/{what}", "x/commanded", "y/commanded")
    u, v = x - x0[0], y - (y0[0] + CIRCLE * 1e-3)
    return np.unwrap(np.arctan2(v, u)), np.hypot(u, v) - CIRCLE * 1e-3


def compute_path_speed(run: Run, name: str, over: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Compute the speed of the pulses along the path.

    Args:
        run: Results.
        name: Name of the part.
        over: Number of samples over which the speed is averaged.

    Returns:
        Time since the part began, s, and speed, mm/s.
    """
    t, x, y = get_part_columns(run, name, "time", "x/pulses", "y/pulses")
    v = np.hypot(x[over:] - x[:-over], y[over:] - y[:-over]) / (t[over:] - t[:-over]) / MM
    return (t[over:] + t[:-over]) / 2 - t[0], v


def print_results(run: Run) -> None:
    for name, edge in run.edges.items():
        home = run.homes[name].position
        print(f"{name}: home {1e6 * (home - edge):+.1f} um from the edge of ORG")
    for name in ("circle", "uneven"):
        off = compute_circle_deviation(run, name, "position")[1]
        print(f"{name}: carriages {off.min() * 1e6:+.1f} to {off.max() * 1e6:+.1f} um from the circle, "
              f"back within {abs(off[-1]) * 1e6:.1f} um")  # fmt: skip
    print("lost steps:", {name: axis.lost_steps for name, axis in run.machine.axes.items()})


# --- the picture ---


def draw_from_above(ax: Any, run: Run) -> None:
    for name in ("to the circle", "to the helix", "to the contour"):
        x, y = get_part_columns(run, name, "x/position", "y/position")
        ax.plot(x * 1e3, y * 1e3, color=TRAVEL, lw=0.9, ls=(0, (4, 3)))
    for name in ("contour", "circle", "helix"):
        x, y = get_part_columns(run, name, "x/position", "y/position")
        ax.plot(x * 1e3, y * 1e3, color=COLOURS[name], lw=2.2)
        ax.plot(x[0] * 1e3, y[0] * 1e3, "o", color=COLOURS[name], ms=5)
    u, v = (1e3 * run.edges[n] + MIDDLE[k] / MM for k, n in enumerate("xy"))
    for name, (right, up) in {"circle": (-18, 0), "helix": (18, 0), "contour": (0, 14.5)}.items():
        ax.text(u + right, v + up, name, color=COLOURS[name], ha="center", va="center", weight="bold")
    ax.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    ax.set_xlim(u - 40, u + 40)
    ax.set_ylim(v - 27, v + 27)


def draw_in_space(ax: Any, run: Run) -> None:
    for name in ("to the circle", "to the helix", "to the contour", "circle", "helix", "contour"):
        places = [1e3 * c for c in get_part_columns(run, name, *(f"{n}/position" for n in "xyz"))]
        travel = name.startswith("to ")
        if name == "to the circle":
            places = [c[places[0] > -45] for c in places]
        ax.plot(*places, color=TRAVEL if travel else COLOURS[name], lw=0.9 if travel else 2)
    ax.set(xlabel="x (mm)", ylabel="y (mm)")
    ax.text2D(0.9, 0.735, "z (mm)", transform=ax.transAxes)
    ax.set_xlim(-45, 40)
    ax.set_ylim(-25, 20)
    ax.set_zlim(-15, 7)
    ax.set_xticks(range(-40, 41, 20))
    ax.set_yticks(range(-20, 21, 20))
    ax.set_zticks(range(-15, 6, 5))
    ax.set_box_aspect((85, 60, 38), zoom=1.1)
    ax.view_init(26, -60)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.pane.set_facecolor("#f6f8fa")
        axis.pane.set_edgecolor(GRID_COLOR)


def draw_the_deviation(ax: Any, run: Run) -> None:
    angle, off = compute_circle_deviation(run, "circle", "position")
    edges = np.linspace(angle[0], angle[0] + 2 * np.pi, BINS + 1)
    where = np.clip(np.digitize(angle, edges), 1, BINS)
    low, high = (np.array([f(off[where == k]) for k in range(1, BINS + 1)]) * 1e6 for f in (np.min, np.max))
    middle = (edges[1:] + edges[:-1]) / 2
    ax.fill_between(middle, low, high, color="#b8cfe6", lw=0, label="carriages, least to most")
    angle, off = compute_circle_deviation(run, "circle", "commanded")
    ax.plot(angle, off * 1e6, color=TEXT_COLOR, lw=0.8, label="pulses")
    ax.set_ylim(-75, 32)
    ax.set_yticks([-25, 0, 25], ["", "", ""])
    for r in (-25, 0, 25):
        ax.text(np.radians(67), r, f"{r:+d}" if r else "0", color=MUTED_COLOR, fontsize=8, ha="center", va="center",
                bbox={"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.8})  # fmt: skip
    ax.set_xticks(np.arange(0, 2 * np.pi, np.pi / 2), ["x+", "y+", "x-", "y-"])
    ax.text(0, -75, "µm", color=MUTED_COLOR, ha="center", va="center")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2, frameon=False, fontsize=9, handlelength=1.2)


def draw_the_home_search(places: Any, lanes: Any, run: Run) -> None:
    end = run.parts["home"][1]
    t = run.columns["time"]
    rows = t <= end
    for k, (name, colour) in enumerate(AXES.items()):
        distance = (run.columns[f"{name}/position"] - run.edges[name])[rows] * 1e3
        places.plot(t[rows], distance, color=colour, lw=1.8, label=name)
        lane, states = 2 - k, run.homes[name].states
        for (begin, state), (until, _) in zip(states, [*states[1:], (end, 0)], strict=True):
            lanes.broken_barh([(begin, until - begin)], (lane + 0.1, 0.42), color=STATES[state][1], lw=0)
        on = run.columns[f"{name}/stop1"][rows]
        lanes.fill_between(t[rows], lane - 0.22, lane + 0.02, where=on, color=LAMP, lw=0, step="post")
        lanes.text(-0.01, lane + 0.3, name, color=colour, weight="bold", ha="right", va="center",
                   transform=lanes.get_yaxis_transform())  # fmt: skip
        lanes.text(-0.01, lane - 0.1, "ORG", color=MUTED_COLOR, fontsize=8, ha="right", va="center",
                   transform=lanes.get_yaxis_transform())  # fmt: skip
    places.axhline(0, color=TEXT_COLOR, lw=0.8)
    places.text(end, 0.8, "edge of ORG", color=MUTED_COLOR, ha="right")
    places.set(ylabel="from the edge (mm)", xlim=(0, end))
    places.tick_params(labelbottom=False)
    places.legend(frameon=False, ncols=3)
    lanes.set(xlabel="time (s)", xlim=(0, end), ylim=(-0.35, 2.7), yticks=[])


STATES = {
    0: ("idle", "#eef1f4"),
    3: ("step 1: to ORG at DV", "#17508f"),
    6: ("timer", "#c3ccd5"),
    11: ("back to ORG", "#e8b04a"),
    15: ("step 2: out of ORG at HV", "#d1571f"),
    18: ("timer", "#c3ccd5"),
    20: ("step 2: to ORG at HV", "#7a3fa0"),
    23: ("timer", "#c3ccd5"),
}
"""What a state of the search is called here, and its colour."""


def draw_the_speed(ax: Any, run: Run) -> None:
    for name, label in (
        ("uneven", "circle, without"),
        ("circle", "circle, with"),
        ("contour", "contour of 8 segments, with"),
    ):
        t, v = compute_path_speed(run, name)
        ax.plot(t, v, color=COLOURS[name], lw=1.6, label=label)
    ax.axhline(FINE.drive / MM, color=TEXT_COLOR, lw=0.8, ls=(0, (2, 2)))
    ax.set(xlabel="time (s)", ylabel="speed on the path (mm/s)", ylim=(0, 68), xlim=(0, None))
    ax.legend(frameon=False, ncols=1, loc="upper right")


TITLES = (
    "From above", "In space", "Off the circle of 12.5 mm", "Automatic home search of three axes by one command",
    "Constant vector speed",
)  # fmt: skip


def draw_picture(run: Run, path: Path) -> None:
    from matplotlib import rc_context
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    figure = Figure(figsize=(14.5, 8.8), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.1, h_pad=0.08)
    with rc_context({"font.size": 10}):
        above, below = figure.subfigures(2, 1, height_ratios=(1.12, 1))
        parts = *above.subfigures(1, 3, width_ratios=(1.45, 1.35, 1)), *below.subfigures(1, 2, width_ratios=(1.75, 1))
        for part, title in zip(parts, TITLES, strict=True):
            part.suptitle(title, x=0.02, ha="left", color=TEXT_COLOR, fontsize=12, weight="bold")
        first, space, polar = (
            part.subplots(subplot_kw={"projection": kind})
            for part, kind in zip(parts, (None, "3d", "polar"), strict=False)
        )
        places, lanes = parts[3].subplots(2, 1, height_ratios=(1.2, 1), sharex=True)
        speed = parts[4].subplots()
        draw_from_above(first, run)
        draw_in_space(space, run)
        draw_the_deviation(polar, run)
        draw_the_home_search(places, lanes, run)
        draw_the_speed(speed, run)
        for ax in (first, places, lanes, speed):
            remove_frame(ax, grid=ax is not lanes, size=9)
        names = {label: colour for label, colour in STATES.values() if label not in ("idle", "back to ORG")}
        keys = [Patch(color=colour, label=label) for label, colour in names.items()]
        keys.append(Patch(color=LAMP, label="ORG (STOP1)"))
        parts[3].legend(handles=keys, loc="outside lower center", ncols=5, frameon=False)
    figure.savefig(path, dpi=130)
    print(f"{path}: drawn")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--record", type=Path, metavar="RRD", help="write a rerun recording")
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw the picture")
    args = parser.parse_args()
    results = run_demonstration()
    print_results(results)
    if args.record:
        print(f"{results.recording.save(args.record, overwrite=True)}: written")
    if args.picture:
        draw_picture(results, args.picture)
