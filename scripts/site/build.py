"""Lay out the documentation site in build/site for `zensical build`: `make docs`.

    python scripts/site/build.py [FOLDER]   pages, reference and configuration
    cd build/site && zensical build --strict

Pages of docs/ are copied as they are, those of packages/NAME/ into NAME/; README.md is the start page. Files of the repository to
which pages link become pages of the site, so the site is complete without the repository. The reference is generated from
`__all__` of the packages, the parser of the command line, and the chips' register maps.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import tomllib
from pathlib import Path

import gallery
import reference

ROOT = Path(__file__).resolve().parents[2]
OUT = Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else ROOT / "build" / "site"
PAGES = OUT / "pages"
LINK = re.compile(r"(\]\()([^)\s#]+)(#[^)]*)?(\))")
LANGUAGES = {
    ".py": "python",
    ".c": "c",
    ".h": "c",
    ".hpp": "cpp",
    ".cpp": "cpp",
    ".toml": "toml",
    ".xml": "xml",
    ".json": "json",
}


def main() -> None:
    """Lay out the whole site again."""
    shutil.rmtree(OUT, ignore_errors=True)
    shutil.copytree(ROOT / "docs", PAGES)
    (PAGES / "index.md").write_text((ROOT / "README.md").read_text())
    for package in _packages():
        if (package / "docs").is_dir():
            shutil.copytree(package / "docs", PAGES / package.name)
        else:
            (PAGES / package.name).mkdir()
        shutil.copy(package / "README.md", PAGES / package.name / "index.md")
    reference_pages = reference.write(PAGES)
    gallery.write(ROOT, PAGES)
    linked: set[Path] = set()
    for page in sorted(PAGES.rglob("*.md")):
        page.write_text(_replace_links(page.read_text(), _source_of(page), page, linked))
    for file in sorted(linked):
        _write_listing_page(file)
    _link_source()
    _write_configuration(reference_pages)
    print(f"{OUT}: {len(list(PAGES.rglob('*.md')))} pages")


def _packages() -> list[Path]:
    """Return the folders of the distributions of their own."""
    return sorted(file.parent for file in ROOT.glob("packages/*/pyproject.toml"))


def _folders() -> dict[Path, Path]:
    """Return where the pages of a folder of the repository lie in the site."""
    return {ROOT / "docs": PAGES} | {package / "docs": PAGES / package.name for package in _packages()}


def _source_of(page: Path) -> Path:
    """Return the file of the repository that a page is a copy of."""
    for package in (ROOT, *_packages()):
        if page == (PAGES if package == ROOT else PAGES / package.name) / "index.md":
            return package / "README.md"
    folder, into = max(
        ((f, to) for f, to in _folders().items() if page.is_relative_to(to)), key=lambda pair: len(pair[1].parts)
    )
    return folder / page.relative_to(into)


def _page_of(file: Path) -> Path | None:
    """Return the page or picture of the site that a file of the repository becomes, None where it becomes none."""
    for package in (ROOT, *_packages()):
        if file == package / "README.md":
            return (PAGES if package == ROOT else PAGES / package.name) / "index.md"
    copies = [to / file.relative_to(folder) for folder, to in _folders().items() if file.is_relative_to(folder)]
    return copies[0] if copies and file.is_file() else None


def _replace_links(text: str, source: Path, page: Path, linked: set[Path]) -> str:
    """Replace the links of a page by links to pages of the site, and return the text.

    Args:
        text: Text of the page.
        source: File of the repository from which the links lead.
        page: Page of the site.
        linked: Set to which linked files without a page are added.
    """

    def led(m: re.Match) -> str:
        if re.match(r"[a-z]+:", m[2]):
            return m[0]
        at = (source.parent / m[2]).resolve()
        if not at.is_relative_to(ROOT) or not at.exists():
            return m[0]  # of the generated pages, or broken: the build says so
        to = _page_of(at)
        if to is None:
            linked.add(at)
            to = _get_listing_page(at)
        return f"{m[1]}{Path(os.path.relpath(to, page.parent)).as_posix()}{m[3] or ''}{m[4]}"

    return LINK.sub(led, text)


def _get_listing_page(file: Path) -> Path:
    """Return the page of the site that shows a file or folder of the repository."""
    return PAGES / "files" / f"{file.relative_to(ROOT).as_posix()}.md"


def _write_listing_page(file: Path) -> None:
    """Write a page with the contents of a file, or the list of a folder."""
    page = _get_listing_page(file)
    page.parent.mkdir(parents=True, exist_ok=True)
    name = file.relative_to(ROOT).as_posix()
    if file.is_dir():
        listed = "\n".join(f"- `{p.name}`" for p in sorted(file.iterdir()) if not p.name.startswith(("_", ".")))
        page.write_text(f"# {name}\n\n{listed}\n")
    elif file.suffix == ".md":
        page.write_text(
            re.sub(LINK, lambda m: m[0] if ":" in m[2] else f"`{m[2]}`", file.read_text()).replace("]`", "] `")
        )
    else:
        text = file.read_text()
        fence = "`" * (max((len(m) for m in re.findall(r"`{3,}", text)), default=2) + 1)
        page.write_text(f"# {name}\n\n{fence}{LANGUAGES.get(file.suffix, 'text')}\n{text.rstrip()}\n{fence}\n")


def _link_source() -> None:
    """Link the package as it is installed, for mkdocstrings: envs/ is stage.envs."""
    package = OUT / "source" / "stage"
    package.mkdir(parents=True)
    for part in [*(ROOT / "stage").iterdir(), ROOT / "envs"]:
        (package / part.name).symlink_to(part)


def _write_configuration(reference_pages: dict[str, list[tuple[str, str]]]) -> None:
    """Write zensical.toml, with the pages of the reference in its `nav`."""
    text = (ROOT / "scripts" / "site" / "zensical.toml").read_text()
    for group, pages in reference_pages.items():
        listed = "".join(f'      {{ "{title}" = "{path}" }},\n' for title, path in pages)
        text = text.replace(f'{{ "{group}" = [] }}', f'{{ "{group}" = [\n{listed}    ] }}')
    tomllib.loads(text)
    (OUT / "zensical.toml").write_text(text)


if __name__ == "__main__":
    main()
