"""The file of an entry: what was played, as data. It comes from strangers, and nothing in it is ever run.

A zip archive of exactly these members, so that `unzip -p FILE entry.json` shows what it says about itself:

entry.json     FORMAT, task, split, track, round, settings chosen, player, notes, cost, seeds, names of the scores, versions,
               what the environment was made of, types, and the checksum of all members
steps          how many steps each episode took, int64
actions        of every step of every episode, in the type and shape of the action space
rewards        of every step, float64
seen           a digest of each observation, 8 bytes: of the reset and of each step
scores         (episodes, names) float64

All numbers are little-endian. A file is at most LARGEST, unpacked at most UNPACKED.

Published entries are kept in an archive a task, a zip file without further compression: `read_all("line.zip")` reads all of its
entries, `read("line.zip/line-train-random-0.bench")` one of them.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stage.errors import ArgumentError
from stage.support.files import written
from stage.support.foreign_files import DocumentError, parse_json, read_bytes, read_members

FORMAT = 1
MARK = "RegisterBench entry"
LARGEST, UNPACKED, WORDS = 16 << 20, 64 << 20, 1 << 20  # bytes: of the file, of all its members, of entry.json
MAX_ARCHIVE_BYTES = 256 << 20
ARRAYS = ("steps", "actions", "rewards", "seen", "scores")
MEMBERS = ("entry.json", *ARRAYS)
TYPES = {"steps": "<i8", "rewards": "<f8", "seen": "<u8", "scores": "<f8"}
ACTIONS = ("<f4", "<f8", "<i4", "<i8", "|i1", "|u1")  # types that an action may have
TEXTS = ("task", "split", "track", "round", "player", "notes")
LONG = 4000  # characters of a text, at most
WHEN = (1980, 1, 1, 0, 0, 0)  # the same entry gives the same bytes, whenever it is packed


@dataclass(frozen=True)
class Submission:
    """An entry: the test episodes of a split, as one player played them.

    settings: those that the player chose; run: number of the training run, where there are several; cost: what it took, by names
    (moves of the test are counted, the rest is as the player says); made_of: what the environment was made of, in words.
    steps (episodes,); actions (steps in all, ...); rewards (steps in all,); seen (steps in all + episodes,); scores (episodes,),
    each.
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
    seen: np.ndarray
    scores: dict[str, np.ndarray]
    versions: dict[str, str]
    made_of: dict[str, str]

    def pack(self) -> bytes:
        """The bytes of the file; equal entries give equal bytes."""
        arrays = {
            "steps": self.steps, "actions": self.actions, "rewards": self.rewards, "seen": self.seen,
            "scores": np.stack(list(self.scores.values()), axis=1),
        }  # fmt: skip
        types = {**TYPES, "actions": self.actions.dtype.newbyteorder("<").str}
        if types["actions"] not in ACTIONS:
            raise ArgumentError(f"actions of type {self.actions.dtype}: one of {', '.join(ACTIONS)}.")
        raw = {name: np.ascontiguousarray(a, types[name]).tobytes() for name, a in arrays.items()}
        header = {
            "format": [MARK, FORMAT], "task": self.task, "split": self.split, "track": self.track, "round": self.round,
            "settings": self.settings, "player": self.player, "run": self.run, "notes": self.notes, "cost": self.cost,
            "seeds": list(self.seeds), "scores": list(self.scores), "actions": [types["actions"], list(self.actions.shape[1:])],
            "versions": self.versions, "made_of": self.made_of,
        }  # fmt: skip
        text = json.dumps({**header, "checksum": _checksum(header, raw)}, indent=1, sort_keys=True, allow_nan=False)
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as archive:
            for name, content in {"entry.json": text.encode(), **raw}.items():
                member = zipfile.ZipInfo(name, WHEN)
                member.external_attr, member.create_system = 0o644 << 16, 3
                archive.writestr(member, content, zipfile.ZIP_DEFLATED, 9)
        return file.getvalue()

    def write(self, path: str | os.PathLike, overwrite: bool = False) -> None:
        """Write the entry.

        Args:
            path: Of the file.
            overwrite: Replace a file that is there.

        Raises:
            FileError: The file cannot be written.
            Refused: `read` would refuse the entry.
        """
        content = self.pack()
        unpack(content)
        if len(content) > LARGEST:
            raise ArgumentError(f"the entry has {len(content)} bytes, and a file at most {LARGEST}.")
        with written(path, overwrite) as part:
            part.write_bytes(content)


class Refused(ArgumentError):
    """A file that is no whole entry of this format."""


def read(path: str | os.PathLike) -> Submission:
    """Read an entry from a file or from ARCHIVE.zip/NAME. Raises Refused for any other file, also for one that does not exist."""
    archive = Path(path).parent
    if archive.suffix == ".zip" and archive.is_file():
        return unpack(_read_archive(archive, [Path(path).name])[Path(path).name], str(path))
    return unpack(read_bytes(path, "entry", LARGEST, Refused), str(path))


def read_all(path: str | os.PathLike) -> dict[str, Submission]:
    """Read all entries of an archive, or the one entry of a file, by the names of their files. Raises Refused as `read` does."""
    if Path(path).suffix != ".zip":
        return {Path(path).name: read(path)}
    return {name: unpack(content, f"{path}/{name}") for name, content in _read_archive(Path(path)).items()}


def write_archive(archive: str | os.PathLike, paths: Iterable[str | os.PathLike], overwrite: bool = False) -> None:
    """Pack files of entries into an archive; equal files give equal bytes.

    Args:
        archive: To write.
        paths: Of the entries.
        overwrite: Replace an archive that is there.

    Raises:
        FileError: The archive cannot be written.
    """
    with written(archive, overwrite) as part, zipfile.ZipFile(part, "w") as packed:
        for path in sorted(map(Path, paths)):
            packed.writestr(zipfile.ZipInfo(path.name, WHEN), path.read_bytes())


def _read_archive(path: Path, names: Sequence[str] = ()) -> dict[str, bytes]:
    """Return the files of these names in an archive, by default all. Raises Refused."""

    def refuse(why: str) -> Refused:
        return Refused(f"{path}: not an archive of entries: {why}. Get it again from where it came.")

    content = read_bytes(path, "archive of entries", MAX_ARCHIVE_BYTES, Refused)
    if not names:
        try:
            names = zipfile.ZipFile(io.BytesIO(content)).namelist()
        except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError) as why:
            raise refuse(f"it is no zip archive ({why!s:.200})") from None
    return read_members(content, names, MAX_ARCHIVE_BYTES, refuse)


def unpack(content: bytes, name: str = "the entry") -> Submission:
    """Read an entry from the bytes of a file.

    Args:
        content: Bytes.
        name: Of the file, for errors.

    Raises:
        Refused: The bytes are no entry.
    """

    def refuse(why: str) -> Refused:
        return Refused(f"{name}: not an entry of the bench: {why}. Get it again from where it came.")

    raw = read_members(content, MEMBERS, UNPACKED, refuse, only=True)
    header = _format_error(raw.pop("entry.json"), name)
    if header.pop("checksum", None) != _checksum(header, raw):
        raise Refused(f"{name}: damaged or changed by hand: its checksum is not that of what is in it.")
    return _submission(header, raw, name)


def _format_error(text: bytes, name: str) -> dict[str, Any]:
    def no_number(word: str) -> Any:
        raise ValueError(f"{word} is no number")

    if len(text) > WORDS:
        raise Refused(f"{name}: entry.json has {len(text)} bytes, and at most {WORDS} are read.")
    try:
        header = parse_json(text, no_number)
    except DocumentError as why:
        raise Refused(f"{name}: entry.json cannot be read: {why}.") from None
    mark = header.get("format") if isinstance(header, dict) else None
    if not isinstance(mark, list) or len(mark) != 2 or mark[0] != MARK:
        raise Refused(f"{name}: entry.json does not begin as an entry does.")
    if mark[1] != FORMAT or isinstance(mark[1], bool):
        raise Refused(
            f"{name}: of format {mark[1]!r:.60}, and this PulseStage reads format {FORMAT}: "
            "use the PulseStage that it was made with."
        )
    return header


def _submission(header: dict[str, Any], raw: Mapping[str, bytes], name: str) -> Submission:
    def refuse(what: str) -> Refused:
        return Refused(f"{name}: {what}.")

    kinds: dict[str, type] = {
        "settings": dict,
        "cost": dict,
        "versions": dict,
        "made_of": dict,
        "seeds": list,
        "scores": list,
    }
    kinds |= {"run": int, "actions": list, **dict.fromkeys(TEXTS, str)}
    if sorted(header) != sorted([*kinds, "format"]):
        raise refuse(f"entry.json should have {', '.join(sorted([*kinds, 'format', 'checksum']))}")
    for key, kind in kinds.items():
        if not isinstance(header[key], kind) or isinstance(header[key], bool):
            raise refuse(f"{key} is no {kind.__name__}")
        if isinstance(header[key], str) and (len(header[key]) > LONG or not header[key].isprintable()):
            raise refuse(f"{key} is longer than {LONG} characters, or has some that cannot be printed")
    if not all(_whole(s) for s in header["seeds"]) or not header["seeds"]:
        raise refuse("seeds are whole numbers from 0 up, one at least")
    if not all(
        isinstance(v, int | float) and not isinstance(v, bool) and 0 <= v <= 1e15 for v in header["cost"].values()
    ):
        raise refuse("cost has numbers from 0 to 1e15")
    for key in ("versions", "made_of"):
        if not all(isinstance(v, str) and len(v) <= LONG and v.isprintable() for v in header[key].values()):
            raise refuse(f"{key} has texts")
    keys = [k for part in ("settings", "cost", "versions", "made_of") for k in header[part]] + header["scores"]
    if not all(isinstance(k, str) and len(k) <= 200 and k.isprintable() for k in keys):
        raise refuse("a name is no short text")
    if len(set(header["scores"])) != len(header["scores"]) or "return" not in header["scores"]:
        raise refuse("scores have names, each once, and 'return' is one of them")
    arrays: dict[str, Any] = _arrays(header, raw, refuse)
    scores = dict(zip(header["scores"], arrays.pop("scores").T, strict=True))
    texts = {key: header[key] for key in TEXTS}
    return Submission(
        **texts, settings=header["settings"], run=header["run"], cost=header["cost"], seeds=tuple(header["seeds"]), **arrays,
        scores=scores, versions=header["versions"], made_of=header["made_of"],
    )  # fmt: skip


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 63


def _arrays(header: dict[str, Any], raw: Mapping[str, bytes], refuse: Any) -> dict[str, np.ndarray]:
    kind = header["actions"]
    if len(kind) != 2 or kind[0] not in ACTIONS or not isinstance(kind[1], list) or len(kind[1]) > 4:
        raise refuse(f"actions are of one of the types {', '.join(ACTIONS)}, with a shape")
    if not all(_whole(n) and 0 < n <= 1 << 16 for n in kind[1]):
        raise refuse("actions have a shape of whole numbers")
    episodes = len(header["seeds"])
    if len(raw["steps"]) != 8 * episodes:
        raise refuse(f"steps has {len(raw['steps'])} bytes, and {episodes} episodes want {8 * episodes}")
    steps = np.frombuffer(raw["steps"], "<i8")
    if (steps < 1).any() or (steps > UNPACKED).any():
        raise refuse("an episode has one step or more")
    total = int(steps.sum())
    shapes = {"actions": (total, *kind[1]), "rewards": (total,), "seen": (total + episodes,)}
    shapes["scores"] = (episodes, len(header["scores"]))
    found = {"steps": steps.astype(np.int64)}
    for key, shape in shapes.items():
        dtype = np.dtype(kind[0] if key == "actions" else TYPES[key])
        wanted = int(np.prod(shape, dtype=object)) * dtype.itemsize
        if len(raw[key]) != wanted:
            raise refuse(f"{key} has {len(raw[key])} bytes, and {total} steps in {episodes} episodes want {wanted}")
        found[key] = np.frombuffer(raw[key], dtype).reshape(shape).astype(dtype.newbyteorder("="))
    return found


def _checksum(header: Mapping[str, Any], raw: Mapping[str, bytes]) -> str:
    """Compute the checksum of an entry: it finds damage, and does not prove who made it."""
    digest = hashlib.blake2b(json.dumps(header, sort_keys=True).encode(), digest_size=16)
    for name in ARRAYS:
        digest.update(hashlib.blake2b(raw[name]).digest())
    return digest.hexdigest()
