"""`ChipPort`: bytes, bits and polling."""

from types import SimpleNamespace

import pytest

from stage import ArgumentError, RunTimeout, StageError, firmware
from stage.chips import CHIPS, PCL240K, PCL240MK
from stage.firmware import Bench, ChipPort, Profile
from stage.firmware.driver import get_driver_class
from stage.firmware.pcl240 import chip_port


def make_port(**options):
    return ChipPort(Bench(PCL240K(), **options).axes["x"])


def test_registers_are_written_from_the_high_byte_to_the_low():
    p = make_port()
    journal = p.axis.chip.journal()
    p.write_register("R0", 0x123456)
    p.write_register("R2", 0x1ABC)
    assert [(e.a, e.b) for e in journal.entries] == [
        (0, 0x80), (3, 0x12), (2, 0x34), (1, 0x56), (0, 0x82), (2, 0x1A), (1, 0xBC),
    ]  # fmt: skip
    assert p.read_counter() == 0x123456
    assert p.axis.chip.values()["R2"] == 0x1ABC


def test_a_set_of_registers_is_checked_before_the_first_is_written():
    p = make_port()
    with pytest.raises(ArgumentError, match=r"R4 .acceleration rate. cannot be 20000: .* from 2 to 16383"):
        p.write_registers(R1=100, R4=20_000)
    assert p.axis.chip.values()["R1"] == 0
    assert p.axis.time == 0.0, "not one bus cycle"


def test_the_status_is_named_by_the_register_map_and_readable():
    p = make_port()
    p.write_registers(R0=100, R1=500, R2=4000, R3=4000, R4=300, R5=300, R6=50, R7=300)
    assert str(p.read_status()) == "halted"
    p.write_command(chip_port.CONTROL | chip_port.PRESET)
    p.write_command(chip_port.RAMP_START_COMMANDS["FH1"] | chip_port.STOP_INTERRUPT_BIT)
    assert str(p.read_status()) == "ramping up or down"
    status = p.wait_until_stopped(10)
    assert str(status) == "halted, R0 = 0, R0 < R6, /INT pending"
    assert not status.no_int
    assert status.zero


def test_reading_a_register_keeps_the_selected_register_and_the_output_mode():
    p = ChipPort(Bench(PCL240MK()).axes["x"])
    p.write_command(chip_port.OUTPUT | chip_port.EXTERNAL)
    p.write_registers(R0=0x010203, R10=0x040506)
    assert p.read_register("R10") == 0x040506
    p.axis.chip.write(1, 0x77)  # R0 is selected, and byte by byte
    values = p.axis.chip.values()
    assert (values["R0"], values["R10"]) == (0x010277, 0x040506)
    assert p.read_counter() == 0x010277, "the extension mode is over"
    p.axis.chip.pins.extp = True
    p.axis.wait(1e-5)
    p.axis.chip.pins.extp = False
    p.axis.wait(1e-5)
    assert p.read_counter() == 0x010276, "what the output mode was before"


def test_a_bus_too_slow_to_read_the_counter_raises_an_error():
    p = make_port(bus_cycle=1e-3)
    p.write_registers(R0=0xFFFFFF, R1=8191, R2=8191, R7=2)
    p.write_command(chip_port.CONTROL)
    p.write_command(chip_port.START["FH1"])
    with pytest.raises(StageError, match="bytes did not agree in 100 reads: the bus is too slow"):
        p.read_counter()


@pytest.mark.parametrize("count", [0x010000, 0xAB0000, 0x800000])
def test_a_counter_read_while_its_high_byte_changes_is_read_again(count):
    """R0 = 10000h at the first byte, FFFFh at the others: 1FFFFh"""
    p = make_port()
    counts = iter([count] + [count - 1] * 20)  # one pulse, after the first byte
    p._chip = SimpleNamespace(read=lambda address: next(counts) >> 8 * (address - 1) & 0xFF)
    assert p.read_counter() == count - 1


def test_a_timeout_states_the_phase_of_the_chip_and_has_the_report():
    x = Bench(PCL240K()).axes["x"]
    with pytest.raises(RunTimeout, match=r"still operates after 0.200 s .*: R0 = \d+, at constant speed") as caught:
        firmware.preset_move(x, 100_000, timeout=0.2)
    report = caught.value.report
    assert report.stopped_by == "timeout"
    assert 0 < report.pulses < 100_000
    assert not report.ok
    with pytest.raises(StageError, match="axis x is moving: wait until it stops, or stop it with 08h"):
        firmware.preset_move(x, 10)
    ChipPort(x).write_command(chip_port.RESET)
    ChipPort(x).wait_until_stopped(1)
    assert firmware.preset_move(x, 10).ok


def test_a_long_move_is_polled_every_two_milliseconds():
    x = Bench(PCL240K()).axes["x"]
    cycles = 0
    read = x.chip.read

    def count_reads(address):
        nonlocal cycles
        cycles += 1
        return read(address)

    x.chip.read = count_reads
    report = firmware.preset_move(x, -16_777_215, Profile.of(fl=1000, fh1=240_000, fh2=240_000, accel=0.5))
    assert report.ok
    assert cycles == pytest.approx(report.duration / 2e-3, rel=0.02)


def test_every_procedure_has_a_name():
    assert firmware.find_procedure("preset-move") is firmware.preset_move
    assert firmware.find_procedure("origin_return") is firmware.origin_return
    assert set(firmware.PROCEDURES) <= set(firmware.__all__)
    with pytest.raises(ArgumentError, match=r"unknown procedure 'orign_return'. Did you mean 'origin_return'"):
        firmware.find_procedure("orign_return")


@pytest.mark.parametrize("name", list(CHIPS))
def test_the_distance_of_a_move_has_a_register_on_every_chip(name):
    """STEP/DIR's driver set FINISH, which nothing reads: the fault lost-write and BusMacros found no register"""
    chip = CHIPS[name]
    register = get_driver_class(chip).DISTANCE_REGISTER
    assert chip.register_cycles(register, 1, 0) != chip.register_cycles(register, 2, 0)
