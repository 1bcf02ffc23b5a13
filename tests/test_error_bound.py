"""The bound of the error: against rational arithmetic, and at the edge of double precision."""

import contextlib
import warnings
from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.calibration import exact
from rtcal.calibration.qp import System, certify, with_errors
from rtcal.support.errors import SolverError
from tests import coupled, rational
from tests.conftest import also, room_of


def answers(solver="clarabel"):
    """Answers and their exact optima, without problems that have no accepted answer (0.1 %)."""
    for seed in range(30):
        with contextlib.suppress(SolverError):
            answer = coupled.solution(seed, solver)
            truth = coupled.optimum(answer)
            if truth is not None:
                yield answer, truth


@pytest.mark.parametrize("solver", ["clarabel", *also("osqp")])
def test_the_bound_holds_for_raw_and_final_answers_and_is_small(solver):
    off, widest = 0, []
    for answer, truth in answers(solver):
        for alpha, certificate in (
            (answer.raw_alpha, answer.raw_certificate),
            (answer.alpha, answer.certificate),
        ):
            error = np.abs(alpha - answer.composition.layout.expand(truth))
            assert (error <= certificate.alpha_error_bound + 2e-16).all()
            off += error.max() > 1e-9
        widest.append(np.max(answer.certificate.alpha_error_bound))
    assert off > (6 if solver == "clarabel" else 0)  # OSQP starts near the optimum
    assert len(widest) > 24
    assert max(widest) < 1e-6
    assert np.median(widest) < 1e-10


@pytest.mark.parametrize("seed", [17, 62, 76, 505, 561, 642, 763, 2837])
def test_nearly_dependent_rows_and_an_optimum_at_a_bound_are_polished(seed):
    answer = coupled.solution(seed)
    assert answer.polished
    assert np.max(answer.certificate.alpha_error_bound) < 1e-6


def test_a_wrong_answer_has_large_residuals_and_a_bound_that_holds(cr2):
    """The certificate is computed from the matrices: what a solver states of its answer is not used."""
    rng = np.random.default_rng(1)
    joint = rt.calibrate(*cr2, method="soft").joint
    qp, right = joint.qp, joint.point
    assert certify(qp, right, 1.0).worst < 1e-12
    place = qp.compiled.places
    for noise in (1e-8, 1e-4, 1e-1):
        v = right.v.copy()
        v[place] += noise * rng.standard_normal(len(place))
        wrong = certify(qp, replace(right, v=v), 1.0)
        assert wrong.worst > noise / 1e3
        assert not wrong.accepted
        moved = joint.composition.layout.expand(qp.scale[place] * np.abs(v - right.v)[place])
        assert (wrong.alpha_error_bound >= moved).all()


def extreme_room(seed):
    """Return a room and a T in s that some coefficients within its bounds give; some bands have none.

    Up to 200 materials, areas from 0.1 to 1,000 m², standard deviations of 1e-8 among ordinary ones.
    """
    rng = np.random.default_rng(seed)
    n = int(rng.choice([1, 2, 5, 20, 60, 200], p=[0.1, 0.2, 0.3, 0.2, 0.1, 0.1]))
    shape = (n, int(rng.integers(1, 7)))
    alpha = rng.uniform(0, 1, shape)
    sigma = 10 ** rng.uniform(-3, 0, shape)
    certain = rng.random(shape) < rng.choice([0, 0.1, 0.5, 0.9])
    sigma[certain] = 10 ** rng.uniform(-8, -5, certain.sum())
    areas = 10 ** rng.uniform(-1, 3, n)
    floor = np.zeros(shape) if rng.random() < 0.5 else alpha * rng.uniform(0, 1, shape)
    room = rt.Room(
        name="extreme",
        volume=float(areas.sum() ** 1.5 / 10),
        materials=[f"m{i}" for i in range(n)],
        areas=areas,
        alpha=alpha,
        sigma=sigma,
        centre_frequencies=[125, 250, 500, 1000, 2000, 4000][: shape[1]],
        air=rt.Air(),
        alpha_min=floor,
    )
    near_prior = alpha + sigma * rng.standard_normal(shape) * 10 ** rng.uniform(-1, 2)
    near_floor = floor + (1 - floor) * 10 ** rng.uniform(-9, 0, (1, shape[1]))
    true = [near_prior, near_floor, rng.uniform(floor, 1)][rng.integers(3)]
    t = rt.Eyring().time(room, areas @ np.clip(true, floor, np.maximum(floor, 0.999)))
    missing = rng.random(shape[1]) < 0.15
    missing[0] = False
    return room, np.where(missing, np.nan, t)


@pytest.mark.long
def test_no_failure_and_no_answer_outside_its_bound_at_the_edge_of_double_precision():
    """The truth is `rtcal.exact`, which shares no code with the calibration; its rounding is 1e-12."""
    looseness = []
    for seed in range(30):
        room, t = extreme_room(seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = rt.calibrate(room, t, unreachable="nearest")
        missing = np.isnan(t)
        target = np.where(missing, 0.0, result.target)
        given = (room.alpha.T, room.sigma.T, room.areas, target, room.alpha_min.T, 1.0)
        truth = np.where(missing, room.alpha, exact.solve(*given).alpha.T)
        error, bound = np.abs(result.alpha - truth), result.certificate.alpha_error_bound
        raw_error = np.abs(result.joint.raw_alpha - truth)
        raw_bound = result.joint.raw_certificate.alpha_error_bound
        assert (raw_error <= raw_bound + 1e-12).all()
        assert (error <= bound + 1e-12).all()
        assert bound.max() < 1e-6
        assert np.max(error[:, missing], initial=0.0) < 1e-12
        measurable = raw_error > 1e-9
        looseness += (raw_bound[measurable] / raw_error[measurable]).tolist()
    assert np.median(looseness) < 2


@pytest.mark.parametrize("configurations", [2, 3])
def test_errors_of_rows_of_either_sign_are_within_the_bound(configurations):
    """Two patterns of signs, alternating, are no bound of the errors of three rows or more."""
    problem, rng = coupled.compiled(configurations, 5, 0).compiled, np.random.default_rng(1)
    first = [
        int(problem.A_columns[problem.A_rows == row].min()) for row in range(len(problem.equal))
    ]
    bands = [np.flatnonzero(np.equal(first, column)) for column in {*first}]
    assert [len(rows) for rows in bands] == [configurations] * len(coupled.FREQUENCIES)
    for rows in bands:
        moves = rng.standard_normal((100, configurations))  # of one unknown, by each row's error
        summed = np.abs(moves @ problem.signs[1][rows]).sum(axis=1)
        assert (np.abs(moves).sum(axis=1) <= summed * (1 + 1e-12)).all()


@pytest.mark.parametrize("seed", range(3))
def test_errors_of_rows_that_define_variables_are_errors_of_the_gradient(seed):
    """The smooth method defines steps and misfits: 41 rows are joined, and no solve is needed."""
    rng = np.random.default_rng(seed)
    alpha, areas = rng.uniform(0.05, 0.9, (7, 6)), rng.uniform(1, 100, 7)
    materials = {
        f"m{i}": (s, a, 0.3 * a) for i, (s, a) in enumerate(zip(areas, alpha, strict=True))
    }
    room = room_of(materials, [125, 250, 500, 1000, 2000, 4000], 200.0, air=rt.Air())
    true = np.clip(alpha + 0.6 * alpha * rng.standard_normal(alpha.shape), 0, 0.99)
    joint = rt.calibrate(room, rt.Eyring().time(room, areas @ true), method="smooth").joint
    qp, at = joint.qp, joint.point.at
    assert qp.compiled.defining is not None
    system = System(qp, at == 0, qp.equal)
    for _ in range(100):
        errors = [rng.standard_normal(n) * (rng.random(n) < 0.2) for n in (len(qp.c), len(qp.b))]
        moved = system.solve(*errors)[0][qp.compiled.places]
        left = with_errors(qp, np.zeros(len(qp.c)), *map(np.abs, errors))
        assert 0 < np.linalg.norm(moved) <= np.linalg.norm(left)


@pytest.mark.parametrize("seed", [160, 258, 350, 370, 613, 711, 777, *range(20)])
def test_near_an_end_the_bound_has_the_rounding_of_the_row(seed):
    """The row has no free variable there: its slack counted, and not the rounding of its slack."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    alpha, sigma = rng.uniform(0.01, 0.95, n), 10 ** rng.uniform(-3, 0, n)
    areas, near = 10 ** rng.uniform(-1, 2.5, n), 10 ** rng.uniform(-13, -1)
    true = (
        near * rng.uniform(0, 1, n) if rng.random() < 0.5 else 0.9999 - near * rng.uniform(0, 1, n)
    )
    materials = {f"m{i}": each for i, each in enumerate(zip(areas, alpha, sigma, strict=True))}
    room = room_of(materials, [500], float(areas.sum()) ** 1.5 / 10)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the room has no air
        result = rt.calibrate(room, rt.Eyring().time(room, np.array([areas @ true])))
    truth = rational.solve(alpha, sigma, areas, float(result.target[0]))
    error = np.abs(result.alpha[:, 0] - np.array([float(a) for a in truth]))
    assert (error <= result.certificate.alpha_error_bound[:, 0] + 1e-17).all()
