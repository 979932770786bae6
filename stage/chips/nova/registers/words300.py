"""MCX304, MCX302, MCX312: home mode, WR0 to WR7 and RR0 to RR7, bit by bit.

Names of bits that the failure notice does not print are those of the manuals, from memory [M]; where the bits are is known
from working drivers [C], some of them for the MCX314 only: then it is inferred for these chips [I].
"""

from __future__ import annotations

from dataclasses import replace

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

HOME_STATES = {
    0: "idle", 3: "step 1: waits for STOP0", 8: "step 2: waits for STOP1 in the other direction",
    12: "step 2: waits for the end of STOP1", 15: "step 2: waits for STOP1", 20: "step 3: waits for STOP2",
    25: "step 4: offset drive",
}  # fmt: skip
"""HMST of RR2."""

DELAYS = (2, 256, 512, 1024, 2048, 4096, 8192, 16384)
"""Of the input filters, us, by FL of WR3."""


def _home(shift: int = 0) -> tuple[Field, ...]:
    """The home search: HM, or from bit 16 on the word in WR7 of EM."""
    ways = ("+", "-")
    meaning = (
        bits("DCCW", 15, 13, "DCC width", "I", values=times(DCC_WIDTHS)),
        bit("DCC-L", 12, "DCC pulse", "I", values=("high", "low")),
        bit("DCC-E", 11, "DCC output at the end of the search", "I"),
        bit("LIMIT", 10, "steps 1 and 2 search the limit of their direction", "I"),
        bit("SAND", 9, "step 3 stops only while STOP1 is active", "I"),
        bit("PCLR", 8, "LP and EP are cleared at the end", "I"),
        bit("ST4-D", 7, "direction of step 4", "I", values=ways),
        bit("ST4-E", 6, "step 4 (offset of P pulses, V) is executed", "I"),
        bit("ST3-D", 5, "direction of step 3", "I", values=ways),
        bit("ST3-E", 4, "step 3 (low-speed search of STOP2, HV) is executed", "I"),
        bit("ST2-D", 3, "direction of step 2", "I", values=ways),
        bit("ST2-E", 2, "step 2 (low-speed search of STOP1, HV) is executed", "I"),
        bit("ST1-D", 1, "direction of step 1", "I", values=ways),
        bit("ST1-E", 0, "step 1 (high-speed search of STOP0, V) is executed", "I"),
    )
    return tuple(replace(f, high=f.high + shift, low=f.low + shift) for f in meaning)


HM = Register(
    "HM", 0x60, 16, "W", "automatic home search", None, _home(), "I", reset=0,
    note="the layout is that of WR7 for command 60h of the MCX314As",
)  # fmt: skip
_DELAYED = tuple(f"{us} us" for us in DELAYS)
EM = Register(
    "EM", 0x60, 32, "W", "extension mode", None,
    (
        *(replace(f, evidence="C") for f in _home(16)),
        bits("FL", 15, 13, "delay of the filters", values=_DELAYED, note="2 is 512 us, the others [I]"),
        bit("FE4", 12, "filter of STOP3", "M"),
        bit("FE3", 11, "filter of EXP+, EXP-", "M"),
        bit("FE2", 10, "filter of INPOS, ALARM"),
        bit("FE1", 9, "filter of STOP2"),
        bit("FE0", 8, "filter of EMG, LMT+, LMT-, STOP0, STOP1"),
        bit("SMODE", 7, "stored, no effect", "C"),
        bit("HMINT", 5, "interrupt at the end of the home search"),
        bit("VRING", 4, "stored, no effect", "C"),
        bit("AVTRI", 3, "triangle prevention of linear ramps", values=("off", "on"), note="which is which [I]"),
        bit("POINV", 2, "the two output pins are exchanged"),
        bit("EPINV", 1, "EP counts the other way round"),
        bit("EPCLR", 0, "STOP2 clears EP", note="where it ends a drive"),
    ),
    "C", reset=0, note="bits 31..16 in WR7, 15..0 in WR6",
)  # fmt: skip


def _comparisons(low: int) -> tuple[Field, ...]:
    """WR1 enables these interrupts, RR3 shows them."""
    return (
        bit("PULSE", low, "a drive pulse began"),
        bit("P>=C-", low + 1, "the counter is at or above CM"),
        bit("P<C-", low + 2, "the counter is below CM"),
        bit("P<C+", low + 3, "the counter is below CP"),
        bit("P>=C+", low + 4, "the counter is at or above CP"),
        bit("C-END", low + 5, "constant speed ended", "S"),
        bit("C-STA", low + 6, "constant speed began"),
        bit("D-END", low + 7, "the drive ended"),
    )


_WRITTEN = (
    word(
        "WR0", "command register",
        bit("RESET", 15, "1 resets the chip: WR0 = 8000h"),
        bits("zero", 14, 12, "must be 0", legal=(0, 0)),
        bits("AXIS", 11, 8, "axes X, Y, Z, U", note="0 keeps the selection [I]"),
        bits("CODE", 7, 0, "command code"),
    ),
    word(
        "WR1", "stop inputs and interrupt enable",
        *(bit(f"SP{k}-L", 2 * k, f"active level of STOP{k}", values=LEVELS) for k in range(3)),
        *(bit(f"SP{k}-E", 2 * k + 1, f"STOP{k} stops the drive", "S") for k in range(3)),
        bit("EPCLR", 6, "STOP2 clears EP", "M", note="where it ends a drive"),
        bit("EPINV", 7, "EP counts the other way round", "M"),
        _comparisons(8), note="of the selected axes",
    ),
    word(
        "WR2", "limits and pulse signals",
        bit("SLMT+", 0, "software limit CP stops the drive", "S"),
        bit("SLMT-", 1, "software limit CM stops the drive", "S"),
        bit("LMTMD", 2, "hardware limits", "S", values=("sudden stop", "decelerating")),
        bit("HLMT+", 3, "active level of LMT+", values=LEVELS),
        bit("HLMT-", 4, "active level of LMT-", values=LEVELS),
        bit("CMPSL", 5, "CP and CM are compared with", values=("LP", "EP")),
        bit("PLSMD", 6, "", values=("independent 2-pulse", "pulse and direction")),
        bit("PLS-L", 7, "drive pulses", values=("positive logic", "negative")),
        bit("DIR-L", 8, "direction", values=("+ is low", "+ is high")),
        bit("PINMD", 9, "encoder input", values=("AB", "up / down")),
        bits("PIND", 11, 10, "division of the AB input", legal=(0, 2), values=("1/1", "1/2", "1/4")),
        bit("ALM-L", 12, "active level of ALARM", values=LEVELS),
        bit("ALM-E", 13, "ALARM stops the drive"),
        bit("INP-L", 14, "active level of INPOS", values=LEVELS),
        bit("INP-E", 15, "the drive ends only when INPOS is active"),
        note="of the selected axes",
    ),
    word(
        "WR3", "drive mode and filters",
        bit("MANLD", 0, "deceleration begins at", values=("the automatic point", "DP")),
        bit("DSNDE", 1, "deceleration at", values=("A, K", "D, and L where the chip has it")),
        bit("SACC", 2, "", "S", values=("linear ramps", "S-curves")),
        bits("EXOP", 4, 3, "drive by EXP+, EXP-", values=("off", "continuous", "fixed", "manual pulser")),
        bit("AVTRI", 5, "triangle prevention of linear ramps", "M", values=("off", "on"), note="which is which [I]"),
        bit("POINV", 6, "the two output pins are exchanged", "M"),
        bit("OUTSL", 7, "OUT0 to OUT3 show", "M", values=("WR4", "CMP+, CMP-, ASND, DSND"), note="which and in what order [I]"),
        bit("FE0", 8, "filter of EMG, LMT+, LMT-, STOP0, STOP1"),
        bit("FE1", 9, "filter of STOP2"),
        bit("FE2", 10, "filter of INPOS, ALARM"),
        bit("FE3", 11, "filter of EXP+, EXP-", note="which inputs [M]"),
        bit("FE4", 12, "filter of the other inputs", note="which inputs [M]"),
        bits("FL", 15, 13, "delay of the filters", values=tuple(f"{us} us" for us in DELAYS), note="2 is 512 us, the others [I]"),
        note="of the selected axes",
    ),
)  # fmt: skip
_SHOWN = (
    word(
        "RR1", "drive status and causes of the last stop, of the selected axis",
        bit("CMP+", 0, "counter >= CP"),
        bit("CMP-", 1, "counter < CM"),
        bit("ASND", 2, "speed increases", "S"),
        bit("CNST", 3, "speed is constant", "S"),
        bit("DSND", 4, "speed decreases", "S"),
        bit("AASND", 5, "acceleration increases"),
        bit("ACNST", 6, "acceleration is constant"),
        bit("ADSND", 7, "acceleration decreases"),
        *(bit(f"STOP{k}", 8 + k, f"ended by STOP{k}") for k in range(3)),
        bit("LMT+", 12, "ended by LMT+", "S"),
        bit("LMT-", 13, "ended by LMT-", "S"),
        bit("ALARM", 14, "ended by ALARM"),
        bit("EMG", 15, "ended by emergency stop"),
    ),
    word(
        "RR2", "errors and home search, of the selected axis",
        bit("SLMT+", 0, "software limit +"),
        bit("SLMT-", 1, "software limit -"),
        bit("HLMT+", 2, "hardware limit +"),
        bit("HLMT-", 3, "hardware limit -"),
        bit("ALARM", 4, "ALARM"),
        bit("EMG", 5, "emergency stop, while the level is active"),
        bit("HOME", 7, "home search"),
        bits("HMST", 12, 8, "state of the home search", values=HOME_STATES, note="see HOME_STATES", listed=False),
    ),
    word(
        "RR3", "interrupt factors of the selected axis; reading clears them [M]",
        _comparisons(0), bit("HMEND", 8, "the automatic home search ended"),
    ),
)  # fmt: skip
_INTERPOLATION = word(
    "WR5", "interpolation mode",
    bits("AX1", 1, 0, "main axis", "I", legal=(0, 1), values=("X", "Y")),
    bits("AX2", 3, 2, "second axis", "I", legal=(0, 1), values=("X", "Y")),
    bits("LSPD", 9, 8, "constant vector speed", "I", legal=(0, 1), values=("off", "two axes")),
    bit("EXPLS", 11, "an outside pulse makes the step", "I"),
    bit("CMPLS", 12, "command 3Ah makes the step", "I"),
    bit("CIINT", 14, "interrupt when the next segment can be written", "I"),
    bit("BPINT", 15, "interrupt when BPSC goes from 2 to 1", "I"),
)  # fmt: skip
_NOT_USED = word("WR5", "not used on this chip")
BIT_PATTERN = tuple(
    word(f"BP{k // 2 + 1}{'PM'[k % 2]}", f"steps of axis {k // 2 + 1} in {'+-'[k % 2]} direction",
         bits("BP", 15, 0, "16 steps, bit 0 first"), access="W", note=f"WR{k + 2} after 36h")
    for k in range(4)
)  # fmt: skip
"""What WR2 to WR5 are while BP writing is enabled."""


def _main_status(axes: int, interpolates: bool) -> Word:
    fields = [
        axis_bits("n-DRV", 0, axes, " is driving"),
        axis_bits("n-ERR", 4, axes, ": an error bit of RR1 or RR2 is set"),
    ]
    if interpolates:
        fields += [
            bit("I-DRV", 8, "interpolation is driving", "I"),
            bit("CNEXT", 9, "the next segment can be written"),
            bits("ZONE", 12, 10, "octant of circular interpolation", "I"),
            bits("BPSC", 14, 13, "bit pattern sets loaded, 0 to 3"),
        ]
    else:
        fields.append(axis_bits("n-HOM", 8, axes, " searches home", "C" if axes == 4 else "I"))
    return word("RR0", "main status", fields)


def _two_inputs(name: str, low: str, high: str) -> Word:
    """A word with the inputs of two axes."""
    fields = [bit("EMG", 3, "level of EMG", "M", values=LEVELS)] if low == "X" else []
    for a, shift in ((low, 0), (high, 8)):
        fields += [bit(f"{a}-STOP{k}", shift + k, f"level of STOP{k} of {a}", "M", values=LEVELS) for k in range(3)]
        signals = "EXP+ EXP- INPOS ALARM".split()
        fields += [bit(f"{a}-{n}", shift + k, f"level of {n} of {a}", values=LEVELS) for k, n in enumerate(signals, 4)]
    return word(name, f"input levels of {low} and {high}", fields)


def _one_input(name: str, a: str) -> Word:
    """A word with the inputs of one axis."""
    signals = {"STOP0": 0, "STOP1": 1, "STOP2": 2, "EXP+": 4, "EXP-": 5, "INPOS": 6, "ALARM": 7, "LMT+": 14, "LMT-": 15}
    fields = [bit(f"{a}-{n}", k, f"level of {n} of {a}", "?", values=LEVELS) for n, k in signals.items()]
    fields += [bit("EMG", 3, "level of EMG", "?", values=LEVELS)] if a == "X" else []
    return word(name, f"input levels of {a}", fields, bits(f"{a}-IN", 13, 8, f"levels of IN5 to IN0 of {a}"))


def _extended() -> tuple[Word, ...]:
    """WR1, WR3, WR5, RR1 and the inputs of the MCX314As, whose STOP inputs are IN0 to IN3 in its manual."""
    written = {w.name: w for w in _WRITTEN}
    outputs = {w.name: w for w in _SHOWN}
    wr1 = [f for f in written["WR1"].fields if f.name not in ("EPCLR", "EPINV")]
    wr3 = [f for f in written["WR3"].fields if f.low < 5]
    return (
        word("WR1", "stop inputs and interrupt enable", wr1, bit("SP3-L", 6, "active level of STOP3", values=LEVELS),
             bit("SP3-E", 7, "STOP3 stops the drive"), note="of the selected axes"),
        word("WR3", "drive mode and outputs", wr3,
             bit("OUTSL", 7, "OUT4 to OUT7 show", values=("bits 11..8", "CMP+, CMP-, ASND, DSND")),
             bits("OUT", 11, 8, "OUT7 to OUT4"), note="of the selected axes"),
        word(
            "WR5", "interpolation mode",
            *(bits(f"AX{k + 1}", 2 * k + 1, 2 * k, text, values=tuple(AXES))
              for k, text in enumerate(("main axis", "second axis", "third axis"))),
            bits("LSPD", 9, 8, "constant vector speed", legal=(0, 3), values={0: "off", 1: "two axes", 2: "none", 3: "three axes"}),
            bit("EXPLS", 11, "an outside pulse makes the step"), bit("CMPLS", 12, "command 3Ah makes the step"),
            bit("CIINT", 14, "interrupt when the next segment can be written"),
            bit("BPINT", 15, "interrupt when BPSC goes from 2 to 1"),
        ),
        word("RR1", outputs["RR1"].title, outputs["RR1"].fields, bit("STOP3", 11, "ended by STOP3")),
        *(
            word(name, f"input levels of {low} and {high}", (
                bit(f"{a}-{n}", shift + k, f"level of {n} of {a}", values=LEVELS)
                for a, shift in ((low, 0), (high, 8))
                for k, n in enumerate("STOP0 STOP1 STOP2 STOP3 EXP+ EXP- INPOS ALARM".split())
            ))
            for name, low, high in (("RR4", "X", "Y"), ("RR5", "Z", "U"))
        ),
        *(
            word(f"BP3{'PM'[k]}", f"steps of axis 3 in {'+-'[k]} direction", bits("BP", 15, 0, "16 steps, bit 0 first"),
                 access="W", note=f"WR{k + 6} after 36h")
            for k in range(2)
        ),
    )  # fmt: skip


def extended_words() -> tuple[Word, ...]:
    """The words of the MCX314As."""
    added = {w.name: w for w in _extended()}
    shared = words(4, True)
    return (*(added.pop(w.name, w) for w in shared), *added.values())


def words(axes: int, interpolates: bool) -> tuple[Word, ...]:
    """WR0 to WR7, RR0 to RR7 and, where there is bit pattern interpolation, the BP registers."""
    if axes == 2:
        inputs = (_one_input("RR4", "X"), _one_input("RR5", "Y"))
    else:
        inputs = (_two_inputs("RR4", "X", "Y"), _two_inputs("RR5", "Z", "U"))
    outputs = (bits(f"{a}-OUT", 4 * k + 3, 4 * k, f"OUT3 to OUT0 of {a}") for k, a in enumerate(AXES[:axes]))
    return (
        *_WRITTEN, word("WR4", "general outputs", outputs), _INTERPOLATION if interpolates else _NOT_USED, *DATA_WRITTEN,
        *(BIT_PATTERN if interpolates else ()), _main_status(axes, interpolates), *_SHOWN, *inputs, *DATA_READ,
    )  # fmt: skip
