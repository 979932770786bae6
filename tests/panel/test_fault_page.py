"""Fault controls in a real browser: what somebody breaks, loads and pushes on the page happens to the stage."""

import pytest

pytestmark = pytest.mark.slow


def faults(bench):
    return bench.stage(lambda stage: stage.faults)


def supply(bench):
    return bench.stage(lambda stage: {a.faults.bus_voltage for a in stage.axes.values()})


@pytest.fixture(scope="module")
def fault_bench(bench):
    bench.browser.click("hands")
    bench.browser.until(lambda: bench.browser.find("payload").is_displayed())
    return bench


def press(bench, name, *keys):
    """Press keys on a slider, as a user without a mouse does."""
    slider = bench.browser.scroll_to(name)
    slider = slider.find_elements("css selector", "[tabindex='0']") or [slider]
    slider[0].send_keys(*keys)


def break_it(bench, what, **choices):
    """Make a fault that the page offers, and return its text in the list."""
    browser = bench.browser
    browser.choose("breaking", what)
    for name, value in choices.items():
        browser.until(lambda name=name: browser.find(f"break-{name}").is_displayed())
        browser.choose(f"break-{name}", value)
    browser.click("break")
    browser.until(lambda: faults(bench))
    (text,) = faults(bench)
    browser.until(lambda: text in browser.text("in-force"))


def clear(bench):
    bench.browser.click("clear-fault")
    bench.browser.until(lambda: not faults(bench))
    bench.browser.until(lambda: not bench.browser.text("in-force"))


def test_the_payload_is_that_of_the_slider(fault_bench):
    from selenium.webdriver.common.keys import Keys

    press(fault_bench, "payload", Keys.ARROW_RIGHT * 5)
    fault_bench.browser.until(lambda: fault_bench.browser.text("payload-value") == "payload 0.5 kg")
    assert fault_bench.stage(lambda stage: stage.payload()) == pytest.approx(0.5)


def test_a_lower_supply_of_all_drives_is_cleared(fault_bench):
    from selenium.webdriver.common.keys import Keys

    before = supply(fault_bench)
    press(fault_bench, "supply", Keys.ARROW_LEFT * 4)
    fault_bench.browser.until(lambda: supply(fault_bench) == {next(iter(before)) - 2.0})
    (text,) = faults(fault_bench)
    fault_bench.browser.until(lambda: text in fault_bench.browser.text("in-force"))
    clear(fault_bench)
    assert supply(fault_bench) == before
    fault_bench.browser.until(lambda: fault_bench.browser.text("supply-value") == f"supply {before.pop():g} V")


def test_a_push_ends_with_the_button(fault_bench):
    browser, dof = fault_bench.browser, fault_bench.session.stage.axes["x"].plant.dof

    def force():
        return fault_bench.stage(lambda stage: stage.data.qfrc_applied[dof])

    before = fault_bench.x("position")
    browser.type("push-force", "25")
    with browser.press_and_hold("push-plus"):
        browser.until(lambda: force() == 25.0)
        browser.until(lambda: fault_bench.x("position") > before + 1e-6)
    browser.until(lambda: force() == 0.0)


def test_an_excessive_push_is_an_error_at_its_field_and_is_not_applied(fault_bench):
    browser = fault_bench.browser
    for typed, message in (
        ("900000", "900000 N: up to 503 N, twice what this motor can hold"),
        ("1e300", "up to 503 N"),
    ):
        browser.type("push-force", typed)
        with browser.press_and_hold("push-plus"):
            browser.until(lambda message=message: message in browser.error_at("push-force"))
    assert fault_bench.stage(lambda stage: stage.data.qfrc_applied[stage.axes["x"].plant.dof]) == 0
    browser.type("push-force", "25")
    before = fault_bench.x("position")
    with browser.press_and_hold("push-plus"):
        browser.until(lambda: fault_bench.x("position") > before + 1e-6)
        assert browser.error_at("push-force") == ""


def test_a_carriage_out_of_its_travel_is_reported_and_recovery_restores_a_good_state(fault_bench):
    browser, session = fault_bench.browser, fault_bench.session
    fault_bench.stage(lambda stage: stage.data.qpos.__setitem__(stage.axes["x"].plant.qpos, 12.0))
    browser.until(lambda: "x is out of its travel, at 1.2e+04 mm" in browser.text("doing"))
    browser.click("recover")
    browser.until(lambda: not browser.find("recover").is_displayed())
    assert abs(fault_bench.x("position")) < 0.158
    session.paused = False
    browser.until(lambda: "stands still" not in browser.text("pace"))


def test_a_stuck_switch_lights_its_lamp_until_it_is_cleared(fault_bench):
    assert not fault_bench.browser.lit("switch-x-org")
    break_it(fault_bench, "switch stuck", pin="org", closed="yes")
    fault_bench.browser.until(lambda: fault_bench.browser.lit("switch-x-org"))
    assert fault_bench.stage(lambda stage: stage.axes["x"].switches.org)
    clear(fault_bench)
    fault_bench.browser.until(lambda: not fault_bench.browser.lit("switch-x-org"))


def test_an_open_wire_is_one_of_the_drive(fault_bench):
    break_it(fault_bench, "phase open", phase="b")
    assert fault_bench.x("faults").open_phases
    clear(fault_bench)
    assert not fault_bench.x("faults").open_phases


def test_another_motor_is_selected_on_the_page_and_named_on_its_card(fault_bench):
    browser = fault_bench.browser
    browser.until(lambda: browser.text("motor-x") == "17HS4401")
    fault_bench.session.paused = True
    break_it(fault_bench, "motor", motor="SS2422-5041")
    browser.until(lambda: browser.text("motor-x") == "SS2422-5041")
    assert browser.text("motor-y") == "17HS4401"
    assert fault_bench.x("drive").motor.name == "SS2422-5041"
    browser.click("back")
    browser.click("back-30")
    browser.until(lambda: "the stage had another motor then" in browser.driver.page_source)
    clear(fault_bench)
    browser.until(lambda: browser.text("motor-x") == "17HS4401")
    fault_bench.session.paused = False


def test_a_switch_bounces_until_the_fault_is_cleared(fault_bench):
    def toggles():
        return fault_bench.stage(
            lambda stage: int(stage.state.switch_table[stage.axes["x"].switches.find_index("org")]["toggles"])
        )

    break_it(fault_bench, "bounce", pin="org")
    assert toggles() == 6
    clear(fault_bench)
    assert toggles() == 0


def test_a_divergence_is_shown_and_the_button_recovers(fault_bench):
    browser, session = fault_bench.browser, fault_bench.session
    y = session.stage.axes["y"]  # nobody has pushed it: a hand that has let go takes its force away
    fault_bench.stage(lambda stage: stage.data.qfrc_applied.__setitem__(y.plant.dof, 1e30))
    browser.until(lambda: "diverged" in browser.text("doing") or "out of its travel" in browser.text("doing"))
    browser.click("recover")
    browser.until(lambda: not browser.find("recover").is_displayed())
    assert abs(fault_bench.stage(lambda stage: y.position)) < 0.108
    session.paused = False
    browser.until(lambda: "stands still" not in browser.text("pace"))


def test_an_impossible_value_is_an_error_at_its_field(fault_bench):
    browser = fault_bench.browser
    browser.choose("breaking", "bounce")
    browser.type("break-toggles", "2.5")
    browser.click("break")
    browser.until(lambda: "a whole number" in browser.error_at("break-toggles"))
    assert not faults(fault_bench)
