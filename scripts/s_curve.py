"""Comparison of linear ramps and S-curves of a PCL-240MS on the same stage, in numbers and in one picture.

python scripts/s_curve.py                                          prints the numbers
python scripts/s_curve.py --picture docs/pictures/s_curve.png      and draws them

A camera on a mast (models/xy_mast.xml) rings after a stop. The xyz stage without a mast shows the following error and the highest
rate without lost steps. An S-curve is compared with a linear ramp of equal time, compared with which its peak acceleration is
twice as high, and with a linear ramp of equal peak acceleration, compared with which its ramp takes twice as long.
docs/s_curve.md explains the results.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from stage import Stage, firmware
from stage.chips import PCL240MS
from stage.drives.dynamometer import compute_closed_form_torque
from stage.drives.motors import MOTORS
from stage.firmware import Profile, Report
from stage.support.plot_style import FRAME_COLOR, MUTED_COLOR, TEXT_COLOR, remove_frame, set_title

FL, R7 = 200, 12  # pps; 50 pps a speed step
AT_FL = 5  # pulses
PULSE = 3.125e-6  # m
EVERY = 0.25e-3  # s between samples

# The camera's case: 200 mm/s, 132 mm, a distance at which the ringing of the two ramps adds up
RATE, RAMP, PULSES = 64_000, 0.25, 42_100
BAND = 0.1e-3  # m; quiet is a camera that stays within
RAMPS = np.arange(0.04, 0.6001, 0.015)  # s
HARD_RATE, HARD_RAMP, LONG = 120_000, 0.07, 80_000  # of the bare stage: 375 mm/s, 250 mm
LIMITS = (0.03, 0.04, 0.06, 0.08, 0.12, 0.16)  # s, ramps of which the highest rate is sought
SLOWER, SHORT = (32_000, 48_000, 64_000), 16_000  # pps of which the shortest ramp is sought, pulses
GRID = 66_000 * 1.03 ** np.arange(38)  # pps, tried from below; 1 % after bisection


@dataclass(frozen=True)
class Shape:
    """Shape of a ramp.

    Attributes:
        name: Name in the picture.
        span: Length of the curved part at each end, as a share of FH - FL: 0 for a linear ramp, 1/2 for one without a linear part.
        color: Color in the picture.
    """

    name: str
    span: float
    color: str

    @property
    def peak(self) -> float:
        """Peak acceleration divided by mean acceleration."""
        return 1 + 2 * self.span

    def profile(self, rate: float, ramp: float) -> Profile:
        """Return the profile from FL to `rate` pps in `ramp` s."""
        return Profile.of(FL, rate, rate, ramp, multiplier=R7, s_curve=self.span or False, chip=PCL240MS)

    def acceleration(self, part: np.ndarray) -> np.ndarray:
        """Return the acceleration divided by its mean, where a share `part` of the way from FL to FH is done."""
        if not self.span:
            return np.ones_like(part)
        return self.peak * np.sqrt(np.minimum(np.minimum(part, 1 - part) / self.span, 1))


LINEAR = Shape("linear", 0, "#d1571f")
MIXED = Shape("S-curve, linear part", 0.25, "#4aa8d8")
CURVE = Shape("S-curve", 0.5, "#17508f")
SHAPES = (LINEAR, MIXED, CURVE)
SLOW = RAMP * CURVE.peak  # s, the S-curve's ramp at the peak acceleration of the linear one

DASHED: dict[str, Any] = {"lw": 1.6, "ls": (0, (4, 2))}
MARK: dict[str, Any] = {"color": MUTED_COLOR, "lw": 1, "ls": (0, (2, 2))}


@dataclass(frozen=True)
class Run:
    """Samples of a move from its start on.

    Attributes:
        seconds: Time, s.
        rate: Pulse rate, pps.
        error: Following error, m.
        bend: Bend of the mast, m.
        stopped: Time of the stop, s.
        lost: Number of lost full steps.
    """

    seconds: np.ndarray
    rate: np.ndarray
    error: np.ndarray
    bend: np.ndarray
    stopped: float
    lost: int

    @property
    def moving(self) -> np.ndarray:
        return self.seconds <= self.stopped

    @property
    def worst_error(self) -> float:
        return float(abs(self.error[self.moving]).max())

    @property
    def rms_error(self) -> float:
        return float(np.sqrt(np.mean(self.error[self.moving] ** 2)))

    @property
    def swing(self) -> float:
        """Amplitude of the carriage's own oscillation, m: half the range of the following error in the 0.1 s after the ramp-up."""
        top = int(np.argmax(self.rate >= 0.9999 * self.rate.max())) + round(2e-3 / EVERY)
        return float(np.ptp(self.error[top : top + round(0.1 / EVERY)])) / 2

    @property
    def ringing(self) -> float:
        """Largest bend of the mast after the stop, m."""
        return float(abs(self.bend[~self.moving]).max())

    @property
    def quiet(self) -> float:
        """Time from the start until the camera stays within BAND of its place, s."""
        out = np.flatnonzero(~self.moving & (abs(self.bend) > BAND))
        return float(self.seconds[out[-1]]) if len(out) else self.stopped


@cache
def power_up(model: str) -> tuple[Stage, Any]:
    """Make a stage with X near its minus end, and the snapshot that every move begins from.

    Its motors have no core loss: the page shows what the shape of a ramp does, near the limit of an ideal motor.
    """
    motor = replace(MOTORS["17HS4401"], core_loss_resistance=None)
    machine = Stage(model, chips=PCL240MS, drives=motor)
    machine.place(x=-0.13)
    machine.run(0.05)
    return machine, machine.snapshot()


def move(machine: Stage, shape: Shape, rate: float, ramp: float, pulses: int) -> Report:
    """Make a preset move of X, whose automatic ramp-down begins five pulses early, so that these are made at FL; return the report.

    Args:
        machine: Stage to move.
        shape: Shape of the ramps.
        rate: FH, pps.
        ramp: Duration of each ramp, s.
        pulses: Distance, pulses.
    """
    return firmware.preset_move(machine.axes["x"], pulses, shape.profile(rate, ramp), automatic=True, down_point=AT_FL)


def run(shape: Shape, rate: float, ramp: float, pulses: int, model: str = "xy_mast", rest: float = 0.2) -> Run:
    """Make a move and record it.

    Args:
        shape: Shape of the ramps.
        rate: FH, pps.
        ramp: Duration of each ramp, s.
        pulses: Distance, pulses.
        model: Name of the model.
        rest: Time after the stop that is recorded as well, s.

    Returns:
        The samples.
    """
    machine, begin = power_up(model)
    machine.restore(begin)
    with machine.record(every=EVERY) as recording:
        began = machine.time
        report = move(machine, shape, rate, ramp, pulses)
        machine.run(rest)
    columns = recording.columns
    seconds, bend = columns["time"] - began - report.began, np.zeros(len(recording))
    if model == "xy_mast":
        at = machine.model.joint("camera_x").qposadr[0]
        bend = np.concatenate([piece["qpos"][:, at] for piece in recording.pieces()])
    error, lost = columns["x/following_error"], report.lost_steps or 0
    return Run(seconds, columns["x/rate"], error, bend, report.duration, lost)


def keeps_step(shape: Shape, rate: float, ramp: float, pulses: int = LONG) -> bool:
    """Return whether a move of the bare xyz stage loses no step."""
    machine, begin = power_up("xyz")
    machine.restore(begin)
    return not move(machine, shape, rate, ramp, pulses).lost_steps


@dataclass(frozen=True)
class Limit:
    """Highest rate of a kind of ramp.

    Attributes:
        rate: Highest rate up to which no tried rate loses a step, pps; 0: none.
        lucky: Higher rates that happen to lose no step, pps.
    """

    rate: float
    lucky: list[float]


def highest_rate(shape: Shape, ramp: float) -> Limit:
    """Find the highest rate without lost steps: up GRID until three in a row lose steps, then bisect the first loss to 1 %.

    Args:
        shape: Shape of the ramps.
        ramp: Duration of each ramp, s.
    """
    rates, in_step = GRID[(GRID + FL) * ramp < LONG], []
    for rate in rates:
        in_step.append(keeps_step(shape, rate, ramp))
        if in_step[-3:] == [False] * 3:
            break
    if all(in_step):
        return Limit(rates[-1], [])
    first = in_step.index(False)
    low, high = rates[first - 1] if first else 0.0, rates[first]
    while low and high / low > 1.01:
        middle = (low * high) ** 0.5
        low, high = (middle, high) if keeps_step(shape, middle, ramp) else (low, middle)
    return Limit(low, [r for r, k in zip(rates[first:], in_step[first:], strict=False) if k])


def find_shortest_ramp(shape: Shape, rate: float) -> float:
    """Find the shortest ramp without lost steps, s: from 30 ms down in steps of 4 %.

    Args:
        shape: Shape of the ramps.
        rate: FH, pps.
    """
    ramp = 0.03
    while keeps_step(shape, rate, ramp / 1.04, SHORT):
        ramp /= 1.04
    return ramp


def mast() -> tuple[float, float]:
    """Return the natural frequency, Hz, and the damping ratio of the mast, from the model."""
    model = power_up("xy_mast")[0].model
    joint, mass = model.joint("camera_x"), model.body("camera").mass[0]
    omega = float(np.sqrt(joint.stiffness[0] / mass))
    return omega / (2 * np.pi), float(joint.damping[0] / (2 * mass * omega))


def ringing_in_theory(shape: Shape, ramp: np.ndarray) -> np.ndarray:
    """Compute the bend after the stop in theory, m: (1 + what damping leaves of the first ramp's ringing) (v / w) |A|.

    The acceleration is a box convolved with a shorter box. A is its spectrum at the mast's frequency: sinc(f T) for the
    linear ramp, sinc(f T / 2)^2 for the S-curve.

    Args:
        shape: Shape of the ramps.
        ramp: Durations of a ramp, s.
    """
    f, damping = mast()
    omega = 2 * np.pi * f
    short = ramp * shape.span / (0.5 + shape.span)
    left = np.exp(-damping * omega * PULSES / RATE)
    return (1 + left) * RATE * PULSE / omega * abs(np.sinc(f * (ramp - short)) * np.sinc(f * short))


# What is measured, once a run of the script


@cache
def camera_runs() -> dict[tuple[Shape, float], Run]:
    """Return runs with equal ramp time, then S-curves with the linear ramp's peak acceleration, by shape and ramp time."""
    cases = [*((s, RAMP) for s in SHAPES), *((s, RAMP * s.peak) for s in SHAPES[1:])]
    return {(s, t): run(s, RATE, t, PULSES, rest=4.0) for s, t in cases}


@cache
def bare_runs(rate: float, ramp: float) -> dict[tuple[Shape, float], Run]:
    """Return runs of the xyz stage at a rate, by shape and ramp time."""
    return {(s, ramp): run(s, rate, ramp, LONG, model="xyz") for s in SHAPES}


@cache
def ringing() -> dict[Shape, np.ndarray]:
    """Return the ringing over RAMPS, m, for each shape."""
    return {s: np.array([run(s, RATE, t, PULSES).ringing for t in RAMPS]) for s in SHAPES}


@cache
def limits() -> dict[Shape, list[Limit]]:
    """Return the highest rates over LIMITS for each shape."""
    return {s: [highest_rate(s, t) for t in LIMITS] for s in SHAPES}


def print_runs(runs: dict[tuple[Shape, float], Run], rate: float) -> None:
    """Print runs, a line each."""
    for (shape, ramp), r in runs.items():
        peak = shape.peak * (rate - FL) * PULSE / ramp
        line = (
            f"   {rate / 1e3:4.0f} kpps in {ramp * 1e3:3.0f} ms, {shape.name:21}{peak:5.2f} m/s2, {r.stopped:5.3f} s; "
        )
        if r.lost:
            print(line + f"{r.lost} steps lost")
            continue
        line += f"max {r.worst_error * 1e6:4.1f}, rms {r.rms_error * 1e6:4.1f}, swing {r.swing * 1e6:4.1f}"
        print(line + (f"; {r.ringing * 1e3:5.3f} mm, {r.quiet:4.2f} s" if r.bend.any() else ""))


def print_all() -> None:
    f, damping = mast()
    print(f"1. camera of 0.5 kg on a mast, {f:.2f} Hz, damped by {damping:.1%} of critical; {PULSES} pulses.")
    print("   peak acceleration, time to the stop; following error of the carriage, um; ringing after the stop, and")
    print(f"   seconds from the start until the camera stays within {BAND * 1e3:g} mm")
    print_runs(camera_runs(), RATE)
    print(f"2. bare xyz stage, {LONG} pulses: the same without the camera")
    for rate, ramp in ((32_000, RAMP), (RATE, RAMP), (72_000, 0.05), (HARD_RATE, HARD_RAMP)):
        print_runs(bare_runs(rate, ramp), rate)
    print(f"3. bare xyz stage, {LONG} pulses: highest rate up to which no step is lost, kpps; * some higher ones, too")
    print(f"   {'ramp, ms':21}" + "".join(f"{t * 1e3:7.0f} " for t in LIMITS))
    for shape, row in limits().items():
        print(f"   {shape.name:21}" + "".join(f"{v.rate / 1e3:7.0f}{'*' if v.lucky else ' '}" for v in row))
    print(f"4. bare xyz stage, {SHORT} pulses: shortest ramp down to which no step is lost, ms")
    print(f"   {'rate, kpps':21}" + "".join(f"{rate / 1e3:7.0f} " for rate in SLOWER))
    for shape in SHAPES:
        print(f"   {shape.name:21}" + "".join(f"{find_shortest_ramp(shape, rate) * 1e3:7.0f} " for rate in SLOWER))


# The picture


def draw_the_moves(ax: Any) -> None:
    runs = camera_runs()
    for shape, ramp in ((LINEAR, RAMP), (CURVE, RAMP), (CURVE, SLOW)):
        r = runs[shape, ramp]
        ax.plot(r.seconds * 1e3, r.rate / 1e3, color=shape.color, **(DASHED if ramp == SLOW else {"lw": 2}))
    draw_the_mast(ax.inset_axes((0.34, 0.03, 0.26, 0.66)))
    ax.set(xlabel="time (ms)", ylabel="pulse rate (kpps)", xlim=(0, 1250), ylim=(0, 70))


def draw_the_mast(ax: Any) -> None:
    """Draw a sketch of models/xy_mast.xml."""
    z = np.linspace(0, 1, 40)
    for lean, alpha in ((-0.22, 0.25), (0.22, 0.25), (0, 1)):
        ax.plot(lean * z**2 * (3 - z) / 2, z, color=MUTED_COLOR, lw=3, alpha=alpha, solid_capstyle="butt")
        ax.add_patch(Rectangle((lean - 0.13, 1), 0.26, 0.2, color=TEXT_COLOR, alpha=alpha, lw=0))
    ax.add_patch(Rectangle((-0.42, -0.12), 0.84, 0.12, color="#9aa4ae", lw=0))
    ax.add_patch(Rectangle((-0.6, -0.19), 1.2, 0.05, color="#c8ced5", lw=0))
    ax.text(0, 1.3, f"0.5 kg, {mast()[0]:.1f} Hz", color=TEXT_COLOR, ha="center")
    ax.set(xlim=(-0.6, 0.6), ylim=(-0.2, 1.45), aspect="equal")
    ax.axis("off")


def draw_the_ringing(ax: Any) -> None:
    ax.axhspan(-BAND * 1e3, BAND * 1e3, color=FRAME_COLOR, lw=0)
    runs = camera_runs()
    for shape, ramp in ((LINEAR, RAMP), (CURVE, RAMP), (CURVE, SLOW)):
        r = runs[shape, ramp]
        ax.plot(
            (r.seconds - r.stopped) * 1e3, r.bend * 1e3, color=shape.color, **(DASHED if ramp == SLOW else {"lw": 1.8})
        )
    ax.axvline(0, **MARK)
    ax.text(-8, -0.77, "stop", color=MUTED_COLOR, ha="right")
    waits = [runs[shape, RAMP].quiet - runs[shape, RAMP].stopped for shape in (LINEAR, CURVE)]
    ax.text(995, 0.74, f"within ±{BAND * 1e3:g} mm after {waits[0]:.1f} s", color=LINEAR.color, ha="right")
    ax.text(995, -0.77, f"after {waits[1]:.1f} s; dashed: at once", color=CURVE.color, ha="right")
    ax.set(xlabel="time after the stop (ms)", ylabel="camera off its place (mm)", xlim=(-200, 1000), ylim=(-0.82, 0.82))


def draw_the_ringing_over_ramp_time(ax: Any) -> None:
    fine = np.linspace(RAMPS[0], RAMPS[-1], 800)
    for shape, amplitudes in ringing().items():
        ax.plot(fine * 1e3, ringing_in_theory(shape, fine) * 1e3, color=shape.color, lw=1.2)
        ax.plot(RAMPS * 1e3, amplitudes * 1e3, ".", color=shape.color, ms=6)
    worse = 4 / np.pi / mast()[0]  # s, where the envelopes 1 / (pi f T) and (2 / (pi f T))^2 cross
    ax.axvspan(0, worse * 1e3, color=LINEAR.color, alpha=0.09, lw=0)
    ax.text(8, 0.018, "S-curve\nis worse", color=LINEAR.color)
    ax.axvline(RAMP * 1e3, **MARK)
    ax.text(RAMP * 1e3 + 6, 4.4, "the moves on the left", color=MUTED_COLOR)
    ax.set(xlabel="ramp time (ms)", ylabel="ringing after the stop (mm)", xlim=(0, 600), yscale="log", ylim=(0.015, 7))
    ax.set_yticks([0.02, 0.1, 1, 5], ["0.02", "0.1", "1", "5"])
    ax.minorticks_off()


def draw_the_following_error(ax: Any) -> None:
    for (shape, _), r in bare_runs(HARD_RATE, HARD_RAMP).items():
        if shape is not MIXED:
            ax.plot(r.seconds * 1e3, r.error * 1e6, color=shape.color, lw=1.4)
            ends = f"{r.lost} steps lost" if r.lost else f"swings by {r.swing * 1e6:.1f} µm"
            ax.text(410, 92 if shape is LINEAR else 30, ends, color=shape.color, ha="right")
    ax.axvline(HARD_RAMP * 1e3, **MARK)
    ax.text(HARD_RAMP * 1e3 + 5, 114, "end of the ramp", color=MUTED_COLOR)
    ax.set(xlabel="time (ms)", ylabel="following error (µm)", xlim=(0, 420), ylim=(-10, 122))


def draw_the_highest_rates(ax: Any) -> None:
    ramps = np.array(LIMITS) * 1e3
    for shape, row in limits().items():
        ax.plot(ramps, [v.rate / 1e3 for v in row], "o-", color=shape.color, lw=2, ms=5)
        for ramp, v in zip(ramps, row, strict=True):
            ax.plot([ramp] * len(v.lucky), np.array(v.lucky) / 1e3, "o", mfc="none", color=shape.color, ms=3.5, mew=0.8)
    ax.text(168, 63, "hollow: kept by luck,\na lower rate is not", color=MUTED_COLOR, ha="right")
    ax.set(xlabel="ramp time (ms)", ylabel="highest rate (kpps)", xlim=(0, 170), ylim=(60, 190))


def draw_the_thrust(ax: Any) -> None:
    machine = power_up("xyz")[0]
    x, model = machine.axes["x"], machine.model
    dof = int(model.joint("x").dofadr[0])
    mass = model.body_subtreemass[model.body("x").id] + model.dof_armature[dof]
    part = np.linspace(0, 1, 400)

    def pull_out(rate: np.ndarray, volts: float) -> np.ndarray:
        rpm = rate / x.drive.pulses_per_turn * 60
        return compute_closed_form_torque(x.drive.motor, volts * x.drive.bus_voltage, x.drive.amplitude, rpm) * x.gear

    rates = HARD_RATE * np.linspace(1e-3, 1.15, 600)
    ax.fill_between(rates / 1e3, pull_out(rates, 1), pull_out(rates, 4 / np.pi), color="#d5dbe1", lw=0)
    ax.plot(rates / 1e3, pull_out(rates, 1), color="#aab3bd", lw=1.2)
    ax.text(4, 182, "what the motor has (pull-out)", color=MUTED_COLOR)
    friction = model.dof_frictionloss[dof] + model.dof_damping[dof] * part * HARD_RATE * PULSE
    top = pull_out(np.array([HARD_RATE]), 1)[0]
    for shape, height in ((LINEAR, 40), (CURVE, 8)):
        push = friction + mass * HARD_RATE * PULSE / HARD_RAMP * shape.acceleration(part)
        ax.plot(part * HARD_RATE / 1e3, push, color=shape.color, lw=2)
        ax.text(112, height, f"leaves {top - push[-1]:.0f} N at the top", color=shape.color, ha="right")
    ax.set(xlabel="pulse rate (kpps)", ylabel="thrust (N)", xlim=(0, HARD_RATE * 1.15e-3), ylim=(0, 200))


PANELS = (
    ("One distance, 200 mm/s, 250 ms ramps", draw_the_moves),
    ("A camera on a mast, after the stop", draw_the_ringing),
    ("How much it rings, over the ramp time", draw_the_ringing_over_ramp_time),
    ("Bare stage, 375 mm/s in 70 ms", draw_the_following_error),
    ("Bare stage, highest rate in step", draw_the_highest_rates),
    ("Why: it pushes where the motor can", draw_the_thrust),
)


def draw(path: Path) -> None:
    figure = Figure(figsize=(13.5, 8.6), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.12)
    with rc_context({"font.size": 10}):
        for ax, (text, panel) in zip(figure.subplots(2, 3).flat, PANELS, strict=True):
            panel(ax)
            set_title(ax, text, 12)
            remove_frame(ax, size=9)
        keys = [Line2D([], [], color=s.color, lw=2.5, label=s.name) for s in (LINEAR, CURVE)]
        keys.append(Line2D([], [], color=CURVE.color, label="S-curve, equal peak acceleration", **DASHED))
        keys.append(Line2D([], [], color=MIXED.color, lw=2.5, label="S-curve with linear part"))
        figure.legend(handles=keys, loc="outside upper center", ncols=4, frameon=False, fontsize=12)
    figure.savefig(path, dpi=140)
    print(f"{path}: drawn")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--picture", type=Path, metavar="PATH", help="draw the picture")
    args = parser.parse_args()
    print_all()
    if args.picture:
        draw(args.picture)
