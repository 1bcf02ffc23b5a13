"""Sources that are not omnidirectional: the lobe, room files, and the paths that it weighs."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.directivity import Directivity
from rtcal.datasets import halls
from rtcal.errors import DataError
from rtcal.io import geometry_files
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import jit

HALL = halls.lecture_hall()
SOURCE, RECEIVER = HALL.sources["S1"], next(iter(HALL.receivers))
TO_RECEIVER = tuple(np.subtract(HALL.receivers[RECEIVER], SOURCE))


def tracer(**options):
    settings = {
        "n_paths": 4000,
        "geometry": HALL.geometry,
        "room": HALL.room,
        "sources": {"S1": SOURCE},
        "receivers": HALL.receivers,
    }
    return PathTracing(**(settings | options))


def speaker(index, aim=TO_RECEIVER):
    return {"S1": Directivity(index=index, aim=aim)}


def test_the_lobe_s_mean_over_all_directions_is_one():
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((200_000, 3))
    gain = Directivity(index=[0, 3, 8], aim=(1, 2, -1)).gain(directions)
    assert gain[:, 0] == pytest.approx(1, abs=1e-12)
    assert gain.mean(axis=0) == pytest.approx([1, 1, 1], abs=0.02)


def test_the_index_is_the_level_on_the_axis():
    on_axis = Directivity(index=[3, 8], aim=(0, 0, 2)).gain([[0, 0, 5]])
    assert 10 * np.log10(on_axis[0]) == pytest.approx([3, 8])


def test_an_index_of_zero_changes_nothing():
    plain = tracer().simulate(HALL.room.alpha, seed=1)
    stated = tracer(directivity=speaker(0.0)).simulate(HALL.room.alpha, seed=1)
    for parameter, values in plain.values.items():
        assert np.array_equal(values, stated.values[parameter])


def test_sound_that_no_wall_reflects_has_the_gain_of_its_direction():
    alpha = np.full_like(HALL.room.alpha, 0.999999)
    index = np.arange(1.0, HALL.room.n_bands + 1)
    plain = tracer().energy(alpha, 0.1, seed=1).mean(axis=0)[0, 0, :, 0]
    towards = tracer(directivity=speaker(index)).energy(alpha, 0.1, seed=1)
    away = tracer(directivity=speaker(index, np.negative(TO_RECEIVER)))
    ratio = towards.mean(axis=0)[0, 0, :, 0] / plain
    assert 10 * np.log10(ratio) == pytest.approx(index, abs=1e-4)
    assert away.energy(alpha, 0.1, seed=1).mean(axis=0)[0, 0, :, 0].max() < 1e-3 * plain.min()


def test_late_energy_is_that_of_the_same_power():
    """The mean gain is 1, and sound forgets where it was sent to."""
    alpha = np.full_like(HALL.room.alpha, 0.05)
    options = {"scattering": 0.9, "n_paths": 16_000}
    late = [
        tracer(directivity=of, **options).energy(alpha, 0.6, seed=2).mean(axis=0)[..., 150:].sum(-1)
        for of in ({}, speaker(7.0))
    ]
    assert (late[1] / late[0]).mean() == pytest.approx(1, abs=0.05)


def test_an_aimed_source_moves_early_parameters_and_not_t20():
    plain = tracer().simulate(HALL.room.alpha, seed=1)
    aimed = tracer(directivity=speaker(7.0)).simulate(HALL.room.alpha, seed=1)
    pair = aimed.pairs.index(("S1", RECEIVER))
    assert (aimed.values["c50"][pair] - plain.values["c50"][pair]).min() > 1
    ratio = aimed.mean("t20") / plain.mean("t20")
    assert np.abs(ratio - 1).max() < 0.05


def test_derivatives_are_those_of_the_aimed_source():
    aimed = tracer(directivity=speaker([2.0, 3, 4, 5, 6, 7, 8]), n_paths=1600)
    alpha, step = np.full_like(HALL.room.alpha, 0.3), 1e-4
    more = alpha.copy()
    more[0] += step
    jacobian = aimed.jacobian(alpha, ["level"], seed=1)[0, :, :, 0]
    change = (
        aimed.observe(more, ["level"], seed=1).values
        - aimed.observe(alpha, ["level"], seed=1).values
    )
    assert change[0] / step == pytest.approx(jacobian, rel=1e-2, abs=1e-3)


@pytest.mark.skipif(not jit.available(), reason="needs numba")
def test_both_kernels_trace_the_same_aimed_paths(monkeypatch):
    aimed = {"directivity": speaker([1.0, 2, 3, 4, 5, 6, 7]), "n_paths": 160}
    compiled = tracer(**aimed).energy(HALL.room.alpha, 0.1, seed=1)
    monkeypatch.setattr(jit, "available", lambda: False)
    assert tracer(**aimed).energy(HALL.room.alpha, 0.1, seed=1) == pytest.approx(compiled, rel=1e-5)


def test_where_the_directivity_is_unknown_reverberation_times_alone_count():
    unknown = tracer(directivity={"S1": "unknown"})
    assert unknown.trusted(["t20", "edt", "c80", "ts", "level"]) == ("t20",)
    assert tracer().trusted(["edt", "c80"]) == ("edt", "c80")
    with pytest.raises(DataError, match="depends on the directivity of a source, which is unknown"):
        unknown.trusted(["edt", "sti"])


def test_a_fit_leaves_them_out_and_says_so():
    measured = tracer(n_paths=1600).simulate(HALL.room.alpha, seed=5)
    said = {}
    for directivity in ({}, {"S1": "unknown"}):
        result = rt.calibrate_positions(
            tracer(n_paths=320, directivity=directivity), HALL.room, measured,
            match=["t20", "edt"], fit_scattering=False,
        )  # fmt: skip
        said[bool(directivity)] = str(result)
    assert "Taken as omnidirectional: S1." in said[False]
    assert "The directivity of S1 is unknown. So reverberation times alone are used" in said[True]
    assert "EDT" in said[False]


def box(**scene):
    return rt.Room(
        name="box", volume=60, dimensions=(4, 5, 3), materials=["plaster"], areas=[94],
        alpha=[[0.1, 0.2]], sigma=[[0.02, 0.02]], centre_frequencies=[500, 1000],
        scattering=[[0.3, 0.3]],
        scene=rt.Scene(
            sources={"S1": (1, 1, 1.5), "S 2": (2, 1, 1)}, receivers={"R1": (3, 4, 1.2)}, **scene
        ),
    )  # fmt: skip


def test_a_room_file_keeps_it_and_the_simulator_takes_it(tmp_path):
    stated = {"S1": Directivity(index=[3, 7.5], aim=(1, 1, 0)), "S 2": "unknown"}
    room = box(directivity=stated)
    room.save(tmp_path / "room.toml")
    again = rt.Room.from_file(tmp_path / "room.toml")
    assert again.scene.directivity == stated
    assert rt.Room.from_dict(room.to_dict()).scene.directivity == stated
    made = geometry_files.path_tracing(again, n_paths=160)
    assert made.directivity["S1"] == stated["S1"]
    # "unknown" is taken as omnidirectional
    one = geometry_files.path_tracing(box(directivity={"S1": stated["S1"]}), n_paths=160)
    alpha = room.alpha
    assert np.array_equal(made.energy(alpha, 0.1), one.energy(alpha, 0.1))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Directivity(index=-1, aim=(1, 0, 0)), "index[0] = -1 dB is not from 0 to 25 dB"),
        (lambda: Directivity(index=[3, np.nan], aim=(1, 0, 0)), "index[1] = nan dB is not"),
        (lambda: Directivity(index=[], aim=(1, 0, 0)), "index has shape (0,)"),
        (lambda: Directivity(index=3, aim=(0, 0, 0)), "aim = (0, 0, 0) is not a direction"),
        (lambda: Directivity(index=3, aim=(1, 0)), "aim = (1, 0) is not a direction"),
        (
            lambda: box(directivity={"S3": "unknown"}),
            'directivity["S3"] is of a source that is not',
        ),
        (lambda: box(directivity={"S1": "omni"}), "is not a Directivity or"),
        (
            lambda: Directivity.from_dict({"index": 3}, 'room.toml: directivity "S1"'),
            'room.toml: directivity "S1" lacks aim',
        ),
        (
            lambda: Directivity.from_dict({"index": [3, "7"], "aim": [1, 0, 0]}, "S1"),
            "S1.index[1] = '7' is not a number",
        ),
        (
            lambda: geometry_files.path_tracing(box(directivity=speaker([1.0, 2, 3]))),
            'directivity["S1"].index has 3 values; the room has 2 bands',
        ),
    ],
)
def test_bad_input_names_place_value_and_rule(make, said):
    with pytest.raises(DataError) as error:
        make()
    assert said in str(error.value)
