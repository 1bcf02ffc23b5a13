"""Faces and objects on walls: where they lie or stand, and how they are cut into the walls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rtcal.io.mend.edges import loops_of, open_edges
from rtcal.io.mend.faces import SAME, Face, Mending, Work
from rtcal.io.mend.shapes import (
    area_of,
    axes_of,
    normal_of,
    plane_of,
    polygon_of,
    polygons_of,
    shapely,
)
from rtcal.io.mend.welding import flattened
from rtcal.simulators import triangles
from rtcal.simulators.geometry import PLANARITY
from rtcal.support.types import Array

COVERED = 0.95
"""Share of a face that lies on others from which it lies on them."""
Cut = tuple[Any, str | None, str]
"""A shape on a face, with the material and the name of what lies there; None where an object stands."""


class Walls:
    """The faces of a shell, to be found by where they are."""

    def __init__(self, mend: Mending, shell: Work) -> None:
        self.faces, self._mend = shell.faces, mend
        starts = np.cumsum([0, *map(len, shell.faces)])[:-1]
        corners = mend.points[np.concatenate(shell.faces)]
        # An object that stands on a wall is moved onto it by as much as the offset.
        margin = 2 * mend.offset + mend.weld
        self._low = np.minimum.reduceat(corners, starts) - margin
        self._high = np.maximum.reduceat(corners, starts) + margin

    def near(self, corners: Array) -> list[tuple[int, Array]]:
        """Return the number and the corners of each face that may touch what has these corners."""
        low, high = corners.min(axis=0), corners.max(axis=0)
        near = ((self._low <= high) & (low <= self._high)).all(axis=1)
        return [(i, self._mend.points[self.faces[i]]) for i in np.flatnonzero(near).tolist()]


def overlaid_on(
    mend: Mending, walls: Walls, part: Work
) -> list[tuple[int, list[Cut], float]] | None:
    """Return the pieces of a plane component on each wall; None if it lies on none."""
    corners = mend.corners(part)
    normal, thick = plane_of(corners)
    if thick > max(mend.weld, PLANARITY):
        return None
    total, found = 0.0, list[tuple[int, list[Cut], float]]()
    for i, base in walls.near(corners):
        wall = normal_of(base)
        distance = np.abs((corners - base.mean(axis=0)) @ wall).max()
        if abs(float(wall @ normal)) < 0.99 or distance > mend.offset:
            continue
        axes = axes_of(wall)
        ground = polygon_of(base, axes)
        pieces = list[Cut]()
        for own, material, name in zip(part.faces, part.materials, part.names, strict=True):
            shape = shapely().snap(polygon_of(mend.points[own], axes), ground, mend.weld)
            for piece in polygons_of(shape.intersection(ground)):
                if piece.area > mend.weld**2:
                    pieces.append((piece, material, name))
                    total += piece.area
        if pieces:
            found.append((i, pieces, float(distance)))
    size = sum(area_of(mend.points[f]) for f in part.faces)
    if not found or total < COVERED * size:
        return None
    return found


def add_piece(mend: Mending, added: Work, wall: Face, piece: Any, material: str, name: str) -> None:
    """Add a piece in a wall's plane, in triangles if it has holes."""
    axes = axes_of(normal_of(mend.points[wall]))
    rings = (
        [piece.exterior]
        if not piece.interiors
        else [t.exterior for t in polygons_of(shapely().constrained_delaunay_triangles(piece))]
    )
    for ring in rings:
        flat = np.array(ring.coords)[:-1]
        added.add(new_points(mend, lifted(mend, flat, wall, axes)), material, name)


def lifted(mend: Mending, flat: Array, wall: Face, axes: Array) -> Array:
    """Return points of a wall's plane, (n, 2), in space; those on its boundary as it is drawn."""
    base, normal = mend.points[wall], normal_of(mend.points[wall])
    lifted = np.asarray(flat @ axes + normal * float(base.mean(axis=0) @ normal))
    for k in range(len(wall)):
        start, along = axes @ base[k - 1], axes @ (base[k] - base[k - 1])
        share = np.clip((flat - start) @ along / (along @ along), 0, 1)
        away = np.linalg.norm(flat - start - share[:, np.newaxis] * along, axis=1)
        on_edge = away < 1e-5
        lifted[on_edge] = base[k - 1] + share[on_edge, np.newaxis] * (base[k] - base[k - 1])
    return lifted


def new_points(mend: Mending, corners: Array) -> list[int]:
    """Add corners (n, 3) in m, and return their numbers."""
    first = len(mend.points)
    mend.points = np.concatenate([mend.points, corners])
    return list(range(first, first + len(corners)))


def cut(mend: Mending, shell: Work, cuts: Mapping[int, Sequence[Cut]]) -> Work:
    """Return the shell with what lies on its faces in their place, the smaller first."""
    out = Work()
    for i, (face, material, name) in enumerate(
        zip(shell.faces, shell.materials, shell.names, strict=True)
    ):
        if i not in cuts:
            out.add(face, material, name)
            continue
        ground = polygon_of(mend.points[face], axes_of(normal_of(mend.points[face])))
        taken = shapely().Polygon()
        for shape, own, called in [
            *sorted(cuts[i], key=lambda c: float(c[0].area)),
            (ground, material, name),
        ]:
            for piece in polygons_of(shape.difference(taken)):
                if own is not None and piece.area > mend.weld**2:
                    add_piece(mend, out, face, piece, own, called)
            taken = taken.union(shape)
    return out


def standing_on(
    mend: Mending, walls: Walls, part: Work
) -> tuple[list[tuple[int, Any]], Work] | None:
    """Return the footprint of an object with an open bottom on each wall, and its faces there.

    It stands on the walls if its open edges lie on them and it rises from them: a panel's do not.
    """
    loops = loops_of(open_edges(mend, part))
    if not loops or plane_of(mend.corners(part))[1] <= mend.weld:
        return None  # closed, or a sheet, whose boundary its open edges are
    found, moved = list[tuple[int, Any]](), dict[int, Array]()
    for loop in loops:
        foot = _foot_of(mend, walls, loop)
        if foot is None:
            return None
        found += foot[0]
        moved |= foot[1]
    for v, point in moved.items():
        mend.points[v] = point
    return found, flattened(mend, part)


def _foot_of(
    mend: Mending, walls: Walls, loop: Face
) -> tuple[list[tuple[int, Any]], dict[int, Array]] | None:
    """Return what an open edge encloses on each wall, and its corners there; else None."""
    size = area_of(mend.points[loop])
    found, total, moved = [], 0.0, {}
    for i, base in walls.near(mend.points[loop]):
        normal = normal_of(base)
        away = (mend.points[loop] - base.mean(axis=0)) @ normal
        if np.abs(away).max() > mend.offset:
            continue
        axes = axes_of(normal)
        ground = polygon_of(base, axes)
        for piece in polygons_of(polygon_of(mend.points[loop], axes).intersection(ground)):
            found.append((i, piece))
            total += piece.area
        for v, distance in zip(loop, away, strict=True):
            if ground.distance(shapely().Point(*(axes @ mend.points[v]))) < SAME:
                moved[v] = mend.points[v] - normal * float(distance)
    if total < COVERED * size or len(moved) < len(loop):
        return None
    return found, moved


def signed_volume(mend: Mending, work: Work, base: Array) -> float:
    """Return the volume between a component and a point of the plane that closes it."""
    faces = [mend.points[f] - base for f in work.faces]
    # Its faces may have either orientation: those away from its middle are taken as outward.
    middle = np.mean([f.mean(axis=0) for f in faces], axis=0)
    volume = 0.0
    for corners in faces:
        area = triangles.vector_area(corners)
        sign = np.sign((corners.mean(axis=0) - middle) @ area)
        volume += float(sign * (corners[0] @ area)) / 3
    return volume
