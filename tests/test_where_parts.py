"""Parts of large surfaces: a divided geometry traces the same paths, and something stands on a part."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder.effects import library
from rtcal.finder.positions import surfaces
from rtcal.finder.positions.problem import materials, on_parts, shifts
from rtcal.finder.positions.surfaces import divided, patched
from rtcal.simulators import PathTracing, Polyhedron
from rtcal.simulators.geometry import SHOEBOX_WALLS
from tests.conftest import in_geometry, measurement_of

BANDS = (500.0, 1000.0)
SIZE = (12.0, 4.0, 3.0)
SOURCES = {"S1": (1.5, 1.0, 1.5), "S2": (10.3, 2.9, 1.4)}
RECEIVERS = {
    "R1": (3.4, 2.4, 1.3),
    "R2": (5.9, 1.2, 1.2),
    "R3": (8.6, 3.1, 1.2),
    "R4": (10.9, 1.1, 1.3),
}
MATCH = ("t20", "edt", "c80", "ts", "level")
PLACE = (2.5, 0.0, 1.5)  # of an opening of 6 m² on the south wall of 36 m²


def box():
    return Polyhedron.shoebox(SIZE, {w: f"{w} wall" for w in SHOEBOX_WALLS})


def tracing(geometry, alpha=0.12, paths=2400, scattering=0.4):
    """Return a tracing in which all materials but "hole" have one alpha."""
    rows = np.array([[1.0 if m == "hole" else alpha] * len(BANDS) for m in geometry.areas])
    room = in_geometry(geometry, BANDS, rows)
    return PathTracing(
        geometry=geometry,
        room=room,
        sources=SOURCES,
        receivers=RECEIVERS,
        scattering=scattering,
        n_paths=paths,
    )


@pytest.fixture(scope="module")
def case():
    south = SHOEBOX_WALLS.index("south")
    opened = patched(box(), [south], 6.0, "hole", "hole", np.array(PLACE))
    assert opened is not None
    real = tracing(opened, paths=9600, scattering=0.5)
    heard = real.observe(real.room.alpha, MATCH, seed=7)
    measured = measurement_of(
        BANDS, heard.pairs, **{("g" if p == "level" else p): heard.natural(p) for p in MATCH}
    )
    return rt.finder.PositionsCase(simulator=tracing(box()), measured=measured)


def test_long_surfaces_are_divided_and_short_ones_are_not(case):
    names = [list(case.faces)[part.surface] for part in case.divided.parts]
    assert names == [w for w in SHOEBOX_WALLS if w not in ("west", "east") for _ in range(3)]
    for name, faces in zip(case.faces, case.divided.surfaces, strict=True):
        area = case.divided.geometry.face_areas[faces].sum()
        assert area == pytest.approx(case.areas[name])
    south = [p for p, name in zip(case.divided.parts, names, strict=True) if name == "south"]
    assert [p.area for p in south] == pytest.approx([18.0] * 3)
    assert np.array([p.middle for p in south]) == pytest.approx(
        np.array([[3, 0, 1.5], [6, 0, 1.5], [9, 0, 1.5]])
    )


def test_the_same_paths_are_traced_in_the_divided_geometry(case):
    whole, alpha = case.simulator, case.room.alpha
    parts = tracing(case.divided.geometry)
    assert len(case.divided.geometry.faces) > len(whole.geometry.faces)
    there, here = (t.observe(alpha, MATCH, seed=1).values for t in (parts, whole))
    assert there == pytest.approx(here, abs=1e-3)


def test_a_mesh_of_triangles_is_divided_as_its_walls_are():
    """The longest edge of a triangle is a diagonal, which is no side of the wall."""
    whole = box()
    corners = [whole.vertices[list(face)] for face in whole.faces]
    halves = [(c[[0, 1, 2]], c[[0, 2, 3]]) for c in corners]
    mesh = Polyhedron.from_polygons(
        [
            (f"{n} {i}", n, t)
            for n, two in zip(whole.names, halves, strict=True)
            for i, t in enumerate(two)
        ]
    )
    made = divided(mesh, surfaces.of_geometry(mesh))
    area = {"south": 18.0, "north": 18.0, "floor": 24.0, "ceiling": 24.0}
    names = [list(surfaces.of_geometry(mesh))[part.surface].split()[0] for part in made.parts]
    assert sorted(names) == sorted(w for w in area for _ in range(3))
    assert [p.area for p in made.parts] == pytest.approx([area[n] for n in names])
    west = list(surfaces.of_geometry(mesh).values())[SHOEBOX_WALLS.index("west")]
    patch = patched(mesh, west, 3.0, "hole", "hole")
    hole = np.concatenate(
        [
            patch.vertices[list(f)]
            for f, m in zip(patch.faces, patch.materials, strict=True)
            if m == "hole"
        ]
    )
    assert np.ptp(hole, axis=0) == pytest.approx([0.0, 2.0, 1.5])


def test_the_odds_of_a_surface_do_not_depend_on_its_parts(case):
    def odds(every):
        total = {}
        for s in every:
            key = (s.effect, s.surface, s.place)
            total[key] = total.get(key, 0.0) + float(s.odds.sum())
        return total

    whole = shifts(case, library())
    both = on_parts(case, whole)
    assert odds(both) == pytest.approx(odds(whole))
    on_one = [s for s in both if s.part is not None]
    assert {s.effect for s in on_one} >= {"opening", "porous", "curtain", "resonator"}
    assert all(s.sizes.max() <= case.divided.parts[s.part].area for s in on_one)


def test_coefficients_that_were_measured_are_seldom_off(case):
    def odds(sigma):
        room = case.room.replace(sigma=sigma * case.room.alpha)
        made = materials(replace(case, simulator=replace(case.simulator, room=room)))
        return sum(float(shift.odds.sum()) for shift in made)

    assert odds(0.3) == pytest.approx(1.0)
    assert odds(0.06) == pytest.approx(0.04)
