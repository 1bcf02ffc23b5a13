"""What a calibration prints of its bands, its room and its materials."""

from __future__ import annotations

import numpy as np
import pytest

import rtcal as rt
from rtcal.calibration.table import band_rows, coefficients, remarks


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


def test_what_the_room_states_of_its_uncertainty_is_repeated(
    cr2: tuple[rt.Room, rt.Measurement],
) -> None:
    room, measured = cr2
    exact, uncertain = (
        remarks(rt.calibrate(of, measured).to_dict())[0]
        for of in (room, room.replace(volume_sigma=0.05))
    )
    assert exact.endswith("the room states no uncertainty of them.")
    assert "volume 5 %" in uncertain
    by_method = remarks(
        rt.calibrate(room.replace(volume_sigma=0.05), measured, method="lse").to_dict()
    )
    assert "taken as exact; stated is" in by_method[0]
    assert "volume 5 %" in by_method[0]
