"""tune, and the commands of the benchmark."""

from __future__ import annotations

from typing import Any

from stage.cli.arguments.options import command, machine, model_help
from stage.cli.quantities import MASS


def add(commands: Any) -> None:
    """These commands."""
    _add_tune(commands)
    _add_bench(commands)


def _add_tune(commands: Any) -> None:
    p = command(
        commands, "tune", "tune:run", "registers for an axis: formula, search, proof",
        "Find the registers of one move of an axis: by the data sheet's formula, then by a search that keeps a margin, and prove "
        "them by moves that the search has not seen. Prints registers, bus bytes and a C header.",
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
    g.add_argument("--moves", type=int, default=48, help="moves of a proof (default: 48)")
    g.add_argument("--seed", type=int, default=0, help="the same seed gives the same registers (default: 0)")
    g.add_argument("--workers", type=int, help="threads; the result does not depend on them (default: one a processor)")
    machine(p.add_argument_group("stage"))
    g = p.add_argument_group("output")
    g.add_argument("-o", "--output", metavar="FOLDER", help="write tuned.h, tuned.txt, tuned.json and tuned.png there")
    g.add_argument("--force", action="store_true", help="overwrite files that exist")


PROMISED = "docs/benchmark.md says what is promised, and what is not."


def _add_bench(commands: Any) -> None:
    p = command(
        commands, "bench", "bench:cards", "the tasks of the benchmark and their test episodes",
        "List the tasks of the benchmark, or show one: what is asked, splits, tracks, settings, players that are shipped.",
        ("stage bench", "all tasks"),
        ("stage bench few-shot --json", "one, with the seeds of all test episodes"),
    )  # fmt: skip
    p.add_argument("task", nargs="?", metavar="TASK", help="for example few-shot (default: list them all)")
    p = command(
        commands, "bench-submit", "bench:submit", "play the test episodes of the benchmark, and pack them into a file",
        "Play the test episodes of a split with a policy and write its actions, rewards, scores and versions to a file, which "
        "anybody can replay.",
        ("stage bench-submit formula -o formula.bench", "a player that is shipped"),
        ("stage bench-submit mine:policy -o mine.bench --split weak", "`policy` of mine.py: (observation, info) -> action"),
        ('stage bench-submit moves.npz -o moves.bench --name "by hand"', "recorded actions"),
        more=PROMISED,
    )  # fmt: skip
    p.add_argument(
        "policy", metavar="POLICY", help="module:name, actions.npz, or a player that is shipped: see `stage bench`"
    )
    p.add_argument("-o", "--output", metavar="FILE", required=True, help="of the entry")
    p.add_argument("--task", default="few-shot", help="see `stage bench` (default: few-shot)")
    p.add_argument("--split", default="train", help="where the machines of the episodes come from (default: train)")
    p.add_argument("--track", default="host", help="what the policy sees: host, truth or tools (default: host)")
    p.add_argument("--round", default="open", metavar="NAME", help="whose seeds are played (default: open)")
    p.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting that players may choose")
    p.add_argument("--name", help="of the player (default: POLICY)")
    p.add_argument(
        "--run", dest="run_number", type=int, default=0, metavar="N", help="number of the training run (default: 0)"
    )
    p.add_argument("--notes", default="", help="a line that goes with it")
    p.add_argument(
        "--cost", action="append", default=[], metavar="NAME=NUMBER", help="what it took: moves=, processor_s=, tokens="
    )
    p.add_argument("--episodes", type=int, metavar="N", help="only the first N, for a trial")
    p.add_argument("--force", action="store_true", help="overwrite a file that exists")
    p = command(
        commands, "bench-verify", "bench:verify", "replay an entry of the benchmark and compare it bit for bit",
        "Play the actions of an entry again, without the policy, and compare every reward, observation and score. Exit code 0 if "
        "they are equal, 1 if not, 2 if the file is refused.",
        ("stage bench-verify mine.bench", "plays the actions again and compares bit for bit"),
        ("stage bench-verify mine.bench --tolerance 1e-9", "made on another processor"),
        more=PROMISED,
    )  # fmt: skip
    p.add_argument("file", metavar="FILE", help="an entry, as `stage bench-submit -o FILE` writes it")
    p.add_argument(
        "--tolerance", type=float, metavar="T", help="rewards and scores may differ by so much, as on another processor"
    )
    p = command(
        commands, "bench-table", "bench:table", "compare entries of the benchmark, as tables in Markdown",
        "Print a table for each task, split, track and round: interquartile mean and mean of the return with their intervals, and "
        "who beats whom. Entries of one player are its runs, and have all test episodes. Nothing is replayed.",
        ("stage bench-table formula.bench mine.bench", "who beats whom"),
        ("stage bench-table *.bench --long", "regret, damage and steps, too"),
    )  # fmt: skip
    p.add_argument("files", nargs="+", metavar="FILE")
    p.add_argument("--long", action="store_true", help="with regret, steps lost, end limits and steps of the episodes")
