"""HCTL-1100: bus, flags, status, resets and the positions."""

import pytest
from support.hctl1100_bench import SAMPLE, bench, commanded, position, trapezoid, write_all
from support.hctl1100_programs import ALIGN, COMMAND, CONTROL, IDLE, PRESET, RESET, begin, word

from stage import ArgumentError
from stage.chips import HCTL1100, chip_class

AFTER_RESET = {"R00": 0x02, "R07": 0xE0, "R08": 0x80, "R09": 0, "R0F": 0x40, "R20": 0xE5, "R21": 0x40, "R22": 0x40}


def test_the_chip_is_found_by_name():
    assert chip_class("hctl-1100") is HCTL1100
    assert HCTL1100().clock_hz == 2_000_000


def test_addresses_act_modulo_64_with_a_diagnostic():
    one, other = HCTL1100(), HCTL1100()
    for address in range(64):
        one.write(address + 64, 0x5A)
        other.write(address + 192, 0x5A)
        assert one.read(address) == other.read(address + 128)
    assert one.read(0x22) == 0x5A
    assert one.values() == other.values()
    one.diagnostics.clear()
    one.write(0x62, 0x11)
    assert [(d.address, d.value, d.message) for d in one.diagnostics] == [
        (0x22, 0x11, "address 62h acts as 22h: the bus is no wider")
    ]


@pytest.mark.parametrize("address", [0x1C, 0x20, 0x21, 0x22, 0x23, 0x24, 0x26, 0x29, 0x2A, 0x2B, 0x3C])
def test_a_register_of_eight_bits_reads_what_was_written(address):
    chip = HCTL1100()
    for value in (0xFF, 0x00, 0xA5):
        chip.write(address, value)
        assert chip.read(address) == value


@pytest.mark.parametrize("address", [0x18, 0x1A, 0x1B, 0x1F, 0x27, 0x28])
def test_a_register_of_seven_bits_keeps_seven(address):
    chip = HCTL1100()
    chip.write(address, 0x55)
    assert not chip.diagnostics
    chip.write(address, 0xFF)
    assert chip.read(address) == 0x7F
    assert "takes 0 to 127" in chip.diagnostics[0].message


# --- flags and status ---


@pytest.mark.parametrize("flag", [0, 2, 3, 4, 5])
def test_a_flag_is_set_by_8_and_its_number_and_cleared_by_its_number(flag):
    chip = HCTL1100()
    chip.write(0x00, 8 | flag)
    assert chip.read(0x00) == 1 << flag | 0x02
    chip.write(0x00, flag)
    assert chip.read(0x00) == 0x02


def test_f1_and_flags_that_do_not_exist_are_left_alone():
    chip = HCTL1100()
    for value in (0x09, 0x01, 0x06, 0x0E, 0x07, 0x0F):
        chip.write(0x00, value)
        assert chip.read(0x00) == 0x02
    assert len(chip.diagnostics) == 6


def test_two_mode_flags_have_a_diagnostic_and_the_first_of_f0_f3_f5_acts():
    chip = bench([(0x00, 0x0D), (0x00, 0x0B)])
    assert chip.diagnostics[0].message == "F3 and F5 are set: only one of F0, F3 and F5 may be"
    assert chip.read(0x00) == 0x2A
    write_all(chip, [(0x3C, 1), (0x27, 1), (0x05, CONTROL)])
    chip.advance(SAMPLE)
    assert chip.command_position == 0, "proportional velocity moves no command position"


def test_the_status_shows_modes_flags_and_options_and_b3_is_0():
    chip = HCTL1100()
    chip.write(0x07, 0xFF)
    assert chip.read(0x07) == 0xE7
    chip.write(0x00, 0x08)
    assert chip.read(0x07) == 0xF7
    assert chip.pins.prof
    assert chip.pins.init
    chip.write(0x05, CONTROL)
    assert chip.read(0x07) == 0xD7
    assert not chip.pins.init


# --- resets ---


def test_reset_values():
    assert {name: value for name, value in HCTL1100().values().items() if name in AFTER_RESET} == AFTER_RESET


def test_a_hard_reset_clears_flags_and_every_register():
    chip = bench([(a, 0x55) for a in range(64)], [(0x00, 0x0A), (0x00, 0x0C)])
    chip.encoder = 1234
    chip.advance(777)
    chip.reset()
    assert chip.values() == HCTL1100().values()
    assert position(chip) == 0
    assert chip.encoder == 1234, "the shaft stays"
    assert chip.clock == 777


def test_a_soft_reset_keeps_flags_and_the_other_registers():
    chip = bench([(0x00, 0x0A), (0x3C, 5), (0x20, 1), (0x21, 2), (0x22, 3), (0x0F, 9), (0x07, 7)], word(COMMAND, 77))
    chip.encoder = 500
    chip.write(0x05, RESET)
    values = chip.values()
    assert {name: values[name] for name in AFTER_RESET} == AFTER_RESET | {"R00": 0x06}
    assert values["R3C"] == 5
    assert commanded(chip) == 77
    assert position(chip) == 0


def test_a_soft_reset_restarts_the_sample():
    chip = bench([(0x0F, 9)])
    chip.advance(5000)
    chip.write(0x05, RESET)
    chip.advance(SAMPLE - 1)
    assert chip.read(0x0F) == 0
    chip.advance(1)
    assert chip.read(0x0F) == 0x40


@pytest.mark.parametrize("mode", [ALIGN, CONTROL])
def test_align_and_control_are_entered_from_idle_only(mode):
    chip = bench(begin("position"))
    chip.diagnostics.clear()
    before = chip.snapshot().record
    chip.write(0x05, mode)
    assert chip.snapshot().record == before
    assert "ignored" in chip.diagnostics[0].message
    chip.write(0x05, IDLE)
    chip.write(0x05, mode)
    assert not chip.pins.init


def test_idle_takes_the_motor_command_away_and_forgets_the_filter():
    chip = bench(word(COMMAND, 3), begin("position"))
    chip.advance(2 * SAMPLE)
    assert chip.motor_command != 0
    chip.write(0x05, IDLE)
    assert (chip.read(0x08), chip.read(0x09), chip.motor_command) == (0x80, 0, 0)
    chip.write(0x05, CONTROL)
    chip.advance(SAMPLE)
    assert chip.motor_command == 0x40 * 3 // 4


# --- actual position ---


def test_reading_the_low_byte_latches_the_others():
    chip = HCTL1100()
    chip.encoder = 0x123456
    assert [chip.read(a) for a in (0x12, 0x13)] == [0, 0], "nothing is latched yet"
    assert chip.read(0x14) == 0x56
    chip.encoder = 0x654321
    assert [chip.read(a) for a in (0x13, 0x12)] == [0x34, 0x12]
    assert position(chip) == 0x654321


def test_a_read_returns_the_position_of_a_turning_shaft_at_its_clock():
    chip = HCTL1100()
    chip.set_shaft(-10, 0.25)
    for _ in range(100):
        assert position(chip) == -10 + chip.clock // 4
        chip.advance(3)
    assert chip.encoder == position(chip)


def test_any_write_to_the_middle_byte_clears_the_position_any_time():
    for mode in ("idle", "position", "integral"):
        chip = bench(begin(mode)) if mode != "idle" else HCTL1100()
        chip.encoder = -700
        assert position(chip) == -700
        chip.write(0x13, 0xA7)
        assert position(chip) == 0
        chip.encoder = -690
        assert position(chip) == 10
        assert not chip.diagnostics


def test_a_preset_loads_with_its_low_byte_and_in_idle_only():
    chip = HCTL1100()
    chip.encoder = 99
    write_all(chip, word(PRESET, -123_456)[:2])
    assert position(chip) == 99
    write_all(chip, word(PRESET, -123_456)[2:])
    assert position(chip) == -123_456
    write_all(chip, begin("position"), word(PRESET, 5))
    assert position(chip) == -123_456
    assert [d.message for d in chip.diagnostics] == [
        f"R{a} is written outside of Init/Idle: ignored" for a in (15, 16, 17)
    ]


def test_the_position_is_24_bits_round_and_the_loop_does_not_see_the_seam():
    chip = bench(word(COMMAND, (1 << 23) - 1), begin("position"))
    chip.encoder = 1 << 23
    assert position(chip) == -(1 << 23)
    chip.advance(SAMPLE)
    assert chip.motor_command == -0x40 // 4


def test_counts_faster_than_one_in_three_clocks_do_not_come_through_the_filter():
    chip = HCTL1100()
    chip.set_shaft(0, 1 / 3)
    chip.advance(3000)
    assert (chip.encoder, chip.missed_counts) == (1000, 0)
    chip.set_shaft(1000, 0.5)
    chip.advance(3000)
    assert (chip.encoder, chip.missed_counts, position(chip)) == (1000, 1500, 1000)
    chip.set_shaft(2500, -0.25)
    chip.advance(400)
    assert (chip.encoder, chip.missed_counts) == (900, 1500), "slow enough again, from where it was heard last"
    chip.set_shaft(2400, -0.5)
    chip.advance(400)
    assert (chip.encoder, chip.missed_counts) == (900, 1300)
    chip.encoder = 70
    assert (chip.encoder, position(chip)) == (70, 70)


@pytest.mark.parametrize("wrong", [float("nan"), float("inf")])
def test_a_shaft_has_a_finite_place_and_rate(wrong):
    chip = HCTL1100()
    for shafts in ((wrong, 0.0), (0.0, wrong)):
        with pytest.raises(ArgumentError, match="finite"):
            chip.set_shaft(*shafts)
    chip.set_shaft(1e300, -1e290)
    chip.write(0x18, 9)
    chip.advance(1 << 40)
    assert 0 <= chip.read(0x14) < 256
    chip.write(0x05, ALIGN)
    assert (chip.encoder, chip.missed_counts) == (1 << 53, -(1 << 53)), "so fast that nothing is counted"


# --- command position ---


def test_the_command_position_is_latched_by_its_low_byte():
    chip = HCTL1100()
    write_all(chip, word(COMMAND, -2)[:2])
    assert commanded(chip) == 0
    chip.write(0x0E, 0xFE)
    assert commanded(chip) == -2


@pytest.mark.parametrize("address", [0x08, 0x09, 0x15, 0x16, 0x17])
def test_what_is_for_idle_is_ignored_with_a_diagnostic_elsewhere(address):
    chip = bench(begin("position"))
    before = chip.snapshot().record
    chip.write(address, 0x33)
    assert chip.snapshot().record == before
    assert chip.diagnostics[-1].message == f"R{address:02X} is written outside of Init/Idle: ignored"


@pytest.mark.parametrize("address", [0x12, 0x14, 0x34, 0x35])
def test_writes_to_what_can_only_be_read_do_nothing(address):
    chip = HCTL1100()
    chip.encoder = 5
    before = chip.snapshot().record
    chip.write(address, 0x33)
    assert chip.snapshot().record == before
    assert "can only be read" in chip.diagnostics[0].message


def test_a_servo_chip_makes_no_pulses_and_its_waveforms_have_the_commanded_motion():
    chip = trapezoid(100)
    journal = chip.journal()
    assert len(chip.trace(60 * SAMPLE)) == 0
    assert chip.command_position == 100
    assert not chip.busy()
    journal.close()
    waveforms = journal.replay_waveforms(every_pulse=True)
    edges = waveforms.edges
    assert edges["command"][[0, -1]].tolist() == [0, 100]
    of_samples = (edges["clock"] % SAMPLE == 0) | (edges["command"] == [0, *edges["command"][:-1]])
    assert of_samples.all(), "what lies between them is PULSE"
    assert waveforms.pin("prof")[0]
    assert not waveforms.pin("prof")[-1]
    moved = (edges["rate"][1:-1] * SAMPLE * 256).round().astype(int)
    assert 0 < moved.max() <= 8 * 256
    assert edges["motor"].max() > 0


@pytest.mark.parametrize(
    ("address", "value", "message"),
    [
        (0x0A, 1, "there is no register at address 0Ah"),
        (0x05, 0x04, "R05 = 04h is no mode"),
        (0x00, 0x09, "F1 is set and cleared by the chip alone"),
        (0x00, 0x0E, "there is no flag 6"),
        (0x28, 0x80, "R28 = 128: maximum velocity takes 0 to 127"),
    ],
)
def test_a_write_that_means_nothing_changes_nothing_and_has_a_diagnostic(address, value, message):
    chip = HCTL1100()
    before = chip.snapshot().record
    chip.write(address, value)
    assert chip.snapshot().record == before
    assert message in chip.diagnostics[0].message
    assert chip.diagnostics[0].source


def test_addresses_without_a_register_and_registers_that_are_only_written_read_0():
    chip = HCTL1100()
    readable = {r.number for r in chip.MAP.registers if r.access != "W"}
    for address in set(range(64)) - readable:
        chip.write(address, 0x01)
        assert chip.read(address) == 0
