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
    Edge,
    Face,
    Mending,
    Work,
    area_of,
    edges_of,
    extent_of,
    normal_of,
    one_loop,
    owners,
    plane_of,
    simplified,
    sorted_edge,
)
from rtcal.simulators import facets
from rtcal.simulators.facets import WELD
from rtcal.simulators.geometry import PLANARITY
from rtcal.support.errors import DataError
from rtcal.support.types import Array


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
    """Return the faces without those that are drawn twice.

    Of two closed objects that stand on each other both faces go.
    """
    seen: dict[frozenset[int], int] = {}
    pairs = list[tuple[int, int]]()
    for i, face in enumerate(work.faces):
        first = seen.setdefault(frozenset(face), i)
        if first != i:
            pairs.append((first, i))
    if not pairs:
        return work
    common = _between_objects(mend, work, pairs)
    kept, twice, area, unsure = [True] * len(work.faces), [], 0.0, []
    buried, hidden = [], 0.0
    for first, i in pairs:
        face, kept[i] = work.faces[i], False
        size = area_of(mend.points[face])
        if first in common:
            kept[first] = False
            hidden += size
            buried.append(f'"{work.names[i]}" on "{work.names[first]}"')
            mend.buried.append(mend.points[face].mean(axis=0))
        else:
            area += size
            own, other = work.materials[i], work.materials[first]
            if own != other:  # either may be the one that is meant
                unsure += [(own, size / np.sqrt(2)), (other, size / np.sqrt(2))]
            twice.append(work.names[i] + (f", {own} on {other}" if own != other else ""))
    if buried:
        mend.found("contact", CONTACT, buried, hidden, surface=-2 * hidden)
    if twice:
        done = "faces drawn twice are taken once"
        mend.found("twice", done, twice, area, surface=-area, unsure=unsure)
    return work.kept(kept)


def _between_objects(mend: Mending, work: Work, pairs: Sequence[tuple[int, int]]) -> set[int]:
    """Return the first of each two faces that two closed objects, or one and the room, have in common.

    Faces that are drawn twice are joined where no other face meets their edge. They are in common if
    an even number of other faces, and some, meet in each edge around them.
    """
    copies = Counter(first for first, _ in pairs)
    first_of = {i: first for pair in pairs for first in pair[:1] for i in pair}
    group = {first: {first} for first in copies}
    around: dict[int, list[int]] = {first: [] for first in copies}
    for sides in owners(mend, work.faces).values():
        own = {first_of[i] for i in sides if i in first_of}
        if len(own) > 1 and all(i in first_of for i in sides):
            joined = set[int]().union(*(group[first] for first in own))
            group.update(dict.fromkeys(joined, joined))
            continue
        for first in own:
            around[first].append(sum(first_of.get(i) != first for i in sides))
    common = set()
    for first, members in group.items():
        others = [n for member in members for n in around[member]]
        once = all(copies[member] == 1 for member in members)
        if once and others and all(n > 0 and n % 2 == 0 for n in others):
            common.add(first)
    return common


def welded(mend: Mending) -> Work:
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
    work, first, spread, unsure = Work(), 0, 0.0, []
    for polygon, material, name in zip(
        mend.drawn.polygons, mend.drawn.materials, mend.drawn.names, strict=True
    ):
        corners = slice(first, first + len(polygon))
        first += len(polygon)
        points = np.asarray(polygon)
        spread += (area_of(points) * float(shifts[corners].mean())) ** 2
        # A corner moves the area by half of its neighbours' distance; none is drawn better than others.
        across = np.linalg.norm(np.roll(points, 1, axis=0) - np.roll(points, -1, axis=0)) / 2
        unsure.append((material, float(np.sqrt(np.mean(shifts**2)) * across)))
        work.add(map(int, index[corners]), material, name)
    if moved:
        mend.found(
            "joint",
            f"corners that lay up to {2 * shifts.max() * 1000:.2g} mm apart are joined",
            [mend.place(k) for k in moved],
            uncertainty=float(np.sqrt(spread)),
            unsure=unsure,
        )
    return cleaned(mend, work)


def snapped(mend: Mending, work: Work) -> Work:
    """Return the faces with corners that are near an edge moved onto it."""
    moved: dict[int, float] = {}
    sizes = [area_of(mend.points[f]) for f in work.faces]
    for _ in range(4):
        shift = _snap_once(mend, work)
        for corner, distance in shift.items():
            moved[corner] = max(moved.get(corner, 0.0), distance)
        if not shift:
            break
    if moved:
        pairs = list(zip(sizes, work.faces, strict=True))
        spread = sum((size * np.mean([moved.get(v, 0.0) for v in f])) ** 2 for size, f in pairs)
        changes = [size - area_of(mend.points[f]) for size, f in pairs]
        mend.found(
            "joint",
            f"corners up to {max(moved.values()) * 1000:.2g} mm beside an edge are moved onto it",
            [mend.place(v) for v in moved],
            uncertainty=float(np.sqrt(spread)),
            unsure=zip(work.materials, changes, strict=True),
        )
    return cleaned(mend, work)


def _snap_once(mend: Mending, work: Work) -> dict[int, float]:
    edges = sorted({sorted_edge(*e) for face in work.faces for e in edges_of(face)})
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


def rewelded(mend: Mending, work: Work) -> Work:
    """Return the faces with the corners that cutting has made on older ones that are near."""
    used = sorted({v for face in work.faces for v in face})
    tree = cKDTree(mend.points[used])
    index: dict[int, int] = {}
    for k, v in enumerate(used):
        near = min(tree.query_ball_point(mend.points[v], mend.weld / 2))
        index[v] = index.get(used[near], used[near]) if near < k else v
    faces = [simplified([index[v] for v in face]) for face in work.faces]
    return Work(faces, work.materials, work.names).kept(
        [len(f) > 2 and area_of(mend.points[f]) > SAME for f in faces]
    )


def settled(mend: Mending, work: Work) -> Work:
    """Return faces after cutting: joints closed, plane, and none so narrow that its corners are one."""
    work = flattened(mend, resnapped(mend, rewelded(mend, work)))
    return work.kept(
        [2 * area_of(mend.points[f]) > WELD * extent_of(mend.points[f]) for f in work.faces]
    )


def resnapped(mend: Mending, work: Work) -> Work:
    """Return the faces with corners near an edge on it, without a word: cutting made them."""
    for _ in range(4):
        if not _snap_once(mend, work):
            break
    return work


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
        parts = facets.triangulate(corners)
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
