"""Faces that lie on larger ones, and what they cut out of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rtcal.io.mend.faces import Face, Work
from rtcal.io.mend.mending import Mending
from rtcal.io.mend.shapes import (
    area_of,
    axes_of,
    normal_of,
    plane_of,
    polygon_of,
    polygons_of,
    shapely,
)
from rtcal.simulators.geometry import PLANARITY
from rtcal.support.types import Array

COVERED = 0.95
"""Share of a face that lies on others from which it lies on them."""
Cut = tuple[Any, str | None, str]
"""A shape on a face, with the material and the name of what lies there; None where an object stands."""


def overlaid_on(
    mend: Mending, shell: Work, part: Work
) -> list[tuple[int, list[Cut], float]] | None:
    """Return the pieces of a plane component on each face of the shell; None if it lies on none."""
    corners = mend.corners(part)
    normal, thick = plane_of(corners)
    if thick > max(mend.weld, PLANARITY):
        return None
    total, found = 0.0, list[tuple[int, list[Cut], float]]()
    for i, face in enumerate(shell.faces):
        base = mend.points[face]
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


def _add_piece(
    mend: Mending, added: Work, wall: Face, piece: Any, material: str, name: str
) -> None:
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
                    _add_piece(mend, out, face, piece, own, called)
            taken = taken.union(shape)
    return out
