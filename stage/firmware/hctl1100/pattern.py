"""What the HCTL-1100's signals and commands mean in a drawing of a move."""

from __future__ import annotations

from stage.firmware import pattern
from stage.firmware.pattern import BLUE, GREEN, GREY, RED


class Pattern(pattern.Pattern):
    """Of a report about an HCTL-1100."""

    LANES = (
        ("prof", "PROF", BLUE), ("init", "INIT", GREY), ("index", "EZ", GREEN), ("stop", "ORG", GREEN), ("limit", "LIMIT", RED),
    )  # fmt: skip
    ALWAYS = ("prof", "init")

    def tells(self, meaning: str) -> bool:
        return meaning.startswith("set F")
