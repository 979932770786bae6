"""Home of a servo axis with an HCTL-1100: to the home switch, back out, then to the encoder's index pulse.

    print(home(set_up(stage.axes["x"])))

A stage wires both end limits to LIMIT, ORG to STOP and the index pulse to INDEX. STOP acts in integral velocity mode only: the chip
brakes and stands. LIMIT acts always and leads to Init/Idle: from there the host must drive the motor out of the limit itself. INDEX
goes to the commutator and cannot be read on the bus: the host reads that line by an input of its own, as here.

    step 1   at the search speed until STOP has triggered
    step 2   back, until STOP is released
    step 3   to STOP again, as slowly as the chip can: one count a sample
    step 4   on, to the begin of the index pulse; back out of it, and towards it again count by count
    step 5   the actual position is preset to 0 there, and the axis moves to 0
"""

from __future__ import annotations

from dataclasses import dataclass

from stage.chips.exclusive_access import exclusive
from stage.chips.hctl1100.maps import MODE
from stage.errors import RunTimeout
from stage.firmware.axis import check_direction
from stage.firmware.hctl1100.chip_port import CONTROL, LIMIT, STOP, Port
from stage.firmware.hctl1100.moves import (
    convert_acceleration_to_register,
    convert_velocity_to_register,
    move_by_trapezoid,
    write_command_velocity,
)

PUSH_COMMAND = 15  # hundredths of full drive: out of a limit
MAX_COUNTS = 4000  # counts: a limit switch is left before; two turns of the usual encoder
FAST_POLL_S = 2e-4  # s between two looks at what should be seen soon
INDEX_RETREAT_COUNTS = 60  # counts before the index pulse, from where it is sought count by count
CREEP_INTERVAL_S = 2e-3  # s for a count
MAX_TURNS = 1.2  # of the motor, within which an index pulse must come


@dataclass(frozen=True)
class ServoHomeReport:
    """Report of a home search. Counts are those from before the search.

    Attributes:
        switch: Position where STOP triggered when it was approached slowly. index: Position where the index pulse began, None
            without it.
        seconds: Time of the whole search. position: Position of the carriage, m; None without one. unit: "m", or "rad" on a hinge.
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
    port: Port,
    direction: int = -1,
    *,
    speed: float = 8_000,
    acceleration: float = 400_000,
    index: bool = True,
    turn: int = 2000,
    deadband: int = 3,
    timeout: float = 20.0,
) -> ServoHomeReport:
    """Search home; the axis is then in position control at position 0.

    Args:
        port: Port of the axis, set up.
        direction: Direction in which the home switch lies, -1 or 1.
        speed: Speed of steps 1 and 2, counts/s.
        acceleration: Acceleration of steps 1 and 2, counts/s2; the axis needs room to brake beyond the switch.
        index: Go on to the index pulse.
        turn: Counts of the encoder per turn.
        deadband: Counts within which the axis settles in the end.
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
    port.load(acceleration=convert_acceleration_to_register(port, acceleration))
    _run_to_switch(port, direction * fast, timeout)
    _back_out_of_switch(port, -direction, speed, acceleration, turn, timeout)
    switch = _run_to_switch(port, direction, timeout)
    found = _find_index_pulse(port, direction, turn) if index else None
    _preset_position(port, switch if found is None else found)
    move_by_trapezoid(port, -port.commanded(), velocity=speed, acceleration=acceleration, deadband=deadband)
    return ServoHomeReport(
        port.axis.name, switch, found, port.axis.time - begin, port.axis.position, getattr(port.axis, "unit", "m")
    )


@exclusive
def leave_limit(
    port: Port, direction: int, *, push: int = PUSH_COMMAND, max_counts: int = MAX_COUNTS, timeout: float = 2.0
) -> None:
    """Drive an axis out of its limit switch in Init/Idle, where the chip closes no loop; then hold it.

    Args:
        port: Port of the axis.
        direction: Direction out of the switch, which the host has to know, 1 or -1.
        push: Motor command, hundredths of full drive.
        max_counts: Distance after which the drive ends, so that a switch that is stuck does not send the axis to its other end,
            counts.
        timeout: Simulated seconds to wait.

    Raises:
        RunTimeout: The switch is still on after `timeout`, or after `max_counts`; the axis is in Init/Idle then.
    """
    port.idle()
    begin = port.position()
    port.load(motor_command=direction * push)

    def is_released_or_out_of_reach() -> bool:
        return bool(port.clear_status() & LIMIT) or abs(port.position() - begin) > max_counts

    port.wait_until(is_released_or_out_of_reach, timeout, "release of the limit switch", FAST_POLL_S)
    if port.limited():
        port.idle()
        raise RunTimeout(
            f"axis {port.axis.name}: its limit switch is still on {max_counts} counts away, at {port.position()} counts. Look "
            "whether it is stuck; the axis is in Init/Idle now."
        )
    port.hold()


def _run_to_switch(port: Port, velocity: int, timeout: float) -> int:
    """Run in integral velocity mode until STOP has triggered and the axis is at rest; return the position where STOP triggered."""
    port.load(integral_velocity=0)
    port.mode("integral velocity")
    if port.status() & STOP:
        write_command_velocity(port, velocity)
    port.wait_until(lambda: port.status() & (STOP | LIMIT) != STOP | LIMIT, timeout, "the home switch", FAST_POLL_S)
    _check_limit(port, "the home switch")
    at = port.position()
    hold_once_at_rest(port)
    return at


def _check_limit(port: Port, what: str) -> None:
    """Raise RunTimeout where LIMIT has triggered. `what` says what it came before."""
    if port.limited():
        raise RunTimeout(
            f"axis {port.axis.name}: LIMIT before {what}, at {port.position()} counts; it is in Init/Idle now."
        )


def hold_once_at_rest(port: Port) -> None:
    """Take position control as soon as the command position has come to rest."""
    before = port.commanded() - 1
    while before != (now := port.commanded()):
        before = now
        port.axis.wait(3 * port.sample)
    port.mode("position")


def _back_out_of_switch(
    port: Port, direction: int, speed: float, acceleration: float, turn: int, timeout: float
) -> None:
    """Move back until STOP can be cleared, an eighth of a turn at a time: a trapezoid does not obey STOP."""

    def released() -> bool:
        if port.clear_status() & STOP:
            return True
        move_by_trapezoid(port, direction * turn // 8, velocity=speed, acceleration=acceleration, deadband=turn)
        return port.limited()

    port.wait_until(released, timeout, "release of the home switch", FAST_POLL_S)
    _check_limit(port, "release of the home switch")
    move_by_trapezoid(port, direction * turn // 8, velocity=speed, acceleration=acceleration, deadband=turn)


def _find_index_pulse(port: Port, direction: int, turn: int) -> int:
    """Return the position at which the index pulse begins, approached from this direction."""
    pins = port.axis.chip.axes[port.axis.chip_axis].pins
    port.clear_status()
    max_counts = round(MAX_TURNS * turn)

    def creep(counts: int, seconds: float) -> bool:
        """Move count by count, up to `counts`; return whether the index pulse has begun."""
        command, before = port.commanded(), pins.index
        for k in range(1, counts + 1):
            port.command(command + direction * k)
            port.axis.wait(seconds)
            if pins.index and not before:
                return True
            before = pins.index
        return False

    found = creep(max_counts, port.sample)
    if found:
        port.command(port.commanded() - direction * INDEX_RETREAT_COUNTS)
        port.axis.wait(INDEX_RETREAT_COUNTS * CREEP_INTERVAL_S)
        found = creep(2 * INDEX_RETREAT_COUNTS, CREEP_INTERVAL_S)
    if not found:
        port.idle()
        raise RunTimeout(
            f"axis {port.axis.name}: no index pulse within {max_counts} counts of the home switch; it is in Init/Idle now."
        )
    return port.position()


def _preset_position(port: Port, origin: int) -> None:
    """Make positions count from `origin` on. Only Init/Idle lets the host write them: the motor is off for a few bus cycles."""
    port.idle()
    port.load(preset_position=port.position() - origin)
    port.load(command_position=port.position())
    port.chip.write(MODE, CONTROL)
