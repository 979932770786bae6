"""The site's pages are complete: each page of docs/ is in the navigation, each link leads somewhere, the reference has what is."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from stage.chips import CHIPS

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site as scripts/site/build.py lays it out, in a folder of its own."""
    out = tmp_path_factory.mktemp("site") / "site"
    subprocess.run([sys.executable, "scripts/site/build.py", str(out)], cwd=ROOT, check=True, capture_output=True)
    return out


def list_entries(nav):
    for entry in nav:
        for at in entry.values():
            yield from list_entries(at) if isinstance(at, list) else [at]


def test_every_page_is_in_the_navigation_and_every_entry_is_a_page(site):
    named = list(list_entries(tomllib.loads((site / "zensical.toml").read_text())["project"]["nav"]))
    pages = {p.relative_to(site / "pages").as_posix() for p in (site / "pages").rglob("*.md")}
    assert len(named) == len(set(named))
    assert set(named) == {p for p in pages if not p.startswith("files/")}


def test_every_relative_link_of_the_site_leads_to_a_file(site):
    for page in (site / "pages").rglob("*.md"):
        text = re.sub(r"^(`{3,}).*?^\1", "", page.read_text(), flags=re.M | re.S)
        for link in re.findall(r"\]\(([^)\s#]+)[^)]*\)", text):
            assert re.match("[a-z]+:", link) or (page.parent / link).exists(), f"{page}: {link}"


def test_the_reference_has_every_chip_with_its_registers_and_every_command(site):
    reference = site / "pages" / "reference"
    for line in CHIPS.list_chips():
        if line.package == "pulsestage":
            page = (reference / f"map_{line.name.lower()}.md").read_text()
            assert all(f"`{r.name}`" in page for r in line.chip.MAP.registers)
            assert all(f"`{c.symbol}`" in page for c in line.chip.MAP.commands)
    assert "## stage new-model" in (reference / "command_line.md").read_text()
    assert "::: stage.sim.stage.Stage" in (reference / "stage.md").read_text()


def test_every_picture_of_the_gallery_names_its_command(site):
    gallery = (site / "pages" / "gallery.md").read_text()
    assert gallery.count("[![") == gallery.count("## ")
    for entry in gallery.split("\n## ")[1:]:
        assert re.search(r"`(stage|python|make) [^`]+`", entry), entry


def test_titles_of_the_gallery_are_phrases_that_differ(site):
    """Not names of files: "fault bus voltage", "model xy mast"."""
    titles = re.findall(r"^## (.*)$", (site / "pages" / "gallery.md").read_text(), re.M)
    assert len(set(titles)) == len(titles)
    assert all(title[0].isupper() and "_" not in title.removeprefix("The model ").partition(" ")[2] for title in titles)
    stems = {path.stem.replace("_", " ") for path in (ROOT / "docs" / "pictures").rglob("*.png")}
    assert not {title for title in titles if title in stems}, "a title is no name of a file"
