"""A saved result as one HTML page, or as a workbook to which a client's own workbook can refer.

The workbook has every table. Its sheets follow from the record's own shape, so that all results are
written alike:

- ``summary``: each single number or text, by its name in the record;
- ``bands``: one row per band, one column per quantity of the bands;
- one sheet per list of entries, such as ``materials``: one row per entry, and one column per quantity,
  or one per band where the quantity has one value per band;
- one sheet per quantity of every position: a row per parameter and pair, a column per band.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rtcal.acoustics import bands
from rtcal.calibration.result import CalibrationResult
from rtcal.files.disk import json_numbers, read_text
from rtcal.files.saved import MAX_BYTES, NUMBERS, load
from rtcal.files.schema import json_object
from rtcal.finder.means.finding import MeansFinding
from rtcal.finder.positions.finding import PositionsFinding
from rtcal.finder.states import StatesFinding
from rtcal.finder.verification import Verification
from rtcal.io import workbook
from rtcal.loop.closed import Loop, LoopResult
from rtcal.loop.positions_result import PositionsPrediction, PositionsPredictions, PositionsResult
from rtcal.modes.calibrate import ModesResult
from rtcal.prediction.designed import Design
from rtcal.prediction.predicted import Prediction, Predictions
from rtcal.report import of_calibration, of_finding, of_loop, of_positions, of_prediction
from rtcal.report.document import Heading, Page, render
from rtcal.support.errors import DataError

__all__ = ["page", "page_of"]
__dir__ = __all__.copy

_PAGES: dict[type, Callable[[Any], Page]] = {
    CalibrationResult: of_calibration.page,
    ModesResult: of_calibration.page_of_modes,
    Loop: of_loop.page,
    LoopResult: of_loop.page,
    PositionsResult: of_positions.page,
    **dict.fromkeys((Prediction, Predictions, Design), of_prediction.page),
    **dict.fromkeys((PositionsPrediction, PositionsPredictions), of_prediction.page_at_positions),
    **dict.fromkeys((MeansFinding, PositionsFinding, StatesFinding), of_finding.page),
    Verification: lambda verified: of_finding.page(verified.finding, verified),
}


def page(
    result: Any, heading: Heading | None = None, progress: Callable[[], None] | None = None
) -> str:
    """Return a result as one HTML page under 2 MB, without links to the network.

    Parameters
    ----------
    result : CalibrationResult, ModesResult, Loop, LoopResult, PositionsResult, Prediction, ...
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
    made = next((make for kind, make in _PAGES.items() if isinstance(result, kind)), None)
    if made is None:
        raise DataError(
            f'a result of the kind "{result.record_kind.rstrip(" 0123456789")}" has no page. Pages '
            "show "
            "a calibration, a loop, positions, modes, predictions, designs, findings and what changed; "
            "`rtcal learn` prints an archive"
        )
    return render(made(result), heading, progress)


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
    result = load(path)
    try:
        return page(result, heading, progress)
    except DataError as error:
        raise DataError(f"{Path(path)}: {error}") from error


Table = list[list[Any]]

_BANDS = "centre_frequencies"
_LOOPS = (Loop.record_kind, LoopResult.record_kind)
_FOR_PROGRAMS = {"object", "inputs", "settings"}
"""Entries that only rtcal reads: the result's pieces, and the text of its input files."""
_BY_MATERIAL = ("raw_alpha", "scattering coefficients", "scattering sigma")
"""Ends of the names of tables with a row per material and a column per band."""
_OF_PAIRS = ("pairs", "contradictions")
"""Ends of the names of lists of a source and a receiver each."""


def write_workbook(result: str | os.PathLike[str], path: str | os.PathLike[str]) -> None:
    """Write the tables of a saved result, a folder or its result.json, as a workbook (xlsx).

    Raises DataError for a file that is no result, and MissingDependencyError without openpyxl.
    """
    file = Path(result, NUMBERS) if Path(result).is_dir() else Path(result)
    try:
        record = json_object(read_text(file, MAX_BYTES))
    except DataError as error:
        raise DataError(f"{file}: {error}") from error
    if "rtcal" not in record:
        raise DataError(f'{file}: no result of rtcal, since it lacks the key "rtcal"')
    if record["rtcal"] in _LOOPS:
        record = _of_loop(load(file))
    workbook.write(tables_of(record), path)


def _of_loop(result: Loop | LoopResult) -> dict[str, Any]:
    """Return a loop's record with the numbers of its room, which its file holds as text."""
    loop = result.loop if isinstance(result, LoopResult) else result
    room, status = loop.room, of_loop.statuses(loop)
    *rows, nearest = of_loop.band_rows(loop)
    return {
        "rtcal": result.record_kind,
        "room": room.name,
        "simulations": len(loop.steps),
        "status": ", ".join(dict.fromkeys(status)),
        _BANDS: json_numbers(room.centre_frequencies),
        "bands": {row.name: json_numbers(row.values) for row in rows},
        nearest.name: list(nearest.values),
        "materials": [
            {
                "name": name,
                "area": float(room.areas[i]),
                "alpha_before": json_numbers(room.alpha[i]),
                "alpha_after": json_numbers(loop.best_alpha[i]),
            }
            for i, name in enumerate(room.materials)
        ],
        "simulated": [
            {"simulation": k, "target": json_numbers(s.target), "T": json_numbers(s.simulated)}
            for k, s in enumerate(loop.steps, start=1)
        ],
    }


def tables_of(record: Mapping[str, Any]) -> dict[str, Table]:
    """Return the tables of a result's record by the name of their sheet, each with its header.

    Examples
    --------
    >>> tables_of({"room": "hall", "centre_frequencies": [125, 250], "gap_jnd": [1.5, -2.0]})
    {'summary': [['quantity', 'value'], ['room', 'hall']], 'bands': [['band / Hz', 'gap_jnd'], \
[125, 1.5], [250, -2.0]]}
    """
    frequencies = _frequencies(record)
    labels = bands.labels(frequencies)
    summary: Table = [["quantity", "value"]]
    of_bands: dict[str, Sequence[Any]] = {}
    lists: dict[str, Table] = {}
    entries = dict(_entries(record, ""))
    materials = [m.get("name") for m in record.get("materials", ()) if isinstance(m, Mapping)]
    for name, value in entries.items():
        if name.endswith(_BANDS):
            continue
        beside = name.rpartition(" ")[0]
        shape = _shape(value)
        if _is_single(value):
            summary.append([name, value])
        elif isinstance(value, list) and value and all(isinstance(v, Mapping) for v in value):
            lists[name] = _listed(value, labels)
        elif _is_row(value, len(frequencies)):
            of_bands[name] = value
        elif len(shape) == 1 and all(map(_is_single, value)):
            summary.append([name, ", ".join(map(str, value))])
        elif len(shape) == 3 and shape[2] == len(labels):
            lists[name] = _by_position(value, labels, entries, f"{beside} ".lstrip())
        elif len(shape) == 2 and name.endswith(_BY_MATERIAL) and len(value) == len(materials):
            rows = zip(materials, value, strict=True)
            lists[name] = [["material", *labels], *([m, *map(_cell, row)] for m, row in rows)]
        elif len(shape) > 1:
            lists[name] = [
                ["source", "receiver"] if name.endswith(_OF_PAIRS) else _columns(value, labels),
                *(list(map(_cell, row)) for row in value),
            ]
    across = [[f, *(column[k] for column in of_bands.values())] for k, f in enumerate(frequencies)]
    tables = {"summary": summary}
    if of_bands:
        tables["bands"] = [["band / Hz", *of_bands], *across]
    return tables | lists


def _frequencies(record: Any) -> list[float]:
    """Return the centre frequencies of the first result in a record that states them."""
    if isinstance(record, Mapping):
        if isinstance(record.get(_BANDS), list):
            return list(record[_BANDS])
        record = [value for key, value in record.items() if key not in _FOR_PROGRAMS]
    if isinstance(record, list):
        return next(filter(None, map(_frequencies, record)), [])
    return []


def _shape(value: Any) -> tuple[int, ...]:
    """Return the lengths of lists in lists, by their first entries."""
    lengths = []
    while isinstance(value, list) and value:
        lengths.append(len(value))
        value = value[0]
    return tuple(lengths)


def _by_position(
    values: Sequence[Any], labels: Sequence[str], entries: Mapping[str, Any], scope: str
) -> Table:
    """Return the table of (n_parameters, n_pairs, n_bands): a row per parameter and pair.

    Names are those that the same part of the record has, else those of the whole, else numbers.
    """

    def names(key: str, number: int) -> list[Any]:
        stated = entries.get(scope + key, entries.get(key, ()))
        return list(stated) if len(stated) == number else list(range(1, number + 1))

    pairs = names("pairs", len(values[0]))
    rows = [
        [parameter, *(pair if isinstance(pair, list) else [pair, None]), *row]
        for parameter, of_parameter in zip(names("parameters", len(values)), values, strict=True)
        for pair, row in zip(pairs, of_parameter, strict=True)
    ]
    return [["parameter", "source", "receiver", *labels], *rows]


def _entries(record: Mapping[str, Any], prefix: str) -> list[tuple[str, Any]]:
    """Return the entries of a record by name; those of a record in it as "outer inner"."""
    found: list[tuple[str, Any]] = []
    for key, value in record.items():
        if not prefix and key in _FOR_PROGRAMS:
            continue
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            found += _entries(value, f"{name} ")
        else:
            found.append((name, value))
    return found


def _listed(entries: Sequence[Mapping[str, Any]], labels: Sequence[str]) -> Table:
    """Return a list's table: a row per entry, and a column per band where a value has one per band."""
    flat = [dict(_entries(entry, " ")) for entry in entries]
    names = list(dict.fromkeys(name for entry in flat for name in entry))
    header: list[Any] = []
    rows: Table = [[] for _ in entries]
    for name in names:
        values = [entry.get(name) for entry in flat]
        if labels and all(v is None or _is_row(v, len(labels)) for v in values) and any(values):
            header += [f"{name.strip()} {label}" for label in labels]
            for row, value in zip(rows, values, strict=True):
                row += value if value is not None else [None] * len(labels)
        else:
            header.append(name.strip())
            for row, value in zip(rows, values, strict=True):
                row.append(_cell(value))
    return [header, *rows]


def _columns(rows: Sequence[Sequence[Any]], labels: Sequence[str]) -> list[Any]:
    width = max(map(len, rows))
    if all(map(_is_number, (cell for row in rows for cell in row))) and width == len(labels):
        return list(labels)
    return [f"column {k + 1}" for k in range(width)]


def _is_single(value: Any) -> bool:
    return isinstance(value, (str, int, float, bool)) or value is None


def _is_row(value: Any, n_bands: int) -> bool:
    return isinstance(value, list) and len(value) == n_bands > 0 and all(map(_is_number, value))


def _is_number(value: Any) -> bool:
    return value is None or isinstance(value, (int, float))


def _cell(value: Any) -> Any:
    """Return a value for one cell: itself, or a list's values in words."""
    if _is_single(value):
        return value
    if isinstance(value, list):
        return "; ".join(str(v) for v in value)
    raise DataError(f"{value!r} is no value of a cell")
