"""The knowledge before measuring: the truncated normal, sigma rules, correlation, catalogue."""

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import rtcal as rt
from rtcal.acoustics.bands import third_octaves
from rtcal.acoustics.priors import TIERS, SigmaRule, sigma_iso_12999_2
from rtcal.support.normal import FINE, truncated_moments, truncated_normal
from tests.conftest import room_of


def moments(mu, sigma):
    """Mean and variance of the normal distribution cut to 0 to 1."""
    return truncated_moments(np.asarray(mu, float), np.square(sigma), 0.0, 1.0, FINE)


def sample(mu, sigma, seed):
    ends = (np.full(20_000, (end - mu) / sigma) for end in (0.0, 1.0))
    drawn = truncated_normal(*ends, np.random.default_rng(seed).random(20_000))
    return np.clip(mu + sigma * drawn, 0, 1)


sigmas = st.floats(np.log(1e-6), np.log(10)).map(np.exp)


@given(mu=st.floats(0, 1), sigma=sigmas)
def test_against_scipy(mu, sigma):
    mean, variance = moments(mu, sigma)
    scipys = stats.truncnorm(-mu / sigma, (1 - mu) / sigma, mu, sigma)
    assert mean == pytest.approx(scipys.mean(), rel=1e-10)
    assert variance == pytest.approx(scipys.var(), rel=1e-9 if sigma > 1 else 1e-10)


@given(mu=st.one_of(st.floats(-3, 0), st.floats(1, 4)), sigma=sigmas)
def test_the_tails_against_sixty_digits(mu, sigma):
    """With mu at and beyond the box scipy's own variance loses its digits; mpmath's does not."""
    with mpmath.workdps(60 + int(20 * np.log10(max(1 / sigma, 1)))):
        m, s = mpmath.mpf(mu), mpmath.mpf(sigma)
        a, b = -m / s, (1 - m) / s
        if a < 0:  # mirror, so that both tails are upper ones
            a, b = -b, -a
        mass = (mpmath.erfc(a / mpmath.sqrt(2)) - mpmath.erfc(b / mpmath.sqrt(2))) / 2
        low, high = mpmath.npdf(a) / mass, mpmath.npdf(b) / mass
        first = low - high
        mean = s * first  # from mu towards the box
        variance = s**2 * (1 + a * low - b * high - first**2)
        end = 0.0 if mu <= 0 else 1.0
        distance = float(mean - abs(m - end))  # of the mean from the nearer end
        expected = float(variance)
    found, spread = moments(mu, sigma)
    assert abs(found - end) == pytest.approx(distance, rel=1e-10, abs=1e-15)
    assert spread == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(
    ("mu", "sigma"), [(0.3, 0.1), (0.02, 0.05), (-0.4, 0.05), (1.3, 0.04), (0.5, 8)]
)
def test_samples_have_the_distribution(mu, sigma):
    drawn = sample(mu, sigma, 1)
    assert drawn.min() >= 0
    assert drawn.max() <= 1
    known = stats.truncnorm(-mu / sigma, (1 - mu) / sigma, mu, sigma)
    assert stats.kstest(drawn, known.cdf).pvalue > 0.01


def test_iso_12999_2():
    """sigma_R = m alpha + n where m or n change; its Table 4 prints U = 2 sigma_R to two digits."""
    thirds = third_octaves(63, 5000)
    found = dict(zip(thirds, sigma_iso_12999_2(np.full(20, 0.5), thirds), strict=True))
    by_hand = {63: 0.24, 125: 0.105, 500: 0.04, 1000: 0.035, 2000: 0.0385, 4000: 0.055, 5000: 0.073}
    for band, sigma in by_hand.items():
        assert found[band] == pytest.approx(sigma, rel=1e-12)
    octave = sigma_iso_12999_2(np.array([0.5, 0.5]), [500, 1000])
    np.testing.assert_allclose(octave, [(0.06 + 0.05 + 0.045) / 6 + 0.015, 0.02 + 0.046 / 3])
    with pytest.raises(rt.errors.DataError, match="no uncertainty at 8000 Hz"):
        sigma_iso_12999_2(np.array([0.5, 0.5]), [4000, 8000])


TABLE_4 = """\
0.33 0.35 0.39 0.38 0.37 0.36 0.36 0.36 0.43 0.49 0.58 0.63 0.68 0.71 0.73 0.75 0.77 0.79 0.81 0.81
0.33 0.26 0.22 0.17 0.13 0.11 0.09 0.08 0.08 0.08 0.08 0.08 0.08 0.09 0.09 0.09 0.10 0.11 0.13 0.16
"""


def test_iso_12999_2_worked_example():
    """Its Table 4: alpha_s and U = 2 sigma_R, printed to two digits (as quoted by phonometry)."""
    alpha, printed = np.loadtxt(TABLE_4.splitlines())
    sigma = sigma_iso_12999_2(alpha, third_octaves(63, 5000))
    np.testing.assert_allclose(2 * sigma, printed, atol=0.0051)


def test_sigma_rules():
    rule = SigmaRule(relative=0.3, minimum=0.01, in_situ_factor=1.5)
    np.testing.assert_allclose(rule.sigma([0.01, 0.4], [500, 1000]), [0.015, 0.18])
    assert list(TIERS.values()) == [0.01, 0.05, 0.1]
    for bad in ({"relative": -1}, {"in_situ_factor": 0.5}):
        with pytest.raises(rt.errors.DataError, match=next(iter(bad))):
            SigmaRule(**bad)


def test_correlations_reach_the_calibration():
    """Not separable sigma, one band without T: the correlated prior carries a shift over to it."""
    room = room_of(
        {"a": (80, 0.1, 0.05), "b": (30, [0.3, 0.4], 0.1)}, [500, 1000], 100, air=rt.Air()
    )
    t = [0.5, np.nan]
    alone = rt.calibrate(room, t)
    together = rt.calibrate(room.replace(band_correlation=0.8), t)
    assert np.all(alone.shift[:, 1] == 0)
    np.testing.assert_allclose(together.shift[:, 1], 0.8 * together.shift[:, 0], rtol=1e-9)
    with pytest.raises(rt.errors.ModelError, match='"robust" treats every coefficient on its own'):
        rt.calibrate(room.replace(band_correlation=0.8), [0.5, 0.5], method="robust")


def test_the_catalogue():
    pytest.importorskip("pyroomacoustics")
    from rtcal.datasets import catalogue

    names = catalogue.names()
    assert len(names) > 70
    found = catalogue.material("hard_surface", [125, 250, 500, 1000, 2000, 4000])
    assert found.alpha == [0.02, 0.02, 0.03, 0.03, 0.04, 0.05]
    assert min(found.sigma) >= 1.5 * 0.015
    assert "pyroomacoustics" in found.source
    assert "Vorländer" in found.source
    with pytest.raises(rt.errors.DataError, match='"hard_stone" is not in the catalogue'):
        catalogue.material("hard_stone", [500])
    with pytest.raises(rt.errors.DataError, match="has no value at 63 Hz"):
        catalogue.material("hard_surface", [63, 125])


def test_no_entry_of_the_catalogue_hides_that_it_is_perforated():
    """A law: who takes an entry by its name sees that it has holes, or is an absorber."""
    pytest.importorskip("pyroomacoustics")
    from rtcal.datasets import catalogue

    holes = {name for name, said in catalogue.names().items() if "perfora" in said.lower()}
    assert "gypsum_board_perforated" in holes
    assert all("perforated" in name or "absorber" in name for name in holes)
    listed = catalogue.material_list()
    assert [*listed.names] == [*catalogue.names()]
