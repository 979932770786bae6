"""Promises about moves: their counts and pins from start to end, limit switches, and the independence of axes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stage.chips import Chip
from stage.testing.chip_acts import (
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


def check_courses(t: PromiseTrial) -> None:
    """busy, net, counter and pins agree with the trace, from the start of a driver's move to its end"""
    for rng in t.seeded_generators():
        for chip, axis, pulses in t.start_moves(rng):
            _check_course(t, rng, chip, axis, pulses)


def _check_course(t: PromiseTrial, rng: np.random.Generator, chip: Chip, axis: int, pulses: int) -> None:
    left, direction = abs(pulses), 1 if pulses > 0 else -1
    _require_busy(chip, axis, left)
    clocks = count_clocks_to_end(chip, axis)
    at = find_pulse_clocks(chip, clocks)
    if len(at) != left:
        raise BrokenPromise(f"the driver's move of {pulses} pulses makes {len(at)} in {clocks} clocks")
    bits, count, net = t.kind.COUNTER[1], read_counter(chip, axis), chip.net(axis)
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


def _require_busy(chip: Chip, axis: int, left: int) -> None:
    """Raise BrokenPromise unless status and core show that the axis drives, with `left` pulses to come."""
    busy, core = chip.busy(axis), bool(chip.CORE.is_busy.with_gil(chip.pointer, axis))
    if busy and core:
        return
    text = f"{'its core' if busy else 'the status on its bus'} says at rest, and {left} pulses come"
    if not chip.input_word(axis):
        text += ", while no input is asserted"
    if chip.AXES > 1:
        driving = [k for k in range(chip.AXES) if chip.CORE.is_busy.with_gil(chip.pointer, k)]
        text = f"axis {axis} is to move: {text}; its core says that axes {driving} drive"
    raise BrokenPromise(text)


MAX_TRIED_ACTS = 12
"""Of the things that a host writes to an axis, so many are tried beside each move of another."""


def check_limit_switches(t: PromiseTrial) -> None:
    """limit switches: an end switch ends the driver's move that goes towards it, and no other; `turns` knows the direction"""
    for rng in t.seeded_generators():
        for chip, axis, pulses in t.start_moves(rng):
            _check_direction(t, axis, pulses, rng)
            free = chip.make_replica()
            free.advance(count_clocks_to_end(free, axis))
            if free.net(axis) - chip.net(axis) != pulses:
                continue  # `check_courses` tells
            for switch, direction in (("el_plus", 1), ("el_minus", -1)):
                bit = t.kind.wired(switch)
                if not bit:
                    continue
                probe = chip.make_replica()
                probe.set_input_word(axis, probe.input_word(axis) | bit)
                probe.advance(count_clocks_to_end(probe, axis))
                pulses_made, towards = probe.net(axis) - chip.net(axis), pulses * direction > 0
                if towards and (probe.busy(axis) or pulses_made == pulses):
                    raise BrokenPromise(
                        f"{_name_move(t, axis, pulses)} goes on to its end, though {switch} is asserted at its start"
                    )
                if not towards and pulses_made != pulses:
                    raise BrokenPromise(
                        f"{_name_move(t, axis, pulses)} ends after {abs(pulses_made)} when {switch} is asserted, behind it"
                    )


def _check_direction(t: PromiseTrial, axis: int, pulses: int, rng: np.random.Generator) -> None:
    """Compare the direction that `turns` gives for a driver's writes, and for other drive commands, with that of the pulses."""
    codes = [
        code for c in t.kind.MAP.commands if (c.starts or c.kind == "drive") and not c.together for code in c.codes
    ]
    acts, _ = draw_move(t.make(), axis, rng, direction=1 if pulses > 0 else -1)
    last = [replace_command_code(t.kind, acts[-1], code) for code in rng.permutation(codes)[:4].tolist()]
    for begin in [acts[-1], *(last if acts[-1].kind == "write" else [])]:
        chip, tried = t.make(), [*acts[:-1], begin]
        perform_acts(chip, tried)
        directions = {direction for _, direction in _trace_pulses(chip, axis, chip.clock_hz // 50)}
        answers = [t.kind.read_direction(act.a, act.b) for act in tried if act.kind == "write"]
        known = [minus for minus in answers if minus is not None]
        if known and len(directions) == 1 and known[-1] == (1 in directions):
            raise BrokenPromise(
                f"begun by a write of {begin.b:X}h to {begin.a:X}h, axis {axis} goes {_name_sign(not known[-1])}, and `turns` says "
                f"{_name_sign(known[-1])}"
            )


def _name_sign(minus: bool) -> str:
    return "minus" if minus else "plus"


def _name_move(t: PromiseTrial, axis: int, pulses: int) -> str:
    of = f" of axis {axis}" if t.kind.AXES > 1 else ""
    return f"the driver's move{of} by {pulses} pulses"


def draw_simultaneous_moves(t: PromiseTrial, rng: np.random.Generator) -> list[Act]:
    """Draw the same move for all axes, started at one clock, and time: their pulses come at the same clocks. [] for one axis."""
    if t.kind.AXES == 1:
        return []
    chip, seed, moves = t.make(), int(rng.integers(1 << 30)), []
    for axis in range(t.kind.AXES):
        acts, _ = draw_move(chip, axis, np.random.default_rng(seed), direction=1)
        moves += [act for act in acts if act.kind != "time"]
    return limit_pulses([Act("reset"), *moves, Act("time", chip.clock_hz // 20)], chip) if moves else []


def check_axes_alone(t: PromiseTrial) -> None:
    """axes: what is for one axis leaves the moves and the registers of the others alone"""
    if t.kind.AXES == 1:
        return
    _check_registers(t)
    for rng in t.seeded_generators():
        for chip, axis, pulses in t.start_moves(rng):
            chip.advance(max(chip.clock_hz // 1000, 1))
            clocks = count_clocks_to_end(chip, axis)
            for other in range(t.kind.AXES):
                both = chip.make_replica()
                if other != axis and rng.integers(2):  # and the other drives, too
                    perform_acts(both, [act for act in draw_move(t.make(), other, rng)[0] if act.kind == "write"])
                alone = _trace_pulses(both, axis, clocks)
                writes = list(_list_axis_writes(t, other, rng)) if other != axis else []
                for k in rng.permutation(len(writes))[:MAX_TRIED_ACTS].tolist():
                    what, acts = writes[k]
                    probe = both.make_replica()
                    perform_acts(probe, acts)
                    if _trace_pulses(probe, axis, clocks) != alone:
                        raise BrokenPromise(
                            f"{what} of axis {other} changes the pulses of {_name_move(t, axis, pulses)}"
                        )


def _trace_pulses(chip: Chip, axis: int, clocks: int) -> list[tuple[int, int]]:
    """Clock and direction of each pulse of an axis in the time to come, on a copy."""
    pulses = chip.make_replica().trace(clocks)
    own = pulses[pulses["axis"] == axis]
    return list(zip(own["clock"].tolist(), own["direction"].tolist(), strict=True))


def _list_axis_registers(t: PromiseTrial, axis: int) -> Iterator[tuple[str, int, list[Act]]]:
    """Yield the registers that each axis has: name, value, and the writes to this axis."""
    for r in t.kind.MAP.registers:
        for value in r.range if "W" in r.access else ():
            cycles = [t.kind.register_cycles(r.name, value & r.mask, k) for k in (axis, (axis + 1) % t.kind.AXES)]
            if cycles[0] != cycles[1]:
                yield r.name, value, [Act("write", *cycle) for cycle in cycles[0]]


def _list_axis_writes(t: PromiseTrial, axis: int, rng: np.random.Generator) -> Iterator[tuple[str, list[Act]]]:
    """Yield what a host writes to one axis, with a description: registers, commands for axes, the driver's stop and a move."""
    for name, value, acts in _list_axis_registers(t, axis):
        yield f"a write of {value} to {name}", acts
    for c in t.kind.MAP.commands:
        if not c.axes or c.kind == "interpolation" or c.together:
            continue
        try:
            cycles = t.kind.command_cycles(
                c.symbol, axis, 1 if c.choice or (c.bytes and "read" not in c.kind) else None
            )
        except NotImplementedError:
            break
        yield f"command {c.symbol}", [Act("write", *cycle) for cycle in cycles]
    yield "the driver's stop", [act for act in list_stop_acts(t.make(), axis) if act.kind == "write"]
    yield "a move by the driver", [act for act in draw_move(t.make(), axis, rng)[0] if act.kind == "write"]


def _check_registers(t: PromiseTrial) -> None:
    """Check that a register shows the same value after the same write on each axis, and that the other axes show what they did."""
    first_values: dict[tuple[str, int], int | None] = {}
    for axis in range(t.kind.AXES):
        for name, value, acts in _list_axis_registers(t, axis):
            chip = t.make()
            others = [chip.values_of(k).get(name) for k in range(t.kind.AXES) if k != axis]
            perform_acts(chip, acts)
            now = chip.values_of(axis).get(name)
            first = first_values.setdefault((name, value), now)
            if now != first:
                raise BrokenPromise(
                    f"{name} = {value} written to axis {axis} shows as {now} in values_of({axis}), and written to axis 0 as "
                    f"{first} in values_of(0)"
                )
            if others != [chip.values_of(k).get(name) for k in range(t.kind.AXES) if k != axis]:
                raise BrokenPromise(
                    f"{name} = {value} written to axis {axis} changes what values_of gives for another axis"
                )
