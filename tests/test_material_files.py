"""Material lists of CATT, ODEON, pyroomacoustics and BRAS: bytes kept, values put in, T told."""

import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import rtcal as rt
from rtcal.io import bras, catt, odeon, pyroomacoustics
from rtcal.io.material_list import dictionaries
from rtcal.support.errors import DataError
from tests import fuzz

FORMATS = {
    "catt": catt,
    "odeon": odeon,
    "pyroomacoustics": pyroomacoustics,
    "bras": bras,
}
FILES = [(name, i) for name in FORMATS for i in range(len(fuzz.READERS[name].seeds))]


@pytest.mark.parametrize(("name", "i"), FILES)
def test_only_calibrated_values_change(name, i, tmp_path):
    content = fuzz.READERS[name].seeds[i]
    path = tmp_path / "a"
    path.write_bytes(content)
    module = FORMATS[name]
    listed = module.read(path)
    first = listed.materials[0]
    room = listed.room(name="hall", volume=500, areas={first.name: 200.0})
    alpha = np.array(room.alpha)
    alpha[0, 1] = 0.123456789
    report = module.write(room.replace(alpha=alpha), path)
    begin, end = first.spans[1]
    old, written = listed.text.characters, path.read_bytes().decode(listed.text.codec)
    assert written[:begin] == old[:begin]
    tail = old[end:]
    assert written[len(written) - len(tail) :] == tail
    number = float(written[begin : len(written) - len(tail)]) * first.unit
    step = 0 if first.decimals is None else 0.5 * first.unit * 10**-first.decimals
    assert abs(number - 0.123456789) <= step + 1e-15
    again = module.read(path).materials[0].alpha
    assert again[1] == pytest.approx(number, rel=1e-14)
    assert again[:1] + again[2:] == first.alpha[:1] + first.alpha[2:]
    assert report.room.alpha[0, 1] == pytest.approx(number, rel=1e-14)


def test_fractions_in_a_list_of_percents_are_refused(tmp_path):
    listed = catt.parse(
        b"ABS wall = <0.02 0.02 0.03 0.03 0.04 0.05>\nABS marble = <1 1 1 1 1 1>\nABS desk = wall\n"
        b"ABS1 door = <0.1 0.1 0.1 0.1 0.1 0.1>\nABS hard = <0 0 0 0 0 0>\nABS felt = <1 2 0.5 3 4 5>\n"
    )
    for name in ("wall", "desk"):
        with pytest.raises(DataError, match=r"line 1: .*is at most 1 %") as refused:
            listed.room(name="hall", volume=1000, areas={name: 700.0})
    assert 'write "ABS1 wall = <0.02 0.02 0.03 0.03 0.04 0.05>" if the' in str(refused.value)
    areas = dict.fromkeys(("marble", "door", "hard", "felt"), 100.0)
    room = listed.room(name="hall", volume=1000, areas=areas)
    assert room.alpha[:, 0].tolist() == [0.01, 0.1, 0.0, 0.01]
    assert "line 2: at most 1 %, since ABS is in percent" in room.sources["marble"]


def test_decimals_can_be_stated(tmp_path):
    path = tmp_path / "hall.geo"
    path.write_bytes(b"ABS wall = <2 2 2 2 2 2>\nABS1 desk = <0.02 0.02 0.02 0.02 0.02 0.02>\n")
    room = catt.read(path).room(name="hall", volume=1000, areas={"wall": 700.0, "desk": 9.0})
    catt.write(room.replace(alpha=np.full((2, 6), 0.0376)), path, decimals=2)
    assert path.read_bytes() == (
        b"ABS wall = <4 4 4 4 4 4>\nABS1 desk = <0.04 0.04 0.04 0.04 0.04 0.04>\n"
    )
    with pytest.raises(DataError, match="decimals = 1 must be from 2 to 15"):
        catt.write(room, path, decimals=1)


def octave_room(**changes):
    frequencies = [63, 125, 250, 500, 1000, 2000, 4000, 8000, 16000]
    rng = np.random.default_rng(4)
    return rt.Room(
        name="hall",
        volume=400,
        materials=["brick", "7 felt"],
        areas=[90, 150],
        alpha=rng.uniform(0.01, 0.99, (2, 9)),
        sigma=np.full((2, 9), 0.1),
        scattering=rng.uniform(0, 1, (2, 9)),
        centre_frequencies=np.array(frequencies),
    ).replace(**changes)


def third_octave_room():
    """Thirds that differ within an octave: the mean of the first is 16.1 %, its middle third 9.5 %."""
    thirds = [[0.05, 0.095, 0.338], [0.2, 0.25, 0.3]]
    alpha = np.array([[a for octave in thirds for a in octave] * 3])
    return rt.Room(
        name="hall",
        volume=1000,
        materials=["wall"],
        areas=[700],
        alpha=alpha,
        sigma=alpha / 10,
        centre_frequencies=rt.acoustics.bands.third_octaves(100, 5000),
    )


@pytest.mark.parametrize("is_new", [True, False])
def test_thirds_are_written_as_their_mean(is_new, tmp_path):
    path, room = tmp_path / "hall.geo", third_octave_room()
    if not is_new:
        path.write_bytes(b"ABS wall = <2 2 2 2 2 2>\r\n")
    report = catt.write(room, path)
    assert b"<16.1 25.0 16.1 25.0 16.1 25.0>" in path.read_bytes()
    as_read = catt.read(path).room(name="", volume=1000, areas={"wall": 700.0})
    t_read = rt.Eyring().reverberation_time(as_read)
    rate = (1 / rt.Eyring().reverberation_time(room)).reshape(6, 3).mean(1)
    assert report.change == pytest.approx((t_read * rate - 1) / 0.05, rel=1e-9)
    # By hand, Eyring without air: the mean of -ln(1 - alpha) is not that of the mean alpha.
    thirds = -np.log(1 - room.alpha[0, :3]).mean() / -np.log(1 - 0.161)
    assert report.change[0] == pytest.approx((thirds - 1) / 0.05, rel=1e-9)
    assert "Alpha is converted from third-octaves to octaves" in str(report)
    assert report.bands_not_written == ()


def test_octaves_are_written_into_each_of_their_thirds(tmp_path):
    path = tmp_path / "wall.csv"
    path.write_bytes(b"material,400,500,630,800\nwall,.1,.2,.3,.4\nfelt,.1,.2,.3,.4\n")
    room = octave_room(materials=["wall", "felt"])
    bras.write(room, path)
    expected = [round(a, 3) for a in (*[room.alpha[0, 3]] * 3, room.alpha[0, 4])]
    assert bras.read(path).materials[0].alpha == pytest.approx(expected)


def test_pyroomacoustics_takes_the_dictionaries():
    library = pytest.importorskip("pyroomacoustics")
    room = octave_room()
    for i, arguments in enumerate(dictionaries(room).values()):
        material = library.Material(**arguments)
        assert material.absorption_coeffs == room.alpha[i].tolist()
        assert material.scattering_coeffs == room.scattering[i].tolist()
    database = Path(library.__file__).parent / "data" / "materials.json"
    listed = pyroomacoustics.read(database)
    expected = json.loads(database.read_text())["absorption"]
    names = [n for category in expected.values() for n in category]
    assert sorted(listed.names) == sorted(names)
    assert listed.with_room(listed.room(name="", volume=1, areas={names[0]: 1.0}))[0] == (
        database.read_bytes()
    )


LEGAL = st.text(st.characters(exclude_categories=("C", "Z"), include_characters=" ;"), min_size=1)


@given(st.lists(LEGAL.filter(str.strip), min_size=2, max_size=2, unique=True))
@example(["Küche Wand", "K_che_Wand"])
@example(['a"b\\;c', "ABS x"])
def test_any_name_that_a_catt_list_is_written_with_is_read_back(names):
    room = octave_room(materials=names)
    areas = dict(zip(names, room.areas, strict=True))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "new.geo")
        for alpha in (room.alpha, 0.9 * room.alpha):
            catt.write(room.replace(alpha=alpha), path)  # the second into the first
            listed = catt.read(path)
            assert listed.names == tuple(names)
            back = listed.room(name="", volume=400, areas=areas)
            np.testing.assert_allclose(back.alpha, alpha[:, 1:], rtol=0, atol=5.1e-4)


def test_refused_writes_leave_the_file(tmp_path):
    path = tmp_path / "hall.geo"
    path.write_bytes(b"ABS brick = <1 2 3 4 5 6>\n")
    with pytest.raises(DataError, match='"7 felt" is not a material of'):
        catt.write(octave_room(), path)
    path.write_bytes(b"not a list of materials\n")
    with pytest.raises(DataError, match="the list has no material"):
        catt.write(octave_room(), path)
    assert path.read_bytes() == b"not a list of materials\n"
    with pytest.raises(DataError, match="without spaces"):
        catt.write(octave_room(), tmp_path / "new.geo", entries={"7 felt": "my felt"})
    low = octave_room(materials=["a", "b"]).in_bands([500.0])
    for module in (catt, odeon):
        with pytest.raises(DataError, match="which the room does not have"):
            module.write(low, tmp_path / "new")
    assert sorted(p.name for p in tmp_path.iterdir() if not p.name.startswith(".rtcal_files")) == [
        "hall.geo"
    ]


def test_a_bras_table_is_read_where_its_columns_say(tmp_path):
    path = tmp_path / "walls.csv"
    path.write_bytes(b"room,material,500\nCR2,wall,.1\nCR3,wall,.2\n")
    (wall,) = bras.read(path, where={"room": "CR3"}).materials
    assert wall.alpha == (0.2,)
