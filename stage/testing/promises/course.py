"""The course of a move, as a chip foretells it."""

from __future__ import annotations

import numpy as np

from stage.chips import Chip
from stage.testing.hands import (
    ended,
    pulse_clocks,
)
from stage.testing.promises.looks import counter
from stage.testing.trial import Broken, Trial


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
    bits, count, net = t.kind.COUNTER[1], counter(chip, axis), chip.net(axis)
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
        gone = (counter(probe, axis) - count) % (1 << bits)
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
