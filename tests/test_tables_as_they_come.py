"""Tables as measuring systems and offices have them: workbooks, REW's, the XL2's and Dirac's text."""

from __future__ import annotations

import datetime
import io
import json
import sys
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest

import rtcal as rt
from rtcal.command.main import main
from rtcal.io import budget, table_columns, tables, workbook
from rtcal.support.errors import DataError, MissingDependencyError
from tests.damage import damages

Cells = Sequence[Sequence[Any]]


def book(sheets: Mapping[str, Cells], change: Callable[[Any], None] | None = None) -> bytes:
    made = openpyxl.Workbook()
    made.remove(made.active)
    for name, rows in sheets.items():
        sheet = made.create_sheet(name)
        for row in rows:
            sheet.append(list(row))
    if change is not None:
        change(made)
    stream = io.BytesIO()
    made.save(stream)
    return stream.getvalue()


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(arguments)
    return int(end.value.code or 0)


T = {("S1", "R1"): (1.5, 1.4), ("S1", "R2"): (1.6, 1.3)}
"""T20 in s at 125 and 250 Hz, which each of the following tables holds."""

ACROSS = [["Frequency (Hz)", "S1R1", "S1R2"], [125, 1.5, 1.6], [250, 1.4, 1.3]]
SAME: dict[str, bytes] = {
    "positions across, the sheet names the parameter": book({"T20": ACROSS}),
    "with its unit": book(
        {"T20 (ms)": [ACROSS[0], *([f, a * 1000, b * 1000] for f, a, b in ACROSS[1:])]}
    ),
    "a title names it": book({"Sheet1": [["T20 [s]"], ["Hall X"], *ACROSS]}),
    "the corner names it": book({"Sheet1": [["T20 [s]", "S1R1", "S1R2"], *ACROSS[1:]]}),
    "bands across, the corner names it": book(
        {"Sheet1": [["T20", "125 Hz", "250 Hz"], ["S1R1", 1.5, 1.4], ["S1R2", 1.6, 1.3]]}
    ),
    "one sheet per position": book(
        {
            "S1R1": [["f", "T20"], [125, 1.5], [250, 1.4]],
            "S1R2": [["f", "T20"], [125, 1.6], [250, 1.3]],
        }
    ),
    "merged headers": book(
        {
            "x": [
                ["", "S1R1", "", "S1R2", ""],
                ["Frequency", "T20", "EDT", "T20", "EDT"],
                [125, 1.5, 9, 1.6, 9],
                [250, 1.4, 9, 1.3, 9],
            ]
        }
    ),
    "merged rows": book(
        {
            "T20": [
                ["source", "receiver", "125", "250"],
                ["S1", "R1", 1.5, 1.4],
                [None, "R2", 1.6, 1.3],
            ]
        },
        lambda b: b["T20"].merge_cells("A2:A3"),
    ),
    "means beside positions": book(
        {
            "T20": [
                ["f", "S1R1", "S1R2", "Mean", "Std. dev."],
                [125, 1.5, 1.6, 1.55, 0.05],
                [250, 1.4, 1.3, 1.35, 0.05],
            ]
        }
    ),
    "text with decimal commas": book(
        {"T20": [ACROSS[0], ["125", "1,5", "1,6"], ["250", "1,4", "1,3"]]}
    ),
    "other sheets": book({"Notes": [["measured by", "X"]], "T20": ACROSS, "Plan": [["a"]]}),
    "a hidden sheet": book(
        {"T20": ACROSS, "old": ACROSS}, lambda b: setattr(b["old"], "sheet_state", "hidden")
    ),
    "Dirac's text": (
        "T20 [s]\t125\t250\n\t\t\nS1R1\t1,5\t1,4\nS1R2\t1,6\t1,3\n\nNumber of Measurements\t2\t2\n"
        "Average\t1,55\t1,35\nStd. dev.\t0,07\t0,07\n"
    ).encode("cp1252"),
    "positions across in CSV": b"Frequency;S1R1;S1R2\n125;1,5;1,6\n250;1,4;1,3\n",
    "REW, two measurements": "".join(
        f"RT60 data saved by REW V5.40\nNote: x\nDated: Aug 23, 2026\nMeasurement: {name} "
        "Aug 23\n\nFormat is freq (Hz), BW (octaves), EDT (s), r, T20 (s), r, Topt (s), r, reverse/"
        f"forward filtered, D50 (%)\n\n125 1/1 9.0 -0.97 {a} -0.99 1.6 -0.99 Zero Phase 55.0\n"
        f"250 1/1 9.0 -0.99 {b} -0.99 1.6 -0.99 Forward 55.0\n\nfull 1/1 1 -1 1 -1 1 -1 Forward 50\n"
        for name, (a, b) in (("S1R1", T["S1", "R1"]), ("S1R2", T["S1", "R2"]))
    ).encode(),
}
STATED = {"positions across in CSV": {"parameter": "t20"}}


INSTRUMENT = [
    ["Model", "Model 831"],
    ["Measurement Description", "RT60"],
    [],
    ["Frequency (Hz)", "Leq (dB)", "T20 (ms)", "BT:T20", "BK:T20 (dB SNR)", "NL:T20 (‰)"],
    ["125 Hz", 92.8, 1500, 24.1, 53.4, 34.1],
    ["250 Hz", 95.0, 1400, 79.0, 60.9, 33.6],
    [],
    ["RT60 Measurement Grade"],
    ["Decays per Position", 4, "Octave", "1/1", "1/1", "1/1", "1/1"],
    ["426A12", 1, 2, 3],
]
"""A summary of a Larson Davis 831, with what stands above and below it, in its workbooks' form."""

APP = """App measurement
Input: phone; granted: yes, no

Band (Hz) |   EDT   |  RT60   | Metric
       63 | 1.1 s   |    —    | unmeasurable
      125 | 1.2 s   | 1.5 s   | t20
      250 | 1.3 s   | 1.4 s   | t30
Mid-band RT60: 1.4 s
(Estimates | from a phone)"""


def test_what_an_instrument_writes_around_its_table_is_left_out() -> None:
    read = tables.parse(book({"Summary": INSTRUMENT}), "RT_Data.xlsx")
    assert read.measurement.values["t20"][0] == pytest.approx([1.5, 1.4], rel=1e-15)
    assert any('line 8 on it is no table: "RT60 Measurement Grade"' in c for c in read.columns)
    detail = [["Decay #", "Frequency (Hz)", "T20 (ms)"], [1, 125, 1500]]
    two = book({"Summary": INSTRUMENT, "RT60 Detail": detail})
    with pytest.raises(
        DataError, match=r'"Decay #" is no parameter.*; or read only sheets="Summary"'
    ):
        tables.parse(two, "RT_Data.xlsx")
    chosen = tables.parse(two, "x", sheets=["Summary"]).measurement
    assert chosen.to_dict() == read.measurement.to_dict()


def test_a_row_that_says_its_decay_time_is_believed() -> None:
    with pytest.raises(
        DataError, match=r"line 6: the row says .t20., and .RT60. is stated to be T30"
    ):
        tables.parse(APP.encode(), "app.txt", decay_time="t30")
    of_rows = tables.parse(APP.replace("RT60   |", "value  |").encode(), "app.txt").measurement
    assert of_rows.values["t20"][0, 1] == 1.5
    assert of_rows.values["t30"][0, 2] == 1.4
    assert of_rows.values["edt"].tolist() == [[1.1, 1.2, 1.3]]


def test_a_band_typed_wrong_below_the_others_is_no_text_below_the_table() -> None:
    with pytest.raises(DataError, match='line 3: band "25O" is no frequency'):
        tables.parse(b"Frequency;T20\n125;1.5\n25O;1.4\n", "t.csv")


@pytest.mark.parametrize("receiver", ["Mikrofon", "Microphone", "Mic", "Empfänger"])
@pytest.mark.parametrize(
    "source", ["Lautsprecher", "Schallquelle", "Speaker", "Loudspeaker", "Sender", "Quelle"]
)
def test_two_loudspeakers_are_two_sources_and_no_repeats(source: str, receiver: str) -> None:
    text = f"{source};{receiver};Band;T20 [s]\nL1;M1;500;1,0\nL2;M1;500;2,0\n"
    found = tables.parse(text.encode()).measurement
    assert found.pairs == (("L1", "M1"), ("L2", "M1"))
    assert found.values["t20"].tolist() == [[1.0], [2.0]]


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
        "2 values are missing, since a formula has an error: #DIV/0! in line 2, #WERT! in line 4"
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


def test_a_spanish_position_is_a_source_and_a_receiver() -> None:
    assert table_columns.position_in("Globo F1-P9 10:52:30") == ("F1", "P9")


@pytest.mark.parametrize("name", SAME)
def test_the_same_values_in_every_shape(name: str) -> None:
    m = tables.parse(SAME[name], **STATED.get(name, {})).measurement
    assert m.pairs == tuple(T)
    assert m.values["t20"] == pytest.approx(np.array([*T.values()]), rel=1e-15)
    assert m.centre_frequencies.tolist() == [125, 250]


def test_what_is_left_out_is_said() -> None:
    said = {name: str(tables.parse(SAME[name])) for name in SAME if name not in STATED}
    assert '"Mean": left out' in said["means beside positions"]
    assert 'left out, without a header: "Notes", "Plan"' in said["other sheets"]
    assert 'left out, hidden: "old"' in said["a hidden sheet"]
    assert "means and deviations beside single positions are left out" in said["Dirac's text"]
    assert "REW calls unreliable (r below 0.98): EDT at 125 Hz" in said["REW, two measurements"]
    assert '"S1R2": T20 of S1 to R2' in said["a title names it"]


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
    text = SAME["REW, two measurements"].decode()
    cut = text.index("RT60 data", 5)
    (tmp_path / "a.txt").write_text(text[:cut].replace(" 1.5 ", " 0.000 "))
    (tmp_path / "b.txt").write_text(text[cut:])
    m = tables.read([tmp_path / "a.txt", tmp_path / "b.txt"]).measurement
    assert m.pairs == (("S1", "R1"), ("S1", "R2"))
    assert np.isnan(m.values["t20"][0, 0])
    assert m.values["t20"][1, 0] == 1.6
    assert m.values["d50"][0, 0] == pytest.approx(0.55, rel=1e-12)


@pytest.mark.parametrize("separator", ["\t", ";", ", "])
def test_rew_with_every_separator(separator: str) -> None:
    text = SAME["REW, two measurements"].decode().replace("Zero Phase", "Zero_Phase")
    rows = [
        separator.join(line.split()) if line[:3] in ("125", "250") else line
        for line in text.replace("Zero_Phase", "Zero-Phase").splitlines()
    ]
    assert tables.parse("\n".join(rows).encode()).measurement.values["t20"][1].tolist() == [
        1.6,
        1.3,
    ]


def test_rew_with_octaves_and_thirds_must_be_told_which() -> None:
    text = SAME["REW, two measurements"].decode()
    thirds = text.replace("250 1/1", "250 1/3").encode()
    with pytest.raises(DataError, match=r"line 6: bands of 1/1 and 1/3 octave; state where="):
        tables.parse(thirds)
    m = tables.parse(thirds, where={"BW (octaves)": "1/3"}).measurement
    assert m.centre_frequencies.tolist() == [250]


XL2 = """XL2 RT60 Reporting:\tMyProject\\2026_RT60_004_Report.txt
# RT60 Average Results

\tBand    \tRT60(T20)\tMeasUnct
\t[Hz]    \t[s]      \t[%]
\t63      \t-.--     \t-.--
\t125     \t1.50     \t6.00
\t250     \t1.40     \t-.--

# RT60 Cycle Results

\tBand [Hz]:\t63\t\t125\t\t250
\t          \tT20\tCorreltn\tT20\tCorreltn\tT20\tCorreltn
\tCYCLE     \t[s]\t[%]\t[s]\t[%]\t[s]\t[%]
\t01        \t-.--\t-.--\t1.45\t99.5\t1.40\t99.9
\t02        \t-.--\t-.--\t1.55\t99.5\t-.--\t-.--
#CheckSum
"""


def test_an_xl2_report_has_its_averages_and_their_uncertainty() -> None:
    read = tables.parse(XL2.encode())
    m = read.measurement
    assert m.pairs == (("S1", "2026_RT60_004_Report"),)
    assert m.centre_frequencies.tolist() == [125, 250]
    assert m.values["t20"].tolist() == [[1.5, 1.4]]
    assert m.uncertainty["t20"][0, 0] == pytest.approx(0.09, rel=1e-12)
    assert not any("not the mean" in line for line in read.columns)


def test_an_xl2_report_whose_averages_contradict_its_decays_is_told() -> None:
    changed = XL2.replace("125     \t1.50", "125     \t1.20").replace("63      \t-.--", "63\t0.20")
    said = "\n".join(tables.parse(changed.encode()).columns)
    assert "63 Hz (no decay), 125 Hz (1.20 s, of decays with a mean of 1.50 s)" in said
    with pytest.raises(DataError, match="Band, RT60\\(T20\\) and MeasUnct are missing"):
        tables.parse(XL2.replace("MeasUnct", "x").encode())
    with pytest.raises(DataError, match="no row of a band"):
        tables.parse(XL2[: XL2.index("\t63  ")].encode())


def formula(made: Any) -> None:
    made["T20"]["B2"] = "=1+0.5"


def dated(made: Any) -> None:
    made["T20"]["B2"] = datetime.datetime(2026, 5, 1)


def zipped(name: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr(name, "<a/>")
    return stream.getvalue()


BAD: list[tuple[bytes, str]] = [
    (book({"T20": ACROSS}, formula), r'sheet "T20", cell B2: a formula without its stored value'),
    (
        book({"T20": ACROSS}, dated),
        r'sheet "T20", line 2: "2026-05-01 .* \(Excel\'s date\)" is not',
    ),
    (
        book({"Sheet1": ACROSS}),
        r'line 2: no heading says which parameter the value "1.5" is; state it: parameter=',
    ),
    (
        b"Nachhallzeit T30 [s], Wohnzimmer\nPosition;125 Hz;250 Hz\nS1-R1;0,66;0,6\n",
        'line 3: no heading says .* state it: parameter="t30", if the title means this table',
    ),
    (book({"RT60": ACROSS}), r'sheet "RT60": "RT60" does not say which decay time it is'),
    (book({"a": [["x"]]}), r'sheet "a", line 1: column "x" is no parameter'),
    (
        book({"T20": ACROSS, "T20 (s)": ACROSS}),
        r'sheet "T20 \(s\)", line 2: T20 of S1, R1 .* twice',
    ),
    (book({"T20": [ACROSS[0], [125, "long", 1]]}), r'sheet "T20", line 2: "long" is not a finite'),
    (book({"T20": [ACROSS[0], [125, "NaN", 1]]}), r'line 2: "NaN" is not a finite number'),
    (book({"T20": []}), "no visible sheet has a cell"),
    (b"\xd0\xcf\x11\xe0" + bytes(600), r"Excel's old format \(xls\); save it as xlsx"),
    (b"%PDF-1.7 " + bytes(600), "a PDF; copy its table into a workbook"),
    (b"\x89HDF\r\n\x1a\n" + bytes(600), "a SOFA .* file: `rtcal measure` reads"),
    (b"PK\x03\x04broken", r"not a workbook \(xlsx\)"),
    (zipped("content.xml"), r"a zip file, but no workbook \(xlsx\)"),
    (zipped("xl/workbook.xml"), r"cannot be read as a workbook"),
    (b"RT60 data saved by REW V5\nMeasurement: a\n", "line 1: REW's line \"Format is freq"),
    (
        b"RT60 data saved by REW V5\nFormat is freq (Hz), BW (octaves), T20 (s)\n",
        "line 2: no row of",
    ),
    (
        b"RT60 data saved by REW V5\nFormat is freq (Hz), BW (octaves), T20 (s)\n125 1/1\n",
        "line 3: 2 cells; REW's format line names 3",
    ),
]


@pytest.mark.parametrize(("content", "rule"), BAD)
def test_bad_tables(content: bytes, rule: str) -> None:
    with pytest.raises(DataError, match=rule):
        tables.parse(content)


MEANS = [["Mean", "", "", "", 1.3], ["", "Mean", "T20", 500, 1.3], ["Mean", "", "T20", 500, 1.3]]


@pytest.mark.parametrize("row", MEANS)
def test_a_row_of_means_beside_positions_is_left_out(row: list[object]) -> None:
    header = ["source", "receiver", "parameter", "band", "value"]
    single = [["S1", "R1", "T20", 500, 1.2], ["S1", "R2", "T20", 500, 1.4]]
    read = tables.parse(book({"T": [header, *single, row]}))
    assert read.measurement.pairs == (("S1", "R1"), ("S1", "R2"))
    left_out = "rows of means and deviations beside single positions are left out"
    assert f'{left_out}: "Mean"' in read.columns


@pytest.mark.parametrize("name", SAME)
def test_broken_tables_raise_typed_errors(name: str) -> None:
    refused = 0
    for damaged in damages(SAME[name], 40):
        try:
            tables.parse(damaged, **STATED.get(name, {}))
        except DataError:
            refused += 1
    assert refused > 3


def test_a_workbook_that_unpacks_to_too_much_is_not_unpacked(monkeypatch) -> None:
    monkeypatch.setattr(budget, "MAX_UNPACKED", 1000)
    with pytest.raises(DataError, match="bytes when unpacked; at most 1000"):
        tables.parse(book({"T20": ACROSS}))


def test_sheets_are_chosen_by_name() -> None:
    both = book({"before": ACROSS, "after": [ACROSS[0], [125, 1.1, 1.2]]})
    m = tables.parse(both, parameter="t20", sheets=["after"]).measurement
    assert m.values["t20"].tolist() == [[1.1], [1.2]]
    with pytest.raises(DataError, match='sheets="then" is no sheet; they are "before", "after"'):
        tables.parse(both, parameter="t20", sheets=["then"])
    with pytest.raises(
        DataError, match='parameter="edt" is stated, and the table\'s name "T20" says T20'
    ):
        tables.parse(SAME["positions across, the sheet names the parameter"], parameter="edt")


def test_a_share_shown_in_percent_is_a_share() -> None:
    def shown(made: Any) -> None:
        made["D50"]["B2"].number_format = "0.0%"

    content = book({"D50": [["f", "S1R1"], [500, 0.556]]}, shown)
    assert tables.parse(content).measurement.values["d50"][0, 0] == pytest.approx(0.556, rel=1e-12)
    with_unit = book({"D50 (%)": [["f", "S1R1"], [500, 55.6]]})
    assert tables.parse(with_unit).measurement.values["d50"][0, 0] == pytest.approx(
        0.556, rel=1e-12
    )


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


def test_a_workbook_straight_into_calibrate_and_its_tables_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "t.xlsx").write_bytes(SAME["means beside positions"])
    where = str(room(tmp_path)), str(tmp_path / "t.xlsx")
    assert run("calibrate", *where, "--out", str(tmp_path / "done"), "--json") == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["measured"]["reverberation_time"] == pytest.approx([1.55, 1.35])
    assert "T20 of 2 pairs in 2 bands; `rtcal table" in printed.err
    out = tmp_path / "tables.xlsx"
    assert run("report", str(tmp_path / "done"), "--out", str(out), "-q") == 0
    made = openpyxl.load_workbook(out)
    assert made.sheetnames[:3] == ["summary", "bands", "materials"]
    header = [cell.value for cell in made["bands"][1]]
    at = header.index("reverberation_time_after")
    assert [row[at] for row in made["bands"].iter_rows(min_row=2, values_only=True)] == (
        pytest.approx([1.55, 1.35], rel=1e-6)
    )
    record = json.loads((tmp_path / "done" / "result.json").read_text())
    alpha = record["materials"][0]["alpha_after"]
    header = [cell.value for cell in made["materials"][1]]
    at = header.index("alpha_after 125 Hz")
    assert made["materials"].cell(2, at + 1).value == pytest.approx(alpha[0], rel=1e-15)
    assert run("report", str(room(tmp_path)), "--out", str(out)) == 2
    assert "room.toml: not JSON" in capsys.readouterr().err


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
    (tmp_path / "t.xlsx").write_bytes(SAME["other sheets"])
    with pytest.raises(DataError, match=r"t\.xlsx: a workbook, and no CSV: `rtcal table .*t\.csv`"):
        rt.Measurement.from_file(str(tmp_path / "t.xlsx"))


def test_without_openpyxl_the_extra_is_named(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'rtcal\[tables\]'"):
        tables.parse(SAME["other sheets"])
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
    assert one.measurement.values["t20"] == pytest.approx(np.array(list(T.values())))
    # Sheets that are named together are meant together.
    both = ["Tabelle1", "Tabelle2"]
    read = tables.parse(content, "room.xlsx", parameter="t20", sheets=both, repeats=True)
    assert len(read.measurement.pairs) == 2


@pytest.mark.parametrize(
    ("sheet", "odd", "usual", "said_as"),
    [
        ("C80", 72.9, 12.9, "C80 of 72.9 dB"),
        ("T20", 41.0, 4.1, "T20 of 41 s"),
        ("Ts", 9.0, 0.9, "Ts of 9 s"),  # in ms, as a small room has it, without the unit
        ("EDT", 0.002, 0.2, "EDT of 0.002 s"),
        ("G", 94.0, 24.0, "G of 94 dB"),  # a level
    ],
)
def test_a_value_that_hardly_any_room_has_is_told(
    sheet: str, odd: float, usual: float, said_as: str, tmp_path: Path
) -> None:
    rows = [["Hz", "S1R1", "S1R2"], [500, odd, usual], [1000, usual, usual]]
    read = tables.parse(book({sheet: rows}), "room.xlsx")
    said = f"hardly any room has {said_as} (S1 to R1 at 500 Hz): look whether"
    assert said in " ".join(str(read).split())
    rows[1][1] = usual
    assert tables.parse(book({sheet: rows}), "room.xlsx").doubts == ()
    tables.write(read.measurement, tmp_path / "t.csv")  # the native table is read without a word
    assert tables.measurement(tmp_path / "t.csv").doubts == read.doubts


@pytest.mark.parametrize(
    ("decimals", "changed", "said"), [(3, 0.0, True), (3, 0.002, False), (1, 0.0, False)]
)
def test_a_renamed_copy_is_told(decimals: int, changed: float, said: bool) -> None:
    """Counted as positions, copies make the mean T surer than it is. Rounded values may agree."""
    times = np.array([1.514, 1.411, 1.313, 1.212])
    table = np.vstack([times, 1.02 * times, times]).round(decimals)
    table[2, 1] += changed
    measured = rt.Measurement(
        centre_frequencies=[250, 500, 1000, 2000],
        values={"t20": table},
        pairs=[("S1", "R1"), ("S1", "R2"), ("S1", "R3")],
    )
    doubts = " ".join(tables.Table(measured, ()).doubts)
    assert ("the same values in every band: S1 to R3 and S1 to R1. If one" in doubts) == said


def test_a_column_of_remarks_is_left_out_and_said() -> None:
    """A German table with "Bemerkung" had been refused."""
    content = (
        "Messung;H\u00f6rsaal 3;;\n\nMessposition;Frequenz [Hz];T30 [s];EDT [s];Bemerkung\n"
        "S1-M1;500;1,02;0,98;\nS1-M2;500;1,05;1,01;gest\u00f6rt\n"
    ).encode("cp1252")
    read = tables.parse(content, "messung.csv")
    assert read.measurement.pairs == (("S1", "M1"), ("S1", "M2"))
    assert read.measurement.values["t30"][:, 0].tolist() == [1.02, 1.05]
    assert '"Bemerkung": left out' in read.columns


@pytest.mark.parametrize("words", [("Src", " Mic"), ("Source ", ", Receiver "), ("Quelle", "-Pos")])
def test_positions_in_words_are_source_and_receiver(words: tuple[str, str]) -> None:
    """A sheet with "Src1 Mic1" across, its mean and its deviation had been refused."""
    source, receiver = words
    names = [f"{source}1{receiver}{i}" for i in (1, 2)]
    rows = [["Freq (Hz)", *names, "Average", "Std dev"], [500, 1.0, 1.1, 1.05, 0.07]]
    read = tables.parse(book({"RT30": rows}), "gym.xlsx")
    first, second = read.measurement.pairs
    assert first[0] == second[0] == f"{source}1"
    assert first[1] == f"{receiver.lstrip(' ,-')}1"
    assert read.measurement.values["t30"][:, 0].tolist() == [1.0, 1.1]
    assert {'"Average": left out', '"Std dev": left out'} <= {*read.columns}


def aurora(*, rows: Sequence[str] = ("S1_R1", "S2_R1"), share: str = "41.2") -> bytes:
    """Lines as AcouPar of Aurora writes them: a row per file, no units, weighted ranges."""
    ranges = ("500 ", "1000 ", "A    ", "Lin  ")
    header = [
        "Filename",
        *(f"{p}_{r}" for p in ("Lsg", "D50", "ts ", "T20", "Imp") for r in ranges),
    ]
    cells = 4 * ["81.0"] + 4 * [share] + 4 * ["95.5"] + 4 * ["1.25"] + 4 * ["8.0"]
    lines = ["Acoupar.exe - ISO3382 Acoustical Parameter File", "\t".join(header)]
    lines += ["\t".join([f"IR\\hall_{place}.wav", *cells]) for place in rows]
    return ("\r\n".join(lines) + "\r\n").encode()


def test_a_file_of_aurora_is_read_as_it_comes() -> None:
    table = tables.parse(aurora())
    m = table.measurement
    assert m.pairs == (("S1", "R1"), ("S2", "R1"))
    assert m.centre_frequencies.tolist() == [500, 1000]
    assert set(m.values) == {"d50", "ts", "t20"}
    for key, value in (("d50", 0.412), ("ts", 0.0955), ("t20", 1.25)):
        np.testing.assert_allclose(m.values[key], value, rtol=1e-12)
    assert "D50 has no unit, and is read in %: no other fits" in str(table)
    assert "Ts has no unit, and is read in ms: no other fits" in str(table)


@pytest.mark.parametrize("d50", [["41", "0.5", "44"], ["41", "44"], ["41", "44", "441"]])
def test_a_unit_is_told_by_all_values_or_by_none(d50: Sequence[str]) -> None:
    rows = "\n".join(f"R{i},{value}" for i, value in enumerate(d50))
    with pytest.raises(DataError, match=r"is it in percent|is not from 0 to 1"):
        tables.parse(f"receiver,D50 500 Hz\n{rows}\n".encode())


@pytest.mark.parametrize(
    ("header", "parameter", "value"),
    [
        ("D50_500 [%]", "d50", 0.5),
        ("D50 [%]_500", "d50", 0.5),
        ("D50 [%] 500 Hz", "d50", 0.5),
        ("D50 500 Hz [%]", "d50", 0.5),
        ("ts_500 [ms]", "ts", 0.05),
        ("Ts (ms) 500 Hz", "ts", 0.05),
        ("C80 [dB] 500 Hz", "c80", 50.0),
    ],
)
def test_a_header_has_band_and_unit_in_any_order(header: str, parameter: str, value: float) -> None:
    m = tables.parse(f"receiver,{header}\nR1,50\n".encode()).measurement
    assert m.values[parameter].tolist() == [[pytest.approx(value, rel=1e-12)]]
    assert m.centre_frequencies.tolist() == [500]


def test_a_file_beside_a_position_is_left_out() -> None:
    m = tables.parse(b"file,source,receiver,T20 500 Hz\nS9_R9.wav,S1,R2,1.5\n").measurement
    assert m.pairs == (("S1", "R2"),)


@pytest.mark.parametrize("cell", [">10", "< 0.2", "\u22650.4"])
def test_a_limit_is_no_value(cell: str) -> None:
    with pytest.raises(DataError, match="is a limit and no value: empty the cell"):
        tables.parse(f"receiver,T30 500 Hz\nR1,{cell}\n".encode())


PLACES = [["Position", 500, 1000], ["S1-R1", 1.5, 1.4], ["S2-R1", 1.6, 1.3]]


@pytest.mark.parametrize(
    "below",
    [
        ["Anmerkung: 63 Hz nicht auswertbar", None, None],
        ["Standardabw.", 0.05, 0.06],
        ["\u00d8", 1.55, 1.35],
        ["Moyenne", 1.55, 1.35],
        ["Streuung", 0.1, 0.1],
    ],
)
def test_what_stands_below_positions_is_no_position(below: Sequence[Any]) -> None:
    m = tables.parse(book({"T20": [*PLACES, below]})).measurement
    assert m.pairs == (("S1", "R1"), ("S2", "R1"))
    assert m.values["t20"].tolist() == [[1.5, 1.4], [1.6, 1.3]]


def test_a_row_among_positions_that_is_none_is_named() -> None:
    with pytest.raises(
        DataError, match='line 4: "JND" is no position as "S1-R1" is; if the row is'
    ):
        tables.parse(book({"T20": [*PLACES, ["JND", 0.05, 0.05]]}))


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


ODEON_LIKE = """Single Point response
Band (Hz)\t500\t1000
T(15) (s)\t1.75\t1.70
T(20) (s)\t1.76\t1.71
Curvature(C)\t1.1\t1.2
Ts (ms)\t120\t118
D(50)\t0.38\t0.39
SPL(A) = 16.6 dB
"""
WITH_CORRELATION = """Octave(Hz)\t500\t1000\tA-wtd
T30(s)\t1.78\t1.73\t1.6
-r T30\t0.999\t1.000\t1
T20(s)\t1.76\t1.71\t1.6
rT20\t--,--\t1.000\t1
r(T20)\t0.999\t1.000\t1
"""


@pytest.mark.parametrize("content", [ODEON_LIKE, WITH_CORRELATION])
def test_rows_of_quality_and_remarks_are_left_out(content: str) -> None:
    m = tables.parse(content.encode()).measurement
    assert m.centre_frequencies.tolist() == [500, 1000]
    assert m.values["t20"].tolist() == [[1.76, 1.71]]
    if "D(50)" in content:
        assert m.values["d50"].tolist() == [[0.38, 0.39]]
    else:
        assert m.values["t30"].tolist() == [[1.78, 1.73]]


def test_dashes_with_a_decimal_mark_are_no_value() -> None:
    m = tables.parse(
        b"position;T20 500 Hz;T20 1000 Hz\nQ1-M1;--,--;1,5\nQ1-M2;1,4;1,5\n"
    ).measurement
    assert m.pairs == (("Q1", "M1"), ("Q1", "M2"))
    np.testing.assert_array_equal(m.values["t20"], [[np.nan, 1.5], [1.4, 1.5]])


def test_a_blank_before_a_number_makes_no_other_place() -> None:
    with pytest.raises(DataError, match='the receiver "R1" and the receiver "R 1"'):
        tables.parse(b"position,T20 500 Hz\nR1,1.5\nR 1,1.5\n")


BANDS_OF_AURORA = (63.0, 250.0, 1000.0, 4000.0)
ROWS_OF_AURORA = {  # by name in the file: rtcal's key, the file's values, and the factor to rtcal's
    "Signal [dB]": ("", (61.0, 62.5, 60.25, 58.125), 1.0),
    "strenGth [dB]": ("", (7.5, 7.25, 6.125, 5.0), 1.0),
    "C50 [dB]": ("c50", (-3.25, -1.5, 0.125, 1.75), 1.0),
    "C80 [dB]": ("c80", (-0.5, 0.75, 2.375, 4.0), 1.0),
    "D50 [%]": ("d50", (32.5, 41.25, 50.75, 59.875), 0.01),
    "Ts [ms]": ("ts", (142.5, 121.25, 98.75, 71.125), 0.001),
    "EDT [s]": ("edt", (1.875, 1.625, 1.5, 1.125), 1.0),
    "Tuser [s]": ("", (1.8, 1.7, 1.55, 1.2), 1.0),
    "T20 [s]": ("t20", (1.95, 1.7, 1.525, 1.25), 1.0),
    "T30 [s]": ("t30", (2.05, 1.75, 1.55, 1.275), 1.0),
    "Impulsivs [dB]": ("", (12.0, 13.0, 14.0, 15.0), 1.0),
}


def of_aurora(kind: str, n_channels: int = 1) -> str:
    """A file as Aurora writes it; channel n has n - 1 hundredths more in every value."""
    mark = "," if kind == "comma between columns" else "\t"
    head = "Aurora 5.0 - ISO3382 Acoustical Parameter File\r\n"
    names = ["63", "250", "1k", "4k"]

    def cells(values: Sequence[float], channel: int) -> list[str]:
        written = [f"{value + 0.01 * (channel - 1):.4f}" for value in values]
        return [w.replace(".", ",") for w in written] if kind == "decimal comma" else written

    if kind == "one row per file":
        header = [f"{name}_{band}" for name in ROWS_OF_AURORA for band in [*names, "A", "Lin"]]
        lines = [["Filename", *header]]
        for channel in range(1, n_channels + 1):
            row = [f"S2_R7 Ch {channel}"]
            for _, values, _ in ROWS_OF_AURORA.values():
                row += [*cells(values, channel), "--", " 1.0"]
            lines.append(row)
        return head + "\r\n" + "".join("\t".join(line) + "\r\n" for line in lines)
    text = head + "ISO 3382  OCTAVE BAND ACOUSTICAL PARAMETERS\r\n\r\n"
    for channel in range(1, n_channels + 1):
        lines = [["Filename", "Frq.band [Hz]", *names, "A", "Lin"]]
        lines += [
            ["room_S2_R7", name, *cells(values, channel), "--", " 1.0"]
            for name, (_, values, _) in ROWS_OF_AURORA.items()
        ]
        text += f"Channel {channel} Parameters\r\n\r\n"
        text += "".join(mark.join(line) + "\r\n" for line in lines)
        text += "\r\nRTU = RT User (-5.0 dB, -20.0 dB)\r\n\r\n"
    return text


@pytest.mark.parametrize(
    "kind", ["tabs", "comma between columns", "decimal comma", "one row per file"]
)
@pytest.mark.parametrize("n_channels", [1, 2, 4])
def test_aurora_is_read_by_channel(kind: str, n_channels: int) -> None:
    """Every layout of it was refused: the column of parameters is called "Frq.band [Hz]"."""
    table = tables.parse(of_aurora(kind, n_channels).encode(), "room.txt")
    names = ["R7"] if n_channels == 1 else [f"R7-{n + 1}" for n in range(n_channels)]
    measured = table.measurement
    assert measured.pairs == tuple(("S2", name) for name in names)
    assert measured.centre_frequencies.tolist() == list(BANDS_OF_AURORA)
    held = {own for own, _, _ in ROWS_OF_AURORA.values() if own}
    assert {*measured.values} == held == {"edt", "c50", "c80", "d50", "ts", "t20", "t30"}
    for own, values, factor in ROWS_OF_AURORA.values():
        for channel in range(n_channels if own else 0):
            expected = factor * (np.array(values) + 0.01 * channel)
            assert measured.values[own][channel] == pytest.approx(expected)
    assert any("each is a receiver" in line for line in table.columns) == (n_channels > 1)


def test_channels_that_are_repeats_are_averaged() -> None:
    read = tables.parse(of_aurora("tabs", 3).encode(), "room.txt", repeats=True).measurement
    expected = np.array(ROWS_OF_AURORA["T20 [s]"][1]) + 0.01
    np.testing.assert_allclose(np.mean(read.values["t20"], axis=0), expected)
    assert len(read.pairs) == 1


def test_receivers_that_are_called_channels_keep_their_names() -> None:
    read = tables.parse(b"receiver;T20_500\nCh1;1.2\nCh2;1.3\n").measurement
    assert read.pairs == (("S1", "Ch1"), ("S1", "Ch2"))


COLUMN = "Frq.band [Hz]"


@pytest.mark.parametrize("name", ROWS_OF_AURORA)
@pytest.mark.parametrize("stated", ["t20", "edt", "c80", "ts", None])
def test_rows_are_of_the_parameter_that_they_say(name: str, stated: str | None) -> None:
    """EDT was read as T20: the selected rows say one parameter, the option another."""
    content = of_aurora("tabs").encode()
    own, values, factor = ROWS_OF_AURORA[name]
    where = {COLUMN: name}
    if own and stated in (own, None):
        table = tables.parse(content, "room.txt", where=where, parameter=stated)
        assert table.measurement.values[own][0] == pytest.approx(factor * np.array(values))
        assert {*table.measurement.values} == {own}
        return
    rule = f'parameter="{stated}" is stated, and where=.* says' if own else "has no use for"
    with pytest.raises(DataError, match=rule):
        tables.parse(content, "room.txt", where=where, parameter=stated)


def test_a_room_may_be_called_as_a_parameter_is() -> None:
    content = b"room;f;value\nD50;500;1.2\nD49;500;1.5\n"
    read = tables.parse(content, where={"room": "D50"}, parameter="t20").measurement
    assert read.values["t20"].tolist() == [[1.2]]


def test_rows_and_columns_that_name_two_parameters_are_refused() -> None:
    content = b"what;f;T20 [s]\nEDT;500;1.2\nC80;500;1.5\n"
    with pytest.raises(DataError, match=r'selects rows of EDT, and the column "T20 \[s\]" is T20'):
        tables.parse(content, where={"what": "EDT"})


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
