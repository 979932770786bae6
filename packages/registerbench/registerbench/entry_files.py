"""The file of an entry: what a player played, as data. Entries come from strangers, so nothing in a file is ever executed.

An entry is a zip archive of exactly these members, so `unzip -p FILE entry.json` shows what it says about itself:

entry.json     format, task, split, track, round, the settings that the player chose, player, notes, cost, seeds, names of the
               scores, versions, parts of the environment, types, and the checksum of all members
steps          number of steps of each episode, int64
actions        action of every step of every episode, in the type and shape of the action space
rewards        reward of every step, float64
seen           a digest of 8 bytes for each observation: that of the reset and those of the steps (`observation_digests`)
scores         (episodes, names) float64

All numbers are little-endian. A file has at most MAX_FILE_BYTES, and its members have at most MAX_UNPACKED_BYTES together.

Published entries lie in one archive for each task, a zip file without further compression: `read_entries("line.zip")` reads all
of its entries, `read_entry("line.zip/line-train-random-0.bench")` reads one of them.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stage.errors import ArgumentError
from stage.support.files import write_atomically
from stage.support.foreign_files import DocumentError, parse_json, read_bytes, read_members

FORMAT_VERSION = 1
FORMAT_NAME = "RegisterBench entry"
MAX_FILE_BYTES, MAX_UNPACKED_BYTES, MAX_HEADER_BYTES = (
    16 << 20,
    64 << 20,
    1 << 20,
)  # bytes: of the file, of all its members, of entry.json
MAX_ARCHIVE_BYTES = 256 << 20
ARRAY_MEMBERS = ("steps", "actions", "rewards", "seen", "scores")
MEMBERS = ("entry.json", *ARRAY_MEMBERS)
ARRAY_TYPES = {"steps": "<i8", "rewards": "<f8", "seen": "<u8", "scores": "<f8"}
ACTION_TYPES = ("<f4", "<f8", "<i4", "<i8", "|i1", "|u1")
TEXT_KEYS = ("task", "split", "track", "round", "player", "notes")
OPTIONAL_KEYS = ("training",)  # texts that older entries lack
MAX_TEXT_LENGTH = 4000
ZIP_DATE = (1980, 1, 1, 0, 0, 0)  # a constant, so that the same entry gives the same bytes whenever it is packed


@dataclass(frozen=True)
class Entry:
    """The test episodes of a split, as one player played them.

    Attributes:
        task, split, track, round: What was played.
        settings: Settings that the player chose.
        player: Name of the player.
        run: Number of the training run, if a learner has several.
        notes: Text of the player.
        cost: What the player spent, by name. The moves of the test are counted; the rest is as the player states it.
        seeds: Seeds of the episodes.
        steps: Number of steps of each episode, (episodes,).
        actions: Actions of all episodes one after the other, (all steps, ...).
        rewards: Rewards likewise, (all steps,).
        observation_digests: A digest of each observation, (all steps + episodes,).
        scores: Scores by name, (episodes,) each.
        versions: Versions with which the entry was made.
        made_of: Parts of the environment, in words.
        training: Command that trains this run and writes its entry again, with {run}, {task}, {split}, {round} and {out} in place
            of their values; "" if there is none. Reading an entry never runs it.
    """

    task: str
    split: str
    track: str
    round: str
    settings: dict[str, Any]
    player: str
    run: int
    notes: str
    cost: dict[str, float]
    seeds: tuple[int, ...]
    steps: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    observation_digests: np.ndarray
    scores: dict[str, np.ndarray]
    versions: dict[str, str]
    made_of: dict[str, str]
    training: str = ""

    def pack(self) -> bytes:
        """Return the bytes of the file; equal entries give equal bytes."""
        arrays = {
            "steps": self.steps, "actions": self.actions, "rewards": self.rewards, "seen": self.observation_digests,
            "scores": np.stack(list(self.scores.values()), axis=1),
        }  # fmt: skip
        types = {**ARRAY_TYPES, "actions": self.actions.dtype.newbyteorder("<").str}
        if types["actions"] not in ACTION_TYPES:
            raise ArgumentError(
                f"actions of type {self.actions.dtype}: use one of the types {', '.join(ACTION_TYPES)}."
            )
        contents = {name: np.ascontiguousarray(a, types[name]).tobytes() for name, a in arrays.items()}
        header = {
            "format": [FORMAT_NAME, FORMAT_VERSION], "task": self.task, "split": self.split, "track": self.track,
            "round": self.round, "settings": self.settings, "player": self.player, "run": self.run, "notes": self.notes,
            "cost": self.cost, "seeds": list(self.seeds), "scores": list(self.scores),
            "actions": [types["actions"], list(self.actions.shape[1:])], "versions": self.versions, "made_of": self.made_of,
            **({"training": self.training} if self.training else {}),
        }  # fmt: skip
        text = json.dumps(
            {**header, "checksum": _compute_checksum(header, contents)}, indent=1, sort_keys=True, allow_nan=False
        )
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as archive:
            for name, content in {"entry.json": text.encode(), **contents}.items():
                member = zipfile.ZipInfo(name, ZIP_DATE)
                member.external_attr, member.create_system = 0o644 << 16, 3
                archive.writestr(member, content, zipfile.ZIP_DEFLATED, 9)
        return file.getvalue()

    def write(self, path: str | os.PathLike, overwrite: bool = False) -> None:
        """Write the entry to a file.

        Args:
            path: Path of the file.
            overwrite: Whether to replace an existing file.

        Raises:
            FileError: The file cannot be written.
            EntryError: `read_entry` would refuse the entry.
        """
        content = self.pack()
        unpack_entry(content)
        if len(content) > MAX_FILE_BYTES:
            raise ArgumentError(f"the entry has {len(content)} bytes, and a file at most {MAX_FILE_BYTES}.")
        with write_atomically(path, overwrite) as part:
            part.write_bytes(content)


class EntryError(ArgumentError):
    """Error of a file that is not a complete, undamaged entry of this format."""


def read_entry(path: str | os.PathLike) -> Entry:
    """Read an entry from a file or from ARCHIVE.zip/NAME. Raises EntryError for any other file and for one that does not exist."""
    archive = Path(path).parent
    if archive.suffix == ".zip" and archive.is_file():
        return unpack_entry(_read_archive(archive, [Path(path).name])[Path(path).name], str(path))
    return unpack_entry(read_bytes(path, "entry", MAX_FILE_BYTES, EntryError), str(path))


def read_entries(path: str | os.PathLike) -> dict[str, Entry]:
    """Read all entries of an archive, or the one entry of a file, by file name. Raises EntryError as `read_entry` does."""
    if Path(path).suffix != ".zip":
        return {Path(path).name: read_entry(path)}
    return {name: unpack_entry(content, f"{path}/{name}") for name, content in _read_archive(Path(path)).items()}


def _read_archive(path: Path, members: Sequence[str] = ()) -> dict[str, bytes]:
    """Return the content of each of these members of an archive, by name; by default of all members. Raises EntryError."""

    def make_entry_error(why: str) -> EntryError:
        return EntryError(f"{path} is not an archive of entries: {why}. Get it again from where it came.")

    content = read_bytes(path, "archive of entries", MAX_ARCHIVE_BYTES, EntryError)
    if not members:
        try:
            members = zipfile.ZipFile(io.BytesIO(content)).namelist()
        except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError) as why:
            raise make_entry_error(f"it is not a zip archive ({why!s:.200})") from None
    return read_members(content, members, MAX_ARCHIVE_BYTES, make_entry_error)


def unpack_entry(content: bytes, name: str = "the entry") -> Entry:
    """Read an entry from the bytes of its file.

    Args:
        content: Bytes of the file.
        name: Name of the file, for error messages.

    Raises:
        EntryError: The bytes are not a complete, undamaged entry.
    """

    def make_entry_error(why: str) -> EntryError:
        return EntryError(f"{name} is not an entry of the benchmark: {why}. Get it again from where it came.")

    raw = read_members(content, MEMBERS, MAX_UNPACKED_BYTES, make_entry_error, exact=True)
    header = _parse_header(raw.pop("entry.json"), name)
    if header.pop("checksum", None) != _compute_checksum(header, raw):
        raise EntryError(f"{name} is damaged or was changed by hand: its checksum does not match its content.")
    return _build_entry(header, raw, name)


def _parse_header(text: bytes, name: str) -> dict[str, Any]:
    """Parse entry.json and check its format. Raises EntryError."""

    def refuse_constant(word: str) -> Any:
        raise ValueError(f"{word} is not a number")

    if len(text) > MAX_HEADER_BYTES:
        raise EntryError(f"{name}: entry.json has {len(text)} bytes; at most {MAX_HEADER_BYTES} are read.")
    try:
        header = parse_json(text, refuse_constant)
    except DocumentError as why:
        raise EntryError(f"{name}: entry.json cannot be read: {why}.") from None
    mark = header.get("format") if isinstance(header, dict) else None
    if not isinstance(mark, list) or len(mark) != 2 or mark[0] != FORMAT_NAME:
        raise EntryError(f"{name}: entry.json lacks the format of an entry.")
    if mark[1] != FORMAT_VERSION or isinstance(mark[1], bool):
        raise EntryError(
            f"{name} has format {mark[1]!r:.60}, and this PulseStage reads format {FORMAT_VERSION}: "
            "use the PulseStage with which the entry was made."
        )
    return header


def _build_entry(header: dict[str, Any], raw: Mapping[str, bytes], name: str) -> Entry:
    """Build an entry from its header and the bytes of its arrays. Raises EntryError for a value that is not allowed."""

    def make_entry_error(what: str) -> EntryError:
        return EntryError(f"{name}: {what}.")

    _check_types(header, make_entry_error)
    _check_values(header, make_entry_error)
    arrays: dict[str, Any] = _parse_arrays(header, raw, make_entry_error)
    scores = dict(zip(header["scores"], arrays.pop("scores").T, strict=True))
    texts = {key: header[key] for key in TEXT_KEYS} | {key: header.get(key, "") for key in OPTIONAL_KEYS}
    return Entry(
        **texts, settings=header["settings"], run=header["run"], cost=header["cost"], seeds=tuple(header["seeds"]),
        observation_digests=arrays.pop("seen"), **arrays, scores=scores, versions=header["versions"], made_of=header["made_of"],
    )  # fmt: skip


def _check_types(header: dict[str, Any], refuse: Callable[[str], EntryError]) -> None:
    """Raise EntryError unless the header has exactly the keys of an entry, each with a value of its type."""
    kinds: dict[str, type] = {
        **dict.fromkeys(("settings", "cost", "versions", "made_of"), dict),
        **dict.fromkeys(("seeds", "scores", "actions"), list), "run": int, **dict.fromkeys(TEXT_KEYS, str),
    }  # fmt: skip
    kinds |= {key: str for key in OPTIONAL_KEYS if key in header}
    if sorted(header) != sorted([*kinds, "format"]):
        raise refuse(f"entry.json must have the keys {', '.join(sorted([*kinds, 'format', 'checksum']))}")
    for key, kind in kinds.items():
        if not isinstance(header[key], kind) or isinstance(header[key], bool):
            raise refuse(f"{key} must be of type {kind.__name__}")
        if isinstance(header[key], str) and not _is_text(header[key], MAX_TEXT_LENGTH):
            raise refuse(f"{key} is longer than {MAX_TEXT_LENGTH} characters, or has characters that cannot be printed")


def _check_values(header: dict[str, Any], refuse: Callable[[str], EntryError]) -> None:
    """Raise EntryError for seeds, costs, texts and names that an entry may not have."""
    if not all(_is_count(s) for s in header["seeds"]) or not header["seeds"]:
        raise refuse("seeds must be one or more integers, 0 or greater")
    if not all(
        isinstance(v, int | float) and not isinstance(v, bool) and 0 <= v <= 1e15 for v in header["cost"].values()
    ):
        raise refuse("cost must have numbers from 0 to 1e15")
    for key in ("versions", "made_of"):
        if not all(_is_text(v, MAX_TEXT_LENGTH) for v in header[key].values()):
            raise refuse(f"{key} must have texts of at most {MAX_TEXT_LENGTH} characters")
    keys = [k for part in ("settings", "cost", "versions", "made_of") for k in header[part]] + header["scores"]
    if not all(_is_text(k, 200) for k in keys):
        raise refuse("a name must be a text of at most 200 characters")
    if len(set(header["scores"])) != len(header["scores"]) or "return" not in header["scores"]:
        raise refuse("scores must have different names, and 'return' must be one of them")


def _is_text(value: Any, max_length: int) -> bool:
    """Return whether a value is a str of at most `max_length` characters."""
    return isinstance(value, str) and len(value) <= max_length and value.isprintable()


def _is_count(value: Any) -> bool:
    """Return whether a value is an int from 0 up."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 63


def _parse_arrays(
    header: dict[str, Any], raw: Mapping[str, bytes], refuse: Callable[[str], EntryError]
) -> dict[str, np.ndarray]:
    """Parse the arrays of an entry, by the name of the member. Raises EntryError if their sizes do not fit."""
    action_type = header["actions"]
    if (
        len(action_type) != 2
        or action_type[0] not in ACTION_TYPES
        or not isinstance(action_type[1], list)
        or len(action_type[1]) > 4
    ):
        raise refuse(f"actions must have one of the types {', '.join(ACTION_TYPES)}, and a shape")
    if not all(_is_count(n) and 0 < n <= 1 << 16 for n in action_type[1]):
        raise refuse("actions must have a shape of positive integers")
    episodes = len(header["seeds"])
    if len(raw["steps"]) != 8 * episodes:
        raise refuse(f"steps has {len(raw['steps'])} bytes, and {episodes} episodes require {8 * episodes}")
    steps = np.frombuffer(raw["steps"], "<i8")
    if (steps < 1).any() or (steps > MAX_UNPACKED_BYTES).any():
        raise refuse("an episode must have one step or more")
    total = int(steps.sum())
    shapes = {"actions": (total, *action_type[1]), "rewards": (total,), "seen": (total + episodes,)}
    shapes["scores"] = (episodes, len(header["scores"]))
    arrays = {"steps": steps.astype(np.int64)}
    for key, shape in shapes.items():
        dtype = np.dtype(action_type[0] if key == "actions" else ARRAY_TYPES[key])
        expected = int(np.prod(shape, dtype=object)) * dtype.itemsize
        if len(raw[key]) != expected:
            raise refuse(
                f"{key} has {len(raw[key])} bytes, and {total} steps in {episodes} episodes require {expected}"
            )
        arrays[key] = np.frombuffer(raw[key], dtype).reshape(shape).astype(dtype.newbyteorder("="))
    return arrays


def _compute_checksum(header: Mapping[str, Any], raw: Mapping[str, bytes]) -> str:
    """Compute the checksum of an entry. It finds damage, and does not prove who made the entry."""
    digest = hashlib.blake2b(json.dumps(header, sort_keys=True).encode(), digest_size=16)
    for name in ARRAY_MEMBERS:
        digest.update(hashlib.blake2b(raw[name]).digest())
    return digest.hexdigest()
