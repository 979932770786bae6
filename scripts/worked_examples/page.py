"""Table of docs/worked_examples.md."""

from __future__ import annotations

from importlib import import_module

from worked_examples.table import EXAMPLES, Example, Number

SHEETS = ("pcl240k", "pcl240ms", "nova", "hctl1100")
BEGIN, END = "<!-- emulated: begin -->\n", "<!-- emulated: end -->"


def compute_rows() -> list[tuple[Example, Number]]:
    """Return every example with the number of the emulated chip."""
    for name in SHEETS:
        import_module(f"worked_examples.{name}")
    return [(example, example.measure()) for example in EXAMPLES]


def format_tables(examples: list[tuple[Example, Number]]) -> str:
    """Return the tables as Markdown, one for each sheet."""
    lines: list[str] = []
    sheet = ""
    for example, emulated in examples:
        if example.sheet != sheet:
            sheet = example.sheet
            lines += ["", f"## {sheet}", "", "| place | what | sheet | emulated | |", "|---|---|---|---|---|"]
        number, displayed = (format_number(n, example.unit) for n in (example.number, emulated))
        differs = "" if number == displayed else f"within {example.within:g}: {example.why}"
        if not example.agrees(emulated):
            differs = f"**differs** by more than {example.within:g}"
        lines.append(f"| {example.place} | {example.says} | {number} | {displayed} | {differs} |")
    return "\n".join(lines[1:]) + "\n"


def format_number(number: Number, unit: str) -> str:
    """Format a number for the page: whole numbers in full, times in ms or us, other numbers with six digits."""
    if unit == "s":
        number, unit = (number * 1e3, "ms") if number >= 0.01 else (number * 1e6, "us")
    integer = float(number) == round(number)
    return f"{round(number):,}" * integer + f"{number:,.6g}" * (not integer) + f" {unit}" * bool(unit)


def replace_tables(page: str, text: str) -> str:
    """Return the page with `text` between its markers."""
    before, rest = page.split(BEGIN)
    return before + BEGIN + "\n" + text + "\n" + END + rest.split(END)[1]
