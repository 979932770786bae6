"""The TMC5160 as the driver of a stage's motor: currents, load, stalls; boards, environments and programs for Arduino."""

import copy
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import stage.envs  # noqa: F401
from stage import ArgumentError, Drive, Stage, StageError, faults, firmware
from stage.board import Board, NativeHost, build
from stage.chips import chip_class
from stage.cli import main
from stage.cli.run import print_report as report
from stage.firmware.driver import Speeds, get_driver
from stage.testing import assert_no_lost_steps, chip_conformance

PROJECT = Path(__file__).parents[1]
SMOOTH = Drive("17HS4401", detent=0.0, mode="sine")


@pytest.fixture(scope="module")
def stage_():
    return Stage("xy", chips={"x": "tmc5160"}, drives=SMOOTH, visuals=False)


@pytest.fixture
def x(stage_):
    stage_.reset()
    return stage_.axes["x"]


def write_registers(chip, **registers):
    for name, value in registers.items():
        for cycle in chip.register_cycles(name, value):
            chip.write(*cycle)


def measure_pull_out_torque(x, **registers):
    """Raise the load slowly at 4 turns per second and return the torque in N m at which the motor loses its first step.

    The motor runs at its final speed before the load rises, because friction and core loss rise with the speed.
    """
    stage_, dof = x.stage, x.plant.dof
    write_registers(x.chip, CHOPCONF=0x100100C3, VMAX=286_331, AMAX=10_000, **registers)
    stage_.run(0.02)
    write_registers(x.chip, RAMPMODE=1)
    stage_.run(0.36)
    damping = stage_.model.dof_damping[dof] + x.drive.motor.core_loss_damping * x.gear**2
    resistance = stage_.model.dof_frictionloss[dof] + damping * stage_.data.qvel[dof]
    load = resistance
    while not x.lost_steps:
        load *= 1.002
        stage_.data.qfrc_applied[dof] = resistance - load
        stage_.run(0.002)
    stage_.data.qfrc_applied[dof] = 0.0
    return load / abs(x.gear)


@pytest.mark.parametrize(
    ("scaler", "irun"),
    [
        (160, 23),
        *(pytest.param(*two, marks=pytest.mark.slow) for two in ((0, 31), (200, 31), (0, 9), (60, 31), (255, 15))),
    ],
)
def test_currents_by_registers_change_the_pull_out_torque_by_the_closed_form(x, scaler, irun):
    current = (scaler or 256) / 256 * (irun + 1) / 32 * 0.325 / 0.1
    measured = measure_pull_out_torque(x, GLOBALSCALER=scaler, IHOLD_IRUN=irun << 8)
    assert x.chip.amplitude == pytest.approx(current)
    assert measured == pytest.approx(x.drive.motor.torque_constant * current, rel=0.03)


def test_a_motor_without_current_does_not_move_while_xactual_counts(x):
    write_registers(x.chip, VMAX=100_000, AMAX=2000, RAMPMODE=1)
    x.stage.run(0.1)
    assert x.chip.values()["XACTUAL"] > 600
    assert abs(x.position) < 2e-5
    assert "TOFF = 0" in x.chip.diagnostics[-1].message


def test_reports_explain_that_a_vertical_axis_falls_without_current(stage_, capsys):
    """Axis z, whose power stage is off, falls onto its hard stop at -45 mm while x moves as commanded."""
    xyz = Stage("xyz", chips="tmc5160", visuals=False)
    x, z = xyz.axes["x"], xyz.axes["z"]
    firmware.move(x, 10e-3)
    assert x.position == pytest.approx(10e-3, abs=25e-6)
    xyz.run(1)
    assert z.position == pytest.approx(-45e-3, abs=1e-3)
    never = "; its power stage was never switched on (CHOPCONF.TOFF = 0 after power-up, or DRV_ENN is high)"
    with pytest.raises(AssertionError) as failed:
        assert_no_lost_steps(xyz)
    (line,) = [line for line in str(failed.value).splitlines() if line.startswith("  z is")]
    assert line.endswith(never)
    report(Board(xyz))
    printed = capsys.readouterr().out
    assert f"z has lost steps without current: {never[2:]}.\n" in printed
    assert "x has lost" not in printed
    write_registers(z.chip, CHOPCONF=0x100100C3, IHOLD_IRUN=31 << 8 | 31)
    xyz.run(0.01)
    assert z.chip.explain_missing_current() == ""
    write_registers(z.chip, CHOPCONF=0x10410150)
    assert z.chip.explain_missing_current().startswith("its power stage is off")
    copy_ = z.chip.make_replica(z.chip.state.tobytes())
    copy_.write(0x6C, 0)
    assert copy_.explain_missing_current().startswith("its power stage is off"), "a replica remembers that it was on"


def test_load_lowers_the_result_of_stallguard_and_a_stall_makes_it_0(x):
    write_registers(
        x.chip, CHOPCONF=0x100100C3, GLOBALSCALER=134, IHOLD_IRUN=31 << 8, VMAX=715_828, AMAX=30_000, RAMPMODE=1
    )
    x.stage.run(0.5)
    free = x.chip.read(0x6F) & 0x3FF
    x.stage.data.qfrc_applied[x.plant.dof] = -0.5 * x.drive.motor.torque_constant * 1.7 * abs(x.gear)
    x.stage.run(0.1)
    loaded = x.chip.read(0x6F) & 0x3FF
    x.stage.data.qfrc_applied[x.plant.dof] = 0.0
    emf = x.drive.motor.torque_constant * 2 * np.pi * 10 / 24
    assert free == pytest.approx(1023 * emf, rel=0.15)
    assert 0 < loaded < 0.7 * free
    write_registers(x.chip, SW_MODE=0x400, TCOOLTHRS=40)
    x.stage.data.qfrc_applied[x.plant.dof] = -2 * x.drive.motor.torque_constant * 1.7 * abs(x.gear)
    x.stage.run(0.05)
    x.stage.data.qfrc_applied[x.plant.dof] = 0.0
    assert x.chip.read(0x35) & 0x440 == 0x440, "event_stop_sg, vzero"
    assert x.chip.read(0x6F) >> 24 & 1


def measure_stall_positions(x, count):
    """Home by stall `count` times and return the positions (m) of the carriage 5 mm from each zero."""
    positions = []
    for k in range(count):
        report = firmware.home(x, by="stall", speed=0.03)
        assert report.ok
        assert report.stopped_by == "stall"
        firmware.move(x, 5e-3)
        positions.append(x.position)
        firmware.move(x, pulses=331 * k + 1)
    return np.array(positions)


def test_homing_by_stall_repeats(x):
    x.stage.place(x=-0.150)
    write_registers(x.chip, GCONF=4)
    positions = measure_stall_positions(x, 3)
    assert np.ptp(positions) <= 256 * x.meters_per_pulse
    registers = {name: x.chip.values()[name] for name in ("GCONF", "TCOOLTHRS", "SW_MODE", "RAMPMODE")}
    assert registers == {"GCONF": 4, "TCOOLTHRS": 0, "SW_MODE": 3, "RAMPMODE": 0}, (
        "StealthChop as before, and switches that stop"
    )


@pytest.mark.slow
def test_homing_by_stall_repeats_within_a_full_step_in_50_runs(x):
    x.stage.place(x=-0.150)
    positions = measure_stall_positions(x, 50)
    assert np.ptp(positions) <= 256 * x.meters_per_pulse


def test_a_short_disables_the_power_stage_until_it_is_switched_off_and_on(x):
    write_registers(x.chip, CHOPCONF=0x100100C3, IHOLD_IRUN=31 << 8 | 31)
    x.stage.run(0.001)
    drive = x.stage.state.drives[0]
    assert drive.current == pytest.approx(3.25)
    x.pins.s2ga = True
    x.stage.run(0.001)
    assert drive.current == 0
    assert x.chip.read(0x01) & 2
    assert x.chip.read(0x6F) >> 27 & 1
    x.pins.s2ga = False
    x.stage.run(0.001)
    assert drive.current == 0
    write_registers(x.chip, CHOPCONF=0)
    write_registers(x.chip, CHOPCONF=0x100100C3, GSTAT=2)
    x.stage.run(0.001)
    assert drive.current == pytest.approx(3.25)
    assert not x.chip.read(0x01) & 2


def test_a_restored_stage_continues_to_the_same_state(x):
    write_registers(x.chip, CHOPCONF=0x100100C3, IHOLD_IRUN=31 << 8, VMAX=300_000, AMAX=3000, RAMPMODE=1)
    x.stage.run(0.1)
    snapshot = x.stage.snapshot()
    x.stage.run(0.1)
    then = x.position, x.chip.state.tobytes()
    x.stage.restore(snapshot)
    x.stage.run(0.1)
    assert (x.position, x.chip.state.tobytes()) == then


def test_a_journal_replays_the_stall_that_the_load_caused(x):
    """A stall stops the replay as it has stopped the axis: the samples of the load are in the journal."""
    x.stage.place(x=-0.155)
    firmware.move(x, pulses=2000)
    journal = x.chip.journal()
    begin = x.chip.net()
    firmware.home(x, by="stall", speed=0.03)
    journal.close()
    edges = journal.replay_waveforms().edges
    assert edges["net"][-1] == x.chip.net()
    assert edges["net"][0] == begin


def test_a_board_maps_the_chip_as_an_spi_device(stage_):
    stage_.reset()
    board = Board(stage_)
    answer = []
    for _ in range(2):
        board.out8(0x300, 0)
        for byte in (0x04, 0, 0, 0, 0):
            board.out8(0x301, byte)
            answer.append(board.in8(0x301))
        board.out8(0x300, 1)
    assert answer == [0x31, 0, 0, 0, 0, 0x31, 0x30, 0, 0, 3 & stage_.chips[0].input_word(0)]
    assert "SPI: read IOIN" in board.trace.text()


def send_spi_datagrams(board, datagrams, reads):
    """Send SPI datagrams, reading each answer or not, and return the diagnostics; a bus cycle of 1 us has 12 clocks."""
    for _ in range(datagrams):
        board.out8(0x300, 0)
        for byte in (0x6F, 0, 0, 0, 0):
            board.out8(0x301, byte)
            if reads:
                board.in8(0x301)
        board.out8(0x300, 1)
    return [d.message for d in board.stage.chips[0].diagnostics]


def test_spi_faster_than_the_data_sheet_allows_is_diagnosed_once(stage_):
    """Page 25: SCK low and high >= tCLK + 10 ns, CSN high >= 2 tCLK + 10 ns"""
    stage_.reset()
    assert send_spi_datagrams(Board(copy.copy(stage_)), 3, reads=True) == []
    (message,) = send_spi_datagrams(Board(copy.copy(stage_)), 3, reads=False)
    assert message.startswith("SCK is too fast: 8 bits in 12 clocks, 8.00 MHz; ")
    assert "so 5.36 MHz at most" in message
    quick = Stage("xy", chips={"x": "tmc5160"}, bus_cycle=1e-7, visuals=False)
    quick.axes["x"].chip.write(0x81, 0)
    messages = send_spi_datagrams(Board(quick), 2, reads=True)
    assert "SDI 00h while CSN is high" in messages[0]
    assert [message.split(":")[0] for message in messages[1:]] == [
        "SCK is too fast",
        "CSN is high too short between datagrams",
    ]
    lone = chip_class("tmc5160")()
    for _ in range(2):
        for address in (0x80, 0x81, 0x81):
            lone.write(address, 0)
    assert "too" not in " ".join(d.message for d in lone.diagnostics), "a chip on no bus has no times"


@pytest.mark.parametrize("id_", ["RegisterTuning", "RegisterBus", "SynchronizedMove"])
def test_environments_accept_the_tmc5160(id_):
    env = gymnasium.make(f"stage/{id_}-v0", chip="tmc5160", model="xy")
    env.reset(seed=1)
    env.action_space.seed(1)
    *_, info = env.step(env.action_space.sample())
    assert info
    env.close()


@pytest.mark.parametrize(
    ("id_", "message"),
    [("OriginReturn", "a TMC5160 has no ORG: .* the end limits"), ("ServoTuning", "a TMC5160 .* closes no loop")],
)
def test_environments_that_the_chip_does_not_support_are_refused(id_, message):
    with pytest.raises(ArgumentError, match=message):
        gymnasium.make(f"stage/{id_}-v0", chip="tmc5160", model="xy")


@pytest.fixture(scope="module")
def tmc_stage():
    return Stage("xy", chips="tmc5160", drives=SMOOTH, visuals=False)


@pytest.mark.parametrize(
    ("x", "y", "speed"), [(16_000, -5_840, 200_000), pytest.param(-300, 20_000, 200_000, marks=pytest.mark.slow)]
)
def test_axes_on_a_line_keep_the_ratio_to_two_steps_of_256(tmc_stage, x, y, speed):
    """The chip does not interpolate: velocities and accelerations are in the ratio of the distances."""
    tmc_stage.reset()
    unit = tmc_stage.axes["x"].meters_per_pulse
    report = firmware.line({"x": x, "y": y}, tmc_stage, pulses=True, speed=speed * unit)
    assert report.ok
    assert report.distances == {"x": x, "y": y}
    assert report.deviation.pulses <= 2.0
    assert report.skew <= 3e-6
    assert report.carriage_deviation <= 4e-5
    assert [axis.chip.values()["XACTUAL"] for axis in tmc_stage.axes.values()] == [x, y]
    assert all(r.stopped_by == "position reached" for r in report.axes.values())


def test_a_line_switches_on_the_power_stage_of_an_axis_at_rest(tmc_stage):
    tmc_stage.reset()
    report = firmware.line({"x": 3000, "y": 0}, tmc_stage, pulses=True)
    assert (report.ok, report.distances) == (True, {"x": 3000})
    assert tmc_stage.axes["y"].chip.values()["CHOPCONF"] & 15, "TOFF 0 is off: a load would pull the axis away"


def test_both_ramps_of_a_line_last_as_long_as_the_longer_one(tmc_stage):
    ramp_seconds = []
    for up, down in ((0.05, 0.2), (0.2, 0.05)):
        tmc_stage.reset()
        drivers = {name: get_driver(axis) for name, axis in tmc_stage.axes.items()}
        speeds = Speeds(start=2000.0, drive=60_000.0, up=up, down=down)
        ramp_seconds.append(drivers["x"].move_line(drivers, {"x": 16_000, "y": 8000}, speeds).seconds)
    assert ramp_seconds[0] == ramp_seconds[1] > 16_000 / 60_000 + 0.15


def test_a_line_beyond_the_limits_of_the_chip_is_refused(tmc_stage):
    tmc_stage.reset()
    with pytest.raises(ArgumentError, match="drive speed 800000 pps: up to 75"):
        firmware.line(
            {"x": 1000, "y": 1000}, tmc_stage, pulses=True, speed=800_000 * tmc_stage.axes["x"].meters_per_pulse
        )
    with pytest.raises(ArgumentError, match="s_curve=True: a TMC5160 has linear ramps only"):
        firmware.line({"x": 1000, "y": 1000}, tmc_stage, pulses=True, s_curve=True)
    tmc_stage.axes["y"].chip.write(0x20, 1)
    for name, value in {"CHOPCONF": 0x100100C3, "AMAX": 1000, "VMAX": 1000}.items():
        write_registers(tmc_stage.axes["y"].chip, **{name: value})
    tmc_stage.run(0.01)
    with pytest.raises(StageError, match="axis y is moving"):
        firmware.line({"x": 1000, "y": 1000}, tmc_stage, pulses=True)


def test_negative_logic_sensors_need_the_polarity_bits_for_homing():
    """The bits are pol_stop_l, pol_stop_r and pol_N; after a reset the inputs are active high."""
    sensors = {"el_minus": "negative", "el_plus": "negative", "ez": "negative"}
    stage = Stage("xy", chips={"x": "tmc5160"}, wiring={"x": sensors}, visuals=False)
    x = stage.axes["x"]
    assert x.chip.pins.refl
    assert x.chip.pins.encn
    stage.place(x=-0.1495)
    for by in ("switch", "index"):
        report = firmware.home(x, by=by)
        assert (report.ok, report.stopped_by) == (True, {"switch": "REFL", "index": "ENCN"}[by])
    assert -0.15 < x.position < -0.144
    assert firmware.move(x, 1e-3).ok
    x.wiring = {}  # the driver assumes positive logic again
    assert firmware.home(x).stopped_by != "REFL" or abs(x.position + 0.15) > 1e-3
    usual = Stage("xy", chips={"x": "tmc5160"}, wiring={"x": dict.fromkeys(sensors, "positive")}, visuals=False)
    assert usual.axes["x"].wiring == {}
    assert not usual.axes["x"].chip.pins.refl


def test_a_move_ignores_leftover_values_of_v1_a1_and_d1(x):
    usual = firmware.move(x, pulses=20_000).duration
    write_registers(x.chip, V1=30_000, A1=200, D1=150)
    assert firmware.move(x, pulses=-20_000).duration == pytest.approx(usual, rel=1e-3)


@pytest.mark.parametrize(("direction", "limit"), [(1, "EL+"), (-1, "EL-")])
def test_a_move_into_an_end_limit_says_which(x, direction, limit):
    x.stage.place(x=x.travel[direction > 0] - direction * 0.012)
    report = firmware.move(x, pulses=direction * 100_000)
    assert (report.stopped_by, report.ok) == (limit, False)


def test_halt_at_once_stops_an_axis_without_a_ramp(x):
    driver, braking_steps = get_driver(x), []
    for at_once in (False, True):
        driver.start_continuous_move(1, Speeds(start=1000.0, drive=100_000.0, up=0.1, down=0.1))
        x.stage.run(0.2)
        began = x.chip.values()["XACTUAL"]
        driver.halt(at_once)
        braking_steps.append(x.chip.values()["XACTUAL"] - began)
    assert braking_steps[0] > 3000
    assert 0 <= braking_steps[1] < 500
    assert x.chip.values()["SW_MODE"] == driver.compute_sw_mode(3), "the polarity is again that of the sensors"


def test_a_motor_gets_no_more_than_the_sense_resistors_allow():
    """TMC5160(rsense=0.22): a Drive of 1.7 A gets 1.48 A"""
    chip = chip_class("tmc5160")(rsense=0.22)
    stage = Stage("xy", chips={"x": chip}, drives=SMOOTH, visuals=False)
    from pulsestage_trinamic.tmc5160.host_driver.driver import compute_current_registers

    assert get_driver(stage.axes["x"]).compute_axis_current_registers() == compute_current_registers(0.325 / 0.22, 0.22)


def test_homing_by_an_unsupported_method_is_refused(stage_):
    with pytest.raises(ArgumentError, match="home by 'smell': a TMC5160 cannot; it homes by switch or index or stall"):
        firmware.home(stage_.axes["x"], by="smell")
    with pytest.raises(ArgumentError, match=r"home by 'stall' and to an index pulse .* give one of the two"):
        firmware.home(stage_.axes["x"], by="stall", index=True)
    with pytest.raises(ArgumentError, match=r"home by 'stall': a PCL240K cannot; it homes by switch\."):
        firmware.home(Stage("xy", visuals=False).axes["x"], by="stall")
    with pytest.raises(ArgumentError, match="s_curve=True"):
        firmware.move(stage_.axes["x"], 1e-3, s_curve=True)


SKETCH = """
#include <SPI.h>
static uint32_t ask(uint8_t address, uint32_t data)
{
    digitalWrite(5, LOW);
    SPI.transfer(address);
    uint32_t answer = 0;
    for (int k = 24; k >= 0; k -= 8)
        answer = answer << 8 | SPI.transfer(uint8_t(data >> k));
    digitalWrite(5, HIGH);
    return answer;
}
void setup()
{
    pinMode(5, OUTPUT);
    digitalWrite(5, HIGH);
    SPI.begin();
    const uint32_t to[][2] = {{0x6C, 0x100100C3},
                              {0x10, 0x1F0A}, {0x26, 2000}, {0x28, 2000}, {0x2A, 2000}, {0x2B, 1000}, {0x27, 300000}};
    for (auto &r : to)
        ask(0x80 | r[0], r[1]);
    ask(0xAD, 25600);
    do
        delay(1);
    while (ask(0x35, 0), !(ask(0x35, 0) >> 9 & 1));
    ask(0x21, 0);
    pulsestage::end(ask(0x21, 0) == 25600 ? 7 : 8);
}
void loop() {}
"""


@pytest.mark.slow
def test_an_arduino_reaches_it_by_spi(stage_, tmp_path):
    stage_.reset()
    (tmp_path / "a.ino").write_text(SKETCH)
    (tmp_path / "pins.cpp").write_text("#include <pinbus.h>\nstatic PinBus driver = PinBus(0x300).spi(5);\n")
    host = NativeHost(build([tmp_path / "a.ino", tmp_path / "pins.cpp"]), Board(stage_))
    assert host.run(timeout=5).code == 7
    assert stage_.axes["x"].position == pytest.approx(5e-3, abs=2e-5)


SETTINGS = """
#include <SPI.h>
static uint64_t took;
static uint32_t version(SPISettings settings, bool turned = false)
{
    const uint64_t then = ps_micros();
    SPI.beginTransaction(settings);
    uint32_t answer = 0;
    for (int k = 0; k < 2; k++) {
        digitalWrite(5, LOW);
        answer = SPI.transfer(turned ? 0x20 : 0x04), answer = 0;
        for (int n = 0; n < 4; n++)
            answer = answer << 8 | SPI.transfer(0);
        digitalWrite(5, HIGH);
    }
    SPI.endTransaction();
    took = ps_micros() - then;
    return answer;
}
void setup()
{
    pinMode(5, OUTPUT);
    digitalWrite(5, HIGH);
    const uint32_t right = version(SPISettings(4000000, MSBFIRST, SPI_MODE3));
    const uint64_t quick = took;
    int code = right >> 24 != 0x30;
    code |= (version(SPISettings(100000, MSBFIRST, SPI_MODE0)) != right) << 1;
    code |= (took - quick != 780) << 2; /* 10 bytes of 80 us, and of 2 us */
    code |= (version(SPISettings(4000000, LSBFIRST, SPI_MODE3), true) >> 24 != 0x0C) << 3;
    code |= (version(SPISettings(4000000, MSBFIRST, SPI_MODE1)) != 0xFFFFFFFF) << 4;
    code |= (version(SPISettings(16000000, MSBFIRST, SPI_MODE3)) != right) << 5;
    pulsestage::end(code);
}
void loop() {}
"""


def test_rate_order_and_mode_of_spi_are_those_of_the_sketch(stage_, tmp_path):
    """SPI.beginTransaction(SPISettings(4000000, MSBFIRST, SPI_MODE1)) to a chip that takes mode 3, 5 MHz at most"""
    stage_.reset()
    (tmp_path / "a.ino").write_text(SETTINGS)
    (tmp_path / "pins.cpp").write_text(
        "#include <pinbus.h>\nstatic PinBus driver = PinBus(0x300).spi(5, 3, 5000000);\n"
    )
    host = NativeHost(build([tmp_path / "a.ino", tmp_path / "pins.cpp"]), Board(stage_))
    assert host.run(timeout=5).code == 0
    modes, rate = (text for _, text in host.log if text.startswith("pins: "))
    assert "takes bits in mode 3, and they come in mode 1" in modes
    assert rate.startswith("pins: SCK of 16000000 Hz, and the chip on SPI at 300h takes 5000000 Hz at most")


@pytest.mark.slow
def test_the_chip_conforms_in_100_programs_and_uncompiled():
    chip_conformance("tmc5160", seed=5, programs=100)
    chip_conformance("tmc5160", seed=5, programs=2, uncompiled=True)


@pytest.mark.slow
def test_the_package_installed_by_pip_registers_the_chip(tmp_path):
    """pip install ./packages/trinamic; stage move x 10mm --chips tmc5160"""
    ignored = shutil.ignore_patterns("__pycache__", "_native.so", "*.egg-info", "build")
    project = shutil.copytree(PROJECT, tmp_path / "trinamic", ignore=ignored)
    venv.create(tmp_path / "venv")
    site = Path(sysconfig.get_path("purelib", "venv", {"base": str(tmp_path / "venv")}))
    (site / "others.pth").write_text(f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n")
    python = tmp_path / "venv" / "bin" / "python"
    clean = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}

    def run(*command):
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, env=clean)
        assert done.returncode == 0, done.stdout + done.stderr
        return done

    pip = (sys.executable, "-m", "pip", "-q", "--python", str(python), "install")
    run(*pip, "setuptools>=80")
    run(*pip, "--no-deps", "--no-build-isolation", str(project))
    assert "pulsestage-trinamic 0.1.0" in run(str(python), "-m", "stage", "chips").stdout
    done = run(str(python), "-m", "stage", "move", "x", "1mm", "--chips", "tmc5160", "--model", "xy")
    assert "pulses 5120 of 5120" in done.stdout
    assert "building" not in done.stderr
    run(
        str(python),
        "-m",
        "pytest",
        "-q",
        "-c",
        "/dev/null",
        "--rootdir",
        str(tmp_path),
        str(project / "tests" / "test_tmc5160_conformance.py"),
    )


@pytest.mark.slow
def test_the_command_line_writes_waveforms_and_recordings_of_the_chip(tmp_path, capsys):
    move = ["move", "x", "1mm", "--chips", "tmc5160", "--model", "xy"]
    assert main([*move, "--vcd", str(tmp_path / "x.vcd"), "--record", str(tmp_path / "x.rrd")]) == 0
    assert "5120 of 5120" in capsys.readouterr().out


def test_another_motor_has_the_current_that_the_chip_gives_it(x):
    write_registers(x.chip, CHOPCONF=0x100100C3, GLOBALSCALER=134, IHOLD_IRUN=31 << 8)
    x.stage.run(0.01)
    current = float(x.read_drive()[0].current)
    assert current == pytest.approx(x.chip.amplitude)
    with faults.motor(x, "SS2422-5041"):
        assert float(x.read_drive()[0].current) == current
        assert x.drive.motor.rated_current < current
