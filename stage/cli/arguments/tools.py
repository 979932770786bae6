"""chips, registers, pullout, view."""

from __future__ import annotations

from typing import Any

from stage.cli.arguments.options import command


def add(commands: Any) -> None:
    """These commands."""
    command(
        commands, "chips", "tools:chips", "the chips that there are",
        "List every chip: PulseStage's own, and those that installed packages bring (docs/your_own_chip.md).",
    )  # fmt: skip
    p = command(
        commands, "registers", "tools:registers", "the register map of a chip",
        "Print a chip's registers, commands and status bits with the evidence for each.",
    )  # fmt: skip
    p.add_argument("chip", metavar="CHIP", help="for example pcl240k")
    p = command(
        commands, "pullout", "tools:pullout", "pull-out torque of a motor and drive over speed",
        "Measure at which torque the motor slips, beside the closed form of an ideal drive.",
    )  # fmt: skip
    p.add_argument("--motor", default="17HS4401")
    p.add_argument("--bus-voltage", type=float, default=24.0, help="V (default: 24)")
    p.add_argument("--microsteps", type=int, default=16)
    p.add_argument("--plot", metavar="FILE.png", help="draw the curve")
    p.add_argument("--force", action="store_true", help="overwrite files that exist")
    p = command(
        commands, "view", "tools:view", "look at a model in the MuJoCo viewer",
        "Open a model in MuJoCo's viewer (needs a screen), or print its axes.",
    )  # fmt: skip
    p.add_argument("model", nargs="?", default="xyz")
    p.add_argument("--text", action="store_true", help="print axes, travel and switches instead")
