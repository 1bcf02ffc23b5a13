"""Speed: BLAS limited to one thread, a pool that an error ends, loops that numba compiles.

Only this module imports threadpoolctl and numba (extra ``fast``). Modules of compiled functions
decorate them with `compiled` and are imported only if numba is `available`. Each has a NumPy version,
which is used without numba.

Factoring a matrix of a hundred rows takes less time than waking a second thread. On a machine with
busy cores the second thread also waits for a core, so that `find` takes more than ten times as long
(benchmarks/threads.py).
"""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

_held = threading.Lock()


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Limit BLAS to one thread, as a context or as a decorator.

    OpenBLAS has one limit per process. The outermost context sets and restores it. Contexts inside it
    or in other threads have no effect meanwhile.
    """
    if not _held.acquire(blocking=False):
        yield
        return
    try:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        _held.release()


@contextmanager
def thread_pool(workers: int | None) -> Iterator[ThreadPoolExecutor]:
    """Yield an executor of threads, as many as the machine has cores where ``workers`` is None.

    It is waited for, unless an exception ends the block: then what has not begun is dropped, and what
    has begun ends by itself. Waiting could last for ever. Ctrl-C may strike the main thread while it
    holds a future's lock, and Python never releases a lock taken in that moment.
    """
    pool = ThreadPoolExecutor(workers or os.cpu_count() or 1)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


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
