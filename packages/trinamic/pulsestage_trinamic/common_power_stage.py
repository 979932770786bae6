"""Compiled parts that the power stages of all chips share: the current in motion and at rest, latched faults, speed thresholds.

The state has the fields `clock`, `inputs`, `current`, `cs`, `falls`, `shorts`, `hot` and `gstat`, see the records of the chips.
"""

from __future__ import annotations

from stage.native import hot

NEVER = 1 << 62
RUNS, FALLS, HOLDS = range(3)
"""Values of `current`: at IRUN, on its way down, at IHOLD."""
DISS2G, DISS2VS = 1 << 30, 1 << 31
"""Bits of CHOPCONF that switch the protection from shorts to ground and to the supply off."""
RESET, DRV_ERR, UV_CP = 1, 2, 4
"""Bits of GSTAT."""


# --- current: `ihold_irun` is the register ---


@hot
def get_irun(ihold_irun):
    return ihold_irun >> 8 & 31


@hot
def get_ihold(ihold_irun):
    return ihold_irun & 31


@hot
def get_iholddelay(ihold_irun):
    """Return the time between two steps of the motor current on its way down, in 2^18 clocks."""
    return ihold_irun >> 16 & 15


@hot
def raise_current(c, ihold_irun):
    """Raise the motor current to IRUN, if it was reduced at standstill."""
    if c.current != RUNS:
        c.current, c.falls, c.cs = RUNS, NEVER, get_irun(ihold_irun)


@hot
def apply_current_register(c, ihold_irun):
    """Apply a write of IHOLD_IRUN, the register of the motor currents."""
    if c.current == RUNS:
        c.cs = get_irun(ihold_irun)
    elif c.current == HOLDS:
        c.cs = get_ihold(ihold_irun)


@hot
def find_next_reduction(c, begin):
    """Return the clock at which the motor current falls next, or NEVER. `begin` is the clock at which it leaves IRUN."""
    return begin if c.current == RUNS else c.falls


@hot
def reduce_current(c, ihold_irun, begin, delay):
    """Lower the motor current to IHOLD, step by step.

    Args:
        c: State of the chip.
        ihold_irun: Register IHOLD_IRUN.
        begin: Clock at which the current leaves IRUN.
        delay: Clocks between two steps; 0: no steps.
    """
    ihold = get_ihold(ihold_irun)
    if c.current == RUNS and c.clock >= begin:
        c.current, c.falls = FALLS, c.clock + delay
    if c.current == FALLS and c.clock >= c.falls:
        if delay == 0:
            c.cs = ihold
        elif c.cs != ihold:
            c.cs += 1 if ihold > c.cs else -1
        c.falls += delay
        if c.cs == ihold:
            c.current, c.falls = HOLDS, NEVER


# --- faults ---


@hot
def latch_faults(c, is_driving, chopconf, to_ground, to_supply, ot, otpw):
    """Latch the power stage faults that are present; each switches the power stage off.

    Args:
        c: State of the chip.
        is_driving: The chopper is enabled; otherwise shorts are cleared.
        chopconf: Register CHOPCONF.
        to_ground: Pins of shorts to ground.
        to_supply: Pins of shorts to the supply.
        ot: Pin of overtemperature.
        otpw: Pin of its warning, whose end allows the power stage again.
    """
    if is_driving:
        c.shorts |= c.inputs & ((0 if chopconf & DISS2G else to_ground) | (0 if chopconf & DISS2VS else to_supply))
    else:
        c.shorts = 0
    if c.inputs & ot:
        c.hot = 1
    elif not c.inputs & otpw:
        c.hot = 0
    if c.shorts or c.hot:
        c.gstat |= DRV_ERR


# --- speed ---


@hot
def get_bit_if_passed(passed_before, bit, threshold, upper, excludes_equal, tstep):
    """Return the bit of a speed threshold if TSTEP has passed the threshold, with hysteresis, else 0.

    Args:
        passed_before: Bits of the thresholds that were passed before.
        bit: Bit of this threshold.
        threshold: Register of the threshold; 0: it is never passed.
        upper: Greatest TSTEP at which it is passed whatever was before.
        excludes_equal: Whether the threshold is not passed at TSTEP = threshold.
        tstep: TSTEP.
    """
    if threshold == 0:
        return 0
    if tstep <= upper:
        return bit
    if tstep > threshold or (excludes_equal and tstep == threshold):
        return 0
    return passed_before & bit
