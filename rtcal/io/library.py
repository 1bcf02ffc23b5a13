"""Product data (ISO 354) as a material list: a table (CSV, xlsx), or a folder of them.

A table has one product per row, its name in the first column and bands across; or one product per
column and bands down. A single product column has the file's name, or the sheet's::

    product;mounting;250;500;1000        f [Hz];Baffle [%];Rug [-]
    Baffle;E-400;0,45;0,90;1,10          250;45;0,10

The unit is % or -, behind a band ("250 Hz [%]") or a product's name, in a column "unit", or behind the
numbers; without one the numbers are fractions. A table in which a title or another header has a unit
is refused, since only the reader knows of what that is: ``columns`` states what every column holds.

Other columns and titles go into the material's source. A coefficient above 1, which ISO 354's edge
effect gives, is taken as 1, and the source says so. A product in m² per object has a doubt, and no room
may use it. Times, uncertainties and statistics beside coefficients are left out, and named in the
source.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rtcal.acoustics import bands
from rtcal.files.disk import read_bytes
from rtcal.files.schema import TABLE, expecting
from rtcal.io import budget
from rtcal.io import table_columns as words
from rtcal.io.material_list import ListedMaterial, MaterialList
from rtcal.io.table_columns import Column
from rtcal.io.tables import columns_text, sheets_of, stated_columns
from rtcal.io.text import MAX_TEXT, Row, Sheet, Text, number, shown
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import first_of

__all__ = ["read"]
__dir__ = __all__.copy

ENDINGS = (".csv", ".txt", ".xlsx")
MAX_FILES = 1000
LARGEST = 1.5
"""Largest coefficient of ISO 354 that is not taken for a percentage; edges of a specimen add up to a
half."""

_LEAST_BANDS = 3
_MOST_LEFT_OUT = 6
_PERCENT = re.compile(r"%|percent|per ?cento?|prozent|pour ?cent|por ?ciento|por ?cento|pct", re.I)
_IN_PERCENT = re.compile(
    rf"(?:\b(?:in|en)\s*|/\s*)(?:{_PERCENT.pattern})|[\[(]\s*(?:{_PERCENT.pattern})\s*[\])]|"
    rf"^(?:\[?Hz\]?\s*)?(?:(?:{_PERCENT.pattern})\s*)+$",
    re.I,
)
"""A title that has the coefficients' unit."""
_ALONE = re.compile(rf"(?<!\d)(?<!\d )(?:{_PERCENT.pattern})", re.I)
"""A percent sign that is not behind a number, as in "50 % open"."""
_ENDS_IN_PERCENT = re.compile(rf"(?<!\d)(?<!\d )(?:{_PERCENT.pattern})\s*[\])]?\s*$", re.I)
_AREA = re.compile(
    r"(?<!\d)(?<!\d )(?:m²|m\^?2|qm|sq\.?\s*m|ft²|sabins?)|A_?obj|\bper (?:object|chair|person)|"
    r"absorption areas?|(?:absorptions|absorber)fläche|aires? d.absorption|[aá]rea\w* d[ei] as?[bs]sor",
    re.I,
)
_COEFFICIENT = re.compile(
    r"(?=.*(?:alpha|α|absor|assorb|[ck]oef))(?:(?:(?:alpha|α)(?:[_ ]?(?:sabine|[spi])\b|[sp])?|[sp]|of|"
    r"de|di|do|d|l|sound|mean|ac[uúo]+stic\w*|(?:schall)?absor\w*|assorb\w*|[ck]oe?ff?i[zc]i\w*)"
    r"(?:\W|_|$)+)+",
    re.I,
)
_BESIDE = re.compile(
    r"(?:T|RT|TR)[_ ]?(?:\d{1,2}|m|s)?|U(?:_?\w)?\s*(?:[\[(,]?\s*k\s*=.*)?|U_?95|±.*|s_?R|"
    r".*(?:uncertainty|unsicherheit|incert\w+)",
    re.I,
)
"""A time or an uncertainty."""


def read(path: str | os.PathLike[str], *, columns: str = "") -> MaterialList:
    """Return the products in tables of a manufacturer or laboratory, with their alpha, as materials.

    Raises DataError for a table without bands, an ambiguous unit, an alpha that is not a number from 0
    to 1.5 (it may be above 1 in a reverberation room, ISO 354), and a product that is given twice. The
    message names the file, the sheet, the line and the rule. Raises MissingDependencyError for a
    workbook, if openpyxl is not installed.

    Parameters
    ----------
    path : path
        Path of a table, or of a folder of tables.
    columns : str, optional
        Meaning of each column in order, with the first line of values and optionally the last, for a
        table without usual headers: ``"from line 3: product; -; value [%] at 250 Hz; value [%] at 500
        Hz"``, or ``"from line 3 to 9: band; value [-] of Rug"``. An error message proposes it.
    """
    checks.text("columns", columns)
    files = [checks.path("path", path)]
    if files[0].is_dir():
        files = sorted(p for p in files[0].iterdir() if p.suffix.lower() in ENDINGS)
        if not files:
            raise DataError(f"{path}: the folder has no file that ends in {', '.join(ENDINGS)}")
        budget.require(len(files), MAX_FILES, "files", os.fspath(path))
    materials: dict[str, tuple[Path, ListedMaterial]] = {}
    for file in files:
        with expecting(TABLE, file):
            sheets = sheets_of(read_bytes(file, MAX_TEXT * 16), os.fspath(file))
            of_file = list[ListedMaterial]()
            for sheet in sheets:
                name = file.stem if len(sheets) == 1 else sheet.name
                table = _stated_table(sheet, columns, name) if columns else _table(sheet, name)
                if table is not None:
                    of_file += _of_table(table)
            if not of_file:
                raise DataError(
                    f"{sheets[0].place}: no table of coefficients was found; it must have a "
                    f"header with {_LEAST_BANDS} bands or more, such as product;125;250;500, or "
                    "rows that begin with a band"
                )
        for material in of_file:
            if material.name in materials:
                raise DataError(
                    f'{file}, line {material.line}: "{shown(material.name)}" is given twice, also in '
                    f"{materials[material.name][0]}"
                )
            materials[material.name] = file, material
    listed = tuple(material for _, material in materials.values())
    return MaterialList(path=os.fspath(path), text=Text(""), materials=listed)


@dataclass(frozen=True)
class _Table:
    """The columns of a sheet, the rows with values, and the texts around them.

    A column is of kind "product", "unit", "band", "value" or "". ``left_out`` stands beside products.
    """

    place: str
    columns: list[Column]
    rows: list[Row]
    titles: list[str]
    left_out: list[str]

    @property
    def first(self) -> int:
        """The line of the first row."""
        return self.rows[0][0]


def _stated_table(sheet: Sheet, columns: str, otherwise: str) -> _Table:
    """Return the table whose columns are stated; ``otherwise`` is the name of a protocol's product."""
    lines, made = stated_columns(sheet, columns, "product")
    rows = [row for row in sheet.rows if row[0] in lines]
    if short := [n for n, cells in rows if len(cells) != len(made)]:
        raise DataError(
            f"{sheet.place}, line {short[0]}: this row must have {len(made)} cells, as "
            "many as columns gives"
        )
    if not rows:
        raise DataError(f"{sheet.place}: the lines that columns gives have no row with a value")
    at, left_out = [k for k, column in enumerate(made) if column.kind == "product"], list[str]()
    if at:
        rows, left_out = _rows_of_products(sheet.place, rows, at[0], otherwise)
    return _Table(sheet.place, made, rows, [], left_out)


def _table(sheet: Sheet, otherwise: str) -> _Table | None:
    """Return the table of a sheet by its header; None without bands."""
    width = max(len(cells) for _, cells in sheet.rows)
    rows = [(line, [*cells, *[""] * width][:width]) for line, cells in sheet.rows]
    for i, (_, header) in enumerate(rows):
        found = [_band(cell) for cell in header]
        of_bands = [band for band in found if band]
        if len(of_bands) >= _LEAST_BANDS and of_bands == sorted(of_bands):
            return _across(sheet.place, rows, i, found, otherwise)
    in_khz = any("khz" in cells[0].lower() for _, cells in rows if not words.frequency_of(cells[0]))
    at = [i for i, (_, cells) in enumerate(rows) if _band(cells[0], 1000 if in_khz else 1)]
    if len(at) < _LEAST_BANDS:
        return None
    return _down(sheet.place, rows, at[0], otherwise, "kHz" if in_khz else "")


def _across(
    place: str, rows: Sequence[Row], at: int, found: Sequence[float | None], otherwise: str
) -> _Table:
    """Return a table with a product in each row, whose header is the row ``at``."""
    line, header = rows[at]
    if found[0]:
        raise DataError(f"{place}, line {line}: the column with the product's name is missing")
    columns = [Column("product", header[0])]
    for name, band in zip(header[1:], found[1:], strict=True):
        kind = "unit" if words.COLUMNS.get(words.plain(name)) == "unit" else ""
        unit = _own_unit(name) if band else ""
        columns.append(Column("value" if band else kind, name, band=band or 0.0, unit=unit))
    of_values = [k for k, column in enumerate(columns) if column.has_values]
    body = [row for row in rows[at + 1 :] if any(row[1][k] for k in of_values)]
    units = [
        row for row in body if not row[1][0] and not any(_is_number(row[1][k]) for k in of_values)
    ]
    body = [row for row in body if row not in units]
    products, left_out = _rows_of_products(place, body, 0, otherwise)
    units += [row for row in rows[:at] if all(row[1][k] for k in of_values)]
    table = _Table(place, columns, products, _texts([*rows[:at], *units]), left_out)
    if units:
        raise _open_unit(table, _texts(units)[0])
    return _checked(table)


def _down(place: str, rows: Sequence[Row], at: int, otherwise: str, unit: str) -> _Table:
    """Return a table with a product in each column, whose first band is in the row ``at``."""
    heads = [cells for _, cells in rows[max(at - 2, 0) : at] if sum(map(bool, cells)) > 1]
    heads.sort(key=lambda cells: all(map(_is_unit, filter(None, cells[1:]))))
    header = heads[0] if heads else rows[max(at - 1, 0)][1] if at else [""] * len(rows[0][1])
    used = {k: header[k] for k in range(1, len(header)) if any(cells[k] for _, cells in rows[at:])}
    if len(used) == 1 and _role(*used.values()) != "beside":
        names, left_out = dict.fromkeys(used, otherwise), list[str]()
    else:
        names, left_out = _products(f"{place}, line {rows[at][0]}", used, otherwise)
    columns = [Column("band", header[0], unit=unit)]
    below = heads[1] if len(heads) > 1 else [""] * len(header)
    for k in range(1, len(header)):
        own = _own_unit(header[k]) or _own_unit(f"[{below[k].strip('[]()')}]")
        kind = "value" if k in names else ""
        columns.append(Column(kind, header[k], receiver=names.get(k, ""), unit=own))
    body = []
    for line, cells in rows[at:]:
        if _band(cells[0], 1000 if unit else 1):
            body.append((line, cells))
        elif any(map(_is_number, cells[1:])) and _role(cells[0]) != "beside":
            raise DataError(
                f'{place}, line {line}: "{shown(cells[0])}" is not a band: write the centre '
                "frequency of an octave or one-third octave in Hz, or delete the row"
            )
        else:
            left_out += cells[:1]
    titles = _texts([row for row in rows[:at] if row[1] is not header])
    table = _Table(place, columns, body, titles, left_out)
    if len(heads) > 1:
        raise DataError(
            f"{place}, line {rows[at][0]}: there are two rows of names above the bands; keep "
            f"one, or give {_proposal(table, titles[-1])}"
        )
    return _checked(table)


def _products(
    place: str, named: Mapping[int, str], otherwise: str
) -> tuple[dict[int, str], list[str]]:
    """Return the products' names, of rows or columns, and the names of what stands beside them."""
    roles = {k: _role(name) for k, name in named.items()}
    roles |= {
        k: "beside" for k, n in named.items() if n.removeprefix("U ") in {*named.values()} - {n}
    }
    left_out = [name for k, name in named.items() if roles[k] == "beside"]
    coefficients = [k for k in named if roles[k] == "coefficient"]
    products = {k: name for k, name in named.items() if not roles[k]}
    if len(coefficients) == 1 and not products:
        return {coefficients[0]: otherwise}, left_out
    wrong = [named[k] for k in coefficients] or left_out
    if wrong and (coefficients or not products):
        raise DataError(
            f'{place}: "{shown(wrong[0])}" is the name of a coefficient, a time or a statistic, '
            "not of a product; write the product's name, or delete the column"
        )
    return products, left_out


def _rows_of_products(
    place: str, rows: Sequence[Row], at: int, otherwise: str
) -> tuple[list[Row], list[str]]:
    """Return the rows of products, whose names stand in column ``at``, and the names of the others."""
    names, left_out = _products(place, {line: cells[at] for line, cells in rows}, otherwise)
    if [*names.values()] == [otherwise]:  # whose own name, with its unit, is that of a coefficient
        rows = [
            (n, [f"{c}%" if _is_number(c) and _own_unit(cells[at]) == "%" else c for c in cells])
            for n, cells in rows
        ]
    return [
        (line, [*cells[:at], names[line], *cells[at + 1 :]])
        for line, cells in rows
        if line in names
    ], left_out


def _is_unit(cell: str) -> bool:
    return bool(_IN_PERCENT.search(cell) or _AREA.search(cell) or cell.strip("[]()") == "-")


def _texts(rows: Sequence[Row]) -> list[str]:
    return [" ".join(filter(None, cells)) for _, cells in rows]


def _is_number(cell: str) -> bool:
    return bool(re.fullmatch(r"\d*[.,]?\d+\s*%?", cell))


def _band(cell: str, factor: float = 1.0) -> float | None:
    """Return the band that a cell names, perhaps with a unit of its values; ``factor`` is to Hz."""
    name, unit = words.name_and_unit(re.sub(r"^(alpha|α)\w*\s*", "", cell.strip()))
    value = words.frequency_of(f"{name} {unit}" if unit.lower() in ("hz", "khz") else name)
    if value is not None and not re.search(r"k|hz", cell, re.I):
        value *= factor
    return words.nearest_band(value) if value is not None and value >= words.LEAST_BAND else None


def _own_unit(name: str) -> str:
    """Return the unit behind a product's or a band's name, "" without one."""
    name = name[-words.MAX_HEADER :].rstrip()
    if _ENDS_IN_PERCENT.search(name):
        return "%"
    unit = words.name_and_unit(name)[1] if name.endswith(("]", ")")) else ""
    is_unit = unit.lower() in words.UNIT_WORDS - {"hz", "khz"} or _AREA.search(unit)
    return unit if is_unit else ""


def _role(name: str) -> str:
    """Return "coefficient", "beside" (a time, an uncertainty, a statistic), or "" for a product."""
    name = words.name_and_unit(name.strip())[0] if len(name) <= words.MAX_HEADER else ""
    name = re.sub(
        r"\s*(?:(?:/|\bin|\ben)\s*[-\u2013]?|[\[(])?\s*$", "", _ENDS_IN_PERCENT.sub("", name)
    )
    if not name or _COEFFICIENT.fullmatch(name):
        return "coefficient" if name else ""
    is_beside = words.parameter_of(name) or _BESIDE.fullmatch(name)
    return "beside" if is_beside or words.statistic_of(name) not in (None, words.DOUBTFUL) else ""


def _checked(table: _Table) -> _Table:
    """Return a table whose units are stated, or not spoken of; DataError with a proposal for others."""
    if not table.rows:
        raise DataError(f"{table.place}: no row has coefficients of a product")
    of_values = [k for k, column in enumerate(table.columns) if column.has_values]
    of_cells = any(column.kind == "unit" for column in table.columns) or any(
        "%" in cells[k] for _, cells in table.rows for k in of_values
    )
    others = [*table.titles, *(c.header for c in table.columns if not c.has_values)]
    said = [text for text in others if _ALONE.search(text) or _AREA.search(text)]
    text = next(filter(_IN_PERCENT.search, said), next(iter(said), ""))
    if not text or of_cells or all(c.unit for c in table.columns if c.has_values):
        return table
    raise _open_unit(table, text)


def _open_unit(table: _Table, text: str) -> DataError:
    """Return the error of a table of which a text may be the unit, with a proposal."""
    may_be = "may be the unit of the coefficients: write [%] or [-] behind each band or product, or"
    if _AREA.search(text):
        may_be = (
            "names absorption areas in m², which are not coefficients; if these values are "
            "coefficients,"
        )
    return DataError(
        f'{table.place}, line {table.first}: "{shown(text, 60)}" {may_be} state '
        f"{_proposal(table, text if text in table.titles else '')}"
    )


def _proposal(table: _Table, title: str) -> str:
    """Return ``columns`` for a table: in percent if a title says so, or a number is as large."""
    of_values = [k for k, column in enumerate(table.columns) if column.has_values]
    cells = [cells[k].replace(",", ".") for _, cells in table.rows for k in of_values]
    large = any(_is_number(cell) and float(cell.rstrip("% ")) > LARGEST for cell in cells)
    unit = "%" if large or _IN_PERCENT.search(title) else "?"
    columns = [
        replace(c, unit="%" if _PERCENT.fullmatch(c.unit) else c.unit or unit)
        if c.has_values
        else c
        for c in table.columns
    ]
    kept = [c.kind and not _AREA.search(c.unit) for c in columns]
    lines = f"{table.first} to {table.rows[-1][0]}"
    return columns_text(
        lines, [c.meaning if k else "-" for c, k in zip(columns, kept, strict=True)]
    )


def _of_table(table: _Table) -> list[ListedMaterial]:
    """Return the materials of a table."""
    products: dict[str, dict[float, tuple[str, str, int]]] = {}  # text, unit and line by band
    texts: dict[str, dict[str, None]] = {}  # what else their rows state
    in_rows = any(column.kind == "product" for column in table.columns)
    in_khz = any(c.kind == "band" and c.unit.lower() == "khz" for c in table.columns)
    for line, cells in table.rows:
        pairs = [*zip(table.columns, cells, strict=True)]
        entries = {column.kind: cell for column, cell in pairs if column.kind}
        beside = [f"{c.header}: {cell}" for c, cell in pairs if c.kind in ("", "unit") and cell]
        of_row = _band(entries.get("band", ""), 1000 if in_khz else 1)
        for column, cell in (pair for pair in pairs if pair[0].has_values):
            name, band = column.receiver or entries.get("product", ""), of_row or column.band
            if not name and cell:
                raise DataError(
                    f"{table.place}, line {line}: these coefficients have no product name; add it"
                )
            known = products.setdefault(name, {})
            if band in known or (in_rows and known and line != next(iter(known.values()))[2]):
                raise DataError(
                    f'{table.place}, line {line}: "{shown(name)}" is given twice at '
                    f"{bands.label(band)}; give one coefficient per product and band"
                )
            unit = column.unit or entries.get("unit", "") or _own_unit(name)
            known[band] = cell, unit, line
            texts.setdefault(name, dict.fromkeys(table.titles)).update(dict.fromkeys(beside))
    every = [value for known in products.values() for value in known.values()]
    if len({bool(u or "%" in cell) for cell, u, _ in every if not _AREA.search(u)}) > 1:
        raise DataError(
            f"{table.place}, line {table.first}: some coefficients have a unit and others have "
            "none; write the unit (% or -) with all or with none"
        )
    if not products:
        raise DataError(f"{table.place}: no column holds coefficients of a product")
    materials = [_material(table, name, products[name], [*texts[name]]) for name in products]
    if all(material.doubt for material in materials):
        raise DataError(materials[0].doubt)
    return materials


def _material(
    table: _Table, name: str, values: Mapping[float, tuple[str, str, int]], texts: Sequence[str]
) -> ListedMaterial:
    """Return a product as a material; it has a doubt if its numbers are no coefficients."""
    line = next(iter(values.values()))[2]
    place = f"{table.place}, line {line}"
    doubt, alpha, above = "", dict[float, float](), []
    for frequency, (cell, unit, _) in values.items():
        if words.is_missing(cell):
            continue
        where = f"{place}: {shown(name)} at {bands.label(frequency)}"
        text = cell.rstrip("% ")
        unit = "%" if cell != text else unit
        if _AREA.search(unit) or _AREA.search(name[: words.MAX_HEADER]):
            doubt = (
                f'{place}: {shown(name)}: "{shown(unit or name)}" has absorption areas in m², '
                "not coefficients: to get a coefficient, multiply the area of one object by the "
                "number of objects and divide by the area that they have in the room"
            )
        elif unit not in ("", "-", "1") and not _PERCENT.fullmatch(unit.strip()):
            raise DataError(f'{where}: "{shown(unit)}" is not a unit of coefficients; use % or -')
        scale = 0.01 if _PERCENT.fullmatch(unit.strip()) else 1.0
        share = scale * number(text.replace(",", ".") if text.count(",") == 1 else text, where)
        if not 0 <= share <= LARGEST and not doubt:
            raise DataError(
                f"{where}: {share:g} must be from 0 to {LARGEST:g}. If it is in percent, "
                'write % in the header, as in "250 Hz [%]"'
            )
        if share > 1:
            above.append(f"{share:.2f} at {bands.label(frequency)}")
        alpha[frequency] = min(share, 1.0)
    source = [place, *texts]
    if missing := [bands.label(f) for f in values if f not in alpha]:
        source.append(f"no coefficient at {', '.join(missing)}")
    if above:
        source.append(f"above 1 (edge effect), taken as 1: {', '.join(above)}")
    if table.left_out:
        named = [f'"{shown(n)}"' for n in dict.fromkeys(table.left_out)]
        source.append(f"left out: {first_of(named, _MOST_LEFT_OUT)}")
    return ListedMaterial(
        name=name,
        line=line,
        alpha=tuple(alpha.values()),
        centre_frequencies=tuple(alpha),
        spans=(),
        source=" ".join("; ".join(source).split())[:1000],
        doubt=doubt,
    )
