"""The reverberation equations: worked examples of the field, laws, and their inverses."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import rtcal as rt

C = 343.0  # the examples' speed of sound, given explicitly
LINEAR = [rt.Sabine(), rt.Eyring(), rt.Kuttruff()]


def room_of(volume, surfaces, bands=(1000,), air=None):
    """``surfaces``: (area, alpha or one a band, axis)."""
    alphas = [np.broadcast_to(a, len(bands)).tolist() for _, a, _ in surfaces]
    names = [f"m{i}" for i in range(len(surfaces))]
    return rt.Room.from_surfaces(
        name="example",
        volume=volume,
        centre_frequencies=bands,
        air=air,
        surfaces=[
            rt.Surface(f"s{i}", names[i], area, axis) for i, (area, _, axis) in enumerate(surfaces)
        ],
        materials=[
            rt.Material(n, a, [0.1] * len(bands)) for n, a in zip(names, alphas, strict=True)
        ],
    )


BOX = room_of(120, [(30, 0.2, "x"), (48, 0.2, "y"), (80, 0.2, "z")])  # 8 x 5 x 3 m
UNEVEN = room_of(120, [(30, 0.5, "x"), (48, 0.1, "y"), (80, 0.1, "z")])
HALL = room_of(3000, [(240, 0.1, "x"), (600, 0.25, "y"), (500, 0.45, "z")])
PAIRS = room_of(3000, [(480, 0.1, "x"), (1200, 0.25, "y"), (1000, 0.45, "z")])
TWO = room_of(100, [(60, 0.3, None), (40, 0.6, None)])


@pytest.mark.parametrize(
    ("equation", "room", "expected"),
    [
        # phonometry's tests
        (rt.Sabine(C), BOX, 0.6118246547),
        (rt.Eyring(C), BOX, 0.5483686633),
        (rt.Millington(C), TWO, 0.277533033),
        (rt.ArauPuchades(C), UNEVEN, 0.8121469281),
        (rt.Fitzroy(C), UNEVEN, 0.974394434),
        # python-acoustics' tests; its Millington is wrong (Eyring's value) and was recomputed
        (rt.Sabine(C), HALL, 1.211382149),
        (rt.Eyring(C), HALL, 1.020427763),
        (rt.Millington(C), HALL, 0.972881636),
        (rt.ArauPuchades(C), HALL, 1.142442931),
        (rt.Fitzroy(C), PAIRS, 0.699854185),
    ],
)
def test_worked_examples(equation, room, expected):
    """Most expect 24 ln 10 / 343 or, python-acoustics, 24 ln 10 / 343 as well: to 1e-8."""
    assert equation.reverberation_time(room)[0] == pytest.approx(expected, rel=1e-8)


def test_everest_figure_7_22():
    """Everest, 4th ed., in feet with 0.049: printed to two digits."""
    bands = [125, 250, 500, 1000, 2000, 4000]
    floor = np.array([0.01, 0.01, 0.015, 0.02, 0.02, 0.02])
    shell = np.array([0.29, 0.10, 0.05, 0.04, 0.07, 0.09])
    room = room_of(105.565, [(34.653, floor, None), (107.675, shell, None)], bands)
    expected = [0.54, 1.53, 2.87, 3.39, 2.06, 1.63]
    np.testing.assert_allclose(rt.Sabine(C).reverberation_time(room), expected, atol=0.02)


def test_en_12354_6_annex_e():
    """Bare room; with hard objects (they add absorption and take volume); with an absorber."""
    bare = [(12.39, 0.05, None), (12.39, 0.02, None), (34.90, 0.04, None)]
    room = room_of(29.75, bare)
    assert room.absorption_area[0] == pytest.approx(2.26, abs=0.005)
    sabine = rt.Sabine(C)
    assert sabine.reverberation_time(room)[0] == pytest.approx(2.1, abs=0.05)
    with_air = sabine.time(room, room.absorption_area + 0.12)
    assert with_air[0] == pytest.approx(2.0, abs=0.05)
    objects = np.array([0.15, 0.60, 0.05, 0.05, 0.65, 0.65])
    added, taken = np.sum(objects ** (2 / 3)), np.sum(objects) / 29.75
    assert added == pytest.approx(2.77, abs=0.005)
    assert taken == pytest.approx(0.072, abs=0.0005)
    smaller = room.replace(volume=29.75 * (1 - taken))
    assert sabine.time(smaller, room.absorption_area + added)[0] == pytest.approx(0.9, abs=0.05)
    absorber = room_of(29.75, [*bare[:2], (25.09, 0.04, None), (9.81, 0.85, None)])
    assert absorber.absorption_area[0] == pytest.approx(10.21, abs=0.01)
    assert sabine.reverberation_time(absorber)[0] == pytest.approx(0.5, abs=0.05)


def test_the_air_term_is_added():
    """V = S = 216, alpha 0.1, m = 0.005 1/m: 1.285 s (pyroomacoustics subtracts: 1.887 s)."""
    room = room_of(216, [(216, 0.1, None)])
    constant = 24 * np.log(10) / C
    expected = constant * 216 / (-216 * np.log(0.9) + 4 * 0.005 * 216)
    assert expected == pytest.approx(1.285, abs=5e-3)
    humid = room.replace(air=rt.Air(20, 50), centre_frequencies=[4000])
    m = humid.air_attenuation[0]
    by_hand = constant * 216 / (-216 * np.log(0.9) + 4 * m * 216)
    assert rt.Eyring(C).reverberation_time(humid)[0] == pytest.approx(by_hand, rel=1e-12)
    assert m == pytest.approx(6.83e-3, rel=1e-2)


alphas = st.floats(0.01, 0.85)
ALL = [rt.Sabine(), rt.Eyring(), rt.Kuttruff(), rt.Millington(), rt.Fitzroy(), rt.ArauPuchades()]


@st.composite
def rooms(draw):
    surfaces = [(draw(st.floats(1, 300)), draw(alphas), axis) for axis in ("x", "y", "z", "x", "z")]
    return room_of(draw(st.floats(20, 5000)), surfaces, air=rt.Air(20, draw(st.floats(10, 90))))


@pytest.mark.parametrize("equation", ALL, ids=lambda e: e.name)
@given(room=rooms(), which=st.integers(0, 4), more=st.floats(1e-4, 0.1))
def test_t_falls_when_any_alpha_rises(equation, room, which, more):
    alpha = room.alpha.copy()
    alpha[which] += more
    raised = room.replace(alpha=alpha)
    if isinstance(equation, rt.Kuttruff):
        mean = raised.absorption_area[0] / raised.total_area
        assume(mean < equation.largest_mean - 0.01)
    assert np.all(equation.reverberation_time(raised) < equation.reverberation_time(room))


@pytest.mark.parametrize("equation", ALL, ids=lambda e: e.name)
@given(room=rooms())
def test_t_falls_when_the_air_absorbs_more(equation, room):
    none = equation.__class__(speed_of_sound=C).reverberation_time(room.with_air(None))
    some = equation.__class__(speed_of_sound=C).reverberation_time(room)
    assert np.all(some < none)


@pytest.mark.parametrize("equation", ALL, ids=lambda e: e.name)
@given(room=rooms(), seed=st.integers(0, 99))
def test_the_order_of_surfaces_changes_nothing(equation, room, seed):
    order = np.random.default_rng(seed).permutation(5)
    turned = room.replace(
        materials=[room.materials[i] for i in order],
        areas=room.areas[order],
        alpha=room.alpha[order],
        sigma=room.sigma[order],
        surfaces=[room.surfaces[i] for i in order],
    )
    found = equation.reverberation_time(turned)
    np.testing.assert_allclose(found, equation.reverberation_time(room), rtol=1e-12)


@given(room=rooms(), small=st.floats(1e-6, 1e-4))
def test_eyring_tends_to_sabine(room, small):
    faint = room.replace(alpha=room.alpha * small)
    ratio = rt.Eyring().reverberation_time(faint) / rt.Sabine().reverberation_time(faint)
    mean = faint.absorption_area / faint.total_area
    assert np.all(ratio < 1)
    np.testing.assert_allclose(ratio, 1, atol=float(mean[0]))


@given(room=rooms(), alpha=alphas)
def test_millington_is_eyring_if_and_only_if_all_alpha_are_equal(room, alpha):
    millington, eyring = rt.Millington(), rt.Eyring()
    even = room.replace(alpha=np.full_like(room.alpha, alpha))
    equal = eyring.reverberation_time(even)
    np.testing.assert_allclose(millington.reverberation_time(even), equal, rtol=1e-12)
    assume(np.ptp(room.alpha) > 0.01)
    assert np.all(millington.reverberation_time(room) < eyring.reverberation_time(room))


@pytest.mark.parametrize("equation", LINEAR, ids=lambda e: e.name)
@given(volume=st.floats(20, 5000), share=st.floats(0.001, 0.9), humid=st.floats(10, 90))
def test_the_inverse_of_predict_is_the_identity(equation, volume, share, humid):
    room = room_of(volume, [(100, 0.1, None), (50, 0.3, None)], (500, 4000), rt.Air(15, humid))
    b = np.full(2, share * room.total_area)
    t = equation.time(room, b)
    np.testing.assert_allclose(equation.absorption_area(room, t), b, rtol=1e-9)
    step = 1e-6 * t
    slope = (equation.target(room, t + step) - equation.target(room, t - step)) / (2 * step)
    np.testing.assert_allclose(equation.target_sensitivity(room, t), slope, rtol=1e-5)


def test_kuttruff_inverts_its_lower_branch_and_refuses_t_below_its_minimum():
    equation = rt.Kuttruff()
    room = room_of(200, [(150, 0.1, None), (60, 0.3, None)])
    peak = equation.largest_mean
    assert peak == pytest.approx(0.918, abs=5e-4)
    shortest = equation.time(room, np.array([peak * room.total_area]))
    found = equation.absorption_area(room, shortest * 1.0000001)
    assert found[0] / room.total_area == pytest.approx(peak, abs=1e-3)
    with pytest.raises(rt.errors.InfeasibleError, match="is too short: in this room Kuttruff's"):
        equation.absorption_area(room, shortest * 0.999)
    with pytest.raises(rt.errors.InfeasibleError, match="cannot be reached"):
        rt.calibrate(room, shortest * 0.999, equation=equation)
    result = rt.calibrate(room, shortest * 0.9, equation=equation, unreachable="nearest")
    assert result.alpha.T @ room.areas / room.total_area == pytest.approx(peak)
    assert result.reverberation_time_after[0] == pytest.approx(shortest[0], rel=1e-9)
    with pytest.raises(rt.errors.ModelError, match="Kuttruff's equation holds for a mean"):
        equation.reverberation_time(room.replace(alpha=np.full((2, 1), 0.95)))


def test_equations_without_a_linear_target_refer_to_the_loop():
    for equation in (rt.Millington(), rt.Fitzroy(), rt.ArauPuchades()):
        with pytest.raises(rt.errors.ModelError, match="calibrate_simulator"):
            equation.absorption_area(UNEVEN, [1.0])
        with pytest.raises(rt.errors.ModelError, match="calibrate_simulator"):
            rt.calibrate(UNEVEN, [1.0], equation=equation)


def test_axes_are_asked_for():
    for equation in (rt.Fitzroy(), rt.ArauPuchades()):
        with pytest.raises(rt.errors.ModelError, match='"s0" has none'):
            equation.reverberation_time(TWO)
        flat = room_of(100, [(60, 0.3, "x"), (40, 0.6, "z")])
        with pytest.raises(rt.errors.ModelError, match='needs a surface with axis = "y"'):
            equation.reverberation_time(flat)
        bare = TWO.replace(surfaces=())
        with pytest.raises(rt.errors.ModelError, match="has no surfaces"):
            equation.reverberation_time(bare)


@given(st.floats(-20, 50), st.floats(10, 100), st.floats(50, 1e4))
def test_air_against_pyfar(temperature, humidity, f):
    """ISO 9613-1 as pyfar has it: to 1e-6 over the standard's range."""
    pyfar = pytest.importorskip("pyfar")
    m_db = pyfar.constants.air_attenuation(temperature, np.array([f]), humidity / 100)[0]
    ours = rt.Air(temperature, humidity)
    np.testing.assert_allclose(ours.attenuation([f]), m_db / (10 * np.log10(np.e)), rtol=1e-6)
