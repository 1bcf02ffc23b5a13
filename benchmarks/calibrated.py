"""Are the stated probabilities right? What the power and the tails of the likelihood do to them.

    python -m benchmarks.calibrated --folder out            # minutes

``folder`` has the control rooms that `benchmarks.second_world controls` keeps. Both worlds'
development rooms (population 0) are evaluated with each setting of `COARSENING` and `DEGREES`. A good
setting has a small calibration error and a large mean log probability of the truth (a proper score:
Good 1952).
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from unittest import mock

import numpy as np

from benchmarks.judging import calibration_error, first_of, kept_controls, one
from benchmarks.second_world import WORLDS, place, truth_of
from rtcal.discrepancy import Case, library, likelihood
from rtcal.discrepancy.evidence import evaluate
from rtcal.discrepancy.features import observe
from rtcal.discrepancy.hypotheses import predict_hypotheses
from rtcal.discrepancy.model_error import estimate_discrepancy
from rtcal.discrepancy.prior import prior_of
from rtcal.discrepancy.probabilities import posterior
from rtcal.support.threads import single_threaded_blas

SETTINGS = (
    *((5.0, power) for power in (np.inf, 200.0, 100.0, 50.0, 25.0)),
    *((degrees, 50.0) for degrees in (3.0, 10.0, np.inf)),
)
LEAST = 1e-9
"""Smallest probability of the truth that is counted."""

Row = tuple[float, bool, float]


def rows_of(folder: str, world: int, step: int) -> dict[tuple[str, float, float], list[Row]]:
    """Probability of the most probable answer, whether it is right, and that of the truth."""
    out: dict[tuple[str, float, float], list[Row]] = defaultdict(list)
    rooms, truths = (WORLDS[world].read(0, part) for part in ("case", "truth"))
    for index in range(0, len(rooms), step):
        kept, known = (
            place(folder, world, 0, "controls", index, "npz"),
            truth_of(world, truths[index]),
        )
        if known is None or not kept.exists():
            continue
        (name,) = known[0]
        whole = Case.from_dict(rooms[index])
        controls = kept_controls(whole, kept)
        for data, case, made in (
            ("one", one(whole), first_of(controls)),
            ("all", whole, controls),
        ):
            observed, _ = observe(case)
            predicted = predict_hypotheses(case, library())
            error = estimate_discrepancy(case, made)
            prior = prior_of(case.room, library(), {})
            for degrees, power in SETTINGS:
                with mock.patch.multiple(likelihood, DEGREES=degrees, COARSENING=power):
                    evidence = evaluate(observed, predicted, error, prior.off)
                table = {k: float(v) for k, v in evidence.by_effect().items()}
                probabilities = posterior(table, prior)
                best = next(iter(probabilities))
                truth = max(probabilities.get(name, 0.0), LEAST)
                out[data, degrees, power].append((probabilities[best], best == name, truth))
    return out


@single_threaded_blas()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", required=True)
    parser.add_argument("--step", type=int, default=1, help="every so many rooms")
    given = parser.parse_args()
    worlds = [rows_of(given.folder, world, given.step) for world in WORLDS]
    print("calibration error of the most probable answer, and mean log probability of the truth")
    print(f"{'data':5}{'degrees':>8}{'power':>7}" + f"{'world 1':>16}{'world 2':>16}{'both':>16}")
    for data in ("one", "all"):
        for degrees, power in SETTINGS:
            parts = [w[data, degrees, power] for w in worlds]
            cells = ""
            for rows in (*parts, [row for part in parts for row in part]):
                stated, right, truth = zip(*rows, strict=True)
                error, _ = calibration_error(stated, right)
                cells += f"{error:9.3f}{np.mean(np.log(truth)):7.3f}"
            print(f"{data:5}{degrees:8g}{power:7g}{cells}", flush=True)


if __name__ == "__main__":
    main()
