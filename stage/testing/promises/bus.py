"""What a chip's addresses, registers and pins answer."""

from __future__ import annotations

import traceback

from stage.chips import Chip, contract
from stage.chips.register_map import Command, Word
from stage.errors import ArgumentError, StageError
from stage.testing.hands import (
    copy_of,
    do,
    do_all,
    fields_that_differ,
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


def _line(error: Exception) -> str:
    where = traceback.extract_tb(error.__traceback__)[-1]
    return f"{where.filename}, line {where.lineno}, in {where.name}"
