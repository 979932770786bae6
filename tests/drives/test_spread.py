"""Spread of core loss and inductance over machines: each motor's own range, with its evidence."""

import math
from dataclasses import replace

import pytest

from stage import ArgumentError
from stage.drives.dynamometer import compute_closed_form_torque, compute_torque_bound
from stage.drives.motor_tolerances import estimate_tolerances, vary_motor
from stage.drives.motors import EVIDENCE, MOTORS, describe_core_loss, estimate_core_loss, find_motor, read_tolerance
from stage.drives.published_pull_out_curves import PUBLISHED_CURVES, fit_curve

CURVE = PUBLISHED_CURVES["17HS19-2004S1"]


@pytest.mark.parametrize("m", MOTORS.values(), ids=lambda m: m.name)
def test_every_motor_lies_in_its_spread_and_each_range_says_its_evidence(m):
    spread = estimate_tolerances(m)
    assert spread["core_loss_damping"].low < m.core_loss_damping < spread["core_loss_damping"].high
    low, high, _ = spread["inductance"]
    assert (low, high) == pytest.approx((0.8 * m.inductance, 1.2 * m.inductance))
    assert all(result.evidence[0] in EVIDENCE and result.evidence[1:3] == ": " for result in spread.values())


def test_a_motor_without_a_curve_has_the_likely_loss_and_one_with_a_curve_a_narrower_one():
    loose, fitted = (estimate_tolerances(find_motor(name))["core_loss_damping"] for name in ("17HS4401", CURVE.motor))
    assert loose[:2] == pytest.approx((2.0e-4, 6.4e-4))
    assert fitted[:2] == pytest.approx((5.8e-4, 1.11e-3), rel=0.01)
    assert (loose.evidence[0], fitted.evidence[0]) == ("I", "C")
    assert fitted.high / fitted.low < loose.high / loose.low


def test_a_core_loss_of_a_data_sheet_does_not_claim_a_fit_to_a_curve():
    stated = replace(find_motor("17HS4401"), evidence={"core_loss_resistance": "S"})
    low, high, evidence = estimate_tolerances(stated)["core_loss_damping"]
    assert (low, high) == pytest.approx((0.65 * stated.core_loss_damping, 1.25 * stated.core_loss_damping))
    assert evidence.startswith("I: 0.65 to 1.25 times the data sheet's")
    assert (
        describe_core_loss(stated) == "The core loss of the 17HS4401, 0.00036 N m s/rad, is stated by its data sheet."
    )


@pytest.mark.parametrize(("factor", "end"), [(1.2, "low"), pytest.param(0.8, "high", marks=pytest.mark.slow)])
def test_the_ends_of_a_fitted_loss_are_fits_with_the_inductances_at_their_ends(factor, end):
    m = replace(find_motor(CURVE.motor), effective_inductance=factor * 3.0e-3)
    fit = fit_curve(m, CURVE, [200, 400, 600, 800, 1000, 1200])
    expected = getattr(estimate_tolerances(find_motor(CURVE.motor))["core_loss_damping"], end)
    assert fit.motor.core_loss_damping == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(
    ("evidence", "message"),
    [
        (None, r"17HS4401: evidence=None: give a mapping, as \{'resistance': 'S: \+-10 %'\}\."),
        ("S", "evidence='S': give a mapping"),
        ({"resistence": "S"}, "Did you mean 'resistance'"),
        (
            {"resistance": "X: +-10 %"},
            r"evidence of resistance, 'X: \+-10 %': begin with C \(fitted .*\), S \(data sheet\), I",
        ),
        ({"resistance": "+-10 %"}, "begin with C"),
        ({"resistance": 3}, "evidence of resistance, 3: begin with C"),
    ],
)
def test_evidence_without_a_known_value_or_letter_is_refused(evidence, message):
    with pytest.raises(ArgumentError, match=message):
        replace(find_motor("17HS4401"), evidence=evidence)


def test_the_tolerance_of_an_effective_inductance_replaces_the_default():
    evidence = {"inductance": "S: +-20 %", "effective_inductance": "C: +-4 %"}
    fitted = replace(find_motor("17HS4401"), effective_inductance=4.0e-3, evidence=evidence)
    assert estimate_tolerances(fitted)["inductance"] == (pytest.approx(3.84e-3), pytest.approx(4.16e-3), "C: +-4 %")


@pytest.mark.parametrize("sign", ["+-", "+- ", "±", "± "])
def test_a_tolerance_is_read_with_either_sign(sign):
    assert (
        read_tolerance(replace(find_motor("17HS4401"), evidence={"inductance": f"S: {sign}5 %"}), "inductance") == 0.05
    )


def test_a_share_of_a_range_counts_by_its_logarithm():
    loss = estimate_tolerances(find_motor("17HS4401"))["core_loss_damping"]
    assert loss.interpolate(0) == pytest.approx(loss.low)
    assert loss.interpolate(1) == pytest.approx(loss.high)
    assert loss.interpolate(0.5) == pytest.approx(math.sqrt(loss.low * loss.high))


def test_functions_of_a_motor_take_the_name_of_a_preset():
    name, m = "17HS4401", find_motor("17HS4401")
    assert estimate_core_loss(name) == estimate_core_loss(m)
    assert estimate_tolerances(name) == estimate_tolerances(m)
    assert vary_motor(name, inductance=3e-3) == vary_motor(m, inductance=3e-3)
    assert describe_core_loss(name) == describe_core_loss(m)
    assert fit_curve(CURVE.motor, CURVE, [500], ["core_loss_resistance"]).motor.name == CURVE.motor
    for form in (compute_closed_form_torque, compute_torque_bound):
        assert form(name, 24.0, 1.7, 300.0) == form(m, 24.0, 1.7, 300.0)


@pytest.mark.parametrize(
    "call",
    [
        estimate_core_loss,
        estimate_tolerances,
        vary_motor,
        describe_core_loss,
        lambda name: fit_curve(name, CURVE, [500, 900]),
    ],
)
@pytest.mark.parametrize("name", ["17HS4410", None, 3])
def test_what_is_no_motor_is_refused_with_the_known_ones(call, name):
    with pytest.raises(ArgumentError, match=f"unknown motor {name!r}.*Known: 17HS15-1504S, 17HS19-2004S1"):
        call(name)


def test_a_varied_motor_differs_in_the_values_named_alone():
    m = find_motor("17HS4401")
    varied = vary_motor(m, core_loss_damping=6.4e-4, inductance=3.3e-3)
    assert varied.core_loss_damping == pytest.approx(6.4e-4)
    assert (varied.phase_inductance, varied.inductance) == (3.3e-3, 2.8e-3)
    assert vary_motor(m) == m
    assert vary_motor(m, core_loss_damping=0).core_loss_resistance is None


@pytest.mark.parametrize("bad", [-1e-4, math.inf, math.nan, "1e-4", 1.0])
def test_a_loss_that_no_motor_has_is_refused_in_one_sentence(bad):
    with pytest.raises(ArgumentError) as error:
        vary_motor(find_motor("17HS4401"), core_loss_damping=bad)
    assert str(error.value) == (f"17HS4401: core_loss_damping={bad!r}: give a number from 0 up to 0.063662 N m s/rad.")
