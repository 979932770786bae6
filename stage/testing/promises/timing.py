"""Time: how a chip lets it pass, at once or in pieces, pulse by pulse."""

from __future__ import annotations

import numpy as np

from stage.chips import Chip, cores
from stage.errors import StageError
from stage.testing.axes import together
from stage.testing.hands import (
    copy_of,
    do,
    do_all,
    ended,
    pulse_clocks,
    room_for,
)
from stage.testing.promises.looks import some
from stage.testing.trial import Broken, Trial


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
                raise Broken(f"the pulses of clocks {begin} to {one.clock} are at {some(clocks)}")
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
    ends = np.zeros(slices, cores.SLICE_END)
    ends["clocks"] = clocks - chip.clock
    row["begin"], row["ends"], row["table"], row["hz"] = chip.clock, ends.ctypes.data, table.ctypes.data, chip.clock_hz
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
