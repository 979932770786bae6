"""Fault controls in a real browser: what somebody breaks, loads and pushes on the page happens to the stage."""

import pytest

pytestmark = pytest.mark.slow


def faults(bench):
    return bench.stage(lambda stage: stage.faults)


def supply(bench):
    return bench.stage(lambda stage: {a.faults.bus_voltage for a in stage.axes.values()})


@pytest.fixture(scope="module")
def hands(bench):
    bench.browser.click("hands")
    bench.browser.until(lambda: bench.browser.find("payload").is_displayed())
    return bench


def press(bench, name, *keys):
    """Keys to a slider, as somebody without a mouse has it."""
    slider = bench.browser.shown(name)
    slider = slider.find_elements("css selector", "[tabindex='0']") or [slider]
    slider[0].send_keys(*keys)


def break_it(bench, what, **choices):
    """A fault, of what the page offers; its text in the list."""
    browser = bench.browser
    browser.choose("breaking", what)
    for name, value in choices.items():
        browser.until(lambda name=name: browser.find(f"break-{name}").is_displayed())
        browser.choose(f"break-{name}", value)
    browser.click("break")
    browser.until(lambda: faults(bench))
    (text,) = faults(bench)
    browser.until(lambda: text in browser.text("in-force"))


def mend(bench):
    bench.browser.click("mend")
    bench.browser.until(lambda: not faults(bench))
    bench.browser.until(lambda: not bench.browser.text("in-force"))


def test_the_payload_is_that_of_the_slider(hands):
    from selenium.webdriver.common.keys import Keys

    press(hands, "payload", Keys.ARROW_RIGHT * 5)
    hands.browser.until(lambda: hands.browser.text("payload-value") == "payload 0.5 kg")
    assert hands.stage(lambda stage: stage.payload()) == pytest.approx(0.5)


def test_the_supply_of_all_drives_goes_down_and_is_mended(hands):
    from selenium.webdriver.common.keys import Keys

    before = supply(hands)
    press(hands, "supply", Keys.ARROW_LEFT * 4)
    hands.browser.until(lambda: supply(hands) == {next(iter(before)) - 2.0})
    (text,) = faults(hands)
    hands.browser.until(lambda: text in hands.browser.text("in-force"))
    mend(hands)
    assert supply(hands) == before
    hands.browser.until(lambda: hands.browser.text("supply-value") == f"supply {before.pop():g} V")


def test_a_push_lasts_as_long_as_the_button_is_held(hands):
    browser, dof = hands.browser, hands.session.stage.axes["x"].plant.dof

    def force():
        return hands.stage(lambda stage: stage.data.qfrc_applied[dof])

    before = hands.x("position")
    browser.type("push-force", "25")
    with browser.held("push-plus"):
        browser.until(lambda: force() == 25.0)
        browser.until(lambda: hands.x("position") > before + 1e-6)
    browser.until(lambda: force() == 0.0)


def test_a_push_that_no_hand_has_is_said_at_its_field_and_nobody_pushes(hands):
    browser = hands.browser
    for typed, said in (("900000", "900000 N: up to 503 N, twice what this motor can hold"), ("1e300", "up to 503 N")):
        browser.type("push-force", typed)
        with browser.held("push-plus"):
            browser.until(lambda said=said: said in browser.error_at("push-force"))
    assert hands.stage(lambda stage: stage.data.qfrc_applied[stage.axes["x"].plant.dof]) == 0
    browser.type("push-force", "25")
    before = hands.x("position")
    with browser.held("push-plus"):
        browser.until(lambda: hands.x("position") > before + 1e-6)
        assert browser.error_at("push-force") == ""


def test_a_carriage_out_of_its_travel_is_told_and_one_goes_back_to_a_good_state(hands):
    browser, session = hands.browser, hands.session
    hands.stage(lambda stage: stage.data.qpos.__setitem__(stage.axes["x"].plant.qpos, 12.0))
    browser.until(lambda: "x is out of its travel, at 1.2e+04 mm" in browser.text("doing"))
    browser.click("recover")
    browser.until(lambda: not browser.find("recover").is_displayed())
    assert abs(hands.x("position")) < 0.158
    session.paused = False
    browser.until(lambda: "stands still" not in browser.text("pace"))


def test_a_stuck_switch_lights_its_lamp_until_it_is_mended(hands):
    assert not hands.browser.lit("switch-x-org")
    break_it(hands, "switch stuck", pin="org", closed="yes")
    hands.browser.until(lambda: hands.browser.lit("switch-x-org"))
    assert hands.stage(lambda stage: stage.axes["x"].switches.org)
    mend(hands)
    hands.browser.until(lambda: not hands.browser.lit("switch-x-org"))


def test_an_open_wire_is_one_of_the_drive(hands):
    break_it(hands, "phase open", phase="b")
    assert hands.x("faults").open_phases
    mend(hands)
    assert not hands.x("faults").open_phases


def test_another_motor_is_chosen_on_the_page_and_stands_on_the_card_of_its_axis(hands):
    browser = hands.browser
    browser.until(lambda: browser.text("motor-x") == "17HS4401")
    hands.session.paused = True
    break_it(hands, "motor", motor="SS2422-5041")
    browser.until(lambda: browser.text("motor-x") == "SS2422-5041")
    assert browser.text("motor-y") == "17HS4401"
    assert hands.x("drive").motor.name == "SS2422-5041"
    browser.click("back")
    browser.click("back-30")
    browser.until(lambda: "the stage had another motor then" in browser.driver.page_source)
    mend(hands)
    browser.until(lambda: browser.text("motor-x") == "17HS4401")
    hands.session.paused = False


def test_a_switch_that_bounces_does_until_it_is_mended(hands):
    def toggles():
        return hands.stage(lambda stage: int(stage.state.switch_table[stage.axes["x"].switches.row("org")]["toggles"]))

    break_it(hands, "bounce", pin="org")
    assert toggles() == 6
    mend(hands)
    assert toggles() == 0


def test_a_simulation_that_diverges_says_so_and_one_goes_back_to_a_good_state(hands):
    browser, session = hands.browser, hands.session
    y = session.stage.axes["y"]  # nobody has pushed it: a hand that has let go takes its force away
    hands.stage(lambda stage: stage.data.qfrc_applied.__setitem__(y.plant.dof, 1e30))
    browser.until(lambda: "diverged" in browser.text("doing") or "out of its travel" in browser.text("doing"))
    browser.click("recover")
    browser.until(lambda: not browser.find("recover").is_displayed())
    assert abs(hands.stage(lambda stage: y.position)) < 0.108
    session.paused = False
    browser.until(lambda: "stands still" not in browser.text("pace"))


def test_what_cannot_be_is_said_at_its_field(hands):
    browser = hands.browser
    browser.choose("breaking", "bounce")
    browser.type("break-toggles", "2.5")
    browser.click("break")
    browser.until(lambda: "a whole number" in browser.error_at("break-toggles"))
    assert not faults(hands)
