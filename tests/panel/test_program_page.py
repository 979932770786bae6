"""Programs beside a page, in a real browser: somebody's own Python, firmware of `stage run`, a host of `stage serve`."""

import re
import shutil
import subprocess
import sys
import threading
from contextlib import contextmanager

import pytest

from stage import Stage, firmware

pytestmark = pytest.mark.slow

BLINK = """#define PULSESTAGE_LINUX_IO
#include <pulsestage.h>
static void put(unsigned r, unsigned long v) { outb(0x80 | r, 0x300); for (int b = 3; b; b--) outb(v >> 8 * (b - 1), 0x300 + b); }
PULSESTAGE_MAIN {
    outb(0x08, 0x300);
    put(1, 50); put(2, 500); put(4, 500); put(5, 500); put(7, 300); put(0, 2000);
    outb(0x44, 0x300); outb(0x15, 0x300);
    while (inb(0x300) & 0x40) usleep(1000);
    return 0;
}"""


@contextmanager
def commanded(*arguments):
    """Start a command with --panel, and return its process and the link."""
    command = [sys.executable, "-m", "stage", *map(str, arguments), "--panel", "--panel-port", "0", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            yield process, re.match(r"http://\S+", process.stdout.readline())[0]
        finally:
            process.kill()


def test_a_program_is_shown_and_waits_while_it_is_suspended(open_browser):
    stage = Stage("xy")
    x = stage.axes["x"]
    with stage.panel(browser=False, program="my program") as panel:
        browser = open_browser(panel.address)
        browser.until(lambda: "my program has the stage" in browser.text("program"))
        firmware.move(x, distance=0.003)  # in this thread, as anybody would
        browser.until(lambda: "start, ramp to FH1" in browser.text("trace"))
        browser.until(lambda: browser.text("commanded-x") == "3.0000 mm")
        at = stage.time
        go = browser.find("go-move")
        assert browser.driver.execute_script("return arguments[0].closest('[inert]') !== null", go)
        assert stage.time == at  # nobody's time passes
        browser.click("take-over")
        browser.until(lambda: browser.time > at + 0.2)
        second = threading.Thread(target=firmware.move, args=(x,), kwargs={"distance": 0.001}, daemon=True)
        second.start()
        browser.until(lambda: "my program waits" in browser.text("program"))
        browser.type("move-distance", "2")
        browser.click("go-move")
        browser.until(lambda: "done" in browser.text("report"))
        assert panel.session.do(lambda stage: x.commanded) == pytest.approx(0.005, abs=1e-6)
        assert second.is_alive()
        browser.click("take-over")
        second.join(20)
        assert x.commanded == pytest.approx(0.006, abs=1e-6)
    assert stage.loop.pace is None
    firmware.move(x, distance=0.001)  # the stage is nobody's session's now


@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
@pytest.mark.parametrize("how", [[], ["--in-process"]])
def test_firmware_with_a_page_ends_as_without_one(open_browser, tmp_path, how):
    source = tmp_path / "blink.c"
    source.write_text(BLINK)
    alone = subprocess.run(
        [sys.executable, "-m", "stage", "run", source, "--model", "xy", *how],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split("\n")
    with commanded("run", source, "--model", "xy", *how) as (process, address):
        assert "blink.c begins when" in process.stdout.readline()
        browser = open_browser(address)
        browser.until(lambda: "R0 = 7D0h (2000)" in browser.text("trace"))
        lines = [process.stdout.readline() for _ in range(4)]
        assert lines[0].split(",")[0] == alone[0].split(",")[0]  # "blink.so returned 0 after ... bus cycles"
        assert [line.rstrip() for line in lines[1:]] == alone[1:4]
        browser.until(lambda: not browser.text("program"))
        at = browser.time
        browser.until(lambda: browser.time > at + 0.1)  # the page lives on
        process.terminate()
        assert process.wait(60) == 0


def test_the_page_shows_a_host_of_serve_and_can_suspend_it(open_browser):
    from stage.serve.client import connect

    with commanded("serve", "--model", "xy", "--listen", "0", "--chips", "pcl240k") as (process, address):
        process.stdout.readline()
        browser = open_browser(address)
        while not (result := re.search(r"listening on (\S+);", process.stdout.readline())):
            pass
        browser.until(lambda: "a host of stage serve" in browser.text("program"))
        with connect(result[1]) as board:
            board.out8(0x300, 0x08)
            browser.until(lambda: "reset command" in browser.text("trace"))
            browser.click("take-over")
            at = browser.time
            browser.until(lambda: browser.time > at + 0.1)
            answers: list[int] = []
            asking = threading.Thread(target=lambda: answers.append(board.in8(0x300)), daemon=True)
            asking.start()
            browser.until(lambda: "waits" in browser.text("program"))
            assert not answers
            browser.click("take-over")
            asking.join(20)
            assert answers == [0xA8]
        process.terminate()
        assert process.wait(60) == 0
