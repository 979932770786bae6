"""The results of a study on disk: whatever was recorded stays, and no trial counts twice.

    study/study.json               the definition
    study/trials/part-000001.parquet ...
                                   finished trials, a batch each, with the same columns in all

A part appears whole or not at all (written beside, fsync, rename), so that the folder `trials` can be read at any time, by
pandas.read_parquet, pyarrow.dataset or anything else that knows Parquet. Columns: id, seed, status ("done" or "failed"),
attempts (calls of the objective that ended), error, the registers, and what the objective measured.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from stage.errors import ArgumentError, StageError
from stage.files import FileError
from stage.study.definition import Definition, Trial

try:
    import pyarrow as pa
    import pyarrow.parquet as pq
except ImportError:
    pa = None

DONE, FAILED = "done", "failed"
OWN = "id", "seed", "status", "attempts", "error"
"""Columns that an objective cannot have."""


@dataclass(frozen=True)
class Record:
    """How a trial ended: with values, or with an error."""

    trial: Trial
    values: dict[str, float] | None = None
    error: str | None = None
    attempts: int = 1

    def row(self) -> dict[str, Any]:
        t = self.trial
        status = FAILED if self.values is None else DONE
        own = zip(OWN, (t.id, t.seed, status, self.attempts, self.error), strict=True)
        return {**dict(own), **t.registers, **(self.values or {})}


class Study:
    """A study's folder, opened to add trials; one process at a time may.

    Use `Study.open`; `read` and `definition` need no Study and no lock.

    Attributes:
        folder, definition.
        done, failed: how many trials are recorded. best: (score, id) of the least score, or None.
    """

    def __init__(self, folder: Path, definition: Definition, lock: IO):
        self.folder, self.definition, self._lock = folder, definition, lock
        self.recorded: set[int] = set()
        self.done = self.failed = 0
        self.best: tuple[float, int] | None = None

    @classmethod
    def open(cls, folder: str | os.PathLike, definition: Definition, force: bool = False) -> Study:
        """Begin a study in `folder`, or go on with the one that is there.

        force: where the study there is another one, move it aside (to FOLDER.1, .2 ...) and begin anew.
        Raises ArgumentError when the study there has another definition; StageError when another process has it open.
        """
        need_pyarrow()
        folder = Path(folder).absolute()
        try:
            (folder / "trials").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StageError(f"{folder} cannot be a study's folder: {error.strerror}.") from error
        lock = _locked(folder)
        try:
            if (folder / "study.json").exists():
                was = read_definition(folder)
                if differences := was.differences(definition):
                    if not force:
                        raise ArgumentError(
                            f"{folder} holds another study:\n  "
                            + "\n  ".join(differences)
                            + "\nChoose another folder, or --force to move that study aside and begin anew."
                        )
                    _move_aside(folder)
                    lock.close()
                    return cls.open(folder, definition)
            elif any((folder / "trials").iterdir()):
                raise StageError(f"{folder} holds trials but no study.json: choose another folder.")
            _write(folder / "study.json", definition.to_json().encode())
            study = cls(folder, definition, lock)
            study._begin()
            return study
        except BaseException:
            lock.close()
            raise

    def _begin(self) -> None:
        for stray in self._parts.glob(".*.tmp"):
            stray.unlink()
        parts = _parts(self.folder)
        tables = [_read_part(p) for p in parts]
        self._next = int(parts[-1].stem.rpartition("-")[2]) + 1 if parts else 0
        self._schema = _base(self.definition.registers)
        if not parts:
            self._add(self._schema.empty_table())
        self._widen([t.schema for t in tables])
        if tables:
            self._count(_table(tables).to_pylist())

    @property
    def _parts(self) -> Path:
        return self.folder / "trials"

    def pending(self) -> list[int]:
        """Ids of the trials that are not recorded, in order."""
        return [id for id in range(self.definition.trials) if id not in self.recorded]

    def append(self, records: Iterable[Record]) -> None:
        """Record trials, durably: one part. Trials that are recorded already are left out."""
        rows = {r.trial.id: r.row() for r in records if r.trial.id not in self.recorded}
        if not rows:
            return
        self._widen([_schema_of(rows.values())])
        self._add(pa.Table.from_pylist(list(rows.values()), schema=self._schema))
        self._count(rows.values())

    def _add(self, table: Any) -> None:
        _write_part(self._parts / f"part-{self._next:06d}.parquet", table)
        self._next += 1

    def _widen(self, schemas: Sequence[Any]) -> None:
        """Take new columns up, into the parts that are there, too: readers look at the columns of the first one only."""
        self._schema = pa.unify_schemas([self._schema, *schemas], promote_options="permissive")
        for part in _parts(self.folder):
            if pq.read_schema(part) != self._schema:
                _write_part(part, _fitted(_read_part(part), self._schema))

    def _count(self, rows: Iterable[dict[str, Any]]) -> None:
        for row in rows:
            self.recorded.add(row["id"])
            if row["status"] == FAILED:
                self.failed += 1
                continue
            self.done += 1
            score = row.get("score")
            if score is not None and score == score and (self.best is None or (score, row["id"]) < self.best):
                self.best = (score, row["id"])

    def close(self) -> None:
        """Let another process go on with the study."""
        self._lock.close()

    def __enter__(self) -> Study:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def read_definition(folder: str | os.PathLike) -> Definition:
    """The definition of the study in `folder`. Raises ArgumentError."""
    path = Path(folder) / "study.json"
    try:
        return Definition.from_json(path.read_text())
    except FileNotFoundError:
        raise ArgumentError(f"{folder} holds no study: there is no {path}.") from None
    except (ValueError, TypeError, KeyError) as error:
        raise ArgumentError(f"{path} is not the definition of a study that this version reads: {error}.") from None


def read(folder: str | os.PathLike) -> Any:
    """Every recorded trial once, as a pyarrow.Table in the order of ids; also while the study runs. Raises ArgumentError."""
    need_pyarrow()
    empty = _base(read_definition(folder).registers).empty_table()
    return _table([empty, *map(_read_part, _parts(Path(folder)))])


def need_pyarrow() -> None:
    if pa is None:
        raise StageError("a study is kept in Parquet files, which need pyarrow: pip install 'pulsestage[cluster]'.")


def _table(tables: list[Any]) -> Any:
    table = pa.concat_tables(tables, promote_options="permissive")
    _, first = np.unique(table["id"].to_numpy(), return_index=True)
    return table.take(first)


def _parts(folder: Path) -> list[Path]:
    return sorted((folder / "trials").glob("part-*.parquet"))


def _base(registers: Iterable[str]) -> Any:
    text, whole = pa.string(), pa.int64()
    own = [(name, text if name in ("status", "error") else whole) for name in OWN]
    return pa.schema([*own, *((name, whole) for name in registers)])


def _schema_of(rows: Iterable[dict[str, Any]]) -> Any:
    """The schema of what was measured: whole numbers are int64, others float64."""
    kinds: dict[str, Any] = {}
    for row in rows:
        for name, value in row.items():
            if name not in OWN and not isinstance(value, int):
                kinds[name] = pa.float64()
            elif name not in OWN:
                kinds.setdefault(name, pa.int64())
    return pa.schema(list(kinds.items()))


def _fitted(table: Any, schema: Any) -> Any:
    """`table` with the columns of `schema`, null where it has none."""
    columns = [
        table[f.name].cast(f.type) if f.name in table.column_names else pa.nulls(len(table), f.type) for f in schema
    ]
    return pa.Table.from_arrays(columns, schema=schema)


def _read_part(path: Path) -> Any:
    try:
        return pq.read_table(path, partitioning=None)
    except (pa.ArrowInvalid, OSError) as error:
        raise StageError(f"{path} cannot be read ({error}). Without it, its trials are run again.") from error


def _write_part(path: Path, table: Any) -> None:
    sink = pa.BufferOutputStream()
    pq.write_table(table.replace_schema_metadata(None), sink)
    _write(path, sink.getvalue())


def _write(path: Path, content: Any) -> None:
    """Put a file there, whole, to survive a kill at any instant. Raises FileError; what was there is then as before."""
    beside = path.with_name(f".{path.name}.tmp")
    try:
        with open(beside, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
        directory = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)
    except OSError as error:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
        raise FileError(
            f"{path} cannot be written: {error.strerror or error}. What was recorded before is safe: make room, then start "
            "again, and the study goes on from there."
        ) from error


def _locked(folder: Path) -> IO:
    """The folder's lock; the system lets go of it when this process ends, however it ends."""
    lock = open(folder / ".lock", "a")  # noqa: SIM115
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.close()
        raise StageError(f"another process is at work on {folder}: wait for it, or stop it.") from None
    return lock


def _move_aside(folder: Path) -> Path:
    k = 1
    while (aside := folder.with_name(f"{folder.name}.{k}")).exists():
        k += 1
    folder.rename(aside)
    return aside
