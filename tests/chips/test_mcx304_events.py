"""MCX304, MCX302, MCX312: the interrupt factors of RR3, the DCC output, the general outputs."""

import random

import pytest
from support.covers import covers
from support.nova_bench import SEED, command, get_signed, put
from support.nova_hands import MS, US, load, passes, pulses, set_word

from stage.chips import MCX302, MCX304, MCX312

FAMILY = pytest.mark.parametrize("make", [MCX304, MCX302, MCX312])
PULSE, GE_MINUS, LT_MINUS, LT_PLUS, GE_PLUS, C_END, C_STA, D_END = (1 << k for k in range(8))
CMPSL = 0x0020  # of WR2


def rr3(chip):
    return chip.read(3)


def cruise(chip, minus=False):
    """Drive at 500,000 pps, a pulse every 32 clocks."""
    load(chip, R=80_000, SV=5000, V=5000)
    command(chip, 0x23 if minus else 0x22)


def relations(counter, plus, minus):
    return (GE_MINUS if counter >= minus else LT_MINUS) | (GE_PLUS if counter >= plus else LT_PLUS)


@covers("MCX304 MCX302 MCX312", "CP", "CM", "C_DRV_P", "C_DRV_M", "R", "SV", "V", "LP")
@FAMILY
@pytest.mark.parametrize("example", range(3))
def test_a_comparison_is_an_event_at_the_clock_of_the_pulse_that_makes_it_true(example, make):
    """Against the counter recomputed from the trace."""
    print("PULSESTAGE_SEED", SEED)
    rng = random.Random(SEED + example)
    for direction in (1, -1):
        chip = make()
        plus, minus, counter = rng.randint(-30, 30), rng.randint(-30, 30), -31 * direction
        load(chip, LP=counter, CP=plus, CM=minus)
        cruise(chip, direction < 0)
        rr3(chip)
        previous = relations(counter, plus, minus)
        for clock in pulses(chip, 64 * 32):
            counter += direction
            now = relations(counter, plus, minus)
            assert passes(chip, clock, rr3) == (0, PULSE | now & ~previous)
            previous = now
        assert counter == 33 * direction


@covers("MCX304 MCX302 MCX312", "EP", "R-EP", "NOP")
@FAMILY
def test_with_cmpsl_the_comparisons_follow_the_encoder(make):
    chip = make()
    set_word(chip, 2, CMPSL)
    load(chip, CP=1, CM=-100, EP=0)
    rr3(chip)
    cruise(chip)
    chip.advance(MS)
    assert rr3(chip) & 0x1E == 0
    chip.axes[0].pins.eca = True
    chip.advance(1)
    assert get_signed(chip, 0x11) == 1
    assert rr3(chip) & 0x1E == GE_PLUS


@FAMILY
def test_only_enabled_factors_cause_an_interrupt_but_rr3_has_all(make):
    for enabled in (0, PULSE << 8, D_END << 8, 0xFF00):
        chip = make()
        set_word(chip, 1, enabled)
        load(chip, R=80_000, SV=5000, V=5000, P=3)
        command(chip, 0x20)
        chip.advance(MS)
        assert chip.output_word(chip.AXES) == (1 if enabled else 0)
        assert rr3(chip) & (PULSE | D_END) == PULSE | D_END
        assert rr3(chip) == 0
        assert chip.output_word(chip.AXES) == 0


@FAMILY
def test_the_values_of_the_registers_can_be_looked_at_without_clearing_the_factors(make):
    chip = make()
    cruise(chip)
    chip.advance(MS)
    assert chip.values()["RR3"] & PULSE
    assert rr3(chip) & PULSE


@covers("MCX304 MCX302 MCX312", "DEVCTR_CLR", "HM")
@FAMILY
@pytest.mark.parametrize("code", range(8))
def test_63h_puts_out_a_dcc_pulse_as_long_as_hm_says(code, make):
    chip = make()
    clocks = (10, 20, 100, 200, 1000, 2000, 10_000, 20_000)[code] * US
    put(chip, 0x60, code << 13)
    command(chip, 0x63)
    assert passes(chip, clocks, lambda c: c.axes[0].pins.dcc) == (True, False)


@FAMILY
def test_wr4_drives_four_general_outputs_of_each_axis(make):
    chip = make()
    chip.write(4, 0x8421)
    result = [[getattr(axis.pins, f"out{i}") for i in range(8)].index(True) for axis in chip.axes]
    assert result == [0, 1, 2, 3][: chip.AXES]
