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
from dataclasses import dataclass, replace
from pathlib import Path

from rtcal.acoustics import bands
from rtcal.acoustics.observables import DecaySlope, of_kind
from rtcal.files.disk import read_bytes
from rtcal.io import workbook
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
from rtcal.io.table_layout import Row, Sheet, sheet_of_text
from rtcal.io.text import MAX_TEXT, Text, decode, number, shown
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
_IS_PERCENT = re.compile(_PERCENT_WORD, re.I)
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
    if workbook.claims(content):
        sheets = workbook.sheets(content, os.fspath(file), {})
    else:
        text = decode(content, os.fspath(file))
        sheets = [sheet_of_text(text, os.fspath(file))]
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
            products, left_out = _across(sheet, at, at_bands, otherwise)
            break
    else:
        products, left_out = _down(sheet, otherwise)
    in_percent = [_stated_unit(p, sheet.place)[0] == "%" for p in products]
    in_percent += [any("%" in cell for cell in p.values.values()) for p in products]
    materials = [
        _material(sheet.place, product, left_out, beside_percent=any(in_percent))
        for product in products
    ]
    doubts = [material.doubt for material in materials if material.doubt]
    if doubts and len(doubts) == len(materials):
        raise DataError(doubts[0])
    yield from materials


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


def _band(cell: str, factor: float = 1.0) -> float | None:
    """Return the band that a cell names, with a ``factor`` to Hz where it has no unit."""
    cell = re.sub(rf"\s*[\[(]\s*(?:{_PERCENT_WORD}|-)\s*[\])]$", "", cell.strip(), flags=re.I)
    value = frequency_of(re.sub(r"^(alpha|α)\w*\s*", "", cell))
    if value is not None and not cell.lower().endswith(("k", "hz")):
        value *= factor
    return nearest_band(value) if value is not None and value >= LEAST_BAND else None


@dataclass(frozen=True, kw_only=True)
class _Product:
    """The cells of one row or column that has coefficients.

    ``name``, its ``line``, the cells by band in Hz (``values``), what else its row says (``stated``),
    and the texts that state its own unit (``units``).
    """

    name: str
    line: int
    values: Mapping[float, str]
    stated: Sequence[str]
    units: Sequence[str]
    titles: Sequence[str]
    headers: Sequence[str]


def _across(
    sheet: Sheet, at: int, at_bands: dict[int, float], otherwise: str
) -> tuple[list[_Product], list[str]]:
    """Return the products of a table of bands across, and the names of rows that are left out."""
    header = sheet.rows[at][1]
    texts = [k for k in range(len(header)) if k not in at_bands]
    names = [k for k in texts if _NAMES.fullmatch(header[k])] or texts[:1]
    if not names:
        raise DataError(
            f"{sheet.place}, line {sheet.rows[at][0]}: no column has the product's name"
        )
    above = [i for i in range(at) if _are_units(sheet.rows[i][1], at_bands)]
    for line, cells in (row for i, row in enumerate(sheet.rows[:at]) if i not in above):
        repeated = {cells[k] for k in at_bands if k < len(cells)}
        if len(repeated) == 1 and any(repeated):
            raise DataError(
                f'{sheet.place}, line {line}: "{shown(repeated.pop())}" is no known unit; '
                "they are % and -"
            )
    titles = _titles([row for i, row in enumerate(sheet.rows[:at]) if i not in above])
    _refuse_objects(sheet, [*header, *titles])
    units = [sheet.rows[i][1] for i in above]
    below = list(sheet.rows[at + 1 :])
    while below and _are_units(below[0][1], at_bands):
        units.append(below.pop(0)[1])
    of_bands = [row[k] for row in units for k in at_bands if k < len(row) and row[k]]
    of_bands += [header[k] for k in at_bands]
    products, left_out = [], []
    for line, cells in below:
        name = cells[names[0]] if len(cells) > names[0] else ""
        values = {
            f: cells[k] for k, f in at_bands.items() if k < len(cells) and not is_missing(cells[k])
        }
        if not values:
            continue
        if not name:
            raise DataError(f"{sheet.place}, line {line}: coefficients without a product's name")
        others = [
            (header[k], cells[k]) for k in texts if k != names[0] and k < len(cells) and cells[k]
        ]
        if any(_is_quantity(h) and _role(c) in ("time", "uncertainty") for h, c in others):
            left_out.append(f"{name}, {next(c for h, c in others if _is_quantity(h))}")
            continue
        stated = [f"{h}: {c}" for h, c in others]
        stated += _lacking(at_bands.values(), values)
        own = [c for h, c in others if _is_quantity(h) or _PER_OBJECT.search(_ends(c))]
        products.append(
            _Product(
                name=name,
                line=line,
                values=values,
                stated=[*titles, *stated],
                units=[name, *own, *of_bands],
                titles=titles,
                headers=header,
            )
        )
    chosen, unused = _with_coefficients(sheet.place, products, otherwise)
    return chosen, [*left_out, *unused]


def _is_quantity(header: str) -> bool:
    """Return whether a column says what a row's numbers are: their unit, or their symbol."""
    kind = COLUMNS.get(plain(header), "")
    return kind in ("unit", "parameter", "statistic") or bool(_QUANTITIES.fullmatch(header.strip()))


def _are_units(cells: Sequence[str], columns: Iterable[int]) -> bool:
    """Return whether a row states the units of some columns, and nothing else of them."""
    of_columns = [cells[k] for k in columns if k < len(cells) and cells[k]]
    if not of_columns or any(_unit(cell) is None for cell in of_columns):
        return False
    if all(cell.isdecimal() for cell in of_columns):
        return False  # values
    # Dashes may be missing values, unless the first cell is no name.
    named = cells[0] and _unit(cells[0]) is None and COLUMNS.get(plain(cells[0])) != "unit"
    return not (named and all(map(is_missing, of_columns)))


def _down(sheet: Sheet, otherwise: str) -> tuple[list[_Product], list[str]]:
    """Return the products of a table of bands down, and the names of columns that are left out."""
    in_khz = any(
        name_and_unit(c[0])[1].lower() == "khz" or c[0].strip(" []()").lower() == "khz"
        for _, c in sheet.rows
        if c and c[0] and frequency_of(c[0]) is None
    )
    factor = 1000.0 if in_khz else 1.0
    rows = [(i, f) for i, (_, c) in enumerate(sheet.rows) if (f := _band(c[0], factor)) is not None]
    if len(rows) < _LEAST_BANDS:
        return [], []
    _refuse_repeated_band(sheet.place, [(f"line {sheet.rows[i][0]}", f) for i, f in rows])
    first = rows[0][0]
    width = max(len(sheet.rows[i][1]) for i, _ in rows)
    columns = [
        k
        for k in range(1, width)
        if any(len(sheet.rows[i][1]) > k and sheet.rows[i][1][k] for i, _ in rows)
    ]
    unit_rows, header_row = [], -1
    for i in range(first - 1, -1, -1):
        cells = sheet.rows[i][1]
        if not any(cells[1:]):
            continue
        plain_units = _are_units(cells, columns) and not all(
            _COEFFICIENT.fullmatch(c) or not c for c in cells[1:]
        )
        named = header_row >= 0 or _is_header(sheet, i - 1, columns)
        if plain_units or (_are_units(cells, columns) and named):
            unit_rows.append(i)
        elif header_row < 0 and _is_header(sheet, i, columns):
            header_row = i
        else:
            _refuse_second_header(sheet, i, columns)
    if header_row < 0 and unit_rows and len(columns) == 1:
        header_row = unit_rows.pop(0)  # as in "Frequency;αs (%)"
    header = sheet.rows[header_row][1] if header_row >= 0 else []
    titles = _titles(
        [row for i, row in enumerate(sheet.rows[:first]) if i != header_row and i not in unit_rows]
    )
    _refuse_objects(sheet, titles)
    left_out = _not_of_bands(sheet, rows, columns, factor)
    unit_columns = [
        k for k in columns if k < len(header) and COLUMNS.get(plain(header[k])) == "unit"
    ]
    stated_units = dict.fromkeys(
        sheet.rows[i][1][k] for k in unit_columns for i, _ in rows if len(sheet.rows[i][1]) > k
    )
    columns = [k for k in columns if k not in unit_columns]
    products = []
    for k in columns:
        name = header[k] if len(header) > k else ""
        if len(columns) == 1 and _role(name) in ("", "coefficient", "statistic"):
            units = [name]
            name = otherwise
        else:
            units = [name]
        if not name or (len(columns) > 1 and _unit(name) and not _role(name)):
            place = f"{sheet.place}, line {sheet.rows[max(first - 1, 0)][0]}"
            raise DataError(f"{place}: column {k + 1} has no product's name")
        values = {
            f: sheet.rows[i][1][k]
            for i, f in rows
            if len(sheet.rows[i][1]) > k and not is_missing(sheet.rows[i][1][k])
        }
        if not values:
            left_out.append(name)
            continue
        units += [
            sheet.rows[i][1][k]
            for i in unit_rows
            if len(sheet.rows[i][1]) > k and sheet.rows[i][1][k]
        ]
        products.append(
            _Product(
                name=name,
                line=sheet.rows[first][0],
                values=values,
                stated=[*titles, *_lacking((f for _, f in rows), values)],
                units=[*units, *filter(None, stated_units)],
                titles=titles,
                headers=header,
            )
        )
    chosen, unused = _with_coefficients(sheet.place, products, otherwise)
    return chosen, [*left_out, *unused]


def _is_header(sheet: Sheet, at: int, columns: Sequence[int]) -> bool:
    """Return whether a row names all columns: its first cell is empty or says that bands are below."""
    if at < 0:
        return False
    cells = sheet.rows[at][1]
    name = name_and_unit(cells[0])[0]
    of_bands = not cells[0] or COLUMNS.get(plain(name)) == "band" or _NAMES.fullmatch(name)
    return bool(of_bands) and any(k < len(cells) and cells[k] for k in columns)


def _refuse_second_header(sheet: Sheet, at: int, columns: Sequence[int]) -> None:
    """Raise DataError for a row of names above a header: one of both may state units."""
    line, cells = sheet.rows[at]
    of_columns = [cells[k] for k in columns if k < len(cells) and cells[k]]
    of_bands = cells[0] and (COLUMNS.get(plain(cells[0])) == "band" or _unit(cells[0]) == "other")
    if len(of_columns) == len(columns) and (of_bands or (not cells[0] and len(columns) > 1)):
        raise DataError(
            f'{sheet.place}, line {line}: "{shown(of_columns[0])}" stands in a second row of '
            "names; keep one, with units such as % or - in a row below it"
        )


def _not_of_bands(
    sheet: Sheet, rows: Sequence[tuple[int, float]], columns: Sequence[int], factor: float
) -> list[str]:
    """Return the names of rows below the first band that are of none.

    Raises DataError for a band that is typed wrong.
    """
    left_out = []
    bands_at = {i for i, _ in rows}
    for i, (line, cells) in enumerate(sheet.rows):
        if i in bands_at or not any(k < len(cells) and cells[k] for k in columns):
            continue
        if i < rows[0][0] and not (
            cells[0][:1].isdecimal()
            and all(_IS_NUMBER.fullmatch(cells[k]) for k in columns if k < len(cells))
        ):
            continue
        if not cells[0] or cells[0][0].isdecimal():
            said = (
                f'"{shown(cells[0])}" is no band'
                if cells[0]
                else "no band stands before the values"
            )
            raise DataError(
                f"{sheet.place}, line {line}: {said}: write the centre frequency of an octave or a "
                f"third in {'kHz' if factor > 1 else 'Hz'}, or delete the row"
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


def _with_coefficients(
    place: str, products: Sequence[_Product], otherwise: str
) -> tuple[list[_Product], list[str]]:
    """Return the products alone, and the names of what stands beside them.

    Raises DataError where it is open which rows or columns are coefficients.
    """
    roles = [_role(p.name) for p in products]
    names = [_product_of(p.name) for p in products]
    for i, product in enumerate(products):  # as in "carpet αs", "carpet U", "carpet T1"
        for other in names:
            rest = product.name.replace(other, "", 1).strip(" _,:-") if other else ""
            if (
                not roles[i]
                and rest != product.name
                and _role(rest) in ("time", "uncertainty", "statistic")
            ):
                roles[i] = "uncertainty"
    if "coefficient" not in roles:
        roles = ["coefficient" if r == "practical" else r for r in roles]
    of = {role: [p for p, r in zip(products, roles, strict=True) if r == role] for role in roles}
    named, coefficients = of.get("", []), of.get("coefficient", [])
    others = [p for p, r in zip(products, roles, strict=True) if r not in ("", "coefficient")]
    if coefficients:
        if (
            others
            and named
            and all(_SYMBOL.fullmatch(p.name) or _WITH_OTHER_UNIT.fullmatch(p.name) for p in named)
        ):
            others, named = [*named, *others], []
        if named or len(coefficients) > 1:
            which = coefficients[0].name if named else coefficients[1].name
            raise DataError(
                f'{place}, line {coefficients[0].line}: "{shown(which)}" names a coefficient and no '
                "product; write the product's name instead"
            )
        only = coefficients[0]
        return [replace(only, name=otherwise, units=[*only.units, only.name])], [
            p.name for p in others
        ]
    if times := of.get("time", []):
        raise DataError(
            f'{place}, line {times[0].line}: "{shown(times[0].name)}" is called as a reverberation '
            "time is, and no coefficient; delete it, or name the product otherwise"
        )
    if not named and (of.get("uncertainty") or len(others) > 1):
        raise DataError(
            f'{place}, line {others[0].line}: "{shown(others[0].name)}" is no product, and nothing '
            'beside it is a coefficient; name one, as "alpha_s" or by its product'
        )
    if not named:
        return [replace(p, name=otherwise) for p in others], []
    return named, [p.name for p in others]


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
        ("%", _IS_PERCENT),
        ("-", _IS_FRACTION),
        ("m²", _IS_AREA),
        ("other", _IS_OTHER),
    ):
        if pattern.fullmatch(only):
            return unit
    return "" if not only and cell.strip() else None


def _refuse_objects(sheet: Sheet, texts: Sequence[str]) -> None:
    """Raise DataError for absorption areas in m² of objects (ISO 354, Sect. 8.1.3)."""
    for text in map(_ends, texts):
        if _PER_OBJECT.search(text) or _AREAS_OF_COEFFICIENTS.search(text):
            raise DataError(f'{sheet.place}: "{shown(text)}" names {_ARE_AREAS}')


_ARE_AREAS = (
    "absorption areas in m², and no coefficients: multiply one by the number of objects, and divide by "
    "the area that is stated for them"
)


def _stated_unit(product: _Product, place: str) -> tuple[str, str]:
    """Return the unit of a product's numbers, "%" or "-", and why they are none; empty if not stated.

    Raises DataError for two units that contradict each other.
    """
    found: dict[str, str] = {}
    for text in map(_ends, product.units):
        unit = _unit(text)
        if unit is None or unit == "":
            unit = "%" if _OF_COLUMN.search(text) else "m²" if _names_area(text) else ""
            behind = _BEHIND.search(text)
            if not unit and behind and _unit(behind[1]) in ("-", "other") and behind[1] != "1":
                unit = _unit(behind[1]) or ""
            unit = "other" if _TIMES_100.search(text) else unit
        if unit:
            found.setdefault(unit, text)
    if area := found.get("m²"):
        return "", f'{place}: "{shown(area)}" names {_ARE_AREAS}'
    other = found.get("other") or next(filter(_TIMES_100.search, map(_ends, product.titles)), "")
    if other:
        return "", f'{place}: "{shown(other)}" is no unit of coefficients; they have % or none'
    of_texts = [*map(_ends, product.headers), *map(_ends, product.titles)]
    of_table = any(map(_OF_COEFFICIENTS.search, of_texts)) or any(
        _unit(t) == "%" for t in product.titles
    )
    if "-" in found and ("%" in found or of_table):
        with_percent = found.get("%") or next(t for t in of_texts if _PERCENT.search(t))
        raise DataError(
            f'{place}: the unit is "{shown(found["-"])}" and also "{shown(with_percent)}"; state one'
        )
    return "%" if "%" in found or of_table else "-" if "-" in found else "", ""


def _names_area(text: str) -> bool:
    return bool(_PER_OBJECT.search(text) or _AREAS_OF_COLUMN.fullmatch(text))


def _titles(rows: Sequence[Row]) -> list[str]:
    return [" ".join(filter(None, cells)) for _, cells in rows]


def _lacking(of_table: Iterable[float], values: dict[float, str]) -> list[str]:
    """Return the note of a product that has no coefficient in some bands of its table."""
    lacking = [bands.label(f) for f in of_table if f not in values]
    return [f"no coefficient at {', '.join(lacking)}"] if lacking else []


def _first_percent(texts: Sequence[str]) -> str:
    return next(filter(_PERCENT.search, texts), "")


def _material(
    of_sheet: str, product: _Product, left_out: Sequence[str], *, beside_percent: bool
) -> ListedMaterial:
    """Return a product as a material; it has a doubt if its numbers are no coefficients."""
    place = f"{of_sheet}, line {product.line}"
    unit, doubt = _stated_unit(product, f"{place}: {shown(product.name)}")
    percent, values = unit == "%", product.values
    of_cells = ["%" in cell for cell in values.values()]
    if any(of_cells) and not all(of_cells) and not percent:
        raise DataError(
            f'{place}: "{shown(product.name)}" has cells with % and others without; write it '
            "in all or in none"
        )
    elsewhere = "" if percent else _first_percent([*product.headers, *product.titles])
    alpha, above = [], []
    for frequency, cell in values.items():
        where = f"{place}: {shown(product.name)} at {bands.label(frequency)}"
        text = cell.rstrip("% ")
        scale = 0.01 if percent or cell != text else 1.0
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
    if elsewhere and unit != "-" and not all(of_cells):
        source += f'; taken as fractions: "{shown(elsewhere, 60)}" is no unit of the coefficients'
    if above:
        source += f"; above 1 (edge effect), taken as 1: {', '.join(above)}"
    if left_out:
        named = first_of([f'"{shown(n)}"' for n in dict.fromkeys(left_out)], _MOST_LEFT_OUT)
        source += f"; left out: {named}"
    return ListedMaterial(
        name=product.name,
        line=product.line,
        alpha=tuple(alpha),
        centre_frequencies=tuple(values),
        spans=(),
        source=" ".join(source.split())[:1000],
        doubt=doubt,
    )
