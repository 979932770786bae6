"""pytest's fixture `host` has the serial line of the firmware: host.serial."""

from pathlib import Path

import pytest

from stage.targets import supported_processors

pytest_plugins = ["pytester"]
DATA = Path(__file__).parents[1] / "targets" / "data"
TESTS = """
import pytest

pytestmark = [
    pytest.mark.stage("xy", chips="PCL240K", record=False),
    pytest.mark.firmware("serial.avr.elf", mcu="atmega2560", map="data=A,address=C:0-3,cs=B0,wr=G0,rd=G1"),
]

def test_it_greets_and_answers(host):
    host.serial.read_until("ready\\r\\n")
    host.serial.write("G0 X1\\n")
    assert host.serial.read_until("\\n") == "G0 X1\\n"

def test_it_is_silent(host):
    host.serial.read_until("Grbl 1.1h", timeout=0.02)
"""


@pytest.mark.skipif(
    not supported_processors.has_simavr(), reason=f"there is no {supported_processors.SIMAVR_REQUIREMENT}"
)
def test_a_test_writes_and_reads_by_the_serial_line(pytester):
    (pytester.path / "serial.avr.elf").write_bytes((DATA / "serial.avr.elf").read_bytes())
    pytester.makepyfile(TESTS)
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider", "-p", "no:xdist", "-o", "addopts=")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["*has not sent 'Grbl 1.1h' over its serial line within 0.02 s*"])
