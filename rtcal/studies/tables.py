"""Write tables as CSV or Parquet, by the ending of the path."""

from __future__ import annotations

import csv
import io
import os
from typing import Any

import numpy as np

from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError, MissingDependencyError
from rtcal.support.files import write_bytes


@checked
def write_table(table: np.recarray[Any, Any], path: str | os.PathLike[str]) -> None:
    """Write a table as .csv or .parquet, whole or not at all; numbers keep all their digits.

    Raises
    ------
    DataError
        If the path has another ending or cannot be written, or ``table`` is no table.
    MissingDependencyError
        For Parquet where pyarrow is not installed (extra ``studies``).
    """
    ending = checks.path("path", path).suffix.lower()
    if not isinstance(table, np.ndarray) or table.dtype.names is None or table.ndim != 1:
        raise DataError("table is not a table of named columns, such as Study.scores returns")
    names = list(table.dtype.names)
    if ending == ".csv":
        write_bytes(path, table_csv(table))
    elif ending == ".parquet":
        try:
            import pyarrow
            from pyarrow import parquet
        except ImportError as error:
            raise MissingDependencyError(
                "Parquet files need pyarrow: pip install 'rtcal[studies]'"
            ) from error
        content = io.BytesIO()
        parquet.write_table(pyarrow.table({c: table[c].tolist() for c in names}), content)
        write_bytes(path, content.getvalue())
    else:
        raise DataError(f'{path}: a table ends with .csv or .parquet, not "{ending}"')


def table_csv(table: np.recarray[Any, Any]) -> bytes:
    """Return a table as the bytes of a CSV file; numbers keep all their digits."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(table.dtype.names)
    writer.writerows(table.tolist())
    return stream.getvalue().encode()
