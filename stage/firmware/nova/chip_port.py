"""`ChipPort`: access to the registers of one axis of a NOVA chip by name, with bus cycles and waits only.

    port = ChipPort(axis)                    the axis of a Stage or a Bench
    port.write_parameters(SV=400, DV=8000, AC=80_000)    parameters and modes, by their names on this chip
    port.write_mode_words(WR2=..., WR3=...)
    port.write_command("DRVRL")
    port.wait_until_stopped(timeout=5)

home_search.py and path_interpolation.py use it for an MCX514, and s_curve_workarounds.py for the chips with the S-curve failure.
"""

from __future__ import annotations

from collections.abc import Callable

from stage.chips import MCX514
from stage.chips.nova import Nova
from stage.chips.nova.registers.mcx514 import MCX514_MAP as MAP
from stage.errors import ArgumentError, RunTimeout, add_article
from stage.firmware.axis import Axis, has_positive_logic

POLL_INTERVAL_S = 1e-3  # s between two looks
MCX514_LEVEL_BITS = {
    "org": ("WR2", "SP1-L"),
    "ez": ("WR2", "SP2-L"),
    "el_plus": ("WR2", "HLM-L"),
    "el_minus": ("WR2", "HLM-L"),
}
MCX300_LEVEL_BITS = {
    "org": ("WR1", "SP1-L"),
    "ez": ("WR1", "SP2-L"),
    "el_plus": ("WR2", "HLMT+"),
    "el_minus": ("WR2", "HLMT-"),
}
"""Sensor -> word and bit to set if the sensor's signal is high while it is on."""
ERROR_BITS = ("SLMT+", "SLMT-", "HLMT+", "HLMT-", "ALARM", "EMG", "HOME", "CERR")
"""Error bits of RR2; the first generation has no CERR."""


def compute_logic_bits(axis: Axis, word: str) -> int:
    """Compute the bits of WR1 or WR2 that suit the wiring of an axis.

    Args:
        axis: Axis.
        word: "WR1" or "WR2".

    Raises:
        ArgumentError: Two sensors of different logic have one bit.
    """
    map_, bits = axis.chip.MAP, 0
    levels = MCX514_LEVEL_BITS if isinstance(axis.chip, MCX514) else MCX300_LEVEL_BITS
    for sensor, (place, name) in levels.items():
        if place != word or not has_positive_logic(axis, sensor):
            continue
        others = [s for s, at in levels.items() if at == (place, name) and not has_positive_logic(axis, s)]
        if others:
            raise ArgumentError(
                f"axis {axis.name}: {sensor} is of positive logic and {others[0]} is not, and {add_article(map_.chip)} "
                "has one bit for both, "
                f"{place} {name}: give both one logic."
            )
        bits |= map_.mask(place, name)
    return bits


def compute_mcx514_wr2(axis: Axis) -> int:
    """Compute WR2 of an MCX514 with which end limits stop the axis and the logic of all sensors suits their wiring."""
    return MAP.mask("WR2", "HLM-E") | compute_logic_bits(axis, "WR2")


class ChipPort:
    """Access to the registers of one axis of a NOVA chip. Raises ArgumentError for an axis with another chip."""

    def __init__(self, axis: Axis):
        if not isinstance(getattr(axis, "chip", None), Nova):
            raise ArgumentError(
                f"{axis!r} has no chip of the NOVA family: make the stage with chips=MCX514, for example."
            )
        self.axis, self.chip, self.map = axis, axis.chip, axis.chip.MAP
        self.bit = 1 << axis.chip_axis
        self._modes = {"WR1": 0, "WR2": 0, "WR3": 0}  # the first generation cannot read them

    def write_command(self, symbol: str) -> None:
        """Write a command to the axis, or to the whole chip if the command has no axis bits."""
        c = self.map.command(symbol)
        self.chip.write(0, (self.bit << 8 if c.axes else 0) | c.code)

    def write_parameters(self, **values: int) -> None:
        """Write parameters and mode registers of a NOVA chip by name: SV, DV, TP, H1M, IPM ...

        Raises:
            ArgumentError: A name or a value is wrong; no bus cycle has been made.
        """
        for name, value in [(n, self.map.check_value(n, v)) for n, v in values.items()]:
            for cycle in self.chip.register_cycles(name, value, self.axis.chip_axis):
                self.chip.write(*cycle)

    def write_mode_words(self, **words: int) -> None:
        """Write mode words by name: WR1, WR2, WR3."""
        for name in words:
            if name not in self._modes:
                raise ArgumentError(f"{name} is no mode word of an axis: WR1, WR2, WR3 are.")
        self.write_command("NOP")
        for name, value in words.items():
            self._modes[name] = value
            self.chip.write(int(name[2]), value)

    def set_mode_bits(self, name: str, bits: int, on: bool = True) -> None:
        """Set or clear bits of a mode word (WR1 to WR3). The other bits keep the values that this port has written before.

        Args:
            name: Name of the word.
            bits: Bits to change.
            on: Whether they are set.
        """
        self.write_mode_words(**{name: self._modes[name] | bits if on else self._modes[name] & ~bits})

    def read_status_register(self, number: int) -> int:
        """Read RR1, RR2 or RR3 (page 0 on an MCX514) of the axis. Reading interrupt factors clears them."""
        self.write_command("RR3P0" if number == 3 and isinstance(self.chip, MCX514) else "NOP")
        return self.chip.read(number)

    def read_value(self, symbol: str) -> int:
        """Read a signed 32-bit value with a data reading command, for example R-LP or CV."""
        self.write_command(symbol)
        word = self.chip.read(6) | self.chip.read(7) << 16
        return word - (word >> 31 << 32)

    def read_position(self) -> int:
        """Read the logical position counter LP, pulses."""
        return self.read_value("R-LP")

    def read_speed(self) -> int:
        """Read the current speed CV, in the unit of the drive speed."""
        return self.read_value("CV")

    def is_driving(self) -> bool:
        """Read the status bit n-DRV of the NOVA chip: whether the axis drives."""
        return self.chip.busy(self.axis.chip_axis)

    def read_error_names(self) -> tuple[str, ...]:
        """Read the names of the error bits of RR2 that are set."""
        word, bits = self.read_status_register(2), {f.name: f.mask for f in self.map.word("RR2").fields}
        return tuple(name for name in ERROR_BITS if word & bits.get(name, 0))

    def start_drive(self, pulses: int) -> None:
        """Start a fixed-pulse drive of signed pulses. Raises ArgumentError for 0."""
        if pulses == 0:
            raise ArgumentError("pulses=0: a drive has at least one; its sign is the direction.")
        if isinstance(self.chip, MCX514):
            self.write_parameters(TP=pulses)
            self.write_command("DRVRL")
        else:
            self.write_parameters(P=abs(pulses))
            self.write_command("F_DRV_P" if pulses > 0 else "F_DRV_M")

    def wait_until_stopped(
        self, timeout: float, routine: Callable[[], bool] | None = None, poll: float = POLL_INTERVAL_S
    ) -> bool:
        """Wait until the axis of the NOVA chip no longer drives (n-DRV = 0).

        Args:
            timeout: Simulated seconds to wait.
            routine: Function to call before each poll, in place of a timer or an interrupt (see s_curve_workarounds.py). It returns
                whether it had to stop the drive.
            poll: Seconds between two polls.

        Returns:
            Whether a call of the routine returned True: it had to stop the drive.

        Raises:
            RunTimeout: The axis still drives after `timeout`.
        """
        until, stopped = self.axis.time + timeout, False
        while True:
            stopped |= bool(routine and routine())
            if not self.is_driving():
                return stopped
            if not self.axis.time < until:
                raise RunTimeout(
                    f"axis {self.axis.name} still drives after {timeout} s: RR1 = {self.read_status_register(1):04X}h."
                )
            self.axis.wait(poll)


def open_ports(axes: tuple[Axis, ...]) -> list[ChipPort]:
    """Open the ports of axes of one MCX514 or MCX512, in the order of the axes on the chip.

    Args:
        axes: Axes.

    Raises:
        ArgumentError: They are not different axes of one MCX514.
    """
    for axis in axes:
        if not isinstance(getattr(axis, "chip", None), MCX514):
            raise ArgumentError(f"{axis!r} has no MCX514: make the stage with chips=MCX514.")
    ports = sorted((ChipPort(axis) for axis in axes), key=lambda port: port.bit)
    if not ports or len({id(port.chip) for port in ports}) > 1 or len({port.bit for port in ports}) < len(ports):
        raise ArgumentError(f"axes {', '.join(a.name for a in axes) or 'none'}: give different axes of one MCX514.")
    return ports


def stop_axes(ports: list[ChipPort]) -> None:
    """Stop the axes of these ports at once, without a ramp."""
    for port in ports:
        port.write_command("DRVFBRK")
