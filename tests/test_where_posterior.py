"""With which probabilities effects and surfaces are told: the temper, and the pool with the means."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import rtcal as rt
from benchmarks.studies.pairs.where import prepared
from rtcal.finder.effects import library
from rtcal.finder.positions.problem import (
    Likelihood,
    PositionsHypotheses,
    ScatteringLevels,
    shifts,
    uneven_amount,
)
from rtcal.finder.positions.search import (
    LEAST_BY_MEANS,
    MEANS_POWER,
    TOLD_TEMPER,
    weights,
    with_families,
)
from tests.test_where import MATCH, measured, stated, tracing


@pytest.fixture(scope="module")
def case() -> rt.finder.PositionsCase:
    return rt.finder.PositionsCase(
        simulator=tracing(stated()), measured=measured(True), match=MATCH
    )


def test_the_families_of_the_means_are_multiplied_in(
    case: rt.finder.PositionsCase,
) -> None:
    some = [
        s.some(slice(0, 1))
        for s in shifts(case, library())
        if s.effect in ("opening", "covered surface")
    ]
    pair = [some[0], next(s for s in some if s.family != some[0].family)]
    every = PositionsHypotheses(pair, [], off=0.1)
    before = weights(np.zeros(len(every.log_prior)), every, TOLD_TEMPER)
    after = with_families(before, every, {"none": 1e-9, pair[0].family: 0.64})
    changed = np.exp(after - before)
    for of_shifts in every.of_groups(changed)[1:]:
        assert np.concatenate(of_shifts) == pytest.approx(
            [0.64**MEANS_POWER, LEAST_BY_MEANS**MEANS_POWER]
        )
    assert changed[0] == pytest.approx(LEAST_BY_MEANS**MEANS_POWER)


def test_means_over_pairs_have_the_density_of_means(
    case: rt.finder.PositionsCase, kept: Path
) -> None:
    numbers, every = prepared(case, kept)
    numbers.levels = ScatteringLevels(np.zeros((len(numbers.residual), 1)), np.zeros(1))
    whole = numbers.likelihoods()[0]
    p, i, k = numbers.shape
    mean = np.kron(np.eye(k * p), np.full((1, i), 1 / i))
    within = np.kron(np.eye(p), np.full((1, i), 1 / i))
    averaged = Likelihood(
        mean @ whole.covariance @ mean.T,
        numbers.used.reshape(-1, i).all(axis=1),
        {name: within @ nodes for name, nodes in whole.nodes.items()},
        uneven=within @ whole.uneven,
        amount=uneven_amount(numbers.data.observations.parameters, 1),
        levels=whole.levels._replace(shifts=mean @ whole.levels.shifts),
    )
    shift = next(s for s in every.shifts if s.effect == "opening").some(slice(5, 6))
    nodes = whole.nodes[shift.response]
    exact = np.einsum("kvn,kn->kv", nodes, shift.weights[0])
    spectrum = [np.outer(np.eye(len(exact))[k], exact[k]).ravel() for k in range(len(exact))]
    change = exact @ whole.amount * shift.uneven[0]
    place = [np.outer(change, column).ravel() for column in whole.uneven.T]
    error = np.transpose(spectrum) @ shift.error @ np.array(spectrum)
    covariance = mean @ (whole.covariance + error + np.transpose(place) @ np.array(place)) @ mean.T
    # Within the normal part of the density: beyond it, the finder's tails are heavier.
    random = np.random.default_rng(4).standard_normal(len(mean))
    residual = mean @ exact.ravel() + 0.5 * np.linalg.cholesky(covariance) @ random
    expected = multivariate_normal.logpdf(residual, mean @ exact.ravel(), covariance)
    constant = len(mean) / 2 * np.log(2 * np.pi)
    (said,) = averaged.shifted([shift], averaged.of(residual))
    assert said == pytest.approx(expected + constant, abs=1e-3)
