"""The engineer's answer: registers from data sheets, without a single trial.

python -m registerbench.baselines.formula --payload 10

stage/tune/formula.py says how: mass, friction and thrust give rates and ramps. Here they become registers, by the chip's data
sheet: of a PCL-240 R1, R2, R4, R5, R7, R6 (`firmware.Profile`), of other families their own (`stage.firmware.driver`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stage.firmware import Axis
from stage.firmware.driver import driver_of
from stage.tune.formula import SAFETY_FACTOR, Load, compute_registers, plan_profile

if TYPE_CHECKING:
    from registerbench.baselines.common import Moves

FACTORS = np.arange(2.0, 0.99, -0.05)  # safety factors that `boldest` tries


class Knobs:
    """The formula's answer as the middle of a search: factors on its rates and accelerations, and on the ramp-down point.

    A chip without R6 finds its ramp-down point itself, and has one acceleration for both ramps.
    """

    RANGES = (3.0, 1.3, 1.7, 1.7, 1.06)  # FL, FH, acceleration, deceleration, R6: from 1 / so much to so much

    def __init__(self, axis: Axis, pulses: int):
        self.pulses, self.middle, self.driver = pulses, plan_profile(Load.from_axis(axis), pulses), driver_of(axis)
        self.ranges = self.RANGES if "R6" in self.driver.list_move_registers(s_curve=False) else self.RANGES[:3]

    def registers(self, knobs: np.ndarray) -> dict[str, int]:
        """Compute registers from as many numbers from -1 to 1 as there are `ranges`; all 0 are the formula's."""
        fl, fh, up, *others = np.array(self.ranges) ** np.asarray(knobs, float)
        down, point = others or (up, 1.0)
        m = self.middle
        low, high = m.fl * fl, m.fh1 * fh
        low = min(low, high)
        longer = (high - low) / (m.fh1 - m.fl)
        ramps = (max(ramp * longer / factor, 1e-3) for ramp, factor in ((m.accel(), up), (m.decel(), down)))
        made = self.driver.formula(low, high, *ramps, self.pulses, s_curve=False)
        return {**made, "R6": min(round(made["R6"] * point), 0xFFFFF)} if others else made


def search(moves: Moves, seed: int = 0, safety: float = SAFETY_FACTOR) -> None:
    """Make one move: the formula's."""
    moves.make_actions(
        moves.registers.to_action(compute_registers(moves.axis, moves.distance, safety, s_curve=False))[None]
    )


def boldest(moves: Moves, seed: int = 0) -> None:
    """Try the formula with one safety factor after the other, as an engineer with a machine does."""
    for factor in FACTORS:
        search(moves, safety=float(factor))


def main() -> None:
    from registerbench.baselines.common import Moves, arguments, describe_answer

    parser = arguments(__doc__, searches=False)
    parser.add_argument("--safety", type=float, default=SAFETY_FACTOR, help="pull-out thrust over the thrust used")
    args = parser.parse_args()
    with Moves(args.payload, 1, "registers", args.distance, lanes=1, chip=args.chip, model=args.model) as moves:
        load = Load.from_axis(moves.axis)
        print(f"moves {load.mass:.2f} kg, rotor and screw included; pull-in {load.pull_in_rate:.0f} pps")
        print(plan_profile(load, args.distance, args.safety))
        search(moves, safety=args.safety)
    print(
        describe_answer(
            moves.log, moves.registers.names, args.payload, args.distance, args.chip, args.model, args.margin
        )
    )


if __name__ == "__main__":
    main()
