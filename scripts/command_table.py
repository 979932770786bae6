"""The tables of commands in docs/nova.md, from the register maps, the chip classes and the tests.

python scripts/command_table.py           writes the tables between the page's markers again
python scripts/command_table.py --check   says whether they are up to date

A marker `<!-- commands: MCX304 MCX302 -->` asks for one table of these chips, up to `<!-- end -->`. A command counts as implemented
unless the register map says what is lacking. Tested by: the test files with tests that are decorated
`@covers(chip, symbol, ...)` (tests/support/covers.py makes such a test fail if it does not write the command).
"""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter, defaultdict
from pathlib import Path

from stage.chips import CHIPS
from stage.chips.nova.registers.mcx300 import MCX302_MAP, MCX304_MAP, MCX312_MAP, MCX314AS_MAP
from stage.chips.nova.registers.mcx514 import MCX501_MAP, MCX512_MAP, MCX514_MAP
from stage.chips.register_map import EVIDENCE, ChipCommand, RegisterMap

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "nova.md"
MAPS = {m.chip: m for m in (MCX514_MAP, MCX512_MAP, MCX501_MAP, MCX304_MAP, MCX302_MAP, MCX312_MAP, MCX314AS_MAP)}
BLOCK = re.compile(r"(<!-- commands: (?P<chips>[\w ]+) -->\n).*?(<!-- end -->)", re.S)
Tests = dict[tuple[str, str], Counter[str]]


def count_covering_tests(folder: Path) -> Tests:
    """Count the tests of each file that cover a command, by (chip, symbol)."""
    matches: Tests = defaultdict(Counter)
    for path in sorted(folder.rglob("test_*.py")):
        text = path.read_text()
        if "@covers(" not in text:
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                for d in node.decorator_list:
                    if isinstance(d, ast.Call) and isinstance(d.func, ast.Name) and d.func.id == "covers":
                        chips, *symbols = (ast.literal_eval(a) for a in d.args)
                        for chip in chips.split():
                            for symbol in symbols:
                                matches[chip, symbol][path.stem] += 1
    return matches


def describe_support(map_: RegisterMap, command: ChipCommand) -> str:
    """Describe for the table whether a chip supports a command."""
    if map_.chip not in CHIPS:
        return "no chip yet"
    return command.lacking.partition(":")[0] or "yes"


def format_table(maps: list[RegisterMap], tests: Tests) -> str:
    """Format one Markdown table for chips whose commands differ only in which of them exist.

    Args:
        maps: Register maps of the chips.
        tests: Tests of each command, as `count_covering_tests` returns them.
    """
    several = len(maps) > 1
    heads = f"command|code|what|bytes|{'chips|' if several else ''}implemented|tested by|evidence".split("|")
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    commands = sorted({c.symbol: c for m in maps for c in m.commands}.values(), key=lambda c: c.code)
    for c in commands:
        on = [m for m in maps if c in m.commands]
        chips = "all" if len(on) == len(maps) else ", ".join(m.chip for m in on)
        meaning = " / ".join(dict.fromkeys(describe_support(m, c) for m in on))
        counts = sum((tests.get((m.chip, c.symbol), Counter()) for m in on), Counter())
        by = ", ".join(f"{name} ({n})" if n > 1 else name for name, n in sorted(counts.items())) or "-"
        cells = [
            c.symbol,
            c.hex,
            c.description,
            str(c.bytes or ""),
            *([chips] if several else []),
            meaning,
            by,
            c.evidence,
        ]
        lines.append("| " + " | ".join(cells) + " |")
    used = {c.evidence for c in commands}
    return "\n".join([*lines, "", "Evidence: " + ", ".join(f"{k} {v}" for k, v in EVIDENCE.items() if k in used) + "."])


def renew_tables(text: str, tests: Tests) -> str:
    """Return the page with its tables computed again.

    Args:
        text: Text of the page.
        tests: Tests of each command, as `count_covering_tests` returns them.
    """

    def block(m: re.Match[str]) -> str:
        return f"{m[1]}{format_table([MAPS[chip] for chip in m['chips'].split()], tests)}\n{m[3]}"

    return BLOCK.sub(block, text)


def main() -> int:
    text = PAGE.read_text()
    new = renew_tables(text, count_covering_tests(ROOT / "tests"))
    if "--check" in sys.argv[1:]:
        print(f"{PAGE.name} is {'up to date' if new == text else 'out of date: run python scripts/command_table.py'}")
        return int(new != text)
    PAGE.write_text(new)
    print(f"{PAGE.name} written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
