"""Which port of a host's bus reaches which address of which chip: layouts as data.

Chips stand one after the other from a base on, each as many ports as its layout has; a card may add ports of its own behind them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from stage.board.bus.host_record import BYTE, HALF, LAST_PORT, LATCH, LATCHED, NOTHING, PORT, PULLS, REGION, WORD
from stage.chips import Chip, contract
from stage.chips.hctl1100 import HCTL1100
from stage.chips.nova import BYTES, MCX514, Nova
from stage.chips.pcl240 import PCL240
from stage.errors import ArgumentError, a_or_an, unknown

MOST_PORTS = LAST_PORT + 1
GAP = 64
"""Ports with nothing there: more of them in a row begin another region of the table."""


@dataclass(frozen=True)
class Layout:
    """How one kind of chip lies on the bus.

    ports: of each port of a chip, what it reaches: (kind, address), see `host_record`. stride: ports from one chip to the next.
    own: ports of the card itself, behind room for `chips` chips. evidence: S data sheet, I inferred (a card's choice).
    """

    name: str
    title: str
    kind: type[Chip]
    ports: tuple[tuple[int, int], ...]
    stride: int
    base: int = 0x300
    own: tuple[tuple[int, int], ...] = ()
    chips: int = 0
    evidence: str = "S"


_FOUR = tuple((BYTE, a) for a in range(4))
_WORDS = tuple((WORD if n % 2 == 0 else HALF, n // 2) for n in range(16))
LAYOUTS: dict[str, Layout] = {
    x.name: x
    for x in (
        Layout("pcl240", "one chip per 4 ports: command or status, then the data bytes", PCL240, _FOUR, 4),
        Layout(
            "pcl240-card", "three chips, and at +12 which of them pull the interrupt line (bits 0 to 2)", PCL240, _FOUR, 4, 0x340,
            ((PULLS, 0),), 3, "I",
        ),
        Layout("nova", "16-bit bus: WRn, RRn at +2n", Nova, _WORDS, 16),
        Layout("nova-8bit", "8-bit bus of the MCX514: low byte of WRn, RRn at +2n, high byte at +2n+1", MCX514,
               tuple((BYTE, BYTES | n) for n in range(16)), 16),
        Layout("hctl1100", "address latch at +0, data at +1", HCTL1100, ((LATCH, 0), (LATCHED, 0)), 2, evidence="I"),
    )
}  # fmt: skip


def usual(chip: Chip) -> Layout:
    """The default layout of a chip: that which its class names in LAYOUT; one that names none has each bus address at a port of its
    own."""
    for layout in LAYOUTS.values():
        if isinstance(chip, layout.kind):
            return layout
    if chip.LAYOUT:
        found = contract.loaded(type(chip), "LAYOUT", "its layout")
        if not isinstance(found, Layout):
            raise ArgumentError(f"{type(chip).__name__}: LAYOUT = {chip.LAYOUT!r} is no stage.board.layouts.Layout.")
        return found
    ports = [(BYTE, a) for a in range(chip.ADDRESSES)]
    if chip.DATA_MASK > 0xFF:
        ports = [(kind, a) for a in range(chip.ADDRESSES) for kind in (WORD, HALF)]
    return Layout(
        type(chip).__name__.lower(), "one address after the other", type(chip), tuple(ports), len(ports), evidence="I"
    )


@dataclass(frozen=True)
class Place:
    """Where a chip lies on a bus. index: of the stage's chips."""

    chip: Chip
    index: int
    layout: Layout
    first: int


def places(
    chips: Mapping[int, Chip], layout: str | Layout | None, base: int | Mapping[Chip, int] | None, stride: int | None
) -> list[Place]:
    """Where each of a stage's chips (by index, in their order on the bus) lies. Raises ArgumentError for a layout that does not
    fit, or ports that do not exist."""
    if isinstance(layout, str):
        if layout not in LAYOUTS:
            raise unknown("layout", layout, LAYOUTS)
        layout = LAYOUTS[layout]
    found: list[Place] = []
    at = None if isinstance(base, Mapping) else base
    for k, chip in chips.items():
        own = layout or usual(chip)
        if not isinstance(chip, own.kind):
            theirs = ", ".join(x.name for x in LAYOUTS.values() if isinstance(chip, x.kind))
            raise ArgumentError(
                f"layout {own.name}: it is for {a_or_an(own.kind.__name__)}, and this stage has "
                f"{a_or_an(type(chip).__name__)}. Layouts for "
                f"that: {theirs or 'the one that it has without layout=, or a Layout of yours'}."
            )
        if own.chips and len(chips) > own.chips:
            raise ArgumentError(
                f"layout {own.name}: it has room for {own.chips} chips, and this stage has {len(chips)}."
            )
        first = base[chip] if isinstance(base, Mapping) else own.base if at is None else at
        if not isinstance(first, int | np.integer) or not 0 <= first <= MOST_PORTS - len(own.ports):
            shown = f"{first:#x}" if isinstance(first, int | np.integer) else repr(first)
            raise ArgumentError(
                f"base={shown}: ports are whole numbers from 0 to {LAST_PORT:X}h, and the chip takes {len(own.ports)}."
            )
        found.append(Place(chip, k, own, int(first)))
        at = int(first) + (own.stride if stride is None else stride)
    return found


def table(
    found: list[Place], others: Mapping[int, tuple[int, int, int, int]] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The REGION records of a bus, and its PORT records. others: ports of devices, which no chip takes. Raises ArgumentError where
    two things share a port."""
    lines: dict[int, tuple[int, int, int, int]] = dict(others or {})

    def put(port: int, kind: int, chip: int, address: int, mask: int) -> None:
        if kind == NOTHING:
            return
        if port > LAST_PORT:
            raise ArgumentError(f"port {port:X}h: ports are 0 to {LAST_PORT:X}h, choose a lower base.")
        if port in lines:
            raise ArgumentError(
                f"port {port:03X}h would reach two things: choose another base or a stride of more ports."
            )
        lines[port] = (kind, chip, address, mask)

    for place in found:
        for n, (kind, address) in enumerate(place.layout.ports):
            put(place.first + n, kind, place.index, address, place.chip.ADDRESS_MASK)
    if found and (own := found[0].layout).own:
        for n, (kind, address) in enumerate(own.own):
            put(found[0].first + own.stride * own.chips + n, kind, 0, address, 0)
    if not lines:
        return np.zeros(0, REGION), np.zeros(1, PORT)
    taken = np.array(sorted(lines), np.int64)
    ends = np.flatnonzero(np.diff(taken, append=1 << 62) > GAP)
    firsts = taken[np.concatenate([[0], ends[:-1] + 1])]
    regions = np.zeros(len(firsts), REGION)
    regions["first"], regions["n"] = firsts, taken[ends] - firsts + 1
    regions["at"] = 1 + np.cumsum(regions["n"]) - regions["n"]
    ports = np.zeros(1 + int(regions["n"].sum()), PORT)
    ports[1:][taken - np.repeat(regions["first"] - regions["at"] + 1, np.diff(ends, prepend=-1))] = [
        (*lines[port], 0) for port in taken.tolist()
    ]
    return regions, ports


def numbers(regions: np.ndarray) -> np.ndarray:
    """Of each PORT record of a table, which port it is about; -1 for the first."""
    return np.concatenate([[-1], *(np.arange(first, first + n) for first, n, _ in regions.tolist())])
