"""What `rtcal.where` says of rooms in which something is hidden at a place that nobody stated.

    python -m benchmarks.where list
    python -m benchmarks.where run --folder out --number 40 --statement "in situ"    # can be resumed
    python -m benchmarks.where gaps --folder out --number 40     # at held-out pairs, the same rooms
    python -m benchmarks.where means --folder out --number 40    # means over positions, the same rooms
    python -m benchmarks.where table                             # of the stored run, or --folder out
    python -m benchmarks.where store --folder out                # the run that the study shows
    python -m benchmarks.where speed --folder out                # first and second run of one room

tests/geometric_world describes the rooms. Each is judged on T20, EDT, C80 and Ts ("without level") and
with G beside them ("level"). Control runs and weighings are kept in the folder's `controls`, so that
another run of a room takes seconds. `means` is `rtcal.discrepancy.find` on the same values, without
a geometry.

The gap is at held-out pairs, in JND: `rtcal.where.verify` fits on half of the pairs and predicts the
other half, and the other way round. It is judged where the effect changes T by over 10 % and something
was added; the gap to what is heard, without the measurement's noise, stands beside it.
"""

from __future__ import annotations

import argparse
import gzip
import json
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks.judging import FLAGS, NOTHING, families_of, kept_controls, rounded, row_of
from benchmarks.positions import bootstrap, share
from rtcal.acoustics.quality import gap_jnd
from rtcal.discrepancy import Case, Configuration, find
from rtcal.discrepancy.engines import ControlRooms
from tests.geometric_world import rooms
from tests.geometric_world.generate import HERE
from tests.geometric_world.load import (
    HANDBOOK,
    IN_SITU,
    GeometricRoom,
    load,
    stored,
    truth,
    without_noise,
)

PATHS = 6000
STATEMENTS = IN_SITU, HANDBOOK
DATA = {"without": "without level", "level": "with level"}
ABSORBERS = rooms.ON_A_SURFACE
WHOLE_PLACES = ("audience",)
"""Kinds whose surface follows from their name: people stand on floors."""
MODELS = ("before", "plain", "corrected")
MATCH = ("t20", "edt", "c80", "ts", "level")
LARGE = 0.10
"""The gap is judged where the effect changes T by more, on average over the bands."""
STORED = HERE / "population_1_results.jsonl.gz"
OF_KIND = {
    "receiver": ("measurement",),
    "coupled room": ("field",),
    "covered surface": ("less absorption",),
}
"""Right families of kinds whose name is no effect of `rtcal.discrepancy`."""


def right_families(kind: str) -> frozenset[str]:
    """Families that are right: of an absorber its own, and "added absorption"."""
    return frozenset(OF_KIND.get(kind, ())) or families_of([kind])


def case_of(room: GeometricRoom, data: str) -> rt.where.Case:
    level = data == "level"
    return rt.where.Case(
        simulator=room.simulator(n_paths=PATHS),
        measured=room.measured if level else room.without_level(),
        match=MATCH if level else MATCH[:-1],
    )


@dataclass(frozen=True)
class Judging:
    """Rooms of a population, the statement of their coefficients, and the folder of what is kept."""

    population: int
    statement: str
    folder: Path

    def load(self, index: int) -> GeometricRoom:
        return load(self.population, index, self.statement)

    def file(self, step: str) -> Path:
        return self.folder / f"{step}_{self.population}_{self.statement.replace(' ', '_')}.jsonl"


def judged(judging: Judging, index: int, data: str) -> dict[str, Any]:
    """Return what `rtcal.where.find` says of a room."""
    room = judging.load(index)
    case = case_of(room, data)
    clock, processor = time.perf_counter(), time.process_time()
    finding = rt.where.find(case, cache=judging.folder / "controls")
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
    finding = rt.where.find(case_of(judging.load(index), data), cache=cache)
    if not finding.can_be_added:
        return out
    result = rt.where.verify(finding, cache=cache)
    gaps = {model: getattr(result, model).mean(axis=0) for model in MODELS}
    off = noise(finding, without_noise(judging.population, index))
    for key, table in (
        ("gaps", gaps),
        ("gaps_heard", {m: to_heard(g, off) for m, g in gaps.items()}),
    ):
        out[key] = {model: float(np.nanmean(np.abs(gap))) for model, gap in table.items()}
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
    room = judging.load(index)
    names = ("t20", "edt", "c80", "g") if data == "level" else ("t20", "edt", "c80")
    measured = rt.Measurement(
        centre_frequencies=room.measured.centre_frequencies,
        values={p: room.measured.values[p] for p in names},
        pairs=room.measured.pairs,
    )
    facing = np.array(
        [
            sum(a * n**2 for a, n, m in zip(*faces_of(room), strict=True) if m == name)
            for name in room.room.materials
        ]
    )
    case = Case(
        room=room.room,
        configurations=[
            Configuration(name="measured", measured=measured, distances=room.distances)
        ],
        facing=facing / facing.sum(1, keepdims=True),
    )
    name = f"{judging.statement}_{judging.population}_{index}_{data}.npz"
    path = judging.folder / "means_controls" / name
    controls: list[ControlRooms] = kept_controls(case, path)
    row = row_of(find(case, controls=controls))
    return {"index": index, "data": data, **row}


def faces_of(room: GeometricRoom) -> tuple[Any, Any, Any]:
    geometry = room.geometry
    return geometry.face_areas, geometry.normals, geometry.materials


def run(judging: Judging, step: str, number: int, data: Iterable[str]) -> None:
    """Judge the first rooms that are built and not in the file yet; each row is written at once."""
    file, population = judging.file(step), judging.population
    file.parent.mkdir(parents=True, exist_ok=True)
    done = {(r["index"], r["data"]) for r in read(file)}
    for index in sorted(stored(population, "truth"))[:number]:
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


def kept(statement: str) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the rows of the stored run, as `results` does."""
    rows = [r for r in read(STORED) if r["statement"] == statement]
    found = [r for r in rows if r["finder"] == "where"]
    return found, [r for r in rows if r["finder"] == "means"]


def store(folder: Path) -> None:
    """Put the rows of a judging run into the repository."""
    lines = [
        json.dumps({"finder": finder, "statement": statement, **row}, separators=(",", ":"))
        for statement in STATEMENTS
        for finder, rows in zip(
            ("where", "means"), results(Judging(1, statement, folder)), strict=True
        )
        for row in rows
    ]
    STORED.write_bytes(gzip.compress("\n".join(lines).encode(), mtime=0))


class Rows:
    """Rows of one kind of data beside the truth of their rooms."""

    def __init__(self, rows: Iterable[dict[str, Any]], population: int, data: str) -> None:
        chosen = {r["index"]: r for r in rows if r["data"] == data}
        self.all = [(truth(population, i), row) for i, row in sorted(chosen.items())]

    def only(self, kinds: Sequence[str], flagged: bool | None = None) -> list[Any]:
        return [
            (t, r)
            for t, r in self.all
            if t["kind"] in kinds and flagged in (None, r["verdict"] in FLAGS)
        ]


HIDDEN = tuple(k for k in rooms.KINDS if k != rooms.NOTHING)


def family_of(row: dict[str, Any]) -> str | None:
    """Return the family that is claimed, or else the most probable one."""
    if row["family"]:
        return str(row["family"])
    wide = {f.split(",")[0] for f in row["families"] if "," in f}
    narrow = {f: p for f, p in row["families"].items() if f not in wide | {NOTHING, "unknown"}}
    return max(narrow, key=lambda f: narrow[f]) if narrow else None


Line = tuple[float, float, float, int]
"""A figure, its 95 % interval, and the number of rooms that it is over."""


def portion(hits: Iterable[bool]) -> Line:
    """Return a share with its interval (Clopper and Pearson 1934)."""
    table = [bool(h) for h in hits]
    return (*share(sum(table), len(table)), len(table)) if table else (np.nan, np.nan, np.nan, 0)


def over(statistic: Callable[[np.ndarray], Any], values: Iterable[float]) -> Line:
    """Return a statistic of the rooms' values with its interval over rooms."""
    x = np.array([v for v in values if v is not None], dtype=float)
    if not x.size:
        return np.nan, np.nan, np.nan, 0
    return (*bootstrap(lambda i: float(statistic(x[i])), len(x)), len(x))


def flags(rows: Rows, kinds: Sequence[str]) -> list[bool]:
    return [r["verdict"] in FLAGS for _, r in rows.only(kinds)]


def common(rows: Rows) -> dict[str, Line]:
    """Return the lines that a finder without a geometry has as well."""
    caught = rows.only(HIDDEN, True)
    right = [(r, family_of(r) in right_families(t["kind"])) for t, r in caught]
    return {
        "flagged with nothing hidden": portion(flags(rows, (rooms.NOTHING,))),
        "detected": portion(flags(rows, HIDDEN)),
        "detected, absorbers alone": portion(flags(rows, ABSORBERS)),
        "right family, of the detected": portion(hit for _, hit in right),
        "the same, where one is claimed": portion(
            hit for r, hit in right if r["verdict"] in ("named", "family")
        ),
    }


def places(rows: Rows) -> dict[str, Line]:
    """Return how often the right surface was said."""
    caught = rows.only(ABSORBERS, True)
    walls = [(t, r) for t, r in caught if t["kind"] not in WHOLE_PLACES]
    claimed = [r for _, r in rows.all if r["surface"] is not None and r["verdict"] in FLAGS]
    sized = [(t["size"], r["best"]["size"]) for t, r in caught if r["best"]]
    return {
        "right surface, of absorbers detected": portion(is_first(r) for _, r in caught),
        "the same without audiences": portion(is_first(r) for _, r in walls),
        "by chance": over(np.mean, (1 / r["n_surfaces"] for _, r in caught)),
        "right surface among the candidates": portion(
            r["true_surface"] in r["likely"] for _, r in caught
        ),
        "candidates, mean": over(np.mean, (len(r["likely"]) for _, r in caught)),
        "a single surface is claimed": portion(r["surface"] is not None for _, r in caught),
        "a single surface claimed: right": portion(
            r["surface"] == r["true_surface"] for r in claimed
        ),
        "size in its 90 % interval": portion(
            low <= size <= high for size, (_, low, high) in sized if low is not None
        ),
    }


def gaps(rows: Rows) -> dict[str, Line]:
    """Return how the gap at held-out pairs shrinks where the effect changes T by over 10 %."""
    large = [(t, r) for t, r in rows.only(HIDDEN) if t["effect_on_t"] > LARGE]
    out: dict[str, Line] = {}
    tried = [r for _, r in large if r.get("gaps")]
    for key, words in (("gaps", ""), ("gaps_heard", ", to what is heard")):
        ratios = [r[key]["corrected"] / r[key]["plain"] for r in tried]
        out[f"gap corrected / plain, median{words}"] = over(np.median, ratios)
        out[f"rooms in which it shrinks{words}"] = portion(x < 1 for x in ratios)
        for which in MODELS:
            out[f"gap {which}, JND{words}"] = over(np.mean, (r[key][which] for r in tried))
    return out


def is_first(row: dict[str, Any]) -> bool:
    return first(row) == row["true_surface"]


def first(row: dict[str, Any]) -> str | None:
    """Return the most probable surface."""
    table = row["surfaces"]
    return max(table, key=lambda name: table[name]) if table else None


def summary(
    found: Iterable[dict[str, Any]], means: Iterable[dict[str, Any]], population: int, data: str
) -> dict[str, Line]:
    """Return every figure of one kind of data by its name; those of the means begin with "means: ".

    The means, and the gain over them, are of the rooms that both have judged.
    """
    rows, others = Rows(found, population, data), Rows(means, population, data)
    out = {**common(rows), **places(rows), **gaps(rows)}
    seconds = [r["processor"] for _, r in rows.all]
    out["processor time, s, median"] = over(np.median, seconds)
    of_means = {id(t): r for t, r in others.all}
    both = [(t, r, of_means[id(t)]) for t, r in rows.all if id(t) in of_means]
    others.all = [(t, r) for t, _, r in both]
    out |= {f"means: {name}": line for name, line in common(others).items()}
    gained = [
        float(r["verdict"] in FLAGS) - float(m["verdict"] in FLAGS)
        for t, r, m in both
        if t["kind"] in HIDDEN
    ]
    out["detected more than by means"] = over(np.mean, gained)
    return out


def asked(data: str) -> dict[str, tuple[float, float]]:
    """Return the limits of issue 22, the lowest and the highest figure that meets it, by name."""
    return {
        "flagged with nothing hidden": (0, 0.05),
        "detected more than by means": (0.12, 1),
        "right family, of the detected": (0.85, 1),
        "right surface, of absorbers detected": (0.75 if data == "level" else 0.6, 1),
        "right surface among the candidates": (0.85, 1),
        "candidates, mean": (1, 2),
        "a single surface claimed: right": (0.9, 1),
        "gap corrected / plain, median": (0, 0.7),
        "rooms in which it shrinks": (0.85, 1),
    }


def print_confusion(rows: Rows) -> None:
    print("rows: hidden; columns: the most probable effect where flagged; '-' not flagged")
    flagged = [effect_of(r) for _, r in rows.all if r["verdict"] in FLAGS]
    names = [n for n in dict.fromkeys([*HIDDEN, *flagged]) if n in flagged]
    print(f"{'':16}{'-':>4}" + "".join(f"{n[:8]:>9}" for n in names))
    for kind in (*HIDDEN, rooms.NOTHING):
        chosen = [r for _, r in rows.only((kind,))]
        count = Counter(effect_of(r) if r["verdict"] in FLAGS else "-" for r in chosen)
        if chosen:
            print(f"{kind:16}{count['-']:4}" + "".join(f"{count[n] or '.':>9}" for n in names))


def effect_of(row: dict[str, Any]) -> str:
    return str((row.get("best") or {}).get("effect") or row["effect"])


def table(found: list[dict[str, Any]], means: list[dict[str, Any]], population: int) -> None:
    """Print every line with its 95 % interval, and what was asked of it."""
    for data, words in DATA.items():
        rows, limits = Rows(found, population, data), asked(data)
        print(f"\n== {words}: {len(rows.all)} rooms of population {population} ==")
        for name, (value, low, high, n) in summary(found, means, population, data).items():
            if n == 0:
                continue
            print(f"{name:46}{value:7.3f}  [{low:.3f}, {high:.3f}] of {n:<4}", end="")
            if name in limits:
                least, most = limits[name]
                met = "met" if least <= value <= most else "not met"
                print(f" asked {least:g} to {most:g}: {met}", end="")
            print()
        print_confusion(rows)


def listed() -> None:
    for population in rooms.COUNTS:
        kinds = Counter(rooms.order(population))
        print(f"population {population}: {sum(kinds.values())} rooms,", end=" ")
        print(f"{len(stored(population, 'truth'))} built;", end=" ")
        print(", ".join(f"{n} {kind}" for kind, n in kinds.items()))


def speed(folder: Path, population: int) -> None:
    """Print the seconds of the first and of the second run: 12 pairs, 8 bands, the most surfaces."""
    every = {i: load(population, i) for i in stored(population, "truth")}
    most = max(
        (i for i, r in every.items() if r.room.n_bands == 8),
        key=lambda i: len(case_of(every[i], "level").faces),
    )
    warm = min(every, key=lambda i: every[i].room.n_materials)
    rt.where.find(case_of(every[warm], "level"))  # compiles
    for which in ("first", "second"):
        case = case_of(every[most], "level")
        clock, processor = time.perf_counter(), time.process_time()
        rt.where.find(case, cache=folder / "speed")
        print(
            f"{len(case.faces)} surfaces, 8 bands, {len(case.pairs)} pairs: {which} run "
            f"{time.perf_counter() - clock:.1f} s, {time.process_time() - processor:.1f} s of processor"
        )


STEPS: dict[str, Callable[[Judging, int, str], dict[str, Any]]] = {
    "run": judged,
    "gaps": verified,
    "means": means_only,
}
"""What is made of a room, by the name of its command and of its file of rows."""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("command", choices=("list", *STEPS, "table", "store", "speed"))
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--population", type=int, default=1)
    parser.add_argument("--statement", choices=STATEMENTS, default=HANDBOOK)
    parser.add_argument("--number", type=int, default=250, help="the first rooms, in a fair order")
    parser.add_argument("--data", default=",".join(DATA))
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    if given.command == "list":
        listed()
    elif given.command == "table" and given.folder is None:
        table(*kept(given.statement), given.population)
    elif given.folder is None:
        parser.error("--folder is needed")
    elif given.command == "table":
        table(*results(Judging(given.population, given.statement, given.folder)), given.population)
    elif given.command == "store":
        store(given.folder)
    elif given.command == "speed":
        speed(given.folder, given.population)
    else:
        judging = Judging(given.population, given.statement, given.folder)
        run(judging, given.command, given.number, given.data.split(","))


if __name__ == "__main__":
    main()
