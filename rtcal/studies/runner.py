"""A study in pieces on many workers. Finished pieces are kept in a folder, to resume from.

A piece draws from a generator seeded by (seed, number). The result does not depend on the number of
workers, nor on which of them computes what. A kept piece states its study and its number, and has a
checksum. A piece with wrong data is computed again.

The sums over realisations, from which scores, standard errors and box plots are calculated, do not
grow with the number of rooms, so neither does the study's memory.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.files import disk
from rtcal.files.disk import make_folder, read_text, write_bytes
from rtcal.files.schema import json_object
from rtcal.studies.paper import CALIBRATIONS, METHODS
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.speed import bar as progress_bar
from rtcal.support.speed import thread_pool
from rtcal.support.types import Array


def write_table(table: np.recarray[Any, Any], path: str | os.PathLike[str]) -> None:
    """Write a table as .csv, whole or not at all; numbers keep all their digits.

    Raises
    ------
    DataError
        If the path has another ending or cannot be written, or ``table`` is no table.
    """
    ending = checks.path("path", path).suffix.lower()
    if not isinstance(table, np.ndarray) or table.dtype.names is None or table.ndim != 1:
        raise DataError("table is not a table of named columns, such as Study.scores returns")
    if ending != ".csv":
        raise DataError(f'{path}: a table ends with .csv, not "{ending}"')
    write_bytes(path, table_csv(table))


def table_csv(table: np.recarray[Any, Any]) -> bytes:
    """Return a table as the bytes of a CSV file; numbers keep all their digits."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(table.dtype.names)
    writer.writerows(table.tolist())
    return stream.getvalue().encode()


SAMPLED = METHODS + tuple(f"{m} bounded" for m in CALIBRATIONS)
ANALYTIC = tuple(f"{m} analytic" for m in METHODS)
SERIES = SAMPLED + ANALYTIC
"""Names of the eleven EMSE that each realisation has."""

EDGES = np.linspace(0.0, 0.5, 4001)  # of sqrt(EMSE); the last bin holds all larger values


@dataclass(frozen=True, eq=False)
class ScoreMoments:
    """Sums over realisations.

    ``count`` is the number of realisations, ``active`` the number of trials with an active bound,
    by calibration. ``sums`` are those of the series, ``products`` those of each pair of series. The
    sampled series also have a histogram of sqrt(EMSE) and its extremes.
    """

    count: int
    sums: Array
    products: Array
    active: Array
    histogram: Array
    least: Array
    most: Array

    @classmethod
    def of(cls, emse: Array, active: Array) -> ScoreMoments:
        """Sum up the series of some realisations, (r, 11), and their active trials, (r, 3)."""
        root = np.sqrt(emse[:, : len(SAMPLED)])
        bins = np.minimum(np.searchsorted(EDGES, root, side="right") - 1, EDGES.size - 2)
        histogram = np.stack([np.bincount(b, minlength=EDGES.size - 1) for b in bins.T])
        return cls(
            count=len(emse),
            sums=emse.sum(0),
            products=np.einsum("ri,rj->ij", emse, emse),
            active=active.sum(0).astype(float),
            histogram=histogram.astype(float),
            least=root.min(0),
            most=root.max(0),
        )

    def __add__(self, other: ScoreMoments) -> ScoreMoments:
        return ScoreMoments(
            self.count + other.count,
            self.sums + other.sums,
            self.products + other.products,
            self.active + other.active,
            self.histogram + other.histogram,
            np.minimum(self.least, other.least),
            np.maximum(self.most, other.most),
        )

    def mean(self, weights: dict[str, float]) -> float:
        """Return the mean over realisations of a weighted sum of series."""
        return float(_vector(weights) @ self.sums / self.count)

    def score(self, method: dict[str, float], baseline: dict[str, float]) -> tuple[float, Array]:
        """Return 1 - sqrt(mean method / mean baseline) and its gradient by the series' means."""
        top, bottom = self.mean(method), self.mean(baseline)
        if top == 0:  # exact in every realisation: there is no error to propagate
            return 1.0, np.zeros(len(SERIES))
        ratio = np.sqrt(top / bottom)
        gradient = -ratio / 2 * (_vector(method) / top - _vector(baseline) / bottom)
        return float(1 - ratio), gradient

    def standard_error(self, gradient: Array) -> float:
        """Return the standard error of a smooth function of the means with that gradient.

        The delta method on independent realisations; NaN for a single one.
        """
        if self.count < 2:
            return float("nan")
        means = self.sums / self.count
        covariance = self.products / self.count - np.outer(means, means)
        variance = float(gradient @ covariance @ gradient) / (self.count - 1)
        return float(max(variance, 0.0) ** 0.5)

    def quantile(self, series: int, share: float) -> float:
        """Return a quantile of sqrt(EMSE) of a sampled series, to a histogram bin (1.25e-4)."""
        running = np.cumsum(self.histogram[series])
        return float(np.interp(share * running[-1], np.concatenate([[0.0], running]), EDGES))


def _vector(weights: dict[str, float]) -> Array:
    return np.array([weights.get(name, 0.0) for name in SERIES])


IN_FLIGHT = 64
"""Largest number of submitted pieces whose results are not yet collected; it bounds the memory."""
MAX_RECORD = 2**24
"""Largest size of study.json in bytes."""
_MAX_PIECE = 2**20


def run_pieces(
    compute: Callable[[int], ScoreMoments],
    count: int,
    *,
    identity: dict[str, Any],
    executor: Executor | None = None,
    workers: int | None = None,
    folder: str | os.PathLike[str] | None = None,
    progress: bool = False,
) -> ScoreMoments:
    """Return the sum of ``compute(0)`` to ``compute(count - 1)``, always added in that order.

    Parameters
    ----------
    compute : callable
        Computes the piece of a number. It must be picklable if the executor's workers are processes.
    count : int
    identity : dict
        Parameters of the study. They are kept in the folder; the folder of another study is refused.
    executor : concurrent.futures.Executor, optional
        For example ``dask.distributed.Client(...).get_executor()`` or a ProcessPoolExecutor; it is
        left open. Default: threads, as NumPy releases the interpreter's lock.
    workers : int, optional
        Number of threads; default the cores of the machine.
    folder : path, optional
        Folder of the finished pieces.
    progress : bool
        Show a bar on standard error after two seconds (extra ``studies``).

    Raises
    ------
    DataError
        If the folder cannot be written, is damaged, holds another study, or
        if ``workers``, ``executor`` or ``folder`` is of the wrong kind.
    """
    if workers is not None:
        checks.whole("workers", workers, 1)
    if executor is not None and (
        isinstance(executor, type) or not callable(getattr(executor, "submit", None))
    ):
        raise DataError(f"executor = {executor!r} is not a concurrent.futures.Executor")
    total: ScoreMoments | None = None
    with ExitStack() as stack:
        store = None
        if folder is not None:
            store = _open(checks.path("folder", folder), identity)
        pool = stack.enter_context(
            thread_pool(workers) if executor is None else nullcontext(executor)
        )
        wanted = checks.flag("progress", progress)
        bar = stack.enter_context(progress_bar(count, "piece", wanted))
        for number, piece in _hand_out(pool, compute, range(count), store):
            result = piece if isinstance(piece, ScoreMoments) else piece.result()
            if store is not None and not isinstance(piece, ScoreMoments):
                store.write(number, result)
            total = result if total is None else total + result
            bar.update(1)
    if total is None:
        raise DataError("a study needs at least one realisation")
    return total


def _hand_out(
    pool: Any, compute: Callable[[int], ScoreMoments], numbers: Iterable[int], store: _Store | None
) -> Iterator[tuple[int, ScoreMoments | Future[ScoreMoments]]]:
    """Yield each number with its stored piece or its future, a bounded number of them ahead."""
    waiting: deque[tuple[int, ScoreMoments | Future[ScoreMoments]]] = deque()
    try:
        for number in numbers:
            stored = None if store is None else store.read(number)
            waiting.append((number, stored or pool.submit(compute, number)))
            if len(waiting) >= IN_FLIGHT:
                yield waiting.popleft()
        while waiting:
            yield waiting.popleft()
    finally:  # after an error, pieces that have not begun are cancelled
        for _, piece in waiting:
            if not isinstance(piece, ScoreMoments):
                piece.cancel()


@dataclass(frozen=True)
class _Store:
    """The folder of a study's finished pieces; ``study`` is a digest of its parameters."""

    folder: Path
    study: str

    @property
    def record(self) -> Path:
        return self.folder / "study.json"

    def write(self, number: int, piece: ScoreMoments) -> None:
        stream = io.BytesIO()
        np.savez_compressed(stream, **vars(piece))
        disk.write(self._file(number), np.frombuffer(stream.getvalue(), np.uint8))

    def read(self, number: int) -> ScoreMoments | None:
        """Return a finished piece; None if it is missing, damaged or from another study."""
        kept = disk.read(self._file(number), _MAX_PIECE)
        if kept is None:
            return None
        with np.load(io.BytesIO(kept.tobytes())) as sums:
            return ScoreMoments(**{**sums, "count": int(sums["count"])})

    def _file(self, number: int) -> Path:
        return self.folder / f"piece-{number:08d}-{self.study}.sums"


def _open(folder: Path, identity: dict[str, Any]) -> _Store:
    make_folder(folder)
    text = json.dumps(identity, sort_keys=True, indent=1) + "\n"
    store = _Store(folder, hashlib.sha256(text.encode()).hexdigest()[:16])
    if not store.record.exists():
        disk.replace_file(store.record, text.encode())
        return store
    try:
        stored = json_object(read_text(store.record, MAX_RECORD))
    except DataError as error:
        raise DataError(
            f"{store.record} is damaged, so it does not tell what the pieces beside it are of: remove "
            "the folder, or choose another"
        ) from error
    if stored != json.loads(text):
        raise DataError(
            f"{folder} holds another study (see {store.record.name}); choose another folder"
        )
    return store
