"""Plain values from a file: parsed strictly as JSON or TOML, then checked entry by entry."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np

from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

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
            raise DataError(f"{self.name} = {checks.shown(self.values)} is not an object")
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
        value = self._value(key, default)
        if not isinstance(value, str):
            raise DataError(f"{self.place}{key} = {checks.shown(value)} is not a text")
        return value

    def choice(self, key: str, options: Collection[str], default: str | None = None) -> str:
        """Return a text that is one of ``options``."""
        value = self.text(key, default)
        if value not in options:
            stated = f"{self.place}{key} = {checks.shown(value)}"
            raise DataError(f"{stated} is not one of {', '.join(options)}")
        return value

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
        return checks.whole(self.place + key, self._value(key, default), least)

    def flag(self, key: str, default: bool | None = None) -> bool:
        """Return true or false."""
        return checks.flag(self.place + key, self._value(key, default))

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
            raise DataError(f"{self.place}{key} = {checks.shown(value)} is not a list")
        return list(value)

    def texts(self, key: str, default: Sequence[str] | None = None) -> list[str]:
        """Return a list of texts."""
        value = self.listed(key, default)
        for i, each in enumerate(value):
            if not isinstance(each, str):
                raise DataError(f"{self.place}{key}[{i}] = {checks.shown(each)} is not a text")
        return value

    def mapping(self, key: str, default: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return an object with arbitrary keys, such as names of materials."""
        return checks.mapped(self.place + key, self._value(key, default))

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
    number = checks.number(place, value)
    if not math.isfinite(number):
        raise DataError(f"{place} = {number:g} is not finite")
    if not limits[0] <= number <= limits[1]:
        raise DataError(f"{place} = {number:g} is not from {limits[0]:g} to {limits[1]:g}")
    return number


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
        number = "" if shape[0] is None else f"{shape[0]} "
        raise DataError(f"{place} = {checks.shown(value)} is not a list of {number}{kind}")
    if shape[0] is not None and len(value) != shape[0]:
        raise DataError(f"{place} has {len(value)} values; it needs {shape[0]}")
    if len(shape) == 1 and all(type(v) is float for v in value):
        row = np.array(value, dtype=float)
        if ((row >= limits[0]) & (row <= limits[1]) & np.isfinite(row)).all():
            return row
    rows = [_array(f"{place}[{i}]", v, shape[1:], limits, missing) for i, v in enumerate(value)]
    return np.array(rows, dtype=float)
