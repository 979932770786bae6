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

from stage.chips.nova.functions import general_ports as ports
from stage.chips.nova.motion import single_axis_drive
from stage.chips.nova.registers.mcx300 import MCX304_MAP
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.state import EXP_PLUS_SHIFT, MCX514_TYPE, P2M
from stage.native import hot

OFF, CONTINUOUS, FIXED, PULSER = range(4)
PLUS, MINUS = 1, 2  # of `exp`
EXOP_304, EXOP_514 = MCX304_MAP.bit("WR3", "EXOP"), MCX514_MAP.bit("P2M", "EXOP")


@hot
def _read_exp_levels(axis):
    """Return the filtered levels of EXP+ and EXP-, as bits 0 and 1."""
    return axis.filtered_inputs >> EXP_PLUS_SHIFT & 3


@hot
def _read_exp_mode(chip, axis):
    """Return the mode of the external drives: OFF, CONTINUOUS, FIXED or PULSER."""
    if chip.variant != MCX514_TYPE:
        return axis.wr[3] >> EXOP_304 & 3
    levels = ports.find_general_input_pins(axis) >> EXP_PLUS_SHIFT - ports.PIO0_SHIFT & 3
    return axis.mode[P2M] >> EXOP_514 & 3 if levels == 3 else OFF


@hot
def reset_external_drives(axis):
    """Note the present levels of the inputs EXP+ and EXP-, so that they do not count as changes."""
    axis.last_exp_levels, axis.exp_driving = _read_exp_levels(axis), 0


@hot
def _start_drive(chip, axis, minus, fixed):
    """Start the drive that a change of EXP+ or EXP- requests, unless the axis is busy.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        minus: Whether the drive goes in - direction.
        fixed: Whether the drive makes a fixed number of pulses.
    """
    if not fixed:
        kind = single_axis_drive.BACKWARD if minus else single_axis_drive.FORWARD
    elif chip.variant == MCX514_TYPE:
        kind = single_axis_drive.COUNTER_RELATIVE if minus else single_axis_drive.RELATIVE
    else:
        kind = single_axis_drive.FIXED_MINUS if minus else single_axis_drive.FIXED_PLUS
    if not (axis.driving or axis.awaits_inpos or axis.home_state or axis.interpolates):
        axis.exp_driving = 0 if fixed else MINUS if minus else PLUS
        single_axis_drive.execute_drive_command(chip, axis, kind)


@hot
def apply_pin_changes(chip, axis):
    """Start and stop external drives after changes of the inputs EXP+ and EXP- since the last call."""
    levels = _read_exp_levels(axis)
    if axis.exp_driving and not axis.driving:
        axis.exp_driving = 0
    if levels == axis.last_exp_levels:
        return
    flip = 3 if chip.variant == MCX514_TYPE else 0  # of PIO the level is known, of EXP whether it is asserted
    before, now = axis.last_exp_levels ^ flip, levels ^ flip
    fallen, risen = now & ~before, before & ~now
    axis.last_exp_levels = levels
    if risen & axis.exp_driving:
        axis.exp_driving = 0
        single_axis_drive.begin_decelerating_stop(chip, axis, 0)
    mode = _read_exp_mode(chip, axis)
    if mode == PULSER:
        if (fallen | risen) & PLUS and now & MINUS:
            _start_drive(chip, axis, fallen & PLUS, 1)
    elif mode != OFF and fallen:
        _start_drive(chip, axis, not fallen & PLUS, mode == FIXED)
