"""Power stages by name: what they allow a drive, how their current is set, and those that packages bring."""

import subprocess
import sys
from dataclasses import replace

import pytest
from support.packages import installed

from stage import Drive, Stage
from stage.drives.power_stages import A4988, POWER_STAGES, TB6600, PowerStage, find_power_stage
from stage.errors import ArgumentError, LoadError
from stage.testing import power_stage_conformance


@pytest.mark.parametrize("name", POWER_STAGES)
def test_every_power_stage_keeps_its_promises(name):
    power_stage_conformance(name)


@pytest.mark.parametrize(
    ("name", "vref", "resistor", "amplitude"),
    [
        ("a4988", 0.8, 0.1, 1.0),  # I = VREF / (8 RS)
        ("a4988", 0.544, None, 1.0),
        ("drv8825", 0.65, None, 1.3),  # I = VREF / (5 RISENSE)
        ("drv8825", 3.3, None, 2.5),  # no more than it can give
        ("tb6600", 0.99, 0.11, 3.0),  # I = VREF / (3 RNF)
    ],
)
def test_the_current_limit_follows_the_formula_of_the_data_sheet(name, vref, resistor, amplitude):
    assert find_power_stage(name).compute_current_limit(vref, resistor) == pytest.approx(amplitude)


def test_the_mode_pins_select_the_microsteps_of_the_data_sheets_table():
    assert A4988.find_microsteps("hhh") == 16
    assert find_power_stage("DRV8825").find_microsteps("LLH") == 16
    with pytest.raises(ArgumentError, match=r"'LLH' on MS1 MS2 MS3 selects nothing. Known: LLL 1/1"):
        A4988.find_microsteps("LLH")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"microsteps": 32}, "microsteps=32: Allegro A4988 has 1, 2, 4, 8, 16"),
        ({"bus_voltage": 36.0}, "bus_voltage=36: Allegro A4988 works from 8 to 35 V"),
        ({"current": 2.1}, "current=2.1: Allegro A4988 gives up to 2 A"),
    ],
)
def test_a_drive_refuses_what_its_power_stage_cannot_do(values, message):
    with pytest.raises(ArgumentError, match=message):
        Drive(power_stage="a4988", **values)


def test_the_default_current_is_the_rated_one_up_to_the_limit_of_the_power_stage():
    weak = replace(A4988, name="weak", max_current=1.2)
    assert Drive(power_stage=weak).amplitude == 1.2
    assert Drive(power_stage="a4988").amplitude == 1.7
    assert Drive().amplitude == 1.7


def test_a_stage_takes_a_power_stage_in_place_of_a_drive():
    stage = Stage("xy", chips="stepdir", drives={"x": "tb6600", "y": A4988}, visuals=False)
    assert [axis.drive.power_stage for axis in stage.axes.values()] == [TB6600, A4988]
    with pytest.raises(ArgumentError, match="Did you mean 'a4988'"):
        Stage("xy", chips="stepdir", drives="a498")
    with pytest.raises(ArgumentError, match=r"A4988 is a power stage, no chip: chips='stepdir', drives='a4988'"):
        Stage("xy", chips="a4988")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"name": "A4988"}, "lower-case"),
        ({"max_current": 0.0}, "no power stage"),
        ({"step_high": -1e-6}, "step_high"),
        ({"dir_hold": float("nan")}, "dir_hold"),
        ({"microsteps": {16: "HH"}}, "MS1, MS2, MS3"),
        ({"enable_level": "on"}, "'low' or 'high'"),
        ({"chip": "acme"}, "package.module:Class"),
        ({"microsteps": {}}, "at least one number of microsteps"),
    ],
)
def test_values_that_no_power_stage_has_are_refused(values, message):
    with pytest.raises(ArgumentError, match=message):
        replace(A4988, **values)


def install(monkeypatch, tmp_path, code, *packages):
    """Install packages that bring a power stage acme100 each."""
    for package in packages or ("acme_power",):
        (tmp_path / f"{package}.py").write_text(code)
        installed(monkeypatch, tmp_path, package, group="pulsestage.power_stages", acme100=f"{package}:ACME100")


GOOD = """
from dataclasses import replace
from stage.drives.power_stages import A4988
ACME100 = replace(A4988, name="acme100", title="ACME 100")
"""


def test_commands_accept_a_power_stage_of_an_installed_package(monkeypatch, tmp_path):
    install(monkeypatch, tmp_path, GOOD)
    command = [sys.executable, "-m", "stage", "move", "x", "100", "--chips", "stepdir", "--drive", "acme100"]
    done = subprocess.run(command, env={"PYTHONPATH": str(tmp_path)}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "done" in done.stdout


@pytest.mark.parametrize(
    ("code", "packages", "error", "message"),
    [
        ("1 / 0", ("broken",), LoadError, "acme100 of package broken 1.0 .* cannot be loaded: ZeroDivisionError"),
        ("ACME100 = 5", ("number",), ArgumentError, "has to be a stage.drives.power_stages.PowerStage"),
        (
            GOOD,
            ("one", "other"),
            ArgumentError,
            "package one 1.0 .* and package other 1.0 .* bring a power stage of this name",
        ),
    ],
)
def test_a_package_that_brings_a_bad_power_stage_is_named(tmp_path, monkeypatch, code, packages, error, message):
    install(monkeypatch, tmp_path, code, *packages)
    with pytest.raises(error, match=message):
        find_power_stage("acme100")
    assert find_power_stage("a4988") is A4988


def test_a_package_that_brings_a_power_stage_of_a_known_name_is_named(tmp_path):
    (tmp_path / "shadow.py").write_text(GOOD)
    info = tmp_path / "shadow-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: shadow\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[pulsestage.power_stages]\na4988 = shadow:ACME100\n")
    command = [sys.executable, "-m", "stage", "move", "x", "100", "--chips", "stepdir", "--drive", "a4988"]
    done = subprocess.run(command, env={"PYTHONPATH": str(tmp_path)}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (
        "PulseStage: a4988 is one of PulseStage's own power stages, and stays it, though package shadow 1.0"
        in done.stderr
    )


WITH_REGISTERS = """
from dataclasses import replace
from stage.chips import STEPDIR
from stage.drives.power_stages import A4988
class AcmeAxis(STEPDIR):
    pass
ACME100 = replace(
    A4988, name="acme100", title="ACME 100", chip="acme_registers:AcmeAxis", microsteps={16: "HHH", 256: ""}
)
"""


def test_a_power_stage_with_registers_brings_the_chip_of_its_axes(tmp_path, monkeypatch):
    install(monkeypatch, tmp_path, WITH_REGISTERS, "acme_registers")
    monkeypatch.syspath_prepend(tmp_path)
    stage = Stage("xy", chips="stepdir", drives={"x": "acme100", "y": "a4988"}, visuals=False)
    assert [type(axis.chip).__name__ for axis in stage.axes.values()] == ["AcmeAxis", "STEPDIR"]
    assert Stage("xy", drives="acme100", visuals=False).axes["x"].chip.__class__.__name__ == "PCL240K"
    power_stage = find_power_stage("acme100")
    power_stage_conformance(power_stage)
    assert Drive(power_stage=power_stage, microsteps=256).power_stage.find_microsteps("HHH") == 16
    with pytest.raises(ArgumentError, match=r"Known: HHH 1/16\.$"):
        power_stage.find_microsteps("LLL")


@pytest.mark.parametrize(
    ("chip", "error", "message"),
    [
        ("no_such_module:Axis", LoadError, "chip no_such_module:Axis cannot be loaded: ModuleNotFoundError"),
        ("stage.chips:PCL240K", ArgumentError, "has to be a subclass of STEPDIR"),
    ],
)
def test_a_chip_of_a_power_stage_that_does_not_fit_is_named(chip, error, message):
    with pytest.raises(error, match=message):
        Stage("xy", chips="stepdir", drives=replace(A4988, name="acme", chip=chip), visuals=False)


def test_a_resistance_inside_the_power_stage_lowers_the_current():
    inside = replace(A4988, internal_resistance=0.032)
    assert inside.compute_current_limit(0.8) == pytest.approx(1.0)


def test_the_conformance_suite_finds_a_time_that_nobody_demands():
    class Forgetful(PowerStage):
        @property
        def times(self):
            return (*super().times[:-1], 0.0)

    demanding = {name: getattr(A4988, name) for name in A4988.__dataclass_fields__} | {
        "name": "forgetful",
        "enable_setup": 1e-4,
    }
    with pytest.raises(AssertionError, match="enable_setup"):
        power_stage_conformance(Forgetful(**demanding))
