"""Registry of all chips by name, those of PulseStage and those of installed packages.

A package names its chips in its pyproject.toml, and then they are known wherever a chip is given by its name:

    [project.entry-points."pulsestage.chips"]
    ACME1000 = "acme_chips:ACME1000"

PulseStage's own chips are found first, without a search. For any other name the metadata of the installed packages is read. The
package of a chip is imported when that chip is requested.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, MutableMapping
from dataclasses import dataclass
from importlib import import_module

from stage.chips import contract_check
from stage.chips.chip import Chip
from stage.errors import ArgumentError, StageError, UnknownKey, unknown_name_error
from stage.support.entry_points import PackageEntryPoint, find_entry_points, load_entry_point, may_have_entry_point

ENTRY_POINT_GROUP = "pulsestage.chips"
"""The entry points of a package that name chips."""
PACKAGE_NAME = "pulsestage"


@dataclass(frozen=True)
class ListedChip:
    """Entry of a list of all chips, such as `stage chips` prints.

    Attributes:
        name: Name of the chip.
        package: Package that brings it.
        chip: Its class; None if it cannot be loaded.
        problem: Reason why it cannot be loaded.
    """

    name: str
    package: str
    chip: type[Chip] | None
    problem: str = ""


def normalize_chip_name(name: str) -> str:
    """Convert a chip's name to the form of the registry: capitals, without hyphens."""
    return name.upper().replace("-", "").replace("_", "")


class Registry(MutableMapping[str, type[Chip]]):
    """Chip classes by name: PulseStage's own, and those of installed packages.

    Iteration yields every name, including chips that cannot be loaded; `list_chips` has the reason for each of these.

    Args:
        families: Package below `home` -> names of its classes.
        home: Package of PulseStage's own families.
    """

    def __init__(self, families: Mapping[str, tuple[str, ...]], home: str):
        self._families = {
            normalize_chip_name(name): f"{home}.{family}:{name}" for family, names in families.items() for name in names
        }
        self._loaded: dict[str, type[Chip]] = {}
        self._told: set[str] = set()

    def __getitem__(self, name: str) -> type[Chip]:
        """Return a chip's class.

        Args:
            name: Name of the chip.

        Raises:
            UnknownKey: No package brings this name.
            LoadError: The package cannot be imported.
            ArgumentError: The class is no chip, or two packages bring the name.
        """
        if not isinstance(name, str):
            raise UnknownKey(f"{name!r} is no name of a chip: give a text, as 'PCL240K'.")
        name = normalize_chip_name(name)
        chip = self._loaded.get(name)
        if chip is None:
            chip = self._loaded[name] = self._load(name)
        return chip

    def __contains__(self, name: object) -> bool:
        known = isinstance(name, str) and (
            normalize_chip_name(name) in self._loaded or normalize_chip_name(name) in self._families
        )
        return known or (isinstance(name, str) and normalize_chip_name(name) in _find_package_chips())

    def __setitem__(self, name: str, chip: type[Chip]) -> None:
        self._loaded[normalize_chip_name(name)] = chip

    def __delitem__(self, name: str) -> None:
        del self._loaded[normalize_chip_name(name)]

    def clear(self) -> None:
        """Forget every class that was set or loaded. PulseStage's own chips and those of packages stay known."""
        self._loaded.clear()

    def popitem(self) -> tuple[str, type[Chip]]:
        """Remove and return the last class that was set or loaded. Raises UnknownKey if there is none."""
        try:
            return self._loaded.popitem()
        except KeyError:
            raise UnknownKey("no class of a chip was set or loaded: PulseStage's own chips stay.") from None

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*self._families, *_find_package_chips(), *self._loaded)))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    @property
    def built_in(self) -> tuple[str, ...]:
        """Names of PulseStage's own chips."""
        return tuple(self._families)

    def list_chips(self) -> list[ListedChip]:
        """List every chip, PulseStage's own first, with the reason if it cannot be loaded. This imports all packages of chips."""
        lines = [ListedChip(name, PACKAGE_NAME, self[name]) for name in self._families]
        for name, sources in sorted(_find_package_chips().items()):
            packages = ", ".join(source.package for source in sources)
            try:
                if name in self._families:
                    raise ArgumentError(_describe_name_conflict(name, sources))
                lines.append(ListedChip(name, packages, self[name]))
            except StageError as error:
                lines.append(ListedChip(name, packages, None, str(error)))
        return lines

    def warn_of_name_conflict(self, name: str) -> None:
        """Warn once, on stderr, if a package brings a chip under one of PulseStage's own names.

        Args:
            name: Name of the chip that is used.
        """
        name = normalize_chip_name(name)
        if name not in self._families or name in self._told:
            return
        self._told.add(name)
        sources = (
            _find_package_chips().get(name)
            if may_have_entry_point(ENTRY_POINT_GROUP, name, normalize_chip_name)
            else None
        )
        if sources:
            print(f"PulseStage: {_describe_name_conflict(name, sources)}", file=sys.stderr, flush=True)

    def _load(self, name: str) -> type[Chip]:
        """Load the class of a chip by its name in the registry."""
        if name in self._families:
            module, _, attribute = self._families[name].partition(":")
            return getattr(import_module(module), attribute)
        if not (sources := _find_package_chips().get(name, [])):
            raise UnknownKey(str(unknown_name_error("chip", name, self)))
        return _load_class(name, sources)


def _find_package_chips() -> dict[str, list[PackageEntryPoint]]:
    """Find the chips that installed packages bring."""
    return find_entry_points(ENTRY_POINT_GROUP, normalize_chip_name)


def _describe_name_conflict(name: str, sources: list[PackageEntryPoint]) -> str:
    """Describe that an installed package has a chip under the name of one of PulseStage's own chips, which stays."""
    others = " and ".join(source.package for source in sources)
    advice = _advise_renaming(sources)
    return f"{name} is one of PulseStage's own chips, and stays it, though {others} has one of this name: {advice}"


def _load_class(name: str, sources: list[PackageEntryPoint]) -> type[Chip]:
    """Load the class that an entry point names. Raises LoadError or ArgumentError."""
    chip = load_entry_point("chip", name, sources)
    try:
        contract_check.check_chip_class(chip, Chip)
        if normalize_chip_name(chip.__name__) != name:
            advice = _advise_renaming(sources)
            raise ArgumentError(
                f"the class is called {chip.__name__}. Recordings and reports name chips by their classes: {advice}"
            )
    except ArgumentError as error:
        raise ArgumentError(f"chip {name} of {sources[0]} is refused: {error}") from None
    return chip


def _advise_renaming(sources: list[PackageEntryPoint]) -> str:
    """Return the advice to rename an entry point, for an error."""
    return f"give the entry point of {sources[0].package} another name, that of its class."
