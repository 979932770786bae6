"""Build the examples of scripts/firmware as a reader would: C99 with all warnings as errors."""

import shutil
from pathlib import Path

import pytest

from stage.board import NoCompilerError, build
from stage.board.firmware_library import find_compiler

EXAMPLES = Path(__file__).resolve().parents[2] / "scripts" / "firmware"
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror")


@pytest.fixture(scope="session")
def firmware(tmp_path_factory):
    """Return a function that builds an example once and returns its library: `firmware("pcl240mk", *flags,
    change=(file, old, new))`.

    With `change`, it builds a copy in which a text of one file is replaced, for example to introduce a fault.
    """
    try:
        find_compiler()
    except NoCompilerError as error:
        pytest.skip(f"firmware in C is not tested here: {error}")
    built_libraries = {}

    def make(name, *flags, change=None):
        key = (name, flags, change)
        if key not in built_libraries:
            folder = tmp_path_factory.mktemp(name)
            shutil.copytree(EXAMPLES / "hal", folder / "hal")
            shutil.copytree(EXAMPLES / name, folder / name)
            if change:
                file, old, new = change
                path = folder / name / file
                text = path.read_text()
                assert text.count(old) == 1, f"{file} has no {old!r} to change, or several"
                path.write_text(text.replace(old, new))
            sources = [*sorted((folder / name).glob("*.c")), folder / "hal" / "hal_pulsestage.c"]
            built_libraries[key] = build(sources, folder / f"{name}.so", (*FLAGS, f"-I{folder / 'hal'}", *flags))
        return built_libraries[key]

    return make
