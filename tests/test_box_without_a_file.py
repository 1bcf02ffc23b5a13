"""A box by its sides and materials, and T by an option: questions as people ask them in public."""

import io
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.changes import Change, changed, facing
from rtcal.command.finder import read_case
from rtcal.io import units
from rtcal.simulators import Polyhedron
from rtcal.support.errors import DataError, InfeasibleError
from tests.conftest import room_of, run

FT = 0.3048
SIX = [125, 250, 500, 1000, 2000, 4000]


def box(sides, floor, ceiling, walls, *more):
    return ["--dimensions", sides, "--floor", floor, "--ceiling", ceiling, "--walls", walls, *more]


Question = tuple[list[str], list[str], float, dict[float, float]]


def question(row):
    """Return a row's name; the options of the room and of T, its volume, and its T by band."""
    name, *described, more, measured, volume, times = (cell.strip() for cell in row.split("|"))
    kind, value = measured.split(" ", 1)
    numbers = [
        t.split(":") if ":" in t else [f, t] for f, t in zip(SIX, times.split(), strict=False)
    ]
    t = {float(f): float(value) for f, value in numbers}
    return name, (box(*described, *shlex.split(more)), [f"--{kind}", value], float(volume), t)


ASKED = Path(__file__).with_name("asked.txt").read_text(encoding="utf-8")
ROWS = ASKED.replace("\\\n", "").strip().splitlines()
QUESTIONS = dict(question(row) for row in ROWS if not row.startswith("#"))


@pytest.mark.parametrize("asked", QUESTIONS)
def test_a_question_is_answered(asked, tmp_path, rtcal):
    described, measured, volume, times = QUESTIONS[asked]
    path = tmp_path / "room.toml"
    answer = json.loads(rtcal("room", *described, *measured, "--out", path, "--json"))[
        "calibration"
    ]
    room = rt.Room.from_file(str(path))
    assert room.volume == pytest.approx(volume, rel=1e-3)
    (x, y, z), _ = units.sides(described[1])
    assert room.total_area == pytest.approx(2 * (x * y + y * z + x * z), rel=1e-9)
    np.testing.assert_allclose(facing(room).sum(axis=1), 1)
    after = dict(zip(answer["centre_frequencies"], answer["reverberation_time_after"], strict=True))
    assert {f: after[f] for f in times} == pytest.approx(times, rel=1e-6)
    assert sum(t is not None for t in answer["measured"]["reverberation_time"]) == len(times)


CLASSROOM = QUESTIONS["classroom of the issue"][0]


@pytest.mark.parametrize("asked", ["classroom of the issue", "garage calculator", "church"])
def test_one_command_is_the_two_that_it_names(asked, tmp_path, rtcal, monkeypatch):
    monkeypatch.chdir(tmp_path)
    described, measured, *_ = QUESTIONS[asked]
    both = ("room", *described, *measured, "--out", "a.toml", "--name", "room")
    named = re.search("and then `rtcal (.*?)`", rtcal(*both))
    one = json.loads(rtcal(*both, "--json"))["calibration"]
    rtcal("room", *described, "--out", "b.toml", "--name", "room")
    two = json.loads(rtcal(*shlex.split(named[1]), "--json"))
    assert one.pop("solver").keys() == two.pop("solver").keys()  # with the time it took
    assert one == two
    assert Path("a.toml").read_text() == Path("b.toml").read_text()
    assert "Nothing is written" in rtcal("room", *described, *measured)


def test_the_library_makes_the_room_of_the_command(tmp_path):
    path = tmp_path / "room.toml"
    assert run("room", *CLASSROOM, "--out", path, "-q") == 0
    written = rt.Room.from_file(str(path))
    walls = {"west": "brick", **dict.fromkeys(("east", "south", "north"), "plaster")}
    made = rt.Room.from_geometry(
        Polyhedron.shoebox((9, 7, 3), walls | {"floor": "carpet", "ceiling": "acoustic_tile"}),
        patches=[("west", "glazing", 4.5), ("south", "wood_door", 2)],
        dimensions=(9, 7, 3),
        name="room",
        air=rt.Air(20, 50),
        centre_frequencies=SIX,
        materials=[replace(written.material(m), area=None) for m in written.materials],
    )
    assert made.surfaces == written.surfaces
    assert dict(zip(made.materials, made.areas, strict=True)) == dict(
        zip(written.materials, written.areas, strict=True)
    )
    np.testing.assert_allclose(made.absorption_area, written.absorption_area)


def test_coefficients_belong_to_their_place(tmp_path, rtcal):
    path = tmp_path / "room.toml"
    pieces = ["--window", "west=4.5:0.1", "--window", "west=20 ft2:0.3", "--door", "west=1:0.1"]
    rtcal("room", *box("30' x 20'x 10'", "0.2", "carpet", "0.2", *pieces), "--out", path)
    room = rt.Room.from_file(str(path))
    areas = dict(zip(room.materials, room.areas.tolist(), strict=True))
    pieces_of_west = {"piece of west": 5.5, "piece of west (2)": 20 * FT**2}
    each = {"floor": 600 * FT**2, "carpet": 600 * FT**2} | pieces_of_west
    assert areas == pytest.approx(each | {"walls": 1000 * FT**2 - sum(pieces_of_west.values())})
    stated = {"floor": 0.2, "walls": 0.2, "piece of west": 0.1, "piece of west (2)": 0.3}
    assert {name: room.material(name).alpha[0] for name in stated} == stated


def test_questions_in_the_terminal(tmp_path, capsys, monkeypatch):
    asked, given = tmp_path / "asked.toml", tmp_path / "given.toml"
    answers = ["9x7", "9x7x3", "xyzzy", "carpet", "acoustic tile", "plaster", "", "55"]
    answers += [str(asked), "nothing", "west=4.5:glazing", "west=17:glazing", "south=2:door", ""]
    answers += ["persons", "sofa=2", "persons=0", "persons=9999", "persons=20", "desks=15", ""]
    answers += ["0.9 0.8", "900 800 700 700 600 600", "0.9 0.8 0.7 0.7 0.6 0.6"]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(answers) + "\n"))
    assert run("room", "--ask") == 0
    said = capsys.readouterr()
    for told in (
        "has 2 numbers, but must have 3",
        'no material like "xyzzy"',
        "no piece",
        '"west" has 16.5 m² left',
        '--object "persons" = 9999 is too large',
        "has 2 numbers, but must have 6",
        "900 s must be from 0.01 to 120 s",
    ):
        assert told in said.err
    assert "and then `rtcal calibrate" in " ".join(said.out.split())
    options = box(
        "9,7,3", "carpet", "acoustic tile", "plaster", *("--temperature", "20", "--humidity", "55")
    )
    options += ["--window", "west=4.5:glazing", "--door", "south=2:door", "--name", "asked"]
    options += ["--object", "persons=20", "--object", "desks=15"]
    assert run("room", *options, "--out", given) == 0
    assert given.read_text() == asked.read_text()


def test_questions_that_end_early_write_nothing(tmp_path, rtcal, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("9,7,3\ncarpet\n"))
    said = rtcal.refused("room", "--ask", "--out", tmp_path / "room.toml")
    assert "still missing: --ceiling, --walls" in said
    assert not [*tmp_path.iterdir()]


def test_a_file_of_others_stays(tmp_path, rtcal):
    path = tmp_path / "room.toml"
    path.write_text("mine")
    command = ["room", *box("9,7,3", "carpet", "plaster", "brick"), "--out", path]
    assert "--force" in rtcal.refused(*command)
    assert path.read_text() == "mine"
    rtcal(*command, "--force")
    assert rt.Room.from_file(str(path)).volume == pytest.approx(189)


@pytest.mark.parametrize(
    ("changed", "place"),
    [
        ("--dimensions '9 7'", 'sides: "9 7" has 2 numbers'),
        ("--dimensions '9m x 700cm x 3m'", "sides in different units"),
        ("--dimensions 9x7x0", "side = 0 m"),
        ("--dimensions '9000 7000 3000'", "it is 189 m³ in mm"),
        ("--dimensions '3000x2000x1000 ft'", "it is 6 m³ in mm"),
        ("--dimensions '9,7,3 km'", '--dimensions "km"'),
        ("--floor xyzzy", 'floor: the catalogue has no material like "xyzzy"'),
        ("--floor xyzzy --ask", 'rtcal: floor: the catalogue has no material like "xyzzy"'),
        ("--floor '10 10 20 20 30 30'", "floor: alpha = 10 at 125 Hz"),
        ("--floor '0.1 0.2'", "has 2 numbers, but must have 1 or 6"),
        ("--floor '125:0.1 250:0.1'", "floor: alpha at 500 Hz is missing"),
        ("--floor=-0.1", "floor: alpha = -0.1 at 125 Hz"),
        ("--wall left=brick", '"left" is not a wall'),
        ("--window west:4.5=glazing", "WALL=M2:MATERIAL"),
        ("--window up=4.5:glazing", '"up" is not a surface'),
        ("--window west=40:glazing", '"west" has 21 m² left'),
        ("--window west=-1:glazing", "west=-1:glazing: area = -1 m²"),
        ("--window west=1.5x3:glazing", '"1.5x3"'),
        ("--audience 200", "--audience: 200 persons"),
        ("--temperature 200", "200"),
        ("--out room.csv", "room.csv"),
        ("--temperature 20 --t20 4000:25", "cannot be reached"),
        ("--t20 500:0.5 --t30 500:0.5", "--t20 and --t30 are both given"),
        ("--t20 ''", "--t20 is empty"),
        ("--t20 '500:0.9 kHz:2'", 'has no value after "500:"'),
        ("--t20 '500:0.9 1000:'", 'has no value after "1000:"'),
        ("--t20 '900 800 700 700 600 600'", "900 s must be from 0.01 to 120 s"),
    ],
)
def test_what_is_wrong_is_named_and_nothing_is_written(changed, place, tmp_path, rtcal):
    command = ["room", *box("9,7,3", "carpet", "plaster", "brick"), "--out", tmp_path / "room.toml"]
    assert place in rtcal.refused(*command, *shlex.split(changed))
    assert not [*tmp_path.iterdir()]


def test_what_is_missing_is_listed(rtcal):
    missing = "--dimensions, --ceiling, --walls"
    assert f"{missing} are missing" in rtcal.refused("room", "--floor", "carpet")
    assert f"{missing} are missing" in rtcal.refused("room", "--floor", "carpet", "--t20", "0.5")


def test_t_of_a_box_needs_no_file_and_its_air_is_stated(tmp_path, rtcal, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sides = ["room", *box("9,7,3", "carpet", "plaster", "brick")]
    said = " ".join(rtcal(*sides).split())
    assert "Nothing is written" in said
    assert not [*tmp_path.iterdir()]
    assert "The air is assumed to have 20 °C and 50 % relative humidity" in said
    times = [
        json.loads(rtcal(*sides, *air, "--json"))["reverberation_time"]
        for air in ((), ("--temperature", "20"), ("--temperature", "20", "--humidity", "50"))
    ]
    assert times[0] == times[1] == times[2]
    assert "is assumed" not in rtcal(*sides, "--humidity", "50")


@pytest.mark.parametrize(
    ("pieces", "notes"),
    [
        ("--audience 25 --object person=25", ["25 (person) + 25 (--audience) = 50 in all"]),
        ("--object person=5 --object pupils=7", ["5 (person) + 7 (pupils) = 12 in all"]),
        ("--object person=25 --object 'wooden chair=25'", ["out of wooden chair, or they count"]),
        ("--audience 25 --object armchair=2", ["out of armchair, or they count twice"]),
        ("--object 'standing audience=25' --object 'wooden chair=25'", []),
        ("--object 'theatre seat=25' --object desk=2", []),
        ("--audience 25 --object desk=2", []),
    ],
)
def test_what_counts_twice_is_noted(pieces, notes, rtcal):
    said = " ".join(rtcal("room", *box("9,7,3", "0.1", "0.1", "0.1"), *shlex.split(pieces)).split())
    for note in notes:
        assert note in said
    assert notes or not re.search("in all|count twice", said)


@pytest.mark.parametrize(
    ("material", "lacks"),
    [
        ("25 mm fabric wrapped acoustic panel", "25 mm"),
        ("plywood, 18 mm", "18 mm"),
        ("velour 32 oz", "32 oz"),
        ("velour 18 oz", None),
        ("fibreglass 25 mm", None),
        ("1 inch fibreglass", None),
    ],
)
def test_a_size_that_an_entry_does_not_state_is_said(material, lacks, rtcal):
    said = " ".join(rtcal("room", *box("9,7,3", "0.1", "0.1", material)).split())
    assert (f"was taken, which does not state {lacks}" in said) == (lacks is not None)
    assert ("does not state" in said) == (lacks is not None)


@pytest.mark.parametrize("ceiling", ["acoustic tile", "plaster", "acoustic panel"])
def test_a_factor_of_ten_is_said_first(ceiling, rtcal):
    sides = ["room", *box("9,7,3", "carpet", ceiling, "plaster")]
    times = json.loads(rtcal(*sides, "--json"))["reverberation_time"]
    for factor in (0.1, 10):
        stated = " ".join(f"{f:g}:{factor * t}" for f, t in zip(SIX[:3], times, strict=False))
        said = rtcal(*sides, "--t20", stated)
        assert "that of 10 decays at one position (ISO 3382-2)" in " ".join(said.split())
        assert said.startswith("Likely a typing error")
        assert f"T is {factor:g} times that of the input coefficients" in " ".join(said.split())


def test_an_audience_that_leaves_leaves_the_floor(tmp_path):
    path, empty = tmp_path / "room.toml", tmp_path / "empty.toml"
    sides = box("9,7,3", "carpet", "plaster", "plaster", "--window", "floor=3:rug")
    assert run("room", *sides, "--audience", "40", "--out", path, "-q") == 0
    assert run("room", *sides, "--out", empty, "-q") == 0
    occupied, bare = rt.Room.from_file(str(path)), rt.Room.from_file(str(empty))
    left = changed(occupied, Change(remove="audience"))
    of_bare = dict(zip(bare.materials, bare.areas.tolist(), strict=True))
    assert dict(zip(left.materials, left.areas.tolist(), strict=True)) == pytest.approx(of_bare)
    np.testing.assert_allclose(left.absorption_area, bare.absorption_area)
    half = changed(occupied, [Change(remove="audience", area=20)] * 2)
    np.testing.assert_allclose(half.absorption_area, bare.absorption_area)
    with pytest.raises(DataError, match='20 m² of "carpet" is a surface'):
        changed(occupied, Change(remove="carpet"))
    more = changed(occupied, [Change(add="carpet", area=4), Change(remove="carpet", area=4)])
    assert more.total_area == pytest.approx(occupied.total_area)
    with pytest.raises(DataError, match="is more than the 40 m²"):
        changed(occupied, Change(remove="audience", area=41))
    result = rt.calibrate(occupied, [0.9, 0.8, 0.7, 0.7, 0.6, 0.6])
    without, covered = (
        rt.prediction.predict(result, change)
        for change in (Change(remove="audience"), Change(cover="audience", by="carpet"))
    )
    np.testing.assert_allclose(without.mean, covered.mean)


def test_what_lies_on_two_materials_leaves_both():
    stated = {"centre_frequencies": [500], "volume": 60, "name": "box"}
    materials = [
        rt.Material(n, [a], 0.01) for n, a in (("floor", 0.1), ("wall", 0.2), ("rug", 0.5))
    ]
    bare = [rt.Surface("a", "floor", 16), rt.Surface("b", "wall", 70)]
    lying = [rt.Surface("a: rug", "rug", 4), rt.Surface("b: rug", "rug", 4)]

    def room(*surfaces):
        return rt.Room.from_surfaces(materials=materials, surfaces=[*bare, *surfaces], **stated)

    left = changed(room(*lying), Change(remove="rug", area=4))
    assert dict(zip(left.materials, left.areas.tolist(), strict=True)) == pytest.approx(
        {"floor": 18, "wall": 72, "rug": 4}
    )
    free = room(rt.Surface("rug", "rug", 8))
    assert changed(free, Change(remove="rug")).total_area == pytest.approx(86)
    with pytest.raises(DataError, match=r'1 m² of "rug" is a surface of the room'):
        changed(room(*lying, rt.Surface("c", "rug", 1)), Change(remove="rug"))


def test_a_stated_time_is_that_of_a_table(tmp_path, rtcal):
    path, table = tmp_path / "room.toml", tmp_path / "t.csv"
    rtcal("room", *box("9,7,3", "carpet", "plaster", "brick"), "--out", path)
    table.write_text("source,receiver,parameter,band,value\n*,*,T20,500,0.9\n*,*,T20,1000,0.8\n")
    of_table, of_options = (
        json.loads(rtcal("calibrate", path, *measured, "--json"))
        for measured in ([table], ["--t20", "500:0.9 s,1000:0.8s"])
    )
    assert of_table.pop("solver").keys() == of_options.pop("solver").keys()  # with the time it took
    assert of_table == of_options
    cases = [
        read_case({"case": str(path), **measured})
        for measured in ({"measured": str(table)}, {"t20": "500:0.9 1000:0.8"})
    ]
    of_file, of_option = (case.configurations[0].measured.values["t20"] for case in cases)
    np.testing.assert_array_equal(of_file, of_option)
    assert of_option[0, 2:4].tolist() == [0.9, 0.8]
    for arguments, said in (
        (("calibrate", path, table, "--t20", "0.9"), "MEASURED and --t20 are both given"),
        (("calibrate", path, "--t20", "500:0.006"), "--t20 at 500 Hz = 0.006 s"),
        (("calibrate", path, "--t20", "0.9"), "has 1 number, but must have 6"),
        (("calibrate", path), "Missing argument MEASURED"),
        (("find", path), "the measurement is missing"),
    ):
        assert said in rtcal.refused(*arguments)


def test_the_largest_share_of_absorption_is_first():
    materials = {"small": (20, 0.1, 0.05), "large": (74, [0.3, 0.2], 0.1)}
    room = room_of(materials, [500, 4000], 60, air=rt.Air(20, 50))
    result = rt.calibrate(room, rt.Measurement.from_values([500, 4000], t20=[0.5, 0.5]))
    shares = {s["name"]: np.array(s["share"]) for s in result.to_dict()["absorption_share"]}
    assert [*shares] == ["large", "small", "air"]
    np.testing.assert_allclose(sum(shares.values()), 1)
    by_area = room.areas[:, np.newaxis] * result.alpha
    np.testing.assert_allclose(shares["large"] / shares["small"], by_area[1] / by_area[0])
    np.testing.assert_allclose(shares["air"], result.air_share)
    # A band without a measured T has the shares of the input, and is not in the mean.
    one = rt.calibrate(room, rt.Measurement.from_values([500], t20=[0.5]))
    of_large = np.array(one.to_dict()["absorption_share"][0]["share"])
    assert abs(of_large.mean() - of_large[0]) > 0.01
    for printed, share in ((result, shares["large"].mean()), (one, of_large[0])):
        said = re.search(r"Share of absorption.*?: large (\d+) %", " ".join(str(printed).split()))
        assert float(said[1]) == pytest.approx(100 * share, abs=0.5)


def test_what_is_exact_by_definition_stays_and_the_contradiction_is_stated(tmp_path, rtcal):
    sides = [*box("9,6,4", "concrete", "concrete", "brick"), "--bands", "500"]
    opening = ["--window", "west=10:open window"]
    path = tmp_path / "room.toml"
    said = rtcal("room", *sides, *opening, "--t20", "500:3.2", "--out", path)
    assert "The measurement contradicts the input coefficients" in said
    assert "; 0 for open window (exact by definition)" in said
    stated = rt.Room.from_file(str(path))
    assert stated.material("open window").sigma == [0.0]
    calibrated = rt.calibrate(stated, rt.Measurement.from_values([500], t20=[3.2]))
    assert calibrated.room.material("open window").alpha == [1.0]
    with pytest.raises(InfeasibleError, match="the bounds allow 10 to 228 m²"):
        rt.calibrate(stated, rt.Measurement.from_values([500], t20=[3.6]))
    areas = ["--area", "open_window=10", "--area", "brickwork=218", "--volume", "216"]
    rtcal("import", "catalogue", *areas, "--out", tmp_path / "of_catalogue.toml")
    imported = rt.Room.from_file(str(tmp_path / "of_catalogue.toml"))
    assert not np.any(imported.material("open_window").sigma)
    assert np.min(imported.material("brickwork").sigma) >= 0.01


def test_t_of_a_box_is_printed_by_its_equation(tmp_path, rtcal):
    path = tmp_path / "room.toml"
    sides = [*box("9,7,3", "0.1", "0.5", "0.1"), "--bands", "500,1000", "--out", path]
    for equation in (rt.Eyring(), rt.Sabine()):
        by = ("--equation", equation.key, "--force")
        said = rtcal("room", *sides, *by)
        t = equation.reverberation_time(rt.Room.from_file(str(path)))
        assert said.startswith(f"T by {equation.name}'s equation: {t[0]:.2f}, {t[1]:.2f} s")
        record = json.loads(rtcal("room", *sides, *by, "--json"))
        assert record["reverberation_time"] == pytest.approx(t)
    assert "t.csv --equation sabine, or --t20" in said
    said = rtcal("room", *sides, *by, "--t20", "500:0.5")
    assert "calibrated to T20 by Sabine's equation" in said
    assert '--t20 "500:0.5" --equation sabine' in said
