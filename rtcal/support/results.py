"""Results in files: plain numbers for others, and the object itself, which rtcal reads back bit by bit.

A result is a graph of frozen dataclasses. `encode` writes each of them once, after those that it holds.
`decode` makes them again by their own constructors, which check what they are given. No code is stored:
a file names classes and their fields, and nothing else is ever called. The classes are rtcal's, or
derive from rtcal's in a module that the program has imported, such as an equation of the user's own.
"""

from __future__ import annotations

import base64
import binascii
import dataclasses
import functools
import hashlib
import json
import math
import os
import sys
import types
from abc import ABC, abstractmethod
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import MISSING
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from rtcal.support import __version__, checks
from rtcal.support.arguments import checked
from rtcal.support.checks import Entries, json_object
from rtcal.support.errors import DataError
from rtcal.support.files import json_text, make_folder, read_text, write_all

NUMBERS = "result.json"
"""Name of a result's file in its folder."""
MAX_BYTES = 2**28
"""Largest size of a file in bytes: control runs of a large room have some 10 MB."""
_OBJECT = "object"
_GONE = {
    "finding 1": "rtcal.find",
    "finding of two states 1": "rtcal.find with before",
    "several effects 1": "rtcal.find with most = 3",
    "verification 1": "rtcal.find and rtcal.finder.verify",
    "where 1": "rtcal.find",
    "where verification 1": "rtcal.find and rtcal.finder.verify",
}
"""Kinds of result that are no longer read, and what makes a new one of the same data."""
_READERS = {
    ".csv": "a table: rtcal.Measurement.from_file reads it",
    ".toml": "a room or a case: rtcal.Room.from_file or rtcal.finder.Case.from_file reads it",
}


class Result(ABC):
    """A result that can be saved and loaded again; it is a frozen dataclass of what it rests on."""

    record_kind: ClassVar[str]
    """Value of the key ``rtcal`` in its file."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return what the result says as plain numbers, lists and text."""

    def to_json(self, folder: str | os.PathLike[str] | None = None) -> str:
        """Return the text of its file: the numbers of `to_dict`, and the object itself.

        Files that it names, such as a room's mesh, are named as seen from ``folder``, in which the text
        is written; without one, by their whole path.

        A result that holds an object of the user's own class, such as a simulator, has its numbers
        alone, and the reason.
        """
        try:
            return self._sealed(folder)
        except CannotBeSavedError as error:
            return _text(self._numbers(), {"not_saved": str(error)})

    def _numbers(self) -> str:
        return json_text({"rtcal": self.record_kind, **self.to_dict()})

    def _sealed(self, folder: str | os.PathLike[str] | None) -> str:
        """Return the text of the file with the object, its version and the checksum of all."""
        encoded, numbers = encode(self, folder), self._numbers()
        digest = _digest(json.loads(numbers), encoded)
        return _text(numbers, {"version": __version__, "sha256": digest, **encoded})

    @checked
    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write a file that `rtcal.load` reads, and return its path.

        ``path`` is a folder, which gets a ``result.json``, or a file's name that ends in ``.json``.

        The file holds `to_json`: numbers for other programs, and the object itself with its room and
        its data. It is written whole or not at all.

        Raises
        ------
        DataError
            If the folder cannot be made, the file cannot be written, or the result holds an object of
            the user's own class, which no file can hold.
        """
        place = checks.path("path", path)
        if place.suffix != ".json" or place.is_dir():
            place /= NUMBERS
        content = self._sealed(place.parent).encode()
        make_folder(place.parent)
        write_all({place: content})
        return place


@checked
def load(path: str | os.PathLike[str]) -> Any:
    """Return the result that a folder or a file holds, as it was saved, bit by bit.

    Parameters
    ----------
    path : path
        The folder that `save`, ``rtcal calibrate --out`` or another command wrote, or the
        ``result.json`` in it.

    Returns
    -------
    CalibrationResult, JointResult, LoopResult, PositionsResult, Finding, Verification or another
        With its room, its data and all its methods.

    Raises
    ------
    DataError
        If the file is no result, was changed by hand, or belongs to another version of rtcal.

    Examples
    --------
    >>> import tempfile
    >>> import rtcal as rt
    >>> result = rt.calibrate(*rt.datasets.bras_cr2())
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = result.save(folder)
    ...     again = rt.load(folder)
    >>> print(bool((again.alpha == result.alpha).all()), str(again) == str(result))
    True True
    """
    place = checks.path("path", path)
    if place.is_dir():
        place /= NUMBERS
        if not place.exists():
            raise DataError(f"folder {Path(path).resolve()} has no {NUMBERS}; `save` writes one")
    if place.suffix in _READERS:
        raise DataError(f"{place}: no saved result but {_READERS[place.suffix]}")
    try:
        return loaded(json_object(read_text(place, MAX_BYTES)), place.parent)
    except DataError as error:
        if str(error).startswith(str(place)):
            raise
        raise DataError(f"{place}: {error}") from error


def loaded(record: Mapping[str, Any], folder: str | os.PathLike[str] = "") -> Any:
    """Return the result of a file's content, in ``folder``; DataError as `load`, without its name."""
    if not isinstance(record.get("rtcal"), str) or _OBJECT not in record:
        if "configurations" in record:
            raise DataError("no saved result but a case: rtcal.finder.Case.from_file reads it")
        raise DataError(
            f'no saved result: it has no "rtcal" and "{_OBJECT}", as of before 0.1.0: calculate again'
        )
    if "not_saved" in Entries("", record, (), record).entries(_OBJECT, (), record[_OBJECT]):
        raise DataError(f"the result itself is not in it: {record[_OBJECT]['not_saved']}")
    if (again := _GONE.get(record["rtcal"])) is not None:
        raise DataError(
            f'a "{record["rtcal"]}" of an earlier version, which this one does not read: search again '
            f"with {again}"
        )
    keys = ("version", "sha256", "objects", "arrays", "value")
    inside = Entries(f"{_OBJECT}.", record[_OBJECT], keys)
    content = {key: inside.values[key] for key in ("objects", "arrays", "value")}
    numbers = {key: value for key, value in record.items() if key != _OBJECT}
    if inside.text("sha256") != _digest(numbers, content):
        raise DataError(
            "it was changed after it was written: change the inputs, and calculate again"
        )
    try:
        result = decode(content, folder)
    except DataError as error:
        if inside.text("version") != __version__:
            raise DataError(
                f"written by rtcal {inside.text('version')}, and this is {__version__}: {error}"
            ) from error
        raise
    if not isinstance(result, Result) or result.record_kind != record["rtcal"]:
        raise DataError(f'its "{_OBJECT}" is no {record["rtcal"]}')
    return result


def _text(numbers: str, inside: Mapping[str, Any]) -> str:
    """Return a file's text: the numbers as JSON, with the object as their last entry."""
    plain = numbers.removesuffix("\n}")
    return f'{plain},\n "{_OBJECT}": {json.dumps(inside, allow_nan=False)}\n}}\n'


def _digest(numbers: Mapping[str, Any], encoded: Mapping[str, Any]) -> str:
    """Return the checksum of a file's numbers and encoded object."""
    content = json.dumps([numbers, encoded], sort_keys=True, allow_nan=False)
    return hashlib.sha256(content.encode()).hexdigest()


MAX_LEVELS = 60
"""Largest nesting depth of lists and tables; results need at most 10."""
NOT_SAVED = {"saved": False}
"""Metadata of a dataclass field that is not stored, such as what was compiled."""
_PACKAGE = "rtcal."
_KINDS = "bifcU"  # of arrays: truth values, integers, floats, complex numbers, texts


class CannotBeSavedError(DataError):
    """An object that no file can hold, such as an effect or a simulator of the user's own class."""


def encode(value: Any, folder: str | os.PathLike[str] | None = None) -> dict[str, Any]:
    """Return a value as plain values for JSON, as `decode` reads them.

    Files are named as seen from ``folder``; without one, by their whole path.

    Raises
    ------
    CannotBeSavedError
        For an object that rtcal cannot make again, such as an effect of the user's own.

    Examples
    --------
    >>> from rtcal.acoustics.air import Air
    >>> decode(encode((Air(20.0, 50.0), np.array([0.1, np.nan]))))
    (Air(temperature=20.0, humidity=50.0, pressure=101.325), array([0.1, nan]))
    """
    writer = _Writer(folder)
    whole = writer.plain(value)
    return {"objects": writer.objects, "arrays": writer.arrays, "value": whole}


def decode(record: Mapping[str, Any], folder: str | os.PathLike[str] = "") -> Any:
    """Return the value that `encode` wrote for a file in ``folder``; DataError for anything else."""
    file = Entries("", record, ("objects", "arrays", "value"))
    reader = _Reader(
        [_array(f"arrays[{i}]", a) for i, a in enumerate(file.listed("arrays"))], folder
    )
    for i, entry in enumerate(file.listed("objects")):
        reader.objects.append(reader.made(f"objects[{i}]", entry))
    return reader.value("value", record.get("value"))


class _Writer:
    """The text written so far: each object and each array once."""

    def __init__(self, folder: str | os.PathLike[str] | None) -> None:
        self.folder = folder
        self.objects: list[dict[str, Any]] = []
        self.arrays: list[dict[str, Any]] = []
        self._places: dict[int, dict[str, int]] = {}
        self._kept: list[Any] = []  # so that no other object gets the id of one that was written

    def plain(self, value: Any) -> Any:
        """Return a value as JSON holds it; objects and arrays as their places."""
        if value is None or isinstance(value, bool | str):
            return value
        if isinstance(value, np.generic):
            return {"scalar": self._once(value, self.arrays, _array_entry(np.asarray(value)))}
        if isinstance(value, int):
            return value
        if isinstance(value, float):
            return value if math.isfinite(value) else {"float": repr(value)}
        if isinstance(value, list):
            return [self.plain(v) for v in value]
        if isinstance(value, tuple) and type(value) is tuple:
            return {"tuple": [self.plain(v) for v in value]}
        if isinstance(value, dict | types.MappingProxyType):
            return {"table": [[self.plain(k), self.plain(v)] for k, v in value.items()]}
        if id(value) in self._places:
            return self._places[id(value)]
        if isinstance(value, np.ndarray) and value.dtype.kind in _KINDS:
            return {"array": self._once(value, self.arrays, _array_entry(value))}
        if isinstance(value, functools.partial):
            return {"partial": [self.plain(v) for v in (value.func, value.args, value.keywords)]}
        if isinstance(value, types.MethodType):
            return {"method": [self.plain(value.__self__), value.__func__.__name__]}
        return {"object": self._once(value, self.objects, self._object_entry(value))}

    def _once(self, value: Any, places: list[dict[str, Any]], entry: dict[str, Any]) -> int:
        places.append(entry)
        kind = "object" if places is self.objects else "array"
        if not isinstance(value, np.generic):
            self._places[id(value)] = {kind: len(places) - 1}
            self._kept.append(value)
        return len(places) - 1

    def _object_entry(self, value: Any) -> dict[str, Any]:
        kind = type(value)
        name = f"{kind.__module__}.{kind.__qualname__}"
        if not _storable(kind):
            raise CannotBeSavedError(
                f"{checks.shown(value)} cannot be saved: {name} is no dataclass of rtcal's kinds"
            )
        if hasattr(value, "seen_from"):  # a scene, which names files
            whole = value.within(os.getcwd())
            value = whole if self.folder is None else whole.seen_from(self.folder)
        stated = {n: self.plain(getattr(value, n)) for n in _fields(kind)}
        return {"class": name, "fields": stated}


class _Reader:
    """The arrays of a file, and the objects that were made of it so far."""

    def __init__(self, arrays: list[np.ndarray[Any, Any]], folder: str | os.PathLike[str]) -> None:
        self.arrays, self.folder = arrays, folder
        self.objects: list[Any] = []

    def made(self, place: str, entry: Any) -> Any:
        """Return the object of an entry, by the constructor of its class.

        A field that the class got after the file was written has its default.
        """
        name, stated = _pair(place, entry, "class", "fields")
        kind = _class(place, name)
        known = _fields(kind)
        needed = {n for n, f in known.items() if f.default is f.default_factory is MISSING}
        if not isinstance(stated, dict) or not needed <= set(stated) <= set(known):
            raise DataError(
                f"{place}: {name} has the fields {', '.join(sorted(known))}; a file with others is of "
                "another version: calculate the result again"
            )
        try:
            value = kind(**{n: self.value(f"{place}.{n}", v) for n, v in stated.items()})
            return value.within(self.folder) if hasattr(value, "seen_from") else value
        except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError) as error:
            if isinstance(error, DataError):
                raise DataError(f"{place}: {error}") from error
            raise DataError(f"{place}: no {name}: {error}") from error

    def value(self, place: str, plain: Any, level: int = 0) -> Any:
        """Return the value that stands at a place."""
        if level > MAX_LEVELS:
            raise DataError(f"{place}: more than {MAX_LEVELS} levels")
        if plain is None or isinstance(plain, bool | int | float | str):
            return plain
        if isinstance(plain, list):
            return [self.value(f"{place}[{i}]", v, level + 1) for i, v in enumerate(plain)]
        if not isinstance(plain, dict) or len(plain) != 1:
            raise DataError(f"{place} = {checks.shown(plain)} is no value")
        ((kind, inside),) = plain.items()
        if kind == "float" and inside in ("nan", "inf", "-inf"):
            return float(inside)
        if kind in ("object", "array", "scalar"):
            found = self._found(place, self.objects if kind == "object" else self.arrays, inside)
            return found[()] if kind == "scalar" else found
        if isinstance(inside, list):
            values = [self.value(f"{place}[{i}]", v, level + 1) for i, v in enumerate(inside)]
            if kind == "tuple":
                return tuple(values)
            if kind == "table":
                return _table(place, values)
            if kind == "method" and len(values) == 2:
                return _method(place, *values)
            if kind == "partial" and len(values) == 3:
                return _partial(place, *values)
        raise DataError(f"{place} = {checks.shown(plain)} is no value")

    def _found(self, place: str, known: list[Any], number: Any) -> Any:
        if type(number) is not int or not 0 <= number < len(known):
            raise DataError(
                f"{place} = {checks.shown(number)} is none of the {len(known)} before it"
            )
        return known[number]


def _storable(kind: type) -> bool:
    """Return whether a class is a dataclass of rtcal, or derived from one, under its module's name."""
    return (
        dataclasses.is_dataclass(kind)
        and any(base.__module__.startswith(_PACKAGE) for base in kind.__mro__)
        and vars(sys.modules.get(kind.__module__, object)).get(kind.__qualname__) is kind
    )


def _fields(kind: Any) -> dict[str, dataclasses.Field[Any]]:
    """Return the fields that are stored, by name: those of the constructor, but for `NOT_SAVED`."""
    return {f.name: f for f in dataclasses.fields(kind) if f.init and f.metadata != NOT_SAVED}


def _class(place: str, name: Any) -> type:
    """Return the class of a name; DataError unless rtcal stores objects of it."""
    module, _, own = str(name).rpartition(".")
    if module.startswith(_PACKAGE) and module.replace(".", "").replace("_", "").isalnum():
        with suppress(ImportError):
            import_module(module)
    kind = vars(sys.modules.get(module, object)).get(own)
    if not isinstance(kind, type) or not _storable(kind) or kind.__module__ != module:
        raise DataError(
            f"{place}: {checks.shown(name)} is no class that rtcal saves; another version wrote it, or "
            "it stands in a module of your own that is to be imported first"
        )
    return kind


def _pair(place: str, entry: Any, *keys: str) -> tuple[Any, ...]:
    if not isinstance(entry, dict) or set(entry) != set(keys):
        raise DataError(f"{place} = {checks.shown(entry)} does not have the keys {', '.join(keys)}")
    return tuple(entry[key] for key in keys)


def _table(place: str, rows: list[Any]) -> dict[Any, Any]:
    try:
        return dict(rows)
    except (TypeError, ValueError) as error:
        raise DataError(f"{place} is not a list of keys and values") from error


def _method(place: str, owner: Any, name: Any) -> Any:
    if not (_storable(type(owner)) and isinstance(name, str) and not name.startswith("_")):
        raise DataError(f"{place}: {checks.shown(name)} is no method of an object")
    method = getattr(owner, name, None)
    if not isinstance(method, types.MethodType):
        raise DataError(f"{place}: {type(owner).__name__} has no method {checks.shown(name)}")
    return method


def _partial(place: str, function: Any, arguments: Any, keywords: Any) -> Any:
    if not (
        isinstance(function, types.MethodType)
        and isinstance(arguments, tuple)
        and isinstance(keywords, dict)
    ):
        raise DataError(f"{place} is not a method with its first arguments")
    return functools.partial(function, *arguments, **keywords)


def _array_entry(array: np.ndarray[Any, Any]) -> dict[str, Any]:
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    return {
        "type": little.dtype.str,
        "shape": list(array.shape),
        "bytes": base64.b64encode(np.ascontiguousarray(little).tobytes()).decode(),
    }


def _array(place: str, entry: Any) -> np.ndarray[Any, Any]:
    kind, shape, content = _pair(place, entry, "type", "shape", "bytes")
    if not (
        isinstance(kind, str)
        and isinstance(content, str)
        and isinstance(shape, list)
        and all(type(n) is int and n >= 0 for n in shape)
    ):
        raise DataError(f"{place} is no array")
    try:
        dtype = np.dtype(kind)
        if dtype.kind not in _KINDS:
            raise ValueError(f"{kind} is no type of numbers or texts")
        raw = base64.b64decode(content, validate=True)
        array = np.frombuffer(raw, dtype).reshape(shape).astype(dtype.newbyteorder("="))
    except (TypeError, ValueError, binascii.Error, SyntaxError) as error:
        raise DataError(f"{place}: {error}") from error
    array.setflags(write=False)
    return array
