"""A panel whose socket gets what is no message lives on, and its terminal is not flooded."""

import http.client
import random
import re
import subprocess
import sys
from contextlib import suppress

import pytest
from support.examples import SEED

pytest.importorskip("nicegui")
connect = pytest.importorskip("websockets.sync.client").connect

SOCKET = "/_nicegui_ws/socket.io/?EIO=4"
MESSAGES = (
    "", "4", "40", "42", "42[", "42[]", "42[1]", "42null", '42["event"]', '42["event",1]', '42["event",{}]', '42["handshake",5]',
    '42["ack",null]',
    '42["log",1]', '42["javascript_response",{}]', '451-["event",{"_placeholder":true,"num":0}]', '4599999999-["a"]',
    "43", "431[1]", "44", "6", "7", "9", "\0", "42" + "[" * 100_000, '42["event",' + "9" * 5000 + "]", b"", b"\xff\0", b"b4AAAA",
)  # fmt: skip


@pytest.mark.slow
def test_hundreds_of_malformed_messages_leave_the_panel_alive_and_one_line_on_its_terminal():
    rng = random.Random(SEED)
    print(f"PULSESTAGE_SEED={SEED}")
    with subprocess.Popen(
        [sys.executable, "-m", "stage", "panel", "xy", "--no-browser", "--port", "0"],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        try:
            port = int(re.search(r"127\.0\.0\.1:(\d+)", process.stdout.readline())[1])
            for _ in range(40):
                with suppress(Exception), connect(f"ws://127.0.0.1:{port}{SOCKET}&transport=websocket") as socket:
                    for message in rng.choices(MESSAGES, k=10):
                        socket.send(message)
                    socket.send(b"\xff\xfe", text=True)
                    socket.recv(timeout=0.1)
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
            connection.request("GET", "/")
            assert connection.getresponse().status == 200
        finally:
            process.terminate()
            _, output = process.communicate(timeout=30)
    print(output)
    (line,) = output.splitlines()
    assert line.startswith("PulseStage: a malformed message came to the panel, and was ignored")
