"""The best test of one hidden effect: what any finder could name (Neyman & Pearson 1933).

The test is told which effect is hidden and how large it is, against one alternative that it is told as
well. No finder knows as much, so none names the truth more often at as few wrong claims. A second test
is told the library and the priors alone: the weighted likelihood ratio is then the most powerful.

The data are drawn from what `rtcal.find` assumes: the prior of the coefficients with their
usual error in common, the measurement's uncertainty, and the model's error as control rooms show it.
Their density is Student's t of the finder's degrees of freedom, or a normal one.

The bound rests on these covariances. Coefficients that are better than stated, or a model that errs
less than the control rooms show, would allow more. The covariance is the model's without the effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from unittest import mock

import numpy as np

from benchmarks.studies.means.judging import families_of
from rtcal.finder import Case, library
from rtcal.finder import evidence as densities
from rtcal.finder.evidence import DEGREES
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.means.problem import (
    MeansProblem,
    distances,
    estimate_discrepancy,
    evaluate,
    observe,
    predict_hypotheses,
    score,
    state,
)
from rtcal.finder.model import predict
from rtcal.finder.prior import prior_of
from rtcal.support.types import Array

DRAWS, SCORED = 4000, 200
"""Draws of a likelihood ratio, and of the evidence of the whole library."""


@dataclass(frozen=True)
class Told:
    """One case, seen by a test that is told the effect.

    ``far`` is the distance of the truth from "nothing" in standard deviations, ``rival`` that from the
    nearest hypothesis that would be a wrong claim, with its name. ``squares`` are r' C⁻¹ r of the
    measurement with the effect and without it. ``values`` is the number of measured values. ``scores``
    (2, n_draws) are the evidence that something is missing, in rooms with the effect and without it.
    """

    far: float
    rival: float
    name: str
    squares: tuple[float, float]
    values: int
    scores: Sequence[Sequence[float]]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; ``Told(**values)`` reads them."""
        return {**vars(self), "scores": np.round(self.scores, 2).tolist()}


def told(
    case: Case,
    truth: Sequence[Case],
    controls: Sequence[ControlRooms],
    right: frozenset[str],
) -> Told:
    """Return the distances of a case.

    ``truth`` has a case per configuration: the same case with the model as it truly is there. ``right``
    are the names whose families are right.
    """
    observed, _ = observe(case)
    mask = observed.used.ravel()
    predicted = predict_hypotheses(case, library())
    error = estimate_discrepancy(case, controls)
    problem = MeansProblem(case, observed, predicted, error)
    inverse = np.linalg.inv(problem.of_alpha(slice(0, 1))[0][0] + problem.without_alpha)
    true = np.array(
        [
            predict([state(t, c)], distances(case, c)).features[0]
            for t, c in zip(truth, case.configurations, strict=True)
        ]
    ).ravel()[mask]

    def square(rows: Array) -> Array:
        return np.asarray(np.einsum("...i,ij,...j->...", rows, inverse, rows))

    table = predicted.features.reshape(len(predicted.names), -1)[:, mask]
    accepted = families_of(right)
    wrong = [
        i
        for i, n in enumerate(predicted.names)
        if i > 0 and n not in right and not families_of([n]) & accepted
    ]
    apart = square(table[wrong] - true)
    nearest = int(np.argmin(apart))
    residual = observed.values - error.bias[mask]
    scale = np.linalg.cholesky(np.linalg.inv(inverse))
    scores = drawn_scores(problem, [true, table[0]], scale)
    return Told(
        far=float(np.sqrt(square(true - table[0]))),
        rival=float(np.sqrt(apart[nearest])),
        name=predicted.names[wrong[nearest]],
        squares=(float(square(residual - true)), float(square(residual - table[0]))),
        values=int(mask.sum()),
        scores=scores.tolist(),
    )


def drawn_scores(problem: MeansProblem, means: Sequence[Array], scale: Array) -> Array:
    """Return the evidence that something is missing in rooms drawn around each of these means.

    (n_means, n_draws), in nats, with the whole likelihood: not coarsened, it is the most powerful test
    of the library with its priors where the data are as assumed.
    """
    rng = np.random.default_rng([len(scale), 21])
    z = rng.standard_normal((SCORED, len(scale))) @ scale.T
    wide = np.sqrt((DEGREES - 2) / rng.chisquare(DEGREES, (SCORED, 1)))
    prior = prior_of(problem.case.room, library(), {})
    values = np.concatenate([mean + problem.bias + wide * z for mean in means])
    with mock.patch.object(densities, "COARSENING", np.inf):
        evidence = evaluate(problem, prior.off, values)
    return score(evidence, prior).reshape(len(means), SCORED)


def log_ratio(with_effect: Array, without: Array, values: int, degrees: float) -> Array:
    """Return the log likelihood ratio of the effect from both r' C⁻¹ r."""
    if np.isinf(degrees):
        return np.asarray(0.5 * (without - with_effect))
    scale = degrees - 2
    ratio = np.log1p(np.asarray(without) / scale) - np.log1p(np.asarray(with_effect) / scale)
    return np.asarray(0.5 * (degrees + values) * ratio)


def drawn_ratios(far: float, values: int, degrees: float) -> Array:
    """Return the log ratio in rooms that have the effect; in rooms without, it is the negative."""
    rng = np.random.default_rng([values, 20])
    along, others = rng.standard_normal(DRAWS), rng.chisquare(max(values - 1, 1), DRAWS)
    wide = np.ones(DRAWS)
    if np.isfinite(degrees):
        wide = (degrees - 2) / rng.chisquare(degrees, DRAWS)
    others = others * wide * (values > 1)
    along = along * np.sqrt(wide)
    return log_ratio(along**2 + others, (along + far) ** 2 + others, values, degrees)


def best_powers(
    far: Sequence[float], values: Sequence[int], wrong: float, degrees: float
) -> tuple[Array, float]:
    """Return how often each effect is named where ``wrong`` of the claims without it are allowed.

    One limit of the log ratio for all cases: the most powerful test of all of them together. Also
    returned.
    """
    ratios = np.array([drawn_ratios(f, v, degrees) for f, v in zip(far, values, strict=True)])
    limit = float(np.quantile(-ratios, 1 - wrong))
    return (ratios > limit).mean(1), limit


WRONG = 1 / 30
"""Share of wrong claims that is allowed."""


def show(names: Sequence[str], rows: Sequence[Told], said: Sequence[str]) -> None:
    """Print each case: its distances, what the measurement says to the test, what find said."""
    powers, limit = best_powers([r.far for r in rows], [r.values for r in rows], WRONG, DEGREES)
    print(f"{'':50} {'nothing':>8} {'power':>6} {'measured':>9}  nearest wrong claim  find")
    for name, row, power, outcome in zip(names, rows, powers, said, strict=True):
        ratio = float(log_ratio(*map(np.array, row.squares), row.values, DEGREES))
        print(
            f"{name:50} {row.far:8.1f} {power:6.2f} {ratio:+9.1f}{'*' if ratio > limit else ' '} "
            f"{row.rival:5.1f} {row.name:14} {outcome}"
        )


def shares(rows: Sequence[Told], right: int, controls: int) -> None:
    """Print how many of all cases a test could name, every control right, and how many find did."""
    n, values = len(rows) + controls, [r.values for r in rows]
    print(f"what could be named, wrong in {WRONG:.3f} of the cases where it is not there:")
    for words, degrees in (("Student's t", DEGREES), ("normal density", np.inf)):
        powers, limit = best_powers([r.far for r in rows], values, WRONG, degrees)
        claims, _ = best_powers([min(r.far, r.rival) for r in rows], values, WRONG, degrees)
        said = sum(
            bool(log_ratio(*map(np.array, r.squares), r.values, degrees) > limit) for r in rows
        )
        print(f"{words}: told effect and size")
        print(f"  against nothing, expected            {rate_of(powers.sum() + controls, n)}")
        print(f"  against nothing, of the measured     {rate_of(said + controls, n)}")
        print(f"  and against the nearest wrong claim  {rate_of(claims.sum() + controls, n)}")
    scores = np.array([r.scores for r in rows])
    flagged = (scores[:, 0] > np.quantile(scores[:, 1], 1 - WRONG)).mean(1).sum()
    print(f"told the library and its priors, expected {rate_of(flagged + controls, n)}")
    print(f"find, of the measured                    {rate_of(right + controls, n)}")


def detections(rows: Sequence[Told], said: Sequence[bool], wrong: float = 0.05) -> None:
    """Print how many effects tests detect with so many false alarms in each room; then find."""
    n = len(rows)
    for words, degrees in (("Student's t", DEGREES), ("normal density", np.inf)):
        limits = [best_powers([r.far], [r.values], wrong, degrees) for r in rows]
        measured = [
            bool(log_ratio(*map(np.array, r.squares), r.values, degrees) > limit)
            for r, (_, limit) in zip(rows, limits, strict=True)
        ]
        power = sum(float(p[0]) for p, _ in limits)
        print(f"{words}: told effect and size      {rate_of(power, n)}")
        print(f"  of the measured                   {rate_of(sum(measured), n)}")
    own = [
        float(np.mean(np.array(r.scores[0]) > np.quantile(r.scores[1], 1 - wrong))) for r in rows
    ]
    print(f"told the library and its priors      {rate_of(sum(own), n)}")
    print(f"find, of the measured                {rate_of(sum(said), n)}")


def rate_of(number: float, n: int) -> str:
    """A number of cases and its share."""
    return f"{number:5.1f} of {n} ({number / n:.2f})"
