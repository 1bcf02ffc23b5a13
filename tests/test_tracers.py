"""`PathTracing` and `RayTracing` as simulators: noise, seeds, length, air, bad input."""

import sys

import numpy as np
import pytest

from rtcal.acoustics.air import Air
from rtcal.datasets import halls
from rtcal.simulators import PathTracing, Polyhedron, base
from rtcal.simulators.path_tracing import measurement
from rtcal.simulators.ray_tracing import RayTracing
from rtcal.support.errors import DataError, MissingDependencyError, TooShortError
from tests.conftest import in_geometry, in_hall

pytest.importorskip("pyroomacoustics")

HALL = halls.lecture_hall()
POINTS = {"sources": {"S1": HALL.sources["S1"]}, "receivers": HALL.receivers}


def path_tracer(**options):
    return in_hall(HALL, **{"n_paths": 1600, **POINTS} | options)


def ray_tracer(**options):
    settings = {
        "n_rays": 160,
        "n_batches": 2,
        "geometry": HALL.geometry,
        "room": HALL.room,
        **POINTS,
    }
    return RayTracing(**(settings | options))


@pytest.mark.parametrize("make", [path_tracer, ray_tracer])
def test_walls_hold_the_room_s_volume(make):
    for share in (0.92, 1.08):
        make(room=HALL.room.replace(volume=share * HALL.geometry.volume))
    for share in (0.5, 0.88, 1.12):
        volume = share * HALL.geometry.volume
        said = f"volume = {volume:g} m³, but the geometry has {HALL.geometry.volume:g} m³"
        with pytest.raises(DataError, match=said):
            make(room=HALL.room.replace(volume=volume))


@pytest.mark.parametrize("make", [path_tracer, ray_tracer])
def test_they_are_simulators(make):
    simulator = make()
    assert isinstance(simulator, base.Simulator)
    assert not simulator.deterministic
    assert HALL.room.name in simulator.name
    found = base.run(simulator, HALL.room.alpha, seed=1)
    assert found.pairs == tuple(("S1", r) for r in HALL.receivers)
    assert np.isfinite(found.uncertainty["t20"]).all()
    assert (found.uncertainty["t20"] > 0).all()
    assert (found.values["t20"] > 0.3).all()
    again = simulator.simulate(HALL.room.alpha, seed=1)
    other = simulator.simulate(HALL.room.alpha, seed=2)
    for name, value in found.values.items():
        assert np.array_equal(again.values[name], value, equal_nan=True)
    assert (other.values["t20"] != found.values["t20"]).any()


def test_a_longer_decay_gets_longer_paths():
    tracer = path_tracer()
    tracer.simulate(HALL.room.alpha, seed=1)
    before = tracer.traced(0, 0.1, seed=1).longest
    found = tracer.simulate(HALL.room.alpha / 8, seed=1)
    after = tracer.traced(0, 0.1, seed=1).longest
    assert after > 2 * before
    assert np.isfinite(found.values["t20"]).all()


def test_a_decay_without_end_is_too_short(monkeypatch):
    monkeypatch.setattr("rtcal.simulators.path_tracing.LONGEST", 0.5)
    room = HALL.room.replace(air=None)
    with pytest.raises(TooShortError, match="too short for T20"):
        path_tracer(room=room).simulate(np.zeros_like(room.alpha), seed=1)


def test_noise_that_is_not_determined_is_nan():
    """One batch has all but the direct sound: without it there is no T20, and nothing late."""
    time = np.arange(600) * 0.002
    energy = np.tile(10 ** (-6 * time / 0.5), (4, 1, 1, 1))
    shared = measurement(energy, 0.002, np.array([1000.0]), [("S", "R")])
    energy[1:, ..., 1:] = 0
    energy[0, ..., 1:] *= 4
    found = measurement(energy, 0.002, np.array([1000.0]), [("S", "R")])
    for name in ("t20", "c50"):
        assert found.values[name] == pytest.approx(shared.values[name], rel=1e-9)
        assert np.isnan(found.uncertainty[name]).all()
        assert shared.uncertainty[name] == pytest.approx(0, abs=1e-9)


def test_ray_tracing_applies_iso_9613_air():
    # Room and seed are the same, so the rays are: the ratio of the decays is the air's alone.
    alpha = np.full_like(HALL.room.alpha, 0.2)
    dry = ray_tracer(room=HALL.room.replace(air=None), scattering=0.0)
    c = HALL.room.speed_of_sound  # 20 °C in both
    room = HALL.room.replace(air=Air(20, 30))
    humid = ray_tracer(room=room, scattering=0.0).energy(alpha, 0.4, seed=1)
    plain = dry.energy(alpha, 0.4, seed=1)
    m = Air(20, 30).attenuation(HALL.room.centre_frequencies)
    first = np.linalg.norm(np.array(list(HALL.receivers.values())) - HALL.sources["S1"], axis=1)[
        :, np.newaxis, np.newaxis
    ]
    length = first + c * 0.002 * (np.arange(plain.shape[-1]) + 0.5)
    expected = np.broadcast_to(np.exp(-m[:, np.newaxis] * length), plain.shape)
    heard = plain > 0
    # A bin is 0.7 m long, and a ray is noted up to 0.1 m before the direct sound.
    assert (humid[heard] / plain[heard]) == pytest.approx(expected[heard], rel=0.02)
    assert np.exp(-m[-1] * 100) < 0.2  # so that the test would notice if it were left out


def test_the_direct_sound_of_both_is_the_inverse_square_law():
    alpha = np.full_like(HALL.room.alpha, 1.0)
    distance = np.linalg.norm(np.array(HALL.receivers["R1"]) - HALL.sources["S1"])
    for tracer, tolerance in (
        (path_tracer(room=HALL.room.replace(air=None)), 1e-9),
        (ray_tracer(room=HALL.room.replace(air=None), n_rays=20000, scattering=0.0), 0.05),
    ):
        heard = tracer.energy(alpha, 0.1, seed=1).mean(axis=0)[0, 0, 3].sum()
        assert heard == pytest.approx(1 / (4 * np.pi * distance**2), rel=tolerance)


@pytest.mark.parametrize("make", [path_tracer, ray_tracer])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sources": {"S1": (50, 1, 1)}}, 'source "S1" = .* is outside the room'),
        ({"receivers": {"R": (1, 1)}}, 'receiver "R" has shape'),
        ({"receivers": {}}, "no receiver"),
        ({"scattering": 1.5}, r"scattering\[.*\] = 1.5 must be from"),
        ({"scattering": np.zeros((2, 2))}, "scattering"),
        ({"room": HALL.room.replace(scattering=None)}, "no scattering coefficients"),
        ({"n_batches": 1}, "at least two batches"),
        ({"bin_width": -1.0}, "bin_width"),
        ({"bin_width": 10.0}, "bin_width = 10 s is more than 0.01 s"),
        ({"radius": 0.0}, "radius"),
        ({"geometry": Polyhedron.shoebox((9, 11, 4), "velvet")}, '"velvet" is not a material'),
    ],
)
def test_bad_input(make, options, message):
    with pytest.raises(DataError, match=message):
        make(**options)


def test_without_pyroomacoustics_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyroomacoustics", None)
    with pytest.raises(MissingDependencyError, match=r"rtcal\[geometry\]"):
        ray_tracer()


# Whatever is asked of groups of paths and of derivatives holds wherever what they are of holds

WALLS = ("west", "east", "south", "north", "floor", "ceiling")
MATCH = ("t20", "edt", "c80", "ts", "level")


def box(alpha, n_paths):
    geometry = Polyhedron.shoebox((5, 7, 3), {wall: wall for wall in WALLS})
    room = in_geometry(geometry, [1000], alpha)
    return PathTracing(
        geometry=geometry,
        room=room,
        sources={"S": (1.2, 1.0, 1.5)},
        receivers={"R1": (3.5, 5.2, 1.2), "R2": (3.4, 2.4, 1.3)},
        scattering=0.4,
        n_paths=n_paths,
    )


@pytest.mark.parametrize(("n_paths", "number", "seed"), [(400, 4, 1), (1600, 8, 0)])
def test_groups_of_paths_are_followed_for_as_long_as_they_need(n_paths, number, seed):
    tracer = box(0.6, n_paths)
    groups = tracer.observe_in_groups(tracer.room.alpha, number, MATCH, seed=seed)
    assert np.isfinite(groups).all()
