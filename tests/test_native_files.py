"""Native files: what is read is written and read back; what breaks a rule is refused by its place."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.changes import read_treatments, read_variants
from rtcal.finder import Case
from rtcal.support.errors import DataError, RtcalError
from tests.test_bad_input import TIMES
from tests.test_discrepancy import opened

ROOM = """\
name = "hall"
above_one = "clip"
volume = 300
centre_frequencies = [250, 500, 1000]
area_sigma = 0.02
[geometry]
mesh = "room.obj"
surfaces = { south = ["face 3", "face 7"] }
[sources]
S = [1, 2, 3]
[receivers]
R = [1, 2, 2]
[directivity]
S = { index = [0, 3, 6], aim = [1, 0, 0] }
[air]
temperature = 20
humidity = 50
[prior]
relative = 0.2
in_situ_factor = 2.0
iso_12999_2 = true
band_correlation = 0.7
[calibration]
method = "mle"
equation = "Eyring"
measured = "0 1 2"
[[material]]
name = "floor"
area = 100
alpha = [0.1, 0.2, 1.1]
sigma = "moderate"
area_sigma = "3 m²"
[[material]]
name = "rest"
alpha = [0.1, 0.1, 0.1]
source = "a book"
[[correlation]]
materials = ["floor", "rest"]
value = 0.5
[[surface]]
material = "rest"
area = 180
axis = "x"
"""
CASE = """\
room = "room.toml"
equation = "sabine"
[uncertainty]
time = 0.02
level = 0.3
[[configuration]]
name = "as built"
measured = "t.csv"
distances = [6.1, 8.3]
suspect_removed = true
air = { temperature = 21, humidity = 60 }
[configuration.changes.floor]
alpha = [0.1, 0.1, 0.1]
sigma = [0.02, 0.02, 0.02]
[[configuration]]
name = "to do"
parameters = ["t20", "edt"]
positions = 4
"""
TABLE = "source,receiver,parameter,band,value\n" + "".join(
    f"S,R{r},{p},{f},{v + 0.01 * r}\n"
    for p, v in (("T20", 1.5), ("T30", 1.6), ("EDT", 1.4), ("C80", 2.0), ("G", 12.0))
    for r in (1, 2)
    for f in (250, 500, 1000)
)
PANEL = """\
[[material]]
name = "panel"
alpha = [0.5, 0.7, 0.8]
sigma = 0.1
"""
VARIANTS = f"""{PANEL}
[target]
low = 0.4
high = [0.7, 0.7, 0.7]
[[variant]]
name = "panels"
cost = 1800
change = [
    {{ cover = "floor", by = "panel", area = 20 }},
    {{ add = "panel", area = 6 }},
    {{ remove = "rest", area = 1 }},
    {{ open = "rest", area = 1 }},
    {{ air = {{ temperature = 26 }} }},
    {{ volume = 280 }},
]
"""
TREATMENTS = f"""{PANEL}
[target]
high = 1.0
[[treatment]]
name = "panels"
material = "panel"
covers = "floor"
largest = 40
cost = 90
"""
Reader = tuple[str, Callable[[Path], Any]]


def room_of(folder: Path) -> rt.Room:
    (folder / "base.toml").write_text(ROOM, encoding="utf-8")
    return rt.Room.from_file(str(folder / "base.toml"))


def case_of(path: Path) -> Case:
    # A case is of a room as it was before it was calibrated.
    before = ROOM.replace(ROOM[ROOM.index("[calibration]") : ROOM.index("[[material]]")], "")
    (path.parent / "room.toml").write_text(before, encoding="utf-8")
    (path.parent / "t.csv").write_text(TABLE, encoding="utf-8")
    return Case.from_file(str(path))


def saved_case() -> str:
    text: str = json.dumps({**opened().to_dict(), "applied": APPLIED})
    return text


APPLIED = [{"effect": "opening", "parameters": {"area": 2.0}, "size_interval": [1.0, 3.0]}]
READERS: dict[str, Reader] = {
    "room.toml": (ROOM, lambda path: rt.Room.from_file(str(path))),
    "t.csv": (TIMES, lambda path: rt.Measurement.from_file(str(path))),
    "case.toml": (CASE, case_of),
    "case.json": (saved_case(), lambda path: Case.from_file(str(path))),
    "variants.toml": (VARIANTS, lambda p: read_variants(p.read_text("utf-8"), room_of(p.parent))),
    "treatments.toml": (
        TREATMENTS,
        lambda p: read_treatments(p.read_text("utf-8"), room_of(p.parent)),
    ),
}


@pytest.mark.parametrize("name", READERS)
def test_the_whole_format_is_read(name: str, tmp_path: Path) -> None:
    """Every key stands in the text above, so that a key that no longer reads is seen."""
    text, read = READERS[name]
    (tmp_path / name).write_text(text, encoding="utf-8")
    assert read(tmp_path / name)


FLAT = "1" + "0" * 400
BROKEN: dict[str, list[tuple[str, str, str]]] = {
    "room.toml": [
        (ROOM, "", 'lacks the key "volume"'),
        (ROOM, "[sources]\nS = [1, 2, 3]\n", "sources belong to the room's file"),
        ("volume = 300", "volume = ", "not valid TOML"),
        ("volume = 300", f"volume = {'9' * 5000}", "not valid TOML"),
        ("volume = 300", f"volume = {'[' * 200}{']' * 200}", "more than 20 levels"),
        ("volume = 300", ".".join("a" * 600) + " = 1", "a key has more than 500 parts"),
        ("volume = 300", "volmue = 300", 'an unknown key, "volmue"; did you mean "volume"?'),
        ("volume = 300", "colour = 300", 'an unknown key, "colour". Known keys: '),
        ("volume = 300", f"volume = {FLAT}", "too large"),
        *(("volume = 300", f"volume = {v}", "volume = ") for v in ("0", "-1", "nan", "inf")),
        *(("volume = 300", f"volume = {v}", "volume = ") for v in ("1e12", "true", '"1.5"', "[]")),
        ("[250, 500, 1000]", '["250", 500, 1000]', "centre_frequencies[0] = '250'"),
        ("[250, 500, 1000]", "[500, 250, 1000]", "centre frequencies must increase"),
        ("[250, 500, 1000]", "[]", "centre_frequencies is empty"),
        ("volume = 300", "volume = 300\ndimensions = 5", "dimensions = 5"),
        ("volume = 300", "volume = 300\ndimensions = [1, 2, '3']", "dimensions[2] = '3'"),
        ('name = "hall"', "name = [1]", "name = [1] must be a text"),
        ('name = "hall"', 'name = "a\\u001b"', "name has"),
        ('"clip"', '"cut"', "above_one = 'cut' must be one of refuse, clip"),
        ('above_one = "clip"\n', "", 'alpha["floor", 1000 Hz] = 1.1 mus'),
        ("area_sigma = 0.02", "area_sigma = 3", 'area_sigma["rest"] = 3 must be'),
        ('"3 m²"', '"3 m2"', 'area_sigma["floor"] = "3 m2" must be a number with the unit m²'),
        ('"3 m²"', "[3]", 'material "floor": area_sigma = [3]'),
        ("area_sigma = 0.02", "climate_sigma = [2]", "climate_sigma = [2] must be a list of 2"),
        (
            "relative = 0.2",
            "relative = 30",
            "prior.relative = 30 must be a number from 0 to 1. If it is in percent",
        ),
        ("iso_12999_2 = true", "iso_12999_2 = 1", "prior.iso_12999_2 = 1 must be true or false"),
        ("factor = 2.0", "factor = 0.5", "in_situ_factor = 0.5 must be finite and 1 or more"),
        ("correlation = 0.7", "correlation = 1.0", "band_correlation = 1 must be from 0"),
        ("[prior]", "[[prior]]", "prior = [{"),
        ('method = "mle"\n', "", 'calibration lacks the key "method"'),
        ("humidity = 50", "humidity = 0.5", "air.humidity = 0.5 % looks like a fraction"),
        ("area = 100", "area = 0", 'material["floor"].area = 0 m² must be finite and above 0'),
        ("area = 100\n", "", 'area["floor"] is missing, and no [[surface]] has this'),
        ("alpha = [0.1, 0.1, 0.1]", "alpha = [0.1, 0.1]\narea = 3", 'area["rest"] and surfaces'),
        ("[0.1, 0.1, 0.1]", "[0.1, 0.1]", 'material "rest": alpha has 2 values'),
        (
            "[0.1, 0.1, 0.1]",
            "[0.1, 0.1, 50]",
            'alpha["rest", 1000 Hz] = 50 is probably in percent',
        ),
        (
            "[0.1, 0.1, 0.1]",
            '[0.1, "a", 0.1]',
            "material \"rest\": alpha[1] = 'a' must be a number",
        ),
        ('"moderate"', '"middling"', "material \"floor\": sigma = 'middling'"),
        ('name = "rest"', 'name = "floor"', 'has "floor" twice'),
        ('name = "rest"', "", 'material 2 lacks the key "name"'),
        ('source = "a book"', "scattering = 0.3", "scattering"),
        ('source = "a book"', "alpha_min = 0.5", 'alpha["rest", 250 Hz] = 0.1 is below its lower'),
        (
            '["floor", "rest"]',
            '["floor"]',
            "correlation 1: materials = ['floor'] must be a list of 2",
        ),
        ('["floor", "rest"]', '["floor", "door"]', '"door" is not a material of room'),
        ("value = 0.5", "value = 1.5", 'material_correlation["floor", "rest"] = 1.5'),
        ('material = "rest"', 'material = "roof"', "rest"),
        ('axis = "x"', 'axis = "w"', '.axis = "w" must be "x", "y" or "z"'),
        ("[receivers]\nR = [1, 2, 2]\n", "", "receivers is empty, but sources is not"),
        ("R = [1, 2, 2]\n", "", "receivers = {} must be a table with an entry"),
        ("[receivers]", "[receiver]", 'the file has an unknown key, "receiver"'),
        ("R = [1, 2, 2]", "R = [1, 2]", 'receivers["R"] = [1, 2] must be a list of 3 numbers'),
        ('mesh = "room.obj"', "mesh = 3", "geometry.mesh = 3 must be a text"),
        (
            'mesh = "room.obj"',
            "unit = 0.001",
            "unit = 0.001 is the unit of a mesh, but no mesh is given; give mesh, or leave unit out",
        ),
        ('mesh = "room.obj"', "position_uncertainty = 0", "position_uncertainty = 0 m"),
        ('["face 3", "face 7"]', "3", 'geometry.surfaces["south"] = 3 must be a list of texts'),
        (
            "index = [0, 3, 6], ",
            "",
            "exactly one of index, gains and file; this one has none",
        ),
        ("[0, 3, 6]", "99", 'directivity["S"].index[0] = 99 dB must be from 0 to 25 dB'),
        ("aim = [1, 0, 0]", "aim = [0, 0, 0]", 'directivity["S"].aim = '),
        (", aim = [1, 0, 0]", "", 'directivity["S"] lacks the key "aim"'),
    ],
    "t.csv": [
        (TIMES, "", "no rows"),
        (TIMES, "source,receiver\n", 'line 1: column "parameter" is missing'),
        (TIMES, "band;T20\n500;1\n", 'since columns are separated by ";"'),
        ("band,value", "band,value,value", 'column "value" is given twice'),
        ("0.9", "abc", 'line 2: value = "abc" must be a number'),
        ("0.9", "-1", "line 2: T20 = -1 s must be from 0.01"),
        ("0.9", "0" * 200_000, "line 2: not a line of comma-separated values"),
        ("T20,1000", "T99,1000", 'line 3: parameter "T99" is unknown'),
        ("1000", "0", 'line 3: band = "0" must be a frequency above 0'),
        ("1000", "500", "line 3: T20 of S1, R1 at 500 Hz is given twice"),
        ("S1,R1,T20,1000", 'S1,"R1,T20,1000', "line 3: not a line of comma-separated values"),
        ("S1,R1,T20,1000,0.8", "S1,R1", "line 3: this row has 2 cells, but the header has 5"),
        ("S1,R1,T20,1000", "S\0,R1,T20,1000", "a name must not have control characters"),
    ],
    "case.toml": [
        ('"room.toml"', '" "', "no such file"),
        ('"room.toml"', '"none.toml"', "none.toml: no such file"),
        (
            'room = "room.toml"',
            'geometry = {}\nroom = "room.toml"',
            "a case file cannot contain a geometry",
        ),
        ('"sabine"', '"norris"', "equation"),
        ("equation", "equatoin", 'an unknown key, "equatoin"; did you mean "equation"?'),
        *(
            ("time = 0.02", f"time = {v}", "uncertainty.time = ")
            for v in ("true", "0", "-1", "nan")
        ),
        (
            "time = 0.02",
            "time = 2",
            "uncertainty.time = 2 must be a number above 0 to 1. If it is in",
        ),
        ('"as built"', "3", "configuration 1: name = 3 must be a text"),
        ('"t.csv"', '""', "not a file"),
        (
            '"t.csv"',
            '"t.csv"\nt20 = [1, 1, 1]',
            'configuration "as built" has an unknown key, "t20"',
        ),
        *(("= true", f"= {v}", '"as built": suspect_removed = ') for v in ('"false"', "0", "[]")),
        ("temperature = 21", "foo = 1", '"as built": air has an unknown key, "foo"'),
        ("[6.1, 8.3]", "[1e6, 3]", "distances has 1e+06 m, but at most 83.2 m is possible"),
        ("[6.1, 8.3]", "[6.1]", "distances must be 2 values above 0, one per pair"),
        ("changes.floor", "changes.roof", '"roof" is not a material'),
        ("sigma = [0.02, 0.02, 0.02]\n", "", '"as built": changes["floor"] lacks the key "sigma"'),
        ('["t20", "edt"]', '["t20", "t20"]', '"to do": parameters must be a list with t20'),
        ('["t20", "edt"]', '[["t20"]]', '"to do": parameters[0]'),
        ("positions = 4", "positions = 10000000", '"to do": positions = 10000000 must be from 1'),
        ("positions = 4", 'measured = "t.csv"', "measured and parameters are both given"),
    ],
    "case.json": [
        (saved_case(), "[1]", f"the file must hold one JSON object: {...}"),
        (saved_case(), "", "not valid JSON"),
        ('"eyring"', "NaN", "NaN is not a number"),
        ('"eyring"', '"eyring", "equation": "eyring"', "the key 'equation' is given twice"),
        ('"eyring"', '"\\ud800"', "half of a surrogate pair"),
        ('"volume"', '"volmue"', 'room has an unknown key, "volmue"'),
        ('"effect": "opening"', '"effect": "gate"', 'effect "gate" is not in rtcal'),
        ('"area": 2.0', '"area": "2"', "applied 1: parameters[\"area\"] = '2' must be a number"),
        ("[1.0, 3.0]", "[1.0]", "applied 1: size_interval = [1.0] must be a list of 2 numbers"),
    ],
    "variants.toml": [
        (VARIANTS, PANEL, "no [[variant]]"),
        (
            'by = "panel"',
            'by = "panl"',
            'variant "panels": by = "panl" is not a known material. Materials of the room:',
        ),
        ('by = "panel", ', "", "change 1: cover needs by, which is missing"),
        ('add = "panel", area = 6', 'add = "panel"', "add needs an area"),
        (
            "volume = 280",
            "volume = 280, area = 3",
            'a change of the kind "volume" does not use area',
        ),
        ("volume = 280", "area = 3", "a change must have exactly one of cover, add"),
        ("area = 20", "area = 2000", 'variant "panels": '),
        ("cost = 1800", "cost = -1", 'variant "panels": cost = -1'),
        ("alpha = [0.5, 0.7, 0.8]", "", 'material "panel": alpha is missing'),
        ("alpha = [0.5, 0.7, 0.8]", 'catalogue = "carpet"', 'material "panel": "carpet" cannot be'),
        ("sigma = 0.1\n", "", 'material "panel" has no sigma'),
        ('name = "panel"', 'name = "panel"\nsource = 3', 'material "panel": source = 3'),
        (PANEL, PANEL * 2, 'materials has "panel" twice'),
    ],
    "treatments.toml": [
        (
            "high = 1.0",
            'standard = "DIN 18041"\ngroup = "A3"\nhigh = 1',
            "and high are both given",
        ),
        ("high = 1.0", 'standard = "DIN 18041"', 'group = "" must be one of A1'),
        (
            "high = 1.0",
            'standard = "ANSI S12.60"\ngroup = "A3"',
            'group = "A3" belongs to DIN 18041',
        ),
        ("high = 1.0", 'standard = "DIN"', "target.standard = 'DIN' must be \"DIN 18041\" or"),
        ("high = 1.0", "high = [1.0]", "target.high has 1 values; give one for each"),
        ("high = 1.0", "high = 600", "at most 100 s"),
        ("high = 1.0", "", "every low and high is missing"),
        ('material = "panel"', 'material = "panl"', 'treatment "panels": material = "panl" is no'),
        ('covers = "floor"', 'covers = "panel"', 'treatment "panels": covers = "panel" is no'),
        ("largest = 40", "largest = -1", 'treatment "panels": largest = -1'),
        ("largest = 40\n", "", 'treatment "panels" lacks the key "largest"'),
    ],
}


@pytest.mark.parametrize(
    ("name", "old", "new", "place"),
    [(name, *row) for name, rows in BROKEN.items() for row in rows],
)
def test_what_breaks_a_rule_is_refused_with_its_place(
    name: str, old: str, new: str, place: str, tmp_path: Path
) -> None:
    text, read = READERS[name]
    assert old in text
    (tmp_path / name).write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(RtcalError) as caught:
        read(tmp_path / name)
    message = str(caught.value)
    assert place in message
    assert len(message.splitlines()) == 1
    assert len(message) < 500
    message.encode()
    if "read_text" not in read.__code__.co_names:
        assert message.startswith(str(tmp_path)), "the file is not named"


@pytest.mark.parametrize("value", ["true", '"1.5"', "null", "[]", "1" + "0" * 350, "1e999", "{}"])
def test_only_numbers_are_numbers(value: str, tmp_path: Path) -> None:
    path = tmp_path / "case.json"
    for name in ("volume", "area", "alpha", "t20", "band_correlation"):
        data = opened().to_dict()
        values, room = data["configuration"][0]["measured"]["values"], data["room"]
        tables = {"t20": values, "volume": room, "band_correlation": room["prior"]}
        tables.get(name, room["material"][0])[name] = "MARK"
        path.write_text(json.dumps(data).replace('"MARK"', value))
        with pytest.raises(DataError, match=name):
            Case.from_file(str(path))


T20 = {"values": {"t20": [[1] * 7]}}


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"room": None}, "room = None must be a text or a table"),
        ({"room": {"volume": 1}}, 'room lacks the key "centre_frequencies"'),
        ({"uncertainty": 3}, "uncertainty = 3 must be a table"),
        ({"uncertainty": {"noise": 1}}, 'uncertainty has an unknown key, "noise"'),
        ({"climate_uncertainty": [1.0, -1.0]}, "climate_uncertainty = (1.0, -1.0)"),
        ({"configuration": []}, "configurations is empty"),
        ({"configuration": [{"name": "A", "measured": T20}] * 2}, "give each configuration a name"),
        ({"configuration": [3]}, "configuration 1 = 3 must be a table"),
        ({"air": 3}, 'configuration "A": air = 3 must be a table'),
        ({"air": {"wind": 3}}, 'configuration "A": air has an unknown key, "wind"'),
        ({"changes": {"a": {"alpha": 1}}}, 'configuration "A": changes["a"] lacks the key "sigma"'),
        ({"changes": {"z": {"alpha": [0.0] * 7, "sigma": [0.0] * 7}}}, '"z" is not a material'),
        ({"measured": {"values": {}}}, 'configuration "A": measurement: values is empty'),
        ({"measured": {"values": {"edt": [[1] * 7]}}}, "has neither T20 nor T30"),
        (
            {"measured": {"values": {"t20": [[1, 2]]}}},
            "values[t20] has shape (1, 2); it must be (1, 7)",
        ),
        ({"measured": {"values": {"t20": [["1"] * 7]}}}, "'1' must be a number"),
        ({"measured": {"valeus": {}}}, 'measured has an unknown key, "valeus"'),
        ({"measured": 3}, 'configuration "A": measured = 3 must be a text or a table'),
        ({"snr": 3}, 'configuration "A" has an unknown key, "snr"'),
        ({"distances": "far"}, "distances = 'far' must be a list of numbers"),
        ({"distances": [-1]}, "distances must be 1 values above 0"),
    ],
)
def test_what_is_no_case_is_refused_with_its_place(change: dict[str, Any], place: str) -> None:
    data = opened().to_dict()
    keys = {"room", "uncertainty", "climate_uncertainty", "configuration"}
    of_configuration = {"name": "A", "measured": T20} | change
    data |= change if change.keys() <= keys else {"configuration": [of_configuration]}
    with pytest.raises(DataError, match=re.escape(place)):
        Case.from_dict(data)


@pytest.mark.parametrize("name", READERS)
def test_other_encodings_are_refused(name: str, tmp_path: Path) -> None:
    """A guess would change names in silence."""
    text, read = READERS[name]
    (tmp_path / name).write_bytes(text.replace("a", "ä", 1).encode("latin-1", "replace"))
    with pytest.raises((DataError, UnicodeDecodeError), match=r"(?i)utf-8"):
        read(tmp_path / name)


def toml_blocks() -> list[str]:
    """Return the room files in the documents, in the package and above."""
    root = Path(__file__).parents[1]
    documents = [*root.glob("docs/**/*.md"), root / "README.md"]
    found = [b for d in documents for b in re.findall(r"```toml\n(.*?)```", d.read_text(), re.S)]
    found += [p.read_text() for p in (root / "rtcal" / "datasets").rglob("*.toml")]
    return [ROOM, *(b for b in found if "centre_frequencies" in b and "[[material]]" in b)]


@pytest.mark.parametrize("text", toml_blocks())
def test_a_room_s_file_is_written_and_read_back(text: str) -> None:
    room = rt.Room.from_text(text, "room.toml")
    plain = room.to_dict()
    again = rt.Room.from_text(room.to_text(), "again.toml")
    assert {**again.to_dict(), "surfaces": 0} == {**plain, "surfaces": 0}
    assert rt.Room.from_dict(json.loads(json.dumps(plain))).to_dict() == plain
    assert again.to_text() == rt.Room.from_text(again.to_text(), "third.toml").to_text()


def test_names_come_back_whatever_they_are() -> None:
    for name in ('quo"te', "back\\slash", "$\\frac$", "講堂", "[1.0,", "a  b", "#", "'"):
        room, _ = rt.datasets.bras_cr2()
        room = room.replace(name=name, sources={room.materials[0]: name})
        again = rt.Room.from_text(room.to_text(), "room.toml")
        assert again.name == name
        assert again.sources[room.materials[0]] == name


@pytest.mark.parametrize("name", ["=1+1", "+S1", "-R1", "@home", '=HYPERLINK("x")'])
def test_a_name_is_no_formula_to_the_program_that_opens_the_table(
    name: str, tmp_path: Path
) -> None:
    from rtcal.io import tables

    measured = rt.Measurement(
        centre_frequencies=[500, 1000],
        values={"t20": np.array([[1.0, 2.0], [3.0, 4.0]])},
        pairs=[(name, "R1"), ("S2", name)],
    )
    for file in ("t.csv", "t.xlsx"):
        tables.write(measured, tmp_path / file)
        assert tables.measurement(tmp_path / file).measurement.pairs == measured.pairs
    cells = [c for row in csv.reader((tmp_path / "t.csv").open()) for c in row]
    assert sum(name in cell for cell in cells) == 4
    assert not any(cell.startswith(tuple("=+-@")) for cell in cells)
    openpyxl = pytest.importorskip("openpyxl")
    (sheet,) = openpyxl.load_workbook(tmp_path / "t.xlsx").worksheets
    assert not any(cell.data_type == "f" for row in sheet.iter_rows() for cell in row)
