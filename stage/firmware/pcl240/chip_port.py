"""`ChipPort`: access to the registers and commands of a PCL-240 chip, with bus cycles and waits only.

port = ChipPort(axis)                      the axis of a Stage or a Bench
port.write_registers(R0=2000, R6=300)
port.write_command(CONTROL | PRESET)
port.write_command(RAMP_START_COMMANDS["FH1"])
port.wait_until_stopped(timeout=5)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from stage.chips import Chip
from stage.chips.pcl240 import PCL240, STATUS
from stage.chips.pcl240 import state as bits
from stage.chips.pcl240.maps import CONTROL, OUTPUT, SELECT
from stage.chips.pcl240.state import (
    AUTOMATIC,
    COLLECTIVE,
    EXTENSION,
    EXTERNAL,
    EZ_SIGNAL,
    MINUS,
    ORIGIN,
    POSITION,
    PRESET,
    SD,
    UNCORRECTED,
)
from stage.errors import ArgumentError, RunTimeout, StageError, add_article
from stage.firmware.axis import Axis
from stage.firmware.driver import compute_poll_interval
from stage.support.argument_checks import explain_constructor

START = {"FL": bits.START | bits.FL, "FH1": bits.START | bits.FH1, "FH2": bits.START | bits.FH2}  # constant speed
RAMP_START_COMMANDS = {name: start | bits.RAMP for name, start in START.items()}
RESET = bits.STOP
SLOW_DOWN = {name: bits.STOP | ramp for name, ramp in RAMP_START_COMMANDS.items()}  # decelerating stop
STOP_INTERRUPT_BIT = bits.INT_AT_STOP

__all__ = [
    "AUTOMATIC", "COLLECTIVE", "CONTROL", "EXTENSION", "EXTERNAL", "EZ_SIGNAL", "STOP_INTERRUPT_BIT", "MINUS", "ORIGIN",
    "ChipPort", "OUTPUT", "POSITION", "PRESET", "RAMP_START_COMMANDS", "RESET", "SD", "SELECT", "SLOW_DOWN", "START", "Status",
    "UNCORRECTED", "describe_leader", "encode_index_pulse_number", "explain_missing_pulses", "has_ez_monitor", "require_clock",
]  # fmt: skip

POLL_INTERVAL_S = 1e-3  # s between two looks at the status byte of a run that takes long
FAST_POLL_S = 2e-4  # s, where a command follows at once
MAX_COUNTER_READS = 100  # tries to read a counter that changes


MIN_MULTIPLIER = 2
"""Smallest R7 with which the chip makes a clock."""


def describe_leader(axis: Axis) -> str:
    """Describe the chip whose clock the axis' chip receives, for example "axis x"."""
    leader = getattr(axis.chip, "syni", None)
    axes: Any = getattr(getattr(axis, "stage", None), "axes", {})
    return next((f"axis {name}" for name, other in axes.items() if other.chip is leader), "another chip")


def read_leader_multiplier(axis: Axis) -> int | None:
    """Return the R7 of the leader whose clock the axis' chip receives at SYNI; None if the chip uses its own clock.

    The R7 of a chip that uses another chip's clock has no effect, so its rates depend on the leader's R7.
    """
    leader = getattr(axis.chip, "syni", None)
    return None if leader is None else int(leader.state["reg"][7])


def require_clock(axis: Axis) -> int | None:
    """Check that the axis' chip has a clock, and return the R7 of its leader, see `read_leader_multiplier`.

    Raises:
        StageError: The leader outputs no clock.
    """
    multiplier = read_leader_multiplier(axis)
    if multiplier is not None and multiplier < MIN_MULTIPLIER:
        raise StageError(f"axis {axis.name} makes no pulses: {explain_missing_pulses(axis)}")
    return multiplier


def explain_missing_pulses(axis: Axis) -> str:
    """Explain why the axis' chip cannot make pulses now; "" if it has a clock."""
    multiplier = read_leader_multiplier(axis)
    if multiplier is not None and multiplier < MIN_MULTIPLIER:
        leader = describe_leader(axis)
        return (
            f"its chip counts the clock of {leader} (SYNI), whose R7 is {multiplier}, and R7 = 2 to 1023 make a clock. "
            f"Write the R7 of {leader}, move both together, or disconnect SYNI."
        )
    if multiplier is None and (own := int(axis.chip.state["reg"][7])) < MIN_MULTIPLIER:
        return f"its R7 is {own}, and R7 = 2 to 1023 make a clock. Write R7."
    return ""


def check_chip_family(axis: Any) -> type[PCL240]:
    """Return the class of the axis' chip.

    Args:
        axis: Axis to check.

    Raises:
        ArgumentError: `axis` is no axis, or its chip is not of the PCL-240 family.
    """
    chip = getattr(axis, "chip", None)
    if not isinstance(chip, Chip):
        raise ArgumentError(f"{axis!r} is no axis: give stage.axes['x'], or Bench(x=PCL240K()).axes['x'].")
    if not isinstance(chip, PCL240):
        raise ArgumentError(
            f"axis {axis.name} has {add_article(chip.MAP.chip)}; these procedures speak to the PCL-240 family, stage.firmware.nova "
            "and stage.firmware.hctl1100 to others."
        )
    return type(chip)


POLARITY_FIELDS = {"org": ("R13", "org_logic"), "ez": ("R12", "ez_logic")}
"""Sensor -> register and field to set if the sensor's signal is high while it is on."""


class Status(NamedTuple):
    """Bits of the status byte, from the highest to the lowest, with the names of the register map."""

    no_int: bool
    operating: bool
    fkeep: bool
    lt: bool
    zero: bool
    sd: bool
    org: bool
    ins: bool

    def __str__(self) -> str:
        """Describe the status in words, for example `at constant speed, R0 < R6`."""
        doing = "halted" if not self.operating else "at constant speed" if self.fkeep else "ramping up or down"
        words = {
            "R0 = 0": self.zero,
            "R0 < R6": self.lt,
            "SD": self.sd,
            "ORG": self.org,
            "/INT pending": not self.no_int,
        }
        return ", ".join([doing, *(word for word, on in words.items() if on)])


assert Status._fields == tuple(f.name for f in STATUS.fields)
_STATUS_BY_BYTE = [Status(*(bool(word >> k & 1) for k in range(7, -1, -1))) for word in range(256)]  # firmware polls it


def compute_polarity_bits(axis: Axis) -> dict[str, int]:
    """Compute the bits of R12 and R13 that suit the wiring of an axis.

    Args:
        axis: Axis.

    Returns:
        Bits by the names of the registers.

    Raises:
        ArgumentError: The chip does not support the logic of a sensor.
    """
    bits: dict[str, int] = {}
    for sensor in getattr(axis, "wiring", {}):
        map_ = axis.chip.MAP
        name, field = POLARITY_FIELDS.get(sensor, ("", ""))
        register = next((r for r in map_.registers if r.name == name), None)
        if register is None or field not in (f.name for f in register.fields):
            able = {"org": "; a PCL240MS can", "ez": "; a PCL240MK or PCL240MS can"}.get(sensor, "")
            raise ArgumentError(
                f"axis {axis.name}: {sensor} is of positive logic, and {add_article(map_.chip)} cannot read it so{able}. "
                "Wire a sensor of negative logic, or an inverter."
            )
        bits[name] = bits.get(name, 0) | map_.mask(name, field)
    return bits


def encode_index_pulse_number(ez: int) -> int:
    """Return the bits of R13 with which an origin return ends at the ez-th index pulse after ORG, at FL."""
    return bits.EZ_RETURN | bits.EZ_FROM_FL | (ez - 1) << bits.EZ_COUNT


def has_ez_monitor(chip: Chip | type[Chip]) -> bool:
    """Return whether R17 of a chip shows the EZ input, as on the PCL-240MS."""
    return any(f.name == "ez" for f in chip.MAP.register("R17").fields)


@explain_constructor
class ChipPort:
    """Access to the registers and commands of the PCL-240 that drives one axis.

    Args:
        axis: Axis of a stage or a bench, whose chip is of the PCL-240 family.
    """

    def __init__(self, axis: Axis):
        self.axis, self._chip = axis, axis.chip
        self.extended = bool(getattr(axis.chip, "EXTENDED", False))
        self._output = OUTPUT

    def write_command(self, value: int) -> None:
        """Write a byte to the command buffer, address 0 of the PCL-240."""
        if value & bits.GROUP == OUTPUT:
            self._output = value
        self._chip.write(0, value)

    def write_control_mode(self, bits: int) -> None:
        """Write the control mode; on PCL-240MK and MS together with the bit that makes the position counter R10 count."""
        self.write_command(CONTROL | bits | (POSITION if self.extended else 0))

    def write_register(self, name: str, value: int) -> None:
        """Select a register of the PCL-240 and write its bytes.

        Args:
            name: Name of the register.
            value: Value to write.

        Raises:
            ArgumentError: The data sheet does not allow the value.
        """
        for cycle in self._chip.register_cycles(name, self._chip.MAP.check_value(name, value)):
            self._chip.write(*cycle)

    def write_registers(self, **values: int) -> None:
        """Write registers of the PCL-240 by name in the order of the arguments, after a check of all values."""
        for name, value in values.items():
            self._chip.MAP.check_value(name, value)
        for name, value in values.items():
            self.write_register(name, value)

    def read_status(self) -> Status:
        """Read the status byte of the PCL-240 by one bus cycle."""
        return _STATUS_BY_BYTE[self._chip.read(0)]

    def read_counter(self) -> int:
        """Read all bytes of R0, the down counter, from high to low, and repeat the reads until they agree (data sheet Q & A).

        Raises:
            StageError: The bytes never agree, because the bus is too slow for the pulse rate.
        """
        read = self._chip.read
        for _ in range(MAX_COUNTER_READS):
            high, middle, low = read(3), read(2), read(1)
            if (read(2), read(3)) == (middle, high):
                return high << 16 | middle << 8 | low
        raise StageError(
            f"axis {self.axis.name}: the counter's bytes did not agree in {MAX_COUNTER_READS} reads: "
            "the bus is too slow to read it in motion."
        )

    def read_register(self, name: str) -> int:
        """Read all bytes of a register on MK and MS, by extension mode and a collective read.

        Args:
            name: Name of the register.

        Returns:
            Value of the register.

        Raises:
            StageError: The chip can read only R0.
        """
        if not self.extended:
            raise StageError(
                f"axis {self.axis.name}: {add_article(self._chip.MAP.chip)} reads R0 only (ChipPort.read_counter)."
            )
        output = self._output
        self.write_command(output | EXTENSION)
        self.write_command(SELECT | COLLECTIVE | self._chip.MAP.register(name).number)
        high, middle, low = (self._chip.read(a) for a in (3, 2, 1))
        self.write_command(SELECT)
        self.write_command(output)
        return high << 16 | middle << 8 | low

    def read_position(self) -> int:
        """Read R10, the position counter of MK and MS: signed pulses since the last write to it. An origin return writes 0."""
        raw = self.read_register("R10")
        return raw - (1 << 24) if raw & 1 << 23 else raw

    def wait_until_stopped(self, timeout: float, poll: float = POLL_INTERVAL_S) -> Status:
        """Poll status bit 6 until the chip has stopped: every `poll` seconds at first, more rarely later (`compute_poll_interval`).

        Args:
            timeout: Simulated seconds to wait.
            poll: Seconds between two polls at first.

        Returns:
            The last status.

        Raises:
            RunTimeout: The chip still moved after `timeout`; the message says what it was doing.
        """
        return self.wait_until(lambda s: not s.operating, timeout, poll, "it to stop")

    def wait_until(
        self,
        condition: Callable[[Status], bool],
        timeout: float,
        poll: float = FAST_POLL_S,
        expected_event: str = "a change",
    ) -> Status:
        """Poll the PCL-240 until a test of its status is met.

        Args:
            condition: Function of the status that returns whether the test is met.
            timeout: Simulated seconds to wait.
            poll: Seconds between two polls at first.
            expected_event: Description of the expected change, for the error.

        Returns:
            The status that met the test.

        Raises:
            RunTimeout: The test was not met after `timeout`; the message says what the chip was doing.
        """
        begin = self.axis.time
        while not condition(status := self.read_status()):
            passed = self.axis.time - begin
            if not passed < timeout:
                still = "still operates" if status.operating else "has stopped"
                raise RunTimeout(
                    f"axis {self.axis.name} {still} after {timeout:.3f} s (waiting for {expected_event}): "
                    f"R0 = {self.read_counter()}, {status}. "
                    f"{explain_missing_pulses(self.axis) or 'Give it more time, or stop it with 08h.'}"
                )
            self.axis.wait(min(compute_poll_interval(poll, passed), timeout - passed + 1e-6))
        return status
