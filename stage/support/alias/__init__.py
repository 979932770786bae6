"""The package `pulsestage`: another name of `stage`, for users who import what they have installed.

    import pulsestage                       the module stage itself
    from pulsestage.chips import PCL240K    the class of stage.chips

pyproject.toml installs this folder under the name `pulsestage`. No module is loaded twice: a finder answers the import of
`pulsestage.NAME` with the module `stage.NAME`. So classes are the same objects, and pickles name `stage` only.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import InspectLoader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import CodeType, ModuleType
from typing import Any

ALIAS, PACKAGE = "pulsestage", "stage"


class SharedModuleLoader(InspectLoader):
    """Loader of a module under its second name: the module that its first name has."""

    def __init__(self, name: str):
        self._name = name

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return the module, imported by its first name."""
        module = import_module(self._name)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Give the module back its own specification, which the import system has replaced; the module has run already."""
        module.__spec__ = self._spec

    def get_code(self, fullname: str) -> CodeType | None:
        """Return the code of the module, for `python -m pulsestage`."""
        loader: Any = getattr(find_spec(self._name), "loader", None)
        return loader and loader.get_code(self._name)

    def get_source(self, fullname: str) -> str | None:
        """Return nothing: the module's own loader has the source."""
        return None


class AliasFinder(MetaPathFinder):
    """Finder of `pulsestage.NAME`, which is `stage.NAME`."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the specification of a module below the alias; None for other modules, and if `stage` has none of that name."""
        top, _, rest = fullname.partition(".")
        if top != ALIAS or not rest or (spec := find_spec(f"{PACKAGE}.{rest}")) is None:
            return None
        is_package = spec.submodule_search_locations is not None
        return ModuleSpec(fullname, SharedModuleLoader(spec.name), is_package=is_package)


if __name__ == ALIAS:
    sys.meta_path.insert(0, AliasFinder())
    sys.modules[ALIAS] = import_module(PACKAGE)
