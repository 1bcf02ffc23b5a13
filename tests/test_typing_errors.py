"""A value far from its neighbours is called a likely typing error before anything else."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.marks import far_from_neighbours, in_measurement, of_input
from rtcal.finder import case_of
from rtcal.io import tables
from rtcal.report.finding_words import cautions
from rtcal.support.text import as_sentence
from tests.conftest import measurement_of, room_of
from tests.test_discrepancy import controls_of

BANDS = [125, 250, 500, 1000, 2000, 4000]
USUAL = [1.1, 1.3, 1.24, 1.2, 1.05, 0.84]


def room(**stated):
    tiles = [0.2, 0.25, 0.3, 0.35, 0.35, 0.4]
    materials = {"plaster": (120, 0.05, 0.02), "linoleum": (70, 0.04, 0.02)}
    materials |= {"tiles": (70, tiles, 0.1)}
    return room_of(materials, BANDS, 210, air=rt.Air(), **stated)


@pytest.mark.parametrize("factor", [1 / 20, 1 / 10, 10, 20])
@pytest.mark.parametrize("band", range(6))
def test_a_value_20_times_its_neighbours_is_found_and_nothing_else(band, factor):
    t = np.array(USUAL)
    assert not far_from_neighbours(t).any()
    t[band] *= factor
    assert np.flatnonzero(far_from_neighbours(t)).tolist() == [band]
    # Another unit or another room for all bands is no outlier among them.
    assert np.array_equal(far_from_neighbours(1000 * t), far_from_neighbours(t))
    assert np.array_equal(far_from_neighbours(t[::-1]), far_from_neighbours(t)[::-1])


def test_what_rooms_do_is_no_typing_error():
    """Church: the air halves T per octave. Booth: long in the first band."""
    church = np.array([9.5, 9.0, 8.2, 6.5, 4.2, 2.2, 1.0, 0.4])
    booth = np.array([0.55, 0.2, 0.15, 0.13, 0.12, 0.12])
    assert not far_from_neighbours(church).any()
    assert not far_from_neighbours(booth).any()
    assert not far_from_neighbours(np.array([1.9, 0.4])).any()
    assert far_from_neighbours(np.array([1.9, 0.05])).all()  # which of the two is open
    assert not far_from_neighbours(np.array([1.9, 0.05]), late=False).any()
    assert not far_from_neighbours(np.array([0.5, 0.5, 6.0, 6.0])).any()
    some = np.array([np.nan, 1.9, np.nan, 0.05, np.nan, 1.6])
    assert np.flatnonzero(far_from_neighbours(some)).tolist() == [3]
    _, measured = rt.datasets.bras_cr2()
    assert in_measurement(measured) == []


def test_one_pair_of_many_is_found_though_the_mean_hides_it(tmp_path):
    table = np.tile(USUAL, (8, 1)) * np.linspace(0.97, 1.03, 8)[:, np.newaxis]
    table[5, 3] /= 20
    measured = measurement_of(BANDS, [("S1", f"R{i}") for i in range(8)], t30=table)
    result = rt.calibrate(room(), measured)
    assert result.trust_marks[0].text.startswith("T30 (S1 to R5) = 0.0608 s, beside 1.26 s at")
    tables.write(measured, tmp_path / "t.csv")
    said = str(tables.read(tmp_path / "t.csv")).split("Caution: ")[1]
    assert said.startswith("likely a typing error at 1000 Hz: T30 (S1 to R5) = ")


def test_a_coefficient_a_tenth_of_its_neighbours_is_found_and_no_resonator_is_missed():
    alpha = room().alpha.copy()
    assert of_input(room()) == ()
    alpha[2, 3] = 0.035 / 2
    wrong = room().replace(alpha=alpha)
    assert [e.frequency for e in of_input(wrong)] == [1000]
    mark = rt.calibrate(wrong, USUAL).trust_marks[0]
    assert mark.kind == "alpha_typing_error"
    assert mark.text == 'alpha of "tiles" = 0.0175, beside 0.3 at 500 Hz and 0.35 at 2000 Hz'
    alpha[2] = [0.1, 0.25, 0.85, 0.3, 0.12, 0.1]
    assert of_input(room().replace(alpha=alpha)) == ()


def shipped():
    halls = rt.datasets.halls
    of_halls = [
        h().room for h in (halls.lecture_hall, halls.hard_hall, halls.theatre, halls.corridor)
    ]
    where = rt.Room.from_file(str(rt.datasets.path("where_room/room.toml")))
    return [rt.datasets.bras_cr2()[0], rt.datasets.hidden_room()[0].room, where, *of_halls]


@pytest.mark.parametrize("factor", [0.1, 10])
@pytest.mark.parametrize("room", shipped(), ids=lambda room: room.name)
def test_ten_times_each_value_of_a_shipped_room_is_named_where_it_can_be(room, factor):
    """Which slips of a decimal point are named, and which nobody can see."""
    t = rt.Eyring().reverberation_time(room)
    assert not any(mark.is_error for mark in of_input(room, t))
    assert of_input(room, factor * t)[0].kind == "unit_error"
    kinds = [mark.kind for mark in of_input(room.replace(volume=factor * room.volume), t)]
    named = "dimensions" if room.dimensions else "surface_typing_error"
    assert kinds[0] == named
    for i, share in enumerate(room.areas / room.total_area):
        areas = room.areas.copy()
        areas[i] *= factor
        found = of_input(room.replace(areas=areas, surfaces=()), t)
        of_box, of_volume = (0.05, 0.18) if factor > 1 else (0.12, 0.3)
        if share > (of_box if room.dimensions else of_volume):
            assert found[0].kind.startswith("surface")
            assert factor < 1 or f'area of "{room.materials[i]}"' in found[0].text
        elif share < (0.04 if room.dimensions else 0.09):
            assert not found


@pytest.mark.parametrize("wrong", ["area", "volume", "T", "alpha"])
def test_every_command_names_the_same_doubts_in_the_same_order(wrong):
    right = room()
    t = rt.Eyring().reverberation_time(right) * (10 if wrong == "T" else 1)
    areas, alpha = right.areas * ([1, 10, 1] if wrong == "area" else 1), right.alpha.copy()
    if wrong == "alpha":
        alpha[2, 3] /= 20
    volume = right.volume * (10 if wrong == "volume" else 1)
    stated = right.replace(areas=areas, alpha=alpha, volume=volume)
    doubts = [as_sentence(mark.sentence) for mark in of_input(stated, t)]
    assert doubts
    result = rt.calibrate(stated, t, method="soft", unreachable="nearest")
    assert [mark.kind for mark in result.trust_marks[: len(doubts)]] == [
        mark.kind for mark in of_input(stated, t)
    ]
    assert result.predict([]).heads[: len(doubts)] == doubts
    of_room = [as_sentence(mark.sentence) for mark in of_input(stated)]
    assert rt.prediction.predict(stated, []).heads[:-1] == of_room
    measured = rt.Measurement.from_values(BANDS, t20=t)
    controls = controls_of(case_of(stated, measured))
    found = rt.find(stated, measured, only=["opening"], controls=controls)
    assert cautions(found)[: len(doubts)] == doubts
    assert [as_sentence(m.sentence) for m in rt.loop.start(stated, measured).doubts] == doubts


def test_a_room_of_which_nothing_can_move_says_so():
    exact = room().replace(sigma=np.zeros((3, 6)))
    assert [mark.kind for mark in of_input(exact)] == ["fixed"]
    with pytest.raises(rt.errors.InfeasibleError, match=r"^Sigma is 0 for every coefficient: no c"):
        rt.calibrate(exact, USUAL)
