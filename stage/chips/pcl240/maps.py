"""Register maps of the PCL-240 family as data. A variant with more registers or bits has more rows.

Sources: PCL-240K data sheet (sections 3 and 4), "Differences between PCL-240MK and PCL-240MS" (its sections 2 and 3), a
vendor header for the 240MK; in place of their lost figures the normative model. PDIR as a pin is asserted
while low (minus) [I].

Evidence S means that a sentence or a table of these sheets states it. Two rules extend the sheets to the MK and the MS: statements
of the 240K's sheet about R0 to R7 hold for both unless the other sheet changes them, and functions that the other sheet describes
without naming them among its "changes and additions" (section 1) exist on both.
"""

from __future__ import annotations

from dataclasses import replace

from stage.chips.register_map import Field, Register, RegisterMap, Word

OPERATE, CONTROL, SELECT, OUTPUT = 0x00, 0x40, 0x80, 0xC0
"""Kinds of commands at address 0, by their two highest bits (data sheet section 3)."""
COMMAND_WORD_NAMES = {OPERATE: "operate", CONTROL: "control", SELECT: "select", OUTPUT: "output"}
"""Name of the command word for each kind of command at address 0."""
COUNTERS = ("R0", "R10")
"""Registers that count by themselves."""
WIRES = {
    "el_plus": ("EL_PLUS_n", 0), "el_minus": ("EL_MINUS_n", 0), "sd_plus": ("SD_PLUS_n", 0), "sd_minus": ("SD_MINUS_n", 0),
    "org": ("ORG_n", 0), "extp": ("EXTP_n", 0), "ez": ("EZ_n", 0), "ins": ("INS", 1), "pout": ("POUT_n", 0), "pdir": ("PDIR", 0),
    "irq": ("INT_n", 0), "ots": ("OTS", 1), "hold": ("HOLD", 1), "fdown": ("FDOWN", 1), "fkeep": ("FKEEP", 1),
    "fup": ("FUP", 1), "lt": ("LT", 1), "zero": ("ZERO", 1),
}  # fmt: skip
"""Pin -> (name on the wire, level while asserted), see `Chip.WIRES`. PDIR is a level: 0 minus, 1 plus (section 2)."""
PHASES = {"hold": "hold", "fup": "up", "fkeep": "keep", "fdown": "down"}
"""Output pin -> phase of a run, see `Chip.PHASES`."""


def _make_group_field(code: int) -> Field:
    """Return the field that distinguishes the four kinds of commands at address 0."""
    return Field("group", 7, 6, f"{code >> 6:02b}", access="W", legal=(code >> 6, code >> 6))


def _make_operating_mode(reset_effect: str) -> Word:
    """Return the word of the operating mode command.

    Args:
        reset_effect: Further effect of the reset command, for its description.
    """
    return Word(
        "operate",
        "operating mode selection, 00xx xxxx at address 0",
        (
            _make_group_field(OPERATE),
            Field("int_at_stop", 5, 5, "/INT at stop", "S", "W", note="0 also clears a pending /INT [H]"),
            Field("start", 4, 4, "start, or a speed change while running", "S", "W"),
            Field(
                "stop", 3, 3, f"alone: reset command{reset_effect}; with start and ramp: decelerating stop", "S", "W",
                note="with start, without ramp: in no table, stops a constant-speed run at once [I]",
            ),
            Field("ramp", 2, 2, "", "S", "W", values={0: "constant speed", 1: "high speed (with ramps)"}),
            Field(
                "speed", 1, 0, "", "S", "W", values={0: "FL", 1: "FH1", 3: "FH2"},
                note="2 is in no table and acts as FL [I]",
            ),
        ),
        address=0,
        sends={
            0x08: "reset command: pulses stop, the next start is armed",
            0x10: "start at FL, constant speed",
            0x11: "start at FH1, constant speed",
            0x13: "start at FH2, constant speed",
            0x15: "start with a ramp to FH1",
            0x17: "start with a ramp to FH2",
            0x14: "ramp down to FL and go on",
            0x1D: "decelerating stop, from FH1",
            0x1F: "decelerating stop, from FH2",
        },
        section="section 3 a",
    )  # fmt: skip


OPERATING_MODE = _make_operating_mode("")
EXTENDED_OPERATING_MODE = _make_operating_mode(", clears R6")
CONTROL_MODE = Word(
    "control",
    "control mode selection, 01xx xxxx at address 0",
    (
        _make_group_field(CONTROL),
        Field("minus", 3, 3, "direction", "S", "W", values={0: "plus", 1: "minus"}),
        Field("preset", 2, 2, "stop when R0 reaches 0", "S", "W"),
        Field("sd", 1, 1, "SD+ and SD- slow a high-speed run", "I", "W"),
        Field("origin", 0, 0, "origin return", "S", "W", note="stop at ORG"),
    ),
    address=0,
    section="section 3 b",
)
REGISTER_SELECT = Word(
    "select",
    "register selection, 10xx xxxx at address 0",
    (_make_group_field(SELECT), Field("register", 2, 0, "register", "I", "W", values={k: f"R{k}" for k in range(8)})),
    address=0,
    section="section 3 c",
)
OUTPUT_MODE = Word(
    "output",
    "output pulse mode selection, 11xx xxxx at address 0",
    (
        _make_group_field(OUTPUT),
        Field("ots", 5, 5, "level of the OTS output", "I", "W", values={0: "low", 1: "high"}),
        Field("external", 4, 4, "R0 counts", "I", "W", values={0: "output pulses", 1: "rising edges of EXTP"}),
        Field("stored", 2, 1, "stored, no effect", "I", "W"),
        Field(
            "independent", 0, 0, "output pulses", "I", "W",
            values={0: "common (POUT and PDIR)", 1: "independent (+ on POUT, - on PDIR)"},
        ),
    ),
    address=0,
    section="section 3 d",
)  # fmt: skip
STATUS = Word(
    "status",
    "status byte, read at address 0",
    (
        Field(
            "no_int", 7, 7, "", "H", "R", values={0: "/INT pending", 1: "no /INT pending"}, silent=1, pins=("/irq",)
        ),
        Field(
            "operating", 6, 6, "", "S", "R", values={0: "not operating", 1: "operating"},
            note="until the pulse in progress is complete; which level is which [H]", silent=None, pins=("/hold",),
        ),
        Field("fkeep", 5, 5, "neither ramping up nor down", "I", "R", pins=("fkeep",)),
        Field("lt", 4, 4, "R0 < R6", "I", "R", pins=("lt",)),
        Field("zero", 3, 3, "R0 = 0", "H", "R", pins=("zero",)),
        Field("sd", 2, 2, "SD of the current direction asserted", "I", "R", pins=("sd_plus", "sd_minus")),
        Field("org", 1, 1, "ORG asserted", "I", "R", pins=("org",)),
        Field("ins", 0, 0, "INS asserted", "I", "R", pins=("ins",)),
    ),
    address=0,
)  # fmt: skip


def _add_fields(word: Word, *more: Field) -> Word:
    """Return a copy of a word of the register map with further fields, in the order of their bits."""
    return replace(word, fields=tuple(sorted((*word.fields, *more), key=lambda f: -f.high)))


EXTENDED_CONTROL_MODE = _add_fields(
    CONTROL_MODE,
    Field("position", 5, 5, "R10 counts output pulses", "H", "W"),
    Field("automatic", 4, 4, "automatic ramp-down point, R6 its offset", "S", "W", note="of preset runs with ramps"),
)
EXTENDED_SELECT = Word(
    "select",
    "register selection, 10xx xxxx at address 0",
    (
        _make_group_field(SELECT),
        Field(
            "collective", 5, 5, "collective transfers", "H", "W",
            note="the low byte's write transfers all bytes; the high byte's read latches all",
        ),
        Field("extension", 4, 4, "group", "H", "W", values={0: "R0 to R7", 1: "R10 to R17"}),
        Field("register", 2, 0, "register", "I", "W", values={k: f"R{k} or R1{k}" for k in range(8)}),
    ),
    address=0,
    section="section 3 c",
)  # fmt: skip
EXTENDED_OUTPUT_MODE = _add_fields(
    OUTPUT_MODE,
    Field("extension", 3, 3, "extension mode: reads return", "H", "W", values={0: "R0", 1: "the selected register"}),
)


def _make_registers(rate_bits: int, ramp_down_point: Register, extended: bool) -> tuple[Register, ...]:
    """Return the registers R0 to R7 of the PCL-240 family.

    Args:
        rate_bits: Width of R4 and R5.
        ramp_down_point: Register R6 of the chip.
        extended: Whether the chip has R10 to R17.
    """
    speed, rate = (1, 8191), (2, (1 << rate_bits) - 1)
    access = "RW" if extended else "W"
    return (
        Register("R0", 0, 24, "RW", "down counter", (1, 16777215), unit="pulses", note="pulses left", also=(0,)),
        Register("R1", 1, 13, access, "FL speed", speed, unit="speed steps"),
        Register("R2", 2, 13, access, "FH1 speed", speed, unit="speed steps"),
        Register("R3", 3, 13, access, "FH2 speed", speed, unit="speed steps"),
        Register("R4", 4, rate_bits, access, "acceleration rate", rate, unit="clocks per speed step"),
        Register("R5", 5, rate_bits, access, "deceleration rate", rate, unit="clocks per speed step"),
        ramp_down_point,
        Register("R7", 7, 10, access, "multiplier", (2, 1023), note="one speed step is clock / (8192 R7)"),
    )


_POINT = Register("R6", 6, 20, "W", "ramping-down point", (1, 1048575), unit="pulses", also=(0,), tuned=(0, 0xFFFFF))
_POINT_OR_OFFSET = replace(
    _POINT, access="RW", legal=(0, 1048575), also=(), note="with the automatic point its offset, sign in b19"
)
_WIDE_POINT_OR_OFFSET = replace(
    _POINT_OR_OFFSET, bits=24, legal=(0, 16777215), note="with the automatic point its offset, sign in b23"
)


def _make_stored_field(high: int, low: int) -> Field:
    """Return a field of bits that are stored without effect."""
    return Field("stored", high, low, "stored, no effect", "I")


def _make_extension_registers(s_curves: bool) -> tuple[Register, ...]:
    """Return R10 to R17. On the MK the registers that only the MS uses store the written value without effect."""
    seen = "S" if s_curves else "I"
    span = Field(
        "span", 11, 0, "speed steps of each curved end", "S", note="1 to 4095; 0 or above half the ramp: half the ramp"
    )
    logic = {0: "negative", 1: "positive"}
    turned = "1: asserted while the pin is high, as it is when nobody drives it"
    org = (
        Field("org_logic", 23, 23, "ORG logic", "S", values=logic, note=turned)
        if s_curves
        else Field("fixed", 23, 23, "always 0", "S", "R")
    )
    monitor: tuple[Field, ...] = (Field("fixed", 20, 16, "always 0", "I", "R"),)
    up: tuple[Field, ...] = (_make_stored_field(15, 0),)
    down: tuple[Field, ...] = (_make_stored_field(11, 0),)
    if s_curves:
        up = (
            Field(
                "uncorrected", 15, 15, "FH correction", "S", values={0: "on", 1: "off"},
                note="off: a short preset move is a triangle",
            ),
            Field("stored", 14, 13, "stored, no effect", "I"),
            Field("linear", 12, 12, "", "I", values={0: "S-curves", 1: "linear ramps"}),
            span,
        )  # fmt: skip
        down = (span,)
        monitor = (
            Field("ez", 20, 20, "EZ asserted", "I", "R"),
            Field("ez_counter", 19, 16, "EZ edges to come", "I", "R", note="at rest R13's count"),
        )
    spans = (0, span.mask)
    note = "S-curve" if s_curves else "no S-curve on this chip; a write in motion ends the automatic point all the same"
    return (
        Register("R10", 0x10, 24, "RW", "position counter", evidence="H", unit="pulses", note="two's complement"),
        Register("R11", 0x11, 24, "RW", "stored, no effect", evidence="I"),
        Register(
            "R12", 0x12, 24, "RW", "input logic", None,
            (
                _make_stored_field(23, 13),
                Field("ez_logic", 12, 12, "EZ logic", "I", values=logic, note=f"{turned}; that this bit selects the logic [S]"),
                _make_stored_field(11, 0),
            ),
        ),
        Register(
            "R13", 0x13, 24 if s_curves else 23, "RW", "origin return", None,
            (
                org,
                _make_stored_field(22, 22),
                Field("ez_return", 21, 21, "origin return ends at", "I", values={0: "ORG", 1: "EZ"}),
                Field("ez_from_fl", 20, 20, "EZ counts from", "I", values={0: "ORG on", 1: "FL reached after ORG"}),
                Field("ez_count", 19, 16, "EZ edges to let pass", "S", note="the return ends at the next one"),
                _make_stored_field(15, 0),
            ),
        ),
        Register("R14", 0x14, 16, "RW", "acceleration", None, up, seen, note=note, tuned=spans),
        Register("R15", 0x15, 12, "RW", "deceleration", None, down, seen, note=note, tuned=spans),
        Register("R16", 0x16, 24, "RW", "stored, no effect", evidence="I"),
        Register(
            "R17", 0x17, 24, "RW", "EZ monitor" if s_curves else "stored, no effect", None,
            (_make_stored_field(23, 21), *monitor, _make_stored_field(15, 0)),
            seen,
        ),
    )  # fmt: skip


EXTENDED_WORDS = (EXTENDED_OPERATING_MODE, EXTENDED_CONTROL_MODE, EXTENDED_SELECT, EXTENDED_OUTPUT_MODE, STATUS)

PCL240K_MAP = RegisterMap(
    "PCL240K",
    "Nippon Pulse PCL-240K pulse generator, one axis, 8-bit bus",
    "data sheet PCL-240K, sections 3 and 4; PDIR as a pin is asserted while low (minus) [I]; "
    "R6 = 0, as /RESET leaves it, is no point [I]",
    _make_registers(14, _POINT, extended=False),
    (OPERATING_MODE, CONTROL_MODE, REGISTER_SELECT, OUTPUT_MODE, STATUS),
)
PCL240MK_MAP = RegisterMap(
    "PCL240MK",
    "Nippon Pulse PCL-240MK pulse generator with automatic ramp-down and position counter, one axis, 8-bit bus",
    'data sheets PCL-240K and "Differences between PCL-240MK and PCL-240MS", vendor header 240MK; '
    "the range of R6 and the sign of its offset follow from its bits [I]",
    (*_make_registers(14, _POINT_OR_OFFSET, extended=True), *_make_extension_registers(s_curves=False)),
    EXTENDED_WORDS,
)
PCL240MS_MAP = RegisterMap(
    "PCL240MS",
    "Nippon Pulse PCL-240MS pulse generator with S-curves, automatic ramp-down and position counter, one axis, 8-bit bus",
    'data sheets PCL-240K and "Differences between PCL-240MK and PCL-240MS", vendor header 240MK; '
    "the ranges of R4 and R5 follow from their bits [I]",
    (*_make_registers(16, _WIDE_POINT_OR_OFFSET, extended=True), *_make_extension_registers(s_curves=True)),
    EXTENDED_WORDS,
)
