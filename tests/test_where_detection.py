"""Whether something is other than stated: the positions decide."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder.claim import Detection
from rtcal.finder.effects import library
from rtcal.finder.positions.problem import (
    NOISE,
    POSITION,
    PositionsHypotheses,
    SpreadHypothesis,
    shifts,
)
from rtcal.finder.positions.search import (
    OF_PROGRAMS,
    THRESHOLD,
    Summary,
    evidence_of_means,
    of_means,
    scores,
    weights,
)
from rtcal.report.finding_words import evidence, record_of_positions
from tests.test_where import measured, stated, tracing
from tests.test_where_page import finding_of


@pytest.fixture(scope="module")
def case() -> rt.finder.PositionsCase:
    return rt.finder.PositionsCase(simulator=tracing(stated()), measured=measured(True))


def test_the_positions_decide() -> None:
    above, below = THRESHOLD + 0.1, THRESHOLD - 0.1
    assert Detection(above, THRESHOLD).verdict is None
    assert Detection(above, THRESHOLD, means=-1.0).verdict is None
    assert Detection(below, THRESHOLD, means=9.0).verdict == "hint"
    assert Detection(-0.1, THRESHOLD).verdict == "none"
    assert Detection(above, threshold=OF_PROGRAMS).verdict == "hint"


@pytest.mark.parametrize("ceiling", [0.2, 0.9])
def test_what_is_called_added_absorption_adds_some(ceiling: float) -> None:
    """A panel all over a ceiling of mineral wool lengthens T: it is no added absorption."""
    room = stated()
    alpha = np.array(room.alpha)
    alpha[-1] = ceiling
    simulator = tracing(room.replace(alpha=alpha))
    case = rt.finder.PositionsCase(simulator=simulator, measured=measured(True))
    tried = [s for s in shifts(case, library()) if s.family.startswith("added absorption")]
    for hypothesis in tried:
        changes = hypothesis.spectra - case.surface_alpha[hypothesis.surface]
        assert (changes.max(axis=1) > -changes.min(axis=1)).all()
    assert {s.surface for s in tried} == set(range(6))


def test_a_noisy_pair_is_a_hint() -> None:
    assert Detection(-5.0, THRESHOLD, noise=3.0).verdict == "hint"
    assert Detection(-5.0, THRESHOLD, noise=-3.0).verdict == "none"
    noisy = replace(finding_of({"wall 5": 1.0}), detection=Detection(-5.0, THRESHOLD, noise=3.0))
    assert "noisy value is the better explanation (odds of 20 to 1)" in evidence(noisy)
    sure = replace(noisy, detection=Detection(THRESHOLD + 1, THRESHOLD, noise=3.0))
    assert "noisy" not in evidence(sure)


def spread(effect: str) -> SpreadHypothesis:
    one = np.ones(1)
    return SpreadHypothesis(
        effect=effect,
        place="S1",
        sizes=one,
        unit="",
        odds=0.5 * one,
        rows=np.arange(1),
        columns=np.eye(1),
        scales=one,
    )


def scored(
    of_noise: float, of_position: float, of_shift: float, case: rt.finder.PositionsCase
) -> float:
    """The score where hypotheses have these log evidences, over that of nothing."""
    one = next(s for s in shifts(case, library()) if s.effect == "opening").some(slice(0, 1))
    every = PositionsHypotheses([one], [spread(NOISE), spread(POSITION)], off=0.0, unknown=False)
    evidence = np.array([0.0, -99.0, -99.0, of_noise, of_position, of_shift])
    return scores(weights(evidence, every, 1.0), every)[0]


def test_a_noisy_pair_is_no_evidence_that_the_room_is_other_than_stated(
    case: rt.finder.PositionsCase,
) -> None:
    assert scored(0, 0, 0, case) == pytest.approx(0, abs=1e-9)
    assert scored(20, 0, 0, case) < -10
    assert scored(-50, 20, 0, case) > 10
    assert scored(0, 0, 40, case) - 20 < scored(20, 0, 40, case) < scored(0, 0, 40, case) - 10


def test_the_means_have_the_pairs_and_the_geometry_of_the_case(
    case: rt.finder.PositionsCase,
) -> None:
    less = replace(case, exclude=[("S1", "R2")], match=("t20", "c80", "ts"))
    (configuration,) = of_means(less).configurations
    assert set(configuration.measured.values) == {"t20", "c80"}
    assert tuple(configuration.measured.pairs) == less.pairs
    kept = [case.measured.pairs.index(pair) for pair in less.pairs]
    np.testing.assert_array_equal(
        configuration.measured.uncertainty["t20"], case.measured.uncertainty["t20"][kept]
    )
    away = np.subtract(case.simulator.sources["S2"], case.simulator.receivers["R3"])
    assert configuration.distances is not None
    assert configuration.distances[less.pairs.index(("S2", "R3"))] == pytest.approx(
        np.linalg.norm(away)
    )
    along = dict(zip(case.room.materials, of_means(case).facing, strict=True))
    np.testing.assert_allclose(along["east wall"], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(along["floor wall"], [0, 0, 1], atol=1e-12)


def test_the_means_say_nothing_without_a_decay_time(
    case: rt.finder.PositionsCase,
) -> None:
    assert evidence_of_means(replace(case, match=("c80", "ts", "level"))) is None


@pytest.mark.parametrize("options", [{"without": ["air"]}, {"only": ["opening", "porous"]}])
def test_fewer_effects_are_asked_of_the_positions_alone(
    case: rt.finder.PositionsCase,
    options: dict[str, list[str]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The means know neither those effects nor their names."""
    module = sys.modules["rtcal.finder.positions.search"]
    monkeypatch.setattr(module, "evidence_of_means", lambda *_: pytest.fail("asked"))
    monkeypatch.setattr(module, "find_by_positions", lambda *arguments: arguments[-1])
    assert rt.find(case, **options) is None


@pytest.mark.long
def test_a_search_for_a_noisy_pair_alone_detects_nothing(
    case: rt.finder.PositionsCase, kept: Path
) -> None:
    finding = rt.find(case, only=["noise"], cache=kept)
    assert (finding.detected, finding.score) == (False, 0.0)
    assert finding.to_dict()["nats_of_noise"] == finding.detection.noise
    without = rt.find(case, without=["noise"], cache=kept)
    assert without.detection.noise is None


@pytest.mark.parametrize("effect", ["coefficients", "unknown"])
def test_a_candidate_without_a_size_has_none_in_words_and_in_json(
    case: rt.finder.PositionsCase, effect: str, kept: Path
) -> None:
    """A full search ended `to_json` in a ValueError where one was among the first twenty."""
    finding = rt.find(case, only=[effect], cache=kept)
    said = json.loads(finding.to_json())["candidates"]
    assert any(c["size"] is None for c in said)
    assert "nan" not in str(finding)


@pytest.mark.long
def test_the_record_is_that_of_what_was_measured(case: rt.finder.PositionsCase, kept: Path) -> None:
    """It was that of all that may be matched, with level, though none had been measured."""
    whole = measured(True)
    without = rt.Measurement(
        centre_frequencies=whole.centre_frequencies,
        values={name: v for name, v in whole.values.items() if name != "g"},
        pairs=whole.pairs,
    )
    lacking = rt.finder.PositionsCase(simulator=case.simulator, measured=without)
    assert "level" in lacking.match
    finding = rt.find(lacking, cache=kept)
    assert record_of_positions(case.room, finding.parameters) in " ".join(str(finding).split())
    assert "level" not in finding.parameters


def test_a_coupled_room_is_claimed_by_its_family_alone(
    case: rt.finder.PositionsCase, kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A box with scattering of 0.05, assumed to have 0.3, had been named a coupled room."""
    module = sys.modules["rtcal.finder.positions.search"]
    summary_of = module.summary_of

    def certain(*arguments: Any) -> Summary:
        told = summary_of(*arguments)
        probabilities = {"coupled room": 0.97, "none": 0.03}
        return replace(told, probabilities=probabilities, families={"field": 0.97, "none": 0.03})

    monkeypatch.setattr(module, "THRESHOLD", -np.inf)
    monkeypatch.setattr(module, "summary_of", certain)
    finding = rt.find(case, only=["coupled room"], cache=kept)
    assert (finding.verdict, finding.effect, finding.family) == ("family", None, "field")
    assert finding.surface is None
    assert "scatters less than assumed" in " ".join(map(str, finding.reasons))
