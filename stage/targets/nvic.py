"""Interrupt controller and SysTick of a Cortex-M: registers by their offset from E0000000h, and the choice of an exception."""

from __future__ import annotations

from collections.abc import Callable

SYSTICK, PENDSV, SVC, FIRST = 15, 14, 11, 16
IRQ_COUNT = 240
NEVER = 1 << 60
_LOWEST_PRIORITY = 256  # priority of code outside exceptions
_CONTROL, _RELOAD, _VALUE, _CALIBRATION = 0xE010, 0xE014, 0xE018, 0xE01C
_ICSR, _VTOR, _AIRCR, _SHPR, _CPUID, _CYCLES = 0xED04, 0xED08, 0xED0C, 0xED18, 0xED00, 0x1004
_STIMULUS_PORT = 0  # stimulus port of ITM; reads as 1: there is room
_SYSRESETREQ = 4


class Nvic:
    """Interrupt controller (NVIC) and SysTick.

    Args:
        now: Function that returns the number of clock cycles that the processor has run.
        irq: Number of the interrupt to which the board's line is wired, or None.

    Attributes:
        level: Whether the board asserts its interrupt line.
        vectors: Address of the vector table.
    """

    def __init__(self, now: Callable[[], int], irq: int | None):
        self._now, self._irq = now, irq
        self.vectors = 0
        self.level = False
        self._enabled: set[int] = set()
        self._pending: set[int] = set()
        self._active: list[int] = []
        self._priority: dict[int, int] = {}
        self._control, self._reload, self._started, self._flagged = 0, 0, 0, 0
        self._other: dict[int, int] = {}

    # --- exceptions ---

    def find_next_exception(self, primask: int, basepri: int) -> int | None:
        """Return the number of the exception that the processor takes now, or None if it takes none.

        Args:
            primask: Register PRIMASK of the processor.
            basepri: Register BASEPRI of the processor.
        """
        if primask & 1 or not (candidates := self._list_pending_exceptions()):
            return None
        priority, number = min((self._priority.get(n, 0), n) for n in candidates)
        return None if priority >= self._get_active_priority() or (basepri and priority >= basepri) else number

    def _list_waiting_exceptions(self) -> set[int]:
        """Return the exceptions, other than that of the board's interrupt line, that are pending and enabled."""
        return {n for n in self._pending if n < FIRST or n in self._enabled}

    def _list_pending_exceptions(self) -> set[int]:
        """Return all exceptions that are pending and enabled, including that of the board's interrupt line."""
        line = FIRST + self._irq if self._irq is not None else None
        may_come = self.level and line in self._enabled and line not in self._active
        return self._list_waiting_exceptions() | ({line} if line is not None and may_come else set())

    def _get_active_priority(self) -> int:
        """Return the highest priority (lowest number) of the active exceptions."""
        return min((self._priority.get(n, 0) for n in self._active), default=_LOWEST_PRIORITY)

    def enter_exception(self, number: int) -> None:
        """Mark an exception as active: its routine begins.

        Args:
            number: Number of the exception.
        """
        self._pending.discard(number)
        self._active.append(number)

    def leave_exception(self, number: int) -> None:
        """Mark an exception as no longer active: its routine has returned.

        Args:
            number: Number of the exception.
        """
        if number in self._active:
            self._active.remove(number)

    def get_active_exception(self) -> int:
        """Return the exception whose routine is running, or 0."""
        return self._active[-1] if self._active else 0

    def has_waiting_exception(self) -> bool:
        """Tell whether an exception other than that of the board's line is pending and has a sufficient priority."""
        return (
            min((self._priority.get(n, 0) for n in self._list_waiting_exceptions()), default=_LOWEST_PRIORITY)
            < self._get_active_priority()
        )

    def can_line_interrupt(self) -> bool:
        """Tell whether the interrupt of the board's line is enabled and has a higher priority than the running routine."""
        if self._irq is None or FIRST + self._irq not in self._enabled or FIRST + self._irq in self._active:
            return False
        return self._priority.get(FIRST + self._irq, 0) < self._get_active_priority()

    # --- SysTick ---

    def is_systick_running(self) -> bool:
        """Tell whether SysTick counts and may interrupt."""
        return self._control & 3 == 3 and self._reload > 0

    def find_next_systick_cycle(self) -> int:
        """Return the cycle of the processor at which SysTick interrupts next, or NEVER."""
        if not self.is_systick_running():
            return NEVER
        return self._started + ((self._now() - self._started) // (self._reload + 1) + 1) * (self._reload + 1)

    def pend_systick(self) -> None:
        """Pend SysTick: its counter has reached zero."""
        if self.is_systick_running():
            self._pending.add(SYSTICK)

    def _read_systick_count(self) -> int:
        """Return the current count of SysTick."""
        if not self._control & 1:
            return 0
        return self._reload - (self._now() - self._started) % (self._reload + 1)

    def _read_and_clear_countflag(self) -> int:
        """Read and clear COUNTFLAG: whether the counter has reached zero since the last read."""
        if not self._control & 1 or not self._reload:
            return 0
        rounds = (self._now() - self._started) // (self._reload + 1)
        set_, self._flagged = rounds > self._flagged, rounds
        return int(set_) << 16

    # --- registers ---

    def read(self, offset: int) -> int:
        """Return a register of 32 bits, of the interrupt controller, SysTick or another part of the Cortex-M.

        Args:
            offset: Offset of the register from E0000000h, a multiple of 4.
        """
        values = {_RELOAD: self._reload, _VTOR: self.vectors, _CPUID: 0x412FC231, _AIRCR: 0xFA050000, _STIMULUS_PORT: 1}
        if offset == _CONTROL:
            return self._control | self._read_and_clear_countflag()
        if offset == _VALUE:
            return self._read_systick_count()
        if offset == _ICSR:
            return self.get_active_exception() | (PENDSV in self._pending) << 28 | (SYSTICK in self._pending) << 26
        if offset == _CYCLES:
            return self._now() & 0xFFFFFFFF
        for begin, end, numbers in (
            (0xE100, 0xE200, self._enabled), (0xE200, 0xE300, self._pending), (0xE300, 0xE320, self._active),
        ):  # fmt: skip
            if begin <= offset < end:
                return self._pack_register_bits(set(numbers), offset & 0x1C)
        if (first := self._find_first_exception(offset)) is not None:
            return sum(self._priority.get(first + k, 0) << 8 * k for k in range(4))
        return values.get(offset, self._other.get(offset, 0))

    @staticmethod
    def _find_first_exception(offset: int) -> int | None:
        """Return the first exception whose priority a register contains, or None."""
        if 0xE400 <= offset < 0xE400 + IRQ_COUNT:
            return FIRST + offset - 0xE400
        return 4 + offset - _SHPR if _SHPR <= offset < _SHPR + 12 else None

    @staticmethod
    def _pack_register_bits(numbers: set[int], offset: int) -> int:
        """Return a 32-bit register with a bit for each exception in `numbers`, for the register at offset `offset` of its group."""
        return sum(1 << n - FIRST - offset * 8 for n in numbers if 0 <= n - FIRST - offset * 8 < 32)

    def write(self, offset: int, value: int, size: int, byte: int) -> bool:
        """Write a register of the interrupt controller, SysTick or another part of the Cortex-M.

        Args:
            offset: Offset of the register.
            value: Written bytes at their position in 32 bits.
            size: Number of written bytes.
            byte: Index of the first written byte.

        Returns:
            Whether the program requests a reset.
        """
        if offset in (_CONTROL, _RELOAD, _VALUE):
            self._write_systick(offset, value)
        elif 0xE100 <= offset < 0xE300:
            numbers = {FIRST + (offset & 0x1C) * 8 + k for k in range(32) if value >> k & 1}
            which = self._enabled if offset < 0xE200 else self._pending
            (which.difference_update if offset & 0x80 else which.update)(numbers)
        elif (first := self._find_first_exception(offset)) is not None:
            for k in range(byte, byte + size):
                self._priority[first + k] = value >> 8 * k & 0xFF
        elif offset == _ICSR:
            for bit, number, on in ((28, PENDSV, True), (27, PENDSV, False), (26, SYSTICK, True), (25, SYSTICK, False)):
                if value >> bit & 1:
                    (self._pending.add if on else self._pending.discard)(number)
        elif offset == _VTOR:
            self.vectors = value & ~0x7F
        elif offset == _AIRCR:
            return bool(value & _SYSRESETREQ)
        else:
            self._other[offset] = value
        return False

    def _write_systick(self, offset: int, value: int) -> None:
        """Write a register of SysTick."""
        if offset == _RELOAD:
            self._reload = value & 0xFFFFFF
            return
        if offset == _VALUE or (value & 1 and not self._control & 1):
            self._started, self._flagged = self._now(), 0
        if offset == _CONTROL:
            self._control = value & 7
