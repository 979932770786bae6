"""MCX514: mode registers, WR0 to WR7 and RR0 to RR7, bit by bit.

Names of mode bits are those of the manual, from memory [M]; where the bits are is known from working drivers [C].
"""

from __future__ import annotations

from stage.chips.nova.registers.common import (
    AXES,
    DATA_READ,
    DATA_WRITTEN,
    DCC_WIDTHS,
    LEVELS,
    axis_bits,
    bit,
    bits,
    times,
    word,
)
from stage.chips.register_map import Field, Register, Word


def _mode(code: int, name: str, title: str, *fields: Field, access: str = "W", evidence: str = "C") -> Register:
    ordered = tuple(sorted(fields, key=lambda f: -f.high))
    return Register(name, code, 16, access, title, None, ordered, evidence, reset=0)


def _pio(i: int) -> Field:
    third = "sync pulse" if i < 4 else f"MR{i - 4} comparison"
    return bits(f"P{i}M", 2 * i + 1, 2 * i, f"PIO{i}", values=("input", "output", "drive status", third))


def _sync(n: int, axes: int = 4) -> Register:
    actions_of_set = {4: f"MR{n} -> {('LP', 'RP', 'SV', 'AC')[n]}", 8: ("CV -> MR0", "CA -> MR1", "none", "none")[n]}
    return _mode(
        0x26 + n, f"S{n}M", f"synchronous action set {n}",
        bits("PREV", 3, 0, "factor", values=FACTORS, note="see FACTORS", listed=False),
        bits("ACT", 8, 4, "action", legal=(0, 24), values=dict(enumerate(ACTIONS)) | actions_of_set,
             note=f"see ACTIONS; 4 is {actions_of_set[4]}, 8 is {actions_of_set[8]}", listed=False),
        *(bit(f"SNC+{k}", 8 + k, f"also SYNC{(n + k) % 4} of this axis") for k in (1, 2, 3)),
        *(bit(f"AXIS{k}", 11 + k, f"also SYNC0 of axis +{k}") for k in range(1, axes)),
        bit("REP", 15, "", values=("once", "repeatedly")),
    )  # fmt: skip


FACTORS = (
    "none", "MRm comparison true", "timer up", "drive start", "constant speed start", "constant speed end", "drive end",
    "split pulse start", "split pulse end", "split pulse output", "PIOm rises", "PIOm falls", "PIOm rises, PIO(m+4) low",
    "PIOm rises, PIO(m+4) high", "PIOm falls, PIO(m+4) low", "PIOm falls, PIO(m+4) high",
)  # fmt: skip
"""PREV of SmM."""
ACTIONS = (
    "none", "MRm -> DV", "MRm -> TP", "MRm -> SP1", "MRm -> LP, RP, SV, AC (m = 0, 1, 2, 3)", "LP -> MRm", "RP -> MRm",
    "CT -> MRm", "CV, CA -> MRm (m = 0, 1)", "sync pulse on PIOm", "relative drive", "counter relative drive",
    "absolute drive", "+ continuous drive", "- continuous drive", "relative drive by MRm", "absolute drive to MRm",
    "decelerating stop", "instant stop", "speed increase", "speed decrease", "timer start", "timer stop",
    "split pulse start", "split pulse stop",
)  # fmt: skip
"""ACT of SmM."""
HOME_STATES = {
    0: "idle", 3: "step 1: waits for the signal", 6: "timer between steps 1 and 2",
    11: "step 2 irregular: waits for the signal in the other direction",
    15: "step 2 irregular: waits for the signal's end in the other direction", 18: "timer after the irregular operation",
    20: "step 2: waits for the signal", 23: "timer or DCC between steps 2 and 3", 28: "step 3: waits for STOP2",
    32: "timer or DCC between steps 3 and 4", 36: "step 4: offset drive",
}  # fmt: skip
"""HSST of RR3 page 0."""

HOME_TIMES = (1, 2, 10, 20, 100, 200, 500, 1000)
"""Of the timer between the steps of a home search, ms, by HTM of H2M."""
SYNC_CLOCKS = (2, 5, 16, 64, 256, 1024, 4096, 16_000)
"""Of a sync pulse, by PW of P2M."""
SYNC_WIDTHS = ("125 ns", "312 ns", *times(n // 16 for n in SYNC_CLOCKS[2:]))
FILTERS = tuple(f"{0.5 * 2**n:g} us" for n in range(16))


def _interpolation(axes: int) -> Register:
    speeds = ("off", "two axes simple", "three axes simple", "two axes high accuracy")
    return _mode(
        0x2A, "IPM", "interpolation mode",
        *(bit(f"{a}-EN", k, f"{a} takes part", note="the lowest is the main axis") for k, a in enumerate(AXES[:axes])),
        bit("CXIV", 4, "the two axes of circular interpolation are exchanged"),
        bits("SPD", 7, 6, "constant vector speed", values=speeds),
        bit("LMDF", 8, "short-axis pulse equalization"),
        bit("STEP", 9, "single step"),
        bits("MLT", 11, 10, "multichip", legal=(0, 2), values=("single chip", "master", "slave")),
        bit("MAXM", 12, "maximum finish point", values=("automatic", "TX")),
        bit("INTA", 14, "interrupt when SC goes from 4 to 3"),
        bit("INTB", 15, "interrupt when SC goes from 8 to 7"),
    )  # fmt: skip


MODES = (
    _mode(
        0x20, "MRM", "multi-purpose register mode",
        *(bits(f"M{m}T", 4 * m + 1, 4 * m, f"MR{m} is compared with", values=("LP", "RP", "CV", "CT")) for m in range(4)),
        *(bits(f"M{m}C", 4 * m + 3, 4 * m + 2, "true if", values=tuple(f"object {sign} MR{m}" for sign in (">=", ">", "=", "<")))
          for m in range(4)),
        access="RW",
    ),
    _mode(0x21, "P1M", "PIO signal setting 1", *(_pio(i) for i in range(8)), access="RW"),
    _mode(
        0x22, "P2M", "PIO signal setting 2, other settings",
        *(bit(f"P{m}L", m, f"sync pulse on PIO{m}", "M", values=("high", "low")) for m in range(4)),
        bits("PW", 6, 4, "width of the sync pulses", "M", values=SYNC_WIDTHS),
        bits("EXOP", 8, 7, "drive by EXP+, EXP- (PIO4, PIO5)", "M", values=("off", "continuous", "relative", "manual pulser")),
        bits("stored", 15, 9, "others, not found", "I", note="stored, read back, no effect"), access="RW",
    ),
    _mode(
        0x23, "H1M", "automatic home search 1",
        bit("S1EN", 0, "step 1 (high-speed search, DV) is executed"),
        bit("S1DR", 1, "direction of step 1", values=("+", "-")),
        bits("S1G", 3, 2, "signal of step 1", legal=(0, 2), values=("STOP0", "STOP1", "limit")),
        bit("S2EN", 4, "step 2 (low-speed search, HV) is executed"),
        bit("S2DR", 5, "direction of step 2", values=("+", "-")),
        bit("S2SG", 6, "signal of step 2", values=("STOP1", "limit")),
        bit("S2DC", 7, "DCC output after step 2"),
        bit("S2RC", 8, "RP is cleared after step 2"),
        bit("S2LC", 9, "LP is cleared after step 2"),
        bit("S3EN", 10, "step 3 (low-speed search of STOP2, HV) is executed"),
        bit("S3DR", 11, "direction of step 3", values=("+", "-")),
        bit("S3DC", 12, "DCC output after step 3"),
        bit("S3RC", 13, "RP is cleared after step 3"),
        bit("S3LC", 14, "LP is cleared after step 3"),
        bit("S4EN", 15, "step 4 (offset of TP pulses, DV) is executed"),
    ),
    _mode(
        0x24, "H2M", "automatic home search 2",
        bit("SAND", 0, "step 3 stops only while STOP1 is active"),
        bit("RCLR", 1, "RP is cleared at the end"),
        bit("LCLR", 2, "LP is cleared at the end"),
        bit("DCPL", 3, "DCC pulse", "?", values=("high", "low")),
        bits("DCP", 6, 4, "DCC width", values=times(DCC_WIDTHS)),
        bit("HTME", 7, "timer between steps"),
        bits("HTM", 10, 8, "timer", values=tuple(f"{ms} ms" for ms in HOME_TIMES)),
    ),
    _mode(
        0x25, "FLM", "input signal filters",
        bit("FE0", 0, "filter of EMG", note="valid on X only", only=0),
        *(bit(f"FE{k}", k, f"filter of {what}") for k, what in enumerate((
            "LMT+, LMT-", "STOP0, STOP1", "INPOS, ALARM", "PIO0 to PIO3", "PIO4 to PIO7", "STOP2",
            "ECA, ECB"), 1)),
        bits("FL0", 11, 8, "time of FE0 to FE5", values=FILTERS, note="time constant, 500 ns * 2^n at 16 MHz", listed=False),
        bits("FL1", 15, 12, "time of FE6, FE7", values=FILTERS, note="time constant, 500 ns * 2^n at 16 MHz", listed=False),
    ),
    *(_sync(n) for n in range(4)),
    _interpolation(4),
)  # fmt: skip


def modes(axes: int) -> tuple[Register, ...]:
    """Mode registers of a chip of this generation with so many axes: one does not interpolate, two have more PIO pins."""
    if axes == 4:
        return MODES
    kept = [r for r in MODES if r.name not in ("IPM", *(f"S{m}M" for m in range(4)))]
    more = [_sync(m, axes) for m in range(4)]
    if axes == 2:
        directions = (bit(f"P{i}D", i - 8, f"PIO{i}", values=("input", "output")) for i in range(8, 14))
        more += [_interpolation(2), _mode(0x2B, "P3M", "PIO signal setting 3", *directions, access="RW")]
    return (*kept, *more)


def _events() -> tuple[Field, ...]:
    """WR1 enables them, RR1 shows them."""
    return (
        *(bit(f"CMR{m}", m, f"the MR{m} comparison became true") for m in range(4)),
        bit("D-STA", 4, "the drive started"),
        bit("C-STA", 5, "constant speed began"),
        bit("C-END", 6, "constant speed ended"),
        bit("D-END", 7, "the drive ended"),
        bit("H-END", 8, "the automatic home search ended"),
        bit("TIMER", 9, "the timer expired"),
        bit("SPLTP", 10, "a split pulse began"),
        bit("SPLTE", 11, "the split pulses ended"),
        *(bit(f"SYNC{m}", 12 + m, f"SYNC{m} was activated") for m in range(4)),
    )


def _ports(name: str, title: str, low: str, high: str) -> Word:
    fields = (bits(f"{high}-PIO", 15, 8, f"PIO7 to PIO0 of {high}"), bits(f"{low}-PIO", 7, 0, f"PIO7 to PIO0 of {low}"))
    return word(name, title, fields)


_FOUR = (
    word(
        "WR0", "command register; on the 8-bit bus the low byte, written last, triggers",
        bits("zero", 15, 12, "must be 0", legal=(0, 0)),
        bits("AXIS", 11, 8, "axes X, Y, Z, U", note="0 keeps the selection [I]"),
        bits("CODE", 7, 0, "command code"),
    ),
    word("WR1", "interrupt enable", _events(), access="RW", note="of the selected axes"),
    word(
        "WR2", "input signals",
        *(bit(f"SP{m}-L", 2 * m, f"active level of STOP{m}", values=LEVELS) for m in range(3)),
        *(bit(f"SP{m}-E", 2 * m + 1, f"STOP{m} stops the drive") for m in range(3)),
        bit("INP-L", 6, "active level of INPOS", values=LEVELS),
        bit("INP-E", 7, "the drive ends only when INPOS is active"),
        bit("ALM-L", 8, "active level of ALARM", values=LEVELS),
        bit("ALM-E", 9, "ALARM stops the drive"),
        bit("HLM-L", 10, "active level of LMT+ and LMT-", values=LEVELS),
        bit("HLM-E", 11, "LMT+ and LMT- stop the drive"),
        bit("HLM-M", 12, "hardware limits", values=("instant stop", "decelerating")),
        bit("SLM-E", 13, "software limits stop the drive"),
        bit("SLM-O", 14, "software limits look at", values=("LP", "RP")),
        bit("SLM-M", 15, "software limits", values=("decelerating stop", "instant")),
        access="RW", note="of the selected axes",
    ),
    word(
        "WR3", "drive mode and pulse signals",
        bit("MANLD", 0, "deceleration begins at", "S", values=("the automatic point", "DP")),
        bit("DSNDE", 1, "deceleration at", values=("AC, JK", "DC, DJ")),
        bit("SACC", 2, "", values=("linear ramps", "S-curves")),
        bits("DPMD", 4, 3, "", values=("independent 2-pulse", "pulse and direction", "quadrature x4", "quadrature x2")),
        bit("DP-L", 5, "drive pulses", values=("positive logic", "negative")),
        bit("DIR-L", 6, "direction", values=("+ is low", "+ is high")),
        bit("DPINV", 7, "the two output pins are exchanged"),
        bits("PIMD", 9, 8, "encoder input", values=("AB x4", "AB x2", "AB x1", "up / down")),
        bit("PI-L", 10, "encoder input", values=("positive logic", "negative")),
        bit("PIINV", 11, "ECA and ECB are exchanged"),
        bit("LMINV", 12, "LMT+ and LMT- are exchanged"),
        bit("AVTRI", 13, "triangle prevention of linear ramps", values=("on", "off")),
        bit("TMMD", 14, "timer", values=("once", "repeatedly")),
        access="RW", note="of the selected axes",
    ),
    *DATA_WRITTEN,
    word("RR1", "interrupt factors of the selected axis; reading clears them", _events()),
    word(
        "RR2", "errors (bits 7 to 0) and finishing status of the selected axis; 79h clears them",
        bit("SLMT+", 0, "software limit +"),
        bit("SLMT-", 1, "software limit -"),
        bit("HLMT+", 2, "hardware limit +"),
        bit("HLMT-", 3, "hardware limit -"),
        bit("ALARM", 4, "ALARM"),
        bit("EMG", 5, "emergency stop"),
        bit("HOME", 6, "home search"),
        bit("CERR", 7, "continuous interpolation"),
        bit("SYNC", 8, "ended by a synchronous action"),
        *(bit(n, k, f"ended by {n}") for k, n in enumerate("STOP0 STOP1 STOP2 LMT+ LMT-".split(), 9)),
        bit("END-ALARM", 14, "ended by ALARM", note="the manual prints ALARM"),
        bit("END-EMG", 15, "ended by emergency stop", note="the manual prints EMG"),
    ),
    word(
        "RR3-0", "RR3 page 0 (7Ah): levels of the pins of the selected axis as they are, and home search",
        *(bit(n, k, f"level of {n}", values=LEVELS)
          for k, n in enumerate("STOP0 STOP1 STOP2 ECA ECB INPOS ALARM LMTP LMTM".split())),
        bits("HSST", 14, 9, "state of the home search", values=HOME_STATES, note="see HOME_STATES", listed=False),
    ),
    word(
        "RR3-1", "RR3 page 1 (7Bh): drive status of the selected axis",
        *(bit(f"SYNC{m}", m, f"SYNC{m} is enabled") for m in range(4)),
        bit("ASND", 4, "speed increases"),
        bit("CNST", 5, "speed is constant"),
        bit("DSND", 6, "speed decreases"),
        bit("AASND", 7, "acceleration increases"),
        bit("ACNST", 8, "acceleration is constant"),
        bit("ADSND", 9, "acceleration decreases"),
        bit("TIMER", 10, "the timer runs"),
        bit("SPLIT", 11, "split pulses run"),
        bit("MCERR", 12, "multichip interpolation error"),
    ),
    *DATA_READ,
)  # fmt: skip
"""The words that chips with one, two and four axes share."""


def _status(axes: int) -> Word:
    fields = [
        axis_bits("n-DRV", 0, axes, " is driving", "C" if axes > 1 else "I"),
        axis_bits("n-ERR", 4, axes, ": an error bit of RR2 is set", "M" if axes > 1 else "I"),
    ]
    if axes > 1:
        fields += [
            bits("ZONE", 10, 8, "octant of circular interpolation"),
            bit("CNEXT", 11, "the next segment can be written"),
            bits("SC", 15, 12, "segments in the pre-buffer, 0 to 8"),
        ]
    return word("RR0", "main status", fields)


def _pios(axes: int) -> tuple[Word, ...]:
    """WR4, WR5, RR4, RR5."""
    out, levels = "general outputs of", "levels of the PIO pins of"
    if axes == 4:
        pairs = (("4", "X", "Y"), ("5", "Z", "U"))
        return (
            *(_ports(f"WR{n}", f"{out} {a} and {b}", a, b) for n, a, b in pairs),
            *(_ports(f"RR{n}", f"{levels} {a} and {b}", a, b) for n, a, b in pairs),
        )
    if axes == 2:
        alone = (("4", "X"), ("5", "Y"))
        return (
            *(word(f"WR{n}", f"{out} {a}", bits(f"{a}-PIO", 13, 0, f"PIO13 to PIO0 of {a}")) for n, a in alone),
            *(word(f"RR{n}", f"{levels} {a}", bits(f"{a}-PIO", 13, 0, f"PIO13 to PIO0 of {a}")) for n, a in alone),
        )
    pins = bits("X-PIO", 7, 0, "PIO7 to PIO0")
    return (
        word("WR4", "general outputs", pins), word("WR5", "not used on this chip"),
        word("RR4", "levels of the PIO pins", pins), word("RR5", "not used on this chip"),
    )  # fmt: skip


def words(axes: int) -> tuple[Word, ...]:
    """WR0 to WR7 and RR0 to RR7 of a chip of this generation with so many axes."""
    found = {w.name: w for w in (*_FOUR, _status(axes), *_pios(axes))}
    return tuple(found[n] for n in sorted(found, key=lambda n: (n[0] != "W", n)))
