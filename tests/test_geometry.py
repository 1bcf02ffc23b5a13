"""Polyhedra: closedness, orientation, volume, areas, inside and outside."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtcal.datasets import halls
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron, triangulate, vector_area
from rtcal.support.errors import DataError

OUTLINE = np.array([[0, 0], [4, 0], [4, 2], [2, 2], [2, 5], [0, 5.0]])  # an L of 14 m²


def l_shape(flip=(), extra=()):
    polygons = [
        ("floor", "carpet", np.c_[OUTLINE, np.zeros(6)]),
        ("ceiling", "tiles", np.c_[OUTLINE, np.full(6, 3.0)]),
    ]
    for i in range(6):
        a, b = OUTLINE[i], OUTLINE[(i + 1) % 6]
        polygons.append((f"wall {i}", "plaster", np.array([[*a, 0], [*b, 0], [*b, 3], [*a, 3]])))
    polygons += list(extra)
    return [
        (name, material, points[::-1] if i in flip else points)
        for i, (name, material, points) in enumerate(polygons)
    ]


def box_at(corner, sides):
    box = Polyhedron.shoebox(sides, "wood")
    return [
        (f"box {name}", "wood", box.vertices[list(face)] + corner)
        for name, face in zip(box.names, box.faces, strict=True)
    ]


def test_shoebox():
    box = Polyhedron.shoebox((5, 7, 3), {w: f"material of {w}" for w in SHOEBOX_WALLS})
    assert box.volume == pytest.approx(105, rel=1e-12)
    assert list(box.face_areas) == pytest.approx([21, 21, 15, 15, 35, 35])
    axes = np.eye(3)[[0, 0, 1, 1, 2, 2]] * np.array([-1, 1, -1, 1, -1, 1])[:, np.newaxis]
    assert box.normals == pytest.approx(axes)
    assert [s.axis for s in box.surfaces] == ["x", "x", "y", "y", "z", "z"]
    assert box.mean_free_path == pytest.approx(4 * 105 / 142)


@settings(derandomize=True, deadline=None, max_examples=30)
@given(
    flip=st.sets(st.integers(0, 7)),
    angles=st.tuples(*[st.floats(-3, 3)] * 2),
    shift=st.tuples(*[st.floats(-1e3, 1e3)] * 3),
)
def test_volume_and_orientation_do_not_depend_on_winding_or_place(flip, angles, shift):
    a, b = angles
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]) @ np.array(
        [[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]
    )
    polygons = [(n, m, p @ turn.T + shift) for n, m, p in l_shape(flip)]
    hall = Polyhedron.from_polygons(polygons)
    assert hall.volume == pytest.approx(42, rel=1e-9)
    closed = np.sum(hall.normals * hall.face_areas[:, np.newaxis], axis=0)
    assert closed == pytest.approx(np.zeros(3), abs=1e-8)
    points = np.array([[1, 1, 1], [3, 1, 1], [3, 3, 1], [1, 1, -0.1]]) @ turn.T + shift
    assert hall.contains(points).tolist() == [True, True, False, False]
    # The normals point out: a step from each face's middle along them leaves the air.
    for i, normal in enumerate(hall.normals):
        middle = hall.triangles[hall.triangle_faces == i][0].mean(axis=0)
        inside = hall.contains([middle - 1e-3 * normal, middle + 1e-3 * normal])
        assert inside.tolist() == [True, False]


def test_an_object_takes_its_volume_off_the_room():
    standing = box_at((0, 0, 0), (1, 1, 1))  # in the corner: its edges lie on the room's edges
    hall = Polyhedron.from_polygons(l_shape(extra=standing))
    assert hall.volume == pytest.approx(41)
    assert hall.contains([[0.5, 0.5, 0.5], [0.5, 0.5, 1.5]]).tolist() == [False, True]
    free = Polyhedron.from_polygons(l_shape(extra=box_at((1, 1, 1), (0.5, 0.5, 0.5))))
    assert free.volume == pytest.approx(42 - 0.125)
    top = free.names.index("box ceiling")
    assert free.normals[top] == pytest.approx([0, 0, -1])  # out of the air, into the object


def test_an_edge_may_run_along_shorter_ones():
    polygons = l_shape()
    name, material, wall = polygons.pop(2)  # the 4 m wall, now in two unequal parts
    lower, upper = wall.copy(), wall.copy()
    lower[2:, 2] = upper[:2, 2] = 1
    hall = Polyhedron.from_polygons([*polygons, (name, material, lower), ("panel", "wood", upper)])
    assert hall.volume == pytest.approx(42)
    assert hall.areas["wood"] == pytest.approx(8)


@pytest.mark.parametrize(
    ("polygons", "message"),
    [
        (l_shape()[:-1], r'do not close: the edge from \(.*\) m of "floor" belongs'),
        ([*l_shape(), ("again", "wood", l_shape()[1][2])], "belongs to 3 faces"),
        ([("line", "a", [[0, 0, 0], [1, 0, 0], [2, 0, 0]])], "one line"),
        (
            [*l_shape()[1:], ("floor", "a", l_shape()[0][2] + np.eye(6, 3)[::-1] / 9)],
            "is not plane",
        ),
    ],
)
def test_polygons_that_bound_no_room_are_refused(polygons, message):
    with pytest.raises(DataError, match=message):
        Polyhedron.from_polygons(polygons)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"faces": [(0, 1, 99)] * 6}, 'face "west" has vertex 99'),
        ({"faces": [(0, 1, 1)] * 6}, "2 distinct vertices"),
        ({"materials": ["a"]}, "materials has 1 values; give one for each of the 6 faces"),
        ({"vertices": [[0, 0]]}, "shape"),
        ({"vertices": [[0, 0, np.nan]] * 8}, "must be finite"),
        ({"vertices": "walls"}, "vertices"),
        ({"faces": [], "names": [], "materials": []}, "there is no face"),
    ],
)
def test_bad_input(change, message):
    box = Polyhedron.shoebox((5, 7, 3), "a")
    parts = {
        "vertices": box.vertices,
        "faces": box.faces,
        "materials": box.materials,
        "names": box.names,
        **change,
    }
    with pytest.raises(DataError, match=message):
        Polyhedron(**parts)


@pytest.mark.parametrize("dimensions", [(5, 7), (5, 7, 0), (5, 7, np.inf)])
def test_a_shoebox_needs_three_lengths(dimensions):
    with pytest.raises(DataError, match="three finite lengths"):
        Polyhedron.shoebox(dimensions, "a")


def test_points_must_lie_in_the_room():
    box = Polyhedron.shoebox((5, 7, 3), "a")
    assert box.require_inside("source", {"S1": (1, 2, 1)}).tolist() == [[1, 2, 1]]
    for point in ((6, 1, 1), (1, 1, 0), (1, 1, 1e-6)):
        with pytest.raises(DataError, match=r'source "S1" = .* is outside the room'):
            box.require_inside("source", {"S1": point})


def test_distance_from_the_walls():
    hall = Polyhedron.from_polygons(l_shape())
    # The inner edge at (2, 2) is nearest to the second point: 0.5 m away along x and along y.
    points = [[1, 4, 1.5], [1.5, 1.5, 1.5]]
    assert hall.wall_distance(points) == pytest.approx([1, 0.5 * np.sqrt(2)])


@settings(derandomize=True, deadline=None, max_examples=60)
@given(radii=st.lists(st.floats(0.2, 3), min_size=3, max_size=12), split=st.integers(0, 11))
def test_triangles_cover_a_polygon(radii, split):
    n = len(radii)
    angles = 2 * np.pi * np.arange(n) / n
    points = np.array(radii)[:, np.newaxis] * np.c_[np.cos(angles), np.sin(angles)]
    k = split % n
    points = np.insert(points, k, 0.5 * (points[k - 1] + points[k]), axis=0)  # a straight corner
    polygon = np.c_[points, points @ [0.3, -0.2]]
    pieces = [vector_area(polygon[list(t)]) for t in triangulate(polygon)]
    assert np.sum(pieces, axis=0) == pytest.approx(vector_area(polygon), rel=1e-9)
    # All wound alike, so that equal sums of vectors mean equal areas without overlap.
    assert all(piece @ vector_area(polygon) > 0 for piece in pieces)


HALLS = (halls.lecture_hall, halls.hard_hall, halls.theatre, halls.corridor)


@pytest.mark.parametrize("make", HALLS)
def test_points_lie_inside_and_held_out_receivers_apart(make):
    hall = make()
    for kind in ("sources", "receivers", "held_out"):
        assert hall.geometry.require_inside(kind, getattr(hall, kind)).shape[1] == 3
    seen = np.array([*hall.sources.values(), *hall.receivers.values()])
    for point in hall.held_out.values():
        assert np.linalg.norm(seen - point, axis=1).min() >= 0.5
    assert dict(zip(hall.room.materials, hall.room.areas, strict=True)) == pytest.approx(
        hall.geometry.areas
    )
    assert hall.room.volume == hall.geometry.volume


def test_the_lecture_hall_has_what_the_paper_says():
    hall = halls.lecture_hall()
    areas = hall.geometry.face_areas
    assert len(areas) == 23
    assert hall.geometry.volume == pytest.approx(334, rel=1e-12)
    assert areas.max() / areas.min() == pytest.approx(66.6, rel=1e-12)
