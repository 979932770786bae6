"""What is kept keeps what it needs: nothing that compiled code reaches can be freed while somebody may call it."""

import gc
import weakref

import numpy as np
import pytest

from stage import Fleet, Program, Stage
from stage.board import Board
from stage.chips import PCL240K

HANDED_OUT = {
    "an axis": lambda stage: stage.axes["x"],
    "a chip": lambda stage: stage.axes["x"].chip,
    "pins": lambda stage: stage.axes["x"].pins,
    "switches": lambda stage: stage.axes["x"].switches,
    "a board": Board,
    "a fleet": lambda stage: Fleet([stage]),
    "a recording": lambda stage: stage.record(),
}


def use_part(part):
    """Use a part of a stage in its usual way and return the result."""
    if isinstance(part, Board):
        return part.in8(0x300)
    if isinstance(part, Fleet):
        return part.play([Program().wait(1e-3)]).diverged.any()
    if isinstance(part, PCL240K):
        part.write(0, 0x08)
        return part.read(0)
    return repr(part)


@pytest.mark.parametrize("what", HANDED_OUT)
def test_what_a_stage_handed_out_works_when_nobody_else_keeps_the_stage(what):
    gc.freeze()  # what other tests have left need not be searched: 0.3 s a collection in a long session
    stage = Stage("xy", visuals=False)
    part, gone = HANDED_OUT[what](stage), weakref.ref(stage)
    del stage
    gc.collect()
    rubbish = [np.full(50_000, 7.0) for _ in range(40)]  # takes the place of what was freed
    assert gone() is not None
    use_part(part)
    del rubbish, part
    gc.collect()
    assert gone() is None, "and nothing keeps it longer"
