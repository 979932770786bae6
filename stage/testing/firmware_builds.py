"""Builds of firmware in a test session: equal sources with equal flags are built once for all worker processes."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import pytest

from stage.board import build, platforms
from stage.board.firmware_library import SOURCE_SUFFIXES, find_compiler
from stage.board.platforms.arduino_library_folder import LIBRARY_FILES
from stage.errors import ArgumentError


def build_library(request: pytest.FixtureRequest, arguments: dict[str, Any]) -> Path:
    """Return the library that @pytest.mark.firmware names, or build it from the sources that the marker names.

    Args:
        request: Request of the fixture.
        arguments: Arguments of the marker. The function removes `sources`, `flags`, `platform` and `libraries`.

    Raises:
        NoCompilerError: There is no C compiler.
        CompileError: A source does not compile.
        ArgumentError: Flags are given for a library, or several libraries.
    """
    sources, flags, platform, libraries = (
        arguments.pop(name) for name in ("sources", "flags", "platform", "libraries")
    )
    if not any(source.suffix in SOURCE_SUFFIXES for source in sources):
        if len(sources) > 1 or flags or platform or libraries:
            raise ArgumentError(
                f"firmware {', '.join(s.name for s in sources)}: one library without flags, or sources "
                f"({' '.join(SOURCE_SUFFIXES)})."
            )
        return sources[0]
    base = request.getfixturevalue("tmp_path_factory").getbasetemp()
    if hasattr(request.config, "workerinput"):  # pytest-xdist: the folder that all workers share
        base = base.parent
    return _build_once(base / "pulsestage-firmware", sources, flags, platform, arguments.get("cost", 0) > 0, libraries)


def _build_once(
    folder: Path,
    sources: list[Path],
    flags: tuple[str, ...],
    platform: str | None,
    metered: bool,
    libraries: list[Path],
) -> Path:
    """Build sources in `folder` unless another worker process has built the same sources with the same flags."""
    inputs = [
        *(find_compiler(source) for source in sources),
        *flags,
        *map(str, sources),
        f"for {platform}",
        str(metered),
        *map(str, libraries),
    ]
    key = hashlib.sha256(os.fsencode("\0".join(inputs)))
    for source in platforms.add_sketch_files(sources):
        key.update(source.read_bytes())
    for file in sorted(path for folder in libraries for path in folder.rglob("*") if path.suffix in LIBRARY_FILES):
        key.update(file.read_bytes())
    library = folder / key.hexdigest()[:16] / f"{sources[0].stem}.so"
    if not library.exists():
        library.parent.mkdir(parents=True, exist_ok=True)
        part = library.with_suffix(f".{os.getpid()}.part")
        try:
            os.replace(build(sources, part, flags, platform, metered, libraries), library)
        finally:
            part.unlink(missing_ok=True)
    return library
