"""Edges of input pins, such as the STEP and DIR lines of a host, applied at their nanosecond while a stage's time passes: compiled.

On the way the stage is observed: every edge of its switches, and the largest following error of each axis.
"""

from __future__ import annotations

from stage.chips import core_interface
from stage.chips.journal_entries import INPUT
from stage.drives import drive_dispatch
from stage.native import array_at, exported, greatest, hot, least, record
from stage.sim.compiled_stage_access import (
    HANDLE,
    get_axis_table,
    get_chip_table,
    get_clockwork,
    get_drives,
    get_qpos,
    get_qvel,
    get_world,
)
from stage.sim.engine import advance
from stage.sim.engine_records import EDGES_FULL, LOGGED_EDGE, NEVER, REACHED, SAMPLES_FULL
from stage.sim.switch_edges import journal_input

PIN_EDGE = record([(name, "i8") for name in "time axis pins levels".split()])
"""An edge: time, ns since power-up; index of the axis; the input pins of its chip that change (bits), and their levels (bits)."""
SWITCH_EDGE = record([(name, "i8") for name in "time axis inputs".split()])
"""An edge of switches: time, ns; index of the axis; the input pins of its chip from then on."""
OBSERVED_AXIS = record([("inputs", "i8"), ("switches", "i8"), ("largest_error", "f8"), ("error_time", "i8")])
"""An axis: its input pins now; those that its switches drive (bits); the largest following error (joint units); its time, ns."""
PIN_EDGE_PLAYER = record(
    [(name, "i8") for name in "edges n_edges next has_journals axes switch_edges room n_switch_edges".split()]
)
"""Edges to play: address and number of PIN_EDGE records, and the next of them; whether chips keep journals. Observations: address
of an OBSERVED_AXIS for each axis; address, room and number of SWITCH_EDGE records."""


@hot
def _store_switch_edges(handle, player, first_entry):
    """Store the switch edges that the engine has logged, from entry `first_entry` of its log on; `player` is a PIN_EDGE_PLAYER."""
    entries = array_at(handle.edges, handle.edge_room, LOGGED_EDGE)
    axes = array_at(player.axes, handle.n_axes, OBSERVED_AXIS)
    switch_edges = array_at(player.switch_edges, player.room, SWITCH_EDGE)
    for k in range(first_entry, handle.noted):
        e = entries[k]
        if e.kind != INPUT:
            continue
        axis = axes[e.axis]
        changed = (axis.inputs ^ e.b) & axis.switches
        axis.inputs = e.b
        if changed and player.n_switch_edges < player.room:
            out = switch_edges[player.n_switch_edges]
            out.time, out.axis, out.inputs = e.now, e.axis, e.b
            player.n_switch_edges += 1


@hot
def _update_largest_following_errors(handle, player):
    """Update the largest following error of each axis at the end of a physics step."""
    axes = array_at(player.axes, handle.n_axes, OBSERVED_AXIS)
    for a in range(handle.n_axes):
        t = get_axis_table(handle)[a]
        count = float(core_interface.read_net_count(get_chip_table(handle)[t.chip], t.chip_axis))
        position = get_qpos(handle)[t.qpos] - get_qvel(handle)[t.dof] * get_clockwork(handle).half
        error = abs(drive_dispatch.compute_lag(get_drives(handle)[a], count, position * t.gear) / t.gear)
        if error > axes[a].largest_error:
            axes[a].largest_error, axes[a].error_time = error, get_world(handle).now


@hot
def _apply_edge(handle, player, edge):
    """Change the input pins of an axis now, as a PIN_EDGE record describes."""
    t = get_axis_table(handle)[edge.axis]
    c = get_chip_table(handle)[t.chip]
    before = core_interface.read_inputs(c, t.chip_axis)
    word = before & ~edge.pins | edge.levels & edge.pins
    if word != before:
        core_interface.set_input(c, t.chip_axis, word)
        array_at(player.axes, handle.n_axes, OBSERVED_AXIS)[edge.axis].inputs = word
        if player.has_journals:
            journal_input(handle, get_world(handle).now, c, t.chip_axis)


@exported("i8", HANDLE, "i8", PIN_EDGE_PLAYER)
def run_with_pin_edges(handle, until_ns, player):
    """Let the stage's time pass up to `until_ns` as `engine.advance` does, and apply every pin edge up to then at its time.

    Returns:
        Reason of the stop, as `engine.advance` returns it.
    """
    w, dt, edges = get_world(handle), get_clockwork(handle).dt, array_at(player.edges, player.n_edges, PIN_EDGE)
    while True:
        time = edges[player.next].time if player.next < player.n_edges else NEVER
        start, noted = w.start, handle.noted
        status = advance(handle, least(least(until_ns, greatest(time, w.now)), w.start + dt))
        if status not in (REACHED, SAMPLES_FULL, EDGES_FULL):
            return status
        _store_switch_edges(handle, player, noted)
        if w.start != start:
            _update_largest_following_errors(handle, player)
        if status != REACHED:
            return status
        if time <= w.now:
            if (
                player.has_journals and handle.noted >= handle.edge_room - get_clockwork(handle).most_edges
            ):  # the engine needs that much in any step
                return EDGES_FULL
            _apply_edge(handle, player, edges[player.next])
            player.next += 1
        elif w.now >= until_ns:
            return REACHED
