"""Play a bus program on a chip, and note what a host sees of it.

A program is a list of operations, tuples that print as what they do:
    ("write", address, value)     ("read", address)     ("write_byte", address, value)     ("read_byte", address)
    ("pin", axis, name, level)    ("shaft", count, rate)    ("advance" or "trace", clocks)    ("reset",)
    ("check",)                    a checkpoint: registers, pins and diagnostics
"""

import random

from stage.chips.chip import Pins
from stage.chips.cycle_descriptions import decode
from stage.chips.nova import state as nova

CHECKPOINTS = 3
"""How many a program has, about."""
EDGES_PER_EVENT = 16
MAX_CLOCK_OF_SINGLE_PULSES = 20_000
FINAL_REGISTERS = ("R0", "status", "RR0", "RR1", "R00", "R05", "R07")
"""Registers of all families in which a summary says how a program ended: pulses left, status, mode."""


class Draw:
    """Random numbers that are the same with every Python: of them only `random()` promises that."""

    def __init__(self, seed):
        self.random = random.Random(seed).random

    def choice(self, *choices):
        """Draw one of the choices, and call it where it can be called."""
        selected = choices[int(self.random() * len(choices))]
        return selected() if callable(selected) else selected

    def between(self, low, high):
        """Draw a whole number, both ends included."""
        return low + int(self.random() * (high - low + 1))

    def size(self, low, high):
        """Draw a whole number, as often small as large."""
        return min(int(low * ((high + 1) / low) ** self.random()), high)

    def chance(self, share):
        """Draw whether something happens that happens in this share of cases."""
        return self.random() < share

    def bits(self, share, width=16):
        """Draw a word whose bits are set with this chance."""
        return sum(self.chance(share) << k for k in range(width))


class BusPlayer:
    """A chip at a bus, a journal of one of its axes, and the events so far."""

    def __init__(self, chip, axis=0):
        self.chip, self.events, self.pulses = chip, {}, 0
        self.journal, self.listener = chip.journal(axis), chip.make_describer()
        self.checked = 0
        self.common_pins = (
            Pins(chip, chip.AXES, nova.COMMON_INPUTS, nova.COMMON_OUTPUTS) if chip.ADDRESS_MASK == 31 else None
        )

    def play(self, program):
        """Run a program and return its events, with a summary."""
        for operation in program:
            self.run(*operation)
        self.close()
        chip, values = self.chip, self.chip.values()
        summary = {
            "clock": chip.clock, "net": [chip.net(j) for j in range(chip.AXES)], "pulses": self.pulses,
            "diagnostics": len(chip.diagnostics), **{name: values[name] for name in FINAL_REGISTERS if name in values},
        }  # fmt: skip
        return {"summary": summary, **self.events}

    def note(self, label, *what):
        """Add an event, under the clock at which it happens."""
        self.events[f"{len(self.events)} @{self.chip.clock} {label}"] = list(what)

    def run(self, kind, *rest):
        """Run one operation and note what it shows."""
        chip, label = self.chip, format_operation(kind, *rest)
        if kind == "check":
            self.check()
        elif kind in ("write", "write_byte"):
            self.note(label, self.listener.write(*rest) if kind == "write" else None)
            self.write(getattr(chip, kind), *rest)
        elif kind == "read":
            value = chip.read(*rest)
            self.note(label, value, self.listener.read(*rest, value))
        elif kind == "pin":
            axis, name, level = rest
            setattr(self.common_pins if axis == chip.AXES and self.common_pins else chip.axes[axis].pins, name, level)
            self.note(label)
        elif kind == "shaft":
            chip.set_shaft(*rest)
            self.note(label)
        elif kind == "trace":
            pulses = chip.trace(*rest)
            self.pulses += len(pulses)
            self.note(label, [pulses[name].tolist() for name in ("clock", "axis", "direction")])
        else:
            value = getattr(chip, kind)(*rest)
            self.pulses += value if kind == "advance" else 0
            self.note(label, value)
            if kind == "reset":
                self.listener = chip.make_describer()

    def write(self, write, *cycle):
        """Write, and keep the first diagnostic of the family's lint: the others are for the tests of the lints."""
        diagnostics = self.chip.diagnostics
        before = len(diagnostics)
        write(*cycle)
        cut = diagnostics[before:] and diagnostics[before].key == "bus-width"
        del diagnostics[before + (2 if cut else 1) :]

    def check(self):
        """Note every register, all output pins, and what the diagnostics say since the last checkpoint."""
        chip = self.chip
        outputs = [chip.output_word(j) for j in range(chip.AXES + (self.common_pins is not None))]
        self.note("registers", chip.values())
        self.note("outputs", outputs, [chip.net(j) for j in range(chip.AXES)])
        new = chip.diagnostics[min(self.checked, max(len(chip.diagnostics) - 20, 0)) :]
        self.checked = len(chip.diagnostics)
        self.note("diagnostics", [[d.clock, d.address, d.value, d.message, d.source] for d in new])

    def close(self):
        """Note what the journal made of it all: the commands by their codes, the changes of the pins."""
        self.journal.close()
        statements = decode(self.chip.decoder(self.journal.axis), self.journal.entries)
        self.note("commands", [[s.clock, s.code, s.meaning] for s in statements])
        edges = self.journal.replay_waveforms(every_pulse=self.chip.clock < MAX_CLOCK_OF_SINGLE_PULSES).edges
        for k in range(0, len(edges), EDGES_PER_EVENT):
            some = edges[k : k + EDGES_PER_EVENT]
            self.note("edges", [some[name].tolist() for name in ("clock", "inputs", "outputs", "counter", "net")])
        self.check()


def format_operation(kind, *rest):
    """Write an operation as a person reads it."""
    if kind.startswith("write"):
        return f"{kind} {rest[0]:02X}h {rest[1]:04X}h"
    return " ".join([kind, *map(str, rest)])


def add_checkpoints(program):
    """Return the program with a checkpoint after each so many operations."""
    every = max(len(program) // CHECKPOINTS, 4)
    return [p for k, op in enumerate(program, 1) for p in ((op, ("check",)) if k % every == 0 else (op,))]
