"""A self-contained HTML document: its heading, its frame, its figures. Each page of a result is one.

No other module imports jinja2. Autoescaping makes every name plain text.
"""

from __future__ import annotations

import base64
import os
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.files.disk import write_text
from rtcal.report import figures
from rtcal.support import __version__
from rtcal.support.checks import LONGEST_NAME, short_name
from rtcal.support.errors import DataError, MissingDependencyError
from rtcal.support.text import shortened
from rtcal.support.types import Array

__all__ = ["Heading"]
__dir__ = __all__.copy


MOST = 1e6
"""Largest odds that are printed as a number: no model is known so well."""
_NUMBER = r"([+−-]?\d+(?:\.\d+)?)"
_ONE = rf"{_NUMBER} nats"
_TWO = rf"{_ONE}(; threshold:?|; it must exceed| instead of| of the) {_NUMBER}(?: nats)?"
_EXPLAINED = re.compile(r" ?2\.3 nats are odds of ten to one\.")
"""What explains nats, and nothing else."""
_FACTORS = (
    (rf"{_ONE} (more|less) probable", "{0} times {1} probable"),
    (rf"{_ONE} (better|worse)", "{0} times {1}"),
    (rf"a standard deviation of {_ONE}", "a standard deviation of a factor of {0}"),
)


def odds(nats: float) -> str:
    """Return evidence in nats as odds, to two digits.

    Examples
    --------
    >>> odds(2.3026), odds(-4.0), odds(0.0), odds(40.0)
    ('10 to 1', '1 to 55', 'even', 'over a million to 1')
    """
    times = _times(abs(nats))
    if times == "1":
        return "even"
    return f"{times} to 1" if nats > 0 else f"1 to {times}"


def in_odds(sentence: str) -> str:
    """Return a sentence with odds in place of nats.

    Examples
    --------
    >>> in_odds("Evidence: +4.6 nats; threshold 2.3.")
    'Evidence: odds of 99 to 1; threshold 10 to 1.'
    >>> in_odds("They are 3.0 nats less probable with the effect.")
    'They are 20 times less probable with the effect.'
    >>> in_odds("Evidence: +4.6 nats; it must exceed 3.0. 2.3 nats are odds of ten to one.")
    'Evidence: odds of 99 to 1; it must exceed 20 to 1.'
    >>> in_odds("its evidence is +1.6 nats instead of +4.6")
    'its evidence is odds of 5 to 1 instead of 99 to 1'
    """
    sentence = _EXPLAINED.sub("", sentence)
    for pattern, words in _FACTORS:
        sentence = re.sub(pattern, partial(_factor, words), sentence)
    sentence = re.sub(_TWO, lambda m: f"{_odds_of(m[1])}{m[2]} {odds(_value(m[3]))}", sentence)
    return re.sub(_ONE, lambda m: _odds_of(m[1]), sentence)


def _factor(words: str, found: re.Match[str]) -> str:
    return words.format(_times(abs(_value(found[1]))), *found.groups()[1:])


def _odds_of(text: str) -> str:
    return f"odds of {odds(_value(text))}"


def _value(text: str) -> float:
    return float(text.replace("−", "-"))


def _times(nats: float) -> str:
    """Return a factor to two digits."""
    factor = float(np.exp(min(nats, 50.0)))
    if factor > MOST:
        return "over a million"
    digits = max(0, int(np.floor(np.log10(factor))) - 1)
    rounded = round(factor / 10**digits) * 10**digits
    return f"{rounded:,}" if factor >= 3 else f"{factor:.2g}"


MAX_BYTES = 2 * 10**6
"""Largest size of a page in bytes."""
_BANDS_ABREAST = 7


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

    def completed(self, title: str, author: str) -> Heading:
        """Return the heading with a title and an author, where it has none; a long title is cut."""
        title = self.title or shortened(title, LONGEST_NAME)
        return Heading(title, self.author or author, self.date)


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


def source(figure: Any, step: Callable[[], None]) -> str:
    """Return a figure as a data URI, a separate document whose ids do not clash with the page's."""
    step()
    return data_of(figures.rendered(figure, "svg"), "image/svg+xml")


def data_of(content: bytes, kind: str = "text/plain") -> str:
    """Return a file's content as a data URI."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def blocks(n_bands: int) -> list[slice]:
    """Return the bands of each part of a table, alike in width, so that it fits a sheet."""
    number = -(-n_bands // _BANDS_ABREAST)
    ends = [n_bands * block // number for block in range(number + 1)]
    return [slice(first, end) for first, end in pairwise(ends)]


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
    environment.filters["odds"] = odds
    environment.filters["in_odds"] = in_odds
    environment.filters["as_it_is"] = Markup  # rtcal's own script, and JSON without markup
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


def material_rows(
    names: Iterable[str],
    areas: Array,
    before: Array,
    after: Array,
    interval: tuple[Array, Array] | None = None,
    at_bound: NDArray[np.bool_] | None = None,
) -> list[dict[str, Any]]:
    """Return one row per material: name, area, and a cell per band.

    Parameters
    ----------
    names : iterable of str (n_materials,)
    areas : array (n_materials,)
        m².
    before, after : array (n_materials, n_bands)
        Coefficients as stated and as calibrated.
    interval : (array, array), optional
        Ends of the calibrated coefficients' 90 % intervals, each (n_materials, n_bands).
    at_bound : array of bool (n_materials, n_bands), optional
        Which coefficients stand at a bound; they get a star.
    """
    rows = []
    for i, name in enumerate(names):
        cells: list[dict[str, Any]] = [
            {"before": b, "after": a, "star": ""} for b, a in zip(before[i], after[i], strict=True)
        ]
        for k, cell in enumerate(cells):
            if interval is not None:
                cell |= {"low": interval[0][i, k], "high": interval[1][i, k]}
            if at_bound is not None and at_bound[i, k]:
                cell["star"] = "*"
        rows.append({"name": name, "area": areas[i], "cells": cells})
    return rows
