"""The one door to threadpoolctl: BLAS with one thread where matrices are small.

To factor a matrix of a hundred rows takes less time than to wake a second thread. On a machine with
busy cores the second thread also waits for a core: `find` then takes ten times as long and more
(benchmarks/threads.py).
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

_held = threading.Lock()


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Hold BLAS to one thread, as a context or as a decorator.

    OpenBLAS has one limit per process. The first context sets and restores it; contexts inside it, and
    those of other threads meanwhile, change nothing.
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
