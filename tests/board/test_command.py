"""`stage run`, as a stranger would type it."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path

import pytest
from support.compiled_firmware import firmware
from support.extras import needs_rerun

from stage.board import get_include_folder
from stage.cli import main

MOVE = r"""
static void put(uint32_t port, int r, uint32_t value)
{
    ps_out8(port, (uint8_t)(0x80 | r));
    for (int byte = 3; byte; byte--)
        ps_out8(port + (uint32_t)byte, (uint8_t)(value >> 8 * (byte - 1)));
}
PULSESTAGE_MAIN
{
    ps_out8(PORT, 0x08);
    put(PORT, 0, 800), put(PORT, 1, 100), put(PORT, 7, 300);
    ps_out8(PORT, 0x44), ps_out8(PORT, 0x10);
    while (ps_in8(PORT) & 0x40)
        ;
    ps_log("arrived");
    return RESULT;
}
"""


def built(result: int = 0, port: str = "0x300") -> str:
    return str(firmware(MOVE, f"-DRESULT={result}", f"-DPORT={port}"))


@needs_rerun
def test_a_run_prints_log_and_axes_and_writes_its_files(tmp_path, capsys):
    files = [str(tmp_path / name) for name in ("run.rrd", "run.vcd", "run.txt")]
    outputs = ["--record", files[0], "--vcd", files[1], "--trace", files[2]]
    assert main(["run", built(), "--chips", "pcl240mk", *outputs]) == 0
    message = capsys.readouterr().out
    for part in ("arrived", "returned 0", "bus cycles", *files):
        assert part in message
    assert "mistakes" not in message
    assert re.search(r"^x +2\.(49|50)\d\d +2\.5000 +0$", message, re.M)
    trace = (tmp_path / "run.txt").read_text()
    assert "x: start, constant FL" in trace
    assert "times until" in trace
    assert main(["run", built(), *outputs]) == 2, "files that exist are not written over"
    assert "--force" in capsys.readouterr().err or "exists" in capsys.readouterr().err


def test_a_trace_of_the_name_minus_is_printed_and_other_files_of_that_name_are_refused(tmp_path, capsys, monkeypatch):
    # stage run driver.so --trace -
    monkeypatch.chdir(tmp_path)
    assert main(["run", built(), "--model", "xy", "--timeout", "0.001", "--trace", "-"]) == 1
    message = capsys.readouterr().out
    assert message.rstrip().splitlines()[-1].startswith("      0.000")
    assert "x: start, constant FL" in message
    for option in ("--record", "--vcd", "--picture"):
        assert main(["run", built(), "--model", "xy", option, "-"]) == 2
        assert f"{option} -: the command prints its text to standard output" in capsys.readouterr().err
    assert main(["home", "x", "--plot", "-"]) == 2
    assert "--plot -: the command prints" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@needs_rerun
@pytest.mark.parametrize(
    "isolated", [["--in-process"], [], ["--isolated"]], ids=["thread", "process", "as it was typed before"]
)
def test_the_exit_code_is_0_only_for_firmware_that_returns_0_in_time(isolated, capsys, tmp_path):
    assert main(["run", built(5), *isolated]) == 1
    assert main(["run", built(), "--timeout", "0.01", "--record", str(tmp_path / "late.rrd"), *isolated]) == 1
    assert "has not returned after 0.01 s" in capsys.readouterr().err
    assert (tmp_path / "late.rrd").stat().st_size > 1000, "a run that fails is the one to look at"
    assert main(["run", str(tmp_path / "nothing.so"), *isolated]) == 2
    assert "stage include" in capsys.readouterr().err


def test_cycles_that_reach_no_chip_are_reported(capsys):
    assert main(["run", built(port="0x300"), "--base", "0x340", "--timeout", "0.01"]) == 1
    assert "reached no chip" in capsys.readouterr().out
    assert main(["run", built(port="0x340"), "--base", "0x340", "--place", "x=-20"]) == 0
    assert "-17.5" in capsys.readouterr().out
    assert main(["run", built(), "--place", "x"]) == 2
    assert main(["run", built(), "--place", "q=3"]) == 2
    assert "unknown axis 'q'" in capsys.readouterr().err
    assert main(["run", built(), "--layout", "nova"]) == 2


def test_sources_are_built_first(tmp_path, capsys):
    built()
    (tmp_path / "a.c").write_text("#include <pulsestage.h>\nint other(void);\nPULSESTAGE_MAIN { return other(); }\n")
    (tmp_path / "b.c").write_text("int other(void) { return CODE; }\n")
    assert main(["run", str(tmp_path / "a.c"), str(tmp_path / "b.c"), "--cflags=-DCODE=0"]) == 0
    assert main(["run", str(tmp_path / "a.c"), built()]) == 2
    assert "sources only" in capsys.readouterr().err
    assert (
        main(["run", str(tmp_path / "a.c"), str(tmp_path / "b.c"), "--cflags=-DCODE=0", "--cflags=-DOTHER=1 -O0"]) == 0
    )
    assert main(["run", str(tmp_path / "a.c"), "--cflags=-D'"]) == 2
    assert "--cflags" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["run", built(), "--base", "3OO"])
    assert "0x300" in capsys.readouterr().err


def test_diagnostics_of_a_chip_name_all_its_axes(capsys):
    assert (
        main(["run", str(firmware("PULSESTAGE_MAIN { ps_out16(0x300, 0x7F01); return 0; }")), "--chips", "mcx304"]) == 0
    )
    assert "chip of xyz: " in capsys.readouterr().out


def test_a_servo_chip_runs_too(capsys):
    body = "PULSESTAGE_MAIN { ps_out8(0x300, 5); ps_out8(0x301, 0); return ps_in8(0x301) == 0xFF; }"
    assert main(["run", str(firmware(body)), "--chips", "hctl1100", "--model", "xyz_servo"]) in (0, 1)
    assert "returned" in capsys.readouterr().out


def test_include_prints_the_folder_of_the_header(capsys):
    assert main(["include"]) == 0
    assert capsys.readouterr().out.strip() == str(get_include_folder())


def test_firmware_that_never_returns_is_run_for_so_long(capsys):
    library = str(firmware("PULSESTAGE_MAIN { for (;;) ps_delay_us(1000); }"))
    assert main(["run", library, "--model", "xy", "--for", "0.01"]) == 0
    assert re.search(r"ran for 0\.01 s, and 0 bus cycles", capsys.readouterr().out)
    assert main(["run", built(5), "--for", "5"]) == 1, "one that returns has its own result"
    with pytest.raises(SystemExit):
        main(["run", library, "--for", "-1"])
    assert "argument --for: -1 must be greater than 0" in capsys.readouterr().err


def test_a_run_stopped_by_sigterm_before_its_first_bus_cycle_shows_no_empty_table(monkeypatch, capsys):
    source = """#include <signal.h>
    #include <stdlib.h>
    PULSESTAGE_MAIN { ps_delay_us(10); kill(atoi(getenv("TOLD")), SIGTERM); for (;;) ps_delay_us(1000); }"""
    monkeypatch.setenv("TOLD", str(os.getpid()))
    assert main(["run", str(firmware(source)), "--model", "xy"]) == 1
    error = capsys.readouterr().err
    assert "after 0 bus cycles. It has made no bus cycle." in error
    assert "seconds  port" not in error


@needs_rerun
@pytest.mark.parametrize("isolated", [["--in-process"], []], ids=["thread", "process"])
def test_a_run_stopped_by_sigterm_reports_its_state_and_writes_its_files(isolated, tmp_path, monkeypatch, capsys):
    # timeout 60 stage run driver.c --record run.rrd; exit code 143 without a word, and no run.rrd
    source = """#include <signal.h>
    #include <stdlib.h>
    PULSESTAGE_MAIN { ps_in8(0x300); kill(atoi(getenv("TOLD")), SIGTERM); for (;;) ps_in8(0x304); }"""
    monkeypatch.setenv("TOLD", str(os.getpid()))
    files = [str(tmp_path / name) for name in ("run.rrd", "run.txt")]
    assert main(["run", str(firmware(source)), "--record", files[0], "--trace", files[1], *isolated]) == 1
    message = capsys.readouterr()
    assert re.search(r"ended from outside by SIGTERM\. What is known of it ends at \d+\.", message.err)
    assert not isolated or "300h R" in message.err
    assert all(Path(file).stat().st_size > 30 for file in files)
    assert re.search(r"^x +0\.0000", message.out, re.M)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
