"""What a finding says of its own reliability is what the study's page says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import rtcal as rt
from rtcal.finder.means import track_record
from rtcal.finder.positions import track_record as where_record

DOCS = Path(__file__).parents[1] / "docs"
PAGE = (DOCS / "discrepancy_study.md").read_text(encoding="utf-8")
WHERE = (DOCS / "where_study.md").read_text(encoding="utf-8")


def numbers(label: str) -> dict[str, tuple[int, int]]:
    """Return a row of the table of both worlds, with the second number first, by kind of data."""
    (row,) = re.findall(rf"^\| {label} \| (\d+); (\d+) \| (\d+); (\d+) \|$", PAGE, re.MULTILINE)
    times, right_of_times, every, right = map(int, row)
    return {track_record.TIMES: (right_of_times, times), track_record.ALL: (right, every)}


@pytest.mark.parametrize(
    ("label", "stated"),
    [
        ("single names claimed; right", track_record.NAMED),
        ("families claimed; right", track_record.FAMILY),
        ("sets of candidates; with the truth", track_record.AMBIGUOUS),
        ("something hidden; missed", track_record.MISSED),
        ("nothing hidden; flagged", track_record.FLAGGED),
    ],
)
def test_claims_and_right_ones_are_those_of_the_table(
    label: str, stated: dict[str, tuple[int, int]]
) -> None:
    assert stated == numbers(label)


def test_measured_cases_are_those_of_the_page() -> None:
    measured = re.search(r"measured rooms: wrong claims \|[^|]+\|[^|]+\| (\d+) of (\d+)", PAGE)
    assert measured is not None
    assert tuple(int(n) for n in measured.groups()) == track_record.MEASURED


@pytest.mark.parametrize(
    ("label", "stated"),
    [
        ("families claimed that were right, all 110 rooms", track_record.SET_FAMILIES),
        ("sets claimed that were right, all 110 rooms", track_record.FAMILY_SETS),
    ],
)
def test_claims_beside_others_are_those_of_the_table(label: str, stated: tuple[int, int]) -> None:
    right, of = stated
    assert re.search(rf"^\| {label} \| \| {right / of:.2f} \[.*\] of {of} \|$", PAGE, re.MULTILINE)
    assert (
        f"{right} of {of} such"
        in track_record.of_sets(True, True)[stated == track_record.FAMILY_SETS]
    )


def test_every_verdict_says_how_often_it_was_right(kept: Path) -> None:
    case, _ = rt.datasets.hidden_room()
    finding = rt.finder.find(case, cache=kept)
    assert finding.track_record == track_record.sentence(finding.verdict, track_record.ALL)
    assert finding.track_record in " ".join(str(finding).split())
    for data in (track_record.TIMES, track_record.ALL):
        for verdict in ("none", "hint", "named", "family", "ambiguous", "unknown"):
            assert "not used to make the finder" in track_record.sentence(verdict, data)


def test_the_record_is_that_of_the_case_s_own_kind_of_data() -> None:
    case, _ = rt.datasets.hidden_room()
    first = case.configurations[0].name
    assert track_record.data_of(case) == track_record.ALL
    times = case.only("t20", "edt", "t30", configurations=[first])
    assert track_record.data_of(times) == track_record.TIMES
    assert track_record.data_of(case.only("t20", "c80", configurations=[first])) == track_record.ALL


@pytest.mark.parametrize(("data", "column"), [("without level", 3), ("with level", 4)])
def test_what_a_finding_with_a_geometry_says_is_the_study_s(data: str, column: int) -> None:
    for label, stated in (
        ("nothing hidden, flagged", where_record.FLAGGED),
        ("something hidden, detected", where_record.DETECTED),
        ("absorbers detected, on the correct surface", where_record.SURFACE),
    ):
        (row,) = (line for line in WHERE.splitlines() if line.startswith(f"| {label} |"))
        cell = row.split("|")[column].split()
        judged = int(cell[-1])
        assert (round(float(cell[0]) * judged), judged) == stated[where_record.IN_SITU][data]


def test_what_it_says_of_a_handbook_s_coefficients_is_the_study_s() -> None:
    detected, right = (
        [record[where_record.HANDBOOK][data] for data in ("without level", "with level")]
        for record in (where_record.DETECTED, where_record.SURFACE)
    )
    flagged = where_record.FLAGGED[where_record.HANDBOOK]["with level"]
    said = (
        f"{detected[0][0]} and {detected[1][0]} of {detected[0][1]} detected, "
        f"{flagged[0]} of {flagged[1]} flagged, {right[0][0]} of {right[0][1]} and {right[1][0]} of "
        f"{right[1][1]} on the correct surface"
    )
    assert said in " ".join(WHERE.split())


def test_a_room_is_compared_with_those_whose_sigma_is_like_its_own() -> None:
    room = rt.datasets.hidden_room()[0].room
    assert where_record.statement(room.replace(sigma=0.3 * room.alpha)) == where_record.HANDBOOK
    assert where_record.statement(room.replace(sigma=0.1 * room.alpha)) == where_record.IN_SITU
