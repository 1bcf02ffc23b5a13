"""A value far from its neighbours is called a likely typing error before anything else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.marks import far_from_neighbours, in_measurement, in_room
from rtcal.io import tables
from rtcal.report.finding_words import cautions

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


def a_box(**stated: object) -> rt.Room:
    """5 x 4 x 3 m of even absorption but for its ceiling, by areas alone."""
    return rt.Room(
        name="box",
        volume=60,
        materials=["ceiling", "floor", "rest"],
        areas=[20, 20, 54],
        alpha=[[0.9] * 2, [0.1] * 2, [0.1] * 2],
        sigma=[[0.1] * 2, [0.03] * 2, [0.03] * 2],
        centre_frequencies=[500, 1000],
        dimensions=(5, 4, 3),
        air=rt.Air(),
        **stated,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize(("row", "factor"), [(0, 10), (1, 10), (2, 10), (2, 0.1), (0, 0.1)])
def test_an_area_that_is_ten_times_another_is_named_first(row: int, factor: float) -> None:
    room = a_box()
    t = rt.Eyring().reverberation_time(room)
    kinds = {mark.kind for mark in rt.calibrate(room, t).trust_marks}
    assert "equations_differ" in kinds
    assert not {"area_typing_error", "box_surface"} & kinds
    areas = room.areas.copy()
    areas[row] *= factor
    wrong = room.replace(areas=areas)
    result = rt.calibrate(wrong, t, unreachable="nearest")
    marks = [mark.kind for mark in result.trust_marks]
    named = f'area of "{room.materials[row]}" = {areas[row]:g} m², for {room.areas[row]:g} m²'
    assert marks[0] == "area_typing_error"
    assert named in str(result)
    assert "Likely a typing error: " in str(result)
    # The other caution stays, though the areas no longer show what the directions are.
    assert {"equations_differ", "directions_unknown"} & {*marks}
    if row == 1:
        measured = rt.Measurement.from_values([500, 1000], t20=t)
        found = rt.find(wrong, measured)
        assert cautions(found)[0].startswith(f"Likely a typing error: {named}")


def test_furniture_and_steps_are_no_mistyped_area() -> None:
    room = a_box()
    for more in ([20, 20, 54 * 0.9], [20, 30, 74], [25, 25, 60]):
        assert in_room(room.replace(areas=more)) == []
    (mark,) = in_room(room.replace(areas=[60, 60, 60]))
    assert mark.kind == "box_surface"
    assert "180 m², but a box of 5 x 4 x 3 m has 94 m²" in mark.text


@pytest.mark.parametrize("factor", [0.001, 0.1, 10, 1000])
def test_a_factor_of_ten_in_every_band_is_named_before_anything_else(factor: float) -> None:
    t = rt.Eyring().reverberation_time(room())
    result = rt.calibrate(room(), factor * t, unreachable="nearest")
    assert result.trust_marks[0].kind == "unit_error"
    assert str(result).count("Likely a typing error: T is") == 1
    if factor > 1:
        with pytest.raises(rt.errors.InfeasibleError, match=r"^T is .* likely a typing error, or"):
            rt.calibrate(room(), factor * t)
    for other in (0.3, 3.0):
        marks = rt.calibrate(room(), other * t, unreachable="nearest").trust_marks
        assert "unit_error" not in {mark.kind for mark in marks}
