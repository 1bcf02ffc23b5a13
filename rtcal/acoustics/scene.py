"""Where a room's walls, sources and receivers are, as its file states it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from typing import Any

from rtcal.acoustics.directivity import (
    DirectivityFile,
    StatedDirectivity,
    directivities,
    directivity_of_table,
    plain_directivities,
)
from rtcal.acoustics.materials import text_name
from rtcal.support import checks
from rtcal.support.checks import Entries
from rtcal.support.errors import DataError

Point = tuple[float, float, float]
_GEOMETRY = ("mesh", "unit", "position_uncertainty", "surfaces")
_POINTS = ("sources", "receivers")
TABLES = ("geometry", *_POINTS, "directivity")
"""Names of its tables in a room's file."""
POSITION = 0.1
"""Root mean square distance in m of sources and receivers from where they are stated. Each coordinate
has a standard deviation sqrt(3) times smaller."""
MOST_OFF = 1.0
"""Largest `POSITION` in m that is taken."""
MAX_POINTS = 1000
"""Largest number of sources, and of receivers."""


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
    def from_dict(cls, data: Any, place: str = "scene") -> Scene:
        """Return the scene of tables as `to_dict` returns them.

        Raises DataError, which begins with ``place``, for an unknown key or a value of the wrong kind.
        """
        place = f"{place}." if checks.text("place", place) else ""
        tables = Entries(place, data, (), TABLES)
        stated: dict[str, Any] = {}
        if "geometry" in tables:
            geometry = tables.entries("geometry", (), _GEOMETRY)
            if "mesh" in geometry.values:
                stated["mesh"] = geometry.text("mesh")
                if not stated["mesh"].strip():
                    raise DataError(f"{geometry.place}mesh is not the name of a mesh's file")
            for key in ("unit", "position_uncertainty"):
                if key in geometry.values:
                    stated[key] = geometry.number(key)
            if "surfaces" in geometry:
                names = geometry.mapping("surfaces")
                faces = geometry.entries("surfaces", (), names)
                stated["surfaces"] = {name: faces.texts(name) for name in names}
        for kind in _POINTS:
            if kind in tables.values:
                names = tables.mapping(kind)
                if not names:
                    raise DataError(f"{tables.place}{kind} is empty; there is at least one")
                points = tables.entries(kind, (), names)
                stated[kind] = {name: points.array(name, (3,)).tolist() for name in names}
        if "directivity" in tables:
            stated["directivity"] = {
                name: of
                if isinstance(of, str)
                else directivity_of_table(of, f"{tables.place}directivity.{name}")
                for name, of in tables.mapping("directivity").items()
            }
        return cls(**stated)


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


def scene_lines(tables: Mapping[str, Any]) -> list[str]:
    """Return the lines of `Scene.to_dict`'s tables."""
    lines: list[str] = []
    geometry = tables.get("geometry", {})
    if geometry:
        lines += ["", "[geometry]"]
        lines += [f"mesh = {quoted(geometry[key])}" for key in ("mesh",) if key in geometry]
        numbers = ("unit", "position_uncertainty")
        lines += [f"{key} = {geometry[key]!r}" for key in numbers if key in geometry]
        if "surfaces" in geometry:
            lines += ["", "[geometry.surfaces]"]
            for name, faces in geometry["surfaces"].items():
                lines.append(f"{quoted(name)} = [{', '.join(map(quoted, faces))}]")
    for kind in ("sources", "receivers"):
        if kind in tables:
            lines += ["", f"[{kind}]"]
            lines += [f"{quoted(n)} = {listed(point)}" for n, point in tables[kind].items()]
    if "directivity" in tables:
        lines += ["", "[directivity]"]
    for name, of in tables.get("directivity", {}).items():
        if isinstance(of, str):
            lines.append(f"{quoted(name)} = {quoted(of)}")
        else:
            # JSON's texts and lists of numbers are TOML's.
            entries = ", ".join(f"{key} = {json.dumps(value)}" for key, value in of.items())
            lines.append(f"{quoted(name)} = {{ {entries} }}")
    return lines


def quoted(text: str) -> str:
    """Return a text as TOML writes it."""
    # A JSON string is a TOML basic string, but for DEL, which TOML wants escaped.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def listed(values: Iterable[float]) -> str:
    """Return numbers as TOML writes them."""
    return "[" + ", ".join(repr(float(v)) for v in values) + "]"
