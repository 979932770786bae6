"""Look at a recording: in rerun's viewer, in a browser, or as a picture without a screen."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

from stage.errors import ArgumentError, StageError

QUIET = {"RUST_LOG": "error"}  # without it the viewer's own messages are in the picture


class ViewerError(StageError):
    """rerun's viewer is missing or failed."""


def has_screen() -> bool:
    """Whether a window could open here."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _rerun() -> list[str]:
    beside = Path(sys.executable).with_name("rerun")
    found = str(beside) if beside.exists() else shutil.which("rerun")
    if found is None:
        raise ViewerError("the command `rerun` is missing: pip install 'rerun-sdk>=0.41'.")
    return [found]


def open_viewer(rrd: str | os.PathLike) -> None:
    """Open the recording in a window and return at once."""
    subprocess.Popen([*_rerun(), str(rrd)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)


def serve_command(rrd: str | os.PathLike, port: int = 9090) -> list[str]:
    """The command that serves the dashboard to browsers of this machine only."""
    if not 1 <= port <= 65534:
        raise ArgumentError(f"port={port!r}: a port is 1 to 65534.")
    # rerun binds to every address unless told otherwise
    return [*_rerun(), str(rrd), "--web-viewer", "--bind", "127.0.0.1", "--web-viewer-port", str(port), "--port", "auto"]


def serve_web(rrd: str | os.PathLike, port: int = 9090) -> int:
    """Serve the dashboard on http://127.0.0.1:port until interrupted. Returns rerun's exit code."""
    command = serve_command(rrd, port)
    print(f"serving {rrd} on http://127.0.0.1:{port} (this machine only); Ctrl-C ends it", flush=True)
    process = subprocess.Popen(command)
    try:
        return process.wait()
    except KeyboardInterrupt:
        process.terminate()
        return process.wait()


def screenshot(rrd: str | os.PathLike, png: str | os.PathLike, size: tuple[int, int] = (1920, 1080)) -> Path:
    """Render the dashboard to a PNG without a screen (needs a Vulkan driver; Debian: mesa-vulkan-drivers).

    Waits until the viewer has loaded everything: until two pictures in a row are the same.
    """
    from rerun.experimental import ViewerClient

    png, port = Path(png), _free_port()
    window = f"{size[0]}x{size[1]}"
    command = [*_rerun(), str(rrd), "--headless", "--window-size", window, "--bind", "127.0.0.1", "--port", str(port)]
    process = subprocess.Popen(command, env=os.environ | QUIET, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    try:
        deadline, before = time.monotonic() + 120, b""
        while time.monotonic() < deadline:
            if process.poll() is not None:
                said = process.stderr.read().decode(errors="replace") if process.stderr else ""
                raise ViewerError(f"rerun ended (a Vulkan driver missing? Debian: mesa-vulkan-drivers):\n{said[-800:]}")
            time.sleep(1.0)
            try:
                ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy").save_screenshot(str(png))
            except Exception:  # the client has no errors of its own: not up yet, or not answering
                continue
            now = png.read_bytes() if png.exists() else b""
            if now and now == before:
                return png
            before = now
    finally:
        process.kill()
        process.wait()
    raise ViewerError(f"rerun did not settle on a picture of {rrd} within two minutes.")


def _free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]
