"""The test-side world against theory that neither it nor the package was written from."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.hidden_world import shipped
from tests.hidden_world.tracer import World, trace
from tests.imports import imported_by

pytestmark = pytest.mark.long  # they check the tests' own world
C = 343.2
CUBE = World(
    size=np.array([6.0, 6.0, 6.0]),
    alpha=np.tile([0.1, 0.3], (6, 1)),
    air=np.zeros(2),
    scattering=1.0,
    source=np.array([1.5, 2.0, 1.2]),
    receivers=np.array([[4.0, 4.5, 1.5], [4.5, 1.5, 3.0], [1.5, 4.5, 4.2]]),
)


def t20(found: np.ndarray, width: float = 0.002) -> np.ndarray:
    left = found.sum(0)[:, ::-1].cumsum(1)[:, ::-1]
    times = []
    for band in 10 * np.log10(np.maximum(left / left[:, :1], 1e-30)):
        within = (band <= -5) & (band >= -25)
        times.append(-60 / np.polyfit(np.flatnonzero(within) * width, band[within], 1)[0])
    return np.array(times)


def eyring(exponent: np.ndarray, volume: float = 216.0, surface: float = 216.0) -> np.ndarray:
    return 24 * np.log(10) / C * volume / (surface * exponent)


def test_the_world_imports_nothing_of_the_package() -> None:
    names = list(imported_by(Path(__file__).parent / "hidden_world"))
    assert names
    assert not [n for n in names if n.split(".")[0] in ("rtcal", ".", "benchmarks")]
    assert all(n.startswith("tests.hidden_world") for n in names if n[:5] == "tests")


def test_a_diffuse_cube_decays_after_eyring() -> None:
    # Lambert walls in a cube: path lengths scatter by gamma² = 0.4 (Kuttruff), which lengthens T by
    # a gamma² / 2, 2 % and 7 %; 2.5 % is five times the noise of T20 here.
    a = -np.log(1 - np.array([0.1, 0.3]))
    kuttruff = eyring(a * (1 - 0.4 * a / 2))
    np.testing.assert_allclose(t20(trace(CUBE, 20000, 1)), kuttruff, rtol=0.025)


def test_air_patch_and_objects_add_what_they_must() -> None:
    k = 24 * np.log(10) / C * 216.0
    bare = k / t20(trace(CUBE, 20000, 2))

    def after_kuttruff(mean_alpha: np.ndarray) -> np.ndarray:
        a = -np.log(1 - mean_alpha)
        return 216 * a * (1 - 0.4 * a / 2)

    mean = CUBE.alpha[0]
    air = replace(CUBE, air=np.full(2, 0.01))
    # Met at random, objects take alpha S of the rate: a Poisson process has no logarithm.
    objects = replace(CUBE, objects_area=20.0, objects_alpha=np.full(2, 0.5))
    for name, world, area in (("air", air, 4 * 0.01 * 216), ("objects", objects, 20 * 0.5)):
        change = k / t20(trace(world, 20000, 2)) - bare
        # The difference of two T20: noise 0.3 % and 0.7 % of 22 and 66 m² each, 0.1 and 0.7 m².
        np.testing.assert_allclose(change, area, rtol=0.15, err_msg=name)
    # A patch counts for more in the middle of a wall than in its corner (4.3 and 3.4 m² over four
    # seeds, alpha = 0.1): their mean is what Kuttruff's exponent says of its area.
    squares = [np.array([low, low + 2, low, low + 2]) for low in (2.0, 0.0)]
    patched = [
        k / t20(trace(replace(CUBE, patch_wall=4, patch=s, patch_alpha=np.ones(2)), 20000, 2))
        for s in squares
    ]
    expected = after_kuttruff(mean + 4 * (1 - mean) / 216) - after_kuttruff(mean)
    np.testing.assert_allclose((np.mean(patched, 0) - bare)[0], expected[0], rtol=0.1)


def test_level_is_the_diffuse_field_s_and_seeds_repeat() -> None:
    # Receivers all over the cube, for the mean over the volume: after the direct sound, the path
    # that is left is the sum of (1 - alpha)^k mean free paths 4V/S. Without reflections (alpha = 1)
    # the same seed gives the direct sound alone.
    grid = np.arange(0.6, 6, 1.2)
    everywhere = np.stack(np.meshgrid(grid, grid, grid), -1).reshape(-1, 3)
    world = replace(CUBE, receivers=everywhere)
    found = trace(world, 2000, 3, radius=0.6)
    direct = trace(replace(world, alpha=np.ones((6, 2))), 2000, 3, radius=0.6)
    level = (found.sum(2) - direct.sum(2)).mean(0)
    a = CUBE.alpha[0]
    np.testing.assert_allclose(level, 4 * (1 - a) / (216 * a), rtol=0.04)
    again = [trace(CUBE, 500, 3, radius=0.6) for _ in range(2)]
    np.testing.assert_array_equal(*again)


def test_a_dead_room_behind_an_aperture_is_an_opening() -> None:
    hole = {"patch_wall": 1, "patch": np.array([2.0, 4.0, 2.0, 4.0])}
    size, dead = np.array([6.0, 6.0, 6.0]), np.ones((6, 2))
    opening = trace(replace(CUBE, **hole, patch_alpha=np.ones(2)), 20000, 4)
    joined = trace(replace(CUBE, **hole, second_size=size, second_alpha=dead), 20000, 4)
    np.testing.assert_allclose(t20(joined), t20(opening), rtol=0.03)
    live = trace(replace(CUBE, **hole, second_size=size, second_alpha=CUBE.alpha / 3), 20000, 4)
    assert (t20(live) > 1.1 * t20(opening)).all()


def test_the_shipped_room_with_its_opening_closed_is_the_worlds() -> None:
    stored = json.loads((shipped.FOLDER / "closed.json").read_text(encoding="utf-8"))
    assert shipped.closed() == stored
