"""Several effects at once, on the rooms of the first hidden world that lack two (studies/hidden_world).

    # can be resumed
    python -m benchmarks.studies.means.several_effects controls --folder out --population 1
    # what any test could do
    python -m benchmarks.studies.means.several_effects bound --folder out --population 1
    python -m benchmarks.studies.means.several_effects run --folder out --population 1  # then: table

Population 0 is for development. It has 12 rooms with two effects; as many as ``--more`` says are
built beside them, from the numbers that follow. Population 1 judges. ``--more 100 --first 50 --singles
60`` takes the last 50 of 100 built rooms with two effects and 60 built rooms with one, turn by turn.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any

import numpy as np
from scipy.stats import norm

from benchmarks.studies.hidden_world.generate import read
from benchmarks.studies.hidden_world.populations import DOUBLE
from benchmarks.studies.means.hidden_effects import NAMES, name_of, rmse
from benchmarks.studies.means.judging import (
    families,
    kept_controls,
    rate,
    rounded,
    row_of,
)
from benchmarks.studies.means.second_world import place
from benchmarks.studies.means.several_effects_rooms import (
    BUILT_SINGLE,
    DATA,
    built_singles,
    cut,
    judged_alone,
    pairs_from,
    rooms,
    true_effects,
)
from rtcal.finder import Case, recalibrate
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.means.problem import (
    MOST,
    MeansProblem,
    ModelDiscrepancy,
    averaged_alpha,
    compare,
    covariance_with_alpha,
    estimate_discrepancy,
    moments,
    observe,
    predict_hypotheses,
)
from rtcal.finder.means.recalibration import plain
from rtcal.finder.search import find

LEVEL = 0.05
"""Of Neyman and Pearson's test: one effect taken for two."""


def distances_apart(
    case: Case, truth: dict[str, Any], discrepancy: ModelDiscrepancy
) -> tuple[float, float, float]:
    """Return how far the pair is from the nearest effect alone, in standard deviations, and its test.

    The first with the model's error, the second with a model that has none. The third is the log
    likelihood ratio of the measurement over that distance, less half of it: above the quantile of a
    normal density the test says "two".
    """
    observed, _ = observe(case)
    mask = observed.used.ravel()
    effects = true_effects(case, truth)
    both = predict_hypotheses(replace(case, applied=effects), [])
    of_alpha = MeansProblem(case, observed, both, discrepancy).of_alpha(slice(0, 1))[0][0]
    own = of_alpha + observed.covariance
    whole = own + discrepancy.covariance[np.ix_(mask, mask)]
    out = []
    for effect in effects:
        alone = predict_hypotheses(replace(case, applied=[effect]), [])
        d = (both.features[0] - alone.features[0]).ravel()[mask]
        far, perfect = (float(np.sqrt(d @ np.linalg.solve(c, d))) for c in (whole, own))
        r = observed.values - alone.features[0].ravel()[mask] - discrepancy.bias[mask]
        out.append((far, perfect, float(d @ np.linalg.solve(whole, r)) / max(far, 1e-12)))
    return min(out)


def bound(folder: str, population: int, more: int, first: int) -> None:
    """Print how often a test that is told both effects and sizes could tell them from one.

    Then, how good the coefficients can be. With ``first``, of the built rooms from that one on.
    """
    limit = float(norm.ppf(1 - LEVEL))
    table: dict[str, list[tuple[float, float, float]]] = {data: [] for data in DATA}
    left = []
    for _, case, truth, controls in pairs_from(folder, population, more, first):
        for data, (part, made) in cut(case, controls).items():
            table[data].append(distances_apart(part, truth, estimate_discrepancy(part, made)))
        left.append(coefficients_left(case, truth, estimate_discrepancy(case, controls)))
    print(f"Neyman and Pearson's test at {LEVEL:g}, told both effects and their sizes:")
    for data, rows in table.items():
        far, perfect, said = np.array(rows).T
        for label, d in (("with the model's error", far), ("with a model without error", perfect)):
            power = norm.cdf(d - limit)
            print(
                f"{DATA[data]:36} {label:27} tells {power.sum():.1f} of {len(d)} "
                f"({power.mean():.2f}); median distance {np.median(d):.1f} standard deviations"
            )
        print(f"{'':36} of what was measured it says two in {rate(said > limit)}")
    print("Both effects and sizes told, alpha's error is at most half of plain calibration's:")
    for label, ratios in zip(
        ("posterior mean", "as it expects", "expected by a model without error"),
        np.array(left).T,
        strict=True,
    ):
        print(f"  {label:36}", rate(ratios <= 0.5))


def coefficients_left(
    case: Case, truth: dict[str, Any], discrepancy: ModelDiscrepancy
) -> tuple[float, float, float]:
    """Errors of alpha over plain calibration's, with the true effects and sizes told.

    Of the posterior mean with the model's error; as that posterior expects; and as the posterior of a
    model without error expects. The last is a bound: it knows everything but alpha.
    """
    told = replace(case, applied=true_effects(case, truth))
    observed, _ = observe(case)
    compared = compare(MeansProblem(told, observed, predict_hypotheses(told, []), discrepancy))
    simple = rmse(plain(case).alpha, truth)
    across = covariance_with_alpha(compared, [()])[0]
    covariance = moments(compared, [()])[0].covariance[0]
    perfect = compared.of_alpha(slice(0, 1))[0][0] + observed.covariance
    area = np.array(truth["areas"])[:, None]
    out = [rmse(averaged_alpha(compared, [((), 1.0)]), truth)]
    for c in (covariance, perfect):
        explained = np.linalg.solve(c, across.reshape(len(c), -1)).reshape(across.shape)
        left = case.room.sigma**2 - (across * explained).sum(0)
        out.append(float(np.sqrt((area * left).sum() / area.sum() / left.shape[1])))
    return out[0] / simple, out[1] / simple, out[2] / simple


def controls(folder: str, population: int, more: int) -> None:
    """Simulate the control rooms of the rooms with two effects; seconds of processor each."""
    cases, truths = read(population, "case"), read(population, "truth")
    for index, truth in enumerate(truths):
        if truth["seed"][1] == DOUBLE:
            kept = place(folder, 1, population, "controls", index, "npz")
            kept_controls(Case.from_dict(cases[index]), kept)
    for _ in rooms(folder, population, more, double=True):
        pass


def run(
    folder: str,
    population: int,
    more: int,
    label: str,
    step: int,
    data: Sequence[str],
    part: str,
    first: int,
    singles: int,
) -> None:
    """Search the rooms for several effects, those with two first, and keep what was said.

    Of the rooms with one effect or none every ``step``-th is searched; with ``singles``, so many built
    rooms with one, and the rooms with two (`pairs_from`) in turn. ``part`` "1/3" does the
    second of three parts.
    """
    warnings.simplefilter("ignore")
    two = list(pairs_from(folder, population, more, first))
    if singles:
        of_one = list(built_singles(folder, population, singles))
        every = [r for turn in zip_longest(two, of_one) for r in turn if r is not None]
    else:
        others = [r for r in rooms(folder, population, 0, double=False) if judged_alone(r[2])]
        every = [*two, *sorted(others[::step], key=lambda r: not r[2]["effects"])]
    begin, parts = (int(x) for x in part.split("/"))
    for index, case, truth, made in every[begin::parts]:
        path = place(folder, 1, population, label, index, "json")
        if path.exists():
            continue
        cuts = cut(case, made)
        row = {name: said_of(*cuts[name], truth) for name in data}
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"truth": truth["effects"], **row}), encoding="utf-8")
        print(f"\r{index}   ", end="", flush=True)
    print()


def said_of(case: Case, made: list[ControlRooms], truth: dict[str, Any]) -> dict[str, Any]:
    """Return what a search for several effects said, the change of alpha, and the time of its parts."""
    began = time.process_time()
    found = find(case, controls=made, most=MOST)
    row = {
        "seconds": time.process_time() - began,
        "verdict": found.verdict,
        "score": found.score,
        "threshold": found.threshold,
        "single": row_of(find(case, controls=made)),
        "named": list(found.named),
        "named_families": list(found.named_families),
        "named_set": list(found.named_set),
        "members": list(found.members),
        "reasons": list(found.reasons),
        "numbers": list(found.numbers),
        "families": rounded(found.families),
        "probabilities": rounded(found.probabilities),
        "sets": [[list(s), p] for s, p in found.sets.items() if p > 1e-4],
    }
    if len(truth["effects"]) == 2:
        simple = rmse(plain(case).alpha, truth)
        row["rmse"] = [rmse(case.room.alpha, truth), simple, simple, rmse(found.alpha, truth)]
        if found.can_be_added:
            row["rmse"][2] = rmse(recalibrate(found.apply(), found.discrepancy).alpha, truth)
        told = replace(case, applied=true_effects(case, truth))
        row["rmse"].append(rmse(recalibrate(told, found.discrepancy).alpha, truth))
    return row


@dataclass(frozen=True)
class Searched:
    """A judged room: what was hidden in it and what a search for several effects said."""

    truth: list[str]
    row: dict[str, Any]

    @property
    def families(self) -> list[str]:
        """The families of what was hidden, added absorption as one, sorted."""
        return wide(self.truth)

    @property
    def claimed(self) -> set[str]:
        """The families that were claimed, one by one or as a set."""
        return {f.split(",")[0] for f in self.row["named_families"]} | {*self.row["named_set"]}

    @property
    def both_claimed(self) -> bool:
        """Whether both families are claimed, and no other."""
        return self.row["named_set"] == self.families

    @property
    def wrong_claim(self) -> bool:
        """Whether a family is claimed that nothing hidden belongs to."""
        return bool(self.claimed - set(self.families))

    @property
    def second_claim(self) -> bool:
        """Whether more is claimed than is hidden: a wrong family, or two where one is hidden."""
        return self.wrong_claim or len(self.row["named_set"]) > len(self.truth)

    @property
    def more_than_one(self) -> float:
        """The probability of two or more effects."""
        return float(sum(self.row["numbers"][2:]))

    @property
    def second_set(self) -> bool:
        """Whether a set of several families is claimed where one effect is hidden."""
        return bool(self.row["named_set"])

    @property
    def likeliest_right(self) -> bool:
        """Whether the most probable set has the families of what was hidden."""
        return self.row["verdict"] in ("named", "family", "ambiguous") and (
            wide(self.row["members"]) == self.families
        )

    @property
    def likeliest_families(self) -> list[str]:
        """The most probable families of two or more effects."""
        table: Counter[tuple[str, ...]] = Counter()
        for names, p in self.row["sets"]:
            if len(names) > 1 and "unknown" not in names:
                table[tuple(wide(names))] += p
        return list(max(table, key=lambda k: table[k])) if table else []

    @property
    def both_among_pairs(self) -> bool:
        """Whether the most probable families of two effects are right, told that there are two."""
        pairs = [s for s in self.row["sets"] if len(s[0]) == 2]
        return replace(self, row={"sets": pairs}).likeliest_families == self.families


def wide(names: list[str]) -> list[str]:
    """The families of effects, added absorption as one, sorted."""
    return sorted(families()[n].split(",")[0] for n in names)


def table(folder: str, population: int, label: str, pairs: str) -> None:
    """Print what the issue asks; ``pairs`` says which rooms with two effects are counted."""
    stored = sorted(place(folder, 1, population, label, 0, "json").parent.glob("*.json"))
    built = len(read(population, "case"))
    left_out = {"all": (), "stored": (True,), "built": (False,)}[pairs]
    singles = {i for i, t in enumerate(read(population, "truth")) if t["seed"][1] != DOUBLE}
    singles |= {int(p.stem) for p in stored if int(p.stem) >= BUILT_SINGLE}
    stored = [p for p in stored if int(p.stem) in singles or (int(p.stem) >= built) not in left_out]
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in stored]
    for data, words in DATA.items():
        every = [
            Searched([name_of(e) for e in row["truth"]], row[data])
            for row in rows
            if data in row and all(e["kind"] in NAMES for e in row["truth"])
        ]
        two = [r for r in every if len(r.truth) == 2]
        if not every:
            continue
        single, none = ([r for r in every if len(r.truth) == n] for n in (1, 0))
        print(f"\n== population {population}: {words} ==")
        print("two hidden: both families claimed       ", rate(r.both_claimed for r in two))
        print("  of the most probable set              ", rate(r.likeliest_right for r in two))
        print("  most probable, told that there are two", rate(r.both_among_pairs for r in two))
        print("  a family claimed that is not there    ", rate(r.wrong_claim for r in two))
        errors = np.array([r.row["rmse"] for r in two])
        if len(errors):
            print("alpha's error at most half of plain's:")
            for k, label in (
                (2, "the set added"),
                (3, "averaged over sets"),
                (4, "the truth told"),
            ):
                print(f"  {label:38}", rate(errors[:, k] <= errors[:, 1] / 2))
            print(
                "  the prior's error is                  ", rate(errors[:, 0] <= errors[:, 1] / 2)
            )
            print(
                "  medians: prior, plain, added, averaged, told", np.median(errors, axis=0).round(4)
            )
        print("one hidden: more claimed than is there  ", rate(r.second_claim for r in single))
        print("  a set of two or three claimed         ", rate(r.second_set for r in single))
        print(
            "nothing hidden: flagged                 ",
            rate(r.row["verdict"] in ("named", "family", "ambiguous") for r in none),
        )
        claims = [(f.split(",")[0] in r.families) for r in every for f in r.row["named_families"]]
        print("claims of a family that were right      ", rate(claims))
        sets = [r.both_claimed for r in every if r.row["named_set"]]
        print("claims of a set that were right         ", rate(sets))
        seconds = [r.row["seconds"] for r in every]
        print(f"seconds of processor: median {np.median(seconds):.2f}, at most {max(seconds):.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("controls", "bound", "run", "table"))
    parser.add_argument("--folder", required=True)
    parser.add_argument("--population", type=int, default=0)
    parser.add_argument("--more", type=int, default=0, help="rooms that are built beside them")
    parser.add_argument("--label", default="several", help="folder of this run's rows")
    parser.add_argument("--step", type=int, default=1, help="every so many rooms with one or none")
    parser.add_argument("--data", nargs="+", choices=tuple(DATA), default=tuple(DATA))
    parser.add_argument(
        "--pairs",
        choices=("all", "stored", "built"),
        default="all",
        help="table: which rooms with two",
    )
    parser.add_argument("--first", type=int, default=0, help="first of the built rooms with two")
    parser.add_argument("--singles", type=int, default=0, help="built rooms with one effect")
    parser.add_argument("--part", default="0/1", help="1/3: the second of three parts of the rooms")
    given = parser.parse_args()
    if given.what == "controls":
        controls(given.folder, given.population, given.more)
    elif given.what == "bound":
        bound(given.folder, given.population, given.more, given.first)
    elif given.what == "run":
        run(
            given.folder,
            given.population,
            given.more,
            given.label,
            given.step,
            given.data,
            given.part,
            given.first,
            given.singles,
        )
    else:
        table(given.folder, given.population, given.label, given.pairs)


if __name__ == "__main__":
    main()
