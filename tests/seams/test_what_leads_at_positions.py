"""A doubt about T leads at positions too, and surfaces are listed where something stands on one."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

import rtcal as rt
from rtcal.finder import PositionsCase
from rtcal.finder.claim import LEADING, Candidate, Reason
from rtcal.finder.finding import Finding
from rtcal.report import figures
from rtcal.report.finding_words import headline
from tests.test_where import heard, stated, tracing

pytestmark = pytest.mark.long  # the search that they share takes 20 s

FOAM = (0.6, 0.9, 0.95)
"""Alpha of the ceiling in truth."""


def hard() -> rt.Room:
    room = stated()
    return room.replace(alpha=0.3 * room.alpha, sigma=0.3 * room.sigma)


def case() -> PositionsCase:
    """Return the hard room, measured with foam on its ceiling."""
    room = hard()
    alpha = room.alpha.copy()
    alpha[-1] = FOAM
    measured = heard(tracing(room, scattering=0.5, n_paths=9600), alpha)
    return PositionsCase(simulator=tracing(room, n_paths=1600), measured=measured)


@pytest.fixture(scope="module")
def finding(kept: Path) -> Finding:
    return rt.find(case(), cache=kept)


def test_the_doubt_of_means_about_what_is_stated_leads(
    finding: Finding, monkeypatch: pytest.MonkeyPatch
) -> None:
    doubt = Reason(LEADING, {"factor": 0.3})
    search = sys.modules["rtcal.finder.positions.search"]
    monkeypatch.setattr(search, "evidence_of_means", lambda *_: SimpleNamespace(mistake=doubt))
    monkeypatch.setattr(search, "find_by_positions", lambda *_: finding)
    led = rt.find(finding.case)
    assert headline(led)[0].startswith(f"{doubt} If there is none: The room absorbs")
    assert led.to_dict()["mistake"] == doubt.to_dict()
    assert str(doubt) not in headline(finding)[0]


def test_a_whole_ceiling_of_foam_is_tried(finding: Finding) -> None:
    """It was 13 m² on a wall: no area beyond 1.4 times the stated absorption area had been tried."""
    assert finding.detected
    best = next(c for c in finding.candidates if c.surface is not None)
    assert best.surface == "ceiling"
    assert best.low < best.high == pytest.approx(finding.case.areas["ceiling"])


def test_likely_surfaces_are_told_where_something_stands_on_one(finding: Finding) -> None:
    """Beside a receiver that stood elsewhere, 58 %, and "unknown", 42 %, the ceiling was listed."""
    assert finding.likely_surfaces
    receiver = Candidate(
        effect="position", family="measurement", place="receiver R1", probability=0.98
    )
    few = replace(
        finding,
        verdict="ambiguous",
        surface=None,
        candidates=(
            receiver,
            *(replace(c, probability=0.02 * c.probability) for c in finding.candidates),
        ),
    )
    assert few.likely_surfaces == ()
    assert not any(figures.likely_shares(few).values())
    assert "ceiling" not in " ".join(headline(few))
