"""NOVA chips, compiled: linear, circular, helical and bit-pattern interpolation, alone and continuous."""

from __future__ import annotations

from stage.chips.nova import drive
from stage.compiled import hot


@hot
def reset(c):
    c.interpolating = 0
    for k in range(len(c.work)):
        c.work[k] = 0


@hot
def command(c, code):
    """60h to 6Fh, 7Ch."""


@hot
def status_bits(c):
    """RR0: ZONE, CNEXT, SC."""
    return 0


@hot
def multichip_error(c):
    return 0


@hot
def rotations(c):
    """CHLN."""
    return 0


@hot
def speed_reading(c, x):
    return drive.speed_reading(c, x)


@hot
def move(c, clock):
    """Let the ticks up to `clock` begin."""


@hot
def step(c):
    """What is due at the present clock; sets `stale` where it changes something."""


@hot
def next_event(c):
    """The clock of the next event of the interpolation, which is where the engine of pulses must stop."""
    return 1 << 60


@hot
def trace(c, until, out, k):
    """As `move`, and logs the pulses in out[k:]. Returns k and how many."""
    return k


@hot
def command304(c, code):
    """30h to 3Dh of the MCX312."""


@hot
def takes_pattern(c):
    """WR2 to WR5 are the bit pattern now."""
    return 0


@hot
def load_pattern(c, k, value):
    """BP1P, BP1M, BP2P, BP2M."""


@hot
def status_bits304(c):
    """RR0 of the MCX312: I-DRV, CNEXT, ZONE, BPSC."""
    return 0


@hot
def next_tick(c):
    """The clock of the next tick."""
    return 1 << 60
