"""The figures of `benchmarks.studies.pairs.where`: what a run of rooms shows, with 95 % intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from benchmarks.studies.geometric_world.load import EMPTY, HIDDEN, ON_A_SURFACE, truth
from benchmarks.studies.means.judging import FLAGS, NOTHING, families_of
from benchmarks.studies.rates import Line, over, share
from benchmarks.studies.stored import Row

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
ASKED = {
    "flagged with nothing hidden": (0, 0.05),
    "detected more than by means": (0.12, 1),
    "right family, of the detected": (0.85, 1),
    "right surface, of absorbers detected": (0.6, 1),
    "right surface among the candidates": (0.85, 1),
    "candidates, mean": (1, 2),
    "a single surface claimed: right": (0.9, 1),
    "gap corrected / plain, median": (0, 0.7),
    "rooms in which it shrinks": (0.85, 1),
}
"""The lowest and the highest figure that meets what was asked."""


def asked(data: str) -> dict[str, tuple[float, float]]:
    """Return the limits for one kind of data by name."""
    more = {"right surface, of absorbers detected": (0.75, 1.0)} if data == "level" else {}
    return ASKED | more


def right_families(kind: str) -> frozenset[str]:
    """Families that are right: of an absorber its own, and "added absorption"."""
    return frozenset(OF_KIND.get(kind, ())) or families_of([kind])


class Rows:
    """Rows of one kind of data beside the truth of their rooms."""

    def __init__(self, rows: Iterable[Row], population: int, data: str) -> None:
        chosen = {r["index"]: r for r in rows if r["data"] == data}
        self.all = [(truth(population, i), row) for i, row in sorted(chosen.items())]

    def only(self, kinds: Sequence[str], flagged: bool | None = None) -> list[tuple[Row, Row]]:
        """Return the rooms of some kinds, or those of them that were flagged."""
        return [
            (t, r)
            for t, r in self.all
            if t["kind"] in kinds and flagged in (None, r["verdict"] in FLAGS)
        ]


def family_of(row: Row) -> str | None:
    """Return the family that is claimed, or else the most probable one."""
    if row["family"]:
        return str(row["family"])
    wide = {f.split(",")[0] for f in row["families"] if "," in f}
    narrow = {f: p for f, p in row["families"].items() if f not in wide | {NOTHING, "unknown"}}
    return max(narrow, key=lambda f: narrow[f]) if narrow else None


def common(rows: Rows) -> dict[str, Line]:
    """Return the lines that a finder without a geometry has as well."""
    caught = rows.only(HIDDEN, True)
    right = [(r, family_of(r) in right_families(t["kind"])) for t, r in caught]
    empty = sorted((r["score"] for _, r in rows.only((EMPTY,))), reverse=True)[1:2]

    def flagged(kinds: Sequence[str]) -> Line:
        return share(r["verdict"] in FLAGS for _, r in rows.only(kinds))

    return {
        "flagged with nothing hidden": flagged((EMPTY,)),
        "detected": flagged(HIDDEN),
        "detected, absorbers alone": flagged(ABSORBERS),
        "detected where one empty room is flagged": share(
            r["score"] > limit for limit in empty for _, r in rows.only(HIDDEN)
        ),
        "ends as unknown, of the detected": share(r["verdict"] == "unknown" for _, r in caught),
        "right family, of the detected": share(hit for _, hit in right),
        "the same, where one is claimed": share(
            hit for r, hit in right if r["verdict"] in ("named", "family")
        ),
    }


def places(rows: Rows) -> dict[str, Line]:
    """Return how often the right surface was named."""
    caught = rows.only(ABSORBERS, True)
    walls = [(t, r) for t, r in caught if t["kind"] not in WHOLE_PLACES]
    claimed = [r for _, r in rows.all if r["surface"] is not None and r["verdict"] in FLAGS]
    # Other sizes are no areas: a distance, or a factor of coefficients.
    sized = [
        (t["size"], r["best"]["size"]) for t, r in caught if r["best"] and r["best"]["surface"]
    ]
    return {
        "right surface, of absorbers detected": share(is_first(r) for _, r in caught),
        "the same without audiences": share(is_first(r) for _, r in walls),
        "by chance": over(np.mean, [1 / r["n_surfaces"] for _, r in caught]),
        "right surface among the candidates": share(
            r["true_surface"] in r["likely"] for _, r in caught
        ),
        "candidates, mean": over(np.mean, [len(r["likely"]) for _, r in caught]),
        "a single surface is claimed": share(r["surface"] is not None for _, r in caught),
        "a single surface claimed: right": share(
            r["surface"] == r["true_surface"] for r in claimed
        ),
        "size in its 90 % interval": share(
            low <= size <= high for size, (_, low, high) in sized if low is not None
        ),
    }


def is_first(row: Row) -> bool:
    """Return whether the true surface is the most probable one."""
    table = row["surfaces"]
    return (max(table, key=lambda name: table[name]) if table else None) == row["true_surface"]


def gaps(rows: Rows) -> dict[str, Line]:
    """Return how the gap at held-out pairs shrinks where the effect changes T by over 10 %."""
    large = [r for t, r in rows.only(HIDDEN) if t["effect_on_t"] > LARGE and r.get("gaps")]
    out: dict[str, Line] = {}
    for key, words in (("gaps", ""), ("gaps_heard", ", to what is heard")):
        ratios = [r[key]["corrected"] / r[key]["plain"] for r in large]
        out[f"gap corrected / plain, median{words}"] = over(np.median, ratios)
        out[f"rooms in which it shrinks{words}"] = share(x < 1 for x in ratios)
        for which in MODELS:
            out[f"gap {which}, JND{words}"] = over(np.mean, [r[key][which] for r in large])
    return out


def summary(
    found: Iterable[Row], means: Iterable[Row], population: int, data: str
) -> dict[str, Line]:
    """Return every figure of one kind of data by its name; those of the means begin with "means: ".

    The means, and the gain over them, are of the rooms that both have judged.
    """
    rows, others = Rows(found, population, data), Rows(means, population, data)
    out = {**common(rows), **places(rows), **gaps(rows)}
    out["processor time, s, median"] = over(np.median, [r["processor"] for _, r in rows.all])
    of_means = {id(t): r for t, r in others.all}
    both = [(t, r, of_means[id(t)]) for t, r in rows.all if id(t) in of_means]
    others.all = [(t, m) for t, _, m in both]
    out |= {f"means: {name}": line for name, line in common(others).items()}
    gained = [
        float(r["verdict"] in FLAGS) - float(m["verdict"] in FLAGS)
        for t, r, m in both
        if t["kind"] in HIDDEN
    ]
    return out | {"detected more than by means": over(np.mean, gained)}


def print_confusion(rows: Rows) -> None:
    """Print what was hidden against the most probable effect."""
    print("rows: hidden; columns: the most probable effect where flagged; '-' not flagged")
    count = Counter(
        (t["kind"], effect_of(r) if r["verdict"] in FLAGS else "-") for t, r in rows.all
    )
    seen = dict.fromkeys([*HIDDEN, *(effect for _, effect in count)])
    names = [n for n in seen if n != "-" and any(effect == n for _, effect in count)]
    print(f"{'':16}{'-':>4}" + "".join(f"{n[:8]:>9}" for n in names))
    for kind in (*HIDDEN, EMPTY):
        if rows.only((kind,)):
            cells = "".join(f"{count[kind, n] or '.':>9}" for n in names)
            print(f"{kind:16}{count[kind, '-']:4}{cells}")


def effect_of(row: Row) -> str:
    """Return the most probable effect."""
    return str((row.get("best") or {}).get("effect") or row["effect"])


def table(found: list[Row], means: list[Row], population: int) -> None:
    """Print every line with its 95 % interval, and what was asked of it."""
    for data, words in DATA.items():
        rows, limits = Rows(found, population, data), asked(data)
        print(f"\n== {words}: {len(rows.all)} rooms of population {population} ==")
        for name, (value, low, high, n) in summary(found, means, population, data).items():
            if n == 0:
                continue
            line = f"{name:46}{value:7.3f}  [{low:.3f}, {high:.3f}] of {n:<4}"
            if name in limits:
                least, most = limits[name]
                met = "met" if least <= value <= most else "not met"
                line += f" asked {least:g} to {most:g}: {met}"
            print(line)
        print_confusion(rows)
