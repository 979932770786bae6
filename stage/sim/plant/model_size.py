"""Bounds on what a model file may expand to, checked before MuJoCo reads it.

A few lines of MJCF can ask for more than any machine holds: nested `<replicate>`s, a `<composite>` of 100,000 bodies, a height
field of 10^10 samples, a mesh whose file is a pipe. MuJoCo cannot be interrupted while it compiles, so such a model is refused by
counting. The bounds lie far above what a motion stage needs; within them MuJoCo compiles for seconds, not for hours.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from stage.errors import ModelError
from stage.foreign_files import open_regular, read_bytes

MAX_ELEMENTS = 20_000
MAX_COMPOSITE_BODIES = 1_000  # MuJoCo's time to compile a chain grows with the square of its length
MAX_SAMPLES = 2**24  # of a height field, and pixels of a texture
MAX_ARRAY_SIZE = 2**20  # numbers in <size>
MAX_FILE_BYTES = 2**28
MAX_MODEL_FILES = 1_000

_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_FOLDERS = ("meshdir", "texturedir", "assetdir")  # attributes of <compiler>
_SIZES = re.compile(r"nuser.*|nkey")


def check_model_size(path: Path) -> None:
    """Raise ModelError if the model file at `path` expands beyond the bounds of this module.

    Files that it includes or attaches are counted with it. What is not well-formed XML is refused, too.
    """
    _Counter(path).check()


class _Counter:
    """Number of elements that a model file expands to, with the files that it names."""

    def __init__(self, path: Path):
        self.path = path
        self._elements = 0
        self._files = 0
        self._folders = {path.parent}

    def check(self) -> None:
        self._add_file(self.path, 1, ())

    def _add_file(self, path: Path, copies: int, parents: tuple[Path, ...]) -> None:
        """Count `copies` of a file; `parents` are the files that led here."""
        self._files += 1
        if path in parents:
            raise ModelError(
                f"{self.path}: {path} includes itself. Remove the <include> or <attach> that closes the circle."
            )
        if self._files > MAX_MODEL_FILES:
            raise ModelError(f"{self.path} reads more than {MAX_MODEL_FILES:,} files. Merge or remove some of them.")
        root = _parse(path)
        for compiler in root.iter("compiler"):
            self._folders |= {path.parent / compiler.get(name, "") for name in _FOLDERS}
        self._folders.add(path.parent)
        models = {m.get("name") or Path(m.get("file", "")).stem: m.get("file", "") for m in root.iter("model")}
        stack = [(root, copies)]
        while stack:
            element, times = stack.pop()
            self._add_element(element, times)
            for file in self._files_of(element):
                if element.tag == "include":
                    self._add_file(file, times, (*parents, path))
            if element.tag == "attach":
                for file in self._find(models.get(element.get("model", ""), "")):
                    self._add_file(file, times, (*parents, path))
            inner = times * _product(element.get("count")) if element.tag == "replicate" else times
            stack.extend((child, inner) for child in element)

    def _add_element(self, element: ElementTree.Element, copies: int) -> None:
        tag = element.tag
        if tag in ("composite", "flexcomp"):
            copies *= _product(element.get("count"))
        self._elements += copies
        self._require(tag, "elements", self._elements, MAX_ELEMENTS)
        if tag == "composite":
            self._require(tag, "bodies", copies, MAX_COMPOSITE_BODIES)
        elif tag == "hfield":
            self._require(tag, "samples", _product(element.get("nrow")) * _product(element.get("ncol")), MAX_SAMPLES)
        elif tag == "texture":
            self._require(tag, "pixels", _product(element.get("width")) * _product(element.get("height")), MAX_SAMPLES)
        elif tag == "size":
            for name, value in element.items():
                if _SIZES.fullmatch(name):
                    self._require(tag, name, _product(value), MAX_ARRAY_SIZE)

    def _require(self, tag: str, unit: str, count: int, limit: int) -> None:
        if count > limit:
            raise ModelError(
                f"{self.path} expands to {count:,} {unit} at its <{tag}>, and a model may have {limit:,}. Lower the counts of "
                "this element and of each <replicate> around it, or pass an MjModel that you compiled yourself."
            )

    def _files_of(self, element: ElementTree.Element) -> Iterator[Path]:
        """Files that an element names and that exist, each a regular file of bounded size."""
        for name, value in element.items():
            if name.startswith("file") and value:
                yield from self._find(value)

    def _find(self, name: str) -> Iterator[Path]:
        for folder in self._folders if name else ():
            path = folder / name
            if path.exists():
                open_regular(path, "file of a model", MAX_FILE_BYTES, ModelError).close()
                yield path
                return


def _parse(path: Path) -> ElementTree.Element:
    """The root of an XML file, read as leniently as MuJoCo does: any bytes in texts, any dashes in comments."""
    content = read_bytes(path, "MJCF file", MAX_FILE_BYTES, ModelError)
    text = _COMMENT.sub("", content.decode(errors="replace"))
    try:
        return ElementTree.fromstring(re.sub(r"^\s*<\?xml.*?\?>", "", text, flags=re.DOTALL).strip())
    except ElementTree.ParseError as error:
        raise ModelError(f"{path} is no MJCF that MuJoCo reads: it is not well-formed XML ({error}).") from None


def _product(counts: str | None) -> int:
    """The product of whole numbers in an attribute; what is no number counts as 1, as MuJoCo refuses it."""
    try:
        return math.prod(max(int(float(count)), 1) for count in (counts or "1").split())
    except (ValueError, OverflowError):
        return 1
