"""The scene in a fresh browser: drawn when time stands still, with the carriages where they are, and sharp at rest."""

import io

import numpy as np
import pytest

from stage import Stage
from stage.panel.session import Session

pytestmark = pytest.mark.slow

GROUPS = """const scene = getElement(Number(arguments[0].id.slice(1)));
const groups = scene.scene.children.filter((item) => item.type === 'Group');
return [groups.map((group) => group.position.toArray()), scene.renderer.getPixelRatio(), devicePixelRatio]"""


@pytest.fixture(scope="module")
def paused_panel(browser_programs):
    """Panel of xy whose time stands still, with both carriages away from the middle."""
    from stage.panel.server import Panel

    with Session(Stage("xy"), paused=True) as session, Panel(session) as panel:
        session.do(lambda stage: stage.place(x=0.03, y=-0.02))
        yield panel


@pytest.mark.parametrize("visit", range(2))
def test_a_page_that_opens_on_a_paused_stage_shows_the_carriages_where_they_are(paused_panel, open_browser, visit):
    image = pytest.importorskip("PIL.Image")
    browser = open_browser(paused_panel.address)
    places = paused_panel.session.do(lambda stage: stage.data.xpos.copy())

    def is_drawn_sharply():
        groups, ratio, full = browser.driver.execute_script(GROUPS, browser.find("scene"))
        matches = [np.abs(places - group).max(axis=1).min() < 1e-5 for group in groups]
        moved = [group for group in groups if np.abs(group).max() > 0.01]
        return len(groups) == len(places) and all(matches) and len(moved) >= 2 and ratio == full

    def is_bright():
        picture = io.BytesIO(browser.driver.find_element("css selector", ".scene canvas").screenshot_as_png)
        return (np.asarray(image.open(picture).convert("L")) > 60).mean() > 0.1

    browser.until(is_bright)
    browser.until(is_drawn_sharply)
