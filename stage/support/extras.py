"""Optional libraries, which the extras of pyproject.toml install: `pip install -e '.[rerun]'` in a checkout.

Modules import such a library by `import_extra`, so that the error is the same everywhere and nothing is imported before its use.
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

INSTALL_FORMAT = "pip install -e '.[{}]'"
"""Command that installs extras of PulseStage, typed in a checkout; README and the pages use the same one."""


def format_install_command(*extras: str) -> str:
    """Return the command that installs extras, and where to type it, for messages: pip install -e '.[rerun]' in a checkout ..."""
    return f"{INSTALL_FORMAT.format(','.join(extras))} in a checkout of PulseStage"


class Extra(NamedTuple):
    """Title of an optional library, and the extra of pyproject.toml that installs it."""

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
    "control": Extra("python-control", "servo"),
    "argcomplete": Extra("argcomplete", "completion"),
    "rerun_notebook": Extra("rerun's widget", "notebook"),
    "nicegui": Extra("NiceGUI", "panel"),
    "caproto": Extra("caproto", "epics"),
    "mcp": Extra("the package mcp", "agents"),
    "numba_cuda": Extra("numba-cuda", "gpu"),
    "numba": Extra("numba", "gpu"),
    "warp": Extra("NVIDIA Warp", "gpu"),
    "mujoco_warp": Extra("mujoco-warp", "gpu"),
}


class ExtraMissing(LoadError):
    """Error of an optional library that is needed and not installed.

    Attributes:
        extra: Extra that installs the library, see `format_install_command`.
    """

    def __init__(self, message: str, extra: str):
        super().__init__(message)
        self.extra = extra

    def __reduce__(self) -> tuple[type, tuple]:
        return type(self), (str(self), self.extra)


def import_extra(module: str, purpose: str, alternative: str = "") -> Any:
    """Import a module of an optional library.

    Args:
        module: Name of the module; its top-level package is a key of LIBRARIES.
        purpose: Feature that needs the module, for errors, as in "drawing".
        alternative: Text for errors that says what works without the library.

    Returns:
        The module.

    Raises:
        ExtraMissing: The library is not installed.
        LoadError: The library is installed, but importing it fails.
    """
    if module.startswith("matplotlib"):
        _set_matplotlib_folder()
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] == library:
            title, extra = LIBRARIES[library]
            raise ExtraMissing(
                f"{purpose} needs {title}: {format_install_command(extra)}{alternative}.", extra
            ) from error
        raise LoadError(f"{purpose}: {module} is installed and cannot be loaded: {error}.") from error


def _set_matplotlib_folder() -> None:
    """Set a temporary MPLCONFIGDIR if the home folder is read-only, where importing matplotlib would print a warning."""
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


def is_installed(library: str) -> bool:
    """Check whether a library is installed, without importing it."""
    try:
        return find_spec(library) is not None
    except (ValueError, ModuleNotFoundError):  # sys.modules has None for it, or a finder blocks it
        return False


class LazyModule:
    """Module of an optional library that `import_extra` imports at the first access to one of its attributes."""

    def __init__(self, module: str, purpose: str):
        self._module, self._what = module, purpose

    def __getattr__(self, name: str) -> Any:
        return getattr(import_extra(self._module, self._what), name)
