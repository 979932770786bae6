"""Lines that say how to install PulseStage: pages, messages and programs use one command, which works in a checkout."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from stage.support import examples
from stage.support.extras import INSTALL_FORMAT, LIBRARIES, ExtraMissing, format_install_command, import_extra

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
USER_FILES = ("README.md", "docs", "stage", "envs", "scripts", "packages")


def read_user_texts():
    for name in USER_FILES:
        path = ROOT / name
        for file in [path] if path.is_file() else path.rglob("*"):
            if file.suffix in (".md", ".py", ".ipynb", ".yml") and not {"__pycache__", "build"} & set(file.parts):
                yield file.relative_to(ROOT), file.read_text(encoding="utf-8")


def test_no_page_and_no_message_installs_from_an_index_that_does_not_have_it():
    wrong_lines = [
        f"{file}: {match[0]}"
        for file, text in read_user_texts()
        for match in re.finditer(r"pip install [^\n]*?(?<![\w/-])pulsestage\b(?!\[build\])[^\n]*", text)
        if "-e ./pulsestage" not in match[0] and "-e './pulsestage" not in match[0]
    ]
    assert wrong_lines == []


def test_each_install_line_has_the_form_of_the_constant_and_names_existing_extras():
    form = re.escape(INSTALL_FORMAT).replace(re.escape("{}"), r"([\w,]+)")
    lines = [
        (file, m)
        for file, text in read_user_texts()
        for m in re.finditer(r"pip install (?:-e )?'\.\[[\w,]+[^\n]*", text)
    ]
    assert len(lines) > 20
    for file, match in lines:
        written = re.match(form, match[0])
        assert written, f"{file}: {match[0]}"
        assert set(written[1].split(",")) <= EXTRAS | {"EXTRA"}, f"{file}: {match[0]}"


def test_a_missing_library_and_an_example_say_the_same_command(monkeypatch):
    monkeypatch.setitem(LIBRARIES, "no_such_library", LIBRARIES["optuna"])
    with pytest.raises(ExtraMissing) as error:
        import_extra("no_such_library", "a study")
    assert str(error.value) == "a study needs Optuna: pip install -e '.[tune]' in a checkout of PulseStage."
    assert str(examples.REQUIREMENTS["sweep"]) == f"needs: {format_install_command('tune')}"


@pytest.mark.slow
def test_the_install_line_works_in_a_fresh_environment(tmp_path):
    subprocess.run(["python3", "-m", "venv", str(tmp_path / "venv")], check=True)
    pip = [str(tmp_path / "venv" / "bin" / "python"), "-m", "pip", "install", "-q"]
    subprocess.run([*pip, "-e", ".[plot]"], cwd=ROOT, check=True)
    program = "import pulsestage, stage; assert pulsestage.chips is stage.chips; print(pulsestage.__version__)"
    subprocess.run([str(tmp_path / "venv" / "bin" / "python"), "-c", program], cwd=tmp_path, check=True)
