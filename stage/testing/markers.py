"""Markers as arguments. The nearest marker of a test wins, argument by argument: function, class, module."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from stage.errors import ArgumentError, unknown
from stage.support.files import FileError
from stage.testing.settings import setting

STAGE = ("model", "chips", "drives", "bus_cycle", "clock", "visuals", "record", "encoders")
BOARD = ("layout", "base", "stride", "keep_cycles", "devices")
FIRMWARE = ("flags", "platform", "isolated", "patience", "cost", "mcu", "map", "mcu_clock")


def stage_arguments(node: pytest.Item) -> dict[str, Any]:
    """For Stage, and `record`. Raises ArgumentError."""
    found: dict[str, Any] = {"visuals": False}
    for mark in _farthest_first(node, "stage", "model", "chips"):
        if mark.name == "stage":
            found |= _bound(mark, STAGE)
        elif mark.name == "model":
            found |= _bound(mark, ("model",), exactly=True)
        else:
            found["chips"] = _chips(mark)
    model = found.get("model")
    if isinstance(model, str | Path) and Path(model).suffix:  # a file; the shipped models have none
        found["model"] = find(node, model, "model")
    return found


def board_arguments(node: pytest.Item) -> dict[str, Any]:
    """For Board. Raises ArgumentError, FileError."""
    from stage.board import layout_files

    found: dict[str, Any] = {}
    for mark in _farthest_first(node, "board"):
        found |= _bound(mark, BOARD)
    if layout_files.is_file(found.get("layout")):
        found["layout"] = find(node, found["layout"], "layout")
    return found


def firmware_arguments(node: pytest.Item) -> dict[str, Any]:
    """`sources` (paths), `flags` (a tuple), `platform`, and what NativeHost takes. Raises ArgumentError, FileError."""
    found: dict[str, Any] = {}
    for mark in _farthest_first(node, "firmware"):
        if mark.args:
            found["sources"] = mark.args
        found |= _bound(pytest.Mark(mark.name, (), mark.kwargs, _ispytest=True), FIRMWARE)
    if "sources" not in found:
        raise ArgumentError(
            'the fixture `host` runs a firmware, and this test names none: @pytest.mark.firmware("driver.c"), from where the test '
            "file is."
        )
    found["sources"] = [find(node, source, "firmware") for source in found["sources"]]
    found.setdefault("isolated", os.name == "posix" and setting(node.config, "firmware") != "in-process")
    found.setdefault("platform", None)
    flags = found.get("flags", ())
    found["flags"] = tuple(shlex.split(flags) if isinstance(flags, str) else flags)
    return found


def find(node: pytest.Item, name: Any, what: str) -> Path:
    """A file that a marker names: from the folder of the test file, else from pytest's rootdir. Raises FileError."""
    if not isinstance(name, str | Path):
        raise ArgumentError(f"{what} {name!r}: a path in quotes is wanted.")
    folders = list(dict.fromkeys((node.path.parent, node.config.rootpath)))
    for folder in folders:
        if (folder / name).is_file():
            return (folder / name).resolve()
    raise FileError(f"{what} {str(name)!r}: there is no such file, from {' or '.join(map(str, folders))}.")


def _farthest_first(node: pytest.Item, *names: str) -> list[pytest.Mark]:
    return [mark for mark in node.iter_markers() if mark.name in names][::-1]


def _bound(mark: pytest.Mark, names: Iterable[str], exactly: bool = False) -> dict[str, Any]:
    """The arguments of a marker by name."""
    names = tuple(names)
    if len(mark.args) > len(names) or (exactly and len(mark.args) + len(mark.kwargs) != len(names)):
        given = ", ".join([*map(repr, mark.args), *(f"{k}={v!r}" for k, v in mark.kwargs.items())])
        raise ArgumentError(f"@pytest.mark.{mark.name}({given}): it takes {', '.join(names)}.")
    for name in mark.kwargs:
        if name not in names:
            raise unknown(f"argument of @pytest.mark.{mark.name}", name, names)
    found = dict(zip(names, mark.args, strict=False))
    for name in mark.kwargs:
        if name in found:
            raise ArgumentError(f"@pytest.mark.{mark.name}: {name} is given twice.")
    return found | dict(mark.kwargs)


def _chips(mark: pytest.Mark) -> Any:
    if len(mark.args) + bool(mark.kwargs) != 1:
        raise ArgumentError(
            '@pytest.mark.chips: one chip for all axes, @pytest.mark.chips("PCL240MS"), or one an axis, '
            '@pytest.mark.chips(x="PCL240MS", y="PCL240K").'
        )
    return mark.args[0] if mark.args else mark.kwargs
