"""Options of a table must leave their mark: one without use is an error."""

from __future__ import annotations

from collections.abc import Collection

from rtcal.io.table_columns import leaves_decay_time_open
from rtcal.io.table_layout import TableLayout
from rtcal.io.text import shown
from rtcal.support.errors import DataError

_MOST_COLUMNS = 20
"""Largest number of columns that a message names."""


def check_options(
    layout: TableLayout,
    path: str,
    *,
    parameter: str | None,
    decay_time: str | None,
    ignore: Collection[str],
) -> None:
    """Raise DataError for an option of `rtcal.io.tables.read` that changes nothing in this table.

    That is a column to ignore that is not there, a parameter where the table names the parameters of
    all values, and a decay time where nothing is called RT60.
    """
    place = f"{path}, line {layout.header_line}"
    headers = [c.header for c in layout.columns]
    for name in ignore:
        if name not in headers:
            raise DataError(
                f'{place}: ignore="{shown(name)}" is no column; they are '
                f"{_quoted(headers[:_MOST_COLUMNS])}"
            )
    rows_named = any(c.kind == "parameter" for c in layout.columns)
    values = [c for c in layout.columns if c.kind in ("data", "value")]
    if parameter is not None and (rows_named or all(c.parameter for c in values)):
        named = [c.header for c in layout.columns if c.parameter or c.kind == "parameter"]
        raise DataError(
            f'{place}: parameter="{parameter}" is not used, since the table names its own '
            f"({_quoted(named[:_MOST_COLUMNS])}); leave it out"
        )
    if decay_time is not None and not (
        any(c.decay_time_open for c in layout.columns)
        or any(map(leaves_decay_time_open, layout.cells("parameter")))
    ):
        raise DataError(
            f'{place}: decay_time="{decay_time}" is not used, since nothing in the table is called '
            "RT60 or T60; leave it out"
        )


def _quoted(names: Collection[str]) -> str:
    return ", ".join(f'"{shown(name)}"' for name in names)
