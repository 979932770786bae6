"""Fuzz the bus and the MJCF contract. Guided runs need the extra `fuzz`.

python scripts/fuzz.py bus --seconds 60         bus cycles, input edges and clocks on any chip
python scripts/fuzz.py mjcf --seconds 60        a small model with elements dropped, renamed, doubled, odd numbers
python scripts/fuzz.py bus --replay FILE ...    the same checks on given inputs; needs no atheris
python scripts/fuzz.py bus --chip hctl1100      one chip only
python scripts/fuzz.py bus --keep               add to tests/corpus/bus the fewest found inputs that reach further

A guided run follows the coverage (atheris). For `bus` it takes two thirds of the time, with the compiled functions as plain
Python, whose branches atheris sees, and a bound on the work of each advance; then come the chips compiled, beside a twin, at
random mutations of all that was found. Findings are inputs named crash-*, timeout-* or oom-* in build/fuzz/TARGET; a small corpus
in tests/corpus/TARGET is replayed by tests/test_corpus.py. What was done is counted in build/fuzz and printed at the end.
"""

from __future__ import annotations

import argparse
import os
import random
import shlex
import subprocess
import sys
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from fuzzing.promises import Counts, read_counts

ROOT = Path(__file__).resolve().parent.parent
SEEDS, FINDINGS = ROOT / "tests" / "corpus", ROOT / "build" / "fuzz"
BUDGET = 3000  # events of one guided input: a long ramp is nothing new after that


@dataclass(frozen=True)
class Target:
    """Target of the fuzzer: a class that checks inputs, and how atheris measures its coverage.

    Attributes:
        module: Module of the class.
        name: Name of the class.
        max_bytes: Largest length of an input.
        instrumented: Package whose coverage counts.
        before: Modules to import before, without coverage.
        uncompiled: Whether guided runs execute the functions as plain Python; mutations then run compiled.
    """

    module: str
    name: str
    max_bytes: int
    instrumented: str  # the package whose branches count
    before: tuple[str, ...] = ()  # compiled functions cannot be instrumented: these modules are loaded before
    uncompiled: bool = False  # guided as plain Python, and then compiled with mutations

    def load(self) -> type:
        return getattr(import_module(self.module), self.name)


TARGETS = {
    "bus": Target("fuzzing.bus", "Bus", 256, "stage.chips", uncompiled=True),
    "mjcf": Target("fuzzing.mjcf", "MjcfTarget", 12, "stage", ("stage.drives.motors", "stage.sim.engine")),
}


def list_inputs(target: str) -> list[Path]:
    """List the files of the corpus, and all inputs that were found in addition to it."""
    return [f for folder in (SEEDS / target, FINDINGS / target) for f in sorted(folder.glob("*")) if f.is_file()]


def run_child(target: str, run: str, options: list[str], chip: str | None = None) -> int:
    """Fuzz in a new process, and print what it has counted.

    Args:
        target: Key of TARGETS.
        run: Kind of run: "guided", "merge" or "mutations".
        options: Options of libFuzzer, or of the mutations.
        chip: The only chip whose inputs are checked; None: all.

    Returns:
        Exit status of the process; not 0 if there is a finding.
    """
    (FINDINGS / target).mkdir(parents=True, exist_ok=True)
    counts = FINDINGS / f"{target}-{run}.json"
    counts.unlink(missing_ok=True)
    uncompiled = run in ("guided", "merge") and TARGETS[target].uncompiled
    command = [*_make_child_command(target, run, chip), *options]
    status = subprocess.run(command, env={**os.environ, "NUMBA_DISABLE_JIT": str(int(uncompiled))}).returncode
    totals = ", ".join(f"{n:,} {name}" for name, n in read_counts(counts).items())
    print(f"{target}, {run}: {totals or 'nothing done'}; {'no finding' if status == 0 else f'exit status {status}'}")
    return status


def _make_child_command(target: str, run: str, chip: str | None) -> list[str]:
    """Return the command of a process that fuzzes."""
    return [sys.executable, __file__, target, "--inside", run, *(["--chip", chip] if chip else [])]


def run_guided(target: str, seconds: int, chip: str | None) -> int:
    """Run guided fuzzing, and then mutations if the target has compiled code; return the exit code."""
    options = [
        *(f"-max_total_time={seconds}", "-timeout=60", f"-max_len={TARGETS[target].max_bytes}", "-len_control=0"),
        *(
            "-print_final_stats=1",
            f"-artifact_prefix={FINDINGS / target}/",
            str(FINDINGS / target),
            str(SEEDS / target),
        ),
    ]
    return run_child(target, "guided", options, chip)


def keep_inputs(target: str) -> int:
    """Add to the corpus the smallest set of found inputs that reach all branches which the corpus does not reach."""
    return run_child(
        target, "merge", ["-set_cover_merge=1", "-use_counters=0", str(SEEDS / target), str(FINDINGS / target)]
    )


def run_in_child(target: str, run: str, options: list[str], chip: str | None) -> int:
    """Fuzz in this process, started by `run_child`: by atheris with libFuzzer's options, or by mutations for some seconds."""
    counts, source = Counts(FINDINGS / f"{target}-{run}.json"), TARGETS[target]
    only = {"only": chip} if chip else {}
    if run == "compiled":
        from fuzzing.mutation import mutate_for

        seconds, seed = map(int, options)
        pool = [f.read_bytes() for f in list_inputs(target)]
        try:
            return mutate_for(source.load()(counts, **only), pool, seconds, seed, FINDINGS / target, source.max_bytes)
        finally:
            counts.save()
    import atheris

    for name in source.before:
        import_module(name)
    with atheris.instrument_imports(include=[source.instrumented]):
        cls = source.load()
    again = shlex.join(_make_child_command(target, run, chip))  # libFuzzer merges in processes of its own
    atheris.Setup([again, *options], cls(counts, budget=BUDGET, **only))
    atheris.Fuzz()
    return 0


def replay_files(target: str, files: list[Path]) -> None:
    """Check the inputs in some files, and print what was counted."""
    inputs = [f.read_bytes() for f in files]
    check = TARGETS[target].load()()  # may go elsewhere
    for data in inputs:
        check(data)
    digest = getattr(check, "digest", None)  # the same compiled and with NUMBA_DISABLE_JIT=1
    print(f"{len(files)} inputs, no finding{f'; final states {digest.hexdigest()[:16]}' if digest else ''}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", choices=TARGETS)
    parser.add_argument("--seconds", type=int, default=60, help="of all runs together")
    parser.add_argument("--run", choices=["guided", "compiled"], help="only this; bus has both, mjcf is always guided")
    parser.add_argument("--chip", help="bus: inputs of this chip only")
    parser.add_argument("--seed", type=int, default=random.randrange(1 << 32), help="of the compiled run's mutations")
    parser.add_argument("--replay", nargs="+", type=Path, metavar="FILE", help="check these inputs and exit")
    parser.add_argument("--keep", action="store_true", help="enlarge tests/corpus from what was found, and exit")
    parser.add_argument("--inside", metavar="RUN", help=argparse.SUPPRESS)
    args, options = parser.parse_known_args()
    if options and not args.inside:
        parser.error(f"unknown: {' '.join(options)}")
    if args.chip and args.target != "bus":
        parser.error(f"{args.target} has no chips to choose from")
    if args.inside:
        return run_in_child(args.target, args.inside, options, args.chip)
    if args.replay:
        replay_files(args.target, args.replay)
        return 0
    both = TARGETS[args.target].uncompiled
    if args.run == "compiled" and not both:
        parser.error(f"{args.target} has no compiled run of its own")
    runs = [args.run] if args.run else ["guided", "compiled"] if both else ["guided"]
    if (args.keep or "guided" in runs) and find_spec("atheris") is None:
        print("guided fuzzing skipped: atheris is not installed; pip install -e '.[fuzz]' (Linux, macOS)")
        runs = [] if args.keep else [run for run in runs if run != "guided"]
    elif args.keep:
        return keep_inputs(args.target)
    shares = {"guided": args.seconds * 2 // 3, "compiled": args.seconds // 3}
    status = 0
    for run in runs:
        seconds = shares[run] if len(runs) > 1 else args.seconds
        if run == "guided":
            status = run_guided(args.target, seconds, args.chip) or status
        else:
            status = run_child(args.target, run, [str(seconds), str(args.seed)], args.chip) or status
    return status


if __name__ == "__main__":
    sys.exit(main())
