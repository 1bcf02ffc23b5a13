"""Components in the shell: overlays, objects with an open bottom, panels, and what lies outside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rtcal.io.mend.defects import Unclosed
from rtcal.io.mend.edges import open_edges
from rtcal.io.mend.faces import SAME, Work
from rtcal.io.mend.mending import ANY_SHARE, Mending
from rtcal.io.mend.overlays import Cut, cut, overlaid_on
from rtcal.io.mend.panels import THICKNESS, add_slab
from rtcal.io.mend.planes import flattened
from rtcal.io.mend.rays import volume_by_rays
from rtcal.io.mend.shapes import area_of
from rtcal.io.mend.standing import signed_volume, standing_on
from rtcal.io.mend.welding import resnapped, rewelded
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.types import Array

_LOOSE = {
    "object": "closed objects stand by themselves",
    "overlay": "components lie on larger faces",
    "open bottom": "objects with an open bottom stand on faces",
    "panel": "components hang free, or are walls that do not meet the others",
}


def tell_loose(mend: Mending, shell: Work, others: Sequence[Work]) -> None:
    """Note what else there is where the shell is open; nothing is cut, since nothing is in a room."""
    told: dict[str, list[tuple[str, float]]] = {}
    for part in others:
        if not open_edges(mend, part):
            kind = "object"
        elif overlaid_on(mend, shell, part) is not None:
            kind = "overlay"
        elif standing_on(mend, shell, part) is not None:
            kind = "open bottom"
        else:
            kind = "panel"
        size = sum(area_of(mend.points[f]) for f in part.faces)
        told.setdefault(kind, []).append((part.names[0], size))
    for kind, rows in told.items():
        mend.found(kind, _LOOSE[kind], [name for name, _ in rows], sum(size for _, size in rows))


def unclosed_room(mend: Mending, shell: Work, others: Sequence[Work]) -> Unclosed:
    """Return the room whose shell is open: V by rays, areas as drawn.

    Rays cross the shell and closed objects. They cross all faces where the shell has less than half of
    the area: then the walls do not meet.
    """
    areas: dict[str, float] = {}
    for part in (shell, *others):
        for face, material in zip(part.faces, part.materials, strict=True):
            areas[material] = areas.get(material, 0.0) + area_of(mend.points[face])
    whole = 2 * sum(area_of(mend.points[f]) for f in shell.faces) > sum(areas.values())
    crossed = [p for p in others if not whole or not open_edges(mend, p)]
    polygons = [mend.points[face] for part in (shell, *crossed) for face in part.faces]
    volume, uncertainty = volume_by_rays(polygons)
    return Unclosed(volume, uncertainty, areas, tuple(mend.defects), mend.drawn.notes)


def with_others(mend: Mending, shell: Work, others: Sequence[Work]) -> Work:
    """Return the shell with overlays, objects and panels; what lies outside is left out."""
    if not others:
        return shell
    hull = Polyhedron(
        vertices=mend.points, faces=[tuple(f) for f in shell.faces], materials=shell.materials
    )
    cuts: dict[int, list[Cut]] = {}
    added, panels = Work(), list[Work]()
    told: dict[str, list[tuple[str, float, float, float]]] = {}
    reveals: list[tuple[str, float]] = []

    def tell(kind: str, part: Work, size: float, volume: float, surface: float) -> None:
        told.setdefault(kind, []).append((part.names[0], size, volume, surface))

    for part in others:
        size = sum(area_of(mend.points[f]) for f in part.faces)
        if not _within(mend, hull, mend.corners(part)):
            tell("outside", part, size, 0.0, 0.0)
        elif not open_edges(mend, part):
            added.extend(part)
        elif (flat := overlaid_on(mend, shell, part)) is not None:
            moved = 0.0
            for wall, pieces, distance in flat:
                cuts.setdefault(wall, []).extend(pieces)
                moved += sum(distance * piece.area for piece, _, _ in pieces)
                # The reveal from the wall to the face is not drawn; it may be of the face's material.
                reveals += [(str(m), ANY_SHARE * distance * p.length) for p, m, _ in pieces]
            tell("overlay", part, size, moved, -size)
        elif (foot := standing_on(mend, shell, part)) is not None:
            prints, stood = foot
            for wall, footprint in prints:
                cuts.setdefault(wall, []).append((footprint, None, ""))
            added.extend(stood)
            base = mend.points[shell.faces[prints[0][0]]]
            covered = sum(footprint.area for _, footprint in prints)
            volume = -abs(signed_volume(mend, stood, base[0]))
            tell("open bottom", part, size, volume, size - covered)
        else:
            panels.append(part)
            tell("panel", part, size, -THICKNESS * size, size)
    _tell_others(mend, told, reveals)
    shell = cut(mend, shell, cuts)
    shell.extend(added)
    if cuts:
        shell = flattened(mend, resnapped(mend, rewelded(mend, shell)))
        shell = shell.kept([area_of(mend.points[f]) > SAME for f in shell.faces])
    for part in panels:
        for face, material, name in zip(part.faces, part.materials, part.names, strict=True):
            add_slab(mend, shell, face, material, name)
    return shell


def _tell_others(
    mend: Mending,
    told: Mapping[str, Sequence[tuple[str, float, float, float]]],
    reveals: Sequence[tuple[str, float]],
) -> None:
    words = {
        "overlay": "faces on a larger one take its area",
        "open bottom": "objects with an open bottom stand on a face, and take its area",
        "panel": "free panels are reflectors with two sides",
        "outside": "components outside the room are left out",
    }
    for kind, rows in told.items():
        area, volume, surface = np.sum([row[1:] for row in rows], axis=0).tolist()
        uncertainty = abs(volume) / np.sqrt(3) if kind == "overlay" else 0.0
        names = [row[0] for row in rows]
        unsure = reveals if kind == "overlay" else ()
        done = words[kind]
        mend.found(kind, done, names, area, volume, surface, float(uncertainty), unsure=unsure)


def _within(mend: Mending, hull: Polyhedron, corners: Array) -> bool:
    """Return whether a component is in the room: its corners, but for those at the walls, are."""
    away = hull.wall_distance(corners) > mend.offset + mend.weld
    outside = ~hull.contains(corners)
    return not bool((away & outside).any())
