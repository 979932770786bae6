"""Draw docs/pictures/panel.png, panel_dark.png, panel_phone.png and the film panel.gif: a panel in a real browser, headless.

python scripts/panel_pictures.py [--no-film]        Chromium and its driver from the system; extra `browser`, and Pillow
"""

from __future__ import annotations

import argparse
import io
import shutil
import time
from pathlib import Path
from typing import Any

from PIL import Image
from selenium import webdriver

from stage import Stage, firmware
from stage.panel.server import Panel
from stage.panel.session import Session
from stage.panel.tour_page import COOKIE

OUT = Path(__file__).parents[1] / "docs" / "pictures"
WIDE, PHONE, FILM = (1400, 900), (390, 844), (1400, 900)
FRAMES, BETWEEN = 34, 0.06  # of the film; simulated seconds


def open_browser(address: str, size: tuple[int, int], dark: bool = False) -> Any:
    options = webdriver.ChromeOptions()
    wanted = ["--headless=new", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--hide-scrollbars"]
    for argument in (*wanted, *(["--force-dark-mode"] if dark else [])):
        options.add_argument(argument)
    options.binary_location = shutil.which("chromium") or ""
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    driver.execute_cdp_cmd("Network.setCookie", {"name": COOKIE, "value": "seen", "url": address})  # no tour
    driver.get(address)
    time.sleep(5)
    return driver


def click_button(driver: Any, name: str) -> None:
    driver.execute_script("arguments[0].click()", driver.find_element("css selector", f"[data-test='{name}']"))


def take_screenshot(driver: Any) -> Image.Image:
    return Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB")


def save_small_picture(picture: Image.Image, path: Path) -> None:
    """Save a picture with 256 colors, which are enough for a page."""
    picture.quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


def draw_pictures(session: Session, panel: Panel) -> None:
    """Take the pictures of the panel after a dual-rate move."""
    for name, size, dark in (("panel", WIDE, False), ("panel_dark", WIDE, True), ("panel_phone", PHONE, False)):
        session.reset()
        driver = open_browser(panel.address, size, dark)
        click_button(driver, "tab-two_rates")
        time.sleep(1)
        click_button(driver, "go-two_rates")
        while "pulses" not in panel.reports.find_outcome("two_rates").text:
            time.sleep(0.01)
        session.paused = True  # with the move in the window of the oscilloscope
        while not driver.find_elements("css selector", ".pattern svg"):
            time.sleep(0.1)
        driver.execute_script("window.scrollTo(0, 0)")
        time.sleep(3)
        save_small_picture(take_screenshot(driver), OUT / f"{name}.png")
        session.paused = False
        driver.quit()


def record_film(session: Session, panel: Panel) -> None:
    """Record a line of both axes picture by picture, so that the film is smooth on a slow machine, too."""
    session.reset()
    session.paused = True
    driver = open_browser(panel.address, FILM)
    move = session.act("line", lambda stage: firmware.line({"x": 0.06, "y": 0.03}, stage.axes))
    frames, steps = [], round(BETWEEN * 1e9 / session.stage.state.dt)
    for _ in range(FRAMES):
        begin = session.stage.now
        session.speed, session.paused = 1.0, False
        while session.stage.now - begin < steps * session.stage.state.dt:
            time.sleep(0.002)
        session.paused = True
        time.sleep(0.8)  # the page draws it
        frames.append(take_screenshot(driver).resize((FILM[0] * 5 // 9, FILM[1] * 5 // 9), Image.Resampling.LANCZOS))
    session.paused = False
    move.result()
    driver.quit()
    palette = frames[len(frames) // 2].quantize(128, dither=Image.Dither.NONE)
    drawn = [f.quantize(palette=palette, dither=Image.Dither.NONE) for f in frames]
    path = OUT / "panel.gif"
    drawn[0].save(path, save_all=True, append_images=drawn[1:], duration=90, loop=0, optimize=True)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--no-film", action="store_true", help="pictures only")
    args = parser.parse_args()
    with Session(Stage("xy", chips="pcl240ms")) as session:
        panel = Panel(session)
        draw_pictures(session, panel)
        if not args.no_film:
            record_film(session, panel)
        panel.close()


if __name__ == "__main__":
    main()
