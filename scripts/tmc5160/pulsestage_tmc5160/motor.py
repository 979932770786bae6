"""TMC5160, compiled: sequencer, current, StallGuard and CoolStep; thresholds on speed; faults of the power stage."""

from __future__ import annotations

from pulsestage_tmc5160.state import (
    CHOPCONF,
    COOL,
    COOLCONF,
    DISS2G,
    DISS2VS,
    DRV_ENN,
    EN_PWM,
    ENC_DEVIATION,
    EVENT_SG,
    FALLS,
    FAST_STANDSTILL,
    GCONF,
    GLOBALSCALER,
    HIGH,
    HOLDS,
    IHOLD_IRUN,
    NEVER,
    OT,
    OTPW,
    PWMCONF,
    RUNS,
    SFILT,
    SG_STOP,
    SHAFT,
    SHORT_G,
    SHORT_VS,
    SLOW,
    SMALL_HYSTERESIS,
    STOP_ENABLE,
    SW_MODE,
    TCOOLTHRS,
    THIGH,
    TPOWERDOWN,
    TPWMTHRS,
    TSTEP_MOST,
    UNIT,
    UV_CP,
    VHIGHFS,
    mres,
)
from stage.native import hot, least

FULL_SCALE = 0.325  # V at RSENSE, with CS = 31 and GLOBALSCALER = 256
PER_SGT, FULL_EMF, UNLOADED = 8, 1024, 1023  # of the model of StallGuard
DELAY = 18  # times are in 2^18 clocks


# --- what holds now ---


@hot
def gated(c):
    """The emergency stop holds all steps: ENCA as the last clock saw it."""
    return c.reg[GCONF] & STOP_ENABLE and c.enc_pins & 1


@hot
def on(c):
    """The power stage drives the motor."""
    enabled = c.reg[CHOPCONF] & 15 and not c.inputs & DRV_ENN
    return enabled and not (c.shorts or c.hot or c.inputs & UV_CP)


@hot
def stealth(c):
    return c.reg[GCONF] & EN_PWM and not c.speeds


@hot
def measures(c):
    """StallGuard sees each full step."""
    return on(c) and not stealth(c)


@hot
def window(c):
    """A stall stops, and status_sg shows it."""
    return c.speeds & COOL and not stealth(c) and not (c.speeds & HIGH and c.reg[CHOPCONF] & VHIGHFS)


@hot
def cools(c):
    return c.reg[COOLCONF] & 15 and c.speeds & COOL and not c.speeds & HIGH and not stealth(c)


@hot
def irun(c):
    return c.reg[IHOLD_IRUN] >> 8 & 31


@hot
def ihold(c):
    return c.reg[IHOLD_IRUN] & 31


@hot
def amplitude(c):
    """Of the phase currents, A."""
    if not on(c):
        return 0.0
    if c.current == HOLDS and c.cs == 0 and c.reg[GCONF] & EN_PWM and c.reg[PWMCONF] >> 20 & 3:
        return 0.0
    scale = c.reg[GLOBALSCALER]
    return (256 if scale == 0 else scale) / 256.0 * (c.cs + 1) / 32.0 * FULL_SCALE / c.rsense


# --- thresholds ---


@hot
def tstep(c, q):
    """TSTEP at a speed."""
    v = q >> UNIT
    if v == 0 or gated(c):
        return TSTEP_MOST
    return least(TSTEP_MOST, ((1 << 24) // v) >> mres(c))


@hot
def _passed(c, was, bit, threshold, strictly, t):
    if threshold == 0:
        return 0
    low = threshold * 31 // 32 - 1 if c.reg[GCONF] & SMALL_HYSTERESIS else threshold * 15 // 16 - 1
    if t <= low:
        return bit
    if t > threshold or (strictly and t == threshold):
        return 0
    return was & bit


@hot
def speeds_at(c, q):
    """The thresholds that are passed when the speed becomes q."""
    slow, cool, high = c.reg[TPWMTHRS], c.reg[TCOOLTHRS], c.reg[THIGH]
    if not (slow | cool | high):
        return 0
    t, was = tstep(c, q), c.speeds
    return (
        _passed(c, was, SLOW, slow, True, t)
        | _passed(c, was, COOL, cool, False, t)
        | _passed(c, was, HIGH, high, False, t)
    )


@hot
def settle(c):
    """Thresholds, registers or faults may have changed."""
    c.speeds = speeds_at(c, c.q)
    if not measures(c):
        c.sg = c.stall = 0
    cooling = 1 if cools(c) else 0
    if c.cooling and not cooling:
        c.count = 0
        if c.current == RUNS:
            c.cs = irun(c)
    c.cooling = cooling


# --- steps ---


@hot
def _up(c):
    """The field turns to greater MSCNT."""
    return (c.dir > 0) != ((c.reg[GCONF] & SHAFT) != 0)


@hot
def _stepped(c, k):
    """The sequencer's position after k steps, not wrapped."""
    power, at = mres(c), c.mscnt
    size = 1 << power
    half = size >> 1
    if power == 0:
        return at + k if _up(c) else at - k
    if _up(c):
        return (((at + half) >> power) << power) + half + (k - 1) * size
    return ((-((half - at) >> power) - 1) << power) + half - (k - 1) * size


@hot
def steps_to_full(c):
    """The step that next changes MSCNT >> 8, counted from 1."""
    size, first = 1 << mres(c), _stepped(c, 1)
    if _up(c):
        end = ((c.mscnt >> 8) << 8) + 256
        return 1 if first >= end else 1 + (end - first + size - 1) // size
    end = (c.mscnt >> 8) << 8
    return 1 if first < end else 2 + (first - end) // size


@hot
def steps(c, k, clock):
    """k steps, the last at `clock`."""
    now = _stepped(c, k)
    c.net += now - c.mscnt
    c.mscnt = now & 1023
    c.toggle ^= k & 1
    c.way = c.dir
    c.last = clock
    if c.current != RUNS:
        c.current, c.falls = RUNS, NEVER
        c.cs = irun(c)


@hot
def step(c):
    """One step, now; what StallGuard sees in it. Returns whether a stall stops."""
    before = c.mscnt >> 8
    steps(c, 1, c.clock)
    if c.mscnt >> 8 == before or not measures(c):
        return False
    return _measure(c)


@hot
def _measure(c):
    c.full += 1
    sgt = c.reg[COOLCONF] >> 16 & 127
    raw = (UNLOADED * c.emf * (FULL_EMF - c.lam)) >> 20
    value = raw + PER_SGT * (sgt - 128 if sgt > 63 else sgt)
    value = 0 if value < 0 else least(value, 1023)
    if c.reg[COOLCONF] & SFILT:
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
    if c.stall and c.reg[SW_MODE] & SG_STOP and window(c):
        c.events |= EVENT_SG
        return True
    return False


@hot
def _cool(c):
    r = c.reg[COOLCONF]
    low, top = 32 * (r & 15), 32 * ((r & 15) + (r >> 8 & 15) + 1)
    if c.sg < low:
        c.cs = least(irun(c), c.cs + (1 << (r >> 5 & 3)))
        c.count = 0
    elif c.sg >= top:
        c.count += 1
        sedn = r >> 13 & 3
        if c.count >= (32 if sedn == 0 else 8 if sedn == 1 else 2 if sedn == 2 else 1):
            c.count = 0
            bottom = irun(c) >> (2 if r >> 15 & 1 else 1)
            c.cs = bottom if c.cs - 1 < bottom else c.cs - 1
    else:
        c.count = 0


@hot
def load(c, lam, emf):
    """The load, live: see LAM and EMF of the page."""
    c.lam, c.emf = lam, emf


@hot
def sample_load(c, lam, emf):
    """A sample of the load: LAM and EMF are the means over the full step. Returns whether anything can come of it."""
    if c.dir == 0 or not measures(c):
        return 0
    if c.load_of != c.full:
        c.load_of, c.load_n, c.load_sum, c.emf_sum = c.full, 0, 0, 0
    c.load_n += 1
    c.load_sum += lam
    c.emf_sum += emf
    c.lam, c.emf = c.load_sum // c.load_n, c.emf_sum // c.load_n
    return 1


# --- time at standstill ---


@hot
def _limit(c):
    return 1 << (18 if c.reg[GCONF] & FAST_STANDSTILL else 20)


@hot
def stands(c):
    """DRV_STATUS b31."""
    return c.clock - c.last >= _limit(c)


@hot
def next_timer(c):
    """The clock at which the standstill next changes something."""
    stops = c.last + _limit(c)
    at = NEVER
    if c.sg or c.stall or c.summed:
        at = stops
    if c.current == RUNS:
        at = least(at, stops + (c.reg[TPOWERDOWN] << DELAY))
    elif c.current == FALLS:
        at = least(at, c.falls)
    return at if at > c.clock else c.clock + 1


@hot
def timers(c):
    """What the time since the last step does."""
    stops = c.last + _limit(c)
    if c.clock >= stops and (c.sg or c.stall or c.summed):
        c.sg = c.stall = c.total = c.summed = 0
    delay = (c.reg[IHOLD_IRUN] >> 16 & 15) << DELAY
    if c.current == RUNS and c.clock >= stops + (c.reg[TPOWERDOWN] << DELAY):
        c.current, c.falls = FALLS, c.clock + delay
    if c.current == FALLS and c.clock >= c.falls:
        if delay == 0:
            c.cs = ihold(c)
        elif c.cs != ihold(c):
            c.cs += 1 if ihold(c) > c.cs else -1
        c.falls += delay
        if c.cs == ihold(c):
            c.current, c.falls = HOLDS, NEVER


@hot
def currents_written(c):
    """IHOLD_IRUN has been written."""
    if c.current == RUNS:
        c.cs = irun(c)
    elif c.current == HOLDS:
        c.cs = ihold(c)


# --- faults ---


@hot
def conditions(c):
    """Faults that are there: latched, and the power stage off."""
    chop = c.reg[CHOPCONF]
    if chop & 15 == 0 or c.inputs & DRV_ENN:
        c.shorts = 0
    else:
        c.shorts |= c.inputs & ((0 if chop & DISS2G else SHORT_G) | (0 if chop & DISS2VS else SHORT_VS))
    if c.inputs & OT:
        c.hot = 1
    elif not c.inputs & OTPW:
        c.hot = 0
    if c.shorts or c.hot:
        c.gstat |= 2
    if c.inputs & UV_CP:
        c.gstat |= 4
    if not measures(c):
        c.sg = c.stall = 0
    most = c.reg[ENC_DEVIATION]
    if most and abs(c.enc - c.x) > most:
        c.enc_flags |= 2


# --- what can be read ---


@hot
def sine(i):
    """CUR_A of the default table at MSCNT = i."""
    i &= 1023
    if i >= 512:
        return -sine_half(i - 512) - 1
    return sine_half(i)


@hot
def sine_half(i):
    """Entries 0 to 511."""
    return TABLE[511 - i if i > 255 else i]


def _table():
    import math

    found = []
    for i in range(256):
        value = 248 * math.sin(2 * math.pi * i / 1024 + math.pi / 1024)
        found.append(max(1, math.floor(value + 0.5)) - 1)
    return tuple(found)


TABLE = _table()


@hot
def status(c):
    """DRV_STATUS."""
    word = c.sg | c.cs << 16 | c.stall << 24
    word |= 1 << 14 if stealth(c) else 0
    word |= 1 << 15 if c.speeds & HIGH and c.reg[CHOPCONF] & VHIGHFS else 0
    word |= (c.shorts >> 8 & 3) << 27 | (c.shorts >> 10 & 3) << 12
    word |= (1 << 25 if c.hot else 0) | (1 << 26 if c.inputs & OTPW else 0)
    word |= (c.inputs >> 14 & 3) << 29
    return word | (1 << 31 if stands(c) else 0)
