"""The page of a saved finding has its case."""

from __future__ import annotations

from types import SimpleNamespace

import rtcal as rt
from rtcal.report import of_finding


def test_the_page_of_a_saved_finding_holds_its_case(tmp_path) -> None:
    case, _ = rt.datasets.hidden_room("identified")
    _, files, command = of_finding._reproduced(SimpleNamespace(case=case, kind="means"), "")
    (tmp_path / "case.json").write_bytes(files.contents["case.json"])
    assert rt.finder.Case.from_file(str(tmp_path / "case.json")).to_json() == case.to_json()
    assert command.text == "rtcal find case.json"
