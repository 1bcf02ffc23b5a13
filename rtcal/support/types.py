"""The types of arrays and of paths, and arrays that cannot be changed."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Paths: TypeAlias = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

_Scalar = TypeVar("_Scalar", bound=np.generic)


def read_only(values: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """Return a read-only copy, through which a function cannot change its caller's values.

    Examples
    --------
    >>> read_only(np.ones(2)).flags.writeable
    False
    """
    copy = values.copy()
    copy.setflags(write=False)
    return copy


def read_only_view(values: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """Return a read-only view, which shows later changes of the original and copies nothing."""
    view = values.view()
    view.setflags(write=False)
    return view


def put(frozen: object, **values: object) -> None:
    """Set fields of an object of a frozen dataclass, as its own constructor does."""
    for name, value in values.items():
        object.__setattr__(frozen, name, value)
