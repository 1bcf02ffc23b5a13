"""Processor time of `find`, control rooms given, against another checkout's, in one run.

    git worktree add ../before fce5b43                # the finder before coefficients were hypotheses
    python -m benchmarks.find_speed --folder out --against ../before

``folder`` has the control rooms of the first world's development rooms
(`python -m benchmarks.second_world controls --world 1 --folder out`).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np


def child(folder: str, rooms: int) -> None:
    """Print seconds of each room: {"one": [...], "all": [...]}."""
    from rtcal.finder import Case, find
    from rtcal.finder.means.engines import ControlRooms
    from tests.hidden_world.generate import read

    warnings.simplefilter("ignore")
    times: dict[str, list[float]] = {"one": [], "all": []}
    for index, plain in enumerate(read(0, "case")):
        kept = Path(folder) / "world1_pop0" / "controls" / f"{index}.npz"
        case = Case.from_dict(plain)
        if len(case.configurations) != 2 or not kept.exists():
            continue
        with np.load(kept) as table:
            made = [ControlRooms(name, table[name].astype(float)) for name in table.files]
        first = case.only("t20", "edt", "t30", configurations=[case.configurations[0].name])
        parts = [ControlRooms(c.engine, c.errors[:, :1]) for c in made]
        for data, which, controls in (("one", first, parts), ("all", case, made)):
            taken = []
            for _ in range(2):
                begin = time.process_time()
                find(which, controls=controls)
                taken.append(time.process_time() - begin)
            times[data].append(min(taken))
        if len(times["all"]) == rooms:
            break
    print(json.dumps(times))


def measured(tree: Path, folder: str, rooms: int) -> dict[str, list[float]]:
    words = [sys.executable, str(Path(__file__).resolve()), "--folder", folder, "--child"]
    done = subprocess.run(
        [*words, "--rooms", str(rooms)],
        capture_output=True,
        text=True,
        check=True,
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree.resolve()), "OPENBLAS_NUM_THREADS": "1"},
    )
    times: dict[str, list[float]] = json.loads(done.stdout.splitlines()[-1])
    return times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", required=True)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--rooms", type=int, default=6)
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        child(given.folder, given.rooms)
        return
    folder = str(Path(given.folder).resolve())
    before = measured(given.against, folder, given.rooms)
    now = measured(Path(__file__).parents[1], folder, given.rooms)
    for data, words in (("one", "one configuration"), ("all", "all data")):
        ratio = np.array(now[data]) / np.array(before[data])
        print(
            f"{words:20} before {np.median(before[data]):.3f} s, now {np.median(now[data]):.3f} s; "
            f"ratio {np.median(ratio):.2f} ({ratio.min():.2f} to {ratio.max():.2f})"
        )


if __name__ == "__main__":
    main()
