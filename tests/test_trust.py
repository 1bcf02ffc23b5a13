"""z, Q and the trust marks: right when the prior is true, and loud when it is not."""

import json
import warnings

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.marks import of_input, plausibility, trust_marks
from rtcal.report.pages import page
from tests.conftest import measurement_of, room_of


def test_q_counts_correlated_bands_once():
    """Two fully alike bands tell no more than one."""
    nearly = np.array([[1.0, 0.999999], [0.999999, 1.0]])
    found = plausibility(np.array([2.0, 2.0]), nearly, bound_active=False)
    assert found.q == pytest.approx(4.0, rel=1e-5)
    assert plausibility(np.array([2.0, 2.0]), np.eye(2), bound_active=False).q == 8


def test_five_materials_and_six_bands_take_at_most_forty_lines(cr2, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    result = rt.calibrate(*cr2)
    assert result.alpha.shape == (5, 6)
    assert len(str(result).splitlines()) < 40  # and one for the files that are written


def test_a_single_typing_error_is_stated_once(cr2):
    room, _ = cr2
    result = rt.calibrate(room, [0.9, 0.8, 0.7, 0.7, 0.6, 90.0], unreachable="nearest")
    said = " ".join(str(result).split())
    assert said.startswith("Likely a typing error at 4000 Hz")
    assert said.count("typing error") == 1
    assert "plaster, concrete, windows, floor and ceiling stand at their lower bounds" in said


def test_cr2_marks_125_hz_below_schroeder_and_implausible(cr2):
    result = rt.calibrate(*cr2)
    kinds = {(m.kind, m.frequency) for m in result.trust_marks}
    assert kinds == {("below_schroeder", 125), ("implausible", 125), ("implausible", 4000)}
    assert result.plausibility.z[0] == pytest.approx(4.6, abs=0.05)
    assert result.plausibility.p_value < 1e-4
    line = next(text for text in str(result).splitlines() if text.startswith("cautions"))
    assert line.split()[-6:] == ["sz", ".", ".", ".", ".", "z"]
    content = json.loads(result.to_json())
    assert {m["kind"] for m in content["trust_marks"]} == {"below_schroeder", "implausible"}
    assert all(m["advice"] for m in content["trust_marks"])


def test_every_mark_is_given_where_it_belongs_and_nowhere_else():
    room = room_of(
        {"wall": (400, 0.05, 0.02), "seats": (150, 0.5, 0.1)},
        [63, 500, 4000, 8000],
        1000,
        air=rt.Air(20, 30),
    )
    t = np.array([1.2, 1.2, 1.0, np.nan])
    quiet = {
        "measured": t,
        "uncertainty": np.full(4, 0.01),
        "air_share": np.full(4, 0.2),
        "active": np.zeros((2, 4)),
        "z": np.zeros(4),
    }

    def kinds(of=room, **changes):
        return {(m.kind, m.frequency) for m in trust_marks(of, **{**quiet, **changes})}

    base = {("below_schroeder", 63), ("missing", 8000)}
    assert kinds() == base
    assert kinds(z=np.array([0, -2.5, 1.9, np.nan])) == base | {("implausible", 500)}
    assert kinds(uncertainty=np.array([np.nan, 0.061, 0.049, 1])) == base | {("uncertain", 500)}
    odd = trust_marks(room, **{**quiet, "uncertainty": np.array([0.1, 1.0, 0.1, np.nan])})
    uncertain = {m.frequency: m.text for m in odd if m.kind == "uncertain"}
    assert "check that the uncertainty is in s, not in percent" in uncertain[500]  # 1 for 1 %
    assert uncertain[63] == uncertain[4000] == "T is uncertain by more than one JND"
    assert kinds(air_share=np.array([0, 0.49, 0.51, 0.2])) == base | {("air", 4000)}
    active = np.array([[0, -1, 0, 0], [0, 0, 1, 0]])
    assert kinds(active=active) == base | {("at_bound", 500), ("at_bound", 4000)}
    assert kinds(room.with_air(None)) == base | {("no_air", None)}
    # A cube of 1000 m³ has 600 m², a box of 27 x 27 x 1.36 m 1621 m².
    for areas in ([390, 140], [1500, 130]):
        assert [mark.kind for mark in of_input(room.replace(areas=areas))] == ["surface"]
    for areas in ([400, 150], [1500, 110]):
        assert of_input(room.replace(areas=areas)) == ()
    with pytest.raises(rt.errors.InfeasibleError, match="but even a cube of 1000 m³ has 600 m²"):
        rt.calibrate(room.replace(areas=[3, 1]), np.array([1.2, 1.2, 1.0, np.nan]))


def test_a_loop_warns_of_missing_air_once(cr2):
    """`rt.loop.start` said nothing; its command did, by the calibration after it."""
    room, measured = cr2
    with pytest.warns(rt.errors.MissingAirWarning, match="has no air"):
        loop = rt.loop.start(room.with_air(None), measured)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loop.calibrated(loop.wanted)
        rt.loop.start(room, measured)


def test_uncertainty_of_t_over_pairs():
    """Two sources x three receivers: n_eff is 3, not 6; never below ISO 3382-2's own variance."""
    rng = np.random.default_rng(3)
    t20 = 1.0 + 0.2 * rng.standard_normal((6, 2))
    pairs = [(s, r) for s in ("S1", "S2") for r in ("R1", "R2", "R3")]
    measured = rt.Measurement(centre_frequencies=[500, 1000], pairs=pairs, values={"t20": t20})
    spread = np.std(t20, axis=0, ddof=1) / np.sqrt(3)
    np.testing.assert_allclose(measured.reverberation_time_uncertainty, spread, rtol=1e-12)
    same = measurement_of([500, 1000], pairs, t20=np.ones((6, 2)))
    iso = 0.88 * np.sqrt((1 + 0.190) / (6 * 0.71 * np.array([500, 1000]) * 1.0))
    np.testing.assert_allclose(same.reverberation_time_uncertainty, iso, rtol=1e-12)
    t30 = measurement_of([500, 630], pairs, t30=np.ones((6, 2)))
    iso = 0.55 * np.sqrt((1 + 0.152) / (6 * 0.23 * np.array([500, 630]) * 1.0))
    np.testing.assert_allclose(t30.reverberation_time_uncertainty, iso, rtol=1e-12)
    t20[0, 1] = np.nan
    holes = rt.Measurement(centre_frequencies=[500, 1000], pairs=pairs, values={"t20": t20})
    assert holes.reverberation_time[1] == pytest.approx(np.mean(t20[1:, 1]))
    stated = measurement_of([500, 1000], pairs, u={"t20": np.full((6, 2), 0.06)}, t20=t20)
    assert stated.reverberation_time_uncertainty[0] == pytest.approx(0.06 / np.sqrt(6))


def test_t20_is_taken_else_t30_never_edt():
    measured = rt.Measurement.from_values(
        [250, 500, 1000], t20=[np.nan, 1.1, np.nan], t30=[1.2, 1.3, np.nan], edt=[1, 1, 1]
    )
    np.testing.assert_array_equal(measured.reverberation_time, [1.2, 1.1, np.nan])
    assert measured.reverberation_parameter == ("t30", "t20", "")


def test_uncertainty_of_t_reaches_b_and_z(cr2):
    """u_b = |db/dT| u_T, by a finite difference; z is smaller with it."""
    room, measured = cr2
    result = rt.calibrate(room, measured)
    u = result.measured_uncertainty
    up, down = (rt.Eyring().absorption_area(room, result.measured + s * 1e-4 * u) for s in (1, -1))
    np.testing.assert_allclose(result.target_uncertainty, np.abs(up - down) / 2e-4, rtol=1e-6)
    bare = rt.calibrate(room, result.measured)
    assert np.isnan(bare.target_uncertainty).all()
    assert np.all(np.abs(result.plausibility.z) < np.abs(bare.plausibility.z))


def _box(ceiling, **stated):
    """A classroom of 8 x 7.5 x 3 m, its ceiling of other coefficients than the rest."""
    surfaces = [
        rt.Surface("ceiling", "tiles", 60, "z"),
        rt.Surface("floor", "linoleum", 60, "z"),
        rt.Surface("long walls", "plaster", 48, "y"),
        rt.Surface("short walls", "plaster", 45, "x"),
    ]
    materials = {
        "tiles": rt.Material("tiles", [ceiling, ceiling], [0.05, 0.05]),
        "linoleum": rt.Material("linoleum", [0.03, 0.05], [0.01, 0.01]),
        "plaster": rt.Material("plaster", [0.03, 0.05], [0.01, 0.01]),
    }
    return rt.Room.from_surfaces(
        name="classroom",
        volume=180,
        materials=[*materials.values()],
        surfaces=surfaces,
        centre_frequencies=[500, 1000],
        air=rt.Air(),
        **stated,
    )


def test_a_room_in_which_equations_differ_is_marked():
    """Directions stated by axis; Arau-Puchades' equation of the package is the oracle."""
    for ceiling in (0.05, 0.2, 0.8):
        room = _box(ceiling)
        result = rt.calibrate(room, 1.02 * rt.Eyring().reverberation_time(room))
        arau, eyring = (e.reverberation_time(result.room) for e in (rt.ArauPuchades(), rt.Eyring()))
        apart = np.abs(arau - eyring) / (0.05 * eyring)
        marks = [m for m in result.trust_marks if m.kind == "equations_differ"]
        assert bool(marks) == (apart.max() > 1)
        if not marks:
            continue
        k = int(np.argmax(apart))
        assert f"{eyring[k]:.2f} s by Eyring's equation and {arau[k]:.2f} s by" in marks[0].text
        assert f"{apart[k]:.1f} JND apart" in marks[0].text
        assert "rtcal fit" in marks[0].advice
        for said in (" ".join(str(result).split()), page(result).replace("&#39;", "'")):
            assert "the absorption is uneven, so T at" in said
        assert "equations_differ" in result.to_json()
        assert result.verdict.level != "agrees"


def test_a_shift_that_a_bound_leaves_to_another_material_contradicts_what_was_stated():
    """T of a ceiling at 1 and of walls that absorb five standard deviations more than stated."""
    room = _box(0.95)
    room = room.replace(sigma=[[0.3, 0.05], [0.01, 0.01], [0.01, 0.01]])
    true = room.alpha.copy()
    true[:, 0] = 1.0, 0.03 + 0.05 * 60 / 93, 0.03 + 0.05
    result = rt.calibrate(room, rt.Eyring().reverberation_time(room.replace(alpha=true)))
    assert np.abs(result.plausibility.z).max() < 2
    distance = np.linalg.norm(result.shift_in_sigmas[:, 0])
    assert distance > 5
    (mark,) = [m for m in result.trust_marks if m.kind == "implausible"]
    assert mark.frequency == 500
    assert result.verdict.level == "contradicts"
    assert "At 500 Hz the measured T needs" in " ".join(str(result).split())
    inside = rt.calibrate(
        room, rt.Eyring().reverberation_time(room.replace(alpha=room.alpha * 1.01))
    )
    assert not [m for m in inside.trust_marks if m.kind == "implausible"]


# Law: a mark claims no more than the answer shows: a bound is no lack of absorption where T is met

EYRING = rt.Eyring()
LACKS = "more absorption than these materials can have"


def room(fixed=False):
    stone = (20, 0.02, 0.0 if fixed else 0.001)
    materials = {"wall": (150, 0.3, 0.002), "panel": (4, 0.9, 0.1), "stone": stone}
    return room_of(materials, [1000], 200, air=rt.Air(20, 50))


def advice(result):
    return [m.advice for m in result.trust_marks if m.kind == "at_bound"]


def test_one_small_material_at_one_where_t_is_met():
    stated = room()
    result = rt.calibrate(stated, EYRING.time(stated, stated.absorption_area + 1.0))
    assert result.active.ravel().tolist() == [0, 1, 0]
    assert np.abs(result.gap_after).max() < 1e-9
    (said,) = advice(result)
    assert LACKS not in said
    assert "the other materials supply" in said
    assert LACKS not in str(result)


@pytest.mark.parametrize("fixed", [False, True])
def test_every_material_at_one(fixed):
    """A fixed material can supply nothing."""
    stated = room(fixed)
    t = rt.Sabine().time(stated, np.array([200.0]))
    result = rt.calibrate(stated, t, equation=rt.Sabine(), unreachable="nearest")
    assert (result.active > 0).sum() == 3 - fixed
    assert all(LACKS in said for said in advice(result))
