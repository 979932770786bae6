"""`chip_conformance`: every shipped chip passes it, and each of many planted defects of a toy chip is found, by its promise."""

import re

import pytest
from support.examples import EXAMPLES, FIXED, SEED, scaled
from toy import TOY, TOY8, defects

from stage.chips import CHIPS
from stage.errors import ArgumentError
from stage.testing import chip_conformance
from stage.testing.conformance import NotConforming

DEFECTS = defects.DEFECTS
MANY = scaled(1) if not FIXED else 1


@pytest.mark.parametrize("name", CHIPS.own)
def test_every_chip_of_ours_passes(name):
    chip_conformance(name, seed=SEED, programs=MANY)


@pytest.mark.slow
@pytest.mark.parametrize("name", CHIPS.own)
def test_every_chip_of_ours_passes_in_many_programs(name):
    chip_conformance(name, programs=max(60, EXAMPLES))


@pytest.mark.slow
@pytest.mark.parametrize("chip", [TOY, TOY8, *CHIPS.own])
def test_as_plain_python_it_gives_the_same_bits(chip):
    chip_conformance(chip, seed=SEED, programs=2, promises=["pins_by_name"], uncompiled=True)


@pytest.mark.slow
def test_a_chip_that_differs_as_plain_python_is_found():
    with pytest.raises(
        NotConforming, match=r"compiled = uncompiled\n    but: in program 0, act 0, compiled code leaves"
    ):
        chip_conformance(defects.Elsewhere, seed=SEED, programs=1, promises=["pins_by_name"], uncompiled=True)


test_toy = chip_conformance.tests(TOY, seed=SEED, programs=2)


def test_a_chip_of_eight_axes_passes():
    chip_conformance(TOY8, seed=SEED, programs=2)


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_planted_defect_is_found_and_its_promise_named(defect):
    chip, promise, words = DEFECTS[defect]
    with pytest.raises(NotConforming, match=r"TOY|seed=") as said:
        chip_conformance(chip, seed=SEED, programs=4, promises=[promise])
    assert said.value.broken.keys() == {promise}
    assert re.search(words, said.value.broken[promise]), said.value
    assert f"seed={SEED}" in str(said.value)


def test_a_promise_that_is_none_is_refused_with_those_that_are():
    with pytest.raises(ArgumentError, match=r"unknown promise 'snapshot'. Did you mean 'snapshots'"):
        chip_conformance(TOY, promises=["snapshot"])


def test_another_seed_each_time_is_printed(capsys):
    for _ in range(2):
        chip_conformance(TOY, promises=["pins_by_name"])
    assert len(set(capsys.readouterr().out.splitlines())) == 2
