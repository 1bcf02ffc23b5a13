"""The QP: its laws, its bounds, its warm start, and what it refuses."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rtcal as rt
from tests.conftest import random_room, true_times

EYRING = rt.Eyring()
seeds = st.integers(0, 10_000)


@given(seeds, st.sampled_from([1, 2, 6, 23]))
def test_both_methods_equal_their_closed_form_where_no_bound_is_active(seed, n):
    rng = np.random.default_rng(seed)
    room = random_room(rng, n, 3, rt.Air())
    t = true_times(rng, room, EYRING)
    for method, sigma in (("mle", room.sigma), ("lse", np.ones_like(room.sigma))):
        result = rt.calibrate(room, t, method=method)
        oracle = rt.exact.maximum_likelihood(room.alpha, sigma, room.areas, result.target)
        if np.all((oracle > 0) & (oracle < 1)):
            assert not result.active.any()
            np.testing.assert_allclose(result.alpha, oracle, rtol=0, atol=1e-10)
            multiplier = rt.exact.multiplier(room.alpha, sigma, room.areas, result.target)
            np.testing.assert_allclose(result.multipliers, multiplier, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(result.reverberation_time_after, t, rtol=1e-9)


def test_drawing_a_wall_as_several_polygons_changes_nothing():
    materials = [
        rt.Material("plaster", [0.05, 0.06], [0.02, 0.02]),
        rt.Material("carpet", [0.2, 0.4], [0.1, 0.1]),
    ]

    def room(*walls):
        surfaces = [rt.Surface(f"wall {i}", "plaster", a) for i, a in enumerate(walls)]
        return rt.Room.from_surfaces(
            name="r",
            volume=100,
            centre_frequencies=[500, 1000],
            materials=materials,
            surfaces=[*surfaces, rt.Surface("floor", "carpet", 33.0)],
        )

    t = [0.9, 0.8]
    whole, parts = rt.calibrate(room(96.0), t), rt.calibrate(room(50.0, 40.0, 6.0), t)
    np.testing.assert_allclose(parts.alpha, whole.alpha, rtol=0, atol=1e-14)
    assert [s.area for s in parts.room.surfaces] == [50.0, 40.0, 6.0, 33.0]


@pytest.mark.parametrize("solver", ["clarabel", "osqp"])
def test_active_bounds_meet_the_optimality_conditions(solver):
    """Hard walls and a T too long for their prior: several stand at 0 in the answer."""
    room = rt.Room(
        name="hard",
        volume=300,
        materials=["stone", "wood", "cloth"],
        areas=[200, 60, 20],
        alpha=[[0.02, 0.02], [0.08, 0.1], [0.3, 0.5]],
        sigma=[[0.02, 0.02], [0.02, 0.02], [0.1, 0.1]],
        centre_frequencies=[500, 1000],
    )
    t = EYRING.time(room, np.array([5.0, 6.0]))
    result = rt.calibrate(room, t, solver=solver)
    assert (result.active[0] == -1).all()
    np.testing.assert_array_equal(result.alpha[0], 0)
    gradient = result.shift / room.sigma**2 + result.multipliers * room.areas[:, np.newaxis]
    free = result.active == 0
    assert np.max(np.abs((gradient * room.sigma)[free])) < 1e-11
    assert np.all(gradient[~free] > 0)
    assert result.certificate.worst < 1e-11
    assert np.all(result.certificate.alpha_error_bound < 1e-6)
    assert result.plausibility.p_value is None


@pytest.mark.parametrize("end", ["low", "high"])
def test_a_target_at_an_end_is_that_end(end):
    rng = np.random.default_rng(3)
    sabine = rt.Sabine()
    room = random_room(rng, 6, 2, rt.Air()).replace(centre_frequencies=[4000, 8000])
    if end == "low":
        wanted, value, sign = np.zeros(2), 0.0, -1
    else:
        wanted, value, sign = np.full(2, room.areas.sum()), 1.0, 1
    result = rt.calibrate(room, sabine.time(room, wanted), equation=sabine)
    np.testing.assert_array_equal(result.alpha, value)
    assert (result.active == sign).all()
    assert result.certificate.worst < 1e-11
    # The multiplier is an interval; the end nearest 0 leaves one coefficient in balance.
    force = result.shift / room.sigma**2 + result.multipliers * room.areas[:, np.newaxis]
    np.testing.assert_allclose(np.min(np.abs(force), axis=0), 0, atol=1e-9)
    assert np.all(force * sign <= 1e-9)


def test_every_solver_cold_or_warm_has_one_answer_to_the_last_bit():
    """The polished answer depends on the active set alone; the closed form is the start of OSQP."""
    at_bound = 0
    for room, t in cases(12, 12, 8):
        one = rt.calibrate(room, t)
        at_bound += bool(one.active.any())
        cold = rt.calibrate(room, t, solver="osqp", warm_start=False)
        warm = rt.calibrate(room, t, solver="osqp")
        assert warm.raw.iterations == 5 < cold.raw.iterations
        others = [cold, warm, rt.calibrate(room, t, "mle")]
        for other in others:
            assert other.joint.polished
            for name in ("alpha", "multipliers", "active"):
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert at_bound == 6


@pytest.mark.parametrize("method", ["mle", "lse"])
def test_osqp_starts_at_the_optimum_also_where_an_end_holds_coefficients(method, cr2):
    room, _ = cr2
    t = rt.Eyring().time(room, 0.2 * room.total_area * np.ones(room.n_bands))
    t[[4, 5]] = 100.0  # longer than the air allows
    warm, cold = (
        rt.calibrate(room, t, method, solver="osqp", warm_start=start, unreachable="nearest")
        for start in (True, False)
    )
    assert len(warm.unreachable) == 2
    assert warm.raw.iterations <= 5 < cold.raw.iterations
    np.testing.assert_array_equal(warm.alpha, cold.alpha)


@pytest.mark.parametrize(
    ("solver", "settings"),
    [
        ("clarabel", {"tol_feas": 1e-3, "tol_gap_abs": 1e-3, "tol_gap_rel": 1e-3}),
        ("clarabel", {"max_iter": 1}),
        ("osqp", {"max_iter": 5}),
        ("osqp", {"eps_abs": 3e-2, "eps_rel": 3e-2, "polishing": False}),
    ],
)
@pytest.mark.parametrize("method", ["mle", "soft", "robust"])
def test_a_solver_that_stops_early_is_polished_to_the_same_answer(solver, settings, method, cr2):
    usual = rt.calibrate(*cr2, method=method)
    result = rt.calibrate(*cr2, method=method, solver=solver, warm_start=False, settings=settings)
    assert result.certificate.worst < 1e-10
    np.testing.assert_allclose(result.alpha, usual.alpha, rtol=0, atol=1e-12)
    off = np.abs(result.joint.raw_alpha - result.alpha)
    assert off.max() > 1e-9
    assert (result.joint.raw_certificate.alpha_error_bound >= off).all()
    assert result.certificate.worst < result.joint.raw_certificate.worst


def test_an_answer_that_fails_the_certificate_is_not_returned(cr2, monkeypatch):
    from rtcal.calibration import qp

    monkeypatch.setattr(qp, "polish", lambda *_: None)
    with pytest.raises(rt.errors.SolverError, match="fails the optimality check: primal residual"):
        rt.calibrate(*cr2, solver="osqp", settings={"max_iter": 3, "polishing": False})


def test_what_a_solver_does_not_know_is_refused(cr2):
    for options, error, place in (
        ({"solver": "scs"}, rt.errors.ModelError, "solver = 'scs' must be"),
        ({"solver": 5}, rt.errors.ModelError, "solver = 5"),
        ({"settings": {"no": 1}}, rt.errors.ModelError, '^solver "clarabel" does not accept'),
        ({"settings": {"max_iter": "many"}}, rt.errors.ModelError, "many"),
        (
            {"solver": "osqp", "settings": {"no": 1}},
            rt.errors.ModelError,
            '^solver "osqp" does not accept .*no=1: ',
        ),
        ({"solver": "osqp", "settings": 5}, rt.errors.ModelError, "settings = 5"),
        ({"warm_start": "closed"}, rt.errors.DataError, "warm_start"),
        ({"unreachable": "no"}, rt.errors.DataError, "unreachable"),
    ):
        with pytest.raises(error, match=place):
            rt.calibrate(*cr2, **options)


# A problem is compiled once for its shape and terms, whoever asks, and threads share it

EYRING = rt.Eyring()


def cases(count, n=6, k=4):
    """Rooms of one shape; in every other one, T pushes coefficients to their bounds."""
    made = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        room = random_room(rng, n, k, rt.Air())
        t = true_times(rng, room, EYRING)
        made.append((room, EYRING.time(room, 0.15 * room.absorption_area) if seed % 2 else t))
    return made


@pytest.mark.parametrize("solver", ["clarabel", "osqp"])
def test_rooms_of_one_shape_are_compiled_once(solver, compilations):
    answers = [rt.calibrate(room, t, solver=solver).alpha for room, t in cases(4)]
    assert len(compilations) == 1
    for (room, t), alpha in zip(cases(4), answers, strict=True):
        rt.calibration.forget()
        np.testing.assert_array_equal(rt.calibrate(room, t, solver=solver).alpha, alpha)


def test_threads_share_one_problem(compilations):
    given = cases(24)
    ready = threading.Barrier(8)

    def solve(some):
        ready.wait(30)
        return [rt.calibrate(room, t, "soft").alpha for room, t in some]

    with ThreadPoolExecutor(8) as threads:
        found = list(threads.map(solve, [given[i::8] for i in range(8)]))
    assert len(compilations) == 1
    for i, answers in enumerate(found):
        for (room, t), alpha in zip(given[i::8], answers, strict=True):
            np.testing.assert_array_equal(rt.calibrate(room, t, "soft").alpha, alpha)
