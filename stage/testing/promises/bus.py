"""Promises about addresses, registers, pins and the descriptions that a chip gives."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import Any

import numpy as np

from stage.chips import Chip, Diagnostic, contract_check
from stage.chips.cycle_descriptions import MAX_LINE_LENGTH, decode
from stage.chips.register_map import ChipCommand, Word
from stage.errors import ArgumentError, StageError
from stage.testing.chip_actions import copy_state, describe_differences, perform_act, perform_acts
from stage.testing.promise_trial import BrokenPromise, PromiseTrial


def check_contract(trial: PromiseTrial) -> None:
    """Check that the class, core and records of the chip have every attribute that loops, boards and recordings use."""
    try:
        contract_check.check_chip_class(trial.chip_class, Chip)
    except ArgumentError as error:
        raise BrokenPromise(str(error)) from None
    axis, bits = trial.chip_class.IRQ
    known = sum(trial.chip_class.OUTPUTS.values())
    if bits & ~known or not -1 <= axis < trial.chip_class.AXES:
        raise BrokenPromise(
            f"IRQ is ({axis}, {bits:#x}): an axis from 0 to {trial.chip_class.AXES - 1}, or -1, and bits of OUTPUTS, which are "
            f"{known:#x}"
        )


def check_bus_lines(trial: PromiseTrial) -> None:
    """Check that bits of an address or a value beyond the chip's address and data lines have no effect on writes and reads."""
    for rng in trial.make_seeded_generators():
        near, distant = trial.make(), trial.make()
        for _ in range(60):
            address = int(rng.integers(near.ADDRESS_MASK, endpoint=True))
            value = int(rng.integers(near.DATA_MASK, endpoint=True)) >> int(rng.integers(0, 12))
            beyond = address + (near.ADDRESS_MASK + 1) * int(rng.integers(0, 3))
            near.write(address, value)
            distant.write(beyond, value + (near.DATA_MASK + 1) * int(rng.integers(0, 3)))
            if (read := near.read(address)) != (other := distant.read(beyond)):
                raise BrokenPromise(
                    f"address {beyond:X}h reads {other:X}h, and {address:X}h, which it acts as, {read:X}h"
                )
            if not 0 <= read <= near.DATA_MASK:
                raise BrokenPromise(
                    f"a read of address {address:X}h gives {read}, and the data lines hold 0 to {near.DATA_MASK:X}h"
                )
            trial.require_same_state(
                near, distant, f"after a write of {value:X}h to {address:X}h and as {beyond:X}h beyond the lines"
            )


def check_pins_by_name(trial: PromiseTrial) -> None:
    """Check that each input can be set alone and by name, and that setting an output or an unknown name is refused."""
    chip = trial.make()
    for axis in chip.axes:
        pins = axis.pins
        if unknown := set(dir(pins)) ^ {*chip.INPUTS, *chip.OUTPUTS}:
            raise BrokenPromise(
                f"pins {', '.join(sorted(unknown))} are listed by dir() or by INPUTS and OUTPUTS, not by both"
            )
        for name in chip.INPUTS:
            before = {n: getattr(pins, n) for n in chip.INPUTS}
            for level in (not before[name], before[name]):
                others = [chip.input_word(k) for k in range(chip.AXES) if k != axis.index]
                setattr(pins, name, level)
                if others != [chip.input_word(k) for k in range(chip.AXES) if k != axis.index]:
                    raise BrokenPromise(
                        f"input {name} of axis {axis.index} set to {level} changes inputs of another axis"
                    )
                now = {n: getattr(pins, n) for n in chip.INPUTS}
                wrong = [n for n in now if now[n] != (level if n == name else before[n])]
                if wrong:
                    raise BrokenPromise(f"input {name} set to {level} leaves input {wrong[0]} at {now[wrong[0]]}")
        for name in [*chip.OUTPUTS, "no_such_pin"]:
            try:
                setattr(pins, name, True)
            except (StageError, AttributeError):
                continue
            raise BrokenPromise(f"pin {name}, no input, can be set")


def check_reads(trial: PromiseTrial) -> None:
    """Check that a read changes nothing, except at READING_ACTS, and that `peek` never changes anything."""
    for rng in trial.make_seeded_generators():
        chip = trial.make()
        for act in trial.draw_program(rng):
            perform_act(chip, act)
            _check_core_reads(trial, chip)
        _check_peeks_and_reads(trial, chip)
        perform_acts(chip, trial.draw_drives(chip, rng))
        _check_peeks_and_reads(trial, chip)


def _check_core_reads(trial: PromiseTrial, chip: Chip) -> None:
    """Check on a copy after each action that a read does not change anything that follows."""
    for address in range(chip.ADDRESSES):
        if address not in chip.READING_ACTS:
            before, state = copy_state(chip), copy_state(chip)
            for k in range(chip.AXES):
                for looked in (before, state):
                    chip.CORE.read_outputs(looked, k)
            chip.CORE.read(state, address)
            _require_unchanged(trial, address, before.tobytes(), state.tobytes())


def _check_peeks_and_reads(trial: PromiseTrial, chip: Chip) -> None:
    """Check that at each address neither `peek` nor a read changes the chip, except reads at READING_ACTS."""
    for k in range(chip.AXES):
        chip.output_word(k)
    for address in range(chip.ADDRESSES):
        before = chip.state.tobytes()
        chip.CORE.peek.with_gil(chip.pointer, address)
        trial.require_same_bits(before, chip.state.tobytes(), f"after peek({address:X}h)")
        if address in chip.READING_ACTS:
            continue
        if not 0 <= (value := chip.read(address)) <= chip.DATA_MASK:
            raise BrokenPromise(f"read({address:X}h) gives {value}, and the data lines hold 0 to {chip.DATA_MASK:X}h")
        _require_unchanged(trial, address, before, chip.state.tobytes())


def _require_unchanged(trial: PromiseTrial, address: int, before: bytes, now: bytes) -> None:
    """Raise BrokenPromise if a cycle at an address has changed the state."""
    if now != before:
        differ = describe_differences(trial.chip_class, before, now)
        raise BrokenPromise(f"read({address:X}h) changes {differ}, and {address:X}h is not in READING_ACTS")


def check_register_cycles(trial: PromiseTrial) -> None:
    """Check that every writable register gets its value from the bus cycles that the family lists for it."""
    for r in trial.chip_class.MAP.registers:
        if "W" not in r.access:
            continue
        for value in dict.fromkeys(r.range):
            cycles = trial.chip_class.register_cycles(r.name, value & r.mask, trial.chip_class.AXES - 1)
            if not cycles:
                raise BrokenPromise(f"no bus cycle writes {r.name}")
            for address, datum in cycles:
                if not (0 <= address <= trial.chip_class.ADDRESS_MASK and 0 <= datum <= trial.chip_class.DATA_MASK):
                    raise BrokenPromise(
                        f"{r.name} = {value} is written by ({address}, {datum}), which is not on the bus"
                    )


def check_command_cycles(trial: PromiseTrial) -> None:
    """Check that every command is sent by bus cycles that exist on the bus, if the family lists cycles for commands."""
    map_ = trial.chip_class.MAP
    sent: list[ChipCommand | Word] = [*map_.commands, *(w for w in map_.words if w.is_written)]
    for what in sent:
        name = what.name if isinstance(what, Word) else what.symbol
        takes = isinstance(what, Word) or what.choice or (what.bytes and "read" not in what.kind)
        try:
            cycles = trial.chip_class.command_cycles(name, trial.chip_class.AXES - 1, 1 if takes else None)
        except NotImplementedError:
            return
        except Exception as error:
            kind = (
                "a word of the map with an address and a field that is written"
                if isinstance(what, Word)
                else "a command"
            )
            raise BrokenPromise(
                f"command_cycles({name!r}), {kind}, raises {type(error).__name__}: {error} ({_format_origin(error)})"
            ) from error
        if not cycles:
            raise BrokenPromise(f"no bus cycle sends {name}")
        for address, datum in cycles:
            if not (0 <= address <= trial.chip_class.ADDRESS_MASK and 0 <= datum <= trial.chip_class.DATA_MASK):
                raise BrokenPromise(f"{name} is sent by ({address}, {datum}), which is not on the bus")


def _format_origin(error: Exception) -> str:
    """Return the file, the line and the function in which an exception was raised."""
    where = traceback.extract_tb(error.__traceback__)[-1]
    return f"{where.filename}, line {where.lineno}, in {where.name}"


def check_diagnostics(trial: PromiseTrial) -> None:
    """Check that no bus write raises, that each diagnostic is a Diagnostic with text, and that lint changes no state."""
    for rng in trial.make_seeded_generators():
        chip = trial.make()
        for act in trial.draw_acts(rng, 60):
            if act.kind == "time":
                act = act._replace(a=min(act.a, 1000))
            if act.kind == "write":
                before = chip.state.tobytes()
                _require_no_error(
                    f"lint({act.a:X}h, {act.b:X}h)", lambda c, a, b: list(c.lint(a, b)), chip, act.a, act.b
                )
                trial.require_same_bits(
                    before, chip.state.tobytes(), f"after lint({act.a:X}h, {act.b:X}h), which only looks"
                )
            _require_no_error(str(act), perform_act, chip, act)
        for value in (-1, 1 << 40, (1 << 63) - 1, 1 << 70, np.int64(-5)):
            address = int(rng.integers(-(1 << 20), 1 << 20))
            _require_no_error(f"write({address}, {value})", chip.write, address, value)
            _require_no_error(f"read({address})", chip.read, address)
        for d in chip.diagnostics:
            if not isinstance(d, Diagnostic) or not all(map(str.strip, d[3:])) or d.clock > chip.clock:
                raise BrokenPromise(f"it notes {d!r}")


def _require_no_error(what: str, call: Callable[..., Any], *args: Any) -> None:
    """Raise BrokenPromise if calling `call` raises an exception."""
    try:
        call(*args)
    except Exception as error:
        raise BrokenPromise(f"{what} raises {type(error).__name__}: {error}") from error


def check_cycle_descriptions(trial: PromiseTrial) -> None:
    """Check that the describer and the decoder describe every bus cycle in one line of ASCII."""
    for rng in trial.make_seeded_generators():
        chip = trial.make()
        listener = chip.make_describer()
        journal = chip.journal()
        for act in trial.draw_program(rng):
            if act.kind in ("write", "read"):
                text = ""
                value = act.b if act.kind == "write" else int(chip.CORE.peek.with_gil(chip.pointer, act.a))
                try:
                    text = getattr(listener, act.kind)(act.a, value)
                except Exception as error:
                    raise BrokenPromise(
                        f"listener.{act.kind}({act.a}, {value}) raises {type(error).__name__}: {error}"
                    ) from error
                if not text or not text.isascii() or "\n" in text or len(text) > MAX_LINE_LENGTH:
                    raise BrokenPromise(
                        f"listener.{act.kind}({act.a}, {value}) says {text!r}: one line of ASCII, up to {MAX_LINE_LENGTH}"
                    )
            perform_act(chip, act)
        _require_no_error("the decoder", decode, chip.decoder(0), journal.entries)
        _require_no_error("dump()", chip.dump)
        _require_no_error("repr()", repr, chip)
