"""Objects with an open bottom that stand on a face."""

from __future__ import annotations

from typing import Any

import numpy as np

from rtcal.io.mend.edges import loops_of, open_edges
from rtcal.io.mend.faces import SAME, Work
from rtcal.io.mend.mending import Mending
from rtcal.io.mend.overlays import COVERED
from rtcal.io.mend.planes import flattened
from rtcal.io.mend.shapes import area_of, axes_of, normal_of, polygon_of, polygons_of, shapely
from rtcal.simulators import triangles
from rtcal.support.types import Array


def standing_on(
    mend: Mending, shell: Work, part: Work
) -> tuple[list[tuple[int, Any]], Work] | None:
    """Return the footprint of an object with an open bottom on each face, and its faces there."""
    loops = loops_of(open_edges(mend, part))
    if loops is None or len(loops) != 1:
        return None
    loop = loops[0]
    size = area_of(mend.points[loop])
    if size > 0.5 * sum(area_of(mend.points[f]) for f in part.faces):
        return None  # a sheet, whose boundary it is
    found, total, moved = [], 0.0, {}
    for i, face in enumerate(shell.faces):
        base = mend.points[face]
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
    for v, point in moved.items():
        mend.points[v] = point
    return found, flattened(mend, part)


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
