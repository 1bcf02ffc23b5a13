"""Tables and notes of a result, stated once: terminal, notebook and page are readings of them."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from rtcal.support import text

# Orange and blue of Okabe and Ito's palette (jfly.uni-koeln.de/color, 2008), which readers with any
# colour vision can distinguish.
_ABOVE, _BELOW = "230, 159, 0", "0, 114, 178"
_MINUS = re.compile(r"(?<![\w.)-])-(?=\d)")  # not the hyphen of a name, a date or an exponent
_STRONGEST = 0.45  # opacity that keeps the text readable in light and in dark notebooks


@dataclass(frozen=True, eq=False)
class Row:
    """Hold a row of a printed table.

    ``values`` (n_columns,) are texts or numbers, with None or NaN for a missing number. ``form`` is the
    format of a number; with "+" in it, positive numbers have a sign, and 0 has none.

    ``name`` stands in front of the row. ``shade`` is the colour of each cell, from -1 (blue) over 0
    (none) to 1 (orange). ``shown`` are texts to print in place of the values. ``others`` maps names to
    further values that ``shown`` contains.
    """

    name: str
    values: Sequence[Any] | NDArray[Any]
    form: str = ""
    shade: Sequence[float] | NDArray[Any] = ()
    shown: Sequence[str] = ()
    others: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def cells(self) -> list[str]:
        """The values as they are printed.

        Examples
        --------
        >>> Row("gap / JND", [1.26, -0.04, None], "+.1f").cells
        ['+1.3', '0.0', '-']
        """
        return [
            v if isinstance(v, str) else text.number(float("nan") if v is None else v, self.form)
            for v in self.shown or self.values
        ]

    @property
    def styles(self) -> list[str]:
        """CSS of each value's background, "" for a value without shade.

        Examples
        --------
        >>> Row("gap / JND", [2.1, 0.0], "+.1f", [0.5, 0.0]).styles
        ['background: rgba(230, 159, 0, 0.23)', '']
        """
        shades = self.shade if len(self.shade) else [0.0] * len(self.values)
        return [
            f"background: rgba({_ABOVE if s > 0 else _BELOW}, {_STRONGEST * min(abs(s), 1.0):.2f})"
            if s == s and s  # not of NaN
            else ""
            for s in shades
        ]

    @property
    def typeset(self) -> list[str]:
        """Texts of the values on a page, with a true minus sign, and a dash for a missing value.

        Examples
        --------
        >>> Row("gap / JND", [-1.26, None, "R-2: -2.5 (-4.2)"], "+.1f").typeset
        ['−1.3', '–', 'R-2: −2.5 (−4.2)']
        """
        return [
            "–" if cell == "-" and not isinstance(v, str) else _MINUS.sub("−", cell)
            for v, cell in zip(self.shown or self.values, self.cells, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class Table:
    """Hold a printed table, with a title above and a note below.

    ``corner`` is the head of the column of the rows' names. A table with ``detail`` True is shown in
    notebooks and on pages, but not in a terminal.

    ``columns`` are the heads of the columns, ``rows`` the rows, ``title`` is the text above and
    ``note`` that below.
    """

    columns: Sequence[str]
    rows: Sequence[Row]
    title: str = ""
    corner: str = ""
    note: str = ""
    detail: bool = False

    @classmethod
    def of_columns(
        cls,
        names: Sequence[str],
        columns: Mapping[str, Sequence[str]],
        shades: Mapping[str, NDArray[Any]] | None = None,
    ) -> Table:
        """Return the table of some columns of texts (n_rows,), with the names of its rows.

        ``names`` are the names of the rows, ``columns`` maps heads to texts, and ``shades`` maps heads
        to the colours of the cells, from -1 (blue) to 1 (orange); by default there are none.
        """
        shaded = [(shades or {}).get(c, [0.0] * len(names)) for c in columns]
        cells = zip(
            names, zip(*columns.values(), strict=True), zip(*shaded, strict=True), strict=True
        )
        return cls([*columns], [Row(name, list(row), shade=shade) for name, row, shade in cells])


@dataclass(frozen=True)
class Note:
    """Hold a sentence of a result.

    A terminal prints ``indent`` before the first line of ``text`` and ``hanging`` before the others; ""
    is an empty line. ``kind`` is the class of the sentence on a page: "lead" for the first sentences,
    "note" for a remark.
    """

    text: str
    indent: str = ""
    hanging: str | None = None
    kind: str = ""


Block = Table | Note


def lines(blocks: Sequence[Block]) -> list[str]:
    r"""Return blocks as lines that fit the terminal; empty lines stand around a table.

    Examples
    --------
    >>> print("\n".join(lines([Table(["125 Hz"], [Row("T / s", [1.5], ".2f")]), Note("One band.")])))
           125 Hz
    T / s    1.50
    <BLANKLINE>
    One band.
    """
    out: list[str] = []
    before: Block | None = None
    for block in blocks:
        if isinstance(block, Table):
            if block.detail:
                continue
            out += [""] if out else []
            out += text.wrapped(block.title)
            rows = [(row.name, row.cells) for row in block.rows]
            out += text.table(rows, header=(block.corner, block.columns))
            out += text.wrapped(block.note)
        else:
            out += [""] if isinstance(before, Table) or not block.text else []
            out += text.wrapped(block.text, block.indent, block.hanging)
        before = block
    return out


def notebook(caption: str, blocks: Sequence[Block]) -> str:
    """Return blocks as HTML for a notebook, as shaded tables and paragraphs; all text is escaped.

    Examples
    --------
    >>> notebook("T", [Table(["1 kHz"], [Row("gap / JND", [2.1], "+.1f", [0.5])])]).count("<td")
    1
    """
    out, first = "", caption
    for block in blocks:
        if isinstance(block, Note):
            out += f"<p>{html.escape(block.text)}</p>" if block.text else ""
            continue
        head = "".join(_cell("th", "col", c) for c in (block.corner, *block.columns))
        body = "".join(f"<tr>{_cells(row)}</tr>" for row in block.rows)
        title = ". ".join(filter(None, (first, block.title)))
        out += (
            f'<table><caption style="text-align: left">{html.escape(title)}</caption>'
            f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
        )
        out += f"<p>{html.escape(block.note)}</p>" if block.note else ""
        first = ""
    return out


def _cells(row: Row) -> str:
    cells = zip(row.cells, row.styles, strict=True)
    return _cell("th", "row", row.name) + "".join(_cell("td", "", c, s) for c, s in cells)


def _cell(tag: str, scope: str, content: str, ground: str = "") -> str:
    style = f"text-align: {'left' if scope == 'row' else 'right'}"
    style += f"; {ground}" if ground else ""
    attribute = f' scope="{scope}"' if scope else ""
    return f'<{tag}{attribute} style="{style}">{html.escape(content.strip())}</{tag}>'
