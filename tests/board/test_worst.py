"""docs/firmware_trust.md: the worst that firmware can do ends as its table says, and what runs after it is not affected."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from stage.board import build, crash_report
from stage.cli import main

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "firmware_trust.md"
SOURCE = ROOT / "scripts" / "firmware" / "worst.cpp"
ROWS = {
    name: (int(code), message)
    for name, code, message in re.findall(r"^\| `(\w+)` \|.*\| ([01]) \| (.*) \|$", PAGE.read_text(), re.M)
}
LONG = {"log"}  # a million lines
EVERY_DAY = {"exit", "pointer", "leave", "fork", "child", "close", "write", "cut", "stop", "kill"}

pytestmark = [
    pytest.mark.skipif(not crash_report.IS_SUPPORTED, reason="elsewhere a crash says its signal only"),
    pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler"),
]


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return build(SOURCE, tmp_path_factory.mktemp("worst") / "worst.so", ["-Wall", "-Wextra", "-Werror", "-pthread"])


def test_the_table_has_what_the_source_does():
    assert set(re.findall(r'is\("(\w+)"\)', SOURCE.read_text())) == set(ROWS)
    assert len(ROWS) >= 20


@pytest.mark.parametrize("what", [pytest.param(w, marks=() if w in EVERY_DAY else pytest.mark.slow) for w in ROWS])
def test_stage_run_says_what_the_table_says(what, library, monkeypatch, capfd):
    # WORST=... stage run worst.so
    code, message = ROWS[what]
    monkeypatch.setenv("WORST", what)
    began = time.monotonic()
    assert main(["run", str(library), "--model", "xy", "--patience", "0.3", "--timeout", "0.05"]) == code
    output = capfd.readouterr()
    assert message in (output.err if code else output.out)
    if code:
        assert len(re.findall("^stage: ", output.err, re.M)) == 1
        assert re.search(r"at 0\.\d{6} s|\(now 0\.\d{6} s\)", output.err)
    assert what in LONG or time.monotonic() - began < 20


def test_a_log_without_end_is_an_error_in_process(library, monkeypatch, capfd):
    monkeypatch.setenv("WORST", "log")
    monkeypatch.setattr("stage.board.board.MAX_LOG_LINES", 1000)
    assert main(["run", str(library), "--model", "xy", "--in-process"]) == 1
    output = capfd.readouterr()
    assert "1,000 lines were noted by ps_log" in output.err
    assert output.out.count("a line of a flood") == 1000


@pytest.mark.slow
def test_a_constructor_that_never_returns_is_killed(tmp_path, capfd):
    source = tmp_path / "hangs.c"
    source.write_text(
        "#include <pulsestage.h>\n"
        "__attribute__((constructor)) static void early(void) { for (volatile int k = 0;; k++) ; }\n"
        "PULSESTAGE_MAIN { return 0; }\n"
    )
    assert main(["run", str(source), "--model", "xy", "--patience", "0.5"]) == 2
    assert "has not got on for 2.5 s of real time, and was ended while it was loaded" in capfd.readouterr().err


SESSION = """
import os
import pytest

pytestmark = [pytest.mark.stage("xy"), pytest.mark.firmware({library!r}, patience=0.3)]

@pytest.mark.parametrize("what", {names!r})
def test_the_worst_firmware_ends_with_a_clear_error(what, host, monkeypatch):
    monkeypatch.setenv("WORST", what)
    host.close()
    assert host.run(timeout=0.05).code == 0

def test_a_run_after_the_worst_firmware_works(host, stage):
    assert host.run().code == 0
    assert stage.now == 1000
"""


@pytest.mark.slow
@pytest.mark.parametrize("workers", [[], ["-n", "2"]], ids=["alone", "xdist"])
def test_in_a_pytest_session_each_fails_with_its_message_and_the_later_tests_pass(workers, library, tmp_path):
    (tmp_path / "test_session.py").write_text(SESSION.format(library=str(library), names=list(ROWS)))
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-rA", "--tb=short", *(workers or ["-p", "no:xdist"]), "test_session.py"],
        cwd=tmp_path, capture_output=True, text=True, check=False, timeout=500,
    )  # fmt: skip
    assert done.returncode == 1
    for name, (code, message) in ROWS.items():
        outcome = "FAILED" if code else "PASSED"
        assert re.search(
            rf"^{outcome} \S*test_the_worst_firmware_ends_with_a_clear_error\[{name}\]", done.stdout, re.M
        ), (name, done.stdout[-3000:])
        assert not code or message in done.stdout
    assert re.search(r"^PASSED \S*test_a_run_after_the_worst_firmware_works", done.stdout, re.M)
