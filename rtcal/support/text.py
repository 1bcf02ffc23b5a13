"""Printed text that fits the terminal: wrapped sentences, tables in blocks of columns."""

from __future__ import annotations

import math
import re
import shutil
import textwrap
from collections.abc import Iterable, Sequence

Row = tuple[str, Sequence[str]]
"""A row of a table: its label, and one cell per column."""

USUAL = 80
"""Width of lines in characters without a terminal."""
NARROWEST = 40
"""Smallest width of lines, also in a narrower terminal: a table needs a label and one column."""


def width() -> int:
    """Return the largest length of a line in characters: the terminal's width, at least 40.

    Without a terminal, as in a pipe or a notebook, it is 80. The environment variable COLUMNS overrides
    the terminal's width and this value.
    """
    return max(NARROWEST, shutil.get_terminal_size((USUAL, 24)).columns)


def wrapped(sentence: str, indent: str = "", hanging: str | None = None) -> list[str]:
    """Return a sentence as lines within `width`, without breaking words.

    ``indent`` is put before the first line and ``hanging`` before all others; by default this is the
    indent and two blanks. A word longer than a line is not broken, so that paths and commands can be
    copied.
    """
    return textwrap.wrap(
        sentence,
        width(),
        initial_indent=indent,
        subsequent_indent=indent + "  " if hanging is None else hanging,
        break_long_words=False,
        break_on_hyphens=False,
    )


def fitted(text: str) -> str:
    """Return a text in which the lines beyond `width` are wrapped and keep their indents.

    Tables from `table` fit already, so only prose is wrapped.

    Examples
    --------
    >>> print(fitted("  note: " + "T does not depend on alpha. " * 3))
      note: T does not depend on alpha. T does not depend on alpha. T does not
        depend on alpha.
    """
    most = width()
    lines: list[str] = []
    for line in text.split("\n"):
        indent = line[: len(line) - len(line.lstrip(" "))]
        lines += wrapped(line.strip(), indent) if len(line) > most else [line]
    return "\n".join(lines)


def shell(command: str, indent: str = "") -> list[str]:
    r"""Return a shell command as lines within `width`, with backslashes, so that it can be copied.

    An option stays on the line of its value.

    Examples
    --------
    >>> command = "rtcal find case.toml --engine 'path tracing' --engine network --seed 1234567890"
    >>> print("\n".join(shell(command)))
    rtcal find case.toml --engine 'path tracing' --engine network \
        --seed 1234567890
    """
    parts = re.findall(r"(?:--\S+ )?(?:'[^']*'|\"[^\"]*\"|[^\s'\"])+", command)
    lines = [indent + parts[0]]
    for part in parts[1:]:
        if len(lines[-1]) + len(part) + 3 <= width():  # a blank, and " \\" at the end
            lines[-1] += f" {part}"
        else:
            lines[-1] += " \\"
            lines.append(f"{indent}    {part}")
    return lines


def number(value: float, form: str) -> str:
    """Return a number in the format ``form``: "-" for a missing number, no sign if it rounds to 0.

    Examples
    --------
    >>> [number(v, "+.1f") for v in (1.26, -0.04, float("nan"))]
    ['+1.3', '0.0', '-']
    """
    if not math.isfinite(value):
        return "-"
    printed = format(value, form)
    return printed if float(printed) else printed.lstrip("+-")


def numbers(values: Iterable[float], form: str) -> list[str]:
    """Return each value as `number` prints it."""
    return [number(value, form) for value in values]


def with_uncertainty(value: float, uncertainty: float, decimals: int) -> str:
    """Return a value with its uncertainty; an uncertainty that would round to 0 gets more decimals.

    Examples
    --------
    >>> with_uncertainty(1.234, 0.056, 2), with_uncertainty(1.234, 0.0004, 2)
    ('1.23 ± 0.06', '1.2340 ± 0.0004')
    """
    if 0 < uncertainty < 0.5 * 10.0**-decimals:
        decimals = min(math.ceil(-math.log10(uncertainty)), _MOST_DECIMALS)
    return f"{value:.{decimals}f} ± {uncertainty:.{decimals}f}"


_MOST_DECIMALS = 6


def rounded(value: float, digits: int) -> str:
    """Return a value with a number of significant ``digits`` and without an exponent.

    >>> rounded(151.49, 2), rounded(10530.4, 4), rounded(0.0123, 2)
    ('150', '10530', '0.012')
    """
    return f"{float(f'{value:.{digits}g}'):.15g}"


def table(rows: Sequence[Row], *, header: Row) -> list[str]:
    """Return a table as lines within `width`: columns that do not fit follow in further blocks.

    Each row is a label and its cells, aligned to the right; all rows have as many cells as the
    ``header``, which stands above each block. A label that takes more than two fifths of a line stands
    on lines of its own, above its cells.

    Examples
    --------
    >>> for line in table([("T before / s", ["2.1", "1.95"])], header=("", ["125 Hz", "250 Hz"])):
    ...     print(line)
                  125 Hz  250 Hz
    T before / s     2.1    1.95
    """
    every = [header, *rows]
    most = 2 * width() // 5
    label_width = max((len(label) for label, _ in every if len(label) <= most), default=0)
    widths = [2 + max(map(len, column)) for column in zip(*(c for _, c in every), strict=True)]
    blocks: list[list[int]] = [[]]
    for column in range(len(widths)):
        used = sum(widths[k] for k in [*blocks[-1], column])
        if blocks[-1] and used > width() - label_width:
            blocks.append([])
        blocks[-1].append(column)
    lines = list[str]()
    for block in blocks:
        lines += [""] if lines else []
        for label, cells in every:
            own = len(label) > most
            lines += wrapped(label) if own else []
            shown = "".join(cells[k].rjust(widths[k]) for k in block)
            lines.append(f"{'' if own else label:{label_width}}{shown}".rstrip())
    return lines


def shortened(text: str, longest: int = 40) -> str:
    """Return a text of at most ``longest`` characters; an ellipsis replaces the remainder.

    Examples
    --------
    >>> shortened("perforated gypsum board", 16)
    'perforated gyps…'
    """
    return text if len(text) <= longest else text[: longest - 1] + "…"


def listed(names: Sequence[str], last: str = "and") -> str:
    """Return names as a sentence lists them, with ``last`` before the last name: a, b and c.

    Examples
    --------
    >>> listed(["a", "b", "c"]), listed(["a", "b"], last="or")
    ('a, b and c', 'a or b')
    """
    return f" {last} ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def as_sentence(words: str) -> str:
    """Return words as a sentence, with a capital letter and a full stop.

    Examples
    --------
    >>> as_sentence("the coefficients are off together")
    'The coefficients are off together.'
    """
    return words[:1].upper() + words[1:].rstrip(".") + "."


def sentences(text: str) -> list[str]:
    """Return the sentences of a text; a full stop within quotes ends none.

    Examples
    --------
    >>> sentences('Look for the effect on "St. Anne". If it is not there, measure T.')
    ['Look for the effect on "St. Anne".', 'If it is not there, measure T.']
    """
    return [*filter(None, re.split(r'(?<=\.) (?=["`A-Z])(?=(?:[^"]*"[^"]*")*[^"]*$)', text))]


def first_of(names: Sequence[str], most: int) -> str:
    """Return names as `listed` does, ``most`` at most, and how many more there are.

    Examples
    --------
    >>> first_of(["floor", "walls"], 2), first_of(["floor", "walls", "door"], 2)
    ('floor and walls', 'floor, walls and 1 more')
    """
    more = [f"{len(names) - most} more"] if len(names) > most else []
    return listed([*names[:most], *more])


_OBEYED = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""What a terminal may interpret: C0 and C1 controls, marks of direction, lone surrogates."""


def decimal_comma(text: str) -> str:
    """Return advice on the first decimal comma in a text; "" if the text has none.

    Examples
    --------
    >>> decimal_comma("[189,5, 20,25]"), decimal_comma("189.5")
    ('. Write decimals with a point: 189.5', '')
    """
    found = re.search(r"(?<![\d.])(\d+),(\d+)(?!\d*\.)", text)
    return f". Write decimals with a point: {found[1]}.{found[2]}" if found else ""


def printable(text: str) -> str:
    r"""Return a text whose control characters are escaped, so that no terminal interprets them.

    Line ends and tabs stay. Names and keys that are read from files may contain escape sequences.

    Examples
    --------
    >>> printable("wall\x1b[2J")
    'wall\\x1b[2J'
    """
    return _OBEYED.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)
