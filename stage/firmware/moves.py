"""Moves, by bus cycles only: preset, continuous, dual rate, speed change, interrupt and resume, external count.

The procedures follow section 5 of the PCL-240K data sheet: reset command, registers, control mode, start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from stage.errors import ArgumentError
from stage.firmware import bus
from stage.firmware.axis import Axis, check
from stage.firmware.bus import Port, Status
from stage.firmware.profile import Profile
from stage.firmware.report import Procedure, Report

SETTLE = 0.05  # s after a stop, before the report looks where the carriage came to rest


def preset_move(
    axis: Axis,
    pulses: int,
    profile: Profile | None = None,
    *,
    high_speed: bool = True,
    fh2: bool = False,
    down_point: int | None = None,
    interrupt: bool = False,
    timeout: float | None = None,
) -> Report:
    """Move by `pulses` (signed) and stop on the last one (section 5 b, c).

    high_speed: with ramps, to FH1 or (fh2) FH2; otherwise constant speed. down_point: R6, default by the data sheet's formula,
    triangular for a short move. interrupt: /INT at the stop. Raises ArgumentError, RunTimeout.
    """
    profile = _profile(axis, profile)
    count = _count(pulses)
    with Procedure(axis, "preset move" if high_speed else "constant-speed preset move") as p:
        _prepare(p.port, profile, bus.PRESET | _minus(pulses))
        p.port.write_register("R0", count)
        if high_speed:
            p.port.write_register("R6", profile.down_point(count, fh2) if down_point is None else down_point)
        p.port.command(_start(high_speed, fh2) | (bus.INTERRUPT if interrupt else 0))
        status = p.port.wait_until_stopped(_patience(timeout, profile, count))
        axis.wait(SETTLE)
        return p.report(_reason(status, pulses), pulses)


def continuous_move(
    axis: Axis,
    seconds: float,
    direction: int = 1,
    profile: Profile | None = None,
    *,
    high_speed: bool = True,
    fh2: bool = False,
    immediate: bool = False,
) -> Report:
    """Run for `seconds`, then stop: decelerating (1Dh, 1Fh), or `immediate` by the reset command (section 5 d, e)."""
    profile = _profile(axis, profile)
    with Procedure(axis, "continuous move" if high_speed else "constant-speed continuous move") as p:
        _prepare(p.port, profile, _minus(direction))
        p.port.command(_start(high_speed, fh2))
        axis.wait(seconds)
        status = p.port.status()
        if not status.operating:
            axis.wait(SETTLE)
            return p.report(_reason(status, direction))
        slow = high_speed and not immediate
        p.port.command((bus.SLOW_DOWN_FH2 if fh2 else bus.SLOW_DOWN_FH1) if slow else bus.RESET)
        p.port.wait_until_stopped(2 * profile.decel(fh2) + 1)
        axis.wait(SETTLE)
        return p.report("decelerating stop" if slow else "reset command")


def dual_rate_move(
    axis: Axis,
    pulses: int,
    profile: Profile | None = None,
    *,
    rates: Sequence[str] = ("FH1", "FH2", "FH1"),
    dwell: float = 0.1,
    timeout: float | None = None,
) -> Report:
    """A preset move through several rates: FL, FH1 and FH2 in the order of `rates`, each for `dwell` seconds after its ramp;
    the last one lasts until the ramp-down point (dual rate mode, ramping up and down).

    A first rate "FL" starts at constant FL, as the data sheet's dual rate pattern does.
    """
    profile = _profile(axis, profile)
    count = _count(pulses)
    for rate in rates:
        if rate not in bus.RAMP:
            raise ArgumentError(f"rate {rate!r}: a chip has FL, FH1 and FH2.")
    if not rates:
        raise ArgumentError("rates is empty: give at least one of FL, FH1, FH2.")
    with Procedure(axis, "dual-rate move") as p:
        _prepare(p.port, profile, bus.PRESET | _minus(pulses))
        last = rates[-1] == "FH2"
        p.port.write_registers(R0=count, R6=profile.down_point(count, last) if rates[-1] != "FL" else 0)
        p.port.command(bus.START["FL"] if rates[0] == "FL" else bus.RAMP[rates[0]])
        p.port.wait_until(lambda s: s.fkeep or not s.operating, 60)
        axis.wait(dwell)
        for rate in rates[1:]:
            p.port.command(bus.RAMP[rate])
            axis.wait(1e-5)
            p.port.wait_until(lambda s: s.fkeep or not s.operating, 60)
            axis.wait(dwell)
        status = p.port.wait_until_stopped(_patience(timeout, profile, count))
        axis.wait(SETTLE)
        return p.report(_reason(status, pulses), pulses)


def speed_change_move(
    axis: Axis,
    pulses: int,
    rates: Sequence[float],
    profile: Profile | None = None,
    *,
    dwell: float = 0.1,
    timeout: float | None = None,
) -> Report:
    """A preset move through any number of rates in pps: the register that is not in use is rewritten, then selected
    (section 5 h: changing the rate of the register not selected gives no influence)."""
    profile = _profile(axis, profile)
    count = _count(pulses)
    steps = [round(r / profile.step) for r in rates]
    if not steps:
        raise ArgumentError("rates is empty: give at least one rate in pps.")
    for s in steps:
        axis.chip.MAP.checked("R2", s)
    with Procedure(axis, "speed change in motion") as p:
        _prepare(p.port, profile, bus.PRESET | _minus(pulses))
        last = Profile(profile.R1, max(steps[-1], 1), profile.R3, profile.R4, profile.R5, profile.R7, profile.clock_hz)
        p.port.write_registers(R0=count, R6=last.down_point(count), R2=steps[0])
        p.port.command(bus.RAMP["FH1"])
        for k, step in enumerate(steps[1:], 1):
            p.port.wait_until(lambda s: s.fkeep or not s.operating, 60)
            axis.wait(dwell)
            unused = "FH2" if k % 2 else "FH1"
            p.port.write_register("R3" if k % 2 else "R2", step)
            p.port.command(bus.RAMP[unused])
            axis.wait(1e-5)
        status = p.port.wait_until_stopped(_patience(timeout, profile, count))
        axis.wait(SETTLE)
        return p.report(_reason(status, pulses), pulses)


def interrupted_move(
    axis: Axis,
    pulses: int,
    profile: Profile | None = None,
    *,
    after: float = 0.3,
    pause: float = 0.2,
    timeout: float | None = None,
) -> Report:
    """Ramp down and interrupt: a preset move is stopped by a decelerating stop after `after` seconds, rests for `pause`, and
    goes on with its residual pulses: R0 kept them (section 4, R0; operation pattern "ramping up/down & interrupting")."""
    profile = _profile(axis, profile)
    count = _count(pulses)
    with Procedure(axis, "interrupted move") as p:
        _prepare(p.port, profile, bus.PRESET | _minus(pulses))
        p.port.write_registers(R0=count, R6=profile.down_point(count))
        p.port.command(bus.RAMP["FH1"])
        axis.wait(after)
        p.port.command(bus.SLOW_DOWN_FH1 | bus.INTERRUPT)
        status = p.port.wait_until_stopped(2 * profile.decel() + 1)
        residual = p.port.counter()
        if residual:
            axis.wait(pause)
            p.port.command(bus.RESET)
            p.port.write_register("R6", profile.down_point(residual))
            p.port.command(bus.RAMP["FH1"])
            status = p.port.wait_until_stopped(_patience(timeout, profile, residual))
        axis.wait(SETTLE)
        return p.report(_reason(status, pulses), pulses)


def external_count(
    axis: Axis,
    pulses: int,
    profile: Profile | None = None,
    *,
    rate: float = 1000.0,
    direction: int = 1,
    source: Callable[[Axis], bool] | None = None,
    timeout: float = 60.0,
) -> Report:
    """Run at constant FL until EXTP has counted R0 = `pulses` edges down to 0 (output mode D4).

    source: called with the axis, makes one external pulse, lets its time pass and returns False when there are no more;
    default a square wave of `rate` Hz on the EXTP pin.
    """
    profile = _profile(axis, profile)
    count = _count(pulses)

    def square_wave(axis: Axis) -> bool:
        for level in (True, False):
            axis.chip.axes[0].pins.extp = level
            axis.wait(0.5 / rate)
        return True

    make = source or square_wave
    with Procedure(axis, "external count") as p:
        _prepare(p.port, profile, bus.PRESET | _minus(direction), output=0x10)
        p.port.write_register("R0", count)
        p.port.command(bus.START["FL"])
        end = axis.time + timeout
        while p.port.status().operating and axis.time < end and make(axis):
            pass
        status = p.port.status()
        if status.operating:
            p.port.command(bus.RESET)
            p.port.wait_until_stopped(1)
        p.port.command(bus.OUTPUT)
        axis.wait(SETTLE)
        return p.report("reset command" if status.operating else _reason(status, direction))


def _prepare(port: Port, profile: Profile, control: int, output: int = 0) -> None:
    port.command(bus.RESET)
    port.write_registers(**profile.registers())
    port.command(bus.OUTPUT | output)
    port.command(bus.CONTROL | control)


def _profile(axis: Axis, profile: Profile | None) -> Profile:
    check(axis)
    if profile is None:
        return Profile.of(clock_hz=axis.chip.clock_hz)
    if not isinstance(profile, Profile):
        raise ArgumentError(f"profile={profile!r}: give a Profile, for example Profile.of(fl=500, fh1=16000).")
    return profile


def _count(pulses: int) -> int:
    if int(pulses) != pulses or not 1 <= abs(pulses) <= 0xFFFFFF:
        raise ArgumentError(f"pulses={pulses!r}: R0 counts 1 to 16777215 pulses; the sign is the direction.")
    return abs(int(pulses))


def _minus(direction: int) -> int:
    return bus.MINUS if direction < 0 else 0


def _start(high_speed: bool, fh2: bool) -> int:
    return (bus.RAMP if high_speed else bus.START)["FH2" if fh2 else "FH1"]


def _patience(timeout: float | None, profile: Profile, count: int) -> float:
    return 1.5 * profile.seconds(count) + 1 if timeout is None else timeout


def _reason(status: Status, direction: int) -> str:
    """Why a run ended that no command ended: the status tells R0 = 0; what is left is the end limit, which it hides."""
    return "R0 = 0" if status.zero else ("EL-" if direction < 0 else "EL+")
