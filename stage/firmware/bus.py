"""`Port`: a chip of the PCL-240 family as a driver's author sees it. Nothing here but bus cycles and waiting."""

from __future__ import annotations

from typing import NamedTuple

from stage.chips.pcl240 import STATUS
from stage.errors import RunTimeout
from stage.firmware.axis import Axis

RESET, SLOW_DOWN_FH1, SLOW_DOWN_FH2 = 0x08, 0x1D, 0x1F
INTERRUPT = 0x20
START = {"FL": 0x10, "FH1": 0x11, "FH2": 0x13}  # constant speed
RAMP = {"FL": 0x14, "FH1": 0x15, "FH2": 0x17}
CONTROL, SELECT, OUTPUT = 0x40, 0x80, 0xC0
ORIGIN, SD, PRESET, MINUS = 0x01, 0x02, 0x04, 0x08


class Status(NamedTuple):
    """The status byte, bit by bit, high to low; named by the register map."""

    no_int: bool
    operating: bool
    fkeep: bool
    lt: bool
    zero: bool
    sd: bool
    org: bool
    ins: bool


assert Status._fields == tuple(f.name for f in STATUS.fields)


class Port:
    """The bus of one axis' chip."""

    def __init__(self, axis: Axis):
        self.axis, self._chip = axis, axis.chip

    def command(self, value: int) -> None:
        """Write the command buffer."""
        self._chip.write(0, value)

    def write_register(self, name: str, value: int) -> None:
        """Select a register and write its bytes, high to low, so that no half-written value is below the old one for long.

        Raises ArgumentError when the data sheet does not allow the value.
        """
        r = self._chip.MAP.register(name)
        value = self._chip.MAP.checked(name, value)
        self.command(SELECT | r.number)
        for k in reversed(range((r.bits + 7) // 8)):
            self._chip.write(1 + k, value >> 8 * k & 0xFF)

    def write_registers(self, **values: int) -> None:
        for name, value in values.items():
            self.write_register(name, value)

    def status(self) -> Status:
        word = self._chip.read(0)
        return Status(*(bool(word >> k & 1) for k in range(7, -1, -1)))

    def counter(self) -> int:
        """R0, whole: high to low, then middle and high again, until they agree (data sheet Q & A)."""
        read = self._chip.read
        high, middle, low = read(3), read(2), read(1)
        while True:
            again = read(2), read(3)
            if again == (middle, high):
                return high << 16 | middle << 8 | low
            high, middle, low = read(3), read(2), read(1)

    def wait_until_stopped(self, timeout: float, poll: float = 1e-3) -> Status:
        """Poll status bit 6. Raises RunTimeout, with what the chip was doing, after `timeout` s."""
        end = self.axis.time + timeout
        while (status := self.status()).operating:
            if self.axis.time > end:
                raise RunTimeout(
                    f"axis {self.axis.name} still operates after {timeout:.3f} s: R0 = {self.counter()}, {status}. "
                    f"Give it more time, or stop it with 08h."
                )
            self.axis.wait(poll)
        return status

    def wait_until(self, test, timeout: float, poll: float = 2e-4) -> Status:
        """Poll until `test(status)` holds."""
        end = self.axis.time + timeout
        while not test(status := self.status()):
            if self.axis.time > end:
                raise RunTimeout(f"axis {self.axis.name}: status is {status} after {timeout:.3f} s.")
            self.axis.wait(poll)
        return status
