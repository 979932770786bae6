"""The process of an IOC: its port, its prefix, its end."""

import socket
import subprocess
import sys

import pytest

from stage.testing.ioc_process import IocProcess

epics = pytest.importorskip("epics")


def run_ioc(*options):
    return subprocess.run([sys.executable, "-m", "stage", "ioc", *options], capture_output=True, text=True, timeout=60)


def test_a_port_in_use_is_refused_with_what_to_do():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        done = run_ioc("--port", str(other.getsockname()[1]))
    assert done.returncode == 2
    assert "Choose another --port" in done.stderr


@pytest.mark.parametrize("options", [("--pace", "0"), ("--rate", "1000"), ("--prefix", "a b"), ("nothing.xml",)])
def test_wrong_options_are_refused(options):
    done = run_ioc(*options)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def test_a_prefix_needs_no_colon_and_a_terminated_ioc_leaves_no_process():
    with IocProcess(prefix="OTHER", chips="stepdir") as ioc:
        assert epics.caget("OTHERx.RBV", timeout=10) == 0
        process = ioc.process
    assert process.poll() == 0


def test_a_killed_ioc_leaves_no_child_process():
    with IocProcess(prefix="KILLED:", chips="stepdir") as ioc:
        ioc.process.kill()
        ioc.process.wait()
        children = subprocess.run(["ps", "--ppid", str(ioc.process.pid), "-o", "pid="], capture_output=True, text=True)
    assert children.stdout.split() == []
