"""HTML tables for notebooks, as ``_repr_html_`` returns them."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass

# Orange and blue of Okabe and Ito's palette (jfly.uni-koeln.de/color, 2008), which readers with any
# colour vision can distinguish.
_ABOVE, _BELOW = "230, 159, 0", "0, 114, 178"
_STRONGEST = 0.45  # opacity that keeps the text readable in light and in dark notebooks


@dataclass(frozen=True)
class Cell:
    """A cell with a shade from -1 (blue) over 0 (none) to 1 (orange), which repeats the text."""

    text: str
    shade: float = 0.0


def table(
    caption: str,
    header: Sequence[str],
    rows: Sequence[Sequence[str | Cell]],
    notes: Sequence[str] = (),
) -> str:
    """Return an HTML table with its notes as paragraphs below; every text is escaped.

    Parameters
    ----------
    caption : str
    header : sequence of str (n_columns,)
    rows : sequence of rows (n_columns,)
        The first cell names the row and is aligned to the left, the others to the right.
    notes : sequence of str

    Examples
    --------
    >>> table("T", ["", "1 kHz"], [["gap / JND", Cell("+2.1", 0.5)]]).count("<td")
    1
    """
    head = "".join(_cell("th", "col", i, text) for i, text in enumerate(header))
    body = "".join(
        f"<tr>{''.join(_cell('th' if i == 0 else 'td', 'row', i, c) for i, c in enumerate(row))}</tr>"
        for row in rows
    )
    lines = "".join(f"<p>{html.escape(note)}</p>" for note in notes)
    return (
        f'<table><caption style="text-align: left">{html.escape(caption)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{lines}"
    )


def _cell(tag: str, scope: str, column: int, content: str | Cell) -> str:
    cell = content if isinstance(content, Cell) else Cell(content)
    style = f"text-align: {'left' if column == 0 else 'right'}"
    if cell.shade:
        colour = _ABOVE if cell.shade > 0 else _BELOW
        opacity = _STRONGEST * min(abs(cell.shade), 1.0)
        style += f"; background: rgba({colour}, {opacity:.2f})"
    attribute = f' scope="{scope}"' if tag == "th" else ""
    return f'<{tag}{attribute} style="{style}">{html.escape(cell.text)}</{tag}>'
