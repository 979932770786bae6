"""docs/rl_libraries.md: its programs, with the libraries themselves; those not installed (extra `libraries`) are skipped."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from support.pages import agree
from test_docs import ROOT, find_code_blocks

PAGE = ROOT / "docs" / "rl_libraries.md"
CLEANRL = Path(os.environ.get("PULSESTAGE_CLEANRL", ""))  # of a checkout: its scripts are in no package
BLOCKS = {
    re.search(r"^(?:import|from) (stable_baselines3|torchrl|ray|minari)", b.code, re.M)[1]: b
    for b in find_code_blocks(PAGE)
}
OF_1_X = ("lambda obs: np.clip(obs, -10, 10))", "lambda obs: np.clip(obs, -10, 10), None)")

pytestmark = pytest.mark.slow


def run(program: Path, *arguments: str, **more: str) -> str:
    """Run a program and return its output; AssertionError with its error if it fails."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", program.name, *arguments],
        cwd=program.parent, capture_output=True, text=True, check=False, timeout=300, env=os.environ | more,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-4000:]
    return done.stdout


@pytest.mark.parametrize("library", BLOCKS)
def test_the_program_of_the_page_runs_and_prints_what_the_page_says(library, tmp_path):
    needs = {"ray": "ray.rllib.algorithms.ppo", "minari": "minari.data_collector"}
    pytest.importorskip(needs.get(library, library), reason="extra libraries is not installed")
    if library == "minari":
        pytest.importorskip("jax", reason="minari[create] is not installed")
    program = tmp_path / "program.py"
    program.write_text(BLOCKS[library].code)
    message = run(program, MINARI_DATASETS_PATH=str(tmp_path / "minari"))
    message = "".join(line for line in message.splitlines(True) if "torchrl]" not in line)  # its log
    assert agree(message, BLOCKS[library].prints), message


def test_the_cleanrl_script_runs_with_only_the_environment_id_changed(tmp_path):
    for name in ("torch", "tyro", "tensorboard"):
        pytest.importorskip(name, reason="extra libraries is not installed")
    if not CLEANRL.is_file():
        pytest.skip("PULSESTAGE_CLEANRL names no cleanrl/ppo_continuous_action.py of a checkout of CleanRL")
    source = CLEANRL.read_text()
    assert source.count(OF_1_X[0]) == 1
    program = tmp_path / CLEANRL.name
    program.write_text(source.replace(*OF_1_X))
    few = ["--total-timesteps", "32", "--num-steps", "8", "--num-envs", "2", "--num-minibatches", "2", "--no-cuda"]
    assert run(program, "--env-id", "stage.envs:stage/RegisterTuning-v0", *few).count("SPS:") == 2
    assert list(tmp_path.glob("runs/stage.envs:stage/*/events*")), "its log of the run"
