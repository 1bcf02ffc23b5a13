"""A self-contained HTML document of blocks: tables, notes and what only a page has.

No other module imports jinja2. Autoescaping makes every name plain text.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.marks import TrustMark, grouped
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
MOST_MATERIALS = 100
"""Largest number of materials in a page's tables: those that absorb, or were learned of, most."""
MAX_BYTES = 2 * 10**6
"""Largest size of a page in bytes."""
_ABREAST, _WORDY = 7, 16
"""Columns of a table that fit a sheet; length of a cell beyond which it is of words."""


@dataclass(frozen=True)
class Heading:
    """The head of a page, which each sheet repeats when it is printed.

    Attributes
    ----------
    title : str
        By default the room's name.
    author : str
        Who made it; by default the room's author, if it has one.
    date : str
        As it is to be printed; nothing by default, so that the same result gives the same bytes.

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
    """A heading of a page; ``name`` is its anchor, ``new_sheet`` says that paper begins anew there."""

    title: str
    name: str
    level: int = 2
    new_sheet: bool = False


@dataclass(frozen=True)
class Box:
    """A verdict: "agrees", "open" or "contradicts", with its first sentence and the reasons."""

    level: str
    lead: str
    texts: Sequence[str] = ()


@dataclass(frozen=True)
class Items:
    """Sentences as a list; without any, nothing."""

    texts: Sequence[str]


@dataclass(frozen=True)
class Code:
    """Commands to copy."""

    text: str


@dataclass(frozen=True)
class Files:
    """Files within the page, by name, with instructions for the reader: "Save a and b" and ``text``."""

    contents: Mapping[str, bytes]
    text: str


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure, which ``draw`` makes once, and its caption; ``tall`` says that it may be high.

    ``alt`` stands in its place for who does not see it; without one the caption does. A figure with a
    ``name`` is a file of its own, too.
    """

    draw: Callable[[], Any]
    caption: str
    alt: str = ""
    tall: bool = False
    name: str = ""

    @cached_property
    def figure(self) -> Any:
        """The figure of matplotlib."""
        return self.draw()


@dataclass(frozen=True, eq=False)
class SideBySide:
    """Parts that stand side by side where the page is wide; ``kind`` is their class."""

    parts: Sequence[Sequence[Any]]
    kind: str = ""


@dataclass(frozen=True, eq=False)
class Page:
    """A page: its subject, its author, its heading, and its blocks.

    Blocks are those of `rtcal.support.blocks`, the classes of this module, and the room of
    `rtcal.report.room_view`.
    """

    name: str
    author: str
    subject: str
    blocks: Sequence[Any]


def render(
    page: Page, heading: Heading | None = None, progress: Callable[[], None] | None = None
) -> str:
    """Return a page as HTML; ``progress`` is called after each figure."""
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
    """Return by path a page, the numbers of its result and its figures that have a name."""
    out = {
        folder / PAGE: render(page, heading).encode(),
        folder / NUMBERS: result.to_json(folder).encode(),
    }
    for block in flat(page.blocks):
        if isinstance(block, Picture) and block.name:
            out[folder / f"{block.name}.png"] = figures.rendered(block.figure, "png")
    return out


def source(picture: Picture) -> str:
    """Return a figure as a data URI, a separate document whose ids do not clash with the page's."""
    return data_of(figures.rendered(picture.figure, "svg"), "image/svg+xml")


def data_of(content: bytes, kind: str = "text/plain") -> str:
    """Return a file's content as a data URI."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def abreast(columns: Sequence[str]) -> list[slice]:
    """Return the columns of each part of a table, alike in number, so that it fits a sheet."""
    number = -(-len(columns) // _ABREAST)
    ends = [len(columns) * part // number for part in range(number + 1)]
    return [slice(first, end) for first, end in pairwise(ends)]


def wordy(table: Table) -> list[bool]:
    """Return which columns are of texts that are longer than a number, (n_columns,)."""
    columns = zip(
        *((() if r.form else r.cells) or [""] * len(table.columns) for r in table.printed),
        strict=True,
    )
    return [any(len(c) > _WORDY and "→" not in c for c in column) for column in columns]


@cache
def _environment() -> Any:
    try:
        import jinja2
        from markupsafe import Markup
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
        "data": data_of,
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
    """Yield blocks, and the parts of those that stand side by side."""
    for block in blocks:
        if isinstance(block, SideBySide):
            for part in block.parts:
                yield from flat(part)
        else:
            yield block


def tables(blocks: Sequence[Block]) -> list[Table]:
    """Return the tables among blocks."""
    return [block for block in blocks if isinstance(block, Table)]


def notes(blocks: Sequence[Block]) -> list[str]:
    """Return the texts of the notes among blocks."""
    return [block.text for block in blocks if isinstance(block, Note)]


def coefficients(
    title: str,
    room: Room,
    alpha: Array,
    interval: tuple[Array, Array] | None = None,
    at_bound: NDArray[np.bool_] | None = None,
    most: Sequence[int] | None = None,
) -> Table:
    """Return the table of coefficients by material and band: input → calibrated, and the interval.

    ``room`` has the input coefficients, ``alpha`` is (n_materials, n_bands), as are the ends of the 90
    % ``interval`` and ``at_bound``: coefficients at a bound get a star. ``most`` are the numbers of the
    materials that a page shows, by default all.
    """

    def cell(i: int, k: int) -> str:
        star = "*" if at_bound is not None and at_bound[i, k] else ""
        ends = (
            "" if interval is None else f"\n{interval[0][i, k]:.3f}\u00a0to {interval[1][i, k]:.3f}"
        )
        return f"{room.alpha[i, k]:.3f}\u00a0→ {alpha[i, k]:.3f}{star}{ends}"

    others = {} if interval is None else {"90 %: from": interval[0], "to": interval[1]}
    return Table(
        bands.labels(room.centre_frequencies),
        [
            Row(
                f"{room.materials[i]}, {room.areas[i]:.4g} m²",
                alpha[i],
                shown=[cell(i, k) for k in range(room.n_bands)],
                others={"input": room.alpha[i], **{k: end[i] for k, end in others.items()}},
            )
            for i in range(room.n_materials)
        ],
        title,
        "Material",
        most=most,
    )


def cautions(marks: Sequence[TrustMark]) -> list[Block]:
    """Return the table of the cautions, a row for each kind, or that there are none."""
    if not marks:
        return [
            Note(
                "No check of rtcal found a reason for caution. Errors that no check can find are still "
                "possible."
            )
        ]
    rows = [
        Row(f"{m.title} ({m.letter})" if m.letter else m.title, ["; ".join(facts), m.advice])
        for m, facts in grouped(marks)
    ]
    return [Table(["Where and what", "What to do"], rows, corner="Caution")]
