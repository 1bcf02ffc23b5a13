"""A doubt about T leads at positions too, and surfaces are listed where something stands on one."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import rtcal as rt
from rtcal.finder import PositionsCase
from rtcal.finder.claim import LEADING, Reason
from rtcal.finder.finding import Finding
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
    assert headline(led)[0].startswith(f"{doubt} If there is no such mistake: The room absorbs")
    assert led.to_dict()["mistake"] == doubt.to_dict()
    assert str(doubt) not in headline(finding)[0]
