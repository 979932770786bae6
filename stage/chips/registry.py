"""`Registry`: every chip by name, those of PulseStage and those that installed packages bring.

A package names its chips in its pyproject.toml, and then they are known wherever a chip is given by its name:

    [project.entry-points."pulsestage.chips"]
    ACME1000 = "acme_chips:ACME1000"

PulseStage's own are found first, and cost nothing. For any other name the metadata of the installed packages is read; a chip's
package is imported when that chip is asked for, and no sooner.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, MutableMapping
from dataclasses import dataclass
from glob import escape, glob
from importlib import import_module
from os.path import join
from typing import Any

from stage.chips import contract
from stage.chips.chip import Chip
from stage.errors import ArgumentError, LoadError, StageError, UnknownKey, unknown

GROUP = "pulsestage.chips"
"""The entry points of a package that name chips."""
OWN = "pulsestage"


@dataclass(frozen=True)
class Source:
    """Where a chip comes from. name: as it is written there; package: with its version; where: "module:Class"."""

    name: str
    package: str
    where: str

    def __str__(self) -> str:
        return f"package {self.package} ({self.name} = {self.where!r})"


@dataclass(frozen=True)
class Listed:
    """A line of a list of chips. chip: None where it cannot be had, and `problem` says why."""

    name: str
    package: str
    chip: type[Chip] | None
    problem: str = ""


def key(name: str) -> str:
    """The name of a chip as the registry has it: any case, with or without hyphens."""
    return name.upper().replace("-", "").replace("_", "")


class Registry(MutableMapping[str, type[Chip]]):
    """Chip classes by name: `families`, of each package below `home` the classes, and those that installed packages bring.

    Iteration gives every name, also those that cannot be loaded; `listed` says which these are.
    """

    def __init__(self, families: Mapping[str, tuple[str, ...]], home: str):
        self._own = {key(name): f"{home}.{family}:{name}" for family, names in families.items() for name in names}
        self._loaded: dict[str, type[Chip]] = {}
        self._told: set[str] = set()

    def __getitem__(self, name: str) -> type[Chip]:
        """Raises KeyError for a name that nobody brings, LoadError for a package that cannot be imported, ArgumentError for a class
        that is no chip and for a name that two packages bring."""
        if not isinstance(name, str):
            raise UnknownKey(f"{name!r} is no name of a chip: give a text, as 'PCL240K'.")
        name = key(name)
        found = self._loaded.get(name)
        if found is None:
            found = self._loaded[name] = self._load(name)
        return found

    def __contains__(self, name: object) -> bool:
        known = isinstance(name, str) and (key(name) in self._loaded or key(name) in self._own)
        return known or (isinstance(name, str) and key(name) in _brought())

    def __setitem__(self, name: str, chip: type[Chip]) -> None:
        self._loaded[key(name)] = chip

    def __delitem__(self, name: str) -> None:
        del self._loaded[key(name)]

    def clear(self) -> None:
        """Forget every class that was set or loaded. PulseStage's own chips and those of packages stay known."""
        self._loaded.clear()

    def popitem(self) -> tuple[str, type[Chip]]:
        """Remove and return the last class that was set or loaded. Raises UnknownKey where there is none."""
        try:
            return self._loaded.popitem()
        except KeyError:
            raise UnknownKey("no class of a chip was set or loaded: PulseStage's own chips stay.") from None

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*self._own, *_brought(), *self._loaded)))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    @property
    def own(self) -> tuple[str, ...]:
        """The names of PulseStage's own chips."""
        return tuple(self._own)

    def listed(self) -> list[Listed]:
        """Every chip, and of those that cannot be had, why; PulseStage's own first. Imports all packages that bring chips."""
        lines = [Listed(name, OWN, self[name]) for name in self._own]
        for name, sources in sorted(_brought().items()):
            packages = ", ".join(source.package for source in sources)
            try:
                if name in self._own:
                    raise ArgumentError(_stays(name, sources))
                lines.append(Listed(name, packages, self[name]))
            except StageError as error:
                lines.append(Listed(name, packages, None, str(error)))
        return lines

    def tell_of_claims(self, name: str) -> None:
        """Where a package brings a chip of one of PulseStage's own names, say once, on stderr, whose the name is."""
        name = key(name)
        if name not in self._own or name in self._told:
            return
        self._told.add(name)
        if not _may_be_claimed(name):
            return
        sources = _brought().get(name)
        if sources:
            print(f"PulseStage: {_stays(name, sources)}", file=sys.stderr, flush=True)

    def _load(self, name: str) -> type[Chip]:
        if name in self._own:
            module, _, attribute = self._own[name].partition(":")
            return getattr(import_module(module), attribute)
        if not (sources := _brought().get(name, [])):
            raise UnknownKey(str(unknown("chip", name, self)))
        if len(sources) > 1:
            raise ArgumentError(
                f"chip {name}: {' and '.join(map(str, sources))} bring a chip of this name. Uninstall one of them."
            )
        return _loaded(name, sources[0])


def _brought() -> dict[str, list[Source]]:
    """Name -> who brings a chip of this name, of the packages that are installed now."""
    from importlib.metadata import entry_points  # 50 ms of a start that mostly needs PulseStage's own chips only

    found: dict[str, list[Source]] = {}
    for point in entry_points(group=GROUP):
        package = f"{point.dist.name} {point.dist.version}" if point.dist is not None else "of unknown name"
        source = Source(point.name, package, point.value)
        sources = found.setdefault(key(point.name), [])
        if source not in sources:
            sources.append(source)
    return found


def _may_be_claimed(name: str) -> bool:
    """Whether an installed package that has chips names this one: a look at their files, some ms, where `_brought` takes 50."""
    for folder in sys.path:
        for info in (*glob(join(escape(folder), "*.dist-info")), *glob(join(escape(folder), "*.egg-info"))):
            try:
                with open(join(info, "entry_points.txt"), "rb") as file:
                    content = file.read()
                if GROUP.encode() in content and name in key(content.decode(errors="replace")):
                    return True
            except OSError:
                continue
    return False


def _stays(name: str, sources: list[Source]) -> str:
    others = " and ".join(source.package for source in sources)
    return f"{name} is one of PulseStage's own chips, and stays it, though {others} has one of this name: {_rename(sources)}"


def _loaded(name: str, source: Source) -> type[Chip]:
    """The class that an entry point names. Raises LoadError, ArgumentError."""
    module, _, attribute = source.where.partition("[")[0].partition(":")  # behind "[" are extras, which pip looks at
    try:
        found: Any = import_module(module.strip())
        for part in filter(None, attribute.strip().split(".")):
            found = getattr(found, part)
    except (Exception, SystemExit) as error:  # it is somebody else's code
        raise LoadError(
            f"chip {name} of {source} cannot be loaded: {type(error).__name__}: {error}. Every other chip works; mend that package "
            "or uninstall it."
        ) from error
    try:
        contract.check(found, Chip)
        if key(found.__name__) != name:
            raise ArgumentError(
                f"the class is called {found.__name__}. Recordings and reports name chips by their classes: {_rename([source])}"
            )
    except ArgumentError as error:
        raise ArgumentError(f"chip {name} of {source} is refused: {error}") from None
    return found


def _rename(sources: list[Source]) -> str:
    return f"give the entry point of {sources[0].package} another name, that of its class."
