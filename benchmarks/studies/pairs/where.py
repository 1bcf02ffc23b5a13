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
import gzip
import json
import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks.studies.geometric_world.load import (
    HANDBOOK,
    IN_SITU,
    GeometricRoom,
    load,
    stored,
    truth,
    without_noise,
)
from benchmarks.studies.means.judging import FLAGS, rounded, row_of
from benchmarks.studies.pairs.where_figures import DATA, LARGE, MODELS, ROOMS, chosen, table
from benchmarks.studies.stored import path
from rtcal.acoustics.marks import gap_jnd
from rtcal.finder import library
from rtcal.finder.positions.problem import PositionsHypotheses, PositionsProblem
from rtcal.finder.positions.search import controls_of, every_hypothesis, of_means
from rtcal.finder.positions.weighing import responses_of
from rtcal.finder.search import find

PATHS = 8000
"""From each source: the default of `PathTracing`."""
STATEMENTS = IN_SITU, HANDBOOK
MATCH = ("t20", "edt", "c80", "ts", "level")
PRESENT = "sixth"
"""The largest set of rooms that one finder judged."""


def population_of(which: str) -> int:
    """Return the population that rooms ``which`` of `ROOMS` belong to."""
    return {"eleventh": 3, "sixth": 3, "seventh": 4, "eighth": 4, "ninth": 4, "tenth": 4}.get(
        which, 1
    )


def stored_in(which: str) -> Path:
    """Return the file that has the rows of rooms ``which``."""
    return path("geometric_world", population_of(which), "results")


def case_of(room: GeometricRoom, data: str, paths: int = PATHS) -> rt.finder.PositionsCase:
    level = data == "level"
    return rt.finder.PositionsCase(
        simulator=room.simulator(n_paths=paths),
        measured=room.measured if level else room.without_level(),
        match=MATCH if level else MATCH[:-1],
    )


@dataclass(frozen=True)
class Judging:
    """Rooms of a population, the statement of their coefficients, and the folder of what is kept."""

    population: int
    statement: str
    folder: Path
    paths: int = PATHS

    def load(self, index: int) -> GeometricRoom:
        return load(self.population, index, self.statement)

    def file(self, step: str) -> Path:
        return self.folder / f"{step}_{self.population}_{self.statement.replace(' ', '_')}.jsonl"


def prepared(
    case: rt.finder.PositionsCase, cache: Path
) -> tuple[PositionsProblem, PositionsHypotheses]:
    """Return the numbers and the hypotheses of a search, as `rtcal.find` makes them."""
    made = responses_of(case, 0, cache)
    numbers = PositionsProblem(case, made, controls_of(case, cache=cache))
    return numbers, every_hypothesis(case, numbers, library())


def judged(judging: Judging, index: int, data: str) -> dict[str, Any]:
    """Return what `rtcal.find` says of a room."""
    room = judging.load(index)
    case = case_of(room, data, judging.paths)
    clock, processor = time.perf_counter(), time.process_time()
    finding = rt.find(case, cache=judging.folder / "controls")
    return {
        "index": index,
        "data": data,
        "seconds": time.perf_counter() - clock,
        "processor": time.process_time() - processor,
        "n_surfaces": len(case.faces),
        "n_bands": room.room.n_bands,
        **said(finding, case, truth(judging.population, index)["surface"]),
    }


def verified(judging: Judging, index: int, data: str) -> dict[str, Any]:
    """Return the mean gaps at held-out pairs in JND, to what was measured and to what is heard.

    What is heard has no noise. Rooms whose T changes little, and findings that add nothing to a
    surface, have none; those of `run` that flagged nothing are not made again.
    """
    out: dict[str, Any] = {"index": index, "data": data, "gaps": {}, "gaps_heard": {}}
    cache = judging.folder / "controls"
    if truth(judging.population, index)["effect_on_t"] <= LARGE:
        return out
    for row in read(judging.file("run")):
        if (row["index"], row["data"]) == (index, data) and row["verdict"] not in FLAGS:
            return out
    case = case_of(judging.load(index), data, judging.paths)
    finding = rt.find(case, cache=cache)
    if not finding.can_be_added:
        return out
    result = rt.finder.verify(finding, cache=cache)
    gaps = dict(zip(MODELS, result.gaps.mean(axis=1), strict=True))
    off = noise(finding, without_noise(judging.population, index))
    for key, by_model in (
        ("gaps", gaps),
        ("gaps_heard", {m: to_heard(g, off) for m, g in gaps.items()}),
    ):
        out[key] = {model: float(np.nanmean(np.abs(gap))) for model, gap in by_model.items()}
    return out


def noise(finding: Any, heard: rt.Measurement) -> tuple[np.ndarray, np.ndarray]:
    """Return measured over heard, in which a gap's JND differ, and their gap in JND.

    Both (n_parameters, n_pairs, n_bands).
    """
    scale, off = [], []
    for name in finding.parameters:
        key = "g" if name == "level" else name
        measured = finding.case.measured
        rows = [[measured.pairs.index(p) for p in finding.pairs]]
        true = heard.values[key][[heard.pairs.index(p) for p in finding.pairs]]
        value = measured.values[key][tuple(rows)]
        scale.append(value / true if name in ("t20", "edt") else np.ones_like(value))
        off.append(gap_jnd(value, true, key))
    return np.array(scale), np.array(off)


def to_heard(gap: np.ndarray, off: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return the gap to what is heard, of that to what was measured; both in JND."""
    scale, measured = off
    return np.asarray(scale * gap + measured)


def said(finding: Any, case: Any, face: int) -> dict[str, Any]:
    """Return a finding as plain values. ``face`` is where something is hidden; -1 for nowhere."""
    names = [name for name, faces in case.faces.items() if face in faces]
    best = finding.best
    return {
        "verdict": finding.verdict,
        "effect": finding.effect,
        "family": finding.family,
        "surface": finding.surface,
        "true_surface": names[0] if names else None,
        "surfaces": rounded(finding.surfaces),
        "likely": list(finding.likely_surfaces),
        "best": None
        if best is None
        else {
            "effect": best.effect,
            "family": best.family,
            "surface": best.surface,
            "place": best.place,
            "size": [best.size, best.low, best.high],
        },
        "probabilities": rounded(finding.probabilities),
        "families": rounded(finding.families),
        "score": float(finding.score),
        "threshold": float(finding.threshold),
        "nats_of_noise": finding.detection.noise,
        "nats_of_means": finding.detection.means,
    }


def plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(f"{value:.4g}") if np.isfinite(value) else None
    return value


def means_only(judging: Judging, index: int, data: str) -> dict[str, Any]:
    """Return what the finder without a geometry says of the same measurement."""
    case = of_means(case_of(judging.load(index), data))
    row = row_of(find(case, cache=judging.folder / "controls"))
    return {"index": index, "data": data, **row}


def run(judging: Judging, step: str, indices: Iterable[int], data: Sequence[str]) -> None:
    """Judge the rooms that are not in the file yet; each row is written at once."""
    file, population = judging.file(step), judging.population
    file.parent.mkdir(parents=True, exist_ok=True)
    done = {(r["index"], r["data"]) for r in read(file)}
    for index in indices:
        for which in data:
            if (index, which) in done:
                continue
            row = plain(STEPS[step](judging, index, which))
            with file.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(row, separators=(",", ":")) + "\n")
            print(
                index, which, truth(population, index)["kind"], row.get("verdict", ""), flush=True
            )


def read(file: Path) -> list[dict[str, Any]]:
    if not file.exists():
        return []
    content = file.read_bytes()
    lines = gzip.decompress(content) if file.suffix == ".gz" else content
    return [json.loads(line) for line in lines.splitlines()]


def results(judging: Judging) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the rows of a run: in the geometry, with their gaps, and of means."""
    every = {step: read(judging.file(step)) for step in STEPS}
    gaps = {(r["index"], r["data"]): r for r in every["gaps"]}
    found = [{**r, **gaps.get((r["index"], r["data"]), {})} for r in every["run"]]
    return found, every["means"]


def kept(statement: str, which: str = PRESENT) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the stored rows of some of the rooms (`ROOMS`), as `results` does."""
    rows = [r for r in read(stored_in(which)) if r["statement"] == statement]
    found = [r for r in chosen(rows, which) if r["finder"] == "where"]
    return found, [r for r in chosen(rows, which) if r["finder"] == "means"]


def store(folder: Path, which: str) -> None:
    """Put the rows of a run into the repository, as rooms ``which`` of `ROOMS`, beside the others."""
    file = stored_in(which)
    every = [r for r in read(file) if r["rooms"] != which]
    every += [
        {"finder": finder, "statement": statement, "rooms": which, **row}
        for statement in STATEMENTS
        for finder, rows in zip(
            ("where", "means"),
            results(Judging(population_of(which), statement, folder)),
            strict=True,
        )
        for row in rows
    ]
    lines = [json.dumps(row, separators=(",", ":")) for row in every]
    file.write_bytes(gzip.compress("\n".join(lines).encode(), mtime=0))


STEPS: dict[str, Callable[[Judging, int, str], dict[str, Any]]] = {
    "run": judged,
    "gaps": verified,
    "means": means_only,
}
"""What is made of a room, by the name of its command and of its file of rows."""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("command", choices=(*STEPS, "table", "store"))
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--population", type=int, default=3)
    parser.add_argument("--statement", choices=STATEMENTS, default=HANDBOOK)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--number", type=int, default=250, help="of rooms, in a fair order")
    parser.add_argument("--rooms", choices=ROOMS, default=PRESENT, help="which ones a table is of")
    parser.add_argument("--data", default=",".join(DATA))
    parser.add_argument("--least", type=float, default=-1.0, help="effect on T of the rooms")
    parser.add_argument("--paths", type=int, default=PATHS, help="from each source")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    if given.command == "table":
        if given.folder is None:
            print(f"rooms {ROOMS[given.rooms]}; coefficients: {given.statement}")
            table(*kept(given.statement, given.rooms), population_of(given.rooms))
        else:
            judging = Judging(given.population, given.statement, given.folder)
            table(*results(judging), given.population)
    elif given.folder is None:
        parser.error("--folder is needed")
    elif given.command == "store":
        store(given.folder, given.rooms)
    else:
        judging = Judging(given.population, given.statement, given.folder, given.paths)
        every = sorted(
            i
            for i in stored(given.population, "truth")
            if i >= given.first and truth(given.population, i)["effect_on_t"] >= given.least
        )
        run(judging, given.command, every[: given.number], given.data.split(","))


if __name__ == "__main__":
    main()
