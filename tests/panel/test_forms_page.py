"""Procedures in a real browser: forms, jog buttons and stop, asserted on the page and on the stage."""

import time

import pytest

pytestmark = pytest.mark.slow

MM = 1e-3
DELETE = "\ue017"  # of WebDriver


def fill(browser, **values):
    for name, value in values.items():
        browser.type(name.replace("__", "-"), value or DELETE)


def go(browser, form, says):
    """Press the button; the report."""
    browser.click(f"go-{form}")
    browser.until(lambda: says in browser.text("report"))
    return browser.text("report")


def test_a_move_arrives_and_its_pattern_is_drawn(bench):
    browser, before = bench.browser, bench.x("commanded")
    fill(browser, move__distance="4", move__speed="40")
    report = go(browser, "move", "preset move on x: done")
    assert "0 full steps lost" in report
    assert bench.x("commanded") - before == pytest.approx(4 * MM, abs=1e-6)
    browser.until(lambda: browser.find("pattern").find_elements("css selector", "svg"))


def test_a_wrong_value_is_an_error_at_its_field_and_nothing_moves(bench):
    browser, before = bench.browser, bench.x("commanded")
    fill(browser, move__distance="ten")
    browser.click("go-move")
    browser.until(lambda: "'ten' is not a number of mm" in browser.error_at("move-distance"))
    fill(browser, move__distance="2", move__speed="-1")
    browser.click("go-move")
    browser.until(lambda: "more than 0" in browser.error_at("move-speed"))
    assert browser.error_at("move-distance") == ""
    assert bench.x("commanded") == pytest.approx(before, abs=1e-9)
    assert bench.session.view.action == ""


def test_two_rates(bench):
    browser = bench.browser
    browser.click("tab-two_rates")
    fill(browser, two_rates__distance="20", two_rates__dwell="0.05")
    before = bench.x("commanded")
    assert "dual-rate move" in go(browser, "two_rates", "done")
    assert bench.x("commanded") - before == pytest.approx(20 * MM, abs=1e-6)


def test_home_finds_the_origin(bench):
    browser = bench.browser
    bench.session.speed = 5.0
    browser.click("tab-home")
    go(browser, "home", "stopped by ORG")
    browser.until(lambda: browser.lit("switch-x-org"))
    assert bench.stage(lambda stage: stage.axes["x"].switches.org)
    bench.session.speed = 1.0


def test_a_line_is_of_both_axes(bench):
    browser = bench.browser
    before = bench.stage(lambda stage: [a.commanded for a in stage.axes.values()])
    browser.click("tab-line")
    fill(browser, line__x="", line__y="")
    browser.click("go-line")
    browser.until(lambda: "nothing moves" in browser.error_at("line-x"))
    fill(browser, line__x="6", line__y="3")
    go(browser, "line", "carriages")
    after = bench.stage(lambda stage: [a.commanded for a in stage.axes.values()])
    assert [b - a for a, b in zip(before, after, strict=True)] == pytest.approx([6 * MM, 3 * MM], abs=1e-5)


def test_an_axis_jogs_while_a_button_is_down(bench):
    browser = bench.browser
    browser.click("tab-jog")
    fill(browser, jog__speed="slow")
    with browser.press_and_hold("jog-plus"):
        browser.until(lambda: "is not a number" in browser.error_at("jog-speed"))
    assert bench.session.view.action == ""
    fill(browser, jog__speed="20")
    before = bench.x("commanded")
    with browser.press_and_hold("jog-plus"):
        browser.until(lambda: bench.x("commanded") > before + MM)
        assert browser.error_at("jog-speed") == ""
        assert bench.session.view.action == "jog x"
    browser.until(lambda: "decelerating stop" in browser.text("report"))
    at = bench.x("commanded")
    time.sleep(0.2)
    assert bench.x("commanded") == pytest.approx(at, abs=1e-9)


def test_a_jog_by_the_space_bar_ends_with_the_key(bench):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    browser = bench.browser
    button = browser.scroll_to("jog-minus")
    before = bench.x("commanded")
    browser.driver.execute_script("arguments[0].focus()", button)
    ActionChains(browser.driver).key_down(Keys.SPACE).perform()
    browser.until(lambda: bench.x("commanded") < before - 1 * MM)
    ActionChains(browser.driver).key_up(Keys.SPACE).perform()
    browser.until(lambda: bench.session.view.action == "")


def test_stop_ends_the_action_with_a_ramp(bench):
    browser = bench.browser
    browser.click("tab-move")
    fill(browser, move__distance="100", move__speed="20")
    before = bench.x("commanded")
    with bench.slow_motion():
        browser.click("go-move")
        browser.until(lambda: bench.x("commanded") > before + 1 * MM)
        browser.click("stop")
    browser.until(lambda: "stopped" in browser.text("report"))
    browser.until(lambda: bench.session.view.action == "")
    assert not bench.stage(lambda stage: stage.axes["x"].chip.busy(0))
    assert bench.x("commanded") < before + 90 * MM


def test_a_double_click_is_one_move(bench):
    from selenium.webdriver.common.action_chains import ActionChains

    browser, before = bench.browser, bench.x("commanded")
    browser.click("tab-move")
    fill(browser, move__distance="3", move__speed="20")
    with bench.slow_motion():
        ActionChains(browser.driver).double_click(browser.scroll_to("go-move")).perform()
        browser.until(lambda: not browser.find("go-move").is_enabled())
        browser.until(lambda: browser.text("busy-move"))  # it says why
    browser.until(lambda: "done" in browser.text("report"))
    browser.until(lambda: browser.find("go-move").is_enabled())
    assert bench.x("commanded") - before == pytest.approx(3 * MM, abs=1e-6)


def test_a_report_is_shown_under_its_tab_also_after_a_reload(bench):
    browser = bench.browser
    report = browser.text("report")
    assert "done" in report
    browser.click("tab-home")
    browser.until(lambda: browser.text("report") != report)
    browser.open(bench.panel.address)
    browser.until(lambda: browser.text("report") == report)
    browser.until(lambda: browser.find("pattern").find_elements("css selector", "svg"))


def test_a_report_from_before_a_rewind_or_a_power_up_is_marked_and_faded(bench):
    bench.fresh()
    browser = bench.browser
    browser.until(lambda: browser.time > 6)  # further from power-up than it goes back
    for mark in ("from before time went back to ", "from before the power-up"):
        bench.session.paused = False
        fill(browser, move__distance="1")
        report = go(browser, "move", "preset move on x: done")
        bench.session.paused = True
        browser.until(lambda: browser.text("undone") == "" and opacity(browser, "report") == 1)
        if "power-up" in mark:
            browser.click("reset")
            browser.click("reset-confirm")
        else:
            browser.click("back")
            browser.click("back-5")
        browser.until(lambda m=mark: browser.text("undone").startswith(m))
        assert browser.text("report") == report
        browser.until(lambda: opacity(browser, "report") < 1)
    bench.session.paused = False


def opacity(browser, name):
    return float(browser.driver.execute_script("return getComputedStyle(arguments[0]).opacity", browser.find(name)))
