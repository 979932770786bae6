"""Promises of an encoder at ECA and ECB of a NOVA chip: RP, EP counts what pins toggled by hand would make it count."""

import copy
import pickle

import numpy as np
import pytest
from support.nova_bench import command, examples, load, load_304, put

from stage import StageError
from stage.chips import MCX304, MCX514
from stage.chips.entries import SHAFT
from stage.errors import ArgumentError

MRM, MR0, RR1_CMR0 = 0x20, 0x10, 1


def real_position(chip, axes=1):
    """RP, EP as a host reads it."""
    command(chip, 0x31 if isinstance(chip, MCX514) else 0x11, axes)
    value = chip.read(6) | chip.read(7) << 16
    return value - (1 << 32) if value >> 31 else value


def set_mode(chip, mode, exchanged):
    """Mode: 0 x4, 1 x2, 2 x1, 3 up / down."""
    if isinstance(chip, MCX514):
        command(chip, 0x1F)
        chip.write(3, mode << 8 | exchanged << 11)
    else:
        command(chip, 0x0F)
        chip.write(1, exchanged << 7)
        chip.write(2, 1 << 9 if mode == 3 else mode << 10)


def show(chip, edge):
    """By hand, one edge at a time: A leads B forward."""
    pins = chip.axes[0].pins
    pins.eca, pins.ecb = edge % 4 in (1, 2), edge % 4 in (2, 3)


@pytest.mark.parametrize("make", [MCX514, MCX304])
@pytest.mark.parametrize("mode", range(4), ids=["x4", "x2", "x1", "up-down"])
def test_the_counter_of_a_shaft_is_that_of_its_edges_by_hand(make, mode):
    for rng in examples(1 / 25):
        fed, by_hand = make(), make()
        exchanged, at = rng.randrange(2), rng.randrange(-9, 10)
        for chip in (fed, by_hand):
            set_mode(chip, mode, exchanged)
        fed.set_shaft(at)
        show(by_hand, at)
        put(by_hand, 0x0A, 0)  # what the hand has made of the way to there
        assert real_position(fed) == 0, "where it is at first counts nothing"
        for _ in range(12):
            to = at + rng.randrange(-11, 12)
            fed.set_shaft(to + rng.uniform(-0.49, 0.49))
            while at != to:
                at += 1 if to > at else -1
                show(by_hand, at)
            assert real_position(fed) == real_position(by_hand)
            for pin in ("eca", "ecb"):
                assert getattr(fed.axes[0].pins, pin) == getattr(by_hand.axes[0].pins, pin)
            if make is MCX514:
                assert fed.read(3) == by_hand.read(3), "the raw pins"


def test_who_looks_meanwhile_changes_nothing():
    """Not even in the up / down mode, while the shaft turns at any speed."""
    for rng in examples(1 / 25):
        mode = rng.randrange(4)
        chips = [MCX514(), MCX514()]
        for chip in chips:
            set_mode(chip, mode, 0)
            chip.set_shaft(0)
        for _ in range(5):
            count, rate, clocks = rng.uniform(-30, 30), rng.choice((0, rng.uniform(-0.3, 0.3))), rng.randrange(2000)
            for looked_at, chip in enumerate(chips):
                chip.set_shaft(count, rate)
                end = chip.clock + clocks
                while looked_at and chip.clock < end:
                    chip.advance(rng.randrange(1, 400) if end - chip.clock > 400 else end - chip.clock)
                    (chip.read if rng.random() < 0.5 else chip.input_word)(3)
                    chip.axes[0].pins.stop0 = rng.random() < 0.5
                chip.advance(end - chip.clock)
        assert real_position(chips[0]) == real_position(chips[1])


def test_a_comparator_of_rp_fires_at_the_clock_at_which_the_count_is_reached():
    chip = MCX514()
    put(chip, MRM, 0b0001)  # MR0: RP >= MR0
    put(chip, MR0, 7)
    chip.read(1)
    chip.set_shaft(0)
    begin, rate = chip.clock, 1 / 48
    chip.set_shaft(0, rate)
    first = begin + 6.5 / rate
    for clock, fired in ((first - 1, 0), (first, RR1_CMR0)):
        chip.advance(int(clock) - chip.clock)
        assert chip.read(1) & RR1_CMR0 == fired
    assert real_position(chip) == 7


def test_a_software_limit_of_the_real_position_stops_a_drive():
    chip = MCX304()
    load_304(chip, R=8_000_000, SV=500, V=500, A=400, AO=0)
    put(chip, 0x0B, 100)  # COMP+
    command(chip, 0x0F)
    chip.write(2, 1 | 1 << 5)  # SLMT+ on, EP compared
    put(chip, 0x0C, -1000)
    command(chip, 0x22)
    chip.set_shaft(0)
    chip.set_shaft(0, 1 / 1600)
    chip.advance(99 * 1600)
    assert chip.axes[0].pins.drive
    chip.advance(64_000)
    assert not chip.axes[0].pins.drive


def test_a_reset_clears_the_counter_and_the_encoder_stays():
    chip = MCX514()
    chip.set_shaft(100)
    chip.set_shaft(140, 0.01)
    chip.advance(1000)
    chip.reset()
    assert real_position(chip) == 0
    chip.advance(1000)
    assert real_position(chip) == 10
    put(chip, 0x0A, -70_000)
    chip.advance(100)
    assert real_position(chip) == -69_999


def test_a_journal_a_snapshot_and_a_copy_go_on_with_the_encoders_of_all_axes():
    chip = MCX514()
    chip.set_shaft(3, axis=1)
    journal = chip.journal(1)
    load(chip, SV=8000, DV=8000, TP=20)
    command(chip, 0x50)
    for axis, rate in ((0, 0.02), (1, -0.01), (0, 0.03)):
        chip.set_shaft(5.5, rate, axis)
        chip.advance(700)
    others = [copy.copy(chip), pickle.loads(pickle.dumps(chip)), chip.twin()]
    journal.close()
    kinds = [e.kind for e in journal.entries if e.kind >= SHAFT]
    assert kinds == [SHAFT, SHAFT + 1, SHAFT]
    for every_pulse in (False, True):
        edges = np.concatenate(list(journal.pieces(every_pulse, size=80)))
        assert edges["clock"][-1] == chip.clock
        assert edges["inputs"][-1] == chip.input_word(1)
    assert len(edges) > 10, "every edge of ECA and ECB is in the course"
    lone = MCX514()
    lone._rows[0] = journal.start
    for e in journal.entries:
        lone.advance(e.clock - lone.clock)
        e.apply(lone.CORE, lone._rows)
    lone.advance(journal.until - lone.clock)
    for other in (lone, *others):
        other.advance(1234)
    chip.advance(1234)
    for other in (lone, *others):
        assert [real_position(other, axes) for axes in (1, 2)] == [real_position(chip, axes) for axes in (1, 2)]
        assert other.snapshot().record == chip.snapshot().record


def test_what_is_no_shaft_is_refused_and_its_pins_are_no_hands():
    chip = MCX514()
    for given in ((float("nan"),), (0, float("inf"))):
        with pytest.raises(ArgumentError, match="finite count"):
            chip.set_shaft(*given)
    with pytest.raises(ArgumentError, match="axes 0 to 3"):
        chip.set_shaft(0, axis=4)
    chip.axes[0].pins.eca = True
    chip.set_shaft(0)
    assert not chip.axes[0].pins.eca
    with pytest.raises(StageError, match="those of its encoder"):
        chip.axes[0].pins.eca = True
    chip.axes[1].pins.eca = True
    assert chip.axes[1].pins.eca
    chip.set_shaft(1e300, -1e290)
    chip.advance(1000)
    assert -(1 << 31) <= real_position(chip) < 1 << 31, "far away, and no failure"


@pytest.mark.parametrize(("slow", "fast"), [(3, 9), (9, 3), (0, 15)])
def test_the_filter_of_the_encoders_pins_delays_what_they_count(slow, fast):
    """FE7 of FLM: ECA and ECB count after the delay of FL1, and of nothing else."""
    for enabled in (True, False):
        chip = MCX514()
        set_mode(chip, 0, 0)
        put(chip, 0x25, (0x80 if enabled else 0x7F) | fast << 8 | slow << 12)
        delay = 8 << slow if enabled else 0
        for edge in range(1, 6):
            show(chip, edge)
            if delay:
                chip.advance(delay - 1)
                assert real_position(chip) == edge - 1, "not yet"
                chip.advance(1)
            assert real_position(chip) == edge
