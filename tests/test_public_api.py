"""docs/public_api.md is the public API: its names exist, and the packages of the checkout are built on nothing else."""

import ast
import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "public_api.md").read_text()
ROWS = re.findall(r"^\| `(stage[\w.]*)` \| ((?:`\w+` ?)+)\|", PAGE, re.M)
LISTED = {(module, name) for module, names in ROWS for name in re.findall(r"\w+", names)}
FOR_EVERYBODY = re.findall(
    r"`(stage[\w.]*)`", PAGE.partition("All names in `__all__` of")[2].partition("the attributes")[0]
)
SOURCES = sorted(
    file for package in ROOT.glob("packages/*") for file in package.rglob("*.py") if "tests" not in file.parts
)


def imported(source: str) -> set[tuple[str, str]]:
    """Return (module, name) of everything that a source imports from PulseStage; of `from stage import envs` ("stage", "envs")."""
    return {
        (node.module or "", alias.name)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "stage"
        for alias in node.names
    }


def is_public(module: str, name: str) -> bool:
    if name == "*":
        return module in {m for m, _ in LISTED}
    whole = f"{module}.{name}"  # a module that is listed itself
    return (
        (module, name) in LISTED
        or whole in {m for m, _ in LISTED} | set(FOR_EVERYBODY)
        or (module in FOR_EVERYBODY and name in getattr(import_module(module), "__all__", vars(import_module(module))))
    )


@pytest.mark.parametrize("module", dict.fromkeys(module for module, _ in ROWS))
def test_every_name_of_the_page_is_there(module):
    if module == "stage.envs.sb3":
        pytest.importorskip("stable_baselines3", reason="extra rl is not installed")
    if module == "stage.native.packing":
        pytest.importorskip("setuptools", minversion="80")
    assert [name for m, name in sorted(LISTED) if m == module and not hasattr(import_module(module), name)] == []


@pytest.mark.parametrize("module", FOR_EVERYBODY)
def test_every_module_for_everybody_says_what_is_public(module):
    assert import_module(module)


@pytest.mark.parametrize("file", SOURCES, ids=lambda file: "/".join(file.relative_to(ROOT / "packages").parts))
def test_a_package_uses_public_names_alone(file):
    assert [f"{m}.{n}" for m, n in sorted(imported(file.read_text())) if not is_public(m, n)] == []


def test_a_private_import_is_found():
    found = imported("from stage import Stage\ndef f():\n    from stage.sim.engine import run\n")
    assert found == {("stage", "Stage"), ("stage.sim.engine", "run")}
    assert is_public("stage", "Stage")
    assert not is_public("stage.sim.engine", "run")
    assert not is_public("stage.envs.base", "StageSpaces")
