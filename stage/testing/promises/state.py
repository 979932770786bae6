"""Promises about the complete state of a chip: determinism, snapshots, resets."""

from __future__ import annotations

import copy
import pickle

import numpy as np

from stage.chips import Chip
from stage.errors import ArgumentError
from stage.testing.chip_actions import limit_pulses, perform_act, perform_acts
from stage.testing.promise_trial import BrokenPromise, PromiseTrial, describe_difference, read_visible_state


def check_determinism(trial: PromiseTrial) -> None:
    """Check that the same actions always give the same answers and the same bits, whatever other chips do meanwhile."""
    for rng in trial.make_seeded_generators():
        acts, other_acts = trial.draw_program(rng), trial.draw_program(rng)
        one, other = trial.make(), trial.make()
        answers = perform_acts(one, acts)
        noise, others_answers = trial.make(), []
        for k, act in enumerate(acts):
            others_answers.append(perform_act(other, act))
            if other_acts:
                perform_act(noise, other_acts[k % len(other_acts)])
        if answers != others_answers:
            k = next(k for k in range(len(answers)) if answers[k] != others_answers[k])
            raise BrokenPromise(
                f"it answers {acts[k]} with {answers[k]} and, beside another chip, with {others_answers[k]}"
            )
        trial.require_same_state(one, other, "alone and beside another chip")
        if read_visible_state(one) != read_visible_state(other):
            raise BrokenPromise("its registers and pins show something else beside another chip")


def check_snapshots(trial: PromiseTrial) -> None:
    """Check that a snapshot is complete, continues bit for bit, also in a new chip, and is refused by other chip classes."""
    for rng in trial.make_seeded_generators():
        first, then = trial.draw_program(rng), None
        chip = trial.make()
        attributes = _read_attributes(chip)
        perform_acts(chip, first)
        for name, value in _read_attributes(chip).items():
            if attributes.get(name) != value:
                raise BrokenPromise(
                    f"bus cycles, pins or time change its attribute {name!r} to {value}: a snapshot does not have it. State is "
                    "in the record"
                )
        snapshot, bits, diagnostics = chip.snapshot(), chip.state.tobytes(), list(chip.diagnostics)
        then = limit_pulses(trial.draw_acts(rng, 25), chip.make_replica())
        answers, last_state = perform_acts(chip, then), chip.state.tobytes()
        visible = read_visible_state(chip)
        chip.restore(snapshot)
        trial.require_same_bits(bits, chip.state.tobytes(), "after a snapshot is restored")
        if chip.diagnostics != diagnostics:
            raise BrokenPromise("a restored snapshot does not bring back its diagnostics")
        fresh = trial.make()
        fresh.restore(snapshot)
        others = {"restored": chip, "restored into a new chip": fresh, "pickled": pickle.loads(pickle.dumps(fresh)),
                  "copied": copy.deepcopy(fresh)}  # fmt: skip
        for how, other in others.items():
            trial.require_same_bits(bits, other.state.tobytes(), how)
            if (now := perform_acts(other, then)) != answers:
                k = next(k for k in range(len(answers)) if now[k] != answers[k])
                raise BrokenPromise(
                    f"{how}, it answers {then[k]} with {now[k]}, and the chip of the snapshot with {answers[k]}"
                )
            trial.require_same_bits(last_state, other.state.tobytes(), f"{how}, after {len(then)} acts")
            if (other_visible := read_visible_state(other)) != visible:
                raise BrokenPromise(
                    f"{how}, after {len(then)} acts it shows {other_visible}, and the chip of the snapshot {visible}"
                )
    _check_extreme_registers(trial)
    _check_refusals(trial, trial.make())


def _read_attributes(chip: Chip) -> dict[str, str]:
    """Return, as text, the numbers, words, lists and arrays that the chip object keeps outside its record."""
    plain_types = (int, float, str, bytes, list, tuple, dict, set, np.ndarray, np.generic, type(None))
    known = {"header", "_diagnostics", "_alone", "_bus", "_address", "_i", "_record", "_rows"}
    return {n: repr(v) for n, v in vars(chip).items() if n not in known and isinstance(v, plain_types)}


def _check_extreme_registers(trial: PromiseTrial) -> None:
    """Check snapshots of chips whose registers have their smallest and largest values."""
    for value in ("least", "most"):
        chip, fresh = trial.make(), trial.make()
        for r in trial.chip_class.MAP.registers:
            for axis in range(trial.chip_class.AXES if "W" in r.access else 0):
                for cycle in trial.chip_class.register_cycles(r.name, r.range[value == "most"] & r.mask, axis):
                    chip.write(*cycle)
        fresh.restore(chip.snapshot())
        trial.require_same_state(chip, fresh, f"with the {value} in every register, restored into a new chip")
        if read_visible_state(fresh) != read_visible_state(chip):
            difference = describe_difference(read_visible_state(fresh), read_visible_state(chip), "before")
            raise BrokenPromise(f"with the {value} in every register, restored into a new chip, it shows {difference}")


def _check_refusals(trial: PromiseTrial, chip: Chip) -> None:
    """Check that a chip refuses snapshots that are damaged or of another class of chips, and keeps its state."""
    options = chip.options() | {"clock_hz": max(chip.clock_hz // 2, 1)}
    other = type("Other", (trial.chip_class,), {})
    before = chip.state.tobytes()
    damaged = bytearray(chip.snapshot().record)
    damaged[0] ^= 1
    for what, foreign in (
        ("at another clock", trial.chip_class(**options).snapshot()),
        ("of another class", other(**chip.options()).snapshot()),
        ("that is damaged", type(chip.snapshot())(chip.header, bytes(damaged), (), chip.snapshot().checksum)),
    ):
        try:
            chip.restore(foreign)
        except ArgumentError:
            trial.require_same_bits(before, chip.state.tobytes(), f"after a snapshot {what} was refused")
            continue
        raise BrokenPromise(f"a snapshot {what} is restored without a word")


def check_resets(trial: PromiseTrial) -> None:
    """Check that a reset sets registers and modes as at power-up, and keeps clock, inputs, net count and diagnostics."""
    for rng in trial.make_seeded_generators():
        used, other = trial.make(), trial.make()
        perform_acts(used, trial.draw_program(rng))
        perform_acts(used, trial.draw_drives(used, rng))
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
        if trial.counts_pulses and [used.net(k) for k in range(used.AXES)] != nets:
            raise BrokenPromise("a reset changes the count of the pulses that were made")
        if (visible := read_visible_state(used)) != (expected := read_visible_state(other)):
            raise BrokenPromise(f"after a reset it shows {describe_difference(visible, expected)}")
        acts = limit_pulses(trial.draw_acts(rng, 25), other.make_replica())
        if perform_acts(used, acts) != perform_acts(other, acts) or (visible := read_visible_state(used)) != (
            expected := read_visible_state(other)
        ):
            raise BrokenPromise(
                f"after a reset it does not go on as one that was just switched on: {describe_difference(visible, expected)}"
            )
