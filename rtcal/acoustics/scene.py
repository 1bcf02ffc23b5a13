"""Where a room's walls, sources and receivers are, as its file states it."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal

import msgspec

from rtcal.acoustics.directivity import (
    DirectivityFile,
    Lobe,
    StatedDirectivity,
    directivities,
    directivity_of,
    plain_directivities,
)
from rtcal.files.schema import FileTable, Number, Point
from rtcal.support import checks
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError

_POINTS = ("sources", "receivers")
POSITION = 0.1
"""Root mean square distance in m of sources and receivers from where they are stated. Each coordinate
has a standard deviation sqrt(3) times smaller."""
MOST_OFF = 1.0
"""Largest `POSITION` in m that is taken."""
MAX_POINTS = 1000
"""Largest number of sources, and of receivers."""


class GeometryTable(FileTable):
    """The table ``geometry`` of a room's file."""

    mesh: str | None = None
    unit: Number = 1.0
    position_uncertainty: Number = POSITION
    surfaces: dict[str, list[str]] = {}


Places = Annotated[dict[str, Point], msgspec.Meta(min_length=1)]


class SceneTables(FileTable):
    """The tables of a room's file that `Scene` holds."""

    geometry: GeometryTable = msgspec.field(default_factory=GeometryTable)
    sources: Places | None = None
    receivers: Places | None = None
    directivity: dict[str, Lobe | Literal["unknown"]] = {}


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Where a room's walls, sources and receivers are. It names files and reads none.

    Parameters
    ----------
    mesh : path, optional
        The room's mesh (Wavefront OBJ). Without it the room is the box of its dimensions. In a file the
        path is relative to the file.
    unit : float
        Length of the mesh's unit in m.
    sources, receivers : mapping of str to (x, y, z)
        Positions in m, by the names of the measurement's pairs. Both are stated, or neither.
    directivity : mapping of str to Directivity, DirectivityFile or "unknown"
        By source. A source that is not stated is taken as omnidirectional. A file's path is as the
        mesh's.
    position_uncertainty : float
        Root mean square distance of the positions from those stated, in m.
    surfaces : mapping of str to sequence of str
        Names of each surface's faces, where coplanar faces of one material are not the surfaces.

    Raises
    ------
    DataError
        For a value that breaks its rule; the message names place, value and rule.

    Examples
    --------
    >>> scene = Scene(mesh="room.obj", sources={"S1": (1.2, 3.4, 1.5)}, receivers={"R1": (4, 2.2, 1.2)})
    >>> scene.receivers
    {'R1': (4.0, 2.2, 1.2)}
    """

    mesh: str | os.PathLike[str] | None = None
    unit: float = 1.0
    sources: Mapping[str, Sequence[float]] = field(default_factory=dict)
    receivers: Mapping[str, Sequence[float]] = field(default_factory=dict)
    directivity: Mapping[str, StatedDirectivity] = field(default_factory=dict)
    position_uncertainty: float = POSITION
    surfaces: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.mesh is not None:
            object.__setattr__(self, "mesh", os.fspath(checks.path("mesh", self.mesh)))
            if not str(self.mesh).strip():
                raise DataError(f"mesh = {self.mesh!r} is not the name of a mesh's file")
        object.__setattr__(self, "unit", checks.positive("unit", self.unit, "m"))
        if self.mesh is None and self.unit != 1:
            raise DataError(f"unit = {self.unit:g} is that of a mesh, and none is stated")
        for kind in _POINTS:
            object.__setattr__(self, kind, _points(kind, getattr(self, kind)))
        for kind, other in (_POINTS, _POINTS[::-1]):
            if getattr(self, kind) and not getattr(self, other):
                raise DataError(f"{other} is empty, and {kind} is not; state both or neither")
        object.__setattr__(self, "directivity", directivities(self.directivity, self.sources))
        uncertainty = checked_uncertainty(self.position_uncertainty)
        object.__setattr__(self, "position_uncertainty", uncertainty)
        surfaces = {}
        for name, faces in checks.mapped("surfaces", self.surfaces).items():
            place = f'surfaces["{text_name("surfaces", name)}"]'
            surfaces[name] = tuple(text_name(place, face) for face in checks.listed(place, faces))
        object.__setattr__(self, "surfaces", surfaces)

    def __bool__(self) -> bool:
        """Whether anything is stated."""
        return self != Scene()

    def within(self, folder: str | os.PathLike[str]) -> Scene:
        """Return the scene of a file in this folder, whose mesh and files are named relative to it."""
        return self._with_files(lambda path: str(Path(folder) / path))

    def seen_from(self, folder: str | os.PathLike[str]) -> Scene:
        """Return the scene as a file in this folder states it; the inverse of `within`."""

        def relative(path: str) -> str:
            try:
                return PurePath(os.path.relpath(path, folder)).as_posix()
            except ValueError:  # another drive
                return PurePath(os.path.abspath(path)).as_posix()

        return self._with_files(relative)

    def _with_files(self, named: Callable[[str], str]) -> Scene:
        return replace(
            self,
            mesh=None if self.mesh is None else named(os.fspath(self.mesh)),
            directivity={
                name: replace(of, file=named(os.fspath(of.file)))
                if isinstance(of, DirectivityFile)
                else of
                for name, of in self.directivity.items()
            },
        )

    def to_dict(self) -> dict[str, Any]:
        """Return its tables as plain values, without those that are not stated."""
        geometry: dict[str, Any] = {}
        if self.mesh is not None:
            geometry["mesh"] = self.mesh
        if self.unit != 1:
            geometry["unit"] = self.unit
        if self.position_uncertainty != POSITION:
            geometry["position_uncertainty"] = self.position_uncertainty
        if self.surfaces:
            geometry["surfaces"] = {name: list(faces) for name, faces in self.surfaces.items()}
        tables = {
            "geometry": geometry,
            **{kind: {n: list(p) for n, p in getattr(self, kind).items()} for kind in _POINTS},
            "directivity": plain_directivities(self.directivity),
        }
        return {name: table for name, table in tables.items() if table}

    @classmethod
    def of(cls, tables: Any) -> Scene:
        """Return the scene of what has the fields of `SceneTables`; DataError as `Scene` does."""
        return cls(
            **msgspec.structs.asdict(tables.geometry),
            sources=tables.sources or {},
            receivers=tables.receivers or {},
            directivity={
                name: directivity_of(of, f'directivity["{name}"]')
                for name, of in tables.directivity.items()
            },
        )


def checked_uncertainty(position_uncertainty: float) -> float:
    """Return the standard uncertainty of places in m; DataError for none, or above `MOST_OFF`."""
    uncertainty = checks.positive("position_uncertainty", position_uncertainty, "m")
    if uncertainty > MOST_OFF:
        raise DataError(
            f"position_uncertainty = {uncertainty:g} m is above {MOST_OFF:g} m: such a position says "
            "nothing"
        )
    return uncertainty


def _points(kind: str, stated: Mapping[str, Sequence[float]]) -> dict[str, Point]:
    points = checks.mapped(kind, stated)
    if len(points) > MAX_POINTS:
        raise DataError(f"{len(points)} {kind}; a room has at most {MAX_POINTS}")
    made: dict[str, Point] = {}
    for name, point in points.items():
        place = f'{kind}["{text_name(kind, name)}"]'
        coordinates = checks.array(place, point)
        if coordinates.shape != (3,) or not abs(coordinates).max() < float("inf"):
            raise DataError(f"{place} = {checks.shown(point)} is not three finite numbers in m")
        x, y, z = coordinates.tolist()
        made[name] = (x, y, z)
    return made
