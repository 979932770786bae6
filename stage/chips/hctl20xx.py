"""HCTL-20xx quadrature decoder and counter chips: what a host without an HCTL-1100 reads an encoder with.

    counter = HCTL2020(lambda: chip.encoder)
    counter.sel, counter.oe = 0, True       OE low, SEL low: latched, and the high byte is on the bus
    counter.data
    counter.count()                         all bytes as a driver reads them, the high one first

A counter is given a function that says what the encoder shows now, in quadrature counts; it follows it however fast it is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from stage.errors import ArgumentError

Encoder = Callable[[], int]
COUNT_MODES = {(1, 0): 1, (0, 1): 2, (1, 1): 4}
"""Quadrature counts of one count, by the pins EN1 and EN2: x4, x2, x1."""


class _Counter:
    """A counter of some bits, and its latch."""

    def __init__(self, encoder: Encoder, bits: int, divisor: int = 1):
        self._encoder, self._mask, self._divisor = encoder, (1 << bits) - 1, divisor
        self._latch: int | None = None
        self.reset()

    def _counted(self) -> int:
        return self._encoder() // self._divisor

    def reset(self) -> None:
        """The RST pin."""
        self._zero = self._counted()

    def total(self) -> int:
        """Counts since RST, however many bits they need."""
        return self._counted() - self._zero

    def latch(self) -> None:
        """Hold the count for the bus, until `release`; what is held stays."""
        if self._latch is None:
            self._latch = self.total() & self._mask

    def release(self) -> None:
        self._latch = None

    def byte(self, k: int) -> int:
        """The k-th byte, as held or as it counts."""
        value = self.total() & self._mask if self._latch is None else self._latch
        return value >> 8 * k & 0xFF


class HCTL2016:
    """HCTL-2016: 16 bits, two bytes. Pins: `oe` (bool, True is asserted: low) and `sel` (0 the high byte, 1 the low one)."""

    BITS: ClassVar[int] = 16

    def __init__(self, encoder: Encoder):
        """encoder: what the encoder shows now, quadrature counts."""
        self._counter = _Counter(encoder, self.BITS)
        self._oe, self._sel = False, 0

    @property
    def oe(self) -> bool:
        return self._oe

    @oe.setter
    def oe(self, asserted: bool) -> None:
        self._oe = bool(asserted)
        self._settle()

    @property
    def sel(self) -> int:
        return self._sel

    @sel.setter
    def sel(self, level: int) -> None:
        self._sel = 1 if level else 0
        self._settle()

    def _settle(self) -> None:
        if not self._oe:
            self._counter.release()
        elif self._sel == 0:
            self._counter.latch()

    @property
    def data(self) -> int | None:
        """The byte on the bus; None while OE is high and the outputs float."""
        return self._counter.byte(1 - self._sel) if self._oe else None

    def count(self) -> int:
        """Both bytes as a driver reads them: high, low, and OE high again. 0 up to 2 ** BITS - 1."""
        value = 0
        for level in (0, 1):
            self.sel = level
            self.oe = True
            value = value << 8 | (self.data or 0)
        self.oe = False
        return value

    def reset(self) -> None:
        """The RST pin: the count is 0."""
        self._counter.reset()


class HCTL2000(HCTL2016):
    """HCTL-2000: 12 bits; b7 to b4 of the high byte are 0."""

    BITS: ClassVar = 12


class HCTL2017(HCTL2016):
    """HCTL-2017: the later HCTL-2016."""


class HCTL2020(HCTL2016):
    """HCTL-2020: the HCTL-2016 with a cascade output."""

    @property
    def cascade(self) -> int:
        """Pulses at CNTCAS since RST, those upwards minus those downwards: how often the count went over its end."""
        return self._counter.total() >> self.BITS


class HCTL2021(HCTL2020):
    """HCTL-2021: the later HCTL-2020."""


class HCTL2022:
    """HCTL-2022: 32 bits, four bytes, counting x1, x2 or x4. Pins: `oe` (True is asserted: low), and the byte on the bus by
    `select`; OE with the highest byte selected latches until OE goes high again."""

    BYTES: ClassVar[dict[tuple[int, int], int]] = {(0, 1): 3, (1, 1): 2, (0, 0): 1, (1, 0): 0}
    """The byte on the bus, by SEL1 and SEL2; 3 is the highest."""

    def __init__(self, encoder: Encoder, count_mode: tuple[int, int] = (1, 0)):
        """count_mode: the levels of EN1 and EN2. Raises ArgumentError for 0, 0, which the data sheet forbids."""
        self._counters = [_Counter(encoder, 32, _divisor(count_mode))]
        self._oe, self._select, self._axis = False, (0, 1), 0

    @property
    def oe(self) -> bool:
        return self._oe

    @oe.setter
    def oe(self, asserted: bool) -> None:
        self._oe = bool(asserted)
        self._settle()

    @property
    def select(self) -> tuple[int, int]:
        """Levels of SEL1 and SEL2."""
        return self._select

    @select.setter
    def select(self, levels: tuple[int, int]) -> None:
        self._select = (1 if levels[0] else 0, 1 if levels[1] else 0)
        self._settle()

    def _settle(self) -> None:
        for counter in self._counters:
            if not self._oe:
                counter.release()
        if self._oe and self.BYTES[self._select] == 3:
            self._counters[self._axis].latch()

    @property
    def data(self) -> int | None:
        """The byte on the bus; None while OE is high and the outputs float."""
        return self._counters[self._axis].byte(self.BYTES[self._select]) if self._oe else None

    def count(self) -> int:
        """The four bytes as a driver reads them, the highest first, and OE high again. 0 up to 2 ** 32 - 1."""
        value = 0
        for levels in self.BYTES:
            self.select = levels
            self.oe = True
            value = value << 8 | (self.data or 0)
        self.oe = False
        return value

    def reset(self) -> None:
        """The RST pin: the count is 0."""
        self._counters[0].reset()


class HCTL2032(HCTL2022):
    """HCTL-2032: two counters as in the HCTL-2022; the pin `xy` says whose bytes are on the bus."""

    def __init__(self, x: Encoder, y: Encoder, count_mode: tuple[int, int] = (1, 0)):
        """x, y: what the encoders show now, quadrature counts. Raises ArgumentError as the HCTL-2022 does."""
        super().__init__(x, count_mode)
        self._counters.append(_Counter(y, 32, _divisor(count_mode)))

    @property
    def xy(self) -> int:
        """Level of X/Y: 0 X, 1 Y."""
        return self._axis

    @xy.setter
    def xy(self, level: int) -> None:
        self._axis = 1 if level else 0
        self._settle()

    def reset(self, axis: int | None = None) -> None:
        """The pins RSTX (axis 0) and RSTY (axis 1); both without `axis`."""
        for k, counter in enumerate(self._counters):
            if axis is None or k == axis:
                counter.reset()


def _divisor(count_mode: tuple[int, int]) -> int:
    if count_mode not in COUNT_MODES:
        raise ArgumentError(
            f"count_mode={count_mode!r}: EN1, EN2 are (1, 0): x4, (0, 1): x2, (1, 1): x1; (0, 0) is illegal."
        )
    return COUNT_MODES[count_mode]
