"""Pieces of a study on many workers: in order, resumable, the same whoever computes them.

A piece is known by its number and draws from a generator seeded by (seed, number), so nothing depends
on how many workers there are or which of them does what. Finished pieces may be kept in a folder;
a study that stops, for whatever reason, starts from there.
"""

from __future__ import annotations

import json
import os
import zipfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from rtcal.errors import DataError
from rtcal.studies.moments import Moments
from rtcal.support import checks
from rtcal.support.files import write_bytes, write_text
from rtcal.support.progress import bar as progress_bar

IN_FLIGHT = 64  # pieces handed out and not yet taken back: bounds the memory


def run_pieces(
    compute: Callable[[int], Moments],
    count: int,
    *,
    identity: dict[str, Any],
    executor: Executor | None = None,
    workers: int | None = None,
    folder: str | os.PathLike[str] | None = None,
    progress: bool = False,
) -> Moments:
    """Return the sum of ``compute(0)`` to ``compute(count - 1)``, always added in that order.

    Parameters
    ----------
    compute : callable
        Of a piece's number; picklable where the executor's workers are processes.
    count : int
    identity : dict
        What the pieces are of; kept in the folder, and another study's folder is refused.
    executor : concurrent.futures.Executor, optional
        For example ``dask.distributed.Client(...).get_executor()`` or a ProcessPoolExecutor; it is
        left open. Default: threads, as NumPy releases the interpreter's lock.
    workers : int, optional
        Number of threads; default the cores of the machine.
    folder : path, optional
        Where finished pieces are kept and found again.
    progress : bool
        Show a bar on standard error after two seconds (extra ``studies``).

    Raises
    ------
    DataError
        If the folder cannot be written, is damaged or holds another study, or ``workers``,
        ``executor`` or ``folder`` is of the wrong kind.
    MissingDependencyError
        With ``progress`` where tqdm is not installed.
    """
    if workers is not None:
        checks.whole("workers", workers, 1)
    if executor is not None and (
        isinstance(executor, type) or not callable(getattr(executor, "submit", None))
    ):
        raise DataError(f"executor = {executor!r} is not a concurrent.futures.Executor")
    store = None if folder is None else _open(checks.path("folder", folder), identity)
    total: Moments | None = None
    own = ThreadPoolExecutor(workers or os.cpu_count() or 1) if executor is None else None
    with own or nullcontext(), progress_bar(count, "piece", progress) as bar:
        pool = own if own is not None else executor
        assigned = _hand_out(pool, compute, range(count), store)
        for number, piece in assigned:
            result = piece if isinstance(piece, Moments) else piece.result()
            if store is not None and not isinstance(piece, Moments):
                write_bytes(_file(store, number), result.to_bytes())
            total = result if total is None else total + result
            bar.update(1)
    if total is None:
        raise DataError("a study needs at least one realisation")
    return total


def _hand_out(
    pool: Any, compute: Callable[[int], Moments], numbers: Iterable[int], store: Path | None
) -> Iterator[tuple[int, Moments | Future[Moments]]]:
    """Yield each number with its stored piece or its future, a bounded number of them ahead."""
    waiting: deque[tuple[int, Moments | Future[Moments]]] = deque()
    try:
        for number in numbers:
            stored = None if store is None else _read(_file(store, number))
            waiting.append((number, stored or pool.submit(compute, number)))
            if len(waiting) >= IN_FLIGHT:
                yield waiting.popleft()
        while waiting:
            yield waiting.popleft()
    finally:  # stopped half-way: what has not begun need not
        for _, piece in waiting:
            if not isinstance(piece, Moments):
                piece.cancel()


def _open(folder: Path, identity: dict[str, Any]) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{folder}: {error.strerror or error}") from error
    record, text = folder / "study.json", json.dumps(identity, sort_keys=True, indent=1) + "\n"
    if not record.exists():
        write_text(record, text)
        return folder
    try:
        known = json.loads(record.read_bytes())
    except OSError as error:
        raise DataError(f"{record}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise DataError(
            f"{record} is damaged, so it does not tell what the pieces beside it are of: remove the "
            "folder, or choose another"
        ) from error
    if known != json.loads(text):
        raise DataError(f"{folder} holds another study (see {record.name}); choose another folder")
    return folder


def _file(folder: Path, number: int) -> Path:
    return folder / f"piece-{number:08d}.npz"


def _read(path: Path) -> Moments | None:
    """Return a finished piece, or None where there is none or it is damaged: computed again then."""
    try:
        return Moments.from_bytes(path.read_bytes())
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
