"""Random choices, the best kept. Whatever learns should beat it.

python -m registerbench.baselines.random_search --budget 1024 --seed 0
python -m registerbench.baselines.random_search --space registers
"""

from __future__ import annotations

import numpy as np

from registerbench.baselines.common import Moves, run


def search(moves: Moves, seed: int = 0) -> None:
    """Spend the budget."""
    rng = np.random.default_rng(seed)
    while moves.left:
        moves.make(rng.uniform(-1, 1, (moves.lanes, moves.size)))


if __name__ == "__main__":
    run(__doc__, search)
