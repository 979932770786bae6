"""HCTL-1100s on a servo stage: a trapezoid and its linear model, commands written too early, a circle with and without SYNC.

python scripts/servo_moves.py                                          prints the numbers
python scripts/servo_moves.py --picture docs/pictures/servo.png        and draws them

docs/servo.md says how to read it. Needs scipy and matplotlib (extra servo).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from stage import ExtraMissing, Stage
from stage.chips import HCTL1100
from stage.chips.hctl1100 import maps
from stage.firmware.hctl1100.chip_port import CONTROL, MODE_FLAGS, RESET, SET_FLAG_BIT, ChipPort
from stage.firmware.hctl1100.moves import FilterTuning, ServoMoveReport, move_by_trapezoid, set_up_servo
from stage.firmware.hctl1100.position_streaming import (
    compute_circle_errors,
    compute_circle_positions,
    stream_positions,
    synchronize_sample_timers,
)
from stage.firmware.hctl1100.servo_loop_model import ServoLoop
from stage.support.extras import import_extra
from stage.support.plot_style import MUTED_COLOR, TEXT_COLOR, remove_frame, set_title

TUNING = FilterTuning()
STEP = 0.25e-3  # s between samples of a recording: a physics step
COUNTS, VELOCITY, ACCELERATION = 20_000, 60_000, 600_000  # 100 mm at 0.3 m/s and 3 m/s2
RADIUS, SECONDS = 6_000, 1.2  # of the circle: 30 mm
PHASES = {"x": 0, "z": 2, "y": 30}  # counts of the timer from one chip's reset to the next one's
SLOW, LINE = 3, 3_000  # counts a sample of the line, samples
LAMP = "#2fb457"
BLUE, LIGHT, ORANGE, RED = "#17508f", "#8fb3d9", "#e8b04a", "#d1571f"


class Trapezoid(NamedTuple):
    """Trapezoidal move of a servo, and its prediction by the linear model.

    Attributes:
        report: Report of the move.
        time: Time from the profile's first sample, s.
        command: Commanded position at the chip's samples, counts.
        position: Position at the chip's samples, counts.
        error: Following error at the chip's samples, counts.
        predicted: Following error that the linear model predicts, counts.
    """

    report: ServoMoveReport
    time: np.ndarray
    command: np.ndarray
    position: np.ndarray
    error: np.ndarray
    predicted: np.ndarray

    @property
    def deviation(self) -> float:
        """Largest difference between simulated and predicted error, divided by the largest predicted error."""
        return float(np.abs(self.error - self.predicted).max() / np.abs(self.predicted).max())


def make_stage_at(**places: float) -> Stage:
    """Make a servo stage with its carriages at the given positions, m, by axis."""
    machine = Stage("xyz_servo", chips=HCTL1100, visuals=False)
    machine.place(**places)
    return machine


def commands(port: ChipPort, begin: int, samples: int) -> np.ndarray:
    """Compute the commands of the profile generator with this chip's registers, sample by sample from `begin` on."""
    chip, values = HCTL1100(port.chip.clock_hz), port.chip.values()
    for address in (*maps.ACCELERATION.addresses, maps.MAX_VELOCITY, *maps.FINAL_POSITION.addresses):
        chip.write(address, values[f"R{address:02X}"])
    for cycle in (*chip.register_cycles("timer", port.t), *chip.register_cycles("command_position", begin)):
        chip.write(*cycle)
    clocks = 16 * (port.t + 1)
    chip.advance(16 * (maps.find_reset_value("timer") + 1))  # the sample of the reset ends
    chip.write(maps.FLAG, SET_FLAG_BIT | MODE_FLAGS["trapezoid"])
    chip.write(maps.MODE, CONTROL)
    out = [chip.command_position]
    for _ in range(samples):
        chip.advance(clocks)
        out.append(chip.command_position)
    return np.array(out)


def run_trapezoid(tuning: FilterTuning = TUNING) -> Trapezoid:
    """Make a trapezoidal move with a filter of the chip, and predict it by the linear model."""
    machine = make_stage_at(x=-0.05)
    axis = machine.axes["x"]
    port = set_up_servo(axis, tuning)
    machine.run(0.1)
    at, zero = port.read_command_position(), round(axis.commanded / axis.meters_per_pulse)
    with machine.record(every=STEP) as recording:
        while port.chip.read(maps.TIMER) < port.t // 2:  # the profile begins with the next sample
            machine.run(port.timer_count_s)
        first = machine.time + (port.chip.read(maps.TIMER) + 0.5) * port.timer_count_s
        report = move_by_trapezoid(port, COUNTS, velocity=VELOCITY, acceleration=ACCELERATION)
        machine.run(0.1)
    columns = recording.columns
    when = first + port.sample * np.arange(-1, int((machine.time - first) / port.sample) - 1)
    command = zero + commands(port, at, len(when) - 1) - at
    position = np.interp(when, columns["time"], columns["x/position"]) / axis.meters_per_pulse
    predicted = ServoLoop.from_axis(axis, tuning).compute_following_error(command)
    return Trapezoid(report, when - first, command - zero, position - zero, command - position, predicted)


def run_line(early: bool) -> tuple[np.ndarray, np.ndarray]:
    """Command a slow line sample by sample, and return seconds and following error in counts.

    Args:
        early: Write each command at the beginning of a sample, not in its safe part.
    """
    machine = make_stage_at(x=-0.05)
    axis = machine.axes["x"]
    port = set_up_servo(axis, TUNING)
    at = port.read_command_position()
    with machine.record(every=STEP) as recording:
        for k in range(1, LINE + 1):
            machine.run((port.chip.read(maps.TIMER) + 2) * port.timer_count_s)  # the next sample has begun
            if not early:
                port.wait_for_safe_part_of_sample()
            port.write_quantities(command_position=at + SLOW * k)
    c = recording.columns
    error = (c["x/commanded"] - c["x/position"]) / axis.meters_per_pulse
    return c["time"] - c["time"][0], error


def run_circle(sync: bool, leader_only: bool) -> tuple[np.ndarray, np.ndarray, int]:
    """Run a circle of three axes. Without SYNC the chips keep the phases of their resets, PHASES.

    Returns:
        Angle in turns; distance from the circle that begins where the carriages stand, um; number of commands written too early.
    """
    machine = make_stage_at(x=0.0, y=-0.03, z=-0.03)
    for name, counts in PHASES.items():
        machine.run(counts * 16 / machine.axes[name].chip.clock_hz)
        machine.axes[name].chip.write(maps.MODE, RESET)  # a reset: its sample begins now
    ports = [set_up_servo(machine.axes[name], TUNING) for name in "xyz"]
    if sync:
        synchronize_sample_timers(ports)
    machine.run(0.2)
    for port in ports:
        port.chip.diagnostics.clear()
    start = [axis.position for axis in machine.axes.values()]
    with machine.record(every=STEP) as recording:
        profile = compute_circle_positions(RADIUS, seconds=SECONDS, sample=ports[0].sample, axes=3)
        stream_positions(ports, profile, leader_only=leader_only)
    c = recording.columns
    radius = RADIUS * machine.axes["x"].meters_per_pulse
    places = np.stack([c[f"{name}/position"] - s for name, s in zip("xyz", start, strict=True)], axis=1)
    revolutions = np.unwrap(np.arctan2(places[:, 0], radius - places[:, 1:].sum(axis=1) * np.sqrt(0.5))) / (2 * np.pi)
    torn = sum("while the sample is computed" in d.message for port in ports for d in port.chip.diagnostics)
    return revolutions, compute_circle_errors(places, radius) * 1e6, torn


CIRCLES = {
    "SYNC": (True, True, BLUE),
    "no SYNC, each timer read": (False, False, ORANGE),
    "no SYNC, one timer read": (False, True, RED),
}
"""Synchronized, one timer for all, colour."""


class Results(NamedTuple):
    trapezoid: Trapezoid
    lines: dict[str, tuple[np.ndarray, np.ndarray]]
    circles: dict[str, tuple[np.ndarray, np.ndarray, int]]


def simulate() -> Results:
    circles = {name: run_circle(sync, one) for name, (sync, one, _) in CIRCLES.items()}
    return Results(run_trapezoid(), {"too early": run_line(True), "safe": run_line(False)}, circles)


def print_results(r: Results) -> None:
    t = r.trapezoid
    print(t.report)
    print(f"following error {np.abs(t.error).max():.1f} counts at most, predicted {np.abs(t.predicted).max():.1f}; "
          f"they differ by {100 * t.deviation:.1f} % of that at most")  # fmt: skip
    for name, (_, error) in r.lines.items():
        print(f"line, commands {name}: following error {np.abs(error).max():.1f} counts at most")
    for name, (_, off, torn) in r.circles.items():
        rms = np.sqrt((off**2).mean())
        print(f"circle, {name}: off by {off.max():.1f} um at most, {rms:.1f} um rms; {torn} commands written too early")


# --- the picture ---


def draw_the_move(ax: Any, t: Trapezoid) -> None:
    mm = 5e-3
    ax.plot(t.time, t.command * mm, color=LIGHT, lw=4, label="command position")
    ax.plot(t.time, t.position * mm, color=TEXT_COLOR, lw=1.3, label="carriage")
    ax.axvspan(0, t.report.profile, ymax=0.03, color=LAMP, lw=0)
    ax.text(t.report.profile / 2, 6, "PROF", color=LAMP, ha="center", weight="bold")
    ax.set(xlabel="time (s)", ylabel="position (mm)", xlim=(t.time[0], t.report.settled + 0.08))
    ax.legend(frameon=False, loc="upper left")


def draw_the_error(ax: Any, t: Trapezoid) -> None:
    ax.plot(t.time, t.predicted, color=RED, lw=3, alpha=0.6, label="linear model")
    ax.plot(t.time, t.error, color=TEXT_COLOR, lw=0.9, label="simulated")
    ax.set(xlabel="time (s)", ylabel="following error (counts)", xlim=(t.time[0], t.report.settled + 0.08))
    caption = f"apart by {100 * t.deviation:.1f} % at most"
    ax.text(0.98, 0.95, caption, transform=ax.transAxes, ha="right", va="top", color=MUTED_COLOR)
    ax.legend(frameon=False, loc="lower left")


def draw_the_lines(ax: Any, lines: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    for (name, (time, error)), colour in zip(lines.items(), (RED, BLUE), strict=True):
        ax.plot(time, error, color=colour, lw=0.9, label=f"commands {name}")
    ax.set(xlabel="time (s)", ylabel="following error (counts)", xlim=(0, 0.6), ylim=(-170, 170))
    ax.legend(frameon=False, loc="upper right", ncols=2)


def draw_the_circles(ax: Any, circles: dict[str, tuple[np.ndarray, np.ndarray, int]]) -> None:
    for name, (revolutions, off, _) in reversed(circles.items()):
        ax.plot(revolutions * 360, off, color=CIRCLES[name][2], lw=0.9, label=f"{name}: {off.max():.0f} µm at most")
    ax.set(xlabel="angle (degrees)", ylabel="distance from the circle (µm)", xlim=(0, 360), xticks=range(0, 361, 90))
    ax.set(yscale="log", ylim=(1, 2e4))
    ax.legend(frameon=False, loc="upper right")


def draw_picture(r: Results, path: Path) -> None:
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 8), layout="constrained")
    with rc_context({"font.size": 10}):
        (move, error), (line, circle_axes) = figure.subplots(2, 2)
        draw_the_move(move, r.trapezoid)
        draw_the_error(error, r.trapezoid)
        draw_the_lines(line, r.lines)
        draw_the_circles(circle_axes, r.circles)
        titles = ("A trapezoid of 100 mm", "Its following error", "A line, commanded once a sample",
                  "A circle of 30 mm, three axes, commanded once a sample")  # fmt: skip
        for ax, text in zip((move, error, line, circle_axes), titles, strict=True):
            set_title(ax, text)
            remove_frame(ax)
    figure.savefig(path, dpi=120)
    print(f"{path}: drawn")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw the picture")
    args = parser.parse_args()
    try:
        import_extra("scipy", "this example")
        results = simulate()
        print_results(results)
        if args.picture:
            draw_picture(results, args.picture)
    except ExtraMissing as missing:
        sys.exit(f"{missing}")
