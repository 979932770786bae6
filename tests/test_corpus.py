"""Inputs that the fuzzer begins with, found or thought of, keep the promises every day; `make fuzz` looks for more."""

import dataclasses
import json
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "scripts"))
import fuzz
from fuzzing.bus import FAMILIES, ORDER, Bus, Run, make_family
from fuzzing.family import Family
from fuzzing.mutation import mutate_for
from fuzzing.promises import Counts, Finding, read_counts

from stage.chips import CHIPS, PCL240K
from stage.chips.journal import Journal

CORPUS = Path(__file__).parent / "corpus"


def list_inputs(target):
    return sorted((CORPUS / target).iterdir())


def replay_corpus(target):
    """The corpus of one target, checked; the check that it went through."""
    check = fuzz.TARGETS[target].load()()
    for path in list_inputs(target):
        print(path.name)
        check(path.read_bytes())
    return check


def run_uncompiled(program):
    """Run a program in Python with numba disabled and return its standard output."""
    return subprocess.run(
        [sys.executable, "-c", program], env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        cwd=Path(__file__).parent, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip


@pytest.mark.parametrize("target", fuzz.TARGETS)
def test_a_corpus_is_small_and_of_inputs_that_the_fuzzer_can_reach(target):
    sizes = [path.stat().st_size for path in list_inputs(target)]
    assert 10 <= len(sizes) <= 64
    assert sum(sizes) <= 60_000
    assert max(sizes) <= fuzz.TARGETS[target].max_bytes


def test_a_corpus_has_inputs_for_every_chip_of_a_known_family():
    kinds = {path.read_bytes()[0] for path in list_inputs("bus")}
    assert kinds >= {k for k, chip in enumerate(ORDER) if issubclass(CHIPS[chip], tuple(FAMILIES))}
    assert set(ORDER) >= set(CHIPS.built_in)


def test_every_model_of_the_corpus_is_refused_with_words_or_runs(monkeypatch):
    monkeypatch.chdir(os.curdir)  # the target changes it
    counts = replay_corpus("mjcf").counts
    assert counts["inputs"] == len(list_inputs("mjcf"))
    assert counts["refused"] >= 5
    assert counts["models that loaded"] >= 2


def test_every_bus_input_of_the_corpus_keeps_the_promises_compiled_or_not_to_the_same_bits():
    """Compiled beside a twin; uncompiled with a bound on the work of each advance."""
    check = replay_corpus("bus")
    assert min(check.counts[what] for what in ("bus cycles", "input edges", "clocks", "pulses")) > 0
    other = run_uncompiled(
        "import json, test_corpus as t; c = t.replay_corpus('bus'); print(json.dumps([c.digest.hexdigest(), c.counts]))"
    )
    assert json.loads(other.splitlines()[-1]) == [check.digest.hexdigest(), check.counts]


PLANTED = """
import test_corpus as t
from fuzzing.pcl240 import COMPILED, counted_core
from stage.chips.pcl240 import motion
assert not COMPILED
cruise, span, pulses = motion._run_at_constant_speed, motion.run_to_event, motion._count_pulses_to_event
for name, defect in (
    ("_run_at_constant_speed", lambda c, until: cruise(c, min(until, c.clock + 1000))),
    ("run_to_event", lambda c, n: span(c, min(n, 64))),
    ("_count_pulses_to_event", lambda c, own: min(1, pulses(c, own))),
):
    setattr(motion, name, defect)
    counted_core.cache_clear()
    try:
        t.replay_corpus("bus")
    except t.Finding as finding:
        print("FOUND", finding)
    motion._run_at_constant_speed, motion.run_to_event, motion._count_pulses_to_event = cruise, span, pulses
"""

PLANTED_NOVA = """
import test_corpus as t
from fuzzing.nova import COMPILED, counted_core
from stage.chips.nova import core
from stage.chips.nova.motion import single_axis_drive
assert not COMPILED
settle = core._process_due_events
def settle_by_the_clock(c):
    settle(c)
    c.quiet_until = min(c.quiet_until, c.clock + 1000)
for module, name, wrong in (
    (single_axis_drive, "count_pulses_to_event", lambda c, x: 1),
    (core, "_process_due_events", settle_by_the_clock),
):
    right = getattr(module, name)
    setattr(module, name, wrong)
    counted_core.cache_clear()
    check = t.Bus()
    try:
        for path in t.list_inputs("bus"):
            if path.name.startswith("nova"):
                check(path.read_bytes())
    except t.Finding as finding:
        print("FOUND", finding)
    setattr(module, name, right)
"""

PLANTED_HCTL = """
import test_corpus as t
from stage.chips.hctl1100 import core
from stage.native import COMPILED
assert not COMPILED
check = t.Bus()
def twice(c, until, sample=core._run_sample):
    sample(c, until)
    sample(c, until)
core._run_sample = twice
try:
    for path in t.list_inputs("bus"):
        if path.name.startswith("hctl1100"):
            check(path.read_bytes())
except t.Finding as finding:
    print("FOUND", finding)
"""


@pytest.mark.parametrize(("program", "defects"), [(PLANTED, 3), (PLANTED_NOVA, 2), (PLANTED_HCTL, 1)])
def test_a_core_that_works_by_the_clock_or_by_the_pulse_is_a_finding(program, defects):
    findings = [line for line in run_uncompiled(program).splitlines() if line.startswith("FOUND")]
    assert ["calls for" in line for line in findings] == [True] * defects


def test_a_chip_that_breaks_a_promise_is_a_finding(monkeypatch):
    check = Bus()
    monkeypatch.setattr(PCL240K, "advance", lambda self, clocks: 0)
    with pytest.raises(Finding, match="time did not pass"):
        check(bytes([0, 0xDF]))


def test_a_chip_whose_state_depends_on_the_lengths_of_advances_is_a_finding(monkeypatch):
    check, advance = Bus(), PCL240K.advance

    def forgetful(self, clocks):
        self.state["total"] += clocks > 1 << 18
        return advance(self, clocks)

    monkeypatch.setattr(PCL240K, "advance", forgetful)
    with pytest.raises(Finding, match="in another state"):
        check((CORPUS / "bus" / "cruise_0").read_bytes())


def test_a_journal_that_loses_writes_is_a_finding(monkeypatch):
    monkeypatch.setattr(Journal, "note_write", lambda self, clock, address, value: None)
    with pytest.raises(Finding, match="a course that ends"):
        Bus()((CORPUS / "bus" / "cruise_0").read_bytes())


class Odd(PCL240K):
    """Stands for chips to come: several axes, words on the bus, more addresses."""

    AXES, DATA_MASK, ADDRESS_MASK = 3, 0xFFFF, 7
    MAP = dataclasses.replace(PCL240K.MAP, axes=3)


def test_a_chip_of_no_known_family_is_driven_by_raw_words_at_all_addresses_and_all_its_pins():
    assert type(make_family(PCL240K)) is not Family
    run = Run(Family(Odd), bytes([0x00, 0x12, 0x34, 0x67, 0, 8, 0xA7, 0x94, 0xD4]), Counts())
    writes = []
    for chip in run.chips:
        chip.write = lambda address, value: writes.append((address, value))
    run.run_to_end()
    assert set(writes) == {(0, 0x1234), (0x67, 8)}
    assert run.counts == {"bus cycles": 3, "input edges": 1, "clocks": 1 << 20, "pulses": 0}
    assert len(run.family.pins(run.chip)) == 3 * len(Odd.INPUTS)


def test_mutations_find_a_planted_defect_leave_the_input_and_the_counts(tmp_path):
    counts = Counts(tmp_path / "counts.json")

    def check(data):
        counts["inputs"] += 1
        counts.save()
        assert data.count(7) < 2

    assert mutate_for(check, [b"abc", b"x\x07yz"], 30.0, seed=1, result=tmp_path, maximum=16) == 1
    (left,) = tmp_path.glob("crash-*")
    assert 2 <= left.read_bytes().count(7) <= 16
    assert read_counts(counts.path) == dict(counts)


HANGING = """
import pathlib, sys, time
from fuzzing import mutation
mutation.HANG = 0.1
mutation.mutate_for(lambda data: time.sleep(60 * data.count(b"x")), [b"ab", b"xy"], 30.0, 1, pathlib.Path(sys.argv[1]), 16)
"""


def test_an_input_that_hangs_ends_the_run_and_is_saved(tmp_path):
    command = [sys.executable, "-c", HANGING, str(tmp_path)]
    completed = subprocess.run(command, cwd=fuzz.ROOT / "scripts", stdout=subprocess.PIPE, timeout=50)
    assert completed.returncode == 70
    (left,) = tmp_path.glob("timeout-*")
    assert b"x" in left.read_bytes()


def test_mutations_of_the_corpus_keep_the_promises(tmp_path):
    seed = random.randrange(1 << 32)  # mutate_for prints it
    pool = [path.read_bytes() for path in list_inputs("bus")]
    check = Bus()
    assert mutate_for(check, pool, 0.5, seed, tmp_path, fuzz.TARGETS["bus"].max_bytes) == 0, list(tmp_path.iterdir())
    assert check.counts["inputs"] > len(pool)
