"""The workbook of a result: every number of its page has a cell of its own."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.report import pages

openpyxl = pytest.importorskip("openpyxl", reason="needs the extra tables")


def rows_of(book, name):
    sheet = book[name]
    return {row[0].value: [cell.value for cell in row[1:]] for row in sheet.iter_rows()}


def test_a_calibrations_numbers_have_cells(result, tmp_path):
    result.save(tmp_path)
    pages.write_workbook(tmp_path, tmp_path / "hall.xlsx")
    book = openpyxl.load_workbook(tmp_path / "hall.xlsx")
    bands = rows_of(book, "By band")
    assert bands[None] == [f"{f:g} Hz" for f in result.prior.centre_frequencies]
    np.testing.assert_allclose(bands["measured T / s"], result.measured)
    np.testing.assert_allclose(bands["deviation before / JND"], result.gap_before)
    coefficients = rows_of(book, "Absorption coefficients")
    low, high = result.interval
    for i, material in enumerate(result.prior.materials):
        name = f"{material}, {result.prior.areas[i]:.4g} m²"
        np.testing.assert_allclose(coefficients[name], result.alpha[i])
        np.testing.assert_allclose(coefficients[f"{name}, input"], result.prior.alpha[i])
        np.testing.assert_allclose(coefficients[f"{name}, 90 %: from"], low[i])
        np.testing.assert_allclose(coefficients[f"{name}, to"], high[i])
    assert result.verdict.text in [row[0].value for row in book["summary"].iter_rows()]


def test_a_loop_has_its_bands_and_what_was_simulated(loop_result, tmp_path):
    pages.write_workbook(loop_result.save(tmp_path), tmp_path / "loop.xlsx")
    book = openpyxl.load_workbook(tmp_path / "loop.xlsx")
    left = rows_of(book, "By band")["deviation / JND"]
    np.testing.assert_allclose(left, loop_result.gap, atol=1e-12)
    assert "Absorption coefficients" in book.sheetnames


def test_sheets_of_one_title_are_kept_apart(tmp_path):
    room = rt.datasets.bras_cr2()[0]
    window = rt.prediction.Change(open="windows", area=2.0)
    found = rt.prediction.predict(rt.calibrate(*rt.datasets.bras_cr2()), window)
    names = list(pages.sheets(pages.blocks_of(found)))
    assert len({name.casefold()[:31] for name in names}) == len(names) > 2
    assert room.name
