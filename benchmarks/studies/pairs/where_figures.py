"""The figures of `benchmarks.studies.pairs.where`: what a run of rooms shows, with 95 % intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks.studies.fits.positions_table import bootstrap, share
from benchmarks.studies.geometric_world.load import EMPTY, HIDDEN, ON_A_SURFACE, truth
from benchmarks.studies.means.judging import FLAGS, NOTHING, families_of

DATA = {"without": "without level", "level": "with level"}
ABSORBERS = ON_A_SURFACE
WHOLE_PLACES = ("audience",)
"""Kinds whose surface follows from their name: people stand on floors."""
MODELS = ("before", "plain", "corrected")
LARGE = 0.10
"""The gap is judged where the effect changes T by more, on average over the bands."""
ROOMS = {
    "sixth": "0 to 70, 72 and 74 of population 3",
    "eleventh": "from 75 of population 3, where T changes by 0.2 and more, with 4,000 paths",
    "tenth": "30 to 36 of population 4, with twice the paths in control runs",
    "ninth": "24 to 29 of population 4",
    "eighth": "15 to 23 of population 4",
    "seventh": "0 to 14 of population 4",
    "first": "0 to 42 of population 1, with a handbook's coefficients",
}
"""The rooms that the stored rows are of. Each set was judged once, by the finder of its day."""


OF_KIND = {
    "receiver": ("measurement",),
    "coupled room": ("field",),
    "covered surface": ("less absorption",),
}
"""Right families of kinds whose name is no effect of `rtcal.finder`."""


def chosen(rows: Iterable[dict[str, Any]], which: str) -> list[dict[str, Any]]:
    """Return the stored rows of some rooms; ``which`` is of `ROOMS`."""
    return [r for r in rows if r["rooms"] == which]


def right_families(kind: str) -> frozenset[str]:
    """Families that are right: of an absorber its own, and "added absorption"."""
    return frozenset(OF_KIND.get(kind, ())) or families_of([kind])


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
    empty = sorted((r["score"] for _, r in rows.only((EMPTY,))), reverse=True)[1:2]
    return {
        "flagged with nothing hidden": portion(flags(rows, (EMPTY,))),
        "detected": portion(flags(rows, HIDDEN)),
        "detected, absorbers alone": portion(flags(rows, ABSORBERS)),
        "detected where one empty room is flagged": portion(
            r["score"] > limit for limit in empty for _, r in rows.only(HIDDEN)
        ),
        "ends as unknown, of the detected": portion(r["verdict"] == "unknown" for _, r in caught),
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
    # Other sizes are no areas: a distance, or a factor of coefficients.
    sized = [
        (t["size"], r["best"]["size"]) for t, r in caught if r["best"] and r["best"]["surface"]
    ]
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
    for kind in (*HIDDEN, EMPTY):
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
