"""`stage serve`, as a stranger would type it."""

from __future__ import annotations

import os
import re
import signal
import socket
import threading
from contextlib import suppress

import pytest

from stage.cli import main
from stage.serve.client import ServerError, connect


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def served(port: int, *options: str) -> int:
    """The exit code of a server to which a host comes, and which is then ended."""

    def drive():
        while True:
            try:
                host = connect(f":{port}")
                break
            except ConnectionRefusedError:
                pass
        with host:
            host.out8(0x300, 0x08)
            host.log("here I am")
            host.in8(0x100)
            host.delay_us(2000)
            os.kill(os.getpid(), signal.SIGTERM)
            with suppress(ConnectionError, ServerError):
                while True:
                    host.delay_us(10**9)

    host = threading.Thread(target=drive)
    host.start()
    try:
        return main(["serve", "--model", "xy", "--chips", "pcl240mk", "--listen", str(port), *options])
    finally:
        host.join()


def test_stage_serve_runs_until_a_signal_and_writes_its_files(tmp_path, capsys):
    files = [str(tmp_path / name) for name in ("run.vcd", "run.txt")]
    port, before = free_port(), signal.getsignal(signal.SIGTERM)
    assert served(port, "--vcd", files[0], "--trace", files[1], "--place", "x=5") == 0
    out = capsys.readouterr()
    for part in (f"listening on 127.0.0.1:{port}", "drives, at", "here I am", "ended after", *files):
        assert part in out.out, part
    assert "1 bus cycles reached no chip" in out.out
    assert re.search(r"^x +(5\.00|4\.99)", out.out, re.M)
    assert not out.err
    assert "command" in (tmp_path / "run.txt").read_text() or "reset" in (tmp_path / "run.txt").read_text()
    assert signal.getsignal(signal.SIGTERM) is before
    assert main(["serve", "--trace", files[1]]) == 2, "files that exist are not written over"


def test_listening_on_other_addresses_prints_a_warning(capsys):
    assert served(free_port(), "--bind", "0.0.0.0") == 0
    assert "warning: other machines may reach 0.0.0.0, and there is no password" in capsys.readouterr().err


def test_a_name_of_this_machine_needs_no_warning(capsys):
    assert served(free_port(), "--bind", "localhost") == 0
    assert "warning" not in capsys.readouterr().err


def test_wrong_options_are_refused_with_an_explanation(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["serve", "--model", "xy", "--listen", "99999"])
    assert "0 (one that is free) to 65535" in capsys.readouterr().err
    assert main(["serve", "--fresh", "--vcd", "x.vcd"]) == 2
    assert "--fresh" in capsys.readouterr().err
    assert main(["serve", "--model", "xy", "--listen", "0", "--bind", "300.1.1.1"]) == 2
    reported = capsys.readouterr().err
    assert "nothing can listen on 300.1.1.1" in reported
    assert "--bind takes an address of this machine" in reported
    assert main(["serve", "--model", "xy", "--listen", "0", "--web", "--port", "0"]) == 2
    assert "a port is a whole number of 1 to 65535" in capsys.readouterr().err, "before it serves"
