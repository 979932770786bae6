"""scripts/quick.py: which tests `make quick` runs for a change."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def quick():
    sys.path.insert(0, str(ROOT))
    try:
        from scripts import quick
    finally:
        sys.path.remove(str(ROOT))
    return quick


@pytest.fixture(scope="module")
def graph(quick):
    return quick.Imports()


@pytest.mark.parametrize(
    ("change", "near"),
    [
        (
            "stage/chips/pcl240/motion.py",
            "tests/chips/test_pcl240k_statements.py",
        ),  # compiled, and imported for its class alone
        ("stage/panel/sampler.py", "tests/panel/test_sampler.py"),
        ("stage/cli/move.py", "tests/test_cli_options.py"),
        ("stage/board/pulsestage.h", "tests/board/test_library.py"),  # no module
        ("docs/panel.md", "tests/test_docs.py"),
        ("tests/test_cli.py", "tests/test_cli.py"),
    ],
)
def test_the_tests_that_import_a_changed_file_directly_come_first(quick, graph, change, near):
    selected = quick.select_tests({ROOT / change}, graph)
    assert ROOT / near in selected[:15]


def test_a_chip_of_another_family_and_the_panel_are_not_tested_after_a_change_that_they_do_not_import(quick, graph):
    selected = quick.select_tests({ROOT / "envs/origin_return.py"}, graph)
    assert ROOT / "tests/envs/test_origin_return.py" in selected
    assert not [path for path in selected if path.parent.name in ("chips", "panel")]


@pytest.mark.parametrize(("seconds_left", "count"), [(-1, 0), (600, 1)])
def test_no_test_begins_after_the_deadline(tmp_path, seconds_left, count):
    (tmp_path / "test_it.py").write_text("def test_it(): open('ran', 'w').close()")
    env = os.environ | {"PULSESTAGE_DEADLINE": str(time.time() + seconds_left), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "pytest", "-p", "scripts.quick", str(tmp_path / "test_it.py")]
    subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, check=True)
    assert len(list(tmp_path.glob("ran"))) == count
