"""HCTL-1100: the sample timer and SYNC, as the data sheet's page 24 has them."""

import pytest
from support.hctl1100_bench import SAMPLE, bench, moving, to_sample
from support.hctl1100_programs import COMMAND, acceleration, begin, velocity, word

from stage.chips import HCTL1100
from stage.chips.hctl1100.maps import MINIMUM_T


@pytest.mark.parametrize(
    "every",
    [(0, 1, 2, 7, 15, 16, 63, 64, 127, 128, 254, 255), pytest.param(range(256), marks=pytest.mark.slow)],
    ids=["some", "all"],
)
def test_a_sample_lasts_16_times_t_plus_1_clocks_for_every_t(every):
    for t in every:
        chip = moving(1, t=t)
        chip.advance(3 * 16 * (t + 1))
        to_sample(chip)
        at = chip.command_position
        for k in range(1, 4):
            chip.advance(16 * (t + 1) - 1)
            assert chip.command_position == at + k - 1, f"T = {t}: a sample came a clock early"
            chip.advance(1)
            assert chip.command_position == at + k, f"T = {t}: no sample after 16 (T + 1) clocks"


@pytest.mark.parametrize(
    ("hz", "t", "seconds"),
    [(2_000_000, 0x07, 64e-6), (2_000_000, 0xFF, 2048e-6), (1_000_000, 0x07, 128e-6), (1_000_000, 0xFF, 4096e-6),
     (2_000_000, 0x0F, 128e-6)],
)  # fmt: skip
def test_sample_times_of_the_data_sheet(hz, t, seconds):
    chip = bench([(0x0F, t)], acceleration(0x100), begin("integral"), [(0x3C, 1)], clock_hz=hz)
    chip.advance(20 * SAMPLE)
    at = chip.command_position
    chip.advance(round(10 * seconds * hz))
    assert chip.command_position == at + 10


def test_table_4_is_the_least_t_of_each_control_mode_and_a_smaller_one_has_a_diagnostic_and_works():
    assert MINIMUM_T == {"position": 7, "proportional velocity": 7, "trapezoid": 15, "integral velocity": 15}
    for mode, least in (("position", 7), ("proportional", 7), ("trapezoid", 15), ("integral", 15)):
        for t in (least, least - 1, 0):
            chip = bench([(0x0F, t)], acceleration(0x100), [(0x28, 1)], begin(mode))
            notes = [d.message for d in chip.diagnostics if "is below" in d.message and d.clock == chip.clock]
            assert bool(notes) == (t < least), (mode, t)
            chip.advance(10_000)


def test_the_timer_counts_down_from_t_to_0_and_reads_as_it_runs():
    chip = HCTL1100()
    chip.write(0x0F, 0x39)
    observed = []
    for _ in range(16 * (0x41 + 0x3A)):
        observed.append(chip.read(0x0F))
        chip.advance(1)
    expected = [k for t in (0x40, 0x39) for k in range(t, -1, -1) for _ in range(16)]
    assert observed == expected
    assert chip.read(0x0F) == 0x39


def test_a_new_t_is_used_after_the_present_count_ends():
    chip = HCTL1100()
    chip.advance(100)
    chip.write(0x0F, 7)
    assert chip.read(0x0F) == 0x40 - 100 // 16
    chip.advance(SAMPLE - 101)
    assert chip.read(0x0F) == 0
    chip.advance(1)
    assert chip.read(0x0F) == 7
    chip.write(0x0F, 0x20)
    chip.advance(16 * 8)
    assert chip.read(0x0F) == 0x20


def test_the_first_sample_comes_16_times_41h_clocks_after_reset():
    chip = bench(acceleration(0x100), begin("integral"), [(0x3C, 1)])
    chip.advance(SAMPLE - 1)
    assert chip.command_position == 0
    chip.advance(1)
    assert chip.command_position == 1


def test_t_of_0_samples_every_16_clocks():
    chip = moving(1, t=0)
    to_sample(chip)
    at = chip.command_position
    chip.advance(16 * 100)
    assert chip.command_position == at + 100
    assert chip.read(0x0F) == 0


# --- commands written in the unsafe part of a sample ---


def settled(mode="position"):
    """A chip of T = 39h at the first clock of a sample, its command position 0FEh, the shaft there."""
    chip = bench([(0x0F, 0x39)], word(COMMAND, 0xFE), acceleration(0x100), begin(mode))
    chip.encoder = 0
    chip.write(0x13, 0)
    chip.encoder = 0xFE
    chip.advance(SAMPLE + 5 * 16 * 0x3A)
    assert chip.read(0x0F) == 0x39
    assert chip.motor_command == 0
    return chip


@pytest.mark.parametrize("mode", ["position", "integral"])
def test_a_command_position_written_before_the_timer_has_counted_down_by_the_minimum_throws_the_sample_off(mode):
    """The example of the data sheet: T = 39h, wait until 32h. 0FEh to 102h: the torn command is 002h."""
    least = {"position": 7, "integral": 15}[mode]
    for count in range(0x3A):
        chip = settled(mode)
        chip.advance(16 * count)
        assert chip.read(0x0F) == 0x39 - count
        chip.diagnostics.clear()
        for address, value in word(COMMAND, 0x102):
            chip.write(address, value)
        torn = count < least
        assert bool(chip.diagnostics) == torn
        assert chip.motor_command == (-128 if torn else 0), f"written at {0x39 - count:02X}h"
        chip.advance(16 * (0x3A - count))
        assert chip.motor_command == 0x40 * 4 // 4, "the next sample is right again"


def test_a_command_velocity_written_too_early_acts_byte_by_byte_at_once():
    chip = bench([(0x0F, 0x39)], velocity(0x00F8), begin("proportional"))
    chip.advance(SAMPLE)
    motor_commands = [chip.motor_command]
    for address, value in velocity(0x0108):
        chip.write(address, value)
        motor_commands.append(chip.motor_command)
    assert motor_commands == [127, 0x40 * 0x08 // 64, 127]
    chip.advance(16 * 7)
    chip.write(0x23, 0)
    chip.write(0x24, 0)
    assert chip.motor_command == 127, "in the safe part it waits for the sample"


def test_an_integral_velocity_written_too_early_jumps_instead_of_ramping():
    chip = bench([(0x0F, 0x39)], acceleration(0x40), begin("integral"))
    chip.advance(SAMPLE)
    chip.write(0x3C, 100)
    assert chip.motor_command == 127, "40h 100 / 4, clipped"
    chip.advance(16 * 0x3A)
    assert chip.motor_command < 10


def test_commands_in_the_safe_part_of_a_sample_never_disturb():
    """A host that writes once a sample at 32h: the command is what the law makes of it, ten thousand times."""
    chip = bench([(0x0F, 0x39), (0x21, 0), (0x20, 0)], begin("position"))
    chip.advance(SAMPLE)
    for n in range(10_000):
        chip.advance(16 * 7)
        command = 37 * n % 100_000
        for address, value in word(COMMAND, command):
            chip.write(address, value)
        chip.encoder = command - n % 7
        previous = chip.motor_command
        chip.advance(16 * (0x3A - 7) - 1)
        assert chip.motor_command == previous
        chip.advance(1)
        assert chip.motor_command == 0x40 * (n % 7) // 4
    assert not [d for d in chip.diagnostics if "while the sample is computed" in d.message]


# --- SYNC ---


def test_sync_starts_the_samples_of_several_chips_at_one_clock():
    chips = [bench([(0x0F, 0x1F)]) for _ in range(3)]
    for k, chip in enumerate(chips):
        chip.advance(100 + 777 * k)
    for chip in chips:
        chip.pins.sync = True
        chip.advance(50)
        assert chip.read(0x0F) == 0, "held"
    for chip in chips:
        chip.pins.sync = False
        assert chip.read(0x0F) == 0x1F, "counts from the programmed value at once"
        for writes in (acceleration(0x100), begin("integral"), [(0x3C, 1)]):
            for address, value in writes:
                chip.write(address, value)
    for n in range(1, 200):
        for chip in chips:
            chip.advance(16)
        assert len({chip.read(0x0F) for chip in chips}) == 1
        assert {chip.command_position for chip in chips} == {n // 0x20}


def test_without_sync_chips_keep_the_phase_of_their_resets():
    one, other = HCTL1100(), HCTL1100()
    one.advance(400)
    one.reset()
    one.advance(1000)
    other.advance(1000)
    assert one.read(0x0F) == other.read(0x0F)
    other.reset()
    assert one.read(0x0F) != other.read(0x0F)


def test_sync_means_nothing_in_a_control_mode_and_leaving_idle_lets_the_timer_go():
    chip = moving(1)
    chip.pins.sync = True
    chip.advance(10 * SAMPLE)
    assert chip.command_position >= 10
    chip.write(0x05, 0x01)
    chip.advance(10 * SAMPLE)
    assert chip.read(0x0F) == 0
    chip.write(0x05, 0x03)
    assert chip.read(0x0F) == 0x40
