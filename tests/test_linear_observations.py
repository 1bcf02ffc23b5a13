"""Linear observations in the QP: against generalised least squares, compiled once, wrong numbers."""

import numpy as np
import pytest

import rtcal as rt
from rtcal import terms
from rtcal.support.errors import DataError
from tests.conftest import room_of

MATERIALS = {
    "floor": (60, [0.2, 0.3], [0.03, 0.04]),
    "ceiling": (60, [0.3, 0.25], [0.05, 0.02]),
    "wall": (110, [0.15, 0.2], 0.03),
}
ROOM = room_of(MATERIALS, [500, 1000], 300, air=rt.Air())
TERM = terms.LinearObservations()


def draw(seed, n=9, shift=0.01):
    """Return observations of alpha + shift with correlated errors."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(n, ROOM.alpha.size))
    root = rng.normal(size=(n, n))
    covariance = 1e-3 * (root @ root.T + np.eye(n))
    values = matrix @ (ROOM.alpha.ravel() + shift) + 1e-3 * rng.normal(size=n)
    return terms.Observed(matrix=matrix, values=values, covariance=covariance)


@pytest.mark.parametrize("n", [2, 6, 40])
@pytest.mark.parametrize(
    ("r", "weight", "shared"), [(0.0, 1.0, ()), (0.6, 0.5, ()), (0.0, 1.0, ("floor", "ceiling"))]
)
def test_without_an_active_bound_it_is_generalised_least_squares(n, r, weight, shared):
    numbers, rows, room = draw(n, n), [0, 1, 2], ROOM
    matrix = numbers.matrix.reshape(n, 3, 2)
    if shared:  # their columns add up
        room, rows = ROOM.replace(alpha=ROOM.alpha[[0, 0, 2]], sigma=ROOM.sigma[[0, 0, 2]]), [0, 2]
        matrix = np.stack([matrix[:, 0] + matrix[:, 1], matrix[:, 2]], axis=1)
    objective = terms.PriorDeviation(band_correlation=r) + weight * TERM
    problem = rt.Calibration(objective, [terms.Shared(*shared)] if shared else []).build(room)
    result = problem.solve(None, observed={TERM: numbers})
    matrix, mu, sigma = matrix.reshape(n, -1), room.alpha[rows].ravel(), room.sigma[rows].ravel()
    prior = np.kron(np.eye(len(rows)), [[1, r], [r, 1]]) * np.outer(sigma, sigma)
    pull = weight * np.linalg.solve(numbers.covariance, matrix).T
    covariance = np.linalg.inv(np.linalg.inv(prior) + pull @ matrix)
    expected = mu + covariance @ pull @ (numbers.values - matrix @ mu)
    assert (expected > 0).all()
    np.testing.assert_allclose(result.alpha[rows].ravel(), expected, rtol=0, atol=1e-12)
    spread = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(result.joint.posterior_sigma[rows].ravel(), spread, rtol=1e-9)
    assert result.certificate.worst < 1e-9


def test_bounds_and_other_terms_stand_beside_it():
    numbers = draw(2, 30, shift=-0.3)
    calibration = rt.Calibration(
        terms.PriorDeviation() + terms.SoftMatch(relative=0.05) + TERM,
        [terms.Bounds(0.1, 1), terms.GroupAbsorption(["floor", "ceiling"], least=14)],
    )
    result = calibration.build(ROOM).solve([1.2, 1.1], observed={TERM: numbers})
    assert result.certificate.worst < 1e-9
    assert result.alpha.min() == pytest.approx(0.1, abs=1e-12)
    assert (60 * (result.alpha[0] + result.alpha[1])).min() > 14 - 1e-9
    exact = rt.Calibration(terms.PriorDeviation() + TERM, [terms.ExactMatch()]).build(ROOM)
    matched = exact.solve([0.6, 0.7], observed={TERM: draw(2, 30)})
    np.testing.assert_allclose(matched.reverberation_time_after, [0.6, 0.7], rtol=1e-9)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"values": np.full(9, np.nan)}, "not finite"),
        ({"values": np.zeros(4)}, "shape"),
        ({"covariance": np.zeros((9, 9))}, "not positive definite"),
        ({"covariance": np.triu(np.ones((9, 9)))}, "not symmetric"),
        ({"matrix": np.zeros((3, 6))}, "matrix has shape"),
        ({"values": []}, "is empty"),
    ],
)
def test_wrong_numbers_are_refused(changes, said):
    numbers = draw(0)
    fields = {n: getattr(numbers, n) for n in ("matrix", "values", "covariance")}
    with pytest.raises(DataError, match=said):
        terms.Observed(**fields | changes)


def test_numbers_that_do_not_belong_are_refused():
    problem = rt.Calibration(terms.PriorDeviation() + TERM, []).build(ROOM)
    with pytest.raises(DataError, match="observed has no numbers for"):
        problem.solve([1.0, 1.0])
    other = terms.LinearObservations("other")
    with pytest.raises(DataError, match="not a term of the objective"):
        problem.solve(None, observed={other: draw(0)})
    with pytest.raises(DataError, match="columns"):
        narrow = terms.Observed(matrix=np.ones((2, 3)), values=[1, 2], covariance=np.eye(2))
        problem.solve(None, observed={TERM: narrow})


def test_rounding_beside_the_diagonal_is_no_asymmetry():
    covariance = np.eye(3)
    covariance[0, 1] = 1e-17
    numbers = terms.Observed(matrix=np.eye(3), values=np.zeros(3), covariance=covariance)
    np.testing.assert_allclose(numbers.factor, np.eye(3), atol=1e-15)
