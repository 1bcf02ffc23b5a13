"""Shared by the finder's benchmarks: kept control rooms, findings as rows, rates with intervals.

A row is what one `find` claimed, as plain values. A judged room is a row with its truth: the name of
the effect that is hidden, "none", or "unknown" where no effect of the library was hidden.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.rates import rate
from benchmarks.studies.stored import Row
from rtcal.finder import Case, Finding, control_rooms, library
from rtcal.finder.means.engines import ENGINES, ControlRooms

NOTHING = "none"
UNKNOWN = "unknown"
FLAGS = ("named", "family", "ambiguous", "unknown")
"""Verdicts that say that the model lacks something."""


def one(case: Case) -> Case:
    """T20, EDT and T30 in the first configuration."""
    return case.only("t20", "edt", "t30", configurations=[case.configurations[0].name])


def first_of(controls: Sequence[ControlRooms]) -> list[ControlRooms]:
    """The control rooms of the first configuration."""
    return [ControlRooms(c.engine, c.errors[:, :1]) for c in controls]


def kept_controls(case: Case, path: Path) -> list[ControlRooms]:
    """The case's control rooms, run once and kept; run anew where rtcal lacks an engine of theirs."""
    if path.exists():
        with np.load(path) as table:
            if set(table.files) <= set(ENGINES):
                return [ControlRooms(name, table[name].astype(float)) for name in table.files]
    rooms = control_rooms(case)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, **{c.engine: c.errors.astype(np.float32) for c in rooms})
    return [ControlRooms(c.engine, c.errors.astype(np.float32).astype(float)) for c in rooms]


def row_of(finding: Finding) -> Row:
    """The finding as plain values."""
    size = finding.size
    # By how many nats a threshold is exceeded, of T20 or of all data; below 0, neither.
    every = (finding.detection, *finding.detection.parts.values())
    return {
        "verdict": finding.verdict,
        "effect": finding.effect,
        "family": finding.family,
        "candidates": list(finding.names),
        "score": finding.score,
        "threshold": finding.threshold,
        "excess": max(d.score - d.threshold for d in every),
        "parameters": {} if finding.best is None else dict(finding.best.parameters),
        "evidence": {k: round(v, 2) for k, v in finding.evidence.items()},
        "probabilities": rounded(finding.probabilities),
        "families": rounded(finding.families),
        "size": None if size is None else [size.mean, size.low, size.high],
    }


def rounded(table: Any) -> dict[str, float]:
    return {k: round(float(v), 4) for k, v in table.items()}


def families() -> dict[str, str]:
    """The family of each effect of the library."""
    return {e.name: e.family for e in library()}


def families_of(names: Iterable[str]) -> frozenset[str]:
    """The families of these effects, and wider ones: "added absorption" of its flat, rising, low."""
    table = families()
    narrow = {table[n] for n in names if n in table} - {""}
    return frozenset(narrow | {f.split(",")[0] for f in narrow})


@dataclass(frozen=True)
class Judged:
    """A judged room: what was hidden and what was claimed.

    ``truths`` are the names that are right: one, or several that mean the same. ``group`` is how the
    case states its uncertainty, or any other division of the rooms.
    """

    truths: frozenset[str]
    row: Row
    group: str = ""

    @property
    def nothing(self) -> bool:
        return NOTHING in self.truths

    @property
    def hidden(self) -> bool:
        """Whether an effect of the library is hidden."""
        return not self.nothing and UNKNOWN not in self.truths

    @property
    def flagged(self) -> bool:
        return self.row["verdict"] in FLAGS

    @property
    def single(self) -> bool:
        """Whether one name is claimed."""
        return self.row["verdict"] == "named"

    @property
    def families(self) -> frozenset[str]:
        """The families that are right."""
        return families_of(self.truths)

    @property
    def right_name(self) -> bool:
        return self.row["effect"] in self.truths

    @property
    def right_family(self) -> bool:
        return self.row["family"] in self.families

    @property
    def truth_in_set(self) -> bool:
        """Whether the truth is in what is named: the name, the family, or the candidates."""
        if self.row["verdict"] == "family":
            return self.right_family
        return bool(self.truths & {*self.row["candidates"], self.row["effect"]})


def calibration_error(
    stated: Sequence[float] | np.ndarray, right: Sequence[bool] | np.ndarray, bins: int = 10
) -> tuple[float, list[tuple[int, float, float]]]:
    """Return the expected calibration error, and per bin count, mean probability and frequency.

    Sum over equal bins of count/total |mean probability - frequency| (Naeini, Cooper, Hauskrecht
    2015).
    """
    p, hit = np.asarray(stated, float), np.asarray(right, float)
    which = np.minimum((p * bins).astype(int), bins - 1)
    rows = [
        (int(within.sum()), float(p[within].mean()), float(hit[within].mean()))
        for within in (which == b for b in range(bins))
        if within.any()
    ]
    return sum(n / len(p) * abs(x - y) for n, x, y in rows), rows


def stated_probabilities(
    rooms: Sequence[Judged], what: str, every: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """The probability of each room's most probable answer, or of ``every`` answer; whether right.

    ``what`` is "probabilities" (of effects) or "families", of which those wider than others are left
    out. "none", "unknown" and "coefficients" are answers like any other.
    """
    answers = []
    for room in rooms:
        table = room.row[what]
        wide = {name.split(",")[0] for name in table if "," in name}
        narrow = {k: p for k, p in table.items() if k not in wide}
        right = room.truths if what == "probabilities" else room.truths | room.families
        named = narrow if every else sorted(narrow, key=lambda k: -narrow[k])[:1]
        answers += [(narrow[name], name in right) for name in named]
    stated, hits = np.array(answers, dtype=float).T
    return stated, hits


def print_rates(rooms: Sequence[Judged]) -> None:
    """Print what was asked of one world and one set of data."""
    controls = [r for r in rooms if r.nothing]
    hidden = [r for r in rooms if r.hidden]
    caught = [r for r in hidden if r.flagged]
    print("controls flagged              ", rate(r.flagged for r in controls))
    for group in sorted({r.group for r in controls} - {""}):
        print(f"  {group:28}", rate(r.flagged for r in controls if r.group == group))
    said = Counter(
        f"{r.row['verdict']} {r.row['family'] if r.row['verdict'] == 'family' else r.row['effect']}"
        for r in controls
        if r.flagged
    )
    if said:
        print("  as:", ", ".join(f"{k} {n}" for k, n in said.most_common()))
    print("detected                      ", rate(r.flagged for r in hidden))
    print("a single name claimed         ", rate(r.single for r in caught))
    named = [r for r in caught if r.single]
    print("  and right, of hidden        ", rate(r.right_name for r in named))
    print("  and right, of all rooms     ", rate(r.right_name for r in rooms if r.single))
    for group in sorted({r.group for r in caught} - {""}):
        print(f"    {group:26}", rate(r.right_name for r in named if r.group == group))
    family = [r for r in caught if r.row["verdict"] == "family"]
    print("a family claimed              ", rate(r.row["verdict"] == "family" for r in caught))
    print("  and right                   ", rate(r.right_family for r in family))
    print("truth in the set, of detected ", rate(r.truth_in_set for r in caught))
    unknown = [r for r in rooms if UNKNOWN in r.truths]
    print("in no library: detected       ", rate(r.flagged for r in unknown))
    print("  and a name or family claimed", rate(r.row["verdict"] in FLAGS[:2] for r in unknown))
    for what in ("probabilities", "families"):
        print_calibration(rooms, what)


def print_calibration(rooms: Sequence[Judged], what: str) -> None:
    """Print calibration errors of the most probable answer and of every one, then the former's bins.

    Beside them what probabilities that are exactly right would show by chance: in so few rooms the
    error is not 0 even then.
    """
    for label, every in (("most probable", False), ("every one", True)):
        p, hit = stated_probabilities(rooms, what, every)
        error, bins = calibration_error(p, hit)
        rng = np.random.default_rng(0)
        picked = rng.integers(len(p), size=(400, len(p)))
        drawn = [calibration_error(p[i], hit[i])[0] for i in picked]
        low, high = np.quantile(drawn, [0.025, 0.975])
        chance = [calibration_error(p, rng.random(len(p)) < p)[0] for _ in range(400)]
        print(
            f"calibration error, {what}, {label}: {error:.3f} [{low:.3f}, {high:.3f}] of {len(p)}; "
            f"by chance {np.mean(chance):.3f} to {np.quantile(chance, 0.95):.3f}; "
            f"mean stated {p.mean():.3f}, right {hit.mean():.3f}"
        )
        print("  stated:right (number)  " + "  ".join(f"{x:.2f}:{y:.2f} ({n})" for n, x, y in bins))


def print_confusion(rooms: Sequence[Judged], names: Sequence[str]) -> None:
    """Print what was hidden against the best name of the flagged rooms."""
    print("hidden: the best name where flagged, how often")
    for name in names:
        count = Counter(
            str(r.row["effect"]) if r.flagged else "not flagged" for r in rooms if name in r.truths
        )
        if count:
            print(f"  {name}: " + ", ".join(f"{best} {n}" for best, n in count.most_common()))
