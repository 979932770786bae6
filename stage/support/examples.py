"""The examples that come with PulseStage: programs, drivers, custom chips, notebooks. `stage example NAME` copies one.

In a checkout they are in scripts/ and docs/notebooks/. A wheel contains them in stage/examples_/, where
stage.native.build_backend copies them.
"""

from __future__ import annotations

import ast
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from stage.errors import unknown_name_error
from stage.support.extras import format_install_command
from stage.support.files import FileError


class Requirement(NamedTuple):
    """Library that an example needs: its name, the extra that installs it, and its purpose ("": the whole example needs it)."""

    library: str
    extra: str
    why: str = ""

    def __str__(self) -> str:
        return f"needs{f' {self.why}' if self.why else ''}: {format_install_command(*self.extra.split(','))}"


REPOSITORY = Path(__file__).resolve().parents[2]
INSTALLED_EXAMPLES = Path(__file__).resolve().parents[1] / "examples_"
EXAMPLE_SCRIPTS = (
    "home_and_move", "straight_line", "stall", "own_stage", "circles_and_helices", "s_curve", "servo_moves", "gcode_controller",
    "sweep", "origin_spread",
)  # fmt: skip
NOTEBOOKS = ("tour", "register_tuning", "firmware")
EXAMPLE_PATHS = {
    **{name: f"scripts/{name}.py" for name in EXAMPLE_SCRIPTS},
    "drivers": "scripts/firmware",
    "gcode": "scripts/firmware/gcode",
    "acme_chip": "scripts/acme_chip",
    "tmc5160": "packages/trinamic",
    **{f"{name}.ipynb": f"docs/notebooks/{name}.ipynb" for name in NOTEBOOKS},
}
"""Name of an example -> its file or folder in the repository."""
FOLDER_TITLES = {
    "drivers": "Firmware in C, C++, Rust and Zig: drivers for several chips, a HAL, ports of other platforms, mistakes.",
    "gcode": "A G-code interpreter for an ATmega328P that makes its own steps, built and in C.",
    "acme_chip": "A chip of one's own in a package of its own: docs/your_own_chip.md goes through it.",
    "tmc5160": "Trinamic's TMC5160 as a package: ramps, SPI, StallGuard.",
}
REQUIREMENTS = {
    "home_and_move": Requirement("matplotlib", "plot"),
    "servo_moves": Requirement("scipy", "servo"),
    "sweep": Requirement("optuna", "tune"),
    "origin_spread": Requirement("matplotlib", "plot", "for its picture"),
    "s_curve": Requirement("matplotlib", "plot"),
    "circles_and_helices": Requirement("matplotlib", "plot", "for its picture"),
    **{f"{name}.ipynb": Requirement("nbclient", "notebook") for name in NOTEBOOKS},
}
"""Libraries that an example needs in addition to PulseStage, by its name."""
GENERATED_FILES = ("__pycache__", "*.pyc", "_native.so*", "build", "*.egg-info")
"""Files that lie in a folder and are no part of the example."""


def find_example(name: str) -> Path:
    """Return the path of an example on this machine."""
    if name not in EXAMPLE_PATHS:
        raise unknown_name_error("example", name, EXAMPLE_PATHS)
    checkout = REPOSITORY / EXAMPLE_PATHS[name]
    return checkout if checkout.exists() else INSTALLED_EXAMPLES / checkout.name


def read_title(name: str) -> str:
    """Return a line that describes an example: the first line of a program's docstring, or the heading of a notebook."""
    if name in FOLDER_TITLES:
        return FOLDER_TITLES[name]
    text = find_example(name).read_text(encoding="utf-8")
    if name.endswith(".ipynb"):
        return str(json.loads(text)["cells"][0]["source"][0]).lstrip("# ").strip() + ", a notebook."
    return (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]


def copy_example(name: str, folder: Path, overwrite: bool = False) -> Path:
    """Copy an example into `folder`, and return the copy.

    Raises:
        ArgumentError: There is no such example.
        FileError: The copy exists already, or cannot be written.
    """
    source = find_example(name)
    target = folder / (f"{name}{source.suffix}" if name in EXAMPLE_SCRIPTS else name)
    if not folder.is_dir():
        raise FileError(f"{folder} is no folder. Make it first, or choose another.")
    if target.exists() and not overwrite:
        raise FileError(f"{target} exists. Choose another folder, or give --force.")
    try:
        _copy_files(source, target)
    except (OSError, shutil.Error) as error:
        raise FileError(f"{target} cannot be written: {getattr(error, 'strerror', None) or error}.") from error
    return target


def install_examples(folder: Path) -> None:
    """Copy all examples into `folder`, for a wheel."""
    folder.mkdir(parents=True, exist_ok=True)
    for location in EXAMPLE_PATHS.values():
        if (source := REPOSITORY / location).exists():  # a part of the tree may be built alone
            _copy_files(source, folder / source.name)


def _copy_files(source: Path, target: Path) -> None:
    """Copy a file, or a folder without GENERATED_FILES."""
    if source.is_dir():
        ignore: Callable = shutil.ignore_patterns(*GENERATED_FILES)
        shutil.copytree(source, target, ignore=ignore, dirs_exist_ok=True)
    else:
        shutil.copyfile(source, target)
