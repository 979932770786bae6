"""Look at a recording: in rerun's viewer, in a browser, or as a picture without a screen."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
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
    """Render the dashboard to a PNG without a screen (needs a Vulkan driver; Debian: mesa-vulkan-drivers)."""
    png = Path(png)
    png.unlink(missing_ok=True)
    command = [*_rerun(), str(rrd), "--headless", "--screenshot-to", str(png), "--window-size", f"{size[0]}x{size[1]}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=os.environ | QUIET, check=False)
    if not png.exists():
        raise ViewerError(f"rerun made no picture (a Vulkan driver missing? Debian: mesa-vulkan-drivers):\n{done.stderr[-800:]}")
    return png
