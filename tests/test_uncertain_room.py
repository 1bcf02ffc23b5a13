"""A room whose volume, areas and climate are uncertain: the QP, its statistics, its file, bad input."""

import cvxpy as cp
import numpy as np
import pytest
from scipy import stats

import rtcal as rt
from rtcal.acoustics.marks import agreement
from rtcal.acoustics.room_errors import target_changes
from rtcal.calibration.unknowns import Configurations
from rtcal.finder import Case, Configuration
from rtcal.finder.evidence import directions
from rtcal.simulators.external import of_equation
from rtcal.support.errors import DataError
from tests import conftest

AREAS = np.array([35.0, 30.0, 21.0, 15.0])
BANDS = (250, 500, 1000, 2000)
STATED = {"volume_sigma": 0.05, "area_sigma": 0.03}
SABINE = rt.Sabine()
EXACT = 1e-4  # relative uncertainty of T that method mle assumes


def room_of(seed, *, small=False, **stated):
    """A room without air, in which b is proportional to the volume."""
    rng = np.random.default_rng(seed)
    mu = rng.uniform(0.01, 0.04, (4, 4)) if small else rng.uniform(0.2, 0.6, (4, 4))
    return rt.Room(
        name="box",
        volume=105,
        materials=["floor", "ceiling", "wall", "door"],
        areas=AREAS,
        alpha=mu,
        sigma=rng.uniform(0.02, 0.06, (4, 4)),
        centre_frequencies=BANDS,
        **stated,
    )


def times(room, seed, off=0.1):
    return SABINE.reverberation_time(room) * np.exp(
        off * np.random.default_rng(seed).standard_normal(room.n_bands)
    )


def by_areas(room, t, solver):
    """alpha of the QP in A = alpha S, with every S and the volume unknown, by another solver."""
    b, s0, mu, sigma = SABINE.target(room, t), room.areas, room.alpha, room.sigma
    n, k = mu.shape
    absorbed, shift, v = cp.Variable((n, k)), cp.Variable(n), cp.Variable()
    noise = cp.Variable(k)
    s = cp.multiply(s0, 1 + shift)
    mean = cp.multiply(mu, cp.reshape(s, (n, 1), order="C") @ np.ones((1, k)))
    cost = cp.sum_squares((absorbed - mean) / (sigma * s0[:, np.newaxis]))
    cost += cp.sum_squares(shift / room.area_sigma) + (v / room.volume_sigma) ** 2
    cost += cp.sum_squares(noise / EXACT)
    match = [cp.sum(absorbed, axis=0) + b * v + cp.multiply(b, noise) == b]
    cp.Problem(cp.Minimize(cost), match).solve(solver=solver)
    return np.asarray(mu + (absorbed.value - mean.value) / s0[:, np.newaxis])


@pytest.mark.filterwarnings("ignore::rtcal.support.errors.MissingAirWarning")
@pytest.mark.parametrize("solver", ["CLARABEL", "HIGHS"])
@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_qp_with_areas_and_volume_among_the_unknowns(solver, seed):
    room = room_of(seed, **STATED)
    t = times(room, seed)
    result = rt.calibrate(room, t, equation=SABINE)
    assert not result.active.any()
    assert result.certificate.worst < 1e-9
    np.testing.assert_allclose(result.alpha, by_areas(room, t, solver), rtol=0, atol=2e-6)
    assert np.abs(result.shift).max() > 0.01


@pytest.mark.parametrize("equation", [SABINE, rt.Eyring(), rt.Kuttruff()])
def test_changes_of_the_target_are_derivatives(equation):
    """Each change against the difference between two rooms that are a little off."""
    room = room_of(1, air=rt.Air(22, 40), common_area_sigma=0.02, climate_sigma=(2, 8), **STATED)
    t = times(room, 2)
    changes = target_changes(equation, room, t)
    h = 1e-5

    def difference(**off):
        other = room.replace(**off)
        return equation.target(other, t) - other.absorption_area - base

    base = equation.target(room, t) - room.absorption_area
    assert np.allclose(changes[0], -0.05 * difference(volume=105 * (1 + h)) / h, rtol=1e-3)
    every = difference(areas=AREAS * (1 + h)) / h
    assert np.allclose(changes[1], -0.02 * every, rtol=1e-3)
    areas = AREAS.copy()
    areas[2] *= 1 + h
    assert np.allclose(changes[4], -0.03 * difference(areas=areas) / h, rtol=1e-3)
    warmer = difference(air=rt.Air(22 + 1e-3, 40)) / 1e-3
    assert np.allclose(changes[-2], -2 * warmer, rtol=0.1, atol=1e-3)
    assert np.abs(changes).max(axis=1).min() > 1e-4


def test_an_ever_more_certain_room_gives_the_exact_match():
    room, _ = rt.datasets.bras_cr2()
    t = 1.05 * rt.Eyring().reverberation_time(room)
    exact = rt.calibrate(room, t)
    nearly = rt.calibrate(room.replace(volume_sigma=1e-7, area_sigma=1e-7), t)
    np.testing.assert_allclose(nearly.alpha, exact.alpha, rtol=0, atol=1e-5)
    far = rt.calibrate(room.replace(volume_sigma=0.5), t)
    assert np.abs(far.shift).max() < 0.3 * np.abs(exact.shift).max()


def test_q_knows_the_room_and_the_common_factor():
    room = room_of(0, air=rt.Air(), common_alpha_sigma=0.1, **STATED)
    t = times(room, 3)
    result = rt.calibrate(room, t, equation=SABINE)
    areas = np.kron(AREAS, np.eye(4))
    mu, sigma = room.alpha.ravel(), room.sigma.ravel()
    changes = target_changes(SABINE, room, t)
    prior = np.diag(sigma**2) + 0.01 * np.outer(mu, mu)
    b = SABINE.target(room, t)
    u_b = EXACT * t * np.abs(SABINE.target_sensitivity(room, t))
    covariance = areas @ prior @ areas.T + changes.T @ changes + np.diag(u_b**2)
    miss = b - areas @ mu
    assert result.plausibility.q == pytest.approx(miss @ np.linalg.solve(covariance, miss), 1e-6)
    gain = prior @ areas.T @ np.linalg.inv(covariance)
    np.testing.assert_allclose(result.alpha.ravel(), mu + gain @ miss, rtol=0, atol=1e-9)
    left = np.sqrt(np.diag(prior - gain @ areas @ prior))
    np.testing.assert_allclose(result.posterior_sigma.ravel(), left, rtol=1e-6)


def test_several_configurations_share_the_volume():
    room = room_of(4, air=rt.Air(), **STATED)
    other = room.replace(name="furnished", areas=AREAS * [1, 0.5, 1, 1])
    t = [1.1 * SABINE.reverberation_time(r) for r in (room, other)]
    joint = rt.calibrate(Configurations([room, other]), t, "joint", SABINE)
    alone = rt.calibrate(room, t[0], "soft", SABINE)
    assert joint.certificate.worst < 1e-9
    assert (joint.posterior_sigma <= alone.posterior_sigma + 1e-12).all()
    warm = Configurations([room, other.replace(climate_sigma=(2, 0))])
    assert warm.union.climate_sigma == (2, 0)
    with pytest.raises(DataError, match=r"volume_sigma = 0\.1, but"):
        Configurations([room, other.replace(volume_sigma=0.1)])


def test_an_area_that_is_uncertain_in_one_configuration_counts_in_any_order():
    room = room_of(4, air=rt.Air())
    other = room.replace(name="furnished", area_sigma={"floor": 0.2})
    t = [factor * SABINE.reverberation_time(room) for factor in (1.1, 1.08)]
    first, last = (
        rt.calibrate(Configurations([room, other][::step]), t[::step], "joint", SABINE)
        for step in (1, -1)
    )
    assert last.configurations.union.area_sigma.tolist() == [0.2, 0, 0, 0]
    np.testing.assert_allclose(first.alpha, last.alpha, rtol=0, atol=1e-12)
    np.testing.assert_allclose(first.posterior_sigma, last.posterior_sigma, rtol=1e-9)
    with pytest.raises(DataError, match=r"has no air, but configuration .* has air"):
        Configurations([room.replace(air=None), room.replace(climate_sigma=(5, 10))])


@pytest.mark.parametrize("method", ["mle", "soft", "smooth", "robust"])
def test_a_standard_deviation_does_not_fall_where_the_room_is_less_certain(method):
    """Nor does it count as prior what a method wants beside it: it is that of the estimate."""
    exact = room_of(5, air=rt.Air())
    t = times(exact, 5)
    sure, unsure = (
        rt.calibrate(room, t, method, SABINE).posterior_sigma
        for room in (exact, exact.replace(volume_sigma=1e-6))
    )
    np.testing.assert_allclose(unsure, sure, rtol=1e-3)
    more = rt.calibrate(exact.replace(volume_sigma=0.05), t, method, SABINE).posterior_sigma
    assert (more > 0.98 * sure).all()


@pytest.mark.parametrize("method", ["mle", "soft", "smooth"])
def test_sensitivities_are_derivatives(method):
    """Every T counts, since all bands share the volume; also through the covariance, that T changes."""
    room = room_of(7, air=rt.Air(), common_alpha_sigma=0.1, **STATED)
    t = times(room, 7, 0.2)
    got = rt.posterior.sensitivity(rt.calibrate(room, t, method))[:, :, 0, :]
    step = 1e-4
    for k in range(4):
        ends = [t * (1 + s * step * (np.arange(4) == k)) for s in (1, -1)]
        high, low = (rt.calibrate(room, end, method).alpha for end in ends)
        np.testing.assert_allclose(
            got[:, :, k], (high - low) / (2 * step * t[k]), rtol=1e-4, atol=1e-5
        )


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"volume_sigma": 5}, "volume_sigma = 5 must be .* percent"),
        ({"volume_sigma": np.nan}, "volume_sigma = nan"),
        ({"common_alpha_sigma": "much"}, "common_alpha_sigma"),
        ({"area_sigma": [0.1, 0.1]}, "area_sigma has 2 values"),
        ({"area_sigma": {"roof": 0.1}}, 'area_sigma\\["roof"\\]'),
        ({"area_sigma": {"door": "1.5"}}, 'such as "1.5 m²"'),
        ({"area_sigma": {"door": "15 m²"}}, "below the area of 15 m²"),
        ({"area_sigma": 3}, 'area_sigma\\["floor"\\] = 3 must be .* percent'),
        ({"climate_sigma": (1,)}, "climate_sigma has shape"),
        ({"climate_sigma": (1, 5), "air": None}, "no air"),
    ],
)
def test_a_statement_that_is_none_is_refused(stated, message):
    with pytest.raises(DataError, match=message):
        room_of(0, **{"air": rt.Air(), **stated})


# A room's statement of its volume and areas is one statement, wherever the room goes

STATED_STATEMENT = {"volume_sigma": 0.08, "area_sigma": 0.05}


@pytest.fixture(scope="module")
def room():
    return rt.datasets.bras_cr2()[0].replace(surfaces=())


def measured(room):
    t = 1.15 * rt.Eyring().reverberation_time(room)
    return rt.Measurement.from_values(room.centre_frequencies, t20=t)


def test_a_loop_takes_it_as_exact_and_does_not_push_the_target(room):
    """The simulator is brought to T all the same, so the room's share must not drift into alpha."""
    loops = []
    for each in (room, room.replace(**STATED_STATEMENT)):
        simulator = of_equation(rt.Kuttruff(), each)
        loops.append(rt.calibrate_simulator(simulator, each, measured(each)))
    np.testing.assert_allclose(loops[1].room.alpha, loops[0].room.alpha, rtol=0, atol=1e-12)
    assert np.abs(loops[0].room.alpha - room.alpha).max() > 0.001


def test_an_archive_counts_it(room):
    shapes = {"A": [1, 1, 1, 1, 1], "B": [1, 2, 1, 0.5, 1], "C": [2, 1, 1, 1, 0.5]}
    exact = [room.replace(name=n, areas=room.areas * np.array(s)) for n, s in shapes.items()]
    sure, unsure = (
        rt.learn([rt.calibrate(r.replace(**stated), measured(r)) for r in exact])
        for stated in ({}, {"volume_sigma": 0.3})
    )
    assert unsure.mean_sigma.mean() > 1.05 * sure.mean_sigma.mean()
    shift = [np.abs(a.alpha - a.table).mean() for a in (sure, unsure)]
    assert shift[1] < shift[0]


# Calibrate and find state once what coefficients are off by, alone and together


def test_the_p_value_beside_the_first_has_the_errors_that_gap_find_assumes():
    room, measured = rt.datasets.bras_cr2()
    result = rt.calibrate(room, measured)
    case = Case(room=room, configurations=[Configuration(name="as built", measured=measured)])
    errors = directions(case)
    together = np.einsum("m,dmb->db", room.areas, errors[0])
    covariance = np.diag((room.areas[:, None] * room.sigma).T @ (room.areas[:, None] * room.sigma))
    deviation, stated = result.joint.innovation
    assert (np.diag(stated) >= covariance).all()  # and the uncertainty of T
    q = deviation @ np.linalg.solve(stated + together.T @ together, deviation)
    found = result.plausibility
    assert found.p_together == pytest.approx(stats.chi2.sf(q, room.n_bands), rel=1e-9)
    assert found.p_together > 100 * found.p_value


def test_what_errors_in_common_explain_is_no_contradiction():
    """Every coefficient is 20 % too small: improbable one by one, and usual of a handbook."""
    alpha, areas = (0.1, 0.2, 0.15, 0.1, 0.3, 0.25), (60, 60, 70, 70, 80, 80)
    handbook = {n: (s, a, 0.3 * a) for n, s, a in zip("abcdef", areas, alpha, strict=True)}
    room = conftest.room_of(handbook, 125 * 2.0 ** np.arange(6), 500, air=rt.Air())
    times = rt.Eyring().time(room, 1.25 * room.absorption_area)
    found = rt.calibrate(room, times).plausibility
    assert agreement(found.p_value) == "contradicts"
    assert agreement(found.p_value, found.p_together) == "agrees"
