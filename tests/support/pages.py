"""Pages that are followed word for word: their pieces, and whether what is printed is what they say."""

import re
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

FENCE = re.compile(r"^```(\w+)\n(.*?)^```\n|^((?: {4}[^\n]+\n)+)", re.M | re.S)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]\d+)?")


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


def steps(page: Path) -> list[Step]:
    """The pieces of a page, in their order."""
    text = page.read_text()
    return [Step(m[1] or "typed", m[2] or m[3], text[: m.start()].count("\n") + 1) for m in FENCE.finditer(text)]


def agree(printed_text: str, expected: str) -> bool:
    """Compare what is printed with what a page says: the same words and whole numbers, and decimals that are near.

    A decimal may differ by what rounding to the last digit of either explains, or by 0.2 %, as another processor's arithmetic does.
    """
    printed, on_page = (NUMBER.findall(text) for text in (printed_text, expected))
    words = NUMBER.sub("#", printed_text).split() == NUMBER.sub("#", expected).split()
    return words and all(_is_same_number(a, b) for a, b in zip(printed, on_page, strict=True))


def _is_same_number(printed: str, on_page: str) -> bool:
    if "." not in on_page and "e" not in on_page:
        return printed == on_page
    rounding = sum(0.501 * 10.0 ** int(Decimal(number).as_tuple().exponent) for number in (printed, on_page))
    return abs(float(printed) - float(on_page)) <= max(rounding, 0.002 * abs(float(on_page)))
