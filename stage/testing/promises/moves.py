"""Promises about moves: counts and pins from start to end, limit switches, and the independence of axes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stage.chips import Chip
from stage.testing.chip_actions import (
    Act,
    count_clocks_to_end,
    draw_move,
    find_pulse_clocks,
    limit_pulses,
    list_stop_acts,
    perform_acts,
    replace_command_code,
)
from stage.testing.promise_trial import BrokenPromise, PromiseTrial, read_counter


def check_outputs_during_move(trial: PromiseTrial) -> None:
    """Check that busy, net, counter and pins agree with the trace during the whole of a move by the host driver."""
    for rng in trial.make_seeded_generators():
        for chip, axis, pulses in trial.start_moves(rng):
            _check_outputs_of_axis_during_move(trial, rng, chip, axis, pulses)


def _check_outputs_of_axis_during_move(
    trial: PromiseTrial, rng: np.random.Generator, chip: Chip, axis: int, pulses: int
) -> None:
    """Check one move that has just started."""
    left, direction = abs(pulses), 1 if pulses > 0 else -1
    _require_busy(chip, axis, left)
    clocks = count_clocks_to_end(chip, axis)
    at = find_pulse_clocks(chip, clocks)
    if len(at) != left:
        raise BrokenPromise(f"the driver's move of {pulses} pulses makes {len(at)} in {clocks} clocks")
    bits, count, net = trial.chip_class.COUNTER[1], read_counter(chip, axis), chip.net(axis)
    for n in sorted({0, *(int(k) for k in rng.integers(0, at[-1], 6)), int(at[-1]) - 1}):
        probe = chip.make_replica()
        probe.advance(n)
        pulse_count = int((at <= n).sum())
        if probe.net(axis) - net != direction * pulse_count:
            raise BrokenPromise(
                f"the driver's move of {pulses} pulses: net has gone by {probe.net(axis) - net} when the trace lists {pulse_count}"
            )
        _require_busy(probe, axis, left - pulse_count)
        gone = (read_counter(probe, axis) - count) % (1 << bits)
        if gone not in (pulse_count, -pulse_count % (1 << bits)):
            raise BrokenPromise(f"counter has gone by {gone} when the trace lists {pulse_count} pulses")
    rest = chip.make_replica()
    rest.advance(clocks + chip.clock_hz)
    if rest.busy(axis) or rest.CORE.is_busy.with_gil(rest.pointer, axis):
        raise BrokenPromise("it says that it drives a second after the end of a move")


def _require_busy(chip: Chip, axis: int, pulses_left: int) -> None:
    """Raise BrokenPromise unless status and core show that the axis drives, with `pulses_left` pulses to come."""
    busy, core = chip.busy(axis), bool(chip.CORE.is_busy.with_gil(chip.pointer, axis))
    if busy and core:
        return
    text = f"{'its core' if busy else 'the status on its bus'} says at rest, and {pulses_left} pulses come"
    if not chip.input_word(axis):
        text += ", while no input is asserted"
    if chip.AXES > 1:
        driving = [k for k in range(chip.AXES) if chip.CORE.is_busy.with_gil(chip.pointer, k)]
        text = f"axis {axis} is to move: {text}; its core says that axes {driving} drive"
    raise BrokenPromise(text)


MAX_TRIED_ACTS = 12
"""Of the things that a host writes to an axis, so many are tried beside each move of another."""


def check_limit_switches(trial: PromiseTrial) -> None:
    """Check that an end switch stops only the driver's move towards it, and that `find_selected_direction` knows each direction."""
    for rng in trial.make_seeded_generators():
        for chip, axis, pulses in trial.start_moves(rng):
            _check_direction(trial, axis, pulses, rng)
            free = chip.make_replica()
            free.advance(count_clocks_to_end(free, axis))
            if free.net(axis) - chip.net(axis) != pulses:
                continue  # `check_outputs_during_move` tells
            for switch, direction in (("el_plus", 1), ("el_minus", -1)):
                bit = trial.chip_class.find_switch_input(switch)
                if not bit:
                    continue
                probe = chip.make_replica()
                probe.set_input_word(axis, probe.input_word(axis) | bit)
                probe.advance(count_clocks_to_end(probe, axis))
                pulses_made, towards = probe.net(axis) - chip.net(axis), pulses * direction > 0
                if towards and (probe.busy(axis) or pulses_made == pulses):
                    raise BrokenPromise(
                        f"{_describe_move(trial, axis, pulses)} goes on to its end, though {switch} is asserted at its start"
                    )
                if not towards and pulses_made != pulses:
                    raise BrokenPromise(
                        f"{_describe_move(trial, axis, pulses)} ends after {abs(pulses_made)} when {switch} is asserted, behind it"
                    )


def _check_direction(trial: PromiseTrial, axis: int, pulses: int, rng: np.random.Generator) -> None:
    """Compare the direction that `find_selected_direction` finds in each drive command with that of the pulses."""
    codes = [
        code
        for c in trial.chip_class.MAP.commands
        if (c.starts or c.kind == "drive") and not c.together
        for code in c.codes
    ]
    acts, _ = draw_move(trial.make(), axis, rng, direction=1 if pulses > 0 else -1)
    last = [replace_command_code(trial.chip_class, acts[-1], code) for code in rng.permutation(codes)[:4].tolist()]
    for begin in [acts[-1], *(last if acts[-1].kind == "write" else [])]:
        chip, tried = trial.make(), [*acts[:-1], begin]
        perform_acts(chip, tried)
        directions = {direction for _, direction in _trace_axis_pulses(chip, axis, chip.clock_hz // 50)}
        answers = [trial.chip_class.find_selected_direction(act.a, act.b) for act in tried if act.kind == "write"]
        known = [minus for minus in answers if minus is not None]
        if known and len(directions) == 1 and known[-1] == (1 in directions):
            raise BrokenPromise(
                f"begun by a write of {begin.b:X}h to {begin.a:X}h, axis {axis} goes {_name_direction(not known[-1])}, and "
                f"`find_selected_direction` says {_name_direction(known[-1])}"
            )


def _name_direction(is_minus: bool) -> str:
    return "minus" if is_minus else "plus"


def _describe_move(trial: PromiseTrial, axis: int, pulses: int) -> str:
    of = f" of axis {axis}" if trial.chip_class.AXES > 1 else ""
    return f"the driver's move{of} by {pulses} pulses"


def draw_simultaneous_moves(trial: PromiseTrial, rng: np.random.Generator) -> list[Act]:
    """Draw the same move for all axes, started at one clock, followed by time; [] for a chip with one axis."""
    if trial.chip_class.AXES == 1:
        return []
    chip, seed, moves = trial.make(), int(rng.integers(1 << 30)), []
    for axis in range(trial.chip_class.AXES):
        acts, _ = draw_move(chip, axis, np.random.default_rng(seed), direction=1)
        moves += [act for act in acts if act.kind != "time"]
    return limit_pulses([Act("reset"), *moves, Act("time", chip.clock_hz // 20)], chip) if moves else []


def check_axis_independence(trial: PromiseTrial) -> None:
    """Check that whatever is written to one axis leaves the moves and the registers of the other axes unchanged."""
    if trial.chip_class.AXES == 1:
        return
    _check_registers(trial)
    for rng in trial.make_seeded_generators():
        for chip, axis, pulses in trial.start_moves(rng):
            chip.advance(max(chip.clock_hz // 1000, 1))
            clocks = count_clocks_to_end(chip, axis)
            for other in range(trial.chip_class.AXES):
                both = chip.make_replica()
                if other != axis and rng.integers(2):  # and the other drives, too
                    perform_acts(both, [act for act in draw_move(trial.make(), other, rng)[0] if act.kind == "write"])
                alone = _trace_axis_pulses(both, axis, clocks)
                writes = list(_list_axis_writes(trial, other, rng)) if other != axis else []
                for k in rng.permutation(len(writes))[:MAX_TRIED_ACTS].tolist():
                    what, acts = writes[k]
                    probe = both.make_replica()
                    perform_acts(probe, acts)
                    if _trace_axis_pulses(probe, axis, clocks) != alone:
                        raise BrokenPromise(
                            f"{what} of axis {other} changes the pulses of {_describe_move(trial, axis, pulses)}"
                        )


def _trace_axis_pulses(chip: Chip, axis: int, clocks: int) -> list[tuple[int, int]]:
    """Return the clock and the direction of each pulse of an axis in the next `clocks` clocks, from a copy of the chip."""
    pulses = chip.make_replica().trace(clocks)
    own = pulses[pulses["axis"] == axis]
    return list(zip(own["clock"].tolist(), own["direction"].tolist(), strict=True))


def _list_axis_registers(trial: PromiseTrial, axis: int) -> Iterator[tuple[str, int, list[Act]]]:
    """Yield for each register of an axis its name, a value, and the actions that write the value."""
    for r in trial.chip_class.MAP.registers:
        for value in r.range if "W" in r.access else ():
            cycles = [
                trial.chip_class.register_cycles(r.name, value & r.mask, k)
                for k in (axis, (axis + 1) % trial.chip_class.AXES)
            ]
            if cycles[0] != cycles[1]:
                yield r.name, value, [Act("write", *cycle) for cycle in cycles[0]]


def _list_axis_writes(trial: PromiseTrial, axis: int, rng: np.random.Generator) -> Iterator[tuple[str, list[Act]]]:
    """Yield what a host writes to one axis, with a description: registers, commands, the driver's stop, a move."""
    for name, value, acts in _list_axis_registers(trial, axis):
        yield f"a write of {value} to {name}", acts
    for c in trial.chip_class.MAP.commands:
        if not c.axes or c.kind == "interpolation" or c.together:
            continue
        try:
            cycles = trial.chip_class.command_cycles(
                c.symbol, axis, 1 if c.choice or (c.bytes and "read" not in c.kind) else None
            )
        except NotImplementedError:
            break
        yield f"command {c.symbol}", [Act("write", *cycle) for cycle in cycles]
    yield "the driver's stop", [act for act in list_stop_acts(trial.make(), axis) if act.kind == "write"]
    yield "a move by the driver", [act for act in draw_move(trial.make(), axis, rng)[0] if act.kind == "write"]


def _check_registers(trial: PromiseTrial) -> None:
    """Check that the same write gives the same register value on each axis and does not change the registers of other axes."""
    first_values: dict[tuple[str, int], int | None] = {}
    for axis in range(trial.chip_class.AXES):
        for name, value, acts in _list_axis_registers(trial, axis):
            chip = trial.make()
            others = [chip.axis_values(k).get(name) for k in range(trial.chip_class.AXES) if k != axis]
            perform_acts(chip, acts)
            now = chip.axis_values(axis).get(name)
            first = first_values.setdefault((name, value), now)
            if now != first:
                raise BrokenPromise(
                    f"{name} = {value} written to axis {axis} shows as {now} in axis_values({axis}), and written to axis 0 as "
                    f"{first} in axis_values(0)"
                )
            if others != [chip.axis_values(k).get(name) for k in range(trial.chip_class.AXES) if k != axis]:
                raise BrokenPromise(
                    f"{name} = {value} written to axis {axis} changes what axis_values gives for another axis"
                )
