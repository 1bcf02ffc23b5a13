"""What is saved is read alike, and broken files are refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rtcal as rt
from rtcal.errors import DataError
from rtcal.loop import Loop
from rtcal.report import (
    page,
)
from rtcal.report import saved as saving
from tests.report.pages import evil_room, no_figures


def test_a_file_and_a_result_are_read_alike(result, tmp_path) -> None:
    (tmp_path / "result.json").write_text(result.to_json(), encoding="utf-8")
    one, other = saving.read(tmp_path), saving.saved(result)
    assert one.record == json.loads(result.to_json()) == other.record
    np.testing.assert_array_equal(one.interval, other.interval)
    np.testing.assert_array_equal(one.alpha_after, result.alpha)
    assert one.trust_marks == result.trust_marks


def paths_of(value, own=()):
    yield own
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in items:
        if isinstance(inner, dict | list):
            yield from paths_of(inner, (*own, key))
        else:
            yield (*own, key)


def _record() -> str:
    return rt.calibrate(evil_room(), [0.4, np.nan, 0.4]).to_json()


RECORD = _record()


PATHS = [p for p in paths_of(json.loads(RECORD)) if p]


@settings(max_examples=200)
@given(data=st.data())
def test_broken_files_are_refused_or_shown(data) -> None:
    """Whatever stands in the file, the page is written or a DataError says what is wrong."""
    record = json.loads(RECORD)
    where = data.draw(st.sampled_from(PATHS))
    junk = data.draw(
        st.sampled_from(
            [None, "text", -1, 1e308, float("inf"), [], {}, [1, "a"], True, {"a": None}, "remove"]
        )
    )
    inner = record
    for key in where[:-1]:
        inner = inner[key]
    if junk == "remove":
        del inner[where[-1]]
    else:
        inner[where[-1]] = junk
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "_figures", no_figures)
        try:
            text = page.page(saving.from_dict(record))
        except DataError as error:
            text = str(error)
    assert "no saved calibration" in text or "What was assumed" in text


def test_what_is_no_result_is_refused(tmp_path) -> None:
    path = tmp_path / "x.json"
    for content, said in (
        ("{", "not JSON"),
        ("[1]", "not a JSON object"),
        ("{}", '"rtcal" is not'),
        ("[" * 100_000, "not JSON"),
    ):
        path.write_text(content)
        with pytest.raises(DataError, match=said):
            page.page_of(path)
    with pytest.raises(DataError, match=r"has no result\.json"):
        page.page_of(tmp_path)


def test_a_loops_file_holds_its_room_and_equation(loop, tmp_path) -> None:
    path = str(tmp_path / "loop.json")
    loop.save(path)
    again = Loop.load(path)
    assert again.room.name == loop.room.name
    np.testing.assert_array_equal(again.room.sigma, loop.room.sigma)
    assert again.status == loop.status
    assert again.equation == rt.Eyring()
    other = rt.loop.start(*rt.datasets.bras_cr2(), equation=rt.Kuttruff(path_variance=0.3))
    other.save(path)
    assert Loop.load(path).equation == rt.Kuttruff(path_variance=0.3)
    path = tmp_path / "loop.json"
    path.write_text(path.read_text().replace('"name": "Kuttruff"', '"name": "Nobody"'))
    with pytest.raises(DataError, match="Nobody"):
        Loop.load(str(path))
