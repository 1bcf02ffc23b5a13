"""A command's MEASURED: the native CSV, a workbook or REW's text."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from rtcal.command.assignments import as_options
from rtcal.command.console import warn
from rtcal.errors import DataError

if TYPE_CHECKING:
    from rtcal.acoustics.measurement import Measurement

ARGUMENTS = (
    "decay_time",
    "parameter",
    "ignore",
    "n_sources",
    "n_receivers",
    "repeats",
    "sheets",
)
"""Arguments of `rtcal.io.tables.read` that its messages name, and `rtcal table` has as options."""


def read_measured(path: str | os.PathLike[str], *, quiet: bool) -> Measurement:
    """Return the measurement that a command takes; what was read from another format is told once.

    Raises DataError as `rtcal.io.tables.measurement`; where the table leaves something open, the
    message says how `rtcal table` is told.
    """
    from rtcal.io import tables

    try:
        table = tables.measurement(path)
    except DataError as error:
        text = as_options(str(error), ARGUMENTS)
        if text != str(error):
            text += f". `rtcal table {path}` takes the option, and --out writes what it read"
        raise DataError(text) from error
    if table.columns and not quiet:
        measured = table.measurement
        n = len(measured.pairs)
        of = "means" if measured.is_summary else f"{n} pair{'s' * (n > 1)}"
        warn(
            f"{path}: {', '.join(p.upper() for p in measured.values)} of {of} in "
            f"{len(measured.centre_frequencies)} bands; `rtcal table {path}` shows how it was read"
        )
    return table.measurement
