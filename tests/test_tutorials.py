"""Each tutorial is followed word for word: its files written, its commands typed, its Python run, what it prints compared."""

import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
from test_docs import agree

from stage.cli import main

PAGES = sorted((Path(__file__).resolve().parents[1] / "docs" / "tutorials").glob("*.md"))
FENCE = re.compile(r"^```(\w+)\n(.*?)^```\n|^((?: {4}[^\n]+\n)+)", re.M | re.S)


class Step(NamedTuple):
    """A piece of a page: what it is (python, c, text, typed), its content, its line."""

    kind: str
    text: str
    line: int


def steps(page):
    text = page.read_text()
    return [Step(m[1] or "typed", m[2] or m[3], text[: m.start()].count("\n") + 1) for m in FENCE.finditer(text)]


def typed(command, capsys):
    words = shlex.split(command)
    if words[0] == "stage":
        assert main(words[1:]) == 0, command
        return capsys.readouterr().out
    assert words[0] in ("pytest", "pip"), command
    if words[0] == "pip":
        return ""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *words[1:]],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_tutorial_that_is_followed_word_for_word_does_what_it_says(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    names, said = {"__name__": "tutorial"}, ""
    for step in steps(page):
        name = re.match(r"(?:/\* |# )(\w+\.\w+)", step.text)
        if step.kind in ("python", "c") and name:
            Path(name[1]).write_text(step.text)
        elif step.kind == "python":
            Path("my.xml").unlink(missing_ok=True)
            exec(compile("\n" * step.line + step.text, page, "exec"), names)
            said = capsys.readouterr().out
        elif step.kind == "typed":
            said = "".join(typed(line.strip(), capsys) for line in step.text.splitlines())
        elif step.kind == "text" and not step.text.startswith("E "):
            where = f"{page.name}:{step.line}"
            assert agree("\n".join(said.splitlines()[: len(step.text.splitlines())]), step.text), (
                f"{where} prints\n{said}"
            )
