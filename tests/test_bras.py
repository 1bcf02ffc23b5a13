"""Two real rooms in third-octaves: a golden test of the equations, and calibration end to end."""

import csv

import numpy as np
import pytest

import rtcal as rt


def bras(folder, name, which):
    """The room with its ``initial`` or ``fitted`` coefficients, and its measured T20."""

    def rows(table, **stated):
        with (folder / "bras" / f"{table}.csv").open(newline="", encoding="utf-8") as stream:
            return [
                r for r in csv.DictReader(stream) if r.items() >= {"room": name, **stated}.items()
            ]

    (room,) = rows("rooms")
    (measured,) = rows("measured_third_octave", parameter="T20")
    bands = [c for c in measured if c.isdigit()]
    areas = {r["material"]: float(r["area_m2"]) for r in rows("surfaces")}
    alpha = {
        r["material"]: [float(r[b]) for b in bands]
        for r in rows("absorption_third_octave", set=which)
    }
    values = np.array([alpha[m] for m in areas])
    made = rt.Room(
        name=name,
        volume=float(room["volume_m3"]),
        materials=list(areas),
        areas=np.array(list(areas.values())),
        alpha=values,
        sigma=np.maximum(0.3 * values, 0.01),
        centre_frequencies=np.array([float(b) for b in bands]),
        air=rt.Air(float(room["temperature_C"]), float(room["rel_humidity_pct"])),
    )
    return made, np.array([float(measured[b]) for b in bands])


@pytest.mark.parametrize("name", ["CR2", "CR3"])
def test_fitted_coefficients_give_the_measured_t20(shared_data, name):
    """Within 0.7 % in every band. They came from such a fit: this checks code, not physics."""
    room, t20 = bras(shared_data, name, "fitted")
    assert room.n_bands == 24
    np.testing.assert_allclose(rt.Eyring().reverberation_time(room), t20, rtol=0.007)


@pytest.mark.parametrize("name", ["CR2", "CR3"])
def test_calibration_meets_every_reachable_band(shared_data, name):
    room, t20 = bras(shared_data, name, "initial")
    result = rt.calibrate(room, t20, unreachable="nearest")
    named = {u.frequency for u in result.unreachable}
    met = np.array([f not in named for f in room.centre_frequencies])
    assert met.sum() >= 20
    np.testing.assert_allclose(result.reverberation_time_after[met], t20[met], rtol=1e-9)
    for u in result.unreachable:
        assert not u.lowest <= u.target <= u.highest
        assert abs(u.reverberation_time / u.longest - 1) > 0


def test_a_band_beyond_reach_is_named_and_the_others_are_met(shared_data):
    """At 63 times the measured T no coefficients of 0 or more would do."""
    room, t20 = bras(shared_data, "CR2", "initial")
    t20[-1] *= 63
    with pytest.raises(rt.errors.InfeasibleError, match=r"T\[16000 Hz\] = 23.27 s"):
        rt.calibrate(room, t20)
    result = rt.calibrate(room, t20, unreachable="nearest")
    assert [u.frequency for u in result.unreachable] == [16000]
    np.testing.assert_allclose(result.reverberation_time_after[:-1], t20[:-1], rtol=1e-9)
    np.testing.assert_array_equal(result.alpha[:, -1], 0)
    assert result.reverberation_time_after[-1] == pytest.approx(result.unreachable[0].longest)
