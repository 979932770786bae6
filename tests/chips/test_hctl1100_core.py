"""HCTL-1100: what a stage asks of the core, and bus writes in words."""

import time

import pytest
from support.hctl1100_bench import SAMPLE, bench, moving, position, trapezoid
from support.hctl1100_programs import COMMAND, begin, velocity, word

from stage.chips import HCTL1100
from stage.chips.cycle_descriptions import decode
from stage.chips.hctl1100 import core


def asked(rows, i, hz):
    """net, counter, pulse rate, busy, inputs, status, R14 as it reads."""
    c = rows[i]
    return (
        core.read_net_count(c, 0), core.read_counter(c, 0), core.read_pulse_rate(c, 0, hz), core.is_busy(c, 0),
        core.read_inputs(c, 0), core.read_status(c, 0), core.peek(c, 0x14),
    )  # fmt: skip


def driven(rows, i, count, rate, word):
    """Drive a chip as a stage does: the shaft, the pins, then time."""
    c = rows[i]
    core.set_shaft(c, 0, count, rate)
    core.set_input(c, 0, word)
    core.run(c, c.clock + 100)


def of(chip):
    return asked(chip._rows, chip._i, float(chip.clock_hz))


def test_a_stage_sees_the_commanded_and_the_actual_position():
    chip = bench(word(COMMAND, -77))
    chip.encoder = 300
    chip.pins.stop = True
    assert of(chip) == (-77, 300, 0.0, 0, HCTL1100.INPUTS["stop"], chip.read(0x07), 300 & 0xFF)
    assert [chip.read(a) for a in (0x12, 0x13)] == [0, 0], "looking has latched nothing"


def test_net_is_the_raw_count_of_the_command_position_wherever_the_position_has_its_0():
    """For a stage, for whoever asks the chip, and in its course."""
    chip = bench(word(COMMAND, -77))
    journal = chip.journal()
    chip.encoder = 300
    assert (chip.command_position, chip.net(), of(chip)[0]) == (-77, -77, -77)
    chip.write(0x13, 0)  # the actual position is 0 at 300
    assert (chip.command_position, chip.net(), of(chip)[0]) == (-77, 223, 223)
    chip.encoder = chip.net()
    chip.read(0x14)
    assert chip.command_position == position(chip)
    chip.encoder = 1 << 24  # once round: the nearer count of those that read alike
    assert chip.net() == of(chip)[0] == (1 << 24) + 223
    edges = journal.replay_waveforms().edges
    assert edges["command"].tolist() == [-77] * len(edges)
    assert set(edges["net"].tolist()) == {-77, 223, (1 << 24) + 223}


def test_the_commanded_velocity_is_that_of_the_profile_or_of_the_command():
    per_second = 2_000_000 / SAMPLE
    chip = moving(-3, a=0x300)
    chip.advance(SAMPLE)
    assert of(chip)[2] == pytest.approx(-3 * per_second)
    chip = bench(velocity(0x18), begin("proportional"))
    assert of(chip)[2] == pytest.approx(1.5 * per_second)
    chip = trapezoid(1000, a=256, top=5)
    chip.advance(50 * SAMPLE)
    assert of(chip)[2] == pytest.approx(5 * per_second)
    assert of(chip)[3]
    chip.pins.limit = True
    assert of(chip)[2] == 0
    assert not of(chip)[3], "F0 stays, but nothing is in progress"


def test_a_stage_sets_shaft_and_pins_as_the_bench_does():
    one, other = bench(begin("position")), bench(begin("position"))
    driven(one._rows, one._i, 12.5, 0.01, HCTL1100.INPUTS["index"])
    other.set_shaft(12.5, 0.01)
    other.pins.index = True
    other.advance(100)
    assert of(one) == of(other)
    assert one.pins.as_dict() == other.pins.as_dict()


def test_time_at_rest_and_in_idle_costs_nothing():
    """2^45 clocks, half a year, are 34 billion samples; one by one they would take a quarter of an hour."""
    for writes in ([], begin("position"), begin("integral"), begin("proportional")):
        chip = bench(writes)
        chip.encoder = -1
        start_s = time.process_time()
        chip.advance(1 << 45)
        assert time.process_time() - start_s < 5.0
        assert chip.clock == 1 << 45
        assert chip.read(0x0F) == 0x40 - (chip.clock % SAMPLE) // 16


def test_a_decoder_describes_bus_writes():
    chip = HCTL1100()
    journal = chip.journal()
    for address, value in ((0x00, 0x08), (0x00, 0x03), (0x05, 3), (0x05, 9), (0x22, 64), (0x3C, 0xFE), (0x0A, 1)):
        chip.write(address, value)
    chip.reset()
    message = decode(chip.decoder(), journal.entries)
    assert [s.meaning for s in message] == [
        "set F0", "clear F3", "control", "no mode", "R22 <- 64 (filter: gain K, in 1/4)",
        "R3C <- -2 (integral command velocity)", "no register at 0Ah", "reset pin",
    ]  # fmt: skip
    assert [s.kind for s in message] == ["command"] * 4 + ["register"] * 3 + ["reset"]
    assert str(message[0]) == "00 08  set F0"


def test_a_decoder_marks_a_lost_write():
    chip = HCTL1100()
    journal = chip.journal()
    chip.glitches = (lambda address, value: True,)
    chip.write(0x05, 0)
    assert [s.meaning for s in decode(chip.decoder(), journal.entries)] == ["LOST: reset"]
