"""What a finding says of its own reliability is what the study's page says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import rtcal as rt
from rtcal.discrepancy import track_record
from rtcal.where import track_record as where_record

DOCS = Path(__file__).parents[1] / "docs"
PAGE = (DOCS / "discrepancy_study.md").read_text(encoding="utf-8")
WHERE = (DOCS / "where_study.md").read_text(encoding="utf-8")


def numbers(label: str) -> tuple[int, int]:
    """Return the numbers for T20, EDT and T30 of a row of the table of both worlds."""
    (row,) = re.findall(rf"^\| {label} \| (\d+); (\d+) \| \d+; \d+ \|$", PAGE, re.MULTILINE)
    return int(row[0]), int(row[1])


@pytest.mark.parametrize(
    ("label", "stated"),
    [
        ("single names claimed; right", track_record.NAMED),
        ("families claimed; right", track_record.FAMILY),
        ("sets of candidates; with the truth", track_record.AMBIGUOUS),
        ("something hidden; missed", track_record.MISSED),
    ],
)
def test_claims_and_right_ones_are_those_of_the_table(label: str, stated: tuple[int, int]) -> None:
    assert stated == numbers(label)[::-1]


def test_flagged_and_measured_are_those_of_the_page() -> None:
    assert numbers("nothing hidden; flagged")[::-1] == track_record.FLAGGED
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


def test_every_verdict_says_how_often_it_was_right() -> None:
    case, _ = rt.datasets.hidden_room()
    finding = rt.discrepancy.find(case)
    assert finding.track_record == track_record.sentence(finding.verdict)
    assert finding.track_record in " ".join(str(finding).split())
    for verdict in ("none", "hint", "named", "family", "ambiguous", "unknown"):
        assert "not used to make the finder" in track_record.sentence(verdict)


@pytest.mark.parametrize("data", ["without level", "with level"])
@pytest.mark.parametrize("statement", [where_record.IN_SITU, where_record.HANDBOOK])
def test_what_a_finding_with_a_geometry_says_is_the_study_s(statement: str, data: str) -> None:
    column = {"without level": 3, "with level": 4}[data]
    section = WHERE.split(f"### Coefficients {statement}\n")[1].split("\n#")[0]
    for label, (some, of) in (
        ("flagged with nothing hidden", where_record.FLAGGED[statement][data]),
        ("detected", where_record.DETECTED[statement][data]),
        ("right surface, of absorbers detected", where_record.SURFACE[statement][data]),
    ):
        row = next(line for line in section.splitlines() if line.startswith(f"| {label} |"))
        cell = row.split("|")[column].strip()
        assert cell.startswith(f"{some / of:.2f} [")
        assert cell.endswith(f"of {of}")


def test_a_room_is_compared_with_those_whose_sigma_is_like_its_own() -> None:
    room = rt.datasets.hidden_room()[0].room
    assert where_record.statement(room.replace(sigma=0.3 * room.alpha)) == where_record.HANDBOOK
    assert where_record.statement(room.replace(sigma=0.1 * room.alpha)) == where_record.IN_SITU
