"""Product data (ISO 354) as a material list: a table (CSV, xlsx), or a folder of them.

Two shapes are read, with the cells of `rtcal.io.table_layout`:

- *bands across*: one row per product, with its name in the first column that holds text;
- *bands down*: one row per band and one column per product; a single column takes the file's name, or
  the sheet's.

A column or a title such as "mounting: E-400" or "source" goes into the material's source. A coefficient
above 1, which ISO 354's edge effect gives, is taken as 1, and the source says so. Coefficients are in
percent if their own cells or headers have the unit ("250 Hz [%]"), or a text names both ("alpha in %").
A % that stands elsewhere, such as "open area [%]", changes nothing, and the source says so.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from rtcal.acoustics import bands
from rtcal.acoustics.observables import TARGET
from rtcal.io import workbook
from rtcal.io.material_list import ListedMaterial, MaterialList
from rtcal.io.table_columns import LEAST_BAND, frequency_of, nearest_band
from rtcal.io.table_layout import Row, Sheet
from rtcal.io.table_words import is_missing
from rtcal.io.text import MAX_TEXT, Text, decode, number, shown
from rtcal.io.text_tables import sheet_of_text
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.files import read_bytes

__all__ = ["read"]
__dir__ = __all__.copy

ENDINGS = (".csv", ".txt", ".xlsx")
MAX_FILES = 1000
LARGEST = 1.5
"""Largest coefficient of ISO 354 that is no percentage: a small specimen's edges add up to a half."""

_LEAST_BANDS = 3
_NAMES = re.compile(r"(material|product|name|produkt|bezeichnung|description|type|typ)\b.*", re.I)
_BAND_HEADER = re.compile(
    r"\W*(f|freq\w*|frequen\w*|band|octave.*|oktav.*|terz.*|hz)\W*(hz)?\W*", re.I
)
_PER_OBJECT = re.compile(
    r"A[_ ]?obj|per object|pro (objekt|stück)|absorptionsfläche|absorption area", re.I
)
_PERCENT = re.compile(r"%|percent|prozent", re.I)
_UNIT = r"(?:in\s+(?:%|percent|prozent)|[\[(]\s*(?:%|percent|prozent)\s*[\])])"
_OF_COLUMN = re.compile(rf"\s*{_UNIT}\s*$", re.I)
_OF_COEFFICIENTS = re.compile(
    r"(?:\w*(?:alpha|α|absor|coeff|koeff)[\w,.]*|\b(?:values|werte|angaben))\s*[/,:]?\s*"
    rf"(?:{_UNIT}|(?:%|percent|prozent)\s*$)",
    re.I,
)


@checked
def read(path: str | os.PathLike[str]) -> MaterialList:
    """Return the products of a file or of all files of a folder.

    Raises
    ------
    DataError
        Naming file, sheet, line and rule: for a table without bands, a coefficient that is no number,
        below 0 or above 1.5, and a product that is given twice.
    MissingDependencyError
        For a workbook without openpyxl.
    """
    folder = Path(path)
    if folder.is_dir():
        files = sorted(p for p in folder.iterdir() if p.suffix.lower() in ENDINGS)
        if not files:
            raise DataError(f"{path}: no file that ends in {', '.join(ENDINGS)}")
        if len(files) > MAX_FILES:
            raise DataError(f"{path}: {len(files)} files; at most {MAX_FILES}")
    else:
        files = [folder]
    materials: dict[str, tuple[Path, ListedMaterial]] = {}
    for file in files:
        for material in _materials(file):
            if material.name in materials:
                raise DataError(
                    f'{file}, line {material.line}: "{shown(material.name)}" is given twice, also in '
                    f"{materials[material.name][0]}"
                )
            materials[material.name] = file, material
    listed = tuple(material for _, material in materials.values())
    return MaterialList(path=os.fspath(path), text=Text(""), materials=listed)


def _materials(file: Path) -> Iterator[ListedMaterial]:
    content = read_bytes(file, MAX_TEXT * 16)
    if workbook.claims(content):
        sheets = workbook.sheets(content, os.fspath(file), {})
    else:
        text = decode(content, os.fspath(file))
        sheets = [sheet_of_text(text, os.fspath(file), decay_time=TARGET.key)]
    found = False
    for sheet in sheets:
        for material in _of_sheet(sheet, file.stem if len(sheets) == 1 else sheet.name):
            found = True
            yield material
    if not found:
        raise DataError(
            f"{sheets[0].place}: no table of coefficients; a header with {_LEAST_BANDS} bands or more "
            "is needed, such as product;125;250;500, or rows that begin with a band"
        )


def _of_sheet(sheet: Sheet, otherwise: str) -> Iterator[ListedMaterial]:
    """Yield the materials of a sheet; ``otherwise`` is the name of one that has none."""
    for at, (_, cells) in enumerate(sheet.rows):
        at_bands = {k: f for k, c in enumerate(cells) if (f := _band(c)) is not None}
        if len(at_bands) >= _LEAST_BANDS and list(at_bands.values()) == sorted(at_bands.values()):
            _refuse_repeated_band(
                f"{sheet.place}, line {sheet.rows[at][0]}",
                [(f"column {k + 1}", f) for k, f in at_bands.items()],
            )
            yield from _across(sheet, at, at_bands)
            return
    yield from _down(sheet, otherwise)


def _refuse_repeated_band(place: str, stated: Sequence[tuple[str, float]]) -> None:
    """Raise DataError if two columns or lines are of one band."""
    first: dict[float, str] = {}
    for where, frequency in stated:
        if frequency in first:
            raise DataError(
                f"{place}: {first[frequency]} and {where} are both {bands.label(frequency)}; "
                "a band has one coefficient per product"
            )
        first[frequency] = where


def _band(cell: str) -> float | None:
    value = frequency_of(
        re.sub(r"^(alpha|α)\w*\s*", "", re.sub(r"\s*[\[(]\s*%\s*[\])]$", "", cell.strip()))
    )
    return nearest_band(value) if value is not None and value >= LEAST_BAND else None


def _across(sheet: Sheet, at: int, at_bands: dict[int, float]) -> Iterator[ListedMaterial]:
    header = sheet.rows[at][1]
    texts = [k for k in range(len(header)) if k not in at_bands]
    names = [k for k in texts if _NAMES.fullmatch(header[k])] or texts[:1]
    if not names:
        raise DataError(
            f"{sheet.place}, line {sheet.rows[at][0]}: no column has the product's name"
        )
    titles = _titles(sheet.rows[:at])
    _refuse_objects(sheet, [*header, *titles])
    percent = _in_percent([header[k] for k in at_bands], [*header, *titles])
    elsewhere = "" if percent else _first_percent([*header, *titles])
    for line, cells in sheet.rows[at + 1 :]:
        name = cells[names[0]] if len(cells) > names[0] else ""
        values = {
            f: cells[k] for k, f in at_bands.items() if k < len(cells) and not is_missing(cells[k])
        }
        if not values:
            continue
        if not name:
            raise DataError(f"{sheet.place}, line {line}: coefficients without a product's name")
        stated = [
            f"{header[k]}: {cells[k]}"
            for k in texts
            if k != names[0] and k < len(cells) and cells[k]
        ]
        stated += _lacking(at_bands.values(), values)
        yield _material(sheet.place, line, name, values, [*titles, *stated], percent, elsewhere)


def _down(sheet: Sheet, otherwise: str) -> Iterator[ListedMaterial]:
    rows = [(i, f) for i, (_, c) in enumerate(sheet.rows) if (f := _band(c[0])) is not None]
    if len(rows) < _LEAST_BANDS:
        return
    _refuse_repeated_band(sheet.place, [(f"line {sheet.rows[i][0]}", f) for i, f in rows])
    first = rows[0][0]
    header = sheet.rows[first - 1][1] if first else []
    if not header or not (not header[0] or _BAND_HEADER.fullmatch(header[0])):
        header = []
    titles = _titles(sheet.rows[: max(first - bool(header), 0)])
    _refuse_objects(sheet, [*header, *titles])
    width = max(len(sheet.rows[i][1]) for i, _ in rows)
    columns = [
        k
        for k in range(1, width)
        if any(len(sheet.rows[i][1]) > k and sheet.rows[i][1][k] for i, _ in rows)
    ]
    for k in columns:
        name = header[k] if len(header) > k else ""
        if len(columns) == 1:
            name = otherwise
        if not name:
            place = f"{sheet.place}, line {sheet.rows[max(first - 1, 0)][0]}"
            raise DataError(f"{place}: column {k + 1} has no product's name")
        values = {
            f: sheet.rows[i][1][k]
            for i, f in rows
            if len(sheet.rows[i][1]) > k and not is_missing(sheet.rows[i][1][k])
        }
        percent = _in_percent(header[k : k + 1], [*header, *titles])
        elsewhere = "" if percent else _first_percent([*header, *titles])
        line = sheet.rows[first][0]
        stated = [*titles, *_lacking((f for _, f in rows), values)]
        yield _material(sheet.place, line, name, values, stated, percent, elsewhere)


def _refuse_objects(sheet: Sheet, texts: Sequence[str]) -> None:
    """Raise DataError for absorption areas in m² of objects (ISO 354, Sect. 8.1.3)."""
    if named := next(filter(_PER_OBJECT.search, texts), ""):
        raise DataError(
            f'{sheet.place}: "{shown(named)}" names absorption areas in m², and no coefficients: '
            "multiply one by the number of objects, and divide by the area that is stated for them"
        )


def _titles(rows: Sequence[Row]) -> list[str]:
    return [" ".join(filter(None, cells)) for _, cells in rows]


def _lacking(of_table: Iterable[float], values: dict[float, str]) -> list[str]:
    """Return the note of a product that has no coefficient in some bands of its table."""
    lacking = [bands.label(f) for f in of_table if f not in values]
    return [f"no coefficient at {', '.join(lacking)}"] if lacking else []


def _in_percent(own: Sequence[str], texts: Sequence[str]) -> bool:
    """Return whether the coefficients' own headers, or texts that name them, have the unit %."""
    return any(map(_OF_COLUMN.search, own)) or any(map(_OF_COEFFICIENTS.search, texts))


def _first_percent(texts: Sequence[str]) -> str:
    return next(filter(_PERCENT.search, texts), "")


def _material(
    place: str,
    line: int,
    name: str,
    values: dict[float, str],
    stated: Sequence[str],
    percent: bool,
    elsewhere: str,
) -> ListedMaterial:
    alpha, above = [], []
    for frequency, cell in values.items():
        where = f"{place}, line {line}: {shown(name)} at {bands.label(frequency)}"
        text = cell.rstrip("% ")
        scale = 0.01 if percent or cell != text else 1.0
        value = scale * number(text.replace(",", ".") if text.count(",") == 1 else text, where)
        if not 0 <= value <= LARGEST:
            raise DataError(
                f"{where}: {value:g} is not from 0 to {LARGEST:g}; name % with the coefficient if in "
                'percent, as in a line "alpha in %" above the header'
            )
        if value > 1:
            above.append(f"{value:.2f} at {bands.label(frequency)}")
        alpha.append(min(value, 1.0))
    source = "; ".join([f"{place}, line {line}", *filter(None, stated)])
    if elsewhere and not all("%" in cell for cell in values.values()):
        source += f'; taken as fractions: "{shown(elsewhere, 60)}" is no unit of the coefficients'
    if above:
        source += f"; above 1 (edge effect), taken as 1: {', '.join(above)}"
    return ListedMaterial(
        name=name,
        line=line,
        alpha=tuple(alpha),
        centre_frequencies=tuple(values),
        spans=(),
        source=" ".join(source.split())[:1000],
    )
