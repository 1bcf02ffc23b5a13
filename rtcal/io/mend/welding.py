"""Joints: corners near each other or near an edge become one; slivers and repeated faces go.

Faces in one plane become one polygon. Faces that are not plane become triangles.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from rtcal.io.mend.faces import (
    ANY_SHARE,
    CONTACT,
    SAME,
    Face,
    FaceSet,
    Mending,
    area_of,
    best_plane,
    edges_of,
    extent_of,
    is_flat,
    loops_of,
    normal_of,
    simplified,
)
from rtcal.simulators.geometry import PLANARITY, WELD, triangulate
from rtcal.support.errors import DataError
from rtcal.support.types import Array


def welded(mend: Mending) -> FaceSet:
    """Return the faces with corners within ``weld`` of each other as one."""
    drawn = np.concatenate([np.asarray(p, dtype=float) for p in mend.drawn.polygons])
    if not np.isfinite(drawn).all():
        raise DataError(f"{mend.path}: a corner is not finite")
    tree = cKDTree(drawn)
    index = np.full(len(drawn), -1)
    groups: list[list[int]] = []
    for i in range(len(drawn)):
        if index[i] < 0:
            near = [k for k in tree.query_ball_point(drawn[i], mend.weld) if index[k] < 0]
            index[near] = len(groups)
            groups.append(near)
    mend.points = np.array([drawn[g].mean(axis=0) for g in groups])
    shifts = np.linalg.norm(mend.points[index] - drawn, axis=1)
    moved = [k for k, g in enumerate(groups) if shifts[g].max() > 1e-4]
    part, first, spread, unsure = FaceSet(mend), 0, 0.0, []
    drawn_rows = zip(mend.drawn.polygons, mend.drawn.materials, mend.drawn.names, strict=True)
    for polygon, material, name in drawn_rows:
        corners = slice(first, first := first + len(polygon))
        points = np.asarray(polygon)
        spread += (area_of(points) * float(shifts[corners].mean())) ** 2
        # A corner moves the area by half of its neighbours' distance; none is drawn better than others.
        across = np.linalg.norm(np.roll(points, 1, axis=0) - np.roll(points, -1, axis=0)) / 2
        unsure.append((material, float(np.sqrt(np.mean(shifts**2)) * across)))
        part.add(map(int, index[corners]), material, name)
    if moved:
        mend.found(
            "joint",
            f"corners that lay up to {2 * shifts.max() * 1000:.2g} mm apart are joined",
            [mend.place(k) for k in moved],
            uncertainty=float(np.sqrt(spread)),
            unsure=unsure,
        )
    return cleaned(part)


def cleaned(part: FaceSet) -> FaceSet:
    """Return the faces without repeated corners, and without slivers."""
    mend = part.mend
    part = FaceSet(mend, map(simplified, part.faces), part.materials, part.names)
    narrow = [
        len(f) < 3 or area_of(mend.points[f]) < mend.weld * extent_of(mend.points[f]) / 2
        for f in part.faces
    ]
    slivers = part.kept(narrow)
    if slivers.faces:
        areas = [
            area if len(f) > 2 else 0.0
            for f, area in zip(slivers.faces, slivers.areas, strict=True)
        ]
        mend.found(
            "sliver",
            f"faces narrower than {mend.weld * 1000:g} mm are dropped",
            slivers.names,
            sum(areas),
            surface=-sum(areas),
            unsure=[(m, ANY_SHARE * a) for m, a in zip(slivers.materials, areas, strict=True)],
        )
    if all(narrow):
        corners = np.concatenate([np.asarray(p) for p in mend.drawn.polygons])
        across = np.linalg.norm(np.ptp(corners, axis=0))
        raise mend.refused(
            f"every face is narrower than the weld distance of {mend.weld * 1000:g} mm: as read, "
            f"the mesh is {across * 1000:.2g} mm across. State a larger --unit, such "
            "as 1 for a mesh drawn in m, or a smaller --weld"
        )
    return part.kept(np.logical_not(narrow).tolist())


def without_repetitions(part: FaceSet) -> FaceSet:
    """Return the faces without those that are drawn twice.

    Of two closed objects that stand on each other both faces go.
    """
    mend = part.mend
    seen: dict[frozenset[int], int] = {}
    firsts = [seen.setdefault(frozenset(face), i) for i, face in enumerate(part.faces)]
    pairs = [(first, i) for i, first in enumerate(firsts) if first != i]
    common = _between_objects(part, firsts, Counter(first for first, _ in pairs)) if pairs else ()
    kept = [first == i for i, first in enumerate(firsts)]
    for first, i in pairs:
        name, own, other = part.names[i], part.materials[i], part.materials[first]
        area = area_of(part.corners(i))
        if first in common:
            kept[first] = False
            mend.found(
                "contact", CONTACT, [f'"{name}" on "{part.names[first]}"'], area, 0.0, -2 * area
            )
            mend.buried.append(part.corners(i).mean(axis=0))
            continue
        # Of two materials either may be the one that is meant.
        unsure = [(m, area / np.sqrt(2)) for m in (own, other) if own != other]
        name += f", {own} on {other}" if own != other else ""
        mend.found(
            "twice", "faces drawn twice are taken once", [name], area, 0.0, -area, 0.0, unsure
        )
    return part.kept(kept)


def _between_objects(part: FaceSet, firsts: Sequence[int], copies: Counter[int]) -> set[int]:
    """Return the first of each two faces that two closed objects, or one and the room, have in common.

    Faces that are drawn twice are joined where no other face meets their edge. They are in common if
    an even number of other faces, and some, meet in each edge around them.
    """
    group = {first: {first} for first in copies}
    around: dict[int, list[int]] = {first: [] for first in copies}
    for sides in part.owners().values():
        drawn = [firsts[i] for i in sides]
        own = {first for first in drawn if first in copies}
        if len(own) > 1 and own.issuperset(drawn):
            joined = set[int]().union(*(group[first] for first in own))
            group.update(dict.fromkeys(joined, joined))
            continue
        for first in own:
            around[first].append(sum(other != first for other in drawn))
    common = set()
    for first, members in group.items():
        others = [n for member in members for n in around[member]]
        once = all(copies[member] == 1 for member in members)
        if once and others and all(n > 0 and n % 2 == 0 for n in others):
            common.add(first)
    return common


def snapped(part: FaceSet) -> FaceSet:
    """Return the faces with corners that are near an edge moved onto it."""
    mend, before = part.mend, part.areas
    moved = _snap(part)
    if moved:
        shifts = [float(np.mean([moved.get(v, 0.0) for v in face])) for face in part.faces]
        changes = np.subtract(before, part.areas).tolist()
        mend.found(
            "joint",
            f"corners up to {max(moved.values()) * 1000:.2g} mm beside an edge are moved onto it",
            [mend.place(v) for v in moved],
            uncertainty=float(np.linalg.norm(np.multiply(before, shifts))),
            unsure=zip(part.materials, changes, strict=True),
        )
    return cleaned(part)


def _snap(part: FaceSet) -> dict[int, float]:
    """Move corners that are near an edge onto it, and return by how much in m each."""
    moved: dict[int, float] = {}
    for _ in range(4):
        shift = _snap_once(part)
        moved |= {v: max(moved.get(v, 0.0), distance) for v, distance in shift.items()}
        if not shift:
            break
    return moved


def _snap_once(part: FaceSet) -> dict[int, float]:
    mend, edges = part.mend, part.edges
    ends = mend.points[np.array(edges)]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    near = cKDTree(mend.points).query_ball_point(ends.mean(axis=1), lengths / 2 + mend.weld)
    best: dict[int, tuple[float, Array]] = {}
    for (start, end), length, corners in zip(ends, lengths, near, strict=True):
        if len(corners) < 3 or length <= 2 * mend.weld:
            continue
        points, along = mend.points[corners], (end - start) / length
        position = (points - start) @ along
        feet = start + position[:, np.newaxis] * along
        distance = np.linalg.norm(points - feet, axis=1)
        beside = (distance > SAME) & (distance <= mend.weld)
        beside &= (mend.weld < position) & (position < length - mend.weld)
        for k in np.flatnonzero(beside).tolist():
            if distance[k] < best.get(corners[k], (np.inf,))[0]:
                best[corners[k]] = float(distance[k]), feet[k]
    for v, (_, foot) in best.items():
        mend.points[v] = foot
    return {v: distance for v, (distance, _) in best.items()}


def rejoined(part: FaceSet) -> FaceSet:
    """Return the faces with the corners that cutting has made on older corners and edges nearby."""
    mend = part.mend
    used = sorted({v for face in part.faces for v in face})
    tree = cKDTree(mend.points[used])
    index: dict[int, int] = {}
    for k, v in enumerate(used):
        near = min(tree.query_ball_point(mend.points[v], mend.weld / 2))
        index[v] = index.get(used[near], used[near]) if near < k else v
    faces = [simplified([index[v] for v in face]) for face in part.faces]
    is_face = [len(f) > 2 and area_of(mend.points[f]) > SAME for f in faces]
    part = FaceSet(mend, faces, part.materials, part.names).kept(is_face)
    _snap(part)
    return part


def settled(part: FaceSet) -> FaceSet:
    """Return faces after cutting: joints closed, plane, and none so narrow that its corners are one."""
    part = flattened(rejoined(part))
    return part.kept([2 * area_of(p) > WELD * extent_of(p) for p in part.polygons])


def joined(part: FaceSet) -> FaceSet:
    """Return the faces with neighbours in one plane and of one material and name as one polygon."""
    mend = part.mend
    if len(part.faces) < 8 or not all(len(f) == 3 for f in part.faces):
        return part
    sides: dict[tuple[int, int], list[int]] = {}
    for i, face in enumerate(part.faces):
        for edge in edges_of(face):
            sides.setdefault(edge, []).append(i)
    links: list[list[int]] = [[] for _ in part.faces]
    for i, j in (pair for pair in sides.values() if len(pair) == 2):
        links[i].append(j)
        links[j].append(i)
    normals = np.array([normal_of(p) for p in part.polygons])
    done = [False] * len(part.faces)
    out = FaceSet(mend)
    for first in range(len(part.faces)):
        if done[first]:
            continue
        done[first] = True
        members, corners = [first], set(part.faces[first])
        for i in members:  # the list grows during the loop
            for j in links[i]:
                if (
                    not done[j]
                    and part.materials[j] == part.materials[first]
                    and abs(float(normals[j] @ normals[first])) > 0.99
                    and best_plane(mend.points[[*corners, *part.faces[j]]])[1] < PLANARITY * 0.9
                ):
                    corners |= set(part.faces[j])
                    done[j] = True
                    members.append(j)
        count = Counter(e for i in members for e in edges_of(part.faces[i]))
        loops = loops_of([edge for edge, n in count.items() if n == 1])
        if len(members) > 1 and loops is not None and len(loops) == 1:
            out.add(_straightened(mend, loops[0]), part.materials[first], part.names[first])
        else:
            out.extend(part.of(members))
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


def flattened(part: FaceSet) -> FaceSet:
    """Return the faces with those that are not plane divided into triangles."""
    mend, out = part.mend, FaceSet(part.mend)
    for face, material, name in part.rows():
        corners = mend.points[face]
        if is_flat(corners):
            out.add(face, material, name)
            continue
        pieces = [[face[k] for k in piece] for piece in triangulate(corners)]
        for piece in pieces:
            out.add(piece, material, name)
        off = np.abs((corners - corners.mean(axis=0)) @ normal_of(corners)).max()
        if off > mend.weld:  # else it is a joint's, noted already
            area, folded = area_of(corners), sum(area_of(mend.points[piece]) for piece in pieces)
            done = "faces that are not plane are divided into triangles"
            mend.found("bent", done, [name], area, unsure=[(material, folded - area)])
    return out
