"""The second test-side world against theory that neither it nor the package was written from."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from tests.imports import imported_by
from tests.second_world import rooms
from tests.second_world.rays import Scene, Walls, trace

C = 343.2
SIDE = 6.0


def cube(alpha: float, strip: tuple[float, float] = (0.0, 0.0)) -> Walls:
    """A cube of Lambert walls; ``strip``: share of wall 0 and its alpha."""
    normals = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1.0]])
    cuts = np.zeros((6, 2, 4))
    cuts[:, :, 3] = 1.0
    if strip[0]:
        cuts[0, 1] = [0, 1, 0, SIDE * (1 - strip[0])]
    parts = np.full((6, 3, 1), alpha)
    parts[0, 2] = strip[1]
    return Walls(normals, np.array([0, SIDE] * 3), cuts, parts, np.ones(6))


def decay_rate(walls: Walls, n_rays: int = 12000, **more: object) -> float:
    """ln of energy per s, from T20 of the mean over three receivers."""
    receivers = np.array([[4.0, 4.5, 1.5], [4.5, 1.5, 3.0], [1.5, 4.5, 4.2]])
    source = np.array([1.5, 2.0, 1.2])
    scene = Scene(walls, np.zeros(1), source, receivers, SIDE**3, False, **more)  # type: ignore[arg-type]
    echo = trace(scene, n_rays, 3, radius=0.6, width=0.002, length=4.0, c=C)
    rest = np.cumsum(echo.sum(0)[0][::-1])[::-1]
    level = 10 * np.log10(np.maximum(rest / rest[0], 1e-12))
    t = 0.002 * np.arange(len(level))
    return 6 * np.log(10) / rooms.slope_time(level, t, -5, -25)


@cache
def bare(alpha: float) -> float:
    """The rate of the cube alone, which several tests compare with."""
    return decay_rate(cube(alpha))


def expected(mean: float) -> float:
    """Kuttruff's rate: path lengths in a Lambert cube scatter by gamma² = 0.4."""
    exponent = -np.log(1 - mean)
    return C * exponent * (1 - 0.2 * exponent) / (4 * SIDE**3 / (6 * SIDE**2))


def test_the_world_imports_nothing_of_the_package_and_nothing_of_the_first() -> None:
    names = list(imported_by(Path(__file__).parent / "second_world"))
    assert names
    assert not [n for n in names if n.split(".")[0] in ("rtcal", ".", "benchmarks")]
    assert all(n.startswith("tests.second_world") for n in names if n[:5] == "tests")


@pytest.mark.long
def test_a_lambert_cube_decays_after_kuttruff() -> None:
    # The noise of T20 with 12,000 rays is 0.8 %.
    np.testing.assert_allclose(bare(0.1), expected(0.1), rtol=0.025)
    np.testing.assert_allclose(bare(0.3), expected(0.3), rtol=0.025)


@pytest.mark.long
def test_a_strip_absorbs_by_its_area() -> None:
    # Half of one wall of six: the mean rises by (0.9 - 0.1) / 12. Places of a strip differ by 10 %.
    rise = decay_rate(cube(0.1, (0.5, 0.9))) - bare(0.1)
    np.testing.assert_allclose(rise, expected(0.1 + 0.8 / 12) - expected(0.1), rtol=0.15)


@pytest.mark.long
def test_boxes_absorb_by_their_free_faces() -> None:
    boxes = np.array([[1.0, 3.5, 0.0, 2.0, 4.5, 1.0], [3.5, 3.0, 0.0, 4.5, 4.0, 1.0]])
    black = decay_rate(cube(0.1), boxes=boxes, box_alpha=np.array([0.8]))
    hard = decay_rate(cube(0.1), boxes=boxes, box_alpha=np.array([0.0]))
    # Ten faces of 1 m², less the floor that they cover: c A / 4V, within 15 % for where they stand.
    np.testing.assert_allclose(black - hard, C * 8.0 / (4 * SIDE**3), rtol=0.15)


@pytest.mark.long
def test_an_aperture_into_a_dead_room_is_an_opening() -> None:
    walls = cube(0.1, (0.5, 1.0))
    dead = Walls(
        np.array([[1.0, 0, 0], [-1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]]),
        np.array([0.0, 20.0, 0, SIDE, 0, SIDE]),
        cube(0.1, (0.5, 1.0)).cuts,
        np.full((6, 3, 1), 0.999),
        np.ones(6),
    )
    joined = decay_rate(walls, 40000, second=dead, aperture=0)
    # The rates of two runs, each with a noise of 1 to 2 %.
    np.testing.assert_allclose(joined, decay_rate(walls, 40000), rtol=0.06)


def test_what_is_stated_is_what_was_drawn() -> None:
    for index in range(4):
        made = rooms.hide("porous", np.random.default_rng([9, index]))
        surface = sum(rooms.area_of(p) for p in made.polygons)
        assert made.areas.sum() == pytest.approx(surface)
        wall = made.truth["wall"]
        cut = made.walls.cuts[wall, 1]
        strip = rooms.beyond(made.polygons[wall], cut[:3], cut[3])
        assert rooms.area_of(strip) == pytest.approx(made.truth["size"], rel=1e-6)
        main = rooms.area_of(rooms.beyond(strip, *made_second(made, wall)))
        assert main == pytest.approx(0, abs=1e-9)  # the strip covers no second material


def made_second(made: rooms.Room, wall: int) -> tuple[np.ndarray, float]:
    cut = made.walls.cuts[wall, 0]
    return cut[:3], float(cut[3])


@pytest.mark.long
def test_a_seed_gives_one_room_and_a_case_without_the_truth() -> None:
    opening = rooms.KINDS.index("opening")
    first, again = rooms.build(0, opening, 1), rooms.build(0, opening, 1)
    assert first == again
    assert first["truth"]["kind"] == "opening"
    case = first["case"]
    assert set(case) == {"room", "equation", "configurations"}
    assert set(case["room"]) == {
        "volume",
        "centre_frequencies",
        "materials",
        "areas",
        "alpha",
        "sigma",
        "facing",
        "air",
    }
    assert [set(c) - {"changes"} for c in case["configurations"]] == [
        {"name", "distance", *rooms.PARAMETERS}
    ] * 2
    assert rt.finder.Case.from_dict(case).room.n_bands == rooms.N
