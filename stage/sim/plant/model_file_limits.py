"""Limits on the size to which a model file may expand, checked before MuJoCo reads the file.

A few lines of MJCF can ask for more than any machine holds: nested `<replicate>`s, a `<composite>` of 100,000 bodies, a height
field of 10^10 samples, a mesh whose file is a pipe. MuJoCo cannot be interrupted while it compiles, so this module counts the
elements first, and refuses such a model. The bounds are far above the needs of a motion stage, and up to them MuJoCo needs seconds.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from stage.errors import ModelError
from stage.support.foreign_files import open_regular, read_bytes

MAX_ELEMENTS = 20_000
MAX_COMPOSITE_BODIES = 1_000  # MuJoCo's time to compile a chain grows with the square of its length
MAX_SAMPLES = 2**26  # of all height fields, pixels of all textures, and numbers of user data of all elements
MAX_ARRAY_SIZE = 2**20  # numbers in <size>, and of all sensors and of all that is delayed
MAX_MESH_RESOLUTION = 512  # of a mesh that MuJoCo makes; its vertices grow with the square
MAX_FLEX_FILE_BYTES = 2**21  # each point of the file becomes a body
MAX_FILE_BYTES = 2**28
MAX_MODEL_FILES = 1_000

_MARKUP = re.compile(
    r"""<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>|<![^>]*>|(<[^<>"'!?](?:[^<>"']|"[^"]*"|'[^']*')*+>)""", re.DOTALL
)
"""Comments, sections of text, declarations, each as long as for MuJoCo; and tags, so that none of the others begins in one."""
_CONTROL_CHARACTER = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f]")
_LITERAL_AMPERSAND = re.compile(r"&(?!(?:amp|lt|gt|quot|apos|#[0-9]+|#x[0-9a-fA-F]+);)")
_PNG, _PNG_SIZE = b"\x89PNG\r\n\x1a\n", slice(16, 24)
_FOLDER_ATTRIBUTES = ("meshdir", "texturedir", "assetdir")  # attributes of <compiler>
_SIZE_ATTRIBUTES = re.compile(r"nuser.*|nkey")
_SENSOR_SIZE_ATTRIBUTES = ("dim", "num", "nsample")


def check_model_size(path: Path) -> None:
    """Raise ModelError if the model file at `path` expands beyond the bounds of this module.

    Files that it includes or attaches are counted with it. What is not well-formed XML is refused, too.
    """
    _ModelSizeCounter(path).check()


class _ModelSizeCounter:
    """Counter of the elements to which a model file and the files that it names expand."""

    def __init__(self, path: Path):
        self.path = path
        self._elements = self._samples = self._readings = 0
        self._user_numbers = 1  # of each element
        self._files = 0
        self._folders = {path.parent}

    def check(self) -> None:
        """Count the whole model. Raises ModelError if it exceeds a limit."""
        self._add_file(self.path, 1, ())
        self._check_limit("size", "numbers of user data", self._elements * self._user_numbers, MAX_SAMPLES)

    def _add_file(self, path: Path, copies: int, parents: tuple[Path, ...]) -> None:
        """Count the elements of a file `copies` times; `parents` are the files by which it is included, the outermost first."""
        self._files += 1
        if path in parents:
            raise ModelError(
                f"{self.path}: {path} includes itself. Remove the <include> or <attach> that closes the circle."
            )
        if self._files > MAX_MODEL_FILES:
            raise ModelError(f"{self.path} reads more than {MAX_MODEL_FILES:,} files. Merge or remove some of them.")
        root = _parse_bounded_xml(path)
        for compiler in root.iter("compiler"):
            self._folders |= {path.parent / compiler.get(name, "") for name in _FOLDER_ATTRIBUTES}
        self._folders.add(path.parent)
        models = {m.get("name") or Path(m.get("file", "")).stem: m.get("file", "") for m in root.iter("model")}
        stack = [(root, copies)]
        while stack:
            element, times = stack.pop()
            self._add_element(element, times)
            for file in self._iterate_files(element):
                if element.tag == "include":
                    self._add_file(file, times, (*parents, path))
            if element.tag == "attach":
                for file in self._find_file(models.get(element.get("model", ""), "")):
                    self._add_file(file, times, (*parents, path))
            inner = times * _multiply_counts(element.get("count")) if element.tag == "replicate" else times
            stack.extend((child, inner) for child in element)

    def _add_element(self, element: ElementTree.Element, copies: int) -> None:
        """Count an XML element and the elements inside it `copies` times."""
        tag = element.tag
        if tag in ("composite", "flexcomp"):
            points = max(len(element.get(name, "").split()) // 3 for name in ("vertex", "point"))
            copies *= max(_multiply_counts(element.get("count")), points)
        self._elements += copies
        self._check_limit(tag, "elements", self._elements, MAX_ELEMENTS)
        if tag == "composite":
            self._check_limit(tag, "bodies", copies, MAX_COMPOSITE_BODIES)
        elif tag == "hfield":
            self._add_samples(element, "samples", ("nrow", "ncol"))
        elif tag == "texture":
            self._add_samples(element, "pixels", ("width", "height", "nchannel"))
        elif tag == "mesh" and element.get("builtin"):
            resolution = max((_multiply_counts(count) for count in element.get("params", "").split()), default=1)
            self._check_limit(tag, "segments a side", resolution, MAX_MESH_RESOLUTION)
        elif tag == "size":
            self._add_sizes(element)
        elif sizes := [_multiply_counts(element.get(name)) for name in _SENSOR_SIZE_ATTRIBUTES if element.get(name)]:
            self._readings += copies * math.prod(sizes)
            self._check_limit(tag, "readings", self._readings, MAX_ARRAY_SIZE)

    def _add_sizes(self, element: ElementTree.Element) -> None:
        """Count the sizes that an element declares, such as the userdata of <size>."""
        for name, value in element.items():
            if _SIZE_ATTRIBUTES.fullmatch(name):
                self._check_limit(element.tag, name, _multiply_counts(value), MAX_ARRAY_SIZE)
                if name != "nkey":
                    self._user_numbers = max(self._user_numbers, _multiply_counts(value))

    def _add_samples(self, element: ElementTree.Element, unit: str, sizes: tuple[str, ...]) -> None:
        """Count the samples of a height field or a texture, from its sizes, or from the header of its picture file."""
        self._samples += math.prod(_multiply_counts(element.get(name)) for name in sizes)
        self._samples += sum(map(_count_pixels, self._iterate_files(element)))
        self._check_limit(element.tag, unit, self._samples, MAX_SAMPLES)

    def _check_limit(self, tag: str, unit: str, count: int, limit: int) -> None:
        """Raise ModelError if a count exceeds a limit."""
        if count > limit:
            raise ModelError(
                f"{self.path} expands to {count:,} {unit} at its <{tag}>, and a model may have {limit:,}. Lower the sizes "
                "and counts there and of each <replicate> around it, or pass an MjModel that you compiled yourself."
            )

    def _iterate_files(self, element: ElementTree.Element) -> Iterator[Path]:
        """Yield the files that an element names and that exist, each a regular file of bounded size."""
        max_bytes = MAX_FLEX_FILE_BYTES if element.tag == "flexcomp" else MAX_FILE_BYTES
        for name, value in element.items():
            if name.startswith("file") and value:
                yield from self._find_file(value, max_bytes)

    def _find_file(self, name: str, max_bytes: int = MAX_FILE_BYTES) -> Iterator[Path]:
        """Yield the path of a file that the model names, if it exists and is small enough."""
        for folder in self._folders if name else ():
            path = folder / name
            if path.exists():
                open_regular(path, "file of a model", max_bytes, ModelError).close()
                yield path
                return


class _BoundedTreeBuilder(ElementTree.TreeBuilder):
    """Builder of an XML tree that stops with an error at the first element beyond the maximum of a model."""

    def __init__(self, path: Path):
        super().__init__()
        self._path, self._count = path, 0

    def start(self, tag: str, attrs: dict[str, str], /) -> ElementTree.Element:
        """Count one more element. Raises ModelError."""
        self._count += 1
        if self._count > MAX_ELEMENTS:
            raise ModelError(
                f"{self._path} has more than {MAX_ELEMENTS:,} elements, at its <{tag}>, and a model may have so many. Remove "
                "some of them, or pass an MjModel that you compiled yourself."
            )
        return super().start(tag, attrs)


def _parse_bounded_xml(path: Path) -> ElementTree.Element:
    """Parse an XML file as leniently as MuJoCo does: any bytes in texts, any dashes in comments, no entities."""
    content = read_bytes(path, "MJCF file", MAX_FILE_BYTES, ModelError).decode(errors="replace")
    text = _MARKUP.sub(lambda match: match[1] or "", _CONTROL_CHARACTER.sub(" ", content))
    text = _LITERAL_AMPERSAND.sub("&amp;", text[max(text.find("<"), 0) :])
    try:
        return ElementTree.fromstring(text, ElementTree.XMLParser(target=_BoundedTreeBuilder(path)))
    except ElementTree.ParseError as error:
        raise ModelError(f"{path} is no MJCF that MuJoCo reads: it is not well-formed XML ({error}).") from None


def _count_pixels(path: Path) -> int:
    """Return the number of pixels in the header of a PNG picture; 0 for any other file, whose size in bytes is limited."""
    with open_regular(path, "file of a model", MAX_FILE_BYTES, ModelError) as file:
        head = file.read(_PNG_SIZE.stop)
    if not head.startswith(_PNG) or len(head) < _PNG_SIZE.stop:
        return 0
    width, height = struct.unpack(">II", head[_PNG_SIZE])
    return int(width * height)


def _multiply_counts(counts: str | None) -> int:
    """Return the product of the whole numbers in an attribute. Other words count as 1, because MuJoCo refuses them later."""
    try:
        return math.prod(max(int(float(count)), 1) for count in (counts or "1").split())
    except (ValueError, OverflowError):
        return 1
