"""Whether something is other than stated: the positions decide."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import rtcal as rt
from benchmarks.studies.geometric_world.load import IN_SITU, load, truth
from rtcal.finder import PositionsCase, library
from rtcal.finder.claim import CLAIMED, LEADING, Candidate, Detection, Reason
from rtcal.finder.evidence import NONE, UNKNOWN
from rtcal.finder.positions.problem import (
    NOISE,
    POSITION,
    PositionsHypotheses,
    PositionsProblem,
    ShiftHypothesis,
    SpreadHypothesis,
    shifts,
)
from rtcal.finder.positions.search import (
    LEAST_BY_MEANS,
    MEANS_POWER,
    THRESHOLD,
    TOLD_TEMPER,
    controls_of,
    evaluate,
    every_hypothesis,
    of_means,
    scores,
    summary_of,
    weights,
    with_families,
)
from rtcal.finder.positions.weighing import responses_of
from rtcal.report.finding_words import headline
from tests.conftest import also
from tests.test_where import MATCH, measured, stated, tracing
from tests.test_where_page import finding_of


@pytest.fixture(scope="module")
def case():
    return rt.finder.PositionsCase(simulator=tracing(stated()), measured=measured(True))


def test_the_positions_decide():
    above, below = THRESHOLD + 0.1, THRESHOLD - 0.1
    assert Detection(above, THRESHOLD).verdict is None
    assert Detection(above, THRESHOLD, means=-1.0).verdict is None
    assert Detection(below, THRESHOLD, means=9.0).verdict == "hint"
    assert Detection(-0.1, THRESHOLD).verdict == "none"


@pytest.mark.parametrize("ceiling", [0.2, 0.9])
def test_what_is_called_added_absorption_adds_some(ceiling):
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


def test_the_means_have_the_pairs_and_the_geometry_of_the_case(case):
    less = replace(case, exclude=[("S1", "R2")], match=("t20", "c80", "ts"))
    (configuration,) = of_means(less).configurations
    assert set(configuration.measured.values) == {"t20", "c80"}
    assert tuple(configuration.measured.pairs) == less.pairs
    kept = [case.measured.pairs.index(pair) for pair in less.pairs]
    np.testing.assert_array_equal(
        configuration.measured.uncertainty["t20"], case.measured.uncertainty["t20"][kept]
    )
    away = np.subtract(case.simulator.sources["S2"], case.simulator.receivers["R3"])
    assert configuration.distances[less.pairs.index(("S2", "R3"))] == pytest.approx(
        np.linalg.norm(away)
    )
    along = dict(zip(case.room.materials, of_means(case).facing, strict=True))
    np.testing.assert_allclose(along["east wall"], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(along["floor wall"], [0, 0, 1], atol=1e-12)


def test_the_families_of_the_means_are_multiplied_in(case):
    some = [
        s.some(slice(0, 1))
        for s in shifts(case, library())
        if s.effect in ("opening", "covered surface")
    ]
    pair = [some[0], next(s for s in some if s.family != some[0].family)]
    every = PositionsHypotheses(pair, [], off=0.1)
    before = weights(np.zeros(len(every.log_prior)), every, TOLD_TEMPER)
    after = with_families(before, every, {"none": 1e-9, pair[0].family: 0.64})
    changed = np.exp(after - before)
    for of_shifts in every.of_groups(changed)[1:]:
        assert np.concatenate(of_shifts) == pytest.approx(
            [0.64**MEANS_POWER, LEAST_BY_MEANS**MEANS_POWER]
        )
    assert changed[0] == pytest.approx(LEAST_BY_MEANS**MEANS_POWER)


# A doubt about T leads at positions too, and surfaces are listed where something stands on one


def test_the_doubt_of_means_about_what_is_stated_leads(monkeypatch):
    doubt, finding = Reason(LEADING, {"factor": 0.3}), finding_of({"wall 5": 1.0})
    search = sys.modules["rtcal.finder.positions.search"]
    monkeypatch.setattr(search, "evidence_of_means", lambda *_: SimpleNamespace(mistake=doubt))
    monkeypatch.setattr(search, "find_by_positions", lambda *_: finding)
    led = rt.find(finding.case)
    assert headline(led)[0].startswith(f"{doubt} If there is no such mistake: The room absorbs")
    assert led.to_dict()["mistake"] == doubt.to_dict()
    assert str(doubt) not in headline(finding)[0]


# Laws of "unknown" at positions, and of halves that found another thing than all pairs

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


def numbers_of(case, kept):
    numbers = PositionsProblem(case, responses_of(case, 0, kept), controls_of(case, cache=kept))
    return case, numbers, every_hypothesis(case, numbers, library())


def told(of, seed, hidden, larger=LARGER):
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


def unknown(shares, families=("added absorption",)):
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


# A pair that was measured badly says nothing of the room: its noise is no evidence of a gap

ODDS = {"porous": 1.0, NOISE: 0.5, POSITION: 0.5}


def shift(effect):
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


def spread(effect):
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
    shifts=[shift("porous")], spreads=[spread(NOISE), spread(POSITION)], off=0.1
)


def score_of(**nats):
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
