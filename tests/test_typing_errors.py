"""A value far from its neighbours is called a likely typing error before anything else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import rtcal as rt
from rtcal.acoustics.marks import far_from_neighbours, in_measurement, of_input
from rtcal.command.main import cli
from rtcal.io import tables
from rtcal.report.finding_words import cautions
from rtcal.support.text import as_sentence

BANDS = [125, 250, 500, 1000, 2000, 4000]
USUAL = [1.1, 1.3, 1.24, 1.2, 1.05, 0.84]


def room(**stated: object) -> rt.Room:
    return rt.Room(
        name="classroom",
        volume=210,
        materials=["plaster", "linoleum", "tiles"],
        areas=[120, 70, 70],
        alpha=[[0.05] * 6, [0.04] * 6, [0.2, 0.25, 0.3, 0.35, 0.35, 0.4]],
        sigma=[[0.02] * 6, [0.02] * 6, [0.1] * 6],
        centre_frequencies=BANDS,
        air=rt.Air(),
        **stated,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("factor", [1 / 20, 1 / 10, 10, 20])
@pytest.mark.parametrize("band", range(6))
def test_a_value_20_times_its_neighbours_is_found_and_nothing_else(
    band: int, factor: float
) -> None:
    t = np.array(USUAL)
    assert not far_from_neighbours(t).any()
    t[band] *= factor
    assert np.flatnonzero(far_from_neighbours(t)).tolist() == [band]
    # Another unit or another room for all bands is no outlier among them.
    assert np.array_equal(far_from_neighbours(1000 * t), far_from_neighbours(t))
    assert np.array_equal(far_from_neighbours(t[::-1]), far_from_neighbours(t)[::-1])


def test_what_rooms_do_is_no_typing_error() -> None:
    """Church: the air halves T per octave. Booth: long in the first band."""
    church = np.array([9.5, 9.0, 8.2, 6.5, 4.2, 2.2, 1.0, 0.4])
    booth = np.array([0.55, 0.2, 0.15, 0.13, 0.12, 0.12])
    assert not far_from_neighbours(church).any()
    assert not far_from_neighbours(booth).any()
    assert not far_from_neighbours(np.array([1.9, 0.05])).any()  # which of the two is open
    assert not far_from_neighbours(np.array([0.5, 0.5, 6.0, 6.0])).any()
    some = np.array([np.nan, 1.9, np.nan, 0.05, np.nan, 1.6])
    assert np.flatnonzero(far_from_neighbours(some)).tolist() == [3]
    _, measured = rt.datasets.bras_cr2()
    assert in_measurement(measured) == []


def test_one_pair_of_many_is_found_though_the_mean_hides_it(tmp_path: Path) -> None:
    table = np.tile(USUAL, (8, 1)) * np.linspace(0.97, 1.03, 8)[:, np.newaxis]
    table[5, 3] /= 20
    measured = rt.Measurement(
        centre_frequencies=BANDS,
        values={"t30": table},
        pairs=[("S1", f"R{i}") for i in range(8)],
    )
    result = rt.calibrate(room(), measured)
    assert result.trust_marks[0].text.startswith("T30 (S1 to R5) = 0.0608 s, beside 1.26 s at")
    tables.write(measured, tmp_path / "t.csv")
    said = str(tables.read(tmp_path / "t.csv")).splitlines()
    assert said[0].startswith("likely a typing error at 1000 Hz: T30 (S1 to R5) = ")


def test_a_coefficient_a_tenth_of_its_neighbours_is_found_and_no_resonator_is_missed() -> None:
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


def a_box(**stated: object) -> rt.Room:
    """5 x 4 x 3 m of even absorption but for its ceiling, by areas alone."""
    return rt.Room(
        name="box",
        volume=60,
        materials=["ceiling", "floor", "rest"],
        areas=[20, 20, 54],
        alpha=[[0.9] * 2, [0.1] * 2, [0.1] * 2],
        sigma=[[0.1] * 2, [0.03] * 2, [0.03] * 2],
        centre_frequencies=[500, 1000],
        dimensions=(5, 4, 3),
        air=rt.Air(),
        **stated,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize(("row", "factor"), [(0, 10), (1, 10), (2, 10), (2, 0.1), (0, 0.1)])
def test_an_area_that_is_ten_times_another_is_named_first(row: int, factor: float) -> None:
    room = a_box()
    t = rt.Eyring().reverberation_time(room)
    kinds = {mark.kind for mark in rt.calibrate(room, t).trust_marks}
    assert "equations_differ" in kinds
    assert not {"surface_typing_error", "surface"} & kinds
    areas = room.areas.copy()
    areas[row] *= factor
    wrong = room.replace(areas=areas)
    result = rt.calibrate(wrong, t, unreachable="nearest")
    marks = [mark.kind for mark in result.trust_marks]
    named = f'area of "{room.materials[row]}" = {areas[row]:g} m², for {room.areas[row]:g} m²'
    assert marks[0] == "surface_typing_error"
    assert named in str(result)
    assert "Likely a typing error: " in str(result)
    # The other caution stays, though the areas no longer show what the directions are.
    assert {"equations_differ", "directions_unknown"} & {*marks}
    if row == 1:
        measured = rt.Measurement.from_values([500, 1000], t20=t)
        found = rt.find(wrong, measured)
        assert cautions(found)[0].startswith(f"Likely a typing error: {named}")


def test_furniture_and_steps_are_no_mistyped_area() -> None:
    room = a_box()
    for more in ([20, 20, 54 * 0.9], [20, 30, 74], [25, 25, 60]):
        assert of_input(room.replace(areas=more)) == ()
    (mark,) = of_input(room.replace(areas=[60, 60, 60]))
    assert mark.kind == "surface"
    assert "180 m², but a box of 5 x 4 x 3 m has 94 m²" in mark.text


@pytest.mark.parametrize("factor", [0.001, 0.1, 10, 1000])
def test_a_factor_of_ten_in_every_band_is_named_before_anything_else(factor: float) -> None:
    t = rt.Eyring().reverberation_time(room())
    result = rt.calibrate(room(), factor * t, unreachable="nearest")
    assert result.trust_marks[0].kind == "unit_error"
    assert str(result).count("Likely a typing error: T is") == 1
    if factor > 1:
        with pytest.raises(rt.errors.InfeasibleError, match=r"^Likely a typing error: T is "):
            rt.calibrate(room(), factor * t)
    for other in (0.3, 3.0):
        marks = rt.calibrate(room(), other * t, unreachable="nearest").trust_marks
        assert "unit_error" not in {mark.kind for mark in marks}


def shipped() -> list[rt.Room]:
    halls = rt.datasets.halls
    of_halls = [
        h().room for h in (halls.lecture_hall, halls.hard_hall, halls.theatre, halls.corridor)
    ]
    where = rt.Room.from_file(str(rt.datasets.path("where_room/room.toml")))
    return [rt.datasets.bras_cr2()[0], rt.datasets.hidden_room()[0].room, where, *of_halls]


@pytest.mark.parametrize("factor", [0.1, 10])
@pytest.mark.parametrize("room", shipped(), ids=lambda room: room.name)
def test_ten_times_each_value_of_a_shipped_room_is_named_where_it_can_be(
    room: rt.Room, factor: float
) -> None:
    """The table of docs/reading_a_result.md: which are named, and which nobody can see."""
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
def test_every_command_names_the_same_doubts_in_the_same_order(wrong: str) -> None:
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
    assert result.predict([]).heads[1:-1] == doubts
    of_room = [as_sentence(mark.sentence) for mark in of_input(stated)]
    assert rt.prediction.predict(stated, []).heads[1:-1] == of_room
    measured = rt.Measurement.from_values(BANDS, t20=t)
    assert cautions(rt.find(stated, measured))[: len(doubts)] == doubts
    assert [as_sentence(m.sentence) for m in rt.loop.start(stated, measured).doubts] == doubts


def test_a_room_of_which_nothing_can_move_says_so() -> None:
    exact = room().replace(sigma=np.zeros((3, 6)))
    assert [mark.kind for mark in of_input(exact)] == ["fixed"]
    with pytest.raises(rt.errors.InfeasibleError, match=r"^Sigma is 0 for every coefficient: noth"):
        rt.calibrate(exact, USUAL)


def test_a_fit_names_them_first() -> None:
    hall = rt.datasets.halls.corridor()
    tracer = rt.simulators.PathTracing(
        room=hall.room,
        geometry=hall.geometry,
        sources=hall.sources,
        receivers=hall.receivers,
        n_paths=320,
    )
    simulated = tracer.simulate(hall.room.alpha, seed=1)
    measured = rt.Measurement(
        centre_frequencies=simulated.centre_frequencies,
        values={"t20": 10 * simulated.values["t20"]},
        pairs=simulated.pairs,
    )
    controls = rt.loop.ControlRuns(
        parameters=("t20",),
        pairs=tracer.pairs,
        errors=0.1 * np.ones((4, 1, len(tracer.pairs), hall.room.n_bands)),
    )
    result = rt.calibrate_positions(
        tracer, hall.room, measured, ("t20",), controls=controls, more_paths=1
    )
    assert result.warning.startswith("Likely a typing error: T is ")


def test_nothing_changes_is_said_whether_t_was_measured_or_not() -> None:
    """It was "T falls by 0 %, from 1.25 to 1.25 s" of the stated coefficients."""
    room, measured = rt.datasets.bras_cr2()
    for known in (room, rt.calibrate(room, measured)):
        assert rt.prediction.predict(known, []).headline.startswith("Nothing changes: ")


def test_a_state_that_is_given_twice_is_refused(tmp_path: Path) -> None:
    room, measured = rt.datasets.bras_cr2()
    files = [str(tmp_path / "room.toml"), str(tmp_path / "t.csv")]
    room.save(files[0])
    measured.save(files[1])
    change = tmp_path / "v.toml"
    change.write_text('[[variant]]\nname = "as it is"\n')
    command = ["predict", *files, "--change", str(change), "--also", *files]
    done = CliRunner().invoke(cli, command)
    assert "this state is given twice" in str(done.exception)
