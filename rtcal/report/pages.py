"""The page of a result, and its tables as a workbook to which a client's own workbook can refer."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from rtcal.calibration.result import CalibrationResult
from rtcal.files.disk import write_bytes
from rtcal.files.saved import load
from rtcal.finder.finding import Finding
from rtcal.finder.verification import Verification
from rtcal.io import workbook
from rtcal.loop.closed import Loop
from rtcal.loop.positions import PositionsResult
from rtcal.loop.predicted import PositionsPrediction
from rtcal.modes.calibrate import ModesResult
from rtcal.prediction.designed import Design
from rtcal.prediction.predicted import Prediction, Predictions
from rtcal.report import of_calibration, of_finding, of_loop, of_positions, of_prediction
from rtcal.report.document import Box, Heading, Items, Page, SideBySide, render
from rtcal.support.blocks import Note, Table
from rtcal.support.errors import DataError

__all__ = ["page", "page_of"]
__dir__ = __all__.copy

_PAGES: dict[type, Callable[[Any], Page]] = {
    CalibrationResult: of_calibration.page,
    ModesResult: of_calibration.page_of_modes,
    Loop: of_loop.page,
    PositionsResult: of_positions.page,
    **dict.fromkeys((Prediction, PositionsPrediction, Predictions, Design), of_prediction.page),
    Finding: of_finding.page,
    Verification: lambda verified: of_finding.page(verified.finding, verified),
}


def blocks_of(result: Any) -> Page:
    """Return what the page of a result shows; DataError for a result that has no page."""
    made = next((make for kind, make in _PAGES.items() if isinstance(result, kind)), None)
    if made is None:
        raise DataError(
            f'a result of the kind "{result.record_kind.rstrip(" 0123456789")}" has no page. Pages '
            "show a calibration, a loop, positions, modes, predictions, designs, findings and what "
            "changed; `rtcal learn` prints an archive"
        )
    return made(result)


def page(
    result: Any, heading: Heading | None = None, progress: Callable[[], None] | None = None
) -> str:
    """Return a result as one HTML page under 2 MB, without links to the network.

    Parameters
    ----------
    result : CalibrationResult, ModesResult, Loop, PositionsResult, Prediction, ...
        Also a design, several predictions, predictions at positions, a finding or its verification.
    heading : Heading, optional
        Title, author and date; by default the room's name and author.
    progress : callable, optional
        Called after each figure.

    Raises
    ------
    MissingDependencyError
        Without jinja2 or matplotlib.
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
    """Return the page of a saved result: its folder, its ``result.json``, or the state of a loop.

    The result does not hold the names of its files. So the page of a finding of means has its case as
    a file within it, and that of a finding at positions has no command to reproduce it.

    Raises
    ------
    DataError
        For a folder that has no result, a file that is none, or a result that has no page.
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
    """Write the tables of a saved result's page as a workbook (xlsx), a sheet each.

    Raises DataError as `page_of`, and MissingDependencyError without openpyxl.
    """
    write_bytes(path, workbook.content(sheets(_made(result))))


def sheets(made: Page) -> dict[str, list[list[Any]]]:
    """Return the tables of a page by the names of their sheets, and its sentences as the first sheet.

    A number has a cell of its own: where the page prints several in one, each has a row.

    Examples
    --------
    >>> from rtcal.support.blocks import Row
    >>> sheets(Page("hall", "", "", [Table(["125 Hz"], [Row("T / s", [1.5], ".2f")], "By band: T")]))
    {'summary': [['text']], 'By band': [['', '125 Hz'], ['T / s', 1.5]]}
    """
    summary: list[list[Any]] = [["text"]]
    made_of: dict[str, list[list[Any]]] = {"summary": summary}
    for block in _flat(made.blocks):
        if isinstance(block, Note):
            summary.append([block.text])
        elif isinstance(block, Box):
            summary += [[text] for text in (block.lead, *block.texts)]
        elif isinstance(block, Items):
            summary += [[text] for text in block.texts]
        elif isinstance(block, Table) and block.rows:
            title = re.split("[:;,]", block.title)[0][:28] or block.corner or "table"
            same = sum(name.startswith(title) for name in made_of)
            made_of[f"{title} {same + 1}" if same else title] = [
                [block.corner, *block.columns],
                *([name, *map(_number, values)] for name, values in _rows(block)),
            ]
    return made_of


def _flat(blocks: Iterable[Any]) -> Iterator[Any]:
    for block in blocks:
        if isinstance(block, SideBySide):
            for part in block.parts:
                yield from _flat(part)
        else:
            yield block


def _rows(table: Table) -> Iterator[tuple[str, Iterable[Any]]]:
    for row in table.rows:
        yield row.name.strip(), row.values
        for name, values in row.others.items():
            yield f"{row.name.strip()}, {name}", values


def _number(value: Any) -> Any:
    """Return a text that is a number as this number."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return value
