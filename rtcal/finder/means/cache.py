"""Control rooms kept in a folder, so that they are simulated once per case.

A file holds the rooms of one engine. Its name is a hash of everything that they depend on: the case,
the seed, the engine and the version of rtcal. The folder can be deleted at any time.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path

from rtcal.errors import DataError
from rtcal.finder.case import Case
from rtcal.finder.means.bootstrap import checked_controls, checked_engines
from rtcal.finder.means.engines import ENGINES, ControlRooms
from rtcal.support import checks, kept_arrays
from rtcal.support.arguments import checked
from rtcal.support.progress import TaskProgress
from rtcal.support.threads import single_threaded_blas
from rtcal.support.version import __version__

FOLDER = ".rtcal_cache"
"""Name of the folder beside a case's file; `support.transaction` removes those named ``.rtcal-*``."""


@single_threaded_blas()
@checked
def cached_control_rooms(
    case: Case,
    folder: str | os.PathLike[str],
    seed: int = 0,
    engines: Sequence[str] = ("path tracing", "network"),
    progress: TaskProgress | None = None,
) -> tuple[ControlRooms, ...]:
    """Return the case's control rooms: read from the folder, or simulated and written there.

    If a file cannot be read or written, the rooms are simulated without an error.

    Parameters
    ----------
    case : Case
    folder : path
    seed, engines, progress
        As for `rtcal.finder.control_rooms`.

    Raises
    ------
    DataError
        For fewer than two engines, or an engine that rtcal lacks.
    """
    checks.whole("seed", seed, 0)
    where, rooms = checks.path("folder", folder), []
    for name in checked_engines(engines):
        path = where / f"{_key(case, seed, name)}.array"
        controls = _read(path, case, name)
        if controls is None:
            controls = ENGINES[name].run(case, seed, progress)
            kept_arrays.write(path, controls.errors)
        rooms.append(controls)
    return tuple(rooms)


def _key(case: Case, seed: int, engine: str) -> str:
    content = json.dumps([case.to_dict(), seed, engine, __version__], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:32]


def _read(path: Path, case: Case, engine: str) -> ControlRooms | None:
    errors = kept_arrays.read(path)
    if errors is None:
        return None
    try:
        return checked_controls(case, [ControlRooms(engine, errors)], least=1)[0]
    except DataError:
        return None
