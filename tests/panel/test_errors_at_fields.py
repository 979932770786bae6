"""What was wrong at a field is said no more at the next attempt, also where nobody has touched that field."""

import pytest

pytest.importorskip("nicegui")


@pytest.fixture(scope="module")
def page(served):
    page = served.visit()
    yield page
    served.leave()


def test_the_next_attempt_shows_only_its_own_errors(page):
    for form, press in (("move", lambda: page.click("go-move")), ("jog", lambda: page.fire("jog-plus", "pointerdown"))):
        first, second = (f"{form}-{name}" for name in ("speed", "accel"))
        page.put(first, "1")
        page.put(second, "99")
        press()
        page.until(lambda s=second: "up to 60 s" in page.error(s))
        page.put(first, "-1")
        press()
        page.until(lambda f=first: "more than 0" in page.error(f))
        assert page.error(second) == ""
        page.put(first, "")
        page.put(second, "0.15")


def test_a_second_attempt_at_a_fault_shows_only_its_own_errors(served, page):
    page.put("breaking", "bounce")
    page.put("break-toggles", "2.5")
    page.click("break")
    page.until(lambda: "a whole number" in page.error("break-toggles"))
    page.put("break-seconds", "soon")
    page.click("break")
    page.until(lambda: "is not a number" in page.error("break-seconds"))
    assert page.error("break-toggles") == ""
    assert not served.panel.fault_controls.faults_in_force


def test_an_error_at_the_force_is_removed_when_the_motor_is_stronger(served, page):
    limit = served.panel.fault_controls.compute_user_push_limit
    page.put("push-force", "1e9")
    page.fire("push-plus", "pointerdown")
    page.until(lambda: page.error("push-force"))
    served.panel.fault_controls.compute_user_push_limit = lambda axis: 2e9
    try:
        page.fire("push-plus", "pointerdown")
        page.until(lambda: not page.error("push-force"))
    finally:
        served.panel.fault_controls.compute_user_push_limit = limit
        page.fire("push-plus", "pointerup")
        page.until(lambda: not served.session.do(lambda stage: stage.data.qfrc_applied.any()))
