"""What the NOVA chips' signals and commands mean in a drawing of a move."""

from __future__ import annotations

from stage.firmware import pattern
from stage.firmware.pattern import AMBER, BLUE, GREEN, GREY, RED, VIOLET


class Pattern(pattern.Pattern):
    """Of a report about a NOVA chip."""

    LANES = (
        ("asnd", "ASND", BLUE), ("cnst", "CNST", BLUE), ("dsnd", "DSND", BLUE), ("drive", "n-DRV", GREY),
        ("dir", "DIR \N{MINUS SIGN}", VIOLET), ("stop0", "STOP0", AMBER), ("stop1", "ORG", GREEN), ("stop2", "EZ", GREEN),
        ("lmt_plus", "EL+", RED), ("lmt_minus", "EL-", RED), ("alarm", "ALARM", RED),
    )  # fmt: skip
    ALWAYS = ("asnd", "cnst", "dsnd", "drive")

    def tells(self, meaning: str) -> bool:
        return "driv" in meaning or "stop" in meaning or "home" in meaning or "interpolation" in meaning
