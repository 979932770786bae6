"""tune, and the commands of the benchmark."""

from __future__ import annotations

from typing import Any

from stage.cli.arguments.options import command, machine, model_help
from stage.cli.quantities import MASS


def add(commands: Any) -> None:
    """These commands."""
    _add_tune(commands)


def _add_tune(commands: Any) -> None:
    p = command(
        commands, "tune", "tune:run", "registers for an axis: formula, search, proof",
        "Find the registers of one move of an axis: by the data sheet's formula, then by a search that keeps a margin, and prove "
        "them by machines that the search has not seen, drawn from the evidence of motor, supply and friction. Prints registers, "
        "bus bytes and a C header.",
        ("stage tune xy --payload 2 --distance 100mm", "a PCL-240 on the X axis of xy: prints registers, bytes and C"),
        ("stage tune xy --payload 2 --distance 100mm -o tuned", "the same as files, with a picture"),
        ("stage tune my.xml --axis z --chips mcx514 --payload 0.5 --spare 0.2 --distance 20mm", ""),
        ("stage tune xy --distance 8000 --settle 20um 100ms --by formula", "without Optuna"),
        more="docs/tuning.md says how it works, and what the proof proves.",
    )  # fmt: skip
    p.add_argument("model", nargs="?", default="xyz", help=model_help())
    p.add_argument("--axis", help="the axis (default: the first of the model)")
    p.add_argument("--distance", help="of the move: 100mm, -30deg, or pulses (of a servo counts)")
    p.add_argument("--payload", type=MASS, default=0.0, metavar="KG", help="that it carries at most (default: 0)")
    p.add_argument(
        "--payload-on",
        metavar="NAME",
        help="body or site that carries it (default: site work, if it rides on the axis, else what the axis moves)",
    )
    p.add_argument(
        "--spare",
        default="30%",
        metavar="KG|PERCENT",
        help="margin: so much more payload, and still no step is lost; percent of the payload, or without one of what the axis "
        "moves by itself (default: 30%%)",
    )
    p.add_argument(
        "--settle",
        nargs=2,
        metavar=("WITHIN", "FOR"),
        help="arrived is who stays within WITHIN of the goal for FOR: 50um 50ms (default: a full step, of a servo 10 counts; 50ms)",
    )
    p.add_argument("--overshoot", metavar="LENGTH", help="no move goes farther beyond its goal (default: twice WITHIN)")
    p.add_argument(
        "--site", metavar="NAME", help="site or body whose place counts, as a camera on a mast (default: the axis)"
    )
    g = p.add_argument_group("search")
    g.add_argument("--by", choices=("search", "formula"), default="search", help="formula: no search, no Optuna needed")
    g.add_argument("--trials", type=int, default=200, help="registers that are tried (default: 200)")
    g.add_argument("--moves", type=int, default=96, help="machines drawn for a proof, each makes a move (default: 96)")
    g.add_argument("--seed", type=int, default=0, help="the same seed gives the same registers (default: 0)")
    g.add_argument("--workers", type=int, help="threads; the result does not depend on them (default: one a processor)")
    machine(p.add_argument_group("stage"))
    g = p.add_argument_group("output")
    g.add_argument("-o", "--output", metavar="FOLDER", help="write tuned.h, tuned.txt, tuned.json and tuned.png there")
    g.add_argument("--force", action="store_true", help="overwrite files that exist")
