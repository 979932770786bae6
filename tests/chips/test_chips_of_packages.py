"""Chips that packages bring: the core knows none of their names."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NAMES = re.compile(r"trinamic|tmc[0-9x]{2}|stallguard|stealthchop|spreadcycle|coolstep", re.IGNORECASE)
LISTS_OF_EXAMPLES = {"stage/support/examples.py"}
SOURCES = sorted(
    file.relative_to(ROOT).as_posix()
    for folder in ("stage", "envs")
    for file in (ROOT / folder).rglob("*")
    if file.suffix in {".py", ".h", ".hpp", ".c", ".cpp", ".json", ".xml"}
)


@pytest.mark.parametrize("folder", sorted({source.rpartition("/")[0] for source in SOURCES}))
def test_a_folder_of_the_core_names_no_chip_of_a_package(folder):
    files = [s for s in SOURCES if s.rpartition("/")[0] == folder and s not in LISTS_OF_EXAMPLES]
    named = {
        file: found.group() for file in files if (found := NAMES.search((ROOT / file).read_text(encoding="utf-8")))
    }
    assert named == {}
