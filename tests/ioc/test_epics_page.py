"""The program of docs/epics.md runs and prints what the page says."""

import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.ioc(model="xyz", chips="mcx514", pace="free")

PAGE = Path(__file__).parents[2] / "docs" / "epics.md"


def test_the_program_of_the_page_prints_what_the_page_says(ioc, capsys):
    pytest.importorskip("ophyd")
    pytest.importorskip("bluesky")
    program, printed = re.search(
        r"```python\n(.*?)```\n\n```text\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S
    ).groups()
    exec(compile(program, str(PAGE), "exec"), {})
    assert capsys.readouterr().out == printed
