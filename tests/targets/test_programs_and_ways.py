"""docs/targets.md: the table of programs and ways is of files that there are, of so many lines, and of tests that run them."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "targets.md").read_text()
FIRMWARE = ROOT / "scripts" / "firmware"
ROWS = re.findall(r"^\| `([\w/]+\.(?:c|ino))`[^|]*\| (\d+) \| ([^|]*)\|(.*)\| `([\w/]+\.py)` \|$", PAGE, re.M)


def test_all_programs_of_the_page_of_ports_are_in_it():
    available = {FIRMWARE / row[0] for row in ROWS}
    ports = {path for path in (FIRMWARE / "ports").rglob("*") if path.suffix in (".c", ".ino")}
    assert ports < available
    assert len(ROWS) == 9


@pytest.mark.parametrize(("program", "lines", "changes", "targets", "test"), ROWS, ids=[row[0] for row in ROWS])
def test_each_row_of_the_table_of_programs_holds(program, lines, changes, targets, test):
    source = FIRMWARE / program
    assert len(source.read_text().splitlines()) == int(lines)
    assert changes.startswith("0"), "no line is changed"
    for beside in re.findall(r"`(ports/[\w/.]+)`", changes):
        assert (FIRMWARE / beside).is_file()
    text = (ROOT / "tests" / test).read_text()
    assert source.stem in text or f'"{source.parent.name}"' in text
    shipped = {"ATmega2560": "avr.elf", "Cortex-M3": "m3.elf", "DOS": "com"}
    for target, cell in zip(shipped, targets.split("|"), strict=True):
        if cell.strip() == "0":  # such a program is kept with the tests
            assert (ROOT / "tests/targets/data" / f"{source.stem}.{shipped[target]}").is_file()
