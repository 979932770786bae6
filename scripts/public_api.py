"""Write docs/reference/public_api.txt, the list of all public names with their arguments: `make api`.

docs/public_api.md says which names are public: all of `__all__` of the modules "for everybody", and those in its tables.
Griffe reads their signatures and members from the sources. tests/test_public_api.py compares the list with them, and the imports
of packages/ with the list.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

try:
    import griffe
except ModuleNotFoundError:
    sys.exit("griffe is missing: pip install -e '.[dev]'")

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/public_api.md"
API = ROOT / "docs/reference/public_api.txt"


def load_package() -> griffe.Module:
    """Return the package as griffe sees its sources; envs/ is stage.envs."""
    loader = griffe.GriffeLoader(search_paths=[ROOT], allow_inspection=False)
    stage = loader.load("stage")
    stage.set_member("envs", loader.load("envs"))
    loader.resolve_aliases(external=False)
    return stage


def read_public_names(stage: griffe.Module, page: str) -> Iterator[str]:
    """Yield the whole name of everything that the page promises.

    Raises:
        SystemExit: The page names a module or a name that does not exist.
    """
    sentence = page.partition("All names in `__all__` of")[2].partition("the attributes")[0]
    for module in re.findall(r"`(stage[\w.]*)`", sentence):
        yield module
        target = find(stage, module)
        exports = [str(name) for name in target.exports or ()] or [
            name for name, member in target.members.items() if not name.startswith("_") and not member.is_alias
        ]
        yield from (f"{module}.{name}" for name in sorted(exports))
    for module, names in re.findall(r"^\| `(stage[\w.]*)` \| ((?:`\w+` ?)+)\|", page, re.MULTILINE):
        yield module
        yield from (f"{module}.{name}" for name in re.findall(r"\w+", names))


def find(stage: griffe.Module, name: str) -> griffe.Object:
    """Return the object of a whole name, through re-exports.

    Raises:
        SystemExit: There is no object of this name.
    """
    target = stage
    for part in name.split(".")[1:]:
        try:
            target = target.all_members[part]
            target = target.final_target if target.is_alias else target
        except griffe.AliasResolutionError as error:
            module, _, constant = error.alias.target_path.rpartition(".")
            target = find_constant(find(stage, module), constant)
        except KeyError:
            target = find_constant(target, part)
    return target


def find_constant(module: griffe.Object, name: str) -> griffe.Object:
    """Return a constant of a module that is one of several in its assignment, as in `A, B = range(2)`: griffe passes over those."""
    stored = (
        node.id
        for node in ast.walk(ast.parse(module.filepath.read_text()))
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    )
    if name not in stored:
        sys.exit(f"{PAGE.name} promises {module.path}.{name}, which does not exist.")
    return griffe.Attribute(name, parent=module)


def format_arguments(function: griffe.Function) -> str:
    """Return the parameters of a function with their defaults, as it is called."""
    parameters = [p for p in function.parameters if p.name not in ("self", "cls")]
    kinds, words, previous = griffe.ParameterKind, [], None
    for p in parameters:
        if previous is kinds.positional_only and p.kind is not previous:
            words.append("/")
        if p.kind is kinds.keyword_only and previous not in (p.kind, kinds.var_positional):
            words.append("*")
        stars = {kinds.var_positional: "*", kinds.var_keyword: "**"}.get(p.kind, "")
        words.append(f"{stars}{p.name}" + (f"={p.default}" if p.default is not None and not stars else ""))
        previous = p.kind
    return f"({', '.join(words)})"


def describe_members(target: griffe.Class) -> set[str]:
    """Return the line of each public member of a class, inherited ones included, after the name of the class."""
    members = {name: m.final_target if m.is_alias else m for name, m in target.all_members.items()}
    return {
        f".{name}" + (format_arguments(member) if member.is_function else "")
        for name, member in members.items()
        if not name.startswith("_") and not member.is_class and not member.is_module
    }


def describe(name: str, target: griffe.Object, public: set[str]) -> Iterator[str]:
    """Yield a line for an object, and one for each member of a class that its public base classes do not have in the same form."""
    if not target.is_class:
        yield name + (format_arguments(target) if target.is_function else "")
        return
    constructor = target.all_members.get("__init__")
    yield name + (format_arguments(constructor) if constructor is not None else "()")
    inherited = {line for base in target.mro() if base.path in public for line in describe_members(base)}
    yield from (name + line for line in sorted(describe_members(target) - inherited))


def list_api(stage: griffe.Module, page: str) -> list[str]:
    """Return the lines of the list. An object that has several public names is described at the first of them."""
    names = dict.fromkeys(read_public_names(stage, page))
    objects = {name: find(stage, name) for name in names}
    public = {target.path for target in objects.values()}
    lines, described = [], set()
    for name, target in objects.items():
        if target.path in described or target.is_module:
            lines.append(name)
        else:
            lines += describe(name, target, public)
        described.add(target.path)
    return lines


def write_list() -> None:
    """Write the list anew."""
    API.parent.mkdir(exist_ok=True)
    API.write_text("\n".join(list_api(load_package(), PAGE.read_text())) + "\n")


if __name__ == "__main__":
    write_list()
