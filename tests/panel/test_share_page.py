"""Saving and opening in a real browser: the file that the menu saves goes on in another panel, bit for bit."""

import re
import subprocess
import sys
import zipfile

import pytest

pytestmark = pytest.mark.slow


@pytest.fixture
def panel_of():
    """Panels of the command line: panel_of(arguments) -> address."""
    processes = []

    def begin(*arguments):
        command = [sys.executable, "-m", "stage", "panel", *map(str, arguments), "--port", "0", "--no-browser"]
        processes.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        return re.match(r"http://\S+", processes[-1].stdout.readline())[0]

    yield begin
    for process in processes:
        process.terminate()
        process.wait(20)
        process.stdout.close()


def test_a_saved_panel_continues_in_another_process(panel_of, open_browser, tmp_path):
    first = open_browser(panel_of("xy", "--chips", "pcl240ms"))
    first.type("move-distance", "8")
    first.click("go-move")
    first.until(lambda: "done" in first.text("report"))
    first.click("play")
    first.until(lambda: "stands still" in first.text("pace"))
    for name, ending, begins in (
        ("program", "py", '"""The panel'),
        ("c", "c", "/* What was done"),
        ("test_program", "py", '"""What was'),
    ):
        first.click("share")
        first.click(f"save-{name}")
        assert first.downloaded(ending).decode().startswith(begins)
    first.click("share")
    first.click("save-panel")
    file = tmp_path / "panel.zip"
    file.write_bytes(first.downloaded("zip"))
    assert {"panel.json", "now.snapshot", "start.snapshot", "program.py"} <= set(zipfile.ZipFile(file).namelist())

    other = open_browser(panel_of("--open", file, "--paused"))
    assert other.text("time") == first.text("time")
    assert other.text("position-x") == first.text("position-x")
    assert "PCL240MS" in other.driver.page_source
    for browser in (first, other):
        browser.click("step")
    other.until(lambda: other.text("time") == first.text("time") != "")
    assert other.text("position-x") == first.text("position-x")
