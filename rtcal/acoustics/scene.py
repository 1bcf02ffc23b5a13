"""Where a room's walls, sources and receivers are, and what its sources radiate in each direction."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from rtcal.files.schema import FileTable, Number, Point
from rtcal.support import checks
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError
from rtcal.support.types import Array, read_only

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
    directivity : mapping of str to Directivity or "unknown"
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
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        if self.mesh is not None:
            put("mesh", os.fspath(checks.path("mesh", self.mesh)))
            if not str(self.mesh).strip():
                raise DataError(f"mesh = {self.mesh!r} is not the name of a mesh's file")
        put("unit", checks.positive("unit", self.unit, "m"))
        if self.mesh is None and self.unit != 1:
            raise DataError(f"unit = {self.unit:g} is that of a mesh, and none is stated")
        for kind, other in (_POINTS, _POINTS[::-1]):
            put(kind, _points(kind, getattr(self, kind)))
            if getattr(self, kind) and not getattr(self, other):
                raise DataError(f"{other} is empty, and {kind} is not; state both or neither")
        put("directivity", directivities(self.directivity, self.sources))
        put("position_uncertainty", checked_uncertainty(self.position_uncertainty))
        surfaces = {}
        for name, faces in checks.mapped("surfaces", self.surfaces).items():
            place = f'surfaces["{text_name("surfaces", name)}"]'
            surfaces[name] = tuple(text_name(place, face) for face in checks.listed(place, faces))
        put("surfaces", surfaces)

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
                if isinstance(of, Directivity) and of.file is not None
                else of
                for name, of in self.directivity.items()
            },
        )

    def to_dict(self) -> dict[str, Any]:
        """Return its tables as plain values, without those that are not stated."""
        stated = {name: getattr(self, name) for name in GeometryTable.__struct_fields__}
        stated["surfaces"] = {name: list(faces) for name, faces in self.surfaces.items()}
        unstated = msgspec.structs.asdict(GeometryTable())
        tables = {
            "geometry": {k: v for k, v in stated.items() if v != unstated[k]},
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
                name: UNKNOWN if isinstance(of, str) else of.directivity(f'directivity["{name}"]')
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


LARGEST_INDEX = 25.0
"""Largest directivity index in dB. Horns for long throws have some 20 dB at 8 kHz."""
UPWARDS = (0.0, 0.0, 1.0)
_LEAST = (7, 4)
"""Fewest angles from the axis and about it: every 30 and every 90 degrees."""
_MOST = 361
_PARALLEL = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Directivity:
    """The energy that a loudspeaker radiates in each direction: an index's lobe, or a balloon.

    One of index, gains and file is stated.

    The energy of a lobe at the angle theta from the axis, over that of an omnidirectional source of the
    same power, is (n + 1) ((1 + cos theta) / 2)^n with n = 10^(index / 10) - 1 (docs/path_tracing.md).
    That of a balloon lies between its directions, linear in both angles.

    Parameters
    ----------
    index : float or array (n_bands,), optional
        Directivity index in dB per octave band, 0 (omnidirectional) to 25: the level on the axis less
        that of an omnidirectional source of the same power.
    aim : (x, y, z)
        Direction of the axis in the room's coordinates, of any length.
    gains : array (n_bands, n_theta, n_phi), optional
        Energy in any unit, at equal steps of the angle theta from the axis, 0 to 180 degrees with
        both ends, and of phi about it, 0 to 360 degrees without the end. phi is 0 above the axis and
        90 degrees to its left. Each band's mean over the sphere becomes 1.
    file : path, optional
        With the balloon, as `rtcal.io.balloon` reads it: SOFA or CLF's text. It is named and not read.
    up : (x, y, z)
        The direction that is above a balloon's axis, in the room's coordinates.

    Raises
    ------
    DataError
        For an index outside its range, gains that are no balloon, an aim of length 0, or a balloon
        that is aimed along ``up``.

    Notes
    -----
    The lobe is that of a first-order source (cardioid) for an index of 3 dB. It has no side lobes. A
    measured loudspeaker had 1.2, 0.5, 3, 7 and 7.7 dB from 250 Hz to 4 kHz (R3VIVAL, CC BY 4.0).

    Examples
    --------
    >>> speaker = Directivity(index=[0, 6], aim=(1, 0, 0))
    >>> print(speaker.gain([[1, 0, 0], [-1, 0, 0]]).round(2))
    [[1.   3.98]
     [1.   0.  ]]
    """

    index: Any = None
    aim: Sequence[float]
    gains: Any = None
    file: str | os.PathLike[str] | None = None
    up: Sequence[float] = UPWARDS

    def __post_init__(self) -> None:
        stated = sum(each is not None for each in (self.index, self.gains, self.file))
        if stated != 1:
            raise DataError(
                f"index: a directivity states {stated} of index, gains and file; it has one of them"
            )
        object.__setattr__(self, "aim", direction("aim", self.aim))
        object.__setattr__(self, "up", direction("up", self.up))
        if self.file is not None:
            object.__setattr__(self, "file", os.fspath(checks.path("file", self.file)))
            return
        if self.gains is not None:
            object.__setattr__(self, "gains", read_only(_balloon(self.gains)))
            self._axes()
            return
        if self.up != UPWARDS:
            raise DataError("up is of a balloon, and an index has none")
        index = np.atleast_1d(checks.array("index", self.index))
        if index.ndim != 1 or not index.size:
            raise DataError(f"index has shape {index.shape}; it is one value, or one per band")
        wrong = np.flatnonzero(~((index >= 0) & (index <= LARGEST_INDEX)))
        if wrong.size:
            raise DataError(
                f"index[{wrong[0]}] = {index[wrong[0]]:g} dB is not from 0 to {LARGEST_INDEX:g} dB"
            )
        object.__setattr__(self, "index", read_only(index))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Directivity):
            return NotImplemented
        same = (self.aim, self.up, self.file) == (other.aim, other.up, other.file)
        return same and np.array_equal(self.pattern, other.pattern)

    @property
    def pattern(self) -> Array:
        """The numbers of each band, (n_numbers, n_bands): bands with equal ones radiate alike."""
        if self.file is not None:
            return np.zeros((0, 1))
        if self.gains is None:
            return np.asarray(self.index[np.newaxis])
        return np.asarray(self.gains.reshape(len(self.gains), -1).T)

    @property
    def n_bands(self) -> int:
        """Number of its bands; 1 for an index that is one value."""
        return int(self.pattern.shape[1])

    def gain(self, directions: ArrayLike) -> Array:
        """Return the energy in each direction over an omnidirectional source's, (n, n_bands).

        ``directions`` (n, 3) have any length; n_bands is 1 for an index that is one value.
        """
        vectors = np.asarray(directions, dtype=float)
        vectors = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
        if self.gains is not None:
            return self._interpolated(vectors)
        cosine = vectors @ self.aim / np.linalg.norm(self.aim)
        power = 10 ** (self.index / 10)
        half = np.clip((1 + cosine) / 2, 0, 1)[..., np.newaxis]
        return np.asarray(power * half ** (power - 1))

    def _axes(self) -> Array:
        """Return the unit vectors along the axis, above it and to its left, (3, 3)."""
        along = np.array(self.aim) / np.linalg.norm(self.aim)
        up = np.array(self.up) / np.linalg.norm(self.up)
        above = up - (up @ along) * along
        if np.linalg.norm(above) < _PARALLEL:
            raise DataError(
                f"up = {checks.shown(self.up)} is along aim; it is what is above the axis"
            )
        above = above / np.linalg.norm(above)
        return np.array([along, above, np.cross(above, along)])

    def _interpolated(self, vectors: Array) -> Array:
        _, n_theta, n_phi = self.gains.shape
        along, above, left = np.moveaxis(vectors @ self._axes().T, -1, 0)
        row = np.arccos(np.clip(along, -1, 1)) / np.pi * (n_theta - 1)
        column = np.arctan2(left, above) / (2 * np.pi) % 1 * n_phi
        i, j = np.minimum(row.astype(int), n_theta - 2), column.astype(int) % n_phi
        down, over = row - i, column - np.floor(column)
        table, after = self.gains, (j + 1) % n_phi
        first = (1 - over) * table[:, i, j] + over * table[:, i, after]
        second = (1 - over) * table[:, i + 1, j] + over * table[:, i + 1, after]
        return np.asarray(np.moveaxis((1 - down) * first + down * second, 0, -1))

    def for_bands(self, n_bands: int, place: str) -> Directivity:
        """Return it for each of ``n_bands``; DataError if it has another number."""
        number = self.n_bands
        if number != n_bands and (number != 1 or self.gains is not None):
            name = "index" if self.gains is None else "gains"
            raise DataError(f"{place}.{name} has {number} values; the room has {n_bands} bands")
        if number == n_bands:
            return self
        return replace(self, index=np.broadcast_to(self.index, n_bands))

    def in_band(self, band: int) -> Directivity:
        """Return the directivity of one band, by its number."""
        if self.gains is not None:
            return replace(self, gains=self.gains[band : band + 1])
        return replace(self, index=self.index[band])

    def to_dict(self) -> dict[str, Any]:
        """Return index and aim, or gains or file, aim and up, as plain values of a room's file."""
        if self.file is not None:
            up = {} if self.up == UPWARDS else {"up": list(self.up)}
            return {"file": self.file, "aim": list(self.aim), **up}
        if self.gains is None:
            return {"index": self.index.tolist(), "aim": list(self.aim)}
        return {"gains": self.gains.tolist(), "aim": list(self.aim), "up": list(self.up)}


def direction(name: str, stated: Any) -> tuple[float, float, float]:
    """Return a direction of any length; DataError for anything else."""
    values = checks.array(name, stated)
    if values.shape != (3,) or not np.isfinite(values).all() or not np.linalg.norm(values) > 0:
        raise DataError(f"{name} = {checks.shown(stated)} is not a direction (x, y, z)")
    x, y, z = values.tolist()
    return x, y, z


def sphere_weights(n_theta: int) -> Array:
    """Return the share of the sphere that each angle from the axis stands for, (n_theta,).

    The mean over the sphere of what is linear between equal steps of theta, 0 to pi: the integrals of
    sin theta / 2 over the hat functions.
    """
    step = np.pi / (n_theta - 1)
    weights = np.sin(step * np.arange(n_theta)) * (1 - np.cos(step)) / step
    weights[[0, -1]] = (step - np.sin(step)) / (2 * step)
    return np.asarray(weights)


def _balloon(gains: Any) -> Array:
    """Return gains whose mean over the sphere is 1 in each band; DataError for what is no balloon."""
    table = checks.array("gains", gains)
    if (
        table.ndim != 3
        or not table.shape[0]
        or any(not least <= n <= _MOST for n, least in zip(table.shape[1:], _LEAST, strict=True))
    ):
        raise DataError(
            f"gains has shape {table.shape}; it is (n_bands, n_theta, n_phi), with at least "
            f"{_LEAST[0]} and {_LEAST[1]} angles and at most {_MOST}"
        )
    wrong = np.argwhere(~(np.isfinite(table) & (table >= 0)))
    if len(wrong):
        place = ", ".join(str(n) for n in wrong[0].tolist())
        raise DataError(f"gains[{place}] = {table[tuple(wrong[0])]:g} is not a number of 0 or more")
    mean = sphere_weights(table.shape[1]) @ table.mean(axis=2).T
    if not (mean > 0).all():
        raise DataError(f"gains[{int(np.argmin(mean))}] is 0 in all directions")
    # What was made 1 stays as it is, bit by bit.
    return np.asarray(np.where(np.abs(mean - 1) < 1e-12, 1.0, 1 / mean)[:, None, None] * table)


StatedDirectivity = Directivity | Literal["unknown"]
UNKNOWN: Literal["unknown"] = "unknown"
"""A source's directivity that nobody knows: it may be a loudspeaker, aimed anywhere."""


def directivities(
    stated: Mapping[str, Any], sources: Mapping[str, Any]
) -> dict[str, StatedDirectivity]:
    """Return the sources' directivities; DataError for one of no source or of another kind."""
    made: dict[str, StatedDirectivity] = {}
    for name, of in checks.mapped("directivity", stated).items():
        place = f'directivity["{text_name("directivity", name)}"]'
        if name not in sources:
            known = ", ".join(sources) or "none"
            raise DataError(f"{place} is of a source that is not stated; the sources are: {known}")
        if not isinstance(of, Directivity) and of != UNKNOWN:
            raise DataError(f'{place} = {checks.shown(of)} is not a Directivity or "{UNKNOWN}"')
        made[name] = of
    return made


class Lobe(FileTable):
    """A source's directivity in a room's file, of which one of index, gains and file is stated."""

    aim: Point
    index: Number | list[Number] | None = None
    gains: list[list[list[Number]]] | None = None
    file: str | None = None
    up: Point = UPWARDS

    def directivity(self, place: str) -> Directivity:
        """Return the directivity; DataError begins with ``place``."""
        try:
            return Directivity(**msgspec.structs.asdict(self))
        except DataError as error:
            raise DataError(f"{place}.{error}") from None


def plain_directivities(stated: Mapping[str, Any]) -> dict[str, Any]:
    """Return the sources' directivities as plain values, as a room's file states them."""
    return {name: UNKNOWN if isinstance(of, str) else of.to_dict() for name, of in stated.items()}
