"""Promises about addresses, registers and pins, and about what a chip says in words."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import Any

import numpy as np

from stage.chips import Chip, Diagnostic, contract
from stage.chips.describe import MAX_LINE_LENGTH, decode
from stage.chips.register_map import Command, Word
from stage.errors import ArgumentError, StageError
from stage.testing.chip_acts import copy_state, describe_differences, perform_act, perform_acts
from stage.testing.promise_trial import BrokenPromise, PromiseTrial


def check_contract(t: PromiseTrial) -> None:
    """the contract: class, core and records have all that loops, boards and recordings ask of them"""
    try:
        contract.check(t.kind, Chip)
    except ArgumentError as error:
        raise BrokenPromise(str(error)) from None
    axis, bits = t.kind.IRQ
    known = sum(t.kind.OUTPUTS.values())
    if bits & ~known or not -1 <= axis < t.kind.AXES:
        raise BrokenPromise(
            f"IRQ is ({axis}, {bits:#x}): an axis from 0 to {t.kind.AXES - 1}, or -1, and bits of OUTPUTS, which are {known:#x}"
        )


def check_bus_lines(t: PromiseTrial) -> None:
    """masks: only the address and data lines that the chip has matter, of writes and of reads"""
    for rng in t.seeded_generators():
        near, distant = t.make(), t.make()
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
            t.require_same_state(
                near, distant, f"after a write of {value:X}h to {address:X}h and as {beyond:X}h beyond the lines"
            )


def check_pins_by_name(t: PromiseTrial) -> None:
    """pins: an input can be set, alone and by name; an output refuses; a name that is none is refused"""
    chip = t.make()
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


def check_reads(t: PromiseTrial) -> None:
    """reads: a read cycle changes nothing, but at READING_ACTS; `peek`, what a host would like to see there, never does"""
    for rng in t.seeded_generators():
        chip = t.make()
        for act in t.draw_program(rng):
            perform_act(chip, act)
            _check_core_reads(t, chip)
        _check_peeks_and_reads(t, chip)
        perform_acts(chip, t.draw_drives(chip, rng))
        _check_peeks_and_reads(t, chip)


def _check_core_reads(t: PromiseTrial, chip: Chip) -> None:
    """Check reads of a copy after each act: they change nothing of what comes."""
    for address in range(chip.ADDRESSES):
        if address not in chip.READING_ACTS:
            before, state = copy_state(chip), copy_state(chip)
            for k in range(chip.AXES):
                for looked in (before, state):
                    chip.CORE.read_outputs(looked, k)
            chip.CORE.read(state, address)
            _require_unchanged(t, address, before.tobytes(), state.tobytes())


def _check_peeks_and_reads(t: PromiseTrial, chip: Chip) -> None:
    for k in range(chip.AXES):
        chip.output_word(k)
    for address in range(chip.ADDRESSES):
        before = chip.state.tobytes()
        chip.CORE.peek.with_gil(chip.pointer, address)
        t.require_same_bits(before, chip.state.tobytes(), f"after peek({address:X}h)")
        if address in chip.READING_ACTS:
            continue
        if not 0 <= (value := chip.read(address)) <= chip.DATA_MASK:
            raise BrokenPromise(f"read({address:X}h) gives {value}, and the data lines hold 0 to {chip.DATA_MASK:X}h")
        _require_unchanged(t, address, before, chip.state.tobytes())


def _require_unchanged(t: PromiseTrial, address: int, before: bytes, now: bytes) -> None:
    if now != before:
        differ = describe_differences(t.kind, before, now)
        raise BrokenPromise(f"read({address:X}h) changes {differ}, and {address:X}h is not in READING_ACTS")


def check_register_cycles(t: PromiseTrial) -> None:
    """register_cycles: every register that can be written is, by cycles that the bus has"""
    for r in t.kind.MAP.registers:
        if "W" not in r.access:
            continue
        for value in dict.fromkeys(r.range):
            cycles = t.kind.register_cycles(r.name, value & r.mask, t.kind.AXES - 1)
            if not cycles:
                raise BrokenPromise(f"no bus cycle writes {r.name}")
            for address, datum in cycles:
                if not (0 <= address <= t.kind.ADDRESS_MASK and 0 <= datum <= t.kind.DATA_MASK):
                    raise BrokenPromise(
                        f"{r.name} = {value} is written by ({address}, {datum}), which is not on the bus"
                    )


def check_command_cycles(t: PromiseTrial) -> None:
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
            raise BrokenPromise(
                f"command_cycles({name!r}), {kind}, raises {type(error).__name__}: {error} ({_format_line(error)})"
            ) from error
        if not cycles:
            raise BrokenPromise(f"no bus cycle sends {name}")
        for address, datum in cycles:
            if not (0 <= address <= t.kind.ADDRESS_MASK and 0 <= datum <= t.kind.DATA_MASK):
                raise BrokenPromise(f"{name} is sent by ({address}, {datum}), which is not on the bus")


def _format_line(error: Exception) -> str:
    where = traceback.extract_tb(error.__traceback__)[-1]
    return f"{where.filename}, line {where.lineno}, in {where.name}"


def check_diagnostics(t: PromiseTrial) -> None:
    """bad writes: none raises, whatever its address and value; what is noted is a Diagnostic with words; noting changes nothing"""
    for rng in t.seeded_generators():
        chip = t.make()
        for act in t.draw_acts(rng, 60):
            if act.kind == "time":
                act = act._replace(a=min(act.a, 1000))
            if act.kind == "write":
                before = chip.state.tobytes()
                _require_no_error(
                    f"lint({act.a:X}h, {act.b:X}h)", lambda c, a, b: list(c.lint(a, b)), chip, act.a, act.b
                )
                t.require_same_bits(
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
    """Raise BrokenPromise if the call raises."""
    try:
        call(*args)
    except Exception as error:
        raise BrokenPromise(f"{what} raises {type(error).__name__}: {error}") from error


def check_words(t: PromiseTrial) -> None:
    """words: listener and decoder tell every bus cycle in a line of ASCII"""
    for rng in t.seeded_generators():
        chip = t.make()
        listener = chip.listener()
        journal = chip.journal()
        for act in t.draw_program(rng):
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
