"""Predicting a change: its laws, over methods, equations and random rooms."""

from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.changes import read_variants
from rtcal.prediction import Assumptions, Change, changed, predict
from rtcal.prediction.predicted import JND
from rtcal.support.errors import DataError, ModelError
from tests.conftest import also, in_order, measurement_of, room_of

BANDS = [250.0, 1000.0, 4000.0]
METHODS = ("mle", "soft", "lse", "smooth", "robust")
EQUATIONS = (rt.Eyring(), rt.Sabine(), rt.Kuttruff())
OTHERS = ((m, e) for m in METHODS for e in EQUATIONS if m != "mle" and e.key != "eyring")
QUICK = (("mle", EQUATIONS[1]), ("mle", EQUATIONS[2]), *((m, EQUATIONS[0]) for m in METHODS))
EACH = pytest.mark.parametrize(("method", "equation"), [*QUICK, *also(*OTHERS)])
PANEL = rt.Material("panel", [0.5, 0.85, 0.8], [0.05, 0.1, 0.1])
SMALL = 0.01
"""m² of a panel in a hall."""


def a_room(seed, *, named=True, **more):
    """A random box; without names nothing says which way its surfaces face."""
    rng = np.random.default_rng([57, seed])
    x, y, z = rng.uniform((5, 4, 2.6), (12, 9, 5))
    names = ["ceiling", "floor", "walls"] if named else ["one", "two", "three"]
    alpha = np.exp(rng.uniform(np.log(0.03), np.log(0.2), (3, len(BANDS))))
    return rt.Room(
        name="box",
        volume=x * y * z,
        materials=names,
        areas=[x * y, x * y, 2 * (x + y) * z],
        alpha=alpha,
        sigma=0.3 * alpha,
        centre_frequencies=BANDS,
        air=rt.Air(20, 50),
        **{**({"dimensions": (x, y, z)} if named else {}), **more},
    )


def measured_in(room, seed, equation=None):
    """A T that is not the stated coefficients', with an uncertainty."""
    factor = np.random.default_rng([58, seed]).uniform(0.8, 1.25, room.n_bands)
    t = factor * (equation or rt.Eyring()).reverberation_time(room)
    return at_two_positions(t, 0.03)


def at_two_positions(t, u):
    """Two values that leave their mean with this relative uncertainty."""
    return measurement_of(BANDS, [("S", "R1"), ("S", "R2")], t20=[(1 - u) * t, (1 + u) * t])


def calibrated(seed, method="mle", equation=None, **more):
    room = a_room(seed, **more)
    return rt.calibrate(room, measured_in(room, seed, equation), method, equation)


@pytest.fixture(scope="module")
def result():
    return calibrated(0)


def same(one, other):
    """Two predictions agree to the last sensible digit."""
    assert other.mean == pytest.approx(one.mean, rel=1e-9)
    for a, b in zip(one.interval, other.interval, strict=True):
        assert b == pytest.approx(a, rel=1e-9)


# Laws ---------------------------------------------------------------------------------------------


@EACH
@pytest.mark.usefixtures("few_draws")
def test_nothing_changed_is_t_of_the_calibrated_room_exactly(method, equation):
    for seed in range(3):
        found = calibrated(seed, method, equation)
        panel_and_back = [
            Change(cover="walls", by=PANEL, area=3),
            Change(cover="panel", by="walls"),
        ]
        for changes in (
            [],
            found.prior,
            panel_and_back,
            [Change(add=PANEL, area=2), Change(remove="panel")],
        ):
            made = found.predict(changes)
            low, high = made.interval
            for t in (made.mean, low, high):
                assert t == pytest.approx(found.reverberation_time_after, rel=1e-9)
            assert made.change == pytest.approx(np.zeros(3), abs=1e-6)
            assert made.half_width == pytest.approx(np.zeros(3), abs=1e-6)
        assert made.before_is == ("measured" if method in ("mle", "lse") else "calibrated model")


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("method", METHODS)
def test_the_width_grows_with_the_change_from_next_to_nothing(method, named):
    found = calibrated(1, method, named=named)
    surface = found.prior.materials[0]
    whole = float(found.prior.areas[0])
    made = [
        found.predict(Change(cover=surface, by=PANEL, area=share * whole))
        for share in (1e-4, 0.02, 0.1, 0.5)
    ]
    widths = np.array([m.interval[1] - m.interval[0] for m in made]) / found.measured
    assert (np.diff(widths, axis=0) > 0).all()
    assert (widths[0] < 2e-3).all()
    tiny = found.predict(Change(add=PANEL, area=SMALL))
    assert tiny.headline.startswith("T changes by less than 1 %")
    assert (tiny.half_width < 0.1).all()
    assert (np.abs(tiny.change) < 0.2).all()


@EACH
@pytest.mark.usefixtures("few_draws")
def test_adding_absorption_lengthens_t_in_no_draw(method, equation):
    for seed in range(3):
        found = calibrated(seed, method, equation, named=seed != 1)
        hard = rt.Material("hard", [0.02] * 3, [0.02] * 3)
        for material in (PANEL, hard):
            made = found.predict(Change(add=material, area=8))
            assert (made.samples <= np.log(made.time_before)[:, np.newaxis]).all()
            assert (made.interval[1] <= made.time_before).all()
        # What covers is more absorbing than what is covered in every draw: so is the room.
        sure = rt.Material("sure", [0.9] * 3, [0.0] * 3)
        made = found.predict(Change(cover=found.prior.materials[1], by=sure, area=5))
        unknowns = made.unknowns.absorption
        more = unknowns[:, made.materials.index("sure")] > unknowns[:, 1]
        longer = made.samples > np.log(made.time_before)[:, np.newaxis] + 1e-12
        assert not (longer & more).any()
        assert more.mean() > 0.9


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize("method", METHODS)
def test_what_is_exchanged_for_equal_numbers_changes_t_as_is_said(method):
    """The old surface is the calibrated one, the new has its input alpha: T differs by the factor."""
    for seed, factor in product(range(2), (0.8, 1.0, 1.25)):
        room = a_room(seed)
        t = factor * rt.Eyring().reverberation_time(room)
        found = rt.calibrate(room, at_two_positions(t, 0.03), method)
        old = room.material("walls")
        made = found.predict(Change(cover="walls", by=replace(old, name="twin")))
        low, high = made.interval
        assert ((low < t) & (t < high)).all()
        said = " ".join(made.sentences)
        alone = next(iter(made.by_equation.values()))
        moved = np.abs(alone / found.reverberation_time_after - 1).max()
        if factor == 1:
            assert moved < 1e-6
        assert ("Calibration changed alpha" in said) == (moved > JND)
        if len(made.by_equation) == 1 and (made.mean < (1 - JND) * alone).any():
            assert "hard surfaces may absorb" in said
        # Nothing of it where the calibrated numbers are taken, as is advised.
        taken = rt.Material("twin", found.alpha[room.materials.index("walls")], old.sigma)
        again = found.predict(Change(cover="walls", by=taken))
        alone = next(iter(again.by_equation.values()))
        assert alone == pytest.approx(found.reverberation_time_after, rel=1e-6)


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize("named", [False, *also(True)])
def test_two_changes_one_after_the_other_are_both_at_once(named):
    for seed in range(3):
        found = calibrated(seed, named=named)
        first, _, third = found.prior.materials
        one, two = (
            Change(cover=first, by=PANEL, area=4),
            Change(cover=third, by=rt.Material("felt", [0.3] * 3, [0.1] * 3), area=6),
        )
        both = found.predict([one, two])
        same(both, found.predict([two, one]))
        same(both, found.predict(changed(changed(found.prior, one), two)))


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize("named", [True, *also(False)])
def test_the_order_of_materials_changes_and_bands_moves_nothing(named):
    room = a_room(3, named=named)
    measured = measured_in(room, 3)
    other = in_order(room, [2, 0, 1])
    felt = rt.Material("felt", [0.3] * 3, [0.1] * 3)
    changes = [
        Change(cover=room.materials[0], by=PANEL, area=7),
        Change(add=felt, area=3),
    ]
    one = rt.calibrate(room, measured).predict(changes)
    two = rt.calibrate(other, measured).predict(changes[::-1])
    same(one, two)
    single = room.replace(
        alpha=room.alpha[:, 1:2], sigma=room.sigma[:, 1:2], centre_frequencies=BANDS[1:2]
    )
    alone = rt.calibrate(single, measured.mean("t20")[1:2]).predict(
        [
            Change(
                cover=room.materials[0],
                by=rt.Material("panel", PANEL.alpha[1:2], PANEL.sigma[1:2]),
                area=7,
            ),
            Change(add=rt.Material("felt", [0.3], [0.1]), area=3),
        ]
    )
    assert alone.mean == pytest.approx(one.mean[1:2], rel=0.01)  # T without an uncertainty


@pytest.mark.parametrize("seed", [6, *also(3, 7)])
def test_a_material_in_parts_that_err_alike_is_one(seed):
    whole = a_room(seed, named=False)
    whole = whole.replace(alpha=np.full((3, 3), 0.08), sigma=np.full((3, 3), 0.024))
    rows, split = [0, 1, 2, 2, 2, 2], ["three", "four", "five", "six"]
    parts = whole.replace(
        materials=["one", "two", *split],
        areas=whole.areas[rows] * [1, 1, *[1 / 4] * 4],
        alpha=whole.alpha[rows],
        sigma=whole.sigma[rows],
        material_correlation=dict.fromkeys(combinations(split, 2), 1 - 1e-07),
    )
    one, other = (
        rt.calibrate(room, measured_in(whole, seed)).predict(
            Change(cover="one", by=PANEL, area=0.8 * whole.areas[0])
        )
        for room in (whole, parts)
    )
    assert other.mean == pytest.approx(one.mean, rel=0.008)
    assert other.half_width == pytest.approx(one.half_width, rel=0.045)


def test_the_change_is_the_equations_where_all_is_known(result):
    sure = Assumptions(volume=0, areas=0, factor=0, least=0, evenness=0, evenness_sigma=0)
    exact = rt.calibrate(
        result.prior.replace(sigma=1e-6 * result.prior.alpha), result.measured, "soft"
    )
    panel = rt.Material("panel", PANEL.alpha, [0.0] * 3)
    for changes in (
        Change(add=panel, area=9),
        [Change(cover="ceiling", by=panel, area=9), Change(air=rt.Air(25, 30))],
    ):
        made = exact.predict(changes, assumptions=sure)
        before, after = (
            rt.Eyring().reverberation_time(r) for r in (exact.room, changed(exact.room, changes))
        )
        assert made.mean == pytest.approx(exact.reverberation_time_after * after / before, rel=1e-4)
        assert (made.half_width < 0.01).all()


# All on one surface -------------------------------------------------------------------------------


def classroom(**more):
    """8 x 6.5 x 2.9 m, hard, its surfaces named; traced with an acoustic ceiling below."""
    plaster, lino = [0.06, 0.05, 0.05], [0.03, 0.03, 0.05]
    alpha = np.array([plaster, lino, plaster])
    return rt.Room(
        name="classroom",
        volume=8 * 6.5 * 2.9,
        materials=["ceiling", "floor", "walls"],
        areas=[52, 52, 84.1],
        alpha=alpha,
        sigma=np.maximum(0.3 * alpha, 0.01),
        centre_frequencies=[500.0, 1000.0, 2000.0],
        air=rt.Air(20, 50),
        **more,
    )


TILE = rt.Material("tile", [0.8, 0.85, 0.85], [0.05] * 3)


@pytest.mark.parametrize(
    ("scattering", "named"), [(0.15, True), *also((0.15, False), (0.35, True), (0.35, False))]
)
def test_an_acoustic_ceiling_is_within_the_interval(scattering, named):
    """Path tracing with the ceiling tiled, as rtcal's tracer has it before and after."""
    room = classroom(dimensions=(8, 6.5, 2.9))
    walls = dict.fromkeys(("west", "east", "south", "north"), "walls")
    tracer = rt.simulators.PathTracing(
        geometry=rt.simulators.Polyhedron.shoebox(
            (8, 6.5, 2.9), {**walls, "floor": "floor", "ceiling": "ceiling"}
        ),
        room=room,
        sources={"S": (1.3, 1.1, 1.5)},
        receivers={"R1": (6.1, 4.9, 1.2), "R2": (3.0, 5.2, 1.2), "R3": (6.8, 2.0, 1.2)},
        scattering=scattering,
        n_paths=2500,
    )
    tiled = room.alpha.copy()
    tiled[0] = TILE.alpha
    empty, after = (tracer.simulate(a, seed=2).mean("t20") for a in (room.alpha, tiled))
    if not named:
        room = room.replace(materials=["one", "two", "three"], dimensions=None)
    made = rt.calibrate(room, empty).predict(Change(cover=room.materials[0], by=TILE, area=52))
    low, high = made.interval
    assert ((low <= after) & (after <= high)).all(), (low, after, high)
    if named:
        assert (made.by_equation["Arau-Puchades"] > 1.2 * made.by_equation["Eyring"]).all()
    assert made.is_placed == named
    assert ("does not give the axes of" in " ".join(str(made).split())) != named


# What is known ------------------------------------------------------------------------------------


@pytest.mark.usefixtures("few_draws")
def test_a_second_state_narrows_and_corrects():
    """The panel's alpha is 0.5 in truth, not 0.85: one state cannot show it, two can."""
    room = a_room(4)
    stated, true = (rt.Material("panel", [a] * 3, [0.15] * 3) for a in (0.85, 0.5))

    def time(*changes):
        return rt.Eyring().reverberation_time(changed(room, changes))

    cover = Change(cover="walls", by=stated, area=25)
    states = rt.Configurations([room, changed(room, replace(cover, area=10))], ["bare", "some"])
    after = [time(), time(replace(cover, by=true, area=10))]
    two = rt.calibrate(states, after, method="joint").results[0].predict(cover)
    one = rt.calibrate(room, time()).predict(cover)
    assert (two.half_width < 0.85 * one.half_width).all()
    off = [np.abs(np.log(p.mean / time(replace(cover, by=true)))) for p in (one, two)]
    assert (off[1] < 0.6 * off[0]).all()


def test_without_a_measurement_the_error_of_t_before_counts():
    room = a_room(2)
    found = calibrated(2).predict(Change(add=PANEL, area=5))
    stated = predict(room, Change(add=PANEL, area=5))
    assert stated.before_is == "input coefficients"
    assert (stated.half_width > 1.5 * found.half_width).all()
    assert stated.mean == pytest.approx(found.uncalibrated.mean)
    # One band without T: there it is as without any.
    t = measured_in(room, 2).mean("t20")
    t[1] = np.nan
    partly = rt.calibrate(room, t).predict(Change(add=PANEL, area=5))
    assert partly.half_width[1] == pytest.approx(stated.half_width[1], rel=0.1)
    assert partly.half_width[0] < 0.6 * stated.half_width[0]
    assert "At 1000 Hz T before was not measured" in " ".join(str(partly).split())


def test_parts_add_up_and_the_largest_is_first(result):
    made = result.predict(Change(cover="walls", by=PANEL, area=12))
    assert sum(made.parts.values()) == pytest.approx(np.ones(3), abs=1e-12)
    means = [part.mean() for part in made.parts.values()]
    assert means == sorted(means, reverse=True)
    assert all((part >= 0).all() for part in made.parts.values())
    exact = rt.Material("panel", PANEL.alpha, [0.0] * 3)
    known = result.predict(Change(cover="walls", by=exact, area=12)).parts
    assert known.get('alpha of "panel"', np.zeros(3)) == pytest.approx(np.zeros(3), abs=1e-3)


def test_probability_agrees_with_the_interval_and_falls_over_all_bands(result):
    made = result.predict(Change(cover="walls", by=PANEL, area=12))
    low, high = made.interval
    assert made.probability(low, high) == pytest.approx([0.9] * 3, abs=0.005)
    assert 0.75 < made.probability_together(low, high) < 0.9
    assert made.probability(np.nan, high) == pytest.approx([0.95] * 3, abs=0.005)
    unchanged = result.predict([])
    t = unchanged.mean
    assert unchanged.probability(0.99 * t, 1.01 * t).tolist() == [1, 1, 1]
    assert unchanged.probability(1.01 * t, np.nan).tolist() == [0, 0, 0]


def test_a_later_change_may_cover_what_an_earlier_one_of_the_file_brought_in(result):
    chain = """
    [[material]]
    name = "panel"
    alpha = [0.5, 0.8, 0.9]
    sigma = 0.1
    [[variant]]
    [[variant.change]]
    {}
    [[variant.change]]
    {}
    """
    first, then = 'cover = "walls"\nby = "panel"\narea = 6', 'cover = "panel"\nby = "walls"'
    ((variant,), _) = read_variants(chain.format(first, then), result.room)
    same(result.predict([]), result.predict(variant.changes))
    with pytest.raises(DataError, match='cover = "panel" is not a known material'):
        read_variants(chain.format(then, first), result.room)


def of_faces(absorbing, *materials):
    """5 x 4 m: ceiling, floor and two pairs of walls, of materials with alpha and relative sigma."""
    rows = [rt.Material(n, [a] * 3, [u * a] * 3) for n, (a, u) in absorbing.items()]
    faces = zip("ABCD", materials, (20, 20, 26, 24), "zzxy", strict=True)
    return rt.Room.from_surfaces(
        name="box",
        volume=50,
        centre_frequencies=BANDS,
        materials=rows,
        surfaces=[rt.Surface(*face) for face in faces],
    )


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize("equation", [EQUATIONS[2], *also(*EQUATIONS[:2])], ids=lambda e: e.key)
def test_without_measurement_t_after_is_that_of_the_changed_room(equation):
    alpha = {"tiles": 0.9, "carpet": 0.4, "plaster": 0.05, "glass": 0.05, "felt": 0.8}
    absorbing = {name: (a, 0.3) for name, a in alpha.items()}
    before = of_faces(absorbing, "tiles", "carpet", "plaster", "glass")
    felt = rt.Material("felt", [0.8] * 3, [0.24] * 3)
    for goes, walls in (("glass", ("plaster", "felt")), ("plaster", ("felt", "glass"))):
        after = of_faces(absorbing, "tiles", "carpet", *walls)
        made = predict(before, Change(cover=goes, by=felt), equation=equation)
        entered = predict(after, [], equation=equation)
        assert made.mean == pytest.approx(entered.time_before, rel=1e-9)
        assert (made.mean < made.time_before).all()
        assert made.by_equation[equation.name] == pytest.approx(equation.reverberation_time(after))
        for name, times in entered.by_equation.items():
            assert made.by_equation[name] == pytest.approx(times)


@pytest.mark.parametrize(("hard", "first"), [(0.05, "Eyring"), (0.4, "Arau-Puchades")])
def test_the_interval_follows_the_sign_of_uneven_absorption(hard, first):
    room = of_faces({"hard": (hard, 0), "side": (0.2, 0)}, "hard", "hard", "side", "hard")
    found = rt.calibrate(room, rt.Eyring().reverberation_time(room))
    made = found.predict(Change(cover="side", by=rt.Material("open", [0.99] * 3, [0.0] * 3)))
    times = {name: made.by_equation[name] for name in ("Eyring", "Arau-Puchades")}
    assert min(times, key=lambda name: times[name][0]) == first
    low, high = made.interval
    assert all(((low < t) & (t < high)).all() for t in times.values())
    assert any("contains both values" in sentence for sentence in made.sentences)


@pytest.mark.parametrize(
    ("call", "error", "place"),
    [
        (lambda r: r.predict(r.prior.replace(sigma=0.5 * r.prior.sigma)), DataError, "sigma"),
        (lambda r: predict(3, []), DataError, "3"),
        (lambda r: r.predict([Change(open=m) for m in r.prior.materials]), ModelError, "T"),
        (lambda r: Assumptions(factor=2), DataError, "factor"),
        (lambda r: predict(r, [], equation=rt.Sabine()), DataError, "Eyring"),
        (lambda r: r.predict(Change(volume=1e-9)), DataError, "volume"),
        (lambda r: r.predict([]).probability([1.0] * 3, [0.5] * 3), DataError, "low"),
        (lambda r: r.predict([]).probability([1.0] * 3, [2.0] * 2), DataError, "high"),
    ],
)
def test_what_does_not_fit_is_refused(result, call, error, place):
    with pytest.raises(error, match=place):
        call(result)


BOARD = rt.Material("panel", [0.8, 0.9], [0.1, 0.1])


def two_materials():
    return room_of(
        {"wall": (100, [0.2, 0.25], 0.04), "floor": (30, [0.1, 0.12], 0.04)},
        [500, 1000],
        100,
        name="box",
    )


def test_changes_keep_the_books():
    room = two_materials()
    total = room.total_area
    assert changed(room, Change(cover="wall", by=BOARD, area=20)).total_area == total
    assert changed(room, Change(cover="wall", by=BOARD)).materials == ("floor", "panel")
    assert changed(room, Change(add=BOARD, area=7)).total_area == total + 7
    assert changed(room, [Change(add=BOARD, area=7), Change(remove="panel")]).total_area == total
    assert changed(room, Change(volume=120)).volume == 120
    opened = changed(room, Change(open="wall", area=3))
    assert opened.alpha[-1].tolist() == [1, 1]
    assert opened.sigma[-1].tolist() == [0, 0]
    assert changed(room, Change(cover="wall", by="floor", area=10)).areas.tolist() == [90, 40]
    # Two materials are exchanged, though none of the first is left in between.
    first, second = room.materials
    one, other = room.areas.tolist()
    swap = [Change(cover=first, by=second), Change(cover=second, by=first, area=other)]
    after = changed(room, swap)
    assert dict(zip(after.materials, after.areas.tolist(), strict=True)) == {
        first: other,
        second: one,
    }
    assert after.alpha[after.materials.index(first)].tolist() == room.alpha[0].tolist()


def of_program(t):
    return rt.Measurement.from_values(BANDS, t20=t)


@pytest.mark.parametrize("seed", range(3))
def test_laws_of_a_change_that_a_program_simulated(seed):
    room = a_room(seed)
    measured = measured_in(room, seed)
    result = rt.calibrate(room, measured)
    before = measured.reverberation_time
    change = Change(cover="ceiling", by=PANEL, area=0.5 * room.areas[0])
    ratio = np.array([0.8, 0.6, 0.65])
    run = rt.Run(room, of_program(before))
    made = result.predict(change, run=run, run_after=of_program(ratio * before))
    # A program with the measured T before has T after.
    np.testing.assert_allclose(made.mean, ratio * before, rtol=1e-9)
    assert (made.interval[0] < made.mean).all()
    # Nothing changed: T before, without a width.
    same = result.predict([], run=run, run_after=of_program(before))
    np.testing.assert_allclose(same.mean, before, rtol=1e-12)
    assert not same.half_width.any()
    small = Change(cover="ceiling", by=PANEL, area=SMALL)
    hardly = result.predict(small, run=run, run_after=of_program((1 - 1e-5) * before))
    assert (hardly.half_width < 0.01 * made.half_width).all()
    # A program that is the equation at the calibrated coefficients has the equation's ratio.
    own = made.by_equation["Eyring"]
    of_equation = result.predict(change, run=run, run_after=of_program(own))
    np.testing.assert_allclose(of_equation.mean, own, rtol=1e-9)
    # A program whose room absorbs more: the same panel shortens the real T by more than by its ratio.
    lively = result.predict(
        change,
        run=rt.Run(room, of_program(0.8 * before)),
        run_after=of_program(0.8 * ratio * before),
    )
    assert (lively.mean < made.mean).all()
    # Noise that the runs state widens the interval.
    noisy = measurement_of(
        BANDS, u={"t20": (0.1 * ratio * before)[None]}, t20=(ratio * before)[None]
    )
    wider = result.predict(change, run=run, run_after=noisy)
    assert (wider.half_width > made.half_width).all()
    np.testing.assert_allclose(wider.mean, made.mean, rtol=1e-9)
    assert str(result.predict(change, run=run, run_after=noisy)) == str(wider)
    assert sum(wider.parts.values()) == pytest.approx(1)
    assert wider.parts["the program"].min() > 0


def test_a_band_without_a_run_is_the_equations():
    room = a_room(1)
    measured = measured_in(room, 1)
    result, before = rt.calibrate(room, measured), measured.reverberation_time
    change = Change(cover="ceiling", by=PANEL, area=10)
    run = rt.Run(room, of_program(before))
    after = of_program(np.array([np.nan, 0.6, 0.65]) * before)
    made, alone = result.predict(change, run=run, run_after=after), result.predict(change)
    for one, other in ((made.mean, alone.mean), *zip(made.interval, alone.interval, strict=True)):
        assert one[0] == other[0]
        assert (one[1:] != other[1:]).all()
    assert "The change is the program's: at 1000 Hz from" in " ".join(str(made).split())
    t30 = rt.Measurement.from_values(BANDS, t30=before)
    with pytest.raises(DataError, match="Only the same parameter in the same band"):
        result.predict(change, run=run, run_after=t30)
    with pytest.raises(DataError, match="run_after is missing"):
        result.predict(change, run=run)
    with pytest.raises(DataError, match="calibration to a measured T"):
        predict(room, change, run=run, run_after=after)


def test_the_command_takes_what_a_program_gave_of_each_variant(tmp_path, rtcal):
    room = a_room(2)
    before = measured_in(room, 2).reverberation_time
    room.save(str(tmp_path / "room.toml"))
    for name, factor in (("t", 1.0), ("run", 1.0), ("after", 0.6)):
        of_program(factor * before).save(str(tmp_path / f"{name}.csv"))
    variants = '[[material]]\nname = "panel"\nalpha = [0.8, 0.8, 0.8]\nsigma = 0.1\n'
    for name in ("simulated", "not simulated"):
        of = 'simulated = "after.csv"\n' * (name == "simulated")
        variants += f'[[variant]]\nname = "{name}"\n{of}[[variant.change]]\n'
        variants += 'cover = "ceiling"\nby = "panel"\narea = 10\n'
    (tmp_path / "variants.toml").write_text(variants)
    room, t, change, run = (
        tmp_path / name for name in ("room.toml", "t.csv", "variants.toml", "run.csv")
    )
    command = ("predict", room, t, "--change", change)
    text = rtcal(*command, "--simulated", run, "--out", tmp_path / "out")
    assert text.count("The change is the program's") == 1
    assert "Add it with --simulated" in rtcal.refused(*command)
    first, second = rt.load(tmp_path / "out").predictions
    np.testing.assert_allclose(first.mean, 0.6 * before, rtol=2e-3)  # of a file's digits
    assert second.simulated is None
    (tmp_path / "variants.toml").write_text(variants.replace('simulated = "after.csv"\n', ""))
    assert "no variant has simulated" in rtcal.refused(*command, "--simulated", run)
