"""Tables as measuring systems and offices have them, beyond the shapes of `corpus.toml`."""

import datetime
import sys

import numpy as np
import openpyxl
import pytest

import rtcal as rt
from rtcal.io import tables, workbook
from rtcal.support.errors import DataError, MissingDependencyError
from tests.conftest import run
from tests.corpus import NAMED, book

ACROSS = [["Frequency (Hz)", "S1R1", "S1R2"], [125, 1.5, 1.6], [250, 1.4, 1.3]]
ROWS = [["source", "receiver", "125", "250"], ["S1", "R1", 1.5, 1.4], [None, "R2", 1.6, 1.3]]


def merged(made):
    made["T20"].merge_cells("A2:A3")


def hidden(made):
    made["old"].sheet_state = "hidden"


def in_percent(made):
    made["D50"]["B2"].number_format = "0.0%"


def formula(made):
    made["T20"]["B2"] = "=1+0.5"


def dated(made):
    made["T20"]["B2"] = datetime.datetime(2026, 5, 1)


@pytest.mark.parametrize(
    ("sheets", "change", "parameter", "values"),
    [
        ({"T20": ROWS}, merged, "t20", [[1.5, 1.4], [1.6, 1.3]]),
        ({"T20": ACROSS, "old": ACROSS}, hidden, "t20", [[1.5, 1.4], [1.6, 1.3]]),
        ({"D50": [["f", "S1R1"], [500, 0.556]]}, in_percent, "d50", [[0.556]]),
        ({"T20": ACROSS}, formula, 'sheet "T20", cell B2: the value of this formula', None),
        (
            {"T20": ACROSS},
            dated,
            'sheet "T20", line 2: "2026-05-01 .* .Excel.s date.. must be',
            None,
        ),
    ],
)
def test_what_only_a_workbook_has(sheets, change, parameter, values):
    """A value beside it is a rule, where the table is refused."""
    content = book(sheets, change)
    if values is None:
        with pytest.raises(DataError, match=parameter):
            tables.parse(content)
        return
    read = tables.parse(content)
    assert read.measurement.values[parameter] == pytest.approx(np.array(values), rel=1e-12)
    assert ('left out, hidden: "old"' in str(read)) == ("old" in sheets)


def test_rew_writes_no_decay_as_zero_and_one_file_per_position(tmp_path):
    text = NAMED["REW, two measurements"].text
    cut = text.index("RT60 data", 5)
    (tmp_path / "a.txt").write_text(text[:cut].replace(" 1.5 ", " 0.000 "))
    (tmp_path / "b.txt").write_text(text[cut:])
    m = tables.read([tmp_path / "a.txt", tmp_path / "b.txt"]).measurement
    assert m.pairs == (("S1", "R1"), ("S1", "R2"))
    assert np.isnan(m.values["t20"][0, 0])
    assert m.values["t20"][1, 0] == 1.6
    assert m.values["d50"][0, 0] == pytest.approx(0.55, rel=1e-12)


def test_a_workbook_straight_into_calibrate(tmp_path, capsys):
    room, path = rt.datasets.bras_cr2()[0], tmp_path / "room.toml"
    room.save(path)
    rows = [["f", "S1R1", "S1R2"], *([f, 1.5, 1.6] for f in room.centre_frequencies.tolist())]
    (tmp_path / "t.xlsx").write_bytes(book({"T20": rows}))
    assert run("calibrate", path, tmp_path / "t.xlsx", "--out", tmp_path / "done") == 0
    assert "T20 of 2 pairs in 6 bands; `rtcal table" in capsys.readouterr().err
    assert run("report", path, "--out", tmp_path / "tables.xlsx") == 2


def test_without_openpyxl_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'rtcal\[tables\]'"):
        tables.parse(NAMED["other sheets"].content)
    with pytest.raises(MissingDependencyError, match=r"rtcal\[tables\]"):
        workbook.content({"a": [["x"]]})


@pytest.mark.parametrize(
    "names",
    [
        ("S1R3", "S1R3"),
        ("S1R3 (1)", "S1R3 (2)"),
        ("S1R3_1", "S1R3_2"),
        ("S1R3 sweep 1", "S1R3 sweep 2"),
    ],
)
def test_repeats_are_proposed_and_read_by_their_usual_names(names):
    rows = [["Hz", "S1R1", *names], [500, 1.5, 1.2, 1.4], [1000, 1.3, 1.0, 1.2]]
    content = book({"T20": rows})
    with pytest.raises(DataError, match="repeats at one position, use repeats=True"):
        tables.parse(content, "room.xlsx")
    read = tables.parse(content, "room.xlsx", repeats=True).measurement
    of_place = dict(zip(read.pairs, read.values["t20"], strict=True))
    assert len(read.pairs) == 2  # a place each, and not a receiver per sweep
    assert of_place["S1", "R1"] == pytest.approx([1.5, 1.3])
    assert next(v for k, v in of_place.items() if k != ("S1", "R1")) == pytest.approx([1.3, 1.1])


PLACES = [["Position", 500, 1000], ["S1-R1", 1.5, 1.4], ["S2-R1", 1.6, 1.3]]


def test_what_a_sheet_hides_is_left_out_and_what_it_strikes_through_is_said():
    def change(made):
        sheet = made["T20"]
        sheet.row_dimensions[3].hidden = True
        sheet.column_dimensions["C"].hidden = True
        sheet["B2"].font = openpyxl.styles.Font(strike=True)

    rows = [*PLACES, ["S2-R2", 1.7, 1.2]]
    table = tables.parse(book({"T20": rows}, change))
    assert table.measurement.pairs == (("S1", "R1"), ("S2", "R2"))
    assert table.measurement.centre_frequencies.tolist() == [500]
    assert "left out, hidden: row 3" in str(table)
    assert "left out, hidden: column C" in str(table)
    assert "struck through, and read: B2; empty what is withdrawn" in str(table)
