"""A simulator in a changed room: what was covered is another mixture of materials on the same walls.

Where the new material lies on a surface is not known to the room. It is spread evenly over all walls
of the material that it covers, so every wall's coefficient is a mean by area, and a tracer weighs the
paths that it has. How the walls scatter stays.

In truth the cover lies somewhere, most often in one piece.
The places that are tried are the ends of the surface: the cover fills it from either side along each of
its axes. A cover in the middle departs less from an even one, so these are the cautious ones.

The surface is cut where the cover would end. Its pieces lie in the same planes and scatter alike. So
the same paths are traced, and only the difference between a place and the even cover is heard.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.changes import Change, Climate, Cover, Open, changed
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import Assumptions
from rtcal.simulators import facets
from rtcal.simulators.base import Simulator
from rtcal.simulators.facets import WELD
from rtcal.simulators.geometry import Plane, Polyhedron, convex_parts
from rtcal.simulators.observations import observe
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support.errors import DataError
from rtcal.support.types import Array

_FLAT = 0.05
"""Extent of a surface along an axis, over its largest, below which it has no ends along it."""
_TILT = (0.1, 0.03)
"""By how much the axes of a surface of several planes are tilted towards each other."""
_LEAST_AREA = 1e-5
"""Least relative error of a covered area."""
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
        owner = room.material_rows(geometry.materials)
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
    parts = [part for i in faces.tolist() for part in convex_parts(geometry, i)]
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
                within = sum(facets.area(facets.cut(p, along, edge)[0]) for p in parts)
                first, last = (edge, last) if within < area else (first, edge)
            found.append((along, (first + last) / 2))
    return found


def _cut(geometry: Polyhedron, face: int, sides: Sequence[HalfSpace]) -> list[Array]:
    """Return the pieces of a face on either side of every edge; the face itself without any."""
    if not sides:
        return [geometry.vertices[list(geometry.faces[face])]]
    pieces = convex_parts(geometry, face)
    for along, offset in sides:
        both = [
            piece
            for whole in pieces
            # What lies in the edge's own plane is on one side of it.
            for piece in (
                facets.cut(whole, along, offset) if np.ptp(whole @ along) > WELD else [whole]
            )
        ]
        pieces = [piece for piece in both if facets.is_face(piece)]
    return pieces


@dataclass(frozen=True, eq=False)
class ChangedRoom:
    """A room, what is changed in it, and which materials its walls then have.

    Raises DataError for a change that a simulator does not know the place of.

    Attributes
    ----------
    before : Room
        With the prior's coefficients.
    changes : tuple of Change
    assumptions : Assumptions
    """

    before: Room
    changes: tuple[Change, ...]
    assumptions: Assumptions

    def __post_init__(self) -> None:
        for change in self.changes:
            if not isinstance(change, (Cover, Open, Climate)):
                raise DataError(
                    f"{change}: a simulator does not know where; state the changed room's own mesh, or "
                    "predict T by an equation"
                )
        _ = self._mixed  # raises where the room does not allow a change

    @cached_property
    def after(self) -> Room:
        """The changed room, with the prior's coefficients."""
        return changed(self.before, self.changes)

    @cached_property
    def _new(self) -> list[int]:
        """Rows of the new materials in the changed room."""
        return [i for i, m in enumerate(self.after.materials) if m not in self.before.materials]

    @property
    def materials(self) -> tuple[str, ...]:
        """The room's materials, and then the new ones."""
        return (*self.before.materials, *(self.after.materials[i] for i in self._new))

    @cached_property
    def _mixed(self) -> tuple[Array, tuple[Move, ...]]:
        """Shares of the materials in what each was, and what each partial cover moved of them."""
        mixture = np.eye(self.before.n_materials, len(self.materials))
        moves = []
        for change in self.changes:
            cover = change.cover(self.before) if isinstance(change, Open) else change
            if not isinstance(cover, Cover):
                continue
            name = cover.by if isinstance(cover.by, str) else cover.by.name
            old, new = self.materials.index(cover.surface), self.materials.index(name)
            has = float(self.before.areas @ mixture[:, old])
            share = 1.0 if cover.area is None else min(cover.area / has, 1.0)
            moved = share * mixture[:, old]
            mixture[:, new] += moved
            mixture[:, old] -= moved
            if share < 1:
                moves.append((old, new, moved))
        return mixture, tuple(moves)

    @property
    def moves(self) -> tuple[Move, ...]:
        """Each partial cover: from which material, to which, and its share of each wall."""
        return self._mixed[1]

    @property
    def mixture(self) -> Array:
        """Share of each material in what was each of the room's, (n_before, n_materials)."""
        return self._mixed[0]

    def all_alpha(self, alpha: Array) -> Array:
        """Return coefficients of all materials for those of the room's, (n_materials, n_bands)."""
        return np.vstack([alpha, self.after.alpha[self._new]])

    def by_areas(self, alpha: Array) -> Array:
        """Return d(alpha of the walls) / d ln(each partly covered area), (n_covers, n_before, n_bands).

        ``alpha`` is that of all materials.
        """
        rows = [moved[:, np.newaxis] * (alpha[new] - alpha[old]) for old, new, moved in self.moves]
        return np.array(rows).reshape(-1, self.before.n_materials, self.before.n_bands)

    @property
    def cover_sigma(self) -> Array:
        """Relative error of each partial cover's area, (n_covers,): that of the surface below it."""
        if self.before.area_sigma.any() or self.before.common_area_sigma:
            stated = [*self.before.area_sigma, *self.after.area_sigma[self._new]]
        else:
            stated = [self.assumptions.areas] * len(self.materials)
        return np.maximum(stated, _LEAST_AREA)[[old for old, *_ in self.moves]]

    @property
    def new_sigma(self) -> Array:
        """Sigma of the new materials, (n_new, n_bands), at least the assumed one but where it is 0."""
        stated = self.after.sigma[self._new]
        return np.where(stated > 0, np.maximum(stated, self.assumptions.changed), stated)

    def simulator(self, simulator: Simulator) -> Simulator:
        """Return the simulator with the air after the change."""
        if self.after.air == self.before.air or not isinstance(simulator, PathTracing):
            if self.after.air != self.before.air:
                raise DataError(
                    "another climate takes a path tracing: the simulator keeps its own air"
                )
            return simulator
        return replace(simulator, room=simulator.room.with_air(self.after.air))
