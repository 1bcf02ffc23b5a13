"""A pair that was measured badly says nothing of the room: its noise is no evidence of a gap."""

import numpy as np
import pytest

from rtcal.finder.positions.problem import (
    NOISE,
    POSITION,
    PositionsHypotheses,
    ShiftHypothesis,
    SpreadHypothesis,
)
from rtcal.finder.positions.search import scores, weights

ODDS = {"porous": 1.0, NOISE: 0.5, POSITION: 0.5}


def shift(effect: str) -> ShiftHypothesis:
    """Return a hypothesis of two sizes whose shifts are not asked for."""
    return ShiftHypothesis(
        effect=effect,
        family=effect,
        surface=0,
        response="",
        weights=np.zeros((2, 1, 1)),
        odds=np.full(2, ODDS[effect] / 2),
        sizes=np.ones(2),
        unit="",
        parameters=[{}, {}],
        spectra=np.zeros((2, 1)),
        error=np.zeros((1, 1)),
        uneven=np.zeros(2),
    )


def spread(effect: str) -> SpreadHypothesis:
    one = np.ones(1)
    return SpreadHypothesis(
        effect=effect,
        place="S1",
        sizes=one,
        unit="",
        odds=ODDS[effect] * one,
        rows=np.arange(1),
        columns=np.eye(1),
        scales=one,
    )


EVERY = PositionsHypotheses(
    shifts=[shift("porous")],
    spreads=[spread(NOISE), spread(POSITION)],
    off=0.1,
)


def score_of(**nats: float) -> tuple[float, float]:
    """Return the scores where these effects explain what was measured better than nothing does."""
    evidence = np.array([nats.get(effect, 0.0) for effect in EVERY.by_row("effect")])
    return scores(weights(evidence, EVERY), EVERY)


@pytest.mark.parametrize("more", [5.0, 40.0])
def test_noise_lowers_the_score(more):
    assert score_of(**{NOISE: more})[0] < score_of()[0]


@pytest.mark.parametrize("missing", ["porous", POSITION])
def test_anything_else_raises_it(missing):
    assert score_of(**{missing: 5.0})[0] > score_of()[0] + 1.0


def test_a_room_in_which_all_explain_alike_has_no_evidence_either_way():
    assert score_of()[0] == pytest.approx(0.0, abs=1e-9)


def test_what_both_explain_is_no_evidence():
    assert score_of(porous=30.0)[0] > 10.0
    assert score_of(porous=30.0, **{NOISE: 33.0})[0] < 0.0


def test_a_noisy_pair_has_a_score_of_its_own():
    assert score_of(**{NOISE: 20.0})[1] > 5.0 > score_of(porous=20.0)[1]
