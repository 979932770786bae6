"""Arduino libraries by their folder: which headers and sources the Arduino tools take from it."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from stage.errors import ArgumentError
from stage.support.files import FileError

SOURCE_SUFFIXES = (".c", ".cc", ".cpp", ".cxx")
LIBRARY_FILES = (*SOURCE_SUFFIXES, ".h", ".hh", ".hpp")
PROPERTIES = "library.properties"


@dataclass(frozen=True)
class ArduinoLibrary:
    """A library of Arduino in a folder.

    Attributes:
        name: Its name in library.properties, or that of the folder.
        folder: The folder.
        include_folders: Folders in which sketches find its headers.
        sources: Sources in C and C++ that are compiled with each sketch.
        dependencies: Names of the libraries that it needs, as library.properties has them.
    """

    name: str
    folder: Path
    include_folders: tuple[Path, ...]
    sources: tuple[Path, ...]
    dependencies: tuple[str, ...]


def read_arduino_library(folder: str | os.PathLike) -> ArduinoLibrary:
    """Read a library: all below `src`, or in the flat layout the files of the folder itself and of `utility`.

    Raises:
        FileError: There is no such folder.
        ArgumentError: The folder has neither headers nor sources where a library has them.
    """
    root = Path(folder)
    if not root.is_dir():
        raise FileError(f"library {root}: there is no such folder. Name the one that has {PROPERTIES} in it.")
    is_recursive = (root / "src").is_dir()
    include_folders = (root / "src",) if is_recursive else (root, *filter(Path.is_dir, [root / "utility"]))
    files = sorted(
        file
        for part in include_folders
        for file in (part.rglob("*") if is_recursive else part.iterdir())
        if file.is_file()
    )
    if not any(file.suffix in LIBRARY_FILES for file in files):
        raise ArgumentError(
            f"library {root}: no header and no source is in {include_folders[0]}. Name the folder of one library, which has "
            f"{PROPERTIES} in it, and give --library (libraries= in Python) once for each."
        )
    properties = _read_properties(root / PROPERTIES)
    return ArduinoLibrary(
        properties.get("name", root.resolve().name),
        root,
        include_folders,
        tuple(file for file in files if file.suffix in SOURCE_SUFFIXES),
        tuple(
            re.sub(r"\s*\(.*", "", name).strip() for name in properties.get("depends", "").split(",") if name.strip()
        ),
    )


def suggest_dependencies(libraries: Sequence[ArduinoLibrary]) -> str:
    """Name the libraries that others depend on and that are not given; "" if there are none."""
    names = {library.name for library in libraries}
    return "".join(
        f"\nThe library {library.name} depends on {name}: give its folder with --library, too."
        for library in libraries
        for name in library.dependencies
        if name not in names
    )


def _read_properties(file: Path) -> dict[str, str]:
    """Read the lines `name=value` of library.properties; no lines of a file that is not there."""
    if not file.is_file():
        return {}
    lines = (line.partition("=") for line in file.read_text(encoding="utf-8", errors="replace").splitlines())
    return {name.strip(): value.strip() for name, equals, value in lines if equals}
