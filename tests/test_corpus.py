"""Files with the oddities of real exports: each gives what it means, or one line that says why not."""

import numpy as np
import pytest

import rtcal as rt
from benchmarks import drawn_tables
from rtcal.io import bras, catt, instruments, library, obj, odeon, pyroomacoustics, tables
from rtcal.io.text import decode
from rtcal.support.errors import DataError
from tests import corpus

READERS = {
    "bras": bras,
    "catt": catt,
    "library": library,
    "modes": rt.modes,
    "obj": obj,
    "odeon": odeon,
    "pyroomacoustics": pyroomacoustics,
    "tables": tables,
}
WRITTEN = {"bras", "catt", "odeon", "pyroomacoustics"}


@pytest.mark.parametrize("case", corpus.CASES, ids=lambda c: c.name)
def test_each_file_gives_what_it_means(case, tmp_path):
    endings = {"library": ".xlsx" if case.sheets else ".csv", "modes": ".csv"}
    path = tmp_path / f"file{endings.get(case.reader, '')}"
    path.write_bytes(case.content)
    read, options = READERS[case.reader].read, case.options
    if case.error is not None:
        with pytest.raises(DataError, match=case.error) as refusal:
            read(path, **case.options)
        assert str(path) in str(refusal.value)
        assert "\n" not in str(refusal.value)
        if case.values is None and case.alpha is None:
            return
        filled = drawn_tables.filled_in(str(refusal.value))
        assert filled
        options = {**case.options, "columns": filled}
    result = read(path, **options)
    if case.volume is not None:
        assert result.volume == pytest.approx(case.volume, rel=1e-9)
    elif case.values is not None:
        expected = {tuple(key): value for *key, value in case.values}
        assert values(result.measurement) == pytest.approx(expected, rel=1e-12)
        assert all(said in str(result) for said in case.said)
    else:
        assert {m.name: list(m.alpha) for m in result.materials} == case.alpha
        sources = " ".join(m.source for m in result.materials)
        assert all(said in sources for said in case.said)
    if case.reader in WRITTEN:
        copy = tmp_path / "copy"
        room = result.room(name="", volume=60, areas=dict.fromkeys(result.names, 10.0))
        READERS[case.reader].write(room, copy, template=path)
        assert copy.read_bytes() == case.content


def values(measured):
    """All values of a measurement by source, receiver, parameter and band."""
    return {
        (*pair, parameter, f): float(value)
        for parameter, table in measured.values.items()
        for pair, row in zip(measured.pairs, table, strict=True)
        for f, value in zip(measured.centre_frequencies.tolist(), row, strict=True)
        if np.isfinite(value)
    }


OF_INSTRUMENTS = [
    case
    for case in corpus.CASES
    if case.reader == "tables" and instruments.recognises(case.content)
]


@pytest.mark.parametrize("case", OF_INSTRUMENTS, ids=lambda c: c.name)
def test_an_instrument_is_known_by_its_text_in_every_encoding(case, tmp_path):
    text = decode(case.content).characters
    for codec in ("utf-8-sig", "utf-16"):
        (tmp_path / "file").write_bytes(text.encode(codec))
        if case.values is None:
            with pytest.raises(DataError, match=case.error):
                tables.read(tmp_path / "file", **case.options)
        else:
            read = values(tables.read(tmp_path / "file", **case.options).measurement)
            assert read == {tuple(key): value for *key, value in case.values}


BAFFLE = (0.45, 0.9, 1.0)


def test_a_table_of_one_product_has_the_name_of_its_file(tmp_path):
    (tmp_path / "Baffle.csv").write_text("Frequency;alpha_s\n250;0,45\n500;0,9\n1000;1,1\n")
    assert library.read(tmp_path / "Baffle.csv").listed("Baffle").alpha == BAFFLE


def test_a_folder_is_a_library(tmp_path, rtcal):
    folder = tmp_path / "products"
    folder.mkdir()
    with pytest.raises(DataError, match="the folder has no file that ends in"):
        library.read(folder)
    (folder / "walls.csv").write_text("product;250;500;1000\nBrick;0,02;0,03;0,04\n")
    (folder / "baffle.xlsx").write_bytes(corpus.NAMED["products, e.xlsx"].content)
    assert [*library.read(folder).names] == ["Baffle", "Brick"]
    out = tmp_path / "room.toml"
    areas = ("--volume", 200, "--area", "walls=200", "--area", "Baffle=20")
    command = ("import", "library", folder, *areas, "--out", out)
    assert "edge effect" in rtcal(*command, "--as", "walls=Brick", "--name", "Studio 1")
    room = rt.Room.from_file(str(out))
    assert (room.name, room.materials) == ("Studio 1", ("walls", "Baffle"))
    assert room.alpha.tolist() == [[0.02, 0.03, 0.04], [*BAFFLE]]
    assert '"walls"' in rtcal.refused(*command)
    (folder / "again.csv").write_text("product;250;500;1000\nBrick;0,02;0,03;0,04\n")
    with pytest.raises(DataError, match=r'"Brick" is given twice, also in .*again\.csv'):
        library.read(folder)
