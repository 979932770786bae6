"""FrontPanel panels and the bus console in a real browser: clicks and keys, asserted on the page and on the stage."""

import pytest

pytestmark = pytest.mark.slow


def enter(text):
    from selenium.webdriver.common.keys import Keys

    return text + Keys.ENTER


def holds(bench, name):
    return bench.stage(lambda stage: stage.chips[0].axis_values(0)[name])


def console(bench, *lines):
    for line in lines:
        bench.browser.type("console", enter(line))
        bench.browser.until(lambda: bench.browser.value("console") == "")


def test_a_register_is_written_in_its_row_and_the_trace_shows_the_cycles(bench):
    from selenium.webdriver.common.keys import Keys

    browser = bench.browser
    browser.type("value-0-R1", enter("64h"))
    browser.until(lambda: browser.value("value-0-R1") == "100")
    assert holds(bench, "R1") == 100
    browser.until(lambda: "select R1: FL speed" in browser.text("trace"))
    browser.type("value-0-R1", "77" + Keys.ESCAPE)
    browser.until(lambda: browser.value("value-0-R1") == "100")
    assert holds(bench, "R1") == 100


def test_an_invalid_number_is_an_error_at_the_field_and_not_written(bench):
    from selenium.webdriver.common.keys import Keys

    browser = bench.browser
    before = browser.text("trace")
    browser.type("value-0-R1", enter("1O0"))
    browser.until(lambda: "Did you mean 100?" in browser.driver.page_source)
    assert browser.text("trace") == before
    assert holds(bench, "R1") == 100
    browser.find("value-0-R1").send_keys(Keys.ESCAPE)


def test_a_field_of_a_word_is_set_and_sent_by_the_button(bench):
    """Bits of a word that cannot be read back are put together on the page; one cycle brings them to the chip."""
    browser = bench.browser
    browser.click("fields-0-output")
    browser.choose("field-0-output-ots", "1  high")
    browser.until(lambda: browser.value("value-0-output") == "E0h")
    assert not browser.lit("pin-0-ots")
    browser.click("send-0-output")
    browser.until(lambda: browser.lit("pin-0-ots"))
    assert bench.stage(lambda stage: stage.chips[0].output_word(0) & stage.chips[0].OUTPUTS["ots"])
    browser.until(lambda: " W  0: E0" in browser.text("trace"))


def test_a_command_moves_the_carriage_and_a_lamp_says_so(bench):
    browser = bench.browser
    console(bench, "R2 <- 2000", "R4 <- 300", "R5 <- 300", "R7 <- 300", "R0 <- 9000", "44")
    assert browser.lit("pin-0-hold")
    at = bench.x("commanded")
    browser.click("command-0-operate-15")
    browser.until(lambda: not browser.lit("pin-0-hold"))
    browser.until(lambda: "start, ramp to FH1" in browser.text("trace"))
    browser.until(lambda: browser.lit("pin-0-hold"))
    browser.until(lambda: browser.value("value-0-R0") == "0")
    goal = at + 9000 * bench.x("meters_per_pulse")
    assert bench.x("commanded") == pytest.approx(goal, abs=1e-9)
    browser.until(lambda: bench.x("position") == pytest.approx(goal, abs=2e-6))
    displayed = browser.until(lambda: browser.text("position-x"))
    assert float(displayed.split()[0]) == pytest.approx(goal * 1e3, abs=0.01)


def test_the_console_sends_bytes_and_shows_the_trace_in_words(bench):
    browser = bench.browser
    console(bench, "81", "2: 1", "1: F4")
    assert holds(bench, "R1") == 500
    console(bench, "R1 <- 100", "R0", "read 0")
    assert holds(bench, "R1") == 100
    browser.until(lambda: "R0 = 0 pulses: down counter" in browser.text("trace"))
    browser.until(lambda: "status: " in browser.text("trace"))


def test_the_console_recalls_lines_completes_names_and_shows_errors(bench):
    from selenium.webdriver.common.keys import Keys

    browser = bench.browser
    console(bench, "R3 <- 77", "8")
    field = browser.type("console", Keys.ARROW_UP)
    browser.until(lambda: field.get_attribute("value") == "8")
    field.send_keys(Keys.ARROW_UP)
    browser.until(lambda: field.get_attribute("value") == "R3 <- 77")
    field.send_keys(Keys.ARROW_DOWN)
    browser.until(lambda: field.get_attribute("value") == "8")
    browser.type("console", "oper" + Keys.TAB)
    browser.until(lambda: field.get_attribute("value") == "operate ")
    browser.type("console", enter("reed 0"))
    browser.until(lambda: "Did you mean read?" in browser.driver.page_source)
    field.send_keys(Keys.ESCAPE)
    browser.until(lambda: field.get_attribute("value") == "")


def test_a_wrong_byte_is_the_chips_diagnostic(bench):
    browser = bench.browser
    console(bench, "R7 <- 1")
    browser.until(lambda: "diagnostics (" in browser.text("diagnostics"))
    browser.until(lambda: "! " in browser.text("trace"))
    lines = browser.find("trace").find_elements("css selector", "div, span")
    color = "return getComputedStyle(arguments[0]).color"
    colors = {line.text[:40]: browser.driver.execute_script(color, line) for line in lines if line.text.strip()}
    red = [text for text, value in colors.items() if value == "rgb(229, 72, 77)"]
    assert red, "red is for mistakes"
    assert all("! " in text for text in red), "and for them only"
    browser.click("diagnostics")
    message = bench.stage(lambda stage: stage.chips[0].diagnostics[-1].message)
    browser.until(lambda: message in browser.text("diagnosed"))
    bench.session.reset()
    browser.until(lambda: not browser.find("diagnostics").is_displayed())
