"""Modes below the Schroeder frequency: closed forms, poles, tables, and the calibration to them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import fsolve

import rtcal as rt
from rtcal.modes import MeasuredModes, absorption, admittance
from rtcal.modes.measured import match
from rtcal.modes.room_modes import AtFrequencies, admittance_slope, box_modes
from rtcal.report.pages import page_of
from rtcal.simulators.geometry import SHOEBOX_WALLS
from rtcal.support.blocks import Table
from rtcal.support.errors import DataError
from tests.conftest import also, measurement_of
from tests.test_saved_results import back

SIDES = np.array([5.2, 4.1, 2.6])
BANDS = (63, 125, 250)


def box_room(sides=SIDES, materials=SHOEBOX_WALLS):
    box = rt.simulators.Polyhedron.shoebox(
        sides, dict(zip(SHOEBOX_WALLS, SHOEBOX_WALLS, strict=True))
    )
    room = rt.Room.from_geometry(
        box,
        name="box",
        dimensions=sides,
        centre_frequencies=BANDS,
        materials=[rt.Material(w, [0.12] * 3, [0.08] * 3) for w in materials],
        air=rt.Air(20, 50),
    )
    return box, room


BOX, ROOM = box_room()
TRUTH = np.array([0.25, 0.25, 0.08, 0.08, 0.15, 0.15])[:, np.newaxis] * np.ones(3)
C = ROOM.air.speed_of_sound


def heard(alpha, error=0.04, seed=0, top=110.0):
    """Return the box's modes with these coefficients, and errors of their decays."""
    poles = box_modes(SIDES, SHOEBOX_WALLS, top, C).poles(lambda f: admittance(alpha[:, 0]))
    order = np.argsort(poles.frequencies)
    noise = 1 + error * np.random.default_rng(seed).standard_normal(len(order))
    return MeasuredModes(
        frequencies=poles.frequencies[order],
        decays=poles.decays[order] * noise,
        decay_uncertainty=error * poles.decays[order],
    )


def times(alpha):
    return rt.Eyring().time(ROOM, ROOM.areas @ alpha)


@pytest.mark.parametrize("beta", [0.01, 0.638, 0.02 + 0.05j, 0.3 - 0.5j, 1.5 + 1j])
def test_paris_integral(beta):
    def absorbed(angle):
        cosine = np.cos(angle)
        return 4 * np.real(beta) * cosine / abs(cosine + beta) ** 2 * np.sin(2 * angle)

    assert absorption(beta) == pytest.approx(quad(absorbed, 0, np.pi / 2)[0], rel=1e-9)


def test_admittance_is_the_inverse_with_its_slope():
    alpha = np.array([0.0, 1e-4, 0.01, 0.1, 0.4, 0.856, 1.0])
    beta, slope = admittance(alpha), admittance_slope(alpha)
    np.testing.assert_allclose(absorption(beta[:-1]), alpha[:-1], rtol=1e-9)
    rise = (admittance(alpha[1:-1] * (1 - 1e-6)) - beta[1:-1]) / (-alpha[1:-1] * 1e-6)
    np.testing.assert_allclose(slope[1:-1], rise, rtol=1e-4)
    assert beta[-1] - beta[-2] == pytest.approx(0.144 * slope[-1])  # along its tangent


@pytest.mark.parametrize(
    ("call", "value", "words"),
    [
        (admittance, 1.2, "alpha"),
        (admittance, float("nan"), "alpha"),
        (absorption, -0.1, "real part"),
    ],
)
def test_what_has_no_admittance(call, value, words):
    with pytest.raises(DataError, match=words):
        call(value)


def test_poles_are_those_of_the_separated_equation():
    """With one absorbing pair of walls k tan(k L / 2 ...) separates: cos, sin waves along x alone."""
    beta_west, beta_east = 0.05 + 0.02j, 0.15 - 0.05j
    walls = np.array([beta_west, beta_east, 0, 0, 0, 0])
    poles = box_modes(SIDES, SHOEBOX_WALLS, 80, C).poles(lambda f: walls)
    length = SIDES[0]

    def exact(parts):
        # p = cosh(k x + a), k = s / c: tanh a = beta_west, tanh(k L + a) = -beta_east.
        k = parts[0] + 1j * parts[1]
        off = np.tanh(k * length + np.arctanh(beta_west)) + beta_east
        return [off.real, off.imag]

    k = fsolve(exact, [-0.2 / length, np.pi / length])
    s = C * (k[0] + 1j * k[1])
    along_x = int(np.argmin(np.abs(poles.values - s)))
    assert poles.values[along_x].real == pytest.approx(s.real, rel=0.005)
    assert poles.values[along_x].imag == pytest.approx(s.imag, rel=0.001)
    rigid = box_modes(SIDES, SHOEBOX_WALLS, 80, C)
    first = C / 2 * np.einsum("i,imm->m", walls.real, rigid.coupling)[: rigid.wanted]
    assert first[along_x] == pytest.approx(-s.real, rel=0.05)


@pytest.mark.parametrize("sides", [(4.0, 4.003, 3.998), (5.2, 3.9, 2.6)])
def test_poles_are_those_of_the_linearised_problem(sides):
    """With admittances that hold at all frequencies the companion matrix has all poles at once."""
    modes = box_modes(np.array(sides), SHOEBOX_WALLS, 120, C)
    walls = np.array([0.03, 0.01 + 0.02j, 0.06, 0.005, 0.02 - 0.01j, 0.04])
    poles = modes.poles(lambda f: walls)
    omega = 2 * np.pi * np.append(modes.frequencies, 0.0)
    n, pull = len(omega), C * np.tensordot(walls, modes.coupling, 1)
    companion = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(omega**2), -pull]])
    all_poles = np.linalg.eigvals(companion)
    off = np.abs(poles.values[:, np.newaxis] - all_poles)
    assert len(poles.values) > 15
    assert (off.min(axis=1) < 1e-6 * np.abs(poles.values.real)).all()
    assert len(set(off.argmin(axis=1))) == len(poles.values)  # none is taken twice


def test_slopes_of_poles_are_their_derivatives():
    modes = box_modes(SIDES, SHOEBOX_WALLS, 90, C)
    beta = np.array([0.02, 0.05, 0.01, 0.08, 0.2, 0.1]) + 0.03j
    at = modes.poles(lambda f: beta)
    for wall in range(6):
        more = beta + 1e-5 * (np.arange(6) == wall)
        change = (modes.poles(lambda f, more=more: more).values - at.values) / 1e-5
        np.testing.assert_allclose(at.slopes[:, wall], change, rtol=2e-3, atol=0.05)


def test_modes_distinguish_the_pairs_of_walls():
    modes, t = heard(TRUTH), times(TRUTH)
    result = rt.calibrate_modes(ROOM, modes, t)
    by_t = rt.calibrate(ROOM, t)
    error = [np.abs(a[:, 0] - TRUTH[:, 0]).mean() for a in (result.alpha, by_t.alpha)]
    assert error[0] < 0.6 * error[1]
    assert result.certificate.worst < 1e-9
    assert np.abs(result.after / result.measured - 1).mean() < 0.05
    assert np.abs(result.before / result.measured - 1).mean() > 0.1
    low, high = result.interval
    assert ((low <= result.alpha) & (result.alpha <= high)).all()
    assert (result.sigma[:, 0] < 0.08).all()
    assert result.sensitivity[0].argmax() < 2  # the first mode stands between west and east
    (first, *_) = next(b for b in result.blocks() if isinstance(b, Table)).rows
    assert first.values[-1] == "west, east"
    assert result.carried[0]
    assert not result.carried[2]
    kinds = {(m.kind, m.frequency) for m in result.trust_marks}
    assert ("below_schroeder", 63.0) not in kinds
    assert ("below_schroeder", 63.0) in {(m.kind, m.frequency) for m in by_t.trust_marks}
    few = rt.calibrate_modes(ROOM, modes.only([0, 1]), t)
    assert ("below_schroeder", 63.0) in {(m.kind, m.frequency) for m in few.trust_marks}
    assert ("missing", 63.0) not in {(m.kind, m.frequency) for m in few.trust_marks}


def test_order_of_walls_does_not_matter():
    modes = heard(TRUTH)
    _, room = box_room(materials=ROOM.materials[::-1])
    one, other = (rt.calibrate_modes(r, modes, times(TRUTH)) for r in (ROOM, room))
    order = [room.material_index(m) for m in ROOM.materials]
    np.testing.assert_allclose(other.alpha[order], one.alpha, atol=1e-9)


def test_matching_weighs_the_decay():
    modes = MeasuredModes(frequencies=[50.0], decays=[5.0], decay_uncertainty=[0.2])
    close = np.array([49.9, 50.1])
    with pytest.raises(DataError, match="none of the 1 measured modes"):  # either of the two
        match(modes, close, np.array([5.0, 5.0]))
    assert match(modes, close, np.array([0.5, 5.0])).calculated.tolist() == [1]


def test_uncertainty_of_t_counts():
    t, modes = times(TRUTH), heard(TRUTH)
    sure, unsure = (
        rt.calibrate_modes(
            ROOM,
            modes,
            measurement_of(BANDS, u={"t20": u * t[None]}, t20=t[None]),
        )
        for u in (0.01, 0.2)
    )
    np.testing.assert_array_equal(sure.alpha, unsure.alpha)  # as method mle matches T
    assert (unsure.sigma[:, 2] > 1.01 * sure.sigma[:, 2]).all()
    assert "no_uncertainty" not in {m.kind for m in sure.trust_marks}
    bare = rt.calibrate_modes(ROOM, modes, t)
    np.testing.assert_array_equal(bare.alpha, sure.alpha)


@pytest.mark.parametrize(("factor", "contradict"), [(1.0, False), (1.8, True)])
def test_modes_that_contradict_are_marked(factor, contradict):
    modes = heard(TRUTH)
    off = factor ** np.where(np.arange(len(modes.decays)) % 2, 1, -1)
    result = rt.calibrate_modes(ROOM, replace(modes, decays=off * modes.decays))
    p_value = result.plausibility.p_value
    assert p_value < 1e-6 if contradict else p_value > 0.05
    assert ("implausible_modes" in {m.kind for m in result.trust_marks}) == contradict


@pytest.mark.parametrize("seed", range(8))
def test_random_frequencies_are_refused_or_doubted(seed):
    f = np.sort(np.random.default_rng(seed).uniform(30, 108, 14))
    random = replace(heard(TRUTH).only(range(14)), frequencies=f)
    if seed in (0, 2, 3):
        assert any(n.startswith("Doubtful") for n in rt.calibrate_modes(ROOM, random).notes)
    else:
        with pytest.raises(DataError, match="no better than chance"):
            rt.calibrate_modes(ROOM, random)


def test_coefficients_between_bands():
    room = ROOM.replace(band_correlation=0.8)
    at = AtFrequencies.of(room, np.array([63.0, 125.0, 30.0]))
    np.testing.assert_allclose(at.weights[:2], np.eye(3)[:2], atol=1e-9)
    np.testing.assert_allclose(np.diag(at.remainder)[:2], 0, atol=1e-9)
    assert 0.2 < at.remainder[2, 2] < 0.5
    np.testing.assert_allclose(at.alpha(TRUTH)[:, 0], TRUTH[:, 0])


TWO = {"frequencies": [30.0, 40.0], "decays": [5.0, 5.0], "decay_uncertainty": [0.1, 0.1]}
FAR = MeasuredModes(frequencies=[20.0], decays=[5.0], decay_uncertainty=[0.1])
STRANGE = MeasuredModes(frequencies=[38.0], decays=[5.0], decay_uncertainty=[0.1])
TWICE = ROOM.areas * np.array([1, 1, 2, 1, 1, 1])


@pytest.mark.parametrize(
    ("call", "place"),
    [
        (lambda: MeasuredModes(**TWO | {"frequencies": []}), "mode"),
        (lambda: MeasuredModes(**TWO | {"frequencies": [40.0, 30.0]}), "frequencies"),
        (lambda: MeasuredModes(**TWO | {"frequencies": [30.0, 4000.0]}), "single modes"),
        (lambda: MeasuredModes(**TWO | {"decays": [5.0, -1.0]}), r"decays\[1\] = -1"),
        (lambda: MeasuredModes(**TWO | {"decay_uncertainty": [0.1]}), r"shape \(1,\)"),
        (lambda: MeasuredModes(**TWO | {"amplitudes": [[1.0]]}), "amplitudes"),
        (lambda: MeasuredModes(**TWO | {"calculated": [1, 1]}), "calculated"),
        (lambda: rt.calibrate_modes(ROOM.replace(dimensions=None), heard(TRUTH)), "dimensions"),
        (lambda: rt.calibrate_modes(ROOM, FAR), "30 Hz"),
        (lambda: rt.calibrate_modes(ROOM, STRANGE), "none of the 1 measured modes"),
        (lambda: rt.calibrate_modes(ROOM.replace(volume=46.9), heard(TRUTH)), "46.9 m³"),
        (
            lambda: rt.calibrate_modes(
                ROOM.replace(areas=TWICE, surfaces=()), heard(TRUTH), geometry=BOX
            ),
            "south has 27.04 m²",
        ),
    ],
)
def test_what_does_not_fit_is_refused(call, place):
    with pytest.raises(DataError, match=place):
        call()


def test_result_is_saved_whole(tmp_path):
    result = rt.calibrate_modes(ROOM, heard(TRUTH), times(TRUTH))
    back(result, tmp_path)
    assert "modes" in result._repr_html_()
    text = page_of(tmp_path)
    assert "carried by" in text
    assert f"{result.modes.frequencies[0]:.1f}" in text
    assert result.room.calibration.method == "modes"


@pytest.mark.parametrize("t", [times(TRUTH), *also(None)])
def test_modes_count_once(t):
    once = rt.calibrate_modes(ROOM, heard(TRUTH), t).room
    with pytest.raises(DataError, match="already calibrated on these data"):
        rt.calibrate_modes(once, heard(TRUTH))
    other = heard(TRUTH * 1.1)
    assert rt.calibrate_modes(once, other).room.calibration.measured.count("modes:") == 2
    if t is not None:
        with pytest.raises(DataError, match="already calibrated on these data"):
            rt.calibrate(once, t)
