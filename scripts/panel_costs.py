"""What a panel costs: from a click to the lamp, frames, processor time, whether time is real beside three charts, growth.

python scripts/panel_costs.py [--minutes 15]        Chromium and its driver from the system, headless; extra `browser`
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import statistics
import subprocess
import sys
import time
from typing import Any

from selenium import webdriver

CLICKS = 41
THIRD = "x load angle (electrical deg)"  # a chart of its own, beside those of rates and positions
TIMED = """
const [button, lamp] = arguments[0], done = arguments[1], begin = performance.now();
const eye = new MutationObserver(() => { eye.disconnect(); done(performance.now() - begin); });
eye.observe(lamp, {attributes: true, attributeFilter: ['class']});
button.click();
"""
TIMES = "return [document.querySelector('[data-test=time]').textContent, performance.now()]"
FRAMES = "const s = Object.values(mounted_app.$refs).find(e => e && 'frames' in e); return s ? s.frames : null"


class Page:
    """A panel of xy in a process of its own, and a browser that looks at it."""

    def __init__(self) -> None:
        command = [sys.executable, "-m", "stage", "panel", "xy", "--port", "0", "--no-browser"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, errors="replace")
        assert self.process.stdout is not None
        self.address = self.process.stdout.readline().strip()
        options = webdriver.ChromeOptions()
        for argument in (
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--enable-unsafe-swiftshader",
            "--window-size=1400,1000",
        ):
            options.add_argument(argument)
        options.binary_location = shutil.which("chromium") or ""
        self.driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
        self.driver.get(self.address)
        time.sleep(4)

    def find(self, name: str) -> Any:
        return self.driver.find_element("css selector", f"[data-test='{name}']")

    def click(self, name: str) -> None:
        self.driver.execute_script("arguments[0].click()", self.find(name))

    def type(self, name: str, text: str) -> None:
        field = self.find(name)
        field.send_keys("\ue009" + "a")
        field.send_keys(text)

    def also_show(self, trace: str) -> None:
        """One more trace on the oscilloscope, of its list."""
        self.click("traces")
        time.sleep(1)
        options = self.driver.find_elements("css selector", ".q-menu [role=option]")
        next(o for o in options if o.text == trace).click()
        self.driver.switch_to.active_element.send_keys("\ue00c")  # Esc closes the list
        time.sleep(1)

    def frames(self) -> int:
        """Pictures of the scene so far."""
        return self.driver.execute_script(FRAMES)

    def console(self, *lines: str) -> None:
        for line in lines:
            self.type("console", line + "\ue007")
            time.sleep(0.3)

    def times(self) -> tuple[float, float]:
        """s: the simulated time that the page shows, and the browser's own."""
        shown, now = self.driver.execute_script(TIMES)
        return float(shown.removesuffix(" s")), now / 1e3

    def processor(self) -> float:
        """s of processor time of the server so far."""
        with open(f"/proc/{self.process.pid}/stat") as file:
            fields = file.read().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def memory(self) -> tuple[float, float]:
        """MB: of the server, of the page's JavaScript."""
        with open(f"/proc/{self.process.pid}/status") as file:
            found = re.search(r"VmRSS:\s+(\d+)", file.read())
        assert found is not None
        return int(found[1]) / 1024, self.driver.execute_script("return performance.memory.usedJSHeapSize") / 1e6

    def close(self) -> None:
        self.driver.quit()
        self.process.terminate()
        self.process.wait()


def share(page: Page, seconds: float) -> float:
    """% of a core that the server takes."""
    begin, at = page.processor(), time.perf_counter()
    time.sleep(seconds)
    return 100 * (page.processor() - begin) / (time.perf_counter() - at)


def clicks(page: Page) -> list[float]:
    """ms from a click on a command to its lamp."""
    page.console("R1 <- 50", "R7 <- 8000", "40")
    found = []
    for k in range(CLICKS):
        button = page.find(f"command-0-operate-{'10' if k % 2 == 0 else '8'}")
        found.append(page.driver.execute_async_script(TIMED, [button, page.find("pin-0-hold")]))
        time.sleep(0.2)
    return found[1:]


def move(page: Page, distance: str, speed: str) -> None:
    page.type("move-distance", distance)
    page.type("move-speed", speed)
    page.click("go-move")


def _rest(page: Page) -> None:
    print(f"load of this machine, 1 minute: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores", flush=True)
    print(f"at rest, a page open: {share(page, 20):.1f} % of a core", flush=True)
    took = clicks(page)
    print(
        f"click to lamp: median {statistics.median(took):.0f} ms, worst of {len(took)} {max(took):.0f} ms", flush=True
    )
    page.click("command-0-operate-8")


def _motion(page: Page) -> None:
    """10 s of a move, with charts of rate, position and load angle."""
    move(page, "100", "10")
    time.sleep(1)
    frames, busy, (simulated, at) = page.frames(), page.processor(), page.times()
    time.sleep(8)
    later, now = page.times()
    wall = now - at
    print(
        f"in motion beside three charts: {(later - simulated) / wall:.3f} simulated seconds a second, "
        f"{100 * (page.processor() - busy) / wall:.0f} % of a core, "
        f"{(page.frames() - frames) / wall:.1f} pictures of the scene a second",
        flush=True,
    )


def _growth(page: Page, minutes: float) -> None:
    """Moves to and fro; each minute a line."""
    begin = last = time.perf_counter()
    sign, frames, (simulated, at) = 1, page.frames(), page.times()
    while time.perf_counter() - begin < 60 * minutes:
        move(page, f"{sign * 10}", "20")
        sign = -sign
        time.sleep(4)
        if time.perf_counter() - last < 60:
            continue
        last = time.perf_counter()
        server, script = page.memory()
        drawn, (later, now) = page.frames(), page.times()
        print(
            f"after {(last - begin) / 60:4.1f} minutes of moves: server {server:.0f} MB, page {script:.0f} MB, "
            f"{(drawn - frames) / (now - at):.1f} pictures a second, {(later - simulated) / (now - at):.3f} s/s, "
            f"load {os.getloadavg()[0]:.1f}",
            flush=True,
        )
        frames, simulated, at = drawn, later, now


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=15.0, help="of watching memory (default: 15)")
    args = parser.parse_args()
    page = Page()
    page.driver.set_script_timeout(30)
    try:
        page.also_show(THIRD)
        _rest(page)
        _motion(page)
        _growth(page, args.minutes)
    finally:
        page.close()


if __name__ == "__main__":
    main()
