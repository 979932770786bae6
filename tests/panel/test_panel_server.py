"""What a panel's server gives, to whom, on which port; how a panel is opened, what keeps it from that, and what its end leaves."""

import os
import signal
import socket
import sys
import threading
import urllib.error
import urllib.request

import pytest

pytest.importorskip("nicegui")
from support.served_panel import ServedPanel

from stage import Stage
from stage.cli import main
from stage.errors import ArgumentError, StageError
from stage.panel import fault_page as touch
from stage.panel import open as open_panel
from stage.panel import server
from stage.panel.access_control import CONTENT_POLICY
from stage.panel.server import Panel
from stage.panel.session import UNPACED_SPEED, Session
from stage.panel.stage_scene import mesh_to_stl


def requested(address, **headers):
    """Request an address, and return status, headers and body of the answer."""
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=10) as answer:
            return answer.status, answer.headers, answer.read()
    except urllib.error.HTTPError as refused:
        return refused.code, refused.headers, refused.read()


@pytest.fixture
def other():
    other = ServedPanel(chips="hctl1100")
    yield other
    other.close()


def test_each_mesh_is_served_as_stl_and_any_other_is_not_found():
    with Session(Stage("xy"), speed=UNPACED_SPEED, paused=True) as session, Panel(session) as panel:
        model = session.stage.model
        assert model.nmesh > 0
        for mesh in range(model.nmesh):
            status, headers, content = requested(f"{panel.address}mesh/{mesh}.stl")
            assert (status, headers["content-type"], content) == (200, "model/stl", mesh_to_stl(model, mesh))
            assert headers["content-security-policy"] == CONTENT_POLICY
        assert requested(f"{panel.address}mesh/{model.nmesh}.stl")[::2] == (404, b"")


def test_the_port_of_a_request_selects_the_panel(served, other):
    pages = [served.visit(), other.visit()]
    chips = [next(e.text for e in page._all() if e.props.get("data-test") == "chip-0") for page in pages]
    assert ["HCTL" in text for text in chips] == [False, True]
    assert [p.controls.browser_count for p in (served.panel, other.panel)] == [1, 1]
    assert {served.panel.port, other.panel.port} <= set(served.panel._site.panels)
    served.leave()


def test_a_page_by_another_name_or_from_elsewhere_is_refused(served):
    port = served.panel.port
    for headers in ({"Host": f"evil.example:{port}"}, {"Origin": "http://evil.example"}):
        status, _, message = requested(served.panel.address, **headers)
        assert (status, b"This server answers" in message) == (403, True)
    assert requested(f"http://localhost:{port}/")[0] == 200


def test_only_a_server_for_other_machines_requires_the_token():
    with Session(Stage("xy", visuals=False), speed=UNPACED_SPEED, paused=True) as session:
        with Panel(session, host="localhost") as panel:
            bare, _, token = panel.address.partition("?token=")
            assert (bare, len(token) > 20) == (f"http://localhost:{panel.port}/", True)
            assert requested(bare)[0] == 403
            status, headers, _ = requested(panel.address)
            assert status == 200
            assert token in headers["set-cookie"]
            assert requested(bare, Cookie=headers["set-cookie"].partition(";")[0])[0] == 200
        with Panel(session) as panel:
            assert "token" not in panel.address
            assert requested(panel.address)[1]["set-cookie"] is None


def test_closing_a_panel_leaves_the_session_and_no_observers():
    with Session(Stage("xy", visuals=False), speed=UNPACED_SPEED, paused=True) as session:
        panel = Panel(session)
        panel.fault_controls.push("x", 3.0)
        assert session._observers
        with panel:
            pass
        assert session._observers == ()
        assert session.stage.loop.recording is None
        assert not session.do(lambda stage: stage.data.qfrc_applied.any())
        assert panel.port not in panel._site.panels
        with socket.socket() as free:
            free.bind(("127.0.0.1", panel.port))
        assert session.do(lambda stage: stage.now) == 0, "it lives on"
        panel.close()


def test_a_panel_of_a_stage_takes_its_session_with_it_and_one_that_fails_leaves_none(monkeypatch):
    displayed = []
    monkeypatch.setattr(server.webbrowser, "open", lambda address: displayed.append(address) or True)
    stage = Stage("xy", visuals=False)
    with open_panel(stage, speed=0.5, program="mine") as panel:
        assert displayed == [panel.address]
        assert (panel.session.speed, panel.session.program) == (0.5, "mine")
        with pytest.raises(StageError, match="has a session already"):
            open_panel(stage, browser=False)
    assert stage.loop.pace is None
    for wrong, error in (({"port": -1}, ArgumentError), ({"host": "203.0.113.9"}, StageError)):
        with pytest.raises(error):
            open_panel(stage, browser=False, **wrong)
        assert stage.loop.pace is None
    with open_panel(stage, browser=False) as panel:
        assert len(displayed) == 1
        assert panel.session.program == "your program"


def test_until_watched_waits_for_a_browser(served):
    assert not served.panel.watched
    assert not served.panel.wait_until_watched(0)
    assert not served.panel.wait_until_watched(0.03)
    served.visit()
    assert served.panel.wait_until_watched(0)
    assert served.panel.wait_until_watched()
    served.leave()
    assert not served.panel.watched


def test_a_port_that_cannot_be_had_says_what_to_do(served):
    with pytest.raises(StageError, match=rf"^127\.0\.0\.1:{served.panel.port}: .*in use\. Choose another port, or 0"):
        server._open_listening_socket("127.0.0.1", served.panel.port)
    with pytest.raises(StageError, match=r"^203\.0\.113\.9:0: .*\. --host takes an address of this machine"):
        server._open_listening_socket("203.0.113.9", 0)
    for port in (-1, 65536):
        with pytest.raises(ArgumentError, match=f"port={port}: a TCP port is 0"):
            server._open_listening_socket("127.0.0.1", port)


@pytest.mark.parametrize(("host", "reachable"), [("0.0.0.0", "127.0.0.1"), ("::", "::1"), ("192.0.2.7", "192.0.2.7")])
def test_a_wildcard_server_without_a_network_has_its_loopback_address(monkeypatch, host, reachable):
    class Nowhere:
        def __init__(self, family, kind):
            assert (family == socket.AF_INET6) == (":" in host)

        def __enter__(self):
            return self

        def __exit__(self, *exc):
            pass

        def connect(self, where):
            raise OSError("there is no network")

    monkeypatch.setattr(server.socket, "socket", Nowhere)
    assert server._find_reachable_host(host) == reachable


def test_a_text_with_quotes_is_one_property_value():
    assert touch.quote_clear_label('jammed by "x"') == "\"clear jammed by 'x'\""


@pytest.fixture
def refused(capsys):
    """Function that returns the error of the command."""

    def run(*arguments):
        assert main(["panel", "xy", "--no-browser", *arguments]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        return line

    return run


def test_a_port_in_use_is_reported(refused):
    pytest.importorskip("nicegui")
    with socket.socket() as acquired:
        acquired.bind(("127.0.0.1", 0))
        acquired.listen()
        port = str(acquired.getsockname()[1])
        line = refused("--port", port)
    assert port in line
    assert "Choose another port" in line


def test_a_missing_library_is_named(refused, monkeypatch):
    monkeypatch.setitem(sys.modules, "nicegui", None)
    assert "pip install -e '.[panel]'" in refused("--port", "0")


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


def test_without_a_browser_the_link_is_printed_in_one_line(capsys, monkeypatch):
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
