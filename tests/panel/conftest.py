"""Panels, in a process of their own or in that of the tests, and real browsers that look at them."""

import re
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.served_panel import ServedPanel

from stage import Stage
from stage.panel.sampler import Sampler
from stage.panel.session import UNPACED_SPEED, Session

TOUR_COOKIE = "pulsestage_tour"

ARGUMENTS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",
    "--window-size=1400,1000",
)

ERROR_AT = """const said = arguments[0].closest('.q-field').querySelector('[role=alert]'); return said ? said.textContent : ''"""
CURVE = "return getElement(Number(arguments[0].id.slice(1))).chart.getOption().series[arguments[1]].data"


class Browser:
    """A Chromium that looks at one page. Elements by their `data-test`.

    Args:
        address: Address of the page.
        *arguments: Arguments of Chromium.
        is_first_visit: Whether the browser has never been here, so that the tour opens.
    """

    def __init__(self, address, *arguments, is_first_visit=False):
        from selenium import webdriver

        options = webdriver.ChromeOptions()
        for argument in (*ARGUMENTS, *arguments):
            options.add_argument(argument)
        options.binary_location = shutil.which("chromium")
        self.downloads = Path(tempfile.mkdtemp(prefix="pulsestage-"))
        wanted = {
            "download.default_directory": str(self.downloads),
            "safebrowsing.enabled": True,
        }  # asks nobody about a .py
        options.add_experimental_option("prefs", wanted)
        options.set_capability("goog:loggingPrefs", {"performance": "ALL", "browser": "ALL"})
        service = webdriver.ChromeService(shutil.which("chromedriver"))
        self.driver = webdriver.Chrome(options=options, service=service)
        if not is_first_visit:
            self.driver.execute_cdp_cmd("Network.setCookie", {"name": TOUR_COOKIE, "value": "seen", "url": address})
        self.open(address)

    def open(self, address):
        self.driver.get(address)
        self.until(lambda: self.text("time"))

    def close(self):
        if self.downloads.exists():
            self.driver.quit()
            shutil.rmtree(self.downloads)

    def find(self, name):
        return self.driver.find_element("css selector", f"[data-test='{name}']")

    def text(self, name):
        return self.find(name).text

    def click(self, name):
        """Click an element with the mouse, where it is visible at that moment."""
        self.scroll_to(name).click()

    def scroll_to(self, name):
        """Scroll to an element, and return it when it has come to rest in the middle of the window."""
        self.until(lambda: self.find(name).is_displayed())
        before: list[dict] = []

        def rests():
            element = self.find(name)
            self.driver.execute_script("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", element)
            before.append(element.rect)
            return element if before[-2:-1] == before[-1:] else None

        return self.until(rests)

    @contextmanager
    def press_and_hold(self, name):
        """Press the mouse button on an element, and hold it during the `with` block."""
        from selenium.webdriver.common.action_chains import ActionChains

        ActionChains(self.driver).click_and_hold(self.scroll_to(name)).perform()
        try:
            yield
        finally:
            ActionChains(self.driver).release().perform()

    def value(self, name):
        return self.find(name).get_attribute("value")

    def error_at(self, name):
        """Return the error at a field, or ""."""
        return self.driver.execute_script(ERROR_AT, self.find(name))

    def curve(self, k):
        """Return the points of a curve of the oscilloscope, as the browser draws it: [[x, y], ...]."""
        return self.driver.execute_script(CURVE, self.find("chart"), k)

    def lit(self, name):
        """Return whether a lamp is on."""
        return "on" in self.find(name).get_attribute("class").split()

    def type(self, name, *keys):
        """Click a field, and type in place of what it holds."""
        from selenium.webdriver.common.keys import Keys

        field = self.scroll_to(name)
        field.click()
        field.send_keys(Keys.CONTROL + "a")  # the key goes up at the end of a call
        field.send_keys(*keys)
        return field

    def choose(self, name, text):
        """Select an item of a list that opens with a click."""
        self.click(name)
        option = self.until(lambda: self._option(text))
        self.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", option)
        option.click()

    def _option(self, text):
        options = self.driver.find_elements("css selector", ".q-menu [role=option]")
        return next((o for o in options if o.text.split() == text.split()), None)

    def downloaded(self, ending):
        """Wait for a complete downloaded file, delete it, and return its bytes."""
        file = self.until(lambda: next(iter(self.downloads.glob(f"*.{ending}")), None))
        data = file.read_bytes()
        file.unlink()
        return data

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
        """List the addresses that the page has requested, from the browser's own log."""
        import json

        entries = (json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance"))
        return [
            e["params"].get("request", {}).get("url") or e["params"].get("url")
            for e in entries
            if e["method"] in ("Network.requestWillBeSent", "Network.webSocketCreated")
        ]


def needs_a_browser():
    """Skip where there is none."""
    pytest.importorskip("nicegui")
    pytest.importorskip("selenium")
    if not (shutil.which("chromium") and shutil.which("chromedriver")):
        pytest.skip("needs Chromium and its driver (Debian: chromium-driver)")


@pytest.fixture(scope="session")
def browser_programs():
    """Chromium and its driver; tests are skipped where there is none."""
    needs_a_browser()


@pytest.fixture(scope="module")
def address():
    """Address of a panel of xy that the command line serves."""
    needs_a_browser()
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
    browser.close()


@pytest.fixture
def open_browser():
    """Opens further browsers: look_on(address)."""
    opened = []

    def observe(address, *arguments, **kwargs):
        opened.append(Browser(address, *arguments, **kwargs))
        return opened[-1]

    yield observe
    for browser in opened:
        browser.close()


class Bench:
    """A panel of xy in the process of the tests, and a browser that has the controls: what is clicked is seen on the stage, too."""

    def __init__(self):
        from stage.panel.server import Panel

        self.session = Session(Stage("xy"))
        self.panel = Panel(self.session)
        self.browser = Browser(self.panel.address)

    def fresh(self):
        """Reset the page to its first state, and the stage to power-up, in real time."""
        for active in reversed(self.panel.fault_controls.faults_in_force):
            self.panel.fault_controls.clear_fault(active)
        self.panel.fault_controls.set_payload(0.0)
        self.session.reset()
        self.session.paused, self.session.speed = False, 1.0
        self.browser.open(self.panel.address)

    @contextmanager
    def slow_motion(self):
        """Set the pace to a tenth of real time, so that input is in time for moving things even on a busy machine."""
        self.session.speed = 0.1
        try:
            yield
        finally:
            self.session.speed = 1.0

    def stage(self, observe):
        """`look(stage)`, by the stage's own thread."""
        return self.session.do(observe)

    def x(self, what):
        """Return an attribute of the axis x."""
        return self.stage(lambda stage: getattr(stage.axes["x"], what))

    def close(self):
        self.browser.close()
        self.panel.close()
        self.session.close()


@pytest.fixture(scope="session")
def _bench():
    needs_a_browser()
    bench = Bench()
    yield bench
    bench.close()


@pytest.fixture(scope="module")
def bench(_bench):
    _bench.fresh()
    return _bench


@pytest.fixture(scope="module")
def session():
    """Session of xy, paused until a test lets time pass."""
    with Session(Stage("xy", visuals=False), speed=UNPACED_SPEED, paused=True) as session:
        yield session


@pytest.fixture
def sampler(session):
    """Sampler of that session, at power-up."""
    session.reset()
    sampler = Sampler(session)
    yield sampler
    sampler.close()


@pytest.fixture(scope="module")
def served():
    pytest.importorskip("nicegui")
    served = ServedPanel()
    yield served
    served.close()
