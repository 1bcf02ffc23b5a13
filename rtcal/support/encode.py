"""Records to JSON text."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np


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
