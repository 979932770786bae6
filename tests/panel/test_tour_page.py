"""The tour in a real browser: the first visit opens it, and each card fills in a form and waits until its button was pressed."""

import pytest

from stage.panel.tour import STEPS

pytestmark = pytest.mark.slow

PLACES = """return ['tour-target', 'tour-press', 'tour-card'].map((name) => {
  const found = document.querySelectorAll('.' + name);
  const { left, right, top, bottom } = found[0].getBoundingClientRect();
  return [found.length, found[0].dataset.test ?? '', [left, right, top, bottom]];
})"""


def wait_for_card(browser, title):
    browser.until(lambda: title in browser.text("tour-title"))


def overlaps(a, b):
    return a[0] < b[1] and b[0] < a[1] and a[2] < b[3] and b[2] < a[3]


def test_the_first_visit_opens_the_tour_and_the_second_does_not(bench, open_browser):
    bench.browser.driver.get("about:blank")  # the controls go to the next browser
    try:
        visitor = open_browser(bench.panel.address, is_first_visit=True)
        wait_for_card(visitor, "1 of 6: First pulse")
        visitor.open(bench.panel.address)
        assert not visitor.find("tour-title").is_displayed()
        visitor.click("tour")
        wait_for_card(visitor, "1 of 6: First pulse")
        visitor.click("tour-close")
        visitor.until(lambda: not visitor.find("tour-title").is_displayed())
    finally:
        visitor.close()
        bench.browser.open(bench.panel.address)


def test_each_card_fills_in_a_form_and_is_confirmed_after_its_button(bench):
    browser = bench.browser
    browser.driver.set_window_size(1400, 1000)
    browser.click("tour")
    for k, step in enumerate(STEPS):
        wait_for_card(browser, f"{k + 1} of 6: {step.title}")
        for field, text in step.texts.items():
            browser.until(lambda s=step, f=field, t=text: browser.value(f"{s.form}-{f}") == t)
        marks = browser.until(lambda s=step: browser.driver.execute_script(PLACES))
        assert [(count, name) for count, name, _ in marks[:2]] == [(1, step.shown_by), (1, f"go-{step.form}")]
        assert not overlaps(marks[2][2], marks[1][2]), "the card leaves its button free"
        bench.session.speed = 5.0 if step.form == "home" else 2.0
        browser.click(f"go-{step.form}")
        wait_for_card(browser, f"Done: {step.title}")
        assert step.sheet in browser.text("tour-task")
        assert browser.find("tour-next").is_displayed()
        assert not browser.find("tour-skip").is_displayed()
        browser.until(lambda: bench.session.view.action == "")
        browser.click("tour-next")
    wait_for_card(browser, "That was the tour")
    bench.session.speed = 1.0


def skip_to_the_end(browser):
    browser.click("tour")
    for k, step in enumerate(STEPS):
        wait_for_card(browser, f"{k + 1} of 6: {step.title}")
        browser.click("tour-skip")
    wait_for_card(browser, "That was the tour")


@pytest.mark.parametrize(
    ("thing", "opened"), [("hands", "breaking"), ("chip-0", "pin-0-hold"), ("share", "save-program")]
)
def test_the_tour_ends_with_three_next_things_and_each_opens_its_part(bench, thing, opened):
    browser = bench.browser
    browser.open(bench.panel.address)
    skip_to_the_end(browser)
    assert "Three things to do next" in browser.text("tour-title")
    things = browser.driver.find_elements("css selector", "[data-test^='tour-then-']")
    assert [t.get_attribute("data-test") for t in things if t.is_displayed()] == [
        "tour-then-hands", "tour-then-chip-0", "tour-then-share",
    ]  # fmt: skip
    browser.click(f"tour-then-{thing}")
    browser.until(lambda: browser.find(opened).is_displayed())
    assert not browser.find("tour-title").is_displayed()
