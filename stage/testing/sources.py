"""Firmware libraries of a test session: equal sources with equal flags are built once, for all its worker processes."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import pytest

from stage.board import build, platforms
from stage.board.library import SOURCES, compiler
from stage.errors import ArgumentError


def library_of(request: pytest.FixtureRequest, arguments: dict[str, Any]) -> Path:
    """The library of what @pytest.mark.firmware names; takes `sources`, `flags`, `platform` out of the arguments.

    Raises NoCompilerError, CompileError, ArgumentError.
    """
    sources, flags, platform = (arguments.pop(name) for name in ("sources", "flags", "platform"))
    if not any(source.suffix in SOURCES for source in sources):
        if len(sources) > 1 or flags or platform:
            raise ArgumentError(
                f"firmware {', '.join(s.name for s in sources)}: one library without flags, or sources ({' '.join(SOURCES)})."
            )
        return sources[0]
    base = request.getfixturevalue("tmp_path_factory").getbasetemp()
    if hasattr(request.config, "workerinput"):  # pytest-xdist: the folder that all workers share
        base = base.parent
    return _built(base / "pulsestage-firmware", sources, flags, platform, arguments.get("cost", 0) > 0)


def _built(folder: Path, sources: list[Path], flags: tuple[str, ...], platform: str | None, metered: bool) -> Path:
    said = [*(compiler(source) for source in sources), *flags, *map(str, sources), f"for {platform}", str(metered)]
    key = hashlib.sha256(os.fsencode("\0".join(said)))
    for source in platforms.whole(sources):
        key.update(source.read_bytes())
    made = folder / key.hexdigest()[:16] / f"{sources[0].stem}.so"
    if not made.exists():
        made.parent.mkdir(parents=True, exist_ok=True)
        part = made.with_suffix(f".{os.getpid()}.part")
        try:
            os.replace(build(sources, part, flags, platform, metered), made)
        finally:
            part.unlink(missing_ok=True)
    return made
