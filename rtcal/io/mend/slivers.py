"""Faces that are no face: slivers, and those drawn twice."""

from __future__ import annotations

import numpy as np

from rtcal.io.mend.edges import simplified
from rtcal.io.mend.faces import Work
from rtcal.io.mend.mending import Mending
from rtcal.io.mend.shapes import area_of, extent_of


def cleaned(mend: Mending, work: Work) -> Work:
    """Return the faces without repeated corners, and without slivers."""
    kept, slivers, area = [], [], 0.0
    for i, face in enumerate(work.faces):
        work.faces[i] = face = simplified(face)
        size = area_of(mend.points[face]) if len(face) > 2 else 0.0
        narrow = len(face) < 3 or size < mend.weld * extent_of(mend.points[face]) / 2
        kept.append(not narrow)
        if narrow:
            slivers.append(work.names[i])
            area += size
    if slivers:
        mend.found(
            "sliver",
            f"faces narrower than {mend.weld * 1000:g} mm are dropped",
            slivers,
            area,
            surface=-area,
        )
    if not any(kept):
        corners = np.concatenate([np.asarray(p) for p in mend.drawn.polygons])
        across = np.linalg.norm(np.ptp(corners, axis=0))
        raise mend.refused(
            f"every face is narrower than the weld distance of {mend.weld * 1000:g} mm: as read, "
            f"the mesh is {across * 1000:.2g} mm across. State a larger --unit, such "
            "as 1 for a mesh drawn in m, or a smaller --weld"
        )
    return work.kept(kept)


def without_repetitions(mend: Mending, work: Work) -> Work:
    """Return the faces without those that are drawn twice."""
    seen: dict[frozenset[int], int] = {}
    kept, twice, area = [], [], 0.0
    for i, face in enumerate(work.faces):
        key = frozenset(face)
        kept.append(key not in seen)
        if key in seen:
            area += area_of(mend.points[face])
            other = work.materials[seen[key]]
            differs = f", {work.materials[i]} on {other}" if work.materials[i] != other else ""
            twice.append(work.names[i] + differs)
        seen.setdefault(key, i)
    if twice:
        mend.found("twice", "faces drawn twice are taken once", twice, area, surface=-area)
    return work.kept(kept)
