"""A study in pieces on many workers. Finished pieces are kept in a folder, to resume from.

A piece draws from a generator seeded by (seed, number). The result does not depend on the number of
workers, nor on which of them computes what. A kept piece states its study and its number, and has a
checksum. A piece with wrong data is computed again.
"""

from __future__ import annotations

import hashlib
import json
import os
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rtcal.studies.moments import ScoreMoments
from rtcal.support import checks, transaction
from rtcal.support.decode import json_object
from rtcal.support.errors import DataError
from rtcal.support.files import make_folder, read_text, write_bytes, write_text
from rtcal.support.progress import bar as progress_bar
from rtcal.support.threads import thread_pool

IN_FLIGHT = 64
"""Largest number of submitted pieces whose results are not yet collected; it bounds the memory."""
MAX_RECORD = 2**24
"""Largest size of study.json in bytes."""
_MAX_PIECE = 2**20
_MAX_SUMS = 2**20  # bytes, unpacked; a piece has 226 kB


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
        If the folder cannot be written, is damaged, holds another study or one that is running, or
        if ``workers``, ``executor`` or ``folder`` is of the wrong kind.
    MissingDependencyError
        With ``progress`` where tqdm is not installed.
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
            stack.enter_context(transaction.held(store.record))
        pool = stack.enter_context(
            thread_pool(workers) if executor is None else nullcontext(executor)
        )
        bar = stack.enter_context(progress_bar(count, "piece", progress))
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
        packed = zlib.compress(piece.to_bytes())
        write_bytes(self._file(number), self._head(number, packed) + packed)

    def read(self, number: int) -> ScoreMoments | None:
        """Return a finished piece; None if it is missing, damaged or from another study."""
        path = self._file(number)
        try:
            if not path.is_file():  # opening a pipe would block
                return None
            with open(path, "rb") as stream:
                head, _, packed = stream.read(_MAX_PIECE).partition(b"\n")
            if head + b"\n" != self._head(number, packed):
                return None
            return ScoreMoments.from_bytes(zlib.decompressobj().decompress(packed, _MAX_SUMS))
        except (OSError, ValueError, zlib.error):
            return None

    def _file(self, number: int) -> Path:
        return self.folder / f"piece-{number:08d}.sums"

    def _head(self, number: int, packed: bytes) -> bytes:
        """Return a piece's first line: its number, its study and its checksum."""
        head = f"rtcal piece {number} of study {self.study}, sha256 "
        return f"{head}{hashlib.sha256(head.encode() + packed).hexdigest()}\n".encode()


def _open(folder: Path, identity: dict[str, Any]) -> _Store:
    make_folder(folder)
    text = json.dumps(identity, sort_keys=True, indent=1) + "\n"
    store = _Store(folder, hashlib.sha256(text.encode()).hexdigest()[:16])
    transaction.recover([folder])
    if not store.record.exists():
        write_text(store.record, text)
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
