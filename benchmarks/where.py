"""What `rtcal.where` says of rooms in which something is hidden at a place that nobody stated.

    python -m benchmarks.where list
    python -m benchmarks.where run --folder out --number 40      # can be resumed
    python -m benchmarks.where means --folder out --number 40    # means over positions, the same rooms
    python -m benchmarks.where table                             # of the stored run, or --folder out
    python -m benchmarks.where speed --folder out                # first and second run of one room

tests/geometric_world describes the rooms. Each is judged on T20, EDT, C80 and Ts ("without level") and
with G beside them ("level"). Control runs are kept in the folder, so that a second run of a room with
--label takes seconds. `means` is `rtcal.discrepancy.find` on the same measurement, without a geometry.

The judged gap is at held-out pairs, in JND over T20, EDT, C80, Ts and G: `rtcal.where.verify` fits on
half of the pairs and predicts the other half, and the other way round.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks.judging import FLAGS, NOTHING, families_of, kept_controls, rate, rounded, row_of
from benchmarks.positions import bootstrap
from rtcal.discrepancy import Case, Configuration, find
from rtcal.discrepancy.engines import ControlRooms
from tests.geometric_world import rooms
from tests.geometric_world.generate import HERE
from tests.geometric_world.load import GeometricRoom, load, stored, truth

PATHS = 8000
DATA = {"without": "without level", "level": "with level"}
ABSORBERS = rooms.ON_A_SURFACE
WHOLE_PLACES = ("audience",)
"""Kinds whose surface follows from their name: people stand on floors."""
MATCH = ("t20", "edt", "c80", "ts", "level")
LARGE = 0.10
"""The gap is judged where the effect changes T by more, on average over the bands."""
STORED = HERE / "population_1_results.jsonl"
OF_KIND = {
    "receiver": ("measurement",),
    "coupled room": ("field",),
    "covered surface": ("less absorption",),
}
"""Right families of kinds whose name is no effect of `rtcal.discrepancy`."""


def right_families(kind: str) -> frozenset[str]:
    """Families that are right: of an absorber its own, and "added absorption"."""
    return frozenset(OF_KIND.get(kind, ())) or families_of([kind])


def case_of(room: GeometricRoom, data: str, workers: int | None) -> rt.where.Case:
    level = data == "level"
    return rt.where.Case(
        simulator=room.simulator(n_paths=PATHS, workers=workers),
        measured=room.measured if level else room.without_level(),
        match=MATCH if level else MATCH[:-1],
    )


def judged(
    population: int, index: int, data: str, folder: Path, workers: int | None
) -> dict[str, Any]:
    """Return what `rtcal.where.find` and `verify` say of a room."""
    room = load(population, index)
    case = case_of(room, data, workers)
    clock, processor = time.perf_counter(), time.process_time()
    finding = rt.where.find(case, cache=folder / "controls" / f"{population}_{index}")
    row = {
        "index": index,
        "data": data,
        "seconds": time.perf_counter() - clock,
        "processor": time.process_time() - processor,
        "n_surfaces": len(case.faces),
        "n_bands": room.room.n_bands,
        **said(finding, case, truth(population, index)["surface"]),
    }
    verification = rt.where.verify(finding)
    for which in ("before", "plain", "corrected"):
        gap = getattr(verification, which)
        row[f"gap_{which}"] = dict(
            zip(case.match, np.nanmean(np.abs(gap), axis=(0, 2, 3)).tolist(), strict=True)
        )
    row["ratio"] = float(verification.ratio)
    return plain(row)


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


def means_only(population: int, index: int, data: str, folder: Path) -> dict[str, Any]:
    """Return what the finder without a geometry says of the same measurement."""
    room = load(population, index)
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
    path = folder / "means_controls" / f"{population}_{index}_{data}.npz"
    controls: list[ControlRooms] = kept_controls(case, path)
    row = row_of(find(case, controls=controls))
    return plain({"index": index, "data": data, **row})


def faces_of(room: GeometricRoom) -> tuple[Any, Any, Any]:
    geometry = room.geometry
    return geometry.face_areas, geometry.normals, geometry.materials


def run(
    file: Path,
    population: int,
    number: int,
    data: Iterable[str],
    make: Callable[[int, str], dict[str, Any]],
) -> None:
    """Judge the first rooms that are built and not in the file yet; each row is written at once."""
    file.parent.mkdir(parents=True, exist_ok=True)
    done = {(r["index"], r["data"]) for r in read(file)}
    for index in sorted(stored(population, "truth"))[:number]:
        for which in data:
            if (index, which) in done:
                continue
            row = make(index, which)
            with file.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(row, separators=(",", ":")) + "\n")
            print(index, which, truth(population, index)["kind"], row["verdict"], flush=True)


def read(file: Path) -> list[dict[str, Any]]:
    return [json.loads(r) for r in file.read_text("utf-8").splitlines()] if file.exists() else []


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


def print_common(rows: Rows) -> None:
    """Print the lines that a finder without a geometry has as well."""
    print("  flagged with nothing hidden   ", rate(flag(rows, (rooms.NOTHING,))))
    print("  detected, of all hidden       ", rate(flag(rows, HIDDEN)))
    print("  detected, of absorbers        ", rate(flag(rows, ABSORBERS)))
    caught = rows.only(HIDDEN, True)
    print(
        "  right family, of the detected ",
        rate(family_of(r) in right_families(t["kind"]) for t, r in caught),
    )
    claimed = [(t, r) for t, r in caught if r["verdict"] in ("named", "family")]
    print(
        "    of those that claim one     ",
        rate(family_of(r) in right_families(t["kind"]) for t, r in claimed),
    )


def flag(rows: Rows, kinds: Sequence[str]) -> list[bool]:
    return [r["verdict"] in FLAGS for _, r in rows.only(kinds)]


def print_places(rows: Rows) -> None:
    """Print whether the right surface was said."""
    caught = rows.only(ABSORBERS, True)
    print(
        "  right surface, of absorbers   ", rate(first(r) == r["true_surface"] for _, r in caught)
    )
    walls = [(t, r) for t, r in caught if t["kind"] not in WHOLE_PLACES]
    print("    without audiences           ", rate(first(r) == r["true_surface"] for _, r in walls))
    chance = np.mean([1 / r["n_surfaces"] for _, r in caught]) if caught else np.nan
    print(f"    by chance                    {chance:.3f}")
    print(
        "  right one among candidates    ",
        rate(r["true_surface"] in r["likely"] for _, r in caught),
    )
    if caught:
        print(
            f"    candidates, mean             {np.mean([len(r['likely']) for _, r in caught]):.2f}"
        )
    single = [(t, r) for t, r in rows.all if r["surface"] is not None and r["verdict"] in FLAGS]
    print("  a single surface claimed      ", rate(r["surface"] is not None for _, r in caught))
    print(
        "    and right, of all rooms     ",
        rate(r["surface"] == r["true_surface"] for _, r in single),
    )
    sized = [(t, r) for t, r in caught if r["best"] and r["best"]["size"][1] is not None]
    print(
        "  size in its 90 % interval     ",
        rate(r["best"]["size"][1] <= t["size"] <= r["best"]["size"][2] for t, r in sized),
    )


def first(row: dict[str, Any]) -> str | None:
    """Return the most probable surface."""
    table = row["surfaces"]
    return max(table, key=lambda name: table[name]) if table else None


def print_gaps(rows: Rows) -> None:
    """Print how the gap at held-out pairs shrinks."""
    large = [(t, r) for t, r in rows.only(HIDDEN) if t["effect_on_t"] > LARGE]
    for words, chosen in (
        ("of all hidden", large),
        ("of the detected", [(t, r) for t, r in large if r["verdict"] in FLAGS]),
    ):
        ratios = np.array([r["ratio"] for _, r in chosen if r["ratio"] is not None])
        if not ratios.size:
            continue
        value, low, high = bootstrap(lambda i, x=ratios: float(np.median(x[i])), len(ratios))
        print(f"  gap corrected / plain, {words}: median {value:.3f} [{low:.3f}, {high:.3f}]")
        print("    rooms in which it shrinks   ", rate(ratios < 1))
        for which in ("before", "plain", "corrected"):
            mean = np.mean([np.mean([*r[f"gap_{which}"].values()]) for _, r in chosen])
            print(f"    mean gap {which:10}          {mean:.2f} JND")


def print_confusion(rows: Rows) -> None:
    print("  rows: hidden; columns: the most probable effect where flagged; '-' not flagged")
    names = [*dict.fromkeys([*HIDDEN, *(effect_of(r) for _, r in rows.all)])]
    names = [n for n in names if any(effect_of(r) == n for _, r in rows.all)]
    print(f"  {'':16}{'-':>4}" + "".join(f"{n[:8]:>9}" for n in names))
    for kind in (*HIDDEN, rooms.NOTHING):
        chosen = [r for _, r in rows.only((kind,))]
        count = Counter(effect_of(r) if r["verdict"] in FLAGS else "-" for r in chosen)
        if chosen:
            print(f"  {kind:16}{count['-']:4}" + "".join(f"{count[n] or '.':>9}" for n in names))


def effect_of(row: dict[str, Any]) -> str:
    return str((row.get("best") or {}).get("effect") or row["effect"])


def table(found: list[dict[str, Any]], means: list[dict[str, Any]], population: int) -> None:
    """Print every line that was asked, with 95 % intervals; the means on the same rooms."""
    for data, words in DATA.items():
        both = {(r["index"], r["data"]) for r in means}
        rows = Rows(found, population, data)
        print(f"\n== {words}: {len(rows.all)} rooms, in their geometry ==")
        print_common(rows)
        print_places(rows)
        print_gaps(rows)
        print_confusion(rows)
        seconds = [r["processor"] for _, r in rows.all]
        if seconds:
            print(f"  processor time, median         {np.median(seconds):.1f} s")
        same = Rows(list(means), population, data)
        if not same.all:
            continue
        print(f"\n== {words}: {len(same.all)} rooms, means over positions only ==")
        print_common(same)
        common = [r for r in found if (r["index"], r["data"]) in both]
        if len(common) < len(found):
            of_same = Rows(common, population, data)
            print(f"  in their geometry, on the same {len(of_same.all)} rooms:")
            print_common(of_same)
        print_difference(rows, same)


def print_difference(rows: Rows, means: Rows) -> None:
    """Print the share detected more than by means, over the rooms that have both."""
    other = {id(t): r for t, r in means.only(HIDDEN)}
    pairs = [
        (r["verdict"] in FLAGS, other[id(t)]["verdict"] in FLAGS)
        for t, r in rows.only(HIDDEN)
        if id(t) in other
    ]
    if pairs:
        gain = np.array([float(a) - float(b) for a, b in pairs])
        value, low, high = bootstrap(lambda i: float(gain[i].mean()), len(gain))
        print(
            f"  detected more than by means    {value:+.3f} [{low:+.3f}, {high:+.3f}] of {len(gain)}"
        )


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
        key=lambda i: len(case_of(every[i], "level", 1).faces),
    )
    warm = min(every, key=lambda i: every[i].room.n_materials)
    rt.where.find(case_of(every[warm], "level", None))  # compiles
    for which in ("first", "second"):
        case = case_of(every[most], "level", None)
        clock, processor = time.perf_counter(), time.process_time()
        rt.where.find(case, cache=folder / "speed")
        print(
            f"{len(case.faces)} surfaces, 8 bands, {len(case.pairs)} pairs: {which} run "
            f"{time.perf_counter() - clock:.1f} s, {time.process_time() - processor:.1f} s of processor"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("command", choices=("list", "run", "means", "table", "speed"))
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--population", type=int, default=1)
    parser.add_argument("--number", type=int, default=250, help="the first rooms, in a fair order")
    parser.add_argument("--data", default=",".join(DATA))
    parser.add_argument("--label", default="where", help="file of this run's rows")
    parser.add_argument("--workers", type=int, default=None)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    data = given.data.split(",")
    if given.command == "list":
        listed()
    elif given.command == "table" and given.folder is None:
        kept = read(STORED)
        table(
            [r for r in kept if r["finder"] == "where"],
            [r for r in kept if r["finder"] == "means"],
            given.population,
        )
    elif given.folder is None:
        parser.error("--folder is needed")
    elif given.command == "table":
        both = (read(place(given.folder, given.population, x)) for x in (given.label, "means"))
        table(*both, given.population)
    elif given.command == "speed":
        speed(given.folder, given.population)
    elif given.command == "run":
        run(
            place(given.folder, given.population, given.label),
            given.population,
            given.number,
            data,
            lambda i, d: judged(given.population, i, d, given.folder, given.workers),
        )
    else:
        run(
            place(given.folder, given.population, "means"),
            given.population,
            given.number,
            data,
            lambda i, d: means_only(given.population, i, d, given.folder),
        )


def place(folder: Path, population: int, label: str) -> Path:
    return folder / f"{label}_{population}.jsonl"


if __name__ == "__main__":
    main()
