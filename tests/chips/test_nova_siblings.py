"""MCX512 and MCX501 do what an MCX514 does, as far as they have it."""

import pytest
from support.covers import covers
from support.examples import SEED
from support.nova_bench import Move, X, Y, command, driving, examples, get, get_signed, load, prepare, put

from stage.chips import MCX501, MCX512, MCX514

SMALLER = pytest.mark.parametrize("make", [MCX512, MCX501])


def program(rng, make):
    """Commands with data to some of its axes, words, pins, time."""
    codes = sorted(set(make.MAP.by_code) - {0x2B, 0x49})
    everyone = (1 << make.AXES) - 1
    for _ in range(rng.randint(5, 60)):
        axes = rng.randint(1, everyone)
        what = rng.random()
        if what < 0.65:
            code = rng.choice(codes)
            data = rng.choice([rng.randint(-300, 300), rng.randint(1, 500_000), rng.getrandbits(32)])
            if code == 0x2A:
                data = rng.randint(0, everyone) | rng.choice([0, 0x40, 0x100])
            if 0x26 <= code <= 0x29:
                data &= ~0x7000  # SYNC0 of other axes: the next ones are not the same
            yield "command", code, axes if make.MAP.by_code[code].axes else 0, data
        elif what < 0.8:
            yield "word", rng.randint(1, 3), axes, rng.getrandbits(16) & rng.getrandbits(16)
        elif what < 0.9:
            yield "pins", rng.randrange(make.AXES), 1 << rng.randrange(17), rng.random() < 0.5
        else:
            yield "time", rng.randint(1, 40_000), 0, 0


def play(chip, steps, axes):
    """Play a program, and return what the chip outputs."""
    observed = []
    for what, a, b, value in steps:
        if what == "command":
            put(chip, a, value, b)
        elif what == "word":
            command(chip, 0x1F, b)
            chip.write(a, value)
        elif what == "pins":
            word = chip.input_word(a)
            chip.set_input_word(a, word | b if value else word & ~b)
        else:
            observed.append(chip.trace(a).tolist())
            command(chip, 0x1F, 1)
            observed.append(
                [chip.read(n) for n in (0, 1, 2, 3, 6, 7)] + [chip.output_word(j) & 0xFFFF for j in range(axes)]
            )
    return observed


@SMALLER
def test_whatever_both_have_does_the_same_on_a_smaller_chip(make):
    for rng in examples(0.6):
        steps = list(program(rng, make))
        small, big = make(), MCX514()
        assert play(small, steps, make.AXES) == play(big, steps, make.AXES), f"PULSESTAGE_SEED={SEED}\n{steps}"
        assert [small.net(j) for j in range(make.AXES)] == [big.net(j) for j in range(make.AXES)]


@covers("MCX512", "P3M", "R-P3M")
def test_the_mcx512_has_six_pio_pins_more_of_each_axis():
    chip = MCX512()
    assert (chip.read(4), chip.read(5)) == (0, 0)
    chip.axes[1].pins.pio8 = chip.axes[1].pins.pio13 = True
    assert (chip.read(4), chip.read(5)) == (0, 0x2100)
    put(chip, 0x2B, 0x3E, Y)
    assert get(chip, 0x49, Y) == 0x3E
    chip.write(5, 0x1F00)
    assert chip.read(5) == 0x1F00, "PIO8 is an input, and high"
    chip.axes[1].pins.pio8 = False
    assert chip.read(5) == 0x1E00
    assert [getattr(chip.axes[1].pins, f"out{i}") for i in range(8, 14)] == [False, True, True, True, True, False]
    chip.write(4, 0x3FFF)
    assert chip.read(4) == 0, "X: all inputs"


@covers("MCX501", "DRVRL", "TP", "LP", "R-LP", "SV", "DV", "RST")
def test_the_mcx501_needs_no_axis_bits_and_takes_them():
    for axes in (0, X):
        chip = MCX501()
        for code, value in ((0x04, 8000), (0x05, 8000), (0x06, -5), (0x09, 100)):
            put(chip, code, value, axes)
        command(chip, 0x50, axes)
        assert chip.read(0) & 1
        assert chip.advance(1_000_000) == 5
        assert get_signed(chip, 0x30, axes) == 95
        assert not chip.diagnostics
        command(chip, 0xFF, 0)
        assert get_signed(chip, 0x30, axes) == 0


@pytest.mark.parametrize(
    ("make", "code"), [(MCX512, 0x62), (MCX512, 0x69), (MCX512, 0x1B), (MCX501, 0x60), (MCX501, 0x64), (MCX501, 0x2B)]
)
def test_a_command_that_a_smaller_chip_lacks_does_nothing_and_has_a_diagnostic(make, code):
    chip = make()
    prepare(chip, Move(SV=8000, DV=8000))
    load(chip, TP=50)
    before = chip.state.copy()
    put(chip, code, 50, 0)
    assert f"{code:02X}h is no command of the {make.__name__}" in chip.diagnostics[-1].message
    assert not driving(chip)
    for name in ("queue", "ax"):
        assert (chip.state[name] == before[name]).all()


def test_synchronous_actions_go_round_the_two_axes_of_the_mcx512():
    chip = MCX512()
    put(chip, 0x26, 13 << 4, X)  # SYNC0 of X: drive on
    put(chip, 0x27, 1 << 12, Y)  # SYNC1 of Y: SYNC0 of the next axis
    command(chip, 0x81, X)
    command(chip, 0x82, Y)
    command(chip, 0xA2, Y)
    assert driving(chip, X)
    assert not driving(chip, Y)
