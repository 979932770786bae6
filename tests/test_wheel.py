"""The wheel, as a user installs it, and what builds and tests it."""

import importlib.util
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT, PACKAGES = SETTINGS["project"], SETTINGS["tool"]["setuptools"]

MOVE = """
from stage import Stage, firmware

stage = Stage("xyz")
firmware.preset_move(stage.axes["x"], 8000).plot("move.png")
"""


ALIAS = """
import pulsestage

error: pulsestage.ArgumentError = pulsestage.errors.ArgumentError("text")
axis: pulsestage.Stage = pulsestage.Stage("xy").axes["x"]  # type: ignore[assignment]
"""


@pytest.mark.parametrize("library", ["mujoco", "rerun-sdk"])
def test_libraries_with_private_parts_in_use_have_an_upper_version_bound(library):
    # an installation on the day after rerun-sdk 0.42 comes out
    every = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["rerun"]]
    (needed,) = (need for need in every if re.match(rf"{library}\b", need))
    assert re.search(r">=[\d.]+,<[\d.]+", needed)


@pytest.mark.parametrize(
    "project",
    [".", "packages/registerbench", "packages/trinamic", "scripts/acme_chip"],
    ids=lambda path: Path(path).name,
)
def test_the_build_backend_that_a_project_names_is_a_module(project, monkeypatch):
    # a renamed module, and pip install -e . in a fresh checkout: cannot import build backend
    settings = tomllib.loads((ROOT / project / "pyproject.toml").read_text())
    classes = settings["tool"]["setuptools"].get("cmdclass", {}).values()
    for path in settings["build-system"].get("backend-path", ()):
        monkeypatch.syspath_prepend(ROOT / project / path)
    for name in (settings["build-system"]["build-backend"], *(name.rpartition(".")[0] for name in classes)):
        assert importlib.util.find_spec(name), name


@pytest.mark.parametrize("workflow", sorted((ROOT / ".github" / "workflows").glob("*.yml")), ids=lambda path: path.stem)
def test_a_workflow_takes_actions_by_their_commits_and_each_job_ends_some_time(workflow):
    # uses: actions/checkout@v5, a tag that its owner may move
    text = workflow.read_text()
    used = re.findall(r"uses: (.*)", text)
    assert used
    assert all(re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}  # v[\d.]+", action) for action in used)
    assert text.count("runs-on: ") == text.count("timeout-minutes: ") > 0
    assert "concurrency:" in text
    assert "permissions:\n  contents: read\n" in text


def test_the_libraries_for_reinforcement_learning_are_installed_every_night_and_their_tests_run():
    # tests/envs/test_libraries.py was skipped everywhere: neither make nor a workflow installed the extra
    (recipe,) = re.findall(r"^test-libraries:\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.M)
    assert "'.[test,libraries]' -e ./packages/registerbench" in recipe
    nightly = (ROOT / ".github" / "workflows" / "nightly.yml").read_text()
    assert "run: make test-libraries" in nightly
    (cleanrl,) = re.findall(r"repository: vwxyzjn/cleanrl, ref: ([0-9a-f]{40})", nightly)
    assert f"| CleanRL | {cleanrl[:7]} |" in (ROOT / "docs" / "rl_libraries.md").read_text()


def test_the_wheel_contains_every_file_of_the_packages():
    # a fresh installation; stage run sketch.ino: Arduino.h was not there
    assert PACKAGES["packages"]["find"]["include"] == ["stage", "stage.*"]
    package_folders = {file.parent.relative_to(ROOT) for file in (ROOT / "stage").rglob("__init__.py")}
    folders = {".".join(folder.parts): ROOT / folder for folder in package_folders}
    folders |= {name: ROOT / folder for name, folder in PACKAGES["package-dir"].items()}
    packaged = {file for folder in folders.values() for file in folder.glob("*.py")}
    packaged |= {
        f
        for name, patterns in PACKAGES["package-data"].items()
        for pattern in patterns
        for f in folders[name].glob(pattern)
    }
    source_files = {f for top in ("stage", "envs", "models") for f in (ROOT / top).rglob("*") if f.is_file()}
    built = {f for f in source_files if "__pycache__" in f.parts or f.name.startswith("_native.so")}
    assert {str(f.relative_to(ROOT)) for f in source_files - packaged - built} == set()


@pytest.mark.slow
def test_a_program_of_the_readme_passes_mypy_against_the_wheel(tmp_path):
    # an installation with mypy; mypy program.py, with firmware.preset_move(stage.axes["x"], 8000)
    pytest.importorskip("mypy")
    tree = tmp_path / "tree"
    for folder in ("stage", "envs", "models"):
        shutil.copytree(ROOT / folder, tree / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tree)
    pip = [sys.executable, "-m", "pip", "-q"]
    subprocess.run([*pip, "wheel", "--no-deps", "-w", str(tmp_path), str(tree)], check=True)
    (wheel,) = tmp_path.glob("pulsestage-*.whl")
    venv.create(tmp_path / "venv")
    site = Path(sysconfig.get_path("purelib", "venv", {"base": str(tmp_path / "venv")}))
    subprocess.run([*pip, "install", "--no-deps", "--target", str(site), str(wheel)], check=True)
    (site / "others.pth").write_text(sysconfig.get_path("purelib"))  # numpy and what else it needs
    texts = [MOVE, ALIAS, *re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)]
    programs = [tmp_path / f"program_{k}.py" for k in range(len(texts))]
    for program, text in zip(programs, texts, strict=True):
        program.write_text(text)
    python = tmp_path / "venv" / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--warn-unused-ignores",
        f"--python-executable={python}",
        "--cache-dir",
        str(tmp_path / "mypy"),
    ]
    done = subprocess.run([*command, *map(str, programs)], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
