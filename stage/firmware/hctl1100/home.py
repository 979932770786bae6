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

from stage.chips.hctl1100.maps import MODE
from stage.chips.sharing import exclusive
from stage.errors import ArgumentError, RunTimeout
from stage.firmware.hctl1100.moves import acceleration_word, cruise, trapezoid, velocity_word
from stage.firmware.hctl1100.port import CONTROL, LIMIT, STOP, Port

PUSH = 15  # hundredths of full drive: out of a limit
MAX_COUNTS = 4000  # counts: a limit switch is left before; two turns of the usual encoder
SOON = 2e-4  # s between two looks at what should be seen soon
BACK = 60  # counts before the index pulse, from where it is sought count by count
STEP = 2e-3  # s for a count
MAX_TURNS = 1.2  # of the motor, within which an index pulse must come


@dataclass(frozen=True)
class HomeReport:
    """The result of a home search. Counts are those from before the search.

    Attributes:
        switch: where STOP triggered when it was approached slowly. index: where the index pulse began, None without it.
        seconds: of the whole search. position: where the carriage is, m; None without one. unit: "m", or "rad" on a hinge.
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
def home(
    port: Port,
    direction: int = -1,
    *,
    speed: float = 8_000,
    acceleration: float = 400_000,
    index: bool = True,
    turn: int = 2000,
    deadband: int = 3,
    timeout: float = 20.0,
) -> HomeReport:
    """Home search; the axis is then in position control at position 0.

    Args:
        direction: where the home switch lies, -1 or 1.
        speed, acceleration: counts/s and counts/s2 of steps 1 and 2; the axis needs room to brake beyond the switch.
        index: go on to the index pulse. turn: counts of the encoder.
        deadband: counts, in which it settles in the end. timeout: s of each step.
    Raises ArgumentError; RunTimeout where a step has no end, or LIMIT has ended it: the axis is then in Init/Idle.
    """
    if direction not in (-1, 1):
        raise ArgumentError(f"direction={direction!r}: -1 or 1, where the home switch lies.")
    fast, begin = abs(velocity_word(port, speed, "integral_velocity", 1)), port.axis.time
    port.clear_status()
    port.load(acceleration=acceleration_word(port, acceleration))
    _to_switch(port, direction * fast, timeout)
    _out_of_switch(port, -direction, speed, acceleration, turn, timeout)
    switch = _to_switch(port, direction, timeout)
    found = _to_index(port, direction, turn) if index else None
    _preset(port, switch if found is None else found)
    trapezoid(port, -port.commanded(), velocity=speed, acceleration=acceleration, deadband=deadband)
    return HomeReport(
        port.axis.name, switch, found, port.axis.time - begin, port.axis.position, getattr(port.axis, "unit", "m")
    )


@exclusive
def leave_limit(
    port: Port, direction: int, *, push: int = PUSH, max_counts: int = MAX_COUNTS, timeout: float = 2.0
) -> None:
    """Drive an axis out of its limit switch in Init/Idle, where the chip closes no loop, by hundredths of full drive; then hold it.

    Which way is out, the host has to know. Raises RunTimeout after `timeout` seconds, and after `max_counts` counts: a switch that
    is stuck does not send the axis to its other end. It is in Init/Idle then.
    """
    port.idle()
    begin = port.position()
    port.load(motor_command=direction * push)

    def is_released_or_out_of_reach() -> bool:
        return bool(port.clear_status() & LIMIT) or abs(port.position() - begin) > max_counts

    port.wait_until(is_released_or_out_of_reach, timeout, "release of the limit switch", SOON)
    if port.limited():
        port.idle()
        raise RunTimeout(
            f"axis {port.axis.name}: its limit switch is still on {max_counts} counts away, at {port.position()} counts. Look "
            "whether it is stuck; the axis is in Init/Idle now."
        )
    port.hold()


def _to_switch(port: Port, velocity: int, timeout: float) -> int:
    """Integral velocity mode until STOP has triggered and the axis is at rest; returns the position where STOP triggered."""
    port.load(integral_velocity=0)
    port.mode("integral velocity")
    if port.status() & STOP:
        cruise(port, velocity)
    port.wait_until(lambda: port.status() & (STOP | LIMIT) != STOP | LIMIT, timeout, "the home switch", SOON)
    _check_limit(port, "the home switch")
    at = port.position()
    stand(port)
    return at


def _check_limit(port: Port, what: str) -> None:
    """Raise RunTimeout where LIMIT has triggered; what: what it came before."""
    if port.limited():
        raise RunTimeout(
            f"axis {port.axis.name}: LIMIT before {what}, at {port.position()} counts; it is in Init/Idle now."
        )


def stand(port: Port) -> None:
    """Position control, as soon as the command position has come to rest."""
    before = port.commanded() - 1
    while before != (now := port.commanded()):
        before = now
        port.axis.wait(3 * port.sample)
    port.mode("position")


def _out_of_switch(port: Port, direction: int, speed: float, acceleration: float, turn: int, timeout: float) -> None:
    """Back until STOP can be cleared, an eighth of a turn at a time: a trapezoid does not mind STOP."""

    def released() -> bool:
        if port.clear_status() & STOP:
            return True
        trapezoid(port, direction * turn // 8, velocity=speed, acceleration=acceleration, deadband=turn)
        return port.limited()

    port.wait_until(released, timeout, "release of the home switch", SOON)
    _check_limit(port, "release of the home switch")
    trapezoid(port, direction * turn // 8, velocity=speed, acceleration=acceleration, deadband=turn)


def _to_index(port: Port, direction: int, turn: int) -> int:
    """The position at which the index pulse begins, seen from this direction."""
    pins = port.axis.chip.axes[port.axis.chip_axis].pins
    port.clear_status()
    max_counts = round(MAX_TURNS * turn)

    def creep(counts: int, seconds: float) -> bool:
        """Count by count, up to so many; whether the index pulse has begun."""
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
        port.command(port.commanded() - direction * BACK)
        port.axis.wait(BACK * STEP)
        found = creep(2 * BACK, STEP)
    if not found:
        port.idle()
        raise RunTimeout(
            f"axis {port.axis.name}: no index pulse within {max_counts} counts of the home switch; it is in Init/Idle now."
        )
    return port.position()


def _preset(port: Port, origin: int) -> None:
    """Positions count from `origin` on. Only Init/Idle lets the host write them: the motor is off for a few bus cycles."""
    port.idle()
    port.load(preset_position=port.position() - origin)
    port.load(command_position=port.position())
    port.chip.write(MODE, CONTROL)
