"""NOVA chips on the bench: their buses by hand, moves that chip and reference both make, and how they are compared.

Command codes and bits are typed from the specification pages of the chips, not taken from the product.
"""

import random
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

from reference.nova_profile import SECOND, Drive, ceil_clock

from support.examples import EXAMPLES, SEED

MAX_PULSES = 100_000  # pulses, or twice as many: a slow S-curve to a high speed would make millions
ROUNDING = 1e-9  # clocks; a pulse due this near to a whole clock may be rounded to the clock beside
X, Y, Z, U = 1, 2, 4, 8
DATA_514 = dict(JK=0x00, DJ=0x01, AC=0x02, DC=0x03, SV=0x04, DV=0x05, TP=0x06, DP=0x07, CP=0x08, LP=0x09, AO=0x0D)
DATA_514.update(IV=0x15, HLN=0x1A, IPM=0x2A)
DATA_304 = dict(R=0x00, K=0x01, A=0x02, D=0x03, SV=0x04, V=0x05, P=0x06, DP=0x07, LP=0x09, AO=0x0D)
MANLD, DSNDE, SACC = 0x0001, 0x0002, 0x0004  # WR3 of both families
AVTRI_514, AVTRI_304 = (0x2000, 0), (0, 0x0020)  # of WR3, prevention off and on: the MCX514 reversed the sense
NOP_514, NOP_304 = 0x1F, 0x0F


def examples(share):
    """Return as many random generators as this share of EXAMPLES, each with a seed of its own."""
    print("PULSESTAGE_SEED", SEED)
    for n in range(max(int(EXAMPLES * share), 4)):
        yield random.Random(SEED + n)


# The bus


def command(chip, code, axes=X):
    chip.write(0, axes << 8 | code)


def put(chip, code, value, axes=X):
    """A data-writing command: WR6, WR7, WR0."""
    chip.write(6, value & 0xFFFF)
    chip.write(7, value >> 16 & 0xFFFF)
    command(chip, code, axes)


def load(chip, axes=X, **values):
    """Parameters of an MCX514 by name."""
    for name, value in values.items():
        put(chip, DATA_514[name], value, 0 if name in ("HLN", "IPM") else axes)


def load_304(chip, axes=X, **values):
    for name, value in values.items():
        put(chip, DATA_304[name], value, axes)


def set_wr3(chip, bits, axes=X, nop=NOP_514):
    command(chip, nop, axes)
    chip.write(3, bits)


def get(chip, code, axes=X):
    """A data-reading command: the unsigned value of RR7, RR6."""
    command(chip, code, axes)
    return chip.read(6) | chip.read(7) << 16


def get_signed(chip, code, axes=X):
    value = get(chip, code, axes)
    return value - (value >> 31 << 32)


def driving(chip, axes=0xF):
    return bool(chip.read(0) & axes)


# Moves


class Move(NamedTuple):
    """Move that both chips are commanded, in physical units. P: None for a continuous drive."""

    SV: int | Fraction
    DV: int | Fraction
    AC: int | Fraction = 1_000_000
    DC: int | Fraction = 1_000_000
    JK: int | Fraction = 1_000_000
    DJ: int | Fraction = 1_000_000
    P: int | None = None
    DP: int | None = None
    AO: int = 0
    s_curve: bool = False
    asymmetric: bool = False
    triangle_prevention: bool = True

    def reference(self, *interventions):
        return _drive(self, interventions)

    def wr3(self, avtri):
        """WR3; `avtri`: its bit for the state that triangle prevention is in."""
        bits = (MANLD, self.DP is not None), (DSNDE, self.asymmetric), (SACC, self.s_curve)
        return sum(bit for bit, on in bits if on) | avtri[self.triangle_prevention]


@lru_cache(64)
def _drive(move, interventions):
    """Drive all chips that have the same commands with one reference: it takes longer than the product."""
    return Drive(**move._asdict(), interventions=interventions)


def prepare(chip, move, axes=X):
    """Load a move into an MCX514, without a start."""
    load(chip, axes, **{name: getattr(move, name) for name in ("SV", "DV", "AC", "DC", "JK", "DJ", "AO")})
    set_wr3(chip, move.wr3(AVTRI_514), axes)
    if move.DP is not None:
        load(chip, axes, DP=move.DP)


def start(chip, move, axes=X, minus=False):
    """Load a move into an MCX514 and start it; the clock of the start."""
    prepare(chip, move, axes)
    if move.P is not None:
        load(chip, axes, TP=-move.P if minus else move.P)
        command(chip, 0x50, axes)
    else:
        command(chip, 0x53 if minus else 0x52, axes)
    return chip.clock


def intervene(chip, what, *value, axes=X, minus=False):
    """An intervention of the reference, as bus writes to an MCX514."""
    if what == "DV":
        load(chip, axes, DV=value[0])
    elif what == "P":
        load(chip, axes, TP=-value[0] if minus else value[0])
    else:
        command(chip, {"slow": 0x56, "stop": 0x57}[what], axes)


def random_move(rng, fixed=None):
    """Speeds and times on a log scale, up to some 2000 pulses; any of the options."""
    sv, gain = log_uniform(rng, 1, 100_000), log_uniform(rng, 1, 100_000)
    seconds = log_uniform(rng, 1, 1000) / 1000
    ac = max(int(gain / seconds), 1)
    jerk = max(int(ac / seconds * rng.choice([1, 2.5, 4, 20])), 1)  # 4 and more have a part of constant acceleration
    pulses = log_uniform(rng, 1, 2000)
    fixed = rng.random() < 0.8 if fixed is None else fixed
    return Move(
        SV=sv,
        DV=sv + gain,
        AC=ac,
        DC=max(int(ac * rng.choice([0.3, 1, 2.2])), 1),
        JK=min(jerk, 0x3FFFFFFF),
        DJ=min(max(int(jerk * rng.choice([0.4, 1, 3])), 1), 0x3FFFFFFF),
        P=pulses if fixed else None,
        DP=rng.randint(0, pulses) if fixed and rng.random() < 0.15 else None,
        AO=rng.choice([0, 0, rng.randint(-20, 60)]),
        s_curve=rng.random() < 0.5,
        asymmetric=rng.random() < 0.4,
        triangle_prevention=rng.random() < 0.5,
    )


def log_uniform(rng, low, high):
    return min(high, int(low * ((high + 1) / low) ** rng.random()))


def draw_clock(rng, drive, most_pulses=2000):
    """Draw a clock in a random phase of a drive, all equally likely, within MAX_PULSES pulses."""
    piece = rng.choice([p for p in drive.pieces if (drive.end is None or p.t < drive.end) and p.p < MAX_PULSES])
    max_seconds = min(piece.length, most_pulses / piece.v)
    while piece.position(max_seconds) > 2 * MAX_PULSES:
        max_seconds /= 2
    until = piece.t + max_seconds
    if drive.end is not None:
        until = min(until, drive.end)
    low, high = ceil_clock(piece.t * SECOND), int(until * SECOND)
    return rng.randint(low, max(low, high))


# The comparison


def played(chip, interventions, until, act=intervene):
    """Let a started chip run until a clock since now, intervening on the way; its pulses as (clock since now, direction)."""
    began, pulses = chip.clock, []
    for clock, *what in (*interventions, (until,)):
        trace = chip.trace(began + clock - chip.clock)
        pulses += zip((trace["clock"] - began).tolist(), trace["direction"].tolist(), strict=True)
        if what:
            act(chip, *what)
    return pulses


def assert_pulses(clocks, drive, note, until=None):
    """Clocks of the product's pulses are the reference's; says which pulse differs first."""
    times = drive.pulse_times(until)
    due = [ceil_clock(t) for t in times]
    for k, (clock, expected, exact) in enumerate(zip(clocks, due, times, strict=False), 1):
        if clock != expected:
            near = abs(exact - round(exact)) < ROUNDING and abs(clock - expected) == 1
            assert near, f"pulse {k} at {clock}, due at {expected} ({float(exact):.9f})\n{note}"
    assert len(clocks) == len(due), f"{len(clocks)} pulses, due {len(due)}\n{note}"


def assert_move_matches_reference(chip, move, interventions=(), minus=False, until=None):
    """Start a move on a fresh MCX514 and compare it to the end with the reference."""
    drive = move.reference(*interventions)
    note = f"{move} {interventions} PULSESTAGE_SEED={SEED}"
    until = drive.end_clock if until is None else until
    start(chip, move, minus=minus)
    pulses = played(chip, interventions, until, lambda *what: intervene(*what, minus=minus))
    assert_pulses([clock for clock, _ in pulses], drive, note, until)
    assert {direction for _, direction in pulses} <= {-1 if minus else 1}, note
    if drive.end_clock is not None and drive.end_clock <= until:
        assert not driving(chip), f"it goes on\n{note}"
        assert chip.advance(SECOND) == 0, note
    return drive
