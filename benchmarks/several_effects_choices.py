"""What decides numbers of the search for several effects, on development rooms.

    python -m benchmarks.several_effects_choices claim --folder out    # `several.TWO`
    python -m benchmarks.several_effects_choices parameters --folder out     # `set_posterior.KEPT`
    python -m benchmarks.several_effects_choices speed --folder out

``claim`` reads what `benchmarks.several_effects run` said: of population 0 what was chosen from, of
population 1 what became of it.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings

import numpy as np

from benchmarks.hidden_effects import NAMES
from benchmarks.second_world import place
from benchmarks.several_effects import Searched
from benchmarks.several_effects_rooms import rooms
from rtcal.finder import find, find_several, library
from rtcal.finder.means import set_posterior
from rtcal.finder.means.features import observe
from rtcal.finder.means.hypotheses import predict_hypotheses
from rtcal.finder.means.model_error import estimate_discrepancy
from rtcal.finder.means.set_posterior import Kept
from rtcal.finder.means.sets import compare
from rtcal.finder.prior import prior_of

POPULATION = 0
NOT_OF_THE_ROOM = frozenset({"climate", "measurement"})
"""Families that neither absorb nor shape the field: a limit of their own for them was tried."""


def claim(folder: str, population: int, label: str) -> None:
    """Print what a claim of two costs where one is hidden, by the probability that it asks for."""
    stored = sorted(place(folder, 1, population, label, 0, "json").parent.glob("*.json"))
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in stored]
    every = [
        Searched([NAMES[e["kind"]] for e in row["truth"]], row["all"])
        for row in rows
        if all(e["kind"] in NAMES for e in row["truth"])
    ]
    single, two = ([r for r in every if len(r.truth) == n] for n in (1, 2))
    right = sum(r.both_among_pairs for r in two)
    print(f"told that there are two, {right} of {len(two)} are right")
    for label, of_the_room in (("climate or measurement among them", False), ("neither", True)):
        print(f"{label}:")
        for least in (0.5, 0.6, 0.75, 0.9, 0.95, 0.98, 0.995):

            def claimed(r: Searched, least: float = least, of: bool = of_the_room) -> bool:
                likeliest = r.likeliest_families
                return r.more_than_one >= least and NOT_OF_THE_ROOM.isdisjoint(likeliest) == of

            print(
                f"  two claimed from {least:5}: {sum(map(claimed, two))} of {len(two)} pairs, "
                f"{sum(claimed(r) and r.likeliest_families == r.families for r in two)} rightly; "
                f"{sum(map(claimed, single))} of {len(single)} rooms with one effect"
            )


def parameters(folder: str) -> None:
    """Print what evaluating few parameters of each two effects costs in probability, and in time."""
    warnings.simplefilter("ignore")
    chosen = set_posterior.KEPT
    for index, case, _, made in list(rooms(folder, POPULATION, 0, double=True))[:6]:
        observed, _ = observe(case)
        predicted, prior = predict_hypotheses(case, library()), prior_of(case.room, library(), {})
        compared = compare(case, observed, predicted, estimate_discrepancy(case, made))
        every: dict[tuple[str, ...], float] = {}
        line = [f"room {index}:"]
        for kept in ((Kept(0.0, 1.0, 300),), (Kept(0.0, 1.0, 24),), chosen):
            set_posterior.KEPT = kept
            began = time.process_time()
            sets = set_posterior.set_posterior(compared, prior, most=2).sets
            seconds = time.process_time() - began
            every = every or dict(sets)
            off = 0.5 * sum(abs(p - sets[s]) for s, p in every.items())
            line.append(f"{kept[0].most} off by {off:.3f} ({seconds:.1f} s)")
        print(" ".join(line))


def speed(folder: str) -> None:
    """Print the time of a search for several effects against that for one, control rooms given."""
    warnings.simplefilter("ignore")
    ratios = []
    for _, case, _, made in list(rooms(folder, POPULATION, 0, double=True))[:5]:
        seconds = []
        for search in (find, find_several):
            began = time.process_time()
            search(case, controls=made)
            seconds.append(time.process_time() - began)
        ratios.append([*seconds, seconds[1] - seconds[0]])
    one_effect, several, beyond = np.median(ratios, axis=0)
    print(
        f"one effect {one_effect:.2f} s, several {several:.2f} s (pairs and sizes {beyond:.2f} s): "
        f"{several / one_effect:.1f} times as long"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("claim", "parameters", "speed"))
    parser.add_argument("--folder", required=True)
    parser.add_argument("--population", type=int, default=POPULATION, help="claim: of which rooms")
    parser.add_argument("--label", default="several", help="claim: folder of the run's rows")
    given = parser.parse_args()
    if given.what == "claim":
        claim(given.folder, given.population, given.label)
    else:
        {"parameters": parameters, "speed": speed}[given.what](given.folder)


if __name__ == "__main__":
    main()
