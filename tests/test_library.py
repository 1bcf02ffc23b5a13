"""Product data as a material list, and the catalogue's nearest entries."""

from __future__ import annotations

from pathlib import Path

import pytest

import rtcal as rt
from rtcal.io import library
from rtcal.support.errors import DataError
from tests.corpus import NAMED

BAFFLE = (0.45, 0.9, 1.0)


def test_a_table_of_one_product_has_the_name_of_its_file(tmp_path: Path) -> None:
    (tmp_path / "Baffle.csv").write_text("Frequency;alpha_s\n250;0,45\n500;0,9\n1000;1,1\n")
    assert library.read(tmp_path / "Baffle.csv").listed("Baffle").alpha == BAFFLE


def test_a_folder_is_a_library(tmp_path, rtcal):
    folder = tmp_path / "products"
    folder.mkdir()
    with pytest.raises(DataError, match="the folder has no file that ends in"):
        library.read(folder)
    (folder / "walls.csv").write_text("product;250;500;1000\nBrick;0,02;0,03;0,04\n")
    (folder / "baffle.xlsx").write_bytes(NAMED["products, e.xlsx"].content)
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
