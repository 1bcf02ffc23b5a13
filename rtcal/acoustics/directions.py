"""Which way a room's surfaces face: across x, y or z."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np

from rtcal.acoustics.room import AXES, Room, Surface
from rtcal.support.types import Array

__all__ = ["enough_known", "facing", "kind_of"]
__dir__ = __all__.copy


UNKNOWN_SHARE = 0.2
"""Share of the absorption area whose direction may be unknown: such objects as chairs and curtains."""
_WHOLE = 0.9
"""Share of a material's area whose direction must be known for the material's."""
NOT_KNOWN = (
    "nothing says in which direction the room's surfaces face: state axis for each [[surface]], "
    "dimensions or a mesh, or name the surfaces floor, ceiling and walls"
)
"""Why an effect is not judged in a room whose directions are not known."""


def facing(room: Room, geometry: Any = None) -> Array:
    """Return each material's shares of area across x, y and z, (n_materials, 3); NaN where unknown.

    In this order: the faces of a geometry (an oblique one counts by the squares of its normal), the
    ``axis`` of a surface, a name of a surface or of a material that says floor, ceiling or wall
    (English, German, French, Spanish, Italian, Portuguese), an area that is that of faces of the box of
    the room's ``dimensions``, and what is left of that box, or of a room whose floor or ceiling is
    named. Named walls without a box share x and y by halves.

    Parameters
    ----------
    room : Room
    geometry : rtcal.simulators.Polyhedron, optional
        Its faces take the place of the room's surfaces. Its materials are named as the room's; one
        that it lacks is unknown.

    Examples
    --------
    >>> room = Room(name="box", volume=210, materials=["carpet", "plaster"], areas=[56, 168.5],
    ...             alpha=[[0.4], [0.05]], sigma=[[0.1], [0.02]], centre_frequencies=[1000])
    >>> print(facing(room))
    [[nan nan nan]
     [nan nan nan]]
    >>> print(facing(room.replace(dimensions=(7, 8, 3.75))).round(2))
    [[0.   0.   1.  ]
     [0.36 0.31 0.33]]
    """
    if geometry is not None:
        rows = {name: row for row, name in enumerate(room.materials)}
        along = np.asarray(geometry.face_areas)[:, np.newaxis] * np.square(geometry.normals)
        faces = zip(geometry.materials, along, strict=True)
        return _by_material(room, [(rows[name], a) for name, a in faces if name in rows], least=0.0)
    surfaces = list(room.surfaces)
    stands = {surface.material for surface in surfaces}
    surfaces += [
        Surface(name, name, float(area))
        for name, area in zip(room.materials, room.areas, strict=True)
        if name not in stands
    ]
    box = None if room.dimensions is None else _box(room.dimensions)
    stated = _stated(surfaces, box)
    if box is not None:
        stated = _matched(surfaces, stated, box)
    else:
        box = _box_of_floor(surfaces, stated)
    if box is not None:
        stated = _rest(surfaces, stated, box)
    places = room.material_rows([s.material for s in surfaces]).tolist()
    return _by_material(
        room, [(row, a) for row, a in zip(places, stated, strict=True) if a is not None]
    )


def enough_known(room: Room, shares: Array) -> bool:
    """Return whether the directions of most of the absorption are known; ``shares`` as of `facing`."""
    unknown = np.isnan(shares).any(axis=1)
    absorbed = (room.areas[:, np.newaxis] * room.alpha).sum(axis=1)
    return bool((~unknown).any() and absorbed[unknown].sum() <= UNKNOWN_SHARE * absorbed.sum())


def _by_material(room: Room, along: Iterable[tuple[int, Array]], least: float = _WHOLE) -> Array:
    """Return shares from areas along x, y and z, each with the row of its material.

    A material is known whose known surfaces have at least the share ``least`` of its area.
    """
    sums = np.zeros((room.n_materials, 3))
    for row, areas in along:
        sums[row] += areas
    total = sums.sum(axis=1)
    known = (total > 0) & (total >= least * room.areas)
    shares = np.full(sums.shape, np.nan)
    shares[known] = sums[known] / total[known, np.newaxis]
    return shares


_X, _Y, _Z = range(3)
FLOOR, CEILING, WALL, LEVEL = "floor", "ceiling", "wall", "floor and ceiling"
_WORDS = {
    FLOOR: "floor floors flooring boden böden fussboden bodenbelag sol plancher suelo piso pavimento "
    "chão soalho",
    CEILING: "ceiling ceilings roof decke decken dach plafond toit techo cielorraso soffitto tetto "
    "teto forro",
    WALL: "wall walls wand wände waende mauer mauern mur murs pared paredes muro muri parete pareti "
    "parede paredes",
}
_COMPOUNDS = {FLOOR: ("boden",), CEILING: ("decke", "decken"), WALL: ("wand", "wände")}
"""Parts of German words: Akustikdecke, Deckenplatten, Rückwand."""
_TO = frozenset(["to", "bis", "au", "à", "al", "ao"])
"""What stands between floor and ceiling in the name of something that reaches from one to the other."""
_NO_COMPOUNDS = ("leinwand", "vorwand", "gewand")


def kind_of(name: str) -> str | None:
    """Return "floor", "ceiling", "wall" or "floor and ceiling" where a name says it, else None.

    Examples
    --------
    >>> kind_of("Akustikdecke"), kind_of("rear wall, wood"), kind_of("floor-to-ceiling window")
    ('ceiling', 'wall', None)
    """
    words = re.findall(r"[^\W\d_]+", name.lower().replace("ß", "ss"))
    kinds = {
        kind
        for kind, listed in _WORDS.items()
        for word in words
        if word in listed.split()
        or (
            word not in _NO_COMPOUNDS
            and (word.startswith(_COMPOUNDS[kind]) or word.endswith(_COMPOUNDS[kind]))
        )
    }
    if kinds == {FLOOR, CEILING} and not _TO.intersection(words):
        return LEVEL
    return kinds.pop() if len(kinds) == 1 else None


def _kind(surface: Surface) -> str | None:
    return kind_of(surface.name) or kind_of(surface.material)


def _box(dimensions: Sequence[float]) -> Array:
    """Return the areas of both faces of a box along x, y and z."""
    x, y, z = dimensions
    return 2 * np.array([y * z, x * z, x * y])


def _stated(surfaces: Sequence[Surface], box: Array | None) -> list[Array | None]:
    """Return the areas along x, y and z that axes and names state; None for other surfaces."""
    walls = np.array([0.5, 0.5, 0.0])
    if box is not None:
        walls = np.array([box[_X], box[_Y], 0.0]) / (box[_X] + box[_Y])
    out: list[Array | None] = []
    for surface in surfaces:
        kind = _kind(surface)
        if surface.axis is not None:
            out.append(surface.area * np.eye(3)[AXES.index(surface.axis)])
        elif kind in (FLOOR, CEILING, LEVEL):
            out.append(surface.area * np.eye(3)[_Z])
        else:
            out.append(surface.area * walls if kind == WALL else None)
    return out


def _box_of_floor(surfaces: Sequence[Surface], along: Sequence[Array | None]) -> Array | None:
    """Return the areas of a box with the named floor or ceiling, as both; None without one.

    The other surfaces are its walls, half of them along x.
    """
    sums = dict.fromkeys((FLOOR, CEILING), 0.0)
    for surface in surfaces:
        if (kind := _kind(surface)) in sums:
            sums[str(kind)] += surface.area
    level, total = max(sums.values()), sum(s.area for s in surfaces)
    walls = total - 2 * level
    return None if level == 0 or walls <= 0 else np.array([walls / 2, walls / 2, 2 * level])


_NEAR = 0.02
"""Share by which an area may differ from that of the faces that it is."""
_LARGEST_SEARCH = 8
"""Surfaces whose areas are matched at once."""


def _matched(
    surfaces: Sequence[Surface], along: Sequence[Array | None], box: Array
) -> list[Array | None]:
    """Return the areas along the axes, also of surfaces with the area of faces of the box.

    All six faces are surfaces, or what is left of them is what is left of the surfaces. Of several
    ways, those count that leave the least area, and only where they agree.
    """
    out = list(along)
    places = [i for i, of_surface in enumerate(along) if of_surface is None]
    if not 0 < len(places) <= _LARGEST_SEARCH:
        return out
    stated = np.sum([a for a in along if a is not None], axis=0) if len(places) < len(out) else 0.0
    face = box / 2
    left = np.asarray(np.round(np.clip((box - stated) / face, 0, 2), 2), dtype=float)
    areas = np.array([surfaces[i].area for i in places])
    ways = list(_ways(areas, face, left))
    if not ways:
        return out
    least = min(rest for rest, _ in ways)
    best = np.array([counts for rest, counts in ways if rest <= least + _NEAR * box.sum()])
    for column, place in enumerate(places):
        of_place = best[:, column] * face
        total = of_place.sum(axis=1)
        if (total > 0).all():
            shares = of_place / total[:, np.newaxis]
            if np.ptp(shares, axis=0).max() < _AGREE:
                out[place] = areas[column] * shares.mean(axis=0)
    return out


_AGREE = 0.05


def _ways(areas: Array, face: Array, left: Array) -> Iterator[tuple[float, Array]]:
    """Yield ways in which areas are those of faces of a box: the area that is left, and the counts.

    The counts (n_surfaces, 3) are numbers of faces along each axis, 0 of a surface that is no faces.
    """
    # One material is usually on floor and ceiling, or on walls but for a corner of two, or on floor or
    # ceiling with all walls.
    every = np.array(list(product(range(3), repeat=3)))[1:]
    x, y, z = every.T
    walls = (z == 0) & ((x != 1) | (y != 1))
    combinations = every[(x + y == 0) | (x + y == 4) | walls]

    options = [
        [np.zeros(3)]
        + [n for n in combinations if (n <= left + _NEAR).all() and _is_near(area, n @ face)]
        for area in areas
    ]
    for counts in product(*options):
        table = np.array(counts)
        if (table.sum(axis=0) > left + _NEAR).any():
            continue
        remaining = float(np.maximum(left - table.sum(axis=0), 0) @ face)
        rest = float(areas[(table == 0).all(axis=1)].sum())
        if remaining <= _NEAR * face.sum() or abs(rest / remaining - 1) <= _OF_REST:
            yield rest, table


def _is_near(area: float, of_faces: float) -> bool:
    return bool(abs(area / of_faces - 1) <= _NEAR)


_OF_REST = 0.1
"""Share by which the surfaces that are left may differ from the faces that are left."""
_ONE_KIND = 0.05
"""Share of another direction in what is left, up to which it is of one kind."""


def _rest(
    surfaces: Sequence[Surface], along: Sequence[Array | None], box: Array
) -> list[Array | None]:
    """Return the areas along the axes, also of the surfaces that are what is left of a box.

    Where walls and floor or ceiling are left, several materials may be on either.
    """
    places = [i for i, of_surface in enumerate(along) if of_surface is None]
    known = [a for a in along if a is not None]
    left = np.maximum(box - np.sum(known, axis=0), 0.0) if known else box
    rest = sum(surfaces[i].area for i in places)
    if not places or left.sum() == 0 or abs(rest / left.sum() - 1) > _OF_REST:
        return list(along)
    of_walls = (left[_X] + left[_Y]) / left.sum()
    one_kind = min(of_walls, 1 - of_walls) <= _ONE_KIND
    if not one_kind and len({surfaces[i].material for i in places}) > 1:
        return list(along)
    shares = left / left.sum()
    if one_kind:
        shares = np.where(np.eye(3)[_Z] > 0, of_walls <= 0.5, (of_walls > 0.5) * shares)
        shares = shares / shares.sum()
    return [
        surfaces[i].area * shares if of_surface is None else of_surface
        for i, of_surface in enumerate(along)
    ]
