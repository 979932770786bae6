"""python scripts/worked_examples: every number of the sheets is what the chips do, and the page says so."""

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def page():
    sys.path.insert(0, str(ROOT / "scripts"))
    try:
        from worked_examples import page
    finally:
        sys.path.pop(0)
    return page


@pytest.fixture(scope="module")
def rows(page):
    return page.compute_rows()


def test_every_number_of_the_sheets_is_what_the_chips_do(rows):
    differ = {f"{e.sheet}, {e.place}: {e.says}": (e.number, result) for e, result in rows if not e.agrees(result)}
    assert not differ
    assert len(rows) >= 55


def test_the_page_is_that_of_today(page, rows):
    text = (ROOT / "docs" / "worked_examples.md").read_text()
    assert page.replace_tables(text, page.format_tables(rows)) == text, (
        "python scripts/worked_examples --markdown docs/worked_examples.md"
    )


def test_a_number_that_differs_from_the_data_sheet_is_marked(page, rows):
    example, result = rows[0]
    assert "**differs** by more than 0" in page.format_tables([(example, result + 1)])
