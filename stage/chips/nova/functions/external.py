"""External drives of the NOVA chips, by the pins EXP+ and EXP- (PIO4 and PIO5 of the MCX514), low when asserted; compiled.

    continuous      EXP+  ^^^^|_________|^^^^        + continuous drive, then a decelerating stop; EXP- alike, in - direction
    fixed           EXP+  ^^^^|___|^^^^^^^^^^        a + fixed-pulse drive from each fall on; EXP- alike
    manual pulser   EXP+  ___|^^^^^^^^|______        with EXP- low: a rise begins a + drive, a fall a - drive
                    EXP-  ________|^^^^^^^^|_        so a handwheel's A and B make one drive a turn, either way

A fixed drive is command 50h for EXP+ and 51h for EXP- on the MCX514, with the pulses of TP; on the older chips 20h and 21h,
with the pulses of P. A falling edge while the axis is busy is lost [M]. Inferred: in the continuous mode the falling edge
begins the drive, not the level, and the release stops it even if the mode has changed; if both pins fall at one clock EXP+
wins; PIO4 and PIO5 act while they are general inputs.
"""

from __future__ import annotations

from stage.chips.nova.functions import io as ports
from stage.chips.nova.motion import drive
from stage.chips.nova.registers.mcx300 import MCX304_MAP
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.state import EXP, MCX514_TYPE, P2M
from stage.native import hot

OFF, CONTINUOUS, FIXED, PULSER = range(4)
PLUS, MINUS = 1, 2  # of `exp`
EXOP_304, EXOP_514 = MCX304_MAP.bit("WR3", "EXOP"), MCX514_MAP.bit("P2M", "EXOP")


@hot
def _read_exp_levels(x):
    """Return the filtered levels of EXP+ and EXP-, as bits 0 and 1."""
    return x.filtered_inputs >> EXP & 3


@hot
def _read_exp_mode(c, x):
    """Return the mode of the external drives: OFF, CONTINUOUS, FIXED or PULSER."""
    if c.variant != MCX514_TYPE:
        return x.wr[3] >> EXOP_304 & 3
    levels = ports.find_general_inputs(x) >> EXP - ports.FIRST_PIO & 3
    return x.mode[P2M] >> EXOP_514 & 3 if levels == 3 else OFF


@hot
def reset_external_drives(x):
    """Note the present levels of the pins, so that they are no changes."""
    x.last_exp_levels, x.exp_driving = _read_exp_levels(x), 0


@hot
def _start_drive(c, x, minus, fixed):
    """Start the drive of a pin, unless the axis is busy.

    Args:
        c: State of the chip.
        x: State of the axis.
        minus: Whether it goes in - direction.
        fixed: Whether it makes a fixed number of pulses.
    """
    if not fixed:
        kind = drive.BACKWARD if minus else drive.FORWARD
    elif c.variant == MCX514_TYPE:
        kind = drive.COUNTER_RELATIVE if minus else drive.RELATIVE
    else:
        kind = drive.FIXED_MINUS if minus else drive.FIXED_PLUS
    if not (x.driving or x.awaits_inpos or x.home_state or x.interpolates):
        x.exp_driving = 0 if fixed else MINUS if minus else PLUS
        drive.execute_drive_command(c, x, kind)


@hot
def apply_pin_changes(c, x):
    """Apply the changes of the pins since the last call."""
    levels = _read_exp_levels(x)
    if x.exp_driving and not x.driving:
        x.exp_driving = 0
    if levels == x.last_exp_levels:
        return
    flip = 3 if c.variant == MCX514_TYPE else 0  # of PIO the level is known, of EXP whether it is asserted
    before, now = x.last_exp_levels ^ flip, levels ^ flip
    fallen, risen = now & ~before, before & ~now
    x.last_exp_levels = levels
    if risen & x.exp_driving:
        x.exp_driving = 0
        drive.begin_decelerating_stop(c, x, 0)
    mode = _read_exp_mode(c, x)
    if mode == PULSER:
        if (fallen | risen) & PLUS and now & MINUS:
            _start_drive(c, x, fallen & PLUS, 1)
    elif mode != OFF and fallen:
        _start_drive(c, x, not fallen & PLUS, mode == FIXED)
