"""The promises that every chip keeps, one function each: it raises `Broken` where a chip breaks it. See conformance.py.

A promise is tried with random acts (hands.py) and with moves as the chip's own driver writes them.
"""

from __future__ import annotations

import copy
import pickle
import traceback
from collections.abc import Callable
from typing import Any

import numpy as np

from stage.chips import Chip, Diagnostic, contract, cores
from stage.chips.describe import LONGEST, decode
from stage.chips.journal import Replay
from stage.chips.register_map import Command, Word
from stage.errors import ArgumentError, StageError
from stage.testing.axes import axes_alone, limit_switches, together
from stage.testing.hands import (
    copy_of,
    do,
    do_all,
    ended,
    fields_that_differ,
    harmless,
    pulse_clocks,
    room_for,
)
from stage.testing.trial import Broken, Trial


def has_what_every_chip_has(t: Trial) -> None:
    """the contract: class, core and records have all that loops, boards and recordings ask of them"""
    try:
        contract.check(t.kind, Chip)
    except ArgumentError as error:
        raise Broken(str(error)) from None
    axis, bits = t.kind.IRQ
    known = sum(t.kind.OUTPUTS.values())
    if bits & ~known or not -1 <= axis < t.kind.AXES:
        raise Broken(
            f"IRQ is ({axis}, {bits:#x}): an axis from 0 to {t.kind.AXES - 1}, or -1, and bits of OUTPUTS, which are {known:#x}"
        )


def bus_lines(t: Trial) -> None:
    """masks: only the address and data lines that the chip has matter, of writes and of reads"""
    for rng in t.draws():
        near, far = t.make(), t.make()
        for _ in range(60):
            address = int(rng.integers(near.ADDRESS_MASK, endpoint=True))
            value = int(rng.integers(near.DATA_MASK, endpoint=True)) >> int(rng.integers(0, 12))
            beyond = address + (near.ADDRESS_MASK + 1) * int(rng.integers(0, 3))
            near.write(address, value)
            far.write(beyond, value + (near.DATA_MASK + 1) * int(rng.integers(0, 3)))
            if (read := near.read(address)) != (other := far.read(beyond)):
                raise Broken(f"address {beyond:X}h reads {other:X}h, and {address:X}h, which it acts as, {read:X}h")
            if not 0 <= read <= near.DATA_MASK:
                raise Broken(
                    f"a read of address {address:X}h gives {read}, and the data lines hold 0 to {near.DATA_MASK:X}h"
                )
            t.same(near, far, f"after a write of {value:X}h to {address:X}h and as {beyond:X}h beyond the lines")


def pins_by_name(t: Trial) -> None:
    """pins: an input can be set, alone and by name; an output refuses; a name that is none is refused"""
    chip = t.make()
    for axis in chip.axes:
        pins = axis.pins
        if unknown := set(dir(pins)) ^ {*chip.INPUTS, *chip.OUTPUTS}:
            raise Broken(f"pins {', '.join(sorted(unknown))} are listed by dir() or by INPUTS and OUTPUTS, not by both")
        for name in chip.INPUTS:
            before = {n: getattr(pins, n) for n in chip.INPUTS}
            for level in (not before[name], before[name]):
                others = [chip.input_word(k) for k in range(chip.AXES) if k != axis.index]
                setattr(pins, name, level)
                if others != [chip.input_word(k) for k in range(chip.AXES) if k != axis.index]:
                    raise Broken(f"input {name} of axis {axis.index} set to {level} changes inputs of another axis")
                now = {n: getattr(pins, n) for n in chip.INPUTS}
                wrong = [n for n in now if now[n] != (level if n == name else before[n])]
                if wrong:
                    raise Broken(f"input {name} set to {level} leaves input {wrong[0]} at {now[wrong[0]]}")
        for name in [*chip.OUTPUTS, "no_such_pin"]:
            try:
                setattr(pins, name, True)
            except (StageError, AttributeError):
                continue
            raise Broken(f"pin {name}, no input, can be set")


def time_that_passes(t: Trial) -> None:
    """clock: `advance(n)` takes n reference clocks, a bus cycle of a chip without a stage none"""
    for rng in t.draws():
        chip = t.make()
        for act in t.program(rng):
            before = chip.clock
            do(chip, act)
            expected = before + (act.a if act.kind == "time" else 0)
            if chip.clock != expected:
                raise Broken(f"after {act} the clock is {chip.clock}, not {expected}")


def traced(t: Trial) -> None:
    """trace = advance: as many pulses, in order, within the time, by axis and direction as `net` counts; the same state"""
    for rng in t.draws():
        one, other = t.make(), t.make()
        acts = t.program(rng)
        used = t.make()
        do_all(used, acts)
        for act in [*acts, *t.drives(used, rng), *together(t, rng)]:
            if act.kind != "time":
                do(one, act)
                do(other, act)
                continue
            begin, nets = one.clock, [one.net(k) for k in range(one.AXES)]
            try:
                room_for(one, act.a)
            except StageError as error:
                raise Broken(str(error)) from None
            made = one.advance(act.a)
            out = np.zeros(made + 64, other.CORE.PULSE)
            listed = int(other.CORE.trace(copy_of(other), other.clock + act.a, out))
            if listed != made:
                raise Broken(f"advance({act.a}) says {made} pulses, and trace lists {listed}")
            pulses = other.trace(act.a)
            clocks, axes, ways = (pulses[name].astype(np.int64) for name in ("clock", "axis", "direction"))
            if (np.diff(clocks) < 0).any() or (made and not (begin < clocks[0] and clocks[-1] <= one.clock)):
                raise Broken(f"the pulses of clocks {begin} to {one.clock} are at {_some(clocks)}")
            if ((axes < 0) | (axes >= one.AXES) | (abs(ways) != 1)).any():
                raise Broken(f"trace gives axes {sorted(set(axes))} and directions {sorted(set(ways))}")
            t.same(one, other, f"after advance({act.a}) and trace({act.a})")
            for k in range(one.AXES if not t.kind.SERVO else 0):
                if one.net(k) - nets[k] != int(ways[axes == k].sum()):
                    raise Broken(
                        f"net of axis {k} goes from {nets[k]} to {one.net(k)}, and the trace lists "
                        f"{int((ways[axes == k] > 0).sum())} pulses plus and {int((ways[axes == k] < 0).sum())} minus"
                    )


def cut_time(t: Trial) -> None:
    """cutting of time: advance(a + b) is advance(a) and advance(b), wherever it is cut, also at the very clock of an event"""
    for rng in t.draws():
        chip, axis, pulses = t.moving(rng)
        if pulses or t.kind.SERVO:
            clocks = min(ended(chip, axis), chip.clock_hz // 2)
            _cut(t, chip, clocks, _instants(chip, axis, clocks, rng))
        chip = t.make()
        for act in t.program(rng):
            if act.kind == "time" and act.a > 1:
                at = pulse_clocks(chip, act.a)
                some = [int(at[rng.integers(len(at))])] if len(at) else []
                _cut(t, chip, act.a, [*some, int(rng.integers(1, act.a))])
            do(chip, act)


def _instants(chip: Chip, axis: int, clocks: int, rng: np.random.Generator) -> list[int]:
    """Clocks at which something happens in a course, and those beside them."""
    twin = chip.twin()
    with_edges = twin.journal(axis)
    twin.advance(clocks)
    edges = with_edges.course().edges["clock"] - chip.clock
    known = np.unique(np.concatenate([edges, pulse_clocks(chip, clocks)[:200]]))
    known = known[(known > 1) & (known < clocks - 1)]
    some = rng.choice(known, min(len(known), 6), replace=False) if len(known) else known
    return [int(n) + d for n in some for d in (-1, 0, 1)]


def _cut(t: Trial, chip: Chip, clocks: int, cuts: list[int]) -> None:
    whole = chip.twin()
    made = whole.advance(clocks)
    for n in cuts:
        if not 0 < n < clocks:
            continue
        cut = chip.twin()
        if (parts := cut.advance(n) + cut.advance(clocks - n)) != made:
            raise Broken(f"advance({clocks}) makes {made} pulses, and advance({n}), advance({clocks - n}) {parts}")
        t.same(whole, cut, f"after advance({clocks}), and after advance({n}) and advance({clocks - n})")


def windows(t: Trial) -> None:
    """run, window and advance agree: a stage's loop takes a chip where `advance` does, with each slice's mean and net"""
    for rng in t.draws():
        chip = t.make()
        do_all(chip, t.drives(chip, rng))
        _windows(t, chip, 5, int(rng.integers(1, max(chip.clock_hz // 5000, 2))))
        at = pulse_clocks(chip, chip.clock_hz // 50)
        later = rng.choice(at[4:40], min(len(at[4:40]), 4), replace=False)
        for n in (*at[:4].tolist(), *later.tolist()):  # a slice that ends at the very clock of a pulse, and beside it
            _windows(t, chip, 1, n)
            _windows(t, chip, 1, max(n + int(rng.choice((-1, 1))), 1))


def _windows(t: Trial, chip: Chip, slices: int, ticks: int) -> None:
    core = chip.CORE
    by_run, by_window, by_advance = chip.twin(), chip.twin(), chip.twin()
    nets = np.array([core.net.held(chip.pointer, k) for k in range(chip.AXES)])
    clocks = chip.clock + ticks * np.arange(1, slices + 1)
    said, counts = np.zeros((chip.AXES, slices)), nets.copy()
    row, table = np.zeros(1, cores.CHIP), np.zeros(chip.AXES, cores.CHIP_AXIS)
    cores.fill(row[0], core, by_window.pointer)
    row["axes"], row["slices"], row["ticks"] = chip.AXES, slices, ticks
    row["clocks"], row["table"], row["hz"] = clocks.ctypes.data, table.ctypes.data, chip.clock_hz
    for k in range(chip.AXES):
        table[k]["axis"], table[k]["means"], table[k]["net"] = k, said[k].ctypes.data, counts[k:].ctypes.data
    core.window.c(by_window.pointer, row.ctypes.data, 0)
    expected = np.zeros_like(said)
    for k, until in enumerate(clocks.tolist()):
        core.run.c(by_run.pointer, until)
        for j in range(chip.AXES):
            expected[j, k] = core.drive_input.c(by_run.pointer, j, int(nets[j]), float(ticks))
            nets[j] = core.net.held(by_run.pointer, j)
    by_advance.advance(slices * ticks)
    t.same(by_run, by_advance, f"after run and advance by {slices * ticks} clocks")
    t.same(by_run, by_window, f"after run and window by {slices} slices of {ticks} clocks")
    if counts.tolist() != nets.tolist():
        raise Broken(f"window leaves the counts {counts.tolist()}, and net is {nets.tolist()}")
    if said.tobytes() != expected.tobytes():
        raise Broken(f"window gives the means {said.tolist()}, and drive_input {expected.tolist()}")


def drive_inputs(t: Trial) -> None:
    """drive_input: the mean of the pulse count over the clocks of a slice; of a servo its motor command. pulse_rate"""
    for rng in t.draws():
        chip, axis, pulses = t.moving(rng, slow=True)
        if not pulses and not t.kind.SERVO:
            return
        chip.advance(int(rng.integers(1, max(chip.clock_hz // 100, 2))))
        for _ in range(12):
            ticks = int(rng.integers(1, max(chip.clock_hz // 1000, 2)))
            start, before, going = chip.clock, chip.net(axis), chip.busy(axis)
            made = chip.trace(ticks)
            found = float(chip.CORE.drive_input.c(chip.pointer, axis, before, float(ticks)))
            if t.kind.SERVO:
                if not -1 <= found <= 1:
                    raise Broken(f"drive_input is {found}, and a motor command is -1 to 1")
                continue
            own = made[made["axis"] == axis]
            steps = np.concatenate([[0], np.cumsum(own["direction"], dtype=np.int64)])
            weights = np.diff(np.concatenate([[start], own["clock"] - 1, [start + ticks]]))
            mean, n = before + float((steps * weights).sum()) / ticks, len(own)
            low, high = sorted((before, chip.net(axis)))
            if not low - 1e-9 <= found <= high + 1e-9:
                raise Broken(f"drive_input is {found:.3f}, and the count goes from {before} to {chip.net(axis)}")
            rate = abs(float(chip.CORE.pulse_rate.c(chip.pointer, axis, float(chip.clock_hz))))
            if going and chip.busy(axis) and abs(rate * ticks / chip.clock_hz - n) > 1.1 + 0.1 * n:
                raise Broken(f"pulse_rate is {rate:.1f} a second, and {n} pulses came in {ticks} clocks")
            if going and chip.busy(axis) and abs(found - mean) > 0.55 + 0.1 * n:
                raise Broken(
                    f"drive_input is {found:.3f}, and the mean of the {n} pulses of {ticks} clocks is {mean:.3f}"
                )


def courses(t: Trial) -> None:
    """busy, net, counter and pins agree with the trace, from the start of a driver's move to its end"""
    for rng in t.draws():
        for chip, axis, pulses in t.moves(rng):
            _course(t, rng, chip, axis, pulses)


def _course(t: Trial, rng: np.random.Generator, chip: Chip, axis: int, pulses: int) -> None:
    left, way = abs(pulses), 1 if pulses > 0 else -1
    _at_work(chip, axis, left)
    clocks = ended(chip, axis)
    at = pulse_clocks(chip, clocks)
    if len(at) != left:
        raise Broken(f"the driver's move of {pulses} pulses makes {len(at)} in {clocks} clocks")
    bits, count, net = t.kind.COUNTER[1], _counter(chip, axis), chip.net(axis)
    for n in sorted({0, *(int(k) for k in rng.integers(0, at[-1], 6)), int(at[-1]) - 1}):
        probe = chip.twin()
        probe.advance(n)
        made = int((at <= n).sum())
        if probe.net(axis) - net != way * made:
            raise Broken(
                f"the driver's move of {pulses} pulses: net has gone by {probe.net(axis) - net} when the trace lists {made}"
            )
        busy, core = probe.busy(axis), bool(probe.CORE.busy.held(probe.pointer, axis))
        if not busy or not core:
            raise Broken(_at_rest(chip, axis, busy, left - made))
        gone = (_counter(probe, axis) - count) % (1 << bits)
        if gone not in (made, -made % (1 << bits)):
            raise Broken(f"counter has gone by {gone} when the trace lists {made} pulses")
    rest = chip.twin()
    rest.advance(clocks + chip.clock_hz)
    if rest.busy(axis) or rest.CORE.busy.held(rest.pointer, axis):
        raise Broken("it says that it drives a second after the end of a move")


def _at_work(chip: Chip, axis: int, left: int) -> None:
    busy, core = chip.busy(axis), bool(chip.CORE.busy.held(chip.pointer, axis))
    if not busy or not core:
        raise Broken(_at_rest(chip, axis, busy, left))


def _at_rest(chip: Chip, axis: int, busy: bool, left: int) -> str:
    told = f"{'its core' if busy else 'the status on its bus'} says at rest, and {left} pulses come"
    if not chip.input_word(axis):
        told += ", while no input is asserted"
    if chip.AXES == 1:
        return told
    driving = [k for k in range(chip.AXES) if chip.CORE.busy.held(chip.pointer, k)]
    return f"axis {axis} is to move: {told}; its core says that axes {driving} drive"


def _counter(chip: Chip, axis: int) -> int:
    return int(chip.CORE.counter.held(chip.pointer, axis))


def snapshots(t: Trial) -> None:
    """snapshots: all state is in them, they go on bit for bit, in a new chip, too, and are refused by another kind"""
    for rng in t.draws():
        first, then = t.program(rng), None
        chip = t.make()
        own = _beside_the_record(chip)
        do_all(chip, first)
        for name, value in _beside_the_record(chip).items():
            if own.get(name) != value:
                raise Broken(
                    f"bus cycles, pins or time change its attribute {name!r} to {value}: a snapshot does not have it. State is "
                    "in the record"
                )
        kept, bits, noted = chip.snapshot(), chip.state.tobytes(), list(chip.diagnostics)
        then = harmless(t.wild(rng, 25), chip.twin())
        said, ended_at = do_all(chip, then), chip.state.tobytes()
        shown = _shown(chip)
        chip.restore(kept)
        t.same_bits(bits, chip.state.tobytes(), "after a snapshot is restored")
        if chip.diagnostics != noted:
            raise Broken("a restored snapshot does not bring back its diagnostics")
        fresh = t.make()
        fresh.restore(kept)
        others = {"restored": chip, "restored into a new chip": fresh, "pickled": pickle.loads(pickle.dumps(fresh)),
                  "copied": copy.deepcopy(fresh)}  # fmt: skip
        for how, other in others.items():
            t.same_bits(bits, other.state.tobytes(), how)
            if (now := do_all(other, then)) != said:
                k = next(k for k in range(len(said)) if now[k] != said[k])
                raise Broken(f"{how}, it answers {then[k]} with {now[k]}, and the chip of the snapshot with {said[k]}")
            t.same_bits(ended_at, other.state.tobytes(), f"{how}, after {len(then)} acts")
            if (looks := _shown(other)) != shown:
                raise Broken(f"{how}, after {len(then)} acts it shows {looks}, and the chip of the snapshot {shown}")
    _every_bit_kept(t)
    _refusals(t, t.make())


def _beside_the_record(chip: Chip) -> dict[str, str]:
    """What its class keeps in the object, as text: numbers, words, lists and arrays of them."""
    plain = (int, float, str, bytes, list, tuple, dict, set, np.ndarray, np.generic, type(None))
    known = {"header", "_diagnostics", "_alone", "_bus", "_here", "_i", "_plain", "_rows"}
    return {n: repr(v) for n, v in vars(chip).items() if n not in known and isinstance(v, plain)}


def _every_bit_kept(t: Trial) -> None:
    for value in ("least", "most"):
        chip, fresh = t.make(), t.make()
        for r in t.kind.MAP.registers:
            for axis in range(t.kind.AXES if "W" in r.access else 0):
                for cycle in t.kind.register_cycles(r.name, r.range[value == "most"] & r.mask, axis):
                    chip.write(*cycle)
        fresh.restore(chip.snapshot())
        t.same(chip, fresh, f"with the {value} in every register, restored into a new chip")
        if (mine := _shown(fresh)) != (its := _shown(chip)):
            raise Broken(
                f"with the {value} in every register, restored into a new chip, it shows {_different(mine, its, 'before')}"
            )


def _shown(chip: Chip) -> Any:
    return (
        chip.values() | {f"{n} of axis {k}": v for k in range(1, chip.AXES) for n, v in chip.values_of(k).items()},
        [chip.output_word(k) for k in range(chip.AXES)],
        [chip.input_word(k) for k in range(chip.AXES)],
    )


def _refusals(t: Trial, chip: Chip) -> None:
    options = chip.options() | {"clock_hz": max(chip.clock_hz // 2, 1)}
    other = type("Other", (t.kind,), {})
    before = chip.state.tobytes()
    damaged = bytearray(chip.snapshot().record)
    damaged[0] ^= 1
    for what, foreign in (
        ("at another clock", t.kind(**options).snapshot()),
        ("of another class", other(**chip.options()).snapshot()),
        ("that is damaged", type(chip.snapshot())(chip.header, bytes(damaged), (), chip.snapshot().checksum)),
    ):
        try:
            chip.restore(foreign)
        except ArgumentError:
            t.same_bits(before, chip.state.tobytes(), f"after a snapshot {what} was refused")
            continue
        raise Broken(f"a snapshot {what} is restored without a word")


def journals(t: Trial) -> None:
    """journals: a replay ends in the same state, and its course shows every pin and count at its clock"""
    for rng in t.draws():
        chip, axis = t.make(), int(rng.integers(t.kind.AXES))
        noted = chip.journal(axis)
        do_all(chip, t.program(rng))
        noted.close()
        for every in (False, True):
            replay = Replay(noted)
            pieces = list(replay.pieces(every))
            chip.output_word(axis)  # some settle their pins when somebody looks
            if every:  # some keep in their state how long a pulse is shown
                _goes_on_alike(t, chip, replay.state, rng)
            else:
                _settled_alike(t, chip, replay.state, "after a replay")
            edges = np.concatenate(pieces)
            if (np.diff(edges["clock"]) < 0).any() or edges["clock"][-1] != chip.clock:
                raise Broken(f"the course's edges are at {_some(edges['clock'])}, and the chip at {chip.clock}")
            decode(chip.decoder(axis), noted.entries)
        _pins_of_a_course(t, rng)
        _no_more_than_there_is_room(t, rng)


def _no_more_than_there_is_room(t: Trial, rng: np.random.Generator) -> None:
    """`scan` gets arrays of a few edges, and what lies behind them is not its own."""
    chip, axis, _ = t.moving(rng)
    until, room, edges = (
        chip.clock + chip.clock_hz // 20,
        cores.SCAN_ROOM,
        np.zeros(2 * cores.SCAN_ROOM, chip.CORE.EDGE),
    )
    state = copy_of(chip)
    edges.view(np.uint8)[:] = 0xA5
    behind = edges[room:].tobytes()
    for _ in range(200):
        made = int(chip.CORE.scan(state, until, 1, axis, edges[:room]))
        if edges[room:].tobytes() != behind or made > room:
            raise Broken(
                f"scan gives {made} edges, and writes behind `out`, which holds {room}: stop before it is full"
            )
        if int(state["clock"][0]) >= until:
            break


def _settled_alike(t: Trial, chip: Chip, state: bytes, when: str) -> None:
    other = chip.twin(state)
    for k in range(chip.AXES):
        other.output_word(k)
        chip.output_word(k)
    t.same(chip, other, when)


def _goes_on_alike(t: Trial, chip: Chip, state: bytes, rng: np.random.Generator) -> None:
    one, other = chip.twin(), chip.twin(state)
    acts = harmless(t.wild(rng, 10), chip.twin())
    if do_all(one, acts) != do_all(other, acts) or _shown(one) != _shown(other):
        raise Broken("after a replay with every pulse it does not go on as the chip does")


def _pins_of_a_course(t: Trial, rng: np.random.Generator) -> None:
    chip, axis, _ = t.moving(rng)
    clocks, start = min(ended(chip, axis), chip.clock_hz // 4), chip.clock
    twin = chip.twin()
    noted = twin.journal(axis)
    twin.advance(clocks)
    fine, coarse = (noted.course(every).edges for every in (True, False))
    at = pulse_clocks(chip, clocks)
    likely = at[rng.integers(len(at), size=3)] if len(at) else at
    for n in sorted({clocks, *(int(k) for k in (*rng.integers(0, clocks, 4), *likely, *at[-1:]))}):
        probe = chip.twin()
        probe.advance(n)
        edge, other = (e[np.searchsorted(e["clock"], start + n, side="right") - 1] for e in (fine, coarse))
        word = probe.output_word(axis)
        wrong = (int(other["outputs"]) ^ word) & ~_toggling(
            fine["outputs"], len(at) // 2
        )  # pulse outputs: only if all are asked for
        wrong |= (int(edge["outputs"]) ^ word) & (int(other["outputs"]) ^ word)
        if wrong:
            pins = ", ".join(name for name, bit in t.kind.OUTPUTS.items() if bit & wrong)
            raise Broken(f"{n} clocks after the start the course shows output {pins} at another level than the chip")
        for what, course, real in (
            ("net", int(edge["net"]), int(probe.CORE.net.held(probe.pointer, axis))),
            ("counter", int(edge["counter"]), _counter(probe, axis)),
        ):
            if course != real and not t.kind.SERVO:
                raise Broken(f"{n} clocks after the start the course shows {what} {course}, and the chip {real}")


def _toggling(outputs: np.ndarray, times: int) -> int:
    """The bits that change at least so many times."""
    changes = outputs[1:] ^ outputs[:-1]
    return sum(1 << k for k in range(63) if int((changes >> k & 1).sum()) >= max(times, 1))


def resets(t: Trial) -> None:
    """reset: registers and modes are as after power-up; the clock, the inputs, the count and what was noted stay"""
    for rng in t.draws():
        used, other = t.make(), t.make()
        do_all(used, t.program(rng))
        do_all(used, t.drives(used, rng))
        words = [used.input_word(k) for k in range(used.AXES)]
        nets, clock, noted = [used.net(k) for k in range(used.AXES)], used.clock, list(used.diagnostics)
        other.advance(clock)
        for k, word in enumerate(words):
            other.set_input_word(k, word)
        used.reset()
        other.reset()
        now = [used.input_word(k) for k in range(used.AXES)]
        if (used.clock, used.diagnostics, now) != (clock, noted, words):
            raise Broken("a reset changes the clock, the inputs or what was noted")
        if not t.kind.SERVO and [used.net(k) for k in range(used.AXES)] != nets:
            raise Broken("a reset changes the count of the pulses that were made")
        if (mine := _shown(used)) != (its := _shown(other)):
            raise Broken(f"after a reset it shows {_different(mine, its)}")
        acts = harmless(t.wild(rng, 25), other.twin())
        if do_all(used, acts) != do_all(other, acts) or (mine := _shown(used)) != (its := _shown(other)):
            raise Broken(f"after a reset it does not go on as one that was just switched on: {_different(mine, its)}")


def _different(mine: Any, its: Any, when: str = "after power-up") -> str:
    for name in its[0]:
        if mine[0].get(name) != its[0][name]:
            return f"{name} {mine[0].get(name)}, and {when} {its[0][name]}"
    return f"pins {mine[1:]}, and {when} {its[1:]}"


def diagnostics(t: Trial) -> None:
    """bad writes: none raises, whatever its address and value; what is noted is a Diagnostic with words; noting changes nothing"""
    for rng in t.draws():
        chip = t.make()
        for act in t.wild(rng, 60):
            if act.kind == "time":
                act = act._replace(a=min(act.a, 1000))
            if act.kind == "write":
                before = chip.state.tobytes()
                _calmly(f"mistake({act.a:X}h, {act.b:X}h)", chip.mistake, act.a, act.b)
                t.same_bits(before, chip.state.tobytes(), f"after mistake({act.a:X}h, {act.b:X}h), which only looks")
            _calmly(str(act), do, chip, act)
        for value in (-1, 1 << 40, (1 << 63) - 1, 1 << 70, np.int64(-5)):
            address = int(rng.integers(-(1 << 20), 1 << 20))
            _calmly(f"write({address}, {value})", chip.write, address, value)
            _calmly(f"read({address})", chip.read, address)
        for d in chip.diagnostics:
            if not isinstance(d, Diagnostic) or not d.message.strip() or not d.source.strip() or d.clock > chip.clock:
                raise Broken(f"it notes {d!r}")


def _calmly(what: str, does: Callable[..., Any], *given: Any) -> None:
    try:
        does(*given)
    except Exception as error:
        raise Broken(f"{what} raises {type(error).__name__}: {error}") from error


def determinism(t: Trial) -> None:
    """determinism: the same acts give the same answers and the same bits, whatever other chips do meanwhile"""
    for rng in t.draws():
        acts, others = t.program(rng), t.program(rng)
        one, other = t.make(), t.make()
        said = do_all(one, acts)
        noise, again = t.make(), []
        for k, act in enumerate(acts):
            again.append(do(other, act))
            if others:
                do(noise, others[k % len(others)])
        if said != again:
            k = next(k for k in range(len(said)) if said[k] != again[k])
            raise Broken(f"it answers {acts[k]} with {said[k]} and, beside another chip, with {again[k]}")
        t.same(one, other, "alone and beside another chip")
        if _shown(one) != _shown(other):
            raise Broken("its registers and pins show something else beside another chip")


def reads(t: Trial) -> None:
    """reads: a read cycle changes nothing, but at READING_ACTS; `peek`, what a host would like to see there, never does"""
    for rng in t.draws():
        chip = t.make()
        for act in t.program(rng):
            do(chip, act)
            _core_reads(t, chip)
        _reads(t, chip)
        do_all(chip, t.drives(chip, rng))
        _reads(t, chip)


def _core_reads(t: Trial, chip: Chip) -> None:
    """Reads of a copy: so they can be made after each act without a change of what comes."""
    for address in range(chip.ADDRESSES):
        if address not in chip.READING_ACTS:
            before, state = copy_of(chip), copy_of(chip)
            for k in range(chip.AXES):
                for looked in (before, state):
                    chip.CORE.outputs(looked, k)
            chip.CORE.read(state, address)
            _unchanged(t, address, before.tobytes(), state.tobytes())


def _reads(t: Trial, chip: Chip) -> None:
    for k in range(chip.AXES):
        chip.output_word(k)
    for address in range(chip.ADDRESSES):
        before = chip.state.tobytes()
        chip.CORE.peek.held(chip.pointer, address)
        t.same_bits(before, chip.state.tobytes(), f"after peek({address:X}h)")
        if address in chip.READING_ACTS:
            continue
        if not 0 <= (value := chip.read(address)) <= chip.DATA_MASK:
            raise Broken(f"read({address:X}h) gives {value}, and the data lines hold 0 to {chip.DATA_MASK:X}h")
        _unchanged(t, address, before, chip.state.tobytes())


def _unchanged(t: Trial, address: int, before: bytes, now: bytes) -> None:
    if now != before:
        differ = fields_that_differ(t.kind, before, now)
        raise Broken(f"read({address:X}h) changes {differ}, and {address:X}h is not in READING_ACTS")


def register_cycles(t: Trial) -> None:
    """register_cycles: every register that can be written is, by cycles that the bus has"""
    for r in t.kind.MAP.registers:
        if "W" not in r.access:
            continue
        for value in dict.fromkeys(r.range):
            cycles = t.kind.register_cycles(r.name, value & r.mask, t.kind.AXES - 1)
            if not cycles:
                raise Broken(f"no bus cycle writes {r.name}")
            for address, datum in cycles:
                if not (0 <= address <= t.kind.ADDRESS_MASK and 0 <= datum <= t.kind.DATA_MASK):
                    raise Broken(f"{r.name} = {value} is written by ({address}, {datum}), which is not on the bus")


def command_cycles(t: Trial) -> None:
    """command_cycles: every command is sent by cycles that the bus has, where the family says how"""
    map_ = t.kind.MAP
    sent: list[Command | Word] = [*map_.commands, *(w for w in map_.words if w.written)]
    for what in sent:
        name = what.name if isinstance(what, Word) else what.symbol
        takes = isinstance(what, Word) or what.choice or (what.bytes and "read" not in what.kind)
        try:
            cycles = t.kind.command_cycles(name, t.kind.AXES - 1, 1 if takes else None)
        except NotImplementedError:
            return
        except Exception as error:
            kind = (
                "a word of the map with an address and a field that is written"
                if isinstance(what, Word)
                else "a command"
            )
            raise Broken(
                f"command_cycles({name!r}), {kind}, raises {type(error).__name__}: {error} ({_line(error)})"
            ) from error
        if not cycles:
            raise Broken(f"no bus cycle sends {name}")
        for address, datum in cycles:
            if not (0 <= address <= t.kind.ADDRESS_MASK and 0 <= datum <= t.kind.DATA_MASK):
                raise Broken(f"{name} is sent by ({address}, {datum}), which is not on the bus")


def words(t: Trial) -> None:
    """words: listener and decoder tell every bus cycle in a line of ASCII"""
    for rng in t.draws():
        chip = t.make()
        listener = chip.listener()
        journal = chip.journal()
        for act in t.program(rng):
            if act.kind in ("write", "read"):
                said = ""
                value = act.b if act.kind == "write" else int(chip.CORE.peek.held(chip.pointer, act.a))
                try:
                    said = getattr(listener, act.kind)(act.a, value)
                except Exception as error:
                    raise Broken(
                        f"listener.{act.kind}({act.a}, {value}) raises {type(error).__name__}: {error}"
                    ) from error
                if not said or not said.isascii() or "\n" in said or len(said) > LONGEST:
                    raise Broken(
                        f"listener.{act.kind}({act.a}, {value}) says {said!r}: one line of ASCII, up to {LONGEST}"
                    )
            do(chip, act)
        _calmly("the decoder", decode, chip.decoder(0), journal.entries)
        _calmly("dump()", chip.dump)
        _calmly("repr()", repr, chip)


def _line(error: Exception) -> str:
    where = traceback.extract_tb(error.__traceback__)[-1]
    return f"{where.filename}, line {where.lineno}, in {where.name}"


def _some(numbers: np.ndarray) -> str:
    shown = ", ".join(map(str, numbers[:5].tolist()))
    return f"{shown} ... {numbers[-1]}" if len(numbers) > 5 else shown


PROMISES: dict[str, Callable[[Trial], None]] = {
    p.__name__: p
    for p in (
        has_what_every_chip_has, pins_by_name, register_cycles, command_cycles,
        bus_lines, time_that_passes, reads, diagnostics, words,
        determinism, traced, cut_time, windows, drive_inputs, courses, limit_switches, axes_alone,
        snapshots, journals, resets,
    )
}  # fmt: skip
"""Every promise by name; their docstrings say what is promised."""
