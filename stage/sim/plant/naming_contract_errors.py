"""Errors of a model that breaks the naming contract, collected, with proposals that repair them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import mujoco

from stage.errors import ModelError, find_similar_names
from stage.sim.plant.model_proposals import Proposal, format_proposals


class ModelProblems:
    """Collection of everything in one model that breaks the naming contract: descriptions and proposals."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self.proposals: list[Proposal] = []

    def add_problem(self, axis: str, text: str, *proposals: Proposal) -> None:
        """Add a problem.

        Args:
            axis: Name of the axis.
            text: What is wrong.
            *proposals: Elements that would repair it together.
        """
        self.texts.append(f"axis {axis}: {text}")
        self.proposals += [p for p in proposals if p not in self.proposals]

    def raise_if_any(self) -> None:
        """Raise one ModelError that lists all problems, if there are any."""
        if self.texts:
            raise make_model_error(
                "the model does not keep the naming contract (docs/models.md):\n  - " + "\n  - ".join(self.texts),
                self.proposals,
            )


def make_model_error(message: str, proposals: Sequence[Proposal]) -> ModelError:
    """Make a ModelError whose message ends with proposals."""
    ending = f"\n  elements to paste into the model:{format_proposals(proposals)}" if proposals else ""
    return ModelError(message + ending, [p.line for p in proposals])


def find_nearest_name(name: str, known: Iterable[str]) -> list[str]:
    """Return the known name that is most similar to `name` in a list, empty if none is similar."""
    return find_similar_names(name, filter(None, known), 0.6)[:1]


def suggest_name(model: Any, kind: Any, count: int, name: str, axes: Sequence[str]) -> str:
    """Suggest a similar name of the model for a missing name, as a clause for an error; "" if no name is similar."""
    known = (mujoco.mj_id2name(model, kind, k) or "" for k in range(count))
    near = find_nearest_name(name, (k for k in known if k not in axes))
    return f" (there is {near[0]!r}: a slip?)" if near else ""
