"""Slow and plain NumPy, against which compiled loops are tested."""

from contextlib import AbstractContextManager
from inspect import isfunction
from types import ModuleType
from unittest.mock import patch


def in_place_of(kernels: ModuleType, reference: ModuleType) -> AbstractContextManager[object]:
    """Run a reference's functions in place of the compiled ones of the same names."""
    own = {n: f for n, f in vars(reference).items() if isfunction(f) and hasattr(kernels, n)}
    return patch.multiple(kernels, **own)
