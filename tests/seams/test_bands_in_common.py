"""A law: room and file may differ in bands. What both have is compared; the rest is said once."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.datasets import examples
from rtcal.finder.effects import library
from rtcal.support.errors import OtherBandsWarning
from tests.conftest import program_of

THIRDS = (200, 250, 315, 400, 500, 630, 800, 1000, 1250, 1600, 2000, 2500)
IN_BANDS = {
    "alike": lambda m: m,
    "one more": lambda m: with_values(m, [*m.centre_frequencies, 4000], np.r_[0:4, 3]),
    "one fewer": lambda m: with_values(m, m.centre_frequencies[1:], np.r_[1:4]),
    "thirds": lambda m: m.in_bands(THIRDS),
}
NOTES = {
    "alike": [],
    "one more": ["T at 4000 Hz is left out, because the room does not have this band."],
    "one fewer": ["Of 240 values 60 are missing, and left out."],
    "thirds": [
        "T is converted from third-octaves to octaves: the mean of 1/T over the three thirds."
    ],
}


def with_values(measured, bands, columns):
    values = {p: v[:, columns] for p, v in measured.values.items()}
    return replace(measured, centre_frequencies=np.asarray(bands, dtype=float), values=values)


@pytest.fixture(scope="module")
def searched(kept):
    """Return the finding in the shipped room, whose file has other bands."""
    room = rt.Room.from_file(str(examples.path("where_room/room.toml")))
    measured = rt.Measurement.from_file(str(examples.path("where_room/pairs.csv")))
    curtain = [e for e in library() if e.name == "curtain"]

    def of(bands):
        case = rt.finder.case_of(room, IN_BANDS[bands](measured), tracing={"n_paths": 600})
        with warnings.catch_warnings():
            warnings.simplefilter("error", OtherBandsWarning)  # the notes say it
            return rt.find(case, effects=curtain, cache=kept)

    return of


@pytest.fixture(scope="module")
def gaps(searched, kept):
    return rt.finder.verify(searched("alike"), cache=kept).gaps


@pytest.mark.long
@pytest.mark.parametrize("bands", ["one more", "thirds", "one fewer"])
def test_bands_in_common_are_compared(bands, searched, gaps, kept):
    found = searched(bands)
    about = ("T at 4000 Hz", "Of 240", "T is converted")
    assert [note for note in found.notes if note.startswith(about)] == NOTES[bands]
    made = rt.finder.verify(found, cache=kept).gaps
    assert made.shape == gaps.shape
    if bands == "one fewer":
        assert np.isnan(made[..., 0]).all()
        assert np.isfinite(made[..., 1:]).all()
        # What nothing was calibrated to is the same in the bands that are left.
        np.testing.assert_allclose(made[0, ..., 1:], gaps[0, ..., 1:], atol=1e-9)
    else:  # a calibration's last step is rounded otherwise on another machine
        np.testing.assert_allclose(made, gaps, atol=1e-4)  # JND


OTHERS = {
    "left out": ([63, 125, 250, 500, 1000, 2000, 4000], "T at 63 Hz is left out, because"),
    "thirds": (THIRDS, "converted from third-octaves to octaves"),
    "few": ([500, 1000], "no T was measured at 125 Hz, 250 Hz, 2000 Hz, 4000 Hz"),
}


@pytest.mark.parametrize(("frequencies", "said"), OTHERS.values(), ids=OTHERS)
def test_the_library_s_loop_says_what_its_command_says(frequencies, said):
    room = rt.datasets.bras_cr2()[0]
    measured = rt.Measurement.from_values(frequencies, t20=np.full(len(frequencies), 1.8))
    with pytest.warns(OtherBandsWarning, match=said):
        rt.loop.start(room, measured)
    with warnings.catch_warnings():
        warnings.simplefilter("error", OtherBandsWarning)
        result = rt.calibrate_simulator(program_of(room), room, measured)
    lacking = [s for s in result.status if s == "no measured T"]
    assert said.lower() in " ".join(result.notes).lower() or len(lacking) == 4
