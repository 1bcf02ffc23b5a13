"""Law: nothing that is written or read depends on the clock, nor on the dates of files."""

from __future__ import annotations

import os
import time
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import rtcal as rt
from rtcal.command.main import main
from rtcal.finder import control_rooms
from rtcal.io import workbook
from tests import faults

FIRST_MOON, LATE = 0, 4_102_444_800
"""Seconds since 1970: a clock without a battery, and the year 2100."""


def call(*words: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([str(word) for word in words])
    assert isinstance(stopped.value.code, int)
    return stopped.value.code


def test_a_workbook_has_no_date_that_a_clock_could_spoil(monkeypatch) -> None:
    """A zip has no dates before 1980: ValueError from openpyxl."""
    pytest.importorskip("openpyxl", reason="needs the extra tables")
    table = {"T": [("band", "t20"), (500, 1.25)]}
    now = workbook.content(table)
    then = SimpleNamespace(time=lambda: 0.0, localtime=lambda *_: time.gmtime(FIRST_MOON))
    monkeypatch.setattr(zipfile, "time", then)
    back = workbook.content(table)
    (one,), (other,) = (workbook.sheets(content, "t.xlsx", {}) for content in (now, back))
    assert str(one.rows) == str(other.rows)


@pytest.mark.long
@pytest.mark.parametrize("date", [FIRST_MOON, LATE])
def test_dates_of_files_say_nothing(tmp_path: Path, date: int) -> None:
    room, measured = rt.datasets.bras_cr2()
    room.save(str(tmp_path / "room.toml"))
    measured.save(str(tmp_path / "t.csv"))
    inputs = tmp_path / "room.toml", tmp_path / "t.csv"
    written = ["calibrate", *inputs, "--method", "lse", "--out", tmp_path / "made", "-q"]
    assert call(*written) == 0
    before = faults.snapshot(tmp_path)
    for i, path in enumerate(sorted(p for p in tmp_path.rglob("*") if p.is_file())):
        os.utime(path, (date, date + i))
    assert call("report", tmp_path / "made", "-q") == 0
    assert call(*written) == 0
    after = faults.snapshot(tmp_path)
    assert {name: after[name] for name in before if name.endswith((".toml", ".csv"))} == {
        name: content for name, content in before.items() if name.endswith((".toml", ".csv"))
    }


@pytest.mark.long
def test_what_is_kept_is_read_whatever_its_date(tmp_path: Path) -> None:
    """Control rooms are kept by what they are of, not by when they were made."""
    case = rt.datasets.hidden_room()[0]
    first = control_rooms(case, cache=tmp_path)
    kept = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert kept
    for path in kept:
        os.utime(path, (FIRST_MOON, LATE))
    written = {path: path.read_bytes() for path in kept}
    again = control_rooms(case, cache=tmp_path)
    assert {path: path.read_bytes() for path in kept} == written
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.errors, other.errors)
