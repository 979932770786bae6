"""Looking at a recording: servers that only this machine reaches, processes that end, pictures without a screen."""

import contextlib
import glob
import http.client
import io
import signal
import socket
import subprocess
import sys
import threading
import time
from types import SimpleNamespace
from urllib.parse import parse_qsl, urlsplit

import numpy as np
import psutil
import pytest

from stage import ArgumentError
from stage.recording import rerun_viewer
from stage.recording.axis_series import COLORS, assign_colors
from stage.recording.rerun_viewer import ViewerError


def listening(process):
    return {(c.laddr.ip, c.laddr.port) for c in process.net_connections("inet") if c.status == "LISTEN"}


@pytest.fixture(scope="module")
def served(rrd):
    """The dashboard's server."""
    with rerun_viewer.make_web_server(rrd, rerun_viewer.find_free_port()) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def requested(server, path, host, method="GET"):
    """Request a path as a browser that takes the server for `host`, and return status, headers and content."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    with contextlib.closing(connection):
        connection.putrequest(method, path, skip_host=True)
        for name in host:
            connection.putheader("Host", name)
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()


def test_the_dashboard_is_served_to_this_machine_only_and_nothing_else_listens(served, rrd):
    me = psutil.Process()
    first_thread = {(ip, port) for ip, port in listening(me) if port == served.server_port}
    assert first_thread == {("127.0.0.1", served.server_port)}
    assert [c for c in me.children() if "rerun" in c.name()] == []
    for name in ("127.0.0.1", "localhost"):
        host = [f"{name}:{served.server_port}"]
        status, headers, _ = requested(served, served.folder, host)
        assert (status, urlsplit(headers["Location"]).path) == (302, served.folder)
        ((key, url),) = parse_qsl(urlsplit(headers["Location"]).query)
        assert (key, url) == ("url", f"http://{host[0]}{served.folder}recording.rrd")  # the page's own origin
        status, headers, page = requested(served, headers["Location"], host)
        assert (status, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
        for part in (b're_viewer.js"', b're_viewer_bg.wasm"'):
            assert part in page
        status, headers, content = requested(served, urlsplit(url).path, host)
        assert (status, content) == (200, rrd.read_bytes())
        assert "Access-Control-Allow-Origin" not in headers
    for part, kind, begin in (
        ("re_viewer.js", "text/javascript", b""),
        ("re_viewer_bg.wasm", "application/wasm", b"\0asm"),
    ):
        status, headers, content = requested(served, served.folder + part, host)
        assert (status, headers["Content-Type"]) == (200, kind)
        assert content.startswith(begin)
        assert len(content) > 100_000
    status, headers, content = requested(served, f"{served.folder}recording.rrd", host, "HEAD")
    assert (status, content, int(headers["Content-Length"])) == (200, b"", rrd.stat().st_size)


@pytest.mark.parametrize(
    "host",
    [["evil.example"], ["evil.example:PORT"], ["127.0.0.1:PORT.evil.example"], ["127.0.0.1"], ["localhost:1"], [],
     ["127.0.0.1:PORT", "evil.example:PORT"]],
)  # fmt: skip
def test_a_rebound_web_site_gets_neither_page_nor_recording(served, rrd, host):
    """stage demo --web & curl -H "Host: evil.example" http://127.0.0.1:9090/"""
    host = [name.replace("PORT", str(served.server_port)) for name in host]
    for path in (
        "/",
        served.folder,
        f"{served.folder}?url=x",
        f"{served.folder}recording.rrd",
        f"{served.folder}re_viewer.js",
    ):
        status, headers, content = requested(served, path, host)
        assert status == 403
        assert content.decode().startswith("This server answers to 127.0.0.1:")
        assert "Location" not in headers


@pytest.mark.parametrize(
    "path", ["/", "/recording.rrd", "/?url=x", "/guess/recording.rrd", "FOLDER../recording.rrd", "FOLDERx.rrd"]
)
def test_who_does_not_know_the_address_gets_nothing(served, path):
    """curl http://127.0.0.1:9090/"""
    path = path.replace("FOLDER", served.folder)
    status, _, content = requested(served, path, [f"127.0.0.1:{served.server_port}"])
    assert (status, len(content) < 100) == (404, True)
    assert len(served.folder) >= 20


@pytest.mark.parametrize("wanted", ["", "1"])
def test_the_page_calls_no_other_server_unless_requested(rrd, monkeypatch, wanted):
    """stage demo --web"""
    monkeypatch.setenv("PULSESTAGE_RERUN_ANALYTICS", wanted)
    monkeypatch.setattr(rerun_viewer, "_fetch_page", lambda: {"": b"page"})
    with rerun_viewer.make_web_server(rrd, rerun_viewer.find_free_port()) as server:
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        _, headers, _ = requested(server, f"{server.folder}?url=x", [f"localhost:{server.server_port}"])
        thread.join()
    policy = headers["Content-Security-Policy"]
    if wanted:
        assert policy is None
    else:
        assert policy.split(";")[0].split()[:2] == ["default-src", "'self'"]
        assert not {"*", "https:", "http:"} & set(policy.split())


def test_servers_have_different_addresses(rrd, monkeypatch):
    monkeypatch.setattr(rerun_viewer, "_fetch_page", dict)
    folders = set()
    for _ in range(2):
        with rerun_viewer.make_web_server(rrd, rerun_viewer.find_free_port()) as server:
            folders.add(server.folder)
    assert len(folders) == 2


def test_a_port_in_use_is_named_before_anything_starts(rrd):
    with socket.create_server(("127.0.0.1", 0)) as acquired:
        port = acquired.getsockname()[1]
        with pytest.raises(ViewerError, match=f"port {port} is in use. Choose another: --port"):
            rerun_viewer.serve_web(rrd, port)


@pytest.mark.skipif(sys.platform != "linux", reason="how a process learns of its parent's end is Linux's")
@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_what_serves_ends_with_its_command(rrd, sent):
    """stage demo --web & sleep 9; kill $!"""
    program = f"from stage.recording import rerun_viewer; rerun_viewer.serve_web({str(rrd)!r}, {rerun_viewer.find_free_port()})"
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True) as parent:
        assert b"is served" in parent.stdout.readline()
        assert psutil.Process(parent.pid).children() == [], "rerun goes on serving"
        parent.send_signal(sent)
        parent.wait(20)
    assert parent.returncode == (-sent if sent == signal.SIGKILL else 128 + sent)


@pytest.mark.skipif(sys.platform != "linux", reason="how a process learns of its parent's end is Linux's")
@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_rerun_ends_with_the_command_that_waits_for_it(sent):
    """stage demo --picture x.png & sleep 9; kill $!"""
    program = (
        "from stage.recording import rerun_viewer\nwith rerun_viewer._run_rerun(['sleep', '100']): "
        "print('runs', flush=True); input()"
    )
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True) as parent:
        assert b"runs" in parent.stdout.readline()
        (rerun,) = psutil.Process(parent.pid).children()
        parent.send_signal(sent)
        parent.wait(20)
    gone, alive = psutil.wait_procs([rerun], 10)
    for process in alive:
        process.kill()
    assert gone, "rerun goes on"
    assert parent.returncode == (-sent if sent == signal.SIGKILL else 128 + sent)


@pytest.mark.skipif(sys.platform != "linux", reason="where rerun keeps its settings is another place elsewhere")
@pytest.mark.parametrize("requested", ["", "1"])
def test_reruns_usage_data_is_off_unless_requested(tmp_path, monkeypatch, requested):
    """stage demo --view"""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "own"))
    monkeypatch.setenv("PULSESTAGE_RERUN_ANALYTICS", requested)
    monkeypatch.delenv("CI", raising=False)  # rerun sends nothing from a machine that says so
    before = {p: p.read_bytes() for p in rerun_viewer.SETTINGS_FOLDER.rglob("*") if p.is_file()}
    command = [rerun_viewer.find_rerun_executable(), "analytics", "config"]
    message = subprocess.run(
        command, env=rerun_viewer.build_rerun_environment(), capture_output=True, text=True, check=True
    ).stdout
    assert ('"analytics_enabled": true' in message) == bool(requested)
    assert ('"analytics_enabled": false' in message) != bool(requested)
    assert {p: p.read_bytes() for p in rerun_viewer.SETTINGS_FOLDER.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize("port", [0, -1, 65536, 9.5])
def test_a_port_that_is_none_is_named(rrd, port):
    with pytest.raises(ArgumentError, match="1 to 65535"):
        rerun_viewer.make_web_server(rrd, port)


def test_without_a_screen_the_error_names_the_alternatives(rrd, monkeypatch):
    monkeypatch.setattr(rerun_viewer, "has_screen", lambda: False)
    with pytest.raises(ViewerError, match="no screen here"):
        rerun_viewer.open_viewer(rrd)


def test_with_a_screen_the_window_listens_to_this_machine_only(rrd, monkeypatch):
    observed = {}
    monkeypatch.setattr(rerun_viewer, "has_screen", lambda: True)
    monkeypatch.setattr(subprocess, "Popen", lambda command, **k: observed.update(command=command))
    rerun_viewer.open_viewer(rrd)
    assert observed["command"][1:] == [str(rrd), "--bind", "127.0.0.1", "--port", "auto"]


def test_a_missing_recording_is_named(tmp_path):
    for observe in (
        rerun_viewer.open_viewer,
        rerun_viewer.serve_web,
        lambda p: rerun_viewer.take_screenshot(p, tmp_path / "x.png"),
    ):
        with pytest.raises(ViewerError, match=r"there is no recording .*none\.rrd"):
            observe(tmp_path / "none.rrd")


NO_DRIVER = """
thread 'main' panicked at 'Failed to get render context'
re_viewer/src/app/mod.rs:1425
stack backtrace:
   6: core::panicking::panic_fmt
"""


@pytest.mark.parametrize(
    ("messages", "cause"),
    [
        (
            NO_DRIVER,
            "Failed to get render context. Pictures need a Vulkan driver, also without a graphics card (Debian: apt install "
            "mesa-vulkan-drivers).",
        ),
        ("cannot open shared object\nmore\n", "cannot open shared object."),
        ("", "it gave no reason."),
    ],
)
def test_a_viewer_that_fails_is_one_line_without_a_backtrace(messages, cause):
    process = SimpleNamespace(poll=lambda: 102, returncode=102, stderr=io.BytesIO(messages.encode()))
    with pytest.raises(ViewerError) as failed:
        rerun_viewer._check_process(process)
    assert str(failed.value) == f"rerun ended with code 102: {cause}"


@pytest.mark.slow
@pytest.mark.skipif(not glob.glob("/usr/share/vulkan/icd.d/*.json"), reason="no Vulkan driver")
def test_a_picture_shows_every_part_of_the_dashboard(rrd, tmp_path):
    from PIL import Image

    png = rerun_viewer.take_screenshot(rrd, tmp_path / "x.png", (1600, 900), at=0.3)
    with Image.open(png) as picture:
        assert picture.size == (1600, 900)
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    scene, plots = pixels[40:500, :800].reshape(-1, 3), pixels[40:600, 920:1560].reshape(-1, 3)
    assert len(np.unique(scene, axis=0)) > 1000
    for axis, colour in zip("xyz", COLORS.values(), strict=False):
        assert np.abs(plots - colour).sum(axis=1).min() < 40, axis


def test_nobody_waits_for_ever_for_a_viewer_that_never_listens():
    """rerun lives and its port stays closed: the wait ends with its time."""
    requested = []

    def poll():
        requested.append(1)
        return None if len(requested) < 50 else 1

    rerun_viewer._wait_for_port(
        rerun_viewer.find_free_port(), SimpleNamespace(poll=poll, stderr=None, returncode=1), time.monotonic() + 0.15
    )
    assert 1 <= len(requested) < 10


def test_a_page_that_cannot_be_had_leaves_the_port_free(rrd, monkeypatch):
    port = rerun_viewer.find_free_port()
    monkeypatch.setattr(rerun_viewer, "_fetch_page", lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError) as reported:
        rerun_viewer.make_web_server(rrd, port)
    assert rerun_viewer._is_port_free(port), reported


def test_a_picture_waits_until_the_viewer_has_loaded_and_settled(rrd, tmp_path, monkeypatch):
    """stage demo --picture x.png: a viewer that is not up at once, goes on loading, and shows a second picture after the first"""
    loaded = SimpleNamespace(
        loading=False, recordings=[SimpleNamespace(timelines=[SimpleNamespace(name="time", end=2e9)])]
    )
    states = [
        loaded,
        SimpleNamespace(loading=False, recordings=[]),
        SimpleNamespace(loading=True, recordings=loaded.recordings),
    ]
    shots, done, running = [b"a", b"b", b"b"], [], SimpleNamespace(poll=lambda: None)

    class ViewerClient:
        def get_state(self):
            return states.pop() if len(states) > 1 else states[0]

        def set_time(self, *arguments, **named):
            done.append((len(states), arguments, named))

        def save_screenshot(self, path):
            with open(path, "wb") as file:
                file.write(shots.pop(0))

    def connect(url):
        if done[-1:] != [0.2]:
            raise ConnectionError
        return ViewerClient()

    def started(command, **_):
        done.append(command[2:5])
        return contextlib.nullcontext(running)

    monkeypatch.setattr("rerun.experimental.ViewerClient", SimpleNamespace(connect=connect))
    monkeypatch.setattr(rerun_viewer, "_run_rerun", started)
    monkeypatch.setattr(rerun_viewer, "_wait_for_port", lambda *_: None)
    monkeypatch.setattr(rerun_viewer, "_cut_window_frame", lambda *arguments: done.append(arguments))
    monkeypatch.setattr("time.sleep", done.append)
    png = tmp_path / "x.png"
    rerun_viewer._render_screenshot(rrd, png, (640, 480), None, 20)
    size = ["--headless", "--window-size", f"640x{480 + rerun_viewer.FRAME_HEIGHT}"]
    current = (1, ("time",), {"duration": 2.0, "play_state": "paused"})
    assert done == [size, 0.2, 0.2, 0.2, current, 0.5, 0.5, (png, (640, 480))]
    assert not shots


def test_the_dashboard_names_the_colour_of_each_axis_and_begins_again_after_the_last():
    eight = SimpleNamespace(axes=dict.fromkeys("abcdefgh"))
    named = assign_colors(eight)
    assert list(named.values()) == [*COLORS, *list(COLORS)[:2]]
    assert named["b"] == "green"
