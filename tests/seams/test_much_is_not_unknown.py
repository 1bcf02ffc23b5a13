"""Laws of "unknown" at positions, and of halves that found another thing than all pairs."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from benchmarks.studies.geometric_world.load import IN_SITU, load, truth
from rtcal.finder import PositionsCase, library
from rtcal.finder.claim import CLAIMED, Candidate
from rtcal.finder.evidence import NONE, UNKNOWN
from rtcal.finder.finding import Finding
from rtcal.finder.positions.problem import PositionsHypotheses, PositionsProblem, shifts
from rtcal.finder.positions.search import (
    TOLD_TEMPER,
    Summary,
    controls_of,
    evaluate,
    every_hypothesis,
    scores,
    summary_of,
    weights,
)
from rtcal.finder.positions.weighing import responses_of
from rtcal.report.finding_words import headline
from tests.conftest import also
from tests.test_where import MATCH, measured, stated, tracing
from tests.test_where_page import finding_of

LARGER = 9.0
"""Variance of the simulator's error that is added, over the one that a search assumes."""
Searched = tuple[PositionsCase, PositionsProblem, PositionsHypotheses]


@pytest.fixture(scope="module")
def searched(kept):
    """Return the numbers of a search in a room for development that hides an opening on face 3."""
    room, hidden = load(0, 0, IN_SITU), truth(0, 0)
    assert (hidden["kind"], hidden["surface"]) == ("opening", 2)
    case = PositionsCase(
        simulator=room.simulator(n_paths=2400), measured=room.without_level(), match=MATCH[:-1]
    )
    return numbers_of(case, kept)


@pytest.fixture(scope="module")
def in_a_box(kept):
    case = PositionsCase(simulator=tracing(stated()), measured=measured(True), match=MATCH)
    return numbers_of(case, kept)


def numbers_of(case: PositionsCase, kept: Path) -> Searched:
    numbers = PositionsProblem(case, responses_of(case, 0, kept), controls_of(case, cache=kept))
    return case, numbers, every_hypothesis(case, numbers, library())


def told(of: Searched, seed: int, hidden: bool, larger: float = LARGER) -> tuple[Summary, float]:
    """Return what a search tells, and its score, where the simulator errs by more than is assumed."""
    case, numbers, every = of
    error = LARGER * numbers.simulator_error
    drawn = np.random.default_rng(seed).multivariate_normal(
        np.zeros(len(error)), error, method="eigh"
    )
    residual = numbers.residual + drawn if hidden else drawn
    evidence = evaluate(numbers.likelihoods(), every, np.where(numbers.used, residual, 0.0))
    said = summary_of(case, every, weights(evidence, every, TOLD_TEMPER))
    return said, scores(weights(evidence, every), every)[0]


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
def test_what_a_surface_explains_is_not_unknown_where_errors_are_larger(searched, seed):
    said, score = told(searched, seed, hidden=True)
    assert score > 10
    assert said.probabilities[UNKNOWN] < 0.15
    assert said.unexplained > 0.9
    assert said.on_surfaces > 0.8
    assert next(iter(said.surfaces)) == "face 3"
    assert next(iter(said.probabilities)) == "opening"


@pytest.mark.long
@pytest.mark.parametrize("room", ["in_a_box", *also("searched")])
@pytest.mark.parametrize("seed", [0, 1])
def test_larger_errors_alone_claim_nothing(seed, room, request):
    said, _ = told(request.getfixturevalue(room), seed, hidden=False)
    assert said.unexplained > (0.5 if room == "searched" else 0.1)
    assert max(p for n, p in said.families.items() if n not in (NONE, UNKNOWN)) < CLAIMED
    assert max(said.surfaces.values()) * said.on_surfaces < CLAIMED


def test_what_no_effect_explains_is_as_probable_alone_as_beside_one():
    """Whatever is tried: one effect or a hundred."""
    case = PositionsCase(simulator=tracing(stated()), measured=measured(True))
    every = shifts(case, library())
    for some in (every, every[: len(every) // 2]):
        hypotheses = PositionsHypotheses(some, [], off=0.0)
        evidence = np.full(len(hypotheses.log_prior), -60.0)
        evidence[2] = 0.0
        for beside in hypotheses.of_groups(evidence)[2]:
            beside[:] = 0.0
        told = summary_of(case, hypotheses, weights(evidence, hypotheses))
        assert told.probabilities[UNKNOWN] == pytest.approx(0.5, abs=1e-6)
        assert told.unexplained == pytest.approx(1.0, abs=1e-6)


def unknown(shares: dict[str, float], families: Sequence[str] = ("added absorption",)) -> Finding:
    """Return a finding that is "unknown" with 0.6, and the rest on some surfaces."""
    finding = finding_of(shares)
    alone = Candidate(effect=UNKNOWN, family=UNKNOWN, probability=0.6)
    known = [
        replace(c, probability=0.4 * c.probability, family=families[i % len(families)])
        for i, c in enumerate(finding.candidates)
    ]
    return replace(
        finding,
        verdict="unknown",
        named=(),
        family=None,
        candidates=(alone, *known),
        probabilities={UNKNOWN: 0.6, "porous": 0.36, "none": 0.04},
        unexplained=0.7,
    )


def test_what_holds_most_of_the_rest_is_said_and_applied():
    found = unknown({"wall 5": 0.8, "wall 0": 0.2})
    assert "added absorption explains most (over 99 % of the rest)" in " ".join(headline(found))
    assert found.can_be_added
    made = found.apply()
    assert made.added.surface == "wall 5"
    assert "effect not in the library (60 %)" in made.support
    torn = unknown({"wall 5": 0.34, "wall 0": 0.33, "ceiling": 0.33}, ["field", "scale", "climate"])
    assert not torn.can_be_added
    with pytest.raises(rt.errors.DataError, match="no effect of the library"):
        torn.apply()
