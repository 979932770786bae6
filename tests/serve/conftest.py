import pytest
from support.served import serving

from stage import Stage
from stage.board import Board
from stage.chips import PCL240MK


@pytest.fixture(scope="module")
def start():
    stage = Stage("xy", chips=PCL240MK, visuals=False)
    return stage, stage.snapshot()


@pytest.fixture
def board(start):
    """Two axes at rest."""
    stage, snapshot = start
    for axis in stage.axes.values():
        for name in axis.switches.as_dict():
            axis.switches.stick(name, None)
    stage.restore(snapshot)
    return Board(stage)


@pytest.fixture
def served(board):
    with serving(board) as built:
        yield built
