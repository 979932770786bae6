"""`play_pin_edges`: edges of input pins, played into a stage while its time passes."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from stage.chips.exclusive_access import get_stage_lock
from stage.errors import ArgumentError
from stage.native import address_of
from stage.sim.compiled_pin_edge_player import OBSERVED_AXIS, PIN_EDGE, PIN_EDGE_PLAYER, SWITCH_EDGE, run_with_pin_edges
from stage.sim.engine_records import SWITCH_PINS

if TYPE_CHECKING:
    from stage.sim.stage import Stage

__all__ = ["PIN_EDGE", "PinEdgeObservation", "play_pin_edges"]

MAX_SWITCH_EDGES = 1 << 14


class PinEdgeObservation(NamedTuple):
    """Observations of a stage during a play of pin edges.

    Attributes:
        switch_edges: SWITCH_EDGE records, the first MAX_SWITCH_EDGES of them.
        largest_errors: Largest following error of each axis at the end of a physics step, m (rad on a hinge).
        error_times: Time of each largest error, ns since power-up.
    """

    switch_edges: np.ndarray
    largest_errors: np.ndarray
    error_times: np.ndarray


def play_pin_edges(stage: Stage, edges: np.ndarray, until: int) -> PinEdgeObservation:
    """Let a stage's time pass, and change input pins of its chips on the way, each edge at its nanosecond, in compiled code.

    Args:
        stage: The stage.
        edges: PIN_EDGE records in the order of their times; an edge whose time has passed is made at once.
        until: Time at the end, ns since power-up; later edges are ignored.

    Raises:
        ArgumentError: The edges are not in order, or are of axes that the stage does not have.
        SimulationError: The simulation diverges, see `Stage.run`.
    """
    edges = np.ascontiguousarray(edges, PIN_EDGE)
    if len(edges) and not 0 <= edges["axis"].min() <= edges["axis"].max() < len(stage.axes):
        raise ArgumentError(f"edges: axes are given by their index, 0 to {len(stage.axes) - 1}.")
    if np.any(np.diff(edges["time"]) < 0):
        raise ArgumentError("edges: their times go back. Sort them by time.")
    axes, switch_edges = np.zeros(len(stage.axes), OBSERVED_AXIS), np.zeros(MAX_SWITCH_EDGES, SWITCH_EDGE)
    for row, axis in zip(axes, stage.axes.values(), strict=True):
        row["inputs"] = axis.chip.input_word(axis.chip_axis)
        row["switches"] = sum({axis.chip.find_switch_input(pin) for pin in SWITCH_PINS})
    player = np.zeros(1, PIN_EDGE_PLAYER)
    row = player[0]
    row["edges"], row["n_edges"], row["axes"] = edges.ctypes.data, len(edges), axes.ctypes.data
    row["switch_edges"], row["room"] = switch_edges.ctypes.data, len(switch_edges)
    row["has_journals"] = any(chip.open_journal is not None for chip in stage.chips)
    where = address_of(row)
    with (
        get_stage_lock(stage),
        stage.loop.use_advance_function(lambda pointer, goal: run_with_pin_edges.c(pointer, goal, where)),
    ):
        stage.run_to(until)
    return PinEdgeObservation(
        switch_edges[: int(row["n_switch_edges"])], axes["largest_error"].copy(), axes["error_time"].copy()
    )
