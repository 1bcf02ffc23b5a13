"""The benchmarks that judge the finder: rates, calibration of probabilities, what counts as right."""

import pytest

from benchmarks.studies.means.judging import calibration_error
from benchmarks.studies.means.real_cases import RealCase
from benchmarks.studies.means.real_rooms import outcome
from benchmarks.studies.rates import share


def row(verdict, effect, **more):
    rest = {"family": None, "candidates": [effect], "probabilities": {}, "families": {}}
    return {"verdict": verdict, "effect": effect, **rest, **more}


def test_the_interval_of_a_share_is_clopper_s_and_pearson_s():
    # 0 of n: 1 - 0.025^(1/n); the other ends mirror it.
    assert share([False] * 30) == pytest.approx((0.0, 0.0, 1 - 0.025 ** (1 / 30), 30))
    assert share([True] * 30) == pytest.approx((1.0, 0.025 ** (1 / 30), 1.0, 30))
    # A printed table's.
    assert share([True, False] * 5) == pytest.approx((0.5, 0.187, 0.813, 10), abs=5e-4)


def test_calibration_error_is_the_mean_distance_over_the_bins():
    stated = [0.95] * 10 + [0.55] * 10
    right = [True] * 9 + [False] + [True] * 5 + [False] * 5
    error, bins = calibration_error(stated, right)
    assert error == pytest.approx(0.5 * 0.05 + 0.5 * 0.05)
    assert [(n, round(f, 2)) for n, _, f in bins] == [(10, 0.5), (10, 0.9)]
    assert calibration_error([1.0, 0.0], [True, False])[0] == 0  # 1.0 is in the last bin


@pytest.mark.parametrize(
    ("names", "said", "wanted"),
    [
        ({"none"}, row("none", None), "right"),
        ({"none"}, row("hint", "air"), "right"),
        ({"none"}, row("unknown", "unknown"), "missed"),
        ({"none"}, row("named", "air"), "wrong"),
        ({"air"}, row("named", "air"), "right"),
        ({"air"}, row("hint", "air"), "missed"),
        ({"air"}, row("ambiguous", "volume", candidates=["volume", "air"]), "right"),
        ({"air"}, row("ambiguous", "volume", candidates=["volume", "formula"]), "missed"),
        ({"air"}, row("named", "volume", candidates=["volume"]), "wrong"),
        ({"air", "coefficients"}, row("named", "coefficients"), "right"),
    ],
)
def test_what_counts_as_right(names, said, wanted):
    case = RealCase("x", "judging", "y", frozenset(names), lambda: None)
    assert outcome(case, said) == wanted
