"""Independent tasks on several workers: threads of this machine, or the workers of a Dask scheduler.

Only this module imports distributed (``rtcal[cluster]``). Both kinds run the same tasks in the same
order. What a task draws belongs to its number, so that results do not depend on the workers.
"""

from __future__ import annotations

import logging
import re
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any
from uuid import uuid4

from rtcal.support import __version__, checks, library
from rtcal.support.errors import ClusterError, RtcalError
from rtcal.support.speed import Progress, cores, single_threaded_blas, thread_pool

_ADDRESS = re.compile(r"(tcp|tls|ucx|wss?)://[^\s/]+:\d+")
_PATIENCE = 10.0
"""Time in s for the scheduler to answer, and for its first worker."""
_WATCHED = 1.0
"""Time in s after which a lost scheduler is noticed."""
_WAITING = 4
"""Tasks that are handed out per worker: the next one begins at once, and memory is bounded."""


@dataclass(frozen=True)
class Workers:
    """Workers that share tasks: ``size`` tasks run at once, and up to ``most`` are handed out."""

    size: int
    most: int
    _submit: Callable[..., Future[Any]]
    _result: Callable[[Future[Any]], Any]
    _follow: Callable[[Callable[[int, int], None]], Callable[[int], Any]]

    def in_order(
        self,
        task: Callable[..., Any],
        jobs: Sequence[Any],
        progress: Progress | None = None,
        *,
        steps: int = 0,
    ) -> Iterator[Any]:
        """Yield ``task(job)`` of each job, in the order of the jobs.

        ``progress`` is called with the number of finished jobs and the number of all jobs; None for no
        calls. If a job has several ``steps``, the task is also given a function to call with the number
        of finished steps of its job, and ``progress`` counts the steps of all jobs.
        """
        finished = dict.fromkeys(range(len(jobs)), 0) if steps else {}

        def step(job: int, done: int) -> None:
            finished[job] = max(finished[job], done)  # a task that is run again counts once
            if progress is not None:
                progress(sum(finished.values()), steps * len(jobs))

        reporter = self._follow(step) if steps else None
        left, waiting = iter(enumerate(jobs)), deque[Future[Any]]()
        try:
            for done in range(1, len(jobs) + 1):
                for number, job in islice(left, self.most - len(waiting)):
                    more = () if reporter is None else (reporter(number),)
                    waiting.append(self._submit(task, job, *more))
                result = self._result(waiting.popleft())
                if progress is not None and not steps:
                    progress(done, len(jobs))
                yield result
        finally:
            for future in waiting:  # of no use any more
                future.cancel()


@contextmanager
def workforce(scheduler: str | None = None, threads: int | None = None) -> Iterator[Workers]:
    """Yield the workers of a Dask scheduler, or else threads of this machine.

    ``scheduler`` is the scheduler's address; None for ``threads`` threads, by default as many as cores.
    A single thread runs each task in the caller's thread, for tasks that use all cores by themselves.

    Raises
    ------
    ClusterError
        For an address of another form, a scheduler that does not answer or has no workers, and later if
        the scheduler is lost or a task ends its workers.
    MissingDependencyError
        If Dask is not installed.
    """
    if scheduler is None:
        with _threads(threads or cores()) as workers:
            yield workers
        return
    address = checked_address(scheduler)
    distributed = library("a scheduler needs Dask: pip install 'rtcal[cluster]'", "distributed")
    # What Dask logs, the errors say.
    silent = distributed.utils.silence_logging_cmgr(logging.CRITICAL)
    with silent, _cluster(distributed, address) as workers:
        yield workers


def checked_address(scheduler: str) -> str:
    """Return the address of a scheduler; ClusterError if it is of another form."""
    if not isinstance(scheduler, str) or not _ADDRESS.fullmatch(scheduler):
        raise ClusterError(
            f"the scheduler {checks.shown(scheduler)} must be an address with a port, such as "
            "tcp://node1:8786, as `dask scheduler` prints it"
        )
    return scheduler


@contextmanager
def _threads(number: int) -> Iterator[Workers]:
    def follow(step: Callable[[int, int], None]) -> Callable[[int], Any]:
        return lambda job: partial(step, job)

    def now(task: Callable[..., Any], *job: Any) -> Future[Any]:
        made: Future[Any] = Future()
        made.set_result(task(*job))
        return made

    # One limit around all tasks.
    with single_threaded_blas():
        if number == 1:
            yield Workers(1, 1, now, Future.result, follow)
            return
        with thread_pool(number) as pool:
            yield Workers(number, _WAITING * number, pool.submit, Future.result, follow)


def _on_worker(version: str, task: Callable[..., Any], job: Any, *reporter: Any) -> Any:
    """Run a task on a worker of the cluster."""
    if version != __version__:
        raise ClusterError(
            f"a worker has rtcal {__version__}, and this machine rtcal {version}: install the same "
            "version on both"
        )
    with single_threaded_blas():
        return task(job, *reporter)


@dataclass(frozen=True)
class _Reporter:
    """What a task on a worker tells its finished steps with."""

    topic: str
    job: int

    def __call__(self, done: int) -> None:
        from distributed import get_worker

        get_worker().log_event(self.topic, (self.job, done))


def _require_answer(address: str) -> None:
    """Wait for a scheduler to answer, for as long as `_PATIENCE`."""
    import asyncio  # 20 ms, which every search would wait for

    from distributed import Security
    from distributed.core import connect

    async def answered() -> None:
        options = Security().get_connection_args("client")
        await (await asyncio.wait_for(connect(address, **options), _PATIENCE)).close()

    asyncio.run(answered())


@contextmanager
def _cluster(distributed: Any, address: str) -> Iterator[Workers]:
    killed = distributed.scheduler.KilledWorker
    try:
        # A client waits for ever where something listens that is no scheduler.
        with thread_pool(1) as probe:
            probe.submit(_require_answer, address).result()
        client = distributed.Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ClusterError(
            f"the scheduler {address} does not answer within {_PATIENCE:g} s: start it with "
            "`dask scheduler`, and give the address that it prints"
        ) from error

    def follow(step: Callable[[int, int], None]) -> Callable[[int], Any]:
        topic = f"rtcal {uuid4()}"
        client.subscribe_topic(topic, lambda event: step(*event[1]))
        return partial(_Reporter, topic)

    def result(future: Future[Any]) -> Any:
        # Dask tells not every future that its scheduler is lost.
        while not future.done() and client.scheduler_comm is connection:
            wait([future], _WATCHED)
        try:
            return future.result(0)
        except RtcalError:
            raise
        except killed as error:
            raise ClusterError(
                f"one task ended several workers of {address}, one after the other, perhaps by its "
                "memory: give each worker more of it, or fewer threads"
            ) from error
        except ImportError as error:
            raise ClusterError(
                f"a worker of {address} lacks a module ({error}): install rtcal there, too, in the "
                "same version"
            ) from error
        except (CancelledError, OSError, TimeoutError) as error:
            raise ClusterError(
                f"the scheduler {address} was lost before the end ({type(error).__name__}): start "
                "it anew, and call again"
            ) from error

    try:
        try:
            client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError as error:
            raise ClusterError(
                f"the scheduler {address} has no workers after {_PATIENCE:g} s: start some with "
                f"`dask worker {address}`"
            ) from error
        size, connection = sum(client.nthreads().values()), client.scheduler_comm
        # It fetches each result at once, so that a worker that ends takes none with it.
        submit = client.get_executor(pure=False).submit
        yield Workers(
            size, _WAITING * size, partial(submit, _on_worker, __version__), result, follow
        )
    finally:
        client.close()
