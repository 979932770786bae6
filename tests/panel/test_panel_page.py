"""The panel in a real browser: clicks, asserted on the page."""

import urllib.error
import urllib.request

import pytest

pytestmark = pytest.mark.slow


def test_the_page_shows_time_and_pauses_it(browser):
    browser.until(lambda: browser.time > 0.5)
    browser.click("play")
    browser.until(lambda: "stands still" in browser.text("pace"))
    at = browser.time
    browser.click("step")
    browser.until(lambda: browser.time > at)
    assert browser.time < at + 0.01
    browser.click("play")
    browser.until(lambda: browser.time > at + 0.2)
    assert " x" in browser.text("pace")


def test_a_double_click_on_a_toggle_is_one_click(browser):
    from selenium.webdriver.common.action_chains import ActionChains

    browser.until(lambda: "stands still" not in browser.text("pace"))
    ActionChains(browser.driver).double_click(browser.scroll_to("play")).perform()
    browser.until(lambda: "stands still" in browser.text("pace"))
    browser.click("play")
    browser.until(lambda: "stands still" not in browser.text("pace"))


def test_the_page_goes_back_and_to_power_up(browser):
    browser.until(lambda: browser.time > 1.5)
    browser.click("play")
    browser.until(lambda: "stands still" in browser.text("pace"))
    at = browser.time
    browser.click("back")
    browser.until(lambda: browser.text("back-1"))  # the menu has opened
    browser.click("back-1")
    browser.until(lambda: browser.time < at - 0.9)
    browser.click("reset")
    browser.until(lambda: browser.text("reset-cancel"))  # it asks first
    assert browser.time > 0
    browser.click("reset-confirm")
    browser.until(lambda: browser.time == 0)
    browser.click("play")


def test_the_button_that_rewinds_time_has_the_icon_of_rewind_and_not_of_undo(browser):
    button = browser.find("back")
    assert button.get_attribute("aria-label") == "rewind simulated time"
    icons = [i.text for i in browser.driver.find_elements("css selector", ".q-header .q-icon")]
    assert button.find_element("css selector", ".q-icon").text == "fast_rewind"
    assert not {"undo", "replay", "restore", "history", "arrow_back", "settings_backup_restore"} & set(icons)
    browser.click("back")
    browser.until(lambda: browser.text("back-1") == "rewind by 1 s")
    browser.driver.switch_to.active_element.send_keys("\ue00c")  # Escape closes the menu
    browser.until(lambda: not browser.driver.find_elements("css selector", "[data-test=back-1]"))


def test_the_scene_is_drawn(browser):
    canvas = browser.until(lambda: browser.driver.find_element("css selector", ".scene canvas"))
    assert canvas.size["width"] > 300
    for view in ("top", "corner"):
        browser.click(f"view-{view}")
    errors = [e["message"] for e in browser.driver.get_log("browser") if e["level"] == "SEVERE"]
    assert not errors


def test_no_request_leaves_the_machine(browser, address):
    target = address.split("/")[2]
    requested = browser.asked_for()
    assert any("/mesh/" in url for url in requested)
    assert not [
        url for url in requested if url.split("/")[2:3] != [target] and not url.startswith(("data:", "blob:", "chrome"))
    ]


def test_a_second_browser_sees_the_same_and_one_has_the_controls(browser, address, open_browser):
    second = open_browser(address)
    second.until(lambda: abs(second.time - browser.time) < 1)
    second.until(lambda: second.text("controls") == "Take the controls")
    play = "return document.querySelector('[data-test=play]').closest('[inert]') !== null"
    second.until(lambda: second.driver.execute_script(play))
    assert not browser.driver.execute_script(play)
    second.click("controls")
    second.until(lambda: not second.driver.execute_script(play))
    browser.until(lambda: browser.driver.execute_script(play))
    second.close()
    browser.until(lambda: not browser.driver.execute_script(play))  # it is alone again


def test_a_foreign_name_of_the_host_is_refused_by_the_server(address):
    request = urllib.request.Request(address, headers={"Host": "evil.example"})
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(request)
    assert refused.value.code == 403


def test_it_can_be_used_by_keyboard_alone(browser, address):
    from selenium.webdriver.common.keys import Keys

    browser.open(address)  # Tab begins at the top
    browser.until(lambda: "stands still" not in browser.text("pace"))
    body = browser.driver.find_element("css selector", "body")
    for _ in range(10):
        body.send_keys(Keys.TAB)
        focused = browser.driver.switch_to.active_element
        if focused.get_attribute("data-test") == "play":
            break
    else:
        pytest.fail("Tab does not come to the button that stops time")
    focused.send_keys(Keys.ENTER)
    browser.until(lambda: "stands still" in browser.text("pace"))
    focused.send_keys(Keys.ENTER)
    browser.until(lambda: "stands still" not in browser.text("pace"))


BOX = """const { top, bottom, left, right } = arguments[0].getBoundingClientRect();
const height = document.documentElement.clientHeight;
const hit = document.elementFromPoint((left + right) / 2, (top + bottom) / 2);
return { top, bottom, height, free: arguments[0].contains(hit) }"""


@pytest.mark.parametrize(("width", "height"), [(1400, 900), (1024, 768)])
def test_machine_oscilloscope_and_controls_are_visible_together(browser, width, height):
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    browser.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    try:
        browser.driver.execute_script("scrollTo(0, 0)")
        for name in ("scene", "readout", "scope", "chart", "procedures", "go-move", "stop", "stop-at-once"):
            browser.until(lambda n=name: inside(browser.driver.execute_script(BOX, browser.find(n))))
        assert browser.find("scene").rect["height"] >= 200
        assert browser.find("trace").rect["height"] < 60, "the console is small until it is used"
        browser.driver.execute_script("scrollTo(0, 1e6)")  # the long column leaves the machine where it is
        for name in ("scene", "scope", "stop"):
            browser.until(lambda n=name: inside(browser.driver.execute_script(BOX, browser.find(n))))
        assert browser.text("chip-0").startswith("Front panel of x")
    finally:
        browser.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def inside(box):
    """Return whether an element is within the window."""
    return box["top"] >= 0 and box["bottom"] <= box["height"]


@pytest.mark.parametrize(("width", "height"), [(1400, 900), (1024, 768), (390, 844)])
def test_the_state_of_the_oscilloscope_is_readable_in_each_size(browser, width, height):
    """1024 pixels cut it to "ru…"."""
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    browser.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    try:
        browser.until(lambda: "running" in browser.text("scope-state"))
        cut = "return arguments[0].scrollWidth - arguments[0].clientWidth"
        browser.until(lambda: browser.driver.execute_script(cut, browser.find("scope-state")) <= 0)
    finally:
        browser.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_stop_of_motion_and_freeze_of_the_picture_differ_in_words_colors_and_places(browser):
    color = "return getComputedStyle(arguments[0]).backgroundColor + getComputedStyle(arguments[0]).color"
    stop, freeze = browser.find("stop"), browser.find("run")
    assert "Stop motion" in stop.text
    assert "Freeze" in freeze.text
    assert browser.driver.execute_script(color, stop) != browser.driver.execute_script(color, freeze)
    within = "return arguments[0].contains(arguments[1])"
    scope = browser.find("scope")
    assert [browser.driver.execute_script(within, scope, button) for button in (stop, freeze)] == [False, True]


def test_a_phone_shows_one_column(address, browser):
    driver = browser.driver
    driver.set_window_size(390, 844)
    try:
        width = "return document.documentElement.scrollWidth - document.documentElement.clientWidth"
        browser.until(lambda: driver.execute_script(width) <= 0)
        parts = [browser.find(name).rect for name in ("machine", "procedures", "scope", "console-card", "chip-0")]
        assert max(abs(part["x"] - parts[0]["x"]) for part in parts) < 4
        assert [part["y"] for part in parts] == sorted(part["y"] for part in parts), "controls come after the machine"
        for target in ("time", "chip-0"):  # the first and the last: stop is in reach everywhere
            browser.scroll_to(target)
            for stop in ("stop", "stop-at-once"):
                box = driver.execute_script(BOX, browser.find(stop))
                assert box["top"] > box["height"] - 70
                assert box["bottom"] <= box["height"]
                assert box["free"]
    finally:
        driver.set_window_size(1400, 1000)


def test_the_tour_waits_for_an_action_of_the_user(browser):
    browser.click("tour")
    browser.until(lambda: browser.text("tour-title").startswith("1 of 6: First pulse"))
    browser.click("tour-skip")
    browser.until(lambda: browser.text("tour-title").startswith("2 of 6: Ramp"))
    assert browser.text("tour-task")
