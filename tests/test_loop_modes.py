"""The closed loop takes room modes along: below the Schroeder frequency they replace T."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.report.pages import page_of
from rtcal.support.errors import DataError
from tests.test_modes import BANDS, BOX, ROOM, TRUTH, heard, times
from tests.test_saved_results import back

MEASURED = rt.Measurement.from_values(BANDS, t20=times(TRUTH), edt=times(TRUTH))


@pytest.fixture(scope="module")
def told():
    """Return what the modes of the box say of its coefficients."""
    return rt.calibrate_modes(ROOM, heard(TRUTH))


def program(factor):
    """Return a simulator whose T is that of Eyring's equation, times a factor."""
    return rt.simulators.External(
        room=ROOM,
        name="program",
        run=lambda alpha, seed: factor * rt.Eyring().time(ROOM, ROOM.areas @ alpha),
    )


def test_an_exact_simulator_leaves_modes_below_and_the_equation_above(told):
    result = rt.calibrate_simulator(program(1.0), told, MEASURED, tolerance=1e-3)
    assert result.status == ("by modes", "by modes", "converged")
    np.testing.assert_array_equal(result.alpha[:, :2], told.alpha[:, :2])
    assert (np.abs(told.alpha[:, :2] - ROOM.alpha[:, :2]) > 0.005).any()
    above = rt.calibrate(told.room, [np.nan, np.nan, times(TRUTH)[2]])
    np.testing.assert_allclose(result.alpha[:, 2], above.alpha[:, 2], rtol=1e-6)
    assert (np.abs(result.alpha[:, 2] - told.alpha[:, 2]) > 1e-4).any()


def test_a_simulator_that_is_off_moves_the_bands_above_alone(told, tmp_path):
    result = rt.calibrate_simulator(program(1.2), told, MEASURED)
    np.testing.assert_array_equal(result.alpha[:, :2], told.alpha[:, :2])
    assert abs(result.gap[2]) < 1
    assert np.isnan(result.gap[:2]).all()
    assert not [m for m in result.trust_marks if m.kind == "below_schroeder"]
    assert "room modes replace the measured T." in " ".join(str(result).split())
    back(result, tmp_path)
    assert "room modes are used instead of T" in page_of(tmp_path)


def test_too_few_modes_keep_the_mark():
    few = rt.calibrate_modes(ROOM, heard(TRUTH).only([0, 1]))
    result = rt.calibrate_simulator(program(1.2), few, MEASURED)
    assert result.status == ("too few modes", "too few modes", "converged")
    marked = [m.frequency for m in result.trust_marks if m.kind == "below_schroeder"]
    assert marked == [63, 125]
    assert "Fewer than three modes determine 63 Hz, 125 Hz" in " ".join(str(result).split())


def test_what_is_refused(told):
    with pytest.raises(DataError, match="would count twice"):
        with_t = rt.calibrate_modes(ROOM, heard(TRUTH), times(TRUTH))
        rt.calibrate_simulator(program(1.0), with_t, MEASURED)
    with pytest.raises(DataError, match="every measured band"):
        low = rt.Measurement.from_values(BANDS[:2], t20=times(TRUTH)[:2])
        rt.calibrate_simulator(program(1.0), told, low)
    with pytest.raises(DataError, match="room"):
        rt.calibrate_simulator(program(1.0), heard(TRUTH), MEASURED)


def test_every_position_is_matched_above_alone(told):
    tracer = rt.simulators.PathTracing(
        room=ROOM,
        geometry=BOX,
        sources={"S": (1.0, 1.2, 1.1)},
        receivers={"R1": (4.0, 3.0, 1.4), "R2": (3.2, 1.0, 1.6)},
        n_paths=600,
        scattering=0.3,
    )
    measured = tracer.simulate(TRUTH, seed=1)
    controls = rt.loop.ControlRuns(
        parameters=("t20",), pairs=tracer.pairs, errors=0.05 * np.ones((4, 1, 2, 3))
    )
    result = rt.calibrate_positions(
        tracer, told, measured, ("t20",), controls=controls, more_paths=1, fit_scattering=False
    )
    np.testing.assert_allclose(result.alpha[:, :2], told.alpha[:, :2], atol=1e-8)
    np.testing.assert_allclose(result.sigma[:, :2], told.sigma[:, :2], rtol=1e-6)
    assert (np.abs(result.alpha[:, 2] - told.alpha[:, 2]) > 1e-3).any()
    assert any("room modes replace the measured T" in note for note in result.notes)
