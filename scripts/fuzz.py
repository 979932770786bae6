"""Coverage-guided fuzzing of the bus and of the MJCF contract: pip install 'pulsestage[fuzz]'

python scripts/fuzz.py bus --seconds 60        bus cycles, input edges and clocks on any chip
python scripts/fuzz.py mjcf --seconds 60       a small model with elements dropped, renamed, doubled, odd numbers
python scripts/fuzz.py bus --replay FILE ...   the same checks on given inputs; needs no atheris

`bus` runs the compiled functions as plain Python, so that atheris sees their branches. Findings are inputs named crash-*,
timeout-* or oom-* in build/fuzz/TARGET; a small corpus of inputs in tests/corpus/TARGET is replayed by tests/test_corpus.py.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SEEDS, FOUND = ROOT / "tests" / "corpus", ROOT / "build" / "fuzz"
LONGEST = 1 << 14  # clocks of one advance, and
TOTAL = 1 << 16  # of one input
RAMPS = 8  # of one advance, each of 8191 steps at most: a write or an edge could cause more, an advance has none
SECONDS_PER_ADVANCE = 5.0
MOST_BYTES = {"bus": 512, "mjcf": 12}


class Finding(AssertionError):
    """A promise that an input breaks."""


def demand(holds: bool, what: str) -> None:
    if not holds:
        raise Finding(what)


# --- bus ---


def spans_counted():
    """A list whose one number counts the events of the cores that run uncompiled, or None where they are compiled."""
    from stage.chips.pcl240 import core
    from stage.compiled import COMPILED

    if COMPILED:
        return None
    span, counted = core._span, [0]

    def counting(c, n):
        counted[0] += 1
        return span(c, n)

    core._span = counting
    return counted


class Bus:
    """Bytes as a host's doings: the chip, then one operation at a time."""

    def __init__(self) -> None:
        from stage.chips import CHIPS

        self.classes, self.events = list(CHIPS.values()), spans_counted()

    def __call__(self, data: bytes) -> None:
        if not data:
            return
        chip = self.classes[data[0] % len(self.classes)]()
        inputs, at, left = list(chip.INPUTS), 1, TOTAL
        while at < len(data):
            op, at = data[at], at + 1
            kind, low = op >> 5, op & 0x1F
            byte = data[at] if at < len(data) else 0
            if kind <= 2:  # a raw write
                chip.write(low, byte)
                at += 1
            elif kind == 3:  # a whole register
                value = int.from_bytes(data[at : at + 3], "big")
                chip.write(0, 0x80 | low)
                for address in (3, 2, 1):
                    chip.write(address, value >> 8 * (address - 1) & 0xFF)
                at += 3
            elif kind == 4:
                setattr(chip.pins, inputs[low % len(inputs)], bool(low & 0x10))
            elif kind == 5:
                demand(0 <= chip.read(low) <= 0xFF, "a read is no byte")
            else:  # 2^(low / 1.5) clocks and some
                clocks = min(int(2 ** (low / 1.5)) + (byte if kind == 7 else 0), LONGEST, left)
                at += kind == 7
                left -= clocks
                self.advance(chip, clocks)
            self.check(chip)

    def advance(self, chip, clocks: int) -> None:
        before, wall = chip.clock, time.process_time()
        if self.events:
            self.events[0] = 0
        pulses = chip.advance(clocks)
        demand(chip.clock == before + clocks, "time did not pass as asked")
        demand(0 <= pulses <= clocks, f"{pulses} pulses in {clocks} clocks")
        demand(
            time.process_time() - wall < SECONDS_PER_ADVANCE,
            f"{clocks} clocks took more than {SECONDS_PER_ADVANCE} s of processor time",
        )
        if self.events:
            most = min(clocks, RAMPS * 8192) + 8
            demand(self.events[0] <= most, f"{self.events[0]} events in {clocks} clocks, at most {most}")

    def check(self, chip) -> None:
        values, pins = chip.values(), chip.pins
        for r in chip.MAP.registers:
            demand(0 <= values[r.name] <= r.mask, f"{r.name} = {values[r.name]} is wider than {r.bits} bits")
        status = values["status"]
        for bit, pin in ((0x20, "fkeep"), (0x10, "lt"), (0x08, "zero"), (0x02, "org"), (0x01, "ins")):
            demand(bool(status & bit) == getattr(pins, pin), f"status {status:02X}h and pin {pin} disagree")
        demand(bool(status & 0x80) != pins.irq, f"status {status:02X}h and irq disagree")
        demand(bool(status & 0x40) != pins.hold, f"status {status:02X}h and hold disagree")
        demand(pins.fup + pins.fkeep + pins.fdown == 1, "not one of FUP, FKEEP, FDOWN")
        if self.events is not None:  # words of the state are small where arithmetic is Python's
            demand(0 <= chip._record["phase"] < max(8192 * values["R7"], 1) + 8192, f"phase {chip._record['phase']}")
        demand(0 <= chip._record["speed"] <= 8191, f"speed {chip._record['speed']}")


# --- mjcf ---

NUMBERS = [*"0 -0 1 -1 nan inf -inf 1e300 -1e300 1e-300 1e-9 0.5 1e6 2147483648 x".split(), "", "0 0", "1 2 3 4 5 6 7"]
STRINGS = [*" x y vane carriage x_el_plus x_org found hinge free ball \u00b5 false".split(" "), "dist found force"]


class Mjcf:
    """Bytes as changes of the complete model in docs/models.md, four bytes each: what, where, which attribute, to what."""

    def __init__(self) -> None:
        page = (ROOT / "docs" / "models.md").read_text(encoding="utf-8")
        self.model = re.search(r"```xml\n(<mujoco.*?)```", page, re.DOTALL).group(1)  # type: ignore[union-attr]
        self.folder = tempfile.TemporaryDirectory()
        os.chdir(self.folder.name)  # MuJoCo writes its log where it stands

    def mutated(self, data: bytes) -> str:
        root = ET.fromstring(self.model)
        for k in range(0, min(len(data), 32) - 3, 4):
            what, where, which, value = data[k : k + 4]
            parents = [(p, c) for p in root.iter() for c in p]
            if not parents:
                break
            parent, child = parents[where % len(parents)]
            keys = sorted(child.attrib)
            kind = what % 6
            if kind == 0:
                parent.remove(child)
            elif kind == 1:
                parent.append(ET.fromstring(ET.tostring(child)))
            elif kind == 2 and keys:
                del child.attrib[keys[which % len(keys)]]
            elif kind == 3 and keys:
                child.set(keys[which % len(keys)], NUMBERS[value % len(NUMBERS)])
            elif kind == 4 and keys:
                child.set(keys[which % len(keys)], STRINGS[value % len(STRINGS)])
            elif kind == 5:
                other = parents[value % len(parents)][0]
                if other is not child and other not in list(child.iter()):
                    parent.remove(child)
                    other.append(child)
        return ET.tostring(root, encoding="unicode")

    def __call__(self, data: bytes) -> None:
        import numpy as np

        from stage import Stage, StageError

        path = Path(self.folder.name) / "model.xml"
        path.write_text(self.mutated(data), encoding="utf-8")
        try:
            stage = Stage(path)
            stage.run(0.01)
        except StageError as error:
            demand(bool(str(error).strip()), f"{type(error).__name__} without a word")
            return
        demand(
            bool(np.isfinite(stage.data.qpos).all() and np.isfinite(stage.data.qvel).all()), "not a number in the state"
        )


TARGETS = {"bus": Bus, "mjcf": Mjcf}


def fuzz(target: str, seconds: int) -> int:
    """Fuzz in a process of its own. Returns its exit status; not 0 means a finding."""
    try:
        import atheris  # noqa: F401
    except ImportError:
        print("fuzzing skipped: atheris is not installed; pip install 'pulsestage[fuzz]' (Linux, macOS)")
        return 0
    found, seeds = FOUND / target, SEEDS / target
    found.mkdir(parents=True, exist_ok=True)
    seeds.mkdir(parents=True, exist_ok=True)
    options = [
        *(f"-max_total_time={seconds}", "-timeout=60", f"-max_len={MOST_BYTES[target]}"),
        *("-len_control=0", "-print_final_stats=1", f"-artifact_prefix={found}/"),
    ]
    command = [sys.executable, __file__, target, "--inside", *options, str(found), str(seeds)]
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"} if target == "bus" else dict(os.environ)
    return subprocess.run(command, env=environment).returncode


def inside(target: str, options: list[str]) -> None:
    import atheris

    if target == "mjcf":  # compiled functions cannot be instrumented: load them before
        import stage.drives.motors
        import stage.engine

        with atheris.instrument_imports(include=["stage"]):
            import stage.machine
            import stage.plant
    else:
        with atheris.instrument_imports(include=["stage.chips"]):
            import stage.chips  # noqa: F401
    atheris.Setup([sys.argv[0], *options], TARGETS[target]())
    atheris.Fuzz()


def main() -> int:
    parser = argparse.ArgumentParser(description="Fuzz the bus or the MJCF contract.")
    parser.add_argument("target", choices=TARGETS)
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--replay", nargs="+", type=Path, metavar="FILE", help="check these inputs and exit")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    given, options = parser.parse_known_args()
    if options and not given.inside:
        parser.error(f"unknown: {' '.join(options)}")
    if given.replay:
        files = [f.resolve() for f in given.replay]
        check = TARGETS[given.target]()
        for f in files:
            check(f.read_bytes())
        print(f"{len(files)} inputs, no finding")
        return 0
    if given.inside:
        inside(given.target, options)
        return 0
    return fuzz(given.target, given.seconds)


if __name__ == "__main__":
    sys.exit(main())
