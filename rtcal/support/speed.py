"""Long computations: BLAS on one thread, a pool that an error ends, compiled loops, the progress bar.

Only this module imports threadpoolctl, numba and tqdm. Modules of compiled functions decorate them
with `compiled`, and are imported where they are first used.

Factoring a matrix of a hundred rows takes less time than waking a second thread. On a machine with
busy cores the second thread also waits for a core, so that `find` takes more than ten times as long
(benchmarks/threads.py in commit 2621e9c7).
"""

from __future__ import annotations

import io
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

from rtcal.support.text import width

_lock = threading.Lock()
_held: list[Any] = []


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Limit BLAS to one thread, as a context or as a decorator.

    OpenBLAS has one limit per process. The first context of all threads sets it, and the last one
    restores it.
    """
    from threadpoolctl import threadpool_limits

    with _lock:
        _held.append(_held[0] if _held else threadpool_limits(1, user_api="blas"))
    try:
        yield
    finally:
        with _lock:
            limit = _held.pop()
            if not _held:
                limit.restore_original_limits()


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # a batch system gives a job some of a machine's
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def thread_pool(workers: int | None) -> Iterator[ThreadPoolExecutor]:
    """Yield an executor of threads, ``workers`` of them or, if it is None, as many as `cores`.

    At the end of the block the executor waits for all tasks. If an exception ends the block, tasks that
    have not begun are dropped, and the others end by themselves without being waited for.
    """
    # Waiting could last for ever: Ctrl-C may strike the main thread while it holds a future's lock, and
    # Python never releases a lock taken in that moment.
    pool = ThreadPoolExecutor(workers or cores())
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])


def compiled(*, reorder: bool, inner: bool = False) -> Callable[[_Kernel], _Kernel]:
    """Return the decorator that compiles a function, which then runs without the interpreter's lock.

    ``reorder`` allows the compiler to reorder sums, which vector instructions need; for compensated
    sums it must be False. NaN and infinities are handled correctly in both cases. ``inner`` is True for
    a function that only compiled functions call: Python cannot call it then, and it takes less time to
    compile. The compiled function is kept on disk; if no folder can be written, it is compiled in every
    run.
    """
    import numba

    freedom = {"reassoc", "contract", "nsz"} if reorder else False
    # Without the entry for C, which nothing uses, compiling takes a seventh less.
    entries = {"no_cfunc_wrapper": True, "no_cpython_wrapper": inner}
    made = numba.njit(nogil=True, fastmath=freedom, error_model="numpy", **entries)

    def decorate(kernel: _Kernel) -> _Kernel:
        dispatcher = made(kernel)
        with suppress(RuntimeError):
            dispatcher.enable_caching()
        kept: _Kernel = dispatcher
        return kept

    return decorate


Progress = Callable[[int, int], None]
"""Function that is called with the numbers of finished and of all steps."""
TaskProgress = Callable[[str, int, int], None]
"""Function that is called with the name of the task, and the numbers of finished and of all steps."""

DELAY = 2.0
"""Delay in seconds; shorter tasks show no bar."""
PATIENCE = 10.0
"""Time in seconds after which a task without a bar says how far it is; each further wait is doubled."""
_BAR = "{desc}{n_fmt}/{total_fmt} {unit}s |{bar}| {elapsed} passed, about {remaining} left"
_IN_WORDS = "{desc}{n_fmt} of {total_fmt} {unit}s done in {elapsed}, about {remaining} left"


@contextmanager
def bar(
    count: int, unit: str, wanted: bool, say: Callable[[str], None] | None = None
) -> Iterator[Any]:
    """Yield tqdm's progress bar of ``count`` steps on standard error; call its ``update(1)`` per step.

    ``unit`` is the name of a step. The bar appears after two seconds and shows how long the rest will
    take. If ``wanted`` is False there is no bar, as for a log: the function ``say`` is called with the
    progress in words after ten seconds, 30, 70 and so on, and then at the end; None calls nothing.
    """
    from tqdm import tqdm

    if wanted or say is None:
        shown = tqdm(
            total=count,
            unit=unit,
            smoothing=0.05,
            delay=DELAY,
            ncols=width(),
            bar_format=_BAR,
            disable=not wanted,
        )
        with shown:
            yield shown
        return
    ended = threading.Event()
    unseen = tqdm(total=count, unit=unit, file=io.StringIO(), bar_format=_IN_WORDS)

    printed: int | None = None  # finished steps in the last line

    def state() -> str:
        nonlocal printed
        printed = unseen.n
        return str(unseen).replace(f" of 1 {unit}s", f" of 1 {unit}").replace(", about ? left", "")

    def log() -> None:
        patience = PATIENCE
        while not ended.wait(patience):
            say(state() if unseen.total else f"no {unit} is done yet")
            patience *= 2

    logger = threading.Thread(target=log, daemon=True)
    logger.start()
    try:
        yield unseen
    finally:
        ended.set()
        logger.join()
        if printed is not None and unseen.n > printed:
            say(state().replace(", about 00:00 left", ""))
        unseen.close()


def following(shown: Any) -> Progress:
    """Return a function that moves a bar to the number of finished steps."""
    return lambda done, _: shown.update(done - shown.n)
