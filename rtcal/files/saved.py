"""Save results to files and load them: numbers for other programs, and the whole result.

A result is a frozen dataclass of numbers, texts, arrays and other such dataclasses, each written once.
`load` makes them again by their constructors, which check the values. A file holds no code, only names
of rtcal's classes, or of your own classes that derive from one, and the values of their fields.
"""

from __future__ import annotations

import base64
import dataclasses
import json
import math
import os
import sys
from abc import ABC
from collections.abc import Mapping
from contextlib import suppress
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from rtcal.files.disk import json_numbers, json_text, read_text, write_all
from rtcal.files.schema import MADE, RESULT, expecting, json_object
from rtcal.support import __version__, checks
from rtcal.support.blocks import Block, lines, notebook
from rtcal.support.errors import DataError

NUMBERS = "result.json"
"""Name of the result's file in its folder."""
MAX_BYTES = 2**28
"""Largest size of a result's file in bytes; reference simulations of a large room have some 10 MB."""
NOT_SAVED = {"saved": False}
"""Metadata of a dataclass field that is not saved, such as a compiled problem."""
_OBJECT = "object"
_KINDS = "bifcU"  # of arrays: truth values, integers, floats, complex numbers, texts


class CannotBeSavedError(DataError):
    """Report an object that cannot be written to a file, such as a function or your own simulator."""


class Result(ABC):  # some kinds have methods that each of them must have
    """Hold a result that can be saved and loaded again: base of the results that rtcal returns."""

    record_kind: ClassVar[str]
    """Value of the key ``rtcal`` in the result's file, such as "loop 1"."""
    in_file: ClassVar[str] = ""
    """Names of the attributes that `to_dict` writes, some as key=path, such as room=prior.name."""
    words_in: ClassVar[str] = ""
    """Name of the module whose function ``blocks`` makes the printed text of the result."""

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain numbers, lists and text for JSON; a missing value is None."""
        named = (name.partition("=") for name in self.in_file.split())
        return {key: json_numbers(attrgetter(path or key)(self)) for key, _, path in named}

    def blocks(self) -> list[Block]:
        """Return the tables and notes that the result prints."""
        made: list[Block] = import_module(self.words_in).blocks(self) if self.words_in else []
        return made

    def __str__(self) -> str:
        return "\n".join(lines(self.blocks())) or repr(self)

    def _repr_html_(self) -> str | None:
        """Return the tables, shaded, and the notes for a notebook."""
        shown = self.blocks()
        return notebook(repr(self).strip("<>"), shown) if shown else None

    def to_json(self, folder: str | os.PathLike[str] | None = None) -> str:
        """Return the JSON text that `save` writes to the file.

        The text has the numbers of `to_dict` and, for `rtcal.load`, all data of the result. Names of
        other files, such as a room's mesh, are relative to ``folder``; if ``folder`` is None, they are
        absolute paths. A result with an object of your own class, such as a simulator, cannot be loaded
        again: the text then has only the numbers and the reason.
        """
        try:
            return self._text({"objects": plain(self, folder)})
        except CannotBeSavedError as error:
            return self._text({"not_saved": str(error)})

    def _text(self, itself: Mapping[str, Any]) -> str:
        itself = {"version": __version__, **itself}
        numbers = json_text({"rtcal": self.record_kind, **self.to_dict()}).removesuffix("\n}")
        return f'{numbers},\n "{_OBJECT}": {json.dumps(itself, allow_nan=False)}\n}}\n'

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the result as a file that `rtcal.load` reads, and return the path of the file.

        ``path`` is a folder, which gets a ``result.json``, or the name of a file that ends in
        ``.json``. The file is written whole or not at all. Raises DataError if the file cannot be
        written, or if the result has an object that no file can hold.
        """
        place = checks.path("path", path)
        if place.suffix != ".json" or place.is_dir():
            place /= NUMBERS
        content = self._text({"objects": plain(self, place.parent)}).encode()
        write_all({place: content}, place.parent)
        return place


def load(path: str | os.PathLike[str]) -> Any:
    """Return a saved result from its folder or file, as the object that was saved.

    The result, such as a `CalibrationResult`, a `Loop` or a `Finding`, has its room, data and methods,
    and prints the same as when it was saved. Raises DataError if the file is not a result, or if an
    incompatible version of rtcal wrote it.

    Parameters
    ----------
    path : path
        Folder that ``save`` or a command such as ``rtcal calibrate`` wrote, or its ``result.json``.
    """
    place = checks.path("path", path)
    if place.is_dir():
        place /= NUMBERS
        if not place.exists():
            raise DataError(
                f"the folder {path} has no {NUMBERS}, so it holds no saved result. {MADE}"
            )
    with expecting(RESULT, place):
        record = json_object(read_text(place, MAX_BYTES))
        kind, itself = record.get("rtcal"), record.get(_OBJECT)
        if not isinstance(kind, str) or not isinstance(itself, dict):
            raise DataError(
                f'this is not a result that rtcal saved, because "rtcal" and "{_OBJECT}" '
                "are missing. Calculate the result again"
            )
        if "not_saved" in itself:
            raise DataError(
                "the file can be read, but not loaded as a result, because only its numbers could be "
                f"saved: {itself['not_saved']}"
            )
        version = itself.get("version")
        if version != __version__ or set(itself) != {"version", "objects"}:
            other = version not in (None, __version__)
            by = f"rtcal {checks.shown(version)}" if other else "an earlier state of rtcal"
            raise DataError(
                f'this result ("{kind}") was saved by {by}, and rtcal {__version__} cannot '
                "read it. Calculate it again from its data"
            )
        result = restored(itself["objects"], place.parent)
        if not isinstance(result, Result) or result.record_kind != kind:
            raise DataError(
                f'the file is damaged: its "{_OBJECT}" is not of the kind '
                f"{checks.shown(kind)}. Calculate the result again"
            )
        return result


def plain(value: Any, folder: str | os.PathLike[str] | None = None) -> list[Any]:
    """Return a dataclass of rtcal as a list that JSON can hold, from which `restored` makes it again.

    Arrays are text in base64. Names of files are relative to ``folder``, absolute for None. Raises
    CannotBeSavedError for an object that is not one of rtcal's dataclasses.

    >>> from rtcal.acoustics.air import Air
    >>> restored(plain(Air(20.0, 50.0)))
    Air(temperature=20.0, humidity=50.0, pressure=101.325)
    """
    objects: list[Any] = []
    places: dict[int, int] = {}
    written: list[Any] = []  # keeps each object alive, so that no other gets its id

    def of(value: Any) -> Any:
        if isinstance(value, np.generic):
            value = value.item()
        if value is None or isinstance(value, bool | int | str):
            return value
        if isinstance(value, float):
            return value if math.isfinite(value) else {"float": repr(value)}
        if isinstance(value, list):
            return [of(v) for v in value]
        if type(value) is tuple:
            return {"tuple": [of(v) for v in value]}
        if isinstance(value, Mapping):
            return {"table": [[of(k), of(v)] for k, v in value.items()]}
        if id(value) not in places:
            entry = array_of(value) if isinstance(value, np.ndarray) else fields_of(value)
            places[id(value)] = len(objects)
            objects.append(entry)
            written.append(value)
        return {_OBJECT: places[id(value)]}

    def array_of(array: np.ndarray[Any, Any]) -> dict[str, Any]:
        if array.dtype.kind not in _KINDS:
            raise CannotBeSavedError(f"an array of {array.dtype} cannot be saved")
        little = array.astype(array.dtype.newbyteorder("<"), copy=False)
        content = base64.b64encode(np.ascontiguousarray(little).tobytes()).decode()
        return {"dtype": little.dtype.str, "shape": list(array.shape), "content": content}

    def fields_of(value: Any) -> dict[str, Any]:
        kind = type(value)
        name = f"{kind.__module__}.{kind.__qualname__}"
        if not _storable(kind):
            raise CannotBeSavedError(
                f"{checks.shown(value)} cannot be saved, because {name} is not one of "
                "rtcal's dataclasses"
            )
        if hasattr(value, "seen_from"):  # a scene, which names files
            whole = value.within(os.getcwd())
            value = whole if folder is None else whole.seen_from(folder)
        stated = [f for f in dataclasses.fields(kind) if f.init and f.metadata != NOT_SAVED]
        return {"class": name, "fields": {f.name: of(getattr(value, f.name)) for f in stated}}

    of(value)
    return objects


def restored(objects: Any, folder: str | os.PathLike[str] = "") -> Any:
    """Return the object from which `plain` made the list ``objects``."""
    made: list[Any] = []

    def value(entry: Any) -> Any:
        if entry is None or isinstance(entry, bool | int | float | str):
            return entry
        if isinstance(entry, list):
            return [value(v) for v in entry]
        ((kind, inside),) = entry.items()
        if kind == "float" and inside in ("nan", "inf", "-inf"):
            return float(inside)
        if kind == "tuple":
            return tuple(value(inside))
        if kind == "table":
            return {value(k): value(v) for k, v in inside}
        if kind == _OBJECT and type(inside) is int and inside >= 0:
            return made[inside]
        raise ValueError(f"{checks.shown(entry)} is not a value")

    for i, entry in enumerate(objects if isinstance(objects, list) else ()):
        name = entry.get("class", "array") if isinstance(entry, dict) else "object"
        try:
            if "class" not in entry:
                made.append(_array(**entry))
                continue
            one = _class(name)(**{n: value(v) for n, v in entry["fields"].items()})
            made.append(one.within(folder) if hasattr(one, "seen_from") else one)
        except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError) as error:
            raise DataError(f"objects[{i}], {checks.shown(name)}: {error}") from error
    if not made:
        raise DataError("objects must be a list of objects")
    return made[-1]


def _storable(kind: type) -> bool:
    """Return whether a class is a dataclass of rtcal, or derived from one, under its module's name."""
    return (
        dataclasses.is_dataclass(kind)
        and any(base.__module__.startswith("rtcal.") for base in kind.__mro__)
        and vars(sys.modules.get(kind.__module__, object)).get(kind.__qualname__) is kind
    )


def _class(name: Any) -> type:
    """Return the class of a name; ValueError unless rtcal stores objects of it."""
    module, _, own = str(name).rpartition(".")
    if module.startswith("rtcal.") and module.replace(".", "").replace("_", "").isalnum():
        with suppress(ImportError):
            import_module(module)
    kind = vars(sys.modules.get(module, object)).get(own)
    if not isinstance(kind, type) or not _storable(kind) or kind.__module__ != module:
        raise ValueError(
            "not a class that rtcal saves; import the module first if the class is your own"
        )
    return kind


def _array(dtype: str, shape: list[int], content: str) -> np.ndarray[Any, Any]:
    kind = np.dtype(str(dtype))
    if kind.kind not in _KINDS or any(type(n) is not int or n < 0 for n in shape):
        raise ValueError(f"{checks.shown([dtype, shape])} must be an array of numbers or texts")
    values = np.frombuffer(base64.b64decode(content, validate=True), kind).reshape(shape)
    array = values.astype(kind.newbyteorder("="))
    array.setflags(write=False)
    return array
