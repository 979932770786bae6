import json
import subprocess
import sys
from pathlib import Path

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
