"""What a calibration prints of its bands, its room and its materials."""

from __future__ import annotations

import numpy as np
import pytest

import rtcal as rt
from rtcal.calibration.table import band_rows, coefficients, verdict


@pytest.fixture
def mixed(cr2: tuple[rt.Room, rt.Measurement]) -> rt.calibration.CalibrationResult:
    """CR2, of which the two lowest bands have T30 alone."""
    room, measured = cr2
    times = measured.mean("t30")
    low = np.arange(len(times)) < 2
    both = rt.Measurement.from_values(
        room.centre_frequencies,
        t20=np.where(low, np.nan, times),
        t30=np.where(low, times, np.nan),
    )
    return rt.calibrate(room, both)


def test_which_decay_time_is_matched_leads_where_they_are_mixed(
    cr2: tuple[rt.Room, rt.Measurement], mixed: rt.calibration.CalibrationResult
) -> None:
    leading = band_rows(mixed.to_dict())[0]
    assert leading.name == "matched"
    assert list(leading.cells) == ["T30", "T30", *["T20"] * 4]
    assert band_rows(rt.calibrate(*cr2).to_dict())[0].name == "measured T / s"


def test_each_material_has_its_name_and_its_coefficients(
    cr2: tuple[rt.Room, rt.Measurement],
) -> None:
    room, measured = cr2
    result = rt.calibrate(room, measured)
    entries = coefficients(room, result.alpha, result.room.sigma, result.interval)
    assert [entry["name"] for entry in entries] == list(room.materials)
    np.testing.assert_array_equal([entry["alpha_after"] for entry in entries], result.alpha)


@pytest.mark.parametrize(
    ("factor", "bands", "longer"),
    [([1.3, 1.3, 1.3], 3, True), ([1.3, 0.7, 1.3], 3, False), ([1.3], 1, False)],
)
def test_t_that_is_longer_in_every_band_is_said_to_be_the_equation(
    factor: list[float], bands: int, longer: bool
) -> None:
    room = rt.Room(
        name="hall",
        volume=2000,
        materials=["wall"],
        areas=[1000],
        alpha=[[0.2] * bands],
        sigma=[[0.004] * bands],
        centre_frequencies=[500, 1000, 2000][:bands],
        air=rt.Air(20, 50),
    )
    t20 = np.array(factor) * rt.Eyring().reverberation_time(room)
    said = verdict(rt.calibrate(room, t20).to_dict()).text
    assert ("longer in every band" in said) is longer


def test_a_second_calibration_confirms_no_material(cr2: tuple[rt.Room, rt.Measurement]) -> None:
    room = rt.calibrate(*cr2).room
    t20 = rt.Eyring().reverberation_time(room) * np.resize([1.001, 0.999], room.n_bands)
    found = verdict(rt.calibrate(room, t20).to_dict())
    assert "follow from a measurement of this room" in found.heading
    assert "do not confirm the materials" in found.text
