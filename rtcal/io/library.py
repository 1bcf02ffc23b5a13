"""Product data (ISO 354) as a material list: a table (CSV, xlsx), or a folder of them.

Two shapes are read, with the cells of `rtcal.io.table_layout`:

- *bands across*: one row per product, with its name in the first column that holds text;
- *bands down*: one row per band and one column per product; a single column takes the file's name, or
  the sheet's.

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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
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
from rtcal.io.table_layout import Row, Sheet
from rtcal.io.tables import sheets_of
from rtcal.io.text import MAX_TEXT, Text, number, shown
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
    r"(mat[eé]ria\w*|produ[ck]?t\w*|prodotto|name|nom|nome|nombre|bezeichnung|artikel|d[eé]signation|"
    r"denominaci[oó]n|descri\w*|type|typ|tipo)\b.*",
    re.I,
)
_QUANTITIES = re.compile(
    r"(quantity|quantities|gr(ö|oe)(ß|ss)e|kenngr(ö|oe)(ß|ss)e|messgr(ö|oe)(ß|ss)e|symbol|grandeur|"
    r"magnitud|grandezza|grandeza|value|wert|valeur|valor|valore|kind|art)",
    re.I,
)
_ALPHA = r"(?:alpha|α)(?:[_ ]?(?:sabine|[spi])\b|[sp])?"
_PERCENT_WORD = r"(?:%|percent|per ?cento?|prozent|pour ?cent|por ?ciento|por ?cento|pct)"
_AREA_WORD = (
    r"(?:m\s*²|m\^?2|qm|sq\.?\s*m|square met(?:er|re)s?|ft\s*²|ft\^?2|sq\.?\s*ft|"
    r"(?:metric )?sabines?|sabins?)"
)
_OBJECT_WORD = (
    r"(?:A[_ ]?obj\w*|per object|pro (?:objekt|stück|platz|person|stuhl)|"
    r"(?:absorptions|absorber)fläche|"
    r"absorption areas?|areas? of absorption|aires? d.absorption|[aá]rea\w* de absor\w*|"
    r"are[ae] di assorbimento)"
)
_PER_OBJECT = re.compile(
    rf"{_OBJECT_WORD}|(?<!\d)(?<!\d\s){_AREA_WORD}\s*(?:/|\b(?:per|pro|je|par|por|a)\b)\s*[^\W\d]",
    re.I,
)
_PERCENT = re.compile(_PERCENT_WORD, re.I)
_IS_FRACTION = re.compile(
    r"[-\u2013\u2014]|1|fraction|dimensionless|dimensionslos|sans dimension", re.I
)
_IS_AREA = re.compile(
    rf"(?:A\s*(?:/|in)?\s*)?{_AREA_WORD}\W*(?:(?:/|\b(?:per|pro|je|par|por|a)\b).*)?|{_OBJECT_WORD}.*",
    re.I,
)
_IS_OTHER = re.compile(r"k?hz|m?s|sec|db|‰|per ?mille?|promille?|[x×·*]\s*100", re.I)
_TIMES_100 = re.compile(r"(?<!\d)(?<!\d\s)[x×·*]\s*100\b(?!\s*(?:[x×]|[cm]?m\b))", re.I)
_BEHIND = re.compile(r"[\[(]\s*([^\])]*?)\s*[\])]\s*$")
_UNIT = rf"(?:\b(?:in|en)\s+{_PERCENT_WORD}|[\[(]\s*{_PERCENT_WORD}\s*[\])])"
_OF_COLUMN = re.compile(rf"(?:{_UNIT}|(?<![\d\s])[\s,/]*{_PERCENT_WORD})\s*$", re.I)
_OF_COEFFICIENTS = re.compile(
    r"(?:(?:alpha|α|absor|assorb|coef|koef)[\w,.]*|\b(?:values|werte|angaben|valeurs|valores|valori))"
    rf"\s*[/,:]?\s*(?:{_UNIT}|{_PERCENT_WORD}\s*$)",
    re.I,
)
_AREAS_OF_COLUMN = re.compile(
    rf"\S.*?(?:[\[(]\s*({_AREA_WORD}[^\])]*)[\])]|(?:\s+in\s+|\s*/\s*)({_AREA_WORD}.*))\s*$", re.I
)
_AREAS_OF_COEFFICIENTS = re.compile(
    r"(?:(?:alpha|α|absorption|absor[cç]|assorb)\w*|\bA|\b(?:values|werte|angaben|valeurs|valores|valori))"
    rf"\s*(?:(?:in|en)\s+|/\s*|[\[(]\s*)({_AREA_WORD})(?!\w)\s*[\])]?(?!\s*[:=]\s*\d)",
    re.I,
)
_UNIT_BEHIND = re.compile(
    rf"\s*(?:[\[(][^\])]*[\])]|(?:/|\b(?:in|en)\b)\s*(?:{_PERCENT_WORD}|\S+)|%)\s*$", re.I
)
_COEFFICIENT = re.compile(
    rf"(?:(?:{_ALPHA}|s|p|of|de|d|di|do|l|sound|acoustic\w*|acústic\w*|acustic\w*|mean|(?:schall)?absorptions?"
    r"(?:grad|koeffizient)?|coefficients?|coefficiente|coefficienti|coeficientes?|absorción|absorcion|"
    r"absorção|assorbimento)(?:\W|_|$)+)+",
    re.I,
)
_NAMES_COEFFICIENT = re.compile(r"alpha|α|absor|assorb|coef|koef", re.I)
_PRACTICAL = re.compile(r"(?:alpha|α)[_ ]?p\b", re.I)
_TIME = re.compile(
    r"(?:T|RT|TR)[_ ]?(?:\d{1,2}|m|s)?\W*"
    r"(?:(?:empty|leer\w*|ohne|mit|with\w*|vide|avec|sans|sin|con|senza|"
    r"vacía|vuot\w|sem|com)\b.*)?|T\w{0,3}\s*[\[(]\s*(?:m?s|sec)\s*[\])]",
    re.I,
)
_UNCERTAINTY = re.compile(
    r"U(?:_?(?:α\w?|alpha\w*|c|95|\w))?\s*(?:[\[(,]?\s*k\s*=?.*)?|±.*|"
    r"(?:(?:expanded|standard|erweiterte|mess)?\W*(?:uncertainty|unsicherheit|messunsicherheit|incertitude|"
    r"incertidumbre|incertezza|incerteza)\b.*)|s_?R",
    re.I,
)
_IS_NUMBER = re.compile(r"\d*[.,]?\d+\s*%?")
_SYMBOL = re.compile(r"[AScVm]_?\w{0,3}", re.I)
_WITH_OTHER_UNIT = re.compile(r".*[\[(]\s*(?:m?s|sec|db|k?hz)\s*[\])]", re.I)


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
    folder = checks.path("path", path)
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
    sheets = sheets_of(content, os.fspath(file))
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


@dataclass(frozen=True, kw_only=True)
class _Product:
    """The cells of one row or column that has coefficients.

    ``name``, its ``line``, the cells by band in Hz (``values``), the texts that state its own unit
    (``units``), and what else is said of it (``stated``).
    """

    name: str
    line: int
    values: Mapping[float, str]
    units: Sequence[str]
    stated: Sequence[str]


@dataclass
class _Products:
    """The products of a sheet, with the names of its columns and the texts above them."""

    place: str
    header: Sequence[str]
    titles: Sequence[str]
    products: list[_Product] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    """The names of rows and columns of no product."""

    def add(
        self,
        name: str,
        line: int,
        cells: Mapping[float, str],
        units: Iterable[str],
        stated: Sequence[str] = (),
    ) -> None:
        """Add a product by its cells of every band; those that are missing are noted."""
        values = {f: cell for f, cell in cells.items() if not is_missing(cell)}
        lacking = [bands.label(f) for f in cells if f not in values]
        notes = [f"no coefficient at {', '.join(lacking)}"] if lacking else []
        self.products.append(
            _Product(
                name=name,
                line=line,
                values=values,
                units=[*filter(None, units)],
                stated=[*self.titles, *stated, *notes],
            )
        )


def _of_sheet(sheet: Sheet, otherwise: str) -> Iterator[ListedMaterial]:
    """Yield the materials of a sheet; ``otherwise`` is the name of one that has none."""
    width = max(len(cells) for _, cells in sheet.rows)
    rows = [(line, cells + [""] * (width - len(cells))) for line, cells in sheet.rows]
    for at, (line, cells) in enumerate(rows):
        at_bands = {k: f for k, c in enumerate(cells) if (f := _band(c)) is not None}
        if len(at_bands) >= _LEAST_BANDS and list(at_bands.values()) == sorted(at_bands.values()):
            stated = [(f"column {k + 1}", f) for k, f in at_bands.items()]
            _refuse_repeated_band(f"{sheet.place}, line {line}", stated)
            found = _across(sheet.place, rows, at, at_bands)
            break
    else:
        found = _down(sheet.place, rows, otherwise)
    _keep_coefficients(found, otherwise)
    in_percent = any(
        _stated_unit(p, found)[0] == "%" or any("%" in cell for cell in p.values.values())
        for p in found.products
    )
    materials = [_material(product, found, beside_percent=in_percent) for product in found.products]
    doubts = [material.doubt for material in materials if material.doubt]
    if doubts and len(doubts) == len(materials):
        raise DataError(doubts[0])
    yield from materials


def _refuse_repeated_band(place: str, stated: Sequence[tuple[str, float]]) -> None:
    """Raise DataError if two columns or lines are of one band."""
    first: dict[float, str] = {}
    for where, frequency in stated:
        if first.setdefault(frequency, where) != where:
            raise DataError(
                f"{place}: {first[frequency]} and {where} are both {bands.label(frequency)}; "
                "a band has one coefficient per product"
            )


def _band(cell: str, factor: float = 1.0) -> float | None:
    """Return the band that a cell names, with a ``factor`` to Hz where it has no unit."""
    cell = re.sub(rf"\s*[\[(]\s*(?:{_PERCENT_WORD}|-)\s*[\])]$", "", cell.strip(), flags=re.I)
    value = frequency_of(re.sub(r"^(alpha|α)\w*\s*", "", cell))
    if value is not None and not cell.lower().endswith(("k", "hz")):
        value *= factor
    return nearest_band(value) if value is not None and value >= LEAST_BAND else None


def _filled(cells: Sequence[str], columns: Iterable[int]) -> list[str]:
    return [cells[k] for k in columns if cells[k]]


def _across(place: str, rows: list[Row], at: int, at_bands: dict[int, float]) -> _Products:
    """Return the products of a table of bands across, whose header is row ``at``."""
    line, header = rows[at]
    end = max(k for k, name in enumerate(header) if name) + 1
    texts = [k for k in range(end) if k not in at_bands]
    names = [k for k in texts if _NAMES.fullmatch(header[k])] or texts[:1]
    if not names:
        raise DataError(f"{place}, line {line}: no column has the product's name")
    units, others = [], []
    for n, cells in rows[:at]:
        if _are_units(cells, at_bands):
            units.append(cells)
            continue
        others.append((n, cells))
        repeated = {cells[k] for k in at_bands}
        if len(repeated) == 1 and any(repeated):
            raise DataError(
                f'{place}, line {n}: "{shown(repeated.pop())}" is no known unit; they are % and -'
            )
    found = _Products(place, header, _titles(others))
    _refuse_objects(place, [*header, *found.titles])
    below = rows[at + 1 :]
    while below and _are_units(below[0][1], at_bands):
        units.append(below.pop(0)[1])
    of_bands = [unit for row in [*units, header] for unit in _filled(row, at_bands)]
    for line, cells in below:
        values = {f: cells[k] for k, f in at_bands.items()}
        if all(map(is_missing, values.values())):
            continue
        if not (name := cells[names[0]]):
            raise DataError(f"{place}, line {line}: coefficients without a product's name")
        stated = [(header[k], cells[k]) for k in texts if k != names[0] and cells[k]]
        quantities = [cell for h, cell in stated if _is_quantity(h)]
        if any(_role(cell) in ("time", "uncertainty") for cell in quantities):
            found.left_out.append(f"{name}, {quantities[0]}")
            continue
        own = [c for h, c in stated if _is_quantity(h) or _PER_OBJECT.search(_ends(c))]
        found.add(name, line, values, [name, *own, *of_bands], [f"{h}: {c}" for h, c in stated])
    return found


def _is_quantity(header: str) -> bool:
    """Return whether a column says what a row's numbers are: their unit, or their symbol."""
    kind = COLUMNS.get(plain(header), "")
    return kind in ("unit", "parameter", "statistic") or bool(_QUANTITIES.fullmatch(header.strip()))


def _are_units(cells: Sequence[str], columns: Iterable[int]) -> bool:
    """Return whether a row states the units of some columns, and nothing else of them."""
    of_columns = _filled(cells, columns)
    if not of_columns or any(_unit(cell) is None for cell in of_columns):
        return False
    if all(cell.isdecimal() for cell in of_columns):
        return False  # values
    # Dashes may be missing values, unless the first cell is no name.
    named = cells[0] and _unit(cells[0]) is None and COLUMNS.get(plain(cells[0])) != "unit"
    return not (named and all(map(is_missing, of_columns)))


def _down(place: str, rows: list[Row], otherwise: str) -> _Products:
    """Return the products of a table of bands down."""
    in_khz = any(
        name_and_unit(c[0])[1].lower() == "khz" or c[0].strip(" []()").lower() == "khz"
        for _, c in rows
        if c[0] and frequency_of(c[0]) is None
    )
    factor = 1000.0 if in_khz else 1.0
    at_bands = {i: f for i, (_, c) in enumerate(rows) if (f := _band(c[0], factor)) is not None}
    if len(at_bands) < _LEAST_BANDS:
        return _Products(place, [], [])
    _refuse_repeated_band(place, [(f"line {rows[i][0]}", f) for i, f in at_bands.items()])
    first = min(at_bands)
    columns = [k for k in range(1, len(rows[0][1])) if any(rows[i][1][k] for i in at_bands)]
    unit_rows, header_row = [], -1
    for i in range(first - 1, -1, -1):
        cells = rows[i][1]
        if not any(cells[1:]):
            continue
        are_units = _are_units(cells, columns)
        of_symbols = all(_COEFFICIENT.fullmatch(c) or not c for c in cells[1:])
        named = header_row >= 0 or (i > 0 and _is_header(rows[i - 1][1], columns))
        if are_units and (named or not of_symbols):
            unit_rows.append(i)
        elif header_row < 0 and _is_header(cells, columns):
            header_row = i
        else:
            _refuse_second_header(f"{place}, line {rows[i][0]}", cells, columns)
    if header_row < 0 and unit_rows and len(columns) == 1:
        header_row = unit_rows.pop(0)  # as in "Frequency;αs (%)"
    header = rows[header_row][1] if header_row >= 0 else [""] * len(rows[0][1])
    others = [rows[i] for i in range(first) if i != header_row and i not in unit_rows]
    found = _Products(place, header if header_row >= 0 else [], _titles(others))
    _refuse_objects(place, found.titles)
    found.left_out += _not_of_bands(place, rows, at_bands, columns, "kHz" if in_khz else "Hz")
    of_units = [k for k in columns if COLUMNS.get(plain(header[k])) == "unit"]
    stated_units = dict.fromkeys(rows[i][1][k] for k in of_units for i in at_bands)
    columns = [k for k in columns if k not in of_units]
    for k in columns:
        name = header[k]
        if len(columns) == 1 and _role(name) in ("", "coefficient", "statistic"):
            name = otherwise
        if not name or (len(columns) > 1 and _unit(name) and not _role(name)):
            line = rows[max(first - 1, 0)][0]
            raise DataError(f"{place}, line {line}: column {k + 1} has no product's name")
        values = {f: rows[i][1][k] for i, f in at_bands.items()}
        if all(map(is_missing, values.values())):
            found.left_out.append(name)
            continue
        units = [header[k], *(rows[i][1][k] for i in unit_rows), *stated_units]
        found.add(name, rows[first][0], values, units)
    return found


def _is_header(cells: Sequence[str], columns: Sequence[int]) -> bool:
    """Return whether a row names all columns: its first cell is empty or says that bands are below."""
    name = name_and_unit(cells[0])[0]
    of_bands = not cells[0] or COLUMNS.get(plain(name)) == "band" or _NAMES.fullmatch(name)
    return bool(of_bands and _filled(cells, columns))


def _refuse_second_header(place: str, cells: Sequence[str], columns: Sequence[int]) -> None:
    """Raise DataError for a row of names above a header: one of both may state units."""
    of_columns = _filled(cells, columns)
    of_bands = cells[0] and (COLUMNS.get(plain(cells[0])) == "band" or _unit(cells[0]) == "other")
    if len(of_columns) == len(columns) and (of_bands or (not cells[0] and len(columns) > 1)):
        raise DataError(
            f'{place}: "{shown(of_columns[0])}" stands in a second row of names; keep one, with units '
            "such as % or - in a row below it"
        )


def _not_of_bands(
    place: str, rows: list[Row], at_bands: Mapping[int, float], columns: Sequence[int], unit: str
) -> list[str]:
    """Return the names of rows below the first band that are of none.

    Raises DataError for a band that is typed wrong.
    """
    left_out = []
    for i, (line, cells) in enumerate(rows):
        of_columns, digits = _filled(cells, columns), cells[0][:1].isdecimal()
        if i in at_bands or not of_columns:
            continue
        if i < min(at_bands) and not (digits and all(map(_IS_NUMBER.fullmatch, of_columns))):
            continue
        if digits or not cells[0]:
            wrong = (
                f'"{shown(cells[0])}" is no band' if digits else "no band stands before the values"
            )
            raise DataError(
                f"{place}, line {line}: {wrong}: write the centre frequency of an octave or a third in "
                f"{unit}, or delete the row"
            )
        left_out.append(cells[0])
    return left_out


def _role(name: str) -> str:
    """Return what a row or column is called after, if after no product.

    It is "coefficient", "time", "uncertainty", "statistic" or "practical" (alpha_p of ISO 11654); empty
    for a product's name.
    """
    name = name.strip()
    if not name or len(name) > MAX_HEADER:
        return ""
    if _PRACTICAL.match(name) and _COEFFICIENT.fullmatch(_without_unit(name)):
        return "practical"
    if _COEFFICIENT.fullmatch(_without_unit(name)) and _NAMES_COEFFICIENT.search(name):
        return "coefficient"
    if _UNCERTAINTY.fullmatch(name) or _UNCERTAINTY.fullmatch(_without_unit(name)):
        return "uncertainty"
    if (
        _TIME.fullmatch(name)
        or _TIME.fullmatch(_without_unit(name))
        or plain(_without_unit(name)) in OPEN_DECAY_TIMES
        or parameters().get(plain(_without_unit(name))) in of_kind(DecaySlope)
        or _WITH_OTHER_UNIT.fullmatch(name)
    ):
        return "time"
    return "" if statistic_of(_without_unit(name)) in (None, DOUBTFUL) else "statistic"


def _without_unit(name: str) -> str:
    return _UNIT_BEHIND.sub("", name).strip()


def _keep_coefficients(found: _Products, otherwise: str) -> None:
    """Keep the products alone; what stands beside them is left out.

    Raises DataError where it is open which rows or columns are coefficients.
    """
    place, products = found.place, found.products
    roles = [_role(p.name) for p in products]
    for i, product in enumerate(products):  # as in "carpet αs", "carpet U", "carpet T1"
        for other in filter(None, (_product_of(p.name) for p in products)):
            rest = product.name.replace(other, "", 1).strip(" _,:-")
            beside = rest != product.name and _role(rest) in ("time", "uncertainty", "statistic")
            roles[i] = roles[i] or ("uncertainty" if beside else "")
    if "coefficient" not in roles:
        roles = ["coefficient" if r == "practical" else r for r in roles]
    of = {role: [p for p, r in zip(products, roles, strict=True) if r == role] for role in roles}
    named, coefficients = of.get("", []), of.get("coefficient", [])
    others = [p for p, r in zip(products, roles, strict=True) if r not in ("", "coefficient")]
    if coefficients:
        symbols = [
            p for p in named if _SYMBOL.fullmatch(p.name) or _WITH_OTHER_UNIT.fullmatch(p.name)
        ]
        if others and named and len(symbols) == len(named):
            others, named = [*named, *others], []
        if named or len(coefficients) > 1:
            which = coefficients[0].name if named else coefficients[1].name
            raise DataError(
                f'{place}, line {coefficients[0].line}: "{shown(which)}" names a coefficient and no '
                "product; write the product's name instead"
            )
        only = coefficients[0]
        named = [replace(only, name=otherwise, units=[*only.units, only.name])]
    elif times := of.get("time", []):
        raise DataError(
            f'{place}, line {times[0].line}: "{shown(times[0].name)}" is called as a reverberation '
            "time is, and no coefficient; delete it, or name the product otherwise"
        )
    elif not named and (of.get("uncertainty") or len(others) > 1):
        raise DataError(
            f'{place}, line {others[0].line}: "{shown(others[0].name)}" is no product, and nothing '
            'beside it is a coefficient; name one, as "alpha_s" or by its product'
        )
    elif not named:
        named, others = [replace(p, name=otherwise) for p in others], []
    found.products = named
    found.left_out += [p.name for p in others]


def _product_of(name: str) -> str:
    """Return a name without the coefficient that it ends with, as in "carpet αs"."""
    if len(name) > MAX_HEADER:
        return name
    return re.sub(rf"[\s_,:-]+{_ALPHA}\s*(?:[\[(].*)?$", "", name, flags=re.I).strip()


def _ends(text: str) -> str:
    """Return a text, or of a long one its begin and end, where units stand; patterns are slow else."""
    return text if len(text) <= 2 * MAX_HEADER else f"{text[:MAX_HEADER]} {text[-MAX_HEADER:]}"


def _unit(cell: str) -> str | None:
    """Return the unit that a cell is: "%", "-", "m²", "other"; "" for αs alone, None for other text."""
    if len(cell) > MAX_HEADER:
        return None
    base, only = _without_unit(cell), cell.strip()
    if _COEFFICIENT.fullmatch(base) and _NAMES_COEFFICIENT.search(base):
        only = only[len(base) :]
    only = re.sub(r"^(in|en)\s+", "", only.strip().strip("[](){}/, "), flags=re.I)
    for unit, pattern in (
        ("%", _PERCENT),
        ("-", _IS_FRACTION),
        ("m²", _IS_AREA),
        ("other", _IS_OTHER),
    ):
        if pattern.fullmatch(only):
            return unit
    return "" if not only and cell.strip() else None


def _refuse_objects(place: str, texts: Sequence[str]) -> None:
    """Raise DataError for absorption areas in m² of objects (ISO 354, Sect. 8.1.3)."""
    for text in map(_ends, texts):
        if _PER_OBJECT.search(text) or _AREAS_OF_COEFFICIENTS.search(text):
            raise DataError(f'{place}: "{shown(text)}" names {_ARE_AREAS}')


_ARE_AREAS = (
    "absorption areas in m², and no coefficients: multiply one by the number of objects, and divide by "
    "the area that is stated for them"
)


def _stated_unit(product: _Product, beside: _Products) -> tuple[str, str]:
    """Return the unit of a product's numbers, "%" or "-", and why they are none; empty if not stated.

    Raises DataError for two units that contradict each other.
    """
    place = f"{beside.place}, line {product.line}: {shown(product.name)}"
    found: dict[str, str] = {}
    for text in map(_ends, product.units):
        unit = _unit(text) or ""
        if not unit:
            behind = _BEHIND.search(text)
            of_text = _unit(behind[1]) if behind and behind[1] != "1" else ""
            if _TIMES_100.search(text):
                unit = "other"
            elif _OF_COLUMN.search(text):
                unit = "%"
            elif _PER_OBJECT.search(text) or _AREAS_OF_COLUMN.fullmatch(text):
                unit = "m²"
            elif of_text in ("-", "other"):
                unit = of_text
        if unit:
            found.setdefault(unit, text)
    if area := found.get("m²"):
        return "", f'{place}: "{shown(area)}" names {_ARE_AREAS}'
    titles = [*map(_ends, beside.titles)]
    of_texts = [*map(_ends, beside.header), *titles]
    if other := found.get("other") or next(filter(_TIMES_100.search, titles), ""):
        return "", f'{place}: "{shown(other)}" is no unit of coefficients; they have % or none'
    of_table = any(map(_OF_COEFFICIENTS.search, of_texts)) or "%" in map(_unit, beside.titles)
    if "-" in found and ("%" in found or of_table):
        with_percent = found.get("%") or next(filter(_PERCENT.search, of_texts))
        raise DataError(
            f'{place}: the unit is "{shown(found["-"])}" and also "{shown(with_percent)}"; state one'
        )
    return "%" if "%" in found or of_table else "-" if "-" in found else "", ""


def _titles(rows: Sequence[Row]) -> list[str]:
    return [" ".join(filter(None, cells)) for _, cells in rows]


def _material(product: _Product, beside: _Products, *, beside_percent: bool) -> ListedMaterial:
    """Return a product as a material; it has a doubt if its numbers are no coefficients."""
    place = f"{beside.place}, line {product.line}"
    unit, doubt = _stated_unit(product, beside)
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
        if value >= 1 and beside_percent and not (unit or any(of_cells) or doubt):
            doubt = (
                f"{where}: {value:g} has no unit beside others in %; state it, as % or -, in the name "
                "of the product or in a column of units"
            )
        if value > 1:
            above.append(f"{value:.2f} at {bands.label(frequency)}")
        alpha.append(min(value, 1.0))
    source = "; ".join([place, *filter(None, product.stated)])
    elsewhere = next(filter(_PERCENT.search, [*beside.header, *beside.titles]), "")
    if elsewhere and not unit and not all(of_cells):
        source += f'; taken as fractions: "{shown(elsewhere, 60)}" is no unit of the coefficients'
    if above:
        source += f"; above 1 (edge effect), taken as 1: {', '.join(above)}"
    if beside.left_out:
        named = [f'"{shown(n)}"' for n in dict.fromkeys(beside.left_out)]
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
