"""Timer of a PC (8253): three channels of 1.19318 MHz, computed in closed form, channel 2 with its gate at port 61h."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

CLOCK_HZ = 1_193_182
MAX_RELOAD = 0x10000
_LATCH_COMMAND = 0
_SQUARE_WAVE_MODE = 3


@dataclass
class TimerChannel:
    """Counter channel of a PC's timer.

    Attributes:
        mode, access: Fields of the control word.
        reload: Reload value, 1 to 65536.
        started: Time at which the counter was loaded, in timer clocks.
        low: Low byte of a reload value, until the high byte has been written.
        latched: Latched count, or -1.
        half: Byte that is accessed next: 0 low, 1 high.
    """

    mode: int = _SQUARE_WAVE_MODE
    access: int = 3
    reload: int = MAX_RELOAD
    started: int = 0
    low: int = 0
    latched: int = -1
    half: int = 0

    def compute_count(self, now: int) -> int:
        """Compute the count of the timer channel, as the processor reads it.

        Args:
            now: Time in timer clocks.
        """
        passed = now - self.started
        if self.mode in (2, 6):
            return (self.reload - passed % self.reload) & 0xFFFF
        if self.mode in (3, 7):
            return (self.reload - 2 * passed % self.reload) & 0xFFFE
        return (self.reload - passed) & 0xFFFF

    def compute_output(self, now: int) -> bool:
        """Compute the level of the output pin of the timer channel.

        Args:
            now: Time in timer clocks.
        """
        passed = now - self.started
        if self.mode in (3, 7):
            return passed % self.reload < (self.reload + 1) // 2
        return passed % self.reload != self.reload - 1 if self.mode in (2, 6) else passed >= self.reload


class PcTimer:
    """Three counter channels of a PC's timer.

    Args:
        now: Function that returns the current time in timer clocks.
    """

    def __init__(self, now: Callable[[], int]):
        self._now = now
        self.channels = [TimerChannel(), TimerChannel(), TimerChannel()]
        self._gate = 0

    def find_next_zero(self) -> int:
        """Return the time at which channel 0 reaches zero next, in timer clocks."""
        c = self.channels[0]
        return c.started + ((self._now() - c.started) // c.reload + 1) * c.reload

    def read(self, port: int) -> int:
        """Read a port of the PC's timer.

        Args:
            port: 40h to 42h for the next byte of a counter, 43h, or 61h for the output of channel 2 in bit 5 and the refresh
                toggle in bit 4.
        """
        now = self._now()
        if port == 0x61:
            return self._gate | self.channels[2].compute_output(now) << 5 | (now // 18 & 1) << 4
        if port == 0x43:
            return 0xFF
        c = self.channels[port - 0x40]
        value = c.latched if c.latched >= 0 else c.compute_count(now)
        if c.access == 3:
            c.half ^= 1
            if c.half:
                return value & 0xFF
            c.latched = -1
            return value >> 8
        c.latched = -1
        return value & 0xFF if c.access == 1 else value >> 8

    def write(self, port: int, value: int) -> None:
        """Write a port of the PC's timer.

        Args:
            port: 40h to 42h for the next byte of a reload value, 43h for a control word, or 61h for the gate of channel 2.
            value: The byte.
        """
        now = self._now()
        if port == 0x61:
            if value & 1 and not self._gate & 1:
                self.channels[2].started = now
            self._gate = value & 3
        elif port == 0x43:
            if value >> 6 < 3:
                c = self.channels[value >> 6]
                if value >> 4 & 3 == _LATCH_COMMAND:
                    c.latched = c.compute_count(now)
                else:
                    c.access, c.mode, c.half, c.latched = value >> 4 & 3, value >> 1 & 7, 0, -1
        else:
            c = self.channels[port - 0x40]
            if c.access == 3 and not c.half:
                c.low, c.half = value, 1
                return
            reload = {1: value, 2: value << 8, 3: value << 8 | c.low}[c.access]
            c.reload, c.started, c.half = reload or MAX_RELOAD, now, 0
