"""The trust that the likelihood of positions deserves when it names effects and surfaces.

    # in situ
    python -m benchmarks.studies.pairs.where_temper run --cache out --population 0 --rooms 0-39
    python -m benchmarks.studies.pairs.where_temper table  # of the stored rows

Log evidences are divided by a temper, and the probabilities of families by means over positions are
multiplied in with a power. Both are chosen by the log score of the true family and of the true surface,
in rooms that had been read and in which something is detected: the probability that was given to
the truth, in nats. `table` also prints the score of a temper that the other populations chose. The
candidates hold different probabilities.
"""

from __future__ import annotations

import argparse
import gzip
import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import logsumexp

from benchmarks.studies.geometric_world.load import IN_SITU, load, truth
from benchmarks.studies.geometric_world.rooms import NOTHING
from benchmarks.studies.pairs.where import case_of, prepared, read
from benchmarks.studies.pairs.where_figures import ABSORBERS, DATA, family_of, right_families
from benchmarks.studies.pairs.where_threshold import numbers_of
from rtcal.finder.claim import CLAIMED
from rtcal.finder.evidence import log_sums
from rtcal.finder.positions import search
from rtcal.finder.positions.problem import COUPLED
from rtcal.finder.positions.search import (
    LEAST_BY_MEANS,
    THRESHOLD,
    evaluate,
    evidence_of_means,
    weights,
)
from rtcal.finder.prior import NONE

STORED = Path(__file__).with_name("where_temper.jsonl.gz")
TEMPERS = (1.25, 1.5, 2.0, 3.0, 4.0)
HELD = (0.6, 0.7, 0.8, 0.85)
"""Probabilities that the candidates may hold."""
POWERS = (0.0, 0.25, 0.5, 1.0)
ADDED = "added absorption"
_SMALLEST = 1e-6
Row = dict[str, Any]


def of_room(population: int, index: int, data: str, cache: Path) -> Row | None:
    """Return the probabilities of a room by family and surface; None where means say nothing."""
    case = case_of(load(population, index, IN_SITU), data)
    means = evidence_of_means(case, cache=cache)
    if means is None:
        return None
    numbers, every = prepared(case, cache)
    evidence = evaluate(numbers.likelihoods(), every, numbers.residual[:, np.newaxis])
    score, noise = search.scores(weights(evidence, every), every)
    by_temper = {}
    for temper in TEMPERS:
        posterior = weights(evidence, every, temper)
        surfaces = [-1 if j is None else j for j in every.by_row("surface")]
        logs = log_sums([*zip(every.by_row("family"), surfaces, strict=True)], posterior[:, 0])
        chances = {k: float(np.exp(v - logsumexp(posterior[:, 0]))) for k, v in logs.items()}
        by_temper[str(temper)] = [
            [family, surface, float(f"{p:.3g}")]
            for (family, surface), p in chances.items()
            if p > _SMALLEST
        ]
    hidden = truth(population, index)
    faces = [m for m, some in enumerate(case.faces.values()) if hidden["surface"] in some]
    return {
        "population": population,
        "index": index,
        "data": data,
        "kind": hidden["kind"],
        "surface": faces[0] if faces and hidden["kind"] in ABSORBERS else -1,
        "n_surfaces": len(case.faces),
        "score": round(float(score[0]), 2),
        "noise": round(float(noise[0]), 2),
        "score_of_means": round(means.score, 2),
        "threshold_of_means": means.threshold,
        "means": {f: round(p, 5) for f, p in means.families.items()},
        "positions": by_temper,
    }


def pooled(row: Row, temper: float, power: float) -> dict[tuple[str, int], float]:
    """Return probabilities by family and surface, as `posterior.with_families`."""
    out = {
        (family, surface): p * max(row["means"].get(family, 0.0), LEAST_BY_MEANS) ** power
        for family, surface, p in row["positions"][str(temper)]
    }
    total = sum(out.values())
    return {key: p / total for key, p in out.items()}


def of_family(row: Row, temper: float, power: float) -> float:
    """Return the probability of the right family, given that something is other than stated."""
    table = {key: p for key, p in pooled(row, temper, power).items() if key[0] != NONE}
    right = right_families(row["kind"])
    return sum(p for (family, _), p in table.items() if family in right) / sum(table.values())


def of_surfaces(row: Row, temper: float, power: float) -> np.ndarray:
    """Return the probability that something stands on each surface, (n_surfaces,)."""
    out = np.zeros(row["n_surfaces"])
    for (_, surface), p in pooled(row, temper, power).items():
        if surface >= 0:
            out[surface] += p
    return out


def names_family(row: Row, temper: float, power: float) -> bool:
    """Return whether a finding names the right family."""
    families: dict[str, float] = {}
    for (family, _), p in pooled(row, temper, power).items():
        families[family] = families.get(family, 0.0) + p
    return right_name(row, families)


def right_name(row: Row, families: dict[str, float]) -> bool:
    """Return whether the right family is named: the claimed one, or else the most probable."""
    added = [p for family, p in families.items() if family.startswith(ADDED)]
    if ADDED not in families and len(added) > 1:
        families = {**families, ADDED: sum(added)}
    claimed = [f for f, p in families.items() if f != NONE and p >= CLAIMED]
    said = {"family": max(claimed, key=len) if claimed else None, "families": families}
    return family_of(said) in right_families(row["kind"])


def scores(rows: Sequence[Row], temper: float, power: float) -> tuple[float, float]:
    """Return the mean log score of the true family and of the true surface."""
    family = [np.log(max(of_family(r, temper, power), 1e-4)) for r in rows if r["kind"] != NOTHING]
    surface = []
    for row in rows:
        if row["surface"] >= 0:
            chance = of_surfaces(row, temper, power)
            share = chance[row["surface"]] / max(chance.sum(), _SMALLEST)
            surface.append(np.log(max(share, 1e-4)))
    return float(np.mean(family)), float(np.mean(surface))


def line(rows: Sequence[Row], temper: float, power: float) -> str:
    """Return the scores, and how often surfaces are right."""
    family, surface = scores(rows, temper, power)
    hidden = [row for row in rows if row["kind"] != NOTHING]
    named = sum(names_family(row, temper, power) for row in hidden)
    claimed = claims = 0
    for row in rows:
        chance = of_surfaces(row, temper, power)
        best = int(chance.argmax())
        table = pooled(row, temper, power)
        aperture = max(table, key=lambda key: table[key])[0] == COUPLED.family
        if chance[best] >= CLAIMED and not aperture:
            claims, claimed = claims + 1, claimed + (best == row["surface"])
    absorbers = [row for row in rows if row["surface"] >= 0]
    ranked = [rank_and_numbers(row, temper, power) for row in absorbers]
    first = sum(rank == 0 for rank, _ in ranked)
    held = "; ".join(
        f"{share:g} in {sum(rank < numbers[h] for rank, numbers in ranked)} "
        f"(mean {np.mean([numbers[h] for _, numbers in ranked]):.2f})"
        for h, share in enumerate(HELD)
    )
    return (
        f"temper {temper:4} power {power:4}: log score of family {family:.2f}, "
        f"of surface {surface:.2f}; families {named} of {len(hidden)}; first {first} of "
        f"{len(absorbers)}, claimed {claims}, right {claimed}; candidates that hold {held}"
    )


def rank_and_numbers(row: Row, temper: float, power: float) -> tuple[int, list[int]]:
    """Return the true surface's rank, and how many surfaces hold each of `HELD`."""
    chance = of_surfaces(row, temper, power)
    order = np.argsort(-chance)
    held = np.cumsum(chance[order]) / max(chance.sum(), _SMALLEST)
    numbers = [min(int(np.searchsorted(held, share)) + 1, len(order)) for share in HELD]
    return int(np.flatnonzero(order == row["surface"])[0]), numbers


def left_out(rows: Sequence[Row]) -> str:
    """Return the scores where each population's temper and power are the others' choice."""
    said = []
    for population in sorted({row["population"] for row in rows}):
        others = [row for row in rows if row["population"] != population]
        best = max(((t, w) for t in TEMPERS for w in POWERS), key=lambda c: sum(scores(others, *c)))
        family, surface = scores([r for r in rows if r["population"] == population], *best)
        said.append(
            f"population {population}, by the others' temper {best[0]:g} and power {best[1]:g}: "
            f"{family:.2f}, {surface:.2f}"
        )
    return "\n  ".join(said)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("command", choices=("run", "table"))
    parser.add_argument("--cache", type=Path, help="folder of control runs and weighings")
    parser.add_argument("--out", type=Path, default=STORED, help="file of the rows")
    parser.add_argument("--population", type=int, default=0)
    parser.add_argument("--rooms", default="0-39")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    if given.command == "run":
        for index in numbers_of(given.rooms):
            for data in DATA:
                row = of_room(given.population, index, data, given.cache)
                if row is not None:
                    with gzip.open(given.out, "at", encoding="utf-8") as stream:
                        stream.write(json.dumps(row, separators=(",", ":")) + "\n")
                print(index, data, None if row is None else row["kind"], flush=True)
        return
    rows = read(given.out)
    for data, words in DATA.items():
        some = [row for row in rows if row["data"] == data and row["score"] > THRESHOLD]
        hidden = [row for row in some if row["kind"] != NOTHING]
        named = sum(right_name(row, row["means"]) for row in hidden)
        print(f"{words}: {len(some)} rooms in which something is detected; means alone name")
        print(f"  the right family of {named} of {len(hidden)}")
        for power in POWERS:
            for temper in TEMPERS:
                print(" ", line(some, temper, power))
        print(" ", left_out(some))


if __name__ == "__main__":
    main()
