"""The page of a result, and its tables as a workbook to which a client's own workbook can refer."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from rtcal.files.disk import write_bytes
from rtcal.files.saved import Result, load
from rtcal.io import workbook
from rtcal.report.document import Box, Heading, Items, Page, flat, render
from rtcal.support import checks
from rtcal.support.blocks import Note, Table
from rtcal.support.errors import DataError

__all__ = ["page", "page_of"]
__dir__ = __all__.copy

_MODULES = {
    "calibration": "of_calibration",
    "modes": "of_modes",
    "loop": "of_loop",
    "comparison": "of_comparison",
    "positions": "of_positions",
    **dict.fromkeys(
        ("prediction", "prediction at positions", "predictions", "design"), "of_prediction"
    ),
    **dict.fromkeys(("finding", "verification"), "of_finding"),
    "diagnosis": "of_diagnosis",
}
"""The module with the page of each kind of result, which alone is imported."""


def blocks_of(result: Result) -> Page:
    """Return the content of a result's page; raises DataError for a result that has no page."""
    if not hasattr(result, "record_kind"):
        raise DataError(
            f"{checks.shown(result)} is not a result, so it has no page: calibrate the room "
            "first, and give the result of rtcal.calibrate"
        )
    kind = result.record_kind.rstrip(" 0123456789")
    if kind not in _MODULES:
        raise DataError(
            f'a result of the kind "{kind}" has no page. Pages '
            "show a calibration, a comparison, a loop, positions, modes, predictions, designs, "
            "findings, diagnoses and what changed; `rtcal learn` prints an archive"
        )
    made: Page = import_module(f"rtcal.report.{_MODULES[kind]}").page(result)
    return made


def page(
    result: Any, heading: Heading | None = None, progress: Callable[[], None] | None = None
) -> str:
    """Return a result as one HTML page, which needs no network and no other file.

    Parameters
    ----------
    result : CalibrationResult, Comparison, ModesResult, Loop, PositionsResult, Prediction, ...
        Result to show; also a design, several predictions, a finding, or a verification.
    heading : Heading, optional
        Title, author and date; by default the room's name and author.
    progress : callable, optional
        Function that is called after each figure.

    Raises
    ------
    MissingDependencyError
        If jinja2 or matplotlib is not installed.
    DataError
        For a result that has no page, and if the page would be larger than 2 MB.
    """
    return render(blocks_of(result), heading, progress)


def page_of(
    path: str | os.PathLike[str],
    *,
    heading: Heading | None = None,
    progress: Callable[[], None] | None = None,
) -> str:
    """Return a saved result as an HTML page, from its folder, its ``result.json`` or a loop's file.

    ``path`` is that of the folder or file, and ``heading`` and ``progress`` are those of `page`. A
    saved result does not contain the names of its input files. Therefore the page of a finding
    shows no command that reproduces it, except for means over positions: their case is then on the
    page, as a file to save.

    Raises
    ------
    DataError
        For a folder without a result, a file that is not a result, or a result that has no page.
    """
    return render(_made(path), heading, progress)


def _made(path: str | os.PathLike[str]) -> Page:
    """Return the blocks of a saved result's page; DataError as `page_of`."""
    result = load(path)
    try:
        return blocks_of(result)
    except DataError as error:
        raise DataError(f"{Path(path)}: {error}") from error


def write_workbook(result: str | os.PathLike[str], path: str | os.PathLike[str]) -> None:
    """Write the tables of a saved result's page as a workbook (xlsx), one sheet per table."""
    write_bytes(path, workbook.content(sheets(_made(result))))


def sheets(made: Page) -> dict[str, list[list[Any]]]:
    """Return the tables of a page as sheets of a workbook, by name; the first sheet has the sentences.

    Each number has its own cell: if a cell of the page has several numbers, each gets a row.
    """
    summary: list[list[Any]] = [["text"]]
    made_of: dict[str, list[list[Any]]] = {"summary": summary}
    for block in flat(made.blocks):
        if isinstance(block, Note):
            summary.append([block.text])
        elif isinstance(block, Box):
            summary += [[text] for text in (block.lead, *block.texts)]
        elif isinstance(block, Items):
            summary += [[text] for text in block.texts]
        elif isinstance(block, Table) and block.rows:
            title = re.split("[:;,]", block.title)[0][:28] or block.corner or "table"
            same = sum(name.startswith(title) for name in made_of)
            rows: list[list[Any]] = [[block.corner, *block.columns]]
            for row in block.rows:
                rows.append([row.name.strip(), *map(_number, row.values)])
                rows += [
                    [f"{row.name.strip()}, {n}", *map(_number, v)] for n, v in row.others.items()
                ]
            made_of[f"{title} {same + 1}" if same else title] = rows
    return made_of


def _number(value: Any) -> Any:
    """Return a text that is a number as this number."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return value
