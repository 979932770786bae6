"""Threshold sweep of sensorless homing with a TMC2209: false trigger, good or missed stop over speed, current and friction.

    python packages/trinamic/examples/stallguard_sweep.py [PICTURE.png] [--quick]

For each speed, current and friction, an axis homes against its end of travel once, and the program notes SG_RESULT at each full
step. A threshold SGTHRS then gives a false trigger if a result on the free travel is at or below 2 SGTHRS, a good stop if the first
such result comes within GOOD_STOP_STEPS of the contact, and a missed stop if it comes later or never. One run serves all
thresholds, as SGTHRS changes nothing but DIAG.
"""

import argparse
from typing import NamedTuple

import numpy as np

from stage import Drive, Stage, firmware

FALSE_TRIGGER, GOOD, MISSED = range(3)
OUTCOMES = ("false trigger", "good", "missed stop")
COLORS = ("#c4572e", "#3a8a5f", "#c9d1da")
SPEEDS_PPS = (1600, 2400, 3200, 4800, 6400, 9600, 12_800)
CURRENTS_A = (0.6, 0.9, 1.2, 1.6)
FRICTIONS_N = (2.0, 20.0, 60.0)
THRESHOLDS = np.arange(0, 161, 4)
MICROSTEPS = 16
START_M, END_M = 0.150, 0.1559
"""Place where a run begins, and from which on the carriage touches the end of travel, m."""
STEPS_PER_SAMPLE, SAMPLES, SAMPLES_AFTER_CONTACT = 8, 1000, 100
GOOD_STOP_STEPS = 4 * MICROSTEPS
"""A good stop comes within one electrical turn after the contact."""


class Homing(NamedTuple):
    """Results of StallGuard4 in one run, and the steps at which each was read, counted from the contact with the end of travel.

    Attributes:
        results: SG_RESULT at each sample.
        steps: Steps of 1/16 since the contact, below 0 on the free travel.
    """

    results: np.ndarray
    steps: np.ndarray


def record_homing(speed: float, current: float, friction: float) -> Homing:
    """Run an axis at a speed against its end of travel, and record SG_RESULT.

    Args:
        speed: Steps of 1/16 full step per second.
        current: Amplitude of the phase current, A.
        friction: Friction of the carriage, N.
    """
    drive = Drive(power_stage="tmc2209", microsteps=MICROSTEPS, current=current)
    machine = Stage("xy", chips="stepdir", drives=drive, visuals=False)
    x = machine.axes["x"]
    firmware.move(x, START_M)
    machine.model.dof_frictionloss[x.plant.dof] = friction
    for rate in np.geomspace(min(800, speed), speed, 40):
        x.pulse(16, rate=rate)
    results, contact = [], None
    for sample in range(SAMPLES):
        x.pulse(STEPS_PER_SAMPLE, rate=speed)
        results.append(x.chip.read_register("SG_RESULT"))
        if contact is None and x.position >= END_M:
            contact = sample
        if contact is not None and sample > contact + SAMPLES_AFTER_CONTACT:
            break
    contact = len(results) if contact is None else contact
    return Homing(np.array(results), (np.arange(len(results)) - contact) * STEPS_PER_SAMPLE)


def judge(homing: Homing, threshold: int) -> int:
    """Return FALSE_TRIGGER, GOOD or MISSED for a threshold SGTHRS."""
    stalls = np.flatnonzero(homing.results <= 2 * threshold)
    if not len(stalls):
        return MISSED
    steps = homing.steps[stalls[0]]
    return FALSE_TRIGGER if steps < 0 else GOOD if steps <= GOOD_STOP_STEPS else MISSED


def sweep(speeds, currents, frictions) -> np.ndarray:
    """Return the outcome for each friction, current, threshold and speed."""
    outcomes = np.zeros((len(frictions), len(currents), len(THRESHOLDS), len(speeds)), np.int64)
    for f, friction in enumerate(frictions):
        for c, current in enumerate(currents):
            for s, speed in enumerate(speeds):
                homing = record_homing(speed, current, friction)
                outcomes[f, c, :, s] = [judge(homing, int(threshold)) for threshold in THRESHOLDS]
    return outcomes


def draw(outcomes: np.ndarray, speeds, currents, frictions, path: str) -> None:
    """Draw the outcomes over speed and threshold, a panel for each friction and current."""
    import matplotlib.pyplot as plt
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    fig, axes = plt.subplots(
        len(frictions), len(currents), figsize=(2.6 * len(currents), 2.3 * len(frictions)), squeeze=False,
        sharex=True, sharey=True, layout="constrained",
    )  # fmt: skip
    for f, friction in enumerate(frictions):
        for c, current in enumerate(currents):
            ax = axes[f, c]
            ax.imshow(outcomes[f, c], cmap=ListedColormap(COLORS), vmin=0, vmax=2, aspect="auto", origin="lower")
            ax.set_title(f"{current:g} A, {friction:g} N", fontsize=9)
            ax.set_xticks(range(len(speeds)), [f"{speed / 3200:.2g}" for speed in speeds], fontsize=8)
            ticks = range(0, len(THRESHOLDS), 10)
            ax.set_yticks(ticks, [str(THRESHOLDS[k]) for k in ticks], fontsize=8)
    fig.supxlabel("speed, turns/s", fontsize=9)
    fig.supylabel("SGTHRS", fontsize=9)
    patches = [Patch(color=color, label=name) for color, name in zip(COLORS, OUTCOMES, strict=True)]
    fig.legend(handles=patches, loc="outside upper center", ncols=3, fontsize=9)
    fig.savefig(path, dpi=130)


def main() -> None:
    """Sweep, print the range of good thresholds for each case, and draw the picture if a path is given."""
    parser = argparse.ArgumentParser(description="Threshold sweep of sensorless homing with a TMC2209.")
    parser.add_argument("picture", nargs="?", help="PNG or SVG to write")
    parser.add_argument("--quick", action="store_true", help="fewer speeds, currents and frictions")
    args = parser.parse_args()
    cases = (SPEEDS_PPS, CURRENTS_A, FRICTIONS_N)
    if args.quick:
        cases = ((3200, 9600), (1.2,), (2.0, 60.0))
    outcomes = sweep(*cases)
    speeds, currents, frictions = cases
    print("friction  current  speed      SGTHRS that stop well")
    for f, friction in enumerate(frictions):
        for c, current in enumerate(currents):
            for s, speed in enumerate(speeds):
                good = THRESHOLDS[outcomes[f, c, :, s] == GOOD]
                text = f"{good[0]} to {good[-1]}" if len(good) else "none"
                print(f"{friction:6g} N {current:6g} A {speed / 3200:6.2f} /s  {text}")
    if args.picture:
        draw(outcomes, *cases, args.picture)


if __name__ == "__main__":
    main()
