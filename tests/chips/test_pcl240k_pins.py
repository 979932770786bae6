"""What the PCL-240K data sheet says of its input and output pins, sentence by sentence."""

import pytest
from support.pcl240k_bench import clocks_while, commands, counter, operating, pins_clock_by_clock, started
from support.programs import load_registers

from stage.chips import PCL240K

SLOW = (50, 800, 20, 20, 2)  # FL, FH, rates, multiplier: at FH a pulse in 20.48 clocks
BOTH_WAYS = pytest.mark.parametrize(("plus", "minus", "control"), [("plus", "minus", 0x40), ("minus", "plus", 0x48)])


@BOTH_WAYS
def test_an_end_limit_stops_its_direction_at_once_and_leaves_the_other_free(plus, minus, control):
    chip = started(*SLOW, control=control)
    chip.advance(20_000)
    setattr(chip.pins, f"el_{minus}", True)
    assert chip.advance(20_000) > 0, "the other direction's limit means nothing"
    setattr(chip.pins, f"el_{plus}", True)
    assert chip.advance(1000) == 0
    assert chip.pins.hold
    commands(chip, 0x08, 0x15)
    assert chip.advance(100_000) == 0
    assert chip.pins.hold
    setattr(chip.pins, f"el_{minus}", False)
    commands(chip, control ^ 0x08, 0x15)
    assert chip.advance(100_000) > 0, "away from the limit"


def test_a_start_that_an_end_limit_refused_needs_no_reset_command():
    chip = started(*SLOW, start=0x08)
    chip.pins.el_plus = True
    chip.write(0, 0x31)
    assert chip.advance(10_000) == 0
    assert not chip.pins.irq
    chip.pins.el_plus = False
    chip.write(0, 0x31)
    assert chip.advance(8192 * 2) == 800


@BOTH_WAYS
def test_sd_slows_a_high_speed_run_while_asserted_and_lets_it_ramp_up_again(plus, minus, control):
    chip = started(*SLOW, control=control | 0x02)
    clocks_while(chip, "fup")
    setattr(chip.pins, f"sd_{minus}", True)
    assert chip.pins.fkeep, "the other direction's switch means nothing"
    assert chip.read(0) & 0x04 == 0
    setattr(chip.pins, f"sd_{plus}", True)
    assert chip.pins.fdown
    assert chip.read(0) & 0x04
    assert clocks_while(chip, "fdown") == 750 * 20
    assert chip.advance(8192 * 2 * 10) == 500, "at FL"
    setattr(chip.pins, f"sd_{plus}", False)
    assert clocks_while(chip, "fup") == 750 * 20
    assert chip.advance(8192 * 2 * 10) == 8000, "at FH again"


@pytest.mark.parametrize(("control", "start"), [(0x40, 0x15), (0x42, 0x11)], ids=["SD not enabled", "constant speed"])
def test_sd_means_nothing_when_not_enabled_or_at_constant_speed(control, start):
    chip = started(*SLOW, control=control, start=start)
    chip.advance(750 * 20)
    chip.pins.sd_plus = True
    assert chip.advance(8192 * 2 * 10) == 8000
    assert chip.read(0) & 0x04, "the status shows it all the same"


@pytest.mark.parametrize("start", [0x11, 0x15])
def test_org_stops_an_origin_return_at_once_and_nothing_else(start):
    for control, stops in ((0x41, True), (0x49, True), (0x40, False), (0x44, False)):
        chip = started(*SLOW, control=control, start=start)
        chip.advance(20_000)
        assert chip.read(0) & 0x02 == 0
        chip.pins.org = True
        assert (chip.advance(1000) == 0) == stops
        assert chip.pins.hold == stops
        assert chip.read(0) & 0x02


def test_a_high_speed_origin_return_slows_at_sd_and_stops_at_org():
    chip = started(*SLOW, control=0x43, start=0x35)
    chip.advance(20_000)
    chip.pins.sd_plus = True
    clocks_while(chip, "fdown")
    assert chip.advance(8192 * 2 * 2) == 100
    chip.pins.org = True
    chip.advance(200)
    assert chip.pins.hold
    assert chip.pins.irq
    commands(chip, 0x08, 0x15)
    assert chip.advance(10_000) == 0, "no start towards an ORG that is reached already"


def test_hold_is_high_in_the_halt_condition_and_low_in_operation_even_where_no_pulse_can_come():
    """Pin 29 and section 4, R0: HOLD and the operating status flag "indicate the halt condition" together; docs/chips.md."""
    for lacking, later in (({"R7": 0}, {"R7": 2}), ({"R1": 0}, {"R1": 50})):
        chip = PCL240K()
        load_registers(chip, **({"R0": 100, "R1": 50, "R2": 800, "R3": 800, "R4": 20, "R5": 20, "R7": 2} | lacking))
        assert (chip.pins.hold, operating(chip)) == (True, False)
        commands(chip, 0x40, 0x10)
        assert chip.advance(10**7) == 0, "no pulse comes,"
        assert "no pulse comes" in chip.diagnostics[-1].message, "which has a diagnostic,"
        assert (chip.pins.hold, operating(chip)) == (False, True), "and the operation is on:"
        load_registers(chip, **later)
        assert chip.advance(8192 * 2 + 1) == 50, (
            "it makes pulses as soon as it can: a new speed acts from the next clock on"
        )
        commands(chip, 0x08)
        chip.advance(1000)
        assert (chip.pins.hold, operating(chip)) == (True, False)


def test_extp_counts_at_the_edge_of_rise_and_stops_a_preset_run_at_0():
    chip = started(*SLOW, r0=3, control=0x44, start=0x08)
    commands(chip, 0xD0, 0x10)
    assert chip.advance(100_000) > 3, "output pulses do not count now"
    assert counter(chip) == 3
    for left in (2, 1, 0):
        chip.pins.extp = True
        chip.advance(10)
        assert counter(chip) == left + 1
        chip.pins.extp = False
        chip.advance(1)
        assert counter(chip) == left
    chip.advance(200)
    assert chip.pins.hold


def test_extp_that_counts_beyond_0_does_not_stop_a_continuous_run():
    chip = started(*SLOW, r0=1, control=0x40, start=0x08)
    commands(chip, 0xD0, 0x10)
    for left in (0, 0xFFFFFF):
        chip.pins.extp = True
        chip.advance(10)
        chip.pins.extp = False
        chip.advance(10)
        assert counter(chip) == left
        assert operating(chip)
    assert chip.advance(100_000) > 3


def test_extp_counts_a_halted_chip_too_and_wraps():
    chip = PCL240K()
    chip.write(0, 0xD0)
    for _ in range(2):
        chip.pins.extp = True
        chip.advance(1)
        chip.pins.extp = False
        chip.advance(1)
    assert counter(chip) == 0xFFFFFE
    chip.write(0, 0xC0)
    chip.pins.extp = True
    chip.advance(1)
    chip.pins.extp = False
    chip.advance(1)
    assert counter(chip) == 0xFFFFFE, "not with output pulses as the source"


def test_ots_follows_bit_5_of_the_output_mode():
    chip = PCL240K()
    for byte, level in ((0xE0, True), (0xC0, False), (0xE1, True), (0xD1, False)):
        chip.write(0, byte)
        assert chip.pins.ots == level


def test_ins_is_read_as_status_bit_0():
    chip = PCL240K()
    for level in (True, False, True):
        chip.pins.ins = level
        assert bool(chip.read(0) & 0x01) == level


@pytest.mark.parametrize(("control", "pin", "silent"), [(0x40, "pout", "pdir"), (0x48, "pdir", "pout")])
def test_independent_mode_puts_plus_pulses_on_pout_and_minus_pulses_on_pdir(control, pin, silent):
    independent, common = (started(*SLOW, control=control, start=0x08) for _ in range(2))
    commands(independent, 0xC1, 0x11)
    commands(common, 0xC0, 0x11)
    levels = pins_clock_by_clock(independent, 500, pin, silent)
    pout = pins_clock_by_clock(common, 500, "pout")
    assert (levels[:, :1] == pout).all()
    assert pout.any()
    assert not levels[:, 1].any()


def test_common_mode_puts_the_direction_on_pdir_low_for_minus():
    chip = started(*SLOW, start=0x11)
    assert not pins_clock_by_clock(chip, 100, "pdir").any()
    chip.write(0, 0x48)
    assert pins_clock_by_clock(chip, 100, "pdir").all()
    assert set(chip.trace(200)["direction"]) == {-1}


def test_hold_is_high_when_no_pulse_is_output():
    chip = started(*SLOW, start=0x08)
    assert chip.pins.hold
    chip.write(0, 0x11)
    assert not chip.pins.hold
    assert operating(chip)
    commands(chip, 0x08)
    assert chip.pins.hold


def test_fup_fkeep_and_fdown_are_high_one_at_a_time_and_bit_5_is_fkeep():
    chip = started(50, 100, 7, 9, 2)
    names = ("fup", "fkeep", "fdown")
    levels = [tuple(pins_clock_by_clock(chip, 500, *names).sum(axis=0))]
    chip.write(0, 0x14)
    levels.append(tuple(pins_clock_by_clock(chip, 500, *names).sum(axis=0)))
    assert levels == [(50 * 7 - 1, 500 - 50 * 7 + 1, 0), (0, 500 - 50 * 9 + 1, 50 * 9 - 1)], (
        "each row one clock late: after it"
    )
    for command in (0x15, 0x14, 0x11):
        chip.write(0, command)
        for _ in range(300):
            chip.advance(2)
            assert chip.pins.fup + chip.pins.fkeep + chip.pins.fdown == 1
            assert bool(chip.read(0) & 0x20) == chip.pins.fkeep


def test_lt_is_high_while_the_counter_is_below_r6_and_zero_while_it_is_0_as_in_the_status():
    chip = started(*SLOW, r0=6, r6=4, control=0x44, start=0x11)
    observed = []
    while not chip.pins.hold:
        lt, zero = chip.pins.lt, chip.pins.zero
        assert lt == (counter(chip) < 4)
        assert zero == (counter(chip) == 0)
        assert (bool(chip.read(0) & 0x10), bool(chip.read(0) & 0x08)) == (lt, zero)
        observed.append((lt, zero))
        chip.advance(1)
    assert set(observed) == {(False, False), (True, False), (True, True)}


@pytest.mark.parametrize(("fh", "start", "ends"), [(0, 0x11, 60), (3, 0x15, 21)], ids=["at rest", "about to ramp up"])
@pytest.mark.parametrize("first", [0, 5, 19])
def test_a_pulse_at_speed_0_ends_at_the_first_clock_of_another_speed_however_time_is_cut(fh, start, ends, first):
    """R7 shrinks meanwhile, so that the phase is in the second half of the pulse already."""
    for clocks in range(first, 60):
        chip = started(0, 512, 20, 20, 98, start=0x11)
        chip.advance(98 * 8192 // 512 + 30)
        load_registers(chip, R2=0)
        chip.advance(1)
        load_registers(chip, R7=3, R2=fh)
        chip.write(0, start)
        chip.advance(first)
        chip.advance(clocks - first)
        assert chip.pins.pout == (clocks < ends), clocks
