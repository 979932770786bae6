"""`IocProcess`: `stage ioc` in a process of its own for tests, isolated from other IOCs; the fixture `ioc` starts one.

Clients of EPICS read their environment once, so all IOCs of a process take turns at one port. `isolate_clients` chooses it:
loopback only, and the port of the CA repeater is occupied, so that no client starts a repeater that would outlive the tests.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from time import monotonic, sleep
from typing import Self

from stage.errors import StageError

START_TIMEOUT_S = 120.0
END_TIMEOUT_S = 10.0
POLL_INTERVAL_S = 0.02
_repeater: list[socket.socket] = []


def isolate_clients() -> int:
    """Set the environment of EPICS clients and servers of this process to the loopback device and a free port, once.

    Returns:
        The port for IOCs.

    Raises:
        StageError: A client library has already read another environment.
    """
    if not _repeater:
        client = sys.modules.get("epics.ca")
        if client is not None and getattr(client, "libca", None) is not None:
            raise StageError(
                "pyepics has read its environment before the fixture `ioc` could set it: use no PV at import, or create "
                "devices in tests and fixtures that use `ioc`."
            )
        repeater = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        repeater.bind(("", 0))
        _repeater.append(repeater)
        os.environ.update(
            EPICS_CA_ADDR_LIST="127.0.0.1",
            EPICS_CA_AUTO_ADDR_LIST="NO",
            EPICS_CA_SERVER_PORT=str(_find_free_port()),
            EPICS_CA_REPEATER_PORT=str(repeater.getsockname()[1]),
        )
    return int(os.environ["EPICS_CA_SERVER_PORT"])


def _find_free_port() -> int:
    """Return a port that is free for TCP and UDP on the loopback device."""
    while True:
        with socket.socket() as tcp, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            tcp.bind(("127.0.0.1", 0))
            try:
                udp.bind(("127.0.0.1", tcp.getsockname()[1]))
            except OSError:
                continue
            return int(tcp.getsockname()[1])


class IocProcess:
    """IOC in a process of its own; a context manager.

    Args:
        model: Model of the stage.
        chips: Chips of the stage, as --chips of the command line.
        prefix: Prefix of the records.
        pace: Simulated seconds per second, or "free".
        options: Further options of `stage ioc`.

    Attributes:
        prefix: Prefix of the records.
        port: Port of the IOC.
        process: The process.
    """

    def __init__(
        self,
        model: str = "xyz",
        chips: str = "PCL240K",
        prefix: str = "STAGE:",
        pace: str | float = "free",
        options: Sequence[str] = (),
    ):
        self.prefix, self.port = prefix, isolate_clients()
        self._log = tempfile.TemporaryFile("w+")  # noqa: SIM115  the process writes to it until `close`
        command = [
            sys.executable, "-m", "stage", "ioc", model, "--chips", chips, "--prefix", prefix, "--pace", str(pace), "--port",
            str(self.port), *options,
        ]  # fmt: skip
        self.process = subprocess.Popen(command, stdout=self._log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
        self._wait_until_ready()

    @property
    def output(self) -> str:
        """Everything that the process has printed."""
        self._log.seek(0)
        return self._log.read()

    def _wait_until_ready(self) -> None:
        end = monotonic() + START_TIMEOUT_S
        while f"port {self.port};" not in self.output:
            if self.process.poll() is not None or monotonic() > end:
                self.process.kill()
                raise StageError(f"the IOC did not start:\n{self.output}")
            sleep(POLL_INTERVAL_S)

    def close(self) -> None:
        """End the process."""
        self.process.terminate()
        try:
            self.process.wait(END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._log.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
