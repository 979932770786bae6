"""Promises about switches and axes: which move a limit switch ends, and that an axis is left alone by what is for another."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stage.chips import Chip
from stage.testing.hands import Act, do_all, driven, ended, harmless, stop, with_code
from stage.testing.trial import Broken, Trial

SOME = 12
"""Of the things that a host writes to an axis, so many are tried beside each move of another."""


def limit_switches(t: Trial) -> None:
    """limit switches: an end switch ends the driver's move that goes towards it, and no other; `turns` knows the direction"""
    for rng in t.draws():
        for chip, axis, pulses in t.moves(rng):
            _direction(t, axis, pulses, rng)
            free = chip.twin()
            free.advance(ended(free, axis))
            if free.net(axis) - chip.net(axis) != pulses:
                continue  # `courses` tells
            for switch, way in (("el_plus", 1), ("el_minus", -1)):
                bit = t.kind.wired(switch)
                if not bit:
                    continue
                twin = chip.twin()
                twin.set_input_word(axis, twin.input_word(axis) | bit)
                twin.advance(ended(twin, axis))
                made, towards = twin.net(axis) - chip.net(axis), pulses * way > 0
                if towards and (twin.busy(axis) or made == pulses):
                    raise Broken(
                        f"{_move(t, axis, pulses)} goes on to its end, though {switch} is asserted at its start"
                    )
                if not towards and made != pulses:
                    raise Broken(
                        f"{_move(t, axis, pulses)} ends after {abs(made)} when {switch} is asserted, behind it"
                    )


def _direction(t: Trial, axis: int, pulses: int, rng: np.random.Generator) -> None:
    """What `turns` says of a driver's writes, and of the same with another drive command, is how the pulses go."""
    codes = [
        code for c in t.kind.MAP.commands if (c.starts or c.kind == "drive") and not c.together for code in c.codes
    ]
    acts, _ = driven(t.make(), axis, rng, way=1 if pulses > 0 else -1)
    last = [with_code(t.kind, acts[-1], code) for code in rng.permutation(codes)[:4].tolist()]
    for begin in [acts[-1], *(last if acts[-1].kind == "write" else [])]:
        chip, tried = t.make(), [*acts[:-1], begin]
        do_all(chip, tried)
        ways = {way for _, way in _pulses(chip, axis, chip.clock_hz // 50)}
        said = [t.kind.turns(act.a, act.b) for act in tried if act.kind == "write"]
        known = [minus for minus in said if minus is not None]
        if known and len(ways) == 1 and known[-1] == (1 in ways):
            raise Broken(
                f"begun by a write of {begin.b:X}h to {begin.a:X}h, axis {axis} goes {_sign(not known[-1])}, and `turns` says "
                f"{_sign(known[-1])}"
            )


def _sign(minus: bool) -> str:
    return "minus" if minus else "plus"


def _move(t: Trial, axis: int, pulses: int) -> str:
    of = f" of axis {axis}" if t.kind.AXES > 1 else ""
    return f"the driver's move{of} by {pulses} pulses"


def together(t: Trial, rng: np.random.Generator) -> list[Act]:
    """The same move on all axes, begun at one clock, and time: their pulses come at the same clocks. [] of one axis."""
    if t.kind.AXES == 1:
        return []
    chip, seed, found = t.make(), int(rng.integers(1 << 30)), []
    for axis in range(t.kind.AXES):
        acts, _ = driven(chip, axis, np.random.default_rng(seed), way=1)
        found += [act for act in acts if act.kind != "time"]
    return harmless([Act("reset"), *found, Act("time", chip.clock_hz // 20)], chip) if found else []


def axes_alone(t: Trial) -> None:
    """axes: what is for one axis leaves the moves and the registers of the others alone"""
    if t.kind.AXES == 1:
        return
    _registers(t)
    for rng in t.draws():
        for chip, axis, pulses in t.moves(rng):
            chip.advance(max(chip.clock_hz // 1000, 1))
            clocks = ended(chip, axis)
            for other in range(t.kind.AXES):
                both = chip.twin()
                if other != axis and rng.integers(2):  # and the other drives, too
                    do_all(both, [act for act in driven(t.make(), other, rng)[0] if act.kind == "write"])
                alone = _pulses(both, axis, clocks)
                tries = list(_for(t, other, rng)) if other != axis else []
                for k in rng.permutation(len(tries))[:SOME].tolist():
                    what, acts = tries[k]
                    twin = both.twin()
                    do_all(twin, acts)
                    if _pulses(twin, axis, clocks) != alone:
                        raise Broken(f"{what} of axis {other} changes the pulses of {_move(t, axis, pulses)}")


def _pulses(chip: Chip, axis: int, clocks: int) -> list[tuple[int, int]]:
    """Clock and direction of each pulse of an axis in the time to come, on a copy."""
    pulses = chip.twin().trace(clocks)
    mine = pulses[pulses["axis"] == axis]
    return list(zip(mine["clock"].tolist(), mine["direction"].tolist(), strict=True))


def _own_registers(t: Trial, axis: int) -> Iterator[tuple[str, int, list[Act]]]:
    """Registers that each axis has: name, value, and the writes to the axis."""
    for r in t.kind.MAP.registers:
        for value in r.range if "W" in r.access else ():
            cycles = [t.kind.register_cycles(r.name, value & r.mask, k) for k in (axis, (axis + 1) % t.kind.AXES)]
            if cycles[0] != cycles[1]:
                yield r.name, value, [Act("write", *cycle) for cycle in cycles[0]]


def _for(t: Trial, axis: int, rng: np.random.Generator) -> Iterator[tuple[str, list[Act]]]:
    """What a host writes to one axis, by name: registers, commands that go to axes, the driver's stop and a move."""
    for name, value, acts in _own_registers(t, axis):
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
    yield "the driver's stop", [act for act in stop(t.make(), axis) if act.kind == "write"]
    yield "a move by the driver", [act for act in driven(t.make(), axis, rng)[0] if act.kind == "write"]


def _registers(t: Trial) -> None:
    """Axes are alike: what a register shows after a write is the same for each; and the other axes show what they did."""
    shown: dict[tuple[str, int], int | None] = {}
    for axis in range(t.kind.AXES):
        for name, value, acts in _own_registers(t, axis):
            chip = t.make()
            others = [chip.values_of(k).get(name) for k in range(t.kind.AXES) if k != axis]
            do_all(chip, acts)
            now = chip.values_of(axis).get(name)
            first = shown.setdefault((name, value), now)
            if now != first:
                raise Broken(
                    f"{name} = {value} written to axis {axis} shows as {now} in values_of({axis}), and written to axis 0 as "
                    f"{first} in values_of(0)"
                )
            if others != [chip.values_of(k).get(name) for k in range(t.kind.AXES) if k != axis]:
                raise Broken(f"{name} = {value} written to axis {axis} changes what values_of gives for another axis")
