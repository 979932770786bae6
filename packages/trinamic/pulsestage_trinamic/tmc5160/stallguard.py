"""TMC5160, compiled: StallGuard2, which sees the load at each full step, and CoolStep, which follows it."""

from __future__ import annotations

from pulsestage_trinamic.tmc5160 import power, sequencer, speeds, state
from stage.native import hot, least

PER_SGT, FULL_EMF, UNLOADED = 8, 1024, 1023  # of the model of StallGuard


@hot
def measures(c):
    """Return whether StallGuard measures at each full step."""
    return power.on(c) and not speeds.stealth(c)


@hot
def blind(c):
    """Clear the result, because there are no measurements."""
    if not measures(c):
        c.sg = c.stall = 0


@hot
def cools(c):
    return c.reg[state.COOLCONF] & 15 and c.speeds & state.COOL and not c.speeds & state.HIGH and not speeds.stealth(c)


@hot
def settle(c):
    """Update thresholds and measurements after registers or faults may have changed."""
    c.speeds = speeds.speeds_at(c, c.q)
    blind(c)
    cooling = 1 if cools(c) else 0
    if c.cooling and not cooling:
        c.count = 0
        if c.current == state.RUNS:
            c.cs = power.irun(c)
    c.cooling = cooling


@hot
def step(c):
    """Process one step with its StallGuard measurement, and return whether a stall stops the motor."""
    before = c.mscnt >> 8
    sequencer.steps(c, 1, c.clock)
    if c.mscnt >> 8 == before or not measures(c):
        return False
    return _measure(c)


@hot
def _measure(c):
    c.full += 1
    sgt = c.reg[state.COOLCONF] >> 16 & 127
    raw = (UNLOADED * c.emf * (FULL_EMF - c.lam)) >> 20
    value = raw + PER_SGT * (sgt - 128 if sgt > 63 else sgt)
    value = 0 if value < 0 else least(value, 1023)
    if c.reg[state.COOLCONF] & state.SFILT:
        c.total += value
        c.summed += 1
        if c.summed < 4:
            return False
        value = c.total >> 2
    c.total = c.summed = 0
    c.sg = value
    c.stall = 1 if value == 0 else 0
    if c.cooling:
        _cool(c)
    if c.stall and c.reg[state.SW_MODE] & state.SG_STOP and speeds.window(c):
        c.events |= state.EVENT_SG
        return True
    return False


@hot
def _cool(c):
    r = c.reg[state.COOLCONF]
    low, top = 32 * (r & 15), 32 * ((r & 15) + (r >> 8 & 15) + 1)
    if c.sg < low:
        c.cs = least(power.irun(c), c.cs + (1 << (r >> 5 & 3)))
        c.count = 0
    elif c.sg >= top:
        c.count += 1
        sedn = r >> 13 & 3
        if c.count >= (32 if sedn == 0 else 8 if sedn == 1 else 2 if sedn == 2 else 1):
            c.count = 0
            bottom = power.irun(c) >> (2 if r >> 15 & 1 else 1)
            c.cs = bottom if c.cs - 1 < bottom else c.cs - 1
    else:
        c.count = 0


@hot
def load(c, lam, emf):
    """Set the load of a chip that is not on a stage; see LAM and EMF in the documentation."""
    c.lam, c.emf = lam, emf


@hot
def sample_load(c, lam, emf):
    """Take a sample of the load; LAM and EMF are the means over a full step. Return whether the sample can change anything."""
    if c.dir == 0 or not measures(c):
        return 0
    if c.load_of != c.full:
        c.load_of, c.load_n, c.load_sum, c.emf_sum = c.full, 0, 0, 0
    c.load_n += 1
    c.load_sum += lam
    c.emf_sum += emf
    c.lam, c.emf = c.load_sum // c.load_n, c.emf_sum // c.load_n
    return 1
