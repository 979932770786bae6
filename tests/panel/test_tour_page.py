"""The tour, by what the page offers, to its end: each step waits until somebody has done it with his own hands."""

import pytest

pytestmark = pytest.mark.slow


def waits_for(browser, title):
    browser.until(lambda: title in browser.text("tour-title"))


def go(bench, form, **values):
    """Fill a form and press its button; the report says that it is over."""
    browser = bench.browser
    browser.click(f"tab-{form}")
    for name, value in values.items():
        browser.type(f"{form}-{name}", value)
    browser.click(f"go-{form}")
    browser.until(lambda: "lost steps" in browser.text("report") or "stopped" in browser.text("report"))
    browser.until(lambda: bench.session.view.action == "")


def test_each_step_is_done_by_hand(bench):
    browser = bench.browser
    bench.session.speed = 2.0
    browser.click("tour")
    waits_for(browser, "1 of 6: First pulse")
    assert "Move, 1 mm" in browser.text("tour-task")
    go(bench, "move", distance="1")
    waits_for(browser, "2 of 6: Ramp")
    go(bench, "move", distance="40")
    waits_for(browser, "3 of 6: Stall")
    assert bench.x("lost_steps") == 0
    go(bench, "move", distance="-40", speed="600", start_speed="300", accel="0.02")
    waits_for(browser, "4 of 6: Origin return")
    assert bench.x("lost_steps") != 0
    bench.session.speed = 5.0
    go(bench, "home")
    waits_for(browser, "5 of 6: Dual rate")
    bench.session.speed = 2.0
    go(bench, "two_rates", distance="60")
    waits_for(browser, "6 of 6: Synchronized move")
    go(bench, "line", x="30", y="10")
    waits_for(browser, "That was all")
    assert browser.text("tour-task") == ""
    browser.until(lambda: browser.text("tour-skip") == "Begin again")
    browser.click("tour-skip")
    waits_for(browser, "1 of 6")
