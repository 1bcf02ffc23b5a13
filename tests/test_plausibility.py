"""z and Q of the real calibration: correlations, shared materials, configurations, every method."""

import numpy as np
import pytest
from scipy import stats

import rtcal as rt
from rtcal import terms
from rtcal.calibration.methods import METHODS
from rtcal.calibration.unknowns import Configurations
from tests.conftest import room_of


def three(**changes):
    materials = {
        "a": (80, [0.1, 0.12, 0.15], [0.02, 0.03, 0.03]),
        "b": (50, [0.3, 0.35, 0.4], [0.05, 0.06, 0.05]),
        "c": (30, 0.2, [0.03, 0.02, 0.04]),
    }
    return room_of(materials, [500, 1000, 2000], 120, **{"air": rt.Air(), **changes})


BETWEEN = np.array([[1, 0.5, 0], [0.5, 1, 0], [0, 0, 1.0]])
BY_BAND = 0.7 ** np.abs(np.subtract.outer(np.arange(3), np.arange(3)))
TIMES = np.array([0.45, 0.5, 0.4])


def by_hand(room, between, by_band):
    """z, Q and p from the covariance of b - S'mu written out over every pair of coefficients."""
    n, k = room.alpha.shape
    covariance = np.zeros((k, k))
    for i, j in np.ndindex(n, n):
        for p, q in np.ndindex(k, k):
            covariance[p, q] += (
                room.areas[i]
                * room.areas[j]
                * room.sigma[i, p]
                * room.sigma[j, q]
                * between[i, j]
                * by_band[p, q]
            )
    miss = rt.Eyring().absorption_area(room, TIMES) - room.absorption_area
    q = float(miss @ np.linalg.solve(covariance, miss))
    return miss / np.sqrt(np.diag(covariance)), q, float(stats.chi2.sf(q, k))


def test_correlations_enter_z_and_q_wherever_they_were_stated():
    z, q, p = by_hand(three(), BETWEEN, BY_BAND)
    _, q_independent, _ = by_hand(three(), np.eye(3), np.eye(3))
    assert abs(q / q_independent - 1) > 0.1
    stated = three(band_correlation=0.7, material_correlation={("a", "b"): 0.5})
    prior = terms.PriorDeviation(band_correlation=0.7, material_correlation={("a", "b"): 0.5})
    composed = rt.Calibration(prior, [terms.ExactMatch()])
    for result in (
        rt.calibrate(stated, TIMES),
        rt.calibrate(stated, TIMES, method="lse"),
        composed.build(three()).solve(TIMES),
    ):
        found = result.plausibility
        np.testing.assert_allclose(found.z, z, rtol=1e-9)
        assert found.q == pytest.approx(q, rel=1e-9)
        assert not result.active.any()
        assert found.p_value == pytest.approx(p, rel=1e-9)


def test_materials_that_share_their_coefficients_err_together():
    """One unknown of 130 m²: (S_a + S_b)² sigma², not S_a² sigma² + S_b² sigma²."""
    room = three()
    alpha, sigma = room.alpha.copy(), room.sigma.copy()
    alpha[1], sigma[1] = alpha[0], sigma[0]
    room = room.replace(alpha=alpha, sigma=sigma)
    composed = rt.Calibration(terms.PriorDeviation(), [terms.ExactMatch(), terms.Shared("a", "b")])
    t = rt.Eyring().reverberation_time(room) * 1.05
    result = composed.build(room).solve(t)
    spread = np.sqrt(130**2 * sigma[0] ** 2 + 30**2 * sigma[2] ** 2)
    miss = result.target - room.absorption_area
    np.testing.assert_allclose(result.plausibility.z, miss / spread, rtol=1e-9)
    assert np.all(result.plausibility.z < -0.1)


def test_each_configuration_has_its_own_z():
    rooms = [three(), three(areas=[80, 20, 60], name="other")]
    times = [TIMES, np.array([0.7, np.nan, 0.8])]
    both = rt.calibrate(Configurations(rooms), times, method="joint")
    for room, t, result in zip(rooms, times, both.results, strict=True):
        alone = rt.calibrate(room, t, method="soft")
        np.testing.assert_allclose(result.plausibility.z, alone.plausibility.z, rtol=1e-9)
        assert result.plausibility.q == pytest.approx(alone.plausibility.q, rel=1e-9)
    assert both.results[1].plausibility.degrees_of_freedom == 2


def test_configurations_state_one_correlation():
    stated = three(band_correlation=0.7, material_correlation={("a", "b"): 0.5})
    other = stated.replace(name="other", material_correlation={("b", "a"): 0.5})
    both = Configurations([stated, other])
    assert both.union.band_correlation == 0.7
    assert both.union.material_correlation == {("a", "b"): 0.5}
    with pytest.raises(rt.errors.DataError, match=r"band_correlation = 0\.1"):
        Configurations([stated, other.replace(band_correlation=0.1)])
    with pytest.raises(rt.errors.DataError, match=r'material_correlation\["a", "b"\] = 0\.2'):
        Configurations([stated, other.replace(material_correlation={("a", "b"): 0.2})])
    with pytest.raises(rt.errors.DataError, match=r'material_correlation\["a", "b"\] = 0,'):
        Configurations([stated, other.replace(material_correlation={})])


@pytest.mark.parametrize("method", METHODS)
def test_a_missing_band_keeps_its_prior_in_every_method(method):
    room = three()
    t = np.array([0.45, np.nan, 0.4])
    result = rt.calibrate(room, t, method=method)
    moved = np.abs(result.shift).max(axis=0)
    assert moved[0] > 1e-3
    if method != "smooth":  # which is asked to carry the shift over
        np.testing.assert_allclose(result.alpha[:, 1], room.alpha[:, 1], atol=1e-12)
    assert np.isnan(result.plausibility.z[1])
    assert result.plausibility.degrees_of_freedom == 2
    marks = {(m.kind, m.frequency) for m in result.trust_marks}
    assert ("missing", 1000.0) in marks


def test_any_configuration_without_air_warns():
    rooms = Configurations([three(air=None), three(air=None, name="no climate")])
    with pytest.warns(rt.errors.MissingAirWarning, match="has no air") as said:
        rt.calibrate(rooms, [TIMES, 1.01 * np.asarray(TIMES)], method="joint")
    assert said[0].filename == __file__
