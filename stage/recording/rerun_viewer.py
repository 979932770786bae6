"""Show a recording in rerun's viewer or in a browser, or render it to a picture without a screen.

rerun's servers listen on every address of the machine by default. Those started here listen on 127.0.0.1 only, send no usage data
(PULSESTAGE_RERUN_ANALYTICS=1 leaves that choice to rerun's own settings), and end with the process that waits for them.
stage.recording.browser_server serves browsers, because rerun's servers accept any host name.
"""

from __future__ import annotations

import ctypes
import errno
import http.client
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stage.errors import ArgumentError, StageError
from stage.recording.browser_server import LOOPBACK_ADDRESS, PAGE_MIME_TYPES, RECORDING_NAME, RecordingServer
from stage.recording.lazy_rerun import experimental
from stage.support.extras import import_extra, is_installed
from stage.support.files import refuse_irregular, write_atomically
from stage.support.opengl import has_screen

if TYPE_CHECKING:
    from stage.recording.recording import Recording

FRAME_HEIGHT = 36  # pixels
QUIET_ENVIRONMENT = {"RUST_LOG": "error"}  # without it the viewer's own messages are in the picture
SETTINGS_FOLDER = Path(__file__).with_name("settings")  # rerun's: usage data off, which it sends by default
PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG
MAX_WIDGET_SAMPLES = 300_000  # 5 minutes at a millisecond
WIDGET_SIZE = 960, 620  # pixels


class ViewerError(StageError):
    """Error of rerun's viewer, which is missing or has failed."""


def find_rerun_executable() -> str:
    """Return the path of rerun's executable. The command `rerun` is a script, and ending it would leave the executable running."""
    if "RERUN_CLI_PATH" in os.environ:
        return os.environ["RERUN_CLI_PATH"]
    spec = find_spec("rerun_cli")
    folders = [Path(f) for f in (spec.submodule_search_locations or ())] if spec else []
    for folder in folders:
        for name in ("Rerun.app/Contents/MacOS/Rerun", "rerun", "rerun.exe"):
            if (folder / name).is_file():
                return str(folder / name)
    import_extra("rerun_cli", "looking at a recording")
    raise ViewerError(
        f"the package rerun_cli in {', '.join(map(str, folders))} has no program of rerun. Install it anew."
    )


def open_viewer(rrd: str | os.PathLike) -> None:
    """Open a recording in a window and return at once. Raises ViewerError on a machine without a screen."""
    rrd = _check_recording(rrd)
    check_screen(str(rrd))
    command = [find_rerun_executable(), str(rrd), "--bind", LOOPBACK_ADDRESS, "--port", "auto"]
    nowhere = subprocess.DEVNULL
    subprocess.Popen(command, env=build_rerun_environment(), stdout=nowhere, stderr=nowhere, start_new_session=True)


def check_screen(subject: str) -> None:
    """Raise ViewerError on a machine without a screen.

    Args:
        subject: What was to be shown, for the message.
    """
    if not has_screen():
        raise ViewerError(
            f"no screen here to show {subject} on. Serve it to a browser (--web), or draw it (--picture, screenshot())."
        )


def check_port(port: int) -> None:
    """Raise ArgumentError if a number is no TCP port."""
    if int(port) != port or not 1 <= port <= 65535:
        raise ArgumentError(f"port={port!r}: a port is a whole number of 1 to 65535.")


def make_web_server(rrd: str | os.PathLike, port: int = 9090) -> RecordingServer:
    """Make a server of the dashboard for browsers of this machine. Call its `serve_forever()`; its `address` is the page.

    Args:
        rrd: The recording.
        port: TCP port.

    Raises:
        ArgumentError: The number is no port.
        ViewerError: The port is in use, or rerun provides no page.
    """
    rrd = _check_recording(rrd)
    check_port(port)
    try:
        server = RecordingServer(rrd, int(port), allow_other_servers=_allows_analytics())
    except OSError as error:
        why = "is in use" if error.errno == errno.EADDRINUSE else f"cannot be had: {error.strerror}"
        raise ViewerError(f"port {port} {why}. Choose another: --port {find_free_port()}, for example.") from error
    try:
        server.page = _fetch_page()
    except BaseException:
        server.server_close()
        raise
    return server


def serve_web(rrd: str | os.PathLike, port: int = 9090) -> None:
    """Serve the dashboard to browsers of this machine until interrupted."""
    with _exit_on_signals():
        try:
            with make_web_server(rrd, port) as server:
                print(f"{rrd} is served on this machine only, at\n  {server.address}\nCtrl-C ends it.", flush=True)
                if has_screen():
                    import webbrowser

                    webbrowser.open(server.address)
                server.serve_forever()
        except KeyboardInterrupt:
            return


def _fetch_page() -> dict[str, bytes]:
    """Return the files of rerun's page by name. They come from rerun's own server, which runs only for this purpose."""
    port = find_free_port()
    command = [
        find_rerun_executable(),
        f"http://{LOOPBACK_ADDRESS}/{RECORDING_NAME}",
        "--serve-web",
        "--bind",
        LOOPBACK_ADDRESS,
    ]
    command += ["--web-viewer-port", str(port)]
    with _run_rerun(command, stderr=subprocess.PIPE) as process:
        _wait_for_port(port, process)
        page = {name: _fetch_file(port, name) for name in PAGE_MIME_TYPES}
        _check_process(process)  # if it has ended, another server has answered
    return page


def _fetch_file(port: int, name: str) -> bytes:
    """Return one file of rerun's page from the server at `port`."""
    connection = http.client.HTTPConnection(LOOPBACK_ADDRESS, port, timeout=30)
    try:
        connection.request("GET", f"/{name}")
        answer = connection.getresponse()
        if answer.status != 200:
            raise ViewerError(f"rerun does not give {name or 'its page'}: {answer.status} {answer.reason}.")
        return answer.read()
    except (OSError, http.client.HTTPException) as error:
        raise ViewerError(f"rerun does not give {name or 'its page'}: {error}.") from error
    finally:
        connection.close()


def take_screenshot(
    rrd: str | os.PathLike,
    png: str | os.PathLike,
    size: tuple[int, int] = (1920, 1080),
    at: float | None = None,
    timeout: float = 120.0,
    overwrite: bool = False,
) -> Path:
    """Render the dashboard to a PNG without a screen (needs a Vulkan driver; Debian: mesa-vulkan-drivers).

    The function waits until the viewer has loaded everything and two successive pictures are equal.

    Args:
        rrd: The recording.
        png: File to write.
        size: Width and height, pixels.
        at: Time to show, s; None: the end.
        timeout: Real seconds to wait.
        overwrite: The file may exist.

    Returns:
        The path of the picture.

    Raises:
        FileError: The file exists, or cannot be written.
        ViewerError: rerun's viewer is missing or failed.
    """
    rrd = _check_recording(rrd)
    with write_atomically(Path(png).absolute(), overwrite) as part:
        _render_screenshot(rrd, part, size, at, timeout)
    return Path(png).absolute()


def _render_screenshot(rrd: Path, png: Path, size: tuple[int, int], at: float | None, timeout: float) -> None:
    """Run the viewer without a window until it has saved the picture."""
    port = find_free_port()
    command = [find_rerun_executable(), str(rrd), "--headless", "--window-size", f"{size[0]}x{size[1] + FRAME_HEIGHT}"]
    command += ["--bind", LOOPBACK_ADDRESS, "--port", str(port)]
    deadline = time.monotonic() + timeout
    with _run_rerun(command, stderr=subprocess.PIPE) as process:
        _wait_for_port(port, process, deadline)
        client = _connect_client(port, process, deadline)
        _show_time(client, at)
        before = b""
        while time.monotonic() < deadline:
            client.save_screenshot(str(png))
            now = png.read_bytes()
            if now == before:
                _cut_window_frame(png, size)
                return
            before = now
            time.sleep(0.5)
    raise ViewerError(f"rerun did not settle on a picture of {rrd} within {timeout:g} s.")


def _cut_window_frame(png: Path, size: tuple[int, int]) -> None:
    """Cut off the frame at the top of the window, which is an empty bar in the picture."""
    from PIL import Image

    with Image.open(png) as picture:
        middle = picture.convert("L").crop((16, 4, picture.width - 16, FRAME_HEIGHT - 4))
        empty = middle.getextrema()[0] == middle.getextrema()[1]
        top = FRAME_HEIGHT if empty else 0
        picture.crop((0, top, picture.width, top + size[1])).save(png)


def _connect_client(port: int, process: subprocess.Popen, deadline: float) -> Any:
    """Return a client of the viewer at `port` after the viewer has loaded the recording."""
    reason: object = "it is still loading"
    while time.monotonic() < deadline:
        _check_process(process)
        try:
            client = experimental.ViewerClient.connect(f"rerun+http://{LOOPBACK_ADDRESS}:{port}/proxy")
            state = client.get_state()
            if not state.loading and any(r.timelines for r in state.recordings):
                return client
        except Exception as error:  # the client has no errors of its own, and the viewer may not be up yet
            reason = error
        time.sleep(0.2)
    raise ViewerError(f"rerun's viewer does not answer: {reason}")


def _show_time(client: Any, time_s: float | None) -> None:
    """Let the viewer show a time, s; None: the end of the recording."""
    timeline = next(t for r in client.get_state().recordings for t in r.timelines if t.name == "time")
    seconds = (timeline.end or 0) * 1e-9 if time_s is None else time_s
    client.set_time("time", duration=seconds, play_state="paused")


def _check_recording(rrd: str | os.PathLike) -> Path:
    """Return the absolute path of a recording. Raises ViewerError if there is no such file."""
    path = Path(rrd)
    refuse_irregular(path, "recording", ViewerError)
    if not path.is_file():
        raise ViewerError(f"there is no recording {path}. Write one: recording.save({str(path)!r}).")
    return path.absolute()


def _wait_for_port(port: int, process: subprocess.Popen, deadline: float | None = None) -> None:
    """Wait until something listens on the port or the deadline has passed. Raises ViewerError if the process ends."""
    deadline = time.monotonic() + 30 if deadline is None else deadline
    while _is_port_free(port) and time.monotonic() < deadline:
        _check_process(process)
        time.sleep(0.1)


def _check_process(process: subprocess.Popen) -> None:
    """Raise ViewerError if rerun has ended."""
    if process.poll() is None:
        return
    messages = process.stderr.read().decode(errors="replace").strip() if process.stderr else ""
    panic = re.search(r"panicked at '?(.+?)'?$", messages, re.MULTILINE)
    cause = panic[1] if panic else (messages.split("\n")[0].rstrip(" .") or "it gave no reason")
    advice = ""
    if re.search("render context|adapter|wgpu|vulkan", messages, re.IGNORECASE):
        advice = (
            " Pictures need a Vulkan driver, also without a graphics card (Debian: apt install mesa-vulkan-drivers)."
        )
    raise ViewerError(f"rerun ended with code {process.returncode}: {cause}.{advice}")


def build_rerun_environment() -> dict[str, str]:
    """Return the environment of rerun's program: usage data off, unless PULSESTAGE_RERUN_ANALYTICS selects rerun's own settings."""
    return {**os.environ, **({} if _allows_analytics() else {"XDG_CONFIG_HOME": str(SETTINGS_FOLDER)})}


def _allows_analytics() -> bool:
    """Return whether rerun's own settings decide about usage data."""
    return os.environ.get("PULSESTAGE_RERUN_ANALYTICS", "0") not in ("", "0")


@contextmanager
def _run_rerun(command: list[str], stderr: int | None = None) -> Iterator[subprocess.Popen]:
    """Run rerun's program during the `with` block.

    It also ends if this process gets SIGTERM or SIGHUP and, on Linux, however this process ends.
    """
    prctl = getattr(ctypes.CDLL(None), "prctl", None) if sys.platform == "linux" else None
    with _exit_on_signals():
        process = subprocess.Popen(
            command,
            env=build_rerun_environment() | QUIET_ENVIRONMENT,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            preexec_fn=prctl and (lambda: prctl(PARENT_DEATH_SIGNAL, signal.SIGTERM)),
        )
        try:
            yield process
        finally:
            _end_process(process)


@contextmanager
def _exit_on_signals() -> Iterator[None]:
    """Turn SIGTERM and SIGHUP into SystemExit during the `with` block, so that open files and processes are closed."""

    def exit_process(signum: int, _frame: object) -> None:
        raise SystemExit(128 + signum)

    main = threading.current_thread() is threading.main_thread()
    before = {s: signal.signal(s, exit_process) for s in (signal.SIGTERM, signal.SIGHUP) if main}
    try:
        yield
    finally:
        for s, handler in before.items():
            signal.signal(s, handler)


def _end_process(process: subprocess.Popen) -> None:
    process.terminate()
    try:
        process.wait(5)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _is_port_free(port: int) -> bool:
    with socket.socket() as s:
        return s.connect_ex((LOOPBACK_ADDRESS, port)) != 0


def find_free_port() -> int:
    """Return a port on which nothing listens."""
    with socket.socket() as s:
        s.bind((LOOPBACK_ADDRESS, 0))
        return s.getsockname()[1]


def build_widget(recording: Recording) -> dict[str, Any]:
    """Return the dashboard of a recording as a Jupyter widget, by MIME type (extra `notebook`).

    The result is empty if rerun's widget is not installed or the recording is too long for a browser.
    """
    if not (is_installed("rerun") and is_installed("rerun_notebook")) or not 0 < len(recording) <= MAX_WIDGET_SAMPLES:
        return {}
    import rerun_notebook

    with tempfile.TemporaryDirectory(prefix="pulsestage-") as folder:
        data = recording.save(Path(folder) / "recording.rrd").read_bytes()
    viewer = rerun_notebook.Viewer(width=WIDGET_SIZE[0], height=WIDGET_SIZE[1])
    viewer.send_rrd(data)
    bundle: dict[str, Any]
    bundle, _ = viewer._repr_mimebundle_()
    return {kind: content for kind, content in bundle.items() if kind.startswith("application/")}
