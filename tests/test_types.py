"""A user's program with every public face passes strict type checkers, and runs."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parent / "typed" / "user_program.py"
ROOT = Path(__file__).parents[1]


def test_the_program_runs(tmp_path):
    spec = importlib.util.spec_from_file_location("user_program", PROGRAM)
    program = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(program)
    program.main(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("checker", "options"), [("mypy", ["--strict", "--follow-imports=silent", "--config-file="]), ("pyright", [])]
)
def test_a_strict_checker_takes_it_without_a_word(checker, options, tmp_path):
    """mypy --strict user_program.py; pyright user_program.py"""
    pytest.importorskip(checker)
    checker_options = {
        "mypy": ["--ignore-missing-imports", "--cache-dir", str(tmp_path)],
        "pyright": ["--pythonpath", sys.executable],
    }
    options = [*options, *checker_options[checker]]
    command = [sys.executable, "-m", checker, *options, str(PROGRAM)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
