"""The interrupt controller and SysTick of a Cortex-M: registers by their offset from E0000000h, and which exception comes next."""

from __future__ import annotations

from collections.abc import Callable

SYSTICK, PENDSV, SVC, FIRST = 15, 14, 11, 16
IRQS = 240
NEVER = 1 << 60
_NONE = 256  # the priority of what is no exception
_CONTROL, _RELOAD, _VALUE, _CALIBRATION = 0xE010, 0xE014, 0xE018, 0xE01C
_ICSR, _VTOR, _AIRCR, _SHPR, _CPUID, _CYCLES = 0xED04, 0xED08, 0xED0C, 0xED18, 0xED00, 0x1004
_RESET = 4


class Nvic:
    """now: the processor's cycles; irq: the number of the board's line, or None.

    Attributes: level: whether the board pulls its line; vectors: where the table is.
    """

    def __init__(self, now: Callable[[], int], irq: int | None):
        self._now, self._irq = now, irq
        self.vectors = 0
        self.level = False
        self._enabled: set[int] = set()
        self._pending: set[int] = set()
        self._active: list[int] = []
        self._priority: dict[int, int] = {}
        self._control, self._reload, self._begun, self._flagged = 0, 0, 0, 0
        self._other: dict[int, int] = {}

    # --- which comes next ---

    def next(self, primask: int, basepri: int) -> int | None:
        """The exception that is taken now, or None."""
        if primask & 1 and not self._active:
            return None
        found = [(self._priority.get(n, 0), n) for n in self._candidates()]
        if not found or primask & 1:
            return None
        priority, number = min(found)
        if priority >= self._running() or (basepri and priority >= basepri):
            return None
        return number

    def _candidates(self) -> set[int]:
        own = {n for n in self._pending if n < FIRST or n in self._enabled}
        line = FIRST + self._irq if self._irq is not None else None
        if line is not None and self.level and line in self._enabled and line not in self._active:
            own.add(line)
        return own

    def _running(self) -> int:
        return min((self._priority.get(n, 0) for n in self._active), default=_NONE)

    def entered(self, number: int) -> None:
        """Its routine begins."""
        self._pending.discard(number)
        self._active.append(number)

    def left(self, number: int) -> None:
        """Its routine has returned."""
        if number in self._active:
            self._active.remove(number)

    def before(self) -> int:
        """The exception whose routine goes on, or 0."""
        return self._active[-1] if self._active else 0

    def waiting(self) -> bool:
        """One of the processor's own waits and may come as far as priorities go."""
        found = [self._priority.get(n, 0) for n in self._pending if n < FIRST or n in self._enabled]
        return bool(found) and min(found) < self._running()

    def line_may_come(self) -> bool:
        """The board's line is on, and of a higher priority than what runs."""
        if self._irq is None or FIRST + self._irq not in self._enabled or FIRST + self._irq in self._active:
            return False
        return self._priority.get(FIRST + self._irq, 0) < self._running()

    # --- SysTick ---

    def ticks(self) -> bool:
        """It counts and interrupts."""
        return self._control & 3 == 3 and self._reload > 0

    def alarm(self) -> int:
        """The cycle at which it does next."""
        if not self.ticks():
            return NEVER
        return self._begun + ((self._now() - self._begun) // (self._reload + 1) + 1) * (self._reload + 1)

    def tick(self) -> None:
        """It has run down."""
        if self.ticks():
            self._pending.add(SYSTICK)

    def _value(self) -> int:
        if not self._control & 1:
            return 0
        return self._reload - (self._now() - self._begun) % (self._reload + 1)

    def _flag(self) -> int:
        """COUNTFLAG: it has run down since the last look."""
        if not self._control & 1 or not self._reload:
            return 0
        rounds = (self._now() - self._begun) // (self._reload + 1)
        set_, self._flagged = rounds > self._flagged, rounds
        return int(set_) << 16

    # --- registers ---

    def read(self, at: int) -> int:
        """32 bits."""
        if at == _CONTROL:
            return self._control | self._flag()
        if at == _RELOAD:
            return self._reload
        if at == _VALUE:
            return self._value()
        if 0xE100 <= at < 0xE200:
            return self._bits(self._enabled, at & 0x1C)
        if 0xE200 <= at < 0xE300:
            return self._bits(self._pending, at & 0x1C)
        if 0xE300 <= at < 0xE320:
            return self._bits(set(self._active), at & 0x1C)
        if 0xE400 <= at < 0xE400 + IRQS:
            return sum(self._priority.get(FIRST + at - 0xE400 + k, 0) << 8 * k for k in range(4))
        if _SHPR <= at < _SHPR + 12:
            return sum(self._priority.get(4 + at - _SHPR + k, 0) << 8 * k for k in range(4))
        if at == _ICSR:
            return (
                self.before()
                | (1 << 28 if PENDSV in self._pending else 0)
                | (1 << 26 if SYSTICK in self._pending else 0)
            )
        if at == _VTOR:
            return self.vectors
        if at == _CYCLES:
            return self._now() & 0xFFFFFFFF
        if at == 0x0:
            return 1  # ITM: there is room
        return {_CPUID: 0x412FC231, _AIRCR: 0xFA050000}.get(at, self._other.get(at, 0))

    @staticmethod
    def _bits(numbers: set[int], at: int) -> int:
        return sum(1 << n - FIRST - at * 8 for n in numbers if 0 <= n - FIRST - at * 8 < 32)

    def write(self, at: int, value: int, size: int, byte: int) -> bool:
        """`size` bytes from `byte` on, in place in 32 bits. True: a reset is asked for."""
        if at == _CONTROL:
            if value & 1 and not self._control & 1:
                self._begun, self._flagged = self._now(), 0
            self._control = value & 7
        elif at == _RELOAD:
            self._reload = value & 0xFFFFFF
        elif at == _VALUE:
            self._begun, self._flagged = self._now(), 0
        elif 0xE100 <= at < 0xE300:
            numbers = {FIRST + (at & 0x1C) * 8 + k for k in range(32) if value >> k & 1}
            which = self._enabled if at < 0xE200 else self._pending
            (which.difference_update if at & 0x80 else which.update)(numbers)
        elif 0xE400 <= at < 0xE400 + IRQS or _SHPR <= at < _SHPR + 12:
            first = FIRST + at - 0xE400 if at < _ICSR else 4 + at - _SHPR
            for k in range(byte, byte + size):
                self._priority[first + k] = value >> 8 * k & 0xFF
        elif at == _ICSR:
            for bit, number, on in ((28, PENDSV, True), (27, PENDSV, False), (26, SYSTICK, True), (25, SYSTICK, False)):
                if value >> bit & 1:
                    (self._pending.add if on else self._pending.discard)(number)
        elif at == _VTOR:
            self.vectors = value & ~0x7F
        elif at == _AIRCR:
            return bool(value & _RESET)
        else:
            self._other[at] = value
        return False
