"""Only one has the controls: what a browser without them sends is refused by the server, even where its page was forged."""

import time

import pytest

pytestmark = pytest.mark.slow

FORGED = """for (const e of document.querySelectorAll('[inert]')) e.removeAttribute('inert');
arguments[0].click();"""
RAW = """const v = mounted_app.elements[arguments[0].id.slice(1)];
const listener = v.events.find(e => e.type.startsWith('click'));
window.socket.emit('event', {id: Number(arguments[0].id.slice(1)), client_id: window.clientId, listener_id: listener.listener_id,
  args: ['{}']});"""


@pytest.fixture
def second(bench, open_browser):
    second = open_browser(bench.panel.address)
    second.until(lambda: second.text("controls") == "Take the controls")
    return second


def get_effects(bench):
    """Return the effects of accepted commands: the bus cycles of the panel, and whether time is paused."""
    return bench.panel.observer.traces[0].get_lines_after(0), bench.session.paused


def test_forged_clicks_and_messages_of_an_observer_do_nothing(bench, second):
    before = get_effects(bench)
    for name in ("play", "command-0-operate-8", "go-move", "reset"):
        second.driver.execute_script(FORGED, second.find(name))
    second.driver.execute_script(RAW, second.find("play"))
    second.click("view-top")  # what is no order is heard
    second.click("controls")  # and in order: all before has come
    second.until(lambda: second.text("controls") != "Take the controls")
    assert get_effects(bench) == before
    second.driver.execute_script(RAW, second.find("play"))
    second.until(lambda: bench.session.paused)  # the same message is an order now
    second.click("play")
    second.until(lambda: not bench.session.paused)


def test_who_loses_the_controls_lets_go_of_a_jog(bench, second):
    first = bench.browser
    first.until(lambda: first.text("controls") == "2 watching")
    first.click("tab-jog")
    with first.press_and_hold("jog-plus"):
        first.until(lambda: bench.session.view.action == "jog x")
        second.click("controls")
        second.until(lambda: bench.session.view.action == "")
        time.sleep(0.1)
        at = bench.x("commanded")
        time.sleep(0.2)
        assert bench.x("commanded") == pytest.approx(at, abs=1e-9)


def test_a_divergence_is_reported_and_recovery_restores_a_good_state(bench):
    browser = bench.browser
    browser.until(lambda: bench.session.view.time > 1.0)
    bench.stage(lambda stage: stage.data.qfrc_applied.__setitem__(0, 1e30))
    browser.until(lambda: "the simulation diverged at" in browser.text("doing"))
    browser.click("recover")
    browser.until(lambda: "stands still" in browser.text("pace"))
    assert not bench.session.view.trouble
    at = browser.time
    browser.click("play")
    browser.until(lambda: browser.time > at + 0.3)
    assert browser.text("doing") == ""
