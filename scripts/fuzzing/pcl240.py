"""The PCL-240 family on the fuzzer's bench."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, ClassVar

import numpy as np

from fuzzing.family import Family, Values, Work
from fuzzing.promises import Finding, demand
from stage.chips import Chip
from stage.chips.journal import Journal
from stage.chips.pcl240 import core, motion
from stage.chips.pcl240.state import EXTENSION, EXTERNAL
from stage.native import COMPILED

WRAP = 1 << 24  # pulses in which R0 comes round, and passes 0 and R6 again
PIN = core.INPUTS | {name: bit << 8 for name, bit in core.OUTPUTS.items()}
FEW = 5000  # pulses: the edges of more are not looked for one by one
STATUS = {0x80: "irq", 0x40: "hold", 0x20: "fkeep", 0x10: "lt", 0x08: "zero", 0x02: "org", 0x01: "ins"}
LOW, SD = 0xC0, 0x04  # bits that are 0 with the pin asserted; the bit of the SD switch ahead
ORG, ORG_LOGIC = 0x02, 1 << 23  # of the status; the bit of an MS' R13 that turns it round
RAMPS = {PIN["fup"], PIN["fkeep"], PIN["fdown"]}
RAMPING = sum(RAMPS)


@cache
def counted_core() -> Work:
    """The core's functions between two events, wrapped once to be counted."""
    work = Work()
    span, cruise, climb, took_step = motion.span, motion._cruise, motion._climb, motion.took_step

    def counting_span(c, n):
        work.spend()
        work.calls += 1
        speed = c.speed
        ran = span(c, n)
        work.steps += c.speed != speed
        return ran

    def counting_cruise(c, until):
        work.calls += 1
        cruise(c, until)

    def counting_climb(c, until):
        work.calls += 1
        climb(c, until)

    def counting_took_step(c):
        work.spend()  # a climb's step is due; what counts is that one call takes many
        took_step(c)

    motion.span, core.span, motion._cruise = counting_span, counting_span, counting_cruise
    motion._climb, motion.took_step = counting_climb, counting_took_step
    return work


class Pcl240(Family):
    FREE: ClassVar = ("quiet",)
    LIVE: ClassVar = {"R0", "R10", "R17", "status"}  # what clocks change

    def __init__(self, chip: type[Chip]):
        super().__init__(chip)
        self.work = None if COMPILED else counted_core()

    def writes(self, kind: int, low: int, take: Callable[[int], int]) -> list[tuple[int, int]]:
        """A raw write, or a whole register."""
        if kind < 3:
            return [(low, take(1))]
        value = take(3)
        return [(0, 0x80 | low), (3, value >> 16), (2, value >> 8 & 0xFF), (1, value & 0xFF)]

    def said(self, chip: Chip, values: Values, address: int) -> int | None:
        """A byte of the status or of a register; what a collective read has latched is not in view."""
        c, byte = chip.state, address & 3
        if not byte:
            return values["status"]
        name = self.limits[int(c["selected"])][0] if c["extended"] and c["output"] & EXTENSION else "R0"
        return None if c["collective"] else values[name] >> 8 * (byte - 1) & 0xFF

    def silent(self, chip: Chip) -> bool:
        """A chip at rest, or at a limit of its direction."""
        return chip.pins.hold or (chip.pins.el_minus if chip.state["minus"] else chip.pins.el_plus)

    def check(self, chip: Chip, values: Values) -> None:
        super().check(chip, values)
        c, status = chip.state, values["status"]
        pins = chip.input_word(0) | chip.output_word(0) << 8
        right = sum(bit for bit, pin in STATUS.items() if pins & PIN[pin]) ^ LOW
        if values.get("R13", 0) & ORG_LOGIC:
            right ^= ORG
        right |= SD if pins & PIN["sd_minus" if c["minus"] else "sd_plus"] else 0
        if status != right:
            raise Finding(f"status {status:02X}h, but the pins say {right:02X}h")
        if pins & RAMPING not in RAMPS:
            raise Finding("not one of FUP, FKEEP, FDOWN")
        if not (0 <= c["phase"] < 8192 * max(values["R7"], 1) + 8192 and 0 <= c["speed"] <= 8191):
            raise Finding(f"phase {c['phase']}, speed {c['speed']}")

    def advanced(self, chip: Chip, before: Any, after: Values, clocks: int, pulses: int) -> None:
        changed = {name for name in before if before[name] != after[name]} - self.LIVE
        demand(not changed, f"clocks changed {changed}")
        demand(2 * (pulses - 1) < clocks, f"{pulses} pulses in {clocks} clocks: no multiplier is that small")
        if not chip.state["output"] & EXTERNAL:
            counted = (before["R0"] - after["R0"]) % WRAP
            demand(counted == pulses % WRAP, f"{pulses} pulses, but R0 counted {counted}")

    def course(self, chip: Chip, journal: Journal, pulses: int) -> None:
        edges = np.concatenate(list(journal.pieces(every_pulse=pulses <= FEW, size=1024)))
        demand(bool((edges["clock"][1:] >= edges["clock"][:-1]).all()), "a course that runs back")
        c, last = chip.state, edges[-1]
        is_at = (int(c["clock"]), int(c["net"]), int(c["reg"][0]), chip.output_word(0), int(c["inputs"]))
        ends_at = tuple(int(last[name]) for name in ("clock", "net", "counter", "outputs", "inputs"))
        demand(ends_at == is_at, f"a course that ends with {ends_at}, a chip with {is_at}")

    def most_work(self, chip: Chip, pulses: int) -> int:
        """Two calls an event, a climb and a span. Events are the steps of the speed that no climb took, three each time that R0
        comes round (below R6, 0, wrapped), some starts, stops and turns; never clocks, nor pulses as such."""
        return 2 * (self.work.steps + 3 * (pulses // WRAP) + 8)  # type: ignore[union-attr]
