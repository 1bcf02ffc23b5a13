"""Checks of single values that constructors take; errors name the place and the rule that is broken."""

from __future__ import annotations

import os
import re
import sys
import unicodedata
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from rtcal.support.errors import DataError
from rtcal.support.types import Array, read_only

T = TypeVar("T")


def number(place: str, value: object) -> float:
    """Return a real number as a float; DataError, which names ``place``, for any other value.

    Examples
    --------
    >>> number("threshold", np.int64(2))
    2.0
    """
    real = (int, float, np.integer, np.floating)
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, real):
        raise DataError(f"{place} = {shown(value)} must be a number")
    try:
        return float(value)
    except OverflowError as cause:
        raise DataError(f"{place} = {shown(value)} is too large") from cause


def positive(place: str, value: object, unit: str = "") -> float:
    """Return a finite number above 0 as a float; DataError, which names ``place``, for anything else.

    Examples
    --------
    >>> positive("duration", 2, "s")
    2.0
    """
    real = number(place, value)
    if not 0 < real < np.inf:
        raise DataError(f"{place} = {real:g}{unit and ' '}{unit} must be finite and above 0")
    return real


def between(
    place: str, value: object, least: float, most: float, unit: str = "", why: str = ""
) -> float:
    """Return a number from ``least`` to ``most``; DataError at ``place``, with ``why``, for any other.

    Examples
    --------
    >>> between("humidity", 50, 1, 100, "%")
    50.0
    """
    real, unit = number(place, value), f" {unit}".rstrip()
    if not least <= real <= most:
        raise DataError(
            f"{place} = {real:.15g}{unit} must be from {least:g} to {most:g}{unit}{why}"
        )
    return real


def whole(place: str, value: object, least: int) -> int:
    """Return a whole number of at least ``least``; DataError for anything else.

    Examples
    --------
    >>> whole("workers", 4, 1)
    4
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise DataError(f"{place} = {shown(value)} must be a whole number of at least {least}")
    return int(value)


def flag(place: str, value: object) -> bool:
    """Return true or false; DataError for anything else, also for 0, 1 and text."""
    if not isinstance(value, bool | np.bool_):
        raise DataError(f"{place} = {shown(value)} must be true or false")
    return bool(value)


def text(place: str, value: object) -> str:
    """Return a text; DataError for anything else."""
    if not isinstance(value, str):
        raise DataError(f"{place} = {shown(value)} must be a text")
    return value


def choice(place: str, value: object, options: Collection[str]) -> str:
    """Return a text that is one of ``options``; DataError for anything else."""
    if text(place, value) not in options:
        raise DataError(f"{place} = {shown(value)} must be one of {', '.join(options)}")
    return str(value)


def content(place: str, value: object) -> bytes:
    """Return the content of a file if it is bytes; DataError for text and any other type."""
    if not isinstance(value, bytes):
        raise DataError(f"{place}: content = {shown(value)} must be the bytes of a file")
    return value


def instance(place: str, value: object, kind: type[T]) -> T:
    """Return an instance of one of rtcal's classes; DataError for anything else."""
    if not isinstance(value, kind):
        wrong = f"{place} = {shown(value)} must be an {public_name(kind)}"
        if type(value).__module__.startswith("rtcal."):
            wrong += f", not an {public_name(type(value))}"
            wrong += ": check the order of the arguments" * (
                kind.__name__ in ("Room", "Measurement")
            )
        elif isinstance(value, str | os.PathLike) and hasattr(kind, "from_file"):
            wrong += f": read it with {public_name(kind)}.from_file"
        raise DataError(wrong)
    return value


def instances(place: str, value: object, kind: type[T]) -> tuple[T, ...]:
    """Return the members of a sequence of one of rtcal's classes; DataError for anything else."""
    every = listed(place, value)
    return tuple([instance(f"{place}[{i}]", each, kind) for i, each in enumerate(every)])


def stack_level() -> int:
    """Return the ``stacklevel`` with which a warning of the caller shows the user's line."""
    package = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(package + os.sep):
        level, frame = level + 1, frame.f_back
    return level


def public_name(thing: Any) -> str:
    """Return the name by which a user imports a class or function, from the outermost package.

    Examples
    --------
    >>> from rtcal.acoustics.room import Room
    >>> public_name(Room)
    'rtcal.Room'
    """
    parts = thing.__module__.split(".")
    packages = [".".join(parts[:n]) for n in range(1, len(parts) + 1)]
    name = thing.__name__
    listing = (p for p in packages if name in getattr(sys.modules.get(p), "__all__", ()))
    own = (
        p
        for p in listing
        if getattr(getattr(sys.modules[p], name), "__module__", None) == thing.__module__
    )
    return f"{next(own, packages[-1])}.{name}"


def array(place: str, value: object) -> Array:
    """Return real numbers as an array; a float array is not copied.

    ``place`` is the name of the value in messages. Raises DataError for any other value, also for true
    and false, and for a masked array with masked entries.
    """
    if np.ma.isMaskedArray(value) and np.ma.getmaskarray(value).any():
        raise DataError(
            f"{place} is a masked array with masked entries; every entry must be a number"
        )
    if value is None:
        raise DataError(f"{place} = None must be an array of real numbers")
    try:
        kind = np.asarray(value).dtype.kind
        if kind not in "bcSU" and not (isinstance(value, list | tuple) and _has_flags(value)):
            return np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError) as cause:
        raise DataError(f"{place} must be an array of real numbers: {cause}") from cause
    found = {"c": "complex numbers", "U": "text", "S": "text"}.get(kind, "true or false")
    raise DataError(f"{place} must be an array of real numbers, but it contains {found}")


def shaped(place: str, value: object, *shape: int | str) -> Array:
    """Return real numbers as a read-only array, once its shape is checked.

    ``shape`` has the length of each axis, or a name for an axis that may have any length. ``place`` is
    the name of the value in messages. The array is read-only so that it stays as it was checked.
    """
    found = array(place, value)
    fits = found.ndim == len(shape)
    for n, of in zip(found.shape, shape, strict=False):
        fits &= isinstance(of, str) or n == of
    if not fits:
        needed = f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})"
        raise DataError(f"{place} has shape {found.shape}; it must be {needed}")
    return read_only(found)


def entries(
    place: str | Callable[..., str],
    values: Array,
    allowed: NDArray[np.bool_],
    rule: str | Callable[..., str],
    unit: str = "",
) -> None:
    """Raise DataError that names the first entry of ``values`` that is not ``allowed``, with the rule.

    ``place`` is the name of the array, or a function of an entry's indices that returns the entry's
    name; so is ``rule``, which follows "must be".

    Examples
    --------
    >>> areas = np.array([1.0, -2.0])
    >>> entries("areas", areas, areas > 0, "above 0", "m²")
    Traceback (most recent call last):
    rtcal.support.errors.DataError: areas[1] = -2 m² must be above 0
    """
    if allowed.all():
        return
    at = tuple(np.argwhere(~allowed)[0].tolist())
    where = place(*at) if callable(place) else f"{place}[{', '.join(map(str, at))}]"
    must = rule(*at) if callable(rule) else rule
    raise DataError(f"{where} = {f'{values[at]:g} {unit}'.rstrip()} must be {must}")


def distinct(place: str, names: Sequence[str], advice: str = "give each a name of its own") -> None:
    """Raise DataError if two of the names are equal."""
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise DataError(f'{place} has "{twice}" twice; {advice}')


def _has_flags(value: Any) -> bool:
    """Whether a list has true or false beside its numbers, of which NumPy makes 1 and 0."""
    nested = isinstance(value, list | tuple)
    return any(map(_has_flags, value)) if nested else isinstance(value, bool | np.bool_)


def listed(place: str, value: object) -> tuple[Any, ...]:
    """Return the members of a sequence; DataError for one text and for anything else."""
    if isinstance(value, str | bytes) or not np.iterable(value):  # an array of no axis is none
        raise DataError(f"{place} = {shown(value)} must be a list")
    return tuple(value)


def texts(place: str, value: object) -> tuple[str, ...]:
    """Return the members of a sequence of texts; DataError for one text and for anything else."""
    every = listed(place, value)
    return tuple([text(f"{place}[{i}]", each) for i, each in enumerate(every)])


def text_by_name(place: str, value: object) -> dict[str, str]:
    """Return a mapping of texts to texts as a dict; None is an empty one; DataError for others."""
    stated = mapped(place, {} if value is None else value)
    return {
        text(f"{place}: a name", name): text(f"{place}[{shown(name)}]", each)
        for name, each in stated.items()
    }


def pairs(place: str, value: object) -> tuple[tuple[str, str], ...]:
    """Return pairs of a source and a receiver; DataError for a single pair and for anything else."""
    every = listed(place, value)
    for pair in every:
        if not (
            isinstance(pair, list | tuple)
            and len(pair) == 2
            and isinstance(pair[0], str)
            and isinstance(pair[1], str)
        ):
            raise DataError(
                f"{place} has {shown(pair)}; give each pair as [source, receiver], such as "
                f'{place} = [["S1", "R3"]]'
            )
    return tuple(map(tuple, every))


def mapped(place: str, value: object) -> dict[Any, Any]:
    """Return a mapping as a dict; DataError for anything else."""
    if not isinstance(value, Mapping):
        raise DataError(f"{place} = {shown(value)} must be a mapping")
    return dict(value)


def path(place: str, value: object) -> Path:
    """Return a path; DataError for anything else."""
    if not isinstance(value, str | os.PathLike):
        raise DataError(f"{place} = {shown(value)} must be a path")
    return Path(value)


def shown(value: object) -> str:
    """Return a value as a message shows it: on one line, at most 60 characters.

    Examples
    --------
    >>> shown("x" * 100)
    "'xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx..."
    """
    try:
        text = " ".join(repr(value).split())
    except (ValueError, RecursionError):  # an integer of thousands of digits, lists without an end
        text = f"a {type(value).__name__} that is too long to show"
    return text if len(text) <= 60 else text[:57] + "..."


IN_PERCENT = ". If it is in percent, divide it by 100"
"""Advice on a share that is above 1."""
LONGEST_NAME = 200
"""Largest length of an author, and of what stands at the head of a page, in characters."""
_BIDIRECTIONAL = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Characters that turn the direction of what follows: a name could be read as another."""


def text_name(place: str, value: object) -> str:
    """Return a name; DataError unless it is text without characters that control how it is shown."""
    if not isinstance(value, str):
        raise DataError(f"{place} has {value!r}; it must be a text")
    if any(
        unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp") or c in _BIDIRECTIONAL for c in value
    ):
        raise DataError(f"{place} has {value!r}; a name must not have control characters")
    return value


def short_name(place: str, value: object) -> str:
    """Return a name of at most `LONGEST_NAME` characters, as stands at the head of a page."""
    name = text_name(place, value)
    if len(name) > LONGEST_NAME:
        raise DataError(f"{place} has {len(name)} characters; at most {LONGEST_NAME} are allowed")
    return name


@lru_cache
def without_looks(name: str) -> str:
    r"""Return a name without differences that are hard to see: case, blanks, width, unseen characters.

    Examples
    --------
    >>> without_looks("Ｒ 1"), without_looks("r\u200b1"), without_looks("Wood  panel ")
    ('r1', 'r1', 'wood panel')
    """
    folded = unicodedata.normalize("NFKC", name).casefold()
    seen = "".join(c for c in folded if unicodedata.category(c) != "Cf")
    return re.sub(r"(?<=\D)\s+(?=\d)", "", " ".join(seen.split()))


def look_alike(names: Iterable[str]) -> tuple[str, str] | None:
    """Return two different names that look the same by `without_looks`; None if there are none.

    Examples
    --------
    >>> look_alike(["R1", "R2", "r1"])
    ('R1', 'r1')
    """
    seen: dict[str, str] = {}
    for name in names:
        if (other := seen.setdefault(without_looks(name), name)) != name:
            return other, name
    return None


LOOKS = "which differ only in upper case, blanks or the width of characters"
