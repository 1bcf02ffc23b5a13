"""The workbook of a result: every number has a cell of its own, under its band, beside its position."""

from __future__ import annotations

import numpy as np
import pytest

from rtcal.report import pages

openpyxl = pytest.importorskip("openpyxl", reason="needs the extra tables")


def record() -> dict:
    """Return a record as results at positions have it, whole or as a part of another's."""
    values = np.arange(12.0).reshape(2, 3, 2)
    return {
        "parameters": ["t20", "edt"],
        "pairs": [["S1", "R1"], ["S1", "R2"], ["S2", "R1"]],
        "centre_frequencies": [500.0, 1000.0],
        "map": values.tolist(),
        "groups": [["west", "east"]],
        "score": 3.5,
    }


@pytest.mark.parametrize("inside", [False, True])
def test_a_value_of_a_position_stands_beside_its_names(inside) -> None:
    made = pages.tables_of({"rtcal": "x", "finding": record()} if inside else record())
    table = made["finding map" if inside else "map"]
    assert table[0] == ["parameter", "source", "receiver", "500 Hz", "1000 Hz"]
    assert table[1:3] == [["t20", "S1", "R1", 0.0, 1.0], ["t20", "S1", "R2", 2.0, 3.0]]
    assert table[6] == ["edt", "S2", "R1", 10.0, 11.0]
    assert made["finding pairs" if inside else "pairs"][0] == ["source", "receiver"]
    # Two names are no values of two bands.
    assert made["finding groups" if inside else "groups"][0] == ["column 1", "column 2"]
    assert "bands" not in made


def test_a_part_at_the_pairs_of_the_whole_names_them() -> None:
    """The sheets of what was not matched had the sources 1, 2, 3 and no receiver."""
    part = {"parameters": ["c80"], "gap": [[[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]]}
    made = pages.tables_of({**record(), "not_matched": part, "contradictions": [["S1", "R2"]]})
    assert made["not_matched gap"][2] == ["c80", "S1", "R2", 3.0, 4.0]
    assert made["contradictions"] == [["source", "receiver"], ["S1", "R2"]]


def test_what_lacks_names_is_numbered() -> None:
    bare = {k: v for k, v in record().items() if k not in ("parameters", "pairs")}
    assert pages.tables_of(bare)["map"][4] == [2, 1, None, 6.0, 7.0]


def test_a_loop_has_its_bands_materials_and_simulations(loop_result, tmp_path) -> None:
    loop = loop_result.loop
    pages.write_workbook(loop_result.save(tmp_path), tmp_path / "loop.xlsx")
    book = openpyxl.load_workbook(tmp_path / "loop.xlsx")
    sheet = book["bands"]
    columns = {column[0].value: [c.value for c in column[1:]] for column in sheet.columns}
    np.testing.assert_allclose(columns["band / Hz"], loop.room.centre_frequencies)
    np.testing.assert_allclose(columns["bands gap left / JND"], loop.gap, atol=1e-12)
    assert [row[0].value for row in book["materials"].iter_rows(min_row=2)] == list(
        loop.room.materials
    )
    assert book["simulated"].max_row == 1 + len(loop.steps)
    assert book["simulated"]["B1"].value == "target 125 Hz"


def test_what_is_of_each_material_says_of_which() -> None:
    stated = {
        "centre_frequencies": [125, 250],
        "materials": [{"name": "floor"}, {"name": "wall"}],
        "scattering": {"sigma": [[0.1, 0.2], [0.3, 0.4]]},
    }
    sheet = pages.tables_of(stated)["scattering sigma"]
    assert sheet == [["material", "125 Hz", "250 Hz"], ["floor", 0.1, 0.2], ["wall", 0.3, 0.4]]
