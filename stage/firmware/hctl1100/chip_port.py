"""`ChipPort`: access to the registers of one axis' HCTL-1100 by name, with bus cycles and waits only.

port = ChipPort(stage.axes["x"])
port.write_quantities(gain=0x40, zero=0xE5, pole=0x40, timer=0x40)
port.hold_position()                               position control at the present position of the shaft
port.write_command_position(port.read_position() + 100)       in the safe part of a sample
"""

from __future__ import annotations

from collections.abc import Callable

from stage.chips import HCTL1100
from stage.chips.hctl1100.maps import (
    ACCELERATION,
    ACTUAL_POSITION,
    ACTUAL_VELOCITY,
    COMMAND_POSITION,
    FINAL_POSITION,
    FLAG,
    FLAG_WRITE,
    INTEGRAL_VELOCITY,
    MAP,
    MINIMUM_T,
    MODE,
    MODE_WRITE,
    NUMBERS,
    STATUS,
    TIMER,
    RegisterQuantity,
    find_reset_value,
)
from stage.chips.hctl1100.state import to_signed
from stage.errors import ArgumentError, RunTimeout, unknown_name_error
from stage.firmware.axis import Axis

POLL_INTERVAL_S = 1e-3  # s between two looks
RESET, IDLE, ALIGN, CONTROL = (
    MODE_WRITE.fields[0].find_code(mode) for mode in ("reset", "Init/Idle", "Align", "control")
)
SET_FLAG_BIT = FLAG_WRITE.fields[0].find_code("set")
MODE_FLAGS = {
    mode: MAP.bit("R00", flag)
    for mode, flag in (("trapezoid", "f0"), ("proportional velocity", "f3"), ("integral velocity", "f5"))
}
"""Flag of each control mode except position control, which has none."""
LIMIT, STOP, INIT, PROFILE = MAP.masks("R07", "limit", "stop", "init", "profile")
SAFE_MARGIN_COUNTS = 3  # counts of the timer: so long before the sample's end no command is begun
MAX_TIMER_READS = 8  # at the timer, one after the other; two or three are enough


class ChipPort:
    """Bus port of one axis' chip. It keeps the sample timer (T, R0F), the only register that cannot be read back.

    Raises:
        ArgumentError: The axis' chip is no HCTL-1100.
    """

    def __init__(self, axis: Axis):
        if not isinstance(getattr(axis, "chip", None), HCTL1100):
            raise ArgumentError(f"{axis!r} has no HCTL1100: make the stage with chips=HCTL1100.")
        self.axis, self.chip, self.t = axis, axis.chip, find_reset_value("timer")

    @property
    def timer_count_s(self) -> float:
        """Duration of one count of the HCTL-1100's sample timer, s."""
        return 16 / self.chip.clock_hz

    @property
    def sample(self) -> float:
        """Sample time of the HCTL-1100, s: from one execution of its control law to the next."""
        return self.timer_count_s * (self.t + 1)

    def write_quantities(self, **values: int) -> None:
        """Write values of the HCTL-1100 by name (NUMBERS of the chip's maps), after a check of all values.

        Raises:
            ArgumentError: A name is unknown, or a value does not fit; no bus cycle has been made.
        """
        for name, value in values.items():
            number = NUMBERS.get(name)
            if number is None:
                raise ArgumentError(f"{name} is nothing to load: {', '.join(NUMBERS)}.")
            if not number.minimum <= value <= number.maximum or int(value) != value:
                raise ArgumentError(f"{name}={value!r}: a whole number from {number.minimum} to {number.maximum}.")
        for name, value in values.items():
            for cycle in self.chip.register_cycles(name, value):
                self.chip.write(*cycle)
        self.t = values.get("timer", self.t)

    def _read(self, number: RegisterQuantity) -> int:
        """Read a signed number from the HCTL-1100's registers, low byte first."""
        value = sum(self.chip.read(a) << number.get_shift(a) for a in reversed(number.addresses))
        return to_signed(value, 8 * len(number.addresses))

    def read_position(self) -> int:
        """Read the actual position, counts."""
        return self._read(ACTUAL_POSITION)

    def read_command_position(self) -> int:
        """Read the command position, counts. Its bytes have no latch, so read it only at rest or at low speed."""
        return self._read(COMMAND_POSITION)

    def read_command_velocity(self) -> int:
        """Read the command velocity of integral velocity mode, counts per sample."""
        return to_signed(self.chip.read(INTEGRAL_VELOCITY), 8)

    def read_final_position(self) -> int:
        """Read the position at which the latest trapezoid ends, counts."""
        return self._read(FINAL_POSITION)

    def read_acceleration(self) -> float:
        """Read the acceleration of trapezoids and integral velocity mode, counts per sample squared."""
        return self._read(ACCELERATION) / ACCELERATION.scale

    def read_velocity(self) -> int:
        """Read the actual velocity, counts per sample. The chip measures it only in proportional velocity mode."""
        return self._read(ACTUAL_VELOCITY)

    def read_status(self) -> int:
        """Read the status register R07; LIMIT, STOP, INIT and PROFILE are masks of its bits."""
        return self.chip.read(STATUS)

    def clear_status(self) -> int:
        """Clear the latched bits of inputs that are released again, and return R07."""
        self.chip.write(STATUS, self.chip.read(STATUS) & MAP.register("R07").writable)
        return self.read_status()

    def read_control_mode(self) -> str:
        """Read the active control mode, a name of `set_control_mode`; "" in Init/Idle."""
        flags = self.chip.read(FLAG)
        if flags >> MAP.bit("R00", "f1") & 1:
            return ""
        return next((name for name, flag in MODE_FLAGS.items() if flags >> flag & 1), "position")

    def enter_init_idle_mode(self) -> None:
        """Write the chip's mode Init/Idle, in which the motor command is 0 and no loop is closed."""
        self.chip.write(MODE, IDLE)

    def set_control_mode(self, name: str) -> None:
        """Set the flag of a control mode of the HCTL-1100 ("position" has none), and wait until the sample in progress ends.

        The chip needs longer to compute a sample if it also computes a profile.

        Args:
            name: Name of the control mode.

        Raises:
            ArgumentError: MINIMUM_T has no such name.
        """
        if name not in MINIMUM_T:
            raise unknown_name_error("control mode", name, MINIMUM_T)
        self._set_flags(name)
        self.axis.wait(self.sample)

    def _set_flags(self, name: str) -> None:
        """Set the flag of a control mode of the HCTL-1100, and clear those of the other modes."""
        for flag in MODE_FLAGS.values():
            if flag != MODE_FLAGS.get(name):
                self.chip.write(FLAG, flag)
        if name != "position":
            self.chip.write(FLAG, SET_FLAG_BIT | MODE_FLAGS[name])

    def hold_position(self) -> None:
        """Switch from any mode to position control at the present position.

        The chip ignores this while LIMIT is latched, see `is_limit_latched`.
        """
        self.enter_init_idle_mode()
        self._set_flags("position")
        self.write_quantities(command_position=self.read_position())
        self.chip.write(MODE, CONTROL)

    def is_limit_latched(self) -> bool:
        """Return whether the flag LIMIT is latched; it keeps the chip in the mode Init/Idle."""
        return not self.read_status() & LIMIT

    def wait_for_safe_part_of_sample(self, mode: str = "position") -> None:
        """Wait for the safe part of a sample: the HCTL-1100 has computed it, and it does not end at once.

        Args:
            mode: Control mode, which determines how long the computation takes.

        Raises:
            ArgumentError: T is too short for a safe part, or differs from the T that this port has stored.
        """
        least = MINIMUM_T[mode]
        if self.t < least + SAFE_MARGIN_COUNTS:
            raise ArgumentError(
                f"axis {self.axis.name}: T = {self.t} leaves no time in a sample for commands of {mode} control: load "
                f"{least + SAFE_MARGIN_COUNTS} or more."
            )
        for _ in range(MAX_TIMER_READS):
            left = self.chip.read(TIMER)
            if self.t - left < least:
                self.axis.wait((least - self.t + left) * self.timer_count_s)
            elif left < SAFE_MARGIN_COUNTS:
                self.axis.wait((left + 1 + least) * self.timer_count_s)
            else:
                return
        raise ArgumentError(
            f"axis {self.axis.name}: its timer never shows the safe part of T = {self.t}. T cannot be read back: load timer= by "
            "this port, or take the port that has loaded it."
        )

    def write_command_position(self, position: int) -> None:
        """Write a new command position, counts, in the safe part of a sample."""
        self.wait_for_safe_part_of_sample()
        self.write_quantities(command_position=position)

    def wait_until(
        self, condition: Callable[[], bool], timeout: float, expected_event: str, poll: float = POLL_INTERVAL_S
    ) -> float:
        """Poll the HCTL-1100 until a condition holds.

        Args:
            condition: Function that returns whether the condition holds.
            timeout: Simulated seconds to wait.
            expected_event: Description of the expected change, for the error.
            poll: Seconds between two polls.

        Returns:
            Seconds until the condition held.

        Raises:
            RunTimeout: The condition did not hold in time. The axis is then in Init/Idle, without a motor command.
        """
        begin = self.axis.time
        while not condition():
            if not self.axis.time - begin < timeout:
                state = f"at {self.read_position()} counts, R07 = {self.read_status():02X}h"
                self.enter_init_idle_mode()
                raise RunTimeout(
                    f"axis {self.axis.name}: {expected_event} did not come in {timeout:g} s; it was {state} and is in "
                    "Init/Idle now."
                )
            self.axis.wait(poll)
        return self.axis.time - begin
