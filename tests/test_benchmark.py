import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "scripts" / "benchmark.py"


def test_the_benchmark_gives_every_figure_with_its_spread_and_names_the_targets(tmp_path):
    path = tmp_path / "bench.json"
    command = [sys.executable, str(SCRIPT), "--quick", "--rounds", "2", "--only", "chips", "--json", str(path)]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    figures = json.loads(path.read_text())["figures"]
    assert {"chips.constant", "chips.ramp", "chips.s_curve", "chips.traced"} <= set(figures)
    for figure in figures.values():
        assert 0 < figure["least"] <= figure["median"] <= figure["most"]
    for key in ("chips.constant", "chips.traced"):
        assert figures[key]["target"]["name"] in output
    assert "not measured" in output


@pytest.mark.parametrize(
    "module",
    [
        *(f"{path.parent.name}.{path.stem}" for path in sorted((SCRIPT.parent / "bench").glob("[a-z]*.py"))),
        "worked_examples.__main__",
    ],
)
def test_every_module_of_the_benchmark_and_the_worked_examples_can_be_imported(module, monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPT.parent))
    import_module(module)
