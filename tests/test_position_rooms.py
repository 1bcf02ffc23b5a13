"""The truth of the position rooms against theory that neither it nor the package was written from."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from rtcal.acoustics import decay
from rtcal.acoustics.observables import observable
from rtcal.simulators import PathTracing
from tests.imports import imported_by
from tests.position_rooms import generate, load, parameters, rooms, shapes
from tests.position_rooms.tracer import Scene, sees, trace

C = 343.2
WIDTH = 0.002
FOLDER = Path(__file__).parent / "position_rooms"


def box(size: tuple[float, float, float], alpha: list[float], scattering: float) -> Scene:
    x, y, z = size
    plan = np.array([[0, 0], [x, 0], [x, y], [0, y]])
    return Scene(
        shapes.prism(plan, np.full(4, z)),
        np.tile(alpha, (6, 1)),
        np.full(6, scattering),
        np.zeros(len(alpha)),
        C,
        np.array([[0.7 * x, 0.65 * y, 0.3 * z], [0.3 * x, 0.75 * y, 0.6 * z]]),
        0.3,
        False,
    )


def test_the_truth_imports_nothing_of_the_package() -> None:
    names = list(imported_by(FOLDER, besides=["load.py", "shipped.py"]))
    assert names
    assert not [n for n in names if n.split(".")[0] in ("rtcal", ".", "benchmarks")]
    assert all(n.startswith("tests.position_rooms") for n in names if n[:5] == "tests")


@pytest.mark.long
@pytest.mark.parametrize("vectors", [False, True])
def test_a_diffuse_cube_decays_after_eyring(vectors: bool) -> None:
    # Lambert walls in a cube: path lengths scatter by gamma² = 0.4 (Kuttruff), which lengthens
    # Eyring's T by 1 / (1 - a gamma² / 2), 2 % and 8 %. The noise of T20 is below 1 %.
    scene = replace(box((6, 6, 6), [0.1, 0.3], 1.0), radius=0.6, vectors=vectors)
    energy = trace(scene, np.array([1.5, 2.0, 1.2]), 20000, 1, width=WIDTH, length=3.0).sum(0)
    a = -np.log(1 - np.array([0.1, 0.3]))
    eyring = 24 * np.log(10) / C * 216 / (216 * a)
    t20 = parameters.evaluate(energy, WIDTH)["t20"]
    np.testing.assert_allclose(t20, eyring / (1 - 0.2 * a), rtol=0.025)
    np.testing.assert_allclose(t20[0], eyring[0], rtol=0.045)


def image_sources(
    size: tuple[float, float, float],
    alpha: float,
    source: np.ndarray,
    at: np.ndarray,
    length: float,
) -> np.ndarray:
    """Energy of all image sources (Allen & Berkley 1979) in bins from the direct sound on."""
    delays, energies = [], []
    reach = [int(C * length / (2 * s)) + 1 for s in size]
    for cell in product(*[range(-n, n + 1) for n in reach]):
        for odd in product((0, 1), repeat=3):
            image = [
                2 * n * s + (-x if o else x)
                for n, s, o, x in zip(cell, size, odd, source, strict=True)
            ]
            hits = sum(abs(2 * n - o) for n, o in zip(cell, odd, strict=True))
            d = float(np.linalg.norm(np.array(image) - at))
            delays.append(d / C)
            energies.append((1 - alpha) ** hits / (4 * np.pi * d**2))
    late = np.array(delays) - min(delays)
    energy, _ = np.histogram(late, np.arange(0, length, WIDTH), weights=energies)
    return energy


@pytest.mark.long
def test_a_specular_box_has_the_energy_of_its_image_sources() -> None:
    size, source = (5.0, 7.0, 3.2), np.array([1.3, 1.7, 1.4])
    scene = box(size, [0.2], 0.0)
    traced = trace(scene, source, 60000, 2, width=WIDTH, length=0.7)[:, 0]
    for receiver, energy in zip(scene.receivers, traced, strict=True):
        exact = image_sources(size, 0.2, source, receiver, 0.5)
        step = 25  # 50 ms
        sums = [e[: 8 * step].reshape(-1, step).sum(1) for e in (energy, exact)]
        # A window of 50 ms holds 500 to 3,000 hits, of unequal energy: 2 to 6 % noise.
        np.testing.assert_allclose(sums[0], sums[1], rtol=0.15)
        found, expected = (parameters.evaluate(e, WIDTH) for e in (energy[: len(exact)], exact))
        assert found["g"] == pytest.approx(expected["g"], abs=0.15)
        assert found["c80"] == pytest.approx(expected["c80"], abs=0.35)
        assert found["edt"] == pytest.approx(expected["edt"], rel=0.05)
        assert found["ts"] == pytest.approx(expected["ts"], rel=0.04)


def test_the_direct_sound_is_computed_and_hidden_by_a_corner() -> None:
    polygons = shapes.angle(np.random.default_rng(1))
    high = np.concatenate(polygons).max(0)
    middle = high[2] / 2
    n, corner = len(polygons), polygons[7][0]  # the side that starts at the inner corner
    behind = np.array(
        [[0.97 * high[0], 0.1 * high[1], middle], [0.1 * high[0], 0.1 * high[1], middle]]
    )
    scene = Scene(
        polygons, np.zeros((n, 1)), np.ones(n), np.zeros(1), C, behind, 0.05, vectors=False
    )
    source = np.array([0.9 * corner[0], 0.97 * high[1], middle])
    assert sees(scene, source).tolist() == [False, True]


def test_parameters_of_an_exponential_are_those_of_theory() -> None:
    t = 0.8
    energy = 10 ** (-6 * WIDTH / 8 * np.arange(16000) / t)
    found = parameters.evaluate(energy, WIDTH / 8)
    tau = t / (6 * np.log(10))
    assert found["t20"] == pytest.approx(t, rel=1e-3)
    assert found["edt"] == pytest.approx(t, rel=1e-3)
    assert found["c80"] == pytest.approx(10 * np.log10(np.exp(0.08 / tau) - 1), abs=0.01)
    assert found["ts"] == pytest.approx(tau, rel=5e-3)


def test_parameters_agree_with_the_packages() -> None:
    # Two programs of one standard, on the decay of a traced room.
    scene = box((5.0, 7.0, 3.2), [0.2], 0.4)
    energy = trace(scene, np.array([1.3, 1.7, 1.4]), 4000, 3, width=WIDTH, length=1.2)[0, 0]
    found = parameters.evaluate(energy, WIDTH)
    assert found["t20"] == pytest.approx(float(decay.decay_time(energy, WIDTH, "t20")), rel=1e-6)
    assert found["edt"] == pytest.approx(float(decay.decay_time(energy, WIDTH, "edt")), rel=1e-6)
    assert found["c80"] == pytest.approx(float(observable("c80").value(energy, WIDTH)), abs=1e-6)


def test_measured_values_scatter_as_theory_says() -> None:
    # sd of one decay 0.88 / sqrt(B T) of T20 and 1.6 / sqrt(B T) of EDT .
    t, bands = 1.0, np.array([500.0])
    energy = 10 ** (-6 * 0.001 * np.arange(1500) / t)
    many = np.tile(energy, (1500, 1, 1))
    noisy = parameters.noise_like(np.random.default_rng(5), many, 0.001, bands)
    found = parameters.evaluate(noisy, 0.001)
    theory = 1 / np.sqrt(0.71 * 500 * t)
    assert found["t20"].std() == pytest.approx(0.88 * theory, rel=0.15)
    assert found["edt"].std() == pytest.approx(1.6 * theory, rel=0.15)
    assert noisy.mean() == pytest.approx(energy.mean(), rel=0.01)


@pytest.mark.parametrize(("population", "index"), [(0, 1), (1, 10), (1, 31), (2, 6), (2, 41)])
def test_a_frozen_room_is_what_its_seed_draws(population: int, index: int) -> None:
    stated, _, sources, truths = rooms.draw(population, index)
    frozen = generate.read(population, "rooms")[index]["stated"]
    assert generate.stored({"stated": stated})["stated"] == frozen
    for k, prior in enumerate(rooms.PRIORS):
        stored = load.true_alpha(population, index, prior)
        np.testing.assert_allclose(stored, truths[k], rtol=1e-4)
    off = np.linalg.norm(np.array(frozen["sources"]) - sources, axis=1)
    np.testing.assert_allclose(off, rooms.OFF, atol=0.001)


def test_the_frozen_rooms_are_what_they_are_said_to_be() -> None:
    read, truth = generate.read(1, "rooms"), generate.read(1, "truth")
    assert list(read) == sorted(generate.order(1)[: len(read)])  # the first ones, none left out
    assert len(read) >= 20
    for index, room in read.items():
        stated = room["stated"]
        assert 120 <= stated["volume"] <= 5000
        n = len(stated["faces"])
        assert 10 <= n <= 30 if index % 2 else n == 6
        assert len(stated["bands"]) in (6, 8)
        scattering = np.array(truth[index]["truth"]["scattering"])
        assert scattering.min() >= 0.1
        assert scattering.max() <= 0.8


@pytest.mark.parametrize("index", range(8))
def test_the_package_closes_the_same_room_with_the_same_air(index: int) -> None:
    stated, scene, _, _ = rooms.draw(0, index)
    case = load.load(0, index, "wide")
    assert case.geometry.volume == pytest.approx(stated["volume"], rel=1e-5)
    np.testing.assert_allclose(case.room.areas, stated["areas"], rtol=1e-3)
    n = case.room.n_bands
    np.testing.assert_allclose(case.room.air_attenuation, scene.air[:n], rtol=2e-3)
    np.testing.assert_allclose(case.room.speed_of_sound, scene.c, rtol=1e-4)


@pytest.mark.parametrize("index", [0, 3])
def test_told_the_truth_the_package_hears_the_same(index: int) -> None:
    # Two tracers that share nothing, one scene. Bounds: four times the noise of the mean over pairs.
    truth = generate.read(0, "truth")[index]["truth"]
    case = load.load(0, index, "wide")
    told = PathTracing(
        geometry=case.geometry,
        room=case.room,
        sources=dict(zip(load.SOURCES, truth["sources"], strict=True)),
        receivers=dict(zip(load.RECEIVERS, truth["receivers"], strict=True)),
        scattering=np.array(truth["scattering"]),
        scattering_model="vector" if truth["vectors"] else "random",
        n_paths=4000,
    )
    heard = told.observe(load.true_alpha(0, index, "wide"), ("t20", "edt", "c80", "ts", "level"))
    exact = load.without_noise(0, index, "wide")
    for name, bound in (("t20", 0.03), ("edt", 0.03), ("ts", 0.03), ("c80", 0.25), ("level", 0.15)):
        of_truth = exact.values["g" if name == "level" else name]
        difference = heard.natural(name) - of_truth
        if name in ("t20", "edt", "ts"):
            difference = difference / of_truth
        assert np.abs(difference.mean(axis=0)).max() < bound, name
