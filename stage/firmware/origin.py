"""Origin return: find ORG, from wherever the axis is (data sheet section 5 f, g).

    fast:  SD enabled, ORG enabled, high speed. The SD switch lies before ORG and slows the axis to FL; ORG stops it.
    slow:  leave ORG, a little more, and approach it again at a crawl.

ORG is asserted at the origin and on from it to the end of travel, so that firmware can tell on which side it is.
"""

from __future__ import annotations

from stage.firmware import bus
from stage.firmware.axis import Axis
from stage.firmware.moves import SETTLE, _minus, _prepare, _profile
from stage.firmware.profile import Profile
from stage.firmware.report import Procedure, Report

BACK_OFF = 200  # pulses beyond the release of ORG
APPROACH = 400.0  # pps; slow, so that the motor does not ring when the switch trips


def origin_return(
    axis: Axis,
    direction: int = -1,
    profile: Profile | None = None,
    *,
    high_speed: bool = True,
    slow_approach: bool = True,
    back_off: int = BACK_OFF,
    approach: float = APPROACH,
    timeout: float = 60.0,
) -> Report:
    """Return to the mechanical origin.

    direction: where ORG lies. high_speed: to FH1 with SD, otherwise constant FL. slow_approach: back off by
    `back_off` pulses and come again at `approach` pps, which makes the position repeatable within a pulse. The report's `stopped_by` is "ORG", or the limit that was met instead.
    Raises RunTimeout when `timeout` seconds a phase were not enough.
    """
    profile = _profile(axis, profile)
    with Procedure(axis, "origin return" if high_speed else "constant-speed origin return") as p:
        port = p.port
        away = bus.CONTROL | _minus(-direction)
        toward = bus.CONTROL | bus.ORIGIN | _minus(direction)
        _prepare(port, profile, _minus(-direction))
        if port.status().org:
            _leave(port, axis, away, back_off, "FH1" if high_speed else "FL", timeout)
        port.command(toward | (bus.SD if high_speed else 0))
        port.command(bus.RAMP["FH1"] if high_speed else bus.START["FL"])
        status = port.wait_until_stopped(timeout)
        if status.org and slow_approach:
            axis.wait(SETTLE)
            port.command(bus.RESET)
            port.write_register("R1", max(1, min(round(approach / profile.step), profile.R1)))
            _leave(port, axis, away, back_off, "FL", timeout)
            port.command(toward)
            port.command(bus.START["FL"])
            status = port.wait_until_stopped(timeout)
        axis.wait(SETTLE)
        port.command(bus.RESET)
        return p.report("ORG" if status.org else ("EL-" if direction < 0 else "EL+"))


def _leave(port: bus.Port, axis: Axis, away: int, back_off: int, rate: str, timeout: float) -> None:
    """Run away from the origin until ORG lets go, stop, and go `back_off` pulses further."""
    port.command(away)
    port.command(bus.START["FL"] if rate == "FL" else bus.RAMP[rate])
    port.wait_until(lambda s: not s.org or not s.operating, timeout)
    port.command(bus.RESET if rate == "FL" else bus.SLOW_DOWN_FH1)
    port.wait_until_stopped(timeout)
    axis.wait(SETTLE)
    port.command(bus.RESET)
    port.write_register("R0", back_off)
    port.command(away | bus.PRESET)
    port.command(bus.START["FL"])
    port.wait_until_stopped(timeout)
    axis.wait(SETTLE)
    port.command(bus.RESET)
