"""`rtcal find` and its kin with a geometry: what is printed, exit codes, what an interruption keeps."""

import json
from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from tests.conftest import run
from tests.test_where import RECEIVERS, SOURCES, measured, stated
from tests.test_where_page import PLACE, finding_of, verification_of

pytest.importorskip("matplotlib", reason="needs the extra report")
pytest.importorskip("jinja2", reason="needs the extra report")

FILES = ("room.toml", "pairs.csv")
FOUND = "found.json"


def some():
    shares = {"floor": 0.6, "wall 0": 0.25, "ceiling": 0.15}
    return finding_of(shares, (("floor", "wall 0"), ("wall 1", "wall 2")))


@pytest.fixture
def found(monkeypatch, tmp_path):
    """The slow part, which is not what these tests are about."""
    finding = some()

    def verified(*_, **__):
        return verification_of(finding, {"before": 3.0, "plain": 2.0, "corrected": 1.0})

    monkeypatch.setattr("rtcal.finder.search.find", lambda *_, **__: finding)
    monkeypatch.setattr(rt.finder, "verify", verified)
    monkeypatch.setattr(rt.finder.positions, "next_position", lambda *_, **__: (PLACE,))
    monkeypatch.chdir(tmp_path)
    scene = rt.Scene(sources=SOURCES, receivers=RECEIVERS)
    stated().replace(scene=scene, scattering=np.full((6, 3), 0.4)).save("room.toml")
    measured(False).save("pairs.csv")
    finding.save(FOUND)
    return finding


def test_the_next_position_is_proposed(found, rtcal):
    record = json.loads(rtcal("plan", FOUND, "--json"))
    assert record["places"] == [
        {"point": list(PLACE.point), "source": PLACE.source, "pairs": PLACE.pairs}
    ]
    claimed = replace(found, surface="floor")
    claimed.save(FOUND)
    assert "no surfaces are in question" in rtcal("plan", FOUND)


def test_the_same_search_is_made_once(found, monkeypatch):
    """With other options, or other files, it is another one."""
    searches = []

    def search(*_, **__):
        searches.append(found)
        return found

    monkeypatch.setattr("rtcal.finder.search.find", search)
    for count, options in enumerate(((), ("--seed", "2"), ("--without", "opening")), 1):
        for _ in range(2):
            assert run("find", *FILES, *options) == 0
            assert len(searches) == count
    measured(False).select(measured(False).pairs[1:]).save("pairs.csv")
    assert run("find", *FILES) == 0
    assert len(searches) == 4


def test_nothing_found_is_said_and_nothing_is_written(found, tmp_path, monkeypatch, rtcal):
    nothing = replace(found, verdict="none", named=(), family=None)
    monkeypatch.setattr("rtcal.finder.search.find", lambda *_, **__: nothing)
    assert run("find", *FILES, "--out", "page") == 0
    assert run("apply", "page", "--out", "corrected") == 6
    assert not (tmp_path / "corrected").exists()
    assert "Nothing to add" in rtcal("verify", "page")
    assert not (tmp_path / "page" / "gap.png").exists()


@pytest.mark.usefixtures("found")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--place", "7,1"), '--place "7,1" must have the form X,Y,Z in m'),
        (("--place", "a,b,c"), '--place "a,b,c" must have the form X,Y,Z in m'),
        (("--place", "6,2,0", "--form", "material"), "at is the centre of a patch"),
        (("--form", "hole"), "'hole' is not one of"),
        (("--out", "pairs.csv"), "--out pairs.csv is a file, but the results need a folder"),
    ],
)
def test_a_wrong_option_is_refused(options, message, tmp_path, rtcal):
    assert message in rtcal.refused("apply", FOUND, "--out", "corrected", *options)
    assert not (tmp_path / "corrected").exists()
