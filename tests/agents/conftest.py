"""Toolboxes at power-up, whose stages are created once a process."""

import pytest

from stage import Stage
from stage.agents import Budget, Toolbox

_stages = {}


def a_box(chips="PCL240K", mode="host", model="xy", **how):
    """Return a toolbox of a stage at power-up."""
    if (model, chips) not in _stages:
        _stages[model, chips] = Stage(model, chips=chips, visuals=False)
    stage = _stages[model, chips]
    stage.reset()
    return Toolbox(stage, mode, how.pop("budget", Budget()), **how)


@pytest.fixture
def make_box():
    """Return `make_box(chips, mode, budget=...)`; the toolboxes are closed at the end."""
    created = []

    def make(*args, **how):
        for box in created:
            box.close()
        created.append(a_box(*args, **how))
        return created[-1]

    yield make
    for box in created:
        for name in ("clear_faults",):
            if name in box.tools:
                box.call(name, {"all": True})
        box.close()


@pytest.fixture
def box(make_box):
    """A toolbox of xy with PCL-240Ks, in host mode, without limits."""
    return make_box()
