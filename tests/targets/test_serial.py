"""The serial line of firmware: its bytes take their time, and the same ones give the same run; ends outside come and go."""

import json
import os
import random
import re
import select
import shlex
import socket
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from support.pages import steps
from support.target_boards import board_of

from stage import Stage
from stage.board import Board, NativeHost
from stage.board.serial_pty_and_tcp import open_end
from stage.board.serial_script import format_script, read_script
from stage.chips import PCL240K
from stage.cli import main
from stage.cli.panel import run_in_real_time
from stage.errors import ArgumentError, RunTimeout, StageError
from stage.targets import TargetHost, supported_processors

DATA = Path(__file__).parent / "data"
PAGE = Path(__file__).parents[2] / "docs" / "serial.md"
PINS = "data=A,address=C:0-3,cs=B0,wr=G0,rd=G1"
RUN = ["run", str(DATA / "serial.avr.elf"), "--mcu", "atmega2560", "--map", PINS, "--chips", "pcl240k"]
SPEED_115200, FRAME_8E2, OFF_10_MS, END, BUSY_10_MS = (bytes([code]) for code in (1, 2, 3, 4, 5))
BYTE_NS = {
    "19200 8N1": 10 * 16 * 52 * 1e3 / 16,
    "115200 8N1": 10 * 8 * 17 * 1e3 / 16,
    "115200 8E2": 12 * 8 * 17 * 1e3 / 16,
}
"""Time of a character from the divisor of the data sheet's table, UBRR + 1, and the clock of 16 MHz."""
needs_simavr = pytest.mark.skipif(
    not supported_processors.has_simavr(), reason=f"there is no {supported_processors.SIMAVR_REQUIREMENT}"
)


@pytest.fixture(params=[True, False], ids=["isolated", "in process"])
def echo(request):
    with TargetHost(DATA / "serial.avr.elf", board_of(), mcu="atmega2560", map=PINS, isolated=request.param) as host:
        yield host


@pytest.fixture
def quick_echo():
    with TargetHost(DATA / "serial.avr.elf", board_of(), mcu="atmega2560", map=PINS, isolated=False) as host:
        yield host


@needs_simavr
def test_a_program_reads_what_is_written_and_answers(echo):
    assert echo.serial.read_until("ready\r\n") == "ready\r\n"
    echo.serial.write("one two")
    assert echo.serial.read_until(b"two") == b"one two"
    echo.serial.write("<MPos:-1.500>")
    match = echo.serial.expect(r"MPos:([^>]+)>")
    assert match[1] == "-1.500"
    assert echo.serial.read() == b"", "what stands before the end of a match is read"
    echo.serial.write(END)
    assert echo.run(timeout=1).code == len("one two<MPos:-1.500>") + 1


@needs_simavr
def test_both_kinds_of_process_give_the_same_times():
    times = []
    for isolated in (True, False):
        with TargetHost(DATA / "serial.avr.elf", board_of(), mcu="atmega2560", map=PINS, isolated=isolated) as host:
            host.serial.read_until("ready")
            host.serial.write("abc")
            host.serial.expect("b")
            host.serial.write(SPEED_115200 + b"def")
            host.serial.read_until("f")
            times.append((host.board.stage.now, host.log, host.board.stage.state.world.tobytes()))
    assert times[0] == times[1]


@needs_simavr
@pytest.mark.parametrize(
    ("settings", "answer", "rate"),
    [
        (b"", "ready\r\n", "19200 8N1"),
        (SPEED_115200, "115200\n", "115200 8N1"),
        (SPEED_115200 + FRAME_8E2, "8E2\n", "115200 8E2"),
    ],
)
def test_each_byte_takes_its_bits_at_the_rate_of_the_program(quick_echo, settings, answer, rate):
    serial, stage, count = quick_echo.serial, quick_echo.board.stage, 60
    serial.write(settings)
    serial.read_until(answer)
    begin = stage.now
    serial.write("a" * count)
    serial.read_until("a" * count)
    took = (stage.now - begin) / BYTE_NS[rate]
    assert count + 1 <= took < count + 3, "to the program one behind the other, and the last one back"


@needs_simavr
def test_bytes_wait_until_the_program_has_turned_its_receiver_on(quick_echo):
    quick_echo.serial.write("early")
    assert quick_echo.serial.read_until("early") == "ready\r\nearly"
    quick_echo.serial.write(OFF_10_MS + b"late")
    assert quick_echo.serial.read_until("late") == "on\nlate"


@needs_simavr
def test_bytes_that_a_busy_program_does_not_read_are_lost_when_the_receiver_is_full(quick_echo):
    quick_echo.serial.write(SPEED_115200)
    quick_echo.serial.read_until("115200\n")
    content = bytes(range(32, 142))  # 110 characters of 85 us
    quick_echo.serial.write(BUSY_10_MS + content)
    quick_echo.run_for(0.03)
    assert quick_echo.serial.read() == content[:64]
    quick_echo.serial.write("again\n")
    assert quick_echo.serial.read_until("\n") == "again\n"
    assert [text for _, text in quick_echo.log if "lost" in text] == [
        "UART: a byte was lost: the program had not read the 64 before it, of which a chip holds three (data overrun); "
        "it is said once"
    ]


@needs_simavr
def test_no_byte_is_lost_or_doubled(quick_echo):
    seed = random.randrange(1 << 32)
    content = bytes(byte for byte in random.Random(seed).randbytes(5200) if byte > 5)
    assert len(content) > 4096, "more than the buffers between firmware and board have room for"
    quick_echo.serial.write(SPEED_115200)
    quick_echo.serial.read_until("115200\n")
    quick_echo.serial.write(content + b"end")
    assert quick_echo.serial.read_until(b"end", timeout=2) == content + b"end", f"seed {seed}"


@needs_simavr
def test_what_does_not_come_is_an_error_with_what_has_come(quick_echo):
    with pytest.raises(
        RunTimeout, match=r"has not sent 'Grbl' over its serial line within 0.02 s .* It has sent 'ready\\r\\n'"
    ):
        quick_echo.serial.read_until("Grbl", timeout=0.02)
    quick_echo.serial.write(END)
    with pytest.raises(RunTimeout, match=r"has not sent b'ok' over its serial line before it returned"):
        quick_echo.serial.read_until(b"ok")
    with pytest.raises(ArgumentError, match="no regular expression"):
        quick_echo.serial.expect("(")
    with pytest.raises(ArgumentError, match="bytes, or text whose characters are bytes"):
        quick_echo.serial.write("\N{EURO SIGN}")


PC_ECHO = bytes.fromhex(
    "BAFB03 B083 EE BAF803 B001 EE 42 30C0 EE BAFB03 B003 EEBAFD03 EC A801 74F8 BAF803 EC 3C04 7403 EE EBED B8054C CD21"
)
"""Sets COM1 to 115200 baud, echoes each byte, and ends with code 5 after a byte 4."""


@pytest.mark.skipif(
    not supported_processors.has_unicorn(), reason=f"there is no {supported_processors.UNICORN_REQUIREMENT}"
)
def test_a_pc_has_a_serial_line_if_a_16550_is_on_its_bus(tmp_path):
    program = tmp_path / "echo.com"
    program.write_bytes(PC_ECHO)
    with (
        TargetHost(program, board_of(), mcu="8086", isolated=False) as host,
        pytest.raises(
            StageError, match=r"echo.com: a PC's serial line is a 16550 on its bus. Add one: --device uart:0x3F8."
        ),
    ):
        host.serial.write("hello")
    board = Board(Stage("xy", chips=PCL240K, visuals=False), devices=["uart:0x3F8"])
    with TargetHost(program, board, mcu="8086", isolated=False) as host:
        host.serial.write("hello")
        assert host.serial.read_until("hello") == "hello"
        host.serial.write(END)
        assert host.run(timeout=1).code == 5


@pytest.mark.skipif(
    not supported_processors.has_unicorn(), reason=f"there is no {supported_processors.UNICORN_REQUIREMENT}"
)
def test_a_cortex_without_a_16550_says_how_it_gets_one():
    with (
        TargetHost(
            DATA / "faults.m3.elf", board_of(), mcu="cortex-m3", map="0x40021000=0x300+0x40", isolated=False
        ) as host,
        pytest.raises(StageError, match=r"UARTs of Cortex-M parts .* not emulated. Put a 16550 on the bus"),
    ):
        host.serial.read_until("ready")


# --- scripts ---


def write_script(folder: Path, *lines: str) -> str:
    path = folder / "job.txt"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return str(path)


@needs_simavr
def test_a_script_sends_expects_and_waits_in_simulated_time(tmp_path, capsys):
    lines = (
        "# a comment",
        'expect "ready\\r\\n"',
        "send hello",
        "expect hello",
        "wait 100ms",
        "at 0.25",
        'send "\\x04"',
        "wait 1",
    )
    script = write_script(tmp_path, *lines)
    assert main([*RUN, "--serial-script", script]) == 1, "a code other than 0"
    output = capsys.readouterr().out
    assert "serial.avr.elf returned 7 after 0.25" in output, (
        "six bytes, and the one that ends it, at 0.25 s and a character"
    )
    assert re.search(r"^ +0\.00\d+  hello$", output, re.M)


@needs_simavr
def test_a_run_ends_with_its_script_unless_for_says_how_long_it_lasts(tmp_path, capsys):
    script = write_script(tmp_path, "expect ready", "wait 20ms")
    assert main([*RUN, "--serial-script", script]) == 0
    assert re.search(r"ran for 0\.02\d+ s", capsys.readouterr().out)
    assert main([*RUN, "--serial-script", script, "--for", "0.1"]) == 0
    assert "ran for 0.1 s" in capsys.readouterr().out


@needs_simavr
@pytest.mark.parametrize("option", ["--for", "--timeout"])
def test_a_script_that_is_cut_off_by_the_end_of_the_run_fails(tmp_path, capsys, option):
    script = write_script(tmp_path, "expect ready", "expect never")
    assert main([*RUN, "--serial-script", script, option, "0.05"]) == 1
    message = f"job.txt is not over after 0.05 s of simulated time: line 2 waits. {option} allows more."
    assert message in capsys.readouterr().err


@needs_simavr
@pytest.mark.parametrize(
    ("lines", "characters"), [(["expect ready"], len("readyhello\n")), (["# only this"], len("hello\n"))]
)
def test_a_script_that_ends_with_send_ends_when_the_last_byte_has_arrived(tmp_path, capsys, lines, characters):
    script = write_script(tmp_path, *lines, "send hello")
    assert main([*RUN, "--serial-script", script, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert 0 <= facts["seconds"] - characters * BYTE_NS["19200 8N1"] * 1e-9 < 0.003
    assert facts["serial"]["sent"] == len("hello\n")
    assert "ends with send, so the run has ended when the firmware had received it" in facts["warnings"][0]


@needs_simavr
def test_a_run_with_for_continues_after_a_script_that_ends_with_send(tmp_path, capsys):
    assert main([*RUN, "--serial-script", write_script(tmp_path, "send hello"), "--for", "0.05"]) == 0
    captured = capsys.readouterr()
    assert "hello" in captured.out
    assert "ran for 0.05 s" in captured.out
    assert not captured.err


def test_a_script_whose_bytes_nobody_reads_fails(tmp_path, capsys):
    source = tmp_path / "deaf.c"
    source.write_text("#include <pulsestage.h>\nPULSESTAGE_MAIN { for (;;) ps_delay_us(100); }", encoding="utf-8")
    script = write_script(tmp_path, "send hello")
    assert main(["run", str(source), "--serial-script", script, "--timeout", "0.1"]) == 1
    assert "the firmware has not received 6 of its bytes. --timeout allows more." in capsys.readouterr().err


def test_a_script_may_send_more_than_the_line_holds_and_wait(tmp_path):
    source = tmp_path / "deaf.c"
    source.write_text("#include <pulsestage.h>\nPULSESTAGE_MAIN { for (;;) ps_delay_us(100); }", encoding="utf-8")
    script = write_script(tmp_path, f"send {'x' * 5000}", "wait 20ms", "send y", "wait 1")
    with NativeHost(source, Board(Stage("xy", visuals=False)), isolated=False) as host:
        host.serial.connect(read_script(script))
        host.run_for(0.1)
        assert host.board.stage.time == pytest.approx(0.1)


@needs_simavr
def test_a_time_that_has_passed_is_refused_at_its_line(tmp_path, capsys):
    script = write_script(tmp_path, "at 0.03", "at 0.01", "send hello")
    assert main([*RUN, "--serial-script", script]) == 1
    error = capsys.readouterr().err
    assert "job.txt:2: at 0.01 comes too late, at 0.03 s of the run. Use wait, or give a later time." in error


@pytest.mark.parametrize("lines", [[""], ["# nothing"], ["timeout 3"]])
def test_a_script_that_does_nothing_is_refused(tmp_path, lines):
    with pytest.raises(ArgumentError, match=r"job.txt: this script does nothing. Write send, expect, wait or at"):
        read_script(write_script(tmp_path, *lines))


@needs_simavr
def test_the_line_of_closed_firmware_is_an_error(quick_echo):
    quick_echo.serial.read_until("ready")
    quick_echo.close()
    now = quick_echo.board.stage.now
    for use in (lambda: quick_echo.serial.read_until("x"), lambda: quick_echo.serial.write("x")):
        with pytest.raises(StageError, match=r"serial.avr.elf was closed, so nothing is at its serial line."):
            use()
    assert quick_echo.board.stage.now == now
    quick_echo.run_for(0.001)
    assert "ready" in quick_echo.serial.read_until("ready")


@needs_simavr
def test_a_script_that_waits_in_vain_fails_at_its_line(tmp_path, capsys):
    script = write_script(tmp_path, "expect ready", "timeout 30ms", "expect ok")
    assert main([*RUN, "--serial-script", script]) == 1
    error = capsys.readouterr().err
    assert r"job.txt:3: the firmware has not sent 'ok' within 0.03 s. It has sent '\r\n'." in error


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("say hello", "job.txt:1: 'say' is no command of a serial script; known are send, expect, wait, at, timeout."),
        ("wait long", "job.txt:1: 'wait long': a simulated time is wanted, for example wait 0.5 or wait 500ms."),
        ("expect", "job.txt:1: what is expected? For example: expect ok"),
        ('send "open', "job.txt:1: \"open: a text in quotes with the escapes of Python is wanted"),
    ],
)  # fmt: skip
def test_a_line_that_is_no_command_is_refused(tmp_path, line, words):
    with pytest.raises(ArgumentError, match=re.escape(words)):
        read_script(write_script(tmp_path, line))


@needs_simavr
@pytest.mark.slow
def test_the_script_of_the_page_homes_and_moves(tmp_path, monkeypatch, capsys):
    page_steps = steps(PAGE)
    (script,) = (step.text for step in page_steps if step.file == "job.txt")
    (commands,) = (step.text for step in page_steps if "--serial-script job.txt" in step.text)
    monkeypatch.chdir(tmp_path)
    Path("job.txt").write_text(script, encoding="utf-8")
    for command in commands.splitlines():
        assert main(shlex.split(command.removeprefix("stage "))) == 0
    assert re.search(r"^x +-139\.99\d\d +-139\.9969 +0 ", capsys.readouterr().out, re.M), (
        "10 mm from where it was at rest"
    )


def test_a_line_has_one_other_end(tmp_path, capsys):
    script = write_script(tmp_path, "wait 1")
    assert main([*RUN, "--serial-script", script, "--serial", "pty"]) == 2
    assert "a serial line has one other end" in capsys.readouterr().err


# --- ends outside simulated time ---


class Client:
    """A program that opens a pseudo-terminal, or connects to a port."""

    def __init__(self, end):
        self.socket = socket.create_connection(("127.0.0.1", end.port)) if hasattr(end, "port") else None
        self.file = self.socket.fileno() if self.socket else os.open(end.path, os.O_RDWR | os.O_NOCTTY)

    def read(self) -> bytes:
        content = b""
        while select.select([self.file], [], [], 0.05)[0] and (more := os.read(self.file, 4096)):
            content += more
        return content

    def close(self):
        self.socket.close() if self.socket else os.close(self.file)


@pytest.fixture(params=["pty", "tcp:0"])
def end(request):
    opened = open_end(request.param)
    yield opened
    opened.close()


@needs_simavr
def test_a_sender_connects_again_while_the_run_continues(quick_echo, end):
    quick_echo.serial.connect(end)
    quick_echo.run_for(0.02)
    for text in (b"first", b"second"):
        client = Client(end)
        quick_echo.run_for(0.01)
        os.write(client.file, text)
        quick_echo.run_for(0.05)
        greeting = b"ready\r\n" if text == b"first" else b""
        assert client.read() == greeting + text, "who connects first gets what was sent before"
        os.write(client.file, b"lost")
        client.close()
        quick_echo.run_for(0.05)
    assert quick_echo.serial.written == len("first" + "lost" + "second" + "lost")


@needs_simavr
def test_the_log_of_a_line_repeats_the_run_bit_for_bit(tmp_path):
    logs, end = [], open_end("tcp:0")
    with TargetHost(DATA / "serial.avr.elf", board_of(), mcu="atmega2560", map=PINS, isolated=False) as host:
        host.serial.connect(end)
        client = Client(end)
        for content in (b"G0 X1\n", b"\x01", b"'\"\\\xff?"):
            host.run_for(0.0123)
            os.write(client.file, content)
        host.run_for(0.05)
        client.close()
        end.close()
        assert host.serial.written == 6 + 1 + 5
        script = tmp_path / "log.txt"
        script.write_text(
            format_script(host.serial.arrivals, host.board.stage.now - host.serial.connected_at), encoding="utf-8"
        )
        logs.append((host.log, host.board.stage.now, host.board.stage.state.world.tobytes()))
    with TargetHost(DATA / "serial.avr.elf", board_of(), mcu="atmega2560", map=PINS) as host:
        host.serial.connect(read_script(script))
        host.run_for(1)
        logs.append((host.log, host.board.stage.now, host.board.stage.state.world.tobytes()))
    assert logs[0] == logs[1]
    assert [text for _, text in logs[0][0]] == ["ready", "G0 X1", "115200"]


@needs_simavr
def test_a_panel_runs_firmware_with_a_connected_line(quick_echo, tmp_path):
    quick_echo.serial.connect(read_script(write_script(tmp_path, "expect ready", "send hello", "expect hello")))
    pieces = []
    session = SimpleNamespace(catch_up_interval_s=0.004, catch_up=lambda: pieces.append(quick_echo.board.stage.time))
    assert run_in_real_time(session, quick_echo, None, 10) is None
    assert pieces
    assert quick_echo.board.stage.time < 0.02, "it ends with the script"


def test_a_log_of_the_line_needs_an_end_and_replaces_no_file(tmp_path, capsys):
    log = tmp_path / "log.txt"
    log.write_text("mine", encoding="utf-8")
    assert main([*RUN, "--serial-log", str(log)]) == 2
    assert "--serial-log: it needs an end whose bytes it writes" in capsys.readouterr().err
    assert main([*RUN, "--serial", "tcp:0", "--serial-log", str(log)]) == 2
    assert "exists. Choose another name, or give --force." in capsys.readouterr().err


@needs_simavr
def test_the_command_writes_the_log_of_the_line(tmp_path, capsys):
    log = tmp_path / "log.txt"
    assert main([*RUN, "--serial", "tcp:0", "--serial-log", str(log), "--for", "0.02"]) == 0
    assert f"{log}: 0 bytes that came in over the serial line" in capsys.readouterr().out
    assert log.read_text(encoding="utf-8").endswith("at 0.020000000\n")


def test_a_link_leads_to_the_pseudo_terminal_while_it_is_open(tmp_path):
    link = tmp_path / "board"
    first = open_end(f"pty:{link}")
    assert first.describe() == str(link)
    assert link.resolve().is_char_device()
    with pytest.raises(ArgumentError, match=r"--serial pty:.*board: File exists"):
        open_end(f"pty:{link}")
    first.close()
    assert not link.is_symlink()


def test_a_port_in_use_is_one_sentence():
    first = open_end("tcp:0")
    with pytest.raises(ArgumentError, match=rf"--serial tcp:{first.port}: Address already in use. Choose another port"):
        open_end(f"tcp:{first.port}")
    first.close()


def test_a_port_that_tcp_does_not_have_is_refused_with_the_ports_that_it_has():
    with pytest.raises(ArgumentError, match=r"--serial 'tcp:65536': TCP ports are 1 to 65535, or 0 for a free one"):
        open_end("tcp:65536")


@pytest.mark.parametrize("text", ["usb", "pty:", "tcp:", "tcp:x"])
def test_an_end_that_does_not_exist_is_refused(text):
    with pytest.raises(ArgumentError, match=r"is no end of a serial line. Write pty, pty:LINK .* or tcp:PORT"):
        open_end(text)


@needs_simavr
def test_a_line_in_use_takes_no_second_end(quick_echo, end):
    quick_echo.serial.connect(end)
    with pytest.raises(StageError, match="has another end already"):
        quick_echo.serial.connect(end)
    with pytest.raises(StageError, match="something else is at the other end"):
        quick_echo.serial.read_until("ready")


@needs_simavr
def test_a_run_in_real_time_takes_at_least_that_and_says_its_lag(tmp_path, capsys):
    script = write_script(tmp_path, "wait 0.2")
    begin = time.perf_counter()
    assert main([*RUN, "--serial-script", script, "--realtime"]) == 0
    assert time.perf_counter() - begin > 0.2
    assert re.search(
        r"real time: the run was behind by \d+\.\d ms at most, and by \d+\.\d ms at its end", capsys.readouterr().out
    )


@needs_simavr
def test_json_has_the_bytes_and_the_lag(tmp_path, capsys):
    script = write_script(tmp_path, "expect ready", "send hello", "expect hello")
    assert main([*RUN, "--serial-script", script, "--realtime", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["serial"] == {"received": len("ready\r\nhello"), "sent": len("hello\n")}
    assert 0 <= facts["realtime"]["final_lag_s"] <= facts["realtime"]["largest_lag_s"]
