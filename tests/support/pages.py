"""Pages that are followed word for word: their pieces, and whether what is printed is what they say."""

import re
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

FENCE = re.compile(r"^```(\w+)\n(.*?)^```\n|^((?: {4}[^\n]+\n)+)", re.M | re.S)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]\d+)?")
WALL_TIME = re.compile(r"in [\d.]+ s of wall time")


class Step(NamedTuple):
    """A piece of a page: what it is (python, c, text, typed), its content, its line."""

    kind: str
    text: str
    line: int

    @property
    def file(self) -> str:
        """The file that it is, by its first line; "" if none."""
        name = re.match(r"(?:/\* |# )(\w+\.\w+)", self.text)
        return name[1] if self.kind in ("python", "c", "sh", "yaml") and name else ""

    @property
    def shows(self) -> bool:
        """Compare the text with the output of the code block before it; errors of pytest are shortened on pages."""
        return self.kind == "text" and not self.text.startswith("E ")


def get_exit_code(command: str) -> int:
    """Return the exit code that a page says a command has: 1 where a wire is at the wrong pin."""
    return int("--pins x.step=B5" in command)


def choose_tolerance(page: Path) -> float:
    """Return the relative tolerance of decimals on a page."""
    return 0.0 if "--mcu" in page.read_text() else 0.002


def steps(page: Path) -> list[Step]:
    """The pieces of a page, in their order."""
    text = page.read_text()
    return [Step(m[1] or "typed", m[2] or m[3], text[: m.start()].count("\n") + 1) for m in FENCE.finditer(text)]


def is_printed(text: str, output: str, tolerance: float) -> bool:
    """Tell whether a page shows what a program prints: the begin of its output, or below a line of dots its end.

    Args:
        text: Text of the page.
        output: Output of the program; its wall-clock times may differ.
        tolerance: Relative tolerance of decimals.
    """
    expected, printed = (WALL_TIME.sub("", each).splitlines() for each in (text, output))
    if expected[0] == "...":
        del expected[0]
        printed = printed[-len(expected) :]
    return agree("\n".join(printed[: len(expected)]), "\n".join(expected), tolerance)


def agree(printed_text: str, expected: str, tolerance: float = 0.002) -> bool:
    """Compare what is printed with what a page says: the same words and whole numbers, and decimals that are near.

    A decimal may differ by what rounding to the last digit of either explains, or by the relative `tolerance`: 0.2 %, as another
    processor's arithmetic does, or 0 for the times and steps of an emulated processor, which are whole cycles.
    """
    printed, on_page = (NUMBER.findall(text) for text in (printed_text, expected))
    words = NUMBER.sub("#", printed_text).split() == NUMBER.sub("#", expected).split()
    return words and all(_is_same_number(a, b, tolerance) for a, b in zip(printed, on_page, strict=True))


def _is_same_number(printed: str, on_page: str, tolerance: float) -> bool:
    if "." not in on_page and "e" not in on_page:
        return printed == on_page
    rounding = sum(0.501 * 10.0 ** int(Decimal(number).as_tuple().exponent) for number in (printed, on_page))
    return abs(float(printed) - float(on_page)) <= max(rounding, tolerance * abs(float(on_page)))
