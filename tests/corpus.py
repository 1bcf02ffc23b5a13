"""Small files with the oddities of real exports, and what must come out of each: `corpus.toml`.

Written after what measuring systems, spreadsheets and acoustics programs export: their encodings,
separators, line ends, decimal commas, units, merged headers and notes.
"""

import io
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import openpyxl


def book(
    sheets: Mapping[str, Sequence[Sequence[Any]]], change: Callable[[Any], None] | None = None
) -> bytes:
    """Return a workbook of sheets of cells, which ``change`` changes."""
    made = openpyxl.Workbook()
    made.remove(made.active)
    for name, rows in sheets.items():
        sheet = made.create_sheet(name)
        for row in rows:
            sheet.append([None if cell == "" else cell for cell in row])
    if change is not None:
        change(made)
    stream = io.BytesIO()
    made.save(stream)
    return stream.getvalue()


@dataclass(frozen=True)
class Case:
    """A file and its answer.

    ``values`` of a table: source, receiver, parameter, band in Hz and value of all that it holds.
    ``alpha`` of a material list: name to coefficients. ``volume`` of a mesh in m³. Else ``error``.
    ``said`` are words of the report, or of the materials' sources.
    """

    name: str
    reader: str
    text: str = ""
    codec: str = "utf-8"
    sheets: dict[str, list[list[Any]]] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)
    values: list[tuple[str, str, str, float, float]] | None = None
    alpha: dict[str, list[float]] | None = None
    volume: float | None = None
    error: str | None = None
    said: tuple[str, ...] = ()

    @property
    def content(self) -> bytes:
        return book(self.sheets) if self.sheets else self.text.encode(self.codec)


LONG = (
    Case("5,000 digits", "tables", "f;T20\n500;" + "9" * 5000, error="must be a finite number"),
    Case("5,000 digits in JSON", "pyroomacoustics", '{"coeffs": [' + "9" * 5000, error="line 1"),
    Case("nested without end", "pyroomacoustics", "[" * 100_000, error="nested too deeply"),
)
STORED = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))["case"]


def _each(stored: dict[str, Any]) -> list[Case]:
    """Return the files of a stored case: one, or one for each of its ``each``."""
    if "each" not in stored:
        return [Case(**stored)]
    each, text, name = (stored.pop(key) for key in ("each", "text", "name"))
    texts = [text.replace("@@", one) for one in each]
    return [Case(name=f"{name} {i}", text=one, **stored) for i, one in enumerate(texts, 1)]


CASES = [*(case for stored in STORED for case in _each(stored)), *LONG]
NAMED = {case.name: case for case in CASES}
