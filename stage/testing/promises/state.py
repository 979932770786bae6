"""The whole state of a chip: determinism, snapshots, resets."""

from __future__ import annotations

import copy
import pickle

import numpy as np

from stage.chips import Chip
from stage.errors import ArgumentError
from stage.testing.hands import (
    do,
    do_all,
    harmless,
)
from stage.testing.promises.looks import different, showing
from stage.testing.trial import Broken, Trial


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
        if showing(one) != showing(other):
            raise Broken("its registers and pins show something else beside another chip")


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
        shown = showing(chip)
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
            if (looks := showing(other)) != shown:
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
        if (mine := showing(fresh)) != (its := showing(chip)):
            raise Broken(
                f"with the {value} in every register, restored into a new chip, it shows {different(mine, its, 'before')}"
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
        if (mine := showing(used)) != (its := showing(other)):
            raise Broken(f"after a reset it shows {different(mine, its)}")
        acts = harmless(t.wild(rng, 25), other.twin())
        if do_all(used, acts) != do_all(other, acts) or (mine := showing(used)) != (its := showing(other)):
            raise Broken(f"after a reset it does not go on as one that was just switched on: {different(mine, its)}")
