"""The finder on the frozen rooms in which an effect is hidden (benchmarks/studies/hidden_world).

    python -m benchmarks.studies.means.hidden_effects run --folder out  # an hour or so; can be resumed
    python -m benchmarks.studies.means.hidden_effects table  # of the stored run, or --folder out
    python -m benchmarks.studies.means.hidden_effects sample --folder out  # random rooms anew
    python -m benchmarks.studies.means.hidden_effects judge  # of the stored sample, or --folder out

"one": T20, EDT and T30 in one configuration; "all": two configurations, C80 and G as well.
"""

from __future__ import annotations

import argparse
import gzip
import json
import multiprocessing
import warnings
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.hidden_world.generate import read
from benchmarks.studies.hidden_world.populations import DOUBLE, TOGGLED, TWINS
from benchmarks.studies.means.judging import (
    FLAGS,
    NOTHING,
    families_of,
    first_of,
    kept_controls,
    one,
    rate,
    row_of,
)
from rtcal.finder import (
    Case,
    verify,
)
from rtcal.finder.effects import AT_1_KHZ
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.search import find

STORED = Path(__file__).parents[1] / "hidden_world" / "population_1_findings.jsonl.gz"
SAMPLE = STORED.with_name("population_1_sample.jsonl.gz")
"""Rooms of population 1 in random order, with the finder of 2026-11-28; the stored run is earlier."""
NAMES = {
    1: "air",
    2: "opening",
    3: "audience",
    4: "furniture",
    5: "porous",
    6: "resonator",
    7: "area",
    8: "volume",
    9: "formula",
    10: "coupled room",
    11: "non-diffuse field",
    12: "noise floor",
    13: "unknown",
}
PERSONS = "persons"
"""What a hidden audience states that stands: it is `People` to the finder."""
SHAPES = ("coupled room", "non-diffuse field", "noise floor")
SIZES = {
    2: "size",
    3: "size",
    4: "size",
    5: "size",
    6: "size",
    7: "ratio",
    8: "ratio",
    10: "size",
    11: "scattering",
    12: "level",
}


def name_of(hidden: dict[str, Any]) -> str:
    """The finder's name of a hidden effect."""
    return "people" if PERSONS in hidden else NAMES[hidden["kind"]]


def hidden_in(row: dict[str, Any]) -> str:
    """The name of the effect that is hidden in a stored room."""
    return name_of(row["truth"][0]) if row["kind"] in NAMES else NOTHING


def parameters_of(effect: dict[str, Any]) -> dict[str, float]:
    """The library's parameters of a truth."""
    kind = effect["kind"]
    if kind == 1:
        return {"temperature": effect["temperature"], "humidity": effect["humidity"]}
    if kind == 3:
        seated = "size" in effect
        area = 0.86 * effect["size"] if seated else 0.51 * effect["persons"]
        return {"absorption_area": area} if seated else {"persons": area / AT_1_KHZ}
    if kind == 10:
        return {"aperture": effect["size"], "volume": effect["volume"], "alpha": effect["alpha"]}
    return {
        2: lambda: {"area": effect["size"]},
        4: lambda: {"absorption_area": effect["size"]},
        5: lambda: {
            "area": effect["size"],
            "thickness": effect["depth"],
            "flow_resistivity": 1e3 * effect["flow"],
        },
        6: lambda: {"area": effect["size"], "resonance": effect["f0"], "quality": effect["q"]},
        7: lambda: {"material": effect["material"], "ratio": effect["ratio"]},
        8: lambda: {"ratio": effect["ratio"]},
        9: lambda: {"equation": 1.0},
        11: lambda: {"scattering": effect["scattering"]},
        12: lambda: {"level": effect["level"], "record": 2.0},
    }[kind]()


def rmse(alpha: Any, truth: dict[str, Any]) -> float:
    """Area-weighted root mean square error of alpha."""
    area = np.array(truth["areas"])[:, None]
    off = np.asarray(alpha) - np.array(truth["alpha"])
    return float(np.sqrt((area * off**2).sum() / area.sum() / off.shape[1]))


def examined(case: Case, controls: list[ControlRooms], truth: dict[str, Any]) -> dict[str, Any]:
    """Find, add, verify; what came of it."""
    finding = find(case, controls=controls)
    row = row_of(finding)
    if finding.can_be_added:
        seen = verify(finding)
        row |= {
            "rmse": [
                rmse(a, truth) for a in (case.room.alpha, seen.plain.alpha, seen.corrected.alpha)
            ],
            "verification": seen.verdict,
            "before": seen.before,
            "after": seen.after,
            "predictive": seen.details["predictive_nats"],
            "gaps": [[g.place, g.quantity, *g.values] for g in seen.quantities],
        }
        if len(truth["effects"]) == 2:
            again = find(finding.apply(), controls=controls)
            row["second"] = {
                "verdict": again.verdict,
                "effect": again.effect,
                "candidates": list(again.names),
            }
            if again.can_be_added and again.best_effect != finding.best_effect:
                mended = verify(again)
                row["second"]["rmse"] = rmse(mended.corrected.alpha, truth)
    return row


def named(row: dict[str, Any]) -> bool:
    """Whether there is an effect to add."""
    return (
        row["verdict"] in FLAGS and row["effect"] in NAMES.values() and row["effect"] != "unknown"
    )


def work(job: tuple[int, int, str]) -> None:
    population, index, folder = job
    path = Path(folder) / "rows" / f"{index}.json"
    if path.exists():
        return
    warnings.simplefilter("ignore")
    case = Case.from_dict(ROOMS[population][index])
    truth = TRUTHS[population][index]
    controls = kept_controls(case, Path(folder) / "controls" / f"{index}.npz")
    row: dict[str, Any] = {"index": index, "kind": truth["seed"][1], "truth": truth["effects"]}
    row["one"] = examined(one(case), first_of(controls), truth)
    if len(case.configurations) > 1:
        row["all"] = examined(case, controls, truth)
    if row["kind"] == 0:
        for label, factor in (("half", 0.5), ("double", 2.0)):
            room = case.room.replace(sigma=np.minimum(case.room.sigma * factor, 1))
            other = one(replace(case, room=room))
            row[label] = find(other, controls=first_of(controls)).verdict
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(row), encoding="utf-8")


ROOMS: dict[int, list[dict[str, Any]]] = {}
TRUTHS: dict[int, list[dict[str, Any]]] = {}


def load(population: int) -> None:
    ROOMS[population], TRUTHS[population] = read(population, "case"), read(population, "truth")


def run(population: int, folder: str, step: int, workers: int, kept: bool) -> None:
    load(population)
    order = np.random.default_rng(0).permutation(len(ROOMS[population]))[::step]
    jobs = [(population, int(i), folder) for i in order]
    if kept:
        jobs = [j for j in jobs if (Path(folder) / "controls" / f"{j[1]}.npz").exists()]
    with multiprocessing.Pool(workers) as pool:
        for done, _ in enumerate(pool.imap_unordered(work, jobs), 1):
            print(f"\r{done}/{len(jobs)}", end="", flush=True)
    print()


def rows_of(folder: str | None) -> list[dict[str, Any]]:
    if folder is None:
        return [json.loads(x) for x in gzip.decompress(STORED.read_bytes()).splitlines()]
    paths = sorted(Path(folder, "rows").glob("*.json"), key=lambda p: int(p.stem))
    return [json.loads(p.read_text(encoding="utf-8")) for p in paths]


def store(folder: str) -> None:
    text = "\n".join(json.dumps(r, separators=(",", ":")) for r in rows_of(folder))
    STORED.write_bytes(gzip.compress(text.encode(), mtime=0))


def sampled(index: int, folder: Path) -> dict[str, Any]:
    """Search a room of population 1 with T20, EDT and T30, and with all data."""
    case, truth = Case.from_dict(ROOMS[1][index]), TRUTHS[1][index]
    controls = kept_controls(case, folder / "controls" / f"{index}.npz")
    row = {"index": index, "kind": truth["seed"][1], "truth": truth["effects"]}
    row["one"] = row_of(find(one(case), controls=first_of(controls)))
    if len(case.configurations) > 1:
        row["all"] = row_of(find(case, controls=controls))
    return row


def sample(folder: Path, number: int) -> None:
    """Search the first rooms of a random order; what is there is kept."""
    load(1)
    warnings.simplefilter("ignore")
    (folder / "rows").mkdir(parents=True, exist_ok=True)
    for index in np.random.default_rng(57).permutation(len(ROOMS[1]))[:number].tolist():
        path = folder / "rows" / f"{index}.json"
        if not path.exists():
            path.write_text(json.dumps(sampled(index, folder)), encoding="utf-8")


def sample_rows(folder: str | None = None) -> list[dict[str, Any]]:
    """Return the rows of the sample, or of a run."""
    if folder is not None:
        return rows_of(folder)
    return [json.loads(line) for line in gzip.decompress(SAMPLE.read_bytes()).splitlines()]


def judge(folder: str | None) -> None:
    """Print flagged and detected rooms, and claims that were right, of the sample."""
    for data in ("one", "all"):
        rows = [(r, r[data]) for r in sample_rows(folder) if data in r]
        hidden = [(hidden_in(r), x) for r, x in rows if 1 <= r["kind"] <= 12]
        print(data, "flagged ", rate(found(x) for r, x in rows if r["kind"] == 0))
        print(data, "detected", rate(found(x) for _, x in hidden))
        names = [x["effect"] == n for n, x in hidden if x["verdict"] == "named"]
        families = [x["family"] in families_of([n]) for n, x in hidden if x["verdict"] == "family"]
        sets = [n in x["candidates"] for n, x in hidden if x["verdict"] == "ambiguous"]
        for words, hits in (("names", names), ("families", families), ("sets", sets)):
            print(data, f"{words} right", rate(hits))


def found(row: dict[str, Any]) -> bool:
    return row["verdict"] in FLAGS


def table(folder: str | None) -> None:
    """Print confusion matrix, rates, ROC; then what correction and proof did."""
    rows = rows_of(folder)
    for data, label in (("one", "T20, EDT, T30; one configuration"), ("all", "all data")):
        print(f"\n== {label} ==")
        here = [(r, r[data]) for r in rows if data in r]
        naming(here, data, rows)
        confusion(here)
        roc(here)
        mending(here)


def naming(here: list[Any], data: str, rows: list[dict[str, Any]]) -> None:
    controls = [x for r, x in here if r["kind"] == 0]
    print("controls flagged          ", rate(found(x) for x in controls))
    if data == "one":
        for label in ("half", "double"):
            flagged = [r[label] in FLAGS for r in rows if label in r]
            print(f"  sigma stated at {label:6}    ", rate(flagged))
    hidden = [(hidden_in(r), x) for r, x in here if 1 <= r["kind"] <= 12]
    caught = [(n, x) for n, x in hidden if found(x)]
    single = [(n, x) for n, x in caught if x["verdict"] == "named"]
    print("detected                  ", rate(found(x) for _, x in hidden))
    print("right name of the detected", rate(x["effect"] == n for n, x in caught))
    print("truth in the set          ", rate(n in x["candidates"] for n, x in caught))
    print(f"mean size of the set       {np.mean([len(x['candidates']) for _, x in caught]):.2f}")
    print("a single name claimed     ", rate(x["verdict"] == "named" for _, x in caught))
    print("  and right               ", rate(x["effect"] == n for n, x in single))
    unknown = [x for r, x in here if r["kind"] == 13]
    print("in no library: detected   ", rate(found(x) for x in unknown))
    print('  and called "unknown"    ', rate(x["effect"] == "unknown" for x in unknown if found(x)))
    for kind, inside in TOGGLED.items():
        other = ({"opening", "audience"} - {NAMES[inside]}).pop()
        caught = [x for r, x in here if r["kind"] == kind and found(x)]
        told = [other not in x["candidates"] for x in caught]
        if data == "all":
            print(f"{NAMES[inside]:9} toggled, told apart", rate(told))
    for kind, inside in TWINS.items():
        twins = [x for r, x in here if r["kind"] == kind and found(x)]
        if twins:
            print(
                f"twins of {NAMES[inside]:12}      ambiguous",
                rate(len(x["candidates"]) > 1 for x in twins),
            )


def most_probable(row: dict[str, Any]) -> str:
    """Return the most probable effect of a finding, "not detected" where it is not flagged."""
    if not found(row):
        return "not detected"
    effects = {k: v for k, v in row["probabilities"].items() if k != NOTHING}
    return max(effects, key=effects.__getitem__)


def confusion(here: list[Any]) -> None:
    print("\nhidden: the most probable effect, how often")
    for name in (NOTHING, *NAMES.values(), "people"):
        count = Counter(
            most_probable(x) for r, x in here if hidden_in(r) == name and r["kind"] in (0, *NAMES)
        )
        cells = ", ".join(f"{best} {n}" for best, n in count.most_common())
        print(f"  {name}: {cells or '-'}")


def roc(here: list[Any]) -> None:
    none = np.array([x["score"] for r, x in here if r["kind"] == 0])
    some = np.array([x["score"] for r, x in here if 1 <= r["kind"] <= 12])
    if not len(none) or not len(some):
        return
    print("\nROC: detected at a share of false alarms")
    for alarms in (0.01, 0.02, 0.05, 0.1, 0.2):
        limit = np.quantile(none, 1 - alarms)
        print(f"  {alarms:.2f}: {np.mean(some > limit):.3f}", end="")
    area = np.mean(some[:, None] > none) + 0.5 * np.mean(some[:, None] == none)
    print(f"   area {area:.3f}")


def mending(here: list[Any]) -> None:
    """Print what the correction did to alpha and to the gaps, and what verification said."""
    done = [(r, x) for r, x in here if 1 <= r["kind"] <= 12 and "rmse" in x]
    if not done:
        return
    table = np.array([x["rmse"] for _, x in done])
    print("\nof rooms with a finding that was added, rightly named or not:")
    ratio = np.median(table[:, 2] / table[:, 1])
    print(
        f"alpha's RMSE, medians: prior {np.median(table[:, 0]):.4f}, "
        f"plain {np.median(table[:, 1]):.4f}, "
        f"corrected {np.median(table[:, 2]):.4f}; corrected/plain {ratio:.2f}"
    )
    print("corrected no worse than the prior ", rate(table[:, 2] <= table[:, 0] * (1 + 1e-9)))
    for name in (*SHAPES, "volume"):
        quantities = ("EDT/T20", "T30/T20") if name in SHAPES else ("G",)
        gains = [
            np.mean([g[3] for g in x["gaps"] if g[1] in quantities])
            / np.mean([g[2] for g in x["gaps"] if g[1] in quantities])
            for r, x in done
            if hidden_in(r) == name and any(g[1] in quantities for g in x["gaps"])
        ]
        if gains:
            print(
                f"{name:18} {' and '.join(quantities)} after/before, median {np.median(gains):.2f}"
                f" of {len(gains)}"
            )
    wrong = [x for r, x in done if x["effect"] != hidden_in(r)]
    right = [(r, x) for r, x in done if x["effect"] == hidden_in(r)]
    print(
        "wrongly named: withdrawn or ambiguous",
        rate(x["verification"] == "withdrawn" or x["verdict"] == "ambiguous" for x in wrong),
    )
    print(
        "rightly named: withdrawn             ",
        rate(x["verification"] == "withdrawn" for _, x in right),
    )
    print("rightly named: the interval holds the size", rate(inside(right)))
    two = [(r, x) for r, x in here if r["kind"] == DOUBLE]
    if two:
        both = [
            {name_of(e) for e in r["truth"]} == {x["effect"], x.get("second", {}).get("effect")}
            for r, x in two
        ]
        better = [
            x.get("second", {}).get("rmse", x["rmse"][2]) <= 0.5 * x["rmse"][1]
            for _, x in two
            if "rmse" in x
        ]
        print("two hidden effects: both named in two rounds", rate(both))
        # Where nothing was detected, alpha stays as plainly calibrated: no better.
        missing = [False] * (len(two) - len(better))
        print(
            "  alpha's RMSE at most half of plain's      ",
            rate([*better, *missing]),
            f"({sum(better)}; {len(missing)} with nothing detected)",
        )
        missed = Counter(
            " + ".join(sorted(name_of(e) for e in r["truth"]))
            for (r, _), ok in zip(two, both, strict=True)
            if not ok
        )
        print("  missed:", ", ".join(f"{k} {v}" for k, v in missed.most_common()))


def inside(right: list[Any]) -> list[bool]:
    """Whether each rightly named room's interval holds the true size."""
    out = []
    for row, x in right:
        effect = row["truth"][0]
        key = SIZES.get(effect["kind"])
        if key is None or x["size"] is None or effect["kind"] in (3, 6):
            continue  # air and formula have no size; audience and resonator another measure of it
        out.append(x["size"][1] <= effect[key] <= x["size"][2])
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("run", "table", "store", "sample", "judge"))
    parser.add_argument("--number", type=int, default=60, help="rooms of a sample")
    parser.add_argument("--folder")
    parser.add_argument("--population", type=int, default=1)
    parser.add_argument("--step", type=int, default=1, help="every so many rooms")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--kept", action="store_true", help="rooms whose control rooms stand")
    chosen = parser.parse_args()
    if chosen.what == "run":
        run(chosen.population, chosen.folder, chosen.step, chosen.workers, chosen.kept)
    elif chosen.what == "store":
        store(chosen.folder)
    elif chosen.what == "sample":
        sample(Path(chosen.folder), chosen.number)
    elif chosen.what == "judge":
        judge(chosen.folder)
    else:
        table(chosen.folder)


if __name__ == "__main__":
    main()
