"""Tests that the examples in README.md and docs/ of this package work, as tests/test_docs.py does for the core."""

import importlib
import re
import shlex
from pathlib import Path

import pytest
import test_docs

from stage.cli import main

HOME = Path(__file__).parents[1]
PAGES = [HOME / "README.md", *sorted((HOME / "docs").glob("*.md"))]
by_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=[pytest.mark.slow] * (page.stem == "benchmark")) for page in PAGES],
    ids=lambda p: p.stem,
)
def test_python_blocks_run_and_print_what_the_page_says(page, tmp_path, monkeypatch, capsys):
    test_docs.test_python_blocks_run_and_print_what_the_page_says(page, tmp_path, monkeypatch, capsys)


@by_page
def test_commands_that_a_page_names_exist_with_their_options(page):
    test_docs.check_commands(page, packages=True)


@by_page
def test_files_and_links_that_a_page_names_exist(page):
    test_docs.test_files_and_links_that_a_page_names_exist(page)


@by_page
def test_programs_that_a_page_names_exist_with_their_options(page):
    for program, arguments in re.findall(r"python -m (registerbench[\w.]+)([^`#\n]*)", page.read_text()):
        folder = Path(importlib.util.find_spec(program).origin).parent
        source = "".join(path.read_text() for path in folder.glob("*.py"))
        for option in re.findall(r"--[\w-]+", arguments):
            assert f'"{option}"' in source, f"{program} has no {option}"


def test_commands_of_the_readme_run(tmp_path, monkeypatch, capsys):
    """The commands are those of its shell block, with two episodes where all would take too long."""
    monkeypatch.chdir(tmp_path)
    block = re.search(r"```sh\n(.*?)```", PAGES[0].read_text(), re.S)[1]
    for line in block.splitlines():
        words = shlex.split(line.partition("#")[0])[1:]
        more = {"bench-submit": ["--episodes", "2"], "agent": ["--episodes", "2"]}.get(words[0], [])
        code = main([*words, *more])
        assert code == (2 if words[0] == "bench-table" else 0), line  # a part of the episodes can stand in no table
