"""A value far from its neighbours is called a likely typing error before anything else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.marks import far_from_neighbours, in_measurement, in_room
from rtcal.io import tables

BANDS = [125, 250, 500, 1000, 2000, 4000]
USUAL = [1.1, 1.3, 1.24, 1.2, 1.05, 0.84]


def room(**stated: object) -> rt.Room:
    return rt.Room(
        name="classroom",
        volume=210,
        materials=["plaster", "linoleum", "tiles"],
        areas=[120, 70, 70],
        alpha=[[0.05] * 6, [0.04] * 6, [0.2, 0.25, 0.3, 0.35, 0.35, 0.4]],
        sigma=[[0.02] * 6, [0.02] * 6, [0.1] * 6],
        centre_frequencies=BANDS,
        air=rt.Air(),
        **stated,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("factor", [1 / 20, 1 / 10, 10, 20])
@pytest.mark.parametrize("band", range(6))
def test_a_value_20_times_its_neighbours_is_found_and_nothing_else(
    band: int, factor: float
) -> None:
    t = np.array(USUAL)
    assert not far_from_neighbours(t).any()
    t[band] *= factor
    assert np.flatnonzero(far_from_neighbours(t)).tolist() == [band]
    # Another unit or another room for all bands is no outlier among them.
    assert np.array_equal(far_from_neighbours(1000 * t), far_from_neighbours(t))
    assert np.array_equal(far_from_neighbours(t[::-1]), far_from_neighbours(t)[::-1])


def test_what_rooms_do_is_no_typing_error() -> None:
    """Church: the air halves T per octave. Booth: long in the first band."""
    church = np.array([9.5, 9.0, 8.2, 6.5, 4.2, 2.2, 1.0, 0.4])
    booth = np.array([0.55, 0.2, 0.15, 0.13, 0.12, 0.12])
    assert not far_from_neighbours(church).any()
    assert not far_from_neighbours(booth).any()
    assert not far_from_neighbours(np.array([1.9, 0.05])).any()  # which of the two is open
    assert not far_from_neighbours(np.array([0.5, 0.5, 6.0, 6.0])).any()
    some = np.array([np.nan, 1.9, np.nan, 0.05, np.nan, 1.6])
    assert np.flatnonzero(far_from_neighbours(some)).tolist() == [3]
    _, measured = rt.datasets.bras_cr2()
    assert in_measurement(measured) == []


def test_one_pair_of_many_is_found_though_the_mean_hides_it(tmp_path: Path) -> None:
    table = np.tile(USUAL, (8, 1)) * np.linspace(0.97, 1.03, 8)[:, np.newaxis]
    table[5, 3] /= 20
    measured = rt.Measurement(
        centre_frequencies=BANDS,
        values={"t30": table},
        pairs=[("S1", f"R{i}") for i in range(8)],
    )
    result = rt.calibrate(room(), measured)
    assert result.trust_marks[0].text.startswith("T30 (S1 to R5) = 0.0608 s, beside 1.26 s at")
    tables.write(measured, tmp_path / "t.csv")
    said = str(tables.read(tmp_path / "t.csv")).splitlines()
    assert said[0].startswith("likely a typing error at 1000 Hz: T30 (S1 to R5) = ")


def test_a_coefficient_a_tenth_of_its_neighbours_is_found_and_no_resonator_is_missed() -> None:
    alpha = room().alpha.copy()
    assert in_room(room()) == []
    alpha[2, 3] = 0.035 / 2
    wrong = room().replace(alpha=alpha)
    assert [e.frequency for e in in_room(wrong)] == [1000]
    mark = rt.calibrate(wrong, USUAL).trust_marks[0]
    assert mark.kind == "alpha_typing_error"
    assert mark.text == 'alpha of "tiles" = 0.0175, beside 0.3 at 500 Hz and 0.35 at 2000 Hz'
    alpha[2] = [0.1, 0.25, 0.85, 0.3, 0.12, 0.1]
    assert in_room(room().replace(alpha=alpha)) == []
