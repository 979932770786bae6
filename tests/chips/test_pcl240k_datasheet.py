"""What the PCL-240K data sheet says, sentence by sentence, through the bus and the pins alone."""

import math
import time

import numpy as np
import pytest
from programs import load_registers

from stage.chips import PCL240K

SEED = np.random.SeedSequence().entropy
RNG = np.random.default_rng(SEED)
SPEEDS = [(50, 800, 300, 300, 20), (25, 500, 1500, 700, 30), (100, 8191, 2, 2, 2), (1, 40, 16383, 9000, 1023)] + [
    (
        int(RNG.integers(1, 400)),
        int(RNG.integers(401, 8192)),
        int(RNG.integers(2, 200)),
        int(RNG.integers(2, 200)),
        int(RNG.integers(2, 60)),
    )
    for _ in range(6)
]
speeds = pytest.mark.parametrize(("fl", "fh", "up", "down", "mult"), SPEEDS, ids=[f"set{k}" for k in range(len(SPEEDS))])


@pytest.fixture(autouse=True)
def _say_the_seed():
    print("seed of the random speeds", SEED)


def started(fl, fh, up, down, mult, r0=0xFFFFFF, r6=0, control=0x40, start=0x15):
    chip = PCL240K()
    load_registers(chip, R0=r0, R1=fl, R2=fh, R3=fh, R4=up, R5=down, R6=r6, R7=mult)
    chip.write(0, control)
    chip.write(0, start)
    return chip


def counter(chip):
    return chip.read(3) << 16 | chip.read(2) << 8 | chip.read(1)


def clocks_while(chip, pin, limit=1 << 40):
    """Clocks for which a pin stays asserted, found by bisection on snapshots: pins are seen between two ticks."""
    start, state = chip.clock, chip.snapshot()
    low, high = 0, 1
    while True:
        chip.restore(state)
        chip.advance(high)
        if not getattr(chip.pins, pin) or high > limit:
            break
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        chip.restore(state)
        chip.advance(middle)
        low, high = (middle, high) if getattr(chip.pins, pin) else (low, middle)
    chip.restore(state)
    chip.advance(high)
    return chip.clock - start


@speeds
def test_tsu_is_fh_minus_fl_times_r4_clocks(fl, fh, up, down, mult):
    chip = started(fl, fh, up, down, mult)
    assert clocks_while(chip, "fup") == (fh - fl) * up


@speeds
def test_tsd_is_fh_minus_fl_times_r5_clocks(fl, fh, up, down, mult):
    """The last speed step down comes R5 clocks before the ramp's mirror image ends."""
    chip = started(fl, fh, up, down, mult)
    chip.advance((fh - fl) * up + 10)
    chip.write(0, 0x14)
    assert chip.pins.fdown
    assert clocks_while(chip, "fdown") == (fh - fl - 1) * down + 1


@speeds
def test_output_frequency_is_clock_times_speed_over_8192_r7(fl, fh, up, down, mult):
    chip = started(fl, fh, up, down, mult, start=0x11)
    chip.advance(12345)
    assert chip.advance(8192 * mult * 1000) == fh * 1000


@speeds
def test_the_first_pulse_begins_after_one_period(fl, fh, up, down, mult):
    chip = started(fl, fh, up, down, mult, start=0x10)
    assert chip.trace(8192 * mult + 1)["clock"][0] == math.ceil(8192 * mult / fl)


@speeds
def test_the_duty_is_50_percent(fl, fh, up, down, mult):
    chip = started(fl, fh, up, down, mult, start=0x11)
    chip.trace(2 * 8192 * mult)
    period = 8192 * mult / fh
    low = []
    for _ in range(3):
        while not chip.pins.pout:
            clocks = max(1, int(period / 64))
            chip.advance(clocks)
        low.append(clocks_while(chip, "pout"))
    assert np.mean(low) == pytest.approx(period / 2, abs=max(period / 30, 2))


@speeds
def test_psd_plus_5_ends_with_5_pulses_at_fl_within_one(fl, fh, up, down, mult):
    psd = (fh**2 - fl**2) * down / (16384 * mult)
    psu = (fh**2 - fl**2) * up / (16384 * mult)
    r6 = int(psd) + 5
    r0 = int(psu) + r6 + 50
    if r6 > 0xFFFFF or r0 > 0xFFFFFF:
        pytest.skip("needs a down point beyond 20 bits")
    chip = started(fl, fh, up, down, mult, r0=r0, r6=r6, control=0x44)
    t = chip.trace(1 << 42)
    assert len(t) == r0
    period = 8192 * mult / fl
    whole = np.diff(t["clock"])[::-1] >= math.floor(period)
    at_fl = 1 + (len(whole) if whole.all() else int(np.argmin(whole)))  # pulses that begin while the speed is FL
    fewer = (fh - fl) * down / (16384 * mult)  # the staircase makes fewer pulses than the straight ramp
    alike = 4 * down * fl / (8192 * mult)  # pulses of the last speed steps above FL, whose period rounds to the same
    assert 4 <= at_fl <= 7 + fewer + alike


@speeds
def test_ramps_make_the_pulses_of_the_formula_within_one(fl, fh, up, down, mult):
    chip = started(fl, fh, up, down, mult)
    made = chip.advance((fh - fl) * up)
    staircase = ((fh**2 - fl**2) - (fh - fl)) * up / (16384 * mult)
    assert made == pytest.approx(staircase, abs=1.01)
    chip.advance(1000)
    chip.write(0, 0x14)
    made = chip.advance((fh - fl) * down)
    staircase = ((fh**2 - fl**2) - (fh - fl)) * down / (16384 * mult)
    assert made == pytest.approx(staircase, abs=1.5), "the phase at the ramp's start is worth up to a pulse"


@speeds
def test_triangular_drive_with_r6_of_the_formula_peaks_once_and_ends_on_its_pulse(fl, fh, up, down, mult):
    limit = (fh**2 - fl**2) * (up + down) / (16384 * mult)
    r0 = min(int(limit * 0.6), 0xFFFFFF)
    r6 = r0 * down // (up + down)
    if r0 < 20 or r6 > 0xFFFFF:
        pytest.skip("no triangle with these speeds")
    chip = started(fl, fh, up, down, mult, r0=r0, r6=r6, control=0x44)
    t = chip.trace(1 << 42)["clock"]
    assert len(t) == r0
    assert counter(chip) == 0
    gaps = np.diff(t)
    assert gaps.min() >= math.floor(8192 * mult / fh), "never beyond FH"
    peak = int(np.argmin(gaps))
    assert (np.diff(gaps[:peak]) <= 1).all(), "only up before the peak (the phase rounds to a clock)"
    assert (np.diff(gaps[peak:]) >= -1).all(), "only down after it"


def test_the_counter_wraps_below_zero_to_the_maximum():
    chip = started(50, 800, 30, 30, 2, r0=3, start=0x11)
    chip.advance(8192 * 2 * 5 // 800 + 30)
    assert counter(chip) > 0xFFFFF0


def test_r6_above_r0_before_the_start_means_no_ramp_up():
    chip = started(50, 800, 30, 30, 2, r0=20, r6=21, control=0x44)
    t = chip.trace(1 << 30)["clock"]
    assert len(t) == 20
    assert (np.diff(t) >= 8192 * 2 // 50).all()


def test_a_start_with_an_empty_counter_makes_no_pulse_and_no_int():
    chip = started(50, 800, 30, 30, 2, r0=0, control=0x44, start=0x35)
    assert chip.pins.hold
    assert chip.read(0) & 0x40 == 0
    assert chip.advance(1_000_000) == 0
    assert not chip.pins.irq
    load_registers(chip, R0=3)
    chip.write(0, 0x35)
    assert chip.advance(1_000_000) == 3, "it is still armed"


@pytest.mark.parametrize("interrupt", [0x1F, 0x08])
def test_residual_pulses_are_kept_and_resumed(interrupt):
    chip = started(50, 800, 30, 30, 2, r0=5000, r6=40, control=0x44, start=0x17)
    made = chip.advance(60_000)
    chip.write(0, interrupt)
    made += chip.advance(100_000)
    assert chip.pins.hold
    assert counter(chip) == 5000 - made > 0
    chip.write(0, 0x08)
    chip.write(0, 0x17)
    assert made + chip.advance(1 << 30) == 5000


def test_status_bit_6_falls_only_after_the_pulse_is_complete():
    chip = started(50, 100, 30, 30, 2, start=0x11)
    chip.advance(8192 * 2 // 100 + 1)
    assert chip.pins.pout
    chip.write(0, 0x08)
    assert chip.read(0) & 0x40
    chip.advance(60)
    assert chip.read(0) & 0x40
    chip.advance(60)
    assert chip.read(0) & 0x40 == 0
    assert not chip.pins.pout


def test_int_comes_at_the_stop_when_d5_asked_for_it_and_a_00_command_without_d5_clears_it():
    chip = started(50, 800, 30, 30, 2, r0=10, control=0x44, start=0x31)
    chip.advance(1 << 20)
    assert chip.pins.irq
    assert chip.read(0) & 0x80 == 0
    chip.write(0, 0x00)
    assert not chip.pins.irq
    assert chip.read(0) & 0x80
    quiet = started(50, 800, 30, 30, 2, r0=10, control=0x44, start=0x11)
    quiet.advance(1 << 20)
    assert not quiet.pins.irq


def test_the_reset_command_with_d5_interrupts_a_run_but_not_a_halted_chip():
    chip = started(50, 800, 30, 30, 2)
    chip.advance(5000)
    chip.write(0, 0x28)
    chip.advance(1000)
    assert chip.pins.irq
    chip.write(0, 0x00)
    chip.write(0, 0x28)
    chip.advance(1000)
    assert not chip.pins.irq


def test_after_a_stop_the_reset_command_is_required_before_the_next_start():
    chip = started(50, 800, 30, 30, 2, r0=10, control=0x44)
    chip.advance(1 << 22)
    load_registers(chip, R0=10)
    chip.write(0, 0x15)
    assert chip.advance(1 << 22) == 0
    assert "reset command" in chip.diagnostics[-1].message
    chip.write(0, 0x08)
    chip.write(0, 0x15)
    assert chip.advance(1 << 22) == 10


def test_speed_changes_between_fh1_and_fh2_in_motion_with_a_ramp():
    chip = PCL240K()
    load_registers(chip, R0=0xFFFFFF, R1=50, R2=400, R3=900, R4=20, R5=30, R6=0, R7=2)
    chip.write(0, 0x40)
    chip.write(0, 0x15)
    chip.advance(350 * 20)
    assert chip.pins.fkeep
    chip.write(0, 0x17)
    assert chip.pins.fup
    assert clocks_while(chip, "fup") == 500 * 20
    chip.write(0, 0x15)
    assert chip.pins.fdown
    assert clocks_while(chip, "fdown") == 499 * 30 + 1


def test_rewriting_the_register_not_selected_has_no_influence():
    one, two = (started(50, 400, 20, 30, 2) for _ in range(2))
    for chip in (one, two):
        chip.advance(5000)
    load_registers(two, R3=8000)
    assert (one.trace(100_000) == two.trace(100_000)).all()


def test_dual_rate_14h_ramps_down_to_fl_and_keeps_running():
    chip = started(50, 800, 20, 20, 2)
    chip.advance(750 * 20)
    chip.write(0, 0x14)
    chip.advance(750 * 20)
    assert chip.pins.fkeep
    assert chip.advance(8192 * 2 * 10) == 500


def test_after_a_constant_start_bit_2_turns_ramps_on():
    chip = started(50, 800, 20, 20, 2, start=0x10)
    chip.advance(20_000)
    chip.write(0, 0x15)
    assert chip.pins.fup
    assert clocks_while(chip, "fup") == 750 * 20


def test_a_torn_read_across_a_borrow_lies_and_the_remedy_of_the_q_and_a_does_not():
    chip = started(50, 8000, 2, 2, 2, r0=0x010000 + 1, start=0x11)
    chip.write(0, 0x11)
    high = chip.read(3)
    chip.advance(8192 * 2 * 3 // 50)
    torn = high << 16 | chip.read(2) << 8 | chip.read(1)
    true = counter(chip)
    assert true < 0x010000 < torn
    assert torn - true >= 0xFF00


def test_a_torn_write_acts_at_once():
    chip = started(50, 0x01FF, 20, 20, 2, start=0x11)
    chip.advance(100_000)
    chip.write(0, 0x82)
    chip.write(2, 0x02)
    assert chip.advance(8192 * 2 * 100) == pytest.approx(0x02FF * 100, abs=1), "neither the old value nor the new"


@pytest.mark.parametrize(("pin", "other", "control"), [("el_plus", "el_minus", 0x40), ("el_minus", "el_plus", 0x48)])
def test_an_end_limit_stops_its_direction_at_once_and_leaves_the_other_free(pin, other, control):
    chip = started(50, 800, 20, 20, 2, control=control)
    chip.advance(20_000)
    setattr(chip.pins, other, True)
    assert chip.advance(20_000) > 0
    setattr(chip.pins, pin, True)
    chip.advance(200)
    assert chip.pins.hold
    chip.write(0, 0x08)
    chip.write(0, 0x15)
    assert chip.advance(100_000) == 0
    setattr(chip.pins, other, False)
    chip.write(0, control ^ 0x08)
    chip.write(0, 0x15)
    assert chip.advance(100_000) > 0


def test_sd_slows_a_high_speed_run_only_when_enabled_and_lets_it_ramp_up_again():
    chip = started(50, 800, 20, 20, 2, control=0x42)
    chip.advance(750 * 20)
    chip.pins.sd_minus = True
    chip.advance(10)
    assert chip.pins.fkeep, "the other direction's switch means nothing"
    chip.pins.sd_plus = True
    chip.advance(10)
    assert chip.pins.fdown
    assert chip.read(0) & 0x04
    chip.advance(750 * 20)
    assert chip.pins.fkeep
    chip.pins.sd_plus = False
    chip.advance(10)
    assert chip.pins.fup
    disabled = started(50, 800, 20, 20, 2, control=0x40)
    disabled.advance(750 * 20)
    disabled.pins.sd_plus = True
    disabled.advance(10)
    assert disabled.pins.fkeep


def test_org_stops_only_an_origin_return():
    for control, stops in ((0x41, True), (0x40, False)):
        chip = started(50, 800, 20, 20, 2, control=control)
        chip.advance(20_000)
        chip.pins.org = True
        chip.advance(200)
        assert chip.pins.hold == stops
        assert chip.read(0) & 0x02


def test_extp_counts_rising_edges_and_stops_a_preset_run():
    chip = started(50, 800, 20, 20, 2, r0=3, control=0x44, start=0x08)
    chip.write(0, 0xD0)
    chip.write(0, 0x10)
    assert chip.advance(100_000) > 3, "output pulses do not count now"
    for left in (2, 1, 0):
        chip.pins.extp = True
        chip.advance(10)
        assert counter(chip) == left + 1
        chip.pins.extp = False
        chip.advance(10)
        assert counter(chip) == left
    chip.advance(1000)
    assert chip.pins.hold


def test_ots_follows_the_output_mode_and_ins_is_read_in_the_status():
    chip = PCL240K()
    for level in (True, False):
        chip.write(0, 0xE0 if level else 0xC0)
        assert chip.pins.ots == level
        chip.pins.ins = level
        assert bool(chip.read(0) & 0x01) == level


@pytest.mark.parametrize(("control", "pin", "silent"), [(0x40, "pout", "pdir"), (0x48, "pdir", "pout")])
def test_independent_mode_puts_plus_pulses_on_pout_and_minus_pulses_on_pdir(control, pin, silent):
    chip = started(50, 800, 20, 20, 2, control=control, start=0x08)
    chip.write(0, 0xC1)
    chip.write(0, 0x10)
    seen = {pin: 0, silent: 0}
    for _ in range(2000):
        chip.advance(1)
        for name in seen:
            seen[name] += getattr(chip.pins, name)
    assert seen[pin] > 0
    assert seen[silent] == 0


def test_registers_drop_the_bits_above_their_width_and_read_as_r0():
    chip = PCL240K()
    for r in PCL240K.MAP.registers[1:]:
        load_registers(chip, **{r.name: 0xFFFFFF})
        assert chip.values()[r.name] == r.mask
        assert counter(chip) == 0, "only R0 can be read"
    assert len(chip.diagnostics) == sum((24 - r.bits + 7) // 8 for r in PCL240K.MAP.registers[1:])


def test_reset_clears_everything_but_the_clock():
    chip = started(50, 800, 20, 20, 2)
    chip.advance(12345)
    chip.reset()
    assert chip.clock == 12345
    assert set(chip.values().values()) == {0, chip.read(0)}
    assert chip.pins.hold
    fresh = PCL240K()
    fresh.advance(12345)
    assert chip.read(0) == fresh.read(0)


def test_the_longest_preset_move_advances_in_milliseconds():
    def move(r0):
        chip = started(50, 8000, 300, 300, 2, r0=r0, r6=120_000, control=0x44)
        begin = time.perf_counter()
        assert chip.advance(1 << 42) == r0
        return time.perf_counter() - begin

    move(1000)
    assert min(move(16_777_215) for _ in range(3)) < 0.02
