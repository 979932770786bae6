"""What the MK and MS offer, used by the same procedures: S-curves, the automatic ramp-down point, position counter, read-back."""

import numpy as np
import pytest
from support.examples import SEED

from stage import ArgumentError, StageError, firmware
from stage.chips import PCL240K, PCL240MK, PCL240MS
from stage.firmware import Bench, ChipPort, Profile
from stage.firmware.pcl240.preset_move_closed_form import _compute_mean_step_delay, compute_twice_curved_end_steps

SHAPES = [False, True, 0.2]


def axis(chip):
    return Bench(chip()).axes["x"]


def random_profiles(n, **options):
    print(f"PULSESTAGE_SEED={SEED}")
    rng = np.random.default_rng(SEED)
    for _ in range(n):
        rates = {"fl": rng.uniform(200, 1500), "fh1": rng.uniform(4000, 60_000), "accel": rng.uniform(0.02, 0.5)}
        yield Profile.of(**rates, **options), int(rng.integers(1, 40_000))


def end_speed(report):
    """The speed register's value of the last pulses."""
    running = report.waveforms.edges[~report.waveforms.pin("hold")]
    return running["speed"][-1]


@pytest.mark.parametrize("chip", [PCL240MK, PCL240MS])
def test_the_same_move_makes_the_same_pulses_on_all_three_chips(chip):
    for profile, pulses in random_profiles(5):
        k = firmware.preset_move(axis(PCL240K), pulses, profile)
        other = firmware.preset_move(axis(chip), pulses, profile, automatic=False)
        assert other.pulses == pulses
        assert other.duration == pytest.approx(k.duration, abs=1e-6)
        assert list(other.rates[other.rates > 0]) == list(k.rates[k.rates > 0])


@pytest.mark.parametrize("s_curve", SHAPES)
@pytest.mark.parametrize("automatic", [True, False])
def test_a_preset_move_of_any_length_and_shape_ends_on_its_pulse_at_fl(s_curve, automatic):
    for profile, pulses in random_profiles(12, chip=PCL240MS):
        report = firmware.preset_move(axis(PCL240MS), pulses, profile, s_curve=s_curve, automatic=automatic)
        assert report.ok
        assert report.stopped_by == "R0 = 0"
        assert end_speed(report) <= profile.R1 + 1, (str(profile), pulses)


def test_an_s_curve_takes_the_time_of_the_linear_ramp_it_replaces():
    for profile, _ in random_profiles(8, chip=PCL240MS):
        for s_curve in (True, 0.1, 0.3, 0.5):
            curved = profile.with_ramp_shape(s_curve)
            assert curved.get_accel_time() == pytest.approx(
                profile.get_accel_time(), rel=0.5 / min(profile.R4, curved.R4) + 1e-9
            )
        long = int(6 * profile.compute_pulses_through([profile.R2]))
        times = [firmware.preset_move(axis(PCL240MS), long, profile, s_curve=s).duration for s in SHAPES]
        assert max(times) - min(times) < 0.02 * 2 * profile.get_accel_time() + 20 / profile.fl


def test_the_ramp_of_an_s_curve_starts_and_ends_gently():
    profile = Profile.of(fl=500, fh1=30_000, accel=0.2, chip=PCL240MS)

    def gains(s_curve):
        waveform = firmware.preset_move(axis(PCL240MS), 30_000, profile, s_curve=s_curve).waveforms
        up = waveform.pin("fup")
        t, speed = waveform.seconds[up], waveform.edges["speed"][up]
        return np.diff(np.interp(np.linspace(t[0], t[-1], 11), t, speed))

    linear, curved = gains(False), gains(True)
    assert np.ptp(linear) < 0.02 * linear.mean()
    assert curved[0] < 0.25 * curved.max() > curved[-1]
    assert curved.max() == pytest.approx(2 * linear.mean(), rel=0.15)


def test_fh_correction_keeps_a_short_s_curve_off_a_triangle():
    profile = Profile.of(fl=500, fh1=30_000, accel=0.2, s_curve=True, chip=PCL240MS)
    short = firmware.preset_move(axis(PCL240MS), 2000, profile)
    sharp = firmware.preset_move(axis(PCL240MS), 2000, profile, fh_correction=False)
    assert short.peak_rate < 0.9 * profile.fh1
    keeps = short.waveforms.pin("fkeep") & ~short.waveforms.pin("hold")
    assert keeps.any()
    assert sharp.ok
    assert sharp.rates.max() != short.rates.max()


def test_a_manual_s_curve_too_short_for_fh_takes_the_revised_r2_of_the_data_sheet():
    profile = Profile.of(fl=500, fh1=30_000, accel=0.2, s_curve=0.3, chip=PCL240MS)
    report = firmware.preset_move(axis(PCL240MS), 3000, profile, automatic=False)
    assert any("R2 <- " in meaning for _, _, meaning in report.writes())
    assert report.peak_rate == pytest.approx(profile.for_distance(3000).fh1, abs=2 * profile.rate_per_speed_step)
    assert end_speed(report) == profile.R1


def test_moves_between_rates_take_s_curves_from_their_profile():
    profile = Profile.of(fl=500, fh1=8000, fh2=16_000, accel=0.1, s_curve=True, chip=PCL240MS)
    report = firmware.dual_rate_move(axis(PCL240MS), 12_000, profile)
    assert report.ok
    assert end_speed(report) == profile.R1
    resumed = firmware.interrupted_move(axis(PCL240MS), 12_000, profile)
    assert resumed.pulses == 12_000
    assert end_speed(resumed) == profile.R1


def test_what_a_chip_does_not_have_is_refused_before_the_first_bus_cycle():
    for chip, options, message in (
        (PCL240K, {"s_curve": True}, "PCL240K has linear ramps only; S-curves need a PCL240MS"),
        (PCL240MK, {"s_curve": 0.2}, "PCL240MK has linear ramps only"),
        (PCL240K, {"automatic": True}, "no automatic ramp-down point: a PCL240MK or PCL240MS has"),
        (PCL240MS, {"s_curve": 0.6}, "True, False, or the share"),
        (PCL240MK, {"automatic": True, "down_point": 600_000}, "from -524288 to 524287"),
    ):
        x = axis(chip)
        with pytest.raises(ArgumentError, match=message):
            firmware.preset_move(x, 1000, **options)
        assert x.time == 0.0


def test_a_profile_for_the_ms_that_a_k_cannot_hold_names_the_register():
    slow = Profile.of(fl=100, fh1=1000, fh2=1000, accel=10, multiplier=600, chip=PCL240MS)
    assert slow.R4 > 16_383
    with pytest.raises(ArgumentError, match="PCL240K R4"):
        firmware.preset_move(axis(PCL240K), 1000, slow)


@pytest.mark.parametrize("chip", [PCL240MK, PCL240MS])
def test_registers_are_read_back_and_the_position_is_counted(chip):
    x = axis(chip)
    port = ChipPort(x)
    port.write_registers(R1=500, R13=0x123456, R12=0xABCDEF)
    assert [port.read_register(n) for n in ("R1", "R13", "R12")] == [500, 0x123456, 0xABCDEF]
    firmware.preset_move(x, 3000)
    firmware.preset_move(x, -5000)
    assert port.read_position() == -2000
    assert port.read_counter() == 0, "and R0 reads as ever"
    assert x.chip.diagnostics == []


def test_a_k_reads_r0_only():
    with pytest.raises(StageError, match="reads R0 only"):
        ChipPort(axis(PCL240K)).read_register("R1")


def test_listings_name_extension_registers():
    report = firmware.preset_move(axis(PCL240MS), 3000, s_curve=0.2)
    assert any(m.startswith("R14 <- ") for _, _, m in report.writes())
    assert "automatic" in report.listing()


@pytest.mark.parametrize(("span", "twice"), [(0, 400), (100, 200), (199, 398), (200, 400), (201, 400), (300, 400)])
def test_a_span_of_more_than_half_of_a_ramp_leaves_no_linear_part(span, twice):
    """R14 = 300 for a ramp of 400 speed steps: as R14 = 0"""
    assert compute_twice_curved_end_steps(span, 400) == twice


def test_the_linear_part_of_a_curve_lags_by_the_rounding_of_its_first_two_steps():
    """The chip takes a step at the first whole tick; quarters of a tick, that alternate between a and a + 2 rate"""
    for a in range(8):
        for rate in range(1, 6):
            lack = [next(k for k in range(4) if (at + k) % 4 == 0) / 4 for at in (a, a + 2 * rate)]
            assert _compute_mean_step_delay(a, rate) == sum(lack) / 2, (a, rate)
