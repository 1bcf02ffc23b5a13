"""Faces that are no face: slivers, and those drawn twice."""

from __future__ import annotations

import numpy as np

from rtcal.io.mend.edges import simplified
from rtcal.io.mend.faces import Work
from rtcal.io.mend.mending import ANY_SHARE, Mending
from rtcal.io.mend.shapes import area_of, extent_of


def cleaned(mend: Mending, work: Work) -> Work:
    """Return the faces without repeated corners, and without slivers."""
    kept, slivers, area, unsure = [], [], 0.0, []
    for i, face in enumerate(work.faces):
        work.faces[i] = face = simplified(face)
        size = area_of(mend.points[face]) if len(face) > 2 else 0.0
        narrow = len(face) < 3 or size < mend.weld * extent_of(mend.points[face]) / 2
        kept.append(not narrow)
        if narrow:
            slivers.append(work.names[i])
            area += size
            unsure.append((work.materials[i], ANY_SHARE * size))
    if slivers:
        mend.found(
            "sliver",
            f"faces narrower than {mend.weld * 1000:g} mm are dropped",
            slivers,
            area,
            surface=-area,
            unsure=unsure,
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
    kept, twice, area, unsure = [], [], 0.0, []
    for i, face in enumerate(work.faces):
        key = frozenset(face)
        kept.append(key not in seen)
        if key in seen:
            size = area_of(mend.points[face])
            area += size
            own, other = work.materials[i], work.materials[seen[key]]
            if own != other:  # either may be the one that is meant
                unsure += [(own, size / np.sqrt(2)), (other, size / np.sqrt(2))]
            twice.append(work.names[i] + (f", {own} on {other}" if own != other else ""))
        seen.setdefault(key, i)
    if twice:
        done = "faces drawn twice are taken once"
        mend.found("twice", done, twice, area, surface=-area, unsure=unsure)
    return work.kept(kept)
