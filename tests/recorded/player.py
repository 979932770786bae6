"""Plays a random program on a chip, and condenses what can be seen of it to a few hexadecimal digits at each checkpoint.

A program is a list of operations, tuples that print as what they do:
    ("write", address, value)     ("read", address)     ("write_byte", address, value)     ("read_byte", address)
    ("pin", axis, name, level)    ("shaft", count, rate)    ("advance" or "trace", clocks)    ("reset",)
    ("check",)                    a checkpoint
A digest tells of everything since the program began: what was read, pulses, outputs, the whole state, what was a mistake, and in
the end the replayed journal. The last one is of words alone: what a listener, a decoder and the diagnostics said. All is of whole
numbers, texts and sums of doubles that every machine rounds alike.
"""

import json
import random
from hashlib import blake2b

import numpy as np

from stage.chips.chip import Pins
from stage.chips.describe import decode
from stage.chips.nova import state as nova

DIGITS = 2  # bytes of a digest


class Draw:
    """Random numbers that are the same with every Python: of them only `random()` promises that."""

    def __init__(self, seed):
        self.random = random.Random(seed).random

    def of(self, *choices):
        """One of them; called, where it can be."""
        chosen = choices[int(self.random() * len(choices))]
        return chosen() if callable(chosen) else chosen

    def between(self, low, high):
        return low + int(self.random() * (high - low + 1))

    def size(self, low, high):
        """As often small as large."""
        return min(int(low * ((high + 1) / low) ** self.random()), high)

    def chance(self, share):
        return self.random() < share

    def bits(self, share, width=16):
        """A word whose bits are set with this chance."""
        return sum(self.chance(share) << k for k in range(width))


class Player:
    def __init__(self, chip, axis=0):
        """axis: the one whose course is looked at in the end."""
        self.chip, self.checks = chip, []
        self.done, self.words = blake2b(digest_size=DIGITS), blake2b(digest_size=DIGITS)
        self.journal = chip.journal(axis)
        self.listener = chip.listener()
        self.common = (
            Pins(chip, chip.AXES, nova.COMMON_INPUTS, nova.COMMON_OUTPUTS) if chip.ADDRESS_MASK == 31 else None
        )

    def play(self, program):
        """The digests of the checkpoints and of the end."""
        for operation in program:
            self.do(*operation)
        self.end()
        return self.checks

    def note(self, *what):
        self.done.update(json.dumps(what, default=lambda v: v.item()).encode())  # uncompiled, numbers are NumPy's

    def tell(self, *words):
        self.words.update(repr(words).encode())

    def do(self, kind, *rest):
        chip = self.chip
        if kind == "check":
            self.check()
        elif kind == "write":
            self.tell(self.listener.write(*rest))
            chip.write(*rest)
        elif kind == "read":
            value = chip.read(*rest)
            self.note(value)
            self.tell(self.listener.read(*rest, value))
        elif kind == "pin":
            axis, name, level = rest
            setattr(self.common if axis == chip.AXES and self.common else chip.axes[axis].pins, name, level)
        elif kind == "shaft":
            chip.set_shaft(*rest)
        elif kind == "trace":
            self.note(chip.trace(*rest).tolist())
        else:  # advance, reset, bytes
            self.note(getattr(chip, kind)(*rest))
            if kind == "reset":
                self.listener = chip.listener()

    def seen(self):
        """What a debugger sees now."""
        chip = self.chip
        outputs = [chip.output_word(j) for j in range(chip.AXES + (self.common is not None))]
        return {**chip.values(), "outputs": outputs, "net": [chip.net(j) for j in range(chip.AXES)]}

    def check(self):
        chip = self.chip
        said = chip.diagnostics
        self.note(self.seen(), [(d.clock, d.address, d.value) for d in said[-20:]], chip.clock)
        self.tell([d.message + d.source for d in said[-20:]])
        words = chip.state.tobytes()
        kept = np.frombuffer(words[: len(words) // 8 * 8], np.int64)
        # whatever the order of the fields, and with new ones at rest
        self.done.update(np.sort(kept[kept != 0]).tobytes())
        self.checks.append(self.done.copy().hexdigest())

    def end(self):
        """What was noted of it all: the commands in words, the changes of the pins. The last digest is that of all words."""
        journal = self.journal
        journal.close()
        decoded = decode(self.chip.decoder(journal.axis), journal.entries)
        self.note([(s.clock, s.kind, s.code) for s in decoded])
        self.tell([s.meaning for s in decoded])
        course = journal.course(every_pulse=self.chip.clock < 20_000)
        self.done.update(course.edges.tobytes())
        self.check()
        self.checks.append(self.words.hexdigest())


def say(operation):
    kind, *rest = operation
    if kind.startswith("write"):
        return f"{kind} {rest[0]:02X}h {rest[1]:04X}h"
    return " ".join([kind, *map(str, rest)])


def with_checks(program, every):
    """A checkpoint after each so many operations."""
    return [p for k, op in enumerate(program, 1) for p in ((op, ("check",)) if k % every == 0 else (op,))]
