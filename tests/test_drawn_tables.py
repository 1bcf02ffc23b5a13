"""Tables with known content: units, statistics and protocols are read right, or refused by name."""

import re
from collections import Counter

import numpy as np
import pytest

from benchmarks import drawn_tables
from rtcal.io import library, tables
from rtcal.support.errors import DataError
from tests.conftest import also
from tests.corpus import CASES

LEAST_READ = {"materials": 0.75, "values": 0.75, "modes": 0.6}
"""Share of the drawn tables that must be read; of modes many state no unit, which is refused."""


@pytest.mark.parametrize(
    "seeds", [range(7000, 7060), pytest.param(range(500), marks=pytest.mark.long)], ids=len
)
def test_a_drawn_table_is_read_with_its_true_values_or_refused_by_its_place(tmp_path, seeds):
    found = {kind: Counter() for kind in LEAST_READ}
    for seed in seeds:
        what, why = drawn_tables.judged(seed, tmp_path)
        found[drawn_tables.example(seed).kind][what] += 1
        assert what in ("right", "right as proposed", "refused"), (seed, what, why)
    for kind, counts in found.items():
        read = counts["right"] + counts["right as proposed"]
        assert read >= LEAST_READ[kind] * counts.total(), (kind, counts)


TIMES = {("R1", 500): 1.62, ("R1", 1000): 1.41, ("R2", 500): 1.6, ("R2", 1000): 2.0}


def written(mark, whole):
    """`TIMES` in every layout; a ``whole`` number has no decimal."""

    def text(value):
        number = f"{value:.12g}"
        return (number if whole or "." in number else f"{number}.0").replace(".", mark)

    n = {key: text(value) for key, value in TIMES.items()}
    down = [[f"{f}", n["R1", f], n["R2", f]] for f in (500, 1000)]
    across = [[r, n[r, 500], n[r, 1000]] for r in ("R1", "R2")]
    long = [["S1", r, "T20", f"{f}", v] for (r, f), v in n.items()]
    named = ["source", "receiver", "parameter", "band", "value"]
    return {
        "rows": [["Receiver", "T20 500 Hz", "T20 1 kHz"], *across],
        "rows and parameter": [
            ["Receiver", "Parameter", "500 Hz", "1k"],
            *([r, "T20 [s]", *v] for r, *v in across),
        ],
        "remarks": [["Receiver", "T20 500 Hz", "T20 1 kHz", "Bemerkung"], *across],
        "no header": [[r, "T20 [s]", *v] for r, *v in across],
        "no names": across,
        "bands alone": down,
        "positions": [["f", "S1R1", "S1R2"], *down],
        "positions of other names": [["f", "Foyer", "Saal"], *down],
        "corner": [["T20 [s]", "500", "1000"], *across],
        "kHz": [["f [kHz]", "S1R1", "S1R2"], [text(0.5), *down[0][1:]], ["1", *down[1][1:]]],
        "kHz across": [["T20 (kHz)", text(0.5), "1"], *across],
        "no kHz": [["Position", text(0.5), "1"], *across],
        "31.5 Hz": [["Position", text(31.5), "1000"], *across],
        "long": [named, *long],
        "units": [[*named, "unit"], *([*row, "s"] for row in long)],
        "uncertainties": [[*named, "uncertainty"], *([*row, text(0.05)] for row in long)],
        "uncertainties left out": [[*named, "uncertainty"], *long],
        "one column twice": [["f", "T20", "T20"], *down],
        "no name": [["f", "T20", ""], *down],
        "two lines": [["", "R1", "R2"], ["f", "T20", "T20"], *down],
        "bands below": [["", "T20", "T20"], ["", "500", "1000"], *across],
        "units below": [["f", "S1R1", "S1R2"], ["Hz", "s", "s"], *down],
        "negative": [["f", "C80"], ["500", text(-1.5)], ["1000", text(2.3)]],
        "separators behind": [[*row, "", ""] for row in [["f", "S1R1", "S1R2"], *down]],
    }


def read_or_refused(content, **options):
    try:
        return tables.parse(content, **options).measurement, ""
    except DataError as error:
        return None, str(error)


@pytest.mark.parametrize("separator", [";", ",", *also("\t", "|", "   ")])
@pytest.mark.parametrize("mark", [".", ","])
@pytest.mark.parametrize("layout", written(".", False))
def test_no_reading_and_no_proposal_gives_another_value(separator, mark, layout):
    for whole in (False, True):
        rows = written(mark, whole)[layout]
        content = "\n".join(map(separator.join, rows)).encode()
        for options in ({}, {"parameter": "t20"}):
            measured, refusal = read_or_refused(content, **options)
            columns = drawn_tables.filled_in(refusal)
            assert (
                columns
                or measured
                or "the comma probably" in refusal
                or (mark, separator) != (",", ",")
            )
            if columns:
                measured, other = read_or_refused(content, columns=columns, **options)
                assert measured or "?" in refusal or options, other
            if measured is None:
                continue
            read = np.concatenate([table.ravel() for table in measured.values.values()])
            assert {*read[np.isfinite(read)]} <= {*TIMES.values(), -1.5, 2.3}


OF_REFUSALS = {
    "columns": r'columns="([^"]*)"',
    "parameter": r'for instance with parameter="(\w+)"',
    "decay_time": r'decay_time="(\w+)"',
    "sheets": r'use sheets="([^"]+)"',
    "repeats": r"repeats=(True)",
    "where": r'where=\{"([^"]+)": "([^"]+)"\}',
}


def test_what_a_refusal_proposes_is_read_when_it_is_copied(tmp_path):
    """Proposals are tried before they are printed; what is not known stands in them as ?."""
    files = [
        (tables if c.reader == "tables" else library, f"{i}.csv", c.content, c.options)
        for i, c in enumerate(CASES)
        if c.reader in ("tables", "library")
    ]
    drawn = [drawn_tables.example(seed) for seed in range(7000, 7060)]
    of_kind = {"values": tables, "materials": library}
    files += [(of_kind[d.kind], d.name, d.content, d.options) for d in drawn if d.kind in of_kind]
    followed = 0
    for reader, name, content, options in files:
        path = tmp_path / (name if not content.startswith(b"PK") else f"{name[:-4]}.xlsx")
        path.write_bytes(content)
        try:
            reader.read(path, **options)
        except DataError as error:
            refusal = str(error)
        else:
            continue
        for option, pattern in OF_REFUSALS.items():
            for stated in re.findall(pattern, refusal):
                value = {"repeats": True}.get(
                    option, dict([stated]) if option == "where" else stated
                )
                if "?" not in stated and options.get(option) != value:
                    reader.read(path, **{**options, option: value})
                    followed += 1
                elif option == "columns":
                    with pytest.raises(DataError, match=r"\?|check that the value is in"):
                        reader.read(path, **{**options, option: value})
    assert followed > 60
