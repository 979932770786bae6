"""What keeps a panel from beginning is said in one line."""

import os
import signal
import socket
import sys
import threading
import urllib.request

import pytest

from stage import Stage
from stage.cli import main
from stage.errors import ArgumentError


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


@pytest.mark.parametrize(
    ("command", "option"),
    [("panel", "--port"), ("serve", "--panel-port"), ("serve", "--listen"), ("run", "--panel-port"), ("mcp", "--port")],
)
@pytest.mark.parametrize("port", ["99999", "65536", "-5"])
def test_a_port_that_is_none(capsys, command, option, port):
    with pytest.raises(SystemExit) as ended:
        main([command, option, port])
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{option}: {port}: a TCP port is 0 (one that is free) to 65535" in line


def test_an_address_that_is_none_of_this_machine(refused):
    pytest.importorskip("nicegui")
    assert "--host takes an address of this machine" in refused("--host", "192.0.2.77", "--port", "0")


def test_a_panel_from_python_refuses_a_port_that_is_none():
    pytest.importorskip("nicegui")
    with pytest.raises(ArgumentError, match="port=65536: a TCP port is 0"):
        Stage("xy", visuals=False).panel(65536, browser=False)


@pytest.mark.parametrize("host", ["0.0.0.0", "127.0.0.1"])
def test_the_link_of_a_panel_opens_its_page(host):
    pytest.importorskip("nicegui")
    with Stage("xy", visuals=False).panel(host=host, browser=False) as panel:
        assert urllib.request.urlopen(panel.address, timeout=10).status == 200


def test_where_there_is_no_browser_the_link_is_printed_and_says_so_in_one_line(capsys, monkeypatch):
    pytest.importorskip("nicegui")
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def none(address):
        threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM)).start()
        return False

    monkeypatch.setattr("stage.panel.server.webbrowser.open", none)
    try:
        assert main(["panel", "xy", "--port", "0"]) == 0
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    link, _, says = capsys.readouterr().out.splitlines()
    assert link.startswith("http://127.0.0.1:")
    assert says == "there is no browser here: open the link in one"
