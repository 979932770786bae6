"""One host drives, others look; whoever comes, goes or fails, the stage stands where it stood."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress

import pytest
from support.served import serving

from stage import StageError
from stage.board import get_include_folder
from stage.serve import client, server
from stage.serve.client import ServerError

PORT = 0x300


def start_a_move(host, pulses=100, interrupt=False):
    """X moves at 1000 pps."""
    batch = host.batch().out8(PORT, 0x08)
    for register, value in ((0, pulses), (1, 50), (7, 30)):
        batch.out8(PORT, 0x80 | register)
        for byte in (2, 1, 0):
            batch.out8(PORT + 1 + byte, value >> 8 * byte & 0xFF)
    batch.out8(PORT, 0x44).out8(PORT, 0x30 if interrupt else 0x10).run()


def test_about_describes_the_board(served):
    with served.host() as host:
        assert host.about["axes"] == {"x": "m", "y": "m"}
        assert host.about["chips"][1] == {"chip": "PCL240MK", "axes": "y", "port": 0x304, "layout": "pcl240"}
        assert host.about["bus_cycle_ns"] == 1000
        assert host.about["devices"] == []


def test_one_host_drives_and_others_observe(served):
    with served.host() as host:
        with pytest.raises(ServerError, match=r"127\.0\.0\.1:\d+ drives this stage, one host at a time"):
            served.host()
        with served.host(observe=True) as watcher:
            start_a_move(host)
            host.delay_us(1_000_000)
            assert watcher.positions()["x"].commanded == pytest.approx(100 * 3.125e-6)
            assert watcher.positions()["x"].lost_steps == 0
            assert watcher.status() == (served.board.stage.time, served.board.cycles, False)
            assert watcher.pin("x.switches.org") is watcher.pin("x.org") is False
            before = served.state()
            for drives in (
                lambda: watcher.in8(PORT),
                watcher.reset,
                lambda: watcher.restore("start"),
                lambda: watcher.log("!"),
            ):
                with pytest.raises(ServerError, match="this connection only observes"):
                    drives()
            with pytest.raises(ServerError, match="only observes"):
                watcher.stick("x.org", True)
            assert served.state() == before
    again(served).close()
    assert [line.split(" ", 1)[1].split(",")[0] for line in served.said[:3]] == ["drives", "drives no more", "drives"]


def test_the_next_host_continues_where_the_last_one_stopped(board):
    with serving(board) as served:
        with served.host() as host:
            start_a_move(host)
            host.on_interrupt(lambda: None)
            now = host.status().seconds
        with again(served) as host:
            assert host.status().seconds == now
            assert host.in8(PORT) & 0x40, "the axis is moving still"
            assert not board.link.hooks.functions, "nobody is called for a host that is gone"


def test_with_fresh_each_host_begins_at_the_start(board):
    with serving(board, fresh=True) as served:
        begin = board.stage.snapshot().state.tobytes()
        with served.host() as host:
            start_a_move(host)
        with again(served):
            assert board.stage.snapshot().state.tobytes() == begin


def again(served):
    """The next host, when the server has seen that the last one is gone."""
    for _ in range(100):
        try:
            return served.host()
        except ServerError:
            time.sleep(0.01)
    raise AssertionError("the host before has not been let go")


@pytest.mark.parametrize("what", ["the host goes", "the server stops"])
def test_a_very_long_delay_ends_when_its_host_disconnects(board, what):
    with serving(board) as served:
        host, watcher = served.host(), served.host(observe=True)

        def wait():
            with suppress(ServerError, OSError):
                host.delay_us(10**15)

        waits = threading.Thread(target=wait)
        waits.start()
        while watcher.status().seconds == 0:  # who looks is answered meanwhile
            pass
        if what == "the host goes":
            host._wire.shutdown(2)
            waits.join()
            again(served).close()
        else:
            served.server.stop()
            waits.join()
        watcher.close()
        host.close()
    assert 0 < board.stage.time < 1000


def test_pins_switches_and_reset(served):
    with served.host() as host:
        host.stick("x.el_plus", True)
        assert host.pin("x.el_plus")
        assert host.pin("x.switches.el_plus")
        host.stick("x.el_plus", None)
        assert not host.pin("x.el_plus")
        start_a_move(host)
        assert host.in8(PORT) & 0x40
        host.reset()
        assert not host.in8(PORT) & 0x40
        for wrong, message in (
            ("q.org", "unknown axis 'q'.*Write AXIS.PIN"),
            ("x.orgg", "Did you mean 'org'"),
            ("x.switches.no", "unknown switch"),
        ):
            with pytest.raises(ServerError, match=message):
                host.pin(wrong)
        with pytest.raises(ServerError, match="unknown switch of axis x 'alarm'"):
            host.stick("x.alarm", True)


def test_snapshots_are_saved_and_restored_by_name(served):
    with served.host() as host:
        start_a_move(host)
        host.snapshot("moving")
        first = host.batch().until8(PORT, 0x40, 0, 100_000).micros().run()
        state = served.state()[0]
        host.restore("moving")
        assert host.batch().until8(PORT, 0x40, 0, 100_000).micros().run() == first
        assert served.state()[0] == state
        host.restore()
        assert host.status().seconds == 0
        with pytest.raises(ServerError, match=r"unknown snapshot 'mowing'\. Did you mean 'moving'"):
            host.restore("mowing")
        with pytest.raises(ServerError, match="choose another name"):
            host.snapshot("start")
        for k in range(99):
            host.snapshot(str(k))
        with pytest.raises(ServerError, match="100 are kept"):
            host.snapshot("one more")
        host.snapshot("moving")
        with served.board.stage.record(), pytest.raises(ServerError, match="runs forward only"):
            host.restore()


def test_a_mistake_in_a_later_frame_of_a_batch_comes_with_the_answers_before_it(served):
    """batch.in8(0x500) 40,000 times, batch.out8(0x300, 999), batch.run()"""
    with served.host() as host:
        batch = host.batch()
        for _ in range(40_000):
            batch.in8(0x500)
        with pytest.raises(ServerError, match="the value does not fit") as failed:
            batch.out8(PORT, 999).run()
        assert failed.value.answers == (0xFF,) * 32_768


def test_a_closed_connection_is_a_clear_error(served):
    """board.close(); board.in8(0x300)"""
    host = served.host()
    with pytest.raises(ValueError, match="a frame of 2,000,000 bytes; there are up to 1,048,576"):
        host.log("x" * 2_000_000)
    assert host.status().cycles == 0, "nothing was sent"
    host.close()
    with pytest.raises(ConnectionError, match=r"this connection is closed\. Make another one"):
        host.in8(PORT)
    host = served.host(observe=True)
    host._wire.shutdown(socket.SHUT_RDWR)
    for _ in range(2):
        with pytest.raises(ConnectionError, match=r"the server has closed the connection\. Make another one"):
            host.status()
    host.close()


def test_what_a_host_logs_does_not_control_the_terminal(served):
    """board.log("\\x1b[2J\\nforged")"""
    with served.host() as host:
        host.log("\x1b[2J\n  1.000000  forged\r\x9b\t\u00b5m\n")
    assert served.board.log[-1][1] == r"\x1b[2J\n  1.000000  forged\r\x9b" + "\t\u00b5m"
    assert served.said[1].endswith("\t\u00b5m"), "one line, and the same one"


def test_log_lines_are_reported_and_their_number_is_limited(board):
    with serving(board, keep=8) as served, served.host() as host:
        for k in range(30):
            host.log(f"line {k}")
        with pytest.raises(ServerError, match="a line has up to 65,536"):
            host.log("x" * 65537)
        assert served.said[-1].split() == ["0.000000", "line", "29"]
        assert board.log[-1] == (0.0, "line 29")
        assert 8 <= len(board.log) <= 10


def test_an_interrupt_calls_the_host_s_hook_in_the_middle_of_its_batch(served):
    observed = []
    with served.host() as host:

        def hook():
            observed.append((host.in8(PORT + 2), host.micros()))
            host.out8(PORT, 0x08)

        host.on_interrupt(hook)
        start_a_move(host, 10, interrupt=True)
        begin, end = host.batch().micros().delay_us(100_000).micros().run()
        assert len(observed) == 1
        assert begin < observed[0][1] < end
        assert end == begin + 100_000 + 1, "the hook is part of the delay"
        assert "the hook is called" in str(served.board.trace)
        host.on_interrupt(None)


def test_a_hook_that_fails_or_does_not_clear_is_reported(served):
    with served.host() as host:
        host.on_interrupt(lambda: 1 / 0)
        start_a_move(host, 10, interrupt=True)
        with pytest.raises(ZeroDivisionError):
            host.delay_us(100_000)
        with pytest.raises(ServerError, match="1,000 times in a row") as failed:
            host.on_interrupt(lambda: None)
        assert failed.value.answers == ()
        host.on_interrupt(None)
        assert host.line()


def test_timers_of_a_host_that_is_gone_stay_off_whatever_the_next_restores(served):
    with served.host() as host:
        host.on_timer(1000, lambda: None, n=1)
    with again(served) as host:
        host.restore()
        host.delay_us(5000)
    assert "timer" not in str(served.board.trace)


def test_a_host_that_disconnects_in_its_hook_is_released(served):
    host = served.host()
    host.on_interrupt(host.close)
    start_a_move(host, 10, interrupt=True)
    with pytest.raises((OSError, ServerError)):
        host.delay_us(10**15)
    with again(served) as next_host:
        assert next_host.status().seconds < 1
        assert not served.board.link.record["serving"]
        assert next_host.line(), "nobody has cleared it"
        next_host.delay_us(1000)


def test_a_host_that_sends_no_frame_in_its_hook_is_disconnected(served):
    host = served.host()
    host.on_interrupt(lambda: host._wire.sendall(client.HEAD.pack(client.MAX_BODY + 1, client.BATCH, 1)))
    start_a_move(host, 10, interrupt=True)
    with pytest.raises((OSError, ServerError)):
        host.delay_us(10**15)
    with again(served) as next_host:
        assert next_host.status().seconds < 1, "its delay is over"
        next_host.delay_us(1000)
    host.close()


def test_the_answers_before_a_failure_come_with_it(served, monkeypatch):
    with served.host() as host:
        host.on_interrupt(lambda: 1 / 0)
        start_a_move(host, 10, interrupt=True)
        monkeypatch.setattr(host, "_failed", None)
        monkeypatch.setattr(host, "_hooks", {})  # clears nothing
        with pytest.raises(ServerError, match="1,000 times") as failed:
            host.batch().micros().in8(PORT + 0x100).delay_us(100_000).micros().run()
        assert len(failed.value.answers) == 2
        assert failed.value.answers[1] == 0xFF


def test_a_batch_with_a_wrong_entry_is_refused_entirely(served):
    with served.host() as host:
        before = served.state()
        for wrong, message in (
            (host.batch().out8(PORT, 256), "entry 1: OUT8 300h <- 256; the value does not fit"),
            (host.batch().delay_us(-1), "entry 1: DELAY -1 us; there are 0 to 1e15 us"),
            (host.batch().in8(-1), "entry 1: IN8 at port -1; ports are 0 to FFFFFFFFh"),
            (host.batch().add(77), "entry 1: 77 is no request; those of a batch are 0 IN8, 1 OUT8"),
            (host.batch().until8(PORT, 1, 1, 0), "entry 1: UNTIL8 0 times, every 0 us"),
        ):
            batch = host.batch().in8(PORT)
            batch._entries += wrong._entries
            with pytest.raises(ServerError, match=message):
                batch.run()
        with pytest.raises(ServerError, match="an entry has 32"):
            host.request(client.BATCH, b"12345")
        assert served.state() == before
        with pytest.raises(ValueError, match="no such request"):
            host.batch().until8(PORT, 1, 1, 1 << 31)
        assert host.batch().run() == []


def test_a_batch_of_more_than_a_frame_is_sent_in_several(served):
    with served.host() as host:
        batch = host.batch()
        for _ in range(40_000):
            batch.in8(0x500)
        assert batch.run() == [0xFF] * 40_000
        assert host.status().cycles == served.board.cycles == 40_000


def test_batches_make_100_000_cycles_a_second_and_more(served):
    with served.host() as host:
        best = 0.0
        for _ in range(5):
            batch = host.batch()
            for _ in range(20_000):
                batch.in8(PORT)
            begin = time.perf_counter()
            batch.run()
            best = max(best, 20_000 / (time.perf_counter() - begin))
    assert best >= 100_000


def test_a_host_of_another_version_or_role_is_refused_in_words(served):
    with pytest.raises(ServerError, match="the host speaks version 3 of the frames, and this server version 1"):
        _greets(served, 3)
    with pytest.raises(ServerError, match="role 2: 0 drives, 1 observes"):
        _greets(served, 1, role=2)


def _greets(served, version, role=0):
    class Other(client.Client):
        def request(self, kind, body=b""):
            return super().request(kind, client.GREETING.pack(client.MAGIC, version, role))

    with socket.create_connection(served.server.address) as wire:
        Other(wire)


def test_the_number_of_connected_hosts_is_limited(served):
    hosts = [served.host(observe=True) for _ in range(server.MAX_HOSTS)]
    with pytest.raises(ServerError, match="16 hosts are connected, and no more can be"):
        served.host(observe=True)
    for host in hosts:
        assert host.status().cycles == 0
        host.close()


def test_an_unreachable_or_invalid_address_is_explained(served):
    with pytest.raises(ConnectionRefusedError, match=r"nobody listens at 127\.0\.0\.1, port 1\. Start a server there"):
        client.connect(":1")
    with pytest.raises(ValueError, match="'here:there': an address is HOST:PORT"):
        client.connect("here:there")


def test_two_servers_do_not_listen_on_one_port(served):
    with pytest.raises(StageError, match=r"nothing can listen on 127\.0\.0\.1, port \d+: .* Choose another"):
        server.Server(served.board, port=served.server.address[1])
    with pytest.raises(StageError, match="65535"):
        server.Server(served.board, port=70_000)


def test_the_client_is_one_file_that_needs_python_only(served, tmp_path):
    shutil.copy(client.__file__, tmp_path / "client.py")
    program = (
        "import sys, client\n"
        f"with client.connect({served.address!r}) as host:\n"
        "    print(host.in8(0x300), host.positions()['y'].lost_steps, len({'mujoco', 'numpy', 'stage'} & set(sys.modules)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-S", "-c", program],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env={"PATH": ""},
    )
    assert (done.stdout.split(), done.stderr) == (["168", "0", "0"], "")


def test_the_client_s_numbers_are_those_of_the_board():
    from stage.board.bus import host_record, request_batch

    for name in ("IN8", "OUT8", "IN16", "OUT16", "IN32", "OUT32", "DELAY", "MICROS", "LINE", "SPEND"):
        assert getattr(client, name) == getattr(host_record, name)
    for name in ("UNTIL8", "UNTIL16", "UNTIL_LINE"):
        assert getattr(client, name) == getattr(request_batch, name)
    assert client.ENTRY.size == request_batch.ENTRY.itemsize
    header = (get_include_folder() / "pulsestage_remote.h").read_text()
    assert (
        "PS_F_HELLO = 1, PS_F_BATCH, PS_F_LOG, PS_F_HOOK, PS_F_RETURN, PS_F_TIMER = 13, PS_F_INTERRUPT = 254, PS_F_ERROR = 255"
        in header
    )
    assert (client.HELLO, client.BATCH, client.LOG, client.HOOK, client.RETURN) == (1, 2, 3, 4, 5)
    assert (client.INTERRUPT, client.ERROR) == (254, 255)
    assert "PS_UNTIL8 = 100, PS_UNTIL16, PS_UNTIL_LINE, PS_F_VERSION = 1, PS_F_HEAD = 12, PS_F_ENTRY = 32" in header
    assert (client.VERSION, client.HEAD.size, client.ENTRY.size, client.PORT) == (1, 12, 32, 7240)
    assert ": 7240" in header
