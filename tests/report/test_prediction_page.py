"""The page of predictions and designs: what it must say, and that it needs nothing else."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.prediction import Change, Target, Treatment, Variant, predict_variants
from rtcal.report import figures, pages

pytest.importorskip("matplotlib", reason="needs the extra report")
pytest.importorskip("jinja2", reason="needs the extra report")

EVIL = 'panel <b>"5 $x$"</b>'


@pytest.fixture(scope="module")
def result():
    return rt.calibrate(*rt.datasets.bras_cr2())


@pytest.fixture(scope="module")
def folder(result, tmp_path_factory):
    path = tmp_path_factory.mktemp("variants")
    variants = [
        Variant("window open", (Change(open="windows", area=2.0),)),
        Variant(EVIL, (Change(open="windows", area=4.0),)),
    ]
    predict_variants(result, variants).save(path)
    return path


@pytest.fixture(scope="module")
def designed(result, tmp_path_factory):
    """A design whose page compares it with designs of other probabilities."""
    panel = rt.Material("panel", [0.5, 0.6, 0.9, 0.9, 0.9, 0.9], [0.1] * 6)
    treatment = Treatment("panels", panel, 45, cost=90, covers="ceiling", unit=1.44)
    found = rt.design(result, [treatment], Target([np.nan] * 6, [1.15] * 6), 0.85)
    path = tmp_path_factory.mktemp("designed")
    found.save(path)
    return found, path, pages.page_of(path)


@pytest.mark.long
def test_a_designs_page_has_its_treatments_target_and_frontier(designed):
    found, folder, html = designed
    assert f"the cost is {found.cost:.0f}." in html
    assert f">{found.areas[0] / 1.44:.0f}</td>" in html
    assert (
        f"in the target in all bands at once with a probability of {found.probability_together:.2f}"
        in html
    )
    assert "Cost by probability, side by side" in html
    assert html == pages.page_of(folder)


def test_the_interval_is_drawn_where_it_is(result):
    variant = result.predict(Change(open="windows", area=2.0), name="open")
    low, high = variant.interval
    f = variant.after.centre_frequencies
    drawn = figures.predicted_times(
        f, variant.time_before, [("open", variant.mean, (low, high))], (0.5 * low, high)
    )
    (axes,) = drawn.axes
    (segments,) = [c for c in axes.collections if hasattr(c, "get_segments")]
    ends = np.array(segments.get_segments())[:, :, 1]
    assert ends[:, 0] == pytest.approx(low)
    assert ends[:, 1] == pytest.approx(high)
