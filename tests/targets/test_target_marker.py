"""pytest's fixture `host` runs programs of other processors, too."""

from pathlib import Path

import pytest

from stage.targets import supported_processors

pytest_plugins = ["pytester"]
DATA = Path(__file__).parent / "data"
GCODE = Path(__file__).parents[2] / "scripts" / "firmware" / "gcode" / "gcode.elf"
TESTS = """
import pytest

PINS = "data=A,address=C:0-3,cs=B0,wr=G0,rd=G1"
pytestmark = pytest.mark.stage("xy", chips="PCL240K", record=False)

@pytest.mark.firmware("faults.avr.elf", mcu="atmega2560", map=PINS)
def test_it_runs(host, board):
    assert host.run().code == 0
    assert board.cycles == 1

@pytest.mark.firmware("faults.avr.elf", mcu="atmega2561x", map=PINS)
def test_it_is_unknown(host):
    pass

@pytest.mark.firmware("faults.avr.elf", mcu="atmega2560", map=PINS, patience=5.0, mcu_clock=8e6)
def test_after_a_failure_others_run(host):
    assert host.run().code == 0

@pytest.mark.stage("xyz", chips="stepdir")
@pytest.mark.firmware("gcode.elf", mcu="atmega328p", pins="grbl")
def test_it_enables_motors_by_a_pin(host, stage):
    assert host.run_for(0.01) is None
    assert all(axis.chip.pins.enable for axis in stage.axes.values())
    assert "PulseStage G-code 1" in str(host.log)
"""


@pytest.mark.skipif(
    not supported_processors.has_simavr(), reason=f"there is no {supported_processors.SIMAVR_REQUIREMENT}"
)
def test_the_marker_names_the_processor_and_its_pins(pytester):
    for file in (DATA / "faults.avr.elf", GCODE):
        (pytester.path / file.name).write_bytes(file.read_bytes())
    pytester.makepyfile(TESTS)
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider", "-p", "no:xdist", "-o", "addopts=")
    result.assert_outcomes(passed=3, errors=1)
    result.stdout.fnmatch_lines(["*mcu 'atmega2561x' is not known. Is it atmega2560[?]*"])


def test_without_the_emulator_it_is_skipped(pytester, monkeypatch):
    supported_processors.load_simavr.cache_clear()
    monkeypatch.setattr(supported_processors, "_SIMAVR_FILES", ())
    monkeypatch.setattr("ctypes.util.find_library", lambda name: None)
    (pytester.path / "faults.avr.elf").write_bytes(b"")
    pytester.makepyfile(TESTS)
    result = pytester.runpytest_inprocess(
        "-p", "no:cacheprovider", "-p", "no:xdist", "-o", "addopts=", "-rs", "-k", "runs"
    )
    supported_processors.load_simavr.cache_clear()
    result.assert_outcomes(skipped=1, deselected=3)
    result.stdout.fnmatch_lines(["*there is no simavr (Debian: apt install libsimavr2)*"])
