"""Covariances by blocks and a part of low rank are those of the whole matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rtcal.finder import ChangedMaterial
from rtcal.finder.effects.absorbers import Opening
from rtcal.finder.effects.whole_room import NoiseFloor
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.means.evidence import evaluate
from rtcal.finder.means.features import AlphaCovariance, estimate_discrepancy, observe
from rtcal.finder.means.hypotheses import predict_hypotheses
from rtcal.finder.means.likelihood import Factorization, MeansProblem
from rtcal.support.speed import single_threaded_blas
from tests.test_discrepancy import ALPHA, opened


@pytest.mark.parametrize("rank", [None, 3])
def test_products_and_determinant_are_those_of_the_whole_matrix(rank: int | None) -> None:
    rng = np.random.default_rng(0)
    n, m = 4, 9
    places = [slice(0, 4), slice(4, 9)] if rank else [slice(None)]
    blocks = []
    covariance = np.zeros((n, m, m))
    for place in places:
        root = rng.standard_normal((n, len(range(m)[place]), 12))
        blocks.append(root @ root.swapaxes(1, 2))
        covariance[:, place, place] = blocks[-1]
    low_rank = None if rank is None else rng.standard_normal((n, rank, m))
    if low_rank is not None:
        covariance += low_rank.swapaxes(1, 2) @ low_rank
    rows = rng.standard_normal((n, 5, m))
    factors = Factorization(blocks, places, low_rank)
    ends = [3, 6, 9]
    for end, products in zip(ends, factors.leading(rows.copy(), 2, ends), strict=True):
        part, seen = covariance[:, :end, :end], rows[:, :, :end]
        expected = seen @ np.linalg.solve(part, seen.swapaxes(1, 2))
        half, square, across, others = products
        np.testing.assert_allclose(half, 0.5 * np.linalg.slogdet(part)[1], rtol=1e-12)
        diagonal = np.diagonal(expected, axis1=1, axis2=2)
        np.testing.assert_allclose(square, diagonal[:, :2], rtol=1e-9)
        np.testing.assert_allclose(across, expected[:, :2, 2:], rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(others, expected[:, 2:, 2:], rtol=1e-8, atol=1e-12)


def test_a_matrix_that_is_not_positive_definite_is_an_error() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="covariance 1 is not positive definite"):
        Factorization([np.stack([np.eye(2), -np.eye(2)])], [slice(None)])


@single_threaded_blas()
def test_evidence_of_many_configurations_is_the_same_by_blocks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = opened()
    (c,) = case.configurations
    change = ChangedMaterial(ALPHA[1] * 1.3, np.full(7, 0.02))
    case = replace(
        case,
        configurations=[
            replace(c, name=str(i), changes={"b": change} if i % 3 else {}) for i in range(14)
        ],
    )
    rng = np.random.default_rng(1)
    scale = np.array([0.03, 0.03, 0.02, 0.5, 0.5])[:, None]
    controls = [
        ControlRooms(name, scale * rng.standard_normal((20, 14, 5, 7)))
        for name in ("path tracing", "image sources")
    ]
    observed, _ = observe(case)
    predicted = predict_hypotheses(case, [Opening(), NoiseFloor()])
    error = estimate_discrepancy(case, controls)
    problem = MeansProblem(case, observed, predicted, error)
    values = observed.values + 0.05 * rng.standard_normal((6, observed.used.sum()))
    by_blocks = predicted.alpha_covariance.low_rank(slice(0, 2))
    assert by_blocks is not None
    few = evaluate(problem, 0.2, values)
    monkeypatch.setattr(AlphaCovariance, "low_rank", lambda *_: None)
    whole = evaluate(problem, 0.2, values)
    np.testing.assert_allclose(few.stated, whole.stated, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(few.off, whole.off, rtol=1e-9, atol=1e-8)
