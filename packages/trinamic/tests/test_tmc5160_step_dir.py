"""The TMC5160 with SD_MODE high, as a power stage of STEP/DIR axes configured by SPI."""

import pytest

from pulsestage_trinamic.power_stages import TMC5160 as POWER_STAGE
from pulsestage_trinamic.tmc5160_step_dir import StepDirTMC5160
from stage import Drive, Stage, firmware
from stage.testing import power_stage_conformance

CHOPCONF = 0x100100C3
RUN = 31 << 8 | 16
DATAGRAMS = ("EC140100C3", "9000061F10", "8000000100")
"""CHOPCONF with 1/16 microsteps, IHOLD_IRUN, GCONF with diag1_stall."""


def make_steps(chip, count, period_ns=100_000):
    for _ in range(count):
        chip.step = True
        chip.advance(period_ns // 2)
        chip.step = False
        chip.advance(period_ns - period_ns // 2)


def make_chip(chopconf=CHOPCONF, current=RUN):
    chip = StepDirTMC5160()
    chip.write_register("CHOPCONF", chopconf)
    chip.write_register("IHOLD_IRUN", current)
    return chip


def test_it_keeps_what_every_power_stage_promises():
    power_stage_conformance("tmc5160")


def test_after_power_up_the_motor_is_off_and_a_step_is_a_256th():
    stage = Stage("xy", chips="stepdir", drives="tmc5160", visuals=False)
    chip = stage.axes["x"].chip
    assert isinstance(chip, StepDirTMC5160)
    assert (chip.microsteps, chip.amplitude) == (256, 0)
    assert "never switched on" in chip.explain_missing_current()
    assert stage.axes["x"].drive.power_stage is POWER_STAGE


def test_a_host_driver_switches_it_on_with_the_microsteps_and_current_of_the_drive():
    stage = Stage("xy", chips="stepdir", drives=Drive(power_stage="tmc5160", microsteps=32, current=1.3), visuals=False)
    x = stage.axes["x"]
    firmware.move(x, 7e-3)
    assert x.chip.microsteps == 32
    assert x.position == pytest.approx(7e-3, abs=5e-6)
    x.pulse(1)
    assert x.chip.amplitude == pytest.approx(1.3, rel=0.02)


def test_spi_reaches_the_registers_as_without_sd_mode():
    chip = StepDirTMC5160()
    for datagram in DATAGRAMS:
        chip.transfer(bytes.fromhex(datagram))
    assert chip.microsteps == 16
    assert chip.amplitude > 0
    chip.transfer(bytes.fromhex("0400000000"))
    answer = chip.transfer(bytes.fromhex("0400000000"))
    assert answer[1:] == bytes.fromhex("30000040")  # version, SD_MODE
    chip.dir, chip.enable = True, False
    chip.step = True
    assert chip.read_register("IOIN") == 0x30000053  # DRV_ENN, DIR, STEP
    assert chip.read_register("GCONF") == 0x100
    for address, value in ((0x10, 0), *((0x11, byte) for byte in bytes.fromhex("EC100100C3")), (0x10, 1)):
        chip.write(address, value)
    assert chip.microsteps == 256


@pytest.mark.parametrize("microsteps", [1, 4, 16, 256])
def test_a_step_moves_mscnt_by_mres_and_shaft_and_dedge_act(microsteps):
    shift = (256 // microsteps).bit_length() - 1
    chip = make_chip(CHOPCONF | shift << 24)
    make_steps(chip, 3)
    first = chip.read_register("MSCNT")
    make_steps(chip, 2)
    assert (chip.read_register("MSCNT") - first) % 1024 == (2 << shift) % 1024
    chip.write_register("GCONF", 0x18)
    make_steps(chip, 2)
    assert chip.read_register("MSCNT") == first
    chip.write_register("GCONF", 0x8)
    chip.write_register("CHOPCONF", CHOPCONF | shift << 24 | 1 << 29)
    make_steps(chip, 1)
    assert (chip.read_register("MSCNT") - first) % 1024 == (2 << shift) % 1024


def test_tstep_standstill_and_the_current_at_rest_follow_the_steps():
    chip = make_chip(CHOPCONF | 4 << 24, current=31 << 8 | 10)
    make_steps(chip, 4, period_ns=1_000_000)
    assert chip.read_register("TSTEP") == 12_000 * 16 // 256
    assert chip.read_register("DRV_STATUS") >> 16 & 31 == 31
    assert not chip.read_register("DRV_STATUS") >> 31
    chip.advance(88_000_000)
    assert chip.read_register("TSTEP") == 0xFFFFF
    assert chip.read_register("DRV_STATUS") >> 31
    chip.advance(10**9)
    assert chip.read_register("DRV_STATUS") >> 16 & 31 == 10
    assert chip.amplitude == pytest.approx(11 / 32 * 0.325 / 0.1)


@pytest.mark.parametrize(("lam", "sgt", "result"), [(0, 0, 511), (512, 0, 255), (1023, 0, 0), (1024, 10, 80)])
def test_stallguard2_measures_the_example_of_the_sheet(lam, sgt, result):
    chip = make_chip(CHOPCONF | 4 << 24)
    chip.write_register("COOLCONF", sgt << 16)
    chip.set_load(lam, 512)
    make_steps(chip, 40)
    assert chip.read_register("DRV_STATUS") & 0x3FF == result


def test_diag_pins_show_what_gconf_assigns():
    chip = make_chip(CHOPCONF | 4 << 24)
    chip.write_register("TCOOLTHRS", 0xFFFFF)
    chip.set_load(1024, 512)
    make_steps(chip, 40)
    assert (chip.diag0, chip.diag1) == (False, False)
    chip.write_register("GCONF", 1 << 8)
    assert (chip.diag0, chip.diag1) == (False, True)
    chip.write_register("GCONF", 1 << 7)
    assert (chip.diag0, chip.diag1) == (True, False)
    chip.advance(100_000_000)
    assert not chip.diag0
    chip.write_register("GCONF", 1 << 5)
    chip.pins.s2vsb = True
    assert (chip.diag0, chip.amplitude) == (True, 0)


def test_a_journal_replays_the_steps_and_a_snapshot_continues_to_the_bit():
    chip = make_chip(CHOPCONF | 4 << 24)
    journal = chip.journal()
    make_steps(chip, 20)
    saved = chip.snapshot()
    make_steps(chip, 5)
    chip.advance(3 * 10**8)
    end = chip.state.tobytes()
    assert journal.replay_waveforms().edges["net"][-1] == chip.net()
    chip.restore(saved)
    make_steps(chip, 5)
    chip.advance(10**8)
    chip.advance(2 * 10**8)
    assert chip.state.tobytes() == end


def test_homing_by_diag1_finds_the_end_of_travel():
    stage = Stage("xy", chips="stepdir", drives=Drive(power_stage="tmc5160", microsteps=16, current=1.2), visuals=False)
    x = stage.axes["x"]
    firmware.move(x, 0.15)
    x.chip.write_register("GCONF", 1 << 8)
    x.chip.write_register("TCOOLTHRS", 100)  # TSTEP is 78 at 9,600 steps/s
    for rate in range(2000, 9601, 250):
        x.pulse(32, rate=rate)
    for _ in range(700):
        if x.chip.diag1:
            break
        x.pulse(8, rate=9600)
    assert x.chip.diag1
    assert x.position == pytest.approx(x.travel[1], abs=3e-3)
