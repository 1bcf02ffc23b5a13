"""The one door to numba (extra ``fast``): compiled loops where it is installed.

A module of kernels decorates them with `compiled` and is imported only where `available` says so;
each kernel has a NumPy twin for everywhere else.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


@functools.cache
def available() -> bool:
    """Return whether numba is installed and can be imported."""
    try:
        import numba  # noqa: F401
    except ImportError:
        return False
    return True


def compiled(*, reorder: bool) -> Callable[[Kernel], Kernel]:
    """Return the decorator that compiles a kernel; it runs without the interpreter's lock.

    ``reorder`` lets sums be taken in another order, as vector instructions need; without it every
    operation rounds as written, as compensated sums need. NaN and infinities count in both.
    """
    import numba

    freedom = {"reassoc", "contract", "nsz"} if reorder else False
    decorate: Callable[[Kernel], Kernel] = numba.njit(
        cache=True, nogil=True, fastmath=freedom, error_model="numpy"
    )
    return decorate
