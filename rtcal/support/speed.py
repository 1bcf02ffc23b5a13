"""Long computations: BLAS on one thread, a pool that an error ends, compiled loops, the progress bar.

Only this module imports threadpoolctl, numba and tqdm. Modules of compiled functions decorate them
with `compiled`, and are imported where they are first used.

Factoring a matrix of a hundred rows takes less time than waking a second thread. On a machine with
busy cores the second thread also waits for a core, so that `find` takes more than ten times as long
(benchmarks/threads.py).
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

from rtcal.support.errors import MissingDependencyError
from rtcal.support.text import width

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


Progress = Callable[[int, int], None]
"""Called with the number of finished steps and their total."""
TaskProgress = Callable[[str, int, int], None]
"""Called with what is computed, the number of finished steps and their total."""

DELAY = 2.0
"""Delay in seconds; shorter tasks show no bar."""


PATIENCE = 10.0
"""Time in seconds after which a step without a bar says once what it does, and how long it may take."""


def bar(count: int, unit: str, wanted: bool, say: Callable[[str], None] | None = None) -> Any:
    """Return a bar of ``count`` steps on standard error, to be entered and ``update(1)``-d.

    It appears after two seconds and says how long the rest will take. Without ``wanted`` there is no
    bar: after ten seconds ``say`` is called once with the same in words, for a log. Raises
    MissingDependencyError if tqdm is not installed.
    """
    if not wanted:
        return _NoBar() if say is None else _Said(count, unit, say)
    try:
        from tqdm import tqdm
    except ImportError as error:
        raise MissingDependencyError(
            "the progress bar needs tqdm: pip install 'rtcal[studies]'"
        ) from error
    return tqdm(
        total=count,
        unit=unit,
        smoothing=0.05,
        delay=DELAY,
        ncols=width(),
        bar_format="{desc}{n_fmt}/{total_fmt} {unit}s |{bar}| {elapsed} passed, about {remaining} left",
    )


def following(shown: Any) -> Progress:
    """Return what moves a bar to the number of finished steps."""
    last = 0

    def progress(done: int, _: int) -> None:
        nonlocal last
        shown.update(done - last)
        last = done

    return progress


class _Said:
    """Says once, after `PATIENCE`, how many steps are done and how long the others may take.

    If not one is done by then, it says so, and the time when the first is. What follows the last step
    is a step of its own.
    """

    def __init__(self, count: int, unit: str, say: Callable[[str], None]) -> None:
        self.unit, self.say, self.what = unit, say, ""
        self.reset(count)

    def reset(self, total: int) -> None:
        self._stop()
        self.total, self.done, self.asked, self.told = total, 0, False, False
        self.begun = time.monotonic()
        self._wait(self._ask)

    _entered = False
    _timer: threading.Timer | None = None

    def set_description(self, text: str) -> None:
        self.what = f"{text}: "

    def __enter__(self) -> _Said:
        self._entered = True
        self.reset(self.total)
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()

    def update(self, steps: int) -> None:
        self.done += steps
        if self.asked and not self.told:
            self._tell()
        if 0 < self.total <= self.done:
            self._stop()
            self._wait(self._rest)

    def _wait(self, then: Callable[[], None]) -> None:
        self._timer = threading.Timer(PATIENCE, then)
        self._timer.daemon = True
        if self._entered:
            self._timer.start()

    def _rest(self) -> None:
        self.say(f"{self.what}what follows the {self.unit}s takes more than {PATIENCE:g} s")

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _ask(self) -> None:
        self.asked = True
        if self.done:
            self._tell()
            return
        of_all = f" of {self.total}" if self.total > 1 else ""
        first = "" if self.total == 1 else "first "
        self.say(f"{self.what}the {first}{self.unit}{of_all} takes more than {PATIENCE:g} s")

    def _tell(self) -> None:
        self.told = True
        passed = time.monotonic() - self.begun
        if not self.done < self.total:
            return
        left = passed / self.done * (self.total - self.done)
        self.say(
            f"{self.what}{self.done} of {self.total} {self.unit}s in {_duration(passed)}, about "
            f"{_duration(left)} left"
        )


def _duration(seconds: float) -> str:
    """Return a duration in s, min or h.

    Examples
    --------
    >>> _duration(12.3), _duration(150), _duration(9000)
    ('12 s', '2.5 min', '2.5 h')
    """
    for unit, length in (("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.1f} {unit}"
    return f"{seconds:.0f} s"


class _NoBar:
    def __enter__(self) -> _NoBar:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def update(self, _: int) -> None:
        pass
