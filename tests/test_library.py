"""Product data as a material list, and the catalogue's nearest entries."""

from __future__ import annotations

import io
import json
from pathlib import Path

import openpyxl
import pytest

import rtcal as rt
from rtcal.command.main import main
from rtcal.io import library
from rtcal.support.errors import DataError


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as end:
        main([str(a) for a in arguments])
    return int(end.value.code or 0)


def book(rows: list[list[object]]) -> bytes:
    made = openpyxl.Workbook()
    for row in rows:
        made.active.append(row)
    stream = io.BytesIO()
    made.save(stream)
    return stream.getvalue()


BAFFLE = (0.45, 0.9, 1.0)
SAME: dict[str, bytes] = {
    "a.csv": b"product;mounting;250;500;1000\nBaffle;E-400;0,45;0,90;1,10\n",
    "b.csv": b"ISO 354 laboratory X\nproduct,250 Hz,500 Hz,1 kHz\nBaffle,45 %,90 %,110 %\n",
    "c.csv": b"material,250,500,1000,alpha in %\nBaffle,45,90,110,x\n",
    "d.txt": b"f / Hz\tBaffle\tOther\n250\t0.45\t0.1\n500\t0.9\t0.1\n1000\t1.1\t0.1\n",
    "Baffle.csv": b"Frequency;alpha_s\n250;0,45\n500;0,9\n1000;1,1\n",
    "e.xlsx": book([["Product", 250, 500, 1000], ["Baffle", 0.45, 0.9, 1.1]]),
}


@pytest.mark.parametrize("name", SAME)
def test_tables_of_products(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(SAME[name])
    baffle = library.read(path).listed("Baffle")
    assert baffle.alpha == pytest.approx(BAFFLE, rel=1e-12)
    assert baffle.centre_frequencies == (250, 500, 1000)
    assert "above 1 (edge effect), taken as 1: 1.10 at 1000 Hz" in baffle.source
    if name == "a.csv":
        assert "mounting: E-400" in baffle.source
    if name == "b.csv":
        assert "ISO 354 laboratory X" in baffle.source


@pytest.mark.parametrize(
    ("content", "rule"),
    [
        (
            b"product;250;500;1000\nBaffle;45;90;95\n",
            "Baffle at 250 Hz: 45 is not from 0 to 1.5; name %",
        ),
        (b"product;250;500;1000\nBaffle;-0,1;0;0\n", "-0.1 is not from 0 to 1.5"),
        (
            b"product;250;500;1000\nBaffle;low;0;0\n",
            'Baffle at 250 Hz: "low" is not a finite number',
        ),
        (b"product;250;500;1000\n;0,1;0,1;0,1\n", "coefficients without a product's name"),
        (b"product;250;500;1000\nA;0,1;0,1;0,1\nA;0,2;0,2;0,2\n", '"A" is given twice'),
        (b"a;b\n1;2\n", "no table of coefficients; a header with 3 bands or more is needed"),
        (b"250;500;1000\n0.1;0.2;0.3\n", "no column has the product's name"),
        (
            b"product;125;250;250;1000\nA;0,1;0,2;0,8;0,9\n",
            r"products\.csv, line 1: column 3 and column 4 are both 250 Hz; a band has one",
        ),
        (
            b"f;A\n125;0,1\n250;0,2\n500;0,3\n250;0,8\n",
            r"products\.csv: line 3 and line 5 are both 250 Hz; a band has one coefficient",
        ),
        (
            "Äquivalente Absorptionsfläche je Stück\nproduct;250;500;1000\nA;0,4;0,6;0,8\n".encode(),
            "names absorption areas in m², and no coefficients: multiply one by the number of objects",
        ),
        (b"f;Chair A_obj [m2]\n125;0,1\n250;0,2\n500;0,3\n", "Chair A_obj.*names absorption areas"),
        (b"product;open area [%];250;500;1000\nA;18;45;90;95\n", "45 is not from 0 to 1.5; name"),
    ],
)
def test_bad_tables(tmp_path: Path, content: bytes, rule: str) -> None:
    path = tmp_path / "products.csv"
    path.write_bytes(content)
    with pytest.raises(DataError, match=rule):
        library.read(path)


@pytest.mark.parametrize(
    ("content", "alpha"),
    [
        ("product;open area [%];125;250;500\nwall;18;0,5;0,5;0,5\n", 0.5),
        ("product;% open area;125;250;500\nwall;18;0,5;0,5;0,5\n", 0.5),
        ("Schallabsorptionsgrad bei 50 % r. F.\nproduct;125;250;500\nwall;0,5;0,5;0,5\n", 0.5),
        ("f;wall;panel, 20 % open\n125;0,5;0,5\n250;0,5;0,5\n500;0,5;0,5\n", 0.5),
        ("α_s (50 % r. F.)\nf;wall;b\n125;0,5;0,5\n250;0,5;0,5\n500;0,5;0,5\n", 0.5),
        ("product;open area [%];125 Hz [%];250 Hz [%];500 Hz [%]\nwall;18;1;1;1\n", 0.01),
        ("Absorptionsgrad αs in % bei 50 % r. F.\nproduct;125;250;500\nwall;1;1;1\n", 0.01),
        ("Absorption coefficient [%]\nf;wall;b\n125;1;0\n250;1;0\n500;1;0\n", 0.01),
        ("f;wall [%];b\n125;1;1\n250;1;1\n500;1;1\n", 0.01),
    ],
)
def test_percent_is_the_unit_of_what_it_stands_with(
    tmp_path: Path, content: str, alpha: float
) -> None:
    """A % in any header or title had made alpha 0.005 of 0.5."""
    (tmp_path / "products.csv").write_text(content, encoding="utf-8")
    wall = library.read(tmp_path / "products.csv").materials[0]
    assert wall.alpha == (alpha,) * 3
    assert ("taken as fractions" in wall.source) == (alpha == 0.5)


@pytest.mark.parametrize(
    "content",
    [
        "product;125;250;500\nwall;0,5;;0,5\nfloor;0,1;0,1;0,1\n",
        "f;wall;floor\n125;0,5;0,1\n250;;0,1\n500;0,5;0,1\n",
    ],
)
def test_an_empty_cell_is_told_with_its_product(tmp_path: Path, content: str) -> None:
    """The room had a band less without a word."""
    (tmp_path / "products.csv").write_text(content)
    wall, floor = library.read(tmp_path / "products.csv").materials
    assert wall.source.endswith("; no coefficient at 250 Hz")
    assert "no coefficient" not in floor.source


def test_a_folder_is_a_library(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "products"
    folder.mkdir()
    with pytest.raises(DataError, match=r"products: no file that ends in \.csv, \.txt, \.xlsx"):
        library.read(folder)
    (folder / "walls.csv").write_text("product;250;500;1000\nBrick;0,02;0,03;0,04\n")
    (folder / "baffle.xlsx").write_bytes(SAME["e.xlsx"])
    assert [*library.read(folder).names] == ["Baffle", "Brick"]
    out = tmp_path / "room.toml"
    command = (
        "import",
        "library",
        folder,
        "--volume",
        200,
        "--area",
        "walls=200",
        "--area",
        "Baffle=20",
    )
    assert run(*command, "--as", "walls=Brick", "--name", "Studio 1", "--out", out) == 0
    assert "edge effect" in capsys.readouterr().out
    room = rt.Room.from_file(str(out))
    assert (room.name, room.materials) == ("Studio 1", ("walls", "Baffle"))
    assert room.alpha.tolist() == [[0.02, 0.03, 0.04], [*BAFFLE]]
    assert run(*command, "--out", out) == 2
    assert '"walls"' in capsys.readouterr().err
    (folder / "again.csv").write_text("product;250;500;1000\nBrick;0,02;0,03;0,04\n")
    with pytest.raises(DataError, match=r'"Brick" is given twice, also in .*again\.csv'):
        library.read(folder)


def test_names_of_the_trade_find_something_sensible() -> None:
    pytest.importorskip("pyroomacoustics")
    catalogue = rt.datasets.catalogue
    for name, word in (
        ("vinyl floor", "linoleum"),
        ("perforated metal panel", "metal"),
        ("Parkett", "wood"),
        ("window", "glass"),
        ("gypsum board", "gypsum"),
        ("carpet_on_floor", "carpet"),
        ("upholstered seats", "upholstered"),
        ("Beton", "concrete"),
    ):
        described = catalogue.names()
        for entry in catalogue.similar(name, 1):
            assert word in f"{entry} {described[entry]}".lower(), (name, entry)
    assert catalogue.similar("xyzzy") == []
    assert catalogue.nearest("vinyl floor", 1) == [
        "linoleum_on_concrete: Linoleum, asphalt, rubber, or cork tile on concrete, "
        "alpha 0.03 ± 0.02 at 500 Hz"
    ]


def test_json_is_printed_though_quiet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "t.csv"
    path.write_text("Frequency;T20\n500;1,5\n")
    assert run("table", path, "--json", "-q") == 0
    assert json.loads(capsys.readouterr().out)["values"]["t20"] == [[1.5]]
    assert run("table", path, "-q") == 0
    assert capsys.readouterr().out == ""
