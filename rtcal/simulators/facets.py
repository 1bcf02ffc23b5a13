"""Plane polygons and triangles: areas, edges, cutting and distances, the arithmetic of geometry."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.support.types import Array

WELD = 1e-4
"""Distance in m below which vertices are merged, since mesh files round their coordinates."""

Edge = tuple[int, int]

_NEXT, _LAST = np.array([[1, 2, 0], [2, 0, 1]])
"""Axes of the factors of a vector product."""


def vector_area(polygon: Array) -> Array:
    """Return the polygon's area in m² times its unit normal, (3,).

    ½ sum of p_i x p_(i+1) (Newell), for any plane polygon. Seen against the normal, the vertices
    run counter-clockwise.

    Examples
    --------
    >>> print(vector_area(np.array([[0.0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0]])))
    [0. 0. 6.]
    """
    local = polygon - polygon[0]  # near the origin the products lose no digits
    after = np.concatenate((local[1:], local[:1]))
    # np.cross takes as long for one polygon as these lines for ten.
    crossed = local.take(_NEXT, 1) * after.take(_LAST, 1) - local.take(_LAST, 1) * after.take(
        _NEXT, 1
    )
    return np.asarray(0.5 * crossed.sum(axis=0))


def vector_areas(vertices: Array, faces: Sequence[Sequence[int]]) -> Array:
    """Return the `vector_area` of each face of these vertices, (n_faces, 3)."""
    return np.array([vector_area(vertices[list(face)]) for face in faces])


def triangulate(polygon: Array) -> list[tuple[int, int, int]]:
    """Return triangles of vertex indices that cover a simple plane polygon, wound as it is.

    Ear clipping: cut off convex corners that contain no other vertex, until a triangle is left.
    """
    normal = vector_area(polygon)
    if len(polygon) == 3:
        return [(0, 1, 2)] if normal.any() else []
    keep = np.delete(np.arange(3), np.argmax(np.abs(normal)))
    flat = polygon[:, keep]
    if vector_area(np.pad(flat, ((0, 0), (0, 1))))[2] < 0:
        flat = flat[:, ::-1]
    tiny = 1e-9 * float(np.abs(normal).max())  # three points on a line
    left = list(range(len(polygon)))
    triangles: list[tuple[int, int, int]] = []
    while len(left) > 3:
        corner = _ear(flat, left, tiny)
        a, b, c = left[corner - 1], left[corner], left[(corner + 1) % len(left)]
        if abs(_turn(flat[a], flat[b], flat[c])) > tiny:
            triangles.append((a, b, c))
        left.pop(corner)
    if abs(_turn(*(flat[i] for i in left))) > tiny:
        triangles.append((left[0], left[1], left[2]))
    return triangles


def _turn(a: Array, b: Array, c: Array) -> float:
    """Return twice the signed area of the triangle: positive for a left turn."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _ear(flat: Array, left: Sequence[int], tiny: float) -> int:
    """Return the position in ``left`` of an ear, else of a straight corner."""
    straight = 0
    for position, corner in enumerate(left):
        before, after = left[position - 1], left[(position + 1) % len(left)]
        a, b, c = flat[before], flat[corner], flat[after]
        turn = _turn(a, b, c)
        if abs(turn) <= tiny:
            straight = position
        if turn <= tiny:
            continue
        others = [flat[i] for i in left if i not in (before, corner, after)]
        if not any(
            _turn(a, b, p) >= -tiny and _turn(b, c, p) >= -tiny and _turn(c, a, p) >= -tiny
            for p in others
        ):
            return position
    return straight


def winding_number(points: Array, triangles: Array) -> Array:
    """Return the winding number of the closed surface at each point, (n_points,): 1 inside, else 0.

    It is the sum of the triangles' solid angles over 4 pi (Van Oosterom & Strackee 1983, IEEE Trans.
    Biomed. Eng. 30(2), Eq. 8). ``points`` (n_points, 3), ``triangles`` (n_triangles, 3, 3).
    """
    corners = triangles[np.newaxis] - points[:, np.newaxis, np.newaxis, :]
    a, b, c = corners[:, :, 0], corners[:, :, 1], corners[:, :, 2]
    la, lb, lc = np.linalg.norm([a, b, c], axis=-1)
    volume = np.sum(a * np.cross(b, c), axis=-1)
    denominator = (
        la * lb * lc
        + np.sum(a * b, axis=-1) * lc
        + np.sum(b * c, axis=-1) * la
        + np.sum(c * a, axis=-1) * lb
    )
    return np.asarray(np.sum(np.arctan2(volume, denominator), axis=-1) / (2 * np.pi))


def distance(points: Array, triangles: Array) -> Array:
    """Return each point's distance in m from the nearest triangle, (n_points,); see `distances`."""
    return np.asarray(np.min(distances(points, triangles), axis=-1))


def distances(points: Array, triangles: Array) -> Array:
    """Return each point's distance in m from each triangle, (n_points, n_triangles).

    The distance is perpendicular if the foot lies in the triangle, else that from the nearest edge.
    """
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    p = points[:, np.newaxis, :]
    height = np.sum((p - a) * normal, axis=-1)
    foot = p - height[..., np.newaxis] * normal
    inside = np.ones(height.shape, dtype=bool)
    nearest = np.full(height.shape, np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge = end - start
        inside &= np.sum(np.cross(edge, foot - start) * normal, axis=-1) >= 0
        share = np.sum((p - start) * edge, axis=-1) / np.sum(edge * edge, axis=-1)
        on_edge = start + np.clip(share, 0, 1)[..., np.newaxis] * edge
        nearest = np.minimum(nearest, np.linalg.norm(p - on_edge, axis=-1))
    return np.asarray(np.where(inside, np.abs(height), nearest))


def first_hit(p: Array, v: Array, planes: Array, sides: Array) -> tuple[NDArray[np.int64], Array]:
    """Return the first triangle that each ray hits and its distance, infinite if it hits none.

    ``p`` and ``v`` (n_rays, 3) are the rays' origins and directions. Planes and sides are those of
    `rtcal.simulators.path_tracing.planes_of`.
    """
    approach = -(v @ planes[:, :3].T)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (p @ planes[:, :3].T - planes[:, 3]) / approach
        met = (approach > 0) & (t >= -1e-9)
        a, b = (
            p @ sides[:, i, :3].T + t * (v @ sides[:, i, :3].T) - sides[:, i, 3] for i in (0, 1)
        )
        met &= (a >= -1e-9) & (b >= -1e-9) & (a <= 1 + 1e-9) & (a + b <= 1 + 1e-9)
    t = np.where(met, t, np.inf)
    triangle = np.argmin(t, axis=1)
    return triangle, t[np.arange(len(t)), triangle]


def welded(vertices: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return vertices of which no two are closer than `WELD`, and the new number of each old one."""
    index = np.zeros(len(vertices), dtype=np.int64)
    kept: list[int] = []
    is_kept = np.zeros(len(vertices), dtype=bool)
    for i, near in enumerate(_tree(vertices).query_ball_point(vertices, WELD, p=np.inf)):
        before = np.array([k for k in near if is_kept[k]], dtype=np.int64)
        before = before[(np.abs(vertices[before] - vertices[i]) < WELD).all(axis=1)]
        if before.size:
            index[i] = index[before].min()
        else:
            index[i], is_kept[i] = len(kept), True
            kept.append(i)
    return vertices[kept], index


def _tree(points: Array) -> Any:
    from scipy.spatial import cKDTree

    return cKDTree(points)


def edge_owners(
    vertices: Array, faces: Sequence[Sequence[int]]
) -> dict[Edge, list[tuple[int, bool]]]:
    """Return the faces at each piece of an edge, and whether each runs from its lower vertex.

    Every vertex of the ``faces`` that lies on an edge divides it.
    """
    sides = [(i, face[k - 1], face[k]) for i, face in enumerate(faces) for k in range(len(face))]
    edges = list({(min(a, b), max(a, b)): None for _, a, b in sides})
    if not edges:
        return {}
    used = np.unique(edges)
    ends = vertices[np.array(edges)]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    near = _tree(vertices[used]).query_ball_point(ends.mean(axis=1), lengths / 2 + WELD)
    divided = {
        edge: [edge[0], *_between(vertices, edge, used[candidates]), edge[1]]
        for edge, candidates in zip(edges, near, strict=True)
    }
    owners: dict[Edge, list[tuple[int, bool]]] = {}
    for i, a, b in sides:
        chain = divided[a, b] if a < b else divided[b, a][::-1]
        for start, end in pairwise(chain):
            owners.setdefault((min(start, end), max(start, end)), []).append((i, start < end))
    return owners


def _between(vertices: Array, edge: Edge, candidates: NDArray[np.int64]) -> list[int]:
    """Return the candidates that lie on an edge between its ends, in order."""
    start, along = vertices[edge[0]], vertices[edge[1]] - vertices[edge[0]]
    length = float(np.linalg.norm(along))
    if len(candidates) < 3 or length <= 2 * WELD:
        return []
    local = vertices[candidates] - start
    position = local @ along / length
    distance = np.linalg.norm(local - position[:, np.newaxis] * along / length, axis=1)
    between = np.flatnonzero((distance < WELD) & (position > WELD) & (position < length - WELD))
    inner: list[int] = candidates[between[np.argsort(position[between])]].tolist()
    return inner


def area(part: Array) -> float:
    """Return the area of a polygon in m², 0 with fewer than three corners."""
    return float(np.linalg.norm(vector_area(part))) if len(part) > 2 else 0.0


def cut(part: Array, normal: Array, offset: float) -> tuple[Array, Array]:
    """Return the pieces of a convex polygon where x @ normal is below an offset, and above."""
    height = part @ normal - offset
    height[np.abs(height) < WELD] = 0.0
    below, above = [], []
    for k in range(len(part)):
        here, h, next_, g = part[k], height[k], part[k - len(part) + 1], height[k - len(part) + 1]
        if h <= 0:
            below.append(here)
        if h >= 0:
            above.append(here)
        if h * g < 0:
            crossing = here + h / (h - g) * (next_ - here)
            below.append(crossing)
            above.append(crossing)
    return np.array(below).reshape(-1, 3), np.array(above).reshape(-1, 3)


def divided(part: Array, sides: Sequence[tuple[Array, float]]) -> tuple[Array, list[Array]]:
    """Return the piece of a convex polygon within all sides, and the pieces beyond each."""
    outside = []
    for normal, offset in sides:
        part, beyond = cut(part, normal, offset)
        if is_face(beyond):
            outside.append(beyond)
    return part, outside


def inside(part: Array, sides: Sequence[tuple[Array, float]]) -> Array:
    """Return the piece of a convex polygon within all sides."""
    return divided(part, sides)[0]


def is_face(piece: Array) -> bool:
    """Return whether a piece is wider than `WELD`, below which corners are one."""
    if len(piece) < 3:
        return False
    length = float(np.linalg.norm(np.roll(piece, -1, axis=0) - piece, axis=1).max())
    return area(piece) > 0.5 * WELD * length


def distance_in_plane(point: Array, normal: Array, parts: Sequence[Array]) -> float:
    """Return a point's distance in m from the nearest of some convex polygons in one plane."""
    return min(_distance_of(point, normal, part) for part in parts)


def _distance_of(point: Array, normal: Array, part: Array) -> float:
    flat = point - ((point - part[0]) @ normal) * normal
    edges = np.roll(part, -1, axis=0) - part
    if (np.cross(edges, flat - part) @ normal >= 0).all():
        return float(np.linalg.norm(point - flat))
    share = np.sum((point - part) * edges, axis=1) / np.maximum(np.sum(edges**2, axis=1), 1e-30)
    nearest = part + np.clip(share, 0.0, 1.0)[:, np.newaxis] * edges
    return float(np.linalg.norm(point - nearest, axis=1).min())
