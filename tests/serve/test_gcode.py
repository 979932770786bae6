"""scripts/gcode_controller.py, as somebody types into its terminal."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "gcode_controller.py"

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals are of POSIX")


@pytest.fixture(scope="module")
def sender():
    """type(text) -> the replies, up to an `ok` or an `error:` for each line."""
    controller = subprocess.Popen(
        [sys.executable, str(SCRIPT), "--model", "xy"], stdout=subprocess.PIPE, text=True, stderr=subprocess.PIPE
    )
    name, _, message = controller.stdout.readline().partition(":")
    assert "G28" in message, controller.stderr.read()
    terminal = os.open(name, os.O_RDWR | os.O_NOCTTY)

    def type_(text):
        os.write(terminal, text.encode())
        answers, wanted, end = b"", text.count("\n"), time.monotonic() + 60
        while sum(line.startswith((b"ok", b"error:")) for line in answers.split(b"\r\n")[:-1]) < wanted:
            assert time.monotonic() < end, answers
            if select.select([terminal], [], [], 1.0)[0]:
                answers += os.read(terminal, 4096)
        return answers.decode().split("\r\n")[:-1]

    yield type_
    os.close(terminal)
    controller.terminate()
    controller.wait()


def test_it_homes_moves_and_says_where_it_is(sender):
    assert sender("G28\n") == ["ok"]
    assert sender("M114\n") == ["X:0.000 Y:0.000", "ok"]
    assert sender("G1 X20 Y7.5 F1800\n") == ["ok"]
    assert sender("G91\nG0 X-5\nM114\n") == ["ok", "ok", "X:15.000 Y:7.500", "ok"]
    assert sender("g90 ; absolute\n(a comment)\nN3 g0x10y10*12\nM114\n") == [
        "ok",
        "ok",
        "ok",
        "X:10.000 Y:10.000",
        "ok",
    ]
    assert sender("G92 X1 Y2\nG4 P100\nM114\n") == ["ok", "ok", "X:1.000 Y:2.000", "ok"]
    assert "x_org: open" in sender("M119\n")


def test_a_mistake_is_an_error_line_and_changes_nothing(sender):
    before = sender("M114\n")
    for wrong, message in (
        ("G5 X1", "G5 is not known here; there are G0 and G1"),
        ("hello", "'HELLO' is no command"),
        ("G1 X1 X2", "a letter comes twice"),
        ("G1 Q1", "Q is no axis here; there are X, Y"),
        ("G1 X", "X without a number"),
        ("G1 X1 F0", "more than 0 mm/min"),
        ("G4 S-1", "a dwell of -1 s"),
        ("G1 X" + "1" * 300, "up to 256"),
    ):
        (reply,) = sender(f"{wrong}\n")
        assert reply.startswith("error: ")
        assert message in reply
    assert sender("M114\n") == before


def test_a_move_into_the_limit_switch_says_so(sender):
    sender("G90\n")
    (reply,) = sender("G0 X1000\n")
    assert reply == "error: X was stopped by EL+, lost steps: 0"
