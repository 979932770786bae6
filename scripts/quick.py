"""Run the tests that stand nearest to a change, for at most a given time: `make quick`.

A change is every file that differs from a commit (by default from where this branch left origin/main), and every new file. The
imports of the checkout, read from the sources, say which test files reach it. Those come first that reach it over the fewest
imports; of those, the ones that reach the fewest modules in all, since they test little else. No test begins after `--seconds`, so
a change in a module that everything uses runs its closest tests; `make test` runs the rest.

Coverage cannot make this choice: most of stage/chips, stage/drives and stage/sim is compiled, and leaves no trace in Python.
"""

import argparse
import functools
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = {"stage": ROOT / "stage", "stage.envs": ROOT / "envs", "": ROOT / "tests"}
"""Where modules lie: the names in front of theirs, and their folder."""
PAGES = ROOT / "tests/test_docs.py"
MAX_FILES = 40
DEADLINE = "PULSESTAGE_DEADLINE"

DOCSTRING = re.compile(r'\A"""[\s\S]*?"""')
FOR_TYPE_CHECKERS = re.compile(r"^if TYPE_CHECKING:\n(?:[ \t]+.*\n|\n)+", re.MULTILINE)
FROM = re.compile(r"^[ \t]*from ([\w.]+) import (\([^)]*\)|[^\n#]*)", re.MULTILINE)
IMPORT = re.compile(r"^[ \t]*import ([\w., ]+)", re.MULTILINE)
NAMED = re.compile(r"[\"'](\w+(?:\.\w+)+|[\w.]+(?=:\w))(?::\w+)?[\"']")
"""Texts that may name a module: "stage.sim.stage", "moves:move"."""


def find_modules() -> dict[str, Path]:
    """Return every module of the checkout by its name."""
    modules = {}
    for package, folder in PACKAGES.items():
        for path in folder.rglob("*.py"):
            parts = [*package.split("."), *path.relative_to(folder).with_suffix("").parts]
            modules[".".join(part for part in parts if part and part != "__init__")] = path
    return modules


class Imports:
    """The import graph of the checkout.

    A name that a package takes from one of its modules is an import of that module. What a package lists for type checkers or
    for lazy loading is no import of its own.
    """

    def __init__(self) -> None:
        self.modules = find_modules()
        self.texts = {path: DOCSTRING.sub("", path.read_text()) for path in self.modules.values()}
        self.imported = {path: self._find_imports(name, path) for name, path in self.modules.items()}

    @functools.cache  # noqa: B019 - one graph a process
    def measure_distances(self, path: Path) -> dict[Path, int]:
        """Return every file that a file reaches, and over how many imports."""
        distances, front = {path: 0}, [path]
        for file in front:
            for target in self.imported[file] - distances.keys():
                distances[target] = distances[file] + 1
                front.append(target)
        return distances

    def _find_imports(self, module: str, path: Path) -> set[Path]:
        """Return the files that a file imports, in functions, too, or names in a text."""
        is_package = path.name == "__init__.py"
        text = FOR_TYPE_CHECKERS.sub("", self.texts[path])
        imports = {name.strip() for names in IMPORT.findall(text) for name in names.split(",")}
        for package, names in FROM.findall(text):
            imports.add(package)
            imports.update(self._find_definition(package, name) for name in re.findall(r"\w+(?: as \w+)?", names))
        if not is_package:
            parents = ["", *(module.rsplit(".", up)[0] + "." for up in range(1, module.count(".") + 1))]
            imports.update(parent + name for name in NAMED.findall(text) for parent in parents)
        files = {self.modules[name] for name in imports if name in self.modules}
        if path.name.startswith("test_") and path.parent != ROOT / "tests":
            files.update(path.parent.glob("conftest.py"))
        return files

    def _find_definition(self, module: str, name: str) -> str:
        """Return the module that `from module import name` takes the name from. Only packages show names of other modules."""
        name = name.partition(" as ")[0]
        if f"{module}.{name}" in self.modules or module not in self.modules:
            return f"{module}.{name}"
        for origin, names in self._find_names(module):
            if name in names and origin != module:
                return self._find_definition(origin, names[name])
        return module

    @functools.cache  # noqa: B019 - one graph a process
    def _find_names(self, module: str) -> list[tuple[str, dict[str, str]]]:
        """Return what a module takes from others: their names, and by its own name the one that each thing has there."""
        imports = []
        if self.modules[module].name != "__init__.py":
            return imports
        for origin, names in FROM.findall(self.texts[self.modules[module]]):
            pairs = re.findall(r"(\w+)(?: as (\w+))?", names)
            imports.append((origin, {new or old: old for old, new in pairs}))
        return imports


def find_changes(since: str | None) -> set[Path]:
    """Return the files that differ from a commit, and those that git does not know yet."""

    def git(*args: str) -> list[str]:
        return subprocess.run(
            ["git", *args], cwd=ROOT, capture_output=True, encoding="utf-8", errors="surrogateescape"
        ).stdout.split("\n")[:-1]

    commit = since or next(iter(git("merge-base", "HEAD", "origin/main")), "HEAD")
    return {
        ROOT / file for file in git("diff", "--name-only", commit) + git("ls-files", "--others", "--exclude-standard")
    }


def select_tests(changes: set[Path], graph: Imports) -> list[Path]:
    """Return the test files that reach a change, the nearest first.

    Pages are read by their own test. Any other file that is no module counts as a change of the modules that name it.
    """
    pages = {path for path in changes if path.suffix == ".md"}
    others = [path.name for path in changes - pages if path not in graph.texts]
    changed = changes & graph.texts.keys() | ({PAGES} if pages else set())
    changed |= {path for path, text in graph.texts.items() if any(name in text for name in others)}
    ranks = {}
    for test in graph.texts:
        if test.name.startswith("test_"):
            distances = graph.measure_distances(test)
            if reached := changed & distances.keys():
                ranks[test] = (min(map(distances.__getitem__, reached)), len(distances), str(test))
    return sorted(ranks, key=ranks.__getitem__)


def pytest_collection_modifyitems(session: pytest.Session, items: list[pytest.Item]) -> None:
    """Keep the order of the files on the command line."""
    order = {argument: place for place, argument in enumerate(session.config.args)}
    items.sort(key=lambda item: order[str(item.path)])


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> bool | None:
    """Leave a test out whose turn comes after the deadline."""
    return True if time.time() > float(os.environ[DEADLINE]) else None


def main() -> int:
    """Choose test files and run them with pytest on two cores."""
    started = time.time()
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("files", nargs="*", type=Path, help="the changed files, in place of those that git knows of")
    parser.add_argument("--since", metavar="COMMIT", help="what the change is measured from")
    parser.add_argument("--seconds", type=float, default=15.0, help="no test begins later; default: %(default)s")
    parser.add_argument("--list", action="store_true", help="name the test files that reach the change, and run none")
    args = parser.parse_args()
    changes = {path.resolve() for path in args.files} or find_changes(args.since)
    tests = select_tests(changes, Imports())
    if args.list or not tests:
        print(
            *(test.relative_to(ROOT) for test in tests),
            f"{len(tests)} test files reach {len(changes)} changes.",
            sep="\n",
        )
        return 0
    os.environ[DEADLINE] = str(started + args.seconds)
    print(
        f"{len(changes)} changes, which {len(tests)} test files reach; the nearest {min(MAX_FILES, len(tests))}:",
        flush=True,
    )
    command = [
        "-p",
        "scripts.quick",
        "-n",
        "2",
        "--dist",
        "loadfile",
        "--no-loadscope-reorder",
        *map(str, tests[:MAX_FILES]),
    ]
    return subprocess.run([sys.executable, "-m", "pytest", *command], cwd=ROOT).returncode


if __name__ == "__main__":
    sys.exit(main())
