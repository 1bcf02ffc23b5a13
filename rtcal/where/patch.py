"""A patch on a face: the same geometry with a part of one face as a face of its own."""

from __future__ import annotations

import numpy as np

from rtcal.simulators.geometry import Polyhedron
from rtcal.support.types import Array

LARGEST = 0.8
"""Largest share of a face that is drawn as a patch in its middle: the rim that is left then has a tenth
of the face's width on every side."""


def patched(
    geometry: Polyhedron, face: int, area: float, material: str, name: str
) -> Polyhedron | None:
    """Return the geometry with a patch in the middle of a face; None where it does not fit.

    The patch has the shape of the face. The rim around it is drawn as two faces, since a face is a
    simple polygon. A patch of at least `LARGEST` of the face does not fit, nor does one in a face
    whose middle does not see all its corners.

    Parameters
    ----------
    geometry : Polyhedron
    face : int
    area : float
        m².
    material, name : str
        Of the patch.
    """
    corners = geometry.vertices[list(geometry.faces[face])]
    share = area / float(geometry.face_areas[face])
    middle = _middle(corners, geometry.normals[face])
    if share >= LARGEST or middle is None:
        return None
    inner = middle + np.sqrt(share) * (corners - middle)
    half = len(corners) // 2
    first = np.concatenate([corners[: half + 1], inner[: half + 1][::-1]])
    second = np.concatenate([corners[half:], corners[:1], inner[:1], inner[half:][::-1]])
    polygons = []
    for i, (other, made_of) in enumerate(zip(geometry.names, geometry.materials, strict=True)):
        if i != face:
            polygons.append((other, made_of, geometry.vertices[list(geometry.faces[i])]))
            continue
        polygons.append((name, material, inner))
        polygons.append((other, made_of, first))
        polygons.append((f"{other}, other side", made_of, second))
    return Polyhedron.from_polygons(polygons)


def _middle(corners: Array, normal: Array) -> Array | None:
    """Return a point of a polygon that sees all its corners; None where none is found.

    The area's centroid and the mean of the corners are tried.
    """
    start = corners[0]
    parts = np.cross(corners[1:-1] - start, corners[2:] - start) @ normal / 2
    centres = (start + corners[1:-1] + corners[2:]) / 3
    for point in (parts @ centres / parts.sum(), corners.mean(axis=0)):
        edges = np.cross(corners - point, np.roll(corners, -1, axis=0) - point) @ normal
        if edges.min() > 1e-3 * edges.sum() / len(corners):
            return np.asarray(point)
    return None
