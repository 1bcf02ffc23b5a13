"""Faces in one plane become one polygon; those that are not plane become triangles."""

from __future__ import annotations

import numpy as np

from rtcal.io.mend.edges import edges_of, one_loop
from rtcal.io.mend.faces import Edge, Face, Mending, Work
from rtcal.io.mend.shapes import area_of, normal_of, plane_of
from rtcal.simulators import triangles
from rtcal.simulators.geometry import PLANARITY


def joined(mend: Mending, work: Work) -> Work:
    """Return the faces with neighbours in one plane and of one material and name as one polygon."""
    if len(work.faces) < 8 or not all(len(f) == 3 for f in work.faces):
        return work
    owners: dict[Edge, list[int]] = {}
    for i, face in enumerate(work.faces):
        for a, b in edges_of(face):
            owners.setdefault((min(a, b), max(a, b)), []).append(i)
    normals = np.array([normal_of(mend.points[f]) for f in work.faces])
    group = np.full(len(work.faces), -1)
    out = Work()
    links: list[list[int]] = [[] for _ in work.faces]
    for sides in owners.values():
        if len(sides) == 2:
            links[sides[0]].append(sides[1])
            links[sides[1]].append(sides[0])
    for first in range(len(work.faces)):
        if group[first] >= 0:
            continue
        group[first] = first
        members, corners = [first], set(work.faces[first])
        for i in members:  # the list grows during the loop
            for j in links[i]:
                if (
                    group[j] < 0
                    and work.materials[j] == work.materials[first]
                    and abs(float(normals[j] @ normals[first])) > 0.99
                    and plane_of(mend.points[[*corners, *work.faces[j]]])[1] < PLANARITY * 0.9
                ):
                    corners |= set(work.faces[j])
                    group[j] = first
                    members.append(j)
        loop = one_loop([work.faces[i] for i in members], owners, set(members))
        if loop is not None and len(members) > 1:
            out.add(_straightened(mend, loop), work.materials[first], work.names[first])
        else:
            for i in members:
                out.add(work.faces[i], work.materials[i], work.names[i])
    return out


def _straightened(mend: Mending, loop: Face) -> Face:
    """Return a polygon without corners on a straight line, which T-junctions find by themselves."""
    kept = []
    for k, v in enumerate(loop):
        before, after = mend.points[loop[k - 1]], mend.points[loop[(k + 1) % len(loop)]]
        a, b = mend.points[v] - before, after - mend.points[v]
        if np.linalg.norm(np.cross(a, b)) > 1e-5 * np.linalg.norm(a) * np.linalg.norm(b):
            kept.append(v)
    return kept if len(kept) > 2 else loop


def flattened(mend: Mending, work: Work) -> Work:
    """Return the faces with those that are not plane divided into triangles."""
    out, bent, area, unsure = Work(), [], 0.0, []
    for face, material, name in zip(work.faces, work.materials, work.names, strict=True):
        corners = mend.points[face]
        off = np.abs((corners - corners.mean(axis=0)) @ normal_of(corners)).max()
        if off <= PLANARITY * 0.9:
            out.add(face, material, name)
            continue
        parts = triangles.triangulate(corners)
        if off > mend.weld:  # else it is a joint's, told already
            bent.append(name)
            area += area_of(corners)
            folded = sum(area_of(corners[list(part)]) for part in parts)
            unsure.append((material, folded - area_of(corners)))
        for part in parts:
            out.add((face[k] for k in part), material, name)
    if bent:
        done = "faces that are not plane are divided into triangles"
        mend.found("bent", done, bent, area, unsure=unsure)
    return out
