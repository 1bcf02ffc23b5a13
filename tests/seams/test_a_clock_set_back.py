"""Law: nothing that is written depends on the clock."""

from __future__ import annotations

import time
import zipfile
from types import SimpleNamespace

import pytest

from rtcal.io import workbook


def test_a_workbook_has_no_date_that_a_clock_could_spoil(monkeypatch) -> None:
    """A clock without a battery: a zip has no dates before 1980, and openpyxl raised ValueError."""
    pytest.importorskip("openpyxl", reason="needs the extra tables")
    table = {"T": [("band", "t20"), (500, 1.25)]}
    now = workbook.content(table)
    then = SimpleNamespace(time=lambda: 0.0, localtime=lambda *_: time.gmtime(0))
    monkeypatch.setattr(zipfile, "time", then)
    back = workbook.content(table)
    (one,), (other,) = (workbook.sheets(content, "t.xlsx", {}) for content in (now, back))
    assert str(one.rows) == str(other.rows)
