"""scripts/firmware/scheduler: a tick switches between a task that moves an axis and one that blinks."""

from __future__ import annotations

from pathlib import Path

from stage import Stage
from stage.board import Board, NativeHost
from stage.chips import PCL240MK

EXAMPLES = Path(__file__).resolve().parents[2] / "scripts" / "firmware"


def test_two_tasks_run_alternately(firmware):  # `firmware` skips where there is no compiler
    sources = [*sorted((EXAMPLES / "scheduler").glob("*.c")), EXAMPLES / "pcl240mk" / "pcl240.c"]
    stage = Stage("xy", chips=PCL240MK, visuals=False)
    flags = (f"-I{EXAMPLES / 'hal'}", "-Wall", "-Wextra", "-Werror")
    host = NativeHost([*sources, EXAMPLES / "hal" / "hal_pulsestage.c"], Board(stage), flags=flags)
    assert host.run(timeout=5).code == 0
    printed_text = [text for _, text in host.log]
    assert printed_text[-1] == "move: done, result 0"
    assert printed_text.count("lamp on") >= 3
    assert abs(stage.axes["x"].position - 2000 * stage.axes["x"].meters_per_pulse) < 2e-5
