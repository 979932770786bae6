"""Firmware in Rust and Zig: the example of the page and those of scripts/firmware, if their compilers are installed."""

import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from stage import Stage
from stage.board import Board, NativeHost
from stage.testing import assert_at, assert_no_diagnostics

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "scripts" / "firmware"
RUSTC = shutil.which("rustc") or shutil.which("rustc", path=str(Path.home() / ".cargo" / "bin"))
rust = pytest.mark.skipif(RUSTC is None, reason="no rustc here")
pytestmark = pytest.mark.slow


def compile_with_rustc(source, folder, edition):
    library = folder / "driver.so"
    subprocess.run(
        [
            RUSTC,
            "--edition",
            edition,
            "-O",
            "-D",
            "warnings",
            "--crate-type",
            "cdylib",
            str(source),
            "-o",
            str(library),
        ],
        check=True,
    )
    return library


@rust
@pytest.mark.parametrize("edition", ["2021", "2024"])
def test_the_example_of_the_page_builds_and_runs(edition, tmp_path):
    page = (ROOT / "docs" / "firmware_in_the_loop.md").read_text()
    (tmp_path / "driver.rs").write_text(re.search(r"```rust\n(.*?)```", page, re.S)[1])
    result = NativeHost(compile_with_rustc(tmp_path / "driver.rs", tmp_path, edition), Board(Stage("xy"))).run(
        timeout=1
    )
    assert (result.code, result.cycles) == (0, 2)


@rust
@pytest.mark.parametrize("edition", ["2021", "2024"])
def test_the_wrapper_moves_an_axis_without_unsafe_code_of_the_driver(edition, tmp_path):
    stage = Stage("xy", chips="PCL240MK", visuals=False)
    host = NativeHost(compile_with_rustc(EXAMPLES / "rust" / "driver.rs", tmp_path, edition), Board(stage))
    assert host.run(timeout=5).code == 0
    assert host.log[-1][1] == "0 pulses are left"
    assert_at(stage.axes["x"], 4000 * stage.axes["x"].meters_per_pulse)
    assert_no_diagnostics(stage)


@pytest.mark.skipif(find_spec("ziglang") is None, reason="no zig here")
def test_the_example_in_zig_builds_and_runs(tmp_path):
    source = EXAMPLES / "zig" / "driver.zig"
    zig = [sys.executable, "-m", "ziglang", "build-lib", "-dynamic", "-O", "ReleaseSafe", str(source)]
    subprocess.run(zig, check=True, cwd=tmp_path)
    host = NativeHost(tmp_path / "libdriver.so", Board(Stage("xy", visuals=False)))
    assert host.run(timeout=1).code == 0
    assert host.log[-1][1] == "it does not operate"
