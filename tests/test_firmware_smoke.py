"""One test of each way to run a program on the board. `make test-firmware` has the others."""

import shutil
from pathlib import Path

import pytest
from support.target_boards import board_of

from stage import Stage
from stage.board import Board, NativeHost
from stage.targets import TargetHost, supported_processors

pytest_plugins = ["pytester"]
DATA = Path(__file__).parent / "targets" / "data"
needs_cc = pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler: cc is not on the PATH")
needs_simavr = pytest.mark.skipif(
    not supported_processors.has_simavr(), reason=f"there is no {supported_processors.SIMAVR_REQUIREMENT}"
)
needs_unicorn = pytest.mark.skipif(
    not supported_processors.has_unicorn(), reason=f"there is no {supported_processors.UNICORN_REQUIREMENT}"
)


@needs_cc
def test_a_program_in_c_with_registers_of_an_avr_makes_bus_cycles_and_steps(tmp_path):
    source = tmp_path / "main.c"
    source.write_text(
        """#include <avr/io.h>
#include <pulsestage.h>
int main(void)
{
    DDRD = 1 << 2 | 1 << 5;
    PORTD = 1 << 5;
    for (int k = 0; k < 20; k++) { PIND = 1 << 2; ps_delay_us(50); }
    ps_logf("status %02X", ps_in8(0x300));
    return PORTD;
}
"""
    )
    stage = Stage("xy", chips={"x": "stepdir", "y": "PCL240K"}, visuals=False)
    with NativeHost(source, Board(stage), platform="avr", pins="x.step=D2,x.dir=D5", patience=10) as host:
        assert host.run(timeout=1).code == 1 << 5
        assert [cycle.port for cycle in host.board.trace] == [0x300]
        assert abs(stage.axes["x"].chip.net()) == 10
        assert host.log[-1][1].startswith("status ")


@needs_simavr
def test_a_program_for_an_avr_runs_untouched():
    host = TargetHost(
        DATA / "faults.avr.elf", board_of(9), mcu="atmega2560", map="data=A,address=C:0-3,cs=B0,wr=G0,rd=G1"
    )
    assert host.run().code == -9
    assert [(cycle.port, cycle.value) for cycle in host.board.trace][-1] == (0x303, 9)


@needs_unicorn
@pytest.mark.parametrize(
    ("program", "mcu", "wiring"),
    [("faults.m3.elf", "cortex-m3", "0x40021000=0x300+0x40"), ("faults.com", "8086", "irq=5")],
)
def test_a_program_for_another_processor_runs_untouched(program, mcu, wiring):
    host = TargetHost(DATA / program, board_of(9), mcu=mcu, map=wiring)
    assert host.run().code == 9


@needs_cc
def test_a_test_session_builds_its_firmware_and_saves_what_failed(pytester):
    pytester.makefile(
        ".c", driver='#include <pulsestage.h>\nPULSESTAGE_MAIN { ps_out8(0x300, 8); ps_log("here"); return 3; }\n'
    )
    pytester.makepyfile(
        """
        import pytest
        pytestmark = [pytest.mark.model("xy"), pytest.mark.firmware("driver.c")]
        def test_passes(host): assert host.run(timeout=1).code == 3
        def test_fails(host): assert host.run(timeout=1).code == 0
        """
    )
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider", "-p", "no:xdist", "-o", "addopts=")
    result.assert_outcomes(passed=1, failed=1)
    assert (pytester.path / ".pulsestage").is_dir()
    result.stdout.fnmatch_lines(["*here*"])
