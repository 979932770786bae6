"""The register map of the TOY as data."""

from stage.chips.register_map import Command, Register, RegisterMap

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
        Command(0, "STOP", "stop", "other"),
        Command(1, "PLUS", "go plus", "drive", starts=True),
        Command(2, "MINUS", "go minus", "drive", starts=True),
    ),
)
