"""What keeps a panel from beginning is said in one line."""

import socket
import sys

import pytest

from stage.cli import main


@pytest.fixture
def refused(capsys):
    """What the command says, where it refuses."""

    def run(*arguments):
        assert main(["panel", "xy", "--no-browser", *arguments]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        return line

    return run


def test_a_port_that_is_taken(refused):
    pytest.importorskip("nicegui")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        line = refused("--port", port)
    assert port in line
    assert "Choose another port" in line


def test_a_library_that_is_not_there(refused, monkeypatch):
    monkeypatch.setitem(sys.modules, "nicegui", None)
    assert "pip install 'pulsestage[panel]'" in refused("--port", "0")


def test_a_file_that_is_none(refused, tmp_path):
    file = tmp_path / "panel.zip"
    file.write_text("nothing")
    assert "no file of a panel" in refused("--open", str(file))


def test_a_speed_that_is_none(refused):
    assert "simulated seconds a second" in refused("--speed", "0")
