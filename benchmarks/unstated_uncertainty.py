"""What the uncertainty of values that state none decides: `python -m benchmarks.unstated_uncertainty`.

Rooms of the second hidden world's development population, of which only the first source-receiver pair
counts, so that no uncertainty follows from the spread over pairs. Prints verdict and effect with the
numbers of `rtcal.acoustics.observables`, and with half and twice those of times and of levels.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from unittest.mock import patch

import numpy as np

from rtcal.acoustics.observables import OBSERVABLES, DecaySlope
from rtcal.finder import Case, control_rooms, find
from rtcal.finder.means import features
from tests.second_world.generate import read

PARAMETERS = ("t20", "edt", "t30", "c80", "g")
FACTORS = ((1.0, 1.0), (0.5, 1.0), (2.0, 1.0), (1.0, 0.5), (1.0, 2.0))


def first_pair(data: dict) -> Case:
    """The case with one pair per configuration, and no stated uncertainty."""
    configurations = []
    for entry in data["configurations"]:
        kept = {
            k: v for k, v in entry.items() if k in ("name", "changes", "suspect_removed", "air")
        }
        for key in (*PARAMETERS, "distance"):
            if key in entry:
                pairs = key == "distance" or isinstance(entry[key][0], list)
                kept[key] = entry[key][:1] if pairs else entry[key]
        configurations.append(kept)
    return Case.from_dict(
        {"room": data["room"], "equation": data["equation"], "configurations": configurations}
    )


@contextmanager
def scaled(of_time: float, of_level: float) -> Iterator[None]:
    """Take so many times the chosen uncertainties."""
    with ExitStack() as changed:
        for kind in OBSERVABLES.values():
            factor = of_time if isinstance(kind, DecaySlope) else of_level
            teams = tuple(factor * x for x in kind.teams)
            changed.enter_context(patch.object(type(kind), "teams", teams))
            if isinstance(kind, DecaySlope):
                changed.enter_context(
                    patch.object(type(kind), "one_decay", of_time * kind.one_decay)
                )
        changed.enter_context(patch.object(features, "ONE_LEVEL", of_level * features.ONE_LEVEL))
        yield


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rooms", type=int, default=8)
    count = parser.parse_args().rooms
    warnings.simplefilter("ignore")
    cases, truths = read(0, "case"), read(0, "truth")
    changed = np.zeros(len(FACTORS), dtype=int)
    for i in np.linspace(0, len(cases) - 1, count).astype(int):
        case = first_pair(cases[i])
        controls = control_rooms(case)
        results = []
        for of_time, of_level in FACTORS:
            with scaled(of_time, of_level):
                finding = find(case, controls=controls)
            results.append((finding.verdict, finding.effect))
        changed += [r != results[0] for r in results]
        print(truths[i]["kind"], *results, sep=" | ")
        sys.stdout.flush()
    for (of_time, of_level), n in zip(FACTORS, changed, strict=True):
        print(f"time x {of_time:g}, level x {of_level:g}: another finding in {n} of {count} rooms")


if __name__ == "__main__":
    main()
