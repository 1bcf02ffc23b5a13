"""A box by its sides and materials, and T by an option: questions as people ask them in public."""

from __future__ import annotations

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
from rtcal.io import geometry_files, units
from rtcal.simulators import Polyhedron
from rtcal.support.errors import DataError, InfeasibleError
from tests.conftest import run

FT = 0.3048
SIX = [125, 250, 500, 1000, 2000, 4000]


def box(sides: str, floor: str, ceiling: str, walls: str, *more: str) -> list[str]:
    return ["--dimensions", sides, "--floor", floor, "--ceiling", ceiling, "--walls", walls, *more]


Question = tuple[list[str], list[str], float, dict[float, float]]

ASKED = """
# what is asked | sides | floor | ceiling | walls | further options | measured T | V in m³ | T by band
# that the calibrated room must have. The first 17 are rooms of public threads and textbooks.
pyroomacoustics issue 280 | 7 x 8 x 3.75 | 0.16 0.24 0.56 0.69 0.81 0.78 \\
  | 0.45, 0.50, 0.5, 0.4, 0.35, 0.35 | 0.02 0.02 0.03 0.03 0.04 0.06 | | t20 0.9 0.8 0.6 0.6 0.5 0.5 \\
  | 210 | 0.9 0.8 0.6 0.6 0.5 0.5
pyroomacoustics issue 404 | 2,4,2.5 | chairs_medium_upholstered | ceiling_plasterboard \\
  | plasterboard | | t20 500:0.11 | 20 | 500:0.11
pyroomacoustics issue 233 | 4, 7, 2.8 | 0.6 | 0.6 | 0.6 | | t20 500:0.1,1000:0.1 | 78.4 \\
  | 500:0.1 1000:0.1
Penn State, cement blocks | 9.25 m x 7.65 m x 3.15 m | concrete | concrete | concrete block \\
  | | t30 1000:3.3 | 222.9 | 1000:3.3
Penn State, then carpet | 9.25m x 7.65m x 3.15m | carpet | concrete | concrete block \\
  | --temperature 21 --humidity 45 | t30 1 kHz: 1.6 | 222.9 | 1000:1.6
hard meeting room | 8 m x 6 m x 4 m | hard_surface | hard_surface | hard_surface | | t20 500:3 | 192 \\
  | 500:3
classroom exercise | 10×8×6 | wooden floor | plaster | plaster | | t20 500:3,1000:3 | 480 | 500:3 1000:3
garage calculator | 6 metres x 5 metres x 2.4 metres | concrete floor | painted wall | painted wall \\
  | | t20 125:2.9 500:2.7 2000:2.0 | 72 | 125:2.9 500:2.7 2000:2
large classroom | 16m x 10m x 5m | 0,05 | 0,05 | 0,05 | --audience 80 | t20 1000:1,1 | 800 | 1000:1.1
meeting room with glazing | 8.0 5.5 3.0 | concrete floor | plasterboard ceiling | drywall \\
  | --window 'south=12:double glazing' --piece west=9.9:hard_surface | t20 500:1.5 | 132 | 500:1.5
hall with curtain cloth | 10*8*6 | wood floor | plaster | plaster | --piece north=20:curtain \\
  | t20 500:1.0 | 480 | 500:1
hall of 3.5 s | 20*15*10 | wood floor | plaster | plaster | | t20 500:3.5 1000:3.5 | 3000 \\
  | 500:3.5 1000:3.5
cubical room | 5.0 x 5.0 x 5.0 m | concrete | 0.3 | 0.3 | --door 'west=1.6875:wooden door' \\
  | t20 2000:0.44 | 125 | 2000:0.44
hall with a wooden floor | 12;30;6 | wooden floor | plaster | plaster | --window east=24:glass \\
  | t20 500:4.5 | 2160 | 500:4.5
Everest, figure 7-22 | 23.3 x 16 x 10 ft | .01 .01 .015 .02 .02 .02 | .29 .10 .05 .04 .07 .09 \\
  | .29 .10 .05 .04 .07 .09 | | t20 0.54 1.53 2.87 3.39 2.06 1.63 | 105.565 \\
  | 0.54 1.53 2.87 3.39 2.06 1.63
dEchorate | 5.705 x 5.965 x 2.355 | carpet | acoustic panel | acoustic panel \\
  | | t20 500:0.18 1000:0.14 2000:0.16 4000:0.22 | 80.14 | 500:0.18 1000:0.14 2000:0.16 4000:0.22
phonometry | 8x5x3 | .2 | .2 | .2 | | t20 1000:0.55 | 120 | 1000:0.55
classroom of the issue | 9,7,3 | carpet | acoustic_tile | plaster \\
  | --wall west=brick --window west=4.5:glazing --door south=2:wood_door --temperature 20 \\
  --humidity 50 | t20 0.9 0.8 0.7 0.7 0.6 0.6 | 189 | 0.9 0.8 0.7 0.7 0.6 0.6
German decimal commas | 9,5 x 7,2 x 3 m | Teppich | Akustikdecke | Putz | --temperature 21 \\
  | t20 0,9 0,8 0,7 0,7 0,6 0,6 | 205.2 | 0.9 0.8 0.7 0.7 0.6 0.6
commas alone | 9,5,7,2,3,0 | Parkett | Gipskarton | Mauerwerk | | t20 1,4,1,3,1,2,1,1,1,0,0,9 \\
  | 205.2 | 1.4 1.3 1.2 1.1 1 0.9
feet and inches | 12'6" x 10' x 8' | hardwood floor | drywall | drywall | --door west=1.9:door \\
  | t20 250:0.5, 500:0.6, 1000:0.6 | 28.3168 | 250:0.5 500:0.6 1000:0.6
home theatre in feet | 20 ft x 15 ft x 9 ft | thick carpet | drywall | acoustic panel \\
  | | t20 125:0.5 250:0.3 500:0.25 1k:0.25 2k:0.2 4k:0.2 | 76.4555 | 0.5 0.3 0.25 0.25 0.2 0.2
millimetres of a drawing | 6000 x 4000 x 2700 mm | vinyl | suspended ceiling | gypsum board \\
  | --temperature 21 --humidity 45 | t30 0.8;0.7;0.6;0.6;0.6;0.5 | 64.8 | 0.8 0.7 0.6 0.6 0.6 0.5
centimetres | 520x410x250cm | laminate floor | plaster | wallpaper | --piece floor=4:rug \\
  | t20 500 Hz: 0.9, 1000 Hz: 0.8 | 53.3 | 500:0.9 1000:0.8
sports hall | 27 x 15 x 7 | vinyl | acoustic baffles | brick | --bands 250,500,1000,2000 \\
  | t20 2.4 2.2 2.0 1.8 | 2835 | 250:2.4 500:2.2 1000:2 2000:1.8
church | 25 by 12 by 10 m | stone | wood | stone wall | --window north=30:glass \\
  | t30 4.5 4.2 4.0 3.6 3.0 2.0 | 3000 | 4.5 4.2 4 3.6 3 2
stairwell in one octave | 3 5 9 | tiles | concrete | concrete | --bands 1000 | t20 2.8 | 135 | 1000:2.8
thirds with coefficients | 5x4x3 | 0.1 | 0.2 | 0.05 | --bands 400,500,630 | t20 1.1 1.0 0.9 | 60 \\
  | 400:1.1 500:1 630:0.9
restaurant | 14 x 9 x 3.2 m | ceramic tiles | perforated gypsum | plaster \\
  | --window west=8:window --window south=12:window --audience 60 --temperature 21 --humidity 45 \\
  | t20 500:0.7,1000:0.7,2000:0.6 | 403.2 | 500:0.7 1000:0.7 2000:0.6
studio with curtains | 7,1m x 5m x 3m | Teppich | acoustic foam | heavy curtain | --wall east=glass \\
  | t20 0.5 0.4 0.3 0.25 0.25 0.25 | 106.5 | 0.5 0.4 0.3 0.25 0.25 0.25
"""


def question(row: str) -> tuple[str, Question]:
    """Return a row's name; the options of the room and of T, its volume, and its T by band."""
    name, *described, more, measured, volume, times = (cell.strip() for cell in row.split("|"))
    kind, value = measured.split(" ", 1)
    numbers = [
        t.split(":") if ":" in t else [f, t] for f, t in zip(SIX, times.split(), strict=False)
    ]
    t = {float(f): float(value) for f, value in numbers}
    return name, (box(*described, *shlex.split(more)), [f"--{kind}", value], float(volume), t)


ROWS = ASKED.replace("\\\n", "").strip().splitlines()
QUESTIONS: dict[str, Question] = dict(question(row) for row in ROWS if not row.startswith("#"))


@pytest.mark.parametrize("asked", QUESTIONS)
def test_a_question_is_answered(
    asked: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    described, measured, volume, times = QUESTIONS[asked]
    path = tmp_path / "room.toml"
    assert run("room", *described, *measured, "--out", path, "--json") == 0, capsys.readouterr().err
    answer = json.loads(capsys.readouterr().out)["calibration"]
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
def test_one_command_is_the_two_that_it_names(
    asked: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    described, measured, *_ = QUESTIONS[asked]
    assert run("room", *described, *measured, "--out", "a.toml", "--name", "room") == 0
    named = re.search("and then `rtcal (.*?)`", " ".join(capsys.readouterr().out.split()))
    assert named
    assert run("room", *described, *measured, "--out", "a.toml", "--name", "room", "--json") == 0
    one = json.loads(capsys.readouterr().out)["calibration"]
    assert run("room", *described, "--out", "b.toml", "--name", "room") == 0
    capsys.readouterr()
    assert run(*shlex.split(named[1]), "--json") == 0
    two = json.loads(capsys.readouterr().out)
    assert one.pop("solver").keys() == two.pop("solver").keys()  # with the time it took
    assert one == two
    assert Path("a.toml").read_text() == Path("b.toml").read_text()
    files = [*tmp_path.iterdir()]
    assert run("room", *described, *measured, "--json") == 0
    alone = json.loads(capsys.readouterr().out)["calibration"]
    alone.pop("solver")
    assert alone == one
    assert [*tmp_path.iterdir()] == files


def test_a_time_beyond_reach_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["room", *box("9,7,3", "carpet", "plaster", "brick"), "--out", tmp_path / "room.toml"]
    assert run(*command, "--temperature", "20", "--t20", "4000:25") == 2
    assert "cannot be reached" in capsys.readouterr().err
    assert run(*command, "--t20", "500:0.5", "--t30", "500:0.5") == 2
    assert "--t20 and --t30 are both given; give only one" in capsys.readouterr().err
    assert run(*command, "--t20", "900 800 700 700 600 600") == 2
    assert (
        "900 s must be from 0.01 to 120 s; check that the value is in seconds"
        in capsys.readouterr().err
    )
    assert not [*tmp_path.iterdir()]


def test_the_library_makes_the_room_of_the_command(tmp_path: Path) -> None:
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


def test_a_box_without_pieces_is_the_box_of_the_simulators(tmp_path: Path) -> None:
    path = tmp_path / "room.toml"
    assert run("room", *box("9,7,3", "carpet", "plaster", "brick"), "--out", path, "-q") == 0
    room = rt.Room.from_file(str(path))
    geometry = geometry_files.read(room)
    assert geometry.volume == pytest.approx(room.volume)
    assert geometry.areas == pytest.approx(dict(zip(room.materials, room.areas, strict=True)))


def test_coefficients_belong_to_their_place(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    path = tmp_path / "room.toml"
    pieces = ["--window", "west=4.5:0.1", "--window", "west=20 ft2:0.3", "--door", "west=1:0.1"]
    assert run("room", *box("30' x 20'x 10'", "0.2", "floor", "0.2", *pieces), "--out", path) == 0
    said = capsys.readouterr().out
    assert "9.14 × 6.1 × 3.05 m: length (x), width (y), height (z)" in said
    assert f"rtcal calibrate {path} t.csv, or --t20" in " ".join(said.split())
    room = rt.Room.from_file(str(path))
    areas = dict(zip(room.materials, room.areas.tolist(), strict=True))
    pieces_of_west = {"piece of west": 5.5, "piece of west (2)": 20 * FT**2}
    each = {"floor": 600 * FT**2, "floor (2)": 600 * FT**2} | pieces_of_west
    assert areas == pytest.approx(each | {"walls": 1000 * FT**2 - sum(pieces_of_west.values())})
    stated = {"floor": 0.2, "walls": 0.2, "piece of west": 0.1, "piece of west (2)": 0.3}
    assert {name: room.material(name).alpha[0] for name in stated} == stated


def test_questions_in_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, given = tmp_path / "asked.toml", tmp_path / "given.toml"
    answers = ["9x7", "9x7x3", "xyzzy", "carpet", "acoustic tile", "plaster", "", "55"]
    answers += [str(asked), "nothing", "west=4.5:glazing", "west=17:glazing", "south=2:door", ""]
    answers += ["persons", "sofa=2", "persons=0", "persons=9999", "persons=20", "desks=15", ""]
    answers += ["0.9 0.8", "900 800 700 700 600 600", "0.9 0.8 0.7 0.7 0.6 0.6"]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(answers) + "\n"))
    assert run("room", "--ask") == 0
    said = capsys.readouterr()
    assert "has 2 numbers, but must have 3" in said.err
    assert 'no material like "xyzzy"' in said.err
    assert "The room has 189 m³" in said.out
    assert "Measured T20 / s in 6 bands, 125 to 4000 Hz, to calibrate" in said.err
    assert "has 2 numbers, but must have 6" in said.err
    assert "900 s must be from 0.01 to 120 s" in said.err
    assert "and then `rtcal calibrate" in " ".join(said.out.split())
    assert '"west" has 16.5 m² left' in said.err
    assert "Persons, seats, desks (NAME=NUMBER: person seated=20), or nothing" in said.err
    assert "no piece" in said.err
    assert '--object "persons" = 9999 is too large' in said.err
    assert said.err.count("For persons the catalogue's") == 1
    assert said.out.count("For persons the catalogue's") == 1
    options = box(
        "9,7,3", "carpet", "acoustic tile", "plaster", *("--temperature", "20", "--humidity", "55")
    )
    options += ["--window", "west=4.5:glazing", "--door", "south=2:door", "--name", "asked"]
    options += ["--object", "persons=20", "--object", "desks=15"]
    assert run("room", *options, "--out", given) == 0
    assert given.read_text() == asked.read_text()


def test_questions_that_end_early_write_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("9,7,3\ncarpet\n"))
    assert run("room", "--ask", "--out", tmp_path / "room.toml") == 2
    said = capsys.readouterr().err
    assert '"Material of the ceiling" was answered; still missing: --ceiling, --walls' in said
    assert not [*tmp_path.iterdir()]


def test_a_file_of_others_stays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "room.toml"
    path.write_text("mine")
    command = ["room", *box("9,7,3", "carpet", "plaster", "brick"), "--out", path]
    assert run(*command) == 2
    assert path.read_text() == "mine"
    assert "--force" in capsys.readouterr().err
    assert run(*command, "--force") == 0
    assert rt.Room.from_file(str(path)).volume == pytest.approx(189)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (["--dimensions", "9 7"], r'sides: "9 7" has 2 numbers, but must have 3'),
        (["--dimensions", "9m x 700cm x 3m"], "sides in different units"),
        (["--dimensions", "9x7x0"], "side = 0 m"),
        (["--floor", "xyzzy"], r'floor: the catalogue has no material like "xyzzy"'),
        (["--floor", "10 10 20 20 30 30"], r"floor: alpha = 10 at 125 Hz .* in percent"),
        (["--floor", "0.1 0.2"], "floor: .* has 2 numbers, but must have 1 or 6"),
        (["--floor", "125:0.1 250:0.1"], "floor: alpha at 500 Hz is missing"),
        (["--wall", "left=brick"], '"left" is not a wall; the walls are west, east'),
        (["--window", "west:4.5=glazing"], "must have the form WALL=M2:MATERIAL"),
        (["--window", "up=4.5:glazing"], '"up" is not a surface; the surfaces are'),
        (
            ["--window", "west=40:glazing"],
            r'"west" has 21 m² left, and a patch must be smaller; glazing has 40 m²',
        ),
        (["--window", "west=-1:glazing"], "west=-1:glazing: area = -1 m²"),
        (["--window", "west=1.5x3:glazing"], '"1.5x3" .* A piece has the form WALL=M2:MATERIAL'),
        (["--floor", "-0.1"], "floor: alpha = -0.1 at 125 Hz"),
        (
            ["--floor", "xyzzy", "--ask"],
            r'^rtcal: floor: the catalogue has no material like "xyzzy"',
        ),
        (
            ["--dimensions", "9000 7000 3000"],
            "V = 1.89e.11 m³ .* it is 189 m³ in mm or .* write the unit",
        ),
        (["--dimensions", "3000x2000x1000 ft"], "--dimensions: V = 1.7e.08 m³ .* it is 6 m³ in mm"),
        (["--dimensions", "9,7,3 km"], '--dimensions "km" is neither a number nor one of'),
        (
            ["--audience", "200"],
            "--audience: 200 persons need 1 m² each and must leave a part of the floor's 63 m²",
        ),
        (["--temperature", "200"], "200"),
        (["--out", "room.csv"], r"room.csv: .* Use .toml"),
    ],
)
def test_what_is_wrong_is_named_and_nothing_is_written(
    changed: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["room", *box("9,7,3", "carpet", "plaster", "brick"), "--out", tmp_path / "room.toml"]
    assert run(*command, *changed) == 2
    assert re.search(said, capsys.readouterr().err)
    assert not [*tmp_path.iterdir()]


def test_what_is_missing_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("room", "--floor", "carpet") == 2
    assert "--dimensions, --ceiling, --walls, --out are missing" in capsys.readouterr().err
    assert run("room", "--floor", "carpet", "--t20", "0.5") == 2
    assert "--dimensions, --ceiling, --walls are missing. Add them" in capsys.readouterr().err


def test_an_audience_that_leaves_leaves_the_floor(tmp_path: Path) -> None:
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
    with pytest.raises(
        DataError, match=r'20 m² of "carpet" is a surface .* cover = "carpet", by ='
    ):
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


def test_what_lies_on_two_materials_leaves_both() -> None:
    stated = {"centre_frequencies": [500], "volume": 60, "name": "box"}
    materials = [
        rt.Material(n, [a], 0.01) for n, a in (("floor", 0.1), ("wall", 0.2), ("rug", 0.5))
    ]
    surfaces = [
        rt.Surface("a", "floor", 16),
        rt.Surface("b", "wall", 70),
        rt.Surface("a: rug", "rug", 4),
        rt.Surface("b: rug", "rug", 4),
    ]
    room = rt.Room.from_surfaces(materials=materials, surfaces=surfaces, **stated)
    left = changed(room, Change(remove="rug", area=4))
    assert dict(zip(left.materials, left.areas.tolist(), strict=True)) == pytest.approx(
        {"floor": 18, "wall": 72, "rug": 4}
    )
    free = rt.Room.from_surfaces(
        materials=materials, surfaces=[*surfaces[:2], rt.Surface("rug", "rug", 8)], **stated
    )
    assert changed(free, Change(remove="rug")).total_area == pytest.approx(86)
    both = rt.Room.from_surfaces(
        materials=materials, surfaces=[*surfaces, rt.Surface("c", "rug", 1)], **stated
    )
    with pytest.raises(DataError, match=r'1 m² of "rug" is a surface of the room'):
        changed(both, Change(remove="rug"))


def test_a_stated_time_is_that_of_a_table(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    path, table = tmp_path / "room.toml", tmp_path / "t.csv"
    assert run("room", *box("9,7,3", "carpet", "plaster", "brick"), "--out", path, "-q") == 0
    table.write_text("source,receiver,parameter,band,value\n*,*,T20,500,0.9\n*,*,T20,1000,0.8\n")
    capsys.readouterr()
    answers = []
    for measured in ([table], ["--t20", "500:0.9 s,1000:0.8s"]):
        assert run("calibrate", path, *measured, "--json") == 0
        answers.append(json.loads(capsys.readouterr().out))
        answers[-1].pop("solver")  # with the time it took
    assert answers[0] == answers[1]
    cases = [
        read_case({"case": str(path), **measured})
        for measured in ({"measured": str(table)}, {"t20": "500:0.9 1000:0.8"})
    ]
    of_file, of_option = (case.configurations[0].measured.values["t20"] for case in cases)
    np.testing.assert_array_equal(of_file, of_option)
    assert of_option[0, 2:4].tolist() == [0.9, 0.8]
    assert run("calibrate", path, table, "--t20", "0.9") == 2
    assert "MEASURED and --t20 are both given; give only one" in capsys.readouterr().err
    assert run("calibrate", path, "--t20", "500:0.006") == 2
    assert "--t20 at 500 Hz = 0.006 s must be from 0.01 to 120 s" in capsys.readouterr().err
    assert run("calibrate", path, "--t20", "0.9") == 2
    assert "has 1 number, but must have 6. The room has 6 bands" in capsys.readouterr().err
    assert run("calibrate", path) == 2
    assert "Missing argument MEASURED" in capsys.readouterr().err
    assert run("find", path) == 2
    assert "is a room, and the measurement is missing" in capsys.readouterr().err


def test_the_largest_share_of_absorption_is_first() -> None:
    room = rt.Room(
        name="box",
        volume=60,
        materials=["small", "large"],
        areas=[20, 74],
        alpha=[[0.1, 0.1], [0.3, 0.2]],
        sigma=[[0.05, 0.05], [0.1, 0.1]],
        centre_frequencies=[500, 4000],
        air=rt.Air(20, 50),
    )
    result = rt.calibrate(room, rt.Measurement.from_values([500, 4000], t20=[0.5, 0.5]))
    shares = {s["name"]: np.array(s["share"]) for s in result.to_dict()["absorption_share"]}
    assert [*shares] == ["large", "small", "air"]
    np.testing.assert_allclose(sum(shares.values()), 1)
    by_area = room.areas[:, np.newaxis] * result.alpha
    np.testing.assert_allclose(shares["large"] / shares["small"], by_area[1] / by_area[0])
    np.testing.assert_allclose(shares["air"], result.air_share)
    line = re.search(
        r"Share of absorption.*?: (\w+) (\d+) % \((\d+) to", " ".join(str(result).split())
    )
    assert line
    assert line[1] == "large"
    assert float(line[2]) == pytest.approx(100 * shares["large"].mean(), abs=0.5)
    # A band without a measured T has the shares of the input, and is not in the mean.
    one = rt.calibrate(room, rt.Measurement.from_values([500], t20=[0.5]))
    line = re.search(
        r"mean over the measured bands \(range\): large (\d+) % \((\d+)\)",
        " ".join(str(one).split()),
    )
    assert line
    of_large = np.array(one.to_dict()["absorption_share"][0]["share"])
    assert float(line[1]) == pytest.approx(100 * of_large[0], abs=0.5)
    assert abs(of_large.mean() - of_large[0]) > 0.01  # a mean over all bands would be seen


def test_pieces_larger_than_their_wall_are_refused() -> None:
    geometry = Polyhedron.shoebox((4, 5, 3), "plaster")
    with pytest.raises(
        DataError, match=r'"west" has 10 m² left, and a patch must be smaller; glass has 10 m²'
    ):
        rt.Room.from_geometry(
            geometry,
            patches=[("west", "glass", 5), ("west", "glass", 10)],
            name="box",
            materials=[rt.Material("plaster", [0.1], 0.01), rt.Material("glass", [0.1], 0.01)],
            centre_frequencies=[500],
        )


def test_what_is_exact_by_definition_stays_and_the_contradiction_is_stated(
    tmp_path: Path, capsys
) -> None:
    """With sigma = 0.3, an open window of 10 m² was calibrated to 0.70, and nothing contradicted."""
    sides = [*box("9,6,4", "concrete", "concrete", "brick"), "--bands", "500"]
    opening = ["--window", "west=10:open window"]
    path = tmp_path / "room.toml"
    assert run("room", *sides, *opening, "--t20", "500:3.2", "--out", path) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "This is more than the input's standard deviations explain" in said
    assert "; 0 for open window (exact by definition)" in said
    stated = rt.Room.from_file(str(path))
    assert stated.material("open window").sigma == [0.0]
    calibrated = rt.calibrate(stated, rt.Measurement.from_values([500], t20=[3.2]))
    assert calibrated.room.material("open window").alpha == [1.0]
    with pytest.raises(InfeasibleError, match="the bounds allow 10 to 228 m²"):
        rt.calibrate(stated, rt.Measurement.from_values([500], t20=[3.6]))
    areas = ["--area", "open_window=10", "--area", "brickwork=218", "--volume", "216"]
    assert run("import", "catalogue", *areas, "--out", tmp_path / "of_catalogue.toml") == 0
    assert "; 0 for open_window (exact by definition)" in " ".join(capsys.readouterr().out.split())
    imported = rt.Room.from_file(str(tmp_path / "of_catalogue.toml"))
    assert not np.any(imported.material("open_window").sigma)
    assert np.min(imported.material("brickwork").sigma) >= 0.01


def test_t_of_a_box_is_printed_by_its_equation(tmp_path: Path, capsys) -> None:
    path = tmp_path / "room.toml"
    sides = [*box("9,7,3", "0.1", "0.5", "0.1"), "--bands", "500,1000", "--out", path]
    for equation in (rt.Eyring(), rt.Sabine()):
        assert run("room", *sides, "--equation", equation.key, "--force") == 0
        said = " ".join(capsys.readouterr().out.split())
        t = equation.reverberation_time(rt.Room.from_file(str(path)))
        first = (
            f"T by {equation.name}'s equation: {t[0]:.2f}, {t[1]:.2f} s in 2 bands, 500 to 1000 Hz"
        )
        assert said.startswith(first)
        assert run("room", *sides, "--equation", equation.key, "--json", "--force") == 0
        assert json.loads(capsys.readouterr().out)["reverberation_time"] == pytest.approx(t)
    assert "t.csv --equation sabine, or --t20" in said
    named = ["--equation", "sabine", "--t20", "500:0.5"]
    assert run("room", *sides, *named, "--force") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "calibrated to T20 by Sabine's equation" in said
    assert '--t20 "500:0.5" --equation sabine' in said
