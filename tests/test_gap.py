"""`rtcal find`, its kin and the hidden rooms: commands, leak audit, stored findings."""

import re
from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.command.finder import read_case
from rtcal.finder import Case, verify
from rtcal.finder.claim import Size
from rtcal.finder.means.engines import FOLDER
from rtcal.finder.means.search import LITTLE
from rtcal.finder.search import find
from rtcal.finder.verification import LEAST_SHRINKAGE, SURE, Miss
from tests.conftest import candidates_of
from tests.test_discrepancy import controls_of

pytestmark = pytest.mark.usefixtures("runs_kept")


@pytest.fixture(scope="module")
def folder(tmp_path_factory, kept):
    """A user's files: the room that ships, its first configuration."""
    case, _ = rt.datasets.hidden_room()
    path = tmp_path_factory.mktemp("case")
    (path / FOLDER).symlink_to(kept)
    case.room.save(str(path / "room.toml"))
    case.configurations[0].measured.save(str(path / "measured.csv"))
    (path / "case.toml").write_text(
        'room = "room.toml"\n[uncertainty]\ntime = 0.02\nlevel = 0.3\n'
        '[[configuration]]\nname = "as built"\nmeasured = "measured.csv"\n'
    )
    replace(case, configurations=case.configurations[:1]).save(str(path / "case.json"))
    (path / "plan.toml").write_text(
        'room = "room.toml"\n[[configuration]]\nname = "to do"\nparameters = ["t20", "edt"]\n'
    )
    return path


@pytest.mark.parametrize(
    ("read", "out"), [("out/report.html", "out"), ("out/result.json", "out/result.json")]
)
def test_nothing_is_written_over_what_was_read(folder, tmp_path, read, out, rtcal):
    """A measurement has a report's own name."""
    (tmp_path / "out").mkdir()
    (tmp_path / read).write_bytes((folder / "measured.csv").read_bytes())
    (tmp_path / "room.toml").write_bytes((folder / "room.toml").read_bytes())
    text = (folder / "case.toml").read_text().replace("measured.csv", read)
    (tmp_path / "case.toml").write_text(text)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    made = ("find", tmp_path / "case.toml", "--out", tmp_path / out, "--force")
    assert "would overwrite" in rtcal.refused(*made)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def test_a_room_and_its_measurement_are_a_case(folder, tmp_path, rtcal):
    """One configuration needed a third file, which named the other two."""
    room, measured = str(folder / "room.toml"), str(folder / "measured.csv")
    (tmp_path / "case.toml").write_text(
        f'room = "{room}"\n[[configuration]]\nname = "as measured"\nmeasured = "{measured}"\n'
    )
    stated = Case.from_file(str(tmp_path / "case.toml"))
    assert read_case({"case": room, "measured": measured}).to_dict() == stated.to_dict()
    assert "--paths needs positions" in rtcal.refused("find", room, measured, "--paths", "100")


@pytest.fixture(scope="module")
def finding(folder):
    case = Case.from_file(str(folder / "case.json"))
    return find(case, only=["opening", "area"], controls=controls_of(case))


def unsure(finding):
    """The same, where a material's area explains the data best and the opening hardly less."""
    area, opening = candidates_of("area", "opening")
    size = Size(1.4, 1.2, 1.6, "of the input area").fields
    area = replace(area, parameters={"material": 1.0, "ratio": 1.4}, **size)
    return replace(
        finding,
        verdict="ambiguous",
        family=None,
        named=(),
        members=("area",),
        candidates=(area, opening),
        detection=replace(finding.detection, score=6.5),
        evidence={"area": 6.5, "opening": 5.7},
        probabilities={"area": 0.6, "opening": 0.3, "none": 0.1},
    )


def with_gap(seen, gaps, *, uncertainty=0.1, predictive=5.0, misses=(), finding=None):
    """Return a verification with these gaps at what was held out, and a claimed family."""
    rows = [seen.quantities.index(quantity) for quantity in gaps]
    values, counted = seen.gaps.copy(), np.zeros_like(seen.counted)
    values[-2:, 0, rows, 0] = np.transpose([*gaps.values()])[:, :, None] if gaps else 0.0
    counted[rows, 0] = True
    claims = replace(seen.finding, verdict="family", family="added absorption")
    return replace(
        seen,
        finding=finding or claims,
        gaps=values,
        counted=counted,
        uncertainty=uncertainty,
        needed=max(LEAST_SHRINKAGE, SURE * uncertainty),
        endured=max(LITTLE, uncertainty),
        predictive=predictive,
        misses=misses,
        held_out=(*gaps,),
    )


MISS = Miss("T20", "", 500.0, 0.53, 0.645, 0.013, -3.6, "s")


@pytest.mark.parametrize(
    ("before", "after", "changes"),
    [
        (1.75, 1.74, {"uncertainty": 0.001}),
        (1.0, 0.7, {"uncertainty": 0.3}),
        (1.0, 0.1, {"predictive": -0.4}),
        (1.0, 0.1, {"predictive": 1.6}),
        (4.0, 1.1, {}),
        (1.0, 0.1, {"misses": (MISS,)}),
    ],
)
def test_supported_means_something(finding, before, after, changes):
    """Not for 1.75 to 1.74 JND, nor within its error, nor where T is missed by 3 JND."""
    seen = with_gap(verify(finding), {"C80": (before, after)}, **changes)
    assert seen.verdict == "unproven"
    record = seen.to_dict()
    assert record["least_shrinkage_jnd"] == 0.2
    assert record["uncertainty_jnd"] == seen.uncertainty
    assert bool(seen.misses) == ("misses" in changes)


def test_what_gets_worse_at_held_out_data_is_said_and_never_supported(finding):
    seen = verify(finding)
    both = with_gap(seen, {"C80": (3.0, 0.2), "G": (1.0, 1.4)})
    assert both.gain > both.needed
    assert both.verdict == "unproven"
    assert with_gap(seen, {"C80": (0.1, 1.0)}).verdict == "withdrawn"
    untested = with_gap(seen, {}, uncertainty=np.nan)
    assert untested.verdict == "not tested"
    assert untested.to_dict()["before_jnd"] is None


def test_nothing_ambiguous_is_supported(finding):
    torn = with_gap(verify(finding), {"C80": (1.0, 0.1)}, finding=unsure(finding))
    assert torn.verdict == "unproven"
    assert [c["effect"] for c in torn.to_dict()["finding"]["candidates"]] == ["area", "opening"]


def held_out(seen):
    return {seen.quantities[q] for q, _ in np.argwhere(seen.counted)}


@pytest.mark.long
def test_what_the_finding_was_fitted_to_tests_nothing(folder):
    """T20, EDT and T30 of one configuration; with C80 and G these two count, and nothing else does."""
    case = Case.from_file(str(folder / "case.json"))
    found = rt.find(case, cache=folder)
    levels = verify(found)
    assert held_out(levels) == {"C80", "G"}
    assert levels.verdict != "not tested"
    times = case.only("t20", "edt", "t30")
    alone = verify(rt.find(times, cache=folder))
    assert alone.verdict == "not tested"
    assert not held_out(alone)
    # What is measured later was not in the search: the effect stays as it was found.
    later = verify(rt.find(times, cache=folder), case)
    assert later.held_out == ("what was not in the search",)
    assert held_out(later) == {"C80", "G"}


def test_a_plan_needs_no_measurement(folder, rtcal):
    path = folder / "plan.toml"
    counted = re.search(r" furniture .*?(\d+) of (\d+)", rtcal("plan", path))
    assert 0 < int(counted[1]) <= int(counted[2])
    assert re.search(r" furniture: (?!no other effect)", rtcal("plan", path, "--all"))
    assert "`rtcal plan`" in rtcal.refused("find", path)
