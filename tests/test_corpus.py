"""Inputs for the fuzzer to begin with, and those that broke something, replayed every day; `make fuzz` looks for more."""

import os
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "scripts"))
import fuzz

CORPUS = Path(__file__).parent / "corpus"


@pytest.mark.parametrize("target", fuzz.TARGETS)
def test_every_input_of_the_corpus_keeps_the_promises(target, monkeypatch):
    monkeypatch.chdir(os.curdir)  # the target changes it
    inputs = sorted((CORPUS / target).iterdir())
    assert len(inputs) >= 10
    check = fuzz.TARGETS[target]()
    for path in inputs:
        print(path.name)
        check(path.read_bytes())


def test_a_chip_that_breaks_a_promise_is_a_finding(monkeypatch):
    from stage.chips import PCL240K

    monkeypatch.setattr(PCL240K, "advance", lambda self, clocks: 0)
    with pytest.raises(fuzz.Finding, match="time did not pass"):
        fuzz.Bus()(bytes([0, 0xDF]))
