"""Checks of values, of arguments and of files; errors name the place and the rule that is broken.

A file's JSON or TOML is parsed strictly, and then checked entry by entry.
"""

from __future__ import annotations

import json
import math
import os
import sys
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from rtcal.support.errors import DataError, RtcalError
from rtcal.support.types import Array

T = TypeVar("T")


def number(place: str, value: object, error: type[RtcalError] = DataError) -> float:
    """Return a real number as a float; ``error`` for anything else, also text and True.

    Examples
    --------
    >>> number("threshold", np.int64(2))
    2.0
    """
    real = (int, float, np.integer, np.floating)
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, real):
        raise error(f"{place} = {shown(value)} is not a number")
    try:
        return float(value)
    except OverflowError as cause:
        raise error(f"{place} = {shown(value)} is too large a number") from cause


def positive(place: str, value: object, unit: str = "") -> float:
    """Return a finite number above 0 as a float; DataError for anything else.

    Examples
    --------
    >>> positive("duration", 2, "s")
    2.0
    """
    real = number(place, value)
    if not 0 < real < np.inf:
        raise DataError(f"{place} = {real:g}{unit and ' '}{unit} is not finite and above 0")
    return real


def whole(place: str, value: object, least: int, error: type[RtcalError] = DataError) -> int:
    """Return a whole number of at least ``least``; ``error`` for anything else.

    Examples
    --------
    >>> whole("workers", 4, 1)
    4
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise error(f"{place} = {shown(value)} is not a whole number of at least {least}")
    return int(value)


def flag(place: str, value: object) -> bool:
    """Return true or false; DataError for anything else, also for 0, 1 and text."""
    if not isinstance(value, bool | np.bool_):
        raise DataError(f"{place} = {shown(value)} is not true or false")
    return bool(value)


def text(place: str, value: object) -> str:
    """Return a text; DataError for anything else."""
    if not isinstance(value, str):
        raise DataError(f"{place} = {shown(value)} is not a text")
    return value


def choice(place: str, value: object, options: Collection[str]) -> str:
    """Return a text that is one of ``options``; DataError for anything else."""
    if text(place, value) not in options:
        raise DataError(f"{place} = {shown(value)} is not one of {', '.join(options)}")
    return str(value)


def content(place: str, value: object) -> bytes:
    """Return the bytes of a file; DataError for anything else, also for its text."""
    if not isinstance(value, bytes):
        raise DataError(f"{place}: content = {shown(value)} is not bytes, as a file has")
    return value


def instance(place: str, value: object, kind: type[T]) -> T:
    """Return an instance of one of rtcal's classes; DataError for anything else."""
    if not isinstance(value, kind):
        raise DataError(f"{place} = {shown(value)} is not a {public_name(kind)}")
    return value


def stack_level() -> int:
    """Return the ``stacklevel`` with which a warning of the caller shows the user's line."""
    package = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(package + os.sep):
        level, frame = level + 1, frame.f_back
    return level


def public_name(thing: Any) -> str:
    """Return the name under which a user has a class or function: of the outermost package with it.

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


def array(place: str, value: object, error: type[RtcalError] = DataError) -> Array:
    """Return real numbers as an array; a float array is not copied.

    ``error`` for anything else, also true and false, and for a masked array with masked entries.
    """
    if np.ma.isMaskedArray(value) and np.ma.getmaskarray(value).any():
        raise error(f"{place} is a masked array with hidden entries; numbers are needed for all")
    if value is None:
        raise error(f"{place} = None is not an array of real numbers")
    try:
        kind = np.asarray(value).dtype.kind
        if kind not in "bc" and not _has_flags(value):
            return np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError) as cause:
        raise error(f"{place} is not an array of real numbers: {cause}") from cause
    found = "complex ones" if kind == "c" else "true or false"
    raise error(f"{place} is not an array of real numbers: it has {found}")


def _has_flags(value: Any) -> bool:
    """Whether a list has true or false beside its numbers, of which NumPy makes 1 and 0."""
    nested = isinstance(value, list | tuple)
    return any(map(_has_flags, value)) if nested else isinstance(value, bool | np.bool_)


def listed(place: str, value: object) -> tuple[Any, ...]:
    """Return the members of a sequence; DataError for one text and for anything else."""
    if isinstance(value, str | bytes) or not isinstance(value, Iterable):
        raise DataError(f"{place} = {shown(value)} is not a list")
    return tuple(value)


def texts(place: str, value: object) -> tuple[str, ...]:
    """Return the members of a sequence of texts; DataError for one text and for anything else."""
    return tuple(text(f"{place}[{i}]", each) for i, each in enumerate(listed(place, value)))


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
            and all(isinstance(name, str) for name in pair)
        ):
            raise DataError(
                f"{place} has {shown(pair)}, which is no pair of a source and a receiver; "
                f'{place} = [["S1", "R3"]] has one'
            )
    return tuple((source, receiver) for source, receiver in every)


def mapped(place: str, value: object) -> dict[Any, Any]:
    """Return a mapping as a dict; DataError for anything else."""
    if not isinstance(value, Mapping):
        raise DataError(f"{place} = {shown(value)} is not a mapping")
    return dict(value)


def path(place: str, value: object) -> Path:
    """Return a path; DataError for anything else."""
    if not isinstance(value, str | os.PathLike):
        raise DataError(f"{place} = {shown(value)} is not a path")
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


MAX_DEPTH = 20
"""Largest nesting depth of a file; rtcal's formats need at most 6."""
MAX_DIGITS = 400
"""Largest number of digits of an integer; the largest float has 309."""
MAX_DOTS = 500
"""Largest number of parts of a dotted TOML key; tomllib's time grows with its square."""


def json_object(text: str) -> dict[str, Any]:
    """Return the object that a JSON text holds.

    Raises DataError, without the file's name, for anything but one object, a key that is given twice,
    NaN and Infinity, an integer of more than `MAX_DIGITS`, more than `MAX_DEPTH` levels, and half of a
    surrogate pair in a text.

    Examples
    --------
    >>> json_object('{"volume": 100}')
    {'volume': 100}
    """
    try:
        value = json.loads(
            text, object_pairs_hook=_unique, parse_constant=_no_number, parse_int=_integer
        )
    except RecursionError as error:
        raise DataError(f"not JSON that rtcal reads: {_TOO_DEEP}") from error
    except ValueError as error:
        raise DataError(f"not JSON: {error}") from error
    if not isinstance(value, dict):
        raise DataError("not a JSON object")
    _check_levels(value)
    return value


def toml_table(text: str) -> dict[str, Any]:
    """Return the table that a TOML text holds; DataError as `json_object`.

    Examples
    --------
    >>> toml_table("volume = 100")
    {'volume': 100}
    """
    if not isinstance(text, str):
        raise DataError(f"content = {shown(text)} is not a text")
    if any(line.count(".") > MAX_DOTS for line in text.split("\n") if "=" not in line[:MAX_DOTS]):
        raise DataError(f"a key of more than {MAX_DOTS} parts")
    try:
        value = tomllib.loads(text)
    except RecursionError as error:
        raise DataError(f"not TOML that rtcal reads: {_TOO_DEEP}") from error
    except ValueError as error:
        raise DataError(f"not valid TOML: {error}") from error
    _check_levels(value)
    return value


_MOST_KEYS = 12  # that a message names: the nearest
_TOO_DEEP = f"more than {MAX_DEPTH} levels"


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for i, key in enumerate(keys) if key in keys[:i])
        raise ValueError(f"the key {twice[:40]!r} is given twice")
    return table


def _no_number(text: str) -> None:
    raise ValueError(f"{text} is no number of JSON's")


def _integer(text: str) -> int:
    if len(text) > MAX_DIGITS:
        raise ValueError(f"an integer of {len(text)} digits; {MAX_DIGITS} are the most")
    return int(text)


def _check_levels(value: Any) -> None:
    """Refuse too many levels, and text that cannot be written to a file again."""
    level: list[Any] = [value]
    for _ in range(MAX_DEPTH + 1):
        below: list[Any] = []
        for each in level:
            if isinstance(each, dict):
                below += each.keys()
                below += each.values()
            elif isinstance(each, list):
                below += each
            elif isinstance(each, str) and not each.isascii():
                try:
                    each.encode()
                except UnicodeEncodeError as error:
                    raise DataError(f"{each[:40]!r} has half of a surrogate pair") from error
        if not below:
            return
        level = below
    raise DataError(_TOO_DEEP)


@dataclass(frozen=True)
class Entries:
    """An object of a file, whose methods return its values and check them.

    Every message begins with ``place`` and the key, so ``place`` includes the separator: ``steps[0].``
    or ``material "plaster": ``. It is empty for the whole file.

    Raises DataError if ``values`` is not a mapping, lacks a key of ``needed``, or has a key that is
    neither in ``needed`` nor in ``optional``.
    """

    place: str
    values: Mapping[str, Any]
    needed: Collection[str] = ()
    optional: Collection[str] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.values, Mapping):
            raise DataError(f"{self.name} = {shown(self.values)} is not an object")
        for key in self.needed:
            if key not in self.values:
                raise DataError(f"{self.name} lacks {key}{self._misspelt(key)}")
        for key in self.values:
            if key not in self.needed and key not in self.optional:
                keys = {*self.needed, *self.optional}
                nearest = get_close_matches(str(key)[:40], sorted(keys), _MOST_KEYS, 0)
                raise DataError(
                    f'{self.name} has the key "{str(key)[:40]}", which is not one of '
                    f"{', '.join(sorted(nearest))}"
                    f"{', ...' if len(keys) > _MOST_KEYS else ''}"
                )

    @property
    def name(self) -> str:
        """The object's name in error messages."""
        return self.place.rstrip(": .") or "the file"

    def _misspelt(self, key: str) -> str:
        """Name a key without a meaning that is nearly ``key``, in brackets; "" if there is none."""
        others = [str(k)[:40] for k in self.values if k not in (*self.needed, *self.optional)]
        near = get_close_matches(key, others, 1)
        return f' (it has "{near[0]}", which has no meaning)' if near else ""

    def __contains__(self, key: str) -> bool:
        return self.values.get(key) is not None

    def text(self, key: str, default: str | None = None) -> str:
        """Return a text, or ``default`` if the key is missing."""
        return text(self.place + key, self._value(key, default))

    def choice(self, key: str, options: Collection[str], default: str | None = None) -> str:
        """Return a text that is one of ``options``."""
        return choice(self.place + key, self._value(key, default), options)

    def number(
        self,
        key: str,
        default: float | None = None,
        limits: tuple[float, float] = (-math.inf, math.inf),
    ) -> float:
        """Return a finite number within the limits."""
        return _within(self.place + key, self._value(key, default), limits)

    def whole(self, key: str, least: int, default: int | None = None) -> int:
        """Return a whole number of at least ``least``."""
        return whole(self.place + key, self._value(key, default), least)

    def flag(self, key: str, default: bool | None = None) -> bool:
        """Return true or false."""
        return flag(self.place + key, self._value(key, default))

    def array(
        self,
        key: str,
        shape: Sequence[int | None],
        limits: tuple[float, float] = (-math.inf, math.inf),
        missing: bool = False,
    ) -> Array:
        """Return nested lists of finite numbers as an array; null becomes NaN where allowed.

        None in ``shape`` stands for any length.
        """
        return _array(self.place + key, self._value(key), tuple(shape), limits, missing)

    def listed(self, key: str, default: Sequence[Any] | None = None) -> list[Any]:
        """Return a list."""
        value = self._value(key, default)
        if not isinstance(value, list | tuple):
            raise DataError(f"{self.place}{key} = {shown(value)} is not a list")
        return list(value)

    def texts(self, key: str, default: Sequence[str] | None = None) -> list[str]:
        """Return a list of texts."""
        return list(texts(self.place + key, self.listed(key, default)))

    def mapping(self, key: str, default: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return an object with arbitrary keys, such as names of materials."""
        return mapped(self.place + key, self._value(key, default))

    def entries(
        self, key: str, needed: Collection[str] = (), optional: Collection[str] = ()
    ) -> Entries:
        """Return an object within this one."""
        return Entries(f"{self.place}{key}.", self._value(key), needed, optional)

    def _value(self, key: str, default: Any = None) -> Any:
        if key not in self.values:
            if default is None:
                raise DataError(f"{self.name} lacks {key}")
            return default
        return self.values[key]


def _within(place: str, value: Any, limits: tuple[float, float]) -> float:
    real = number(place, value)
    if not math.isfinite(real):
        raise DataError(f"{place} = {real:g} is not finite")
    if not limits[0] <= real <= limits[1]:
        raise DataError(f"{place} = {real:g} is not from {limits[0]:g} to {limits[1]:g}")
    return real


def _array(
    place: str,
    value: Any,
    shape: tuple[int | None, ...],
    limits: tuple[float, float],
    missing: bool,
) -> Array:
    if not shape:
        if value is None and missing:
            return np.array(np.nan)
        return np.array(_within(place, value, limits))
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, list | tuple):
        kind = "numbers" if len(shape) == 1 else "lists"
        count = "" if shape[0] is None else f"{shape[0]} "
        raise DataError(f"{place} = {shown(value)} is not a list of {count}{kind}")
    if shape[0] is not None and len(value) != shape[0]:
        raise DataError(f"{place} has {len(value)} values; it needs {shape[0]}")
    if len(shape) == 1 and all(type(v) is float for v in value):
        row = np.array(value, dtype=float)
        if ((row >= limits[0]) & (row <= limits[1]) & np.isfinite(row)).all():
            return row
    rows = [_array(f"{place}[{i}]", v, shape[1:], limits, missing) for i, v in enumerate(value)]
    return np.array(rows, dtype=float)
