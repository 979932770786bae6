"""The slow reference of the TMC5160 keeps the data sheet's worked examples and formulas before anything is held against it."""

import pytest
from tmc5160_reference import programs
from tmc5160_reference.chip import Reference
from tmc5160_reference.controls import (
    HOLD,
    PLUS,
    create_reference,
    read_bit,
    read_register,
    read_speed,
    set_steady_speed,
    tick_until,
    write_registers,
)
from tmc5160_reference.registers import ADDRESS, TABLE

# Bus


def test_reset_values_masks_and_access():
    chip = Reference()
    for address, name, access, _, reset in TABLE:
        expected = 0 if access == "W" else {"MSCURACT": 0x00F70000}.get(name, reset)
        assert chip.read(address) == expected, name
    for address, name, access, width, _ in TABLE:
        chip.write(address, 0xFFFFFFFF)
        if access == "RW":
            assert chip.read(address) == (1 << width) - 1, name
    assert read_register(chip, "GSTAT") == 0
    assert chip.read(0x7F) == 0


def test_spi_replies_in_the_next_datagram_with_the_status_first():
    chip = Reference()
    sent = (0x2100000000, 0x2100000000, 0xA700ABCDEF, 0xA700123456)
    chip.write(ADDRESS["XACTUAL"], 5)
    answers = [chip.transfer(datagram) for datagram in sent]
    assert [a & 0xFFFFFFFF for a in answers] == [0, 5, 5, 0x00ABCDEF]
    assert Reference().transfer(0) >> 32 == 0x31
    status = chip.transfer(0x8100000007) >> 32  # GSTAT: reset is cleared; what comes back is older than that
    assert (status & 1, chip.transfer(0) >> 32 & 1) == (1, 0)


# Switches and stops


def test_flags_follow_a_write_and_events_are_cleared_by_a_one():
    chip = create_reference()
    write_registers(chip, RAMP_STAT=0x80)
    assert read_register(chip, "RAMP_STAT") == 0x700
    write_registers(chip, XTARGET=5, VMAX=9)
    assert read_register(chip, "RAMP_STAT") == 0x400
    write_registers(chip, RAMP_STAT=0, XACTUAL=5)
    assert read_register(chip, "RAMP_STAT") == 0x680
    write_registers(chip, RAMP_STAT=0x80)
    assert read_register(chip, "RAMP_STAT") == 0x600


def test_a_hard_stop_holds_the_latched_position_and_continues_when_released():
    chip = create_reference(
        VSTART=90000, AMAX=60000, VMAX=99000, DMAX=60000, VSTOP=90000, XTARGET=-100, SW_MODE=0x21, TZEROWAIT=1
    )
    tick_until(chip, lambda: len(chip.steps) == 12)
    chip.set_pin("REFL_STEP", True)
    assert not read_bit(chip, 0)
    chip.tick()
    assert (chip.q, read_register(chip, "XACTUAL"), read_register(chip, "XLATCH")) == (0, 2**32 - 12, 2**32 - 12)
    assert read_register(chip, "RAMP_STAT") & 0x3F == 0x15
    stop = chip.clock
    chip.set_pin("REFL_STEP", False)
    assert tick_until(chip, lambda: chip.q) == stop + 513
    assert not read_bit(chip, 4)
    assert read_bit(chip, 2)


def test_a_soft_stop_takes_the_braking_distance_of_the_formula():
    chip = create_reference(VSTART=29900, AMAX=60000, VMAX=60000, XTARGET=900, SW_MODE=0x882, DMAX=60000, VSTOP=20000)
    tick_until(chip, lambda: read_speed(chip) == 30000)
    chip.set_pin("REFR_DIR", True)
    tick_until(chip, lambda: chip.dir == 0)
    distance = read_register(chip, "XACTUAL") - read_register(chip, "XLATCH")
    assert distance == pytest.approx((30000**2 - 20000**2) / (256 * 60000), abs=1)


def test_polarity_and_swap_are_edges():
    chip = create_reference(XACTUAL=7, XTARGET=7, SW_MODE=0x80)
    write_registers(chip, SW_MODE=0x88)
    assert read_register(chip, "XLATCH") == 0
    chip.tick()
    assert (read_register(chip, "XLATCH"), read_register(chip, "RAMP_STAT") & 0xB) == (7, 0xA)
    chip.set_pin("REFL_STEP", True)
    write_registers(chip, SW_MODE=0x90)
    chip.tick()
    assert read_register(chip, "RAMP_STAT") & 3 == 2


def test_emergency_stop_freezes_and_resumes_at_the_old_speed():
    chip = create_reference(AMAX=60000, VMAX=60000, RAMPMODE=PLUS, GCONF=0x8000)
    chip.advance(3000)
    before = chip.q, chip.ph, len(chip.steps)
    chip.set_pin("ENCA_DCIN_CFG5", True)
    chip.advance(300)
    assert (chip.q, chip.ph, len(chip.steps)) == before
    assert read_register(chip, "TSTEP") == 0xFFFFF
    chip.set_pin("ENCA_DCIN_CFG5", False)
    chip.tick()
    assert chip.q == before[0] + 60000


# Driver


def test_sequencer_positions_of_every_resolution():
    for mres, first, size in ((0, 1, 1), (2, 2, 4), (7, 64, 128), (8, 128, 256)):
        chip = Reference()
        write_registers(chip, CHOPCONF=mres << 24)
        positions = []
        for _ in range(3):
            chip.sequence(1)
            positions.append(read_register(chip, "MSCNT"))
        assert positions == [first + k * size for k in range(3)]
        for _ in range(3):
            chip.sequence(-1)
        assert read_register(chip, "MSCNT") == (first - size) % 1024
    write_registers(chip, GCONF=0x10)
    chip.sequence(-1)
    assert read_register(chip, "MSCNT") == 128  # shaft: from 896 forwards
    assert read_register(chip, "MSCURACT") == 175 | 174 << 16


def test_standstill_then_power_down_by_one_a_delay():
    chip = create_reference(IHOLD_IRUN=0x10503, TPOWERDOWN=2, GCONF=2, AMAX=60000, VMAX=60000)
    assert read_bit(chip, 31, "DRV_STATUS") == 0
    levels = []
    for periods in range(6):  # each a 2^18 clocks, of which the last alone is looked at
        chip.since = (1 << 18) * (periods + 1) - 1
        chip.down_timer = (1 << 18) - 1
        chip.tick()
        levels.append((read_bit(chip, 31, "DRV_STATUS"), read_register(chip, "DRV_STATUS") >> 16 & 31))
    assert levels == [(1, 5), (1, 5), (1, 5), (1, 4), (1, 3), (1, 3)]
    write_registers(chip, IHOLD_IRUN=0x10501)
    assert read_register(chip, "DRV_STATUS") >> 16 & 31 == 1
    write_registers(chip, VSTART=60000, VSTOP=60000, XTARGET=1)
    tick_until(chip, lambda: chip.steps)
    assert (read_bit(chip, 31, "DRV_STATUS"), read_register(chip, "DRV_STATUS") >> 16 & 31) == (0, 5)


def test_thresholds_have_the_hysteresis_of_the_examples():
    chip = create_reference(TCOOLTHRS=280, GCONF=4, TPWMTHRS=500)
    for v, cool, stealth in (
        (33554, 0, 1), (35848, 0, 1), (35849, 0, 0), (33555, 0, 0), (33554, 0, 1), (64035, 0, 0), (64036, 1, 0),
        (59707, 1, 0), (59705, 0, 0), (30000, 0, 1),
    ):  # fmt: skip
        set_steady_speed(chip, v)
        assert (chip.cool, read_bit(chip, 14, "DRV_STATUS")) == (cool, stealth), v


def test_stall_guard_values_and_stop():
    chip = create_reference(
        AMAX=60000, VSTART=60000, VSTOP=60000, VMAX=70000, XTARGET=100, TCOOLTHRS=5000, SW_MODE=0x400, TZEROWAIT=1
    )
    for lam, sgt, value in ((0, 0, 511), (512, 0, 255), (1023, 0, 0), (1024, 10, 80)):
        write_registers(chip, COOLCONF=sgt << 16)
        chip.set_load(lam, 512)
        chip.measure()
        assert read_register(chip, "DRV_STATUS") & 0x3FF == value
    write_registers(chip, COOLCONF=0, CHOPCONF=0x18000003)
    chip.set_load(0, 512)
    tick_until(chip, lambda: len(chip.steps) == 3)
    chip.set_load(1024, 512)
    steps = len(chip.steps)
    stop = tick_until(chip, lambda: chip.q == 0)
    assert len(chip.steps) == steps + 1
    assert read_bit(chip, 6)
    chip.advance(600)
    assert chip.q == 0
    chip.set_load(0, 512)
    write_registers(chip, RAMP_STAT=0x40)
    assert tick_until(chip, lambda: chip.q) == stop + 601


def test_filtered_stall_guard_is_the_mean_of_four():
    chip = create_reference(COOLCONF=1 << 24)
    values = []
    for lam in (0, 256, 512, 1024, 0):
        chip.set_load(lam, 1024)
        chip.measure()
        values.append(read_register(chip, "DRV_STATUS") & 0x3FF)
    assert values == [0, 0, 0, (1023 + 767 + 511) // 4, (1023 + 767 + 511) // 4]


def test_cool_step_raises_and_lowers_the_current_and_leaves_at_irun():
    chip = create_reference(IHOLD_IRUN=0x01000, TCOOLTHRS=5000, COOLCONF=2 | 1 << 5 | 1 << 8 | 3 << 13)
    set_steady_speed(chip, 60000)
    currents = []
    for lam in (0, 0, 0, 1024, 1024, 920):
        chip.set_load(lam, 1024)
        chip.measure()
        currents.append(chip.current)
    assert currents == [15, 14, 13, 15, 16, 16]
    for _ in range(20):
        chip.set_load(0, 1024)
        chip.measure()
    assert chip.current == 8
    set_steady_speed(chip, 0)
    assert chip.current == 16


def test_a_short_switches_off_until_the_driver_is_released():
    chip = create_reference()
    chip.set_fault("s2ga", True)
    chip.tick()
    write_registers(chip, GSTAT=7)
    chip.tick()
    assert (chip.driver_on, read_register(chip, "GSTAT"), read_bit(chip, 27, "DRV_STATUS")) == (False, 2, 1)
    chip.set_fault("s2ga", False)
    write_registers(chip, CHOPCONF=0)
    write_registers(chip, CHOPCONF=3, GSTAT=7)
    chip.tick()
    assert (chip.driver_on, read_register(chip, "GSTAT")) == (True, 0)
    with pytest.raises(KeyError, match="no fault 'fire'; there are s2ga, "):
        chip.set_fault("fire", True)
    with pytest.raises(KeyError, match="no input pin 'CLK'; there are REFL_STEP, "):
        chip.set_pin("CLK", True)


# Encoder


def send_quadrature(chip, edges):
    order = ((False, False), (True, False), (True, True), (False, True))
    for k in range(edges + 1) if edges > 0 else range(0, edges - 1, -1):
        a, b = order[k % 4]
        chip.set_pin("ENCA_DCIN_CFG5", a)
        chip.set_pin("ENCB_DCEN_CFG4", b)
        chip.tick()


@pytest.mark.parametrize(
    ("constant", "decimal", "edges", "position"),
    [(0x000C8000, 0, 7, 87), (0x003307D0, 0x400, 5, 256), (0xFFE60FA0, 0x400, 5, -128), (0x000C8000, 0, -4, -50)],
)
def test_encoder_counts_the_factor(constant, decimal, edges, position):
    chip = create_reference(ENC_CONST=constant, ENCMODE=decimal)
    send_quadrature(chip, edges)
    assert read_register(chip, "X_ENC") == position % 2**32
    write_registers(chip, ENC_DEVIATION=20)
    chip.tick()
    assert read_register(chip, "ENC_STATUS") == 2


def test_n_event_latches_once_and_clears():
    chip = create_reference(ENCMODE=0x36C, XACTUAL=9, XTARGET=9, X_ENC=5)  # rise, clear once, both positions, N high
    chip.tick()
    assert read_register(chip, "ENC_STATUS") == 0
    chip.set_pin("ENCN_DCO_CFG6", True)
    chip.tick()
    assert [read_register(chip, n) for n in ("ENC_STATUS", "ENC_LATCH", "X_ENC", "XLATCH", "ENCMODE")] == [
        1,
        5,
        0,
        9,
        0x34C,
    ]
    write_registers(chip, ENC_STATUS=1)
    assert read_register(chip, "ENC_STATUS") == 0


def test_diag_pins_are_low_active_after_reset():
    chip = Reference()
    assert (chip.diag0(), chip.diag1()) == (False, False)
    write_registers(chip, RAMP_STAT=0x80, X_COMPARE=1)
    assert (chip.diag0(), chip.diag1()) == (True, True)
    write_registers(chip, GCONF=0x3000)
    assert (chip.diag0(), chip.diag1()) == (False, False)


# Homing, programs


def test_homing_by_the_sheet_ends_on_the_switching_point():
    chip = create_reference(VSTART=40000, AMAX=60000, DMAX=60000, VMAX=41000, VSTOP=38000, SW_MODE=0x821, XTARGET=-1000)
    tick_until(chip, lambda: len(chip.steps) == 20)
    chip.set_pin("REFL_STEP", True)
    tick_until(chip, lambda: chip.q == 0)
    assert read_bit(chip, 10)
    write_registers(chip, RAMPMODE=HOLD)
    away = read_register(chip, "XACTUAL") - read_register(chip, "XLATCH")
    write_registers(chip, XACTUAL=away, XTARGET=away, RAMPMODE=0)
    chip.advance(10)
    assert chip.q == 0
    write_registers(chip, XTARGET=0)
    tick_until(chip, lambda: chip.dir == 0)
    assert read_bit(chip, 9)
    assert sum(direction for _, direction in chip.steps) == -20


def test_a_program_is_the_same_again_and_eventful():
    clocks = 9_000
    steps, answers = 0, 0
    for seed in range(3):
        program = programs.random_program(seed, clocks)
        assert program == programs.random_program(seed, clocks)
        chip = Reference()
        answers += len(programs.play(chip, program, clocks))
        assert chip.clock == clocks
        steps += len(chip.steps)
    assert steps > 9
    assert answers > 200


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_sampling_inputs_only_after_a_change_equals_sampling_every_clock(seed):
    class Attentive(Reference):
        def tick(self):
            self.touched = True
            super().tick()

    program = programs.random_program(seed, 60_000)
    quick, attentive = Reference(), Attentive()
    assert programs.play(quick, program, 60_000) == programs.play(attentive, program, 60_000)
    assert vars(quick) == vars(attentive)
