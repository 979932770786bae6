"""README.md for a package index: relative links become absolute links to the tagged version of the repository."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

PAGE = Path("build") / "README.index.md"
"""Path of the page for the package index, as pyproject.toml states it."""
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\((?![a-z]+:|#)([^)\s]+)\)")


def make_index_page(text: str, source: str, tag: str) -> str:
    """Return the text with absolute links.

    Args:
        text: Contents of README.md.
        source: Address of the repository, such as https://github.com/OWNER/NAME.
        tag: Tag of the version.
    """
    raw = source.replace("https://github.com/", "https://raw.githubusercontent.com/")

    def absolute(m: re.Match[str]) -> str:
        mark, words, target = m[1], LINK.sub(absolute, m[2]), m[3]  # a picture may be what is clicked
        return f"{mark}[{words}]({raw}/{tag}/{target})" if mark else f"[{words}]({source}/blob/{tag}/{target})"

    parts = re.split(r"(^```.*?^```$)", text, flags=re.M | re.S)  # code stays as it is
    return "".join(part if part.startswith("```") else LINK.sub(absolute, part) for part in parts)


def write_index_page(root: Path) -> None:
    """Write the page for a package index from pyproject.toml and README.md of a checkout.

    Args:
        root: Folder of the checkout.
    """
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    text = (root / "README.md").read_text(encoding="utf-8")
    (root / PAGE).parent.mkdir(exist_ok=True)
    (root / PAGE).write_text(
        make_index_page(text, project["urls"]["Source"], f"v{project['version']}"), encoding="utf-8"
    )
