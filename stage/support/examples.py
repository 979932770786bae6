"""The examples that come with PulseStage: programs, drivers, chips of one's own, notebooks. `stage example NAME` copies one.

In a checkout they lie in scripts/ and docs/notebooks/; a wheel has them in stage/examples_/, put there by stage.native.backend.
"""

from __future__ import annotations

import ast
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from stage.errors import unknown_name_error
from stage.support.files import FileError


class Needs(NamedTuple):
    """A library, the extra of pyproject.toml that has it, and what it is for; "": without it nothing runs."""

    library: str
    extra: str
    why: str = ""

    def __str__(self) -> str:
        return f"needs{f' {self.why}' if self.why else ''}: pip install 'pulsestage[{self.extra}]'"


ROOT = Path(__file__).resolve().parents[2]
INSTALLED = Path(__file__).resolve().parents[1] / "examples_"
PROGRAMS = (
    "home_and_move", "straight_line", "stall", "own_stage", "circles_and_helices", "s_curve", "servo_moves", "gcode_controller",
    "sweep", "origin_spread",
)  # fmt: skip
NOTEBOOKS = ("tour", "register_tuning", "firmware")
PLACES = {
    **{name: f"scripts/{name}.py" for name in PROGRAMS},
    "drivers": "scripts/firmware",
    "acme_chip": "scripts/acme_chip",
    "tmc5160": "packages/trinamic",
    **{f"{name}.ipynb": f"docs/notebooks/{name}.ipynb" for name in NOTEBOOKS},
}
"""Name of an example -> where it lies in the repository, a file or a folder."""
FOLDERS = {
    "drivers": "Firmware in C, C++, Rust and Zig: drivers for several chips, a HAL, ports of other platforms, mistakes.",
    "acme_chip": "A chip of one's own in a package of its own: docs/your_own_chip.md goes through it.",
    "tmc5160": "Trinamic's TMC5160 as a package: ramps, SPI, StallGuard.",
}
EXTRAS = {
    "home_and_move": Needs("matplotlib", "plot"),
    "servo_moves": Needs("scipy", "servo"),
    "sweep": Needs("optuna", "tune"),
    "origin_spread": Needs("matplotlib", "plot", "for its picture"),
    "s_curve": Needs("matplotlib", "plot"),
    "circles_and_helices": Needs("matplotlib", "plot", "for its picture"),
    **{f"{name}.ipynb": Needs("nbclient", "notebook") for name in NOTEBOOKS},
}
"""What an example needs beside PulseStage."""
GENERATED_FILES = ("__pycache__", "*.pyc", "_native.so*", "build", "*.egg-info")
"""Files that lie in a folder and are no part of the example."""


def place(name: str) -> Path:
    """Return where an example lies on this machine.

    Raises:
        ArgumentError: There is no such example; the error has near names.
    """
    if name not in PLACES:
        raise unknown_name_error("example", name, PLACES)
    checkout = ROOT / PLACES[name]
    return checkout if checkout.exists() else INSTALLED / checkout.name


def title(name: str) -> str:
    """Return a line that says what an example shows: the first one of a program's docstring, the heading of a notebook."""
    if name in FOLDERS:
        return FOLDERS[name]
    text = place(name).read_text(encoding="utf-8")
    if name.endswith(".ipynb"):
        return str(json.loads(text)["cells"][0]["source"][0]).lstrip("# ").strip() + ", a notebook."
    return (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]


def copy(name: str, folder: Path, overwrite: bool = False) -> Path:
    """Copy an example into `folder`, and return the copy.

    Raises:
        ArgumentError: There is no such example.
        FileError: The copy exists already, or cannot be written.
    """
    source = place(name)
    target = folder / (f"{name}{source.suffix}" if name in PROGRAMS else name)
    if not folder.is_dir():
        raise FileError(f"{folder} is no folder. Make it first, or choose another.")
    if target.exists() and not overwrite:
        raise FileError(f"{target} exists. Choose another folder, or give --force.")
    try:
        _copied(source, target)
    except (OSError, shutil.Error) as error:
        raise FileError(f"{target} cannot be written: {getattr(error, 'strerror', None) or error}.") from error
    return target


def install(into: Path) -> None:
    """Put all of them into the folder `into`, for a wheel."""
    into.mkdir(parents=True, exist_ok=True)
    for location in PLACES.values():
        if (source := ROOT / location).exists():  # a part of the tree may be built alone
            _copied(source, into / source.name)


def _copied(source: Path, target: Path) -> None:
    if source.is_dir():
        ignore: Callable = shutil.ignore_patterns(*GENERATED_FILES)
        shutil.copytree(source, target, ignore=ignore, dirs_exist_ok=True)
    else:
        shutil.copyfile(source, target)
