"""The register map of the ACME1000 as data: the tables of its data sheet."""

from stage.chips.register_map import ChipCommand, Field, Register, RegisterMap, Word

SOURCE = "data sheet ACME1000, tables 1 to 3"
CONTROL = Word(
    "control",
    "control word, written at address 0",
    (
        Field("slow", 5, 5, "decelerating stop"),
        Field("ramp", 4, 4, "ramps between START and DRIVE; 0: START throughout"),
        Field("origin", 3, 3, "stop at ORG"),
        Field("preset", 2, 2, "stop when COUNT is 0"),
        Field("minus", 1, 1, "direction", values={0: "plus", 1: "minus"}),
        Field("start", 0, 0, "start; without start and slow: stop at once"),
    ),
    16,
)
STATUS = Word(
    "status",
    "status word, read at address 0",
    (
        Field("org", 3, 3, "ORG asserted", pins=("org",)),
        Field("minus_limit", 2, 2, "EL- asserted", pins=("el_minus",)),
        Field("plus_limit", 1, 1, "EL+ asserted", pins=("el_plus",)),
        Field("busy", 0, 0, "operating"),
    ),
    16,
)
MAP = RegisterMap(
    "ACME1000",
    "an invented pulse generator, one axis, 16-bit bus",
    SOURCE,
    (
        Register("START", 1, 16, "RW", "start and stop speed", (1, 20_000), unit="pps"),
        Register("DRIVE", 2, 16, "RW", "drive speed", (1, 65_535), unit="pps"),
        Register("SLOPE", 3, 16, "RW", "change of speed in a millisecond", (1, 5_000), unit="pps/ms"),
        Register("COUNT", 4, 16, "RW", "pulses left", (0, 65_535), unit="pulses"),
    ),
    (CONTROL, STATUS),
    (
        ChipCommand(0x00, "STOP", "stop at once", "other"),
        ChipCommand(0x20, "SLOW", "decelerating stop", "other"),
        ChipCommand(0x15, "MOVE+", "preset move with ramps, plus", "drive", starts=True),
        ChipCommand(0x17, "MOVE-", "preset move with ramps, minus", "drive", starts=True),
        ChipCommand(0x11, "RUN+", "run with ramps, plus", "drive", starts=True),
        ChipCommand(0x13, "RUN-", "run with ramps, minus", "drive", starts=True),
        ChipCommand(0x19, "HOME+", "with ramps to ORG, plus", "drive", starts=True),
        ChipCommand(0x1B, "HOME-", "with ramps to ORG, minus", "drive", starts=True),
        ChipCommand(0x09, "CREEP+", "at START to ORG, plus", "drive", starts=True),
        ChipCommand(0x0B, "CREEP-", "at START to ORG, minus", "drive", starts=True),
    ),
)
