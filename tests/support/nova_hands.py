"""NOVA chips by hand: home search, synchronous actions, timer, split pulse, comparisons and ports on the bus and at the pins.

Codes and bits are typed from shared/spec/nova_mcx514.md and nova_mcx304.md, not taken from the product.
"""

import copy

from stage.chips import MCX514
from support.nova_bench import SECOND, X, command, put

US, MS = SECOND // 1_000_000, SECOND // 1000
DATA = dict(
    JK=0x00, DJ=0x01, AC=0x02, DC=0x03, SV=0x04, DV=0x05, TP=0x06, DP=0x07, LP=0x09, RP=0x0A, SP=0x0B, SM=0x0C, AO=0x0D,
    LX=0x0E, RX=0x0F, MR0=0x10, MR1=0x11, MR2=0x12, MR3=0x13, HV=0x14, IV=0x15, TM=0x16, SP1=0x17, SP2=0x18, MRM=0x20,
    P1M=0x21, P2M=0x22, H1M=0x23, H2M=0x24, FLM=0x25, S0M=0x26, S1M=0x27, S2M=0x28, S3M=0x29,
)  # fmt: skip
DATA_304 = dict(R=0x00, K=0x01, A=0x02, SV=0x04, V=0x05, P=0x06, LP=0x09, EP=0x0A, CP=0x0B, CM=0x0C, HM=0x60, HV=0x61)
READ = dict(LP=0x30, RP=0x31, CV=0x32, CA=0x33, MR0=0x34, MR1=0x35, MR2=0x36, MR3=0x37, CT=0x38, SV=0x44, DV=0x45,
            AC=0x43, TP=0x46, SP1=0x47)  # fmt: skip
CMR0, D_STA, C_STA, C_END, D_END, H_END, TIMER, SPLTP, SPLTE, SYNC0 = (
    1 << k for k in (0, 4, 5, 6, 7, 8, 9, 10, 11, 12))  # fmt: skip


def load(chip, axes=X, **values):
    """Parameters and modes by name."""
    codes = DATA if isinstance(chip, MCX514) else DATA_304
    for name, value in values.items():
        put(chip, codes[name], value, axes)


def nop(chip):
    return 0x1F if isinstance(chip, MCX514) else 0x0F


def set_word(chip, n, value, axes=X):
    """WR1, WR2 or WR3 of an axis."""
    command(chip, nop(chip), axes)
    chip.write(n, value)


def word(chip, n, axes=X):
    """RR1, RR2 or RR3 of an axis."""
    command(chip, nop(chip), axes)
    return chip.read(n)


def page1(chip, axes=X):
    """RR3 page 1."""
    command(chip, 0x7B, axes)
    return chip.read(3)


def home_state(chip, axes=X):
    """HSST, or HMST of the older chips."""
    if isinstance(chip, MCX514):
        command(chip, 0x7A, axes)
        return chip.read(3) >> 9 & 0x3F
    return word(chip, 2, axes) >> 8 & 0x1F


def cruise(chip, pps=1_000_000, minus=False, axes=X):
    """A drive without end at one speed: at 1,000,000 pps a pulse every 16 clocks."""
    load(chip, axes, SV=pps, DV=pps)
    command(chip, 0x53 if minus else 0x52, axes)


def passes(chip, clock, read):
    """Return the results of `read` one clock before `clock`, and at it."""
    chip.advance(clock - 1 - chip.clock)
    before = read(chip)
    chip.advance(1)
    return before, read(chip)


def pulses(chip, clocks):
    """Clocks at which a chip would begin its pulses; the chip itself stays."""
    return copy.copy(chip).trace(clocks)["clock"].tolist()
