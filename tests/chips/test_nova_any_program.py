"""NOVA chips take any write, and how their time is cut makes no difference, whatever they were told."""

import copy

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.covers import covers
from support.examples import scaled

from stage.chips import MCX302, MCX304, MCX312, MCX514

CHIPS = (MCX514, MCX304, MCX302, MCX312)
programs = settings(max_examples=scaled(10), deadline=None, suppress_health_check=list(HealthCheck), print_blob=True)
data = st.one_of(st.integers(-60, 60), st.integers(1, 1_000_000), st.integers(0, (1 << 32) - 1))


def steps(make):
    """Draw commands with data, raw words, inputs and waits."""
    codes = st.one_of(st.sampled_from(sorted(make.MAP.by_code)), st.integers(0, 255))
    axes = st.integers(0, (1 << make.AXES) - 1)
    return st.one_of(
        st.tuples(st.just("command"), codes, axes, data),
        st.tuples(st.just("word"), st.integers(1, 5), axes, st.integers(0, 0xFFFF)),
        st.tuples(st.just("pins"), st.integers(0, make.AXES), st.integers(0, (1 << 17) - 1), st.just(0)),
        st.tuples(st.just("wait"), st.integers(0, 30_000), st.integers(0, 30_000), st.just(0)),
    )


def command(chip, code, axes, value):
    chip.write(6, value & 0xFFFF)
    chip.write(7, value >> 16 & 0xFFFF)
    chip.write(0, axes << 8 | code)


def play(chip, program, cut):
    """`cut`: waits in two, and what comes in between is another chip's that took the state."""
    for what, a, b, value in program:
        if what == "command":
            command(chip, a, b, value)
        elif what == "word":
            command(chip, 0x1F if isinstance(chip, MCX514) else 0x0F, b, 0)
            chip.write(a, value)
        elif what == "pins":
            chip.set_input_word(a, b & 1 if a == chip.AXES else b)
        elif cut:
            chip.advance(a)
            replica = type(chip)(**chip.options())
            replica.restore(chip.snapshot())
            chip = replica
            chip.advance(b)
        else:
            chip.advance(a + b)
    return chip


@pytest.mark.parametrize("make", CHIPS)
def test_nothing_raises_for_any_program_and_a_cut_run_is_the_same_run(make):
    @programs
    @given(st.lists(steps(make), max_size=40))
    def run(program):
        uncut, cut = play(make(), program, False), play(make(), program, True)
        assert uncut.snapshot() == cut.snapshot()
        assert all(0 <= value <= 0xFFFF for value in uncut.values().values())
        assert [uncut.read(n) for n in range(8)] == [cut.read(n) for n in range(8)]

    run()


@pytest.mark.parametrize("make", CHIPS)
def test_a_trace_has_the_pulses_that_advance_would_make(make):
    @programs
    @given(st.lists(steps(make), max_size=30), st.integers(0, 500))
    def run(program, clocks):
        chip = play(make(), program, False)
        replica = copy.copy(chip)
        trace = chip.trace(clocks)
        assert len(trace) == replica.advance(clocks)
        assert chip.snapshot() == replica.snapshot()

    run()


@covers("MCX514", "DCC", "HMSRC", "TMSTA", "TMSTP", "SPSTA", "SPSTP", "SYNCEN", "SYNCDIS", "SYNCACT", "R-P2M", "P2M")
def test_every_command_code_is_accepted_in_every_mode():
    chip = MCX514()
    for value in (0, 0xFFFF, 0xA5A5, 0xFFFFFFFF, 0x5A5A5A5A, 0x00010001):
        for n in (1, 2, 3):
            command(chip, 0x1F, 0xF, 0)
            chip.write(n, value & 0xFFFF)
        for code in range(256):
            command(chip, code, 0xF, value)
            chip.advance(7)
    assert chip.clock == 6 * 256 * 7
