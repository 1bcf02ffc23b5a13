"""The page of a finding leads with the finding."""

from __future__ import annotations

import base64
import re
from types import SimpleNamespace

import pytest

import rtcal as rt
from rtcal.report import figures, gap_report, page
from tests.report.pages import FINDING, no_figures


def test_the_page_of_a_saved_finding_holds_its_case(result, tmp_path) -> None:
    case, _ = rt.datasets.named_room()
    reproduce = gap_report._reproduce(SimpleNamespace(case=case), None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "_figures", no_figures)
        pictures = dict.fromkeys(("residuals", "evidence"), (figures.gap(result), ""))
        text = page.finding_page(result, FINDING | {"reproduce": reproduce}, pictures)
    (coded,) = re.findall(r'download="case.json" href="data:text/plain;base64,([^"]+)"', text)
    (tmp_path / "case.json").write_bytes(base64.b64decode(coded))
    assert rt.finder.Case.from_file(str(tmp_path / "case.json")).to_json() == case.to_json()
    assert "<pre>rtcal find case.json</pre>" in text
