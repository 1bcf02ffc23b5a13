"""A self-contained HTML document: its heading, its frame, its figures. Each page of a result is one.

No other module imports jinja2. Autoescaping makes every name plain text.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from rtcal.acoustics.materials import LONGEST_NAME, short_name
from rtcal.errors import DataError, MissingDependencyError
from rtcal.report import figures
from rtcal.support.arguments import checked
from rtcal.support.files import write_text
from rtcal.support.text import shortened
from rtcal.support.version import __version__

MAX_BYTES = 2 * 10**6
"""Largest size of a page in bytes."""
_BANDS_ABREAST = 7


@dataclass(frozen=True)
class Heading:
    """What stands at the head of a page, and on each sheet when it is printed.

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

    def completed(self, title: str, author: str) -> Heading:
        """Return the heading with a title and an author, where it has none; a long title is cut."""
        title = self.title or shortened(title, LONGEST_NAME)
        return Heading(title, self.author or author, self.date)


@checked
def render(template: str, values: Mapping[str, Any], heading: Heading) -> str:
    """Return a page of a template that extends ``layout.html``.

    Raises
    ------
    MissingDependencyError
        Without jinja2.
    DataError
        If the page would be larger than 2 MB.
    """
    text: str = (
        _environment().get_template(template).render(version=__version__, heading=heading, **values)
    )
    if (size := len(text.encode("utf-8", errors="backslashreplace"))) > MAX_BYTES:
        raise DataError(f"the page would have {size} bytes, more than {MAX_BYTES}")
    return text


@checked
def source(figure: Any, step: Callable[[], None]) -> str:
    """Return a figure as a data URI, a separate document whose ids do not clash with the page's."""
    content = base64.b64encode(figures.rendered(figure, "svg")).decode()
    step()
    return f"data:image/svg+xml;base64,{content}"


@checked
def blocks(n_bands: int) -> list[slice]:
    """Return the bands of each part of a table, so that it fits a sheet of paper."""
    return [slice(k, k + _BANDS_ABREAST) for k in range(0, n_bands, _BANDS_ABREAST)]


@checked
def write(path: str | os.PathLike[str], text: str) -> None:
    """Write a page, whole or not at all."""
    write_text(path, text)


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
    environment.filters["fixed"] = _fixed
    environment.filters["signed"] = _signed
    environment.filters["in_style"] = lambda text: Markup(_in_style(text))
    return environment


def _fixed(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"


def _signed(value: float, digits: int) -> str:
    if not np.isfinite(value):
        return "–"
    text = f"{value:+.{digits}f}"
    return text.replace("-", "−") if float(text) else text.lstrip("+-")


def _in_style(text: str) -> str:
    r"""Return a text as a string of a style sheet; what is no letter or digit is written as a code.

    >>> _in_style('Hall "A" </style>')
    '"Hall \\22 A\\22  \\3c \\2f style\\3e "'
    """
    return '"' + "".join(c if c.isalnum() or c in " .,-" else f"\\{ord(c):x} " for c in text) + '"'
