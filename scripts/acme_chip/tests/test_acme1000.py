"""The ACME1000: its data sheet's numbers, and what every chip promises."""

import pytest
from acme_chips import ACME1000

from stage import Stage, firmware
from stage.testing import chip_conformance

test_conformance = chip_conformance.tests(ACME1000, programs=2)


def test_a_move_takes_the_time_that_the_data_sheet_gives():
    chip = ACME1000()
    for name, value in {"START": 1000, "DRIVE": 3000, "SLOPE": 20, "COUNT": 900}.items():
        for cycle in chip.register_cycles(name, value):
            chip.write(*cycle)
    chip.write(0, chip.MAP.command("MOVE+").code)
    pulses = chip.trace(chip.clock_hz)
    assert len(pulses) == 900
    seconds = (pulses["clock"][-1] - pulses["clock"][0]) / chip.clock_hz
    assert seconds == pytest.approx(2 * 0.1 + (900 - 2 * 0.1 * 2000) / 3000, rel=0.02)  # section 4: two ramps of 0.1 s
    assert not chip.diagnostics


def test_the_driver_finds_home_on_a_stage():
    stage = Stage("xy", chips="acme1000", visuals=False)
    stage.place(x=-0.11)
    report = firmware.home(stage.axes["x"])
    assert report.stopped_by == "ORG"
    assert stage.axes["x"].position == pytest.approx(-0.12, abs=1e-4)


def test_a_start_without_a_speed_has_a_diagnostic():
    chip = ACME1000()
    chip.write(0, chip.MAP.command("MOVE+").code)
    assert [d.message for d in chip.diagnostics] == ["no pulse will come: START is 0"]
