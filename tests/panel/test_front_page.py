"""Front panels and the bus console in a real browser: clicks and keys, asserted on the page and by what the carriage does."""

import pytest

pytestmark = pytest.mark.slow


def type_into(browser, name, text):
    from selenium.webdriver.common.keys import Keys

    element = browser.until(lambda: browser.find(name))
    browser.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
    element.click()
    element.send_keys(Keys.CONTROL + "a")  # held down to the end of the call
    element.send_keys(text)
    return element


def console(browser, *lines):
    from selenium.webdriver.common.keys import Keys

    for line in lines:
        type_into(browser, "console", line + Keys.ENTER)
        browser.until(lambda: browser.find("console").get_attribute("value") == "")


def press(browser, name):
    """A click that no other element can catch: the page may be long."""
    browser.driver.execute_script("arguments[0].click()", browser.until(lambda: browser.find(name)))


def lit(browser, name):
    return "on" in browser.find(name).get_attribute("class").split()


def test_a_register_is_written_in_its_row_and_the_bus_tells_how(browser):
    from selenium.webdriver.common.keys import Keys

    type_into(browser, "value-0-R1", "64h" + Keys.ENTER)
    browser.until(lambda: browser.find("value-0-R1").get_attribute("value") == "100")
    browser.until(lambda: "select R1: FL speed" in browser.text("trace"))
    type_into(browser, "value-0-R1", "77" + Keys.ESCAPE)
    browser.until(lambda: browser.find("value-0-R1").get_attribute("value") == "100")


def test_what_is_no_number_is_said_at_the_field_and_nothing_is_written(browser):
    from selenium.webdriver.common.keys import Keys

    before = browser.text("trace")
    type_into(browser, "value-0-R1", "1O0" + Keys.ENTER)
    browser.until(lambda: "Did you mean 100?" in browser.driver.page_source)
    assert browser.text("trace") == before
    browser.find("value-0-R1").send_keys(Keys.ESCAPE)


def test_lines_of_the_console_and_a_button_move_the_carriage_and_a_lamp_says_so(browser):
    console(browser, "R2 <- 2000", "R4 <- 300", "R5 <- 300", "R7 <- 300", "R0 <- 3000", "44")
    assert lit(browser, "pin-0-hold")
    press(browser, "command-0-operate-15")
    browser.until(lambda: not lit(browser, "pin-0-hold"))
    browser.until(lambda: "start, ramp to FH1" in browser.text("trace"))
    browser.until(lambda: lit(browser, "pin-0-hold"))
    browser.until(lambda: browser.find("value-0-R0").get_attribute("value") == "0")
    console(browser, "R0", "read 0")
    browser.until(lambda: "R0 = 0 pulses: down counter" in browser.text("trace"))
    browser.until(lambda: "status: " in browser.text("trace"))


def test_the_console_remembers_lines_completes_names_and_says_what_is_wrong_there(browser):
    from selenium.webdriver.common.keys import Keys

    console(browser, "R3 <- 77", "8")
    field = type_into(browser, "console", Keys.ARROW_UP)
    browser.until(lambda: field.get_attribute("value") == "8")
    field.send_keys(Keys.ARROW_UP)
    browser.until(lambda: field.get_attribute("value") == "R3 <- 77")
    type_into(browser, "console", "oper" + Keys.TAB)
    browser.until(lambda: field.get_attribute("value") == "operate ")
    type_into(browser, "console", "reed 0" + Keys.ENTER)
    browser.until(lambda: "Did you mean read?" in browser.driver.page_source)
    field.send_keys(Keys.ESCAPE)


def test_a_wrong_byte_is_the_chips_diagnostic(browser):
    console(browser, "R7 <- 1")
    browser.until(lambda: "diagnostics (" in browser.text("diagnostics"))
    assert "! " in browser.text("trace")
