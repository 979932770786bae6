"""Homing of a servo axis with an HCTL-1100: to the home switch, back out of it, then to the encoder's index pulse.

    print(home_servo(set_up_servo(stage.axes["x"])))

A stage wires both end limits to LIMIT, ORG to STOP and the index pulse to INDEX. STOP acts only in integral velocity mode, in
which it brakes the axis to rest. LIMIT acts in all modes and leads to Init/Idle, from which the host itself must drive the motor
out of the limit. INDEX goes to the commutator and cannot be read on the bus, so the host reads its line by an input of its own.

    step 1   move at the search speed until STOP triggers
    step 2   move back until STOP is released
    step 3   move to STOP again at the lowest speed, one count per sample
    step 4   move on to the beginning of the index pulse, back out of it, and towards it again count by count
    step 5   preset the actual position to 0 there, and move to 0
"""

from __future__ import annotations

from dataclasses import dataclass

from stage.chips.exclusive_access import exclusive
from stage.chips.hctl1100.maps import MODE
from stage.errors import RunTimeout
from stage.firmware.axis import check_direction
from stage.firmware.hctl1100.chip_port import CONTROL, LIMIT, STOP, ChipPort
from stage.firmware.hctl1100.moves import (
    convert_acceleration_to_register,
    convert_velocity_to_register,
    move_by_trapezoid,
    write_command_velocity,
)

LIMIT_EXIT_MOTOR_COMMAND = 15  # hundredths of full drive: out of a limit
MAX_LIMIT_EXIT_COUNTS = 4000  # counts: a limit switch is left before; two turns of the usual encoder
FAST_POLL_S = 2e-4  # s between two looks at what should be seen soon
INDEX_RETREAT_COUNTS = 60  # counts before the index pulse, from where it is sought count by count
CREEP_INTERVAL_S = 2e-3  # s for a count
MAX_INDEX_SEARCH_REVOLUTIONS = 1.2  # of the motor, within which an index pulse must come


@dataclass(frozen=True)
class ServoHomeReport:
    """Report of a home search. Counts refer to the position counter before the search.

    Attributes:
        axis: Name of the axis.
        switch: Position, counts, at which STOP triggered during the slow approach.
        index: Position, counts, at which the index pulse began; None without a search for it.
        seconds: Duration of the whole search.
        position: Position of the carriage, m (rad on a hinge); None without a carriage.
        unit: "m", or "rad" on a hinge.
    """

    axis: str
    switch: int
    index: int | None
    seconds: float
    position: float | None
    unit: str = "m"

    def __str__(self) -> str:
        index = "" if self.index is None else f", index {self.index - self.switch:+d} counts from it"
        where = "" if self.position is None else f"; at {self.position * 1e3:.4f} m{self.unit}"
        return f"{self.axis}: home found in {self.seconds:.3f} s, switch at {self.switch}{index}{where}"


@exclusive
def home_servo(
    port: ChipPort,
    direction: int = -1,
    *,
    speed: float = 8_000,
    acceleration: float = 400_000,
    index: bool = True,
    turn: int = 2000,
    deadband: int = 3,
    timeout: float = 20.0,
) -> ServoHomeReport:
    """Home the axis, which is then in position control at position 0.

    Args:
        port: Port of the axis, set up.
        direction: Direction in which the home switch lies, -1 or 1.
        speed: Speed of steps 1 and 2, counts/s.
        acceleration: Acceleration of steps 1 and 2, counts/s2; the axis needs room to brake beyond the switch.
        index: True to go on to the index pulse.
        turn: Counts of the encoder per turn.
        deadband: Counts within which the axis settles at the end.
        timeout: Simulated seconds that each step may take.

    Returns:
        The report.

    Raises:
        ArgumentError: A value is out of its range.
        RunTimeout: A step has no end, or LIMIT has ended it: the axis is then in Init/Idle.
    """
    check_direction(direction, ", where the home switch lies")
    fast, begin = abs(convert_velocity_to_register(port, speed, "integral_velocity", 1)), port.axis.time
    port.clear_status()
    port.write_quantities(acceleration=convert_acceleration_to_register(port, acceleration))
    _run_to_switch(port, direction * fast, timeout)
    _back_out_of_switch(port, -direction, speed, acceleration, turn, timeout)
    switch = _run_to_switch(port, direction, timeout)
    found = _find_index_pulse(port, direction, turn) if index else None
    set_position_origin(port, switch if found is None else found)
    move_by_trapezoid(port, -port.read_command_position(), velocity=speed, acceleration=acceleration, deadband=deadband)
    return ServoHomeReport(
        port.axis.name, switch, found, port.axis.time - begin, port.axis.position, getattr(port.axis, "unit", "m")
    )


@exclusive
def leave_limit(
    port: ChipPort,
    direction: int,
    *,
    push: int = LIMIT_EXIT_MOTOR_COMMAND,
    max_counts: int = MAX_LIMIT_EXIT_COUNTS,
    timeout: float = 2.0,
) -> None:
    """Drive an axis out of its limit switch in Init/Idle, in which the chip closes no loop; then hold its position.

    Args:
        port: Port of the axis.
        direction: Direction out of the switch, 1 or -1; the host has to know it.
        push: Motor command, hundredths of full drive.
        max_counts: Distance after which the drive ends, so that a switch that is stuck does not send the axis to its other end,
            counts.
        timeout: Simulated seconds to wait.

    Raises:
        RunTimeout: The switch is still on after `timeout` or after `max_counts`. The axis is then in Init/Idle.
    """
    port.enter_init_idle_mode()
    begin = port.read_position()
    port.write_quantities(motor_command=direction * push)

    def is_released_or_out_of_reach() -> bool:
        """Clear LIMIT if the switch is released; return whether it is, or whether the axis has moved more than `max_counts`."""
        return bool(port.clear_status() & LIMIT) or abs(port.read_position() - begin) > max_counts

    port.wait_until(is_released_or_out_of_reach, timeout, "release of the limit switch", FAST_POLL_S)
    if port.is_limit_latched():
        port.enter_init_idle_mode()
        raise RunTimeout(
            f"axis {port.axis.name}: its limit switch is still on {max_counts} counts away, at {port.read_position()} counts. Look "
            "whether it is stuck; the axis is in Init/Idle now."
        )
    port.hold_position()


def _run_to_switch(port: ChipPort, velocity: int, timeout: float) -> int:
    """Run a servo axis in integral velocity mode until STOP has triggered and it rests; return the position of the trigger."""
    port.write_quantities(integral_velocity=0)
    port.set_control_mode("integral velocity")
    if port.read_status() & STOP:
        write_command_velocity(port, velocity)
    port.wait_until(
        lambda: port.read_status() & (STOP | LIMIT) != STOP | LIMIT, timeout, "the home switch", FAST_POLL_S
    )
    _check_limit(port, "the home switch")
    at = port.read_position()
    hold_once_at_rest(port)
    return at


def _check_limit(port: ChipPort, expected_event: str) -> None:
    """Raise RunTimeout if LIMIT, the HCTL-1100's limit flag, has triggered. `expected_event` is for the message."""
    if port.is_limit_latched():
        raise RunTimeout(
            f"axis {port.axis.name}: LIMIT before {expected_event}, at {port.read_position()} counts; it is in Init/Idle now."
        )


def hold_once_at_rest(port: ChipPort) -> None:
    """Switch the HCTL-1100 to position control as soon as its command position is at rest."""
    before = port.read_command_position() - 1
    while before != (now := port.read_command_position()):
        before = now
        port.axis.wait(3 * port.sample)
    port.set_control_mode("position")


def _back_out_of_switch(
    port: ChipPort, direction: int, speed: float, acceleration: float, turn: int, timeout: float
) -> None:
    """Move back, an eighth of a turn at a time, until STOP can be cleared. The moves are trapezoids, which ignore STOP."""

    def clear_stop_or_move_back() -> bool:
        """Clear the latched STOP flag if the switch is released; otherwise move back an eighth of a turn.

        Returns:
            Whether to stop waiting: STOP is cleared, or LIMIT is latched.
        """
        if port.clear_status() & STOP:
            return True
        move_by_trapezoid(port, direction * turn // 8, velocity=speed, acceleration=acceleration, deadband=turn)
        return port.is_limit_latched()

    port.wait_until(clear_stop_or_move_back, timeout, "release of the home switch", FAST_POLL_S)
    _check_limit(port, "release of the home switch")
    move_by_trapezoid(port, direction * turn // 8, velocity=speed, acceleration=acceleration, deadband=turn)


def _find_index_pulse(port: ChipPort, direction: int, turn: int) -> int:
    """Find the index pulse, and return the position at which it begins when approached in `direction`."""
    pins = port.axis.chip.axes[port.axis.chip_axis].pins
    port.clear_status()
    max_counts = round(MAX_INDEX_SEARCH_REVOLUTIONS * turn)

    def creep(counts: int, seconds: float) -> bool:
        """Move count by count, `seconds` each, at most `counts`; return whether the index pulse has begun."""
        command, before = port.read_command_position(), pins.index
        for k in range(1, counts + 1):
            port.write_command_position(command + direction * k)
            port.axis.wait(seconds)
            if pins.index and not before:
                return True
            before = pins.index
        return False

    found = creep(max_counts, port.sample)
    if found:
        port.write_command_position(port.read_command_position() - direction * INDEX_RETREAT_COUNTS)
        port.axis.wait(INDEX_RETREAT_COUNTS * CREEP_INTERVAL_S)
        found = creep(2 * INDEX_RETREAT_COUNTS, CREEP_INTERVAL_S)
    if not found:
        port.enter_init_idle_mode()
        raise RunTimeout(
            f"axis {port.axis.name}: no index pulse within {max_counts} counts of the home switch; it is in Init/Idle now."
        )
    return port.read_position()


def set_position_origin(port: ChipPort, origin: int) -> None:
    """Subtract `origin`, counts, from the HCTL-1100's actual position, and hold the axis where it is.

    The chip allows this only in Init/Idle, so the motor is off for a few bus cycles.
    """
    port.enter_init_idle_mode()
    port.write_quantities(preset_position=port.read_position() - origin)
    port.write_quantities(command_position=port.read_position())
    port.chip.write(MODE, CONTROL)
