"""Procedures that a host runs: each consists of bus cycles and returns a report.

    from stage import Stage, firmware

    machine = Stage("xyz", chips="mcx514")
    print(firmware.home(machine.axes["x"]))
    print(firmware.move(machine.axes["x"], 10e-3))

move, home, square_gantry, line, jog and stop work with every chip. begin_move, begin_home, begin_jog and begin_stop return at
once, and the action goes on while time passes; `read_axis_state` shows an axis to any thread. preset_move, origin_return and
others are procedures of the PCL-240's data sheet; `stage.firmware.nova` and `stage.firmware.hctl1100` have the procedures that
only these families offer.

A `Bench` runs the same procedures on chips without a stage.
"""

from collections.abc import Callable

from stage.errors import unknown_name_error
from stage.firmware.axis import Axis
from stage.firmware.axis_actions import AxisAction, find_action
from stage.firmware.axis_state import AxisState, read_axis_state
from stage.firmware.chip_bench import Bench
from stage.firmware.gantry_homing import square_gantry
from stage.firmware.move_report import Report
from stage.firmware.pcl240.chip_port import ChipPort
from stage.firmware.pcl240.line_plan import Plan, plan
from stage.firmware.pcl240.moves import continuous_move, external_count, interrupted_move, preset_move
from stage.firmware.pcl240.origin_return import origin_return
from stage.firmware.pcl240.rate_change_moves import curved_ramp_move, dual_rate_move, speed_change_move
from stage.firmware.pcl240.speed_profile import Profile
from stage.firmware.pcl240.synchronized_move import synchronized_move
from stage.firmware.procedures import begin_home, begin_jog, begin_move, begin_stop, home, jog, line, move, stop
from stage.firmware.synchronized_report import SynchronizedReport

PROCEDURES: dict[str, Callable] = {
    f.__name__: f
    for f in (
        preset_move, continuous_move, dual_rate_move, speed_change_move, curved_ramp_move, interrupted_move, external_count,
        origin_return, synchronized_move, move, home, line, jog, stop,
    )
}  # fmt: skip
"""Every procedure by name."""


def find_procedure(name: str) -> Callable:
    """Return the procedure with this name.

    Args:
        name: Name, with underscores or hyphens.

    Raises:
        ArgumentError: There is no such procedure; the message lists similar names.
    """
    key = str(name).lower().replace("-", "_")
    if key not in PROCEDURES:
        raise unknown_name_error("procedure", name, PROCEDURES)
    return PROCEDURES[key]


__all__ = [
    "Axis", "AxisAction", "AxisState", "Bench", "PROCEDURES", "Plan", "ChipPort", "Profile", "Report", "SynchronizedReport",
    "begin_home", "begin_jog", "begin_move", "begin_stop", "continuous_move", "curved_ramp_move", "dual_rate_move",
    "external_count", "find_action", "home", "interrupted_move", "jog", "line", "move", "origin_return", "plan", "preset_move",
    "find_procedure", "read_axis_state", "speed_change_move", "square_gantry", "stop", "synchronized_move",
]  # fmt: skip
