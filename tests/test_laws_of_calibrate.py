"""Plain questions to a calibration, over all methods, equations and kinds of uncertain rooms."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.support.errors import DataError
from tests.conftest import also, in_order, room_of

METHODS = ("mle", "lse", "soft", "smooth", "robust")
EQUATIONS = (rt.Sabine(), rt.Eyring(), rt.Kuttruff())
STATED = {
    "exact": {},
    "uncertain": {"volume_sigma": 0.05, "area_sigma": 0.03, "climate_sigma": (2, 10)},
    "correlated": {"band_correlation": 0.6, "common_alpha_sigma": 0.15},
}
BANDS = [125, 250, 500, 1000, 2000]


def room(seed=1, **stated):
    rng = np.random.default_rng(seed)
    alpha = rng.uniform(0.03, 0.4, (4, 5))
    areas = {"carpet": 34, "boards": 80, "glass": 14, "door": 6}
    materials = {n: (s, a, 0.3 * a) for (n, s), a in zip(areas.items(), alpha, strict=True)}
    return room_of(materials, BANDS, 95, air=rt.Air(21, 45), **stated)


def cases():
    every = [
        (m, e, kind)
        for m in METHODS
        for e in EQUATIONS
        for kind in STATED
        if not (m == "robust" and kind == "correlated")
    ]
    quick = [c for i, c in enumerate(every) if i % 3 == 0]
    return [*quick, *also(*(c for c in every if c not in quick))]


@pytest.mark.parametrize(("method", "equation", "kind"), cases())
def test_a_calibrated_room_is_not_moved_by_the_t_that_it_has(method, equation, kind):
    given = room(**STATED[kind])
    t = equation.reverberation_time(given) * np.array([1.2, 0.9, 0.8, 1.1, 1.0])
    first = rt.calibrate(given, t, method, equation)
    again = first.room.replace(calibration=None)
    second = rt.calibrate(again, first.reverberation_time_after, method, equation)
    np.testing.assert_allclose(second.alpha, first.alpha, rtol=0, atol=1e-9)
    assert np.nanmax(np.abs(second.gap_before)) < 1e-9
    with pytest.raises(DataError, match=r"already calibrated|twice"):
        rt.calibrate(first.room, t, method, equation)


def without_air(given, size):
    still = given.replace(air=None, climate_sigma=(0, 0))
    return still.replace(volume=size**3 * given.volume, areas=size**2 * given.areas)


ORDER, AS_IT_IS = np.array([2, 0, 3, 1]), np.arange(4)
ALIKE = {
    "nothing": (lambda r: r, lambda r: r, 1.0, AS_IT_IS),
    "order": (lambda r: r, lambda r: in_order(r, ORDER), 1.0, ORDER),
    # (k V / T - 4 m V) / S has the same value.
    "twice": (lambda r: r, lambda r: r.replace(volume=190, areas=2 * r.areas), 1.0, AS_IT_IS),
    "size": (lambda r: without_air(r, 1.0), lambda r: without_air(r, 2.3), 2.3, AS_IT_IS),
}
"""What makes of a room one that is as absorbing; how many times as long its T is; its materials."""


@pytest.mark.parametrize("law", ALIKE)
@pytest.mark.parametrize(("method", "equation", "kind"), cases())
def test_rooms_that_are_alike_have_one_answer(law, method, equation, kind):
    first, second, longer, order = ALIKE[law]
    rooms = [of(room(2, **STATED[kind])) for of in (first, second)]
    stated = [equation.reverberation_time(r) for r in rooms]
    assert stated[1] == pytest.approx(longer * stated[0], rel=1e-12)
    off = np.array([0.8, 1.3, 1.1, 0.9, 1.2])
    one, other = (
        rt.calibrate(r, t, method, equation)
        for r, t in zip(rooms, (stated[0] * off, longer * stated[0] * off), strict=True)
    )
    if law == "nothing":  # the same bits
        assert one.alpha.tobytes() == other.alpha.tobytes()
        assert one.posterior_sigma.tobytes() == other.posterior_sigma.tobytes()
    np.testing.assert_allclose(other.alpha, one.alpha[order], rtol=0, atol=1e-8)
    sigma = one.posterior_sigma[order]
    np.testing.assert_allclose(other.posterior_sigma, sigma, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(other.plausibility.z, one.plausibility.z, rtol=0, atol=1e-6)
    np.testing.assert_allclose(other.plausibility.q, one.plausibility.q, rtol=1e-6)
    assert other.verdict.level == one.verdict.level


@pytest.mark.parametrize("kind", [{}, {"common_alpha_sigma": 0.15}])
@pytest.mark.parametrize("method", ["mle", "soft", "smooth"])
def test_a_material_in_two_parts_that_err_alike_is_one(method, kind):
    """The smoothness of the two parts counted twice."""
    whole = room(5, **kind)
    rows = [0, 1, 1, 2, 3]
    parts = whole.replace(
        materials=["carpet", "boards", "boards behind", "glass", "door"],
        areas=[34, 50, 30, 14, 6],
        alpha=whole.alpha[rows],
        sigma=whole.sigma[rows],
        material_correlation={("boards", "boards behind"): 1 - 1e-7},
    )
    t = rt.Eyring().reverberation_time(whole) * np.array([0.8, 1.3, 1.1, 0.9, 1.2])
    one, two = (rt.calibrate(r, t, method, rt.Eyring()) for r in (whole, parts))
    np.testing.assert_allclose(two.alpha, one.alpha[rows], rtol=0, atol=1e-5)
    np.testing.assert_allclose(two.posterior_sigma, one.posterior_sigma[rows], rtol=1e-3)


def test_where_a_held_coefficient_would_be_without_its_bound():
    """One surface, so that the unbounded estimate is (mu / sigma² + a / s²) / (1 / sigma² + 1 / s²)."""
    room = room_of({"wall": (94, 0.05, 0.04)}, [1000], 60, alpha_min=[[0.04]])
    t = rt.Eyring().time(room, 94 * np.array([0.01]))
    joint = rt.calibrate(room, t, method="soft").joint
    assert joint.active[0, 0] == -1
    measured, u = joint.target[0, 0] / 94, joint.numbers.target_uncertainty[0, 0] / 94
    precision = 1 / 0.04**2 + 1 / u**2
    wanted = (0.05 / 0.04**2 + measured / u**2) / precision
    assert wanted < 0.03
    assert joint.unbounded(joint.estimate_sigma)[0] == pytest.approx(wanted, abs=1e-9)


def test_another_room_of_a_problem_has_its_bands():
    room, measured = rt.datasets.bras_cr2()
    problem = rt.Calibration(rt.terms.PriorDeviation()).build(room)
    other = room.replace(centre_frequencies=[100, 200, 400, 800, 1600, 3150])
    with pytest.raises(DataError, match="other bands than the problem was built with"):
        problem.solve(measured, other)


def test_what_is_known_before_a_change_is_measured_where_t_was():
    room, measured = rt.datasets.bras_cr2()
    t = measured.reverberation_time.copy()
    t[1] = np.nan
    known = rt.calibrate(room, t).known
    assert known.measured.tolist() == [True, False, True, True, True, True]
