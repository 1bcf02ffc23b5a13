"""The bound of an answer's error, where rows share coefficients: `python benchmarks/error_bound.py`.

Rooms in two or three configurations, with limits of groups and orders of materials. Each has a raw
and a final answer, and an optimum in rational arithmetic. Counted are the answers that lie outside
their own `alpha_error_bound`. 10,000 problems take six minutes.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from rtcal.support.errors import SolverError
from tests import coupled

ROUNDING = 2e-16
"""The rational optimum is compared as the nearest float."""


def main() -> int:
    """Print the counts; fails where an answer lies outside its bound."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("problems", type=int, nargs="?", default=10_000)
    parser.add_argument("--first", type=int, default=0, help="seed of the first problem")
    parser.add_argument("--solver", default="clarabel")
    chosen = parser.parse_args()
    warnings.simplefilter("ignore")
    outside: dict[str, list[int]] = {"raw": [], "final": []}
    widest: dict[str, list[float]] = {"raw": [], "final": []}
    looseness, failed, dependent = [], 0, 0
    for seed in range(chosen.first, chosen.first + chosen.problems):
        try:
            answer = coupled.solution(seed, chosen.solver)
        except SolverError:
            failed += 1
            continue
        truth = coupled.optimum(answer)
        if truth is None:
            dependent += 1
            continue
        for kind, u, certificate in (
            ("raw", answer.raw.unknowns, answer.raw.certificate),
            ("final", answer.unknowns, answer.certificate),
        ):
            error, bound = np.abs(u - truth), certificate.alpha_error_bound.ravel()
            if (error > bound + ROUNDING).any():
                outside[kind].append(seed)
            widest[kind].append(float(bound.max()))
            measurable = (error > 1e-9) & (kind == "raw")
            looseness += (bound[measurable] / error[measurable]).tolist()
    print(
        f"{chosen.problems} problems, {chosen.solver}: {failed} SolverErrors, {dependent} with "
        f"dependent rows left out"
    )
    for kind, seeds in outside.items():
        median, most, worst = np.quantile(widest[kind], [0.5, 0.9, 0.99])
        print(
            f"{kind} answers: {len(widest[kind])}, outside their bound {len(seeds)} {seeds[:9]}; "
            f"widest bound {median:.1e} in the median, {most:.1e} in 90 %, {worst:.1e} in 99 %, "
            f"above 1e-6 in {np.sum(np.array(widest[kind]) > 1e-6)}"
        )
    loose = np.quantile(looseness, [0.5, 0.9]) if looseness else [np.nan, np.nan]
    print(f"bound over error of raw answers: {loose[0]:.3g} in the median, {loose[1]:.3g} in 90 %")
    return int(any(outside.values()))


if __name__ == "__main__":
    sys.exit(main())
