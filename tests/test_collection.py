"""Every choice of test folders runs in one session, in a fresh checkout, and says at its end what it has not tested."""

import ast
import os
import re
import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path

import pytest

from stage.support.extras import LIBRARIES

ROOT = Path(__file__).parents[1]
FOLDERS = [ROOT / "tests", ROOT / "scripts/acme_chip/tests", *sorted(ROOT.glob("packages/*/tests"))]
FILES = [path for folder in FOLDERS for path in sorted(folder.rglob("*.py"))]


def run_pytest(*arguments: str, **environment: str) -> str:
    """Run pytest with this project's settings in a process of its own and return what it prints."""
    command = [sys.executable, "-m", "pytest", "-c", str(ROOT / "pyproject.toml"), "-p", "no:cacheprovider", *arguments]
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    return subprocess.run(command, capture_output=True, text=True, check=False, env=inherited | environment).stdout


def test_no_test_imports_a_conftest_by_its_name():
    """Several folders have one, and Python keeps the first that is imported: what tests share lies in tests/support."""
    named = [path for path in FILES if re.search(r"^\s*(from|import) conftest", path.read_text(), re.M)]
    importing = [
        path.relative_to(ROOT)
        for path in named
        for node in ast.walk(ast.parse(path.read_text()))
        if (isinstance(node, ast.ImportFrom) and node.module == "conftest")
        or (isinstance(node, ast.Import) and "conftest" in [alias.name for alias in node.names])
    ]
    assert not importing


def test_modules_of_test_folders_that_are_no_packages_have_unique_names():
    """pytest imports such a module by its file's name alone, and refuses a second one of that name."""
    names = Counter(
        path.stem for path in FILES if path.stem != "conftest" and not (path.parent / "__init__.py").exists()
    )
    assert not [name for name, count in names.items() if count > 1]


@pytest.fixture
def run_both_tests(tmp_path):
    """Return what pytest prints of a test that lacks simavr, and of one that sees whether the native library was loaded before."""
    (tmp_path / "test_rare.py").write_text(
        "import pytest\n\n@pytest.mark.skipif(True, reason='there is no simavr (Debian: apt install libsimavr2)')\n"
        "def test():\n    pass\n"
    )
    (tmp_path / "test_first.py").write_text(
        "from stage.native import COMPILED, library_loader\n\n"
        "def test():\n    assert library_loader._load_library.cache_info().currsize == COMPILED\n"
    )

    def run(required: str) -> str:
        environment = {"PYTHONPATH": str(ROOT / "tests"), "PULSESTAGE_REQUIRE": required}
        return run_pytest(f"--rootdir={tmp_path}", "-p", "conftest", str(tmp_path), **environment)

    return run


def test_what_is_skipped_is_listed_with_its_reason_and_the_native_library_is_loaded_before_the_first_test(
    run_both_tests,
):
    """A fresh checkout builds the library, and prints how far it is: not into what the first test captures."""
    printed = run_both_tests("gdb")
    assert re.search(r"^SKIPPED \[1\] \S*test_rare.py:3: there is no simavr", printed, re.M), printed
    assert re.search(r"^1 passed, 1 skipped", printed, re.M), printed


def test_a_test_that_lacks_what_this_machine_must_have_fails_instead_of_being_skipped(run_both_tests):
    """PULSESTAGE_REQUIRE=simavr,avr-gcc, where .ci/run has installed both"""
    printed = run_both_tests("simavr,avr-gcc")
    assert re.search(r"^1 passed, 1 error", printed, re.M), printed


def test_another_target_of_make_and_of_ci_runs_each_test_that_pytest_leaves_out_by_default(pytestconfig):
    conftest = pytestconfig.pluginmanager.get_plugin(str(ROOT / "tests/conftest.py"))
    left_out = {f"tests/{name}" for name in conftest.collect_ignore}
    makefile, ci = (ROOT / "Makefile").read_text(), (ROOT / ".ci/run").read_text()
    recipes = dict(re.findall(r"^(test-\w+): .*\n\t.* --dist worksteal (.*)", makefile, re.M))
    targets = ("test-firmware", "test-servers", "test-ioc")
    variables = {f"$({name})": files for name, files in re.findall(r"^(FIRMWARE|SERVERS) := (.*)", makefile, re.M)}
    assert {file for target in targets for file in variables.get(recipes[target], recipes[target]).split()} == left_out
    assert {"make test", *(f"make {target}" for target in targets)} <= set(ci.splitlines())
    assert all((ROOT / name).exists() for name in left_out)


def test_the_dev_extra_has_every_library_that_the_product_can_use():
    """`make test` installs that extra. Learners and browsers are only needed by tests; their skips are listed."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]

    def expand(extra: str) -> set[str]:
        inner = [
            name for need in extras[extra] if (m := re.match(r"pulsestage\[(.*)\]", need)) for name in m[1].split(",")
        ]
        return {extra}.union(*map(expand, inner))

    used = {library.extra for library in LIBRARIES.values()} - {"gpu"}  # of use only where a GPU is
    assert expand("dev") >= used | {"build", "targets"}
