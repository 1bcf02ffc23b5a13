"""A still picture of a room: an axonometric projection as the shapes of an SVG.

Faces towards the reader are left out, so that the room can be looked into. ``room.js`` projects in the
same way.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.simulators.geometry import Polyhedron
from rtcal.support.types import Array

GREY = "#c8c8c8"
"""Colour of what has no value."""
ABOVE, BELOW = np.radians([30, -30])
"""Directions from which the view looks, above the horizontal: floor or ceiling is seen."""
TURNS = np.radians([35, 125, 215, 305])
"""Directions round z, of which the one is taken that shows most of what is to be seen."""
_WIDTH, _HEIGHT = 460, 330
_MARGIN = 20
_SIZE = 7
_FLAT = 0.01
"""Largest sine between the normals of two faces without an edge between them."""
_MOST_NAMES = 40


def between(colours: Sequence[str], share: float) -> str:
    """Return the colour at a share from 0 to 1 of a scale; beyond its ends the end; grey for NaN.

    >>> between(("#000000", "#ff0000"), 0.5), between(("#000000", "#ff0000"), float("nan"))
    ('#800000', '#c8c8c8')
    """
    if not np.isfinite(share):
        return GREY
    stops = np.array([[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in colours], dtype=float)
    at = np.clip(share, 0, 1) * (len(stops) - 1)
    mixed = [np.interp(at, np.arange(len(stops)), channel) for channel in stops.T]
    return "#" + "".join(f"{int(np.floor(c + 0.5)):02x}" for c in mixed)


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """A direction of view of a geometry, and its picture's scale.

    Attributes
    ----------
    turn, tilt : float
        Of the view, round z and above the horizontal, in radians.
    owners : int array (n_faces,)
        Part of each face, -1 without one.
    edges : int array (n_edges, 2)
        Vertices of the edges that are drawn.
    scale : float
        Units of the picture per m.
    origin : array (2,)
        Of the picture, in m.
    size : tuple of float
        Width and height of the picture.
    """

    geometry: Polyhedron
    turn: float
    tilt: float
    owners: NDArray[np.int64]
    edges: NDArray[np.int64]
    scale: float
    origin: Array
    size: tuple[float, float]

    @property
    def box(self) -> str:
        """The picture's extent as an SVG's viewBox."""
        return f"0 0 {self.size[0]:.0f} {self.size[1]:.0f}"

    def shapes(self) -> dict[str, Any]:
        """Return polygons (points, part, edges), the farthest first, and the edges before them."""
        flat = self._flat(self.geometry.vertices)
        into = axes_of(self.turn, self.tilt)[2]
        drawn = {(int(a), int(b)) for a, b in self.edges}
        depth = self.geometry.vertices @ into
        faces = [list(face) for face in self.geometry.faces]
        seen = self.geometry.normals @ into > 0
        order = sorted(
            np.flatnonzero(seen),
            key=lambda i: (-float(depth[faces[i]].max()), -float(depth[faces[i]].mean())),
        )
        of_face = {i: drawn.intersection(_around(faces[i])) for i in order}
        near = drawn.difference(*of_face.values())
        return {
            "polygons": [
                (_points(flat[faces[i]]), int(self.owners[i]), _path(flat, of_face[i]))
                for i in order
            ],
            "near": _path(flat, near),
        }

    def marks(self, stands: Iterable[tuple[str, str, Any, str]]) -> list[dict[str, Any]]:
        """Return sources and receivers: (kind, name, place, colour), with names unless many."""
        every = list(stands)
        low = self.geometry.vertices[:, 2].min()
        made = []
        for kind, name, place, colour in every:
            (x, y), (_, foot) = self._flat(np.array([place, (place[0], place[1], low)]))
            s = _SIZE
            corners = [(x, y - s), (x - s, y + 0.7 * s), (x + s, y + 0.7 * s)]
            made.append(
                {
                    "kind": kind,
                    "name": name if len(every) <= _MOST_NAMES else "",
                    "x": f"{x:.1f}",
                    "y": f"{y:.1f}",
                    "foot": f"{foot:.1f}",
                    "corners": _points(np.array(corners)),
                    "colour": colour,
                }
            )
        return made

    def _flat(self, points: Array) -> Array:
        """Return points (n, 3) in m in the picture, (n, 2), whose y is downward."""
        right, up, _ = axes_of(self.turn, self.tilt)
        flat = np.stack([points @ right, points @ up], axis=1) - self.origin
        return np.asarray(flat * self.scale * (1, -1))


def axes_of(turn: float, tilt: float) -> Array:
    """Return the unit vectors to the right, upward and into the picture, (3, 3)."""
    across, along = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    right = np.array([*across, 0.0])
    up = np.array([*(np.sin(tilt) * along), np.cos(tilt)])
    into = np.array([*(np.cos(tilt) * along), -np.sin(tilt)])
    return np.stack([right, up, into])


def look(
    geometry: Polyhedron, owners: NDArray[np.int64], weights: Array, tilt: float = ABOVE
) -> Look:
    """Return the look from which most of the faces' weights (n_faces,) is seen from inside."""

    def shown(turn: float) -> float:
        return float(weights @ np.clip(geometry.normals @ axes_of(turn, tilt)[2], 0, None))

    turn = float(max(TURNS, key=shown))
    right, up, _ = axes_of(turn, tilt)
    flat = np.stack([geometry.vertices @ right, geometry.vertices @ up], axis=1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    room = np.array([_WIDTH, _HEIGHT]) - 2 * _MARGIN
    scale = float((room / np.maximum(high - low, 1e-9)).min())
    width, height = scale * (high - low) + 2 * _MARGIN
    return Look(
        geometry=geometry,
        turn=turn,
        tilt=float(tilt),
        owners=owners,
        edges=_edges(geometry, owners),
        scale=scale,
        origin=np.array([low[0] - _MARGIN / scale, high[1] + _MARGIN / scale]),
        size=(float(width), float(height)),
    )


def _edges(geometry: Polyhedron, owners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the edges between parts and where a part bends, but none within a plane."""
    of_edge: dict[tuple[int, int], list[int]] = {}
    for i, face in enumerate(geometry.faces):
        for edge in _around(face):
            of_edge.setdefault(edge, []).append(i)

    def drawn(faces: list[int]) -> bool:
        if len(faces) < 2 or len({int(owners[i]) for i in faces}) > 1:
            return True
        first = geometry.normals[faces[0]]
        return any(
            float(np.linalg.norm(np.cross(first, geometry.normals[i]))) > _FLAT for i in faces[1:]
        )

    kept = [edge for edge, faces in of_edge.items() if drawn(faces)]
    return np.array(kept, dtype=np.int64).reshape(-1, 2)


def _points(flat: Array) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in flat)


def _around(face: Sequence[int]) -> list[tuple[int, int]]:
    """Return the edges of a face, each with its lower vertex first."""
    return [(min(a, b), max(a, b)) for a, b in zip(face, [*face[1:], face[0]], strict=True)]


def _path(flat: Array, edges: Iterable[tuple[int, int]]) -> str:
    """Return edges as the path of an SVG."""
    return "".join(
        "M{:.1f} {:.1f}L{:.1f} {:.1f}".format(*flat[a], *flat[b]) for a, b in sorted(edges)
    )
