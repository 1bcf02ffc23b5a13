"""The room's shell: which faces it has, its small holes, and its volume where it does not close.

The volume of a room whose faces do not close is taken by lines through what is drawn: parallel lines
in three directions cross the walls. Between its first and second crossing, its third and fourth, a line
is in the room. A line with an odd number of crossings went through a hole, and takes the mean of its
neighbours. Where holes face each other a direction is wrong and the others are not, so their spread is
the uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from rtcal.io.mend.faces import (
    ANY_SHARE,
    MOST_PLACES,
    Face,
    FaceSet,
    Mended,
    MeshError,
    area_of,
    best_plane,
    edges_of,
    loops_of,
)
from rtcal.io.mend.welding import flattened
from rtcal.simulators.geometry import triangulate
from rtcal.support.errors import DataError
from rtcal.support.text import rounded
from rtcal.support.types import Array

_THICKEST = 0.6
"""Mean distance in m between two closed surfaces up to which they are both sides of the walls."""
_HOLE_SHARE = 0.01
"""Largest area of a hole that is closed, over the area of the shell."""
_NEAR = 0.2
"""Distance in m within which a hole's edge and another face are meant to meet."""
_LOOPS = "close the hole with a face, or delete the faces around it"


def shell_of(part: FaceSet) -> tuple[FaceSet, list[FaceSet]]:
    """Return the shell of the room, which may have holes, and the other components."""
    mend = part.mend
    parts = [part.of(members) for members in part.components()]
    points = [p.points for p in parts]
    boxes = [float(np.prod(np.sort(np.ptp(p, axis=0))[1:])) for p in points]
    # The shell encloses all: its box is the largest, and no flat component's is a room's.
    solid = [i for i, p in enumerate(points) if best_plane(p)[1] > 5 * mend.weld]
    if not solid:
        raise mend.refused("no faces enclose a volume: draw the walls, the floor and the ceiling")
    main = max(solid, key=lambda i: (round(boxes[i], 3), parts[i].size))
    outer = _volume(parts[main])
    low, high = points[main].min(axis=0), points[main].max(axis=0)
    for i in solid:
        is_within = (low < points[i].min(axis=0)).all() and (points[i].max(axis=0) < high).all()
        if i != main and 2 * boxes[i] > boxes[main] and is_within:
            inner = _volume(parts[i])
            if outer > inner > outer / 2 and outer - inner < _THICKEST * parts[i].size:
                main = i  # the walls are drawn with their thickness
                break
    return parts[main], [p for i, p in enumerate(parts) if i != main]


def _volume(part: FaceSet) -> float:
    """Return the volume in m³ of a component; 0.0 if it is open."""
    try:
        return float(part.polyhedron().volume)
    except DataError:
        return 0.0


def without_holes(part: FaceSet, others: Sequence[FaceSet]) -> FaceSet:
    """Return the shell with its small holes closed; MeshError for a large one."""
    mend, missing = part.mend, part.open_edges()
    if not missing:
        return part
    largest = _HOLE_SHARE * part.size if mend.largest_hole is None else mend.largest_hole
    loops = loops_of(missing)
    if loops is None:
        a, b = next(iter(missing))
        raise mend.refused(
            f"{len(missing)} open edges, the first from {mend.place(a)} to {mend.place(b)}, do not "
            f"bound a hole: faces are missing or cross each other there; {_LOOPS}",
            missing,
        )
    areas = {k: area_of(mend.points[loop]) for k, loop in enumerate(loops)}
    large = sorted((k for k in areas if areas[k] > largest), key=lambda k: -areas[k])
    if large:
        each = "; ".join(
            f"hole of {rounded(areas[k], 3)} m² at {mend.place(loops[k][0])}, beside "
            f'"{part.names[missing[edges_of(loops[k][:2])[0]]]}"'
            for k in large[:MOST_PLACES]
        )
        more = f" ({len(large)} holes in all)" if len(large) > MOST_PLACES else ""
        raise mend.refused(
            f"{each}{more}; holes up to {rounded(largest, 3)} m² are "
            f"closed. {_hint(part, loops[large[0]], others)}",
            missing,
        )
    for loop, area in zip(loops, areas.values(), strict=True):
        ends = mend.points[[*loop, loop[0]]]
        longest = int(np.argmax(np.linalg.norm(np.diff(ends, axis=0), axis=1)))
        material = part.materials[
            missing[edges_of([loop[longest], loop[longest - len(loop) + 1]])[0]]
        ]
        mend.found(
            "hole",
            "holes are closed with their neighbour's material",
            [f"at {mend.place(loop[0])}, {material}"],
            area,
            surface=area,
            uncertainty=area**1.5 / 4,
            unsure=[(material, ANY_SHARE * area)],  # it may be of another material
        )
        part.add(loop, material, "closed hole")
    part = flattened(part)
    if again := part.open_edges():
        a, b = next(iter(again))
        raise mend.refused(
            f"a hole at {mend.place(a)} to {mend.place(b)} cannot be closed by one face; {_LOOPS}",
            again,
        )
    return part


def _hint(part: FaceSet, loop: Face, others: Sequence[FaceSet]) -> str:
    """Return how a hole may be mended: faces whose corners nearly meet its edges ask for a weld."""
    points, own = part.mend.points, {v for face in part.faces for v in face}
    beside = sorted({v for other in others for face in other.faces for v in face} - own)
    if beside:
        away, _ = cKDTree(points[beside]).query(points[loop])
        if (distance := float(np.median(away))) < _NEAR:
            return (
                f"Corners of other faces lie {distance * 1000:.2g} mm from its edges: state --weld "
                f"{np.max(away[away < _NEAR]) * 1.1:.2g}"
            )
    enough = rounded(1.01 * area_of(points[loop]), 3)  # more than the area, as printed
    return f"In your program, {_LOOPS}; or state --hole {enough}"


def as_drawn(shell: FaceSet, others: Sequence[FaceSet], error: MeshError) -> MeshError:
    """Return the error of a shell that is open with the room as it is drawn: V by rays.

    Rays cross the shell and closed objects. They cross all faces where the shell has less than half of
    the area: then the walls do not meet.
    """
    areas: dict[str, float] = {}
    for part in (shell, *others):
        for area, material in zip(part.areas, part.materials, strict=True):
            areas[material] = areas.get(material, 0.0) + area
    is_whole = 2 * shell.size > sum(areas.values())
    crossed = [p for p in others if not is_whole or not p.open_edges()]
    volume, u = volume_by_rays([p for part in (shell, *crossed) for p in part.polygons])
    size, notes = tuple(np.ptp(shell.points, axis=0).tolist()), shell.mend.drawn.notes
    error.unclosed = Mended(None, volume, u, areas, size, error.defects, notes)
    return error


_LINES = 64
"""Lines along each side of the picture, 4096 in each direction."""
_TILT = (0.0131, 0.0217, 0.0173)
"""Small turns in radians about x, y and z, so that no line lies in a wall."""
_NEIGHBOURHOOD = 9
_GUESSED = 0.3
"""Relative standard uncertainty of the part of lines with an odd number of crossings."""


def volume_by_rays(polygons: Sequence[Array]) -> tuple[float, float]:
    """Return the volume in m³ that polygons (n, 3) in m enclose, and its standard uncertainty.

    >>> from rtcal.simulators import Polyhedron
    >>> box = Polyhedron.shoebox((4, 5, 3), "plaster")
    >>> open_box = [box.vertices[list(face)] for face in box.faces[:-1]]
    >>> volume, uncertainty = volume_by_rays(open_box)
    >>> bool(abs(volume - 60) < 2 * uncertainty < 2)
    True
    """
    corners = np.concatenate(
        [
            polygon[np.array(triangulate(polygon), dtype=int).reshape(-1, 3)]
            for polygon in map(np.asarray, polygons)
        ]  # a polygon without area has no triangle
    )
    if not len(corners):
        return 0.0, 0.0
    corners = corners @ Rotation.from_euler("xyz", _TILT).as_matrix().T
    found = [_along(np.roll(corners, k, axis=2)) for k in range(3)]
    volumes, unknown = (np.array(column) for column in zip(*found, strict=True))
    weights = np.clip(1 - unknown, 1e-3, None) ** 4
    weights /= weights.sum()
    volume = float(weights @ volumes)
    spread = float(weights @ (volumes - volume) ** 2)
    guessed = _GUESSED * volume * float(weights @ unknown)
    return volume, float(np.sqrt(spread + guessed**2 + (volume / _LINES**1.5) ** 2))


def _along(corners: Array) -> tuple[float, float]:
    """Return the volume by lines along the last axis, and the share of the lines that are unknown."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    step = (high - low)[:2] / _LINES
    if not step.all():
        return 0.0, 1.0
    lines, depths = [], []
    for a, b, c in corners:
        first, second = b - a, c - a
        area = first[0] * second[1] - first[1] * second[0]
        if abs(area) < 1e-12:
            continue
        ends = np.array([a, b, c])[:, :2]
        start = np.ceil((ends.min(axis=0) - low[:2]) / step - 0.5).astype(int)
        stop = np.floor((ends.max(axis=0) - low[:2]) / step + 0.5).astype(int)
        (i, k), (m, n) = start.clip(0), stop.clip(max=_LINES)
        rows, columns = np.mgrid[i:m, k:n]
        x = low[0] + step[0] * (rows + 0.5) - a[0]
        y = low[1] + step[1] * (columns + 0.5) - a[1]
        u = (x * second[1] - y * second[0]) / area
        v = (first[0] * y - first[1] * x) / area
        met = (u >= 0) & (v >= 0) & (u + v <= 1)
        lines.append((rows * _LINES + columns)[met])
        depths.append((a[2] + u * first[2] + v * second[2])[met])
    line, depth = np.concatenate(lines), np.concatenate(depths)
    order = np.lexsort((depth, line))
    line, depth = line[order], depth[order]
    crossings = np.bincount(line, minlength=_LINES**2)
    rank = np.arange(len(line)) - (np.cumsum(crossings) - crossings)[line]
    lengths = np.bincount(line, np.where(rank % 2, depth, -depth), _LINES**2)
    unknown, known = crossings % 2 == 1, crossings % 2 == 0
    known &= lengths > 0
    if not known.any():
        return 0.0, 1.0
    near, number = (
        uniform_filter(each.reshape(_LINES, _LINES), _NEIGHBOURHOOD, mode="constant").ravel()
        for each in (np.where(known, lengths, 0.0), known.astype(float))
    )
    mean = np.full(len(lengths), lengths[known].mean())
    np.divide(near, number, out=mean, where=number > 0.5 / _NEIGHBOURHOOD**2)
    total = lengths[known].sum() + mean[unknown].sum()
    return float(total * step.prod()), float(unknown.sum() / (unknown | known).sum())
