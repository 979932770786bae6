"""The register maps of the TOY and the TOY8."""

from stage.chips.register_map import ChipCommand, Register, RegisterMap

MAP = RegisterMap(
    "TOY",
    "a chip of two registers",
    "tests",
    (
        Register("RATE", 1, 16, "RW", "pulse rate", (1, 50_000), evidence="I", unit="pps"),
        Register("COUNT", 2, 16, "RW", "pulses left", (0, 0xFFFF), evidence="I", unit="pulses"),
    ),
    (),
    commands=(
        ChipCommand(0, "STOP", "stop", "other"),
        ChipCommand(1, "PLUS", "go plus", "drive", starts=True),
        ChipCommand(2, "MINUS", "go minus", "drive", starts=True),
    ),
)

AXES = 8
MAP8 = RegisterMap(
    "TOY8",
    "a chip of two registers an axis, eight axes",
    "tests",
    tuple(
        Register(f"{r.name}{j}", r.number + 2 * j, r.bits, r.access, r.title, r.legal, evidence="I", unit=r.unit)
        for j in range(AXES)
        for r in MAP.registers
    ),
    (),
    tuple(
        ChipCommand(c.code | j << 4, f"{c.symbol}{j}", f"{c.title}, axis {j}", c.kind, starts=c.starts)
        for j in range(AXES)
        for c in MAP.commands
    ),
    AXES,
)
