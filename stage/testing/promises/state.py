"""Promises about the whole state of a chip: determinism, snapshots, resets."""

from __future__ import annotations

import copy
import pickle

import numpy as np

from stage.chips import Chip
from stage.errors import ArgumentError
from stage.testing.chip_acts import limit_pulses, perform_act, perform_acts
from stage.testing.promise_trial import BrokenPromise, PromiseTrial, describe_difference, read_visible_state


def check_determinism(t: PromiseTrial) -> None:
    """determinism: the same acts give the same answers and the same bits, whatever other chips do meanwhile"""
    for rng in t.seeded_generators():
        acts, other_acts = t.draw_program(rng), t.draw_program(rng)
        one, other = t.make(), t.make()
        answers = perform_acts(one, acts)
        noise, others_answers = t.make(), []
        for k, act in enumerate(acts):
            others_answers.append(perform_act(other, act))
            if other_acts:
                perform_act(noise, other_acts[k % len(other_acts)])
        if answers != others_answers:
            k = next(k for k in range(len(answers)) if answers[k] != others_answers[k])
            raise BrokenPromise(
                f"it answers {acts[k]} with {answers[k]} and, beside another chip, with {others_answers[k]}"
            )
        t.require_same_state(one, other, "alone and beside another chip")
        if read_visible_state(one) != read_visible_state(other):
            raise BrokenPromise("its registers and pins show something else beside another chip")


def check_snapshots(t: PromiseTrial) -> None:
    """snapshots: all state is in them, they go on bit for bit, in a new chip, too, and are refused by another kind"""
    for rng in t.seeded_generators():
        first, then = t.draw_program(rng), None
        chip = t.make()
        attributes = _read_attributes(chip)
        perform_acts(chip, first)
        for name, value in _read_attributes(chip).items():
            if attributes.get(name) != value:
                raise BrokenPromise(
                    f"bus cycles, pins or time change its attribute {name!r} to {value}: a snapshot does not have it. State is "
                    "in the record"
                )
        snapshot, bits, diagnostics = chip.snapshot(), chip.state.tobytes(), list(chip.diagnostics)
        then = limit_pulses(t.draw_acts(rng, 25), chip.make_replica())
        answers, last_state = perform_acts(chip, then), chip.state.tobytes()
        visible = read_visible_state(chip)
        chip.restore(snapshot)
        t.require_same_bits(bits, chip.state.tobytes(), "after a snapshot is restored")
        if chip.diagnostics != diagnostics:
            raise BrokenPromise("a restored snapshot does not bring back its diagnostics")
        fresh = t.make()
        fresh.restore(snapshot)
        others = {"restored": chip, "restored into a new chip": fresh, "pickled": pickle.loads(pickle.dumps(fresh)),
                  "copied": copy.deepcopy(fresh)}  # fmt: skip
        for how, other in others.items():
            t.require_same_bits(bits, other.state.tobytes(), how)
            if (now := perform_acts(other, then)) != answers:
                k = next(k for k in range(len(answers)) if now[k] != answers[k])
                raise BrokenPromise(
                    f"{how}, it answers {then[k]} with {now[k]}, and the chip of the snapshot with {answers[k]}"
                )
            t.require_same_bits(last_state, other.state.tobytes(), f"{how}, after {len(then)} acts")
            if (other_visible := read_visible_state(other)) != visible:
                raise BrokenPromise(
                    f"{how}, after {len(then)} acts it shows {other_visible}, and the chip of the snapshot {visible}"
                )
    _check_extreme_registers(t)
    _check_refusals(t, t.make())


def _read_attributes(chip: Chip) -> dict[str, str]:
    """Return what the class keeps in the object, beside the record, as text: numbers, words, lists and arrays of them."""
    plain_types = (int, float, str, bytes, list, tuple, dict, set, np.ndarray, np.generic, type(None))
    known = {"header", "_diagnostics", "_alone", "_bus", "_address", "_i", "_record", "_rows"}
    return {n: repr(v) for n, v in vars(chip).items() if n not in known and isinstance(v, plain_types)}


def _check_extreme_registers(t: PromiseTrial) -> None:
    for value in ("least", "most"):
        chip, fresh = t.make(), t.make()
        for r in t.kind.MAP.registers:
            for axis in range(t.kind.AXES if "W" in r.access else 0):
                for cycle in t.kind.register_cycles(r.name, r.range[value == "most"] & r.mask, axis):
                    chip.write(*cycle)
        fresh.restore(chip.snapshot())
        t.require_same_state(chip, fresh, f"with the {value} in every register, restored into a new chip")
        if read_visible_state(fresh) != read_visible_state(chip):
            difference = describe_difference(read_visible_state(fresh), read_visible_state(chip), "before")
            raise BrokenPromise(f"with the {value} in every register, restored into a new chip, it shows {difference}")


def _check_refusals(t: PromiseTrial, chip: Chip) -> None:
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
            t.require_same_bits(before, chip.state.tobytes(), f"after a snapshot {what} was refused")
            continue
        raise BrokenPromise(f"a snapshot {what} is restored without a word")


def check_resets(t: PromiseTrial) -> None:
    """reset: registers and modes are as after power-up; the clock, the inputs, the count and what was noted stay"""
    for rng in t.seeded_generators():
        used, other = t.make(), t.make()
        perform_acts(used, t.draw_program(rng))
        perform_acts(used, t.draw_drives(used, rng))
        words = [used.input_word(k) for k in range(used.AXES)]
        nets, clock, diagnostics = [used.net(k) for k in range(used.AXES)], used.clock, list(used.diagnostics)
        other.advance(clock)
        for k, word in enumerate(words):
            other.set_input_word(k, word)
        used.reset()
        other.reset()
        now = [used.input_word(k) for k in range(used.AXES)]
        if (used.clock, used.diagnostics, now) != (clock, diagnostics, words):
            raise BrokenPromise("a reset changes the clock, the inputs or what was noted")
        if t.counts_pulses and [used.net(k) for k in range(used.AXES)] != nets:
            raise BrokenPromise("a reset changes the count of the pulses that were made")
        if (visible := read_visible_state(used)) != (expected := read_visible_state(other)):
            raise BrokenPromise(f"after a reset it shows {describe_difference(visible, expected)}")
        acts = limit_pulses(t.draw_acts(rng, 25), other.make_replica())
        if perform_acts(used, acts) != perform_acts(other, acts) or (visible := read_visible_state(used)) != (
            expected := read_visible_state(other)
        ):
            raise BrokenPromise(
                f"after a reset it does not go on as one that was just switched on: {describe_difference(visible, expected)}"
            )
