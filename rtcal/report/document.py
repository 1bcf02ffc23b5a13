"""A self-contained HTML document of blocks: tables, notes and what only a page has.

No other module imports jinja2. Autoescaping makes every name plain text.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.room import Room
from rtcal.files.saved import NUMBERS, Result
from rtcal.report import figures
from rtcal.support import __version__
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.checks import LONGEST_NAME, short_name
from rtcal.support.errors import DataError, MissingDependencyError
from rtcal.support.text import shortened
from rtcal.support.types import Array

__all__ = ["Heading"]
__dir__ = __all__.copy


PAGE = "report.html"
"""Name of a page in its folder."""
MOST_ROWS = 100
"""Largest number of rows of a table on a page; a workbook has all."""
MAX_BYTES = 2 * 10**6
"""Largest size of a page in bytes."""
_ABREAST, _WORDY = 7, 16
"""Columns of a table that fit a sheet; length of a cell beyond which it is of words."""
_COMMAND = re.compile("`([^`<>]+)`")
"""Command in a sentence of plain text."""


@dataclass(frozen=True)
class Heading:
    """Hold title, author and date of a page, which each printed sheet repeats.

    Attributes
    ----------
    title : str
        Title of the page; by default the room's name.
    author : str
        Author of the page; by default the room's author, if it has one.
    date : str
        Date as it is to be printed. By default there is none.

    Raises
    ------
    DataError
        For a text that is longer than 200 characters or has control characters.
    """

    title: str = ""
    author: str = ""
    date: str = ""

    def __post_init__(self) -> None:
        for name, text in vars(self).items():
            short_name(name, text)


@dataclass(frozen=True)
class Section:
    """Hold a heading of a page, its anchor ``name``, and whether it starts a new sheet of paper."""

    title: str
    name: str
    level: int = 2
    new_sheet: bool = False


@dataclass(frozen=True)
class Box:
    """Hold a verdict, "agrees", "open" or "contradicts", with its first sentence and the reasons."""

    level: str
    lead: str
    texts: Sequence[str] = ()


@dataclass(frozen=True)
class Items:
    """Hold sentences that a page shows as a list, or nothing without any."""

    texts: Sequence[str]


@dataclass(frozen=True)
class Code:
    """Hold commands that a reader of the page can copy."""

    text: str


@dataclass(frozen=True)
class Files:
    """Hold files within a page, by name, with instructions for the reader."""

    contents: Mapping[str, bytes]
    text: str


@dataclass(frozen=True, eq=False)
class Picture:
    """Hold a figure and its caption; ``draw`` is a function that returns the figure.

    ``alt`` is for readers who cannot see it, by default the caption. A ``tall`` figure may be higher
    than usual. A figure with a ``name`` is also written as a file.
    """

    draw: Callable[[], Any]
    caption: str
    alt: str = ""
    tall: bool = False
    name: str = ""

    @cached_property
    def figure(self) -> Any:
        """Figure of matplotlib."""
        return self.draw()


@dataclass(frozen=True, eq=False)
class SideBySide:
    """Hold lists of blocks that are shown side by side on a wide screen, with a CSS class ``kind``."""

    parts: Sequence[Sequence[Any]]
    kind: str = ""


@dataclass(frozen=True, eq=False)
class Page:
    """Hold a page: its subject, its author, its name and its blocks.

    Blocks are those of `rtcal.support.blocks`, of this module and of `rtcal.report.room_view`.
    """

    name: str
    author: str
    subject: str
    blocks: Sequence[Any]


def render(
    page: Page, heading: Heading | None = None, progress: Callable[[], None] | None = None
) -> str:
    """Return a page as HTML text; the function ``progress`` is called after each figure."""
    stated = heading or Heading()
    title = stated.title or shortened(page.name, LONGEST_NAME)
    whole = Heading(title, stated.author or page.author, stated.date)
    subject = page.subject[:1].upper() + page.subject[1:]

    def drawn(picture: Picture) -> str:
        encoded = source(picture)
        if progress is not None:
            progress()
        return encoded

    text: str = (
        _environment()
        .get_template("page.html")
        .render(
            version=__version__,
            heading=whole,
            subtitle=subject if whole.title == page.name else f"{page.name}: {page.subject}",
            blocks=page.blocks,
            room=next((b for b in page.blocks if type(b).__name__ == "RoomSection"), None),
            source=drawn,
        )
    )
    if (size := len(text.encode("utf-8", errors="backslashreplace"))) > MAX_BYTES:
        raise DataError(f"the page would have {size} bytes; at most {MAX_BYTES} can be written")
    return text


def page_files(
    page: Page, result: Result, folder: Path, heading: Heading | None = None
) -> dict[Path, bytes]:
    """Return the files of a page by path: the page, its result's numbers, and figures with a name."""
    out = {
        folder / PAGE: render(page, heading).encode(),
        folder / NUMBERS: result.to_json(folder).encode(),
    }
    for block in flat(page.blocks):
        if isinstance(block, Picture) and block.name:
            out[folder / f"{block.name}.png"] = figures.rendered(block.figure, "png")
    return out


def source(picture: Picture) -> str:
    """Return a figure as a data URI, whose ids cannot clash with other ids of the page."""
    return data_of(figures.rendered(picture.figure, "svg"), "image/svg+xml")


def data_of(content: bytes, kind: str = "text/plain") -> str:
    """Return a file's content as a data URI."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def abreast(columns: Sequence[str]) -> list[slice]:
    """Return the columns of each part of a table that is divided, so that each part fits a sheet."""
    number = -(-len(columns) // _ABREAST)
    ends = [len(columns) * part // number for part in range(number + 1)]
    return [slice(first, end) for first, end in pairwise(ends)]


def wordy(table: Table) -> list[bool]:
    """Return True for each column whose texts are longer than a number, (n_columns,)."""
    columns = zip(
        *((() if r.form else r.cells) or [""] * len(table.columns) for r in table.rows),
        strict=True,
    )
    return [any(len(c) > _WORDY and "→" not in c for c in column) for column in columns]


@cache
def _environment() -> Any:
    try:
        import jinja2
        from markupsafe import Markup, escape
    except ImportError as error:
        raise MissingDependencyError(
            "the page needs jinja2: pip install 'rtcal[report]'"
        ) from error
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rtcal.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "kind": lambda block: type(block).__name__,
        "abreast": abreast,
        "wordy": wordy,
        "shown": lambda rows: rows[:MOST_ROWS],
        "data": data_of,
        "with_code": lambda text: Markup(_COMMAND.sub(r"<code>\1</code>", str(escape(text)))),
        "in_style": lambda text: Markup(_in_style(text)),
        "as_it_is": Markup,  # rtcal's own script, and JSON without markup
    }
    return environment


def _in_style(text: str) -> str:
    r"""Return a text as a string of a style sheet; what is no letter or digit is written as a code.

    >>> _in_style('Hall "A" </style>')
    '"Hall \\22 A\\22  \\3c \\2f style\\3e "'
    """
    return '"' + "".join(c if c.isalnum() or c in " .,-" else f"\\{ord(c):x} " for c in text) + '"'


def flat(blocks: Iterable[Any]) -> Iterator[Any]:
    """Yield all blocks, with the parts of `SideBySide` one after the other."""
    for block in blocks:
        if isinstance(block, SideBySide):
            for part in block.parts:
                yield from flat(part)
        else:
            yield block


def tables(blocks: Sequence[Block | None]) -> list[Table]:
    """Return the tables among blocks."""
    return [block for block in blocks if isinstance(block, Table)]


def notes(blocks: Sequence[Block]) -> list[str]:
    """Return the texts of the notes among blocks."""
    return [block.text for block in blocks if isinstance(block, Note)]


def summary(
    blocks: Sequence[Block], picture: Picture, more: Sequence[str] = (), *, wide: bool = False
) -> list[Any]:
    """Return the first part of a page: the first note of a result, its other notes, and a picture.

    ``more`` are sentences after the notes. A ``wide`` picture stands below them, not beside them.
    """
    lead, *further = notes(blocks)
    said = Items([*further, *more])
    below = [said, picture] if wide else [SideBySide([[said], [picture]], "summary")]
    return [Note(lead, kind="lead"), *below]


def coefficients(
    title: str,
    room: Room,
    alpha: Array,
    interval: tuple[Array, Array] | None = None,
    at_bound: NDArray[np.bool_] | None = None,
    of: Sequence[int] | None = None,
) -> Table:
    """Return the table of input and calibrated coefficients by material and band.

    ``room`` has the input coefficients. ``alpha`` are the calibrated ones, ``interval`` the ends of
    their 90 % interval, and ``at_bound`` is True for those that get a star; all are (n_materials,
    n_bands). ``of`` are the numbers of the materials in the table, by default of all.
    """

    def cell(i: int, k: int) -> str:
        star = "*" if at_bound is not None and at_bound[i, k] else ""
        ends = (
            "" if interval is None else f"\n{interval[0][i, k]:.3f}\u00a0to {interval[1][i, k]:.3f}"
        )
        return f"{room.alpha[i, k]:.3f}\u00a0→ {alpha[i, k]:.3f}{star}{ends}"

    ends = {} if interval is None else {"90 %: from": interval[0], "to": interval[1]}
    rows = [
        Row(
            f"{room.materials[i]}, {room.areas[i]:.4g} {'m²' if room.is_surface[i] else 'pieces'}",
            alpha[i],
            shown=[cell(i, k) for k in range(room.n_bands)],
            others={name: values[i] for name, values in ({"input": room.alpha} | ends).items()},
        )
        for i in (range(room.n_materials) if of is None else of)
    ]
    return Table(bands.labels(room.centre_frequencies), rows, title, "Material")
