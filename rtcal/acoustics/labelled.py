"""Tables with labels (mappings, pandas): rows are the room's materials, columns its bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.support.errors import DataError
from rtcal.support.text import shortened
from rtcal.support.types import Array


def in_order(place: str, value: Any, materials: Sequence[str], frequencies: Array) -> Any:
    """Return the values of a mapping, DataFrame or Series in the room's order; others as they are.

    A mapping has the materials as keys. Rows are ordered by their labels if these are texts, which have
    to be the materials. Columns are ordered by theirs unless they are 0, 1, 2, ...: they have to be the
    bands, in Hz.

    Raises
    ------
    DataError
        If labels are not the room's materials or bands.
    """
    if isinstance(value, Mapping):
        _places(f"{place}: keys", list(value), list(materials))
        return [value[name] for name in materials]
    index = getattr(value, "index", None)
    if index is None or callable(index) or not hasattr(value, "to_numpy"):
        return value
    array = value.to_numpy()
    if array.shape[:1] == (len(materials),) and any(isinstance(name, str) for name in index):
        array = array[_places(f"{place}: rows", list(index), list(materials))]
    columns = list(getattr(value, "columns", ()))
    if columns != list(range(len(columns))) and len(columns) == len(frequencies):
        place = f"{place}: columns"
        array = array[:, _places(place, [_band(c) for c in columns], frequencies.tolist())]
    return array


def _band(label: object) -> object:
    """Return a column's label as a nominal frequency, or as it is if it is none."""
    try:
        return bands.nominal(float(str(label).removesuffix("Hz")))
    except ValueError:
        return label


def _places(place: str, labels: list[Any], wanted: list[Any]) -> list[int]:
    """Return where each of the wanted labels stands; DataError unless the labels are these."""
    if len(set(labels)) < len(labels) or set(labels) != set(wanted):
        others = shortened(", ".join(str(label) for label in labels), 60)
        needed = shortened(", ".join(f"{label}" for label in wanted), 60)
        raise DataError(f"{place} are {others}; the room has {needed}")
    return [int(np.flatnonzero([label == name for label in labels])[0]) for name in wanted]
