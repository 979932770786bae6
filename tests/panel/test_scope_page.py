"""The oscilloscope in a real browser: what the page draws and saves is what the stage did."""

import io

import numpy as np
import pytest

from stage import firmware

pytestmark = pytest.mark.slow

LEVEL = 8000.0  # pulses a second


@pytest.fixture(scope="module")
def triggered(bench):
    """A move of 4 mm, caught by a single trigger at its rate."""
    browser = bench.browser
    browser.choose("mode", "single")
    browser.type("level", f"{LEVEL:g}")
    browser.choose("span", "200 ms")
    browser.choose("source", "x pulse rate (pps)")
    browser.until(lambda: browser.text("scope-state") == "waits for the trigger")
    bench.session.act("move", lambda stage: firmware.move(stage.axes["x"], 0.004)).result(60)
    browser.until(lambda: browser.text("scope-state").startswith("frozen"))
    return bench


def test_the_rate_crosses_the_level_where_the_time_is_zero(triggered):
    browser, sampler = triggered.browser, triggered.panel.sampler
    curve = np.array(browser.until(lambda: c if len(c := browser.curve(0)) > 100 else None))
    before, after = curve[curve[:, 0] < 0], curve[(curve[:, 0] >= 0) & (curve[:, 0] < 20)]  # ms
    assert before[:, 1].max() < LEVEL <= after[:, 1].min()
    assert curve[0, 0] == pytest.approx(-50, abs=1)
    _, values = sampler.read_columns(["x/rate"], sampler.last_time - 10, sampler.last_time)
    assert curve[:, 1].max() == pytest.approx(values["x/rate"].max(), rel=0.01)  # older samples are coarser


def test_run_and_stop_hold_the_picture(triggered):
    browser = triggered.browser
    browser.choose("mode", "no trigger")
    browser.until(lambda: browser.text("scope-state") == "running")
    browser.click("run")
    browser.until(lambda: browser.text("scope-state").startswith("frozen"))
    browser.click("run")
    browser.until(lambda: browser.text("scope-state") == "running")


@pytest.mark.parametrize("ending", ["csv", "png", "vcd", "rrd"])
def test_a_file_of_the_window_comes_with_every_sample(triggered, ending):
    browser, sampler = triggered.browser, triggered.panel.sampler
    if not browser.text("scope-state").startswith("frozen"):
        browser.click("run")
        browser.until(lambda: browser.text("scope-state").startswith("frozen"))
    browser.click("export")
    browser.until(lambda: browser.text(f"export-{ending}"))  # the menu has opened
    browser.click(f"export-{ending}")
    data = browser.downloaded(ending)
    if ending == "csv":
        rows = np.genfromtxt(io.BytesIO(data), delimiter=",", skip_header=1)
        heads = data.decode().split("\n")[0].split(",")
        times, values = sampler.read_columns(["x/position"], rows[0, 0] - 1e-5, rows[-1, 0] + 1e-5)
        assert len(rows) == len(times) > 200
        assert np.allclose(rows[:, heads.index("x position (mm)")], values["x/position"])
    else:
        assert data.startswith({"png": b"\x89PNG", "vcd": b"$date", "rrd": b"RRF"}[ending])
