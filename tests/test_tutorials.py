"""Each tutorial is followed word for word: its files written, its commands typed, its Python run, what it prints compared."""

import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from support.pages import choose_tolerance, get_exit_code, is_printed, steps

from stage.cli import main
from stage.targets import supported_processors

PAGES = sorted((Path(__file__).resolve().parents[1] / "docs" / "tutorials").glob("*.md"))


def run_typed_command(command, capsys):
    words = shlex.split(command)
    if words[0] == "stage":
        assert main(words[1:]) == get_exit_code(command), command
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
    if "--mcu atmega" in page.read_text() and not supported_processors.has_simavr():
        pytest.skip(f"there is no {supported_processors.SIMAVR_REQUIREMENT}")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    names, output = {"__name__": "tutorial"}, ""
    for step in steps(page):
        if step.file:
            Path(step.file).write_text(step.text)
        elif step.kind == "python":
            Path("my.xml").unlink(missing_ok=True)
            exec(compile("\n" * step.line + step.text, page, "exec"), names)
            output = capsys.readouterr().out
        elif step.kind == "typed":
            output = "".join(run_typed_command(line.strip(), capsys) for line in step.text.splitlines())
        elif step.shows:
            where = f"{page.name}:{step.line}"
            assert is_printed(step.text, output, choose_tolerance(page)), f"{where} prints\n{output}"


def test_the_numbers_of_an_emulated_processor_are_those_of_the_page_to_the_last_digit():
    on_page = "    9.974281  <Idle|MPos:1.000|Rate:0>\n"
    output = "    9.974378  <Idle|MPos:1.000|Rate:0>\nran for 10 s, in 0.7 s of wall time\n"
    assert is_printed(on_page, output, 0.002)
    assert not is_printed(on_page, output, 0.0)
    assert is_printed("...\nran for 10 s, in 0.40 s of wall time\n", output, 0.0)
    assert choose_tolerance(next(page for page in PAGES if page.stem == "grbl")) == 0
