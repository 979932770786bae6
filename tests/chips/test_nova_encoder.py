"""Promises of an encoder at ECA and ECB of a NOVA chip: RP, EP counts what pins toggled by hand would make it count."""

import copy
import itertools
import math
import pickle

import numpy as np
import pytest
from support.nova_bench import command, examples, load, load_304, put

from stage import StageError
from stage.chips import CHIPS, MCX304, MCX514
from stage.chips.journal_entries import SHAFT
from stage.errors import ArgumentError

MRM, MR0, RR1_CMR0 = 0x20, 0x10, 1


def real_position(chip, axes=1):
    """Return the real position (RP, EP) as a host reads it."""
    command(chip, 0x31 if isinstance(chip, MCX514) else 0x11, axes)
    value = chip.read(6) | chip.read(7) << 16
    return value - (1 << 32) if value >> 31 else value


def set_mode(chip, mode, exchanged):
    """Set the mode of the encoder inputs: 0 x4, 1 x2, 2 x1, 3 up / down."""
    if isinstance(chip, MCX514):
        command(chip, 0x1F)
        chip.write(3, mode << 8 | exchanged << 11)
    else:
        command(chip, 0x0F)
        chip.write(1, exchanged << 7)
        chip.write(2, 1 << 9 if mode == 3 else mode << 10)


def show(chip, edge):
    """Set the encoder pins one edge at a time; A leads B forward."""
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


def test_reading_the_position_in_between_changes_nothing():
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
    others = [copy.copy(chip), pickle.loads(pickle.dumps(chip)), chip.make_replica()]
    journal.close()
    assert [e.axis for e in journal.entries if e.kind == SHAFT] == [0, 1, 0]
    for every_pulse in (False, True):
        edges = np.concatenate(list(journal.replay_in_pieces(every_pulse, size=80)))
        assert edges["clock"][-1] == chip.clock
        assert edges["inputs"][-1] == chip.input_word(1)
    assert len(edges) > 10, "every edge of ECA and ECB is in the course"
    lone = MCX514()
    lone._rows[0] = journal.start_state
    for e in journal.entries:
        lone.advance(e.clock - lone.clock)
        e.apply(lone.CORE, lone._rows)
    lone.advance(journal.end_clock - lone.clock)
    for other in (lone, *others):
        other.advance(1234)
    chip.advance(1234)
    for other in (lone, *others):
        assert [real_position(other, axes) for axes in (1, 2)] == [real_position(chip, axes) for axes in (1, 2)]
        assert other.snapshot().record == chip.snapshot().record


def test_an_invalid_shaft_is_refused_and_encoder_pins_cannot_be_set():
    chip = MCX514()
    for shafts in ((float("nan"),), (0, float("inf"))):
        with pytest.raises(ArgumentError, match="finite count"):
            chip.set_shaft(*shafts)
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


# Comparisons with RP, against a model that passes every edge at its clock


OFF, MR1 = 0xFFFFFFFF, 0x11
CONDITIONS = (lambda a, b: a >= b, lambda a, b: a > b, lambda a, b: a == b, lambda a, b: a < b)


class Shaft:
    """An encoder's shaft and the counter behind it, edge by edge."""

    def __init__(self, mode, exchanged, ring_length=OFF):
        self.mode, self.direction, self.ring_length = mode, -1 if exchanged else 1, ring_length
        self.edge = self.counter = 0
        self.at = (0, 0.0, 0)

    def place(self, count, rate, clock):
        self.at = (count, rate, clock)
        self.follow(clock)

    def follow(self, clock):
        """Pass the edges up to a clock; where the shaft turns back, edge n is passed on the way from n to n - 1."""
        count, rate, since = self.at
        to = math.floor(count + rate * (clock - since) + 0.5)
        while self.edge != to:
            forward = to > self.edge
            self.edge += 1 if forward else -1
            self._count(self.edge if forward else self.edge + 1, forward)

    def _count(self, passed, forward):
        if self.mode == 3:  # rises of ECA count up, rises of ECB down
            change = {1: 1, 2: -1}.get(passed % 4, 0) if forward else {3: 1, 0: -1}.get(passed % 4, 0)
        else:
            change = (1 if forward else -1) if passed % (1 << self.mode) == 0 else 0
        self.counter += change * self.direction
        if change and self.ring_length != OFF:
            self.counter %= self.ring_length + 1


def turning(rng):
    return rng.uniform(-20, 20), rng.choice((0.0, 0.25, -1.0, rng.uniform(-0.1, 0.1), rng.uniform(-1.6, 1.6)))


def test_comparators_of_rp_fire_at_the_clock_of_every_model_edge():
    """Every mode, either way, with and without a ring, faster than an edge a clock, jumps of the shaft"""
    for rng in examples(1):
        mode, exchanged = rng.randrange(4), rng.randrange(2)
        ring_length = rng.choice((OFF, OFF, 0, 1, 2, rng.randrange(3, 30), (1 << 31) - 1))
        condition, than = rng.randrange(4), rng.randrange(-12, 13)
        chip, shaft = MCX514(), Shaft(mode, exchanged, ring_length)
        set_mode(chip, mode, exchanged)
        put(chip, 0x0F, ring_length)
        put(chip, MRM, 1 | condition << 2)  # MR0 with RP
        put(chip, MR0, than)
        chip.set_shaft(0)
        chip.read(1)
        previous = CONDITIONS[condition](0, than)
        for _ in range(4):
            where = turning(rng)
            chip.set_shaft(*where)
            shaft.place(*where, chip.clock)
            for _ in range(120):
                now = CONDITIONS[condition](shaft.counter, than)
                assert chip.read(1) & RR1_CMR0 == (now and not previous), (
                    mode,
                    exchanged,
                    ring_length,
                    condition,
                    than,
                    where,
                )
                previous = now
                chip.advance(1)
                shaft.follow(chip.clock)
        assert real_position(chip) == shaft.counter


@pytest.mark.parametrize("mode", [0, 3], ids=["x4", "up-down"])
@pytest.mark.parametrize("exchanged", [0, 1])
def test_a_comparison_of_rp_that_holds_for_one_count_is_not_passed_over_in_a_long_advance(mode, exchanged):
    """Up to four counts in one advance; the ring turns over from 0 to 5"""
    for ring_length, than, rate in itertools.product((OFF, 5), (5, 1, 0, -1), (1 / 48, -1 / 48)):
        for clocks in (60, 100, 150, 200):
            chip, shaft = MCX514(), Shaft(mode, exchanged, ring_length)
            set_mode(chip, mode, exchanged)
            put(chip, 0x0F, ring_length)
            put(chip, MRM, 1)  # MR0: RP >= MR0
            put(chip, MR0, than)
            chip.set_shaft(0)
            chip.read(1)
            chip.set_shaft(0, rate)
            shaft.place(0, rate, chip.clock)
            previous, fired = than <= 0, False
            for clock in range(chip.clock + 1, chip.clock + clocks + 1):
                shaft.follow(clock)
                fired |= shaft.counter >= than and not previous
                previous = shaft.counter >= than
            chip.advance(clocks)
            assert bool(chip.read(1) & RR1_CMR0) == fired, (ring_length, than, rate, clocks)


def compare_ep(counter, plus, minus):
    """P>=C-, P<C-, P<C+, P>=C+"""
    return [counter >= minus, counter < minus, counter < plus, counter >= plus]


def test_comparisons_of_ep_change_at_the_clock_of_every_model_edge():
    for rng in examples(1 / 2):
        mode, exchanged = rng.choice((0, 1, 2, 3)), rng.randrange(2)
        plus, minus = rng.randrange(-12, 13), rng.randrange(-12, 13)
        chip, shaft = MCX304(), Shaft(mode, exchanged)
        command(chip, 0x0F)
        chip.write(1, exchanged << 7)
        chip.write(2, 1 << 5 | (1 << 9 if mode == 3 else mode << 10))  # CMPSL: EP
        put(chip, 0x0B, plus)
        put(chip, 0x0C, minus)
        chip.set_shaft(0)
        chip.read(3)
        previous = compare_ep(0, plus, minus)
        for _ in range(4):
            where = turning(rng)
            chip.set_shaft(*where)
            shaft.place(*where, chip.clock)
            for _ in range(120):
                now = compare_ep(shaft.counter, plus, minus)
                risen = sum(1 << k + 1 for k in range(4) if now[k] and not previous[k])
                assert chip.read(3) & 0x1E == risen, (mode, exchanged, plus, minus, where)
                previous = now
                chip.advance(1)
                shaft.follow(chip.clock)
        assert real_position(chip) == shaft.counter


@pytest.mark.parametrize("name", ["MCX514", "MCX512", "MCX501", "MCX304", "MCX302", "MCX312", "MCX314AS"])
@pytest.mark.parametrize("mode", range(4), ids=["x4", "x2", "x1", "up-down"])
def test_a_resting_chip_takes_no_time_while_its_shaft_turns(name, mode):
    """Each edge was an event as soon as something looked at RP: these hours of its time took half an hour of ours"""
    chip, hours = CHIPS[name](), (1 << 36) + 4000
    older = chip.VARIANT == MCX304.VARIANT
    command(chip, 0x0F if older else 0x1F)
    if older:
        chip.write(2, 1 << 5 | (1 << 9 if mode == 3 else mode << 10))  # CMPSL: EP
        put(chip, 0x0B, 5)
    else:
        chip.write(3, mode << 8)
        put(chip, MRM, 0b0001)
        put(chip, MR0, 5)
        put(chip, MR1, 5)
    chip.set_shaft(0)
    chip.set_shaft(0, 0.25)
    chip.advance(hours)
    command(chip, 0x11 if older else 0x31)
    counted = chip.read(6) | chip.read(7) << 16
    assert counted == (0 if mode == 3 else (hours // 4 >> mode) % (1 << 32))
