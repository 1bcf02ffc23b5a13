"""What decides numbers of the search for several effects, on development rooms.

    python -m benchmarks.several_effects_choices claim --folder out    # `several.TWO`
    python -m benchmarks.several_effects_choices kept --folder out     # `set_posterior.KEPT`
    python -m benchmarks.several_effects_choices speed --folder out

``claim`` reads what `benchmarks.several_effects run` said of population 0.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings

import numpy as np

from benchmarks.hidden_effects import NAMES
from benchmarks.second_world import place
from benchmarks.several_effects import Searched, rooms
from rtcal.discrepancy import find, find_several, library, set_posterior
from rtcal.discrepancy.features import observe
from rtcal.discrepancy.hypotheses import predict_hypotheses
from rtcal.discrepancy.model_error import estimate_discrepancy
from rtcal.discrepancy.prior import prior_of
from rtcal.discrepancy.sets import compare

POPULATION = 0


def claim(folder: str) -> None:
    """Print what a claim of two costs where one is hidden, by the probability that it asks for."""
    stored = sorted(place(folder, 1, POPULATION, "several", 0, "json").parent.glob("*.json"))
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in stored]
    every = [Searched([NAMES[e["kind"]] for e in row["truth"]], row["all"]) for row in rows]
    single, two = ([r for r in every if len(r.truth) == n] for n in (1, 2))
    right = sum(r.both_among_pairs for r in two)
    print(f"told that there are two, {right} of {len(two)} are right")
    for least in (0.5, 0.75, 0.9, 0.95, 0.98, 0.995):
        claimed = [r for r in two if r.more_than_one >= least]
        print(
            f"two claimed from {least:5}: {len(claimed)} of {len(two)} pairs, "
            f"{sum(r.both_among_pairs for r in claimed)} rightly; "
            f"{sum(r.more_than_one >= least for r in single)} of {len(single)} rooms with one effect"
        )


def kept(folder: str) -> None:
    """Print what evaluating few parameters of each two effects costs in probability, and in time."""
    warnings.simplefilter("ignore")
    chosen = set_posterior.KEPT
    for index, case, _, made in list(rooms(folder, POPULATION, 0, double=True))[:6]:
        observed, _ = observe(case)
        predicted, prior = predict_hypotheses(case, library()), prior_of(case.room, library(), {})
        compared = compare(case, observed, predicted, estimate_discrepancy(case, made))
        every: dict[tuple[str, ...], float] = {}
        line = [f"room {index}:"]
        for number in (((0.0, 300),), ((0.0, 24),), chosen):
            set_posterior.KEPT = number
            began = time.process_time()
            sets = set_posterior.set_posterior(compared, prior, most=2).sets
            seconds = time.process_time() - began
            every = every or dict(sets)
            off = 0.5 * sum(abs(p - sets[s]) for s, p in every.items())
            line.append(f"{number[0][1]} off by {off:.3f} ({seconds:.1f} s)")
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
    what = {f.__name__: f for f in (claim, kept, speed)}
    parser.add_argument("what", choices=tuple(what))
    parser.add_argument("--folder", required=True)
    given = parser.parse_args()
    what[given.what](given.folder)


if __name__ == "__main__":
    main()
