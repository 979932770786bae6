"""Motors of the table, drives that fit them, and what is said to those that do not."""

import math
import pickle
import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from stage.cli import main
from stage.drives import stepper
from stage.drives.dc_motors import DC_MOTORS
from stage.drives.motors import EVIDENCE, MOTORS, Drive, Motor, find_motor
from stage.errors import ArgumentError

TABLE = {  # spec/drives.md, data sheet and curve of the 17HS19-2004S1: I, R, L, holding, detent, rotor J, Km; None: not given
    "17HS4401": (1.7, 1.5, 2.8e-3, 0.40, 0.022, 54e-7, 0.166),
    "17HS19-2004S1": (2.0, 1.6, 3.0e-3, 0.56, None, 82e-7, 0.198),
    "17HS15-1504S": (1.5, 2.3, 4.4e-3, 0.45, None, None, 0.212),
    "SS2422-5041": (1.0, 5.4, 2.9e-3, 0.186, None, 28e-7, 0.132),
}
FIELDS = "rated_current resistance inductance holding_torque detent_torque rotor_inertia".split()
PAGE = Path(__file__).resolve().parents[2] / "docs" / "drives.md"


@pytest.mark.parametrize("name", TABLE)
def test_a_motor_is_that_of_the_data_sheet_and_says_which_values_are_not(name):
    m = find_motor(name)
    *values, km = TABLE[name]
    for field, value in zip(FIELDS, values, strict=True):
        if value is None:
            assert m.evidence[field].startswith("I: ")
        else:
            assert getattr(m, field) == pytest.approx(value)
            assert m.evidence[field][0] == ("C" if (name, field) == ("17HS19-2004S1", "holding_torque") else "S")
    assert m.torque_constant == pytest.approx(km, abs=6e-4)
    assert m.rotor_teeth == 50


@pytest.mark.parametrize("m", [*MOTORS.values(), *DC_MOTORS.values()], ids=lambda m: m.name)
def test_every_number_of_every_motor_has_a_letter_of_evidence_and_an_inferred_one_a_reason(m):
    numbers = {f.name for f in fields(m) if isinstance(getattr(m, f.name), int | float)}
    assert set(m.evidence) == numbers
    for text in m.evidence.values():
        letter, _, reason = text.partition(": ")
        assert letter in EVIDENCE
        assert letter == "S" or reason


def test_the_page_has_the_values_and_letters_of_the_presets():
    scale = dict(zip([*FIELDS, "core_loss_resistance"], (1, 1, 1e3, 1, 1, 1e7, 1), strict=True))
    for name, m in MOTORS.items():
        cells = re.search(rf"^\| {name} \| (.*) \|$", PAGE.read_text(), re.M)[1].split(" | ")
        for cell, field in zip(cells, scale, strict=False):
            value, letter = cell.split()
            assert float(value) == pytest.approx(getattr(m, field) * scale[field])
            assert letter == m.evidence[field][0], (name, field)


def test_list_motors_shows_each_value_with_its_letter_and_reason(capsys):
    """stage list motors"""
    assert main(["list", "motors"]) == 0
    output = capsys.readouterr().out
    for row in ("resistance           1.6 ohm         S  +-10 %", "torque_constant      0.0525 N m/A    S"):
        assert f"\n  {row}\n" in output
    assert output.splitlines()[-1] == "evidence: C fitted to a published pull-out curve, S data sheet, I inferred"


def test_the_table_has_all_motors():
    assert set(MOTORS) == set(TABLE)


def test_a_drive_fills_every_parameter_of_its_record_and_leaves_its_state():
    rows = np.full(1, 7, stepper.DRIVE)
    drive = Drive("SS2422-5041", microsteps=8, bus_voltage=36, current=0.7, mode="sine", detent=0.001)
    drive.fill_record(rows[0])
    d, m = rows[0], drive.motor
    assert (d.resistance, d.inductance, d.teeth) == (m.resistance, m.inductance, 50)
    assert (d.torque_constant, d.voltage, d.current, d.detent) == (m.torque_constant, 36, 0.7, 0.001)
    assert (d.per_pulse, d.mode) == (math.pi / 16, stepper.SINE)
    assert (d.offset, d.current_a, d.current_b) == (7, 7, 7)
    assert drive.pulses_per_turn == 1600


def test_a_record_holds_only_8_byte_numbers_since_it_lives_in_userdata():
    assert {stepper.DRIVE[name].base for name in stepper.DRIVE.names} <= {np.dtype("i8"), np.dtype("f8")}


def test_drives_default_to_the_current_and_detent_of_the_motor():
    assert Drive().amplitude == 1.7
    assert Drive().detent_torque == 0.022
    assert Drive(detent=0.0).detent_torque == 0.0


def test_a_drive_holds_in_proportion_to_its_current():
    assert Drive().peak_torque == pytest.approx(0.40)
    assert Drive(current=0.85).peak_torque == pytest.approx(0.20)


def test_drives_are_values_compared_pickled_and_hashed():
    drive = Drive("17HS15-1504S", 32)
    assert pickle.loads(pickle.dumps(drive)) == drive
    assert len({drive, replace(drive), Drive()}) == 2


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: find_motor("17HS4410"), "Did you mean '17HS4401'"),
        (lambda: Drive("NEMA17"), "unknown motor 'NEMA17'.*Known: 17HS15-1504S, 17HS19-2004S1, 17HS4401, SS2422-5041"),
        (lambda: Drive({"resistance": 1.5}), "unknown motor .*resistance.*Known: 17HS15-1504S"),
        (lambda: Drive(microsteps=0), r"microsteps=0: .* 1 to 256"),
        (lambda: Drive(microsteps=257), "1 to 256"),
        (lambda: Drive(microsteps=2.5), "whole number"),
        (lambda: Drive(microsteps="16"), "microsteps='16'"),
        (lambda: Drive(microsteps=math.nan), "microsteps=nan"),
        (lambda: Drive(bus_voltage=-3), "bus_voltage=-3: give a number above 0, up to 400 V"),
        (lambda: Drive(bus_voltage=math.nan), "bus_voltage=nan"),
        (lambda: Drive(bus_voltage="24"), "bus_voltage='24'"),
        (lambda: Drive(current=99), "current of the 17HS4401=99: give a number above 0, up to 3.4 A"),
        (lambda: Drive(current=0), "above 0, up to 3.4 A"),
        (lambda: Drive(detent=-1), "detent of the 17HS4401=-1: give a number from 0 up to 0.4 N m"),
        (lambda: Drive(mode="chooper"), "Did you mean 'chopper'"),
        (lambda: replace(find_motor("17HS4401"), inductance=0), "17HS4401: inductance=0: give a number above 0"),
        (lambda: replace(find_motor("17HS4401"), detent_torque=1.0), "from 0 up to 0.4 N m"),
        (lambda: Motor("odd", 1, 1, 1e-3, 0.1, 0, 1e-6, steps_per_turn=198), "a tooth is 4 steps"),
    ],
)
def test_what_no_motor_or_drive_can_be_is_refused_with_what_is_allowed(make, message):
    with pytest.raises(ArgumentError, match=message):
        make()


def test_every_field_of_a_drive_is_checked():
    bad = {
        "motor": "x",
        "microsteps": 0,
        "bus_voltage": 0,
        "current": -1,
        "mode": "x",
        "detent": -1,
        "power_stage": "x",
    }
    assert set(bad) == {f.name for f in fields(Drive)} - {"drops_edges"}
    for name, value in bad.items():
        with pytest.raises(ArgumentError):
            Drive(**{name: value})


def test_every_field_of_a_motor_is_checked():
    good = replace(find_motor("17HS4401"), core_loss_resistance=None)
    maximum = {
        "rated_current": 100, "resistance": 1000, "inductance": 1, "holding_torque": 1000,
        "detent_torque": good.holding_torque, "rotor_inertia": 1, "steps_per_turn": 4000, "core_loss_resistance": 1e6,
        "effective_inductance": 1,
    }  # fmt: skip
    assert set(maximum) == {f.name for f in fields(good)} - {"name", "evidence"}
    for name, value in maximum.items():
        assert getattr(replace(good, **{name: value}), name) == value
        for bad in (-1, 0, math.nan, "1", True, value * 1.5):
            if not (name == "detent_torque" and bad == 0):
                with pytest.raises(ArgumentError, match=f"17HS4401: {name}="):
                    replace(good, **{name: bad})
