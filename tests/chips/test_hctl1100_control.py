"""HCTL-1100: the control modes, LIMIT and STOP, the motor command."""

import numpy as np
import pytest
from support.examples import SEED
from support.hctl1100_bench import SAMPLE, bench, moving, trapezoid, write_all
from support.hctl1100_programs import (
    COMMAND,
    CONTROL,
    FINAL,
    IDLE,
    MODE_FLAGS,
    acceleration,
    begin,
    gains,
    velocity,
    word,
)

from stage.chips import HCTL1100
from stage.chips.hctl1100 import core


def waveforms(chip, samples):
    """Return the command position after each sample."""
    at = []
    for _ in range(samples):
        chip.advance(SAMPLE)
        at.append(chip.command_position)
    return at


# --- trapezoid ---


def every_step(direction, a, top):
    """The steps of a trapezoid in 256ths of counts, as the specification words them: faster if the rest allows to brake then."""
    rest, v, steps = 256 * direction, 0, []
    while True:
        faster = min(v + a, 256 * top)
        braking = sum(range(faster - a, 0, -a))
        v = faster if rest - faster >= braking else max(v - a, a)
        if v >= rest:
            return [*steps, rest]
        steps.append(v)
        rest -= v


@pytest.mark.parametrize("a", [40, 64, 100, 256, 300, 700])
def test_every_short_trapezoid_brakes_no_step_later_and_no_step_sooner_than_it_must(a):
    """Its velocities on the way, and that it ends in the sample in which it must."""
    for direction in range(1, 30):
        for top in (1, 2, 5):
            chip = trapezoid(direction, a, top)
            steps = every_step(direction, a, top)
            at = [sum(steps[: k + 1]) // 256 for k in range(len(steps))]
            result = waveforms(chip, len(steps) - 1) if len(steps) > 1 else []
            assert result == at[:-1], f"way {direction}, top {top}"
            assert chip.pins.prof
            chip.advance(SAMPLE)
            assert (chip.command_position, chip.pins.prof) == (direction, False), f"way {direction}, top {top}"


def test_a_trapezoid_climbs_by_the_acceleration_cruises_and_brakes():
    chip = trapezoid(1000, a=512, top=10)
    steps = np.diff([0, *waveforms(chip, 120)])
    ramp = [2, 4, 6, 8, 10]
    assert steps[:5].tolist() == ramp
    assert (steps[5:90] == 10).all()
    moving = steps[steps > 0]
    assert (np.diff(moving[90:]) <= 0).all()
    assert chip.command_position == 1000


def test_a_short_move_is_a_triangle():
    chip = trapezoid(-60, a=256, top=127)
    steps = -np.diff([0, *waveforms(chip, 40)])
    assert steps.max() < 10
    assert steps.sum() == 60
    assert chip.command_position == -60


def test_the_profile_flag_falls_at_the_last_command_position_where_control_continues():
    chip = trapezoid(50)
    assert chip.pins.prof
    while chip.pins.prof:
        assert chip.command_position < 50
        assert chip.read(0x07) & 0x10
        chip.advance(SAMPLE)
    assert chip.command_position == 50
    assert chip.read(0x00) == 0
    assert chip.motor_command > 0, "the shaft has not moved, and the position loop pulls"
    chip.encoder = 50
    chip.advance(30 * SAMPLE)
    assert chip.motor_command == 0


def test_the_flag_set_in_position_control_starts_the_profile_at_once():
    chip = bench(word(FINAL, 30), acceleration(256), [(0x28, 3)], begin("position"))
    chip.advance(5 * SAMPLE)
    assert chip.command_position == 0
    chip.write(0x00, 0x08)
    assert waveforms(chip, 3) == [1, 3, 6]


def test_a_move_to_where_it_is_ends_with_its_first_sample():
    chip = trapezoid(0)
    chip.advance(SAMPLE - 1)
    assert chip.pins.prof
    chip.advance(1)
    assert not chip.pins.prof


def test_what_follows_a_profile_begins_at_rest():
    """With F5 set, too, integral velocity follows."""
    for goal in range(10, 40):
        chip = trapezoid(goal, a=256, top=5)
        chip.write(0x00, 0x0D)
        chip.advance(30 * SAMPLE)
        assert not chip.pins.prof
        assert chip.command_position == goal


@pytest.mark.parametrize(("a", "top"), [(0, 5), (100, 0)])
def test_a_trapezoid_that_cannot_move_has_a_diagnostic_and_never_ends(a, top):
    chip = trapezoid(100, a, top)
    assert "never ends" in chip.diagnostics[-1].message
    chip.advance(1000 * SAMPLE)
    assert chip.pins.prof
    assert chip.command_position == 0


def test_new_data_while_the_profile_runs_has_a_diagnostic():
    chip = trapezoid(1000)
    chip.advance(SAMPLE + 16 * 20)
    assert not chip.diagnostics
    write_all(chip, word(FINAL, 2000))
    assert len([d for d in chip.diagnostics if "while PROF is high" in d.message]) == 3


# --- integral velocity, STOP ---


def test_integral_velocity_ramps_to_its_command_and_the_fractions_of_a_count_add_up():
    chip = bench(acceleration(0x40), begin("integral"))
    chip.advance(16 * 20)
    chip.write(0x3C, 2)
    at = waveforms(chip, 12)
    assert at == [sum(min(64 * (k + 1), 512) for k in range(n)) // 256 for n in range(1, 13)]


def test_a_jump_of_the_command_velocity_by_more_than_127_has_a_diagnostic_and_of_no_other_register_and_mode():
    for mode, count in (("integral", 1), ("position", 0)):
        chip = bench(acceleration(0x40), begin(mode))
        chip.advance(16 * 20)
        for address, value in ((0x3C, 100), (0x3C, 0xE5), (0x3C, 100), (0x3C, 0xE4), (0x22, 0x7F), (0x22, 0x80)):
            chip.advance(SAMPLE)
            chip.write(address, value)
        assert [d.message.split(":")[0] for d in chip.diagnostics] == ["R3C changes by -128"] * count


def test_stop_brakes_at_the_acceleration_until_it_is_cleared_and_a_velocity_is_written():
    chip = moving(20, a=512)
    chip.advance(20 * SAMPLE)
    chip.pins.stop = True
    chip.pins.stop = False
    assert chip.read(0x07) & 0x40 == 0, "latched"
    assert np.diff([chip.command_position, *waveforms(chip, 12)]).tolist() == [18, 16, 14, 12, 10, 8, 6, 4, 2, 0, 0, 0]
    chip.advance(300)
    chip.write(0x3C, 5)
    assert "STOP has triggered" in chip.diagnostics[-1].message
    at = chip.command_position
    chip.advance(20 * SAMPLE)
    assert chip.command_position == at
    chip.write(0x07, 0)
    chip.advance(20 * SAMPLE)
    assert chip.command_position == at, "the command velocity is 0 now"
    chip.write(0x3C, 5)
    chip.advance(20 * SAMPLE)
    assert chip.command_position > at


def test_stop_is_not_cleared_while_its_pin_is_asserted():
    chip = moving(20)
    chip.pins.stop = True
    chip.write(0x07, 0)
    assert chip.read(0x07) & 0x40 == 0
    chip.pins.stop = False
    assert chip.read(0x07) & 0x40 == 0
    chip.write(0x07, 0)
    assert chip.read(0x07) & 0x40


@pytest.mark.parametrize("mode", ["position", "trapezoid", "proportional"])
def test_stop_acts_in_integral_velocity_only(mode):
    def run(stop):
        chip = bench(word(FINAL, 500), acceleration(64), [(0x28, 9)], velocity(40), begin(mode))
        chip.pins.stop = stop
        chip.advance(50 * SAMPLE)
        return chip.command_position, chip.motor_command

    assert run(True) == run(False)


def test_successive_integral_velocities_may_differ_by_127():
    chip = moving(64)
    chip.advance(SAMPLE)
    chip.write(0x3C, -63 & 0xFF)
    assert not chip.diagnostics
    chip.advance(SAMPLE)
    chip.write(0x3C, 65)
    assert "changes by 128" in chip.diagnostics[0].message


# --- LIMIT ---


@pytest.mark.parametrize("mode", sorted(MODE_FLAGS))
def test_limit_ends_every_control_mode_at_once_and_its_flags_stay(mode):
    chip = bench(
        word(COMMAND, 9), word(FINAL, 500), acceleration(64), [(0x28, 9), (0x3C, 20)], velocity(40), begin(mode)
    )
    chip.advance(4 * SAMPLE)
    assert chip.motor_command != 0
    flags, at = chip.read(0x00), chip.command_position
    chip.pins.limit = True
    assert chip.pins.init
    assert chip.motor_command == 0
    assert (chip.read(0x08), chip.read(0x09)) == (0x80, 0)
    assert chip.read(0x00) == flags | 0x02
    chip.advance(10 * SAMPLE)
    assert chip.command_position == at


def test_limit_is_latched_and_cleared_by_a_write_to_the_status_once_the_pin_is_released():
    chip = bench(begin("position"))
    chip.pins.limit = True
    chip.write(0x07, 0)
    assert chip.read(0x07) & 0x80 == 0, "the pin is still asserted"
    chip.pins.limit = False
    assert chip.read(0x07) & 0x80 == 0, "nobody has written R07"
    chip.write(0x05, CONTROL)
    assert chip.pins.init, "no control mode while it is triggered"
    assert "LIMIT has triggered" in chip.diagnostics[-1].message
    chip.write(0x07, 0)
    assert chip.read(0x07) & 0x80
    chip.write(0x05, CONTROL)
    assert not chip.pins.init


def test_a_limit_that_blinks_between_samples_is_not_missed():
    chip = bench(begin("position"))
    chip.advance(500)
    chip.pins.limit = True
    chip.pins.limit = False
    assert chip.pins.init


# --- motor command ---


def test_unipolar_commands_have_one_sign():
    chip = bench(word(COMMAND, -5), [(0x05, IDLE), (0x00, 0x0A), (0x05, CONTROL)])
    chip.advance(SAMPLE)
    assert (chip.motor_command, chip.read(0x08)) == (0, 0x80)
    write_all(chip, [(0x05, IDLE)], word(COMMAND, 500), [(0x05, CONTROL)])
    chip.advance(SAMPLE)
    assert (chip.motor_command, chip.read(0x08)) == (127, 0xFF)


def test_the_ports_are_written_in_idle_and_the_last_one_drives():
    chip = HCTL1100()
    chip.write(0x08, 0xC0)
    assert (chip.motor_command, chip.read(0x08), chip.read(0x09)) == (0x40, 0xC0, 0)
    chip.write(0x09, 0xD8)
    assert (chip.motor_command, chip.read(0x08), chip.read(0x09)) == (-40, 0xC0, 0xD8)
    assert chip.pins.sign
    assert chip.pins.pulse
    chip.write(0x09, 40)
    assert not chip.pins.sign
    assert chip.pins.pulse
    chip.write(0x09, 0)
    assert not chip.pins.pulse
    chip.write(0x09, 0x9B)
    assert "takes -100 to 100" in chip.diagnostics[-1].message


def test_in_a_control_mode_both_ports_have_the_same_command():
    chip = bench(word(COMMAND, -5), begin("position"))
    chip.advance(SAMPLE)
    assert chip.motor_command == -80
    assert (chip.read(0x08), chip.read(0x09)) == (0x80 - 80, 256 - 80)
    assert chip.pins.sign


@pytest.mark.parametrize("inhibit", [0, 1])
def test_sign_reversal_inhibit_keeps_pulse_off_for_one_pwm_period(inhibit):
    chip = bench([(0x07, inhibit), (0x09, 50)])
    assert chip.pins.pulse
    chip.write(0x09, -50 & 0xFF)
    assert chip.pins.sign
    observed = []
    for _ in range(220):
        observed.append(chip.pins.pulse)
        chip.advance(1)
    period = [True] * 50 + [False] * 50
    assert observed == (([False] * 100 if inhibit else period) + period + period)[:220]
    assert mean_of(chip, 250, [(0, 0x09, 50)]) == pytest.approx(0.5 * (150 if inhibit else 250) / 250)


def run_for(rows, i, clocks):
    core.run(rows[i], rows[i].clock + clocks)


def mean(rows, i, ticks):
    return core.compute_drive_input(rows[i], 0, 0, ticks)


def mean_of(chip, clocks, writes=()):
    """Return the mean motor command over a slice, as a stage reads it; writes: (clocks after its start, address, value)."""
    mean(chip._rows, chip._i, 1.0)
    at = 0
    for when, address, value in writes:
        run_for(chip._rows, chip._i, when - at)
        at = when
        chip.write(address, value)
    run_for(chip._rows, chip._i, clocks - at)
    return mean(chip._rows, chip._i, float(clocks))


def test_the_mean_over_a_slice_is_that_of_every_clock_samples_inside_or_not():
    seed = SEED
    print("seed", seed)
    rng = np.random.default_rng(seed)
    for _ in range(60):
        k, t = int(rng.integers(0, 256)), int(rng.integers(0, 40))
        chip = bench([(0x0F, t), (0x07, int(rng.integers(2)))], gains(200, 100, k), word(COMMAND, 7), begin("position"))
        chip.advance(int(rng.integers(1000, 3000)))
        chip.set_shaft(float(rng.integers(-20, 20)), float(rng.normal(0, 0.02)))
        clocks = int(rng.integers(1, 2000))
        replica = HCTL1100()
        replica.restore(chip.snapshot())
        total = 0
        for _ in range(clocks):
            total += (
                max(-100, min(100, replica.motor_command)) if replica.clock >= replica.state["pulse_off_until"] else 0
            )
            replica.advance(1)
        assert mean_of(chip, clocks) == pytest.approx(total / (100 * clocks), abs=1e-12)


def test_full_drive_is_100_and_beyond():
    chip = HCTL1100()
    for value, share in ((100, 1.0), (127, 1.0), (-128, -1.0), (-100, -1.0), (-40, -0.4), (0, 0.0)):
        chip.write(0x09, value & 0xFF)
        assert mean_of(chip, 300) == share


@pytest.mark.parametrize("mode", ["position", "integral", "proportional"])
def test_long_times_make_no_difference_where_nearly_nothing_happens(mode):
    """A shaft that creeps is not one at rest, nor is one that stands still again, nor a loop that goes through a velocity of 0."""
    for rate in (0.0, 1e-6, -3e-7):
        uncut, cut = (
            bench(gains(100, 9, 7), acceleration(256), velocity(3), [(0x3C, 2)], begin(mode)) for _ in range(2)
        )
        for chip in (uncut, cut):
            chip.set_shaft(0.5, rate)
            chip.advance(3 * SAMPLE + 300)
            chip.set_shaft(1.5, rate)
            chip.write(0x3C, 0xFE)
        uncut.advance(3000 * SAMPLE)
        for _ in range(3000):
            cut.advance(SAMPLE)
        assert uncut.snapshot() == cut.snapshot()


class Motor:
    """A DC motor: it turns at `speed` counts a sample at full drive, after `lag` samples."""

    def __init__(self, chip, speed=20.0, lag=40.0):
        self.chip, self.speed, self.lag = chip, speed, lag
        self.at = self.velocity = 0.0

    def run(self, samples):
        for _ in range(samples):
            self.velocity += (
                self.speed * max(-100, min(100, self.chip.motor_command)) / 100 - self.velocity
            ) / self.lag
            self.chip.set_shaft(self.at, self.velocity / SAMPLE)
            self.at += self.velocity
            self.chip.advance(SAMPLE)


def test_the_loop_closes_round_a_motor_in_every_control_mode():
    chip = bench(word(FINAL, 3000), acceleration(26), [(0x28, 10)], gains(0xE5, 0x40, 0x40), begin("trapezoid"))
    motor = Motor(chip)
    motor.run(1000)
    assert not chip.pins.prof
    assert abs(motor.at - 3000) < 5
    write_all(chip, [(0x3C, 5), (0x00, 0x0D)])
    motor.run(400)
    assert motor.velocity == pytest.approx(5, abs=0.3)
    assert abs(motor.at - chip.command_position) < 40
    chip.pins.stop = True
    motor.run(400)
    assert abs(motor.velocity) < 0.3
    chip.pins.stop = False
    write_all(chip, [(0x00, 0x05), (0x07, 0x00)], word(COMMAND, 2000))
    motor.run(400)
    assert abs(motor.at - 2000) < 5
    write_all(chip, velocity(-6 * 16), [(0x00, 0x0B)])
    motor.run(400)
    assert -6 <= motor.velocity < -2, "the gain alone leaves an error"
    chip.pins.limit = True
    motor.run(400)
    assert abs(motor.velocity) < 0.01


# --- from one mode to another ---


@pytest.mark.parametrize("mode", ["position", "integral", "trapezoid"])
@pytest.mark.parametrize("k", [4, 64])
def test_a_mode_that_is_entered_from_proportional_velocity_remembers_nothing_of_it(mode, k):
    """X(n-1) = MC(n-1) = 0 on entering a mode: at rest on its goal the motor gets nothing, whatever it got before."""
    chip = bench(gains(200, 200, k), velocity(2000), begin("proportional"))
    chip.advance(SAMPLE)
    assert chip.motor_command == min(127, k * 2000 // 64)
    write_all(chip, [(0x00, 0x03), (0x00, MODE_FLAGS[mode])])
    for _ in range(3):
        chip.advance(SAMPLE)
        assert chip.motor_command == 0


@pytest.mark.parametrize("command", [0, 1, 40, -40, 99, 100, 127, -128])
def test_pulse_is_on_for_the_commands_share_of_each_period_of_100_clocks(command):
    """PWM frequency clk / 100; D8h is 40 % negative."""
    chip = bench([(0x09, command & 0xFF)])
    chip.advance(137)
    journal = chip.journal()
    observed = []
    for _ in range(300):
        observed.append(chip.pins.pulse)
        chip.advance(1)
    assert sum(observed) == 3 * min(abs(command), 100)
    assert chip.pins.sign == (command < 0)
    waveforms = journal.replay_waveforms(every_pulse=True)
    level = np.repeat(waveforms.pin("pulse"), np.diff(waveforms.edges["clock"], append=chip.clock))
    assert level[:300].tolist() == observed, "and so a waveform shows it"
    assert len(journal.replay_waveforms().edges) <= 2, "which has no edges of it unless it is asked for pulses"


@pytest.mark.parametrize(
    ("mode", "first", "second"),
    [
        ("position", word(COMMAND, 5), word(COMMAND, 6)),
        ("integral", [(0x3C, 3)], [(0x3C, 4)]),
        ("proportional", [(0x24, 0), (0x23, 16)], [(0x24, 0), (0x23, 32)]),
    ],
)
def test_two_commands_in_one_sample_have_a_diagnostic_and_one_in_each_has_none(mode, first, second):
    chip = bench([(0x0F, 0x3F)], begin(mode))
    chip.advance(16 * 0x40 + 16 * 0x10)  # a sample has begun, and its law is done
    chip.diagnostics.clear()
    for address, value in first:
        chip.write(address, value)
    assert chip.diagnostics == []
    for address, value in second:
        chip.write(address, value)
    assert {d.message.split(":")[0].split(" ", 1)[1] for d in chip.diagnostics} == {"is written twice in one sample"}
    chip.diagnostics.clear()
    chip.advance(16 * 0x40)
    for address, value in first:
        chip.write(address, value)
    assert chip.diagnostics == []
