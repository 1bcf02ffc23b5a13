"""Tetrahedra that fill a room of plane walls exactly: a grid, cut by the planes of the walls.

The grid of the bounding box has lines through every corner of the room, and each of its cells is six
tetrahedra (Kuhn 1960). A plane of a wall that no grid line holds bisects the edges that cross it. What
lies outside the room is left out.
"""

from __future__ import annotations

from itertools import combinations, pairwise, permutations

import numpy as np
from numpy.typing import NDArray

from rtcal.simulators.geometry import WELD, Polyhedron
from rtcal.support.errors import ModelError
from rtcal.support.types import Array

Integers = NDArray[np.int64]
Plane = tuple[Array, float]
"""Normal and offset in m."""

MOST = 150_000
"""Largest number of tetrahedra."""
_TOO_MANY = f"the room's {{}} need over {MOST} tetrahedra: state a mesh without small objects"
_NEAR = 1e-7
"""Distance in m within which a vertex lies on a plane."""
_MOVED = 0.2
"""Share of the grid's spacing by which a free vertex may be moved onto a plane."""
_AXIAL = 1 - 1e-9
_EDGES = np.array([*combinations(range(4), 2)])


def fill(geometry: Polyhedron, spacing: float) -> tuple[Array, Integers]:
    """Return vertices (n_vertices, 3) in m and tetrahedra (n_tetrahedra, 4) of a room.

    ``spacing`` is the largest distance of grid lines in m. Raises ModelError for a room that would need
    more than `MOST` tetrahedra.
    """
    lines = [_lines(geometry.vertices[:, axis], spacing) for axis in range(3)]
    if 6 * np.prod([len(line) - 1.0 for line in lines]) > MOST:
        raise ModelError(_TOO_MANY.format("corners"))
    points, tetrahedra = _kuhn(lines)
    planes = _oblique(geometry)
    # Vertices on a wall across an axis may not be moved.
    fixed = np.zeros(len(points), dtype=bool)
    for normal, face in zip(geometry.normals, geometry.faces, strict=True):
        if np.abs(normal).max() >= _AXIAL:
            fixed |= np.abs((points - geometry.vertices[face[0]]) @ normal) < _NEAR
    for plane in planes:
        points = _moved(points, tetrahedra, fixed, plane, spacing)
        fixed |= np.abs(points @ plane[0] - plane[1]) < _NEAR
        points, tetrahedra = _cut(points, tetrahedra, plane)
        fixed = np.append(fixed, np.ones(len(points) - len(fixed), dtype=bool))
        if len(tetrahedra) > MOST:
            raise ModelError(_TOO_MANY.format(f"{len(planes)} oblique planes"))
    tetrahedra = tetrahedra[np.abs(_volumes(points, tetrahedra)) > 1e-12]
    tetrahedra = tetrahedra[geometry.contains(points[tetrahedra].mean(axis=1))]
    used, numbers = np.unique(tetrahedra, return_inverse=True)
    return points[used], numbers.reshape(-1, 4)


def _lines(corners: Array, spacing: float) -> Array:
    """Return grid lines through all corners, at most ``spacing`` apart."""
    own = np.sort(corners)
    own = own[np.r_[True, np.diff(own) > WELD / 2]]
    parts = [
        np.linspace(a, b, max(int(np.ceil((b - a) / spacing - 1e-9)), 1) + 1)[:-1]
        for a, b in pairwise(own)
    ]
    return np.concatenate([*parts, own[-1:]])


def _kuhn(lines: list[Array]) -> tuple[Array, Integers]:
    """Return the vertices of a grid and six tetrahedra in each of its cells."""
    points = np.stack(np.meshgrid(*lines, indexing="ij"), -1)
    shape = points.shape[:3]
    numbers = np.arange(np.prod(shape)).reshape(shape)
    cells = numbers[:-1, :-1, :-1].ravel()
    steps = np.array([shape[1] * shape[2], shape[2], 1])
    paths = [np.concatenate([[0], np.cumsum(steps[list(p)])]) for p in permutations(range(3))]
    tetrahedra = np.concatenate([cells[:, np.newaxis] + path for path in paths])
    return points.reshape(-1, 3), tetrahedra


def _oblique(geometry: Polyhedron) -> list[Plane]:
    """Return planes that cut: oblique walls, and edges between coplanar walls."""
    planes: list[Plane] = []

    def add(normal: Array, point: Array) -> None:
        offset = float(normal @ point)
        for other, distance in planes:
            same = abs(other @ normal) > _AXIAL
            if same and abs(distance - offset * np.sign(other @ normal)) < 1e-6:
                return
        if np.abs(normal).max() < _AXIAL:
            planes.append((normal, offset))

    faces = [geometry.vertices[list(face)] for face in geometry.faces]
    for normal, corners in zip(geometry.normals, faces, strict=True):
        add(normal, corners[0])
    for i, (normal, corners) in enumerate(zip(geometry.normals, faces, strict=True)):
        along = (j for j in range(i) if normal @ geometry.normals[j] >= _AXIAL)
        if any(abs(normal @ (faces[j][0] - corners[0])) <= 1e-6 for j in along):
            for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                across = np.cross(b - a, normal)
                add(across / np.linalg.norm(across), a)
    return planes


def _moved(
    points: Array, tetrahedra: Integers, fixed: NDArray[np.bool_], plane: Plane, spacing: float
) -> Array:
    """Move free vertices that are near a plane onto it, unless that turns a tetrahedron over."""
    normal, offset = plane
    distance = points @ normal - offset
    near = ~fixed & (np.abs(distance) < _MOVED * spacing)
    moved = points - np.where(near, distance, 0.0)[:, np.newaxis] * normal
    before = _volumes(points, tetrahedra)
    for _ in range(5):
        small = _volumes(moved, tetrahedra) / before < 0.05
        if not small.any():
            return np.asarray(moved)
        back = np.unique(tetrahedra[small])
        moved[back] = points[back]
    return points


def _volumes(points: Array, tetrahedra: Integers) -> Array:
    """Return six times the volumes in m³, with their sign."""
    corners = points[tetrahedra]
    return np.asarray(np.linalg.det(corners[:, 1:] - corners[:, :1]))


def _cut(points: Array, tetrahedra: Integers, plane: Plane) -> tuple[Array, Integers]:
    """Divide each edge that crosses a plane there, and the tetrahedra that have it.

    Of a tetrahedron's edges that with the highest vertices is first: neighbours agree on their face.
    """
    n, distance = len(points), points @ plane[0] - plane[1]
    side = np.where(np.abs(distance) < _NEAR, 0, np.sign(distance))
    ends = np.sort(tetrahedra[:, _EDGES])
    codes = np.unique((ends @ [n, 1])[side[ends].prod(axis=2) < 0])
    a, b = np.divmod(codes, n)
    share = (distance[a] / (distance[a] - distance[b]))[:, np.newaxis]
    points = np.vstack([points, points[a] + share * (points[b] - points[a])])
    side = np.append(side, np.zeros(len(codes)))
    while True:
        ends = np.sort(tetrahedra[:, _EDGES])
        order = np.where(side[ends].prod(axis=2) < 0, ends.sum(axis=2), -1)
        cut = order.max(axis=1) >= 0
        if not cut.any():
            return points, tetrahedra
        whole, edge = tetrahedra[cut], ends[cut, order[cut].argmax(axis=1)]
        new = n + np.searchsorted(codes, edge @ [n, 1])[:, np.newaxis]
        halves = [np.where(whole == end[:, np.newaxis], new, whole) for end in edge.T]
        tetrahedra = np.vstack([tetrahedra[~cut], *halves])
