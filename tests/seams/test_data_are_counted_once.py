"""A law: no way of calibrating takes the same data twice, also not after a small change."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.marks import given_twice
from rtcal.loop import positions
from rtcal.loop.measured_pairs import fingerprints, pairs_to_match
from rtcal.simulators.base import Observations
from rtcal.support.errors import DataError
from tests.conftest import in_hall, measurement_of


@pytest.fixture(scope="module")
def room_and_times():
    room, measured = rt.datasets.bras_cr2()
    return room, measured.reverberation_time


@pytest.mark.parametrize("change", [0.0, 1e-7, -1e-7, 2e-5])
def test_an_equation(room_and_times, change):
    room, times = room_and_times
    once = rt.calibrate(room, times).room
    with pytest.raises(DataError, match="already calibrated on these data"):
        rt.calibrate(once, times + change)
    rt.calibrate(once, times * 1.01)


@pytest.mark.parametrize("change", [0.0, 1e-7, 2e-5])
def test_every_position(room_and_times, change):
    room, times = room_and_times
    pairs = [("S1", "R1"), ("S1", "R2")]

    def names(of, change):
        values = {"edt": np.stack([times, 1.1 * times]) + change}
        measured = measurement_of(room.centre_frequencies, pairs, **values)
        return fingerprints(of, Observations.of_measurement(measured, ("edt",), pairs), measured)

    record = rt.acoustics.room.CalibrationRecord(
        method="positions", equation="", measured=" ".join(names(room, 0.0))
    )
    with pytest.raises(DataError, match="already calibrated on these data"):
        names(room.replace(calibration=record), change)
    assert names(room.replace(calibration=record), 0.01)


def test_a_part_of_the_data_counts_once_too(room_and_times):
    room, times = room_and_times
    part = times.copy()
    part[0] = np.nan
    of_part, of_all = (rt.calibrate(room, t).room for t in (part, times))
    with pytest.raises(DataError, match=r"on these data \(T at 250 Hz, T at 500 Hz, T at 1000 Hz"):
        rt.calibrate(of_part, times)
    with pytest.raises(DataError, match="already calibrated on these data"):
        rt.calibrate(of_all, part)


@pytest.mark.parametrize("equal", [[2], [1, 4], [0, 2, 5]])
def test_rounded_values_agree_by_chance_and_are_other_data(room_and_times, equal):
    room, times = room_and_times
    times = times.round(2)
    once = rt.calibrate(room, times).room
    other = (1.02 * times).round(2)
    other[equal] = times[equal]
    rt.calibrate(once, other)


PLACES = [("S 1", f"R,{i}") for i in range(4)]
"""Names with characters that a record sets apart."""


def at_places(room, times, kept, **scale):
    spread = times * (1 + 0.03 * np.arange(len(PLACES)))[:, np.newaxis]
    return measurement_of(
        room.centre_frequencies,
        [PLACES[i] for i in kept],
        **{name: (factor * spread)[kept] for name, factor in scale.items()},
    )


@pytest.mark.parametrize("entry", ["mean", "positions"])
def test_a_pair_is_left_out(room_and_times, entry, tmp_path):
    room, times = room_and_times

    def data_of(of, kept, **scale):
        measured = at_places(of, times, kept, **scale)
        if entry == "mean":
            return rt.calibrate(of, measured).room.calibration.measured
        observations = Observations.of_measurement(measured, tuple(scale), measured.pairs)
        return " ".join(fingerprints(of, observations, measured))

    names = data_of(room, [0, 1, 2], t20=1.0)
    record = rt.acoustics.room.CalibrationRecord(method="fit", equation="", measured=names)
    room.replace(calibration=record).save(str(tmp_path / "room.toml"))
    once = rt.Room.from_file(str(tmp_path / "room.toml"))
    for kept in ([0, 1], [1, 2, 0], [0, 1, 2]):
        with pytest.raises(DataError, match="already calibrated on these data"):
            data_of(once, kept, t20=1.0)
    with pytest.raises(DataError, match=r"T20 of S 1 to R,2 at 125 Hz"):
        data_of(once, [2, 3], t20=1.0)
    assert data_of(once, [3], t20=1.0)  # another pair
    assert data_of(once, [0, 1, 2], t20=1.01)  # another state, or the same one measured again
    assert data_of(once, [0, 1, 2], t30=1.01)  # another parameter
    if entry == "positions":
        assert data_of(once, [0, 1, 2], edt=1.0)
        with pytest.raises(DataError, match="already calibrated on these data"):
            data_of(once, [0, 1], t20=1.0, edt=1.1)


@pytest.mark.parametrize(("factor", "said"), [(1.0, True), (1.01, False)])
def test_a_copied_decay_time_is_said_at_every_position(room_and_times, factor, said):
    room, times = room_and_times
    pairs = [("S1", "R1"), ("S1", "R2")]
    t20 = np.stack([times, 1.1 * times])
    heard = measurement_of(room.centre_frequencies, pairs, t20=t20, t30=factor * t20)
    match = ("t20", "t30")
    data = pairs_to_match(room, heard, match, Observations.of_measurement(heard, match, pairs))
    assert any("leave one out of match" in note for note in data.notes) == said


@pytest.mark.parametrize("match", [("t20",), ("edt", "t20"), ("edt",)])
def test_a_fit_refuses_them_before_it_simulates(match, monkeypatch):
    """It refused after more than 10 s of paths."""

    def begun(*_):
        raise AssertionError("the paths have begun")

    monkeypatch.setattr(positions, "trace_ahead", begun)
    hall = rt.datasets.halls.corridor()
    tracer = in_hall(hall, n_paths=800)
    times = 1 + np.arange(len(tracer.pairs) * hall.room.n_bands).reshape(-1, hall.room.n_bands) / 9
    measured = measurement_of(
        hall.room.centre_frequencies, tracer.pairs, t20=times, edt=1.1 * times
    )
    once = rt.calibrate(hall.room, measured, unreachable="nearest").room
    used = replace(tracer, room=once)
    with pytest.raises(DataError, match="already calibrated on these data"):
        rt.calibrate_positions(used, once, measured, match)
    with pytest.raises(AssertionError, match="have begun"):
        rt.calibrate_positions(tracer, hall.room, measured, match)


@pytest.mark.parametrize("bands", [[500, 1000, 2000], [125, 250, 500, 1000, 2000, 4000]])
@pytest.mark.parametrize("equal", [True, False])
def test_a_position_that_is_given_twice_is_said_in_python(bands, equal):
    """The commands alone said it, of six values or more, where three fine ones are no chance, too."""
    room, measured = rt.datasets.bras_cr2()
    rows = [i for i, f in enumerate(room.centre_frequencies) if f in bands]
    room = room.replace(
        alpha=room.alpha[:, rows], sigma=room.sigma[:, rows], centre_frequencies=bands
    )
    times = measured.reverberation_time[rows]
    heard = measurement_of(
        bands,
        [("S1", "R1"), ("S1", "R2")],
        t20=np.stack([times, times if equal else (times * 1.03).round(2)]),
    )
    said = "every value of S1 to R2 equals that of S1 to R1"
    quick = equal and len(bands) == 3
    for made in (rt.calibrate(room, heard), *([rt.find(room, heard)] if quick else [])):
        text = " ".join(str(made).split())
        assert (said in text.replace("Every", "every")) == equal
        assert ".." not in text


@pytest.mark.parametrize(("value", "said"), [(0.31, False), (1.94, True)])
def test_few_rounded_values_are_equal_by_chance(value, said):
    """Three of 0.3 s with two decimals agree at two positions in one of some 4 cases."""
    heard = measurement_of(
        [500, 1000, 2000], [("S1", "R1"), ("S1", "R2")], t20=np.full((2, 3), value)
    )
    assert bool(given_twice(heard)) == said


@pytest.mark.parametrize("method", ["joint", "mle", "lse", "smooth", "robust"])
def test_one_state_that_is_given_twice_is_refused(room_and_times, method):
    """Its T counted twice, where the command refused the same files."""
    room, times = room_and_times
    both = rt.Configurations([room, room], ["empty", "again"])
    with pytest.raises(DataError, match='"empty" and "again" have the same areas and the same'):
        rt.calibrate(both, [times, times], method)


def test_two_states_of_one_t_and_other_areas_are_two(room_and_times):
    room, times = room_and_times
    other = room.replace(areas=1.01 * room.areas)
    rt.calibrate(rt.Configurations([room, other], ["one", "two"]), [times, times], "joint")
