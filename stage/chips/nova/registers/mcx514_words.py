"""MCX514: mode registers, WR0 to WR7 and RR0 to RR7, bit by bit.

Names of mode bits are those of the manual, from memory [M]; their positions are known from working drivers [C].
"""

from __future__ import annotations

from stage.chips.nova.registers.field_builders import (
    AXIS_LETTERS,
    DATA_READ_WORDS,
    DATA_WRITE_WORDS,
    DCC_WIDTHS_US,
    LEVELS,
    format_times,
    make_axis_bits,
    make_bit,
    make_bits,
    make_word,
)
from stage.chips.register_map import Field, Register, Word


def _make_mode_register(
    code: int, name: str, title: str, *fields: Field, access: str = "W", evidence: str = "C"
) -> Register:
    """Return a mode register, whose number is the code of the command that writes it."""
    ordered = tuple(sorted(fields, key=lambda f: -f.high))
    return Register(name, code, 16, access, title, None, ordered, evidence, reset=0)


def _make_pio_field(pin_index: int) -> Field:
    """Return the field that selects the function of a PIO pin."""
    third = "sync pulse" if pin_index < 4 else f"MR{pin_index - 4} comparison"
    return make_bits(
        f"P{pin_index}M",
        2 * pin_index + 1,
        2 * pin_index,
        f"PIO{pin_index}",
        values=("input", "output", "drive status", third),
    )


def _make_sync_mode(set_index: int, axes: int = 4) -> Register:
    """Return the mode register of synchronous action set `set_index` of the MCX514's kind."""
    actions_of_set = {
        4: f"MR{set_index} -> {('LP', 'RP', 'SV', 'AC')[set_index]}",
        8: ("CV -> MR0", "CA -> MR1", "none", "none")[set_index],
    }
    return _make_mode_register(
        0x26 + set_index, f"S{set_index}M", f"synchronous action set {set_index}",
        make_bits("PREV", 3, 0, "factor", values=FACTORS, note="see FACTORS", listed=False),
        make_bits("ACT", 8, 4, "action", legal=(0, 24), values=dict(enumerate(ACTIONS)) | actions_of_set,
             note=f"see ACTIONS; 4 is {actions_of_set[4]}, 8 is {actions_of_set[8]}", listed=False),
        *(make_bit(f"SNC+{k}", 8 + k, f"also SYNC{(set_index + k) % 4} of this axis") for k in (1, 2, 3)),
        *(make_bit(f"AXIS{k}", 11 + k, f"also SYNC0 of axis +{k}") for k in range(1, axes)),
        make_bit("REP", 15, "", values=("once", "repeatedly")),
    )  # fmt: skip


FACTORS = (
    "none", "MRm comparison true", "timer up", "drive start", "constant speed start", "constant speed end", "drive end",
    "split pulse start", "split pulse end", "split pulse output", "PIOm rises", "PIOm falls", "PIOm rises, PIO(m+4) low",
    "PIOm rises, PIO(m+4) high", "PIOm falls, PIO(m+4) low", "PIOm falls, PIO(m+4) high",
)  # fmt: skip
"""Meanings of the field PREV of SmM, the activation factor of a synchronous action set."""
ACTIONS = (
    "none", "MRm -> DV", "MRm -> TP", "MRm -> SP1", "MRm -> LP, RP, SV, AC (m = 0, 1, 2, 3)", "LP -> MRm", "RP -> MRm",
    "CT -> MRm", "CV, CA -> MRm (m = 0, 1)", "sync pulse on PIOm", "relative drive", "counter relative drive",
    "absolute drive", "+ continuous drive", "- continuous drive", "relative drive by MRm", "absolute drive to MRm",
    "decelerating stop", "instant stop", "speed increase", "speed decrease", "timer start", "timer stop",
    "split pulse start", "split pulse stop",
)  # fmt: skip
"""Meanings of the field ACT of SmM, the action of a synchronous action set."""
HOME_STATES = {
    0: "idle", 3: "step 1: waits for the signal", 6: "timer between steps 1 and 2",
    11: "step 2 irregular: waits for the signal in the other direction",
    15: "step 2 irregular: waits for the signal's end in the other direction", 18: "timer after the irregular operation",
    20: "step 2: waits for the signal", 23: "timer or DCC between steps 2 and 3", 28: "step 3: waits for STOP2",
    32: "timer or DCC between steps 3 and 4", 36: "step 4: offset drive",
}  # fmt: skip
"""Meanings of the field HSST of RR3 page 0, the state of the home search."""

HOME_TIMER_MS = (1, 2, 10, 20, 100, 200, 500, 1000)
"""Times of the timer between the steps of a home search, ms, by the field HTM of H2M."""
SYNC_PULSE_CLOCKS = (2, 5, 16, 64, 256, 1024, 4096, 16_000)
"""Clocks that a sync pulse takes, by the field PW of P2M."""
SYNC_WIDTHS = ("125 ns", "312 ns", *format_times(n // 16 for n in SYNC_PULSE_CLOCKS[2:]))
FILTERS = tuple(f"{0.5 * 2**n:g} us" for n in range(16))


def _make_interpolation_mode(axes: int) -> Register:
    """Return the interpolation mode register IPM for a number of axes."""
    speeds = ("off", "two axes simple", "three axes simple", "two axes high accuracy")
    return _make_mode_register(
        0x2A, "IPM", "interpolation mode",
        *(make_bit(f"{a}-EN", k, f"{a} takes part", note="the lowest is the main axis") for k, a in enumerate(AXIS_LETTERS[:axes])),
        make_bit("CXIV", 4, "the two axes of circular interpolation are exchanged"),
        make_bits("SPD", 7, 6, "constant vector speed", values=speeds),
        make_bit("LMDF", 8, "short-axis pulse equalization"),
        make_bit("STEP", 9, "single step"),
        make_bits("MLT", 11, 10, "multichip", legal=(0, 2), values=("single chip", "master", "slave")),
        make_bit("MAXM", 12, "maximum finish point", values=("automatic", "TX")),
        make_bit("INTA", 14, "interrupt when SC goes from 4 to 3"),
        make_bit("INTB", 15, "interrupt when SC goes from 8 to 7"),
    )  # fmt: skip


MODE_REGISTERS = (
    _make_mode_register(
        0x20, "MRM", "multi-purpose register mode",
        *(make_bits(f"M{m}T", 4 * m + 1, 4 * m, f"MR{m} is compared with", values=("LP", "RP", "CV", "CT")) for m in range(4)),
        *(make_bits(f"M{m}C", 4 * m + 3, 4 * m + 2, "true if",
                    values=tuple(f"object {sign} MR{m}" for sign in (">=", ">", "=", "<"))) for m in range(4)),
        access="RW",
    ),
    _make_mode_register(0x21, "P1M", "PIO signal setting 1", *(_make_pio_field(i) for i in range(8)), access="RW"),
    _make_mode_register(
        0x22, "P2M", "PIO signal setting 2, other settings",
        *(make_bit(f"P{m}L", m, f"sync pulse on PIO{m}", "M", values=("high", "low")) for m in range(4)),
        make_bits("PW", 6, 4, "width of the sync pulses", "M", values=SYNC_WIDTHS),
        make_bits("EXOP", 8, 7, "drive by EXP+, EXP- (PIO4, PIO5)", "M", values=("off", "continuous", "relative", "manual pulser")),
        make_bits("stored", 15, 9, "others, not found", "I", note="stored, read back, no effect"), access="RW",
    ),
    _make_mode_register(
        0x23, "H1M", "automatic home search 1",
        make_bit("S1EN", 0, "step 1 (high-speed search, DV) is executed"),
        make_bit("S1DR", 1, "direction of step 1", values=("+", "-")),
        make_bits("S1G", 3, 2, "signal of step 1", legal=(0, 2), values=("STOP0", "STOP1", "limit")),
        make_bit("S2EN", 4, "step 2 (low-speed search, HV) is executed"),
        make_bit("S2DR", 5, "direction of step 2", values=("+", "-")),
        make_bit("S2SG", 6, "signal of step 2", values=("STOP1", "limit")),
        make_bit("S2DC", 7, "DCC output after step 2"),
        make_bit("S2RC", 8, "RP is cleared after step 2"),
        make_bit("S2LC", 9, "LP is cleared after step 2"),
        make_bit("S3EN", 10, "step 3 (low-speed search of STOP2, HV) is executed"),
        make_bit("S3DR", 11, "direction of step 3", values=("+", "-")),
        make_bit("S3DC", 12, "DCC output after step 3"),
        make_bit("S3RC", 13, "RP is cleared after step 3"),
        make_bit("S3LC", 14, "LP is cleared after step 3"),
        make_bit("S4EN", 15, "step 4 (offset of TP pulses, DV) is executed"),
    ),
    _make_mode_register(
        0x24, "H2M", "automatic home search 2",
        make_bit("SAND", 0, "step 3 stops only while STOP1 is active"),
        make_bit("RCLR", 1, "RP is cleared at the end"),
        make_bit("LCLR", 2, "LP is cleared at the end"),
        make_bit("DCPL", 3, "DCC pulse", "?", values=("high", "low")),
        make_bits("DCP", 6, 4, "DCC width", values=format_times(DCC_WIDTHS_US)),
        make_bit("HTME", 7, "timer between steps"),
        make_bits("HTM", 10, 8, "timer", values=tuple(f"{ms} ms" for ms in HOME_TIMER_MS)),
    ),
    _make_mode_register(
        0x25, "FLM", "input signal filters",
        make_bit("FE0", 0, "filter of EMG", note="valid on X only", only=0),
        *(make_bit(f"FE{k}", k, f"filter of {what}") for k, what in enumerate((
            "LMT+, LMT-", "STOP0, STOP1", "INPOS, ALARM", "PIO0 to PIO3", "PIO4 to PIO7", "STOP2",
            "ECA, ECB"), 1)),
        make_bits("FL0", 11, 8, "time of FE0 to FE5", values=FILTERS, note="time constant, 500 ns * 2^n at 16 MHz", listed=False),
        make_bits("FL1", 15, 12, "time of FE6, FE7", values=FILTERS, note="time constant, 500 ns * 2^n at 16 MHz", listed=False),
    ),
    *(_make_sync_mode(n) for n in range(4)),
    _make_interpolation_mode(4),
)  # fmt: skip


def list_mode_registers(axes: int) -> tuple[Register, ...]:
    """Return the mode registers of the MCX501, MCX512 or MCX514 by the number of axes.

    A chip with one axis does not interpolate, a chip with two axes has more PIO pins.
    """
    if axes == 4:
        return MODE_REGISTERS
    kept = [r for r in MODE_REGISTERS if r.name not in ("IPM", *(f"S{m}M" for m in range(4)))]
    more = [_make_sync_mode(m, axes) for m in range(4)]
    if axes == 2:
        directions = (make_bit(f"P{i}D", i - 8, f"PIO{i}", values=("input", "output")) for i in range(8, 14))
        more += [
            _make_interpolation_mode(2),
            _make_mode_register(0x2B, "P3M", "PIO signal setting 3", *directions, access="RW"),
        ]
    return (*kept, *more)


def _make_event_bits() -> tuple[Field, ...]:
    """Return the bits of the events that WR1 enables and RR1 shows."""
    return (
        *(make_bit(f"CMR{m}", m, f"the MR{m} comparison became true") for m in range(4)),
        make_bit("D-STA", 4, "the drive started"),
        make_bit("C-STA", 5, "constant speed began"),
        make_bit("C-END", 6, "constant speed ended"),
        make_bit("D-END", 7, "the drive ended"),
        make_bit("H-END", 8, "the automatic home search ended"),
        make_bit("TIMER", 9, "the timer expired"),
        make_bit("SPLTP", 10, "a split pulse began"),
        make_bit("SPLTE", 11, "the split pulses ended"),
        *(make_bit(f"SYNC{m}", 12 + m, f"SYNC{m} was activated") for m in range(4)),
    )


def _make_port_word(name: str, title: str, low: str, high: str) -> Word:
    """Return the word that shows or sets the PIO levels of two axes."""
    fields = (
        make_bits(f"{high}-PIO", 15, 8, f"PIO7 to PIO0 of {high}"),
        make_bits(f"{low}-PIO", 7, 0, f"PIO7 to PIO0 of {low}"),
    )
    return make_word(name, title, fields)


_FOUR_AXIS_WORDS = (
    make_word(
        "WR0", "command register; on the 8-bit bus the low byte, written last, triggers",
        make_bits("zero", 15, 12, "must be 0", legal=(0, 0)),
        make_bits("AXIS", 11, 8, "axes X, Y, Z, U", note="0 keeps the selection [I]"),
        make_bits("CODE", 7, 0, "command code"),
    ),
    make_word("WR1", "interrupt enable", _make_event_bits(), access="RW", note="of the selected axes"),
    make_word(
        "WR2", "input signals",
        *(make_bit(f"SP{m}-L", 2 * m, f"active level of STOP{m}", values=LEVELS) for m in range(3)),
        *(make_bit(f"SP{m}-E", 2 * m + 1, f"STOP{m} stops the drive") for m in range(3)),
        make_bit("INP-L", 6, "active level of INPOS", values=LEVELS),
        make_bit("INP-E", 7, "the drive ends only when INPOS is active"),
        make_bit("ALM-L", 8, "active level of ALARM", values=LEVELS),
        make_bit("ALM-E", 9, "ALARM stops the drive"),
        make_bit("HLM-L", 10, "active level of LMT+ and LMT-", values=LEVELS),
        make_bit("HLM-E", 11, "LMT+ and LMT- stop the drive"),
        make_bit("HLM-M", 12, "hardware limits", values=("instant stop", "decelerating")),
        make_bit("SLM-E", 13, "software limits stop the drive"),
        make_bit("SLM-O", 14, "software limits look at", values=("LP", "RP")),
        make_bit("SLM-M", 15, "software limits", values=("decelerating stop", "instant")),
        access="RW", note="of the selected axes",
    ),
    make_word(
        "WR3", "drive mode and pulse signals",
        make_bit("MANLD", 0, "deceleration begins at", "S", values=("the automatic point", "DP")),
        make_bit("DSNDE", 1, "deceleration at", values=("AC, JK", "DC, DJ")),
        make_bit("SACC", 2, "", values=("linear ramps", "S-curves")),
        make_bits("DPMD", 4, 3, "", values=("independent 2-pulse", "pulse and direction", "quadrature x4", "quadrature x2")),
        make_bit("DP-L", 5, "drive pulses", values=("positive logic", "negative")),
        make_bit("DIR-L", 6, "direction", values=("+ is low", "+ is high")),
        make_bit("DPINV", 7, "the two output pins are exchanged"),
        make_bits("PIMD", 9, 8, "encoder input", values=("AB x4", "AB x2", "AB x1", "up / down")),
        make_bit("PI-L", 10, "encoder input", values=("positive logic", "negative")),
        make_bit("PIINV", 11, "ECA and ECB are exchanged"),
        make_bit("LMINV", 12, "LMT+ and LMT- are exchanged"),
        make_bit("AVTRI", 13, "triangle prevention of linear ramps", values=("on", "off")),
        make_bit("TMMD", 14, "timer", values=("once", "repeatedly")),
        access="RW", note="of the selected axes",
    ),
    *DATA_WRITE_WORDS,
    make_word("RR1", "interrupt factors of the selected axis; reading clears them", _make_event_bits()),
    make_word(
        "RR2", "errors (bits 7 to 0) and finishing status of the selected axis; 79h clears them",
        make_bit("SLMT+", 0, "software limit +"),
        make_bit("SLMT-", 1, "software limit -"),
        make_bit("HLMT+", 2, "hardware limit +"),
        make_bit("HLMT-", 3, "hardware limit -"),
        make_bit("ALARM", 4, "ALARM"),
        make_bit("EMG", 5, "emergency stop"),
        make_bit("HOME", 6, "home search"),
        make_bit("CERR", 7, "continuous interpolation"),
        make_bit("SYNC", 8, "ended by a synchronous action"),
        *(make_bit(n, k, f"ended by {n}") for k, n in enumerate("STOP0 STOP1 STOP2 LMT+ LMT-".split(), 9)),
        make_bit("END-ALARM", 14, "ended by ALARM", note="the manual prints ALARM"),
        make_bit("END-EMG", 15, "ended by emergency stop", note="the manual prints EMG"),
    ),
    make_word(
        "RR3-0", "RR3 page 0 (7Ah): levels of the pins of the selected axis as they are, and home search",
        *(make_bit(n, k, f"level of {n}", values=LEVELS)
          for k, n in enumerate("STOP0 STOP1 STOP2 ECA ECB INPOS ALARM LMTP LMTM".split())),
        make_bits("HSST", 14, 9, "state of the home search", values=HOME_STATES, note="see HOME_STATES", listed=False),
    ),
    make_word(
        "RR3-1", "RR3 page 1 (7Bh): drive status of the selected axis",
        *(make_bit(f"SYNC{m}", m, f"SYNC{m} is enabled") for m in range(4)),
        make_bit("ASND", 4, "speed increases"),
        make_bit("CNST", 5, "speed is constant"),
        make_bit("DSND", 6, "speed decreases"),
        make_bit("AASND", 7, "acceleration increases"),
        make_bit("ACNST", 8, "acceleration is constant"),
        make_bit("ADSND", 9, "acceleration decreases"),
        make_bit("TIMER", 10, "the timer runs"),
        make_bit("SPLIT", 11, "split pulses run"),
        make_bit("MCERR", 12, "multichip interpolation error"),
    ),
    *DATA_READ_WORDS,
)  # fmt: skip
"""The words that chips with one, two and four axes share."""


def _make_status_word(axes: int) -> Word:
    """Return RR0, the main status, for a number of axes."""
    fields = [
        make_axis_bits("n-DRV", 0, axes, " is driving", "C" if axes > 1 else "I"),
        make_axis_bits("n-ERR", 4, axes, ": an error bit of RR2 is set", "M" if axes > 1 else "I"),
    ]
    if axes > 1:
        fields += [
            make_bits("ZONE", 10, 8, "octant of circular interpolation"),
            make_bit("CNEXT", 11, "the next segment can be written"),
            make_bits("SC", 15, 12, "segments in the pre-buffer, 0 to 8"),
        ]
    return make_word("RR0", "main status", fields)


def _make_port_words(axes: int) -> tuple[Word, ...]:
    """Return the words of the general ports: WR4, WR5, RR4, RR5."""
    out, levels = "general outputs of", "levels of the PIO pins of"
    if axes == 4:
        pairs = (("4", "X", "Y"), ("5", "Z", "U"))
        return (
            *(_make_port_word(f"WR{n}", f"{out} {a} and {b}", a, b) for n, a, b in pairs),
            *(_make_port_word(f"RR{n}", f"{levels} {a} and {b}", a, b) for n, a, b in pairs),
        )
    if axes == 2:
        alone = (("4", "X"), ("5", "Y"))
        return (
            *(
                make_word(f"WR{n}", f"{out} {a}", make_bits(f"{a}-PIO", 13, 0, f"PIO13 to PIO0 of {a}"))
                for n, a in alone
            ),
            *(
                make_word(f"RR{n}", f"{levels} {a}", make_bits(f"{a}-PIO", 13, 0, f"PIO13 to PIO0 of {a}"))
                for n, a in alone
            ),
        )
    pins = make_bits("X-PIO", 7, 0, "PIO7 to PIO0")
    return (
        make_word("WR4", "general outputs", pins), make_word("WR5", "not used on this chip"),
        make_word("RR4", "levels of the PIO pins", pins), make_word("RR5", "not used on this chip"),
    )  # fmt: skip


def list_words(axes: int) -> tuple[Word, ...]:
    """Return the words WR0 to WR7 and RR0 to RR7 of the MCX501, MCX512 or MCX514 by the number of axes."""
    found = {w.name: w for w in (*_FOUR_AXIS_WORDS, _make_status_word(axes), *_make_port_words(axes))}
    return tuple(found[n] for n in sorted(found, key=lambda n: (n[0] != "W", n)))
