"""The TMC2209 as a power stage of STEP/DIR axes: microsteps, currents, standstill, speed thresholds, internal steps, pins."""

import math

import pytest

from pulsestage_trinamic.power_stages import TMC2209 as POWER_STAGE
from pulsestage_trinamic.tmc2209 import TMC2209
from stage import Drive, Stage, firmware
from stage.board.pin_assignment import parse_pins
from stage.errors import ArgumentError
from stage.testing import power_stage_conformance

CHOPCONF = 0x10010053
FULL_STEP_M = 10e-3 / 200
CLOCK_NS = 1e9 / 12e6


def make_steps(chip, count, period_ns=100_000):
    """Make steps in the direction of DIR, one in each period."""
    for _ in range(count):
        chip.step = True
        chip.advance(period_ns // 2)
        chip.step = False
        chip.advance(period_ns - period_ns // 2)


def set_microsteps(chip, microsteps, extra=0):
    chip.write_register("GCONF", chip.read_register("GCONF") | 0x80)
    chip.write_register("CHOPCONF", 0x53 | (256 // microsteps).bit_length() - 1 << 24 | extra)


def test_it_keeps_what_every_power_stage_promises():
    power_stage_conformance("tmc2209")


def test_the_name_gives_a_stepdir_axis_the_registers_of_the_chip():
    stage = Stage("xy", chips="stepdir", drives={"x": "tmc2209", "y": "a4988"}, visuals=False)
    assert isinstance(stage.axes["x"].chip, TMC2209)
    assert type(stage.axes["y"].chip).__name__ == "STEPDIR"
    assert stage.axes["x"].drive.power_stage is POWER_STAGE


@pytest.mark.parametrize(("levels", "microsteps"), [("LL", 8), ("HL", 32), ("LH", 64), ("HH", 16)])
def test_ms1_and_ms2_select_the_microsteps_of_the_data_sheets_table(levels, microsteps):
    chip = TMC2209()
    chip.pins.ms1, chip.pins.ms2 = (level == "H" for level in levels)
    make_steps(chip, 3)
    assert chip.read_register("MSCNT") == 3 * 256 // microsteps
    assert POWER_STAGE.find_microsteps(levels) == microsteps
    on_stage = Stage("xy", chips="stepdir", drives=Drive(power_stage="tmc2209", microsteps=microsteps), visuals=False)
    assert on_stage.axes["x"].chip.microsteps == microsteps


@pytest.mark.parametrize("microsteps", [1, 2, 4, 8, 16, 32, 64, 128, 256])
def test_mres_selects_256_to_1_microsteps_once_mstep_reg_select_is_set(microsteps):
    chip = TMC2209()
    chip.write_register("CHOPCONF", 0x53 | (256 // microsteps).bit_length() - 1 << 24)
    make_steps(chip, 1)
    assert chip.read_register("MSCNT") == 16  # as MS1 and MS2 say
    assert [d.key for d in chip.diagnostics] == ["tmc2209-mres-unused"] * (microsteps != 256)
    set_microsteps(chip, microsteps)
    chip.dir = True
    make_steps(chip, 5)
    assert chip.read_register("MSCNT") == (16 - 5 * 256 // microsteps) % 1024


def test_shaft_inverts_the_direction_and_dedge_counts_both_edges():
    chip = TMC2209()
    set_microsteps(chip, 16, extra=1 << 29)
    make_steps(chip, 4)
    assert chip.read_register("MSCNT") == 8 * 16
    assert chip.read_register("POSITION") == 8
    chip.write_register("GCONF", 0x189)
    make_steps(chip, 2)
    assert chip.read_register("MSCNT") == 4 * 16


def test_a_step_moves_the_motor_by_the_microsteps_that_are_set():
    stage = Stage("xy", chips="stepdir", drives="tmc2209", visuals=False)
    x = stage.axes["x"]
    x.pulse(320, rate=4000)
    stage.run(0.1)
    assert x.position == pytest.approx(20 * FULL_STEP_M, abs=5e-6)
    set_microsteps(x.chip, 4)
    x.pulse(80, rate=1000)
    stage.run(0.1)
    assert x.position == pytest.approx(40 * FULL_STEP_M, abs=5e-6)
    assert (x.lost_steps, x.commanded) == (0, pytest.approx(40 * FULL_STEP_M, abs=1e-9))


def test_microsteps_that_the_pins_do_not_have_are_written_by_the_host_driver():
    stage = Stage("xy", chips="stepdir", drives=Drive(power_stage="tmc2209", microsteps=128), visuals=False)
    x = stage.axes["x"]
    assert x.chip.microsteps == 16
    firmware.move(x, 2e-3)
    assert x.chip.microsteps == 128
    assert x.position == pytest.approx(2e-3, abs=5e-6)


def test_interpolation_moves_the_field_in_256_microsteps():
    """Compare the ripple of the speed: half steps make a rotor ring, and interpolation turns the field evenly."""
    speeds = {}
    for intpol in (0, 1 << 28):
        stage = Stage("xy", chips="stepdir", drives=Drive(power_stage="tmc2209", detent=0), visuals=False)
        x = stage.axes["x"]
        set_microsteps(x.chip, 2, extra=intpol)
        for name, value in {"START": 20, "RATE": 400, "UP": 200_000}.items():
            x.chip.write_register(name, value)
        x.chip.write(*x.chip.command_cycles("RUN+")[0])
        stage.run(0.4)
        measured = []
        for _ in range(300):
            stage.run(0.37e-3)
            measured.append(float(stage.data.qvel[x.plant.dof]))
        speeds[intpol] = max(measured) - min(measured)
    assert speeds[1 << 28] < 0.3 * speeds[0]


@pytest.mark.parametrize(
    ("irun", "vsense", "rsense", "amplitude"),
    [(31, 0, 0.11, 2.5), (31, 1, 0.11, 1.3846), (15, 0, 0.11, 1.25), (31, 0, 0.075, 3.4211), (0, 0, 0.11, 0.078125)],
)
def test_irun_vsense_and_the_sense_resistor_set_the_current(irun, vsense, rsense, amplitude):
    """I peak = (CS + 1) / 32 VFS / (RSENSE + 20 mohm)."""
    chip = TMC2209(rsense=rsense)
    chip.write_register("GCONF", 0x100)
    chip.write_register("CHOPCONF", CHOPCONF | vsense << 17)
    chip.write_register("IHOLD_IRUN", irun << 8)
    assert chip.amplitude == pytest.approx(amplitude, rel=1e-4)


def test_after_power_up_vref_gives_the_current_of_the_drive():
    stage = Stage("xy", chips="stepdir", drives=Drive(power_stage="tmc2209", current=1.2), visuals=False)
    chip = stage.axes["x"].chip
    assert chip.amplitude == pytest.approx(1.2)
    assert POWER_STAGE.compute_current_limit(vref=1.2) == pytest.approx(1.2)
    chip.write_register("IHOLD_IRUN", 15 << 8)
    assert chip.amplitude == pytest.approx(0.6)
    chip.write_register("GCONF", 0x100)  # VREF no longer counts
    assert chip.amplitude == pytest.approx(1.25)


def test_the_current_falls_step_by_step_after_standstill_and_tpowerdown():
    chip = TMC2209()
    chip.write_register("IHOLD_IRUN", 28 | 31 << 8 | 2 << 16)
    chip.write_register("TPOWERDOWN", 4)
    make_steps(chip, 1, period_ns=2)
    down = (1 << 20) + 4 * (1 << 18)
    for step in range(4):
        at = (down + 2 * step * (1 << 18)) * CLOCK_NS
        chip.advance(round(at) - chip.clock - 500)
        assert chip.read_register("DRV_STATUS") >> 16 & 31 == 31 - max(0, step - 1)
        chip.advance(1000)
        assert chip.read_register("DRV_STATUS") >> 16 & 31 == 31 - step
    assert chip.read_register("DRV_STATUS") >> 31 == 1
    make_steps(chip, 1)
    assert (chip.read_register("DRV_STATUS") >> 16 & 31, chip.read_register("DRV_STATUS") >> 31) == (31, 0)


@pytest.mark.parametrize(("pdn_disable", "pdn", "cs"), [(0, False, 16), (0, True, 31), (1, True, 16)])
def test_pdn_uart_or_pdn_disable_reduces_the_current_at_rest(pdn_disable, pdn, cs):
    chip = TMC2209()
    chip.write_register("GCONF", 0x101 | pdn_disable << 6)
    chip.pins.pdn = pdn
    chip.advance(3 * 10**9)
    assert chip.read_register("DRV_STATUS") >> 16 & 31 == cs


def test_freewheel_at_ihold_0_switches_the_motor_off_in_stealth_chop():
    chip = TMC2209()
    chip.write_register("IHOLD_IRUN", 31 << 8)
    chip.write_register("PWMCONF", 0xC80D0E24 | 1 << 20)
    chip.advance(3 * 10**9)
    assert chip.amplitude == 0
    assert "FREEWHEEL" in chip.explain_missing_current()
    chip.write_register("GCONF", 0x105)
    assert chip.amplitude == pytest.approx(2.5 / 32)


def test_toff_0_enable_and_faults_switch_the_motor_off_and_show():
    chip = TMC2209()
    chip.write_register("CHOPCONF", CHOPCONF & ~15)
    assert chip.amplitude == 0
    chip.write_register("CHOPCONF", CHOPCONF)
    chip.pins.enable = False
    assert (chip.amplitude, chip.read_register("IOIN") & 1) == (0, 1)
    chip.pins.enable = True
    chip.pins.s2ga = True
    chip.pins.s2ga = False
    assert (chip.amplitude, chip.diag) == (0, True)
    assert chip.read_register("DRV_STATUS") & 0x3C == 4
    assert chip.read_register("GSTAT") & 2
    chip.pins.enable = False
    chip.pins.enable = True
    assert (chip.diag, chip.amplitude > 0) == (False, True)
    chip.write_register("GSTAT", 3)
    assert chip.read_register("GSTAT") == 0


@pytest.mark.parametrize("microsteps", [1, 8, 16, 256])
def test_tstep_is_the_time_of_a_256th_step(microsteps):
    chip = TMC2209()
    set_microsteps(chip, microsteps)
    assert chip.read_register("TSTEP") == 0xFFFFF
    make_steps(chip, 4, period_ns=1_000_000)
    assert chip.read_register("TSTEP") == 12_000 * microsteps // 256
    chip.advance(10**9)
    assert chip.read_register("TSTEP") == 0xFFFFF


def test_tpwmthrs_switches_from_stealth_chop_to_spread_cycle_with_hysteresis():
    chip = TMC2209()
    chip.write_register("TPWMTHRS", 75)

    def is_stealth_at(tstep):
        make_steps(chip, 3, period_ns=math.ceil(tstep * 16 * CLOCK_NS))
        return bool(chip.read_register("DRV_STATUS") >> 30 & 1)

    assert [is_stealth_at(t) for t in (80, 72, 69, 72, 74, 76)] == [True, True, False, False, False, True]
    chip.pins.spread = True
    assert not is_stealth_at(80)


@pytest.mark.parametrize("value", [1000, -3000, 1 << 20])
def test_vactual_makes_internal_steps_and_step_pulses_do_not_count(value):
    chip = TMC2209()
    set_microsteps(chip, 256)
    chip.write_register("VACTUAL", value)
    chip.advance(10**9)
    make_steps(chip, 5, period_ns=2)
    rate = value * 12e6 / (1 << 24)
    assert chip.net() == pytest.approx(rate / 16, abs=2)
    assert chip.CORE.read_pulse_rate(chip.state, 0, 1e9) * 16 == pytest.approx(rate)
    chip.write_register("VACTUAL", 0)
    before = chip.read_register("MSCNT")
    make_steps(chip, 2)
    assert chip.read_register("MSCNT") == (before + 2) % 1024


def test_index_shows_the_first_microstep_of_each_electrical_turn():
    chip = TMC2209()
    levels = []
    for _ in range(128):
        levels.append(chip.index)
        make_steps(chip, 1)
    assert [k for k, on in enumerate(levels) if on] == [0, 64]
    chip.write_register("GCONF", 0x111)
    assert not chip.index
    chip.pins.otpw = True
    assert chip.index


def test_diag_and_index_are_lines_that_a_microcontroller_reads():
    stage = Stage("xy", chips="stepdir", drives={"x": "tmc2209", "y": "a4988"}, visuals=False)
    chips = {name: axis.chip for name, axis in stage.axes.items()}
    line = parse_pins("x.step=D2,x.diag=D9", chips)[1]
    assert line.get_mask(chips["x"]) == chips["x"].INPUTS["diag"]
    with pytest.raises(ArgumentError, match="power stage of axis y has no output diag"):
        parse_pins("y.diag=D9", chips)
    chips["x"].pins.s2vsa = True
    assert chips["x"].input_word(0) & chips["x"].INPUTS["diag"]
    chips["x"].pins.diag = False  # an output cannot be driven
    assert chips["x"].diag


def test_a_journal_replays_the_steps_and_a_snapshot_continues_to_the_bit():
    chip = TMC2209()
    journal = chip.journal()
    make_steps(chip, 20)
    chip.write_register("VACTUAL", 5000)
    chip.advance(10**7)
    saved = chip.snapshot()
    chip.advance(10**8)
    end = chip.state.tobytes()
    edges = journal.replay_waveforms().edges
    assert edges["net"][-1] == chip.net()
    chip.restore(saved)
    chip.advance(4 * 10**7)
    chip.advance(6 * 10**7)
    assert chip.state.tobytes() == end
