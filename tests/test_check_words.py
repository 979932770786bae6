"""scripts/check_words.py: names and docstrings that `make lint` refuses."""

import importlib.util
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "scripts/check_words.py"


@pytest.fixture(scope="module")
def check_words():
    spec = importlib.util.spec_from_file_location("check_words", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("source", "lines"),
    [
        ("def told(): ...", [1]),
        ("class LateLint: ...", [1]),
        ("def move(distance, *given): ...", [1]),
        ("x = 1\nself.kept = SHORTEST = x", [2, 2]),
        ('def move():\n    """What moves."""', [1]),
        ('def move(distance):\n    """Move an axis."""\n    return untold + hold', []),
    ],
)
def test_weak_names_and_weak_openings_are_reported(check_words, source, lines):
    assert [line for line, _ in check_words.find_offenders(source)] == lines


def test_a_folder_with_more_of_them_than_before_fails_and_one_with_fewer_lowers_its_count(
    check_words, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(check_words, "ROOT", tmp_path)
    monkeypatch.setattr(check_words, "COUNTS", tmp_path / "counts.txt")
    monkeypatch.setattr("sys.argv", ["check_words.py"])
    (tmp_path / "envs").mkdir()
    (tmp_path / "envs/task.py").write_text("told = kept = 1\n")
    check_words.COUNTS.write_text("envs 1\n")
    assert check_words.main() == 1
    assert "envs/task.py:1: told" in capsys.readouterr().out
    (tmp_path / "envs/task.py").write_text("told = 1\n")
    check_words.COUNTS.write_text("envs 2\n")
    assert check_words.main() == 0
    monkeypatch.setattr("sys.argv", ["check_words.py", "--update"])
    assert check_words.main() == 0
    assert check_words.COUNTS.read_text() == "envs 1\n"
