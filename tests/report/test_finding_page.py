"""The page of a finding leads with the finding."""

from __future__ import annotations

import base64
import re
from types import SimpleNamespace

import pytest

import rtcal as rt
from rtcal.report import figures, gap_report, page
from tests.report.pages import FINDING, no_figures


def test_a_findings_page_opens_with_the_finding(result) -> None:
    """Not with the sentence that the plain calibration meets the measured T, which proves nothing."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "_figures", no_figures)
        pictures = {
            "residuals": (figures.gap(result), "Map"),
            "evidence": (figures.gap(result), "E"),
        }
        text = page.finding_page(result, FINDING, pictures)
        usual = page.calibration_page(result)
    met = "now the model has the measured T in all 6 bands"
    order = [
        "The model lacks &lt;i&gt;this&lt;/i&gt;.",
        "Size of opening",
        "The odds are high.",
        "Measure once without it.",
        'opening</td><td data-of="Probability / %">93</td><td data-of="Odds">220,000 to 1',
        "From here on, text, tables and pictures are of the plain calibration: not to be used",
        met,
    ]
    assert [text.index(sentence) for sentence in order] == sorted(map(text.index, order))
    assert text.count("data:image/svg+xml") == 2
    assert met in usual
    assert "What to do" not in usual.split('id="doubts"')[0]


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
