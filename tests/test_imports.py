"""Imports go down the list of the layout, and never round in a circle: also those inside functions.

Not seen are modules that are named by texts: the drivers of chips (`Chip.DRIVER`), which firmware/ loads when a host wants one.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import stage

ROOT = Path(__file__).parents[1]
FOLDERS = {"stage": "stage", "envs": "stage.envs"}

LAYERS = (
    {"errors", "units"},
    {"support"},
    {"native"},
    {"chips"},
    {"drives"},
    {"models"},
    {"sim"},
    {"firmware"},
    {"recording"},
    {"board"},
    {"targets", "testing", "serve", "cli", "envs", "study", "tune", "panel", "agents"},
    {"__main__"},
)
"""From the bottom to the top: a module imports from its own layer and from those before."""

ALLOWED = {
    (
        "stage.sim.fleet",
        "stage.sim.gpu.fleet",
    ): 'Fleet makes a GpuFleet where device="cuda" is given, and loads it then: few have a GPU',
    (
        "stage.native.load",
        "stage.native.build",
    ): "a library that does not fit its sources is built, with tools that few have",
}
"""(who, whom) -> why. All of them inside functions."""

SHOWN_BY_STAGE = {**stage._LAZY, **stage._MODULES}


def modules() -> dict[str, Path]:
    """Every module of the package, and its file."""
    found = {}
    for folder, package in FOLDERS.items():
        for path in (ROOT / folder).rglob("*.py"):
            if folder != "stage" or path.relative_to(ROOT / folder).parts[0] not in ("envs", "models"):
                parts = [package, *path.relative_to(ROOT / folder).with_suffix("").parts]
                found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """All statements of a tree, and what holds some, but what only a type checker reads."""
    left = [tree]
    while left:
        for node in ast.iter_child_nodes(left.pop()):
            if isinstance(node, ast.expr) or (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)):
                continue
            yield node
            left.append(node)


def imported(source: str, known: dict[str, Path]) -> set[str]:
    """The modules of the package that a source imports. `from stage import Stage` is that of stage.sim.stage."""
    found = set()
    for node in nodes(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "imports are absolute"
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                shown = SHOWN_BY_STAGE.get(alias.name) if node.module == "stage" else None
                found.add(name if name in known else shown or node.module or "")
    return found & known.keys() - {"stage"}


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """The modules of which each imports the others, on whatever way."""

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        left = [start]
        while left:
            new = graph.get(left.pop(), set()) - seen
            seen |= new
            left += new
        return seen

    reach = {module: reached(module) for module in graph}
    rings = {frozenset({m, *(n for n in reach[m] if m in reach.get(n, ()))}) for m in graph if m in reach[m]}
    return sorted(sorted(ring) for ring in rings)


@pytest.fixture(scope="module")
def graph():
    known = modules()
    return {module: imported(path.read_text(), known) - {module} for module, path in known.items()}


def layer(module: str) -> int:
    part = module.split(".")[1]
    return next(k for k, parts in enumerate(LAYERS) if part in parts)


def test_imports_go_down_the_list_of_the_layout(graph):
    up = {
        (module, other)
        for module, others in graph.items()
        for other in others
        if module != "stage" and layer(other) > layer(module)
    }
    assert up - ALLOWED.keys() == set()


def test_no_module_imports_itself_on_a_way_round(graph):
    assert circles({m: {o for o in others if (m, o) not in ALLOWED} for m, others in graph.items()}) == []


def test_what_is_allowed_is_needed(graph):
    assert [pair for pair in ALLOWED if pair[1] not in graph[pair[0]]] == []


def test_circles_are_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": set(), "e": {"a"}}) == [["a", "b", "c"]]


def test_imports_inside_functions_and_by_the_face_of_the_package_are_found():
    known = modules()
    lazy = "def f():\n    from stage import Stage, board\n    import stage.support.files\n"
    assert imported(lazy, known) == {"stage.sim.stage", "stage.board", "stage.support.files"}
    typed = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from stage import board\n"
    assert imported(typed, known) == set()
