"""Homing of a TMC5160 by a switch, by the index pulse of the encoder, or by a stall: data sheet, pages 46 and 85 to 90.

Each function returns what ended the homing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from pulsestage_trinamic.tmc5160 import state
from pulsestage_trinamic.tmc5160.encoder import CLR_ONCE, DECIMAL, IGNORE_AB, LATCH_X, N_EVENT, POL_N
from pulsestage_trinamic.tmc5160.stallguard import PER_SGT
from stage.firmware.axis import is_sensor_inverted
from stage.firmware.driver import wait_until_stopped

if TYPE_CHECKING:
    from pulsestage_trinamic.tmc5160.driver import Tmc5160Driver

STOPS = state.STOP_L | state.STOP_R
LEAST_VSTOP = 10  # recommended
USUAL_STEPS = 200  # full steps a turn of a motor that the axis does not state
SLOWLY = 10  # the index is sought at a tenth of VMAX
RISING = 1 << 6  # ENCMODE: the event is the beginning of the pulse
TUNING, FULL_STEP = 8, 256  # number of full steps in which SG_RESULT is read; steps of a full step
WINDOW = 1.2  # TCOOLTHRS over TSTEP


def to_switch(d: Tmc5160Driver, direction: int, values: Mapping[str, int], timeout: float) -> str:
    """Drive to a reference switch, make the position at which it closes 0, and end there (data sheet, pages 85 and 86).

    Args:
        d: Driver of the axis.
        direction: -1 or 1.
        values: Registers of the drive.
        timeout: Simulated seconds.

    Returns:
        "REFL" or "REFR", or why the axis stopped before.
    """
    left = direction < 0
    closed, stop, latch = (
        (state.STATUS_L, state.STOP_L, state.LATCH_L_ON) if left else (state.STATUS_R, state.STOP_R, state.LATCH_R_ON)
    )
    end = d.axis.time + timeout
    if d.get("RAMP_STAT") & closed:  # off it first
        d.run_with(-direction, values, STOPS)
        while d.get("RAMP_STAT") & closed and d.axis.time < end and d.is_running():
            d.axis.wait(1e-3)
        d.halt()
    d.run_with(direction, values, stop | latch | state.SOFT_STOP)
    wait_until_stopped([d.axis], end - d.axis.time)
    if not d.get("RAMP_STAT") & closed:
        d.stay()
        return d.stopped_by() or "no switch"
    d.put("SW_MODE", d.switches(0))
    _zero_at_latch(d)
    wait_until_stopped([d.axis], end - d.axis.time)
    d.put("SW_MODE", d.switches(STOPS))
    return "REFL" if left else "REFR"


def to_index(d: Tmc5160Driver, direction: int, values: Mapping[str, int], timeout: float) -> str:
    """Drive away from the switch to the index pulse within a turn (data sheet, page 46), and make its position 0.

    The pulse is some steps wide, so the axis passes it slowly and always in this direction.

    Args:
        d: Driver of the axis.
        direction: -1 or 1.
        values: Registers of the drive.
        timeout: Simulated seconds.

    Returns:
        "ENCN", or why the axis stopped before.
    """
    motor = getattr(getattr(d.axis, "drive", None), "motor", None)
    turn = FULL_STEP * getattr(motor, "steps_per_turn", USUAL_STEPS)
    slow = {**values, "VMAX": max(values["VMAX"] // SLOWLY, LEAST_VSTOP)}
    slow["VSTART"] = min(values["VSTART"], slow["VMAX"])
    slow["VSTOP"] = max(slow["VSTART"], LEAST_VSTOP)
    level = 0 if is_sensor_inverted(d.axis, "ez") else POL_N
    end = d.axis.time + timeout
    d.put("ENC_STATUS", N_EVENT)
    d.put("ENCMODE", d.get("ENCMODE") & DECIMAL | level | IGNORE_AB | CLR_ONCE | LATCH_X | RISING)
    d.run_with(direction, slow, STOPS)
    begin = d.get("XACTUAL")
    while not d.get("ENC_STATUS") & N_EVENT and d.is_running() and d.axis.time < end:
        if abs(d.get("XACTUAL") - begin) > turn + FULL_STEP:
            break
        d.axis.wait(1e-3)
    met = d.stopped_by()
    d.halt()
    d.put("ENCMODE", d.get("ENCMODE") & DECIMAL)
    if not d.get("ENC_STATUS") & N_EVENT:
        return met or "no index"
    d.put("VMAX", slow["VMAX"])
    _zero_at_latch(d)
    wait_until_stopped([d.axis], end - d.axis.time)
    return "ENCN"


def _zero_at_latch(d: Tmc5160Driver) -> None:
    """Make the position that XLATCH holds 0, and start a move to it."""
    d.put("RAMPMODE", state.HOLD)
    beyond = d.get("XACTUAL") - d.get("XLATCH")
    d.put("XACTUAL", beyond)
    d.put("XTARGET", beyond)
    d.put("RAMPMODE", state.POSITION)
    d.put("XTARGET", 0)


def to_stall(d: Tmc5160Driver, direction: int, values: Mapping[str, int], timeout: float) -> str:
    """Drive until the motor stalls, and make that position 0 (data sheet, pages 87 to 90).

    SGT is set so that SG_RESULT becomes 0 at half of its value in free motion. So the motor stops before its field is half an
    electrical turn ahead, where it might slip by four full steps.

    Args:
        d: Driver of the axis.
        direction: -1 or 1.
        values: Registers of the drive.
        timeout: Simulated seconds.

    Returns:
        "stall", or why the axis stopped otherwise.
    """
    gconf, tstep = d.get("GCONF"), (1 << 24) // values["VMAX"]
    settings = {
        "GCONF": gconf & ~4,
        "COOLCONF": 0,
        "TCOOLTHRS": min(round(WINDOW * tstep), 0xFFFFF),
        "RAMP_STAT": state.EVENT_SG,
    }
    for name, value in settings.items():
        d.put(name, value)
    d.run_with(direction, values, 0)
    end = d.axis.time + timeout
    while not d.get("RAMP_STAT") & state.VELOCITY_REACHED and d.axis.time < end:
        d.axis.wait(1e-3)
    free = []
    for _ in range(TUNING):
        d.axis.wait(FULL_STEP * d.chip.clock_hz**-1 * tstep)
        free.append(d.get("DRV_STATUS") & 0x3FF)
    d.put("COOLCONF", (-round(min(free) / 2 / PER_SGT) & 0x7F) << 16)
    d.put("SW_MODE", d.switches(state.SG_STOP))
    wait_until_stopped([d.axis], end - d.axis.time)
    end_reason = d.stopped_by()
    d.put("RAMPMODE", state.HOLD)
    d.put("XACTUAL", 0)
    d.put("XTARGET", 0)
    d.put("SW_MODE", d.switches(STOPS))
    d.put("RAMP_STAT", state.EVENT_SG | state.EVENT_POS)
    d.put("TCOOLTHRS", 0)
    d.put("GCONF", gconf)
    d.put("RAMPMODE", state.POSITION)
    return end_reason or "no stall"
