"""Every term: its cvxpy expression against plain NumPy, its derivatives, what it refuses."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp

import rtcal as rt
from rtcal import terms
from rtcal.calibration.compiled_qp import Context
from rtcal.calibration.configurations import Assembler, Configurations, layout_of
from rtcal.calibration.feasibility import reach
from rtcal.calibration.problem_data import ProblemData, times_in_room
from rtcal.support.kkt import Hessian
from tests.conftest import random_room, true_times

EYRING = rt.Eyring()
GAIN = [0.5, 1.0, 2.0, 1.5]
OBJECTIVE = {
    "prior": terms.PriorDeviation(),
    "correlated": terms.PriorDeviation(
        band_correlation={"m0": 0.7, "m2": 0.4}, material_correlation={("m1", "m3"): 0.5}
    ),
    "together": terms.PriorDeviation(common=True),
    "together and correlated": terms.PriorDeviation(
        band_correlation=0.6, material_correlation={("m1", "m3"): 0.5}, common=True
    ),
    "huber": terms.HuberDeviation(threshold=0.8),
    "soft": terms.SoftMatch(0.05),
    "uncertain room": terms.RoomMatch(0.05),
    "smooth": terms.BandSmoothness(),
    "effect": terms.AddedAbsorption("opening", GAIN, sigma=2.0, mean=0.5),
}
ROWS = {
    "exact": terms.ExactMatch(),
    "within": terms.MatchWithin(1.0),
    "at most": terms.AtMost("m1", "m3"),
    "group": terms.GroupAbsorption(["m0", "m2"], least=5.0, most=50.0),
    "group at one band": terms.GroupAbsorption(["m0", "m1"], most=30.0, band=250),
}


def made(seed: int, term: object = None) -> tuple[Context, ProblemData, rt.Room]:
    """Problem data with a missing T, a coefficient with sigma = 0 and one that is pinned."""
    rng = np.random.default_rng(seed)
    room = random_room(rng, 4, 4)
    sigma = room.sigma.copy()
    sigma[0, 1] = 0.0
    room = room.replace(
        sigma=sigma,
        air=rt.Air(),
        volume_sigma=0.05,
        area_sigma=0.03,
        common_area_sigma=0.02,
        common_alpha_sigma=0.1,
        climate_sigma=(2, 10),
    )
    t = true_times(rng, room, EYRING)
    t[2] = np.nan
    objective = terms.as_objective(terms.PriorDeviation())
    if isinstance(term, terms.ObjectiveTerm):
        objective = terms.Objective((term,), (2.5,))
    configurations = Configurations([room])
    layout = layout_of(configurations, objective, [])
    assembler = Assembler(layout, EYRING, objective, (), 0, None)
    data = assembler.problem_data(configurations, [times_in_room(room, t)], None)
    where = np.zeros(layout.size, dtype=bool)
    where[5] = True
    return Context(layout), data.pin(where, np.full(layout.size, 0.9)), room


def point(data: ProblemData, seed: int) -> tuple[np.ndarray, np.ndarray]:
    x = np.random.default_rng(seed + 1).standard_normal(data.layout.size)
    return x, data.centre + data.scale * x


@pytest.mark.parametrize("name", OBJECTIVE)
@pytest.mark.parametrize("seed", range(4))
def test_expression_equals_the_numpy_twin(name: str, seed: int) -> None:
    """Up to a constant: what is held contributes one, and x of what is held is free."""
    term = OBJECTIVE[name]
    context, data, _ = made(seed, term)
    expression = term.expression(context, 0)
    context.update(data)
    values, numpy_values = [], []
    loose = (data.scale == 0) & (np.arange(data.layout.size) < data.layout.n_alpha)
    for s in (seed, seed + 50):
        x, u = point(data, s)
        # The helper unknowns of a term and the x of held coefficients take their best value.
        problem = cp.Problem(cp.Minimize(expression), [context.x[~loose] == x[~loose]])
        problem.solve(solver="CLARABEL", tol_gap_abs=1e-12, tol_gap_rel=1e-12, tol_feas=1e-12)
        values.append(problem.value)
        numpy_values.append(data.weights[0] * term.value(u, data))
    assert abs(numpy_values[1] - numpy_values[0]) > 1e-3
    assert values[1] - values[0] == pytest.approx(numpy_values[1] - numpy_values[0], rel=1e-6)


@pytest.mark.parametrize("name", OBJECTIVE)
def test_gradient_and_curvature_are_derivatives_of_the_value(name: str) -> None:
    term = OBJECTIVE[name]
    _, data, _ = made(3, term)
    rng = np.random.default_rng(0)
    u = data.centre + 0.02 * rng.standard_normal(data.layout.size)
    curvature = Hessian.total([(1.0, term.curvature(u, data))], len(u)).whole()
    curvature = curvature.toarray() if sp.issparse(curvature) else np.diag(curvature)
    gradient = term.gradient(u, data)
    h = 1e-6
    for i in range(len(u)):
        step = np.zeros_like(u)
        step[i] = h
        slope = (term.value(u + step, data) - term.value(u - step, data)) / (2 * h)
        assert gradient[i] == pytest.approx(slope, rel=1e-5, abs=1e-5)
        bend = (term.gradient(u + step, data) - term.gradient(u - step, data)) / (2 * h)
        np.testing.assert_allclose(curvature[i], bend, rtol=1e-5, atol=1e-3)
    assert np.abs(gradient).max() > 1e-4
    # The claimed convexity holds: curvature - diag(m / sigma²) has no negative eigenvalue.
    sigma = data.sigma
    moves = sigma > 0
    scaled = (curvature * np.outer(sigma, sigma))[np.ix_(moves, moves)]
    m = term.convexity(data)[moves]
    assert np.linalg.eigvalsh(scaled - np.diag(m)).min() > -1e-9 * max(1, np.abs(scaled).max())


@pytest.mark.parametrize("name", ROWS)
@pytest.mark.parametrize("seed", range(4))
def test_constraint_expressions_equal_the_rows_of_the_twin(name: str, seed: int) -> None:
    term = ROWS[name]
    context, data, _ = made(seed)
    constraints = term.constraints(context)
    context.update(data)
    x, u = point(data, seed)
    context.x.value = x
    rows, scale = term.rows(data), term.row_scale(data)
    at = rows.matrix @ u
    applies = scale > 0
    for constraint, sign in constraints:
        got = np.asarray(constraint.args[0].value - (constraint.args[1].value))
        limit = rows.upper if sign > 0 else rows.lower
        if name == "exact":
            limit = np.where(applies, rows.lower, 0.0)
        wanted = (at - np.where(applies, limit, 0.0)) * scale
        # cvxpy writes a >= b as b - a <= 0.
        got = got if sign > 0 else -got
        np.testing.assert_allclose(np.abs(got[applies]), np.abs(wanted[applies]), atol=1e-12)
        assert np.abs(wanted[applies]).max() > 1e-3
        excess = wanted[applies] * sign
        np.testing.assert_array_equal(got[applies] * sign > 0, excess > 0)


def test_correlated_prior_is_the_gaussian_with_that_correlation() -> None:
    """Dense algebra, the unknown with sigma = 0 integrated out."""
    term = OBJECTIVE["correlated"]
    _, data, room = made(1, term)
    layout = data.layout
    r = term.correlation(layout)
    octaves = np.log2(room.centre_frequencies)
    assert r[0, 3] == pytest.approx(0.7 ** (octaves[3] - octaves[0]))
    assert r[4, 5] == 0
    assert r[4, 12] == pytest.approx(0.5)  # the same band of two materials
    moves = data.sigma > 0
    x = np.random.default_rng(2).standard_normal(layout.size)
    u = data.mu + data.sigma * x
    inverse = np.linalg.inv(r[np.ix_(moves, moves)])
    wanted = 0.5 * x[moves] @ inverse @ x[moves]
    assert term.value(u, data) == pytest.approx(wanted, rel=1e-10)
    columns = np.random.default_rng(3).standard_normal((layout.size, 2))
    np.testing.assert_allclose(term.correlate(columns, layout), r @ columns, atol=1e-12)


def test_a_term_is_priced_by_hand() -> None:
    _, data, room = made(0, terms.SoftMatch(0.05))
    u = data.mu.copy()
    u[:4] += 0.1
    miss = (room.areas @ data.alpha(u) - data.target[0])[[0, 1, 3]]
    t = data.time[0]
    slope = (EYRING.target(room, t * 1.001) - EYRING.target(room, t * 0.999)) / 0.002
    u_b = np.abs(0.05 * slope)[[0, 1, 3]]
    assert terms.SoftMatch(0.05).value(u, data) == pytest.approx(
        0.5 * np.sum((miss / u_b) ** 2), rel=1e-4
    )
    x = np.array([0.5, -3.0])
    h = terms.HuberDeviation(threshold=1.0, convex=0.1)
    u = data.mu.copy()
    u[2:4] += data.sigma[2:4] * x
    wanted = 0.1 * (0.125 + 4.5) + 0.9 * (0.125 + 3.0 - 0.5)
    assert h.value(u, data) == pytest.approx(wanted, rel=1e-12)
    smooth = terms.BandSmoothness()
    # Row 0 has sigma = 0 in band 1, so only bands 2 and 3 are neighbours there.
    assert smooth.value(u, data) == pytest.approx(0.5 * (3.5**2), rel=1e-12)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: terms.PriorDeviation(sigma=0.0), "must be finite and above 0"),
        (lambda: terms.HuberDeviation(threshold=-1), "must be finite and above 0"),
        (lambda: terms.HuberDeviation(convex=0), r"in \(0, 1\]"),
        (lambda: terms.SoftMatch(-0.1), "above 0"),
        (lambda: terms.MatchWithin(20), "from 0 to below 20"),
        (lambda: terms.AddedAbsorption("x", [1, np.nan], 1.0), "not finite"),
        (lambda: terms.AddedAbsorption("x", [1, 1], 0.0), "above"),
        (lambda: terms.AtMost("a", "a"), "both sides"),
        (lambda: terms.GroupAbsorption(["a"]), "one of them at least"),
        (lambda: terms.GroupAbsorption([], least=1), "needs a material"),
        (lambda: terms.GroupAbsorption(["a"], least=3, most=2), "least <= most"),
        (lambda: terms.Shared("a"), "two different"),
        (lambda: -1 * terms.BandSmoothness(), "not convex"),
    ],
)
def test_terms_refuse_what_makes_no_sense(make, says: str) -> None:
    with pytest.raises(rt.errors.ModelError, match=says):
        make()


@pytest.mark.parametrize(
    ("term", "error", "says"),
    [
        (terms.PriorDeviation(band_correlation=1.0), "ModelError", r"not in \[0, 1\)"),
        (terms.PriorDeviation(band_correlation={"no": 0.5}), "DataError", "is no material"),
        (terms.PriorDeviation(band_correlation=np.ones((2, 2))), "ModelError", "shape"),
        (terms.PriorDeviation(band_correlation=np.ones((4, 4))), "ModelError", "definite"),
        (
            terms.PriorDeviation(material_correlation={("m0", "m1"): 1.5}),
            "ModelError",
            "not positive definite",
        ),
    ],
)
def test_correlations_that_are_none_are_refused(term, error: str, says: str) -> None:
    room = random_room(np.random.default_rng(0), 4, 4)
    with pytest.raises(getattr(rt.errors, error), match=says):
        rt.Calibration(term).build(room)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: terms.Bounds(material=5), "Bounds: 5 is not the name of a material"),
        (lambda: terms.Bounds(band=-1), "Bounds: band = -1 Hz is not finite and above 0"),
        (lambda: terms.Fixed(5), "Fixed: 5 is not the name of a material"),
        (lambda: terms.Fixed("a", band=0), "Fixed: band = 0 Hz is not finite and above 0"),
        (lambda: terms.Shared("a", 5), "Shared: 5 is not the name of a material"),
        (lambda: terms.AtMost(5, "a"), "AtMost: 5 is not the name of a material"),
        (lambda: terms.AtMost("a", 5), "AtMost: 5 is not the name of a material"),
        (lambda: terms.AtMost("a", "b", band=0), "AtMost: band = 0 Hz is not finite and above 0"),
        (
            lambda: terms.GroupAbsorption(["a", 5], most=1),
            "GroupAbsorption: 5 is not the name of a material",
        ),
        (
            lambda: terms.GroupAbsorption(["a"], most=1, band=0),
            "GroupAbsorption: band = 0 Hz is not finite and above 0",
        ),
    ],
)
def test_names_and_bands_of_terms_are_checked(make, says: str) -> None:
    with pytest.raises(rt.errors.DataError) as error:
        make()
    assert str(error.value) == says


def test_a_soft_match_names_its_argument() -> None:
    with pytest.raises(rt.errors.ModelError, match=r"^SoftMatch: relative\b"):
        terms.SoftMatch("much")


def test_target_limits_are_those_of_the_longest_and_the_shortest_time() -> None:
    _, data, room = made(0)
    low, high = terms.MatchWithin(2.0).target_limits(data)
    matched = [0, 1, 3]
    t = data.time[0]
    np.testing.assert_allclose(low[0, matched], EYRING.target(room, 1.1 * t)[matched], rtol=1e-12)
    np.testing.assert_allclose(high[0, matched], EYRING.target(room, 0.9 * t)[matched], rtol=1e-12)


def made_with_effects(gains: dict[str, list[float]]) -> ProblemData:
    """Problem data with further unknowns, whose prior sigma is 3."""
    room = random_room(np.random.default_rng(2), 4, 4)
    effects = tuple(terms.AddedAbsorption(name, gain, sigma=3.0) for name, gain in gains.items())
    objective = terms.Objective((terms.PriorDeviation(), *effects), (1.0,) * (1 + len(effects)))
    configurations = Configurations([room])
    layout = layout_of(configurations, objective, [])
    t = EYRING.time(room, room.areas @ room.alpha)
    assembler = Assembler(layout, EYRING, objective, (), 0, None)
    return assembler.problem_data(configurations, [times_in_room(room, t)], None)


def test_effects_widen_the_reach_of_their_own_band_and_side() -> None:
    data = made_with_effects({"opening": [1.0, 0, 0, 0], "correction": [0, 0, -2.0, 0]})
    least, most = reach(data)
    total = data.areas[0].sum()
    np.testing.assert_allclose(least[0], [0, 0, -np.inf, 0])
    np.testing.assert_allclose(most[0], [np.inf, total, total, total])


def test_a_row_is_scaled_by_all_that_can_move_in_it() -> None:
    data = made_with_effects({"opening": GAIN})
    variance = data.areas[0] ** 2 @ data.alpha(data.sigma) ** 2 + np.square(GAIN) * 3.0**2
    np.testing.assert_allclose(terms.ExactMatch().row_scale(data), variance**-0.5, rtol=1e-12)


@pytest.mark.parametrize("correlation", [0.0, 0.5])
def test_the_prior_is_as_convex_as_its_correlation_allows(correlation: float) -> None:
    data = made_with_effects({"opening": GAIN})
    prior = terms.PriorDeviation(
        band_correlation=correlation, material_correlation={("m1", "m3"): correlation}
    )
    least = 1 / np.linalg.eigvalsh(prior.correlation(data.layout)).max()
    convexity = prior.convexity(data)
    np.testing.assert_allclose(convexity, [least] * data.layout.n_alpha + [0.0], rtol=1e-12)


def test_the_huber_prior_is_not_convex_in_what_it_does_not_weigh() -> None:
    data = made_with_effects({"opening": GAIN})
    convexity = terms.HuberDeviation(convex=0.2).convexity(data)
    np.testing.assert_array_equal(convexity, [0.2] * data.layout.n_alpha + [0.0])


def test_a_pinned_unknown_has_its_value_as_centre() -> None:
    _, data, _ = made(0)
    where = np.arange(data.layout.size) == 7
    pinned = data.pin(where, np.full(data.layout.size, 0.25))
    np.testing.assert_array_equal(pinned.centre, np.where(where, 0.25, data.centre))
    np.testing.assert_array_equal(pinned.pinned, where | data.pinned)


def test_groups_of_shared_materials_stay_apart() -> None:
    room = random_room(np.random.default_rng(0), 5, 2)
    objective = terms.as_objective(terms.PriorDeviation())
    shared = [terms.Shared("m1", "m3"), terms.Shared("m4", "m0")]
    assert layout_of(Configurations([room]), objective, shared).rows == (0, 1, 2, 1, 0)
    joined = [*shared, terms.Shared("m3", "m0")]
    assert layout_of(Configurations([room]), objective, joined).rows == (0, 0, 1, 0, 0)
