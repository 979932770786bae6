"""Register maps of the PCL-240 family as data. What a variant has more is a row more.

Sources: PCL-240K data sheet (sections 3 and 4), "Differences between PCL-240MK and PCL-240MS" (its sections 2 and 3), a
vendor header for the 240MK; the normative model for what their lost figures would say. PDIR as a pin is asserted
while low (minus) [I].
"""

from __future__ import annotations

from dataclasses import replace

from stage.chips.register_map import Field, Register, RegisterMap, Word

CONTROL, SELECT, OUTPUT = 0x40, 0x80, 0xC0
"""What a byte to address 0 begins with, in its two high bits (section 3); 00 begins a command."""

OPERATING_MODE = Word(
    "operate",
    "operating mode selection, 00xx xxxx at address 0",
    (
        Field("group", 7, 6, "00", access="W"),
        Field("int_at_stop", 5, 5, "1 = /INT at stop; 0 also clears a pending /INT", "S", "W"),
        Field("start", 4, 4, "start, or a speed change while running", "S", "W"),
        Field("stop", 3, 3, "alone (08h): reset command; with start (1Dh, 1Fh): decelerating stop", "S", "W"),
        Field("ramp", 2, 2, "1 = high speed (with ramps), 0 = constant speed", "S", "W"),
        Field("speed", 1, 0, "00 FL, 01 FH1, 11 FH2; 10 acts as FL [I]", "S", "W"),
    ),
)
CONTROL_MODE = Word(
    "control",
    "control mode selection, 01xx xxxx at address 0",
    (
        Field("group", 7, 6, "01", access="W"),
        Field("minus", 3, 3, "direction: 0 plus, 1 minus", "S", "W"),
        Field("preset", 2, 2, "stop when R0 reaches 0", "S", "W"),
        Field("sd", 1, 1, "SD+ and SD- slow a high-speed run", "I", "W"),
        Field("origin", 0, 0, "origin return: stop at ORG", "S", "W"),
    ),
)
REGISTER_SELECT = Word(
    "select",
    "register selection, 10xx xxxx at address 0",
    (Field("group", 7, 6, "10", access="W"), Field("register", 2, 0, "R0 to R7", "S", "W")),
)
OUTPUT_MODE = Word(
    "output",
    "output pulse mode selection, 11xx xxxx at address 0",
    (
        Field("group", 7, 6, "11", access="W"),
        Field("ots", 5, 5, "level of the OTS output", "I", "W"),
        Field("external", 4, 4, "R0 counts: 0 output pulses, 1 rising edges of EXTP", "I", "W"),
        Field("stored", 2, 1, "stored, no effect", "I", "W"),
        Field("independent", 0, 0, "0 common (POUT and PDIR), 1 independent (+ on POUT, - on PDIR)", "I", "W"),
    ),
)
STATUS = Word(
    "status",
    "status byte, read at address 0",
    (
        Field("no_int", 7, 7, "1 = no /INT pending", "H", "R"),
        Field("operating", 6, 6, "1 until the pulse in progress is complete", "S", "R"),
        Field("fkeep", 5, 5, "neither ramping up nor down", "I", "R"),
        Field("lt", 4, 4, "R0 < R6", "I", "R"),
        Field("zero", 3, 3, "R0 = 0", "H", "R"),
        Field("sd", 2, 2, "SD of the current direction asserted", "I", "R"),
        Field("org", 1, 1, "ORG asserted", "I", "R"),
        Field("ins", 0, 0, "INS asserted", "I", "R"),
    ),
)


def _with(word: Word, *more: Field) -> Word:
    """`word` with fields more, in the order of their bits."""
    return replace(word, fields=tuple(sorted((*word.fields, *more), key=lambda f: -f.high)))


EXTENDED_OPERATING_MODE = replace(
    OPERATING_MODE,
    fields=tuple(
        replace(f, meaning=f.meaning.replace("reset command", "reset command, clears R6")) if f.name == "stop" else f
        for f in OPERATING_MODE.fields
    ),
)
EXTENDED_CONTROL_MODE = _with(
    CONTROL_MODE,
    Field("position", 5, 5, "R10 counts output pulses", "H", "W"),
    Field("automatic", 4, 4, "automatic ramp-down point, R6 its offset; preset, with ramps", "S", "W"),
)
EXTENDED_SELECT = Word(
    "select",
    "register selection, 10xx xxxx at address 0",
    (
        Field("group", 7, 6, "10", access="W"),
        Field(
            "collective", 5, 5, "the low byte's write transfers all bytes; the high byte's read latches all", "H", "W"
        ),
        Field("extension", 4, 4, "1 = the group R10 to R17", "H", "W"),
        Field("register", 2, 0, "R0 to R7, or R10 to R17", "S", "W"),
    ),
)
EXTENDED_OUTPUT_MODE = _with(
    OUTPUT_MODE, Field("extension", 3, 3, "extension mode: reads return the selected register, else R0", "H", "W")
)


def _registers(rate_bits: int, point_bits: int, extended: bool) -> tuple[Register, ...]:
    speed, rate = (1, 8191), (2, (1 << rate_bits) - 1)
    point, access = (0, (1 << point_bits) - 1), "RW" if extended else "W"
    offset = f"; with the automatic point its offset, sign in b{point_bits - 1}" if extended else ""
    return (
        Register("R0", 0, 24, "RW", "down counter: pulses left", (0, 16777215), unit="pulses"),
        Register("R1", 1, 13, access, "FL speed", speed, unit="speed steps"),
        Register("R2", 2, 13, access, "FH1 speed", speed, unit="speed steps"),
        Register("R3", 3, 13, access, "FH2 speed", speed, unit="speed steps"),
        Register("R4", 4, rate_bits, access, "acceleration rate", rate, unit="clocks per speed step"),
        Register("R5", 5, rate_bits, access, "deceleration rate", rate, unit="clocks per speed step"),
        Register("R6", 6, point_bits, access, "ramping-down point" + offset, point, unit="pulses"),
        Register("R7", 7, 10, access, "multiplier: one speed step is clock / (8192 R7)", (2, 1023)),
    )


def _stored(high: int, low: int) -> Field:
    return Field("stored", high, low, "stored, no effect", "I")


def _extension(s_curves: bool) -> tuple[Register, ...]:
    """R10 to R17. On the MK the registers that only the MS has store what is written."""
    seen = "S" if s_curves else "I"
    span = "speed steps of each curved end, 1 to 4095; 0 or above half the ramp: half"
    org = (
        Field("org_logic", 23, 23, "ORG logic: 0 negative, 1 positive; stored, pins are set as asserted", "S")
        if s_curves
        else Field("fixed", 23, 23, "always 0", "S", "R")
    )
    up: tuple[Field, ...] = (_stored(15, 0),)
    down: tuple[Field, ...] = (_stored(11, 0),)
    if s_curves:
        up = (
            Field("uncorrected", 15, 15, "1 = FH correction off: a short preset move is a triangle", "S"),
            Field("stored", 14, 13, "stored, no effect", "I"),
            Field("linear", 12, 12, "1 = linear ramps, 0 = S-curves", "I"),
            Field("span", 11, 0, span, "S"),
        )
        down = (Field("span", 11, 0, span, "S"),)
    title = (
        "S-curve" if s_curves else "no S-curve on this chip; a write in motion ends the automatic point all the same"
    )
    return (
        Register("R10", 0x10, 24, "RW", "position counter, two's complement", evidence="H", unit="pulses"),
        Register("R11", 0x11, 24, "RW", "stored, no effect", evidence="I"),
        Register(
            "R12", 0x12, 24, "RW", "input logic", None,
            (
                _stored(23, 13),
                Field("ez_logic", 12, 12, "EZ logic; stored, pins are set as asserted", "S"),
                _stored(11, 0),
            ),
        ),
        Register(
            "R13", 0x13, 24 if s_curves else 23, "RW", "origin return", None,
            (
                org,
                _stored(22, 22),
                Field("ez_return", 21, 21, "1 = origin return ends at EZ, not at ORG", "I"),
                Field("ez_from_fl", 20, 20, "EZ counts from: 0 ORG on, 1 FL reached after ORG", "I"),
                Field("ez_count", 19, 16, "EZ edges to let pass: the return ends at the next one", "S"),
                _stored(15, 0),
            ),
        ),
        Register("R14", 0x14, 16, "RW", f"acceleration: {title}", None, up, seen),
        Register("R15", 0x15, 12, "RW", f"deceleration: {title}", None, down, seen),
        Register("R16", 0x16, 24, "RW", "stored, no effect", evidence="I"),
        Register(
            "R17", 0x17, 24, "RW", "EZ monitor", None,
            (
                _stored(23, 21),
                Field("ez", 20, 20, "EZ asserted", seen, "R"),
                Field("ez_counter", 19, 16, "EZ edges to come; at rest R13's count", seen, "R"),
                _stored(15, 0),
            ),
            seen,
        ),
    )  # fmt: skip


EXTENDED_WORDS = (EXTENDED_OPERATING_MODE, EXTENDED_CONTROL_MODE, EXTENDED_SELECT, EXTENDED_OUTPUT_MODE, STATUS)

PCL240K_MAP = RegisterMap(
    "PCL240K",
    "Nippon Pulse PCL-240K pulse generator, one axis, 8-bit bus",
    "data sheet PCL-240K, sections 3 and 4; PDIR as a pin is asserted while low (minus) [I]",
    _registers(14, 20, extended=False),
    (OPERATING_MODE, CONTROL_MODE, REGISTER_SELECT, OUTPUT_MODE, STATUS),
)
PCL240MK_MAP = RegisterMap(
    "PCL240MK",
    "Nippon Pulse PCL-240MK pulse generator with automatic ramp-down and position counter, one axis, 8-bit bus",
    'data sheets PCL-240K and "Differences between PCL-240MK and PCL-240MS", vendor header 240MK',
    (*_registers(14, 20, extended=True), *_extension(s_curves=False)),
    EXTENDED_WORDS,
)
PCL240MS_MAP = RegisterMap(
    "PCL240MS",
    "Nippon Pulse PCL-240MS pulse generator with S-curves, automatic ramp-down and position counter, one axis, 8-bit bus",
    'data sheets PCL-240K and "Differences between PCL-240MK and PCL-240MS", vendor header 240MK',
    (*_registers(16, 24, extended=True), *_extension(s_curves=True)),
    EXTENDED_WORDS,
)
