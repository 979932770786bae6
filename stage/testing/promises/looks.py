"""Looks at a chip that more than one promise takes."""

from __future__ import annotations

from typing import Any

import numpy as np

from stage.chips import Chip


def counter(chip: Chip, axis: int) -> int:
    return int(chip.CORE.counter.held(chip.pointer, axis))


def showing(chip: Chip) -> Any:
    return (
        chip.values() | {f"{n} of axis {k}": v for k in range(1, chip.AXES) for n, v in chip.values_of(k).items()},
        [chip.output_word(k) for k in range(chip.AXES)],
        [chip.input_word(k) for k in range(chip.AXES)],
    )


def different(mine: Any, its: Any, when: str = "after power-up") -> str:
    for name in its[0]:
        if mine[0].get(name) != its[0][name]:
            return f"{name} {mine[0].get(name)}, and {when} {its[0][name]}"
    return f"pins {mine[1:]}, and {when} {its[1:]}"


def some(numbers: np.ndarray) -> str:
    shown = ", ".join(map(str, numbers[:5].tolist()))
    return f"{shown} ... {numbers[-1]}" if len(numbers) > 5 else shown
