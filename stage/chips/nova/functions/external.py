"""NOVA chips, compiled: drives by the pins EXP+ and EXP-, low when asserted; of the MCX514 these are PIO4 and PIO5.

    continuous      EXP+  ^^^^|_________|^^^^        + continuous drive, then a decelerating stop; EXP- alike, in - direction
    fixed           EXP+  ^^^^|___|^^^^^^^^^^        a + fixed-pulse drive from each fall on; EXP- alike
    manual pulser   EXP+  ___|^^^^^^^^|______        with EXP- low: a rise begins a + drive, a fall a - drive
                    EXP-  ________|^^^^^^^^|_        so a handwheel's A and B make one drive a turn, either way

On the MCX514 a fixed drive is 50h for EXP+ and 51h for EXP-, with the pulses of TP; before it 20h and 21h, with those of P. What
falls while the axis is busy is lost [M]. Inferred: in the continuous mode the fall begins the drive, not the level, and the release
stops it in whatever mode then is; where both pins fall at one clock EXP+ counts; PIO4 and PIO5 count while they are general inputs.
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
def _levels(x):
    return x.level >> EXP & 3


@hot
def _mode(c, x):
    if c.variant != MCX514_TYPE:
        return x.wr[3] >> EXOP_304 & 3
    levels = ports.inputs(x) >> EXP - ports.FIRST & 3
    return x.mode[P2M] >> EXOP_514 & 3 if levels == 3 else OFF


@hot
def reset(x):
    x.exp, x.exp_drives = _levels(x), 0


@hot
def _start(c, x, minus, fixed):
    if not fixed:
        kind = drive.BACKWARD if minus else drive.FORWARD
    elif c.variant == MCX514_TYPE:
        kind = drive.COUNTER_RELATIVE if minus else drive.RELATIVE
    else:
        kind = drive.FIXED_MINUS if minus else drive.FIXED_PLUS
    if not (x.driving or x.waiting or x.home or x.interpolates):
        x.exp_drives = 0 if fixed else MINUS if minus else PLUS
        drive.start(c, x, kind)


@hot
def step(c, x):
    """Apply the changes of the pins since the last call."""
    levels = _levels(x)
    if x.exp_drives and not x.driving:
        x.exp_drives = 0
    if levels == x.exp:
        return
    flip = 3 if c.variant == MCX514_TYPE else 0  # of PIO the level is known, of EXP whether it is asserted
    before, now = x.exp ^ flip, levels ^ flip
    fallen, risen = now & ~before, before & ~now
    x.exp = levels
    if risen & x.exp_drives:
        x.exp_drives = 0
        drive.request_stop(c, x, 0)
    mode = _mode(c, x)
    if mode == PULSER:
        if (fallen | risen) & PLUS and now & MINUS:
            _start(c, x, fallen & PLUS, 1)
    elif mode != OFF and fallen:
        _start(c, x, not fallen & PLUS, mode == FIXED)
