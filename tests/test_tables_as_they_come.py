"""Tables as measuring systems and offices have them, beyond the shapes of `corpus.toml`."""

from __future__ import annotations

import datetime
import io
import json
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest

import rtcal as rt
from rtcal.command.main import main
from rtcal.io import budget, tables, workbook
from rtcal.support.errors import DataError, MissingDependencyError
from tests.corpus import NAMED, book


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(arguments)
    return int(end.value.code or 0)


ACROSS = [["Frequency (Hz)", "S1R1", "S1R2"], [125, 1.5, 1.6], [250, 1.4, 1.3]]
ROWS = [["source", "receiver", "125", "250"], ["S1", "R1", 1.5, 1.4], [None, "R2", 1.6, 1.3]]


def merged(made: Any) -> None:
    made["T20"].merge_cells("A2:A3")


def hidden(made: Any) -> None:
    made["old"].sheet_state = "hidden"


def in_percent(made: Any) -> None:
    made["D50"]["B2"].number_format = "0.0%"


def formula(made: Any) -> None:
    made["T20"]["B2"] = "=1+0.5"


def dated(made: Any) -> None:
    made["T20"]["B2"] = datetime.datetime(2026, 5, 1)


@pytest.mark.parametrize(
    ("sheets", "change", "parameter", "values"),
    [
        ({"T20": ROWS}, merged, "t20", [[1.5, 1.4], [1.6, 1.3]]),
        ({"T20": ACROSS, "old": ACROSS}, hidden, "t20", [[1.5, 1.4], [1.6, 1.3]]),
        ({"D50": [["f", "S1R1"], [500, 0.556]]}, in_percent, "d50", [[0.556]]),
        ({"T20": ACROSS}, formula, 'sheet "T20", cell B2: a formula without its stored', None),
        (
            {"T20": ACROSS},
            dated,
            'sheet "T20", line 2: "2026-05-01 .* .Excel.s date.. is not',
            None,
        ),
    ],
)
def test_what_only_a_workbook_has(
    sheets: dict[str, Any], change: Callable[[Any], None], parameter: str, values: Any
) -> None:
    """A value beside it is a rule, where the table is refused."""
    content = book(sheets, change)
    if values is None:
        with pytest.raises(DataError, match=parameter):
            tables.parse(content)
        return
    read = tables.parse(content)
    assert read.measurement.values[parameter] == pytest.approx(np.array(values), rel=1e-12)
    assert ('left out, hidden: "old"' in str(read)) == ("old" in sheets)


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("content.xml", r"a zip file, but no workbook \(xlsx\)"),
        ("xl/workbook.xml", "cannot be read as a workbook"),
    ],
)
def test_zip_files_that_are_no_workbook(name: str, rule: str) -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr(name, "<a/>")
    with pytest.raises(DataError, match=rule):
        tables.parse(stream.getvalue())


def test_values_that_a_formula_failed_to_give_are_counted() -> None:
    rows = [
        ["source", "receiver", "band", "T20"],
        *(["S1", f"R{n}", 500, 1.5] for n in range(1, 4)),
    ]
    sound = str(tables.parse(book({"T": rows})))
    assert "missing" not in sound
    rows[1][3], rows[3][3] = "#DIV/0!", "#WERT!"
    found = tables.parse(book({"T": rows}))
    assert (
        "missing, since a formula has an error: #DIV/0! in line 2, #WERT! in line 4"
        in found.columns
    )


def test_a_decimal_that_was_typed_wrong_at_one_position_is_named() -> None:
    rows = [["source", "receiver", "band", "T20"]]
    rows += [["S1", f"R{n}", f, 1.0 + n / 50] for n in range(1, 5) for f in (500, 1000)]
    assert tables.parse(book({"T": rows})).doubts == ()
    assert rows[5] == ["S1", "R3", 500, 1.06]
    rows[5][3] = 10.6
    read = tables.parse(book({"T": rows}))
    assert read.doubts == (
        "T20 is 3 times as long as at the other pairs, or as short: 10.6 s (S1 to R3 at 500 Hz; "
        "median over the pairs 1.06 s). Look whether the decimal is another, and whether the row is a "
        "position",
    )
    assert read.doubts[0] in str(read)


def test_five_sweeps_at_one_place_are_one_position() -> None:
    """They took u(T) from 0.088 to 0.050 s while each counted as a position."""
    sweeps = [1.5, 1.52, 1.48, 1.51, 1.49]
    names = ["S1R1", *(f"S1R1#{n}" for n in range(2, 6))]
    once = tables.parse(book({"T20": [["f", "S1R1", "S1R2"], [500, 1.5, 1.6]]})).measurement
    five = tables.parse(book({"T20": [["f", *names, "S1R2"], [500, *sweeps, 1.6]]}))
    assert five.measurement.pairs == once.pairs
    assert five.measurement.values["t20"] == pytest.approx(once.values["t20"], rel=1e-12)
    assert "5 of S1 to R1" in str(five)
    assert five.measurement.mean_uncertainty("t20") == pytest.approx(
        once.mean_uncertainty("t20"), rel=1e-12
    )


def test_rew_writes_no_decay_as_zero_and_one_file_per_position(tmp_path: Path) -> None:
    text = NAMED["REW, two measurements"].text
    cut = text.index("RT60 data", 5)
    (tmp_path / "a.txt").write_text(text[:cut].replace(" 1.5 ", " 0.000 "))
    (tmp_path / "b.txt").write_text(text[cut:])
    m = tables.read([tmp_path / "a.txt", tmp_path / "b.txt"]).measurement
    assert m.pairs == (("S1", "R1"), ("S1", "R2"))
    assert np.isnan(m.values["t20"][0, 0])
    assert m.values["t20"][1, 0] == 1.6
    assert m.values["d50"][0, 0] == pytest.approx(0.55, rel=1e-12)


def test_an_xl2_report_has_its_averages_and_their_uncertainty() -> None:
    read = tables.parse(NAMED["an XL2's report"].content)
    m = read.measurement
    assert m.pairs == (("S1", "2026_RT60_004_Report"),)
    assert m.centre_frequencies.tolist() == [125, 250]
    assert m.values["t20"].tolist() == [[1.5, 1.4]]
    assert m.uncertainty["t20"][0, 0] == pytest.approx(0.09, rel=1e-12)


def test_a_workbook_that_unpacks_to_too_much_is_not_unpacked(monkeypatch) -> None:
    monkeypatch.setattr(budget, "MAX_UNPACKED", 1000)
    with pytest.raises(DataError, match="bytes when unpacked; at most 1000"):
        tables.parse(book({"T20": ACROSS}))


def test_a_measurement_written_as_a_workbook_is_the_same(tmp_path: Path) -> None:
    m = rt.Measurement(
        centre_frequencies=[125, 250],
        pairs=[("S1", "R1"), ("S1", "R2")],
        values={"t20": [[1.0 / 3, np.nan], [1.6, 1.3]], "c80": [[-1.0, 2.0], [0.0, np.nan]]},
        uncertainty={"t20": [[0.1, np.nan], [0.2, 0.2]]},
        common_uncertainty={"t20": [0.05, 0.06]},
    )
    tables.write(m, tmp_path / "m.xlsx")
    again = tables.read(tmp_path / "m.xlsx").measurement
    assert again.pairs == m.pairs
    for name in ("values", "uncertainty", "common_uncertainty"):
        there, back = getattr(m, name), getattr(again, name)
        assert there.keys() == back.keys()
        for parameter, values in there.items():  # openpyxl writes 16 digits
            assert back[parameter] == pytest.approx(values, rel=1e-15, nan_ok=True)


def room(folder: Path) -> Path:
    path = folder / "room.toml"
    rt.Room(
        name="hall",
        volume=200,
        materials=["wall"],
        areas=[220],
        alpha=[[0.1, 0.1]],
        sigma=[[0.03, 0.03]],
        centre_frequencies=[125, 250],
        air=rt.Air(),
    ).save(path)
    return path


def test_a_workbook_straight_into_calibrate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "t.xlsx").write_bytes(NAMED["means beside positions"].content)
    where = str(room(tmp_path)), str(tmp_path / "t.xlsx")
    assert run("calibrate", *where, "--out", str(tmp_path / "done"), "--json") == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["measured"]["reverberation_time"] == pytest.approx([1.55, 1.35])
    assert "T20 of 2 pairs in 2 bands; `rtcal table" in printed.err
    assert run("report", str(room(tmp_path)), "--out", str(tmp_path / "tables.xlsx")) == 2
    assert "room.toml" in capsys.readouterr().err


def test_what_a_workbook_leaves_open_is_told_with_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "t.xlsx").write_bytes(book({"RT60": ACROSS}))
    assert run("calibrate", str(room(tmp_path)), str(tmp_path / "t.xlsx")) == 2
    said = capsys.readouterr().err
    assert "state --decay-time t20 or --decay-time t30. `rtcal table" in said
    out = str(tmp_path / "t.csv")
    assert run("table", str(tmp_path / "t.xlsx"), "--decay-time", "t30", "--out", out, "-q") == 0
    assert rt.Measurement.from_file(out).values["t30"][0].tolist() == [1.5, 1.4]


def test_a_command_that_takes_no_workbook_says_how_to_make_a_csv(tmp_path: Path) -> None:
    (tmp_path / "t.xlsx").write_bytes(NAMED["other sheets"].content)
    with pytest.raises(DataError, match=r"`rtcal table .*t\.xlsx` reads other tables"):
        rt.Measurement.from_file(str(tmp_path / "t.xlsx"))


def test_without_openpyxl_the_extra_is_named(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'rtcal\[tables\]'"):
        tables.parse(NAMED["other sheets"].content)
    with pytest.raises(MissingDependencyError, match=r"rtcal\[tables\]"):
        workbook.content({"a": [["x"]]})


def test_a_written_name_is_no_formula_and_names_are_kept_apart() -> None:
    made = openpyxl.load_workbook(io.BytesIO(workbook.content({"a/b": [["name"], ["=1+1"]]})))
    assert made.sheetnames == ["a b"]
    assert made["a b"]["A2"].value == "=1+1"
    assert made["a b"]["A2"].data_type == "s"
    with pytest.raises(DataError, match='tables "a/b" and "A b" have one name in Excel'):
        workbook.content({"a/b": [["x"]], "A b": [["x"]]})


@pytest.mark.parametrize(
    "names",
    [
        ("S1R3", "S1R3"),
        ("S1R3 (1)", "S1R3 (2)"),
        ("S1R3_1", "S1R3_2"),
        ("S1R3 sweep 1", "S1R3 sweep 2"),
    ],
)
def test_repeats_are_proposed_and_read_by_their_usual_names(names: tuple[str, str]) -> None:
    rows = [["Hz", "S1R1", *names], [500, 1.5, 1.2, 1.4], [1000, 1.3, 1.0, 1.2]]
    content = book({"T20": rows})
    with pytest.raises(DataError, match="repeats of one place, state repeats=True"):
        tables.parse(content, "room.xlsx")
    read = tables.parse(content, "room.xlsx", repeats=True).measurement
    of_place = dict(zip(read.pairs, read.values["t20"], strict=True))
    assert len(read.pairs) == 2  # a place each, and not a receiver per sweep
    assert of_place["S1", "R1"] == pytest.approx([1.5, 1.3])
    assert next(v for k, v in of_place.items() if k != ("S1", "R1")) == pytest.approx([1.3, 1.1])


@pytest.mark.parametrize("repeats", [False, True])
def test_sheets_of_other_parameters_are_no_repeats(repeats: bool) -> None:
    """T20, EDT and C80 of sheets "Tabelle1" to "3" had been averaged on the message's own advice."""
    other = [ACROSS[0], *([f, 10 * a, 10 * b] for f, a, b in ACROSS[1:])]
    content = book({"Tabelle1": ACROSS, "Tabelle2": other})
    with pytest.raises(DataError, match="Which parameter does each sheet hold") as refused:
        tables.parse(content, "room.xlsx", parameter="t20", repeats=repeats)
    assert "repeats" not in str(refused.value)
    one = tables.parse(content, "room.xlsx", parameter="t20", sheets=["Tabelle1"])
    assert one.measurement.values["t20"] == pytest.approx(np.array([[1.5, 1.4], [1.6, 1.3]]))
    # Sheets that are named together are meant together.
    both = ["Tabelle1", "Tabelle2"]
    read = tables.parse(content, "room.xlsx", parameter="t20", sheets=both, repeats=True)
    assert len(read.measurement.pairs) == 2


PLACES = [["Position", 500, 1000], ["S1-R1", 1.5, 1.4], ["S2-R1", 1.6, 1.3]]


def test_a_time_that_is_a_third_of_the_others_is_named() -> None:
    rows = [["position", 500], *([f"R{n}", 1.0 + n / 50] for n in range(1, 5)), ["x", 0.05]]
    (doubt,) = tables.parse(book({"T20": rows})).doubts
    assert "0.05 s (S1 to x at 500 Hz" in doubt
    assert "whether the row is a position" in doubt


def test_what_a_sheet_hides_is_left_out_and_what_it_strikes_through_is_said() -> None:
    def change(made: Any) -> None:
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


@pytest.mark.parametrize(
    "content",
    [
        b"f;T20\n500;1.2\n1000;1.1\n",
        b"f;S1R1;S1R2\n500;1.2;1.3\n",
        b"receiver;T20_500\nR1;1.2\nR2;1.3\nmean;1.25\n",
        book({"T20": ACROSS}),
    ],
)
def test_repeats_where_nothing_is_repeated_are_refused(content: bytes) -> None:
    """The option was taken and changed nothing: sweeps under names of their own stayed positions."""
    options = {"parameter": "t20"} if b"S1R1;" in content else {}
    tables.parse(content, **options)
    with pytest.raises(DataError, match="repeats=True changes nothing, since every source"):
        tables.parse(content, repeats=True, **options)
