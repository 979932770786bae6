"""What the PCL-240K data sheet says of starts, stops, interrupts and registers, sentence by sentence."""

import pytest
from support.pcl240k_bench import FOREVER, clocks_while, commands, counter, operating, pins_clock_by_clock, started
from support.programs import load_registers

from stage.chips import PCL240K

SLOW = (50, 800, 30, 30, 2)  # FL, FH, rates, multiplier: at FH a pulse in 20.48 clocks, at FL in 327.68


def test_a_start_with_an_empty_counter_makes_no_pulse_and_no_int():
    chip = started(*SLOW, r0=0, control=0x44, start=0x35)
    assert chip.pins.hold
    assert not operating(chip)
    assert chip.advance(1_000_000) == 0
    assert not chip.pins.irq
    load_registers(chip, R0=3)
    chip.write(0, 0x35)
    assert chip.advance(1_000_000) == 3, "it is still armed"
    assert chip.pins.irq


@pytest.mark.parametrize("interrupt", [0x1F, 0x1D, 0x08])
def test_residual_pulses_are_output_after_the_reset_command_and_a_start(interrupt):
    chip = started(*SLOW, r0=5000, r6=40, control=0x44, start=0x17)
    pulses = chip.advance(60_000)
    chip.write(0, interrupt)
    pulses += chip.advance(100_000)
    assert chip.pins.hold
    assert counter(chip) == 5000 - pulses > 0
    commands(chip, 0x08, 0x17)
    assert pulses + chip.advance(FOREVER) == 5000
    assert counter(chip) == 0


def test_a_decelerating_stop_ramps_down_to_fl_and_stops_there():
    chip = started(*SLOW)
    chip.advance(750 * 30)
    chip.write(0, 0x1F)
    assert chip.pins.fdown
    assert clocks_while(chip, "fdown") == 749 * 30 + 1
    assert chip.advance(8192 * 2) == 0
    assert chip.pins.hold


def test_a_decelerating_stop_without_bit_2_stops_a_constant_speed_run_at_once():
    chip = started(*SLOW, start=0x11)
    chip.advance(20_000)
    chip.write(0, 0x18)
    chip.advance(11)
    assert not operating(chip)
    with_bit_2 = started(*SLOW, start=0x11)
    with_bit_2.advance(20_000)
    with_bit_2.write(0, 0x1C)
    assert with_bit_2.pins.fdown


def test_a_speed_change_cancels_a_decelerating_stop():
    chip = started(*SLOW)
    chip.advance(750 * 30)
    commands(chip, 0x1F)
    chip.advance(100 * 30)
    commands(chip, 0x15)
    assert chip.pins.fup
    clocks_while(chip, "fup")
    assert chip.advance(8192 * 2 * 10) == 8000


def test_status_bit_6_falls_only_after_the_pulse_in_progress_is_complete():
    chip = started(50, 100, 30, 30, 2, start=0x11)
    chip.advance(164)  # the pulse began with this clock; it is low while its phase is below 8192
    assert chip.pins.pout
    chip.write(0, 0x08)
    assert operating(chip)
    levels = pins_clock_by_clock(chip, 90, "pout", "hold")
    assert (levels[:, 0] != levels[:, 1]).all(), "HOLD rises in the clock in which POUT does"
    assert levels[:, 0].sum() == 81
    assert not operating(chip)
    between = started(50, 100, 30, 30, 2, start=0x11)
    between.advance(160)
    between.write(0, 0x08)
    assert not operating(between), "no pulse, nothing to complete"


def test_a_start_while_the_last_pulse_is_being_completed_is_ignored():
    chip = started(50, 100, 30, 30, 2, start=0x11)
    chip.advance(164)
    commands(chip, 0x08, 0x11)
    assert chip.advance(100_000) == 0
    commands(chip, 0x11)
    assert chip.advance(8192 * 2) == 100, "armed by 08h all the same"


def test_int_is_asserted_at_the_stop_if_d5_is_set_and_cleared_by_a_00_command_without_d5():
    chip = started(*SLOW, r0=10, control=0x44, start=0x31)
    clocks_while(chip, lambda chip: not chip.pins.zero)
    assert chip.pins.pout
    assert not chip.pins.irq, "the last pulse is still low"
    assert clocks_while(chip, "pout") <= 11
    assert chip.pins.irq
    assert chip.read(0) & 0x80 == 0, "status bit 7 is 0 while /INT is pending"
    chip.write(0, 0x20)
    assert chip.pins.irq, "D5 = 1 clears nothing"
    chip.write(0, 0x00)
    assert not chip.pins.irq
    assert chip.read(0) & 0x80
    masked = started(*SLOW, r0=10, control=0x44, start=0x11)
    masked.advance(FOREVER)
    assert masked.pins.hold
    assert not masked.pins.irq


def test_the_latest_d5_before_the_stop_counts():
    chip = started(*SLOW, r0=10, control=0x44, start=0x11)
    chip.advance(10)
    chip.write(0, 0x20)
    chip.advance(FOREVER)
    assert chip.pins.irq
    chip = started(*SLOW, r0=10, control=0x44, start=0x31)
    chip.advance(10)
    chip.write(0, 0x00)
    chip.advance(FOREVER)
    assert not chip.pins.irq


def test_the_reset_command_28h_interrupts_when_it_stops_a_run_and_08h_does_not():
    for command, irq in ((0x28, True), (0x08, False)):
        chip = started(*SLOW, start=0x35)
        chip.advance(5000)
        chip.write(0, command)
        chip.advance(1000)
        assert chip.pins.irq == irq
        chip.write(0, 0x00)
        chip.write(0, command)
        chip.advance(1000)
        assert not chip.pins.irq, "a halted chip has nothing to stop"


def test_after_a_stop_the_reset_command_is_required_before_the_next_start():
    chip = started(*SLOW, r0=10, control=0x44)
    chip.advance(FOREVER)
    load_registers(chip, R0=10)
    chip.write(0, 0x15)
    assert chip.advance(FOREVER) == 0
    assert "reset command" in chip.diagnostics[-1].message
    commands(chip, 0x08, 0x15)
    assert chip.advance(FOREVER) == 10


def test_speed_changes_between_fh1_and_fh2_in_motion_with_a_ramp():
    chip = started(50, 400, 20, 30, 2, fh2=900)
    assert clocks_while(chip, "fup") == 350 * 20
    chip.write(0, 0x17)
    assert chip.pins.fup
    assert clocks_while(chip, "fup") == 500 * 20
    assert chip.advance(8192 * 2 * 10) == 9000
    chip.write(0, 0x15)
    assert chip.pins.fdown
    assert clocks_while(chip, "fdown") == 500 * 30
    assert chip.advance(8192 * 2 * 10) == 4000


def test_rewriting_the_register_not_selected_has_no_influence_and_the_selected_one_has():
    one, two, three = (started(50, 400, 20, 30, 2) for _ in range(3))
    for chip in (one, two, three):
        chip.advance(5000)
    load_registers(two, R3=8000)
    load_registers(three, R2=8000)
    courses = [chip.trace(100_000).tolist() for chip in (one, two, three)]
    assert courses[0] == courses[1]
    assert len(courses[2]) > len(courses[0])


def test_dual_rate_14h_ramps_down_to_fl_and_keeps_running_until_15h_ramps_up_again():
    chip = started(50, 800, 20, 20, 2)
    chip.advance(750 * 20)
    chip.write(0, 0x14)
    clocks_while(chip, "fdown")
    assert chip.pins.fkeep
    assert chip.advance(8192 * 2 * 10) == 500
    chip.write(0, 0x15)
    assert clocks_while(chip, "fup") == 750 * 20


def test_after_a_constant_start_bit_2_enables_ramps():
    chip = started(50, 800, 20, 20, 2, start=0x10, fh2=2000)
    chip.advance(20_000)
    chip.write(0, 0x14)
    assert chip.pins.fkeep
    chip.write(0, 0x17)
    assert chip.pins.fup
    assert clocks_while(chip, "fup") == 1950 * 20
    chip.write(0, 0x11)
    chip.advance(1)
    assert chip.pins.fkeep
    assert chip.advance(8192 * 2 * 10) == 8000, "without bit 2 the speed is there at once"


def carefully(chip, clocks):
    """Q&A: read high, middle and low, then middle and high again, until they agree; a bus cycle takes some clocks."""

    def read(address):
        chip.advance(clocks)
        return chip.read(address)

    while True:
        high, middle, low = read(3), read(2), read(1)
        if (read(2), read(3)) == (middle, high):
            return high << 16 | middle << 8 | low


def test_a_read_torn_by_a_borrow_lies_and_the_remedy_of_the_q_and_a_does_not():
    clocks = 7  # of a bus cycle; at 8000 of 16384 a pulse takes 2.05
    lies = 0
    for r0 in range(0x010000, 0x010020):
        chip = started(50, 8000, 2, 2, 2, r0=r0, start=0x11)
        high = chip.read(3)
        chip.advance(clocks)
        middle = chip.read(2)
        chip.advance(clocks)
        torn = high << 16 | middle << 8 | chip.read(1)
        assert torn - counter(chip) in (0, 0x10000, 0x100)
        lies += torn != counter(chip)
        before = counter(chip)
        value = carefully(chip, clocks)
        assert counter(chip) <= value <= before
    assert lies >= 5


def test_a_torn_write_acts_at_once():
    chip = started(50, 0x01FF, 20, 20, 2, start=0x11)
    chip.advance(100_000)
    chip.write(0, 0x82)
    chip.write(2, 0x02)
    chip.advance(1)
    assert chip.advance(8192 * 2 * 100) == 0x02FF * 100, "neither the old value nor the new"
    chip.write(1, 0x00)
    chip.advance(1)
    assert chip.advance(8192 * 2 * 100) == 0x0200 * 100


def pulses_after(start, clocks=8192 * 6):
    return lambda chip: (commands(chip, start), chip.advance(clocks))[1]


def clocks_up(chip):
    commands(chip, 0x15)
    return clocks_while(chip, "fup")


def clocks_down(chip):
    clocks_up(chip)
    commands(chip, 0x14)
    return clocks_while(chip, "fdown")


@pytest.mark.parametrize(
    ("name", "bits", "value", "probe"),
    [
        pytest.param(*case, id=case[0])
        for case in (
            ("R1", 13, 100, pulses_after(0x10)),
            ("R2", 13, 100, pulses_after(0x11)),
            ("R3", 13, 100, pulses_after(0x13)),
            ("R4", 14, 9, clocks_up),
            ("R5", 14, 9, clocks_down),
            ("R6", 20, 7, lambda chip: chip.pins.lt),
            ("R7", 10, 3, pulses_after(0x11)),
        )
    ],
)
def test_bits_above_a_registers_width_are_dropped_and_its_top_bit_counts(name, bits, value, probe):
    def observed(written):
        chip = PCL240K()
        load_registers(chip, R0=8, R1=50, R2=400, R3=600, R4=3, R5=3, R6=0, R7=2)
        load_registers(chip, **{name: written})
        return probe(chip)

    dropped = 0xFFFFFF & -1 << bits
    assert observed(value | dropped) == observed(value)
    assert observed(value | 1 << bits - 1) != observed(value)


def test_r0_has_24_bits():
    chip = PCL240K()
    for value in (0xFFFFFF, 0x800000, 0x123456, 0):
        load_registers(chip, R0=value)
        assert counter(chip) == value


def test_write_only_registers_cannot_be_read_a_read_gives_r0():
    chip = PCL240K()
    load_registers(chip, R0=0x123456)
    for number in range(1, 8):
        load_registers(chip, **{f"R{number}": 0xFFFFFF})
        assert counter(chip) == 0x123456


def test_the_writes_that_lose_bits_are_diagnosed():
    chip = PCL240K()
    for r in PCL240K.MAP.registers[1:]:
        load_registers(chip, **{r.name: 0xFFFFFF})
        assert chip.values()[r.name] == r.mask
    assert len(chip.diagnostics) == sum((24 - r.bits + 7) // 8 for r in PCL240K.MAP.registers[1:])


def test_reset_clears_everything_but_the_clock():
    chip = started(*SLOW, control=0x4C, start=0x35)
    chip.write(0, 0xE1)
    chip.advance(12345)
    chip.reset()
    fresh = PCL240K()
    fresh.advance(12345)
    for a_chip in (chip, fresh):
        assert a_chip.clock == 12345
        assert a_chip.read(0) == 0b1010_1000, "no /INT, halted, FKEEP, ZERO"
        assert counter(a_chip) == 0
        assert a_chip.pins.hold
        assert not any(getattr(a_chip.pins, name) for name in ("ots", "pout", "pdir", "fup", "fdown", "lt", "irq"))
    assert set(chip.values().values()) == {0, chip.read(0)}
    load_registers(chip, R1=500, R7=2)
    chip.write(0, 0x10)
    assert chip.advance(8192 * 2) == 500, "armed as at power-up, no 08h needed, and all modes 0"
