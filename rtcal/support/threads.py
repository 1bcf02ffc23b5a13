"""Threads: BLAS limited to one (only this module imports threadpoolctl); a pool that an error ends.

Factoring a matrix of a hundred rows takes less time than waking a second thread. On a machine with
busy cores the second thread also waits for a core, so that `find` takes more than ten times as long
(benchmarks/threads.py).
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

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
