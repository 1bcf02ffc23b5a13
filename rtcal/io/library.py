"""Product data (ISO 354) as a material list: a table (CSV, xlsx), or a folder of them.

A table has one product per row, with bands across, or one per column, with bands down. Both are read
alike: a sheet is turned so that each product is a column, its names are above and its bands below
(`_Upright`). A single column takes the file's name, or the sheet's.

A column or a title such as "mounting: E-400" or "source" goes into the material's source. A coefficient
above 1, which ISO 354's edge effect gives, is taken as 1, and the source says so. Coefficients are in
percent if their own cells or headers have the unit ("250 Hz [%]"), a row of units or a column "unit"
has it, or a text names both ("alpha in %"). A % that stands elsewhere, such as "open area [%]", changes
nothing, and the source says so. A product in m² per object has a doubt, and no room may use it.

Of a protocol, with columns or rows such as T1, T2, alpha_s and U(k=2), the coefficients are read, and
the source names what is left out; so it does with uncertainties and statistics beside products.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rtcal.acoustics import bands
from rtcal.acoustics.observables import DecaySlope, of_kind
from rtcal.files.disk import read_bytes
from rtcal.io.material_list import ListedMaterial, MaterialList
from rtcal.io.table_columns import (
    COLUMNS,
    DOUBTFUL,
    LEAST_BAND,
    MAX_HEADER,
    OPEN_DECAY_TIMES,
    frequency_of,
    is_missing,
    name_and_unit,
    nearest_band,
    parameters,
    plain,
    statistic_of,
)
from rtcal.io.tables import sheets_of
from rtcal.io.text import MAX_TEXT, Sheet, Text, number, shown
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import first_of

__all__ = ["read"]
__dir__ = __all__.copy

ENDINGS = (".csv", ".txt", ".xlsx")
MAX_FILES = 1000
LARGEST = 1.5
"""Largest coefficient of ISO 354 that is no percentage: a small specimen's edges add up to a half."""

_LEAST_BANDS = 3
_MOST_LEFT_OUT = 6
_NAMES = re.compile(
    r"(mat[eé]ria|produ[ck]?t|prodotto|name|nom|bezeichnung|artikel|d[eé]signation|denominaci|descri|"
    r"typ[eo]?\b|tipo\b).*",
    re.I,
)
_QUANTITY = re.compile(
    r"(quantit|grö|groe|kenngr|messgr|symbol|grand|magnitud|value|wert|val|kind)\w*", re.I
)
_PERCENT = r"(?:%|percent|per ?cento?|prozent|pour ?cent|por ?ciento|por ?cento|pct)"
_M2 = r"(?:m\s*²|m\^?2|qm|sq\.?\s*m|square met(?:er|re)s?|ft\s*²|ft\^?2|sq\.?\s*ft|sabin[es]*)"
_OTHER = r"(?:k?hz|m?s|sec|db|‰|per ?mille?|promille?|[x×·*]\s*100)"
_PER = r"(?:/|\b(?:per|pro|je|par|por|a)\b)"
_OBJECT = (
    r"(?:A[_ ]?obj\w*|per object|pro (?:objekt|stück|platz|person|stuhl)|absorption areas?|"
    r"(?:absorptions|absorber)fläche|areas? of absorption|aires? d.absorption|[aá]rea\w* de absor\w*|"
    r"are[ae] di assorbimento)"
)
_UNITS = {
    "%": re.compile(_PERCENT, re.I),
    "-": re.compile(r"[-\u2013\u2014]|1|fraction|dimension\w+|sans dimension", re.I),
    "m²": re.compile(rf"(?:A\s*(?:/|in)?\s*)?{_M2}\W*(?:{_PER}.*)?|{_OBJECT}.*", re.I),
    "other": re.compile(_OTHER, re.I),
}
"""The units that a cell may be, and nothing else."""
_PER_OBJECT = re.compile(rf"{_OBJECT}|(?<!\d)(?<!\d\s){_M2}\s*{_PER}\s*[^\W\d]", re.I)
_BEFORE_UNIT = r"(?:\b(?:in|en)\s+|/\s*|[\[(]\s*)"
_OF_COLUMN = re.compile(
    rf"(?:{_BEFORE_UNIT}|(?<![\d\s])[\s,]*(?=%))([^\[\]()]+?)\s*[\])]?\s*$|(?<![\d\s])\s*([x×·*]\s*100)$",
    re.I,
)
"""A column's name with its unit behind it."""
_OF_TABLE = re.compile(
    r"(?:(?:alpha|α|absor|assorb|[ck]oef)[\w,.]*|\bA|\b(?:values|werte|angaben|valeurs|valores|valori))\s*[,:]?\s*"
    rf"(?:(?:{_BEFORE_UNIT}|(?=%))({_PERCENT}|{_M2})|([x×·*]\s*100))(?!\w)(?!\s*[\])]?\s*[:=]\s*\d)",
    re.I,
)
"""A text that has the coefficients' unit, among others."""
_UNIT_BEHIND = re.compile(
    rf"\s*(?:[\[(][^\])]*[\])]|(?:/|\b(?:in|en)\b)\s*(?:{_PERCENT}|\S+)|%)\s*$", re.I
)
_ALPHA = r"(?:alpha|α)(?:[_ ]?(?:sabine|[spi])\b|[sp])?"
_COEFFICIENT = re.compile(
    rf"(?=.*(?:alpha|α|absor|assorb|[ck]oef))(?:(?:{_ALPHA}|[sp]|of|de|di|do|d|l|sound|mean|"
    r"ac[uúo]+stic\w*|(?:schall)?absor\w*|assorb\w*|[ck]oe?ff?i[zc]i\w*)(?:\W|_|$)+)+",
    re.I,
)
_BESIDE = re.compile(
    r"(?:T|RT|TR)[_ ]?(?:\d{1,2}|m|s)?\W*(?:(?:empty|leer|ohne|mit|with|vide|avec|sans|sin|con|senza|"
    r"vacía|vuot|sem|com)\w*\b.*)?|.*[\[(]\s*(?:m?s|sec|db|k?hz)\s*[\])]|"
    r"U(?:_?(?:α\w?|alpha\w*|95|\w))?\s*(?:[\[(,]?\s*k\s*=?.*)?|±.*|s_?R|"
    r".*(?:uncertainty|unsicherheit|incert\w+)\b.*",
    re.I,
)
"""A time or an uncertainty."""
_SYMBOL = re.compile(r"[AScVm]_?\w{0,3}", re.I)
_ARE_NONE = {
    "m²": "names absorption areas in m², and no coefficients: multiply one by the number of objects, "
    "and divide by the area that is stated for them",
    "other": "is no unit of coefficients; they have % or none",
}


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
    files = [checks.path("path", path)]
    if files[0].is_dir():
        files = sorted(p for p in files[0].iterdir() if p.suffix.lower() in ENDINGS)
        if not files:
            raise DataError(f"{path}: no file that ends in {', '.join(ENDINGS)}")
        if len(files) > MAX_FILES:
            raise DataError(f"{path}: {len(files)} files; at most {MAX_FILES}")
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


def _materials(file: Path) -> list[ListedMaterial]:
    sheets = sheets_of(read_bytes(file, MAX_TEXT * 16), os.fspath(file))
    found = []
    for sheet in sheets:
        found += _of_sheet(_upright(sheet), file.stem if len(sheets) == 1 else sheet.name)
    if not found:
        raise DataError(
            f"{sheets[0].place}: no table of coefficients; a header with {_LEAST_BANDS} bands or more "
            "is needed, such as product;125;250;500, or rows that begin with a band"
        )
    return found


@dataclass
class _Upright:
    """A sheet in which each product is a column and each band a row; the first column has labels.

    ``across`` is whether the file has them the other way round. ``rows`` are their place in the file
    with their cells, ``at`` the bands in Hz of some rows by their number, ``lines`` the line of each
    column's product, ``titles`` the texts around the table.
    """

    place: str
    across: bool
    rows: list[tuple[str, list[str]]]
    at: dict[int, float]
    lines: list[int]
    titles: list[str]


@dataclass(frozen=True, kw_only=True)
class _Product:
    """A product's name, its line, its cells by band in Hz, the texts with its unit, other texts."""

    name: str
    line: int
    values: Mapping[float, str]
    units: Sequence[str]
    stated: Sequence[str]


def _upright(sheet: Sheet) -> _Upright:
    width = max(len(cells) for _, cells in sheet.rows)
    rows = [(line, cells + [""] * (width - len(cells))) for line, cells in sheet.rows]
    for k, (line, header) in enumerate(rows):
        at = {i: f for i, cell in enumerate(header) if (f := _band(cell)) is not None}
        if len(at) < _LEAST_BANDS or [*at.values()] != sorted(at.values()):
            continue
        around = [c for _, c in rows[:k] if not any(c[i] for i in at)]
        products = [row for row in rows if row[1] is not header and row[1] not in around]
        end = max(i for i, cell in enumerate(header) if cell) + 1
        turned = [(f"column {i + 1}", [c[i] for _, c in [rows[k], *products]]) for i in range(end)]
        _refuse_repeated_band(f"{sheet.place}, line {line}", turned, at)
        lines = [line, *(n for n, _ in products)]
        return _Upright(sheet.place, True, turned, at, lines, [*map(_joined, around)])
    named = [(f"line {line}", cells) for line, cells in rows]
    in_khz = any(
        "khz" in (name_and_unit(c[0])[1].lower(), c[0].strip(" []()").lower())
        for _, c in rows
        if frequency_of(c[0]) is None
    )
    factor = 1000.0 if in_khz else 1.0
    at = {i: f for i, (_, c) in enumerate(rows) if (f := _band(c[0], factor)) is not None}
    _refuse_repeated_band(sheet.place, named, at)
    first = min(at, default=0)
    titles = [_joined(c) for _, c in rows[:first] if not any(c[1:])]
    return _Upright(sheet.place, False, named, at, [rows[first][0]] * width, titles)


def _joined(cells: Sequence[str]) -> str:
    return " ".join(filter(None, cells))


def _band(cell: str, factor: float = 1.0) -> float | None:
    """Return the band that a cell names, with a ``factor`` to Hz where it has no unit."""
    cell = re.sub(rf"\s*[\[(]\s*(?:{_PERCENT}|-)\s*[\])]$", "", cell.strip(), flags=re.I)
    value = frequency_of(re.sub(r"^(alpha|α)\w*\s*", "", cell))
    if value is not None and not cell.lower().endswith(("k", "hz")):
        value *= factor
    return nearest_band(value) if value is not None and value >= LEAST_BAND else None


def _refuse_repeated_band(
    place: str, rows: Sequence[tuple[str, list[str]]], at: Mapping[int, float]
) -> None:
    first: dict[float, str] = {}
    for i, frequency in at.items():
        if first.setdefault(frequency, rows[i][0]) != rows[i][0]:
            raise DataError(
                f"{place}: {first[frequency]} and {rows[i][0]} are both {bands.label(frequency)}; "
                "a band has one coefficient per product"
            )


def _of_sheet(table: _Upright, otherwise: str) -> list[ListedMaterial]:
    """Return the materials of a sheet; ``otherwise`` is the name of one that has none."""
    if len(table.at) < _LEAST_BANDS:
        return []
    band_rows = [table.rows[i][1] for i in table.at]
    columns = [k for k in range(1, len(table.lines)) if any(row[k] for row in band_rows)]
    heads = {
        i: cells
        for i, (_, cells) in enumerate(table.rows)
        if i not in table.at and (table.across or any(cells[k] for k in columns))
    }
    left_out = [] if table.across else _below(table, heads, columns)
    unit_rows = [i for i, cells in heads.items() if _are_units(cells[0], _of(cells, columns))]
    names = _row_of_names(table, heads, unit_rows, columns)
    header = [""] * len(table.lines) if names is None else heads.pop(names)
    units = [heads.pop(i) for i in unit_rows if i in heads]
    of_units = [
        k
        for k in columns
        if (table.across or COLUMNS.get(plain(header[k])) == "unit")
        and _are_units(header[k], [row[k] for row in band_rows])
    ]
    shared = [row[k] for row in band_rows for k in of_units]
    shared += [row[0] for row in band_rows if re.search(_PERCENT, row[0])]
    columns = [k for k in columns if k not in of_units]
    titles = table.titles + [_joined(h) for h in heads.values() if not table.across]
    labels = [h[0] for h in [header, *heads.values()]] if table.across else header
    products = []
    for k in columns:
        cells = {f: row[k] for f, row in zip(table.at.values(), band_rows, strict=True)}
        values = {f: cell for f, cell in cells.items() if not is_missing(cell)}
        own = [(h[0], h[k]) for h in heads.values() if table.across and h[k]]
        quantities = [cell for label, cell in own if _is_quantity(label)]
        if not values or "beside" in map(_role, quantities):
            left_out += [", ".join([header[k], *quantities[:1]])] * bool(values or not table.across)
            continue
        is_only = not table.across and len(columns) == 1 and _role(header[k]) != "beside"
        name = otherwise if is_only else header[k]
        if not name or (not table.across and _unit(name) and not _role(name)):
            raise DataError(
                f"{table.place}, line {table.lines[k]}: coefficients without a product's name, or a "
                f'unit that is not known ("{shown(next(iter(values.values())))}"); known are % and -'
            )
        missing = [bands.label(f) for f in cells if f not in values]
        per_object = [cell for _, cell in own if _PER_OBJECT.search(_ends(cell))]
        notes = [f"no coefficient at {', '.join(missing)}"] if missing else []
        products.append(
            _Product(
                name=name,
                line=table.lines[k],
                values=values,
                units=[
                    header[k],
                    *quantities,
                    *per_object,
                    *filter(None, (u[k] for u in units)),
                    *shared,
                ],
                stated=[*titles, *(f"{label}: {cell}" for label, cell in own), *notes],
            )
        )
    products, others = _coefficients(table.place, products, otherwise)
    beside = [*labels, *titles]
    in_percent = any(
        _stated_unit(table.place, p, beside)[0] == "%" or "%" in "".join(p.values.values())
        for p in products
    )
    more = left_out + others
    materials = [_material(table.place, p, beside, more, in_percent) for p in products]
    if materials and all(material.doubt for material in materials):
        raise DataError(materials[0].doubt)
    return materials


def _of(cells: Sequence[str], columns: Iterable[int]) -> list[str]:
    return [cells[k] for k in columns if cells[k]]


def _are_units(label: str, cells: Sequence[str]) -> bool:
    """Return whether some cells are units of what ``label`` names, and nothing else."""
    cells = [*filter(None, cells)]
    if not cells or any(_unit(c) is None for c in cells) or all(map(str.isdecimal, cells)):
        return False
    # Dashes may be missing values, unless the label is no name.
    named = label and _unit(label) is None and COLUMNS.get(plain(label)) != "unit"
    return not (named and all(map(is_missing, cells)))


def _row_of_names(
    table: _Upright, heads: Mapping[int, list[str]], unit_rows: list[int], columns: Sequence[int]
) -> int | None:
    """Return the row with the products' names; DataError where it is open which that is."""
    if table.across:
        known = [i for i, cells in heads.items() if _NAMES.fullmatch(cells[0])]
        if not (rows := known or [*heads]):
            raise DataError(f"{table.place}: no column has the product's name")
        return rows[0]
    rows = []
    for i, cells in heads.items():
        name = name_and_unit(cells[0])[0]
        if not name or COLUMNS.get(plain(name)) == "band" or _NAMES.fullmatch(name):
            rows.append(i)
    named = [i for i in rows if i not in unit_rows]
    if not named and rows:  # as in "Frequency;αs (%)"
        of_symbols = all(_COEFFICIENT.fullmatch(c) for c in _of(heads[rows[0]], columns))
        named = rows[:1] if of_symbols or len(columns) == 1 else []
    if len(named) > 1 and len(_of(heads[named[0]], columns)) == len(columns) > 1:
        raise DataError(
            f'{table.place}, {table.rows[named[0]][0]}: "{shown(_of(heads[named[0]], columns)[0])}" '
            "stands in a second row of names; keep one, with units such as % or - in a row below it"
        )
    return named[-1] if named else None


def _below(table: _Upright, heads: dict[int, list[str]], columns: Sequence[int]) -> list[str]:
    """Take the rows below the first band that are of none from the heads, and return their labels.

    Raises DataError for a band that is typed wrong.
    """
    left_out = []
    for i, cells in [*heads.items()]:
        numbers = all(re.fullmatch(r"\d*[.,]?\d+\s*%?", c) for c in _of(cells, columns))
        digits = cells[0][:1].isdecimal()
        if i < min(table.at) and not (digits and numbers):
            continue
        if digits or not cells[0]:
            wrong = (
                f'"{shown(cells[0])}" is no band' if digits else "no band stands before the values"
            )
            raise DataError(
                f"{table.place}, {table.rows[i][0]}: {wrong}: write the centre frequency of an octave "
                "or a third in Hz, or delete the row"
            )
        left_out.append(heads.pop(i)[0])
    return left_out


def _is_quantity(header: str) -> bool:
    """Return whether a column says what a row's numbers are: their unit, or their symbol."""
    kinds = ("unit", "parameter", "statistic")
    return COLUMNS.get(plain(header), "") in kinds or bool(_QUANTITY.fullmatch(header.strip()))


def _role(name: str) -> str:
    """Return "coefficient", "beside" (a time, an uncertainty, a statistic), or "" for a product."""
    name = name.strip()
    if not name or len(name) > MAX_HEADER:
        return ""
    bare = _UNIT_BEHIND.sub("", name).strip()
    if _COEFFICIENT.fullmatch(bare):
        return "coefficient"
    is_time = plain(bare) in OPEN_DECAY_TIMES or parameters().get(plain(bare)) in of_kind(
        DecaySlope
    )
    if is_time or _BESIDE.fullmatch(name) or _BESIDE.fullmatch(bare):
        return "beside"
    return "" if statistic_of(bare) in (None, DOUBTFUL) else "beside"


def _coefficients(
    place: str, products: Sequence[_Product], otherwise: str
) -> tuple[list[_Product], list[str]]:
    """Return the products alone, and the names of what stands beside them.

    Raises DataError where it is open which rows or columns are coefficients.
    """
    of: dict[str, list[_Product]] = {"": [], "coefficient": [], "beside": []}
    behind = re.compile(rf"[\s_,:-]+{_ALPHA}\s*(?:[\[(].*)?$", re.I)
    names = {behind.sub("", p.name[:MAX_HEADER]).strip() for p in products}
    for product in products:
        role = _role(product.name)
        for name in (
            names - {product.name} if not role else ()
        ):  # as in "carpet U" beside "carpet αs"
            rest = product.name.replace(name, "", 1).strip(" _,:-") if name else ""
            role = "beside" if rest != product.name and _role(rest) == "beside" else role
        of[role].append(product)
    named, coefficients, others = of.values()
    if len(coefficients) == 1 and all(_SYMBOL.fullmatch(p.name) for p in named):
        (only,), others = coefficients, [*named, *others]
        named = [replace(only, name=otherwise, units=[*only.units, only.name])]
    elif coefficients or (others and not named):
        wrong = (coefficients[-1:] if not named else coefficients) or others
        raise DataError(
            f'{place}, line {wrong[0].line}: "{shown(wrong[0].name)}" names a coefficient, a time or a '
            "statistic and no product; write the product's name, or delete what is no coefficient"
        )
    return named, [p.name for p in others]


def _ends(text: str) -> str:
    """Return a text, or of a long one its begin and end, where units stand; patterns are slow else."""
    return text if len(text) <= 2 * MAX_HEADER else f"{text[:MAX_HEADER]} {text[-MAX_HEADER:]}"


def _unit(cell: str) -> str | None:
    """Return the unit that a cell is, of `_UNITS`; "" for αs alone, None for other text."""
    if len(cell) > MAX_HEADER:
        return None
    base, only = _UNIT_BEHIND.sub("", cell).strip(), cell.strip()
    only = only[len(base) :] if _COEFFICIENT.fullmatch(base) else only
    only = re.sub(r"^(in|en)\s+", "", only.strip().strip("[](){}/, "), flags=re.I)
    if not only and cell.strip():
        return ""
    return next((unit for unit, pattern in _UNITS.items() if pattern.fullmatch(only)), None)


def _unit_within(text: str, pattern: re.Pattern[str]) -> str:
    """Return the unit that a text is, or states as the pattern says; "" without one."""
    text = _ends(text)
    if (unit := _unit(text)) is not None:
        return unit
    if _PER_OBJECT.search(text):
        return "m²"
    found = pattern.search(text)
    return (_unit(found[1] or found[2]) or "") if found and found[0] != "(1)" else ""


def _stated_unit(place: str, product: _Product, beside: Sequence[str]) -> tuple[str, str]:
    """Return the unit of a product's numbers, "%" or "-", and why they are none; empty if not stated.

    ``beside`` are the texts of the whole table. Raises DataError for units that contradict each other.
    """
    place = f"{place}, line {product.line}: {shown(product.name)}"
    found = {_unit_within(text, _OF_COLUMN): text for text in reversed(product.units)}
    of_table = {_unit_within(text, _OF_TABLE): text for text in reversed(beside)}
    for unit, why in _ARE_NONE.items():
        if text := found.get(unit) or (of_table.get(unit) if unit != "other" else ""):
            return "", f'{place}: "{shown(text)}" {why}'
    both = found | {"%": of_table["%"]} if "%" in of_table else found
    if "-" in found and "%" in both:
        raise DataError(
            f'{place}: the unit is "{shown(found["-"])}" and also "{shown(both["%"])}"; state one'
        )
    return next((unit for unit in "%-" if unit in both), ""), ""


def _material(
    of_table: str,
    product: _Product,
    beside: Sequence[str],
    left_out: Sequence[str],
    in_percent: bool,
) -> ListedMaterial:
    """Return a product as a material; it has a doubt if its numbers are no coefficients.

    ``in_percent`` is whether others of the table are.
    """
    place = f"{of_table}, line {product.line}"
    unit, doubt = _stated_unit(of_table, product, beside)
    of_cells = ["%" in cell for cell in product.values.values()]
    if any(of_cells) and not all(of_cells) and unit != "%":
        raise DataError(
            f'{place}: "{shown(product.name)}" has cells with % and others without; write it '
            "in all or in none"
        )
    alpha, above = [], []
    for frequency, cell in product.values.items():
        where = f"{place}: {shown(product.name)} at {bands.label(frequency)}"
        text = cell.rstrip("% ")
        scale = 0.01 if unit == "%" or cell != text else 1.0
        value = scale * number(text.replace(",", ".") if text.count(",") == 1 else text, where)
        if not 0 <= value <= LARGEST and not doubt:
            raise DataError(
                f"{where}: {value:g} is not from 0 to {LARGEST:g}; name % with the coefficient if in "
                'percent, as in a line "alpha in %" above the header'
            )
        if value >= 1 and in_percent and not (unit or any(of_cells) or doubt):
            doubt = (
                f"{where}: {value:g} has no unit beside others in %; state it, as % or -, in the name "
                "of the product or in a column of units"
            )
        if value > 1:
            above.append(f"{value:.2f} at {bands.label(frequency)}")
        alpha.append(min(value, 1.0))
    source = "; ".join([place, *filter(None, product.stated)])
    elsewhere = next((t for t in beside if re.search(_PERCENT, t, re.I)), "")
    if elsewhere and not unit and not all(of_cells):
        source += f'; taken as fractions: "{shown(elsewhere, 60)}" is no unit of the coefficients'
    if above:
        source += f"; above 1 (edge effect), taken as 1: {', '.join(above)}"
    if left_out:
        named = [f'"{shown(n)}"' for n in dict.fromkeys(left_out)]
        source += f"; left out: {first_of(named, _MOST_LEFT_OUT)}"
    return ListedMaterial(
        name=product.name,
        line=product.line,
        alpha=tuple(alpha),
        centre_frequencies=tuple(product.values),
        spans=(),
        source=" ".join(source.split())[:1000],
        doubt=doubt,
    )
