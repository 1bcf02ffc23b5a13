"""Designing to a target: the cheapest, beside exhaustive search; laws; what is refused."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from benchmarks.studies.predictions import designs
from rtcal.prediction import Target, Treatment, ansi_s12_60, din_18041, predict
from rtcal.prediction.designed import can_be_had, design, design_model
from rtcal.support.errors import DataError, InfeasibleError
from tests.conftest import also, room_of

BANDS = [250.0, 500.0, 1000.0]


PANEL = rt.Material("panel", [0.5, 0.7, 0.8], [0.1] * 3)
BASS = rt.Material("bass", [0.6, 0.4, 0.2], [0.1] * 3)


def a_room():
    materials = {
        "wall": (100, [0.06, 0.05, 0.05], 0.02),
        "floor": (60, [0.05, 0.06, 0.08], 0.02),
        "ceiling": (60, [0.1, 0.08, 0.08], 0.02),
    }
    return room_of(materials, BANDS, 180, air=rt.Air(20, 50))


def known(room=None):
    room = room or a_room()
    return rt.calibrate(room, 0.95 * rt.Eyring().reverberation_time(room))


TREATMENTS = (
    Treatment("ceiling", PANEL, 55, cost=90, covers="ceiling"),
    Treatment("traps", BASS, 40, cost=60, covers="wall"),
)
TARGET = Target([0.4] * 3, [0.8] * 3)


def a_shop(one_sided):
    """A small room with panels on two surfaces and free pieces; Sabine's equation."""
    room = room_of(
        {
            "brick": (36, [0.04, 0.05, 0.07], 0.02),
            "boards": (21, [0.2, 0.09, 0.06], [0.04, 0.02, 0.02]),
        },
        BANDS,
        24,
        air=rt.Air(20, 50),
        volume_sigma=0.04,
        area_sigma=0.03,
    )
    t = 0.97 * rt.Sabine().reverberation_time(room)
    every = (
        Treatment("tiles", PANEL, 14, cost=66, covers="brick", unit=1.9),
        Treatment("screens", BASS, 8, cost=95),
        Treatment(
            "slats", rt.Material("slats", [0.3, 0.3, 0.25], [0.05] * 3), 10, 41, "boards", 2.3
        ),
    )
    low = [np.nan] * 3 if one_sided else [0.2] * 3
    result = rt.calibrate(room, t, equation=rt.Sabine())
    return result, every, Target(low, [0.42] * 3)


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize("index", [0, *also(*range(1, 8))])
def test_exhaustive_search_finds_nothing_that_is_cheaper_by_one_percent(index):
    """Every number of panels, with a fine search over what may be had in any area."""
    result, treatments, target, p = designs.problem(index, stream=5)
    try:
        found = design(result, treatments, target, p)
    except InfeasibleError:
        model = design_model(result, treatments, target)
        assert designs.exhaustive(model, p)[1] is None
        return
    for treatment, area in zip(treatments, found.areas.tolist(), strict=True):
        panels = area / (treatment.unit or area or 1.0)
        assert treatment.unit is None or panels == pytest.approx(round(panels), abs=1e-9)
    assert found.probability[target.bounded].min() >= p - 1e-4
    assert designs.exhaustive(found.model, p, 0.99 * found.cost)[1] is None
    turned = design(result, treatments[::-1], target, p)
    assert turned.areas[::-1] == pytest.approx(found.areas, abs=1e-9)


@pytest.mark.usefixtures("few_draws")
def test_panels_that_may_be_cut_are_named_where_whole_ones_will_not_do():
    result = known()
    target = Target([np.nan] * 3, [1.3] * 3)
    some = design(result, TREATMENTS[:1], target, 0.8)
    area = float(some.areas[0])
    large = replace(TREATMENTS[0], largest=1.1 * area, unit=0.6 * area)
    bought = 2 * large.unit * large.cost
    said = f"No number of whole panels .*: {area:.1f} m² .* {some.cost:.0f} if .* {bought:.0f} if"
    with pytest.raises(InfeasibleError, match=said):
        design(result, [large], target, 0.8)


@pytest.mark.usefixtures("few_draws")
def test_nothing_is_placed_where_nothing_is_needed():
    shop, every, _ = a_shop(one_sided=True)
    before = shop.reverberation_time_after.tolist()
    for costs, high in ((1.0, [2.0] * 3), (0.0, [2.0] * 3), (1.0, before)):
        some = [replace(t, cost=costs * t.cost) for t in every]
        found = design(shop, some, Target([np.nan] * 3, high), 0.9)
        assert found.cost == 0
        assert found.areas.tolist() == [0, 0, 0]
    assert "Nothing is needed" in str(found)


@pytest.mark.usefixtures("few_draws")
def test_the_probability_is_that_of_the_prediction_of_the_same_changes():
    shop, every, target = a_shop(one_sided=False)
    found = design(shop, every, target, 0.85)
    put = [t.change(a) for t, a in zip(every, found.areas, strict=True) if a > 0]
    for changes in (put, put[::-1]):
        made = predict(shop, changes)
        assert made.probability(target.low, target.high) == pytest.approx(
            found.probability, abs=1e-9
        )
    # Whole numbers are areas as others are, and a design that has predicted goes to another process.
    whole = np.full(len(every), 2)
    expected = found.model.probability(whole.astype(float))
    assert np.array_equal(found.model.probability(whole), expected)
    again = pickle.loads(pickle.dumps(found)).model
    assert np.array_equal(again.probability(whole), expected)


@pytest.mark.usefixtures("few_draws")
def test_what_can_be_had_is_said_where_nothing_will_do():
    with pytest.raises(InfeasibleError, match=r"wider by .* at both ends can be met"):
        design(known(), TREATMENTS, Target([0.50] * 3, [0.56] * 3))
    small = tuple(replace(t, largest=3.0) for t in TREATMENTS)
    with pytest.raises(InfeasibleError, match=r"these probabilities by band: .* Hz 0\.00") as error:
        design(known(), small, TARGET)
    assert "already too short" not in str(error.value)
    assert "but the range ends at" in str(
        error.value
    )  # the room is far from it: no other words help
    assert "narrow the interval" not in str(error.value)
    with pytest.raises(
        InfeasibleError, match=r"T with these areas is .* but the range ends at 0.01"
    ):
        design(known(), TREATMENTS, Target([0.001] * 3, [0.01] * 3))
    t = known().known.time
    with pytest.raises(InfeasibleError, match="T is already too short for this target"):
        design(known(), TREATMENTS, Target(1.5 * t, 2 * t))
    model = design_model(known(), TREATMENTS, TARGET)
    assert "wider by less than 1 % at both ends" in " ".join(can_be_had(model, 0.8))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: design(known(), TREATMENTS, TARGET, 0.7), "0.7 must be from 0.8 to 0.99"),
        (lambda: design(known(), [], TARGET), "at least one"),
        (
            lambda: design(known(), [TREATMENTS[0], replace(TREATMENTS[0], cost=1)], TARGET),
            'treatments has "ceiling" twice',
        ),
        (lambda: design(known(), TREATMENTS, Target([0.4], [0.8])), "1 bands"),
        (lambda: Treatment("x", PANEL, 4, cost=1, unit=5), "larger than largest"),
        (lambda: Treatment("x", PANEL, 4, cost=-1), "cost = -1"),
        (lambda: Target([0.8], [0.4]), "must be below"),
        (lambda: Target([np.nan], [np.nan]), "every low and high is missing"),
        (lambda: Target([0.4], [100.5]), r"high\[0\] = 100.5 s"),
        (
            lambda: design(known(), [Treatment("x", PANEL, 2201, cost=1)], TARGET),
            'treatment "x": largest: area = 2201 m² is too large',
        ),
        (lambda: din_18041("A3", 6000, BANDS), "from 30 to 5000"),
        (lambda: din_18041("B1", 100, BANDS), "must be one of A1"),
        (lambda: ansi_s12_60(600, BANDS), "up to 566"),
        (
            lambda: design(known(), [Treatment("x", PANEL, 4, cost=1, covers="roof")], TARGET),
            '"roof" is not a material',
        ),
    ],
)
def test_what_breaks_a_rule_is_refused(make, said):
    with pytest.raises(DataError, match=said):
        make()


def test_standards_give_their_numbers():
    """Classroom of 180 m³: 0.32 lg 180 - 0.17 = 0.552 s, by hand."""
    target = din_18041("A3", 180, [125, 250, 1000, 4000, 8000])
    assert target.low[:4] == pytest.approx(0.5517 * np.array([0.65, 0.8, 0.8, 0.65]), abs=1e-3)
    assert target.high[:4] == pytest.approx(0.5517 * np.array([1.45, 1.2, 1.2, 1.2]), abs=1e-3)
    assert np.isnan(target.low[4])
    assert np.isnan(din_18041("A5", 2000, [125, 500]).low).tolist() == [True, False]


def a_seminar_room():
    """CR2 with one panel and a largest T alone: the mean of A has no upper end."""
    result = rt.calibrate(*rt.datasets.bras_cr2())
    panel = rt.Material("P", [0.4, 0.6, 0.8, 0.9, 0.9, 0.9], [0.1] * 6)
    target = Target([np.nan] * 6, [1.2, 1.2, 1.1, 1.1, 1.1, 1.1])
    return result, Treatment("a", panel, 40, 90, covers="ceiling"), target


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize("p", [0.86, *also(0.8)])
def test_a_largest_t_alone_is_met_at_the_least_area_that_keeps_the_promise(p):
    result, panel, target = a_seminar_room()
    found = rt.design(result, [panel], target, p)
    assert p - 0.002 <= found.probability.min() <= p + 0.002
    less = found.model.prediction(0.99 * found.areas)
    assert less.probability(target.low, target.high).min() < p
