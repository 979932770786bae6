"""Settings of the plugin, and arguments of a test's markers.

If several markers set an argument, the nearest one counts: function, then class, then module.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from stage.errors import ArgumentError, unknown_name_error
from stage.support.files import FileError

STAGE_ARGUMENTS = ("model", "chips", "drives", "bus_cycle", "clock", "visuals", "record", "encoders")
BOARD_ARGUMENTS = ("layout", "base", "stride", "keep_cycles", "devices")
IOC_ARGUMENTS = ("model", "chips", "prefix", "pace", "options")
FIRMWARE_ARGUMENTS = (
    "flags",
    "platform",
    "libraries",
    "isolated",
    "patience",
    "cost",
    "mcu",
    "map",
    "pins",
    "mcu_clock",
)


def read_setting(config: pytest.Config, name: str) -> str:
    """Read a setting from the command line, else from the ini file; "" if neither has it."""
    return config.getoption(f"pulsestage_{name}") or config.getini(f"pulsestage_{name}") or ""


def read_stage_arguments(node: pytest.Item) -> dict[str, Any]:
    """Return the arguments for Stage, and `record`.

    Raises:
        ArgumentError: A marker has an argument that does not exist, or one twice.
    """
    arguments: dict[str, Any] = {"visuals": False}
    for mark in _list_markers(node, "stage", "model", "chips"):
        if mark.name == "stage":
            arguments |= _bind_arguments(mark, STAGE_ARGUMENTS)
        elif mark.name == "model":
            arguments |= _bind_arguments(mark, ("model",), exactly=True)
        else:
            arguments["chips"] = _read_chips(mark)
    model = arguments.get("model")
    if isinstance(model, str | Path) and Path(model).suffix:  # a file; the shipped models have none
        arguments["model"] = find_file(node, model, "model")
    return arguments


def read_board_arguments(node: pytest.Item) -> dict[str, Any]:
    """Return the arguments for Board.

    Raises:
        ArgumentError: A marker has an argument that does not exist, or one twice.
        FileError: The file of a layout does not exist.
    """
    from stage.board import bus_layouts

    arguments: dict[str, Any] = {}
    for mark in _list_markers(node, "board"):
        arguments |= _bind_arguments(mark, BOARD_ARGUMENTS)
    if bus_layouts.is_layout_file(arguments.get("layout")):
        arguments["layout"] = find_file(node, arguments["layout"], "layout")
    return arguments


def read_ioc_arguments(node: pytest.Item) -> dict[str, Any]:
    """Return the arguments for IocProcess.

    Raises:
        ArgumentError: A marker has an argument that does not exist, or one twice.
    """
    arguments: dict[str, Any] = {}
    for mark in _list_markers(node, "ioc"):
        arguments |= _bind_arguments(mark, IOC_ARGUMENTS)
    return arguments


def read_firmware_arguments(node: pytest.Item) -> dict[str, Any]:
    """Return `sources` (paths), `flags` (a tuple), `platform`, `libraries` (paths), and the arguments of NativeHost.

    Raises:
        ArgumentError: No firmware is named, or an argument does not exist.
        FileError: A source does not exist.
    """
    arguments: dict[str, Any] = {}
    for mark in _list_markers(node, "firmware"):
        if mark.args:
            arguments["sources"] = mark.args
        arguments |= _bind_arguments(pytest.Mark(mark.name, (), mark.kwargs, _ispytest=True), FIRMWARE_ARGUMENTS)
    if "sources" not in arguments:
        raise ArgumentError(
            'the fixture `host` runs a firmware, and this test names none: @pytest.mark.firmware("driver.c"), from where the test '
            "file is."
        )
    arguments["sources"] = [find_file(node, source, "firmware") for source in arguments["sources"]]
    arguments.setdefault("isolated", os.name == "posix" and read_setting(node.config, "firmware") != "in-process")
    arguments.setdefault("platform", None)
    arguments["libraries"] = [find_file(node, folder, "library") for folder in arguments.get("libraries", ())]
    flags = arguments.get("flags", ())
    arguments["flags"] = tuple(shlex.split(flags) if isinstance(flags, str) else flags)
    return arguments


def find_file(node: pytest.Item, name: Any, what: str) -> Path:
    """Find a file that a marker names: from the folder of the test file, else from pytest's rootdir.

    Args:
        node: Test.
        name: Path as the marker gives it.
        what: Kind of file, for the error.

    Raises:
        FileError: There is no such file.
    """
    if not isinstance(name, str | Path):
        raise ArgumentError(f"{what} {name!r}: a path in quotes is wanted.")
    folders = list(dict.fromkeys((node.path.parent, node.config.rootpath)))
    for folder in folders:
        if (folder / name).is_dir() if what == "library" else (folder / name).is_file():
            return (folder / name).resolve()
    raise FileError(f"{what} {str(name)!r}: there is no such file, from {' or '.join(map(str, folders))}.")


def _list_markers(node: pytest.Item, *names: str) -> list[pytest.Mark]:
    """Return the markers of a test with one of these names, the nearest one first."""
    return [mark for mark in node.iter_markers() if mark.name in names][::-1]


def _bind_arguments(mark: pytest.Mark, names: Iterable[str], exactly: bool = False) -> dict[str, Any]:
    """Return the arguments of a marker by name. Raises ArgumentError for unknown arguments."""
    names = tuple(names)
    if len(mark.args) > len(names) or (exactly and len(mark.args) + len(mark.kwargs) != len(names)):
        text = ", ".join([*map(repr, mark.args), *(f"{k}={v!r}" for k, v in mark.kwargs.items())])
        raise ArgumentError(f"@pytest.mark.{mark.name}({text}): it takes {', '.join(names)}.")
    for name in mark.kwargs:
        if name not in names:
            raise unknown_name_error(f"argument of @pytest.mark.{mark.name}", name, names)
    arguments = dict(zip(names, mark.args, strict=False))
    for name in mark.kwargs:
        if name in arguments:
            raise ArgumentError(f"@pytest.mark.{mark.name}: {name} is given twice.")
    return arguments | dict(mark.kwargs)


def _read_chips(mark: pytest.Mark) -> Any:
    """Return the chips that a marker names, as `Stage` takes them."""
    if len(mark.args) + bool(mark.kwargs) != 1:
        raise ArgumentError(
            '@pytest.mark.chips: one chip for all axes, @pytest.mark.chips("PCL240MS"), or one an axis, '
            '@pytest.mark.chips(x="PCL240MS", y="PCL240K").'
        )
    return mark.args[0] if mark.args else mark.kwargs
