"""The page of a finding in a geometry and its figures, and what a verification may say."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rtcal.files.disk import write_all
from rtcal.finder import verification
from rtcal.finder.claim import Detection
from rtcal.finder.evidence import probability_off
from rtcal.finder.finding import Finding
from rtcal.finder.positions.places import Place
from rtcal.finder.verification import Verification
from rtcal.loop.measured_pairs import ControlRuns
from rtcal.report import finding_words as words
from rtcal.report import of_finding, verification_words
from rtcal.report.document import page_files
from rtcal.support.text import sentences
from tests.conftest import measurement_of
from tests.test_where_corrected import L_PLAN, candidate, case_in, prism, triangulated

pytest.importorskip("matplotlib", reason="needs the extra report")
pytest.importorskip("jinja2", reason="needs the extra report")

PLACE = Place(point=(6.5, 3.0, 1.2), source="S", pairs=2.5)


def finding_of(shares, groups=()):
    """Return a finding in an L-shaped room; its candidates are a porous layer on each surface."""
    case = case_in(triangulated(prism(L_PLAN)))
    candidates = tuple(
        replace(candidate(name, 6.0), probability=0.9 * p) for name, p in shares.items()
    )
    shape = (2, len(case.simulator.pairs), 2)
    return Finding(
        case=case,
        verdict="named",
        named=("porous",),
        family="added absorption",
        surface=None,
        surfaces=shares | {n: 0.0 for n in case.faces if n not in shares},
        groups=groups,
        candidates=candidates,
        probabilities={"porous": 0.9, "none": 0.1},
        families={"added absorption": 0.9, "none": 0.1},
        detection=Detection(12.0, 2.5, means=3.0),
        map=np.arange(8.0).reshape(shape) - 3,
        parameters=("t20", "edt"),
        pairs=case.simulator.pairs,
        reasons=(),
        notes=("A note.",),
        effects={},
        controls=ControlRuns(
            parameters=("t20", "edt"), pairs=case.simulator.pairs, errors=np.zeros((2, *shape))
        ),
    )


@pytest.fixture(scope="module")
def finding():
    shares = {"wall 5": 0.6, "wall 0": 0.25, "ceiling": 0.15}
    return finding_of(shares, (("wall 5", "wall 0"), ("wall 1", "wall 2")))


def verification_of(finding, gaps, noise=0.1, changes=lambda _: None, added=(None, None)):
    """Return gaps that are as stated in the mean, with noise over seeds and pairs."""
    rng = np.random.default_rng(4)
    shape = (3, len(finding.parameters), len(finding.pairs), 2)
    sign = (-1.0) ** np.arange(len(finding.pairs))[:, np.newaxis]
    every = np.stack([sign * (g + noise * rng.standard_normal(shape)) for g in gaps.values()])
    changes(every[-1])
    halves = (finding.pairs[:1], finding.pairs[1:])
    return verification.at_positions(finding, every, added, halves)


SIX = [("S", f"R{i}") for i in range(6)]
MEASURED = measurement_of([500, 1000], SIX, t20=np.full((6, 2), 1.2), edt=np.full((6, 2), 1.1))
PAIRS = SimpleNamespace(
    kind="positions",
    pairs=SIX,
    parameters=("t20", "edt"),
    likeliest=None,
    surface=None,
    case=SimpleNamespace(
        in_room=MEASURED,
        measured=MEASURED,
        room=SimpleNamespace(centre_frequencies=MEASURED.centre_frequencies),
    ),
)


@pytest.mark.parametrize(
    ("plain", "corrected", "verdict"),
    [(2.0, 1.0, "supported"), (2.0, 1.98, "unproven"), (1.0, 2.0, "withdrawn")],
)
def test_a_gap_that_changes_by_less_than_its_uncertainty_is_unproven(plain, corrected, verdict):
    result = verification_of(PAIRS, {"before": 3.0, "plain": plain, "corrected": corrected})
    assert result.verdict == verdict
    assert result.gain == pytest.approx(plain - corrected, abs=0.06)
    assert 0.005 < result.uncertainty < 0.05
    assert " ± " in str(verification_words.gaps(result).rows[0].values[0])


@pytest.mark.parametrize("name", ["t20", "edt"])
def test_a_mean_that_is_missed_is_never_supported(name):
    means = {"before": 3.0, "plain": 2.5, "corrected": 0.8}
    assert verification_of(PAIRS, means).verdict == "supported"
    row = PAIRS.parameters.index(name)

    def with_band(values):
        def change(gaps):
            gaps[:, row, :, 1] = values

        return verification_of(PAIRS, means, changes=change)

    # As close on average, but every pair is off to the same side, in one band.
    result = with_band(-2.0)
    assert result.gain > result.needed
    assert result.verdict == "unproven"
    (miss,) = result.misses
    assert (miss.quantity.lower(), miss.frequency) == (name, 1000.0)
    assert miss.model == pytest.approx(0.9 * miss.measured)
    # A miss within 1 JND, or within its uncertainty, is none.
    assert not with_band(-0.9).misses
    assert not with_band(1.2 + 12 * (-1.0) ** np.arange(6)).misses


def test_a_gap_that_shrinks_at_one_pair_alone_is_unproven():
    def change(gaps):
        gaps[:, :, 0] = 0.1

    means = {"before": 3.0, "plain": 2.0, "corrected": 2.0}
    result = verification_of(PAIRS, means, 0.001, change)
    assert (result.by_seed[2] < result.by_seed[1]).all()
    assert result.verdict == "unproven"


@pytest.mark.parametrize("score", [0.8, 1.4])
def test_a_hint_says_how_prior_and_odds_give_the_probability_of_nothing(finding, score):
    before = (1 - probability_off(finding.case.room)) / 3
    alone = before / (before + (1 - before) * np.exp(score))

    def said(nothing):
        shares = {"none": nothing, "porous": 1 - nothing}
        detection = Detection(score, 2.5, means=-1.0)
        hint = replace(finding, verdict="hint", probabilities=shares, detection=detection)
        return words.evidence(hint)

    begin = (
        f"Before the measurement, the probability that nothing is missing was {before:.0%}".replace(
            "%", " %"
        )
    )
    assert f"{begin}; with these odds it is {words.percent(alone)}." in said(alone)
    other = f"{begin}; these odds alone would make it {words.percent(alone)}. It is 50 %, because"
    assert other in said(0.5)
    assert "Before the measurement" not in words.evidence(finding)


def test_the_page_has_three_sentences_between_answer_and_figure(finding):
    gaps = {"before": 3.0, "plain": 2.0, "corrected": 1.99}
    page = of_finding.page(finding, verification_of(finding, gaps, 1.0), "", PLACE)
    box, beside, title, cautions, *_, details, grounds = page.blocks
    said, (figure, *_) = beside.parts
    assert sentences(box.lead) == [box.lead]
    assert [len(sentences(text)) for text in said[0].texts] == [1, 1, 1]
    assert figure.name == "gap"
    assert title.name == "cautions"
    assert "A note." in cautions.texts
    assert details.name == "details"
    assert "In the mean over all effects" in grounds.texts[0]


def test_the_page_begins_with_the_answer_and_the_bars(finding, tmp_path):
    result = verification_of(finding, {"before": 3.0, "plain": 2.0, "corrected": 1.99}, 1.0)
    write_all(page_files(of_finding.page(finding, result, "", PLACE), result, tmp_path))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    body = page[page.index("<main>") :]
    assert body.index("The room absorbs more") < body.index("is unproven") < body.index("<img")
    assert "Mean deviation" in body[body.index("<img") :][:40]
    assert body.count("<img") == 3
    bars, *_, plan = re.findall(r'<img alt="([^"]+)"', body)
    for gap, model in zip(result.by_seed.mean(axis=1), result.models, strict=True):
        assert f"{gap:.2f} JND {model}" in bars
    assert "wall 5 60 % and wall 0 25 %" in plan
    assert "measure at (6.5, 3.0, 1.2) m with source S" in " ".join(body.split())
    record = json.loads((tmp_path / "result.json").read_text())
    assert (record["rtcal"], record["verdict"]) == (Verification.record_kind, "unproven")
