"""An engineer's answer to `stage/ServoTuning-v0`: gain, zero and pole by frequency response, without a trial on the machine.

python -m registerbench.baselines.servo_formula --payload 10 --margin 50
python -m registerbench.baselines.servo_formula --plot build/servo_loop.png       Bode and root locus, by python-control

The design derives the sampled plant from the machine's data: motor, masses, friction. For every value of the zero register, it
computes the highest crossover frequency that has the required phase margin, and the gain for it. One count of the encoder must
not change the motor command by more than --rattle, because a coarse encoder makes a fast filter rattle. Of the zeros with nearly
the highest crossover, the design takes the lowest, which is the stiffest at rest. Needs python-control (extra servo).
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from stage.errors import StageError
from stage.firmware.hctl1100 import servo_loop_model
from stage.firmware.hctl1100.moves import FilterTuning
from stage.firmware.hctl1100.servo_loop_model import DEFAULT_POLE, MAX_RATTLE, PHASE_MARGIN_DEGREES, ServoLoop
from stage.support.extras import import_extra

DEFAULT_SAMPLE_TIMER = 0x40  # sample timer after a reset
MAX_MARGIN_LOSS_DEGREES = 3.0  # by which a rounded gain may reduce the phase margin


def import_control() -> Any:
    """Import python-control. Raises ExtraMissing if it is not installed."""
    return import_extra("control", "this baseline")


class LoopDesign(NamedTuple):
    """Servo loop with the margins that python-control computes for the registers' values.

    Attributes:
        tuning: Gain, zero, pole and sample timer.
        phase_margin: Degrees.
        gain_margin: Factor on the gain.
        crossover: Crossover frequency, rad/s.
    """

    tuning: FilterTuning
    phase_margin: float
    gain_margin: float
    crossover: float

    def __str__(self) -> str:
        t = self.tuning
        return (
            f"gain {t.gain} zero {t.zero} pole {t.pole} T {t.timer}: phase margin {self.phase_margin:.0f} degrees, gain margin "
            f"{self.gain_margin:.1f}, crossover {self.crossover / (2 * np.pi):.0f} Hz"
        )


def make_open_loop(loop: ServoLoop) -> Any:
    """Return the open loop, filter times plant, as a transfer function of python-control."""
    tf, h = import_control().tf, loop.sample
    return tf(*loop.filter, h) * tf(*loop.plant, h)


def compute_margins(loop: ServoLoop) -> LoopDesign:
    """Compute the stability margins of a servo loop."""
    gain, phase, _, crossover = import_control().margin(make_open_loop(loop))
    return LoopDesign(loop.tuning, float(phase), float(gain), float(crossover))


def design_filter(loop: ServoLoop, margin: float = PHASE_MARGIN_DEGREES, rattle: float = MAX_RATTLE) -> LoopDesign:
    """Choose gain and zero of the servo filter for this plant; pole and sample timer stay.

    Args:
        loop: Servo loop with the plant.
        margin: Phase margin, degrees.
        rattle: Largest change of the motor command for one count of the encoder.

    Returns:
        The chosen tuning with its margins.

    Raises:
        StageError: No filter reaches the margin (see `stage.firmware.hctl1100.servo_loop_model.design_filter`).
    """
    return compute_margins(replace(loop, tuning=servo_loop_model.design_filter(loop, margin, rattle)))


def design_registers(axis: Any, timer: int = DEFAULT_SAMPLE_TIMER) -> dict[str, int]:
    """Design the filter for an axis of a stage and its payload.

    Args:
        axis: Axis of the stage.
        timer: Sample timer R0F.

    Returns:
        R22, R20, R21 and R0F by name.
    """
    t = design_filter(ServoLoop.from_axis(axis, FilterTuning(pole=DEFAULT_POLE, timer=timer))).tuning
    return {"R22": t.gain, "R20": t.zero, "R21": t.pole, "R0F": t.timer}


def draw_design(design: LoopDesign, loop: ServoLoop, path: Path) -> None:
    """Draw the Bode diagram and the root locus of a servo loop.

    Args:
        design: Design to draw.
        loop: Servo loop with the plant.
        path: PNG file.
    """
    from matplotlib import pyplot as plt

    c, system = import_control(), make_open_loop(replace(loop, tuning=design.tuning))
    figure, axes = plt.subplots(1, 3, figsize=(15, 5), layout="constrained")
    omega = np.geomspace(1.0, 0.95 * np.pi / loop.sample, 800)
    response = system(np.exp(1j * omega * loop.sample))
    axes[0].loglog(omega / (2 * np.pi), np.abs(response))
    axes[1].semilogx(omega / (2 * np.pi), np.degrees(np.unwrap(np.angle(response))))
    axes[0].axvline(design.crossover / (2 * np.pi), color="#d1571f", lw=1)
    axes[1].axvline(design.crossover / (2 * np.pi), color="#d1571f", lw=1)
    axes[0].set(xlabel="frequency (Hz)", ylabel="open loop", title=f"crossover {design.crossover / (2 * np.pi):.0f} Hz")
    axes[1].set(
        xlabel="frequency (Hz)", ylabel="phase (degrees)", title=f"phase margin {design.phase_margin:.0f} degrees"
    )
    loci = c.root_locus_map(system, gains=np.geomspace(1e-2, 10, 400)).loci
    axes[2].plot(loci.real, loci.imag, color="#66717d", lw=1)
    poles = replace(loop, tuning=design.tuning).poles
    axes[2].plot(poles.real, poles.imag, "x", color="#d1571f")
    axes[2].add_patch(plt.Circle((0, 0), 1, fill=False, color="#aab4be"))
    axes[2].set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2), aspect="equal", title="root locus in z")
    figure.savefig(path, dpi=110)


def measure_moves(payload: float, values: dict[str, int], distance: int = 200, moves: int = 8) -> dict[str, float]:
    """Make a few moves of the environment with these registers, and compute means over them.

    Args:
        payload: Mass on the table, kg.
        values: R22, R20, R21 and R0F by name.
        distance: Length of a move, encoder counts.
        moves: Number of moves.

    Returns:
        Means of reward, settled, overshoot and unrest by name.
    """
    import gymnasium

    import stage.envs  # noqa: F401

    env = gymnasium.make(
        "stage/ServoTuning-v0", disable_env_checker=True, moves=moves, distances=(distance, distance + moves),
        payloads=(payload, payload),
    ).unwrapped  # fmt: skip
    env.reset(seed=0)
    rows = []
    for _ in range(moves):
        _, reward, *_, info = env.step(env.task_instance.registers.to_action(values))
        rows.append((reward, info["settled"], info["overshoot"], info["unrest"]))
    return dict(zip(("reward", "settled", "overshoot", "unrest"), np.mean(rows, axis=0).tolist(), strict=True))


def main() -> None:
    from stage import Stage
    from stage.chips import HCTL1100

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--payload", type=float, default=0.0, metavar="KG", help="on the table")
    parser.add_argument("--margin", type=float, default=PHASE_MARGIN_DEGREES, metavar="DEGREES", help="phase margin")
    parser.add_argument(
        "--rattle", type=float, default=MAX_RATTLE, metavar="UNITS", help="motor command for one count, at most"
    )
    parser.add_argument("--plot", type=Path, metavar="PNG", help="Bode diagram and root locus")
    args = parser.parse_args()
    stage = Stage("xyz_servo", chips=HCTL1100)
    stage.set_payload(args.payload)
    loop = ServoLoop.from_axis(stage.axes["x"], FilterTuning(pole=DEFAULT_POLE, timer=DEFAULT_SAMPLE_TIMER))
    try:
        by_reset, designed = compute_margins(loop), design_filter(loop, args.margin, args.rattle)
    except StageError as error:
        sys.exit(str(error))
    for name, d in (("after a reset", by_reset), ("designed", designed)):
        t = d.tuning
        print(f"{name}: {d}")
        means = measure_moves(args.payload, {"R22": t.gain, "R20": t.zero, "R21": t.pole, "R0F": t.timer})
        print(f"  settles in {means['settled'] * 1e3:.0f} ms, {means['overshoot']:.1f} counts beyond the goal, unrest "
              f"{means['unrest']:.1f} counts; reward {means['reward']:.4f}")  # fmt: skip
    if args.plot:
        draw_design(designed, loop, args.plot)
        print(f"{args.plot}: drawn")


if __name__ == "__main__":
    main()
