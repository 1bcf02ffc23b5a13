"""Results in files: plain numbers for others, and the object itself, which rtcal reads back."""

from __future__ import annotations

import hashlib
import json
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from rtcal.support import objects
from rtcal.support.arguments import checked
from rtcal.support.checks import Entries, json_object
from rtcal.support.errors import DataError
from rtcal.support.files import make_folder, read_text, write_all
from rtcal.support.lazy import __version__


def json_text(record: Mapping[str, Any], *, ascii_only: bool = False) -> str:
    """Return a record as JSON: arrays as lists, tables as one object per row, NaN as null.

    Parameters
    ----------
    record : mapping
        Of numbers, texts, arrays, lists, mappings and None.
    ascii_only : bool
        Whether to write other characters as escapes.

    Examples
    --------
    >>> print(json_text({"t": np.array([1.5, np.nan])}))
    {
     "t": [
      1.5,
      null
     ]
    }
    """
    return json.dumps(_plain(record), indent=1, ensure_ascii=ascii_only, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        if value.dtype.names:  # a table
            return [dict(zip(value.dtype.names, _plain(list(row)), strict=True)) for row in value]
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


NUMBERS = "result.json"
"""Name of a result's file in its folder."""
MAX_BYTES = 2**28
"""Largest size of a file in bytes: control runs of a large room have some 10 MB."""
_OBJECT = "object"
_GONE = {
    "finding 1": "rtcal.find",
    "several effects 1": "rtcal.find with most = 3",
    "verification 1": "rtcal.find and rtcal.finder.verify",
    "where 1": "rtcal.find",
    "where verification 1": "rtcal.find and rtcal.finder.verify",
}
"""Kinds of result that are no longer read, and what makes a new one of the same data."""


class Result(ABC):
    """A result that can be saved and loaded again; it is a frozen dataclass of what it rests on."""

    record_kind: ClassVar[str]
    """Value of the key ``rtcal`` in its file."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return what the result says as plain numbers, lists and text."""

    def to_json(self) -> str:
        """Return the text of its file: the numbers of `to_dict`, and the object itself.

        A result that holds an object of the user's own class, such as a simulator, has its numbers
        alone, and the reason.
        """
        try:
            return self._sealed()
        except objects.CannotBeSavedError as error:
            return _text(self._numbers(), {"not_saved": str(error)})

    def _numbers(self) -> str:
        return json_text({"rtcal": self.record_kind, **self.to_dict()})

    def _sealed(self) -> str:
        """Return the text of the file with the object, its version and the checksum of all."""
        encoded, numbers = objects.encode(self), self._numbers()
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
        place = Path(path)
        if place.suffix != ".json" or place.is_dir():
            place /= NUMBERS
        content = self._sealed().encode()
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
    place = Path(path)
    if place.is_dir():
        place /= NUMBERS
        if not place.exists():
            raise DataError(f"folder {Path(path).resolve()} has no {NUMBERS}; `save` writes one")
    try:
        return loaded(json_object(read_text(place, MAX_BYTES)))
    except DataError as error:
        if str(error).startswith(str(place)):
            raise
        raise DataError(f"{place}: {error}") from error


def loaded(record: Mapping[str, Any]) -> Any:
    """Return the result of a file's content; DataError as `load`, without the file's name."""
    if not isinstance(record.get("rtcal"), str) or _OBJECT not in record:
        raise DataError(
            f'no saved result: it has no "rtcal" and "{_OBJECT}". Files of before rtcal 0.1.0 lack '
            "them: calibrate or search again"
        )
    if "not_saved" in Entries("", record, (), record).entries(_OBJECT, (), record[_OBJECT]):
        raise DataError(f"the result itself is not in it: {record[_OBJECT]['not_saved']}")
    if (again := _GONE.get(record["rtcal"])) is not None:
        raise DataError(
            f'a "{record["rtcal"]}" of an earlier version, which this one does not read: search again '
            f"with {again}"
        )
    inside = Entries(
        f"{_OBJECT}.",
        record[_OBJECT],
        ("version", "sha256", "objects", "arrays", "value"),
    )
    content = {key: inside.values[key] for key in ("objects", "arrays", "value")}
    numbers = {key: value for key, value in record.items() if key != _OBJECT}
    if inside.text("sha256") != _digest(numbers, content):
        raise DataError(
            "it was changed after it was written: change the inputs, and calculate again"
        )
    try:
        result = objects.decode(content)
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
