"""The programs of docs/bugs_found.md print the text of the page, and the page shows their code."""

import re
import shlex
from pathlib import Path

import pytest
from support.pages import agree

from stage.cli import main

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "bugs_found.md").read_text()
STORIES = re.findall(r"```sh\nstage (.*?)\n```\n\n```text\n(.*?)```", PAGE, re.S)


@pytest.mark.parametrize(
    ("command", "expected_output"),
    [pytest.param(*story, marks=pytest.mark.slow) if "MENDED" in story[0] else story for story in STORIES],
    ids=lambda value: re.sub(r".*/(\w+)\.c.*?(MENDED)?$", r"\1\2", value) if "/" in value else "",
)
def test_each_story_prints_the_text_of_the_page(command, expected_output, firmware, tmp_path, monkeypatch, capsys):
    words = [str(ROOT / word) if word.startswith("scripts/") else word for word in shlex.split(command)]
    monkeypatch.chdir(tmp_path)
    is_repaired = "MENDED" in command
    flags = "-std=c99 -Wall -Wextra -pedantic -Werror" + (" -DMENDED" if is_repaired else "")
    words = [word for word in words if not word.startswith("--cflags")]
    code = main([*words, "--in-process", f"--cflags={flags}"])
    printed_text = capsys.readouterr()
    printed = re.sub(r", in \S+ s of wall time", "", printed_text.out) + printed_text.err + Path("out.txt").read_text()
    for line in expected_output.splitlines():
        assert any(agree(other, line) for other in printed.splitlines()), f"{line}\nis not in\n{printed}"
    failed = {
        "rate_too_wide": is_repaired,
        "speed_never_set": not is_repaired,
        "wrong_command": not is_repaired,
        "no_axis_bits": False,
    }
    assert code == failed[Path(words[1]).stem]
    kind = "mistakes" in printed
    assert kind is not is_repaired


def test_the_page_shows_the_code_of_all_four_stories():
    assert len(STORIES) == 8
    programs = [
        re.sub(r"\s+", " ", path.read_text()) for path in (ROOT / "scripts" / "firmware" / "stories").glob("*.c")
    ]
    blocks = re.findall(r"```c\n(.*?)```", PAGE, re.S)
    assert len(blocks) == 5
    for block in blocks:
        assert any(all(re.sub(r"\s+", " ", line) in text for line in block.splitlines()) for text in programs), block
