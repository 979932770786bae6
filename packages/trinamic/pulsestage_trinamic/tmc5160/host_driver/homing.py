"""Homing of a TMC5160 by a switch, by the index pulse of the encoder, or by a stall: data sheet, pages 46 and 85 to 90.

Each function returns the reason why the homing ended.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from pulsestage_trinamic.tmc5160 import state
from pulsestage_trinamic.tmc5160.encoder import CLR_ONCE, DECIMAL, IGNORE_AB, LATCH_X, N_EVENT, POL_N
from pulsestage_trinamic.tmc5160.stallguard import RESULT_PER_SGT
from stage.firmware.axis import is_sensor_inverted
from stage.firmware.driver import wait_until_stopped

if TYPE_CHECKING:
    from pulsestage_trinamic.tmc5160.host_driver.driver import Tmc5160Driver

STOP_AT_SWITCHES = state.STOP_L | state.STOP_R
MIN_VSTOP = 10  # recommended by the data sheet
DEFAULT_STEPS_PER_TURN = 200  # full steps, if the motor of the axis is not known
INDEX_SPEED_DIVISOR = 10  # the axis searches for the index pulse at a tenth of VMAX
RISING_EDGE_EVENT = 1 << 6  # ENCMODE: the N event happens at the beginning of the pulse
SG_SAMPLES = 8  # full steps in free motion in which SG_RESULT is read
PULSES_PER_FULL_STEP = 256
TCOOLTHRS_RATIO = 1.2  # TCOOLTHRS divided by TSTEP at VMAX


def home_to_switch(driver: Tmc5160Driver, direction: int, values: Mapping[str, int], timeout: float) -> str:
    """Drive to a reference switch, make the position at which it closes 0, and end there (data sheet, pages 85 and 86).

    Args:
        driver: Host driver of the axis.
        direction: -1 or 1.
        values: Registers of the ramp.
        timeout: Simulated seconds.

    Returns:
        "REFL" or "REFR", or why the axis stopped before.
    """
    left = direction < 0
    closed, stop, latch = (
        (state.STATUS_L, state.STOP_L, state.LATCH_L_ON) if left else (state.STATUS_R, state.STOP_R, state.LATCH_R_ON)
    )
    end = driver.axis.time + timeout
    if driver.read_register("RAMP_STAT") & closed:  # the axis begins on the switch: leave it first
        driver.run_with_registers(-direction, values, STOP_AT_SWITCHES)
        while driver.read_register("RAMP_STAT") & closed and driver.axis.time < end and driver.is_running():
            driver.axis.wait(1e-3)
        driver.halt()
    driver.run_with_registers(direction, values, stop | latch | state.SOFT_STOP)
    wait_until_stopped([driver.axis], end - driver.axis.time)
    if not driver.read_register("RAMP_STAT") & closed:
        driver.hold_position()
        return driver.read_stop_reason() or "no switch"
    driver.write_register("SW_MODE", driver.compute_sw_mode(0))
    _start_move_to_latched_zero(driver)
    wait_until_stopped([driver.axis], end - driver.axis.time)
    driver.write_register("SW_MODE", driver.compute_sw_mode(STOP_AT_SWITCHES))
    return "REFL" if left else "REFR"


def home_to_index(driver: Tmc5160Driver, direction: int, values: Mapping[str, int], timeout: float) -> str:
    """Drive away from the switch to the index pulse within a turn (data sheet, page 46), and make its position 0.

    The pulse is some steps wide, so the axis passes it slowly and always in this direction.

    Args:
        driver: Host driver of the axis.
        direction: -1 or 1.
        values: Registers of the ramp.
        timeout: Simulated seconds.

    Returns:
        "ENCN", or why the axis stopped before.
    """
    motor = getattr(getattr(driver.axis, "drive", None), "motor", None)
    turn = PULSES_PER_FULL_STEP * getattr(motor, "steps_per_turn", DEFAULT_STEPS_PER_TURN)
    slow = {**values, "VMAX": max(values["VMAX"] // INDEX_SPEED_DIVISOR, MIN_VSTOP)}
    slow["VSTART"] = min(values["VSTART"], slow["VMAX"])
    slow["VSTOP"] = max(slow["VSTART"], MIN_VSTOP)
    level = 0 if is_sensor_inverted(driver.axis, "ez") else POL_N
    end = driver.axis.time + timeout
    driver.write_register("ENC_STATUS", N_EVENT)
    driver.write_register(
        "ENCMODE",
        driver.read_register("ENCMODE") & DECIMAL | level | IGNORE_AB | CLR_ONCE | LATCH_X | RISING_EDGE_EVENT,
    )
    driver.run_with_registers(direction, slow, STOP_AT_SWITCHES)
    begin = driver.read_register("XACTUAL")
    while not driver.read_register("ENC_STATUS") & N_EVENT and driver.is_running() and driver.axis.time < end:
        if abs(driver.read_register("XACTUAL") - begin) > turn + PULSES_PER_FULL_STEP:
            break
        driver.axis.wait(1e-3)
    stop_reason = driver.read_stop_reason()
    driver.halt()
    driver.write_register("ENCMODE", driver.read_register("ENCMODE") & DECIMAL)
    if not driver.read_register("ENC_STATUS") & N_EVENT:
        return stop_reason or "no index"
    driver.write_register("VMAX", slow["VMAX"])
    _start_move_to_latched_zero(driver)
    wait_until_stopped([driver.axis], end - driver.axis.time)
    return "ENCN"


def _start_move_to_latched_zero(driver: Tmc5160Driver) -> None:
    """Make the position that XLATCH holds 0, and start a move to it."""
    driver.write_register("RAMPMODE", state.HOLD)
    beyond = driver.read_register("XACTUAL") - driver.read_register("XLATCH")
    driver.write_register("XACTUAL", beyond)
    driver.write_register("XTARGET", beyond)
    driver.write_register("RAMPMODE", state.POSITION)
    driver.write_register("XTARGET", 0)


def home_to_stall(driver: Tmc5160Driver, direction: int, values: Mapping[str, int], timeout: float) -> str:
    """Drive until the motor stalls, and make that position 0 (data sheet, pages 87 to 90).

    SGT is set so that SG_RESULT becomes 0 at a load that halves its value in free motion. The motor therefore stops before its
    field leads the rotor by half an electrical turn, at which the rotor might slip by four full steps.

    Args:
        driver: Host driver of the axis.
        direction: -1 or 1.
        values: Registers of the ramp.
        timeout: Simulated seconds.

    Returns:
        "stall", or why the axis stopped otherwise.
    """
    gconf, tstep = driver.read_register("GCONF"), (1 << 24) // values["VMAX"]
    settings = {
        "GCONF": gconf & ~4,
        "COOLCONF": 0,
        "TCOOLTHRS": min(round(TCOOLTHRS_RATIO * tstep), 0xFFFFF),
        "RAMP_STAT": state.EVENT_SG,
    }
    for name, value in settings.items():
        driver.write_register(name, value)
    driver.run_with_registers(direction, values, 0)
    end = driver.axis.time + timeout
    while not driver.read_register("RAMP_STAT") & state.VELOCITY_REACHED and driver.axis.time < end:
        driver.axis.wait(1e-3)
    free = []
    for _ in range(SG_SAMPLES):
        driver.axis.wait(PULSES_PER_FULL_STEP * driver.chip.clock_hz**-1 * tstep)
        free.append(driver.read_register("DRV_STATUS") & 0x3FF)
    driver.write_register("COOLCONF", (-round(min(free) / 2 / RESULT_PER_SGT) & 0x7F) << 16)
    driver.write_register("SW_MODE", driver.compute_sw_mode(state.SG_STOP))
    wait_until_stopped([driver.axis], end - driver.axis.time)
    end_reason = driver.read_stop_reason()
    driver.write_register("RAMPMODE", state.HOLD)
    driver.write_register("XACTUAL", 0)
    driver.write_register("XTARGET", 0)
    driver.write_register("SW_MODE", driver.compute_sw_mode(STOP_AT_SWITCHES))
    driver.write_register("RAMP_STAT", state.EVENT_SG | state.EVENT_POS)
    driver.write_register("TCOOLTHRS", 0)
    driver.write_register("GCONF", gconf)
    driver.write_register("RAMPMODE", state.POSITION)
    return end_reason or "no stall"
