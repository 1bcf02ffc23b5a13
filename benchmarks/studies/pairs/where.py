"""The verdicts of `finder.positions` on rooms that hide something at a place that nobody stated.

    # can be resumed
    python -m benchmarks.studies.pairs.where run --folder out --number 40 --statement "in situ"
    # at held-out pairs, the same rooms
    python -m benchmarks.studies.pairs.where gaps --folder out --number 40
    # means over positions, the same rooms
    python -m benchmarks.studies.pairs.where means --folder out --number 40
    python -m benchmarks.studies.pairs.where table --statement "in situ"
    python -m benchmarks.studies.pairs.where store --folder out  # the run that the study shows

studies/geometric_world describes the rooms. Each is judged on T20, EDT, C80 and Ts ("without level"),
and with G beside them ("level"). Control runs and weighings are kept in the folder's `controls`, so
that another run of a room takes seconds. `means` is `rtcal.find` on the same values, without
a geometry.

The gap is at held-out pairs, in JND: `rtcal.finder.verify` fits on half of the pairs and predicts the
other half, and the other way round. It is judged where the effect changes T by over 10 % and something
was added; the gap to what is heard, without the measurement's noise, stands beside it.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks.studies.geometric_world.load import (
    HANDBOOK,
    IN_SITU,
    load,
    stored,
    truth,
    without_noise,
)
from benchmarks.studies.means.judging import FLAGS, rounded, row_of
from benchmarks.studies.pairs.where_figures import DATA, LARGE, MODELS, ROOMS, table
from benchmarks.studies.stored import Row, path, plain, resume, rows, write
from rtcal.acoustics.marks import gap_jnd
from rtcal.finder.positions.search import of_means
from rtcal.finder.search import find

PATHS = 8000
"""From each source: the default of `PathTracing`."""
STATEMENTS = IN_SITU, HANDBOOK
MATCH = ("t20", "edt", "c80", "ts", "level")
PRESENT = "sixth"
"""The largest set of rooms that one finder judged."""


def population_of(which: str) -> int:
    """Return the population that rooms ``which`` of `ROOMS` belong to."""
    return {"eleventh": 3, "sixth": 3, "first": 1}.get(which, 4)


def stored_in(which: str) -> Path:
    """Return the file that has the rows of rooms ``which``."""
    return path("geometric_world", population_of(which), "results")


@dataclass(frozen=True)
class Judging:
    """Rooms of a population, the statement of their coefficients, and the folder of what is kept."""

    population: int
    statement: str
    folder: Path
    paths: int = PATHS

    @property
    def cache(self) -> Path:
        return self.folder / "controls"

    def case(self, index: int, data: str) -> rt.finder.PositionsCase:
        room, level = load(self.population, index, self.statement), data == "level"
        return rt.finder.PositionsCase(
            simulator=room.simulator(n_paths=self.paths),
            measured=room.measured if level else room.without_level(),
            match=MATCH if level else MATCH[:-1],
        )

    def file(self, step: str) -> Path:
        return self.folder / f"{step}_{self.population}_{self.statement.replace(' ', '_')}.jsonl"


def judged(judging: Judging, index: int, data: str) -> Row:
    """Return what `rtcal.find` claims of a room."""
    case = judging.case(index, data)
    clock, processor = time.perf_counter(), time.process_time()
    finding = rt.find(case, cache=judging.cache)
    face, best = truth(judging.population, index)["surface"], finding.best
    names = [name for name, faces in case.faces.items() if face in faces]
    return {
        "seconds": time.perf_counter() - clock,
        "processor": time.process_time() - processor,
        "n_surfaces": len(case.faces),
        "n_bands": len(case.measured.centre_frequencies),
        "verdict": finding.verdict,
        "effect": finding.effect,
        "family": finding.family,
        "surface": finding.surface,
        "true_surface": names[0] if names else None,
        "surfaces": rounded(finding.surfaces),
        "likely": list(finding.likely_surfaces),
        "best": best
        and {
            **{k: getattr(best, k) for k in ("effect", "family", "surface", "place")},
            "size": [best.size, best.low, best.high],
        },
        "probabilities": rounded(finding.probabilities),
        "families": rounded(finding.families),
        "score": float(finding.score),
        "threshold": float(finding.threshold),
        "nats_of_noise": finding.detection.noise,
        "nats_of_means": finding.detection.means,
    }


def verified(judging: Judging, index: int, data: str) -> Row:
    """Return the mean gaps at held-out pairs in JND, to what was measured and to what is heard.

    What is heard has no noise. Rooms whose T changes little, and findings that add nothing to a
    surface, have none; those of `run` that flagged nothing are not made again.
    """
    none: Row = {"gaps": {}, "gaps_heard": {}}
    made = {(r["index"], r["data"]): r["verdict"] for r in rows(judging.file("run"))}
    small = truth(judging.population, index)["effect_on_t"] <= LARGE
    if small or made.get((index, data), FLAGS[0]) not in FLAGS:
        return none
    finding = rt.find(judging.case(index, data), cache=judging.cache)
    if not finding.can_be_added:
        return none
    gaps = rt.finder.verify(finding, cache=judging.cache).gaps.mean(axis=1)
    scale, off = noise(finding, without_noise(judging.population, index))
    return {
        key: {m: float(np.nanmean(np.abs(g))) for m, g in zip(MODELS, gap, strict=True)}
        for key, gap in (("gaps", gaps), ("gaps_heard", scale * gaps + off))
    }


def noise(finding: Any, heard: rt.Measurement) -> tuple[np.ndarray, np.ndarray]:
    """Return measured over heard, in which a gap's JND differ, and their gap in JND.

    Both (n_parameters, n_pairs, n_bands).
    """
    scale, off = [], []
    for name in finding.parameters:
        key = "g" if name == "level" else name
        value, true = (
            m.values[key][[m.pairs.index(p) for p in finding.pairs]]
            for m in (finding.case.measured, heard)
        )
        scale.append(value / true if name in ("t20", "edt") else np.ones_like(value))
        off.append(gap_jnd(value, true, key))
    return np.array(scale), np.array(off)


def means_only(judging: Judging, index: int, data: str) -> Row:
    """Return what the finder without a geometry claims of the same measurement."""
    return row_of(find(of_means(judging.case(index, data)), cache=judging.cache))


STEPS: dict[str, Callable[[Judging, int, str], Row]] = {
    "run": judged,
    "gaps": verified,
    "means": means_only,
}
"""What is made of a room, by the name of its command and of its file of rows."""


def made_of(judging: Judging, step: str, index: int, data: str) -> Row:
    """Return the row of a room as it is kept."""
    return {"index": index, "data": data, **plain(STEPS[step](judging, index, data), 4)}


def results(judging: Judging) -> tuple[list[Row], list[Row]]:
    """Return the rows of a run: in the geometry, with their gaps, and of means."""
    gaps = {row["job"]: row for row in rows(judging.file("gaps"))}
    found = [{**row, **gaps.get(row["job"], {})} for row in rows(judging.file("run"))]
    return found, rows(judging.file("means"))


def kept(statement: str, which: str = PRESENT) -> tuple[list[Row], list[Row]]:
    """Return the stored rows of some of the rooms (`ROOMS`), as `results` does."""
    chosen = [
        r for r in rows(stored_in(which)) if (r["statement"], r["rooms"]) == (statement, which)
    ]
    found, means = ([r for r in chosen if r["finder"] == f] for f in ("where", "means"))
    return found, means


def store(folder: Path, which: str) -> None:
    """Put the rows of a run into the repository, as rooms ``which`` of `ROOMS`, beside the others."""
    every = [r for r in rows(stored_in(which)) if r["rooms"] != which]
    for statement in STATEMENTS:
        of_run = results(Judging(population_of(which), statement, folder))
        for finder, found in zip(("where", "means"), of_run, strict=True):
            given = {"finder": finder, "statement": statement, "rooms": which}
            every += [{**given, **row} for row in found]
    write(stored_in(which), every)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("command", choices=(*STEPS, "table", "store"))
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--population", type=int, default=3)
    parser.add_argument("--statement", choices=STATEMENTS, default=HANDBOOK)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--number", type=int, default=250, help="of rooms, in a fair order")
    parser.add_argument("--rooms", choices=ROOMS, default=PRESENT, help="which ones a table is of")
    parser.add_argument("--least", type=float, default=-1.0, help="effect on T of the rooms")
    parser.add_argument("--paths", type=int, default=PATHS, help="from each source")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    if given.command == "table" and given.folder is None:
        print(f"rooms {ROOMS[given.rooms]}; coefficients: {given.statement}")
        table(*kept(given.statement, given.rooms), population_of(given.rooms))
        return
    if given.folder is None:
        parser.error("--folder is needed")
    judging = Judging(given.population, given.statement, given.folder, given.paths)
    if given.command == "table":
        table(*results(judging), given.population)
    elif given.command == "store":
        store(given.folder, given.rooms)
    else:
        every = sorted(
            i
            for i in stored(given.population, "truth")
            if i >= given.first and truth(given.population, i)["effect_on_t"] >= given.least
        )
        resume(
            judging.file(given.command),
            {
                f"{i} {data}": partial(made_of, judging, given.command, i, data)
                for i in every[: given.number]
                for data in DATA
            },
        )


if __name__ == "__main__":
    main()
