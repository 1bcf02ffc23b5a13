"""A doubt about T leads at positions too, and surfaces are listed where something stands on one."""

import sys
from types import SimpleNamespace

import rtcal as rt
from rtcal.finder.claim import LEADING, Reason
from rtcal.report.finding_words import headline
from tests.test_where_page import finding_of


def test_the_doubt_of_means_about_what_is_stated_leads(monkeypatch):
    doubt, finding = Reason(LEADING, {"factor": 0.3}), finding_of({"wall 5": 1.0})
    search = sys.modules["rtcal.finder.positions.search"]
    monkeypatch.setattr(search, "evidence_of_means", lambda *_: SimpleNamespace(mistake=doubt))
    monkeypatch.setattr(search, "find_by_positions", lambda *_: finding)
    led = rt.find(finding.case)
    assert headline(led)[0].startswith(f"{doubt} If there is no such mistake: The room absorbs")
    assert led.to_dict()["mistake"] == doubt.to_dict()
    assert str(doubt) not in headline(finding)[0]
