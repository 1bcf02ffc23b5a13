"""Where on its surface a cover lies, which a room does not state, and what each position hears of that.

A change spreads its cover evenly over the surface. In truth it lies somewhere, most often in one piece.
The places that are tried are the ends of the surface: the cover fills it from either side along each of
its axes. A cover in the middle departs less from an even one, so these are the cautious ones.

The surface is cut where the cover would end. Its pieces lie in the same planes and scatter alike. So
the same paths are traced, and only the difference between a place and the even cover is heard.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.room import Room
from rtcal.simulators import polygons
from rtcal.simulators.geometry import WELD, Polyhedron
from rtcal.simulators.observations import observe
from rtcal.simulators.path_tracing import PathTracing
from rtcal.simulators.polygons import Plane
from rtcal.support.types import Array

_FLAT = 0.05
"""Extent of a surface along an axis, over its largest, below which it has no ends along it."""
_TILT = (0.1, 0.03)
"""By how much the axes of a surface of several planes are tilted towards each other."""
_HALVINGS = 40
"""Of the interval that holds the edge of a cover: to the last digit."""

Move = tuple[int, int, Array]
"""What a partial cover moved: the numbers of the material below and of the new one, and the share
that it takes of what was each of the room's materials, (n_before,)."""
HalfSpace = tuple[Array, float]
"""A direction and an offset in m: the points x with x @ direction at most the offset."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """A tracing whose surfaces are cut where covers may end, each piece with coefficients of its own.

    Attributes
    ----------
    tracer : PathTracing
    parent : int array (n_pieces,)
        Number of the room's material of each piece.
    moves : tuple of Move
        The partial covers; where each lies has nothing to do with the others.
    places : tuple of array (n_places, n_pieces)
        Which pieces each of them covers, for every place.
    """

    tracer: PathTracing
    parent: NDArray[np.int64]
    moves: tuple[Move, ...]
    places: tuple[Array, ...]

    @classmethod
    def of(cls, tracer: PathTracing, moves: Sequence[Move]) -> Pieces:
        """Return the tracing with the covered surfaces cut."""
        geometry, room = tracer.geometry, tracer.room
        owner = np.array([room.material_index(m) for m in geometry.materials])
        ends = [_ends(geometry, owner, moved) for _, _, moved in moves]
        cut: list[tuple[str, str, Array]] = []
        parent: list[int] = []
        for face, own in enumerate(owner.tolist()):
            sides = [
                s for of, (*_, moved) in zip(ends, moves, strict=True) if moved[own] for s in of
            ]
            for piece in _cut(geometry, face, sides):
                cut.append((f"{len(cut)}", f"{room.materials[own]} ({len(cut)})", piece))
                parent.append(own)
        numbers = np.array(parent)
        solid = Polyhedron.from_polygons(cut)
        pieces = Room(
            name=room.name,
            volume=room.volume,
            materials=solid.materials,
            areas=solid.face_areas,
            alpha=room.alpha[numbers],
            sigma=room.sigma[numbers],
            centre_frequencies=room.centre_frequencies,
            air=room.air,
        )
        middles = np.array([solid.vertices[list(f)].mean(axis=0) for f in solid.faces])
        places = tuple(
            np.array([(middles @ along < offset) & (moved[numbers] > 0) for along, offset in of])
            for of, (*_, moved) in zip(ends, moves, strict=True)
        )
        scattering = tracer.scattering[numbers]
        by_piece = replace(tracer, geometry=solid, room=pieces, scattering=scattering)
        return cls(by_piece, numbers, tuple(moves), places)

    def heard(self, walls: Array, alpha: Array, match: Sequence[str], seed: int) -> Array:
        """Return what places of covers change, (n_places, n_values): its square is their covariance.

        Parameters
        ----------
        walls : array (n_before, n_bands)
            Coefficients of the room's surfaces with the covers spread evenly.
        alpha : array (n_materials, n_bands)
            Of all materials.
        match : sequence of str
        seed : int
        """

        def hear(alpha: Array) -> Array:
            return observe(self.tracer, np.clip(alpha, 0.0, 1.0), match, seed=seed).values.ravel()

        even = walls[self.parent]
        middle = hear(even)
        rows = []
        for (below, new, moved), places in zip(self.moves, self.places, strict=True):
            for covered in places:
                more = (covered - moved[self.parent])[:, np.newaxis] * (alpha[new] - alpha[below])
                rows.append((hear(even + more) - middle) / np.sqrt(len(places)))
        return np.array(rows).reshape(-1, middle.size)


def _ends(geometry: Polyhedron, owner: NDArray[np.int64], moved: Array) -> list[HalfSpace]:
    """Return the half spaces that hold a cover at either end of its surface, along each axis.

    ``moved`` (n_before,) is the share that is covered of each of the room's materials.
    """
    faces = np.flatnonzero(moved[owner] > 0)
    faces = faces[np.argsort(-geometry.face_areas[faces], kind="stable")]
    area = float(geometry.face_areas[faces] @ moved[owner[faces]])
    parts = [part for i in faces.tolist() for part in polygons.convex_parts(geometry, i)]
    corners = np.concatenate(parts)
    plane = Plane.of(geometry, faces.tolist())
    axes = [plane.along, plane.across, geometry.normals[faces[0]]]
    size = [float(np.ptp(corners @ axis)) for axis in axes]
    axes = [axis for axis, of in zip(axes, size, strict=True) if of > _FLAT * max(size)]
    if len(axes) > 2:
        # A wall across an axis is filled from one of its sides, not at once.
        axes = [a + _TILT[0] * axes[i - 1] + _TILT[1] * axes[i - 2] for i, a in enumerate(axes)]
    found = []
    for axis in axes:
        for along in (axis, -axis):
            first, last = float((corners @ along).min()), float((corners @ along).max())
            for _ in range(_HALVINGS):
                edge = (first + last) / 2
                within = sum(polygons.area(polygons.cut(p, along, edge)[0]) for p in parts)
                first, last = (edge, last) if within < area else (first, edge)
            found.append((along, (first + last) / 2))
    return found


def _cut(geometry: Polyhedron, face: int, sides: Sequence[HalfSpace]) -> list[Array]:
    """Return the pieces of a face on either side of every edge; the face itself without any."""
    if not sides:
        return [geometry.vertices[list(geometry.faces[face])]]
    pieces = polygons.convex_parts(geometry, face)
    for along, offset in sides:
        both = [
            piece
            for whole in pieces
            # What lies in the edge's own plane is on one side of it.
            for piece in (
                polygons.cut(whole, along, offset) if np.ptp(whole @ along) > WELD else [whole]
            )
        ]
        pieces = [piece for piece in both if polygons.is_face(piece)]
    return pieces
