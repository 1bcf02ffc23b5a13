"""What people call a material finds its entry of the catalogue first."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from rtcal.datasets import catalogue
from rtcal.support.errors import DataError

TABLE = Path(__file__).with_name("names_of_materials.txt")


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


@pytest.mark.parametrize("name", ["sofa", "grass", "xyzzy"])
def test_a_name_that_shares_letters_alone_finds_nothing(name):
    assert catalogue.similar(name) == []


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
