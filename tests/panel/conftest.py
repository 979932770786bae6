"""A panel in a process of its own, and real browsers that look at it."""

import re
import shutil
import subprocess
import sys
import time

import pytest

from stage import Stage
from stage.panel.sampler import Sampler
from stage.panel.session import FREE, Session

ARGUMENTS = (
    "--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--window-size=1400,1000",
)  # fmt: skip


class Browser:
    """A Chromium that looks at one page. Elements by their `data-test`."""

    def __init__(self, address, *arguments):
        from selenium import webdriver

        options = webdriver.ChromeOptions()
        for argument in (*ARGUMENTS, *arguments):
            options.add_argument(argument)
        options.binary_location = shutil.which("chromium")
        options.set_capability("goog:loggingPrefs", {"performance": "ALL", "browser": "ALL"})
        service = webdriver.ChromeService(shutil.which("chromedriver"))
        self.driver = webdriver.Chrome(options=options, service=service)
        self.driver.get(address)
        self.until(lambda: self.text("time"))

    def find(self, name):
        return self.driver.find_element("css selector", f"[data-test='{name}']")

    def text(self, name):
        return self.find(name).text

    def click(self, name):
        self.find(name).click()

    def until(self, condition, seconds=40.0):
        """Wait until `condition()` is true, and return it."""
        from selenium.common.exceptions import WebDriverException

        end, last = time.monotonic() + seconds, None
        while time.monotonic() < end:
            try:
                if last := condition():
                    return last
            except WebDriverException as error:
                last = error
            time.sleep(0.05)
        raise AssertionError(f"not within {seconds:g} s; last: {last}")

    @property
    def time(self):
        """The simulated time that the page shows, s."""
        return float(self.text("time").removesuffix(" s"))

    def asked_for(self):
        """The addresses that the page has asked for, from the browser's own log."""
        import json

        entries = (json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance"))
        return [
            e["params"].get("request", {}).get("url") or e["params"].get("url")
            for e in entries
            if e["method"] in ("Network.requestWillBeSent", "Network.webSocketCreated")
        ]


@pytest.fixture(scope="module")
def address():
    """Of a panel of xy, which the command line serves."""
    pytest.importorskip("nicegui")
    pytest.importorskip("selenium")
    if not (shutil.which("chromium") and shutil.which("chromedriver")):
        pytest.skip("needs Chromium and its driver (Debian: chromium-driver)")
    command = [sys.executable, "-m", "stage", "panel", "xy", "--port", "0", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        yield re.match(r"http://\S+", process.stdout.readline())[0]
        process.terminate()
        assert process.wait(20) == 0


@pytest.fixture(scope="module")
def browser(address):
    """The browser that came first and has the controls."""
    browser = Browser(address)
    yield browser
    browser.driver.quit()


@pytest.fixture(scope="module")
def session():
    """Of xy, where time stands still until a test lets it pass."""
    with Session(Stage("xy", visuals=False), speed=FREE, paused=True) as session:
        yield session


@pytest.fixture
def sampler(session):
    """Of that session, at power-up."""
    session.reset()
    sampler = Sampler(session)
    yield sampler
    sampler.close()
