"""A NOVA chip's trace, where pulses come evenly, falls where the profile puts each pulse by itself."""

import random

import numpy as np
import pytest
from loops.nova import one_by_one
from support.nova_bench import NOP_304, NOP_514, command, examples, load, load_304, set_wr3

from stage.chips import MCX304, MCX514
from stage.chips.cycle_descriptions import decode
from stage.chips.nova.motion import pulse_trace as pulses

PARTS = (1, 2, 3, 7, 11, 64, 625, 999, 4096, 15_625)


def compare(chip, clocks):
    """Each axis' pulses of a trace with those found one by one; returns how many. Nothing but pulses may happen in it."""
    expected, before = {}, chip._rows.copy()
    traced = chip.trace(clocks)
    for axis in range(chip.AXES):
        x = before[0].ax[axis]
        own_pulses = traced["clock"][traced["axis"] == axis]
        expected[axis] = np.zeros(len(own_pulses), np.int64)
        if x.driving:
            assert one_by_one(x, expected[axis]) == len(own_pulses)
        assert np.array_equal(own_pulses, expected[axis]), f"axis {axis}, {before[0].ax[axis].reg[:8]}"
    order = np.lexsort((traced["axis"], traced["clock"]))
    assert np.array_equal(order, np.arange(len(traced)))
    return len(traced)


def speed(rng):
    """Draw a speed whose period is a whole number of clocks, or a simple or an odd fraction of them."""
    return rng.choice(
        [
            rng.randint(1, 8_000_000),
            16_000_000 // rng.randint(2, 5000),
            rng.choice(PARTS) * rng.randint(1, 500),
            8_000_000,
        ]
    )


def ramp(rng):
    """Draw SV, DV and AC for a ramp of few pulses."""
    sv, dv = speed(rng), speed(rng)
    return sv, dv, min(max(int(abs(dv * dv - sv * sv) / rng.uniform(2, 2000)), 1), 536_870_911)


def test_pulses_at_any_constant_speed_fall_where_each_would_alone():
    observed = 0
    for rng in examples(0.2):
        chip = MCX514()
        for axes in (1, 2, 4, 8)[: rng.randint(1, 4)]:
            sv = speed(rng)
            load(chip, axes, SV=sv, DV=sv, TP=rng.randint(1, 5000))
            command(chip, rng.choice([0x50, 0x52, 0x53]), axes)
            chip.advance(rng.randint(0, 1000))
        for _ in range(3):
            observed += compare(chip, rng.randint(1, 100_000))
    assert observed > 1000


@pytest.mark.parametrize("wr3", [0, 4], ids=["linear", "S-curve"])
def test_so_they_do_after_ramps_of_any_kind_and_when_the_speed_is_changed(wr3):
    observed = 0
    for rng in examples(1):
        chip = MCX514()
        set_wr3(chip, wr3)
        sv, dv, ac = ramp(rng)
        load(chip, 1, SV=sv, DV=dv, AC=ac, JK=rng.randint(1 << 24, 1 << 30), TP=rng.randint(1, 50_000))
        command(chip, rng.choice([0x50, 0x52, 0x53]))
        observed += compare(chip, rng.randint(1, 200_000))
        load(chip, 1, DV=speed(rng))
        observed += compare(chip, rng.randint(1, 200_000))
    assert observed > 1000


def test_so_they_do_in_the_multiples_of_the_first_generation():
    observed = 0
    for rng in examples(0.25):
        chip = MCX304()
        set_wr3(chip, 0, nop=NOP_304)
        r = rng.choice([16_000, 80_000, 800_000, 8_000_000, rng.randint(16_000, 8_000_000)])
        load_304(chip, 1, R=r, SV=rng.randint(1, 8000), V=rng.randint(1, 8000), A=rng.randint(1, 8000), P=30_000)
        command(chip, rng.choice([0x20, 0x22, 0x23]))
        observed += compare(chip, rng.randint(1, 200_000))
    assert observed > 1000


def test_integer_speeds_are_recognized_over_the_full_range():
    """So the fast way is the one that is taken."""
    chip, seed = MCX514(), random.randrange(1 << 32)
    print("seed", seed)
    rng = random.Random(seed)
    for pps in [1, 2, 3, 7_999_999, 8_000_000, *(rng.randint(1, 8_000_000) for _ in range(200))]:
        command(chip, 0x57)
        load(chip, 1, SV=pps, DV=pps)
        command(chip, 0x52)
        rows = chip._rows.copy()
        x = rows[0].ax[0]
        pulses._clear_predicted_pulse(x)
        pulses._predict_pulse(x, 1)
        assert x.even_pps == pps
        assert 0 <= x.even_rest < pps


def test_a_long_drive_is_where_the_reciprocal_of_its_speed_puts_it_after_a_hundred_million_pulses():
    chip, pps = MCX514(), 1_999_993
    load(chip, 1, SV=pps, DV=pps)
    command(chip, 0x52)
    chip.advance(800_000_000)
    done = chip.net()
    clocks = chip.trace(1000)["clock"]
    assert clocks.tolist() == [-(-(done + k) * 16_000_000 // pps) for k in range(1, len(clocks) + 1)]
    assert len(clocks) in (124, 125)


@pytest.mark.parametrize("cls", [MCX304, MCX514], ids=lambda cls: cls.__name__)
def test_mode_words_are_described_for_the_axis_that_they_set(cls):
    """WR1 to WR3 belong to the axes that were selected last."""
    chip = cls()
    journal = chip.journal()
    command(chip, NOP_304 if cls is MCX304 else NOP_514, 2)
    for n in (1, 2, 3):
        chip.write(n, 0x0010 + n)
    message = [[s.meaning for s in decode(chip.decoder(axis), journal.entries) if "<-" in s.meaning] for axis in (0, 1)]
    assert message == [[], ["WR1 <- 0011h", "WR2 <- 0012h", "WR3 <- 0013h"]]
