"""Persons and chairs: absorption without a surface, in every equation, calibration and file."""

import json
import tomllib
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.changes import Change, read_variants
from rtcal.acoustics.equations import mean_equation
from rtcal.acoustics.room import LARGEST_PIECE, Material, Piece, Room
from rtcal.calibration.archive import learn
from rtcal.calibration.table import shares as table_of_shares
from rtcal.datasets import catalogue
from rtcal.finder.apply import corrected_case
from rtcal.finder.case import Case, ChangedMaterial, Configuration
from rtcal.finder.effects import AppliedEffect
from rtcal.finder.means.engines import box, draw_alpha
from rtcal.finder.means.problem import state
from rtcal.finder.means.recalibration import recalibrate
from rtcal.finder.model import DirectionalDecay, predict, sensitivities
from rtcal.finder.search import find
from rtcal.simulators import PathTracing, Polyhedron
from rtcal.support.errors import DataError
from tests.conftest import measurement_of
from tests.test_discrepancy import controls_of

F = [500.0, 1000.0]
PERSONS = Piece("persons", 30, [0.5, 1.2], [0.1, 0.2], "a table", 0.05)
WALLS = (
    Material("floor", [0.1, 0.15], [0.05, 0.05], area=63),
    Material("rest", [0.05, 0.06], [0.02, 0.02], area=159),
)


def room(*objects, **stated):
    return Room.from_surfaces(
        name="class", volume=189, centre_frequencies=F, materials=WALLS, objects=objects, **stated
    )


def test_pieces_are_in_a_and_not_in_s():
    with_them, without = room(PERSONS), room()
    assert with_them.total_area == without.total_area == 222
    added = 30 * np.array([0.5, 1.2])
    assert with_them.absorption_area == pytest.approx(without.absorption_area + added)
    constant = 24 * np.log(10) / with_them.speed_of_sound * 189
    area = np.array([63 * 0.1 + 159 * 0.05, 63 * 0.15 + 159 * 0.06]) + added
    mean = area / 222
    assert rt.Sabine().reverberation_time(with_them) == pytest.approx(constant / area)
    eyring = constant / (-222 * np.log(1 - mean))
    assert rt.Eyring().reverberation_time(with_them) == pytest.approx(eyring)
    walls = -(63 * np.log(1 - np.array([0.1, 0.15])) + 159 * np.log(1 - np.array([0.05, 0.06])))
    millington = constant / (walls + added)
    assert rt.Millington().reverberation_time(with_them) == pytest.approx(millington)


def test_a_box_with_even_walls_has_eyrings_t_by_axes():
    wall = Material("wall", [0.1, 0.1], [0.02, 0.02])
    sides = [("a", "x", 21), ("b", "y", 27), ("c", "z", 63)]
    surfaces = [rt.Surface(name, "wall", 2 * area, axis) for name, axis, area in sides]
    even = Room.from_surfaces(
        name="box",
        volume=189,
        centre_frequencies=F,
        materials=[wall],
        surfaces=surfaces,
        objects=[PERSONS],
    )
    for equation in (rt.Fitzroy(), rt.ArauPuchades()):
        expected = rt.Eyring().reverberation_time(even)
        assert equation.reverberation_time(even) == pytest.approx(expected)


def test_calibration_moves_them_as_the_closed_form_says():
    """mu - D S sigma² (Bellows & Katz 2025) with the number of pieces as their S; nothing is active."""
    prior = room(replace(PERSONS, number_sigma=0.0))
    result = rt.calibrate(prior, [0.75, 0.5])
    target = rt.Eyring().target(prior, np.array([0.75, 0.5]))
    weight = (prior.areas[:, np.newaxis] * prior.sigma**2).T
    excess = (prior.absorption_area - target) / np.sum(prior.areas * weight, axis=1)
    expected = prior.alpha - excess * weight.T
    assert result.alpha == pytest.approx(expected, abs=1e-12)
    assert rt.Eyring().reverberation_time(result.room) == pytest.approx([0.75, 0.5])
    assert result.room.pieces == ("persons",)
    assert result.alpha[2, 1] > 1  # as no coefficient may be
    low, high = result.interval
    assert ((low[2] < expected[2]) & (expected[2] < high[2])).all()


def test_pieces_stop_at_zero():
    few = room(Piece("chairs", 200, [0.02, 0.02], [0.05, 0.05]))
    at = rt.calibrate(few, [2.2, 2.0])
    assert at.alpha[2] == pytest.approx([0, 0], abs=1e-12)
    assert "chairs" in str(at)


def test_an_uncertain_number_widens_t():
    exact = room(Piece("persons", 30, [0.5, 1.2], [0, 0]))
    unsure = room(Piece("persons", 30, [0.5, 1.2], [0, 0], number_sigma=0.2))
    changes = [
        rt.acoustics.room_errors.target_changes(rt.Eyring(), r, np.array([1.0, 0.5]))
        for r in (exact, unsure)
    ]
    assert not changes[0].any()
    # 20 % of 30 persons, and no more surface.
    assert changes[1][2 + 2] == pytest.approx(0.2 * 30 * np.array([0.5, 1.2]))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"number": 0}, r'object\["persons"\].number = 0'),
        ({"area_per_piece": [0.5, 36.0]}, r'alpha\["persons", 1000 Hz\] = 36 must be from 0 to'),
        ({"area_per_piece": [0.5, -1.0]}, "must be from 0 to 10 m², the absorption area of one"),
        ({"area_per_piece": [0.5]}, "1 value"),
        ({"number": 1e9}, r"number = 1e\+09 is too large: the pieces would absorb 1.2e\+09 m²"),
        ({"number": 190}, "would absorb 228 m², and the room's surfaces have 222 m²"),
        ({"name": "floor"}, 'material and object has "floor" twice'),
        ({"sigma": -0.1}, "the absorption area of one piece"),
        ({"number_sigma": 30}, "If it is in percent"),
    ],
)
def test_bad_pieces_are_refused(change, words):
    stated = {"name": "persons", "number": 30, "area_per_piece": [0.5, 1.2], "sigma": [0.1, 0.2]}
    data = room().to_dict() | {"object": [stated | change]}
    with pytest.raises(DataError, match=words):
        Room.from_dict(data)
    with pytest.raises(DataError, match="every material of the room is a piece"):
        room(PERSONS).replace(pieces=["persons", "floor", "rest"])


def test_the_files_rule_gives_pieces_their_sigma():
    data = room().to_dict() | {
        "object": [{"name": "persons", "number": 30, "area_per_piece": [0.01, 3.0]}]
    }
    with pytest.raises(DataError, match=r'object "persons" has no sigma, and the file'):
        Room.from_dict(data)
    made = Room.from_dict(data | {"prior": {"relative": 0.3, "minimum": 0.01}})
    assert made.sigma[2] == pytest.approx([0.01, 0.9])
    with pytest.raises(DataError, match="number = 1000 is too large"):
        Change(add=made.material("persons"), number=1000).apply(room())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (Change(remove="persons", area=10), '"persons" has a number of pieces: give number'),
        (Change(remove="floor", number=10), '"floor" has an area in m²: give area'),
        (Change(remove="persons", number=31), 'number = 31 is more than the 30 of "persons"'),
        (Change(cover="persons", by="floor"), "has a number of pieces and no surface; pieces"),
        (Change(open="persons"), "has a number of pieces and no surface"),
    ],
)
def test_changes_that_pieces_do_not_allow(change, words):
    with pytest.raises(DataError, match=words):
        change.apply(room(PERSONS))
    with pytest.raises(DataError, match="add needs an area in m², or a number if pieces"):
        Change(add="persons")


def by_hand(area, surface, of):
    """Return Eyring's T in s of an absorption area and a surface in m², without the library's."""
    constant = 24 * np.log(10) / of.speed_of_sound * of.volume
    air = 4 * of.air_attenuation * of.volume
    return np.asarray(constant / (-surface * np.log(1 - area / surface) + air))


@pytest.mark.parametrize(
    ("changes", "persons", "surface"),
    [
        ([Change(remove="persons", number=1)], -1, 0),
        ([Change(remove="persons", number=10)], -10, 0),
        ([Change(remove="persons", number=5), Change(remove="persons", number=5)], -10, 0),
        ([Change(remove="persons", number=30)], -30, 0),
        ([Change(remove="persons")], -30, 0),
        ([Change(remove="persons", number=29), Change(remove="persons")], -30, 0),
        ([Change(add="persons", number=10)], 10, 0),
        ([Change(remove="persons", number=10), Change(add="persons", number=4)], -6, 0),
        ([Change(remove="rest", area=5)], 0, -5),
        ([Change(remove="rest", area=2), Change(remove="rest", area=3)], 0, -5),
        ([Change(remove="rest", area=5), Change(remove="persons", number=3)], -3, -5),
    ],
)
def test_a_part_is_taken_out(changes, persons, surface):
    result = rt.calibrate(room(PERSONS), [1.0, 0.6])
    after = result.room
    area = after.absorption_area + persons * result.alpha[2] + surface * result.alpha[1]
    expected = by_hand(area, 222 + surface, after)
    assert result.predict(changes).by_equation["Eyring"] == pytest.approx(expected, rel=1e-6)
    assert abs(expected / [1.0, 0.6] - 1).min() > 1e-3  # a change that is not made would be seen


VARIANTS = """
[[object]]
name = "audience"
area_per_piece = [0.5, 0.9]
sigma = [0.1, 0.2]
[[variant]]
name = "full"
[[variant.change]]
add = "audience"
number = 40
[[variant]]
name = "without"
[[variant.change]]
remove = "persons"
[[variant]]
name = "fewer"
[[variant.change]]
remove = "persons"
number = 20
"""


def test_what_a_file_brings_in_may_have_its_sigma_by_rule():
    whole = room(PERSONS)
    material = """
[[material]]
name = "panel"
alpha = [0.01, 0.5]
"""
    bare = VARIANTS.replace("sigma = [0.1, 0.2]\n", "") + material
    ruled = bare + "[prior]\nrelative = 0.3\nminimum = 0.02\n"
    added = ruled.replace('add = "audience"\nnumber = 40', 'add = "panel"\narea = 4')
    for text, expected, surface in ((ruled, [0.15, 0.27], 0), (added, [0.02, 0.15], 4)):
        (full, _, fewer), _ = read_variants(text, whole)
        after = full.changes[0].apply(whole)
        assert after.sigma[-1] == pytest.approx(expected)
        assert after.total_area == whole.total_area + surface
        assert str(fewer.changes[0]) == 'remove 20 of "persons"'
    with pytest.raises(DataError, match=r'add = "audience" is an \[\[object\]\]: give its number'):
        read_variants(VARIANTS.replace("number = 40", "area = 40"), whole)
    with pytest.raises(DataError, match='material "panel" has no sigma'):
        read_variants(bare, whole)
    with pytest.raises(DataError, match='object "audience" has no sigma'):
        read_variants(bare.replace(material, ""), whole)
    with pytest.raises(DataError, match=r"prior\.band_correlation belongs to the room's file"):
        read_variants(ruled + "band_correlation = 0.5\n", whole)
    with pytest.raises(DataError, match='object "audience": number = 3 belongs to the change'):
        read_variants(VARIANTS.replace("sigma = [0.1", "number = 3\nsigma = [0.1"), whole)


def test_what_holds_no_pieces_says_so(tmp_path):
    whole = room(PERSONS)
    box = Polyhedron.shoebox((9, 7, 3), "floor")
    at = {"sources": {"S1": (1, 1, 1)}, "receivers": {"R1": (5, 5, 1)}}
    with pytest.raises(DataError, match=r'a tracing takes only surfaces, but room "class"'):
        PathTracing(geometry=box, room=whole, scattering=0.5, **at)
    with pytest.raises(DataError, match="an archive takes only surfaces"):
        learn([rt.calibrate(whole.replace(name=n), [1.0, 0.6]) for n in "ab"])
    for program in (rt.io.catt, rt.io.odeon):
        report = program.write(whole, tmp_path / "list", missing_bands="nearest")
        assert "[[object]]" in report.lost
        assert any("T is without persons" in note for note in report.notes)
        names = [m.name.split()[-1] for m in program.read(tmp_path / "list").materials]
        assert names == ["floor", "rest"]
        (tmp_path / "list").unlink()


TABLE = tomllib.loads(resources.files("rtcal.datasets").joinpath("pieces.toml").read_text("utf-8"))
OCTAVES = [125, 250, 500, 1000, 2000, 4000]


def rows_of(name):
    """Return m² per piece, one row per published value, in six octaves."""
    (piece,) = (each for each in TABLE["piece"] if each["name"] == name)
    return np.array([np.array(row["values"][:6]) * row.get("times", 1) for row in piece["row"]])


def test_every_piece_is_published_values_with_a_page_that_has_them():
    used = {row["source"] for piece in TABLE["piece"] for row in piece["row"]}
    assert used == set(TABLE["source"])
    for each in TABLE["source"].values():
        assert each["work"]
        assert "https://" in each["page"]
        assert each["read"].year >= 2026
    for name, source in catalogue.pieces().items():
        piece = catalogue.piece(name, 12, OCTAVES)
        assert piece.source == source
        assert piece.area_per_piece == pytest.approx(rows_of(name).mean(axis=0), abs=6e-5)
        assert 0 < min(piece.area_per_piece) <= max(piece.area_per_piece) < LARGEST_PIECE
        assert min(piece.sigma) >= 0.01
        for row in next(p for p in TABLE["piece"] if p["name"] == name)["row"]:
            assert TABLE["source"][row["source"]]["work"] in source
            assert row["of"] in source


def test_their_sigma_is_the_spread_of_the_values():
    spreads = {}
    for piece in TABLE["piece"]:
        rows = rows_of(piece["name"])
        if "extremes" in piece:
            spreads[piece["name"]] = np.ptp(rows, axis=0) / np.sqrt(12) / rows.mean(axis=0)
        elif len(rows) > 1:
            spreads[piece["name"]] = rows.std(axis=0, ddof=1) / rows.mean(axis=0)
    pooled = np.sqrt(np.mean(np.square([*spreads.values()]), axis=0))
    assert len(spreads) == sum(len(piece["row"]) > 1 for piece in TABLE["piece"])
    for name in catalogue.pieces():
        expected = np.maximum(spreads.get(name, pooled), pooled) * rows_of(name).mean(axis=0)
        sigma = catalogue.piece(name, 5, OCTAVES).sigma
        assert sigma == pytest.approx(np.maximum(expected, 0.01), abs=2e-4)


def test_pieces_have_the_bands_of_their_values():
    seated = catalogue.piece("person seated", 5, [4000, 8000])
    assert seated.area_per_piece[1] == 0.435  # the one row that has this band
    relative = np.array(seated.sigma) / seated.area_per_piece
    assert relative[1] == pytest.approx(relative[0], abs=2e-3)
    with pytest.raises(DataError, match="is not among the pieces: person standing, "):
        catalogue.piece("sofa", 1, [1000])
    with pytest.raises(DataError, match="no value at 8000 Hz; it has 125 to 4000 Hz"):
        catalogue.piece("wooden chair", 1, [8000])
    with pytest.raises(DataError, match="no value at 63 Hz"):
        catalogue.piece("wooden chair", 1, [63])


@pytest.mark.parametrize(
    ("said", "first"),
    [
        ("people", "person seated"),
        ("students", "pupil at a desk"),
        ("padded chair", "upholstered chair"),
        ("theatre seats", "theatre seat"),
        ("Musiker", "musician with instrument"),
        ("standing people", "person standing"),
    ],
)
def test_pieces_are_found_by_what_people_call_them(said, first):
    assert catalogue.similar(said, 1, among=catalogue.pieces()) == [first]


def test_the_catalogue_is_listed_with_its_sources(rtcal):
    pytest.importorskip("pyroomacoustics")
    whole = json.loads(rtcal("materials", "--json"))
    assert [m["name"] for m in whole["materials"]] == list(catalogue.names())
    assert [p["name"] for p in whole["pieces"]] == list(catalogue.pieces())
    assert all(each["source"] for each in (*whole["materials"], *whole["pieces"]))
    said = rtcal("materials", "vinyl", "wooden chair")
    assert "linoleum_on_concrete" in said
    assert "carpet_thin" not in said
    assert all(page in said for page in catalogue.pages(["wooden chair"]))
    said = rtcal("materials", "steel", "church pews")
    assert 'steel: the catalogue has no material like "steel". The nearest names are' in said
    assert "church pews: 0.05" in said
    said = rtcal.refused("materials", "heavy", "xyzzy")
    assert "A name of several words stands in quotes" in said
    assert 'no material like "xyzzy"' in rtcal.refused("materials", "xyzzy")


def test_a_box_has_the_pieces_of_its_options(tmp_path, rtcal):
    pytest.importorskip("pyroomacoustics")
    box = ["room", "--dimensions", "9,7,3", "--floor", "0.1", "--ceiling", "0.1", "--walls", "0.1"]
    path, bare = tmp_path / "room.toml", tmp_path / "bare.toml"
    chairs = ["--object", "wooden chair=30", "--object", "person standing=2"]
    rtcal(*box, *chairs, "--out", path)
    said = rtcal(*box, "--object", "Stuhl=30", "--out", tmp_path / "chairs.toml")
    assert "catalogue's wooden chair was taken" in said
    rtcal(*box, "--out", bare)
    made, without = Room.from_file(str(path)), Room.from_file(str(bare))
    assert made.pieces == ("wooden chair", "person standing")
    assert made.surfaces == without.surfaces
    added = made.absorption_area - without.absorption_area
    one = [rows_of(name).mean(axis=0).round(4) for name in made.pieces]
    assert added == pytest.approx(30 * one[0] + 2 * one[1])
    for wrong, words in (
        ("sofa=2", 'no piece like "sofa". The nearest names are upholstered chair, theatre seat'),
        ("wooden chair", "must have the form NAME=NUMBER"),
        ("wooden chair=1e9", 'wooden chair" = 1e+09 is too large'),
    ):
        assert words in rtcal.refused(*box, "--object", wrong, "--out", tmp_path / "x.toml")


def case_of_pieces(persons=30, **stated):
    """A room with persons, and T20 of the same room with another number of persons and no error."""
    model = room(replace(PERSONS, number_sigma=0.0), **stated)
    model = model.replace(sigma=0.05 * model.alpha)
    true = model.replace(areas=[63, 159, persons])
    times = rt.Eyring().reverberation_time(true)[np.newaxis]
    measured = measurement_of(F, u={"t20": 0.01 * times}, t20=times)
    return Case(room=model, configurations=[Configuration(name="as built", measured=measured)])


@pytest.mark.parametrize("equation", ["sabine", "eyring", "millington", "kuttruff"])
def test_the_finders_state_has_the_equations_t(equation):
    case = replace(case_of_pieces(), equation=equation)
    made = state(case, case.configurations[0])
    expected = mean_equation(equation).reverberation_time(case.room)
    assert 6 * np.log(10) / made.rate == pytest.approx(expected, rel=1e-9)
    assert made.total_area == 222
    step = 1e-6
    for i in range(3):
        moved = np.array(made.alpha)
        moved[i] += step
        slope = (replace(made, alpha=moved).rate - made.rate) / step
        assert sensitivities([made])[0, i] == pytest.approx(slope, rel=1e-4)


def test_pieces_absorb_alike_in_every_direction():
    """With walls that absorb nothing the field is even, whatever its scattering."""
    case = case_of_pieces()
    alpha = np.array(case.room.alpha)
    alpha[:2] = 1e-12
    made = replace(state(case, case.configurations[0], alpha), shape=DirectionalDecay(0.0))
    times = np.exp(predict([made], np.array([3.0])).features[0, 0])
    assert times == pytest.approx(6 * np.log(10) / made.rate, rel=1e-3)


def test_reference_rooms_absorb_what_the_pieces_do():
    case = case_of_pieces()
    reference, _, share = box(case)
    mean = reference.areas @ (share.T @ case.room.alpha) / reference.total_area
    walls = reference.areas @ (share[:2].T @ case.room.alpha[:2]) / reference.total_area
    assert mean - walls == pytest.approx(case.room.area_of_pieces / 222)
    drawn = draw_alpha(case, np.random.default_rng(0), 500)
    assert drawn[:, 0, 2].mean(axis=0) == pytest.approx([0.5, 1.2], rel=0.02)


def test_find_names_a_wrong_number_of_pieces(tmp_path):
    case = case_of_pieces(90)
    finding = find(case, only=["area", "covered surface"], controls=controls_of(case))
    best = finding.candidates[0]
    assert best.title == 'number of "persons"'
    assert best.size == pytest.approx(3, rel=0.25)
    assert "times the input number" in str(finding)
    assert all(c.title != 'covered surface of "persons"' for c in finding.candidates)
    made = finding.apply(effect="area")
    assert made.room.areas[2] == pytest.approx(30 * best.size)
    assert made.room.pieces == ("persons",)
    assert made.room.total_area == 222
    assert 'The input number of "persons": it was 30' in " ".join(map(str, made.notes))
    simulated = np.array(made.simulator().simulate(made.room.alpha).values["t20"][0])
    assert simulated == pytest.approx(rt.Eyring().reverberation_time(made.room), rel=1e-9)
    made.save(tmp_path)
    assert Case.from_file(str(tmp_path / "case.json")).room.pieces == ("persons",)


def test_what_is_added_beside_pieces_keeps_the_models_t():
    case = case_of_pieces()
    opening = AppliedEffect("opening", {"area": 12.0}, (8.0, 16.0))
    made = corrected_case(replace(case, applied=[opening]))
    whole = state(replace(case, applied=[opening]), case.configurations[0])
    expected = 6 * np.log(10) / whole.rate
    assert rt.Eyring().reverberation_time(made.room) == pytest.approx(expected, rel=1e-6)
    assert made.room.pieces == ("persons",)
    calibrated = recalibrate(replace(case, applied=[opening]))
    assert calibrated.room.pieces == ("persons",)
    assert "m² per piece" in str(calibrated.blocks()[0])


def test_configurations_change_pieces_in_m2_per_piece():
    case = case_of_pieces()
    nobody = replace(
        case.configurations[0],
        name="without persons",
        changes={"persons": ChangedMaterial(np.zeros(2), np.zeros(2))},
    )
    both = replace(case, configurations=[*case.configurations, nobody])
    without = state(both, both.configurations[1])
    expected = rt.Eyring().reverberation_time(case.room.without_pieces)
    assert 6 * np.log(10) / without.rate == pytest.approx(expected, rel=1e-9)
    many = replace(nobody, changes={"persons": ChangedMaterial(np.full(2, 2.0), np.ones(2))})
    assert replace(case, configurations=[many]).configurations[0].changes["persons"].alpha[0] == 2
    wrong = replace(nobody, changes={"floor": ChangedMaterial(np.full(2, 2.0), np.ones(2))})
    with pytest.raises(DataError, match=r'alpha of "floor" must be 2 values from 0 to 1$'):
        replace(case, configurations=[wrong])


def test_two_states_of_a_room_with_pieces():
    whole = room(PERSONS)
    before, after = (
        replace(rt.Measurement.from_values(F, t20=t), n_sources=2, n_receivers=6)
        for t in ([1.0, 0.6], [0.6, 0.4])
    )
    found = rt.find(whole, after, before=before)
    assert found.detected
    made = found.apply()
    assert made.room.pieces == ("persons",)
    assert rt.Eyring().reverberation_time(made.room) == pytest.approx([0.6, 0.4], rel=0.05)


def test_a_search_by_positions_names_the_one_by_means():
    scene = rt.Scene(sources={"S": (1, 1, 1)}, receivers={"R": (5, 5, 1)})
    whole = room(PERSONS).replace(scene=scene)
    pairs = measurement_of(F, [("S", "R")], t20=np.ones((1, 2)))
    with pytest.raises(DataError, match=r"no surface to trace\. Search by means over positions"):
        rt.find(whole, pairs)


def test_what_is_printed_keeps_pieces_apart(tmp_path, rtcal):
    result = rt.calibrate(room(PERSONS), [1.0, 0.6])
    shares = [row.values for row in table_of_shares(result.to_dict()).rows]
    assert np.sum(shares, axis=0) == pytest.approx(100)
    assert "222 m² of surfaces" in str(result)
    result.save(tmp_path / "found")
    (tmp_path / "variants.toml").write_text(VARIANTS)
    assert "full" in rtcal("predict", tmp_path / "found", "--change", tmp_path / "variants.toml")
