"""Looking at a recording, without rerun: ports and programs that are named, what is asked of the viewer, what a browser is told."""

from __future__ import annotations

import errno
import http.client
import signal
import socket
import subprocess
import threading
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from stage.errors import ArgumentError
from stage.recording import rerun_viewer
from stage.recording.browser_server import RecordingServer
from stage.recording.rerun_viewer import ViewerError
from stage.support.files import FileError


@pytest.mark.parametrize("port", [0, -1, 65536, 90.5])
def test_a_port_beyond_the_first_and_the_last_is_refused(port):
    with pytest.raises(ArgumentError, match=rf"port={port!r}: a port is a whole number of 1 to 65535\."):
        rerun_viewer.check_port(port)
    rerun_viewer.check_port(1), rerun_viewer.check_port(65535)


@pytest.mark.parametrize(
    ("number", "message"),
    [(errno.EADDRINUSE, "port 9191 is in use. Choose another: --port 4711"),
     (errno.EACCES, "port 9191 cannot be had: no, sir. Choose another: --port 4711")],
)  # fmt: skip
def test_a_port_that_cannot_be_had_says_why_and_names_one_that_is_free(tmp_path, monkeypatch, number, message):
    def refused(rrd, port, allow_other_servers):
        raise OSError(number, "no, sir")

    monkeypatch.setattr(rerun_viewer, "RecordingServer", refused)
    monkeypatch.setattr(rerun_viewer, "find_free_port", lambda: 4711)
    rrd = tmp_path / "x.rrd"
    rrd.touch()
    with pytest.raises(ViewerError) as failed:
        rerun_viewer.make_web_server(rrd, 9191)
    assert str(failed.value).startswith(message)


@pytest.mark.parametrize(
    ("arguments", "wanted"), [(None, False), ("", False), ("0", False), ("1", True), ("yes", True)]
)
def test_usage_data_is_sent_only_on_request(monkeypatch, arguments, wanted):
    monkeypatch.delenv("PULSESTAGE_RERUN_ANALYTICS", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", "/own")
    if arguments is not None:
        monkeypatch.setenv("PULSESTAGE_RERUN_ANALYTICS", arguments)
    assert rerun_viewer.build_rerun_environment()["XDG_CONFIG_HOME"] == (
        "/own" if wanted else str(rerun_viewer.SETTINGS_FOLDER)
    )


def test_reruns_program_is_the_one_that_is_named_or_that_of_its_package(tmp_path, monkeypatch):
    """RERUN_CLI_PATH; the program of macOS in its folder, that of Linux; a package without one"""
    monkeypatch.delenv("RERUN_CLI_PATH", raising=False)
    spec = SimpleNamespace(submodule_search_locations=[str(tmp_path / "none"), str(tmp_path)])
    monkeypatch.setattr(rerun_viewer, "find_spec", lambda name: spec)
    monkeypatch.setattr(rerun_viewer, "import_extra", lambda *_: None)
    with pytest.raises(ViewerError, match=rf"in {tmp_path}/none, {tmp_path} has no program of rerun\. Install it anew"):
        rerun_viewer.find_rerun_executable()
    for name in ("rerun.exe", "rerun", "Rerun.app/Contents/MacOS/Rerun"):
        program = tmp_path / name
        program.parent.mkdir(parents=True, exist_ok=True)
        program.touch()
        assert rerun_viewer.find_rerun_executable() == str(program)
    monkeypatch.setenv("RERUN_CLI_PATH", "/else/where")
    assert rerun_viewer.find_rerun_executable() == "/else/where"


@pytest.mark.parametrize(
    ("at", "end", "displayed"),
    [(None, 2_500_000_000, 2.5), (0.0, 2_500_000_000, 0.0), (1.25, 9, 1.25), (None, None, 0.0)],
)
def test_a_picture_shows_the_requested_time_or_the_end(at, end, displayed):
    """also that of 0 s"""
    requested = []
    timelines = [SimpleNamespace(name="log_time", end=7), SimpleNamespace(name="time", end=end)]
    state = SimpleNamespace(recordings=[SimpleNamespace(timelines=timelines)])
    client = SimpleNamespace(
        get_state=lambda: state, set_time=lambda *arguments, **named: requested.append((arguments, named))
    )
    rerun_viewer._show_time(client, at)
    assert requested == [(("time",), {"duration": pytest.approx(displayed), "play_state": "paused"})]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_ends_leaves_in_order_and_handlers_are_as_before(number):
    def own(signum, frame): ...

    before = signal.signal(number, own)
    try:
        with pytest.raises(SystemExit) as left, rerun_viewer._exit_on_signals():
            signal.raise_signal(number)
        assert left.value.code == 128 + number
        assert signal.getsignal(number) is own
    finally:
        signal.signal(number, before)


def test_a_program_that_does_not_end_is_killed_and_waited_for():
    done = []

    def wait(timeout=None):
        done.append(("wait", timeout))
        if timeout:
            raise subprocess.TimeoutExpired("rerun", timeout)

    process = SimpleNamespace(terminate=lambda: done.append("terminate"), kill=lambda: done.append("kill"), wait=wait)
    rerun_viewer._end_process(process)
    assert done == ["terminate", ("wait", 5), "kill", ("wait", None)]


def test_an_existing_picture_is_overwritten_only_on_request(tmp_path, monkeypatch):
    """screenshot(rrd, png, (320, 200), at=0.5, timeout=7)"""
    rrd, png, requested = tmp_path / "x.rrd", tmp_path / "x.png", []
    rrd.touch(), png.write_bytes(b"old")
    monkeypatch.setattr(
        rerun_viewer,
        "_render_screenshot",
        lambda rrd, part, *arguments: (requested.append(arguments), part.write_bytes(b"new")),
    )
    with pytest.raises(FileError, match=r"x\.png"):
        rerun_viewer.take_screenshot(rrd, png)
    assert (png.read_bytes(), requested) == (b"old", [])
    assert rerun_viewer.take_screenshot(rrd, png, (320, 200), at=0.5, timeout=7, overwrite=True) == png
    assert (png.read_bytes(), requested) == (b"new", [((320, 200), 0.5, 7)])


@pytest.mark.parametrize(("bar", "top"), [(lambda x: 30, rerun_viewer.FRAME_HEIGHT), (lambda x: x % 256, 0)])
def test_an_empty_bar_of_a_window_is_cut_off_and_what_is_drawn_stays(tmp_path, bar, top):
    """a picture of 64 x 48 below the bar, of which row y has the colour y"""
    image = pytest.importorskip("PIL.Image")
    height = 48 + rerun_viewer.FRAME_HEIGHT
    picture = image.new("L", (64, height))
    for y in range(height):
        for x in range(64):
            picture.putpixel((x, y), bar(x) if y < rerun_viewer.FRAME_HEIGHT else y)
    picture.save(tmp_path / "x.png")
    rerun_viewer._cut_window_frame(tmp_path / "x.png", (64, 48))
    with image.open(tmp_path / "x.png") as cut:
        assert cut.size == (64, 48)
        assert cut.getpixel((5, 0)) == (rerun_viewer.FRAME_HEIGHT if top else 5)


class HttpAnswer:
    def __init__(self, status, reason="so"):
        self.status, self.reason = status, reason

    def read(self):
        return b"content"


@pytest.mark.parametrize(("name", "called"), [("", "its page"), ("re_viewer.js", r"re_viewer\.js")])
def test_a_page_that_rerun_does_not_give_is_named(monkeypatch, name, called):
    requested = []
    connection = SimpleNamespace(
        request=lambda *arguments: requested.append(arguments),
        getresponse=lambda: answers.pop(0),
        close=lambda: requested.append("closed"),
    )
    monkeypatch.setattr(http.client, "HTTPConnection", lambda host, port, timeout: connection)
    answers = [HttpAnswer(404, "Not Found"), HttpAnswer(200)]
    with pytest.raises(ViewerError, match=rf"rerun does not give {called}: 404 Not Found\."):
        rerun_viewer._fetch_file(1, name)
    assert rerun_viewer._fetch_file(1, name) == b"content"
    assert requested == [("GET", f"/{name}"), "closed"] * 2


# --- what serves a browser ---


@contextmanager
def serving(rrd):
    with RecordingServer(rrd, 0) as server:
        server.page = {"": b"the page", "favicon.ico": b"an icon"}
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


def requested(server, path, host=None, method="GET"):
    """Request a path, and return status, headers, and all bytes until the server closes the connection."""
    with socket.create_connection(("127.0.0.1", server.server_port), timeout=10) as wire:
        wire.sendall(f"{method} {path} HTTP/1.0\r\nHost: {host or f'localhost:{server.server_port}'}\r\n\r\n".encode())
        message = b"".join(iter(lambda: wire.recv(4096), b""))
    head, _, content = message.partition(b"\r\n\r\n")
    first, *lines = head.decode().split("\r\n")
    return int(first.split()[1]), dict(line.split(": ", 1) for line in lines), content


def test_headers_forbid_caching_sniffing_and_referrers(tmp_path):
    """a file of the page, one that is none, the head alone, a name in capitals, the address with and without its question"""
    rrd = tmp_path / "x.rrd"
    rrd.write_bytes(b"a recording")
    with serving(rrd) as server:
        for path, status, content in (
            ("?url=x", 200, b"the page"), ("favicon.ico", 200, b"an icon"), ("recording.rrd", 200, b"a recording"),
            ("re_viewer.js", 404, b"There is no such file.\n"), ("", 302, b""),
        ):  # fmt: skip
            got, headers, message = requested(server, server.folder + path)
            assert (got, message, headers["Content-Length"]) == (status, content, str(len(content)))
            assert [headers[name] for name in ("Referrer-Policy", "X-Content-Type-Options", "Cache-Control")] == [
                "no-referrer", "nosniff", "no-store",
            ]  # fmt: skip
            got, headers, message = requested(server, server.folder + path, method="HEAD")
            assert (got, message, headers["Content-Length"]) == (status, b"", str(len(content)))
        assert requested(server, server.folder + "favicon.ico", host=f"LocalHost:{server.server_port}")[0] == 200
        assert requested(server, "http://[")[::2] == (400, b"This is no address.\n")
        rrd.unlink()
        assert requested(server, server.folder + "recording.rrd")[::2] == (404, b"The recording is no longer there.\n")


def test_at_port_80_a_browser_leaves_the_port_away():
    server = SimpleNamespace(server_port=80)
    assert RecordingServer.hosts.fget(server) == ["127.0.0.1:80", "localhost:80", "127.0.0.1", "localhost"]
    server.server_port = 8080
    assert RecordingServer.hosts.fget(server) == ["127.0.0.1:8080", "localhost:8080"]


def test_a_disconnected_browser_is_no_error_and_others_are_reported(tmp_path, capfd):
    with RecordingServer(Path(tmp_path), 0) as server:
        for error, reported in ((BrokenPipeError("gone"), False), (ValueError("a mistake of ours"), True)):
            try:
                raise error
            except (OSError, ValueError):
                server.handle_error(None, ("127.0.0.1", 1))
            assert ("a mistake of ours" in capfd.readouterr().err) is reported
