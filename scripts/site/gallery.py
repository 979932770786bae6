"""Gallery of the site: every picture of the docs, with the page that explains it and the command that draws it."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import NamedTuple

PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)]*pictures/[^)]+)\)")

ELSEWHERE = {
    "patterns/": "python scripts/draw_patterns.py",
    "fault_": "stage fault {} --plot FILE.png",
    "origin_spread": "python scripts/origin_spread.py",
    "model_": "python scripts/render_models.py",
}
"""Pictures, by the begin of their names, that no script names in full."""


class Picture(NamedTuple):
    """Picture of the docs.

    Attributes:
        file: File in docs/pictures.
        says: Alternative text.
        page: Page in docs, or README.md.
        command: Command that draws the picture.
    """

    file: Path
    says: str
    page: Path
    command: str


def list_pictures(root: Path) -> list[Picture]:
    """List every picture of the pages once, in the order of the pages."""
    pictures_by_file: dict[Path, Picture] = {}
    for page in [root / "README.md", *sorted((root / "docs").rglob("*.md"))]:
        for says, link in PICTURE.findall(page.read_text()):
            file = (page.parent / link).resolve()
            pictures_by_file.setdefault(file, Picture(file, says, page, find_command(root, file)))
    return list(pictures_by_file.values())


def find_command(root: Path, file: Path) -> str:
    """Return the command that draws a picture: `make pictures`, another target of make, or a script that names it; "" for none.

    Args:
        root: Root of the repository.
        file: File of the picture.
    """
    name = file.relative_to(root / "docs").as_posix()
    for line in (root / "Makefile").read_text().splitlines():
        if line.startswith("\t") and f"docs/{name}" in line:
            return re.sub(r"^\$\(BIN\)/(python )?", r"\1", line.strip().replace("$(CURDIR)/", "")).split(" && ")[0]
    for begin, command in ELSEWHERE.items():
        if name.startswith(f"pictures/{begin}"):
            return command.format(file.stem.removeprefix(begin).replace("_", "-"))
    for script in sorted((root / "scripts").rglob("*.py")):
        if "site" not in script.parts and f"{file.stem}.png" in script.read_text():
            return f"python {script.relative_to(root).as_posix()}"
    return ""


def make_title(says: str) -> str:
    """Return the title of a picture: its alternative text up to the first colon or semicolon, with a capital letter."""
    title = re.split("[:;]", says)[0].strip()
    return title[:1].upper() + title[1:]


def read_heading(page: Path) -> str:
    """Return the first heading of a page."""
    return next(line.removeprefix("# ").strip() for line in page.read_text().splitlines() if line.startswith("# "))


def write(root: Path, pages: Path) -> None:
    """Write gallery.md to the pages of the site.

    Args:
        root: Root of the repository.
        pages: Folder of the site's pages.
    """
    text = ["# Gallery\n", "Every picture is made by a command. Its page says what it shows.\n"]
    for p in list_pictures(root):
        page = "index.md" if p.page.name == "README.md" else p.page.relative_to(root / "docs").as_posix()
        command = f"`{p.command}`" if p.command else ""
        text.append(f"## {make_title(p.says)}\n")
        text.append(f"[![{p.says}]({os.path.relpath(p.file, root / 'docs')})]({page})\n")
        text.append(f"{p.says} (page [{read_heading(p.page)}]({page})). {command}\n")
    (pages / "gallery.md").write_text("\n".join(text))
