"""The two pins that carry pulses, `pins.pls` and `pins.dir`, in every mode of the pulse output.

independent         PLS: pulses of + drives     DIR: pulses of - drives
pulse and direction PLS: pulses                 DIR: + low, - high
quadrature          PLS: A                      DIR: B, A leads in + direction; x4 an edge a pulse, x2 two
"""

import itertools
import random

import pytest
from support.covers import covers
from support.examples import SEED, scaled
from support.nova_bench import X, Y, command, load, load_304, put
from support.nova_interpolation_bench import line, prepared

from stage.chips import CHIPS, MCX304, MCX514

INDEPENDENT, PULSE_AND_DIRECTION, QUADRATURE_X4, QUADRATURE_X2 = range(4)
PERIOD = 20  # clocks a pulse: 800 kpps
SECOND_GENERATION, OLDER = ["MCX514", "MCX512", "MCX501"], ["MCX304", "MCX302", "MCX312", "MCX314AS"]
QUARTERS = ((False, False), (True, False), (True, True), (False, True))
"""A and B, forward."""


def second_generation(name, mode, negative, plus_is_high, exchanged):
    chip = CHIPS[name]()
    command(chip, 0x1F)
    chip.write(3, mode << 3 | negative << 5 | plus_is_high << 6 | exchanged << 7)
    load(chip, SV=800_000, DV=800_000, TP=1)
    return chip


def older(name, mode, negative, plus_is_high, exchanged):
    chip = CHIPS[name]()
    command(chip, 0x0F)
    chip.write(2, mode << 6 | negative << 7 | plus_is_high << 8)
    chip.write(3, exchanged << 6)
    load_304(chip, R=80_000, SV=8000, V=8000, P=1)  # multiple 100
    return chip


def levels(mode, negative, plus_is_high, exchanged, way, pulses, on):
    """PLS and DIR, True: high, after so many pulses of a drive from power-up; on: the last of them is on."""
    if mode == INDEPENDENT:
        pls, direction = on and way > 0, on and way < 0
    elif mode == PULSE_AND_DIRECTION:
        pls, direction = on, (way < 0) != plus_is_high
    else:
        edges = way * pulses if mode == QUADRATURE_X4 else way * (2 * pulses - on)
        pls, direction = QUARTERS[edges % 4]
    if negative:
        pls, direction = not pls, direction if mode == PULSE_AND_DIRECTION else not direction
    return (direction, pls) if exchanged else (pls, direction)


def displayed(chip, axis=0):
    pins = chip.axes[axis].pins
    return pins.pls, pins.dir


@pytest.mark.parametrize("way", [1, -1], ids=["plus", "minus"])
@pytest.mark.parametrize("name", SECOND_GENERATION + OLDER)
def test_pulses_and_direction_are_at_the_pins_as_the_mode_says(name, way):
    """pins.pls was never True, and pins.dir knew neither DIR-L nor DPMD nor DPINV"""
    make_chip, modes = (older, 2) if name in OLDER else (second_generation, 4)
    for mode, negative, plus_is_high, exchanged in itertools.product(range(modes), *[(False, True)] * 3):
        if exchanged and name == "MCX314AS":  # it has no POINV
            continue
        chip = make_chip(name, mode, negative, plus_is_high, exchanged)
        assert displayed(chip) == levels(mode, negative, plus_is_high, exchanged, 1, 0, False), "plus after a reset"
        command(chip, (0x22 if way > 0 else 0x23) if make_chip is older else 0x52 if way > 0 else 0x53)
        begin = chip.clock
        for _ in range(5 * PERIOD):
            chip.advance(1)
            pulses, since = divmod(chip.clock - begin, PERIOD)
            on = pulses > 0 and since < PERIOD // 2
            expected = levels(mode, negative, plus_is_high, exchanged, way, pulses, on)
            assert displayed(chip) == expected, (mode, negative, plus_is_high, exchanged, chip.clock - begin)


@covers("MCX514", "DRVRL")
def test_the_last_pulse_of_a_drive_is_as_long_as_the_others():
    chip = second_generation("MCX514", PULSE_AND_DIRECTION, False, False, False)
    put(chip, 0x06, 3)
    command(chip, 0x50)
    highs = [(chip.advance(1), chip.axes[0].pins.pls)[1] for _ in range(5 * PERIOD)]
    assert [k + 1 for k, high in enumerate(highs) if high] == [
        n * PERIOD + k for n in (1, 2, 3) for k in range(PERIOD // 2)
    ]
    assert not chip.axes[0].pins.drive


def drive_at_random(chip, rng):
    """Make a random bus cycle or pin change that begins or changes a drive."""
    what = rng.randrange(6)
    if isinstance(chip, MCX514):
        rows = [(0x05, rng.randrange(100_000, 2_000_000)), (0x06, rng.randrange(-60, 60)), (0x04, 400_000)]
        if what < 3:
            put(chip, *rows[what])
        else:
            command(chip, rng.choice((0x50, 0x51, 0x52, 0x53, 0x56, 0x57, 0x58, 0x59)))
    elif what < 3:
        put(chip, *[(0x05, rng.randrange(2000, 8000)), (0x06, rng.randrange(1, 60)), (0x04, 4000)][what])
    else:
        command(chip, rng.choice((0x20, 0x21, 0x22, 0x23, 0x26, 0x27)))


@pytest.mark.parametrize("name", ["MCX514", "MCX304"])
def test_at_every_clock_the_pins_are_those_of_the_waveform(name):
    """The course of a journal, from which VCD files are made; ramps, stops, changes of speed, restarts"""
    changes = 0
    for seed in range(SEED, SEED + scaled(8)):
        print("PULSESTAGE_SEED", seed)
        rng = random.Random(seed)
        mode = rng.randrange(4 if name == "MCX514" else 2)
        make_chip = second_generation if name == "MCX514" else older
        chip = make_chip(name, mode, rng.random() < 0.5, rng.random() < 0.5, rng.random() < 0.5)
        put(chip, 0x02, 200_000_000 if name == "MCX514" else 8000)
        journal, observed = chip.journal(), []
        for _ in range(12):
            drive_at_random(chip, rng)
            for _ in range(rng.randrange(1, 300)):
                observed.append((chip.clock, *displayed(chip)))
                chip.advance(1)
        journal.close()
        edges = journal.replay_waveforms(every_pulse=True).edges
        at = edges["clock"].searchsorted([clock for clock, _, _ in observed], side="right") - 1
        outputs, bits = edges["outputs"][at], chip.OUTPUTS
        for (clock, pls, direction), word in zip(observed, outputs, strict=True):
            assert (bool(word & bits["pls"]), bool(word & bits["dir"])) == (pls, direction), clock - observed[0][0]
        changes += sum(before[1:] != after[1:] for before, after in itertools.pairwise(observed))
    assert changes > 50, "there were pulses to see"


def test_pulses_of_an_interpolation_are_at_the_pins_of_each_axis():
    """Half a tick each, the last one as well"""
    chip = prepared()
    command(chip, 0x1F, X | Y)
    chip.write(3, PULSE_AND_DIRECTION << 3)
    journal = chip.journal(1)
    line(chip, (8, -4))
    begin, highs, directions = chip.clock, ([], []), set()
    for _ in range(10 * 16):
        for axis in (0, 1):
            if chip.axes[axis].pins.pls:
                highs[axis].append((chip.clock - begin) // 100)
            directions.add((axis, chip.axes[axis].pins.dir))
        chip.advance(100)
    assert (1, True) in directions
    assert (0, True) not in directions
    assert highs[0] == [16 * k + n for k in range(1, 9) for n in range(8)], "x at every tick of 1600 clocks, half of it"
    assert len(highs[1]) == 4 * 8
    edges = journal.replay_waveforms(every_pulse=True).edges
    rises = (edges["outputs"][1:] & ~edges["outputs"][:-1] & chip.OUTPUTS["pls"] != 0).sum()
    assert rises == 4


def test_a_waveform_of_the_recorder_has_every_pulse_at_the_pin_of_its_direction():
    """Independent pulses, as after a reset: those of a minus drive are at DIR"""
    for chip, code in ((MCX514(), 0x50), (MCX304(), 0x21)):
        if isinstance(chip, MCX514):
            load(chip, SV=800_000, DV=800_000, TP=-7)
        else:
            load_304(chip, R=80_000, SV=8000, V=8000, P=7)
        journal = chip.journal()
        command(chip, code)
        chip.advance(1000)
        edges = journal.replay_waveforms(every_pulse=True).edges
        risen = edges["outputs"][1:] & ~edges["outputs"][:-1]
        assert [(risen & chip.OUTPUTS[pin] != 0).sum() for pin in ("pls", "dir")] == [0, 7]
