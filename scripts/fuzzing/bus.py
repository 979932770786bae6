"""The bus target: an input is a sequence of operations on any chip, as a host and the outside world may make them.

The first byte is the index of the chip in ORDER. Operations follow, with `kind` in three bits of a byte and `low` in the lower
five:

    0 to 3    bus writes, defined by the family           5    a bus read, or with low = 31 the /RESET pin
    4         a change of a pin, defined by the family    6    2^low clocks    7    (256 + the next byte) 2^low / 256 clocks
"""

from __future__ import annotations

import hashlib
import time

import numpy as np

from fuzzing.family import Enough, Family, Values
from fuzzing.hctl1100 import HctlFamily
from fuzzing.nova import NovaFamily
from fuzzing.pcl240 import Pcl240
from fuzzing.promises import Counts, require
from stage.chips import CHIPS, Chip, chip_class
from stage.chips import chip as chip_module
from stage.chips.hctl1100 import HCTL1100
from stage.chips.nova import Nova
from stage.chips.pcl240 import PCL240
from stage.native import COMPILED

if not COMPILED:
    chip_module.SHORT_RUN_CLOCKS = 1 << 62  # one piece, so that the calls counted are those of the events alone

ORDER = (
    "PCL240K", "PCL240MK", "PCL240MS", "MCX514", "MCX304", "MCX302", "MCX312", "HCTL1100", "MCX512", "MCX501", "MCX314AS",
    "STEPDIR",
)  # fmt: skip
"""Chips by the first byte of an input. A new one goes to the end: inputs that were found stay those of their chip."""
FAMILIES: dict[type[Chip], type[Family]] = {PCL240: Pcl240, Nova: NovaFamily, HCTL1100: HctlFamily}
SECONDS_PER_ADVANCE = 5.0  # compiled, however busy the machine; 2^32 clocks take milliseconds
TRACED = 1 << 16  # clocks: the twin's longer advances are not traced pulse by pulse


def make_family(chip: type[Chip]) -> Family:
    """Make the family of a chip, or the general one if the chip has none."""
    return next((family for cls, family in FAMILIES.items() if issubclass(chip, cls)), Family)(chip)


class Bus:
    """Target that checks one input at each call.

    Args:
        counts: Counters to update.
        budget: Largest number of events of an input, after which it ends; None: any number.
        only: Name of the only chip whose inputs are checked; None: all.
    """

    def __init__(self, counts: Counts | None = None, budget: int | None = None, only: str | None = None) -> None:
        self.families = [make_family(CHIPS[name]) for name in ORDER]
        self.only = chip_class(only) if only else None
        self.counts = Counts() if counts is None else counts
        self.budget, self.digest = budget, hashlib.sha256()
        for family in self.families:
            family.warm_up()

    def __call__(self, data: bytes) -> int:
        """Check an input. Returns 0; -1, by which libFuzzer keeps no such input, where it is for no chip."""
        self.counts["inputs"] += 1
        self.counts.save(every=1.0)
        if not data or data[0] >= len(self.families):
            return -1
        family = self.families[data[0]]
        if self.only not in (None, family.chip):
            return -1
        self.counts[f"for {family.chip.__name__}"] += 1
        if family.work:
            family.work.done, family.work.budget = 0, self.budget
        run = Run(family, data[1:], self.counts)
        try:
            run.run_to_end()
        except Enough:
            self.counts["out of budget"] += 1
        else:
            self.digest.update(repr(family.state(run.chip)).encode())
        return 0


class Run:
    """Execution of one input, by a compiled chip with a journal and a twin, or by an uncompiled chip whose work is counted."""

    def __init__(self, family: Family, data: bytes, counts: Counts):
        self.family, self.data, self.at, self.counts = family, data, 0, counts
        self.chip = family.make(uncompiled=not COMPILED)
        self.chips = (self.chip, family.make(uncompiled=False)) if COMPILED else (self.chip,)
        self.values: Values = self.chip.values()
        self.pulses, self.journal = 0, self.chip.journal() if COMPILED else None

    def take(self, n: int) -> int:
        """Return the number in the next `n` bytes; after the end of the input, bytes are zero."""
        chunk = self.data[self.at : self.at + n]
        self.at += n
        return int.from_bytes(chunk.ljust(n, b"\0"), "big")

    def run_to_end(self) -> None:
        while self.at < len(self.data):
            op = self.take(1)
            kind, low = op >> 5, op & 0x1F
            if kind <= 3:
                self.write(kind, low)
            elif kind == 4:
                self.toggle_pin(low)
            elif kind == 5:
                self.reset() if low == 31 else self.read(low)
            else:
                self.advance(1 << low if kind == 6 else (256 + self.take(1) << low) >> 8)
                continue
            self.check()
        if self.journal:
            self.family.check_waveform(self.chip, self.journal, self.pulses)

    def write(self, kind: int, low: int) -> None:
        for address, value in self.family.make_writes(kind, low, self.take):
            self.counts["bus cycles"] += 1
            for chip in self.chips:
                self.family.write(chip, address, value)

    def read(self, low: int) -> None:
        """Make a bus read and check its value. Addresses above 30 are in a byte of their own."""
        address = low if self.chip.ADDRESS_MASK < 31 else self.take(1)
        self.counts["bus cycles"] += 1
        words = [self.family.read(chip, address) for chip in self.chips]
        require(0 <= words[0] <= self.chip.DATA_MASK, f"{words[0]} read at {address}")
        right = self.family.predict_read(self.chip, self.values, address)
        require(right is None or words[0] == right, f"{words[0]} read at {address}, where {right} is")
        require(words[0] == words[-1], f"{words[0]} read at {address}, {words[-1]} by the twin")

    def toggle_pin(self, low: int) -> None:
        self.counts["input edges"] += 1
        for chip in self.chips:
            self.family.toggle_pin(chip, low)

    def reset(self) -> None:
        for chip in self.chips:
            chip.reset()

    def check(self) -> None:
        self.values = self.chip.values()
        self.family.check(self.chip, self.values)
        if len(self.chips) == 2:
            one, other = (self.family.bits(chip) for chip in self.chips)
            require(one == other, "a twin that ran in pieces is in another state")

    def advance(self, clocks: int) -> None:
        chip, family, work = self.chip, self.family, self.family.work
        clocks = family.limit_clocks(chip, clocks)
        silent, start = family.is_silent(chip), chip.clock
        if work:
            work.calls = work.steps = 0
        started = time.perf_counter()
        pulses = chip.advance(clocks)
        spent = time.perf_counter() - started
        self.counts["clocks"] += clocks
        self.counts["pulses"] += pulses
        self.pulses += pulses
        require(chip.clock == start + clocks, "time did not pass as asked")
        require(pulses == 0 if silent else pulses >= 0, f"{pulses} pulses in {clocks} clocks{' of silence' * silent}")
        if work:
            allowed = family.compute_max_work(chip, pulses)
            require(
                work.calls <= allowed,
                f"{work.calls} calls for {work.steps} steps in {clocks} clocks: at most {allowed}",
            )
        else:
            require(spent < SECONDS_PER_ADVANCE, f"{clocks} clocks took {spent:.1f} s")
        if len(self.chips) == 2:
            self.advance_replica(clocks, pulses)
        self.check()

    def advance_replica(self, clocks: int, pulses: int) -> None:
        """Trace the same clocks on the twin, unless they are too many, and run them again in two pieces, cut at the last pulse."""
        chip, replica = self.chips
        cuts = [clocks // 3]
        if clocks <= TRACED:
            before, start = replica.snapshot(), replica.clock
            pulse_clocks = replica.trace(clocks)["clock"]
            require(len(pulse_clocks) == pulses, f"{pulses} pulses in {clocks} clocks, {len(pulse_clocks)} traced")
            require(bool((pulse_clocks[1:] > pulse_clocks[:-1]).all()) or replica.AXES > 1, "pulses out of order")
            require(not pulses or start < pulse_clocks[0] <= pulse_clocks[-1] <= start + clocks, "a pulse at no time")
            require(self.family.bits(chip) == self.family.bits(replica), "a trace ends in another state")
            replica.restore(before)
            cuts += [int(clock) - start for clock in pulse_clocks[-1:]]
        pieces = np.diff([0, *sorted(cuts), clocks])
        others = sum(replica.advance(int(piece)) for piece in pieces)
        require(others == pulses, f"{pulses} pulses in {clocks} clocks, {others} in pieces of {pieces}")
