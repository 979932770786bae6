"""Commands that show what there is."""

import os
import shlex
import shutil
import subprocess
import sys

import pytest

from stage.cli import main
from stage.drives.dc_motors import DC_MOTORS
from stage.drives.motors import MOTORS
from stage.sim import plant


@pytest.mark.parametrize(
    ("what", "names"),
    [("motors", [*MOTORS, *DC_MOTORS]), ("models", plant.list_model_names()), ("chips", ["PCL240K", "MCX514"])],
)
def test_list_prints_the_motors_models_and_chips(what, names, capsys):
    # stage list motors
    assert main(["list", what]) == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert set(names) <= set(listed)


def test_a_model_is_drawn_with_the_names_of_its_axes(tmp_path, capsys):
    # stage view xy --picture xy.png
    import matplotlib.image

    file = tmp_path / "xy.png"
    assert main(["view", "xy", "--picture", str(file)]) == 0
    image = matplotlib.image.imread(file)
    assert image.shape[:2] == (900, 1600)
    assert image[..., :3].std() > 0.05
    assert main(["view", "xy", "--picture", str(file)]) == 2
    assert main(["view", "xy", "--picture", str(file), "--force", "--camera", "frnt"]) == 2
    assert "front" in capsys.readouterr().err


BASH_SCRIPT = """
eval "$(stage completion bash)"
complete_line() {
    COMP_LINE="$1" COMP_POINT=${#1} COMP_TYPE=9 COMP_WORDS=($1) COMPREPLY=()
    [[ "$1" == *" " ]] && COMP_WORDS+=("")
    COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
    _python_argcomplete stage "${COMP_WORDS[$COMP_CWORD]}" "${COMP_WORDS[$COMP_CWORD - 1]}"
    echo "${COMPREPLY[@]}"
}
"""


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes_names_also_after_an_equals_sign(tmp_path):
    """stage move x 1mm --chips x=mcx51<Tab>, in a bash that has read the script of `stage completion bash`"""
    wanted = {
        "stage view xyz": "xyz xyz_servo",
        "stage move x 1mm --chips x=mcx51": "mcx514 mcx512",
        "stage sync --model xy ": "x= y=",
    }
    shim = tmp_path / "stage"
    shim.write_text(f'#!/bin/sh\nexec {sys.executable} -m stage "$@"\n')
    shim.chmod(0o755)
    lines = "".join(f"complete_line {shlex.quote(line)}\n" for line in wanted)
    done = subprocess.run(
        ["bash", "-c", BASH_SCRIPT + lines], env=os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"},
        capture_output=True, text=True, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert [line.strip() for line in done.stdout.splitlines()] == list(wanted.values()), done.stderr


def complete_line(line):
    """Return the words that a shell is offered for the end of a line. A copy of this process answers, which then ends itself."""
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        try:
            os.environ |= {
                "_ARGCOMPLETE": "1",
                "COMP_LINE": line,
                "COMP_POINT": str(len(line)),
                "_ARGCOMPLETE_IFS": "\n",
            }
            os.dup2(writing, 8)
            main([])
        finally:
            os._exit(1)
    os.close(writing)
    with os.fdopen(reading) as answer:
        words = answer.read().splitlines()
    assert os.waitpid(child, 0)[1] == 0
    return [word.partition(":")[0].strip() for word in words]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot copy a process")
@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("stage ne", "new-model"), ("stage home --mo", "--model --motor"), ("stage list mo", "models motors"),
        ("stage view xy_", "xy_mast"), ("stage move x 1 --chips MCX31", "MCX312 MCX314AS"), ("stage export ", "a.rrd"),
        ("stage move x 1mm --chips pcl", "pcl240k pcl240mk pcl240ms"), ("stage registers HC", "HCTL1100"),
        ("stage move x 1mm --motor 17HS4", "17HS4401"), ("stage move x 1mm --drive tb", "tb6600"),
        ("stage move --model gantry ", "w x y"), ("stage fault ja", "jam"), ("stage example sta", "stall"),
    ],
)  # fmt: skip
def test_a_shell_is_offered_commands_options_names_and_files(line, wanted, tmp_path, monkeypatch):
    """stage hom<Tab>; stage home --mo<Tab>; stage view xy_<Tab>; stage export <Tab> in a folder with a recording"""
    monkeypatch.chdir(tmp_path)
    for name in ("a.rrd", "b.txt"):
        (tmp_path / name).touch()
    offered = [word for word in complete_line(line) if not word.startswith("-") or "--mo" in word]
    assert " ".join(sorted(offered)) == wanted
