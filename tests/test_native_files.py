"""Native files: what is read is written and read back; what breaks a rule is refused by its place."""

import csv
import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.changes import read_treatments, read_variants
from rtcal.finder import Case
from rtcal.support.errors import DataError, RtcalError
from tests.conftest import measurement_of
from tests.test_discrepancy import opened

FOLDER = Path(__file__).parent / "native"
"""Good files, in which every key stands, and `broken.toml`."""
ROOM, TABLE = ((FOLDER / name).read_text("utf-8") for name in ("room.toml", "pairs.csv"))


def room_of(folder):
    (folder / "base.toml").write_text(ROOM, encoding="utf-8")
    return rt.Room.from_file(str(folder / "base.toml"))


def case_of(path):
    # A case is of a room as it was before it was calibrated.
    before = ROOM.replace(ROOM[ROOM.index("[calibration]") : ROOM.index("[[material]]")], "")
    (path.parent / "room.toml").write_text(before, encoding="utf-8")
    (path.parent / "t.csv").write_text(TABLE, encoding="utf-8")
    return Case.from_file(str(path))


def saved_case():
    text = json.dumps({**opened().to_dict(), "applied": APPLIED})
    return text


APPLIED = [{"effect": "opening", "parameters": {"area": 2.0}, "size_interval": [1.0, 3.0]}]
READERS = {
    "room.toml": lambda path: rt.Room.from_file(str(path)),
    "t.csv": lambda path: rt.Measurement.from_file(str(path)),
    "case.toml": case_of,
    "case.json": lambda path: Case.from_file(str(path)),
    "variants.toml": lambda p: read_variants(p.read_text("utf-8"), room_of(p.parent)),
    "treatments.toml": lambda p: read_treatments(p.read_text("utf-8"), room_of(p.parent)),
}


def good(name):
    return saved_case() if name == "case.json" else (FOLDER / name).read_text("utf-8")


@pytest.mark.parametrize("name", READERS)
def test_the_whole_format_is_read(name, tmp_path):
    """Every key stands in it, so that a key that no longer reads is seen."""
    (tmp_path / name).write_text(good(name), encoding="utf-8")
    assert READERS[name](tmp_path / name)


BROKEN = [
    (name, *row)
    for name, rows in tomllib.loads((FOLDER / "broken.toml").read_text("utf-8")).items()
    for row in rows
]
BROKEN += [
    ("room.toml", "volume = 300", f"volume = {'[' * 200}{']' * 200}", "more than 20 levels"),
    ("room.toml", "volume = 300", ".".join("a" * 600) + " = 1", "a key has more than 500 parts"),
    ("t.csv", "0.9", "0" * 200_000, "line 2: not a line of comma-separated values"),
]


@pytest.mark.parametrize(("name", "old", "new", "place"), BROKEN)
def test_what_breaks_a_rule_is_refused_with_its_place(name, old, new, place, tmp_path):
    text, read = good(name), READERS[name]
    assert old in text
    (tmp_path / name).write_text(text.replace(old or text, new), encoding="utf-8")
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
def test_only_numbers_are_numbers(value, tmp_path):
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
        ({"uncertainty": 3}, "uncertainty = 3 must be a table"),
        ({"climate_uncertainty": [1.0, -1.0]}, "climate_uncertainty = (1.0, -1.0)"),
        ({"configuration": []}, "configurations is empty"),
        ({"configuration": [{"name": "A", "measured": T20}] * 2}, "give each configuration a name"),
        ({"configuration": [3]}, "configuration 1 = 3 must be a table"),
        ({"air": 3}, 'configuration "A": air = 3 must be a table'),
        ({"changes": {"a": {"alpha": 1}}}, 'configuration "A": changes["a"] lacks the key "sigma"'),
        ({"changes": {"z": {"alpha": [0.0] * 7, "sigma": [0.0] * 7}}}, '"z" is not a material'),
        ({"measured": {"values": {}}}, 'configuration "A": measurement: values is empty'),
        ({"measured": {"values": {"edt": [[1] * 7]}}}, "has neither T20 nor T30"),
        ({"measured": {"values": {"t20": [[1, 2]]}}}, "values[t20] has shape (1, 2)"),
        ({"measured": {"values": {"t20": [["1"] * 7]}}}, "'1' must be a number"),
        ({"measured": 3}, 'configuration "A": measured = 3 must be a text or a table'),
        ({"distances": "far"}, "distances = 'far' must be a list of numbers"),
    ],
)
def test_what_is_no_case_is_refused_with_its_place(change, place):
    data = opened().to_dict()
    keys = {"room", "uncertainty", "climate_uncertainty", "configuration"}
    of_configuration = {"name": "A", "measured": T20} | change
    data |= change if change.keys() <= keys else {"configuration": [of_configuration]}
    with pytest.raises(DataError, match=re.escape(place)):
        Case.from_dict(data)


@pytest.mark.parametrize("name", READERS)
def test_other_encodings_are_refused(name, tmp_path):
    """A guess would change names in silence."""
    content = good(name).replace("a", "ä", 1).encode("latin-1", "replace")
    (tmp_path / name).write_bytes(content)
    with pytest.raises((DataError, UnicodeDecodeError), match=r"(?i)utf-8"):
        READERS[name](tmp_path / name)


def toml_blocks():
    """Return the room files in the documents, in the package and above."""
    root = Path(__file__).parents[1]
    documents = [*root.glob("docs/**/*.md"), root / "README.md"]
    found = [b for d in documents for b in re.findall(r"```toml\n(.*?)```", d.read_text(), re.S)]
    found += [p.read_text() for p in (root / "rtcal" / "datasets").rglob("*.toml")]
    return [ROOM, *(b for b in found if "centre_frequencies" in b and "[[material]]" in b)]


@pytest.mark.parametrize("text", toml_blocks())
def test_a_room_s_file_is_written_and_read_back(text):
    room = rt.Room.from_text(text, "room.toml")
    plain = room.to_dict()
    again = rt.Room.from_text(room.to_text(), "again.toml")
    assert {**again.to_dict(), "surfaces": 0} == {**plain, "surfaces": 0}
    assert rt.Room.from_dict(json.loads(json.dumps(plain))).to_dict() == plain
    assert again.to_text() == rt.Room.from_text(again.to_text(), "third.toml").to_text()


def test_names_come_back_whatever_they_are():
    for name in ('quo"te', "back\\slash", "$\\frac$", "講堂", "[1.0,", "a  b", "#", "'"):
        room, _ = rt.datasets.bras_cr2()
        room = room.replace(name=name, sources={room.materials[0]: name})
        again = rt.Room.from_text(room.to_text(), "room.toml")
        assert again.name == name
        assert again.sources[room.materials[0]] == name


@pytest.mark.parametrize("name", ["=1+1", "+S1", "-R1", "@home", '=HYPERLINK("x")'])
def test_a_name_is_no_formula_to_the_program_that_opens_the_table(name, tmp_path):
    from rtcal.io import tables

    measured = measurement_of(
        [500, 1000], [(name, "R1"), ("S2", name)], t20=np.array([[1.0, 2.0], [3.0, 4.0]])
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
