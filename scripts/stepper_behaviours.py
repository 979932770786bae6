"""What a believable stepper does: the five behaviours of docs/drives.md, simulated on the bench, drawn and printed.

python scripts/stepper_behaviours.py [PICTURE.png]     default: docs/pictures/stepper_behaviours.png
"""

import sys
import time
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from stage.drives.dynamometer import (
    SLICE_S,
    compute_closed_form_torque,
    compute_load_angle,
    compute_mean_counts,
    compute_natural_frequency,
    compute_torque_bound,
    count_lost_steps,
    count_slices,
    count_steps_lost_in_start,
    find_pull_in_rate,
    measure_swing_frequency,
    simulate_motor,
    simulate_pull_out,
    sweep_resonance,
)  # fmt: skip
from stage.drives.motors import MOTORS, Drive
from stage.support.plot_style import COLORS, MUTED_COLOR, TEXT_COLOR, remove_frame, set_title

BLUE, RED, GREEN = COLORS[:3]
MOTOR = replace(MOTORS["17HS4401"], core_loss_resistance=None)  # as the closed form of the page
DRIVE = Drive(MOTOR)
SMOOTH = Drive(MOTOR, detent=0.0)
ROTOR = MOTOR.rotor_inertia
STEP = 2 * np.pi / MOTOR.steps_per_turn
FULL_STEP = MOTOR.steps_per_turn / 60  # full steps a second at 1 rpm


def pull_out_follows_the_closed_form(ax):
    spec = np.array([300, 900, 1200, 1500, 2000])
    sine = replace(SMOOTH, mode="sine", microsteps=256)
    print("1. pull-out torque, N m, 17HS4401, 24 V, 1.7 A, no detent")
    columns = (
        compute_closed_form_torque(MOTOR, 24, 1.7, spec),
        simulate_pull_out(sine, spec),
        simulate_pull_out(SMOOTH, spec),
    )
    for rpm, ideal, sine, chopper in zip(spec, *columns, strict=True):
        ratios = f"sine / closed form {sine / ideal:.4f}, chopper / closed form {chopper / ideal:.3f}"
        print(f"   {rpm:5} rpm: closed form {ideal:.3f}, sine {sine:.3f}, chopper {chopper:.3f}; {ratios}")
    rpm = np.r_[50, 150:700:110, 700:1000:20, 1000:2401:100]
    chopper, ideal = simulate_pull_out(SMOOTH, rpm), compute_closed_form_torque(MOTOR, 24, 1.7, rpm)
    saturated, both = (
        compute_closed_form_torque(MOTOR, 4 / np.pi * 24, 1.7, rpm),
        compute_torque_bound(MOTOR, 24, 1.7, rpm),
    )
    low, out = np.argmin(chopper / ideal), rpm[chopper < ideal * 0.99]
    print(f"   chopper / closed form at V: {chopper[low] / ideal[low]:.3f} at {rpm[low]} rpm, the least;", end=" ")
    print(f"below 0.99 from {out.min()} to {out.max()} rpm; {max(chopper / ideal):.3f}, the most")
    print(f"   sine bound by V and I at once / closed form: {min(both / ideal):.3f}, the least;", end=" ")
    print(
        f"chopper / that bound: {min(chopper / both):.3f}, the least; chopper / 4/pi V: {max(chopper / saturated):.3f}"
    )
    fine = np.linspace(1, 2400, 400)
    at_v, at_fundamental = (
        compute_closed_form_torque(MOTOR, 24, 1.7, fine),
        compute_closed_form_torque(MOTOR, 4 / np.pi * 24, 1.7, fine),
    )
    ax.fill_between(fine, at_v, at_fundamental, color="#cfe0f2", lw=0)
    ax.plot(fine, compute_torque_bound(MOTOR, 24, 1.7, fine), color=MUTED_COLOR, lw=1, ls=":")
    ax.plot(rpm, chopper, color=BLUE, lw=2)
    ax.plot(spec, columns[1], "o", color=TEXT_COLOR, ms=4)
    ax.text(1480, 0.235, "closed form, V to 4/π V", color=MUTED_COLOR, fontsize=8)
    ax.text(2050, 0.165, "chopper", color=BLUE, fontsize=8)
    ax.text(1130, 0.176, "ideal sine drive", color=TEXT_COLOR, fontsize=8, ha="right")
    ax.text(930, 0.238, "sine bound by V and I", color=MUTED_COLOR, fontsize=8, ha="right")
    ax.set(xlabel="rpm", ylabel="pull-out torque (N m)", ylim=(0, 0.32), xlim=(0, 2400))


def the_rotor_rings_at_its_natural_frequency(ax):
    print("2. natural frequency, Hz, bare rotor: simulated (sqrt(stiffness / J) / 2 pi)")
    for label, drive, microstep in (
        ("no detent", SMOOTH, 0),
        ("on a full step", DRIVE, 0),
        ("on a half step", DRIVE, DRIVE.microsteps // 2),
    ):
        simulated, formula = (
            measure_swing_frequency(drive, ROTOR, microstep),
            compute_natural_frequency(drive, ROTOR, microstep > 0),
        )
        print(f"   {label}: {simulated:.1f} ({formula:.1f})")
    for times, color in ((1, BLUE), (4, RED)):
        swing = simulate_motor(
            DRIVE, np.zeros(count_slices(0.03)), times * ROTOR, start_angle=0.1 * STEP, frame_damping=5e-4
        )
        hz = measure_swing_frequency(DRIVE, times * ROTOR)
        label = "bare rotor" if times == 1 else f"{times} rotors"
        ax.plot(
            np.arange(len(swing)) * SLICE_S * 1e3, swing["theta"] / STEP, color=color, label=f"{label}: {hz:.0f} Hz"
        )
        print(f"   {label}: {hz:.1f}")
    ax.legend(frameon=False, fontsize=8, loc="lower right")
    ax.set(xlabel="ms after the rotor is let go", ylabel="rotor angle (full steps)", xlim=(0, 30), ylim=(-0.15, 0.12))


def full_steps_lose_torque_at_resonance(ax):
    rates = np.unique(np.r_[np.geomspace(60, 2000, 40), 180:280:5])
    for microsteps, color in ((16, MUTED_COLOR), (1, BLUE)):
        sweep = sweep_resonance(Drive(MOTOR, microsteps), rates)
        ax.plot(
            sweep.rate,
            sweep.torque,
            color=color,
            lw=2,
            label=f"1/{microsteps} microsteps" if microsteps > 1 else "full steps",
        )
        dead = sweep.rate[sweep.torque == 0]
        print(f"   1/{microsteps}: torque {min(sweep.torque):.3f} to {max(sweep.torque):.3f} N m;", end=" ")
        print(
            f"falls out unloaded at {dead.min():.0f} to {dead.max():.0f} full steps/s"
            if len(dead)
            else "never falls out"
        )
    for ratio in (0.03, 0.06, 0.1):
        sweep = sweep_resonance(Drive(MOTOR, 1), rates, damping_ratio=ratio)
        dead = [round(rate) for rate in sweep.rate[sweep.torque == 0]]
        print(f"   full steps, damped by {ratio:.0%} of critical: falls out unloaded at {dead or 'no rate'}")
    natural = measure_swing_frequency(SMOOTH, ROTOR)
    ax.axvline(natural, color=RED, lw=1, ls=(0, (4, 3)))
    ax.text(natural * 1.06, 0.1, f"natural\nfrequency,\n{natural:.0f} Hz", color=RED, fontsize=8)
    ax.legend(frameon=False, fontsize=8, loc="lower right")
    ax.set(
        xlabel="full steps per second",
        ylabel="pull-out torque (N m)",
        xscale="log",
        xlim=(60, 2000),
        ylim=(-0.01, 0.32),
    )
    ax.set_xticks([100, 300, 1000], ["100", "300", "1000"])
    ax.minorticks_off()


def slip_is_a_multiple_of_four_full_steps(ax):
    print(
        "3. slip after an overload of 0.5 N m at 300 rpm, bare rotor; 0.4 s later the pulses stop and the rotor rests"
    )
    seconds = np.arange(count_slices(1.2)) * SLICE_S
    counts = compute_mean_counts(np.where(seconds < 0.5, 300 / 60 * DRIVE.pulses_per_turn, 0.0))
    for ms, color in ((1, MUTED_COLOR), (4, GREEN), (8, BLUE), (12, RED)):
        load = np.where((seconds >= 0.1) & (seconds < 0.1 + ms * 1e-3), 0.5, 0.0)
        trace = simulate_motor(DRIVE, counts, ROTOR, load, frame_damping=1e-3, start_speed=300 * 2 * np.pi / 60)
        lag = compute_load_angle(DRIVE, trace) / (np.pi / 2)
        ax.plot(seconds * 1e3 - 100, lag, color=color, lw=1.8, label=f"{ms} ms")
        print(f"   {ms:2} ms: at rest {lag[-1]:.4f} full steps behind; lost_steps = {count_lost_steps(DRIVE, trace)}")
    ax.legend(frameon=False, fontsize=8, loc="upper left", title="overload for", title_fontsize=8)
    ax.set(xlabel="ms after the overload begins", ylabel="rotor behind (full steps)", xlim=(-10, 40), ylim=(-2, 18))
    ax.set_yticks(np.arange(0, 17, 4))


def a_start_fails_where_a_ramp_succeeds(ax):
    print("4. pull-in rate, full steps/s, over inertia; running torque there")
    times = np.array([1, 1.5, 2, 3, 4, 6, 8, 12])
    rates = np.array([find_pull_in_rate(DRIVE, k * ROTOR) for k in times]) / DRIVE.microsteps
    for k, rate in zip(times, rates, strict=True):
        print(
            f"   {k:4g} rotors: {rate:5.0f}; pull-out torque there {simulate_pull_out(DRIVE, [rate / FULL_STEP])[0]:.3f} N m"
        )
    inertia, rate = 5 * ROTOR, 1.5 * find_pull_in_rate(DRIVE, 5 * ROTOR)
    once, ramped = (
        count_steps_lost_in_start(DRIVE, rate, inertia),
        count_steps_lost_in_start(DRIVE, rate, inertia, accel=100_000),
    )
    print(
        f"   5 rotors, {rate:.0f} pps, 1.5 x pull-in: {once} steps lost in 0.4 s at once, {ramped} ramped at 100000 pps/s"
    )
    ax.plot(times, rates, "o-", color=BLUE, lw=2, ms=4)
    ax.plot(5, rate / DRIVE.microsteps, "x", color=RED, ms=8, mew=2)
    ax.text(
        5.25, rate / DRIVE.microsteps + 20, f"at once: {once} steps lost\nramped: {ramped} lost", color=RED, fontsize=8
    )
    ax.text(4.8, 720, "starts at once\nbelow the line", color=BLUE, fontsize=8, ha="right")
    ax.set(xlabel="inertia (rotors)", ylabel="pull-in rate (full steps/s)", xlim=(0, 12.5), ylim=(0, 2200))


def missed_steps_never_repair_themselves(ax):
    print("5. 100 full steps forth at 1000 a second, jammed by 0.5 N m for 8 ms, and at the same rate back; bare rotor")
    seconds = np.arange(count_slices(0.5)) * SLICE_S
    rates = np.where(seconds < 0.1, 1000.0, 0.0) - np.where((seconds >= 0.2) & (seconds < 0.3), 1000.0, 0.0)
    load = np.where((seconds >= 0.05) & (seconds < 0.058), 0.5, 0.0)
    trace = simulate_motor(DRIVE, compute_mean_counts(rates * DRIVE.microsteps), ROTOR, load, frame_damping=1e-3)
    for ms in (190, 499):
        k = count_slices(ms * 1e-3)
        rotor, lost = trace["theta"][k] / STEP, count_lost_steps(DRIVE, trace[: k + 1])
        print(f"   {ms} ms: {trace['count'][k]:.0f} pulses, rotor at {rotor:.3f} full steps; lost_steps = {lost}")
    ax.plot(seconds * 1e3, trace["count"] / DRIVE.microsteps, color=MUTED_COLOR, lw=2, label="pulses")
    ax.plot(seconds * 1e3, trace["theta"] / STEP, color=BLUE, lw=2, label="rotor")
    ax.axvspan(50, 58, color=RED, alpha=0.18, lw=0)
    ax.text(61, 8, "jammed", color=RED, fontsize=8)
    ax.text(405, 8, f"pulses back at 0,\nrotor {lost} full steps off", color=RED, fontsize=8, ha="center")
    ax.legend(frameon=False, fontsize=8, loc="upper right")
    ax.set(xlabel="ms", ylabel="full steps", xlim=(0, 500), ylim=(-20, 112))


def cost():
    for mode in ("chopper", "sine"):
        drive = Drive(MOTOR, mode=mode)
        for rpm in (300, 2000):
            counts = compute_mean_counts(np.full(300_000, rpm / 60 * drive.pulses_per_turn))
            best = np.inf
            for _ in range(7):
                start = time.perf_counter()
                simulate_motor(drive, counts, inertia=1e-5)
                best = min(best, (time.perf_counter() - start) / len(counts))
            print(f"a slice of the dynamometer, {mode}, {rpm} rpm: {best * 1e9:.0f} ns")


PANELS = (
    ("1  Pull-out follows the closed form", pull_out_follows_the_closed_form),
    ("2  The rotor rings at its natural frequency", the_rotor_rings_at_its_natural_frequency),
    ("2  Full steps excite it: torque is lost there", full_steps_lose_torque_at_resonance),
    ("3  Slip is a whole multiple of four full steps", slip_is_a_multiple_of_four_full_steps),
    ("4  Pull-in falls with inertia", a_start_fails_where_a_ramp_succeeds),
    ("5  Missed steps never repair themselves", missed_steps_never_repair_themselves),
)

if __name__ == "__main__":
    figure = Figure(figsize=(13, 7.4), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.1, h_pad=0.12)
    for ax, (text, draw) in zip(figure.subplots(2, 3).flat, PANELS, strict=True):
        draw(ax)
        set_title(ax, text)
        remove_frame(ax)
    path = sys.argv[1] if len(sys.argv) > 1 else "docs/pictures/stepper_behaviours.png"
    figure.savefig(path, dpi=140)
    print(f"{path}: drawn; {len(MOTORS)} motors known, this is the {MOTOR.name}")
    cost()
