"""Origin return of the PCL-240 family: find ORG from any position of the axis (data sheet section 5 f, g).

    fast:  SD and ORG are enabled. The axis runs at high speed; the SD switch before ORG slows it to FL, and ORG stops it.
    slow:  The axis leaves ORG, moves a little further, and approaches ORG again at a very low rate.
    ez:    On an MK or MS the last approach continues past ORG to an index pulse of the motor's encoder (EC-Z counting).

ORG is asserted from the origin to the end of travel, so the firmware knows on which side of the origin the carriage is.
"""

from __future__ import annotations

from stage.chips.exclusive_access import exclusive
from stage.errors import ArgumentError, add_article
from stage.firmware.axis import Axis, check_direction, check_origin
from stage.firmware.driver import SETTLING_TIME_S
from stage.firmware.move_report import Report
from stage.firmware.pcl240 import chip_port
from stage.firmware.pcl240.moves import check_pulses_and_drop_sign, choose_profile, encode_direction, write_move_setup
from stage.firmware.pcl240.procedure_observer import Pcl240Observer
from stage.firmware.pcl240.speed_profile import Profile
from stage.support.argument_checks import check_timeout, explain_arguments

BACK_OFF_PULSES = 200  # pulses beyond the release of ORG
APPROACH_RATE_PPS = 400.0  # pps; slow, so that the motor does not ring when the switch trips


@explain_arguments
@exclusive
def origin_return(
    axis: Axis,
    direction: int = -1,
    profile: Profile | None = None,
    *,
    high_speed: bool = True,
    slow_approach: bool = True,
    back_off: int = BACK_OFF_PULSES,
    approach: float = APPROACH_RATE_PPS,
    ez: int | None = None,
    timeout: float = 60.0,
) -> Report:
    r"""Return to the mechanical origin from any position: before ORG, on it, beyond it, or on an end limit.

                ______ FH1
               /      \  SD                        towards ORG
              /        \______ FL
        _____/                |___      __________  at `approach` pps, up to ORG
                            ORG   |____|            away: out of ORG, `back_off` pulses more

    On MK and MS the position counter R10 is 0 at the origin.

    Args:
        axis: Axis whose chip is a PCL-240.
        direction: Direction in which ORG lies, 1 or -1.
        profile: Rates and ramps.
        high_speed: True to run at FH1 until SD slows the axis; False for constant FL.
        slow_approach: Whether the axis backs off by `back_off` pulses and comes again at `approach` pps, which makes the position
            repeatable within a pulse.
        back_off: Pulses from the release of ORG to the start of the approach.
        approach: Rate of the last approach, pps.
        ez: Number of the index pulse after ORG at which the return ends, 1 to 16, at FL or slower; the position of the switch then
            hardly matters (R13; data sheet MS, 2-4). Needs a PCL240MK or PCL240MS.
        timeout: Simulated seconds that each of its runs may take.

    Returns:
        A report whose `stopped_by` is "ORG" or "EZ" after success, and otherwise what the axis has met: the end limit ahead (no
        ORG), the one behind (ORG was not released), or "HOME" if ORG is asserted again after the axis has left it.

    Raises:
        ArgumentError: A value is out of its range, or the axis has no origin switch.
        RunTimeout: A run took longer than `timeout`.
    """
    check_timeout(timeout)
    check_origin(axis)
    profile, logic = choose_profile(axis, profile), chip_port.compute_polarity_bits(axis)
    if ez is not None:
        _check_index_number(axis, ez)
    check_direction(direction)
    back_off = check_pulses_and_drop_sign(back_off)
    if not 0 < approach <= profile.rate_per_speed_step * 8191:
        raise ArgumentError(
            f"approach={approach!r} pps: more than 0, up to {profile.rate_per_speed_step * 8191:.0f} with R7 = {profile.R7}."
        )
    with Pcl240Observer(axis, "origin return" if high_speed else "constant-speed origin return") as p:
        port = p.port
        write_move_setup(port, profile, encode_direction(-direction))
        port.write_registers(**logic)
        met = _leave_origin(p, -direction, back_off, high_speed, timeout) if port.read_status().org else ""
        stopped_by = met or _run_to_origin(p, direction, high_speed, timeout, None if slow_approach else ez)
        if stopped_by == "ORG" and slow_approach:
            port.write_command(chip_port.RESET)
            port.write_register("R1", max(1, min(round(approach / profile.rate_per_speed_step), profile.R1)))
            met = _leave_origin(p, -direction, back_off, False, timeout)
            stopped_by = met or _run_to_origin(p, direction, False, timeout, ez)
        port.write_command(chip_port.RESET)
        if port.extended and stopped_by in ("ORG", "EZ"):
            port.write_register("R10", 0)
        return p.make_report(stopped_by)


def _check_index_number(axis: Axis, ez: int) -> None:
    """Raise ArgumentError if the chip cannot count index pulses, or cannot count as many as `ez`."""
    if not getattr(axis.chip, "EXTENDED", False):
        raise ArgumentError(
            f"axis {axis.name}: {add_article(axis.chip.MAP.chip)} does not count EZ: a PCL240MK or PCL240MS does."
        )
    if ez not in range(1, 17):
        raise ArgumentError(f"ez={ez!r}: the origin return ends at the 1st to 16th index pulse after ORG.")


def _run_to_origin(observer: Pcl240Observer, direction: int, high_speed: bool, timeout: float, ez: int | None) -> str:
    """Run until ORG, an index pulse after it (`ez`) or the end limit stops the axis, and return the stop reason."""
    port = observer.port
    if port.extended:
        logic = chip_port.compute_polarity_bits(port.axis).get("R13", 0)
        port.write_register("R13", logic | (chip_port.encode_index_pulse_number(ez) if ez else 0))
    port.write_control_mode(chip_port.ORIGIN | (chip_port.SD if high_speed else 0) | encode_direction(direction))
    port.write_command(chip_port.RAMP_START_COMMANDS["FH1"] if high_speed else chip_port.START["FL"])
    port.wait_until_stopped(timeout)
    port.axis.wait(SETTLING_TIME_S)
    return observer.find_stop_reason()


def _leave_origin(observer: Pcl240Observer, direction: int, back_off: int, high_speed: bool, timeout: float) -> str:
    """Run in `direction` until ORG is released, stop, and move `back_off` pulses further, at the low rate FL.

    Returns:
        "" if ORG is off afterwards; otherwise the end limit that stopped the axis, or "HOME" if ORG is still asserted.
    """
    port = observer.port
    port.write_control_mode(encode_direction(direction))
    port.write_command(chip_port.RAMP_START_COMMANDS["FH1"] if high_speed else chip_port.START["FL"])
    port.wait_until(lambda s: not s.org or not s.operating, timeout, expected_event="the release of ORG")
    port.write_command(chip_port.SLOW_DOWN["FH1"] if high_speed else chip_port.RESET)
    port.wait_until_stopped(timeout)
    port.axis.wait(SETTLING_TIME_S)
    port.write_command(chip_port.RESET)
    port.write_register("R0", back_off)
    port.write_control_mode(chip_port.PRESET | encode_direction(direction))
    port.write_command(chip_port.START["FL"])
    status = port.wait_until_stopped(timeout)
    port.axis.wait(SETTLING_TIME_S)
    met = observer.find_stop_reason()
    port.write_command(chip_port.RESET)
    if not status.org:
        return ""
    return met if met in ("EL+", "EL-") else "HOME"
