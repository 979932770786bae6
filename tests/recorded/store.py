"""Recorded behaviour: what the product does in many small scenes, kept in data/ and compared with what it does now.

    make record                      write the files anew (scripts/record_behaviour.py; names of files as arguments: only these)
    pytest tests/recorded            compare

A test here does not say what is right: the specification, the references and the other tests do that. It says that something has
changed. A change that is meant: run the command, read the diff, and commit it with the change. One that is not meant is a defect,
and the failure names the scene and what differs in it.

Each `recorded_*.py` has FILES, {file: {scene: function}}. A scene returns numbers, texts, lists and dictionaries. Whole numbers
and texts must be the same; others agree to 1e-7, as mathematical libraries round differently. A text of more than LONG lines is
kept as a few digits a line.
"""

from __future__ import annotations

import dataclasses
import enum
import inspect
import json
import math
from collections.abc import Callable, Iterator
from hashlib import blake2b
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

DATA = Path(__file__).parent / "data"
RELATIVE, ABSOLUTE = 1e-7, 1e-9
LONG = 30
WIDE = 120
Scenes = dict[str, Callable[..., Any]]


def digits(text: str | bytes, size: int = 2) -> str:
    return blake2b(text.encode() if isinstance(text, str) else text, digest_size=size).hexdigest()


def plain(value: Any) -> Any:
    """As JSON keeps it."""
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if hasattr(value, "_asdict"):
        return plain(value._asdict())
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(v) for v in (sorted(value) if isinstance(value, set | frozenset) else value)]
    if isinstance(value, float):
        return float(f"{value:.9g}") if math.isfinite(value) else str(value)
    if isinstance(value, bytes):
        return digits(value, 4)
    if isinstance(value, str) and "\n" in value:
        return value.splitlines()
    return value if isinstance(value, bool | int | str) or value is None else str(value)


def packed(value: Any) -> Any:
    """The same with long texts as digits a line."""
    if isinstance(value, dict):
        return {k: packed(v) for k, v in value.items()}
    if isinstance(value, list) and value and all(isinstance(v, str) for v in value) and len(value) > LONG:
        return " ".join(map(digits, value))
    return [packed(v) for v in value] if isinstance(value, list) else value


def play(scene: Callable[..., Any], folder: Path) -> Any:
    """What a scene returns, as JSON keeps it. folder: an empty one, for scenes that write files."""
    return plain(scene(folder) if inspect.signature(scene).parameters else scene())


def differences(kept: Any, now: Any, where: str = "") -> Iterator[str]:
    """What differs, a line each."""
    if isinstance(kept, dict) and isinstance(now, dict):
        for k in dict.fromkeys((*kept, *now)):
            if k not in kept or k not in now:
                yield f"{where}/{k}: {'recorded only' if k in kept else 'is new'}"
            else:
                yield from differences(kept[k], now[k], f"{where}/{k}")
    elif isinstance(kept, str) and isinstance(now, list):
        lines = kept.split(" ")
        if len(lines) != len(now):
            yield f"{where}: {len(lines)} lines recorded, now {len(now)}"
        for k, (a, b) in enumerate(zip(lines, now, strict=False), 1):
            if a != digits(b):
                yield f"{where}, line {k} is not as recorded: {b!r}"
    elif isinstance(kept, list) and isinstance(now, list):
        if len(kept) != len(now):
            yield f"{where}: {len(kept)} recorded, now {len(now)}: {now!r:.300}"
        for k, (a, b) in enumerate(zip(kept, now, strict=False)):
            yield from differences(a, b, f"{where}[{k}]")
    elif isinstance(kept, float) or isinstance(now, float):
        if not isinstance(now, int | float) or not isinstance(kept, int | float) or not close(kept, now):
            yield f"{where}: recorded {kept!r}, now {now!r}"
    elif kept != now or type(kept) is not type(now):
        yield f"{where}: recorded {kept!r}, now {now!r}"


def close(a: float, b: float) -> bool:
    return math.isclose(a, b, rel_tol=RELATIVE, abs_tol=ABSOLUTE)


def load(file: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((DATA / f"{file}.json").read_text(encoding="utf-8"))
    return found


def save(file: str, scenes: dict[str, Any]) -> None:
    (DATA / f"{file}.json").write_text(written(packed(scenes)) + "\n", encoding="utf-8")


def same_mujoco(version: str) -> bool:
    """Whether the files were recorded with this version of MuJoCo: contacts differ between them by more than rounding."""
    return bool(load("about")["mujoco"] == version)


def same_package(name: str) -> bool:
    """Whether the files were recorded with this version of an optional package, and it is there."""
    return version_of(name) != "" and bool(load("about").get(name) == version_of(name))


def version_of(name: str) -> str:
    """Of an installed distribution; "" where it is not there."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def written(value: Any, indent: int = 0) -> str:
    """JSON that diffs well: what fits into a line is on one."""
    line = json.dumps(value, ensure_ascii=False)
    if len(line) + indent <= WIDE or not isinstance(value, dict | list) or not value:
        return line
    pad = " " * (indent + 1)
    if isinstance(value, dict):
        parts = [f"{pad}{json.dumps(k, ensure_ascii=False)}: {written(v, indent + 1)}" for k, v in value.items()]
        return "{\n" + ",\n".join(parts) + "\n" + " " * indent + "}"
    if not any(isinstance(v, dict | list | str) for v in value):  # numbers: filled lines
        lines, now = [], pad
        for k, v in enumerate(value):
            text = json.dumps(v) + ("," if k + 1 < len(value) else "")
            if len(now) + len(text) >= WIDE:
                lines.append(now.rstrip())
                now = pad
            now += text + " "
        return "[\n" + "\n".join([*lines, now.rstrip()]) + "\n" + " " * indent + "]"
    return "[\n" + ",\n".join(pad + written(v, indent + 1) for v in value) + "\n" + " " * indent + "]"
