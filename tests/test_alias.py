"""The package `pulsestage` is `stage`, as a program sees it that imports the name of the distribution."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def run_program(tmp_path):
    """Return a function that runs Python with `pulsestage` on its path as an installation has it; it returns the output."""
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "pulsestage").symlink_to(ROOT / "stage" / "support" / "alias")

    def run(*arguments):
        path = os.pathsep.join([str(tmp_path / "site"), os.environ.get("PYTHONPATH", "")])
        done = subprocess.run(
            [sys.executable, *arguments],
            env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False, cwd=tmp_path,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return run


def test_both_names_give_the_same_modules_in_any_order_of_imports(run_program):
    program = """
import pickle
import pulsestage, stage
assert pulsestage.chips is stage.chips  # loaded at the first access
from pulsestage.chips import PCL240K
import pulsestage.chips.pcl240.core
import stage.chips, stage.units
import pulsestage.units as units
from pulsestage import firmware
assert pulsestage is stage and pulsestage.chips is stage.chips and PCL240K is stage.chips.PCL240K
assert pulsestage.chips.pcl240.core is stage.chips.pcl240.core and units is stage.units and firmware is stage.firmware
assert stage.units.__spec__.name == stage.units.__name__ == "stage.units"
assert pickle.loads(pickle.dumps(pulsestage.ArgumentError)) is stage.ArgumentError
assert pickle.loads(b"cpulsestage.units\\nUnit\\n.") is stage.units.Unit
print(PCL240K.__module__)
"""
    assert run_program("-c", program).startswith("stage.chips")


def test_an_unknown_module_below_the_alias_is_reported_by_the_name_that_was_typed(run_program):
    program = "try: import pulsestage.chipz\nexcept ModuleNotFoundError as error: print(error)"
    assert "No module named 'pulsestage.chipz'" in run_program("-c", program)


def test_the_alias_runs_as_a_program(run_program):
    assert run_program("-m", "pulsestage", "--version").startswith("pulsestage ")
