"""What a host would run: procedures made of bus cycles, each returning a report.

    from stage import Stage, firmware

    stage = Stage("xyz")
    print(firmware.origin_return(stage.axes["x"]))
    firmware.preset_move(stage.axes["x"], 8000).plot("move.png")
"""

from stage.firmware.axis import Axis, Bench
from stage.firmware.bus import Port
from stage.firmware.moves import (
    continuous_move,
    dual_rate_move,
    external_count,
    interrupted_move,
    preset_move,
    speed_change_move,
)
from stage.firmware.origin import origin_return
from stage.firmware.plan import Plan, plan
from stage.firmware.profile import Profile
from stage.firmware.report import Report
from stage.firmware.synchronized import SynchronizedReport, synchronized_move

__all__ = [
    "Axis", "Bench", "Plan", "Port", "Profile", "Report", "SynchronizedReport", "continuous_move", "dual_rate_move",
    "external_count", "interrupted_move", "origin_return", "plan", "preset_move", "speed_change_move", "synchronized_move",
]  # fmt: skip
