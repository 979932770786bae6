"""StallGuard4 of the TMC2209: the shape of SG_RESULT, when DIAG shows a stall, and homing without a switch."""

import numpy as np
import pytest

from pulsestage_trinamic.tmc2209 import TMC2209
from stage import Drive, Stage, firmware

PERIOD_NS = 156_250  # of a step at 6,400 pps: TSTEP 117


def measure(lam, emf, current=1.2, setup=(), period_ns=PERIOD_NS):
    """Drive a chip by itself under a fixed load for some full steps, and return it."""
    chip = TMC2209()
    chip.fit_drive(Drive(power_stage="tmc2209", current=current))
    for name, value in setup:
        chip.write_register(name, value)
    chip.set_load(lam, emf)
    for _ in range(40):
        chip.step = True
        chip.advance(1000)
        chip.step = False
        chip.advance(period_ns - 1000)
    return chip


def decode_results(loads, **setup):
    return [measure(lam, emf, **setup).read_register("SG_RESULT") for lam, emf in loads]


def test_the_result_falls_with_load_to_0_and_is_even_and_below_512():
    results = decode_results([(lam, 100) for lam in range(0, 1025, 128)])
    assert results == sorted(results, reverse=True)
    assert (results[0] > 0, results[-1]) == (True, 0)
    assert all(result % 2 == 0 and result <= 510 for result in results)
    assert decode_results([(0, 1024)])[0] < 510


def test_the_result_rises_with_speed_and_falls_with_current():
    by_speed = decode_results([(0, emf) for emf in (10, 50, 100, 200, 400)])
    assert by_speed == sorted(set(by_speed))
    by_current = [decode_results([(0, 100)], current=current)[0] for current in (0.5, 1.0, 1.5, 2.0)]
    assert by_current == sorted(set(by_current), reverse=True)


def test_the_result_is_0_in_spread_cycle_and_with_the_motor_off():
    for setup in ([("GCONF", 0x105)], [("CHOPCONF", 0x10000050)], [("TPWMTHRS", 1000)]):
        assert measure(0, 100, setup=setup).read_register("SG_RESULT") == 0


@pytest.mark.parametrize(
    ("tcoolthrs", "lam", "is_high"),
    [
        (0, 1024, False),
        (110, 1024, False),
        (118, 1024, False),
        (126, 1024, True),
        (0xFFFFF, 1024, True),
        (0xFFFFF, 0, False),
    ],
)
def test_diag_shows_a_stall_only_above_the_speed_of_tcoolthrs(tcoolthrs, lam, is_high):
    """Open the window at TSTEP <= TCOOLTHRS x 15 / 16 - 1."""
    chip = measure(lam, 100, setup=[("TCOOLTHRS", tcoolthrs), ("SGTHRS", 50)])
    assert chip.read_register("TSTEP") == 117
    assert chip.diag == is_high


def test_diag_compares_the_result_with_twice_the_threshold():
    result = measure(512, 100).read_register("SG_RESULT")
    for sgthrs in (result // 2 - 1, result // 2):
        chip = measure(512, 100, setup=[("TCOOLTHRS", 0xFFFFF), ("SGTHRS", sgthrs)])
        assert chip.diag == (result <= 2 * sgthrs)


def test_a_stall_ends_at_standstill():
    chip = measure(1024, 100, setup=[("TCOOLTHRS", 0xFFFFF), ("SGTHRS", 50)])
    assert chip.diag
    chip.advance(100_000_000)
    assert not chip.diag


def test_coolstep_lowers_the_current_under_little_load_and_raises_it_under_much():
    setup = [("TCOOLTHRS", 0xFFFFF), ("COOLCONF", 2 | 1 << 8 | 3 << 13)]
    assert measure(0, 400, setup=setup).read_register("DRV_STATUS") >> 16 & 31 < 31
    assert measure(1024, 400, setup=setup).read_register("DRV_STATUS") >> 16 & 31 == 31


def make_axis(**drive):
    stage = Stage(
        "xy", chips="stepdir", drives=Drive(power_stage="tmc2209", **{"current": 1.2, **drive}), visuals=False
    )
    return stage.axes["x"]


def drive_until_diag(axis, rate, sgthrs, steps=6000):
    """Run towards plus up to a stall, as a host does that watches DIAG, and return the steps made or None."""
    chip = axis.chip
    chip.write_register("TCOOLTHRS", round(1.2 * 12e6 / (16 * rate)))
    chip.write_register("SGTHRS", sgthrs)
    for pps in np.geomspace(rate / 5, rate, 30):
        axis.pulse(32, rate=pps)
    for done in range(0, steps, 8):
        if chip.diag:
            return done
        axis.pulse(8, rate=rate)
    return None


def test_friction_on_the_carriage_lowers_the_result_on_a_stage():
    results = []
    for friction in (2.0, 60.0):
        x = make_axis()
        x.stage.model.dof_frictionloss[x.plant.dof] = friction
        drive_until_diag(x, 9600, 0, steps=1600)
        results.append(x.chip.read_register("SG_RESULT"))
        assert x.lost_steps == 0
    assert results[1] < 0.9 * results[0]


def test_a_carriage_that_is_blocked_away_from_any_switch_stalls_and_shows_it():
    x = make_axis()
    assert drive_until_diag(x, 6400, 30, steps=1200) is None
    x.stage.model.dof_frictionloss[x.plant.dof] = 1e5
    blocked = x.position
    assert drive_until_diag(x, 6400, 30, steps=1200) is not None
    assert abs(x.position - blocked) < 5e-3
    assert not x.chip.limit


@pytest.mark.parametrize("rate", [6400, 9600])
def test_homing_by_diag_finds_the_end_of_travel_within_8_full_steps(rate):
    ends = []
    for start in (150e-3, 149.3e-3):
        x = make_axis()
        firmware.move(x, start)
        assert drive_until_diag(x, rate, 30) is not None
        ends.append(x.position)
    assert abs(ends[1] - ends[0]) < 8 * 50e-6
    assert ends[0] == pytest.approx(x.travel[1], abs=3e-3)


def test_homing_by_polling_sg_result_stops_where_diag_does():
    x = make_axis()
    firmware.move(x, 150e-3)
    chip, rate = x.chip, 9600
    for pps in np.geomspace(rate / 5, rate, 30):
        x.pulse(32, rate=pps)
    polled = 0
    for _ in range(700):
        x.pulse(8, rate=rate)
        polled += 1
        if chip.read_register("SG_RESULT") <= 60:
            break
    assert polled < 700
    assert x.position == pytest.approx(x.travel[1], abs=3e-3)


def test_the_load_is_in_the_journal_so_that_a_recording_repeats_diag():
    x = make_axis()
    firmware.move(x, 155e-3)
    journal = x.chip.journal()
    assert drive_until_diag(x, 6400, 30) is not None
    replayed = journal.replay_waveforms().edges
    bit = x.chip.INPUTS["diag"]
    assert replayed["inputs"][-1] & bit
