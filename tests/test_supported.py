"""Counts of "supported" in another tracer's rooms: the study states those of the stored rows."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

from benchmarks.studies.means import supported

PAGE = (Path(supported.__file__).with_name("README.md")).read_text(encoding="utf-8")


def row_of(label: str) -> list[str]:
    """Return the cells of a row of the study's table, by set of data."""
    section = PAGE.split('## Is "supported" right')[1].split("\n## ")[0]
    (row,) = re.findall(rf"^\| {label} \|(.*)\|$", section, re.MULTILINE)
    return [cell.strip() for cell in row.split("|")]


@pytest.mark.parametrize("column", range(4))
def test_the_table_is_that_of_the_rows(column: int) -> None:
    data = supported.DATA[column]
    rows = [(r["hidden"], r["rows"][data]) for r in supported.stored() if data in r["rows"]]
    assert int(row_of("cases")[column]) == len(rows)
    said = Counter(row["verification"] for _, row in rows if "verification" in row)
    assert int(row_of("verified")[column]) == sum(said.values())
    for verdict in ("not tested", "unproven", "withdrawn"):
        assert int(row_of(verdict)[column]) == said[verdict]
    right = [
        supported.is_right(hidden, row)
        for hidden, row in rows
        if row.get("verification") == "supported"
    ]
    of = [int(n) for n in row_of("supported; right")[column].split(";")]
    assert of == ([len(right), sum(right)] if right else [0])


def test_times_of_one_configuration_are_never_tested() -> None:
    rows = [r["rows"]["times"] for r in supported.stored()]
    verdicts = {row["verification"] for row in rows if "verification" in row}
    assert verdicts == {"not tested"}
