"""A finding's statement of its own reliability is what the study's page says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import rtcal as rt
from rtcal.finder import claim
from rtcal.finder.claim import (
    HANDBOOK,
    IN_SITU,
    LATER,
    RECORDS_OF_POSITIONS,
    WITH_LEVEL,
    WITHOUT_LEVEL,
    Share,
    TrackRecord,
)

DOCS = Path(__file__).parents[1] / "docs"
PAGE = (DOCS / "discrepancy_study.md").read_text(encoding="utf-8")
WHERE = (DOCS / "where_study.md").read_text(encoding="utf-8")


def numbers(label: str) -> dict[str, tuple[int, int]]:
    """Return a row of the table of both worlds, with the second number first, by kind of data."""
    (row,) = re.findall(rf"^\| {label} \| (\d+); (\d+) \| (\d+); (\d+) \|$", PAGE, re.MULTILINE)
    times, right_of_times, every, right = map(int, row)
    return {claim.TIMES: (right_of_times, times), claim.ALL: (right, every)}


@pytest.mark.parametrize(
    ("label", "claimed"),
    [
        ("single names claimed; right", "named"),
        ("families claimed; right", "family"),
        ("sets of candidates; with the truth", "ambiguous"),
    ],
)
def test_claims_and_right_ones_are_those_of_the_table(label: str, claimed: str) -> None:
    stated = {data: record.right[claimed] for data, record in claim.RECORDS_OF_MEANS.items()}
    assert stated == numbers(label)


def test_what_is_missed_and_flagged_is_that_of_the_table() -> None:
    for data, (missed, hidden) in numbers("something hidden; missed").items():
        assert claim.RECORDS_OF_MEANS[data].detected == (hidden - missed, hidden)
    for data, flagged in numbers("nothing hidden; flagged").items():
        assert claim.RECORDS_OF_MEANS[data].flagged == flagged


def test_measured_cases_are_those_of_the_page() -> None:
    measured = re.search(r"measured rooms: wrong claims \|[^|]+\|[^|]+\| (\d+) of (\d+)", PAGE)
    assert measured is not None
    assert tuple(int(n) for n in measured.groups()) == claim.MEASURED


@pytest.mark.parametrize(
    ("label", "kind"),
    [
        ("families claimed that were right, all 110 rooms", "families"),
        ("sets claimed that were right, all 110 rooms", "sets of families"),
    ],
)
def test_claims_beside_others_are_those_of_the_table(label: str, kind: str) -> None:
    right, of = claim.SEVERAL[kind]
    assert re.search(rf"^\| {label} \| \| {right / of:.2f} \[.*\] of {of} \|$", PAGE, re.MULTILINE)
    assert f"{right} of {of} such {kind} were right" in claim.record_of_several([kind])


def test_every_verdict_says_how_often_it_was_right(kept: Path) -> None:
    case, _ = rt.datasets.hidden_room()
    finding = rt.find(case, cache=kept)
    assert finding.track_record == claim.record_of_means(finding.verdict, claim.ALL)
    assert finding.track_record in " ".join(str(finding).split())
    for data in (claim.TIMES, claim.ALL):
        for verdict in ("none", "hint", "named", "family", "ambiguous", "unknown"):
            assert "not used to make the finder" in claim.record_of_means(verdict, data)


def test_the_record_is_that_of_the_case_s_own_kind_of_data() -> None:
    case, _ = rt.datasets.hidden_room()
    first = case.configurations[0].name
    assert claim.data_of(case) == claim.ALL
    times = case.only("t20", "edt", "t30", configurations=[first])
    assert claim.data_of(times) == claim.TIMES
    assert claim.data_of(case.only("t20", "c80", configurations=[first])) == claim.ALL


def counts(record: TrackRecord) -> dict[str, Share]:
    """Return the counts of a search at every position by the labels of the study's table."""
    return {
        "nothing hidden, flagged": record.flagged,
        "something hidden, detected": record.detected,
        "absorbers detected, on the correct surface": record.right["surface"],
    }


@pytest.mark.parametrize(("data", "column"), [(WITHOUT_LEVEL, 3), (WITH_LEVEL, 4)])
def test_what_a_finding_with_a_geometry_says_is_the_study_s(data: str, column: int) -> None:
    for label, stated in counts(RECORDS_OF_POSITIONS[IN_SITU, data]).items():
        (row,) = (line for line in WHERE.splitlines() if line.startswith(f"| {label} |"))
        cell = row.split("|")[column].split()
        judged = int(cell[-1])
        assert (round(float(cell[0]) * judged), judged) == stated


@pytest.mark.parametrize(("data", "which"), [(WITHOUT_LEVEL, "without"), (WITH_LEVEL, "level")])
def test_what_it_says_of_a_later_version_is_what_was_judged(data: str, which: str) -> None:
    pytest.importorskip("numba", reason="the geometric world is compiled (extra fast)")
    from benchmarks import where, where_figures

    judged = where_figures.Rows(where.kept(where.IN_SITU, "seventh")[0], 4, which)
    detected = where_figures.flags(judged, where_figures.HIDDEN)
    flagged = where_figures.flags(judged, (where.rooms.NOTHING,))
    first = [
        row["true_surface"] == next(iter(row["surfaces"]))
        for _, row in judged.only(where_figures.ABSORBERS, True)
    ]
    assert LATER[data].detected == (sum(detected), len(detected))
    assert LATER[data].flagged == (sum(flagged), len(flagged))
    assert LATER[data].right == {"surface": (sum(first), len(first))}


def test_what_it_says_of_a_handbook_s_coefficients_is_the_study_s() -> None:
    without, with_level = (
        RECORDS_OF_POSITIONS[HANDBOOK, data] for data in (WITHOUT_LEVEL, WITH_LEVEL)
    )
    right = without.right["surface"], with_level.right["surface"]
    said = (
        f"{without.detected[0]} and {with_level.detected[0]} of {without.detected[1]} detected, "
        f"{with_level.flagged[0]} of {with_level.flagged[1]} flagged, {right[0][0]} of "
        f"{right[0][1]} and {right[1][0]} of {right[1][1]} on the correct surface"
    )
    assert said in " ".join(WHERE.split())


def test_a_room_is_compared_with_those_whose_sigma_is_like_its_own() -> None:
    room = rt.datasets.hidden_room()[0].room
    assert claim.statement_of(room.replace(sigma=0.3 * room.alpha)) == HANDBOOK
    assert claim.statement_of(room.replace(sigma=0.1 * room.alpha)) == IN_SITU
