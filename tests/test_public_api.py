"""docs/public_api.md and docs/reference/public_api.txt are the public API: packages of the checkout are built on nothing else."""

import ast
import sys
from pathlib import Path

import pytest

pytest.importorskip("griffe", reason="extra dev is not installed")
ROOT = Path(__file__).parents[1]
API = (ROOT / "docs/reference/public_api.txt").read_text().splitlines()
PUBLIC = {line.partition("(")[0] for line in API}
SOURCES = sorted(
    file for package in ROOT.glob("packages/*") for file in package.rglob("*.py") if "tests" not in file.parts
)


@pytest.fixture(scope="module")
def public_api():
    sys.path.insert(0, str(ROOT))
    try:
        from scripts import public_api
    finally:
        sys.path.remove(str(ROOT))
    return public_api


@pytest.fixture(scope="module")
def package(public_api):
    return public_api.load_package()


def test_the_list_has_every_public_name_with_its_arguments(public_api, package):
    """If you meant the change: `make api`, and a line in CHANGELOG.md for what is renamed, removed or has another default."""
    assert public_api.list_api(package, public_api.PAGE.read_text()) == API


def test_a_promised_name_that_does_not_exist_is_an_error(public_api, package):
    page = public_api.PAGE.read_text() + "\n| `stage.chips.chip` | `Chips` | |\n"
    with pytest.raises(SystemExit, match=r"promises stage\.chips\.chip\.Chips, which does not exist"):
        public_api.list_api(package, page)


def find_private_imports(source):
    """Return what a source imports from PulseStage that the list does not have."""
    return [
        f"{node.module}.{alias.name}"
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "stage"
        for alias in node.names
        if alias.name != "*" and f"{node.module}.{alias.name}" not in PUBLIC
    ]


@pytest.mark.parametrize("file", SOURCES, ids=lambda file: "/".join(file.relative_to(ROOT / "packages").parts))
def test_a_package_uses_public_names_alone(file):
    assert find_private_imports(file.read_text()) == []


def test_a_private_import_is_reported():
    source = "from stage import Stage\ndef f():\n    from stage.sim.engine import run\n"
    assert find_private_imports(source) == ["stage.sim.engine.run"]
