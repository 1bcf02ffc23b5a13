"""The reference of a relative level says nothing, and changes no result."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder import library
from rtcal.finder.means.problem import observe, predict_hypotheses
from rtcal.finder.means.search import _off_levels
from rtcal.loop import measured_pairs
from tests.test_where import MATCH, measured, stated, tracing

OFFSET = 100.0
"""dB. With 30 dB an empty room was a coupled room with 452 nats, with 40 dB a LinAlgError."""


def referred(measurement):
    """Return the measurement with another reference for each source and band."""
    rng = np.random.default_rng(6)
    each = {
        source: OFFSET + 3 * rng.standard_normal(measurement.values["level"].shape[1])
        for source in dict.fromkeys(s for s, _ in measurement.pairs)
    }
    rows = zip(measurement.pairs, measurement.values["level"], strict=True)
    level = np.array([row + each[s] for (s, _), row in rows])
    return replace(measurement, values={**measurement.values, "level": level})


def relative(hidden):
    """Return levels, of which one is missing."""
    made = measured(hidden, "level")
    level = made.values["level"].copy()
    level[1, 0] = np.nan
    return replace(made, values={**made.values, "level": level})


def simulator():
    return tracing(stated(), n_paths=800)


@pytest.mark.long
@pytest.mark.parametrize("hidden", [False, True])
def test_no_reference_changes_a_finding(hidden, kept):
    case = rt.finder.PositionsCase(simulator=simulator(), measured=relative(hidden))
    found = rt.find(case, cache=kept)
    other = rt.find(replace(case, measured=referred(case.measured)), cache=kept)
    assert other.verdict == found.verdict
    assert other.detection.score == pytest.approx(found.detection.score, abs=1e-6)
    assert other.surfaces == pytest.approx(found.surfaces, abs=1e-6)
    assert other.probabilities == pytest.approx(found.probabilities, abs=1e-6)
    assert [c.title for c in other.candidates] == [c.title for c in found.candidates]
    sizes = [[(c.low, c.size, c.high) for c in f.candidates] for f in (found, other)]
    assert np.array(sizes[1]) == pytest.approx(np.array(sizes[0]), rel=1e-6, nan_ok=True)
    np.testing.assert_allclose(other.map, found.map, atol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("off", [-3.0, -2.0, 2.0, 3.0])
def test_a_gain_that_is_off_names_nothing(off, kept):
    made = measured(False, "g")
    values = {**made.values, "g": made.values["g"] + off}
    case = rt.finder.PositionsCase(simulator=simulator(), measured=replace(made, values=values))
    found = rt.find(case, cache=kept)
    assert found.verdict == "none"
    assert found.probabilities["volume"] < 0.2


@pytest.mark.long
def test_no_reference_changes_a_calibration_to_every_position(kept, monkeypatch):
    monkeypatch.setattr(measured_pairs, "RUNS", 6)
    room, heard = stated(), relative(True)
    first, other = (
        rt.calibrate_positions(simulator(), room, measured, match=MATCH, cache=kept)
        for measured in (heard, referred(heard))
    )
    assert other.measured.fingerprints == first.measured.fingerprints
    np.testing.assert_allclose(other.unexplained, first.unexplained, atol=1e-4)
    np.testing.assert_allclose(other.alpha, first.alpha, atol=1e-6)
    np.testing.assert_allclose(other.sigma, first.sigma, atol=1e-6)
    np.testing.assert_allclose(other.gap_before, first.gap_before, atol=1e-6)
    np.testing.assert_allclose(other.gap_after, first.gap_after, atol=1e-6)
    np.testing.assert_allclose(other.misfit, first.misfit, rtol=1e-6)
    np.testing.assert_allclose(other.predicted.values, first.predicted.values, atol=1e-6)


# A level that is off alike in all bands is told first; one that is tilted is not


def problem(case):
    """Return what the notes ask of a problem of means."""
    observed, predicted = observe(case)[0], predict_hypotheses(case, library())
    return SimpleNamespace(case=case, observed=observed, predicted=predicted)


def notes(off, slope=0.0):
    """Return the notes of the shipped room with G off and tilted over the bands."""
    case, _ = rt.datasets.hidden_room()
    configurations = []
    for each in case.configurations:
        values = dict(each.measured.values)
        tilt = slope * np.linspace(-1, 1, np.shape(values["g"])[-1])
        values["g"] = np.asarray(values["g"]) + off + tilt
        configurations.append(replace(each, measured=replace(each.measured, values=values)))
    case = replace(case, configurations=tuple(configurations))
    return _off_levels(problem(case))


@pytest.mark.parametrize("off", [-30, -5, 5, 20])
def test_a_level_that_is_off_is_said(off):
    said = notes(off)
    assert len(said) == 2
    for note in said:
        assert note.values["side"] == ("above" if off > 0 else "below")
        assert note.values["by"] == pytest.approx(abs(off), abs=0.5)


def test_what_a_room_may_do_is_not_said():
    assert notes(0) == []
    assert notes(5, slope=6) == []


def test_a_level_that_fits_the_stated_room_is_not_said():
    case, _ = rt.datasets.hidden_room("identified")
    assert _off_levels(problem(case)) == []
