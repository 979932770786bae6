"""Parts that installed packages supply: chips, power stages and commands, by the entry points of their pyproject.toml.

The metadata of all packages is read only when a part is requested that PulseStage itself does not have, and a package is imported
only when its own part is requested.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stage.errors import ArgumentError, LoadError


@dataclass(frozen=True)
class PackageEntryPoint:
    """Entry point of an installed package.

    Attributes:
        name: Name of the entry point.
        package: Name and version of the package.
        where: Location of the object, "module:object".
    """

    name: str
    package: str
    where: str

    def __str__(self) -> str:
        return f"package {self.package} ({self.name} = {self.where!r})"


def find_entry_points(group: str, normalize: Callable[[str], str]) -> dict[str, list[PackageEntryPoint]]:
    """Find the entry points of a group in all installed packages.

    Args:
        group: Name of the group, for example "pulsestage.chips".
        normalize: Function that returns the form in which names are compared.

    Returns:
        Parts by normalized name; more than one part if packages have the same name for different ones. A package that is installed
        twice counts once.
    """
    from importlib.metadata import entry_points  # takes 50 ms, and most commands need only what PulseStage brings

    parts: dict[str, list[PackageEntryPoint]] = {}
    for point in entry_points(group=group):
        package = f"{point.dist.name} {point.dist.version}" if point.dist is not None else "of unknown name"
        part = PackageEntryPoint(point.name, package, point.value)
        if part not in parts.setdefault(normalize(point.name), []):
            parts[normalize(point.name)].append(part)
    return parts


def may_have_entry_point(group: str, name: str, normalize: Callable[[str], str]) -> bool:
    """Return whether an installed package may bring a part of a name.

    The function only searches the text of the entry-point files, which takes a few ms; `find_entry_points` parses them in 50 ms.

    Args:
        group: Name of the group.
        name: Normalized name of the part.
        normalize: Function that returns the form in which names are compared.
    """
    for folder in sys.path:
        for path in Path(folder).glob("*.*-info/entry_points.txt"):
            try:
                content = path.read_bytes()
                if group.encode() in content and name in normalize(content.decode(errors="replace")):
                    return True
            except OSError:
                continue
    return False


def load_entry_point(
    kind: str, name: str, parts: Sequence[PackageEntryPoint], use: Callable[[Any], Any] | None = None
) -> Any:
    """Import the package that supplies a part, and return the object of the part.

    Args:
        kind: Word for parts of this group, for errors.
        name: Normalized name of the part.
        parts: All parts of this name.
        use: Function that is called with the object at once; its errors count as failures of the package.

    Raises:
        ArgumentError: Two packages supply a part of this name.
        LoadError: The package cannot be imported or has no such object, or `use` fails.
    """
    from importlib.metadata import EntryPoint

    if len(parts) > 1:
        packages = " and ".join(map(str, parts))
        raise ArgumentError(f"{kind} {name}: {packages} bring a {kind} of this name. Uninstall one of them.")
    try:
        loaded = EntryPoint(parts[0].name, parts[0].where, "").load()
        if use is not None:
            use(loaded)
    except (Exception, SystemExit) as error:  # the code of another maker may raise anything
        raise LoadError(
            f"{kind} {name} of {parts[0]} cannot be loaded: {type(error).__name__}: {error}. Repair or uninstall that package; "
            f"every other {kind} works."
        ) from error
    return loaded
