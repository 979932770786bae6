"""A host elsewhere drives STEP/DIR axes by their lines."""

import numpy as np
import pytest
from support.served import serving

from stage import Stage
from stage.board import Board
from stage.serve import client as frames
from stage.serve.client import Batch, ServerError
from stage.sim.pin_edge_player import PIN_EDGE, play_pin_edges


def make_stage():
    return Stage("xy", chips={"x": "stepdir", "y": "stepdir"}, drives="a4988", bus_cycle=500e-9)


@pytest.fixture
def served():
    with serving(Board(make_stage())) as server:
        yield server


def test_a_batch_makes_edges_at_the_end_of_its_bus_cycles(served):
    with served.host() as host:
        batch = host.batch()
        for _ in range(20):
            batch.set_lines("y", step=True).spend_ns(3_000).set_lines("y", step=False).spend_ns(96_000)
        assert batch.run() == []
    stage, reference = served.board.stage, make_stage()
    edges = np.zeros((20, 2), PIN_EDGE)
    edges["time"] = 500 + 100_000 * np.arange(20)[:, None] + [0, 3_500]
    edges["axis"], edges["pins"], edges["levels"] = 1, 1, [1, 0]
    play_pin_edges(reference, edges.ravel(), 2_000_000)
    assert (stage.now, served.board.cycles) == (2_000_000, 40)
    assert stage.axes["y"].chip.state.tobytes() == reference.axes["y"].chip.state.tobytes()
    assert np.array_equal(stage.data.qpos, reference.data.qpos)


def test_lines_are_set_together_and_read_by_name(served):
    with served.host() as host:
        host.set_lines("x", dir=True, step=True, enable=False)
        chip = served.board.stage.axes["x"].chip
        assert (chip.net(), chip.dir, chip.enable) == (-1, True, False)
        assert not host.read_line("x", "limit")
        host.stick("x.el_plus", True)
        assert [host.read_line("x", line) for line in ("limit", "limit_plus", "limit_minus", "dir")] == [
            True,
            True,
            False,
            True,
        ]
        word, later = host.batch().read_lines("x").read_lines("x").run()
        assert word == later == chip.input_word(0)
        assert served.board.cycles == 8


@pytest.mark.parametrize(
    ("levels", "message"),
    [
        ({"limit_plus": True}, "'limit_plus' can only be read; a host drives step, dir, enable"),
        ({"origin": False}, "'origin' can only be read"),
        ({"step": "low"}, "step = 'low': a line is asserted or not; give True or False"),
        ({"dir": 2}, "dir = 2: a line is asserted or not"),
    ],
)
def test_lines_that_a_host_reads_and_levels_that_are_none_are_refused(served, levels, message):
    with served.host() as host:
        with pytest.raises(ValueError, match=message):
            host.set_lines("x", **levels)
        chip, (bit,) = host.find_lines("x", ["limit_plus"])
        batch = host.batch().set_lines("x", step=True).add(frames.SET_LINES, chip, bit << frames.LINES_SHIFT | bit)
        with pytest.raises(ServerError, match=r"entry 1: SET_LINES at chip 0, .* with lines step, dir and enable only"):
            batch.run()
        assert served.board.stage.axes["x"].chip.pins.as_dict() == make_stage().axes["x"].chip.pins.as_dict()


def test_a_change_of_a_watched_line_calls_the_hook(served):
    times = []
    with served.host() as host:

        def acknowledge():
            times.append(host.status().seconds)
            host.watch_lines("x", "limit", "origin")

        host.watch_lines("x", "limit", "origin")
        host.on_interrupt(acknowledge)
        host.delay_us(1000)
        assert times == []
        host.stick("x.el_plus", True)
        host.delay_us(1000)
        host.delay_us(1000)
        assert len(times) == 1
        host.watch_lines("x")
        host.stick("x.el_plus", None)
        host.delay_us(1000)
        assert len(times) == 1


def test_another_host_watches_nothing(served):
    with served.host() as host:
        host.watch_lines("x", "limit")
        host.stick("x.el_plus", True)
        assert host.status().interrupt
    with served.host() as host:
        assert not host.status().interrupt


def test_axes_and_lines_that_do_not_exist_are_refused(served):
    with served.host() as host:
        with pytest.raises(ValueError, match=r"'q': STEP/DIR axes of the server are x, y\."):
            host.set_lines("q", step=True)
        with pytest.raises(ValueError, match=r"'stp': lines of axis x are step, dir, enable, limit, "):
            host.batch().set_lines("x", stp=True)
        for entry in ((frames.SET_LINES, 2), (frames.READ_LINES, 7 | frames.WITH_CYCLE), (frames.WATCH_LINES, 0, -1)):
            with pytest.raises(ServerError, match="Nothing of this batch was done") as refused:
                host.batch().out8(0x300, 0).add(*entry).run()
            assert refused.value.answers == ()
    with pytest.raises(ValueError, match="belongs to no connection"):
        Batch().set_lines("x", step=True)
    assert served.board.cycles == 0


def test_a_board_without_step_dir_axes_describes_no_lines():
    with serving(Board(Stage("xy"))) as server, server.host() as host:
        assert host.about["lines"] == {}
        with pytest.raises(ValueError, match="STEP/DIR axes of the server are none"):
            host.read_lines("x")
