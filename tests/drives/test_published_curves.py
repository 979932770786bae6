"""Pull-out curves that makers publish: the simulation beside them, fits of few values to few points, and refused curves."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from stage import ArgumentError
from stage.cli import main
from stage.drives.dynamometer import simulate_pull_out, tabulate_pull_out
from stage.drives.motor_tolerances import vary_motor
from stage.drives.motors import MOTORS, Drive, describe_core_loss, estimate_core_loss, find_motor
from stage.drives.published_pull_out_curves import PUBLISHED_CURVES, PublishedCurve, fit_curve
from stage.drives.pull_out_plot import plot_pull_out

CURVE = PUBLISHED_CURVES["17HS19-2004S1"]
DATA_SHEET = replace(
    MOTORS["17HS19-2004S1"], resistance=1.6, inductance=3.0e-3, holding_torque=0.59, core_loss_resistance=None
)
EVERY_SECOND, BETWEEN = CURVE.rpm[1::2], CURVE.rpm[::2]
LINE = {"motor": "mine", "bus_voltage": 24.0, "current": 1.0, "microsteps": 8, "source": "a page", "reading": "by eye"}


@pytest.fixture(scope="module")
def shipped():
    """Return the curve compared with the shipped motor."""
    return CURVE.compare(find_motor(CURVE.motor))


def test_the_curve_of_the_17hs19_2004s1_is_that_of_the_specification():
    """spec/drives.md, "Losses that grow with speed", N cm."""
    assert CURVE.rpm == tuple(range(100, 1300, 100))
    assert np.array(CURVE.torque) * 100 == pytest.approx(
        [41.2, 40.6, 40.6, 42.2, 40.2, 36.2, 32.4, 28.6, 25.4, 23.2, 20.0, 17.2]
    )
    assert (CURVE.bus_voltage, CURVE.current, CURVE.microsteps) == (24.0, 2.2, 8)
    assert "DM320T" in CURVE.source
    assert CURVE.reading


@pytest.mark.parametrize("speeds", [pytest.param(EVERY_SECOND, marks=pytest.mark.slow), BETWEEN])
def test_two_values_fitted_to_six_points_predict_the_others_within_5_percent(speeds):
    fit = fit_curve(DATA_SHEET, CURVE, speeds)
    print(fit)
    assert fit.rms_of_others < 0.05
    assert fit.comparison.compute_rms() < 0.05
    assert 0.53 < fit.motor.holding_torque < 0.59
    assert 8e-4 < fit.motor.core_loss_damping < 1.1e-3
    assert (fit.motor.resistance, fit.motor.phase_inductance) == (1.6, 3.0e-3)


def test_without_a_core_loss_the_data_sheet_predicts_too_much_torque():
    comparison = CURVE.compare(DATA_SHEET)
    assert comparison.deviation[[0, -1]] == pytest.approx([0.11, 0.72], abs=0.02)
    assert comparison.compute_rms() == pytest.approx(0.36, abs=0.01)


def test_a_fit_recovers_the_motor_of_a_curve():
    known = replace(DATA_SHEET, holding_torque=0.54, core_loss_resistance=60.0)
    curve = replace(CURVE, rpm=(200, 500, 900, 1200), torque=(0.4,) * 4)
    curve = replace(curve, torque=tuple(curve.predict(known)))
    fit = fit_curve(DATA_SHEET, curve, [200, 1200])
    assert fit.motor.holding_torque == pytest.approx(0.54, rel=0.005)
    assert fit.motor.core_loss_damping == pytest.approx(known.core_loss_damping, rel=0.02)
    assert fit.rms_of_others < 0.005


def test_a_fit_may_choose_an_effective_inductance():
    known = replace(DATA_SHEET, effective_inductance=3.9e-3)
    curve = replace(CURVE, rpm=(700, 1000, 1200), torque=(0.4,) * 3)
    curve = replace(curve, torque=tuple(curve.predict(known)))
    fit = fit_curve(DATA_SHEET, curve, [700, 1200], ["effective_inductance"])
    assert fit.motor.effective_inductance == pytest.approx(3.9e-3, rel=0.005)
    assert fit.motor.inductance == 3.0e-3


def test_the_shipped_motor_follows_its_curve_within_5_percent(shipped):
    """The table of docs/drives.md: 100, 300, 600, 900 and 1200 rpm."""
    print(shipped)
    assert shipped.compute_rms() < 0.05
    assert shipped.compute_rms(BETWEEN) < 0.05, "the points that were not fitted"
    assert shipped.deviation[[0, 2, 5, 8, 11]] == pytest.approx([0.03, 0.0, 0.01, 0.04, -0.01], abs=0.01)


@pytest.mark.parametrize("m", [m for m in MOTORS.values() if m.name not in PUBLISHED_CURVES], ids=lambda m: m.name)
def test_a_shipped_motor_without_a_curve_has_the_middle_of_its_likely_loss(m):
    assert m.core_loss_damping == pytest.approx(estimate_core_loss(m).middle, rel=0.01)
    assert m.evidence["core_loss_resistance"].startswith("I: no pull-out curve is at hand")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"rpm": (100, 200), "torque": (0.4, 0.3)},
            "2 speeds and 2 torques; give 3 points or more, a torque at each speed.",
        ),
        ({"rpm": (100, 200, 300), "torque": (0.4, 0.3)}, "3 speeds and 2 torques; give 3 points or more"),
        ({"rpm": (100, 300, 200)}, "rpm=(100, 300, 200); give speeds above 0 in rising order."),
        ({"rpm": (100, 100, 200)}, "give speeds above 0 in rising order."),
        ({"rpm": (0, 100, 200)}, "give speeds above 0 in rising order."),
        ({"rpm": (100, math.nan, 200)}, "give speeds above 0 in rising order."),
        ({"torque": (0.4, -0.1, 0.2)}, "torque=(0.4, -0.1, 0.2); give N m above 0,"),
        ({"torque": (0.4, math.inf, 0.2)}, "give N m above 0,"),
        ({"torque": (0.4, 0.3, 0.0)}, "torque=(0.4, 0.3, 0.0); give N m above 0, as deviations are relative to them."),
        ({"rpm": "abc"}, "rpm='abc'; give a list of numbers."),
        ({"rpm": (100, "200", 300)}, "rpm=(100, '200', 300); give a list of numbers."),
        ({"rpm": None}, "rpm=None; give a list of numbers."),
        ({"torque": 0.4}, "torque=0.4; give a list of numbers."),
        ({"current": -2.0}, "current=-2.0: give a number above 0, up to 100 A."),
    ],
)
def test_a_curve_that_is_none_is_refused_in_one_sentence(change, message):
    with pytest.raises(ArgumentError) as error:
        PublishedCurve(**(LINE | {"rpm": (100, 200, 300), "torque": (0.4, 0.3, 0.2)} | change))
    assert str(error.value).startswith("curve of the mine: ")
    assert message in str(error.value)


def test_curves_of_lists_and_arrays_are_those_of_tuples():
    first, *others = (
        PublishedCurve(**LINE, rpm=make((100, 200, 300)), torque=make((0.4, 0.3, 0.2)))
        for make in (tuple, list, np.array)
    )
    assert all(other == first and hash(other) == hash(first) for other in others)


@pytest.mark.parametrize("speeds", [[], [150], [100, 150]])
def test_a_deviation_at_speeds_that_the_curve_does_not_have_is_refused(speeds, shipped):
    assert shipped.compute_rms([100]) == pytest.approx(abs(shipped.deviation[0]))
    with pytest.raises(ArgumentError) as error:
        shipped.compute_rms(speeds)
    assert str(error.value).startswith(f"speeds={speeds!r}: give some of the curve's, [100.0, 200.0,")


def test_a_fit_to_all_points_of_a_curve_predicts_no_others():
    curve = PublishedCurve(**LINE | {"current": 2.0}, rpm=(300, 600, 900), torque=(0.4, 0.36, 0.25))
    fit = fit_curve(DATA_SHEET, curve, curve.rpm)
    assert math.isnan(fit.rms_of_others)
    assert str(fit).endswith("rms deviation at the speeds that were not fitted: all were")


@pytest.mark.parametrize("setting", [{"bus_voltage": -24.0}, {"bus_voltage": "24 V"}, {"microsteps": 0}])
def test_a_curve_with_settings_that_no_drive_has_is_refused(setting):
    ((name, value),) = setting.items()
    with pytest.raises(ArgumentError, match=f"^{name}={value!r}: "):
        PublishedCurve(**(LINE | {"rpm": (100, 200, 300), "torque": (0.4, 0.3, 0.2)} | setting))


@pytest.mark.parametrize("speeds", [None, ["fast", "slow"], [100, None]])
def test_speeds_that_are_no_numbers_are_refused_by_a_fit(speeds):
    with pytest.raises(ArgumentError, match=r"speeds=.*a list, of each a number"):
        fit_curve(DATA_SHEET, CURVE, speeds)


@pytest.mark.parametrize("ratio", [-1, math.inf, math.nan, "0.15"])
def test_a_bench_refuses_a_damper_that_is_none(ratio):
    with pytest.raises(
        ArgumentError, match=f"^damping_ratio={ratio!r}: give a number from 0 up to 10 times critical.$"
    ):
        simulate_pull_out(Drive(), [600], damping_ratio=ratio)


@pytest.mark.parametrize(
    ("speeds", "values", "message"),
    [
        ([100, 250], ["holding_torque"], "give 1 to 6 of the curve's speeds"),
        (CURVE.rpm[:7], ["holding_torque"], "give 1 to 6 of the curve's speeds"),
        ([100], ["holding_torque", "core_loss_resistance"], "give 2 to 6 of the curve's speeds"),
        ([100, 200, 300], [], "a curve fixes one or two values"),
        ([100, 200], ["holding_torque"] * 2, "a curve fixes one or two values"),
        ([100, 200, 300], ["holding_torque", "effective_inductance", "core_loss_resistance"], "one or two values"),
        ([100, 200], ["holding_torqe"], "Did you mean 'holding_torque'"),
    ],
)
def test_a_fit_of_too_much_or_elsewhere_is_refused(speeds, values, message):
    with pytest.raises(ArgumentError, match=message):
        fit_curve(DATA_SHEET, CURVE, speeds, values)


def test_the_likely_core_loss_grows_with_the_holding_torque_and_holds_that_of_the_curve():
    small, strong = (estimate_core_loss(find_motor(name)) for name in ("SS2422-5041", "17HS4401"))
    assert small.low < small.middle < small.high
    assert strong == pytest.approx(np.array(small) * 0.40 / 0.186)
    assert strong == pytest.approx([2.0e-4, 3.6e-4, 6.4e-4])
    likely = estimate_core_loss(DATA_SHEET)
    assert likely.low < 3.1e-4 < 9.2e-4 < likely.high, "the two fits of spec/drives.md"


# --- what stage pullout shows ---


@pytest.mark.parametrize(
    ("name", "label"),
    [
        (CURVE.motor, "published, 24 V, 2.2 A"),
        ("17HS4401", "likely: core loss 0.0002 to 0.00064 N m s/rad"),
    ],
)
def test_the_picture_has_the_published_points_or_the_band_of_the_likely_loss(name, label):
    drive = Drive(name)
    (ax,) = plot_pull_out(drive, tabulate_pull_out(drive, [300, 900])).axes
    assert label in [text.get_text() for text in ax.get_legend().get_texts()]
    published = [line for line in ax.lines if "published" in line.get_label()]
    assert len(published) == (name == CURVE.motor)
    assert all(line.get_ydata() == pytest.approx(np.array(CURVE.torque)) for line in published)


def test_the_band_of_the_likely_loss_ends_where_such_motors_have_no_torque():
    """At 8 V the 17HS4401 has no torque from 1650 rpm on; without core loss it would have 0.01 N m at 2400 rpm"""
    drive, likely, rpm = (
        Drive("17HS4401", bus_voltage=8.0),
        estimate_core_loss(find_motor("17HS4401")),
        [900, 1650, 2400],
    )
    (ax,) = plot_pull_out(drive, tabulate_pull_out(drive, rpm)).axes
    band = next(drawn for drawn in ax.collections if "likely" in str(drawn.get_label())).get_paths()[0].vertices
    for loss, reach in ((likely.low, np.max), (likely.high, np.min)):
        simulated = simulate_pull_out(replace(drive, motor=vary_motor(drive.motor, core_loss_damping=loss)), rpm)
        assert [reach(band[band[:, 0] == speed, 1]) for speed in rpm] == pytest.approx(list(simulated))


def test_pullout_compares_with_the_published_curve(capsys, monkeypatch):
    monkeypatch.setattr("stage.drives.dynamometer.tabulate_pull_out", lambda drive, progress: "table")
    assert main(["pullout", "--motor", CURVE.motor]) == 0
    output = capsys.readouterr().out
    assert CURVE.source in output
    assert next(line.split()[:2] for line in output.splitlines() if "%" in line) == ["100", "0.412"]
    assert main(["pullout", "--motor", CURVE.motor, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["published"]["published"] == list(CURVE.torque)


def test_one_sentence_says_how_well_a_core_loss_is_known():
    assert describe_core_loss(MOTORS["17HS4401"]) == (
        "No pull-out curve of the 17HS4401 is at hand: its core loss is likely 0.0002 to 0.00064 N m s/rad, simulated with 0.00036."
    )
    assert describe_core_loss(MOTORS[CURVE.motor]) == (
        "The core loss of the 17HS19-2004S1, 0.00089 N m s/rad, is fitted to its published pull-out curve."
    )
