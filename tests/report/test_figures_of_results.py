"""Figures: what is drawn is what was calibrated."""

import re

import numpy as np
import pytest
from scipy import stats

import rtcal as rt
from rtcal.report import figures, of_calibration
from rtcal.report.document import tables
from rtcal.support.errors import DataError


def line(axes, label):
    return next(x for x in axes.get_lines() if x.get_label() == label)


def test_axes_have_units(result, loop):
    every = [
        figures.reverberation_time(result),
        figures.gap(result),
        figures.coefficients(result),
        figures.path(loop),
    ]
    for figure in every:
        for axes in (a for a in figure.axes if a.get_visible()):
            assert re.search(r"/ Hz|Simulation number|^α of .* m²$", axes.get_xlabel())
            assert re.search(r"/ (s|JND|%)$|^α", axes.get_ylabel())


def test_gap_and_reverberation_time(result):
    bars = figures.gap(result).axes[0].containers[0]
    assert [b.get_height() for b in bars] == pytest.approx(result.gap_before.tolist())
    axes = figures.reverberation_time(result).axes[0]
    assert line(axes, "model before calibration").get_ydata() == pytest.approx(
        result.reverberation_time_before
    )
    assert line(axes, "model after calibration").get_ydata() == pytest.approx(result.measured)


def test_coefficients_and_their_intervals(result):
    axes = figures.coefficients(result).axes
    assert len([a for a in axes if a.get_visible()]) == 5
    for i, panel in enumerate(axes[:5]):
        prior, after = (c.lines[0].get_ydata() for c in panel.containers)
        assert prior == pytest.approx(result.prior.alpha[i])
        assert after == pytest.approx(result.alpha[i])
        bars = np.array(panel.containers[1].lines[2][0].get_segments())
        low, high = bars[:, 0, 1], bars[:, 1, 1]
        assert low == pytest.approx(result.interval[0][i])
        assert high == pytest.approx(result.interval[1][i])
        assert (low < result.alpha[i]).all()


def test_intervals_without_an_exact_posterior_are_the_linear_estimates():
    found = rt.calibrate(*rt.datasets.bras_cr2(), method="lse")
    alpha, sigma = found.alpha, found.posterior_sigma
    cut = stats.truncnorm(-alpha / sigma, (1 - alpha) / sigma, alpha, sigma)
    assert not found.active.any()
    for end, p in zip(found.interval, (0.05, 0.95), strict=True):
        np.testing.assert_allclose((end - cut.ppf(p)) / sigma, 0, atol=5e-3)


def test_shares_add_up_and_are_the_areas(result):
    shares = next(t for t in tables(of_calibration.page(result).blocks) if "Share of" in t.title)
    parts = {row.name: row.values for row in shares.rows}
    np.testing.assert_array_equal(sum(parts.values()), 100)
    np.testing.assert_allclose(parts["air"], 100 * result.air_share, atol=1)
    area = result.prior.areas[:, np.newaxis] * result.alpha
    walls = 100 * (1 - result.air_share) * area / area.sum(axis=0)
    np.testing.assert_allclose(parts["windows"], walls[2], atol=1)
    np.testing.assert_allclose(parts["floor"], walls[3], atol=1)


def test_the_papers_plane():
    """Fig. 3b: mu (0.6, 0.5), sigma (0.05, 0.1) gives (0.54, 0.26); the truth is (0.6, 0.2)."""
    mu, sigma, areas = np.array([0.6, 0.5]), np.array([0.05, 0.1]), np.array([47.0, 47.0])
    alpha = rt.exact.maximum_likelihood(mu[:, None], sigma[:, None], areas, [47 * 0.8])[:, 0]
    assert alpha == pytest.approx([0.54, 0.26], abs=1e-9)
    axes = figures.plane(mu, sigma, areas, 47 * 0.8, alpha, truth=[0.6, 0.2]).axes[0]
    assert [v[0] for v in line(axes, "true").get_data()] == [0.6, 0.2]


def test_the_loops_path(loop):
    left, right = figures.path(loop).axes
    assert line(left, "first simulation").get_ydata() == pytest.approx(loop.steps[0].simulated)
    assert len(loop.steps) >= 2
    drawn = line(right, "125 Hz").get_ydata()
    assert drawn[loop.best[0]] == pytest.approx(loop.gap[0])
    assert abs(drawn[0]) > abs(drawn[loop.best[0]])
    begun = rt.loop.start(*rt.datasets.bras_cr2())
    with pytest.raises(DataError, match="no simulation yet"):
        figures.path(begun)


def test_the_same_figure_has_the_same_bytes(result):
    first, second = (figures.rendered(figures.gap(result), "svg") for _ in range(2))
    assert first == second
    assert len(first) > 5000
