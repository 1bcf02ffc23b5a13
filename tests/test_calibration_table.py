"""What a calibration prints of its bands, its room and its materials."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.calibration.table import of_bands, verdict
from tests.conftest import room_of


def test_which_decay_time_is_matched_leads_where_they_are_mixed(cr2):
    """The two lowest bands have T30 alone."""
    room, measured = cr2
    times = measured.mean("t30")
    low = np.arange(len(times)) < 2
    t20, t30 = np.where(low, np.nan, times), np.where(low, times, np.nan)
    mixed = rt.calibrate(
        room, rt.Measurement.from_values(room.centre_frequencies, t20=t20, t30=t30)
    )
    leading = of_bands(mixed.to_dict()).rows[0]
    assert leading.name == "matched"
    assert list(leading.cells) == ["T30", "T30", *["T20"] * 4]
    assert of_bands(rt.calibrate(*cr2).to_dict()).rows[0].name == "measured T / s"


@pytest.mark.parametrize(
    ("factor", "bands", "longer"),
    [([1.3, 1.3, 1.3], 3, True), ([1.3, 0.7, 1.3], 3, False), ([1.3], 1, False)],
)
def test_t_that_is_longer_in_every_band_is_said_to_be_the_equation(factor, bands, longer):
    centres = [500, 1000, 2000][:bands]
    room = room_of({"wall": (1000, 0.2, 0.004)}, centres, 2000, air=rt.Air(20, 50))
    t20 = np.array(factor) * rt.Eyring().reverberation_time(room)
    said = verdict(rt.calibrate(room, t20).to_dict()).text
    assert ("longer in every band" in said) is longer


def test_a_second_calibration_confirms_no_material(cr2):
    room = rt.calibrate(*cr2).room
    t20 = rt.Eyring().reverberation_time(room) * np.resize([1.001, 0.999], room.n_bands)
    found = verdict(rt.calibrate(room, t20).to_dict())
    assert "follow from a measurement of this room" in found.heading
    assert "do not confirm the materials" in found.text
