"""MCX304, MCX302, MCX312: home mode, WR0 to WR7 and RR0 to RR7, bit by bit.

Names of bits that the failure notice does not print are those of the manuals, from memory [M]. The positions of the bits are known
from working drivers [C]; some of these are for the MCX314 only, and the positions are then inferred for these chips [I].
"""

from __future__ import annotations

from dataclasses import replace

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

HOME_STATES = {
    0: "idle", 3: "step 1: waits for STOP0", 8: "step 2: waits for STOP1 in the other direction",
    12: "step 2: waits for the end of STOP1", 15: "step 2: waits for STOP1", 20: "step 3: waits for STOP2",
    25: "step 4: offset drive",
}  # fmt: skip
"""Meanings of the field HMST of RR2, the state of the home search."""

FILTER_DELAYS_US = (2, 256, 512, 1024, 2048, 4096, 8192, 16384)
"""Delays of the input filters, us, by the field FL of WR3."""


def _make_home_fields(shift: int = 0) -> tuple[Field, ...]:
    """Return the fields of the home search: those of HM, or with `shift` 16 those of the word in WR7 of EM."""
    ways = ("+", "-")
    meaning = (
        make_bits("DCCW", 15, 13, "DCC width", "I", values=format_times(DCC_WIDTHS_US)),
        make_bit("DCC-L", 12, "DCC pulse", "I", values=("high", "low")),
        make_bit("DCC-E", 11, "DCC output at the end of the search", "I"),
        make_bit("LIMIT", 10, "steps 1 and 2 search the limit of their direction", "I"),
        make_bit("SAND", 9, "step 3 stops only while STOP1 is active", "I"),
        make_bit("PCLR", 8, "LP and EP are cleared at the end", "I"),
        make_bit("ST4-D", 7, "direction of step 4", "I", values=ways),
        make_bit("ST4-E", 6, "step 4 (offset of P pulses, V) is executed", "I"),
        make_bit("ST3-D", 5, "direction of step 3", "I", values=ways),
        make_bit("ST3-E", 4, "step 3 (low-speed search of STOP2, HV) is executed", "I"),
        make_bit("ST2-D", 3, "direction of step 2", "I", values=ways),
        make_bit("ST2-E", 2, "step 2 (low-speed search of STOP1, HV) is executed", "I"),
        make_bit("ST1-D", 1, "direction of step 1", "I", values=ways),
        make_bit("ST1-E", 0, "step 1 (high-speed search of STOP0, V) is executed", "I"),
    )
    return tuple(replace(f, high=f.high + shift, low=f.low + shift) for f in meaning)


HM = Register(
    "HM", 0x60, 16, "W", "automatic home search", None, _make_home_fields(), "I", reset=0,
    note="the layout is that of WR7 for command 60h of the MCX314As",
)  # fmt: skip
_FILTER_DELAY_TEXTS = tuple(f"{us} us" for us in FILTER_DELAYS_US)
EM = Register(
    "EM", 0x60, 32, "W", "extension mode", None,
    (
        *(replace(f, evidence="C") for f in _make_home_fields(16)),
        make_bits("FL", 15, 13, "delay of the filters", values=_FILTER_DELAY_TEXTS, note="2 is 512 us, the others [I]"),
        make_bit("FE4", 12, "filter of STOP3", "M"),
        make_bit("FE3", 11, "filter of EXP+, EXP-", "M"),
        make_bit("FE2", 10, "filter of INPOS, ALARM"),
        make_bit("FE1", 9, "filter of STOP2"),
        make_bit("FE0", 8, "filter of EMG, LMT+, LMT-, STOP0, STOP1"),
        make_bit("SMODE", 7, "stored, no effect", "C"),
        make_bit("HMINT", 5, "interrupt at the end of the home search"),
        make_bit("VRING", 4, "stored, no effect", "C"),
        make_bit("AVTRI", 3, "triangle prevention of linear ramps", values=("off", "on"), note="which is which [I]"),
        make_bit("POINV", 2, "the two output pins are exchanged"),
        make_bit("EPINV", 1, "EP counts the other way round"),
        make_bit("EPCLR", 0, "STOP2 clears EP", note="where it ends a drive"),
    ),
    "C", reset=0, note="bits 31..16 in WR7, 15..0 in WR6",
)  # fmt: skip


def _make_comparison_bits(low: int) -> tuple[Field, ...]:
    """Return the bits of the comparison interrupts, which WR1 enables and RR3 shows."""
    return (
        make_bit("PULSE", low, "a drive pulse began"),
        make_bit("P>=C-", low + 1, "the counter is at or above CM"),
        make_bit("P<C-", low + 2, "the counter is below CM"),
        make_bit("P<C+", low + 3, "the counter is below CP"),
        make_bit("P>=C+", low + 4, "the counter is at or above CP"),
        make_bit("C-END", low + 5, "constant speed ended", "S"),
        make_bit("C-STA", low + 6, "constant speed began"),
        make_bit("D-END", low + 7, "the drive ended"),
    )


_WRITE_WORDS = (
    make_word(
        "WR0", "command register",
        make_bit("RESET", 15, "1 resets the chip: WR0 = 8000h"),
        make_bits("zero", 14, 12, "must be 0", legal=(0, 0)),
        make_bits("AXIS", 11, 8, "axes X, Y, Z, U", note="0 keeps the selection [I]"),
        make_bits("CODE", 7, 0, "command code"),
    ),
    make_word(
        "WR1", "stop inputs and interrupt enable",
        *(make_bit(f"SP{k}-L", 2 * k, f"active level of STOP{k}", values=LEVELS) for k in range(3)),
        *(make_bit(f"SP{k}-E", 2 * k + 1, f"STOP{k} stops the drive", "S") for k in range(3)),
        make_bit("EPCLR", 6, "STOP2 clears EP", "M", note="where it ends a drive"),
        make_bit("EPINV", 7, "EP counts the other way round", "M"),
        _make_comparison_bits(8), note="of the selected axes",
    ),
    make_word(
        "WR2", "limits and pulse signals",
        make_bit("SLMT+", 0, "software limit CP stops the drive", "S"),
        make_bit("SLMT-", 1, "software limit CM stops the drive", "S"),
        make_bit("LMTMD", 2, "hardware limits", "S", values=("sudden stop", "decelerating")),
        make_bit("HLMT+", 3, "active level of LMT+", values=LEVELS),
        make_bit("HLMT-", 4, "active level of LMT-", values=LEVELS),
        make_bit("CMPSL", 5, "CP and CM are compared with", values=("LP", "EP")),
        make_bit("PLSMD", 6, "", values=("independent 2-pulse", "pulse and direction")),
        make_bit("PLS-L", 7, "drive pulses", values=("positive logic", "negative")),
        make_bit("DIR-L", 8, "direction", values=("+ is low", "+ is high")),
        make_bit("PINMD", 9, "encoder input", values=("AB", "up / down")),
        make_bits("PIND", 11, 10, "division of the AB input", legal=(0, 2), values=("1/1", "1/2", "1/4")),
        make_bit("ALM-L", 12, "active level of ALARM", values=LEVELS),
        make_bit("ALM-E", 13, "ALARM stops the drive"),
        make_bit("INP-L", 14, "active level of INPOS", values=LEVELS),
        make_bit("INP-E", 15, "the drive ends only when INPOS is active"),
        note="of the selected axes",
    ),
    make_word(
        "WR3", "drive mode and filters",
        make_bit("MANLD", 0, "deceleration begins at", values=("the automatic point", "DP")),
        make_bit("DSNDE", 1, "deceleration at", values=("A, K", "D, and L where the chip has it")),
        make_bit("SACC", 2, "", "S", values=("linear ramps", "S-curves")),
        make_bits("EXOP", 4, 3, "drive by EXP+, EXP-", values=("off", "continuous", "fixed", "manual pulser")),
        make_bit("AVTRI", 5, "triangle prevention of linear ramps", "M", values=("off", "on"), note="which is which [I]"),
        make_bit("POINV", 6, "the two output pins are exchanged", "M"),
        make_bit("OUTSL", 7, "OUT0 to OUT3 show", "M", values=("WR4", "CMP+, CMP-, ASND, DSND"),
                 note="which and in what order [I]"),
        make_bit("FE0", 8, "filter of EMG, LMT+, LMT-, STOP0, STOP1"),
        make_bit("FE1", 9, "filter of STOP2"),
        make_bit("FE2", 10, "filter of INPOS, ALARM"),
        make_bit("FE3", 11, "filter of EXP+, EXP-", note="which inputs [M]"),
        make_bit("FE4", 12, "filter of the other inputs", note="which inputs [M]"),
        make_bits("FL", 15, 13, "delay of the filters", values=tuple(f"{us} us" for us in FILTER_DELAYS_US),
                  note="2 is 512 us, the others [I]"),
        note="of the selected axes",
    ),
)  # fmt: skip
_READ_WORDS = (
    make_word(
        "RR1", "drive status and causes of the last stop, of the selected axis",
        make_bit("CMP+", 0, "counter >= CP"),
        make_bit("CMP-", 1, "counter < CM"),
        make_bit("ASND", 2, "speed increases", "S"),
        make_bit("CNST", 3, "speed is constant", "S"),
        make_bit("DSND", 4, "speed decreases", "S"),
        make_bit("AASND", 5, "acceleration increases"),
        make_bit("ACNST", 6, "acceleration is constant"),
        make_bit("ADSND", 7, "acceleration decreases"),
        *(make_bit(f"STOP{k}", 8 + k, f"ended by STOP{k}") for k in range(3)),
        make_bit("LMT+", 12, "ended by LMT+", "S"),
        make_bit("LMT-", 13, "ended by LMT-", "S"),
        make_bit("ALARM", 14, "ended by ALARM"),
        make_bit("EMG", 15, "ended by emergency stop"),
    ),
    make_word(
        "RR2", "errors and home search, of the selected axis",
        make_bit("SLMT+", 0, "software limit +"),
        make_bit("SLMT-", 1, "software limit -"),
        make_bit("HLMT+", 2, "hardware limit +"),
        make_bit("HLMT-", 3, "hardware limit -"),
        make_bit("ALARM", 4, "ALARM"),
        make_bit("EMG", 5, "emergency stop, while the level is active"),
        make_bit("HOME", 7, "home search"),
        make_bits("HMST", 12, 8, "state of the home search", values=HOME_STATES, note="see HOME_STATES", listed=False),
    ),
    make_word(
        "RR3", "interrupt factors of the selected axis; reading clears them [M]",
        _make_comparison_bits(0), make_bit("HMEND", 8, "the automatic home search ended"),
    ),
)  # fmt: skip
_INTERPOLATION = make_word(
    "WR5", "interpolation mode",
    make_bits("AX1", 1, 0, "main axis", "I", legal=(0, 1), values=("X", "Y")),
    make_bits("AX2", 3, 2, "second axis", "I", legal=(0, 1), values=("X", "Y")),
    make_bits("LSPD", 9, 8, "constant vector speed", "I", legal=(0, 1), values=("off", "two axes")),
    make_bit("EXPLS", 11, "an outside pulse makes the step", "I"),
    make_bit("CMPLS", 12, "command 3Ah makes the step", "I"),
    make_bit("CIINT", 14, "interrupt when the next segment can be written", "I"),
    make_bit("BPINT", 15, "interrupt when BPSC goes from 2 to 1", "I"),
)  # fmt: skip
_NOT_USED = make_word("WR5", "not used on this chip")
BIT_PATTERN = tuple(
    make_word(f"BP{k // 2 + 1}{'PM'[k % 2]}", f"steps of axis {k // 2 + 1} in {'+-'[k % 2]} direction",
         make_bits("BP", 15, 0, "16 steps, bit 0 first"), access="W", note=f"WR{k + 2} after 36h")
    for k in range(4)
)  # fmt: skip
"""Words that take the place of WR2 to WR5 while writing of bit patterns is enabled."""


def _make_main_status_word(axes: int, interpolates: bool) -> Word:
    """Return RR0, the main status, for a number of axes."""
    fields = [
        make_axis_bits("n-DRV", 0, axes, " is driving"),
        make_axis_bits("n-ERR", 4, axes, ": an error bit of RR1 or RR2 is set"),
    ]
    if interpolates:
        fields += [
            make_bit("I-DRV", 8, "interpolation is driving", "I"),
            make_bit("CNEXT", 9, "the next segment can be written"),
            make_bits("ZONE", 12, 10, "octant of circular interpolation", "I"),
            make_bits("BPSC", 14, 13, "bit pattern sets loaded, 0 to 3"),
        ]
    else:
        fields.append(make_axis_bits("n-HOM", 8, axes, " searches home", "C" if axes == 4 else "I"))
    return make_word("RR0", "main status", fields)


def _make_input_word_of_two(name: str, low: str, high: str) -> Word:
    """Return the RR word that shows the inputs of two axes."""
    fields = [make_bit("EMG", 3, "level of EMG", "M", values=LEVELS)] if low == "X" else []
    for a, shift in ((low, 0), (high, 8)):
        fields += [
            make_bit(f"{a}-STOP{k}", shift + k, f"level of STOP{k} of {a}", "M", values=LEVELS) for k in range(3)
        ]
        signals = "EXP+ EXP- INPOS ALARM".split()
        fields += [
            make_bit(f"{a}-{n}", shift + k, f"level of {n} of {a}", values=LEVELS) for k, n in enumerate(signals, 4)
        ]
    return make_word(name, f"input levels of {low} and {high}", fields)


def _make_input_word_of_one(name: str, axis_name: str) -> Word:
    """Return the RR word that shows the inputs of one axis."""
    signals = {"STOP0": 0, "STOP1": 1, "STOP2": 2, "EXP+": 4, "EXP-": 5, "INPOS": 6, "ALARM": 7, "LMT+": 14, "LMT-": 15}
    fields = [
        make_bit(f"{axis_name}-{n}", k, f"level of {n} of {axis_name}", "?", values=LEVELS) for n, k in signals.items()
    ]
    fields += [make_bit("EMG", 3, "level of EMG", "?", values=LEVELS)] if axis_name == "X" else []
    return make_word(
        name,
        f"input levels of {axis_name}",
        fields,
        make_bits(f"{axis_name}-IN", 13, 8, f"levels of IN5 to IN0 of {axis_name}"),
    )


def _make_mcx314as_words() -> tuple[Word, ...]:
    """Return WR1, WR3, WR5, RR1 and the input words of the MCX314As, whose manual calls the STOP inputs IN0 to IN3."""
    written = {w.name: w for w in _WRITE_WORDS}
    outputs = {w.name: w for w in _READ_WORDS}
    wr1 = [f for f in written["WR1"].fields if f.name not in ("EPCLR", "EPINV")]
    wr3 = [f for f in written["WR3"].fields if f.low < 5]
    return (
        make_word("WR1", "stop inputs and interrupt enable", wr1, make_bit("SP3-L", 6, "active level of STOP3", values=LEVELS),
             make_bit("SP3-E", 7, "STOP3 stops the drive"), note="of the selected axes"),
        make_word("WR3", "drive mode and outputs", wr3,
             make_bit("OUTSL", 7, "OUT4 to OUT7 show", values=("bits 11..8", "CMP+, CMP-, ASND, DSND")),
             make_bits("OUT", 11, 8, "OUT7 to OUT4"), note="of the selected axes"),
        make_word(
            "WR5", "interpolation mode",
            *(make_bits(f"AX{k + 1}", 2 * k + 1, 2 * k, text, values=tuple(AXIS_LETTERS))
              for k, text in enumerate(("main axis", "second axis", "third axis"))),
            make_bits("LSPD", 9, 8, "constant vector speed", legal=(0, 3),
                      values={0: "off", 1: "two axes", 2: "none", 3: "three axes"}),
            make_bit("EXPLS", 11, "an outside pulse makes the step"), make_bit("CMPLS", 12, "command 3Ah makes the step"),
            make_bit("CIINT", 14, "interrupt when the next segment can be written"),
            make_bit("BPINT", 15, "interrupt when BPSC goes from 2 to 1"),
        ),
        make_word("RR1", outputs["RR1"].title, outputs["RR1"].fields, make_bit("STOP3", 11, "ended by STOP3")),
        *(
            make_word(name, f"input levels of {low} and {high}", (
                make_bit(f"{a}-{n}", shift + k, f"level of {n} of {a}", values=LEVELS)
                for a, shift in ((low, 0), (high, 8))
                for k, n in enumerate("STOP0 STOP1 STOP2 STOP3 EXP+ EXP- INPOS ALARM".split())
            ))
            for name, low, high in (("RR4", "X", "Y"), ("RR5", "Z", "U"))
        ),
        *(
            make_word(f"BP3{'PM'[k]}", f"steps of axis 3 in {'+-'[k]} direction", make_bits("BP", 15, 0, "16 steps, bit 0 first"),
                 access="W", note=f"WR{k + 6} after 36h")
            for k in range(2)
        ),
    )  # fmt: skip


def list_mcx314as_words() -> tuple[Word, ...]:
    """Return all words of the MCX314As."""
    added = {w.name: w for w in _make_mcx314as_words()}
    shared = list_words(4, True)
    return (*(added.pop(w.name, w) for w in shared), *added.values())


def list_words(axes: int, interpolates: bool) -> tuple[Word, ...]:
    """Return the words WR0 to WR7, RR0 to RR7 and, on chips with bit pattern interpolation, the BP registers."""
    if axes == 2:
        inputs = (_make_input_word_of_one("RR4", "X"), _make_input_word_of_one("RR5", "Y"))
    else:
        inputs = (_make_input_word_of_two("RR4", "X", "Y"), _make_input_word_of_two("RR5", "Z", "U"))
    outputs = (
        make_bits(f"{a}-OUT", 4 * k + 3, 4 * k, f"OUT3 to OUT0 of {a}") for k, a in enumerate(AXIS_LETTERS[:axes])
    )
    return (
        *_WRITE_WORDS, make_word("WR4", "general outputs", outputs), _INTERPOLATION if interpolates else _NOT_USED,
        *DATA_WRITE_WORDS,
        *(BIT_PATTERN if interpolates else ()), _make_main_status_word(axes, interpolates), *_READ_WORDS, *inputs, *DATA_READ_WORDS,
    )  # fmt: skip
