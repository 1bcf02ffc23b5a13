"""Laws of two states: exchanged, the same twice, twice as much, the climate alone, idle options."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder import StatesCase
from rtcal.report.pages import page as page_of_result
from tests.conftest import also, measurement_of
from tests.two_states import ALPHA, AREAS, BANDS, measured, room, times

Two = tuple[rt.Room, rt.Measurement, rt.Measurement]


def drawn(seed):
    """Return a room of its own size and coefficients, measured before and after a random change."""
    rng = np.random.default_rng(seed)
    volume, areas = float(rng.uniform(60, 900)), AREAS * rng.uniform(0.7, 2.0)
    one = np.clip(ALPHA * np.exp(0.4 * rng.standard_normal(ALPHA.shape)), 0.01, 0.6)
    other = np.clip(one * np.exp(0.25 * rng.standard_normal((3, 1))), 0.01, 0.9)
    airs = [rt.Air(20 + 2 * rng.standard_normal(), 50 + 10 * rng.standard_normal()) for _ in "ab"]
    pairs = int(rng.integers(2, 9))

    def t(alpha, air):
        absorbed = areas @ -np.log(1 - alpha) + 4 * air.attenuation(BANDS) * volume
        return np.asarray(24 * np.log(10) / 343.2 * volume / absorbed)

    states = [
        measured(t(alpha, air), 1000 * seed + j, pairs=pairs, uneven=0.02)
        for j, (alpha, air) in enumerate(zip((one, other), airs, strict=True))
    ]
    if seed % 3 == 0:  # means over positions
        states = [
            measurement_of(
                BANDS,
                u={"t20": 0.02 * m.values["t20"].mean(axis=0, keepdims=True)},
                t20=m.values["t20"].mean(axis=0, keepdims=True),
            )
            for m in states
        ]
    stated = room().replace(volume=volume, areas=areas, air=rt.Air() if seed % 2 else None)
    return stated, states[0], states[1]


def exchanged(table):
    """Return a table with "added" in the place of "removed", and the other way round."""
    other = {"added": "removed", "removed": "added"}
    return {" ".join(other.get(word, word) for word in k.split(" ")): v for k, v in table.items()}


def assert_mirrored(there, back):
    """Assert that two findings are of the same states in the two orders."""
    assert back.verdict == there.verdict
    assert back.score == pytest.approx(there.score, rel=1e-9)
    for name in ("probabilities", "families"):
        assert getattr(back, name) == pytest.approx(exchanged(getattr(there, name)), abs=1e-12)
    assert (there.family is None) == (back.family is None)
    if there.family is not None:
        assert exchanged({str(there.family): 0.0}) == {str(back.family): 0.0}
    np.testing.assert_allclose(back.change[[0, 2, 1]], -there.change, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(back.shift, -there.shift, rtol=1e-9, atol=1e-12)
    sizes = [
        (back.size.mean, back.size.high, back.size.low),
        (there.size.mean, there.size.low, there.size.high),
    ]
    np.testing.assert_allclose(sizes[0], -np.array(sizes[1]), rtol=1e-9, atol=1e-12)
    assert back.climate == pytest.approx(there.climate, abs=1e-12)


def both_ways(two):
    stated, before, after = two
    return rt.find(stated, after, before=before), rt.find(stated, before, before=after)


def the_same_twice():
    """Return a state given twice: its answer is its own mirror image."""
    state = measured(times(), 1)
    return room(), state, state


def panels():
    return room(), measured(times(), 1), measured(times(12), 2, uneven=0.03)


@pytest.mark.parametrize(
    "two", [the_same_twice, panels, *also(*(partial(drawn, i) for i in range(6)))]
)
def test_exchanged_states_mirror_the_answer(two):
    there, back = both_ways(two())
    assert_mirrored(there, back)
    if there.can_be_verified:
        one, other = rt.finder.verify(there), rt.finder.verify(back)
        assert one.verdict == other.verdict
        # The gaps are in steps of 1 JND each of ln T, which is mirrored.
        np.testing.assert_allclose(other.gaps, -one.gaps, rtol=1e-6, atol=1e-9)


@pytest.mark.long
def test_the_same_state_twice_is_no_change():
    """One file given twice, of one to fewer digits, and of one that was measured again."""
    once = measured(times(), 1)
    rounded = replace(once, values={"t20": once.values["t20"].round(2)})
    rng = np.random.default_rng(3)
    again = replace(
        once, values={"t20": once.values["t20"] * (1 + 0.003 * rng.standard_normal((6, 6)))}
    )
    for other in (once, rounded, again):
        for finding in (rt.find(room(), other, before=once), rt.find(room(), once, before=other)):
            assert finding.verdict == "none"
            assert finding.family is None
            assert finding.probabilities["none"] > 0.9
            assert not finding.can_be_added


@pytest.mark.long
def test_the_order_of_pairs_and_of_effects_changes_nothing():
    before, after = measured(times(), 1), measured(times(8), 2)
    there = rt.find(room(), after, before=before)
    order = list(before.pairs)[::-1]
    other = rt.find(room(), after.select(order), before=before)
    assert other.probabilities == pytest.approx(dict(there.probabilities), abs=1e-9)
    np.testing.assert_allclose(other.change, there.change, rtol=1e-6)
    effects = list(reversed(rt.finder.library()))
    turned = rt.find(room(), after, before=before, effects=effects)
    assert turned.probabilities == pytest.approx(dict(there.probabilities), abs=1e-9)
    np.testing.assert_allclose(turned.change, there.change, rtol=1e-6)


@pytest.mark.long
def test_an_option_without_effect_is_refused():
    stated, before, after = drawn(1)
    two = {"room": stated, "before": before, "after": after}
    dry = rt.find(stated, after, before=before, without=["air"])
    assert "air" not in dry.probabilities
    assert dry.climate == 0
    for options in ({"without": ["volume"]}, {"without": ["coefficients"]}, {"only": ["formula"]}):
        with pytest.raises(rt.errors.DataError, match=r"which is not an effect"):
            rt.find(stated, after, before=before, **options)
    unused = {"cache": "folder", "progress": print, "prior": {}, "most": 2, "scheduler": "x"}
    for name, value in unused.items():
        with pytest.raises(rt.errors.DataError, match=f"{name} cannot be used in a search"):
            rt.find(stated, after, before=before, **{name: value})
    volume = [e for e in rt.finder.library() if e.name == "volume"]
    with pytest.raises(rt.errors.DataError, match="none of the effects adds absorption"):
        rt.find(stated, after, before=before, effects=volume)
    with pytest.raises(rt.errors.DataError, match="but the room has no air"):
        StatesCase(**{**two, "room": stated.replace(air=None)}, climate_uncertainty=(1, 5))


def test_a_climate_alone_has_numbers_and_a_page_without_nan(tmp_path):
    pytest.importorskip("jinja2")
    pytest.importorskip("matplotlib")
    two = [measured(times(air=rt.Air(20, h)), j, pairs=30) for j, h in enumerate((50, 28), 3)]
    found = rt.find(room(), two[1], before=two[0], only=["air"], without=["unknown"])
    assert found.family == "climate"
    assert rt.finder.verify(found).verdict == "supported"
    json.dumps(found.to_dict(), allow_nan=False)
    assert str(rt.load(found.save(tmp_path))) == str(found)
    page = page_of_result(found)
    assert "The climate of the air changed, and nothing else" in page
    assert "nan" not in page.split("<img")[0].lower()
