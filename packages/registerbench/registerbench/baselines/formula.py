"""An engineer's answer: registers from data sheets, without a single trial.

python -m registerbench.baselines.formula --payload 10

stage/tune/formula.py computes rates and ramps from mass, friction and thrust. This module converts them to registers by the
chip's data sheet: R1, R2, R4, R5, R7 and R6 of a PCL-240 (`firmware.Profile`), or those of other families
(`stage.firmware.driver`).
"""

from __future__ import annotations

import numpy as np

from registerbench.baselines.move_tuning import MoveTuning, format_answer, make_parser
from stage.tune.formula import SAFETY_FACTOR, Load, compute_registers, plan_profile

SAFETY_FACTORS = np.arange(2.0, 0.99, -0.05)  # safety factors that `try_safety_factors` tries


def make_formula_move(moves: MoveTuning, seed: int = 0, safety: float = SAFETY_FACTOR) -> None:
    """Make the one move of the formula.

    Args:
        moves: Move that is tuned.
        seed: Not used: the formula has no chance.
        safety: Pull-out thrust divided by the thrust that the move uses.
    """
    moves.measure_rewards_of_actions(
        moves.registers.to_action(compute_registers(moves.axis, moves.distance, safety, s_curve=False))[None]
    )


def try_safety_factors(moves: MoveTuning, seed: int = 0) -> None:
    """Make the formula's move with one safety factor after the other, as an engineer with a machine does.

    Args:
        moves: Move that is tuned.
        seed: Not used: the formula has no chance.
    """
    for factor in SAFETY_FACTORS:
        make_formula_move(moves, safety=float(factor))


def main() -> None:
    parser = make_parser(__doc__, searches=False)
    parser.add_argument("--safety", type=float, default=SAFETY_FACTOR, help="pull-out thrust over the thrust used")
    args = parser.parse_args()
    with MoveTuning(args.payload, 1, "registers", args.distance, lanes=1, chip=args.chip, model=args.model) as moves:
        load = Load.from_axis(moves.axis)
        print(f"moves {load.mass:.2f} kg, rotor and screw included; pull-in {load.pull_in_rate:.0f} pps")
        print(plan_profile(load, args.distance, args.safety))
        make_formula_move(moves, safety=args.safety)
    print(
        format_answer(moves.log, moves.registers.names, args.payload, args.distance, args.chip, args.model, args.margin)
    )


if __name__ == "__main__":
    main()
