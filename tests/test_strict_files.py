"""Content that no native file may hold: readers refuse it in one line with place, value and rule."""

from __future__ import annotations

import csv
import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder import Case
from rtcal.finder.finding import Detection
from rtcal.support.errors import DataError, ModelError
from tests.test_discrepancy import opened


def refused(read: Callable[[], object], *words: str) -> None:
    with pytest.raises(DataError) as caught:
        read()
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    assert len(message) < 400
    message.encode()
    for word in words:
        assert word in message, message


def case_text() -> str:
    return opened().to_json()


READERS: dict[str, tuple[Callable[[], str], Callable[[str], Any], str]] = {
    "case": (case_text, Case.from_file, '"equation": "eyring"'),
}


@pytest.fixture(params=sorted(READERS))
def reader(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[str, str, Callable[..., None]]:
    """A good text, an entry of it, and a check that another text is refused."""
    make, read, entry = READERS[request.param]
    path = tmp_path / f"{request.param}.json"

    def check(text: str, *words: str) -> None:
        path.write_text(text, encoding="utf-8")
        refused(lambda: read(str(path)), str(path), *words)

    path.write_text(make(), encoding="utf-8")
    read(str(path))  # the text is good
    return make(), entry, check


def test_json_readers_are_strict(reader: tuple[str, str, Callable[..., None]]) -> None:
    text, entry, check = reader
    key = entry.split('"')[1]
    check(text.replace(entry, f'{entry}, "{key[:-2]}no": 1'), f'has the key "{key[:-2]}no"')
    check(text.replace(entry, f"{entry}, {entry}"), f"the key '{key}' is given twice")
    for value in ("NaN", "Infinity", "-Infinity"):
        check(text.replace(entry, f'"{key}": {value}'), f"{value} is no number")
    check(text.replace(entry, f'"{key}": {"9" * 5000}'), "an integer of 5000 digits")
    check(text.replace(entry, f'"{key}": {"[" * 100_000}'), "more than 20 levels")
    check(text.replace(entry, f'"{key}": {"[" * 100}{"]" * 100}'), "more than 20 levels")
    check(text.replace(entry, f'"{key}": "\\ud800"'), "half of a surrogate pair")
    check("[1]", "not a JSON object")
    check("", "not JSON")


@pytest.mark.parametrize("name", sorted(READERS))
def test_json_in_latin_1_is_refused(name: str, tmp_path: Path) -> None:
    """JSON is UTF-8 (RFC 8259): a guess would change names in silence."""
    make, read, _ = READERS[name]
    path = tmp_path / f"{name}.json"
    text = make().replace("seminar room", "Saal in München").replace('"hall"', '"Bühne"')
    assert "ü" in text
    path.write_text(text, encoding="utf-8")
    read(str(path))
    path.write_bytes(text.encode("latin-1", "replace"))
    refused(lambda: read(str(path)), str(path), "UTF-8")


def test_a_finding_without_a_number_is_none() -> None:
    """NaN is no JSON, and no evidence: such a finding is refused before it is written."""
    found = rt.find(opened())
    with pytest.raises(ModelError, match=r"score.*is nan nats"):
        dataclasses.replace(found, detection=Detection(float("nan"), 1.0))


@pytest.mark.parametrize("value", ["true", '"1.5"', "null", "[]", "1" + "0" * 350, "1e999", "{}"])
def test_only_numbers_are_numbers(value: str, tmp_path: Path) -> None:
    path = tmp_path / "case.json"
    for name in ("volume", "areas", "alpha", "t20", "band_correlation"):
        data = opened().to_dict()
        entries = data["configurations"][0] if name == "t20" else data["room"]
        entries[name] = "MARK"
        path.write_text(json.dumps(data).replace('"MARK"', value))
        refused(lambda: Case.from_file(str(path)), str(path), name)


def test_a_misspelt_key_is_refused_at_every_level(tmp_path: Path) -> None:
    path = tmp_path / "case.json"
    places: list[Callable[[dict[str, Any]], dict[str, Any]]] = [
        lambda data: data,
        lambda data: data["room"],
        lambda data: data["configurations"][0],
        lambda data: data["configurations"][0]["uncertainty"],
        lambda data: data["present"][0],
    ]
    for place in places:
        data = opened().to_dict()
        data["present"] = [{"effect": "opening", "parameters": {"area": 2.0}}]
        Case.from_dict(data)
        place(data)["equatoin"] = "sabine"
        path.write_text(json.dumps(data))
        refused(lambda: Case.from_file(str(path)), str(path), "equatoin")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("volume = " + "9" * 5000, ("not valid TOML",)),
        ("volume = 0x" + "f" * 5000, ("volume", "too large")),
        ("volume = 1" + "0" * 400, ("volume", "too large")),
        ("volume = 1e999", ("volume = inf is not finite",)),
        ("volume = nan", ("volume = nan is not finite",)),
        ("volume = true", ("volume = True is not a number",)),
        ('volume = "1.5"', ("volume = '1.5' is not a number",)),
        ("volume = " + "[" * 5000, ("more than 20 levels",)),
        ("volume = " + "[" * 200 + "]" * 200, ("more than 20 levels",)),
        ("volume = 1\nvolume = 2", ("not valid TOML", "overwrite")),
        ("volume = 1\nvolmue = 2", ('the file has the key "volmue"',)),
    ],
)
def test_toml_readers_are_strict(text: str, words: tuple[str, ...], tmp_path: Path) -> None:
    room = tmp_path / "room.toml"
    material = '[[material]]\nname = "a"\narea = 1\nalpha = [0.1]\nsigma = 0\n'
    more = f"\ncentre_frequencies = [500]\n{material}"
    room.write_text(text + more)
    refused(lambda: rt.Room.from_file(str(room)), str(room), *words)


@pytest.mark.parametrize(
    "text", ["equation = " + "9" * 5000, "equation = " + "[" * 5000, "equatoin = 'sabine'"]
)
def test_a_case_in_toml_is_read_strictly(text: str, tmp_path: Path) -> None:
    case = tmp_path / "case.toml"
    case.write_text(f"room = 'room.toml'\n{text}\n")
    refused(lambda: Case.from_file(str(case)), str(case))


def test_a_room_and_a_measurement_are_their_plain_values() -> None:
    room, measured = rt.datasets.bras_cr2()
    again = rt.Room.from_dict(json.loads(json.dumps(room.to_dict())))
    assert again.to_dict() == room.to_dict()
    assert again.to_text() == room.to_text()
    plain = json.loads(json.dumps(measured.to_dict()))
    assert rt.Measurement.from_dict(plain).to_dict() == measured.to_dict()
    with pytest.raises(DataError, match="valeus"):
        rt.Measurement.from_dict({**plain, "valeus": {}})


def test_a_saved_case_keeps_its_room_whole(tmp_path: Path) -> None:
    """Correlations between materials, sources and surfaces were lost in a saved case."""
    case = opened()
    first, second = case.room.materials[:2]
    room = case.room.replace(material_correlation={(first, second): 0.5}, sources={first: "a book"})
    path = tmp_path / "case.json"
    Case(room=room, configurations=case.configurations).save(str(path))
    again = Case.from_file(str(path)).room
    assert again.material_correlation == {(first, second): 0.5}
    assert again.sources == {first: "a book"}


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
