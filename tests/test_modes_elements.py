"""Modes of any room by finite elements: exact meshes, convergence, closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from rtcal.modes import modes_of
from rtcal.modes.room_modes import box_modes, fill
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.errors import DataError, ModelError
from tests.test_where_corrected import prism

pytest.importorskip("skfem")

L_SHAPE = prism([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], 1.1)
# A bench stands across the room; a U has a cupboard up to its ceiling.
BENCH = prism([(0, 0), (1, 0), (1, 0.8), (2, 0.8), (2, 0), (5, 0), (5, 2.5), (0, 2.5)], 4)
FURNISHED = replace(BENCH, vertices=BENCH.vertices[:, [0, 2, 1]])
CUPBOARD = [(1.6, 0), (1.6, 0.6), (2.4, 0.6), (2.4, 0)]
TEN_WALLS = prism(
    [(0, 0), *CUPBOARD, (4, 0), (4, 3), (2.8, 3), (2.8, 1.5), (1.2, 1.5), (1.2, 3), (0, 3)], 2
)


def slanted(low=2.2, high=3.3):
    """A room of 5 x 4 m whose ceiling rises along x."""
    plan = [(0, 0), (5, 0), (5, 4), (0, 4)]
    vertices = [(x, y, 0) for x, y in plan] + [(x, y, low + (high - low) * x / 5) for x, y in plan]
    faces = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    names = ["floor", "ceiling", "front", "high", "back", "low"]
    return Polyhedron(vertices=vertices, faces=faces, materials=names, names=names)


def crooked():
    """A room without two parallel walls."""
    plan = [(0, 0), (5, 0.5), (5.5, 4), (1, 5)]
    vertices = [(x, y, 0) for x, y in plan] + [(x, y, 2.6 + 0.1 * x - 0.05 * y) for x, y in plan]
    faces = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    return Polyhedron(vertices=vertices, faces=faces, materials=["a"] * 6)


def test_too_many_modes_of_a_mesh():
    large = replace(slanted(), vertices=2 * slanted().vertices)
    with pytest.raises(DataError, match="modes up to 250 Hz, but at most 600 are calculated"):
        modes_of(large, 250)
    with pytest.raises(DataError, match="or check whether the room is in mm"):
        modes_of(Polyhedron.shoebox((5200, 4100, 2600), "plaster"), 100)


@pytest.mark.parametrize("room", [L_SHAPE, FURNISHED, TEN_WALLS, slanted(), crooked()])
@pytest.mark.parametrize("spacing", [1.0, 0.6])
def test_tetrahedra_fill_the_room_and_fit_together(room, spacing):
    points, tetrahedra = fill(room, spacing)
    corners = points[tetrahedra]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    assert volumes.sum() == pytest.approx(room.volume, rel=1e-9)
    assert volumes.min() > 0
    faces = np.sort(
        np.concatenate([np.delete(tetrahedra, left, axis=1) for left in range(4)]), axis=1
    )
    faces, count = np.unique(faces, axis=0, return_counts=True)
    assert count.max() == 2
    a, b, c = (points[faces[count == 1]][:, k] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert area == pytest.approx(float(np.sum(room.face_areas)), rel=1e-9)


def test_a_box_has_its_closed_form():
    sides = np.array([5.2, 4.1, 2.7])
    box = Polyhedron.shoebox(sides, "plaster")
    exact, found = box_modes(sides, ["plaster"] * 6, 90, 343.2), modes_of(box, 90, spacing=0.6)
    n = exact.wanted
    np.testing.assert_allclose(found.frequencies[:n], exact.frequencies[:n], rtol=2e-3)
    for k in range(5):
        np.testing.assert_allclose(found.coupling[:, k, k], exact.coupling[:, k, k], rtol=0.01)
    inside = np.array([[1.3, 0.7, 1.1], [4.9, 3.9, 0.3]])
    np.testing.assert_allclose(
        np.abs(found.shapes(inside)[:, :5]), np.abs(exact.shapes(inside)[:, :5]), atol=2e-3
    )


def test_the_l_shape_of_the_literature():
    """Neumann eigenvalues of three unit squares: Dauge 2004, benchmark computations for Maxwell."""
    exact = 343.2 / (2 * np.pi) * np.sqrt([1.47562182408, 3.53403136678])
    errors = []
    for spacing in (0.5, 0.25):
        found = modes_of(L_SHAPE, 140, spacing=spacing)
        errors.append(found.frequencies[:2] / exact - 1)
    assert (np.array(errors) > 0).all()  # Rayleigh and Ritz: from above
    # The edge lets the first converge as spacing^(4/3).
    order = np.log2(errors[0][0] / errors[1][0])
    assert 1.1 < order < 1.6
    richardson = errors[1][0] - (errors[0][0] - errors[1][0]) / (2 ** (4 / 3) - 1)
    assert abs(richardson) < 0.15 * abs(errors[1][0])


def test_too_many_planes():
    with pytest.raises(ModelError, match="small objects"):
        fill(Polyhedron.shoebox((50, 50, 50), "plaster"), 0.5)
