"""`UartWiring`: the UARTs of axes' chips at the serial lines of a host's firmware, and the signs that they are wired wrongly."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

from stage.board.pin_assignment import UART_LINE, PinWiring, WiringFinding, name_serial_line
from stage.board.uart_wire import UartWire
from stage.errors import ArgumentError

MAX_SEARCHED = 4096
"""Bytes of a line in which datagrams are searched."""

if TYPE_CHECKING:
    from stage.board.native_host import Host


class ConnectedLine(NamedTuple):
    """A serial line of the firmware with UARTs at its other end.

    Attributes:
        number: Number of the line.
        axes: Names of the axes.
        wire: The wire.
    """

    number: int
    axes: tuple[str, ...]
    wire: UartWire


class UartWiring:
    """UARTs of axes' chips at the serial lines of a host's firmware.

    Args:
        host: The host.
        wiring: Lines of axes at its pins and serial lines.

    Raises:
        ArgumentError: The firmware does not have one of the serial lines.
    """

    def __init__(self, host: Host, wiring: PinWiring):
        self._host = host
        self._present = host.board.serial_lines.list_present(host.SERIAL_LINES)
        self._chips: dict[str, Any] = {name: axis.chip for name, axis in host.board.stage.axes.items()}
        self._lines = [self._connect(number, axes) for number, axes in wiring.uarts]
        self._unconnected = [axis for axis, name in wiring.unconnected if name == UART_LINE]
        self._free = [k for k in self._present if k not in dict(wiring.uarts)]
        for number in self._free if self._lines or self._unconnected else ():
            host.get_serial_port(number)  # so that what the firmware sends over it is kept

    def _connect(self, number: int, axes: tuple[str, ...]) -> ConnectedLine:
        """Connect the UARTs of axes to a serial line. Raises ArgumentError."""
        if number not in self._present:
            names = ", ".join(map(name_serial_line, self._present))
            raise ArgumentError(
                f"--pins {axes[0]}.uart={name_serial_line(number)}: the serial lines of {self._host.path.name} are {names}. "
                "Choose one of them."
            )
        read_byte_ns = self._host.board.serial_lines.lines[number].get_byte_time_ns
        wire = UartWire([self._chips[axis].uart for axis in axes], read_byte_ns)
        self._host.get_serial_port(number).connect(wire)
        return ConnectedLine(number, axes, wire)

    def find_wiring_findings(self) -> tuple[WiringFinding, ...]:
        """Return the signs that UARTs are at the wrong serial lines, or have addresses that do not fit."""
        return (*self._find_equal_addresses(), *self._find_unaddressed_chips(), *self._find_unconnected_uarts())

    def _find_equal_addresses(self) -> Iterator[WiringFinding]:
        """Yield a problem for each wire on which several chips have replied at once."""
        for _, axes, wire in self._lines:
            if wire.collisions:
                addresses = Counter(self._chips[axis].uart.address for axis in axes)
                equal = [axis for axis in axes if addresses[self._chips[axis].uart.address] > 1] or axes
                text = (
                    f"The chips of {', '.join(equal)} reply at once over their UART: give each another address, or another "
                    f"serial line. {self._chips[equal[0]].uart.address_rule}"
                )
                yield WiringFinding("", text)

    def _find_unaddressed_chips(self) -> Iterator[WiringFinding]:
        """Yield a finding for each chip that has understood nothing of what the firmware has sent over any serial line."""
        ports = self._host.get_open_serial_ports()
        for number, axes, wire in self._lines:
            name, sent = name_serial_line(number), ports[number].received
            for axis in (axis for axis, known in zip(axes, wire.has_understood, strict=True) if not known):
                uart, place = self._chips[axis].uart, self._find_line_of_datagrams(axis)
                if sent:
                    text = f"The chip of {axis} understood nothing of the {sent:,} bytes that the program sent over {name}."
                    cure = f"Its address is {uart.address}, and its diagnostics say more. {uart.address_rule}"
                else:
                    text = f"The program never sent a byte over {name}, where the UART of {axis} is."
                    cure = f"If it has nothing to say to {axis}, leave {axis}.uart out."
                if place:
                    cure = f"It sends datagrams over {place}, where nothing is: write {axis}.uart={place}."
                is_needed = self._has_moved(axis) or not any(wire.has_understood)
                yield WiringFinding(axis, f"{text} {cure}", is_problem=bool(place or (sent and is_needed)))

    def _has_moved(self, axis: str) -> bool:
        """Return whether the firmware has moved an axis."""
        chip_axis = self._host.board.stage.axes[axis].chip_axis
        return self._chips[axis].net(chip_axis) != 0

    def _find_unconnected_uarts(self) -> Iterator[WiringFinding]:
        """Yield a finding if the firmware sends over lines where nothing is, and chips have UARTs at no line.

        It is a problem if one of the chips would understand what is sent.
        """
        sent = self._list_lost_bytes()
        for axis in self._unconnected:
            understood = self._find_line_of_datagrams(axis)
            name = understood or next((name_serial_line(k) for k in sent if k > 0), "")
            if name:
                text = (
                    f"The program sends {'datagrams' if understood else 'bytes'} over {name}, where nothing is, and the chip of "
                    f"{axis} has a UART: write {axis}.uart={name}, or {axis}.uart=none if {name} leads elsewhere."
                )
                yield WiringFinding(axis, text, is_problem=bool(understood))

    def _list_lost_bytes(self) -> dict[int, bytes]:
        """Return what the firmware has sent over serial lines where nothing is and nobody reads, by the number of the line."""
        ports = self._host.get_open_serial_ports()
        free = {k: ports[k] for k in self._free if k in ports and not ports[k].is_connected}
        return {k: port.unread[:MAX_SEARCHED] for k, port in free.items() if port.unread}

    def _find_line_of_datagrams(self, axis: str) -> str:
        """Return the name of a serial line where nothing is and over which the firmware has sent datagrams for a chip, or ""."""
        uart = self._chips[axis].uart
        lines = (k for k, content in self._list_lost_bytes().items() if uart.contains_datagram(content))
        return next(map(name_serial_line, lines), "")
