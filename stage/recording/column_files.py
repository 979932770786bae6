"""Columns as data frames and files: pandas, Parquet, CSV, NumPy's .npz.

Files are written in parts, so that hours of samples do not fill the memory. Names and units are those of the columns, for example
"x/position" in meters. A Parquet file has the unit of each column in the metadata of its field.
"""

from __future__ import annotations

import csv
import json
import os
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.errors import UnknownKey, unknown_name_error
from stage.support.argument_checks import explain_arguments
from stage.support.extras import import_extra
from stage.support.files import FileError, check_ending, write_atomically

if TYPE_CHECKING:
    import pandas

FORMATS = {".csv": "to_csv", ".parquet": "to_parquet", ".npz": "to_npz"}


def find_writer_name(path: str | os.PathLike) -> str:
    """Return the name of the method of `ColumnTable` that writes a file with this ending.

    Raises:
        FileError: The ending is not among FORMATS.
    """
    return FORMATS[check_ending(path, FORMATS, "a table")]


class Columns(dict[str, np.ndarray]):
    """Columns by name. An unknown name raises UnknownKey (a KeyError), whose message lists similar names."""

    def __missing__(self, name: object) -> np.ndarray:
        raise UnknownKey(str(unknown_name_error("column", name, self)))


class ColumnTable:
    """Base class of tables of columns over time: arrays of equal length by name, "time" first."""

    ERROR: type[FileError] = FileError

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column, "" for pins and states; in the order of the columns."""
        raise NotImplementedError

    @explain_arguments
    def iterate_columns(self, names: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        """Yield the values of these columns for successive groups of rows, at least once.

        Args:
            names: Names of the columns.

        Raises:
            ArgumentError: A column does not exist.
        """
        return self._iterate_columns(self._check_column_names(names))

    def _iterate_columns(self, names: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        """Yield the values of columns that exist, for successive groups of rows."""
        raise NotImplementedError

    def _check_column_names(self, names: Sequence[str]) -> list[str]:
        """Return the names as a list. Raises ArgumentError if a column does not exist."""
        known = list(self.units)
        for name in names:
            if name not in known:
                raise unknown_name_error("column", name, known)
        return list(names)

    def _select_columns(self, columns: Sequence[str] | str | None) -> list[str]:
        """Return the names of the columns to write, "time" included."""
        if columns is None:
            return list(self.units)
        names = self._check_column_names([columns] if isinstance(columns, str) else columns)
        return ["time", *(name for name in dict.fromkeys(names) if name != "time")]

    @explain_arguments
    def to_pandas(self, columns: Sequence[str] | str | None = None) -> pandas.DataFrame:
        """Return a data frame whose index is the time, s; its `attrs["units"]` has the units.

        Args:
            columns: Names of columns, or one; None: all.

        Raises:
            ArgumentError: An unknown column, with the near misses.
            ExtraMissing: There is no pandas (extra `data`).
        """
        pandas = import_extra("pandas", "a data frame")
        names = self._select_columns(columns)
        parts = [*self.iterate_columns(names)]
        columns_by_name = {name: np.concatenate([part[name] for part in parts]) for name in names}
        index = pandas.Index(columns_by_name.pop("time"), name="time")
        frame = pandas.DataFrame(columns_by_name, index=index)
        frame.attrs["units"] = {name: self.units[name] for name in names}
        return frame

    @explain_arguments
    def to_parquet(
        self, path: str | os.PathLike, columns: Sequence[str] | str | None = None, *, overwrite: bool = False
    ) -> Path:
        """Write a Parquet file; pandas, Polars, DuckDB and Spark read it. The metadata of a field has its unit.

        Args:
            path: The file.
            columns: Names of columns, or one; None: all.
            overwrite: The file may exist.

        Returns:
            Its path.

        Raises:
            FileError: The file exists, or cannot be written.
            ArgumentError: An unknown column.
            ExtraMissing: There is no pyarrow (extra `data`, and part of `rerun`).
        """
        pyarrow = import_extra("pyarrow", "a Parquet file")
        parquet = import_extra("pyarrow.parquet", "a Parquet file")
        names = self._select_columns(columns)
        schema = None
        with write_atomically(path, overwrite, self.ERROR) as part:
            writer = None
            try:
                for piece in self.iterate_columns(names):
                    arrays = [pyarrow.array(piece[name]) for name in names]
                    if writer is None:
                        fields = [
                            pyarrow.field(name, array.type, nullable=False, metadata={"unit": self.units[name]})
                            for name, array in zip(names, arrays, strict=True)
                        ]
                        about = {"pulsestage": json.dumps({"units": {name: self.units[name] for name in names}})}
                        schema = pyarrow.schema(fields, metadata=about)
                        writer = parquet.ParquetWriter(part, schema)
                    writer.write_table(pyarrow.Table.from_arrays(arrays, schema=schema))
            finally:
                if writer is not None:
                    writer.close()
        return Path(path)

    @explain_arguments
    def to_csv(
        self, path: str | os.PathLike, columns: Sequence[str] | str | None = None, *, overwrite: bool = False
    ) -> Path:
        """Write a CSV file: a line with the names, then one line per sample.

        Numbers have as many digits as their exact value needs; pins are 0 and 1.

        Args:
            path: The file.
            columns: Names of columns, or one; None: all.
            overwrite: The file may exist.

        Returns:
            Its path.

        Raises:
            FileError: The file exists, or cannot be written.
            ArgumentError: An unknown column.
        """
        names = self._select_columns(columns)
        with (
            write_atomically(path, overwrite, self.ERROR) as part,
            part.open("w", newline="", encoding="utf-8") as file,
        ):
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(names)
            for piece in self.iterate_columns(names):
                values = [piece[name] for name in names]
                rows.writerows(zip(*((v.astype(int) if v.dtype == bool else v).tolist() for v in values), strict=True))
        return Path(path)

    @explain_arguments
    def to_npz(
        self, path: str | os.PathLike, columns: Sequence[str] | str | None = None, *, overwrite: bool = False
    ) -> Path:
        """Write NumPy's .npz: `numpy.load(path)["x/position"]`.

        Args:
            path: The file.
            columns: Names of columns, or one; None: all.
            overwrite: The file may exist.

        Returns:
            Its path.

        Raises:
            FileError: The file exists, or cannot be written.
            ArgumentError: An unknown column.
        """
        names = self._select_columns(columns)
        with (
            write_atomically(path, overwrite, self.ERROR) as part,
            zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive,
        ):
            for name in names:  # one at a time: never all of them in memory
                values = np.concatenate([piece[name] for piece in self.iterate_columns([name])])
                with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, values, allow_pickle=False)
        return Path(path)

    def to_file(
        self, path: str | os.PathLike, columns: Sequence[str] | str | None = None, *, overwrite: bool = False
    ) -> Path:
        """Write a .csv, .parquet or .npz file, according to the ending of the path.

        Args:
            path: The file.
            columns: Names of columns, or one; None: all.
            overwrite: The file may exist.

        Returns:
            Its path.

        Raises:
            FileError: The file exists, or cannot be written.
            ArgumentError: An unknown column.
            ExtraMissing: There is no pyarrow.
        """
        write: Any = getattr(self, find_writer_name(path))
        return Path(write(path, columns, overwrite=overwrite))
