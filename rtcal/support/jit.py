"""Compiled loops by numba (extra ``fast``), which only this module imports.

Modules of compiled functions decorate them with `compiled` and are imported only if numba is
`available`. Each has a NumPy version, which is used without numba.
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
    """Return the decorator that compiles a function; it runs without the interpreter's lock.

    ``reorder`` allows the compiler to reorder sums, which vector instructions need. Compensated sums
    need it to be False. NaN and infinities are handled correctly in both cases.
    """
    import numba

    freedom = {"reassoc", "contract", "nsz"} if reorder else False
    decorate: Callable[[Kernel], Kernel] = numba.njit(
        cache=True, nogil=True, fastmath=freedom, error_model="numpy"
    )
    return decorate
