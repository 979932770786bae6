"""Cache of object files of sketches and their libraries, so that a file that has not changed is not compiled again.

An object file is found by the compiler, its version, the command, the source, and the names of the headers in the include folders.
A description beside it has the digests of all headers that it was made from; if one of them differs, the file is compiled again.
The folder is `pulsestage/objects` in $XDG_CACHE_HOME, or in ~/.cache; without a folder that can be written, everything is compiled.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from stage.native import object_file_cache
from stage.support.subprocesses import run_program

MAX_FILES = 3000
"""Files of the cache, three for each object; beyond, the oldest third is removed."""
HEADERS = (".h", ".hh", ".hpp", ".hxx", ".inc", ".ipp", ".tpp", ".def", "")
"""Suffixes of files that sources include."""
FOLDER_PLACEHOLDER = "@TEMPORARY@"
"""Stands for the folder of translated sketches, which has another name in each build."""
VARIABLES = ("CPATH", "C_INCLUDE_PATH", "CPLUS_INCLUDE_PATH", "COMPILER_PATH", "GCC_EXEC_PREFIX")
_EXTRA_OUTPUT_PATTERN = re.compile(
    r"--coverage|-fprofile|-ftest-coverage|-save-temps|-M|-d|-Wp,|@|-fplugin|-specs|-B|-x"
)


def can_cache(flags: Sequence[str]) -> bool:
    """Return whether a compilation with flags of a user has an object file as its only result."""
    return not any(_EXTRA_OUTPUT_PATTERN.match(flag) for flag in flags)


class CompiledObjectCache:
    """Cache of object files.

    Args:
        temporary: Folder of translated sketches and of files that are removed after the build.
        compiler: The compiler, perhaps with a program before it, as in "ccache g++".
    """

    def __init__(self, temporary: Path, compiler: str):
        self._temporary, self._compiler = str(temporary), compiler
        self._digests: dict[Path, str] = {}
        self._folder: Path | None = None
        try:
            root = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
            folder = root / "pulsestage" / "objects"
            folder.mkdir(parents=True, exist_ok=True)
            self._folder = folder
        except (OSError, RuntimeError):  # a home folder may be unknown, too
            pass

    def compile(
        self, source: Path, command: Sequence[str], output: Path, run: Callable[[list[str]], str]
    ) -> tuple[Path, str]:
        """Compile a source, or find its object file.

        Args:
            source: The source.
            command: Compiler with its options, without the output.
            output: Object file if the cache cannot be used.
            run: Function that runs a command and returns the messages of the compiler, or raises an error.

        Returns:
            The object file and the messages.
        """
        target = output if self._folder is None else self._folder / f"{self._compute_key(source, command)}.o"
        if self._folder is not None and (message := self._read_valid_message(target)) is not None:
            return target, message
        dependencies = output.with_suffix(".d")
        message = run([*command, "-MD", "-MF", str(dependencies), "-o", str(output)])
        try:
            if self._folder is not None:
                self._store(target, output, dependencies, message)
                return target, message
        except OSError:
            self._folder = None
        return output, message

    def _compute_key(self, source: Path, command: Sequence[str]) -> str:
        """Return the name of an object file: a digest of what decides about it, apart from the contents of headers."""
        folders = {source.parent, *(Path(text.removeprefix("-I")) for text in command if text.startswith("-I"))}
        names = {
            str(folder): sorted(entry.name for entry in folder.iterdir() if entry.is_dir() or entry.suffix in HEADERS)
            for folder in folders
            if str(folder) != self._temporary and folder.is_dir()
        }
        parts = [
            self._insert_placeholder(" ".join(command)),
            hashlib.sha256(source.read_bytes().replace(self._temporary.encode(), b"")).hexdigest(),
            names, str(Path.cwd()), describe_compiler(self._compiler), [os.environ.get(name) for name in VARIABLES],
        ]  # fmt: skip
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode(errors="surrogateescape")).hexdigest()

    def _read_valid_message(self, target: Path) -> str | None:
        """Return the messages of the compiler about an object file that can be used as it is, or None."""
        try:
            description = json.loads(target.with_suffix(".json").read_text(encoding="utf-8"))
            is_current = all(
                self._compute_digest(Path(self._expand_placeholder(name))) == digest
                for name, digest in description["files"].items()
            )
        except (OSError, ValueError, KeyError):
            return None
        if not (is_current and object_file_cache.is_intact(target)):
            return None
        os.utime(target)
        return self._expand_placeholder(description["message"])

    def _store(self, target: Path, output: Path, dependencies: Path, message: str) -> None:
        """Store an object file in the cache, with the digests of all files that it was made from."""
        text = (
            dependencies.read_text(encoding="utf-8", errors="surrogateescape").partition(": ")[2].replace("\\\n", " ")
        )
        names = [name.replace("\\ ", " ") for name in re.split(r"(?<!\\)\s+", text) if name]
        description = {
            "files": {self._insert_placeholder(name): self._compute_digest(Path(name)) for name in names},
            "message": self._insert_placeholder(message),
        }
        self._remove_oldest()
        object_file_cache.write_object(target, output.read_bytes())
        part = target.with_suffix(f".{os.getpid()}.part")
        part.write_text(json.dumps(description), encoding="utf-8")
        part.replace(target.with_suffix(".json"))

    def _compute_digest(self, path: Path) -> str:
        """Return the digest of a file's content; a header that many sources include is read once."""
        if path not in self._digests:
            self._digests[path] = hashlib.sha256(path.read_bytes()).hexdigest()
        return self._digests[path]

    def _remove_oldest(self) -> None:
        """Remove the oldest third of the files in the cache if there are too many."""
        assert self._folder is not None
        files = [(entry.stat().st_mtime, entry.path) for entry in os.scandir(self._folder)]
        for _, path in sorted(files)[: len(files) // 3] if len(files) > MAX_FILES else ():
            Path(path).unlink(missing_ok=True)

    def _insert_placeholder(self, text: str) -> str:
        """Replace the path of the temporary build folder in a compiler's text by a placeholder."""
        return text.replace(self._temporary, FOLDER_PLACEHOLDER)

    def _expand_placeholder(self, text: str) -> str:
        """Insert the path of the temporary build folder into a compiler's text from the cache."""
        return text.replace(FOLDER_PLACEHOLDER, self._temporary)


@functools.cache
def describe_compiler(compiler: str) -> str:
    """Return what a compiler prints about its version. The compiler may have a program before it, as in "ccache g++"."""
    return run_program([*compiler.split(), "--version"]).stdout
