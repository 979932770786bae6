"""What a host would run: procedures made of bus cycles, each returning a report.

    from stage import Stage, firmware

    stage = Stage("xyz")
    print(firmware.origin_return(stage.axes["x"]))
    firmware.preset_move(stage.axes["x"], 8000).plot("move.png")

Chips without a stage run the same procedures on a `Bench`.
"""

from collections.abc import Callable

from stage.errors import unknown
from stage.firmware.axis import Axis
from stage.firmware.bench import Bench
from stage.firmware.pcl240.bus import Port
from stage.firmware.pcl240.home import origin_return
from stage.firmware.pcl240.moves import continuous_move, external_count, interrupted_move, preset_move
from stage.firmware.pcl240.plan import Plan, plan
from stage.firmware.pcl240.profile import Profile
from stage.firmware.pcl240.rates import curved_ramp_move, dual_rate_move, speed_change_move
from stage.firmware.pcl240.synchronized import SynchronizedReport, synchronized_move
from stage.firmware.report import Report

PROCEDURES: dict[str, Callable] = {
    f.__name__: f
    for f in (
        preset_move, continuous_move, dual_rate_move, speed_change_move, curved_ramp_move, interrupted_move, external_count,
        origin_return, synchronized_move,
    )
}  # fmt: skip
"""Every procedure by name."""


def procedure(name: str) -> Callable:
    """The procedure called `name`; hyphens do for underscores. Raises ArgumentError with near misses."""
    key = str(name).lower().replace("-", "_")
    if key not in PROCEDURES:
        raise unknown("procedure", name, PROCEDURES)
    return PROCEDURES[key]


__all__ = [
    "Axis", "Bench", "PROCEDURES", "Plan", "Port", "Profile", "Report", "SynchronizedReport", "continuous_move",
    "curved_ramp_move", "dual_rate_move", "external_count", "interrupted_move", "origin_return", "plan", "preset_move",
    "procedure", "speed_change_move", "synchronized_move",
]  # fmt: skip
