"""Looking at a recording: servers that only this machine reaches, processes that end, pictures without a screen."""

import glob
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest

from stage import ArgumentError
from stage.recording import viewer
from stage.recording.rerun_log import PALETTE
from stage.recording.viewer import ViewerError


def listening(pid):
    return {(c.laddr.ip, c.laddr.port) for c in psutil.Process(pid).net_connections("inet") if c.status == "LISTEN"}


def test_the_dashboard_is_served_to_this_machine_only_and_ends_with_its_command(rrd):
    port = viewer.free_port()
    command, url = viewer.serve_command(rrd, port)
    assert url.startswith(f"http://127.0.0.1:{port}/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A")
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        end = time.monotonic() + 20
        while len(open_now := listening(process.pid)) < 2 and time.monotonic() < end:
            time.sleep(0.1)
    finally:
        viewer._end(process)
    assert {ip for ip, _ in open_now} == {"127.0.0.1"}
    assert port in {p for _, p in open_now}
    assert process.poll() is not None


def test_a_port_in_use_is_named_before_anything_starts(rrd):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ViewerError, match=f"port {port} is in use. Choose another: --port"):
            viewer.serve_web(rrd, port)


@pytest.mark.skipif(sys.platform != "linux", reason="how a process learns of its parent's end is Linux's")
@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_what_serves_ends_with_its_command(rrd, sent):
    """stage demo --web & sleep 9; kill $!"""
    program = f"from stage.recording import viewer; viewer.serve_web({str(rrd)!r}, {viewer.free_port()})"
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True) as parent:
        assert b"is served" in parent.stdout.readline()
        (rerun,) = psutil.Process(parent.pid).children()
        parent.send_signal(sent)
        parent.wait(20)
    gone, alive = psutil.wait_procs([rerun], 10)
    for process in alive:
        process.kill()
    assert gone, "rerun goes on serving"
    assert parent.returncode == (-sent if sent == signal.SIGKILL else 128 + sent)


@pytest.mark.skipif(sys.platform != "linux", reason="where rerun keeps its settings is another place elsewhere")
@pytest.mark.parametrize("asked", ["", "1"])
def test_reruns_usage_data_is_off_unless_asked_for(tmp_path, monkeypatch, asked):
    """stage demo --view"""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "own"))
    monkeypatch.setenv("PULSESTAGE_RERUN_ANALYTICS", asked)
    before = {p: p.read_bytes() for p in viewer.SETTINGS.rglob("*") if p.is_file()}
    command = [viewer.executable(), "analytics", "config"]
    said = subprocess.run(command, env=viewer.environment(), capture_output=True, text=True, check=True).stdout
    assert ('"analytics_enabled": true' in said) == bool(asked)
    assert ('"analytics_enabled": false' in said) != bool(asked)
    assert {p: p.read_bytes() for p in viewer.SETTINGS.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize("port", [0, -1, 65536, 9.5])
def test_a_port_that_is_none_is_named(rrd, port):
    with pytest.raises(ArgumentError, match="1 to 65535"):
        viewer.serve_command(rrd, port)


def test_without_a_screen_it_says_what_else_there_is(rrd, monkeypatch):
    monkeypatch.setattr(viewer, "has_screen", lambda: False)
    with pytest.raises(ViewerError, match="no screen here"):
        viewer.open_viewer(rrd)


def test_with_a_screen_the_window_listens_to_this_machine_only(rrd, monkeypatch):
    seen = {}
    monkeypatch.setattr(viewer, "has_screen", lambda: True)
    monkeypatch.setattr(subprocess, "Popen", lambda command, **k: seen.update(command=command))
    viewer.open_viewer(rrd)
    assert seen["command"][1:] == [str(rrd), "--bind", "127.0.0.1", "--port", "auto"]


def test_a_recording_that_is_not_there_is_named(tmp_path):
    for look in (viewer.open_viewer, viewer.serve_web, lambda p: viewer.screenshot(p, tmp_path / "x.png")):
        with pytest.raises(ViewerError, match=r"there is no recording .*none\.rrd"):
            look(tmp_path / "none.rrd")


@pytest.mark.slow
@pytest.mark.skipif(not glob.glob("/usr/share/vulkan/icd.d/*.json"), reason="no Vulkan driver")
def test_a_picture_shows_the_whole_dashboard(rrd, tmp_path):
    from PIL import Image

    png = viewer.screenshot(rrd, tmp_path / "x.png", (1600, 900), at=0.3)
    with Image.open(png) as picture:
        assert picture.size == (1600, 900)
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    scene, plots = pixels[40:500, :800].reshape(-1, 3), pixels[40:600, 920:1560].reshape(-1, 3)
    assert len(np.unique(scene, axis=0)) > 1000
    for axis, colour in zip("xyz", PALETTE, strict=False):
        assert np.abs(plots - colour).sum(axis=1).min() < 40, axis
