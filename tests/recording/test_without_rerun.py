"""The small installation: everything but .rrd files and what looks at them works without rerun, and those say what to install."""

import subprocess
import sys

import pytest

from stage.support.extras import format_install_command

BLOCKED = """
import sys
from importlib.abc import MetaPathFinder

class Nothing(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("rerun", "rerun_cli", "rerun_bindings", "pyarrow", "pandas"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Nothing())
"""
PROGRAM = """
from stage import Stage, firmware
from stage.errors import LoadError
from stage.support.extras import ExtraMissing

stage = Stage("xy")
with stage.record() as recording:
    firmware.preset_move(stage.axes["x"], 800)
print(recording.columns["x/pulses"][-1], recording.to_vcd("x.vcd").stat().st_size > 0)
for write in (recording.save, lambda path: stage.record(path=path)):
    try:
        write("x.rrd")
    except ExtraMissing as missing:
        print(missing, missing.extra, isinstance(missing, LoadError))
print(stage.recording)
"""


@pytest.fixture
def small(tmp_path):
    """Runs a program, or a command line, in a process that has no rerun."""

    def run(program, *argv):
        command = [sys.executable, "-c", BLOCKED + program, *argv]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=100, check=False)

    return run


def test_only_an_rrd_file_requires_rerun(small, tmp_path):
    done = small(PROGRAM)
    message = "a recording (.rrd) needs rerun: pip install -e '.[rerun]' in a checkout of PulseStage. rerun True"
    assert (done.stdout.splitlines(), done.stderr) == (["800 True", message, message, "None"], "")
    assert [p.name for p in tmp_path.iterdir()] == ["x.vcd"], "no half-written recording is left"


def test_the_demo_makes_its_moves_and_says_what_a_recording_needs(small, tmp_path):
    """An installation without extras: stage demo"""
    done = small("from stage.cli import main; sys.exit(main(sys.argv[1:]))", "demo", "--model", "xy")
    assert (done.returncode, done.stderr) == (0, "")
    hint = f"no demo.rrd is written: recordings need rerun. Install it with: {format_install_command('rerun')}.\n"
    assert done.stdout.startswith(hint)
    assert [path.name for path in tmp_path.iterdir()] == ["demo.png"]


@pytest.mark.parametrize("option", ["--record=a.rrd", "--picture=a.png", "--view", "--web"])
def test_what_needs_rerun_is_refused_before_the_move(small, option):
    """stage move x 8000 --record a.rrd"""
    done = small("from stage.cli import main; sys.exit(main(sys.argv[1:]))", "move", "x", "8000", option)
    name = option.partition("=")[0]
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"stage: {name} needs rerun: pip install -e '.[rerun]' in a checkout of PulseStage.\n"
