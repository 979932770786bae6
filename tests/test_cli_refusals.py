"""Wrong command lines end with code 2, and the error says what was given, what is allowed or what to do."""

import shlex

import pytest

from stage.cli import main

PCL240_ALONE = "only the PCL-240 family does"
REFUSALS = {
    "home q": ["unknown axis 'q'"],
    "move x 0": ["R0 counts 1 to 16777215"],
    "move x 100 --model xyzz": ["Did you mean"],
    "move x 100 --model nowhere.xml": ["no MJCF file"],
    "move x 100 --chips PCL241": ["Did you mean"],
    "move x 10kg": ["'10kg'", "pulses for axis x, such as 8000, or a distance in nm, um, mm, cm, m"],
    "move x 1.5": ["'1.5': give a whole number of pulses"],
    "home x --chips mcx304 --by stall": ["home by 'stall': an MCX304 cannot; it homes by switch or index"],
    "home x --chips pcl240k --by index": ["home by 'index': a PCL240K cannot; it homes by switch"],
    "home x --chips pcl240ms --by switch --ez 1": ["give one of the two"],
    "sync x=100 y=100 --chips x=mcx302,y=pcl240k": ["MCX302 and PCL240K draw no line together"],
    "move x 100 --chips mcx304 --fh1 1e6": ["MCX304 makes 20 to 160000 pps"],
    "move x 100 --motor 17HS4410": ["Did you mean '17HS4401'"],
    "sync x": ["AXIS=PULSES"],
    "sync x=abc": ["a whole number of pulses for axis x"],
    "registers pcl": ["Known: ", "PCL240K"],
    "move x 100 --record no/such/folder.rrd": ["no folder"],
    "pullout --plot a.foo": ["a figure is no 'foo'"],
    "fault start-skew --chips mcx302 --model xy": ["one command starts all axes", "one MCX302's"],
    "fault phase-open --chips hctl1100 --model xy": ["a DC motor, 14201S003, without phases"],
    "home y --from nan": ["--from nan: axis y travels from"],
    "home x --ez 2": ["PCL240K does not count EZ", "PCL240MK or PCL240MS"],
    "home x --ez 2 --chips mcx514": ["--ez 2", "MCX514", "index pulse 1 after"],
    "home x --ez 17 --chips pcl240mk": ["--ez 17", "1 to 16"],
    "home x --constant --chips mcx514": ["--constant", "an MCX514", PCL240_ALONE],
    "home x --fast-only --chips hctl1100": ["--fast-only", "an HCTL1100", PCL240_ALONE],
    "home x --from -99999": ["--from -99999", "-158 to 158 mm"],
    "home y --model gantry --ez 1": ["--ez", "y and w drive one load"],
    "home y --model gantry --by stall": ["--by", "y and w drive one load"],
    "home y --model gantry --constant": ["--constant", "y and w drive one load"],
    "move x 10deg": ["'10deg'", "nm, um, mm, cm, m"],
    "move x 100 --chips hctl1100 --s-curve": ["HCTL1100 has linear ramps only"],
    "move x 100 --chips mcx514 --s-curve 0.2": ["--s-curve 0.2", "an MCX514", "--s-curve alone"],
    "move x 100 --chips mcx514 --fh2 100": ["--fh2", PCL240_ALONE],
    "move x 100 --chips mcx304 --automatic": ["--automatic", PCL240_ALONE],
    "move x 100 --automatic": ["PCL240K", "PCL240MK or PCL240MS"],
    "move x 100 --chips pcl240ms --s-curve 0.7": ["0.7", "0.5"],
    "move x 100 --microsteps 0": ["microsteps=0", "1 to 256"],
    "move x 100 --bus-voltage -1": ["bus_voltage=-1.0", "400 V"],
    "move x 100 --bus-cycle -1": ["bus_cycle=-1.0", "0 to 1 s"],
    "move x 100 --fl 9000 --fh1 3000": ["fl=9000.0", "3000, 6000"],
    "move x 100 --fh1 1e9": ["fh1=1000000000.0", "4915200 Hz", "2457300 pps"],
    "dual-rate x 100 --chips mcx514": ["FH1 and FH2", "one drive speed"],
    "sync x=": ["'x='", "AXIS=PULSES"],
    "sync x=0 y=0": ["nothing moves"],
    "sync x=1000 y=500 x=2000": ["'x=2000'", "already has 1000 pulses"],
    "sync x=100 y=100 --automatic": ["PCL240K", "PCL240MK or PCL240MS"],
    "sync x=100 y=100 --chips hctl1100 --automatic": ["--automatic", PCL240_ALONE],
    "run x.so --layout nonsense": ["'nonsense'", "pcl240-card"],
    "run x.so --place x": ["--place 'x'", "AXIS=PLACE"],
    "run x.so --place x=1 --place x=2": ["--place 'x=2'", "already has a place"],
    "run x.so --cflags \"'\"": ["--cflags", "No closing quotation"],
    "run nowhere.so": ["nowhere.so", "stage include"],
    "fault stuck": ["'stuck'", "'stuck-open' or 'stuck-closed'"],
    "erratum --chips mcx514": ["--chips mcx514", "MCX302, MCX304, MCX312"],
    "move x 5 --wiring x.org": ["--wiring 'x.org'", "AXIS.SENSOR=LOGIC"],
    "move x 5 --wiring org=positive": ["--wiring 'org=positive'", "AXIS.SENSOR=LOGIC"],
    "move x 5 --syni y=": ["--syni 'y='", "FOLLOWER=LEADER"],
    "move x 5 --syni y=x,y=z": ["axis y already has x"],
    "move x 5 --multichip x,": ["--multichip 'x,'", "x,z"],
    "tune xy --payload 1 --distance 10mm --spare lots": ["--spare lots", "30%", "0.6"],
    "tune xy --payload 1 --distance 10mm --settle 0um 50ms": ["--settle", "greater than 0", "50um"],
    "tune xy --payload 1 --distance 10mm --overshoot 5kg": ["--overshoot", "5kg", "50um"],
}  # fmt: skip


@pytest.mark.parametrize("line", REFUSALS)
def test_a_wrong_command_line_ends_with_2_and_says_what_is_allowed(line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split(line)) == 2
    error = capsys.readouterr().err
    assert error.startswith("stage: ")
    for part in REFUSALS[line]:
        assert part in error
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("line", ["move", "move x", "nonsense", "run x.so --base abc", "move x 100 --nothing"])
def test_wrong_usage_ends_with_2_and_names_the_help(line, capsys):
    with pytest.raises(SystemExit) as end:
        main(line.split())
    assert end.value.code == 2
    assert "--help" in capsys.readouterr().err


def test_moving_one_axis_of_a_gantry_warns_with_the_command_for_both(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    main(["move", "y", "200", "--model", "gantry"])
    assert "which stays behind" in (error := capsys.readouterr().err)
    assert "stage sync y=200 w=200" in error


def test_home_of_axes_that_drive_one_load_reports_each(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["home", "y", "--model", "gantry", "--from", "-68"]) == 0
    out = capsys.readouterr().out
    assert "axes y and w drive one load" in out
    assert "on y" in out
    assert "on w" in out
