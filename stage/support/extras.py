"""Libraries that a small installation does not have, and the words for who needs one: `pip install 'pulsestage[rerun]'`.

Whoever uses such a library gets it here, and so all say the same, and nothing is imported before it is used.
"""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple

from stage.errors import LoadError


class Extra(NamedTuple):
    """Title of a library, and the extra of pyproject.toml that has it."""

    title: str
    extra: str


LIBRARIES = {
    "rerun": Extra("rerun", "rerun"),
    "rerun_cli": Extra("rerun", "rerun"),
    "matplotlib": Extra("matplotlib", "plot"),
    "pandas": Extra("pandas", "data"),
    "pyarrow": Extra("pyarrow", "data"),
    "optuna": Extra("Optuna", "tune"),
    "scipy": Extra("scipy", "servo"),
    "argcomplete": Extra("argcomplete", "completion"),
    "rerun_notebook": Extra("rerun's widget", "notebook"),
    "nicegui": Extra("NiceGUI", "panel"),
    "mcp": Extra("the package mcp", "agents"),
    "numba_cuda": Extra("numba-cuda", "gpu"),
    "numba": Extra("numba", "gpu"),
    "warp": Extra("NVIDIA Warp", "gpu"),
    "mujoco_warp": Extra("mujoco-warp", "gpu"),
}


class ExtraMissing(LoadError):
    """Error: something needs a library that is not installed.

    Attributes:
        extra: the extra that has it, for pip install 'pulsestage[EXTRA]'.
    """

    def __init__(self, message: str, extra: str):
        super().__init__(message)
        self.extra = extra

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (str(self), self.extra)


def need(module: str, what: str, instead: str = "") -> Any:
    """Import a module of a library of LIBRARIES.

    Args:
        module: Name of the module.
        what: What needs it, for errors, as in "drawing".
        instead: What works without it, for errors.

    Raises:
        ExtraMissing: The library is not installed.
        LoadError: It cannot be loaded.
    """
    if module.startswith("matplotlib"):
        _give_matplotlib_a_folder()
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] == library:
            title, extra = LIBRARIES[library]
            raise ExtraMissing(f"{what} needs {title}: pip install 'pulsestage[{extra}]'{instead}.", extra) from error
        raise LoadError(f"{what}: {module} is installed and cannot be loaded: {error}.") from error


def _give_matplotlib_a_folder() -> None:
    """A home that cannot be written to makes matplotlib complain at its import: it gets a folder that goes at the end."""
    if "MPLCONFIGDIR" in os.environ or "matplotlib" in sys.modules:
        return
    home = os.path.expanduser("~")
    for variable, usual in (("XDG_CONFIG_HOME", ".config"), ("XDG_CACHE_HOME", ".cache")):
        folder = os.path.join(os.environ.get(variable) or os.path.join(home, usual), "matplotlib")
        while not os.path.lexists(folder) and os.path.dirname(folder) != folder:
            folder = os.path.dirname(folder)
        if not (os.path.isdir(folder) and os.access(folder, os.W_OK | os.X_OK)):
            os.environ["MPLCONFIGDIR"] = own_folder = tempfile.mkdtemp(prefix="pulsestage-matplotlib-")
            atexit.register(shutil.rmtree, own_folder, ignore_errors=True)
            return


def has(library: str) -> bool:
    """Check whether a library is installed, without importing it."""
    try:
        return find_spec(library) is not None
    except (ValueError, ModuleNotFoundError):  # somebody has put None in its place, or blocks it
        return False


class Later:
    """The module `module` of a library, imported by `need` for `what` when something of it is first used."""

    def __init__(self, module: str, what: str):
        self._module, self._what = module, what

    def __getattr__(self, name: str) -> Any:
        return getattr(need(self._module, self._what), name)
