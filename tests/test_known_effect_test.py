"""The bound of what any finder could name: a test that is told the effect."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from benchmarks.studies.means.known_effect_test import best_powers, drawn_ratios
from benchmarks.studies.means.second_world import WORLDS, true_effect, truth_of
from rtcal.finder import library


@pytest.mark.parametrize("far", [0.5, 2.0, 4.0])
def test_of_one_normal_case_the_power_is_neyman_s_and_pearson_s(far: float) -> None:
    (power,), limit = best_powers([far], [12], 0.05, np.inf)
    assert power == pytest.approx(norm.cdf(far - norm.ppf(0.95)), abs=0.03)
    assert limit == pytest.approx(far * norm.ppf(0.95) - far**2 / 2, abs=0.1 * far)


@pytest.mark.parametrize("degrees", [5.0, np.inf])
def test_the_mean_likelihood_ratio_in_rooms_without_the_effect_is_1(degrees: float) -> None:
    ratios = -drawn_ratios(0.8, 6, degrees)
    assert np.exp(ratios).mean() == pytest.approx(1.0, abs=0.05)


def test_every_hidden_effect_of_every_world_has_its_true_parameters() -> None:
    effects = {e.name: e for e in library()}
    seen = set()
    for world, made in WORLDS.items():
        for truth in made.read(1 if world == 3 else 0, "truth"):
            known = truth_of(world, truth)
            if known is None or known[0] & {"none", "unknown", "coefficients"}:
                continue
            hidden = true_effect(world, truth)
            assert known[0] == {hidden.name}
            assert effects[hidden.name].size in hidden.parameters
            seen.add(hidden.name)
    assert seen == set(effects) - {"covered surface", "direct sound"}
