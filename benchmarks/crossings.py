"""Calls from one file of rtcal into another in a search at every pair: how far its reader must follow.

    python -m benchmarks.crossings               # two to three minutes
    python -m benchmarks.crossings --most 40     # the forty most frequent ones

The room is that of `rtcal example where`, with few paths. Control runs are computed first and handed
over, since they are the simulator's. A call counts where the caller's file and the called one's are
both in rtcal and not the same. A decorator is a file of its own; what NumPy calls is not counted.
"""

from __future__ import annotations

import argparse
import inspect
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import rtcal as rt
from rtcal.datasets.examples import example
from rtcal.finder.positions.search import controls_of

PATHS, RUNS_SEED = 500, 0
PACKAGE = str(Path(rt.__file__).parent) + "/"

Call = tuple[str, str]
"""Caller and called function, each as file:function."""


def counted(run: Callable[[], Any]) -> tuple[Counter[Call], set[str]]:
    """Return the calls between files of rtcal, and the files that are entered at all."""
    calls: Counter[Call] = Counter()
    files: set[str] = set()

    def seen(frame: FrameType, event: str, _: object) -> None:
        function = (
            frame.f_code.co_flags & inspect.CO_OPTIMIZED
        )  # no module or class that is imported
        if event != "call" or not (function and frame.f_code.co_filename.startswith(PACKAGE)):
            return
        here, caller = frame.f_code.co_filename, frame.f_back
        files.add(here)
        if caller is None:
            return
        there = caller.f_code.co_filename
        if there != here and there.startswith(PACKAGE):
            calls[(_name(caller), _name(frame))] += 1

    sys.setprofile(seen)
    try:
        run()
    finally:
        sys.setprofile(None)
    return calls, files


def _name(frame: FrameType) -> str:
    code = frame.f_code
    return f"{code.co_filename.removeprefix(PACKAGE)}:{code.co_name}"


def search(paths: int = PATHS) -> tuple[Counter[Call], set[str]]:
    """Return the calls and the files of a search in the example's room."""
    with tempfile.TemporaryDirectory() as folder:
        for name, content in example("where").files.items():
            Path(folder, name).write_bytes(content)
        room = rt.Room.from_file(str(Path(folder, "room.toml")))
        measured = rt.Measurement.from_file(str(Path(folder, "pairs.csv")))
        case = rt.finder.positions.PositionsCase.from_room(
            room, measured, tracing={"n_paths": paths}
        )
    controls = controls_of(case, RUNS_SEED)
    find = rt.find  # imported before it is counted
    return counted(lambda: find(case, controls=controls))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--most", type=int, default=12, help="lines of the most frequent calls")
    parser.add_argument("--paths", type=int, default=PATHS)
    given = parser.parse_args()
    calls, files = search(given.paths)
    print(f"{calls.total()} calls from one file into another, {len(files)} files entered")
    for (caller, called), number in calls.most_common(given.most):
        print(f"{number:7d}  {caller} -> {called}")


if __name__ == "__main__":
    main()
