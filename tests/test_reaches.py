"""A name with an underscore is its module's own: what others need of it has a name without one, and a docstring."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = sorted(
    path
    for folder in ("stage", "envs", "packages")
    for path in (ROOT / folder).rglob("*.py")
    if "tests" not in path.parts
)

OF_OTHERS = {
    "_replace", "_make", "_asdict", "_fields", "_fields_",  # of named tuples and of ctypes' structures
    "_address",  # of MuJoCo's models and data: where they lie
    "_exit",  # of os
    "_current_frames", "_getframe",  # of sys
    "_repr_mimebundle_",  # what Jupyter asks an object for
    "_handle", "_mmap", "_uch",  # what C calls a library of ctypes, a memory map of NumPy, an engine of Unicorn
}  # fmt: skip
"""Names that the libraries which have them show to everybody."""

INSIDE_NUMBA = {
    "stage/native/emit.py",
    "stage/native/passes.py",
    "stage/native/typed.py",
    "stage/sim/gpu/device_code.py",
}
"""Objects for a baseline processor, and arrays at an address on a GPU, are nothing that numba offers."""

REACH = re.compile(r"(?<!\bself)(?<!\bcls)(?<!\bsuper\(\))\s*\.\s*_(?!_)")
"""Sources without it need not be parsed."""


def is_own(node: ast.expr, *names: str) -> bool:
    """It is one of these names, or a call of it without arguments."""
    if isinstance(node, ast.Call) and not node.args:
        node = node.func
    return isinstance(node, ast.Name) and node.id in names


def reaches(source: str) -> list[str]:
    """Attributes with an underscore, of another object than `self`, that nothing in this source has itself."""
    if not REACH.search(source):
        return []
    nodes = list(ast.walk(ast.parse(source)))
    own = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    own |= {
        node.attr
        for node in nodes
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and is_own(node.value, "self")
    }
    return [
        f"line {node.lineno}: {ast.unparse(node)}"
        for node in nodes
        if isinstance(node, ast.Attribute)
        and node.attr.startswith("_")
        and not node.attr.startswith("__")
        and node.attr not in own | OF_OTHERS
        and not is_own(node.value, "self", "cls", "super")
    ]


def taken(source: str) -> list[str]:
    """Names with an underscore that a source imports out of a module of ours."""
    return [
        f"line {node.lineno}: {a.name} of {node.module}"
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in ("stage", "envs")
        for a in node.names
        if a.name.startswith("_") and not a.name.startswith("__") and a.name != "_native"
    ]  # fmt: skip


def test_no_module_imports_what_is_another_ones_own():
    """from stage.envs.base import _one"""
    assert taken("from stage.envs.base import _one, two") == ["line 1: _one of stage.envs.base"]
    found = {str(path.relative_to(ROOT)): taken(path.read_text()) for path in SOURCES}
    assert {name: lines for name, lines in found.items() if lines} == {}


def test_no_module_reaches_into_what_is_another_ones_own():
    found = {str(path.relative_to(ROOT)): reaches(path.read_text()) for path in SOURCES}
    assert {name: lines for name, lines in found.items() if lines and name not in INSIDE_NUMBA} == {}


def test_reaches_are_found():
    found = reaches(
        "class A:\n    def f(self, a, stage):\n        self._b = 1\n        return a._b + stage._now + stage.x._y"
    )
    assert sorted(found) == ["line 4: stage._now", "line 4: stage.x._y"]
