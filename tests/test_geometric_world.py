"""The hidden geometric world against theory that neither it nor the package was written from."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from rtcal.simulators import PathTracing
from tests.geometric_world import generate, hidden, in_situ, load, rooms
from tests.imports import imported_by
from tests.position_rooms import parameters, shapes
from tests.position_rooms.tracer import Scene, trace

pytestmark = pytest.mark.long  # they check the tests' own world
C = 343.2
SIDE = 6.0
FOLDER = Path(__file__).parent / "geometric_world"
FIRST = 12


def cube() -> hidden.Solid:
    plan = np.array([[0, 0], [SIDE, 0], [SIDE, SIDE], [0, SIDE]])
    return hidden.Solid(shapes.prism(plan, np.full(4, SIDE)), [0] * 6)


def rate(solid: hidden.Solid, rows: tuple[float, ...]) -> float:
    """ln of energy per s, from T20 of the mean over three receivers. Its noise is 1 %."""
    receivers = np.array([[4.0, 4.5, 1.5], [4.5, 1.5, 3.0], [1.5, 4.5, 4.2]])
    n = len(solid.polygons)
    alpha = np.array(rows)[solid.owner][:, np.newaxis]
    scene = Scene(solid.polygons, alpha, np.ones(n), np.zeros(1), C, receivers, 0.6, False)
    energy = trace(scene, np.array([1.5, 2.0, 1.2]), 15000, 3, width=0.002, length=3.0).sum(0)[0]
    return float(6 * np.log(10) / parameters.evaluate(energy, 0.002)["t20"])


@cache
def bare() -> float:
    """The rate of the cube alone."""
    return rate(cube(), (0.1,))


def expected(mean: float, volume: float = SIDE**3, surface: float = 6 * SIDE**2) -> float:
    """Kuttruff's rate: path lengths in a Lambert cube scatter by gamma² = 0.4."""
    exponent = -np.log(1 - mean)
    return C * surface * exponent * (1 - 0.2 * exponent) / (4 * volume)


def test_the_truth_imports_nothing_of_the_package() -> None:
    names = list(imported_by(FOLDER, besides=["load.py"]))
    assert names
    assert not [n for n in names if n.split(".")[0] in ("rtcal", ".", "benchmarks")]
    allowed = ("tests.position_rooms", "tests.geometric_world")
    assert all(n.startswith(allowed) for n in names if n[:5] == "tests")


def test_a_patch_absorbs_by_its_area() -> None:
    # 18 m² of 216: the mean rises by 0.8 / 12. Where a patch hangs makes up to 10 %.
    solid = cube()
    hidden.replace_part(np.random.default_rng(1), solid, 3, 18.0, 1)
    assert sum(shapes.area(p) for p in solid.polygons) == pytest.approx(6 * SIDE**2)
    of_patch = sum(shapes.area(p) for p, k in zip(solid.polygons, solid.owner, strict=True) if k)
    assert of_patch == pytest.approx(18.0)
    rise = rate(solid, (0.1, 0.9)) - bare()
    assert rise == pytest.approx(expected(0.1 + 0.8 / 12) - expected(0.1), rel=0.15)


def test_a_strip_stands_in_where_no_rectangle_fits() -> None:
    triangle = np.array([[0.0, 0, 0], [4, 0, 0], [0, 0, 4]])
    solid = hidden.Solid([triangle], [0])
    hidden.replace_part(np.random.default_rng(1), solid, 0, 7.0, 1)
    assert shapes.area(solid.polygons[-1]) == pytest.approx(7.0, rel=1e-6)
    assert sum(shapes.area(p) for p in solid.polygons) == pytest.approx(8.0)


def test_a_curtain_absorbs_on_both_sides() -> None:
    # Its front meets what a wall of 12 m² would meet; its back, 0.2 m before the wall, some of it.
    solid = cube()
    assert hidden.hang(np.random.default_rng(2), solid, 3, 12.0, 1, 0.2)
    assert len(solid.polygons) == 7
    rise = rate(solid, (0.1, 0.8)) - bare()
    one_side = C * 12.0 * 0.7 / (4 * SIDE**3)
    assert one_side < rise < 2 * one_side


def test_a_block_of_audience_absorbs_by_top_and_sides() -> None:
    solid = cube()
    assert hidden.seat(np.random.default_rng(3), solid, 0, 9.0, 1)
    low = cube()
    assert hidden.seat(np.random.default_rng(3), low, 0, 9.0, 0)
    top, *sides = (shapes.area(p) for p in solid.bodies)
    rise = rate(solid, (0.05, 0.8)) - rate(low, (0.05, 0.05))
    assert rise == pytest.approx(C * 0.75 * (top + sum(sides)) / (4 * SIDE**3), rel=0.15)


def test_a_dead_second_room_is_an_opening_and_a_live_one_gives_energy_back() -> None:
    def opened(alpha: float) -> float:
        solid = cube()
        assert hidden.open_to_a_second_room(np.random.default_rng(4), solid, 3, 8.0, 150.0, 1)
        return rate(solid, (0.1, alpha))

    gone = opened(0.999)
    assert gone - bare() == pytest.approx(expected(0.1 + 0.9 * 8 / 216) - expected(0.1), rel=0.15)
    assert opened(0.02) < 0.8 * gone


def test_the_populations_have_the_kinds_that_they_are_said_to_have() -> None:
    kinds = rooms.order(1)
    assert len(kinds) == 250
    assert kinds.count(rooms.NOTHING) == 100
    for n in (25, 50, 100):  # a first part is a fair sample
        assert abs(kinds[:n].count(rooms.NOTHING) - 0.4 * n) <= 1
        assert set(rooms.KINDS) <= set(kinds[:n])


@pytest.mark.parametrize(("population", "expected_digest"), sorted(rooms.FROZEN.items()))
def test_the_definition_is_the_frozen_one(population: int, expected_digest: str) -> None:
    assert generate.digest(population, FIRST) == expected_digest


@pytest.mark.parametrize(("population", "expected_digest"), sorted(in_situ.FROZEN.items()))
def test_what_is_stated_in_situ_is_frozen(population: int, expected_digest: str) -> None:
    true = [load.truth(population, i)["alpha"] for i in range(FIRST)]
    assert in_situ.digest(population, true) == expected_digest


def test_coefficients_in_situ_err_by_their_sigma() -> None:
    every = []
    for index in range(40):
        room = load.load(1, index, load.IN_SITU).room
        every.append(((room.alpha - load.truth(1, index)["alpha"]) / room.sigma).ravel())
    assert np.concatenate(every).std() == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("population", [0, 1, 3, 4])
def test_the_stored_rooms_are_the_first_ones_and_what_they_are_said_to_be(population: int) -> None:
    read, truth = generate.read(population, "rooms"), generate.read(population, "truth")
    assert list(read) == list(truth) == list(range(len(read)))
    kinds = rooms.order(population)
    for index, room in read.items():
        stated, hid = room["stated"], truth[index]["truth"]
        assert hid["kind"] == kinds[index]
        assert 90 <= stated["volume"] <= 3000
        assert 6 <= len(stated["faces"]) <= 10
        assert np.array(room["measured"]["t20"], dtype=float).shape == (12, len(stated["bands"]))
        if hid["surface"] >= 0:
            assert hid["size"] <= rooms.LARGEST * stated["areas"][hid["surface"]] + 0.01
            assert hid["effect_on_t"] > 0.005


@pytest.mark.parametrize("index", range(8))
def test_the_package_closes_the_same_room_with_the_same_air(index: int) -> None:
    stated, scene, _, made = rooms.draw(0, index)
    case = load.load(0, index)
    assert case.geometry.volume == pytest.approx(stated["volume"], rel=1e-5)
    np.testing.assert_allclose(case.geometry.face_areas, made.areas, rtol=1e-3)
    np.testing.assert_allclose(case.room.air_attenuation, scene.air, rtol=2e-3)
    np.testing.assert_allclose(case.room.speed_of_sound, scene.c, rtol=1e-4)


def of_its_own(index: int) -> bool:
    """Return whether every surface has a material of its own, as the package's scattering has."""
    room = load.load(0, index)
    return room.room.n_materials == len(room.geometry.faces)


def test_told_the_truth_the_package_hears_the_same() -> None:
    # Two tracers that share nothing, in a room of 430 m³ without anything hidden. The bounds are four
    # times the noise of a mean over pairs. In larger rooms T20 needs more paths.
    index = next(i for i, k in enumerate(rooms.order(0)) if k == rooms.NOTHING and of_its_own(i))
    truth, case = load.truth(0, index), load.load(0, index)
    heard = PathTracing(
        geometry=case.geometry,
        room=case.room,
        sources=dict(zip(load.SOURCES, truth["sources"], strict=True)),
        receivers=dict(zip(load.RECEIVERS, truth["receivers"], strict=True)),
        scattering=np.array(truth["scattering"]),
        scattering_model="vector" if truth["vectors"] else "random",
        n_paths=16000,
    ).observe(np.array(truth["alpha"]), ("t20", "edt", "c80", "ts", "level"))
    exact = load.without_noise(0, index)
    for name, bound in (("t20", 0.03), ("edt", 0.03), ("ts", 0.03), ("c80", 0.25), ("level", 0.15)):
        of_truth = exact.values["g" if name == "level" else name]
        difference = heard.natural(name) - of_truth
        if name in ("t20", "edt", "ts"):
            difference = difference / of_truth
        assert np.abs(difference.mean(axis=0)).max() < bound, name
