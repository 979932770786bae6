"""list, chips, registers, pullout, view, new-model, completion."""

from __future__ import annotations

from typing import Any

from stage.cli.arguments.options import ALL, command, model_help
from stage.cli.quantities import VOLTAGE


def add(commands: Any) -> None:
    """These commands."""
    p = command(
        commands, "list", "tools:list_", "the chips, motors and models that there are",
        "List what --chips, --motor and --model take.",
        ("stage list motors", "names for --motor"),
        ("stage list models", "names for --model"),
    )  # fmt: skip
    p.add_argument("what", choices=("chips", "motors", "models"))
    command(
        commands, "chips", "tools:chips", "the chips that there are",
        "List every chip: PulseStage's own, and those that installed packages bring (docs/your_own_chip.md).",
        ("stage chips", "names for --chips, and where they come from"),
    )  # fmt: skip
    p = command(
        commands, "registers", "tools:registers", "the register map of a chip",
        "Print a chip's registers, commands and status bits with the evidence for each.",
        ("stage registers pcl240k", "the whole map"),
        ("stage registers mcx514 | less", "page by page"),
    )  # fmt: skip
    chip = p.add_argument("chip", metavar="CHIP", help="for example pcl240k; `stage chips` has them all")
    chip.known = ALL  # type: ignore[attr-defined]
    p = command(
        commands, "pullout", "tools:pullout", "pull-out torque of a motor and drive over speed",
        "Simulate at which torque the motor slips, beside the closed form of an ideal drive.",
        ("stage pullout --motor 17HS4401 --plot pullout.png", "the curve, drawn"),
        ("stage pullout --bus-voltage 48", "with another supply"),
    )  # fmt: skip
    p.add_argument("--motor", default="17HS4401")
    p.add_argument("--bus-voltage", type=VOLTAGE, default=24.0, help="V (default: 24)")
    p.add_argument("--microsteps", type=int, default=16)
    p.add_argument("--plot", metavar="FILE.png", help="draw the curve")
    p.add_argument("--force", action="store_true", help="overwrite files that exist")
    p = command(
        commands, "view", "tools:view", "look at a model in the MuJoCo viewer",
        "Open a model in MuJoCo's viewer (needs a screen), or print its axes, or draw it.",
        ("stage view xyz --text", "axes, travel, switches"),
        ("stage view my.xml --picture my.png", "a picture with the axes' names"),
    )  # fmt: skip
    p.add_argument("model", nargs="?", default="xyz", help=model_help())
    p.add_argument("--text", action="store_true", help="print axes, travel and switches instead")
    p.add_argument("--picture", metavar="FILE.png", help="draw it instead, no screen needed")
    p.add_argument("--camera", metavar="NAME", help="a camera of the model (default: overview, or one that sees all)")
    p.add_argument("--force", action="store_true", help="overwrite files that exist")
    p = command(
        commands, "new-model", "new_model:run", "a commented MJCF of your own axes, to begin with",
        "Write an MJCF that keeps the naming contract (docs/models.md): screws and tables with limit switches, hard stops and "
        "motors, each on the one before. Its numbers are for you to change.",
        ("stage new-model --axes x:slide:300mm -o my.xml", "one axis"),
        ("stage new-model --axes x:slide:300mm,z:slide:80mm,a:hinge:360deg -o my.xml", "three, each on the one before"),
        ("stage home --model my.xml", "and they go home"),
    )  # fmt: skip
    p.add_argument(
        "--axes",
        default="x:slide:300mm,y:slide:200mm",
        metavar="NAME:KIND:TRAVEL,...",
        help="x:slide:300mm, or a:hinge:90deg; the travel is that between the end limits; 360deg turns without end (default: "
        "x:slide:300mm,y:slide:200mm)",
    )
    p.add_argument("-o", "--output", metavar="FILE.xml", help="where to; - prints it (default: -)")
    p.add_argument("--force", action="store_true", help="overwrite a file that exists")
    p = command(
        commands, "completion", "tools:completion", "completion of commands and options for a shell",
        "Print what makes a shell complete this command line by Tab.",
        ('eval "$(stage completion bash)"', "in ~/.bashrc"),
        ('eval "$(stage completion zsh)"', "in ~/.zshrc"),
        ("stage completion fish | source", "in ~/.config/fish/config.fish"),
        json=False,
    )  # fmt: skip
    p.add_argument("shell", choices=("bash", "zsh", "fish"))
