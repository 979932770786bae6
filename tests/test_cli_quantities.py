"""Numbers on the command line: their units, and what is told of slips."""

import argparse
import re

import pytest
from support.mirrored import mirrored

from stage.chips import PCL240K
from stage.cli import build_parser, main, package_commands
from stage.cli.options import FREQUENCY, INTEGER_FREQUENCY, MASS, RATE, TIME, VOLTAGE
from stage.units import explain_number_error, identify_unit


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        (RATE, "1000pps", 1000), (RATE, "1.5kpps", 1500), (RATE, "1e3", 1000), (TIME, " -5", -5), (TIME, "100ms", 0.1),
        (TIME, "1us", 1e-6), (TIME, "2 s", 2), (TIME, "0.5", 0.5), (TIME, "2min", 120), (VOLTAGE, "24V", 24), (MASS, "2kg", 2),
        (MASS, "500g", 0.5), (FREQUENCY, "16MHz", 16e6), (INTEGER_FREQUENCY, "4.9152MHz", 4_915_200),
        (INTEGER_FREQUENCY, "0x10", 16),
    ],
)  # fmt: skip
def test_a_quantity_is_parsed_with_and_without_its_unit(kind, text, value):
    """stage move x 100 --fh1 1000pps --accel 100ms --bus-voltage 24V"""
    assert kind(text) == pytest.approx(value)


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        (
            RATE,
            "2kg",
            "'2kg' is not a pulse rate. kg is a unit of mass. Give a number, alone or with a unit: pps, kpps.",
        ),
        (
            TIME,
            "24V",
            "'24V' is not a time. V is a unit of voltage. Give a number, alone or with a unit: ns, us, ms, s, min.",
        ),
        (
            MASS,
            "2,5kg",
            "'2,5kg' is not a mass. Use a decimal point: 2.5kg. Give a number, alone or with a unit: g, kg.",
        ),
        (VOLTAGE, "many", "'many' is not a voltage. Give a number, alone or with a unit: mV, V."),
        (INTEGER_FREQUENCY, "1.5", "'1.5' is not a whole number"),
        (INTEGER_FREQUENCY, "inf", "'inf' is not a whole number"),
        (INTEGER_FREQUENCY, "nan", "'nan' is not a whole number"),
    ],
)
def test_another_unit_is_named_for_what_it_is(kind, text, message):
    """stage move x 100 --fh1 2kg"""
    with pytest.raises(argparse.ArgumentTypeError, match=re.escape(message)):
        kind(text)


def test_every_option_that_is_a_quantity_takes_its_units(monkeypatch):
    monkeypatch.setattr(package_commands, "find_entry_points", lambda *group: {})  # the core has no say in packages
    commands = next(a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction)).choices
    unitless_options = {
        option
        for p in commands.values()
        for a in p._actions
        if a.type is float
        for option in a.option_strings
        if option[:2] == "--"
    }
    assert unitless_options == {"--pace", "--speed", "--s-curve"}, "what has no unit"
    line = "move x 100 --fl 500pps --fh1 2kpps --accel 50ms --decel 0.1s --bus-voltage 36V --bus-cycle 2us"
    args = build_parser().parse(line.split())
    assert (args.fl, args.fh1, args.accel, args.decel, args.bus_voltage) == (500, 2000, 0.05, 0.1, 36)
    assert args.bus_cycle == pytest.approx(2e-6)


def test_what_a_number_is_a_number_of():
    assert [identify_unit(t) for t in ("2kg", "10pps", "5ms", "3m", "1", "kg", "x")] == [
        ("kg", "mass"), ("pps", "pulse rate"), ("ms", "time"), ("m", "length"), None, None, None,
    ]  # fmt: skip
    assert [explain_number_error(text) for text in ("10,5mm", "1,5", "a,b", "1,2,3")] == [
        " Use a decimal point: 10.5mm.", " Use a decimal point: 1.5.", "", "",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("move x 10 mm", "stage move: unknown argument 'mm'. Write a number and its unit without a space: 10mm."),
        ("move X 100", "stage: unknown axis 'X'. Did you mean 'x'\\? Known: x, y, z."),
        ("move x 10,5mm", "stage: '10,5mm': .* Use a decimal point: 10.5mm."),
        ("home x --from 10,5mm", "stage: --from 10,5mm: .* Use a decimal point: 10.5mm."),
        ("move x 100 --from -90cm", "stage: --from -90cm: axis x travels from -158 to 158 mm."),
        ("move x 100 --fl -5", "stage move: argument --fl: -5 must be greater than 0, and finite."),
        ("move x 100 --fh1 2kg", "stage move: argument --fh1: '2kg' is not a pulse rate. kg is a unit of mass."),
        ("list", "stage list: the following arguments are required: what. Known: chips, motors, power-stages, models."),
        ("completion", "stage completion: the following arguments are required: shell. Known: bash, zsh, fish."),
        ("registers", "stage registers: the following arguments are required: CHIP. Known: PCL240K, PCL240MK, "),
        (
            "demo --port 9000",
            "stage: --port 9000: --web serves the dashboard there. Give --web as well, or leave out --port.",
        ),
    ],
)
def test_a_typing_error_is_answered_with_the_likely_correction(typed, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    try:
        code = main(typed.split())
    except SystemExit as end:
        code = end.code
    out, err = capsys.readouterr()
    assert code == 2
    assert re.match(message, err), err
    assert not out


def test_a_distance_without_a_unit_may_have_been_millimetres(capsys):
    """stage tune --distance 40"""
    command = ["tune", "xy", "--distance", "40", "--by", "formula", "--moves", "4"]
    assert main(command) == 0
    assert "warning: --distance 40 is 40 pulses: did you mean 40mm?" in capsys.readouterr().err
    command[3] = "40mm"
    assert main(command) == 0
    assert "did you mean" not in capsys.readouterr().err


def test_a_move_beyond_the_end_limits_runs_with_a_warning(capsys):
    """stage move x 8000 --from 148"""
    assert main(["move", "x", "8000", "--from", "148"]) == 1
    out, err = capsys.readouterr()
    assert err == "stage: warning: axis x reaches from -150 to 150 mm, and this move goes to 173 mm.\n"
    assert "stopped by EL+" in out
    assert main(["move", "x", "800"]) == 0
    assert capsys.readouterr().err == ""


def test_the_travel_warning_respects_a_left_hand_screw(tmp_path, capsys):
    """stage move x 25mm --from 148, of an axis on which pulses towards plus go to minus"""
    options = ["--from", "148", "--model", mirrored(tmp_path)]
    assert main(["move", "x", "25mm", *options]) == 1
    assert "this move goes to 173 mm" in capsys.readouterr().err
    assert main(["move", "x", "8000", *options]) == 0
    assert capsys.readouterr().err == ""


def test_the_help_names_every_model_that_ships():
    from stage.sim import plant

    commands = next(a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction)).choices
    for name in ("move", "tune", "view", "panel"):
        assert ", ".join(plant.list_model_names()) in " ".join(commands[name].format_help().split()), name


def test_a_negative_residual_is_printed_with_its_sign():
    """R0 16777008, of a move without a distance towards minus"""
    from stage import firmware

    report = firmware.continuous_move(firmware.Bench(PCL240K()).axes["x"], 0.02, -1)
    assert report.residual > 1 << 23
    assert f"R0 {report.residual} (24-bit counter: {report.residual - (1 << 24)})" in str(report)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("x 10mm --speed 20deg/s", "stage: --fh1 20deg/s: axis x moves in mm. Give a speed such as 50mm/s."),
        (
            "x 10mm --speed 9m/s --chips mcx304",
            "drive speed 2.88e+06 pps (9 m/s): an MCX304 makes 20 to 160000 pps (6.25e-05 to 0.5 m/s) here.",
        ),
        ("x 1m --speed 9m/s --chips mcx304", "stage: drive speed 2.88e+06 pps"),
        ("x infmm", "stage: 'infmm' is not a finite number."),
        ("x nanmm", "stage: 'nanmm' is not a finite number."),
    ],
)  # fmt: skip
def test_an_error_has_the_unit_of_the_question_and_comes_before_other_output(options, message, capsys):
    assert main(["move", *options.split()]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert err.startswith("stage: ")
    assert "warning" not in err


@pytest.mark.parametrize("option", ["--speed 50mm/s", "--fh1 3000mm/min", "--speed 16kpps"])
def test_a_speed_of_the_carriage_is_that_many_pulses_per_second(option, capsys):
    assert main(["move", "x", "10mm", "--accel", "0.1", *option.split()]) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert "FH1 16000.0" in first
    assert "FL to FH1 in 100" in first, "--accel is the time to the speed that the move uses"


@pytest.mark.parametrize("chip", ["pcl240k", "pcl240ms", "mcx514", "mcx304", "hctl1100", "stepdir"])
@pytest.mark.parametrize("command", ["move x 10mm", "home x", "sync x=1mm y=1mm"])
def test_every_limit_of_a_speed_is_named_in_the_unit_of_the_question(command, chip, capsys):
    """stage home x --speed 90000mm/s --chips stepdir"""
    assert main([*command.split(), "--speed", "90000mm/s", "--chips", chip]) == 2
    error = capsys.readouterr().err
    rates = re.findall(r"(?:pps|counts/s|steps per second)(?! \([^)]*mm/s\))", error)
    assert "mm/s)" in error
    assert not rates, error
