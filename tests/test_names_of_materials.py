"""What people call a material finds its entry of the catalogue first."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from rtcal.datasets import catalogue
from rtcal.support.errors import DataError

TABLE = Path(__file__).with_name("names_of_materials.txt")

WOOD = "wood_floor wood_floor_on_joists stage_floor parquet_on_concrete"
BRICK = "brickwork brick_unglazed smooth_brickwork_flush_pointing brick_wall_rough"
CARPET = (
    "carpet_thin carpet_cotton carpet_tufted_9.5mm carpet_tufted_9m carpet_6mm_closed_cell_foam "
    "carpet_6mm_open_cell_foam carpet_soft_10mm carpet_hairy carpet_1.35_kg_m2"
)
CURTAIN = (
    "curtains_0.2 curtains_cotton_0.33 curtains_cotton_0.5 curtains_fabric curtains_densely_woven"
)
WOOL = "rockwool_50mm_40kgm3 rockwool_50mm_80kgm3 mineral_wool_50mm_40kgm3"
GLAZING = "double_glazing_10mm double_glazing_30mm"

WANTED = {
    "wooden floor": WOOD,
    "hardwood floor": WOOD,
    "parquet": WOOD,
    "vinyl": "linoleum_on_concrete",
    "lino": "linoleum_on_concrete",
    "gypsum board": "plasterboard ceiling_plasterboard",
    "drywall": "plasterboard",
    "Gipskarton": "plasterboard",
    "plaster": "hard_surface brickwork",
    "painted brick": "smooth_brickwork_flush_pointing",
    "brick": BRICK,
    "concrete floor": "concrete_floor",
    "tiles": "ceramic_tiles",
    "acoustic tile": "ceiling_fissured_tile",
    "suspended ceiling": "ceiling_fissured_tile",
    "acoustic panel": "panel_fabric_covered_6pcf panel_fabric_covered_8pcf",
    "acoustic foam": "ceiling_melamine_foam",
    "carpet": CARPET,
    "Teppich": CARPET,
    "curtain": CURTAIN,
    "velvet drapes": "curtains_velvet",
    "window": "glass_window",
    "double glazing": GLAZING,
    "wood_door": "wooden_door",
    "plywood": "plywood_thin",
    "wood panelling": "wooden_lining plywood_thin",
    "audience": "audience_1_m2 audience_1.5_m2 audience_2_m2 audience_0.72_m2",
    "upholstered seats": "chairs_medium_upholstered chairs_upholstered_cloth "
    "chairs_upholstered_moderate chairs_heavy_upholstered",
    "stone wall": "limestone_wall",
    "glass wool": WOOL,
}


@pytest.mark.parametrize("name", WANTED)
def test_a_name_that_people_use_finds_its_entry_first(name):
    assert catalogue.similar(name, 1)[0] in WANTED[name].split()


NAMED = [
    (entries.split(), [" ".join(name.split()) for name in names.split(";")])
    for line in re.sub(r"\n ", "", TABLE.read_text(encoding="utf-8")).splitlines()
    if line and not line.startswith("#")
    for entries, names in [line.split(": ", 1)]
]


@pytest.mark.parametrize(("entries", "names"), NAMED, ids=lambda each: each[0])
def test_names_find_their_entry_or_are_refused(entries, names):
    for name in names:
        try:
            first = catalogue.found(name)[0]
        except DataError:
            first = "-"
        assert first in entries, name


def test_the_names_are_many_and_their_entries_are_in_the_catalogue_too():
    assert sum(len(names) for _, names in NAMED) > 700
    assert {entry for entries, _ in NAMED for entry in entries} <= {"-", *catalogue.names()}


@pytest.mark.parametrize(
    ("name", "entry"),
    [
        # The thing is before what it is mounted on, after what it is covered with.
        ("brick covered with plaster", "plaster_on_brick"),
        ("concrete lined with wood panelling", "wooden_lining"),
        ("mineral wool behind perforated metal", None),
        ("concrete floor with carpet", "carpet_heavy_on_concrete"),
        ("chairs without upholstery", "chairs_wooden"),
        # A word that decides is accounted for, and so is a material.
        ("perforated concrete", None),
        ("glass piano", None),
        ("glass wool 200 mm", None),
        # A word that no entry knows may stand beside a noun, but not beside a place, nor be the noun.
        ("Obersachsen parquet", "parquet_on_concrete"),
        ("xyzzy wall", None),
        ("brick xyzzy", None),
        ("brique xyzzy", "brick_unglazed"),
    ],
)
def test_a_name_is_taken_apart(name, entry):
    if entry is None:
        with pytest.raises(DataError):
            catalogue.found(name)
    else:
        assert catalogue.found(name)[0] == entry


@pytest.mark.parametrize("name", ["sofa", "grass", "xyzzy"])
def test_a_name_that_shares_letters_alone_finds_nothing(name):
    assert catalogue.similar(name) == []


@pytest.mark.parametrize(
    ("name", "entry"),
    [
        ("Holzboden", "wood_floor"),
        ("Laminat", "parquet_on_concrete"),
        ("Betondecke", "unpainted_concrete"),
        ("white wall", "hard_surface"),
        ("red carpet", "carpet_thin"),
        ("Carpet Thin", "carpet_thin"),
        ("open window", "open_window"),
        ("offenes Fenster", "open_window"),
    ],
)
def test_a_name_of_any_form_means_its_entry(name, entry):
    assert catalogue.found(name)[0] == entry
    if entry == "open_window":
        assert catalogue.material(entry, [125, 1000]).alpha == [1.0, 1.0]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("blue paint", "no name of a material is in it"),
        ("not carpet", "no name of a material is in it"),
        ("the", "no name of a material is in it"),
        ("", "no name of a material is in it"),
        ("whiteboard", "The nearest name is hard_surface"),
        ("shelf", "The nearest names are bookshelves, wooden_lining"),
        ("desk", "pieces (`rtcal room --object`): desk"),
        ("steel door", "The nearest names are wooden_door, hard_surface"),
        ("metal ceiling", "The nearest names are hard_surface, ceiling_perforated_metal"),
        ("bed", "pieces (`rtcal room --object`): upholstered chair, theatre seat"),
        ("steel", "The nearest names are hard_surface, ceiling_perforated_metal"),
        ("sheet metal", "The nearest names are hard_surface, ceiling_perforated_metal"),
        ("Sofa", "pieces (`rtcal room --object`): upholstered chair, theatre seat"),
    ],
)
def test_what_has_no_entry_is_refused_with_the_nearest_names(name, words):
    with pytest.raises(DataError, match=re.escape(words)):
        catalogue.found(name)


def test_things_without_an_entry_name_entries():
    path = Path(catalogue.__file__).with_name("material_names.toml")
    near = tomllib.loads(path.read_text(encoding="utf-8"))["near"]
    every = {*catalogue.names(), *catalogue.pieces()}
    assert {n.strip() for each in near.values() for n in each.split(",")} <= every


def test_the_names_are_thirty_and_their_entries_are_in_the_catalogue():
    assert len(WANTED) == 30
    entries = {entry for each in WANTED.values() for entry in each.split()}
    assert entries <= {*catalogue.names()}


def test_a_stated_name_means_one_entry_of_the_catalogue():
    path = Path(catalogue.__file__).with_name("material_names.toml")
    stated = tomllib.loads(path.read_text(encoding="utf-8"))
    assert {*stated["names"]} <= {*catalogue.names()}
    for entry, called in stated["names"].items():
        for name in called.split(","):
            assert catalogue.similar(name, 1) == [entry]


def test_every_entry_has_a_source_a_mounting_and_a_sigma():
    for listed in catalogue.material_list().materials:
        entry = catalogue.material(listed.name, listed.centre_frequencies)
        works = r"Sabine \(1900\)|Vorländer 2008|Cox and D'Antonio|Bies, Hansen|DIN 18041"
        assert re.search(works, entry.source)
        assert re.search(r"; mounting: \w", entry.source)
        if listed.name == "open_window":
            assert entry.sigma == [0.0] * len(listed.alpha)
        else:
            assert np.min(entry.sigma) >= 0.01
    path = Path(catalogue.__file__).with_name("material_names.toml")
    mounted = tomllib.loads(path.read_text(encoding="utf-8"))["mounting"].values()
    assert sorted(" ".join(mounted).split()) == sorted(catalogue.names())
