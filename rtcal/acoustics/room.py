"""The room: its stated materials, surfaces, volume and air, and its file.

Also where its walls, sources and receivers are, and what its sources radiate in each direction.

docs/files.md describes the file, which is TOML with one ``[[material]]`` per material; `RoomFile` has
its keys.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import InitVar, asdict, dataclass, field, fields, replace
from functools import cached_property, partial
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal
from urllib.parse import quote, unquote

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.observables import OBSERVABLES, parameter_label
from rtcal.acoustics.priors import TIERS, SigmaRule
from rtcal.files.disk import read_text, write_text
from rtcal.files.schema import (
    FileTable,
    Number,
    Point,
    Share,
    expecting,
    read,
    toml_table,
    toml_text,
)
from rtcal.support import blocks, checks
from rtcal.support.blocks import Row, Table
from rtcal.support.checks import short_name, text_name
from rtcal.support.errors import DataError
from rtcal.support.text import first_of, shortened
from rtcal.support.types import Array, put, read_only

__all__ = [
    "AXES",
    "CalibrationRecord",
    "Directivity",
    "Material",
    "Piece",
    "Room",
    "Scene",
    "Surface",
]
__dir__ = __all__.copy

_POINTS = ("sources", "receivers")
POSITION = 0.1
"""Usual root mean square error of stated source and receiver positions, in m. Each coordinate has a
standard deviation sqrt(3) times smaller."""
MOST_OFF = 1.0
"""Largest root mean square error of positions that is accepted, in m."""
MAX_POINTS = 1000
"""Largest number of sources, and of receivers, in a room."""


class GeometryTable(FileTable):
    """Table ``geometry`` of a room's file."""

    mesh: str | None = None
    unit: Number = 1.0
    position_uncertainty: Number = POSITION
    leaks: bool = False
    surfaces: dict[str, list[str]] = {}


Places = Annotated[dict[str, Point], msgspec.Meta(min_length=1)]


class SceneTables(FileTable):
    """Tables of a room's file from which a `Scene` is made."""

    geometry: GeometryTable = msgspec.field(default_factory=GeometryTable)
    sources: Places | None = None
    receivers: Places | None = None
    directivity: dict[str, Directivity | Literal["unknown"]] = {}


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Geometry of a room for simulators: its mesh, its sources and its receivers.

    Parameters
    ----------
    mesh : path, optional
        File of the room's mesh (Wavefront OBJ), which is not read here. Without it the room is the box
        of its dimensions. In a room's file, the path is relative to that file.
    unit : float
        Length of the mesh's unit in m, such as 0.001 for mm.
    sources, receivers : mapping of str to (x, y, z)
        Positions in m, by the names that the measurement's pairs have. Give both, or neither.
    directivity : mapping of str to Directivity or "unknown"
        Directivity of each source; a source without one is taken as omnidirectional, and one that is
        "unknown" may be aimed anywhere. The path of `Directivity.file` is relative as that of the mesh.
    position_uncertainty : float
        Root mean square error of the positions in m, above 0 and at most 1.
    leaks : bool
        Whether the mesh may have small holes, as `rtcal import --leaks` writes; see
        `rtcal.simulators.Polyhedron`.
    surfaces : mapping of str to sequence of str
        Names of the mesh's faces that form each surface, by the name of the surface. By default
        coplanar faces of one material form a surface.

    Raises
    ------
    DataError
        If a value breaks a rule; the message names place, value and rule.

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
    leaks: bool = False
    surfaces: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.mesh is not None:
            put(self, mesh=os.fspath(checks.path("mesh", self.mesh)))
            if not str(self.mesh).strip():
                raise DataError(f"mesh = {self.mesh!r} must be the name of a mesh file")
        put(
            self,
            unit=checks.positive("unit", self.unit, "m"),
            leaks=checks.flag("leaks", self.leaks),
            position_uncertainty=checked_uncertainty(self.position_uncertainty),
            surfaces={
                text_name("surfaces", name): tuple(
                    text_name(f'surfaces["{name}"]', face)
                    for face in checks.listed(f'surfaces["{name}"]', faces)
                )
                for name, faces in checks.mapped("surfaces", self.surfaces).items()
            },
            **{kind: _points(kind, getattr(self, kind)) for kind in _POINTS},
        )
        put(self, directivity=directivities(self.directivity, self.sources))
        for name in ("unit", "leaks"):
            value = getattr(self, name)
            if self.mesh is None and value != getattr(Scene, name):
                raise DataError(
                    f"{name} = {checks.shown(value)} is of a mesh, but no mesh is given; give mesh, "
                    f"or leave {name} out"
                )
        for kind, other in (_POINTS, _POINTS[::-1]):
            if getattr(self, kind) and not getattr(self, other):
                raise DataError(f"{other} is empty, but {kind} is not; give both or neither")

    def __bool__(self) -> bool:
        """Whether anything is stated."""
        return self != Scene()

    def within(self, folder: str | os.PathLike[str]) -> Scene:
        """Return the scene with its relative paths joined to the folder of the room's file."""
        return self._with_files(lambda path: str(Path(folder) / path))

    def seen_from(self, folder: str | os.PathLike[str]) -> Scene:
        """Return the scene with paths relative to a folder (inverse of `within`)."""

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
        """Return the scene as plain values of the tables of a room's file, without empty tables."""
        usual = msgspec.structs.asdict(GeometryTable())
        stated = {name: getattr(self, name) for name in usual}
        stated["surfaces"] = {name: list(faces) for name, faces in self.surfaces.items()}
        tables = {
            "geometry": {k: v for k, v in stated.items() if v != usual[k]},
            **{kind: {n: list(p) for n, p in getattr(self, kind).items()} for kind in _POINTS},
            "directivity": plain_directivities(self.directivity),
        }
        return {name: table for name, table in tables.items() if table}

    @classmethod
    def of(cls, tables: SceneTables) -> Scene:
        """Return the scene from the tables of a room's file; DataError for the reasons of `Scene`."""
        return cls(
            **msgspec.structs.asdict(tables.geometry),
            sources=tables.sources or {},
            receivers=tables.receivers or {},
            directivity=tables.directivity,
        )


def checked_uncertainty(position_uncertainty: float) -> float:
    """Return the error of positions in m; DataError unless it is above 0 m and at most 1 m."""
    place = "position_uncertainty"
    return checks.between(
        place, checks.positive(place, position_uncertainty, "m"), 0, MOST_OFF, "m"
    )


def _points(kind: str, stated: Mapping[str, Sequence[float]]) -> dict[str, Point]:
    points = checks.mapped(kind, stated)
    if len(points) > MAX_POINTS:
        raise DataError(f"{len(points)} {kind}; a room may have at most {MAX_POINTS}")
    rule = "three finite numbers in m"
    return {n: _three(f'{kind}["{text_name(kind, n)}"]', p, rule) for n, p in points.items()}


def _three(place: str, stated: Any, rule: str) -> Point:
    """Return three finite numbers (x, y, z)."""
    values = checks.array(place, stated)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise DataError(f"{place} = {checks.shown(stated)} must be {rule}")
    x, y, z = values.tolist()
    return x, y, z


def direction(name: str, stated: Any) -> Point:
    """Return the direction ``stated`` as three numbers (x, y, z).

    Raises DataError, which has the ``name`` of the direction, for values that are not three finite
    numbers, and for the length 0.
    """
    point = _three(name, stated, rule := "a direction (x, y, z)")
    if not np.linalg.norm(point) > 0:
        raise DataError(f"{name} = {checks.shown(stated)} must be {rule}")
    return point


LARGEST_INDEX = 25.0
"""Largest directivity index in dB. Long-throw horns have some 20 dB at 8 kHz."""
UPWARDS = (0.0, 0.0, 1.0)
_LEAST = (7, 4)
"""Fewest angles from the axis and about it: every 30 and every 90 degrees."""
_MOST = 361
_PARALLEL = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Directivity:
    """Directivity of a loudspeaker: a directivity index with an axis, or a measured balloon.

    Exactly one of index, gains and file must be given. With an index, the energy at the angle theta
    from the axis, over that of an omnidirectional source of the same power, is
    (n + 1) ((1 + cos theta) / 2)^n with n = 10^(index / 10) - 1 (docs/path_tracing.md). A balloon is
    interpolated linearly in both angles.

    Parameters
    ----------
    index : float or array (n_bands,), optional
        Directivity index in dB per band, 0 (omnidirectional) to 25: the level on the axis minus that
        of an omnidirectional source of the same power.
    aim : (x, y, z)
        Direction of the axis in the room's coordinates, of any length.
    gains : array (n_bands, n_theta, n_phi), optional
        Radiated energy in any unit at equal steps of two angles: theta from the axis, 0 to 180 degrees
        with both ends, and phi about the axis, 0 to 360 degrees without the end. For an observer who
        looks along the axis, phi is 0 upwards (as ``up``) and 90 degrees to the left. Each band is
        scaled to a mean of 1 over the sphere.
    file : path, optional
        File of the balloon (SOFA, or text of CLF), which `rtcal.io.balloon` reads when it is needed.
    up : (x, y, z)
        Upward direction of a balloon in the room's coordinates, which must not be along ``aim``.

    Raises
    ------
    DataError
        For an index outside its range, gains of a wrong shape or value, an ``aim`` of length 0, or a
        balloon whose ``aim`` is along ``up``.

    Notes
    -----
    An index of 3 dB is about that of a cardioid. An index gives no side lobes. A measured loudspeaker
    had 1.2, 0.5, 3, 7 and 7.7 dB in the octaves from 250 Hz to 4 kHz (R3VIVAL, CC BY 4.0).

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
    file: Any = None
    up: Sequence[float] = UPWARDS

    def __post_init__(self) -> None:
        stated = sum(each is not None for each in (self.index, self.gains, self.file))
        if stated != 1:
            raise DataError(
                "a directivity must have exactly one of index, gains and file; this one "
                f"has {stated or 'none'}"
            )
        put(self, aim=direction("aim", self.aim), up=direction("up", self.up))
        if self.file is not None:
            put(self, file=os.fspath(checks.path("file", self.file)))
        elif self.gains is not None:
            put(self, gains=read_only(_balloon(self.gains)))
            self._axes()
        elif self.up != UPWARDS:
            raise DataError(
                "up can be given only with gains or a file, and this directivity has "
                "index: leave up out"
            )
        else:
            index = np.atleast_1d(checks.array("index", self.index))
            if index.ndim != 1 or not index.size:
                raise DataError(f"index has shape {index.shape}; give one value, or one per band")
            rule = f"from 0 to {LARGEST_INDEX:g} dB"
            checks.entries("index", index, (index >= 0) & (index <= LARGEST_INDEX), rule, "dB")
            put(self, index=read_only(index))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Directivity):
            return NotImplemented
        same = (self.aim, self.up, self.file) == (other.aim, other.up, other.file)
        return same and np.array_equal(self.pattern, other.pattern)

    @property
    def pattern(self) -> Array:
        """Directivity index in dB, (1, n_bands), or gains of the balloon, (n_directions, n_bands).

        For a balloon that is still in its file, the array is (0, 1).
        """
        if self.file is not None:
            return np.zeros((0, 1))
        if self.gains is None:
            return np.asarray(self.index[np.newaxis])
        return np.asarray(self.gains.reshape(len(self.gains), -1).T)

    @property
    def n_bands(self) -> int:
        """Number of bands; 1 if the index is a single value."""
        return int(self.pattern.shape[1])

    def gain(self, directions: ArrayLike) -> Array:
        """Return the energy in each direction over that of an omnidirectional source, (n, n_bands).

        ``directions`` (n, 3) are vectors of any length. n_bands is 1 if the index is a single value.
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
                f"up = {checks.shown(self.up)} is parallel to aim; give another direction, "
                "which is at the top when the source looks along aim"
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
        """Return the directivity with ``n_bands`` bands; an index that is one value holds in each.

        Raises DataError, which names the ``place`` of the directivity, for another number of bands.
        """
        if self.n_bands == n_bands:
            return self
        if self.n_bands == 1 and self.gains is None:
            return replace(self, index=np.broadcast_to(self.index, n_bands))
        name = "index" if self.gains is None else "gains"
        raise DataError(
            f"{place}.{name} has {self.n_bands} values; give one for each of the room's {n_bands} bands"
        )

    def in_band(self, band: int) -> Directivity:
        """Return the directivity in one band, given by its number."""
        if self.gains is not None:
            return replace(self, gains=self.gains[band : band + 1])
        return replace(self, index=self.index[band])

    def to_dict(self) -> dict[str, Any]:
        """Return the directivity as plain values of a room's file."""
        stated = {name: getattr(self, name) for name in ("file", "index", "gains", "aim", "up")}
        return {
            name: value if isinstance(value, str) else np.asarray(value).tolist()
            for name, value in stated.items()
            if value is not None and (name, value) != ("up", UPWARDS)
        }


def _balloon(gains: Any) -> Array:
    """Return gains whose mean over the sphere is 1 in each band; DataError for what is no balloon."""
    table = checks.array("gains", gains)
    if (
        table.ndim != 3
        or not table.shape[0]
        or any(not least <= n <= _MOST for n, least in zip(table.shape[1:], _LEAST, strict=True))
    ):
        raise DataError(
            f"gains has shape {table.shape}; it must be (n_bands, n_theta, n_phi), with at least "
            f"{_LEAST[0]} and {_LEAST[1]} angles and at most {_MOST}"
        )
    checks.entries("gains", table, np.isfinite(table) & (table >= 0), "finite and 0 or more")
    # The mean over the sphere of what is linear between the angles from the axis: integrals of
    # sin theta / 2 over the hat functions.
    step = np.pi / (table.shape[1] - 1)
    weights = np.sin(step * np.arange(table.shape[1])) * (1 - np.cos(step)) / step
    weights[[0, -1]] = (step - np.sin(step)) / (2 * step)
    mean = weights @ table.mean(axis=2).T
    if not (mean > 0).all():
        raise DataError(
            f"gains[{int(np.argmin(mean))}] is 0 in all directions; at least one must be above 0"
        )
    # What was made 1 stays as it is, bit by bit.
    return np.asarray(np.where(np.abs(mean - 1) < 1e-12, 1.0, 1 / mean)[:, None, None] * table)


StatedDirectivity = Directivity | Literal["unknown"]
UNKNOWN: Literal["unknown"] = "unknown"
"""Directivity of a source that nobody knows: it may be a loudspeaker that is aimed anywhere."""


def directivities(
    stated: Mapping[str, Any], sources: Mapping[str, Any]
) -> dict[str, StatedDirectivity]:
    """Return the ``stated`` directivities, by source, once they are checked.

    Raises DataError for a source that is not among ``sources``, and for a value that is neither a
    `Directivity` nor "unknown".
    """
    made: dict[str, StatedDirectivity] = checks.mapped("directivity", stated)
    for name, of in made.items():
        place = f'directivity["{text_name("directivity", name)}"]'
        if name not in sources:
            known = ", ".join(sources) or "none"
            raise DataError(
                f"{place}: the room has no source of this name; its sources are: {known}"
            )
        if not isinstance(of, Directivity) and of != UNKNOWN:
            raise DataError(f'{place} = {checks.shown(of)} is not a Directivity or "{UNKNOWN}"')
    return made


def plain_directivities(stated: Mapping[str, Any]) -> dict[str, Any]:
    """Return directivities, by source, as plain values of the table ``directivity`` of a file."""
    return {name: UNKNOWN if isinstance(of, str) else of.to_dict() for name, of in stated.items()}


AXES = ("x", "y", "z")


PerBand = Number | Sequence[Number]


@dataclass(frozen=True)
class Material:
    """Material of a room with its absorption coefficients and their uncertainty.

    Parameters
    ----------
    name : str
        Name of the material.
    alpha : sequence (n_bands,)
        Random-incidence absorption coefficients, 0 to 1.
    sigma : float, sequence (n_bands,), or {"low", "moderate", "high"}
        Standard deviation of each coefficient; 0 for an exact coefficient. The three words stand for
        0.01, 0.05 and 0.1 (Bellows & Katz 2025). sigma may be left out only if the room has a rule for
        it (table ``[prior]`` of its file).
    alpha_min : float or sequence (n_bands,)
        Lower bound of the calibrated coefficient, 0 by default.
    scattering : float or sequence (n_bands,), optional
        Random-incidence scattering coefficients, 0 to 1; only simulators use them.
    source : str
        Source of the coefficients.
    area : float, optional
        Area in m². Give it only for a material that no `Surface` of the room has.
    area_sigma : float or str, optional
        Relative standard deviation of the area, or the standard deviation in m²: "1.5 m²".
    """

    name: str
    alpha: Sequence[Number]
    sigma: PerBand | Literal["low", "moderate", "high"] | None = None
    alpha_min: PerBand = 0.0
    scattering: PerBand | None = None
    source: str = ""
    area: Number | None = None
    area_sigma: Number | str | None = None


_OF_PIECE = {
    "name": "name",
    "area": "number",
    "alpha": "area_per_piece",
    "sigma": "sigma",
    "area_sigma": "number_sigma",
    "source": "source",
}
"""Fields of a `Material` with those of a `Piece` that stand in them."""


@dataclass(frozen=True)
class Piece:
    """Persons, seats or other objects of one kind, with their number and the absorption area of one.

    Such pieces are no surfaces: the mean coefficient of a room is (sum alpha_i S_i + sum n_j a_j) / S,
    where S is the area of the surfaces alone, n_j a number of pieces and a_j the absorption area of one
    (Kuttruff, Room Acoustics, on absorption by people). Sabine's A is then that of EN 12354-6. A
    calibration changes the absorption area of one piece as it changes a coefficient.

    Parameters
    ----------
    name : str
        Name of the objects.
    number : float
        Number of the objects, above 0. A room refuses objects that absorb more, in any band, than its
        surfaces would with alpha = 1.
    area_per_piece : sequence (n_bands,)
        Equivalent absorption area of one object in m² (ISO 354), 0 to 10.
    sigma : float or sequence (n_bands,)
        Standard deviation of the absorption area of one object in m²; 0 for an exact value. It may be
        left out only if the room has a rule for it (table ``[prior]`` of its file).
    source : str
        Source of the absorption areas.
    number_sigma : float
        Relative standard deviation of the number.

    Examples
    --------
    >>> wall = Material("wall", [0.05], [0.02], area=150)
    >>> room = Room.from_surfaces(name="class", volume=120, centre_frequencies=[1000],
    ...                           materials=[wall], objects=[Piece("persons", 20, [0.6], 0.1)])
    >>> room.total_area, room.absorption_area.tolist()
    (150.0, [19.5])
    """

    name: str
    number: Number
    area_per_piece: Sequence[Number]
    sigma: PerBand | None = None
    source: str = ""
    number_sigma: Number = 0.0

    def as_material(self, scattering: float | None = None) -> Material:
        """Return the pieces as a `Material`: their number as its area, the area of one as its alpha.

        ``scattering`` is the material's scattering coefficient; None if the room has none.
        """
        stated = {key: getattr(self, name) for key, name in _OF_PIECE.items()}
        return Material(**stated, scattering=scattering)

    def with_sigma(self, rule: SigmaRule | None) -> Piece:
        """Return the pieces with their own sigma or, if they have none, with the sigma of a rule.

        The rule gives in_situ_factor * max(relative * area_per_piece, minimum) in m². Its part of ISO
        12999-2 is not used, because it is for coefficients. Raises DataError if the pieces have no
        sigma and ``rule`` is None.
        """
        if self.sigma is not None:
            return self
        if rule is None:
            raise DataError(
                f'object "{self.name}" has no sigma, and the file has no [prior] from which it could '
                "follow; add one of them. If in doubt, write sigma = 0.3 times area_per_piece"
            )
        area = checks.array(f'area_per_piece["{self.name}"]', self.area_per_piece)
        sigma = rule.in_situ_factor * np.maximum(rule.relative * area, rule.minimum)
        return replace(self, sigma=np.minimum(sigma, LARGEST_PIECE).tolist())


@dataclass(frozen=True)
class Surface:
    """Surface of a room: its name, that of its material, its area in m², above 0, and its axis.

    ``axis`` is ``"x"``, ``"y"`` or ``"z"``, that of the normal. Only equations that treat the axes
    apart (Fitzroy, Arau-Puchades) need it.
    """

    name: str
    material: str
    area: float
    axis: str | None = None

    def __post_init__(self) -> None:
        text_name("surface name", self.name)
        text_name("surface material", self.material)
        place = f'surface["{self.name}"]'
        put(self, area=checks.positive(f"{place}.area", self.area, "m²"))
        if self.axis is not None:
            checks.choice(f"{place}.axis", self.axis, AXES)


def refuse_too_many(place: str, number: float, area_per_piece: ArrayLike, surface: float) -> None:
    """Raise DataError, with ``place``, if pieces absorb more than ``surface`` m² of alpha = 1 would.

    ``area_per_piece`` (n_bands,) is in m².
    """
    absorbed = number * float(np.max(area_per_piece, initial=0.0))
    if absorbed > surface:
        raise DataError(
            f"{place} = {number:g} is too large: the pieces would absorb {absorbed:.4g} m², and the "
            f"room's surfaces have {surface:.4g} m²"
        )


def with_patches(
    surfaces: Sequence[Surface], patches: Iterable[tuple[str, str, float]]
) -> list[Surface]:
    """Return surfaces of which parts have other materials, such as a window in a wall.

    Each patch is (name of the surface, material, area in m²). The area of a patch is taken from its
    surface, and the name of a patch contains that of its surface, so that `lying_on` finds it. Raises
    DataError for an unknown surface, and if the patches are larger than their surface.

    Examples
    --------
    >>> west = Surface("west", "plaster", 21.0, "x")
    >>> [surface.area for surface in with_patches([west], [("west", "glass", 4.5)])]
    [16.5, 4.5]
    """
    left = {surface.name: surface for surface in surfaces}
    pieces: list[Surface] = []
    for name, material, area in patches:
        if name not in left:
            raise DataError(f'"{name}" is not a surface; the surfaces are {", ".join(left)}')
        whole = left[name]
        patch = Surface(f"{name}: {material}", material, area, whole.axis)
        if not patch.area < whole.area:
            raise DataError(
                f'"{name}" has {whole.area:.6g} m² left, and a patch must be smaller; {material} '
                f'has {patch.area:g} m². If {material} covers all of "{name}", give it as '
                f'the material of "{name}"'
            )
        left[name] = replace(whole, area=whole.area - patch.area)
        pieces.append(patch)
    return [*left.values(), *pieces]


def lying_on(surfaces: Sequence[Surface], material: str) -> dict[str | None, float]:
    """Return the area in m² of a material that lies on each other material, by the other's name.

    ``surfaces`` are all surfaces of the room, and ``material`` is the name of the material. A surface
    that is named "floor: audience" lies on the surface "floor", as `with_patches` names it.
    The part of the material's area that lies on no other surface has the key None.

    Examples
    --------
    >>> floor = with_patches([Surface("floor", "carpet", 63.0, "z")], [("floor", "audience", 40)])
    >>> lying_on(floor, "audience"), lying_on(floor, "carpet")
    ({'carpet': 40.0}, {None: 23.0})
    """
    by_name = {surface.name: surface.material for surface in surfaces}
    areas: dict[str | None, float] = {}
    for surface in surfaces:
        if surface.material == material:
            whole = surface.name.removesuffix(f": {material}")
            below = by_name.get(whole) if whole != surface.name else None
            areas[below] = areas.get(below, 0.0) + surface.area
    return areas


ARCHIVE = "archive"
"""Method named in the record of a room whose coefficients come from an archive of other rooms."""
CHANGED = "changed"
"""Method named in the record of a room whose coefficients were changed after their calibration."""
_SAME = 1e-4
"""Largest difference of equal values, relative above 1: a program that converts changes less."""


@dataclass(frozen=True)
class CalibrationRecord:
    """Record in a room of how its coefficients were calibrated, or of the archive that they are from.

    ``method`` is the calibration method, "archive" for coefficients of an `rtcal.archive.Archive`, or
    "changed" if coefficients were changed after their calibration. ``equation`` is the name of the
    reverberation equation, ``solver`` that of the solver, and ``version`` rtcal's version. ``measured``
    identifies, per band, each T that was used: a second calibration of the room to the same T raises an
    error, because T would count twice.
    """

    method: str
    equation: str
    measured: str
    solver: str = ""
    version: str = ""


LEAST, LARGEST = 1e-9, 1e9
"""Smallest and largest volume of a room in m³, and largest area in m². No building comes near them."""
LARGEST_LABORATORY_ALPHA = 2.0
"""Largest coefficient above 1 that is taken for a laboratory's. ISO 354 gives up to some 1.3 for thick
absorbers of 10 m² (edge effect); small objects give more."""
LARGEST_PIECE = 10.0
"""Largest absorption area of one piece in m². A person has some 1 m²; more is that of all pieces."""
LEAST_SIGMA = 1e-150
"""Smallest standard deviation above 0 that is accepted: the square of a smaller one rounds to 0."""
RELATIVE = ("volume_sigma", "common_area_sigma", "common_alpha_sigma")


def _relative(place: str, value: object) -> float:
    """Return a relative value; DataError unless it is 0 or more and below 1."""
    stated = checks.number(place, value)
    if not 0 <= stated < 1:
        percent = checks.IN_PERCENT if 1 <= stated <= 100 else ""
        raise DataError(f"{place} = {stated:g} must be from 0 to below 1{percent}")
    return stated


def _area_sigma(place: str, stated: object, area: float) -> float:
    """Return the relative standard deviation of an area in m², which a text states in m²."""
    if not isinstance(stated, str):
        return _relative(place, stated)
    number, unit, rest = stated.partition("m²")
    square_metres = np.nan
    with suppress(ValueError):
        square_metres = float(number)
    if not unit or rest.strip() or not 0 <= square_metres < area:
        raise DataError(
            f'{place} = "{stated[:40]}" must be a number with the unit m² (written with ²), from 0 to '
            f'below the area of {area:g} m², such as "1.5 m²", or a share of the area as a number '
            "without quotes, such as 0.1"
        )
    return square_metres / area


@dataclass(frozen=True, kw_only=True, eq=False)
class Room:
    """Room with its volume, and its materials with area, absorption coefficients and their uncertainty.

    Each material is one row of the arrays, and a calibration finds one coefficient per row and band. A
    material that covers several surfaces is one row with the sum of their areas, which
    `Room.from_surfaces` calculates. Arrays by material may also be given as a mapping, such as
    ``areas={"floor": 20, "rest": 74}``.

    Parameters
    ----------
    name : str
        Name of the room.
    volume : float
        Volume in m³, from 1e-9 to 1e9.
    materials : sequence of str (n_materials,)
        Names of the materials, all different.
    areas : array (n_materials,)
        Area of each material in m², above 0.
    alpha : array (n_materials, n_bands)
        Absorption coefficients, 0 to 1: the input values before a calibration, the calibrated
        coefficients after it.
    sigma : array (n_materials, n_bands)
        Standard deviations of the coefficients, 0 to 1; a coefficient with 0 is not calibrated.
    centre_frequencies : array (n_bands,)
        Centre frequencies in Hz, increasing. A frequency within 1.5 % of a nominal third-octave centre
        is replaced by it.
    air : Air, optional
        Air in the room. Without it the air absorbs nothing, which is wrong above about 1 kHz.
    alpha_min : array (n_materials, n_bands), optional
        Lower bounds of the calibrated coefficients; 0 by default.
    scattering : array (n_materials, n_bands), optional
        Scattering coefficients of the materials, 0 to 1, for simulators.
    scattering_model : {"random", "vector"}
        Meaning of the scattering coefficients; see `rtcal.simulators.path_tracing.ScatteringModel`.
    surfaces : sequence of Surface
        Single surfaces, if they are known; ``areas`` must be the sums of their areas.
    dimensions : (x, y, z), optional
        Length, width and height of a shoebox, in m, for simulators.
    scene : Scene
        Mesh, sources and receivers, for simulators; empty by default.
    sources : mapping of str to str
        Source of the coefficients of each material, such as a handbook.
    band_correlation : float
        Correlation of the errors of one material's coefficients in bands an octave apart, 0 to below 1.
        Bands n octaves apart have band_correlation ** n.
    material_correlation : mapping of (material, material) to float
        Correlation of the errors of two materials' coefficients in the same band, for materials that
        share a source or a mounting.
    above_one : {"refuse", "clip"}
        Whether coefficients above 1, which laboratories report (ISO 354: the edges of the specimen
        absorb too), raise an error or are set to 1 and listed in ``clipped``.
    calibration : CalibrationRecord, optional
        Record of the calibration, in a room that a calibration or
        `rtcal.calibration.archive.Archive.apply` returns.
    author : str
        Name of the author of the model, for pages with results.
    volume_sigma : float
        Relative standard deviation of the volume, 0 (exact) to below 1.
    area_sigma : float, or array or mapping (n_materials,)
        Relative standard deviation of each material's area, independent of the others. A mapping may
        also state m²: ``{"curtain": "1.5 m²"}``. Materials that it lacks have an exact area.
    common_area_sigma : float
        Relative standard deviation that all areas have in common, such as that of a drawing's scale.
    common_alpha_sigma : float
        Relative standard deviation that all coefficients have in common: all may be too high or too
        low.
    climate_sigma : (temperature, humidity)
        Standard deviations of the air's temperature in K and relative humidity in %.
    pieces : sequence of str
        Names of the materials that are pieces (`Piece`) and no surfaces. Their ``areas`` are numbers of
        pieces; ``alpha``, ``sigma`` and ``alpha_min`` are the absorption area of one piece in m².

    Raises
    ------
    DataError
        If a shape or a value breaks a rule; the message names place, value and rule.

    Examples
    --------
    >>> room = Room(name="box", volume=60, materials=["floor", "rest"], areas=[20, 74],
    ...             alpha=[[0.4], [0.6]], sigma=[[0.1], [0.1]], centre_frequencies=[1000])
    >>> print(room.absorption_area)
    [52.4]
    """

    name: str
    volume: float
    materials: Sequence[str]
    areas: Array
    alpha: Array
    sigma: Array
    centre_frequencies: Array
    air: Air | None = None
    alpha_min: Array | None = None
    scattering: Array | None = None
    scattering_model: Literal["random", "vector"] = "random"
    surfaces: Sequence[Surface] = ()
    dimensions: tuple[float, float, float] | None = None
    scene: Scene = field(default_factory=Scene)
    sources: Mapping[str, str] = field(default_factory=dict)
    band_correlation: float = 0.0
    material_correlation: Mapping[tuple[str, str], float] = field(default_factory=dict)
    calibration: CalibrationRecord | None = None
    author: str = ""
    volume_sigma: float = 0.0
    area_sigma: Array = 0.0  # type: ignore[assignment]
    common_area_sigma: float = 0.0
    common_alpha_sigma: float = 0.0
    climate_sigma: tuple[float, float] = (0.0, 0.0)
    above_one: InitVar[str] = "refuse"
    clipped: tuple[str, ...] = ()
    pieces: tuple[str, ...] = ()

    def __post_init__(self, above_one: str) -> None:
        checks.choice("above_one", above_one, ("refuse", "clip"))
        checks.choice("scattering_model", self.scattering_model, ("random", "vector"))
        checks.instance("scene", self.scene, Scene)
        for name, kind in (("air", Air), ("calibration", CalibrationRecord)):
            if getattr(self, name) is not None:
                checks.instance(name, getattr(self, name), kind)
        listed = checks.listed("materials", self.materials)
        put(
            self,
            name=text_name("name", self.name),
            author=short_name("author", self.author),
            volume=checks.between("volume", self.volume, LEAST, LARGEST, "m³"),
            centre_frequencies=read_only(bands.as_bands(self.centre_frequencies)),
            materials=tuple(text_name("materials", m) for m in listed),
            pieces=checks.listed("pieces", self.pieces),
            surfaces=checks.instances("surfaces", self.surfaces, Surface),
            sources=checks.mapped("sources", self.sources),
            material_correlation=checks.mapped("material_correlation", self.material_correlation),
            **{n: _relative(n, getattr(self, n)) for n in (*RELATIVE, "band_correlation")},
        )
        self._check_names()
        areas = in_order("areas", self.areas, self.materials)
        put(self, areas=checks.shaped("areas", areas, self.n_materials))
        checks.entries(
            lambda i: f'areas["{self.materials[i]}"]',
            self.areas,
            (self.areas > 0) & (self.areas <= LARGEST),
            f"above 0 and at most {LARGEST:g} m²",
            "m²",
        )
        for name in ("alpha", "sigma", "scattering", "alpha_min"):
            if getattr(self, name) is not None:
                self._put_coefficients(name, clip=(name, above_one) == ("alpha", "clip"))
        least = self.least_alpha
        checks.entries(
            partial(self.place, "alpha"),
            self.alpha,
            self.alpha >= least,
            lambda i, k: f"at least alpha_min = {least[i, k]:g}, its lower bound",
        )
        if self.dimensions is not None:
            sides = checks.shaped("dimensions", self.dimensions, 3).tolist()
            put(self, dimensions=tuple(checks.positive("dimensions", s, "m") for s in sides))
        put(self, area_sigma=self._area_errors())
        climate = checks.shaped("climate_sigma", self.climate_sigma, 2).tolist()
        for value, most, unit in zip(climate, (20, 50), ("K", "%"), strict=True):
            checks.between("climate_sigma", value, 0, most, unit)
        put(self, climate_sigma=tuple(climate))
        if self.air is None and any(climate):
            raise DataError("climate_sigma is given, but the room has no air; give air, too")
        self._check_surfaces()
        self._check_correlation()

    def _check_names(self) -> None:
        """Raise DataError for no material, and for names that are blank, given twice or look alike."""
        if not self.materials:
            raise DataError("materials is empty; a room must have at least one material")
        if blank := [m for m in self.materials if not m.strip()]:
            raise DataError(f"materials has {blank[0]!r}; a name must not be blank")
        checks.distinct("materials", self.materials, "give each once, with its total area")
        if alike := checks.look_alike(self.materials):
            raise DataError(f'materials has "{alike[0]}" and "{alike[1]}", {checks.LOOKS}')
        for name in self.pieces:
            self.material_index(name, "pieces: ")
        if not self.is_surface.any():
            raise DataError(
                "every material of the room is a piece ([[object]]); a room must have at "
                "least one material with an area"
            )

    def _put_coefficients(self, name: str, clip: bool) -> None:
        """Check and set a table (n_materials, n_bands); ``clip`` makes laboratory values above 1 1."""
        stated = in_order(name, getattr(self, name), self.materials)
        table = checks.shaped(name, stated, self.n_materials, self.n_bands)
        if clip:
            above = (table > self.most_alpha) & (table <= LARGEST_LABORATORY_ALPHA)
            cut = [f"{self.place(name, i, k)} = {table[i, k]:g}" for i, k in np.argwhere(above)]
            put(self, clipped=(*self.clipped, *cut))
            table = read_only(np.where(above, 1.0, table))

        def rule(i: int, k: int) -> str:
            value = table[i, k]
            if not self.is_surface[i]:
                return f"from 0 to {LARGEST_PIECE:g} m², the absorption area of one piece"
            if name == "sigma" and 0 < value < LEAST_SIGMA:
                return f"{LEAST_SIGMA:g} or more, or 0 for a coefficient that is known exactly"
            if name == "alpha" and 1 < value <= LARGEST_LABORATORY_ALPHA:
                return f"from 0 to 1{above_one_hint(value)}"
            return f"from 0 to 1{checks.IN_PERCENT if 1 < value <= 100 else ''}"

        allowed = (table >= 0) & (table <= self.most_alpha)
        if name == "sigma":
            allowed &= (table == 0) | (table >= LEAST_SIGMA)
        checks.entries(partial(self.place, name), table, allowed, rule)
        put(self, **{name: table})

    def _check_surfaces(self) -> None:
        """Raise DataError unless the surfaces, if there are any, add up to the stated areas."""
        drawn = np.zeros(self.n_materials)
        for surface in self.surfaces:
            place = f'surface["{surface.name}"].material: '
            drawn[self.material_index(surface.material, place)] += surface.area
        differ = self.is_surface & ~np.isclose(drawn, self.areas, rtol=1e-9, atol=0)
        if self.surfaces and differ.any():
            i = int(np.argmax(differ))
            raise DataError(
                f'areas["{self.materials[i]}"] = {self.areas[i]:g} m², but its surfaces sum to '
                f"{drawn[i]:g} m²; make them equal, or leave the surfaces out (surfaces=())"
            )

    def _check_correlation(self) -> None:
        """Raise DataError unless the prior correlations of materials are possible ones."""
        between: dict[tuple[int, int], float] = {}
        for pair, value in self.material_correlation.items():
            if not isinstance(pair, tuple) or len(pair) != 2:
                raise DataError(
                    f"material_correlation has {pair!r}; give each key as a pair of materials"
                )
            place = f'material_correlation["{pair[0]}", "{pair[1]}"]'
            i, j = (self.material_index(name, f"{place}: ") for name in pair)
            if i == j or not -1 < checks.number(place, value) < 1:
                raise DataError(
                    f"{place} = {value:g} must be between -1 and 1, for two different materials"
                )
            between[i, j] = between[j, i] = value
        named = sorted({i for i, _ in between})
        matrix = np.array([[between.get((i, j), float(i == j)) for j in named] for i in named])
        if named and np.linalg.eigvalsh(matrix)[0] <= 0:
            raise DataError(
                "material_correlation is not positive definite: its values contradict each "
                "other; make the correlations smaller"
            )

    def _area_errors(self) -> Array:
        """Return the relative standard deviation of each area, (n_materials,), however it is stated."""
        stated: Any = self.area_sigma
        if isinstance(stated, Mapping):
            for name in stated:
                self.material_index(name, f'area_sigma["{name}"]: ')
            stated = [stated.get(name, 0.0) for name in self.materials]
        elif not isinstance(stated, list | tuple | np.ndarray) or not np.ndim(stated):
            stated = [stated if on else 0.0 for on in self.is_surface]
        elif isinstance(stated, np.ndarray) and not stated.any():
            stated = [0.0] * self.n_materials  # also of a room that had other materials
        if len(stated) != self.n_materials:
            raise DataError(
                f"area_sigma has {len(stated)} values; give one for each of the "
                f"{self.n_materials} materials"
            )
        each = zip(self.materials, stated, self.areas.tolist(), strict=True)
        return read_only(np.array([_area_sigma(f'area_sigma["{m}"]', s, a) for m, s, a in each]))

    def __repr__(self) -> str:
        return f"<{self._description}>"

    def _repr_html_(self) -> str:
        """Return a table of alpha ± sigma per material and band, darker where more is absorbed."""
        rows = []
        for i, (name, area) in enumerate(zip(self.materials, self.areas, strict=True)):
            pairs = zip(self.alpha[i], self.sigma[i], strict=True)
            unit = "" if name not in self.pieces else " pieces"
            cells = [f"{area:.4g}{unit}", *(f"{alpha:.3f} ± {sigma:.3f}" for alpha, sigma in pairs)]
            rows.append(Row(name, cells, shade=[0.0, *self.alpha[i]]))
        columns = ["S / m²", *bands.labels(self.centre_frequencies)]
        return blocks.notebook(self._description, [Table(columns, rows, corner="α ± σ")])

    @property
    def _description(self) -> str:
        calibrated = ""
        if self.calibration is not None:
            from_archive = self.calibration.method == ARCHIVE
            calibrated = ", coefficients of an archive" if from_archive else ", calibrated"
        return (
            f'Room "{shortened(self.name)}": {self.volume:.4g} m³, {self.total_area:.4g} m², '
            f"{self.n_materials} material{'s' * (self.n_materials > 1)}, "
            f"{bands.span(self.centre_frequencies)}{calibrated}"
        )

    @property
    def n_materials(self) -> int:
        """Number of materials, the rows of ``alpha``."""
        return len(self.materials)

    @property
    def n_bands(self) -> int:
        """Number of bands, the columns of ``alpha``."""
        return len(self.centre_frequencies)

    @cached_property
    def is_surface(self) -> NDArray[np.bool_]:
        """Whether each material is a surface and not a piece, (n_materials,)."""
        return np.array([m not in self.pieces for m in self.materials])

    @cached_property
    def total_area(self) -> float:
        """Total area S of the surfaces in m²."""
        return float(np.sum(self.areas[self.is_surface]))

    @property
    def absorption_area(self) -> Array:
        """Equivalent absorption area of surfaces and pieces in m², (n_bands,)."""
        return np.asarray(self.areas @ self.alpha)

    @property
    def area_of_pieces(self) -> Array:
        """Equivalent absorption area of the pieces in m², (n_bands,)."""
        return np.asarray(self.areas[~self.is_surface] @ self.alpha[~self.is_surface])

    @property
    def without_pieces(self) -> Room:
        """Room with its surfaces alone, without pieces such as persons."""
        if not self.pieces:
            return self
        return self.with_rows([self.material(m) for m in self.materials if m not in self.pieces])

    def refuse_pieces(self, what: str) -> None:
        """Raise DataError if the room has pieces: its message is that ``what`` takes only surfaces."""
        if self.pieces:
            raise DataError(
                f'{what} takes only surfaces, but room "{self.name}" has the [[object]] '
                f'"{self.pieces[0]}". Leave it out, or give a [[material]] with an area '
                "instead"
            )

    @cached_property
    def air_attenuation(self) -> Array:
        """Energy attenuation of the air m in 1/m, (n_bands,); 0 in a room without air."""
        if self.air is None:
            return read_only(np.zeros(self.n_bands))
        return read_only(self.air.attenuation(self.centre_frequencies))

    @cached_property
    def is_uncertain(self) -> bool:
        """Whether the room states an uncertainty of its volume, areas or climate."""
        stated = (self.volume_sigma, self.common_area_sigma, *self.climate_sigma)
        return any(stated) or bool(self.area_sigma.any())

    @property
    def as_exact(self) -> Room:
        """Room with an exact volume, exact areas and an exact climate."""
        if not self.is_uncertain:
            return self
        return self.replace(
            volume_sigma=0.0, area_sigma=0.0, common_area_sigma=0.0, climate_sigma=(0.0, 0.0)
        )

    @cached_property
    def speed_of_sound(self) -> float:
        """Speed of sound in the room's air in m/s; that at 20 °C in a room without air."""
        return (self.air or Air()).speed_of_sound

    def with_air(self, air: Air | None) -> Room:
        """Return the room with other air, to predict T there with the same coefficients.

        With ``air`` None, the air absorbs nothing, and the room has no uncertainty of the climate
        either.
        """
        sigma = (0.0, 0.0) if air is None else self.climate_sigma
        return self.replace(air=air, climate_sigma=sigma)

    def in_bands(self, wanted: Iterable[float]) -> Room:
        """Return the room with its coefficients converted to other bands, octaves or third-octaves.

        ``wanted`` are the centre frequencies of these bands in Hz. Raises DataError if the room lacks a
        third-octave of a wanted octave, or the octave of a wanted third-octave.
        """
        conversion = bands.Conversion(self.centre_frequencies, wanted)
        tables = {n: getattr(self, n) for n in ("alpha", "sigma", "alpha_min", "scattering")}
        converted = {n: conversion.mean(t) for n, t in tables.items() if t is not None}
        return self.replace(centre_frequencies=conversion.new, **converted)

    def place(self, name: str, material: int, band: int) -> str:
        """Return the name of a value in messages, such as ``alpha["carpet", 500 Hz]``.

        ``name`` is the name of the array, ``material`` and ``band`` are the value's indices in it.
        """
        frequency = bands.label(self.centre_frequencies[band])
        return f'{name}["{self.materials[material]}", {frequency}]'

    def material_index(self, name: str, place: str = "") -> int:
        """Return the row of a material in the room's arrays, counted from 0, by its name.

        Raises DataError if the room has no material of this name; the message begins with ``place``.
        """
        if name not in self.materials:
            known = ", ".join(self.materials)
            raise DataError(
                f'{place}"{name}" is not a material of room "{self.name}", which has {known}'
            )
        return self.materials.index(name)

    def material(self, name: str) -> Material:
        """Return a material by its name, with its area; DataError if the room has none of this name."""
        row = self.material_index(name)
        return Material(
            name,
            self.alpha[row].tolist(),
            self.sigma[row].tolist(),
            0.0 if self.alpha_min is None else self.alpha_min[row].tolist(),
            None if self.scattering is None else self.scattering[row].tolist(),
            self.sources.get(name, ""),
            float(self.areas[row]),
            float(self.area_sigma[row]),
        )

    def with_rows(self, rows: Sequence[Material], **changes: Any) -> Room:
        """Return the room with the materials ``rows`` in place of its own; each must have its area.

        ``changes`` are new values of other fields of the room, as in `replace`. The room keeps
        scattering coefficients only if all materials have them.

        Examples
        --------
        >>> room = Room(name="box", volume=60, materials=["wall"], areas=[94], alpha=[[0.1]],
        ...             sigma=[[0.02]], centre_frequencies=[1000])
        >>> panel = Material("panel", [0.9], [0.1], area=10)
        >>> print(room.with_rows([room.material("wall"), panel]).absorption_area)
        [18.4]
        """
        names = {m.name for m in rows}
        stated = {
            **of_materials(rows, self.centre_frequencies),
            "areas": [m.area for m in rows],
            "area_sigma": [m.area_sigma or 0.0 for m in rows],
            "material_correlation": {
                pair: r for pair, r in self.material_correlation.items() if names.issuperset(pair)
            },
            "pieces": [name for name in self.pieces if name in names],
        }
        return self.replace(**(stated | changes))

    @property
    def least_alpha(self) -> Array:
        """Lower bounds of the coefficients in a calibration, (n_materials, n_bands)."""
        return np.zeros_like(self.alpha) if self.alpha_min is None else self.alpha_min

    @property
    def most_alpha(self) -> Array:
        """Upper bounds of the coefficients in a calibration, (n_materials, n_bands).

        The bound is 1 for a surface, and 10 m² (`LARGEST_PIECE`) for the absorption area of one piece.
        """
        most = np.where(self.is_surface, 1.0, LARGEST_PIECE)
        return np.broadcast_to(most[:, np.newaxis], (self.n_materials, self.n_bands))

    def material_rows(self, names: Sequence[str]) -> NDArray[np.int64]:
        """Return the row number of each material by its name, (n,); DataError for an unknown name."""
        return np.array([self.material_index(name) for name in names], dtype=np.int64)

    def replace(self, **changes: Any) -> Room:
        """Return the room with some fields changed; all rules are checked again.

        ``changes`` are the new values by field. Raises DataError for the reasons of `Room`, and for a
        field that a room does not have.
        """
        try:
            return replace(self, **changes)
        except TypeError as error:
            raise DataError(f"this change of the room is not possible: {error}") from error

    @classmethod
    def from_surfaces(
        cls,
        *,
        materials: Iterable[Material],
        centre_frequencies: Sequence[float] | Array,
        surfaces: Iterable[Surface] = (),
        objects: Iterable[Piece] = (),
        prior: SigmaRule | None = None,
        **stated: Any,
    ) -> Room:
        """Return a room from its materials and single surfaces, whose areas are summed per material.

        Parameters
        ----------
        materials : sequence of Material
            Materials, each with surfaces or with an ``area``. A material with neither is left out.
        centre_frequencies : sequence (n_bands,)
            Centre frequencies in Hz, increasing.
        surfaces : sequence of Surface
            Single surfaces, such as those of a mesh.
        objects : sequence of Piece
            Objects that are no surfaces, such as persons.
        prior : SigmaRule, optional
            Rule for sigma of the materials that state none; without it each must state sigma.
        **stated
            Other fields of `Room`, such as ``name``, ``volume`` and ``air``.

        Raises
        ------
        DataError
            For the reasons of `Room`, for a surface with an unknown material, for a material with both
            surfaces and an area, and for a field that is missing or unknown.
        """
        frequencies = bands.as_bands(centre_frequencies)
        drawn = [*checks.instances("surfaces", surfaces, Surface)]
        listed = checks.instances("materials", materials, Material)
        pieces = checks.instances("objects", objects, Piece)
        checks.distinct("material and object", [m.name for m in listed] + [p.name for p in pieces])
        areas: dict[str, list[float]] = {m.name: [] for m in listed}
        for surface in drawn:
            if surface.material not in areas:
                raise DataError(
                    f'surface["{surface.name}"].material = "{surface.material}" is not among the '
                    f"materials: {', '.join(areas)}"
                )
            areas[surface.material].append(surface.area)
        for m in listed:
            if m.area is None:
                continue
            if areas[m.name]:
                raise DataError(
                    f'area["{m.name}"] and surfaces of this material are both given; give only '
                    "one of them"
                )
            areas[m.name].append(checks.positive(f'material["{m.name}"].area', m.area, "m²"))
            if drawn:
                drawn.append(Surface(m.name, m.name, m.area))
        used = [replace(m, area=float(np.sum(areas[m.name]))) for m in listed if areas[m.name]]
        lacking = [m.name for m in used if m.scattering is None]
        if 0 < len(lacking) < len(used):
            raise DataError(
                f'scattering["{lacking[0]}"] is missing; give scattering for every material or for none'
            )
        for piece in pieces:
            checks.positive(f'object["{piece.name}"].number', piece.number)
        rows = [piece.with_sigma(prior).as_material(None if lacking else 0.0) for piece in pieces]
        rows, names = [*used, *rows], [m.name for m in used]
        errors: Any = stated.pop("area_sigma", 0.0)
        if np.ndim(errors):
            errors = [*errors, *(piece.number_sigma for piece in pieces)]
        else:
            of_all = errors if isinstance(errors, Mapping) else dict.fromkeys(names, errors)
            errors = {**of_all} | {m.name: m.area_sigma for m in rows if m.area_sigma}
        stated |= {"areas": [m.area for m in rows], "area_sigma": errors, "surfaces": drawn}
        stated |= {"pieces": [piece.name for piece in pieces], "centre_frequencies": frequencies}
        try:
            room = cls(**stated, **of_materials(rows, frequencies, prior))
        except TypeError as error:
            raise DataError(f"a room cannot be made from these values: {error}") from error
        for piece in pieces:
            place = f'object["{piece.name}"].number'
            refuse_too_many(place, piece.number, piece.area_per_piece, room.total_area)
        return room

    @classmethod
    def from_geometry(
        cls, geometry: Any, patches: Iterable[tuple[str, str, float]] = (), **stated: Any
    ) -> Room:
        """Return a room with the volume and the surfaces of a `rtcal.simulators.Polyhedron`.

        ``patches`` are parts of surfaces with other materials, each as (name of the surface, material,
        area in m²). ``stated`` are the other arguments of `from_surfaces`. Raises DataError for the
        reasons of `with_patches` and `from_surfaces`.
        """
        if not (hasattr(geometry, "volume") and hasattr(geometry, "surfaces")):
            raise DataError(
                f"geometry = {checks.shown(geometry)} has no volume and surfaces; give an "
                "rtcal.simulators.Polyhedron"
            )
        surfaces = with_patches(geometry.surfaces, patches)
        return cls.from_surfaces(volume=geometry.volume, surfaces=surfaces, **stated)

    def to_dict(self) -> dict[str, Any]:
        """Return the room as plain values of the tables of its file, without empty tables.

        Coefficients above 1 that the room set to 1 are 1 in these tables.
        """
        covered = {surface.material for surface in self.surfaces}
        rows = {name: asdict(self.material(name)) for name in self.materials}
        pieces = [
            {key: rows[name][of] for of, key in _OF_PIECE.items() if rows[name][of]}
            for name in self.pieces
        ]
        materials = [
            {"name": name, "area": None} | row | ({"area": None} if name in covered else {})
            for name, row in rows.items()
            if name not in self.pieces
        ]
        tables = {
            "name": self.name,
            "author": self.author,
            "volume": self.volume,
            "centre_frequencies": self.centre_frequencies.tolist(),
            "scattering_model": "" if self.scattering_model == "random" else self.scattering_model,
            "dimensions": list(self.dimensions or ()),
            "clipped": list(self.clipped),
            **{name: getattr(self, name) for name in RELATIVE},
            "climate_sigma": list(self.climate_sigma) if any(self.climate_sigma) else None,
            **self.scene.to_dict(),
            "prior": {"band_correlation": self.band_correlation} if self.band_correlation else None,
            "air": self.air and dict(sorted(asdict(self.air).items())),
            "calibration": self.calibration and asdict(self.calibration),
            "material": [{k: v for k, v in row.items() if v} for row in materials],
            "object": pieces,
            "correlation": [
                {"materials": list(pair), "value": float(value)}
                for pair, value in self.material_correlation.items()
            ],
            "surface": [
                {k: v for k, v in asdict(surface).items() if v is not None}
                for surface in self.surfaces
            ],
        }
        return {name: table for name, table in tables.items() if table}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], place: str = "") -> Room:
        """Return a room from plain values of the tables of a file, as `to_dict` returns them.

        ``place`` is the name of the file in error messages. Raises DataError for an unknown key, for a
        value of a wrong type, and for the reasons of `Room`.
        """
        if isinstance(data, Mapping) and data and {*data} <= {*SceneTables.__struct_fields__}:
            raise DataError(
                f"{' and '.join(data)} belong to the room's file: copy these tables to the end "
                "of room.toml"
            )
        return cls.of_table(read(RoomFile, data, place))

    @classmethod
    def of_table(cls, file: RoomFile) -> Room:
        """Return a room from the tables of its file.

        Raises DataError for the reasons of `from_surfaces`, and for a material that has neither an area
        nor a surface.
        """
        checks.distinct("material", [m.name for m in file.material])
        covered = {surface.material for surface in file.surface}
        for m in file.material:
            if m.area is None and m.name not in covered:
                raise DataError(
                    f'area["{m.name}"] is missing, and no [[surface]] has this material; give '
                    "one of them"
                )
        alike = {*RoomFile.__struct_fields__} & {f.name for f in fields(cls)} | {"above_one"}
        return cls.from_surfaces(
            **{key: getattr(file, key) for key in alike - {"sources"}},
            surfaces=[
                Surface(s.name or f"surface {i}", s.material, s.area, s.axis)
                for i, s in enumerate(file.surface, start=1)
            ],
            materials=file.material,
            objects=file.object,
            prior=file.prior,
            scene=Scene.of(file),
            band_correlation=0.0 if file.prior is None else file.prior.band_correlation,
            material_correlation={c.materials: c.value for c in file.correlation},
        )

    @classmethod
    def from_file(cls, path: str) -> Room:
        """Read a room from a TOML file; docs/files.md describes its format."""
        with expecting("a room", path):
            room = cls.from_text(read_text(path, MAX_BYTES), os.fspath(path))
        return room.replace(scene=room.scene.within(Path(path).parent)) if room.scene else room

    @classmethod
    def from_text(cls, text: str, place: str) -> Room:
        """Return a room from the text of a TOML file; messages begin with ``place``."""
        try:
            return cls.from_dict(toml_table(text))
        except DataError as error:
            raise DataError(f"{place}: {error}") from error

    def to_text(self, folder: str | os.PathLike[str] | None = None) -> str:
        """Return the room as the text of a TOML file, from which the same numbers are read.

        Paths of the mesh and of balloons are written relative to ``folder``; with None as they are.
        """
        room = self if folder is None else self.replace(scene=self.scene.seen_from(folder))
        return toml_text(room.to_dict())

    def save(self, path: str) -> None:
        """Write the room to a TOML file; an error leaves no incomplete file."""
        write_text(path, self.to_text(checks.path("path", path).parent))


def of_materials(
    materials: Sequence[Material], frequencies: Array, prior: SigmaRule | None = None
) -> dict[str, Any]:
    """Return the arguments of `Room` that follow from materials, such as its names and coefficients.

    ``frequencies`` (n_bands,) are the room's bands in Hz. ``prior`` is the rule for sigma of materials
    that state none; with None each must state sigma. Scattering coefficients are returned only if all
    materials have them. Raises DataError, which names the material, for a wrong number of values, and
    for a missing sigma.
    """

    def row(material: Material, name: str) -> Array:
        stated: Any = getattr(material, name)
        if name == "sigma" and isinstance(stated, str):
            stated = TIERS[checks.choice(f'sigma["{material.name}"]', stated, TIERS)]
        if name == "sigma" and stated is None:
            if prior is None:
                raise DataError(
                    f'material "{material.name}" has no sigma, and the file has no [prior] '
                    "that gives one. If in doubt, add [prior] with relative = 0.3 and "
                    "minimum = 0.01"
                )
            # The rules take up to 2; the room refuses or cuts what lies above 1.
            return prior.sigma(np.clip(row(material, "alpha"), 0, 2), frequencies)
        values = checks.array(f'{name}["{material.name}"]', np.nan if stated is None else stated)
        if values.shape != (len(frequencies),) and (values.ndim or name == "alpha"):
            raise DataError(
                f'material "{material.name}": {name} has {values.size} values; give one for each '
                f"of the room's {len(frequencies)} bands"
            )
        return np.broadcast_to(values, len(frequencies))

    tables: dict[str, Any] = {
        name: np.reshape([row(m, name) for m in materials], (-1, len(frequencies)))
        for name in ("alpha", "sigma", "alpha_min", "scattering")
    }
    return tables | {
        "materials": [m.name for m in materials],
        "alpha_min": tables["alpha_min"] if tables["alpha_min"].any() else None,
        "scattering": None if np.isnan(tables["scattering"]).any() else tables["scattering"],
        "sources": {m.name: m.source for m in materials if m.source},
    }


def in_order(place: str, value: Any, materials: Sequence[str]) -> Any:
    """Return the values of a mapping by material in the order of ``materials``.

    A ``value`` that is no mapping is returned unchanged. ``place`` is its name in error messages.
    Raises DataError if the keys are not exactly ``materials``, and for a table with labels, such as a
    pandas one, whose rows may have another order.
    """
    if hasattr(value, "to_numpy"):
        raise DataError(
            f"{place} is a table with labels, which rtcal does not use: give a mapping from "
            "material to value, or plain values (to_numpy) in the order of the room"
        )
    if not isinstance(value, Mapping):
        return value
    if {*value} != {*materials}:
        stated, needed = (shortened(", ".join(map(str, each)), 60) for each in (value, materials))
        raise DataError(f"{place} has the keys {stated}; they must be {needed}")
    return [value[name] for name in materials]


def above_one_hint(alpha: float) -> str:
    """Return the end of an error message on a coefficient from 1 to 2; "" for any other value.

    The text says that a laboratory may report such coefficients (ISO 354), and what to do.

    >>> above_one_hint(1.2)[:36], above_one_hint(0.7)
    ('. A laboratory may report more than ', '')
    """
    if not 1 < alpha <= LARGEST_LABORATORY_ALPHA:
        return ""
    return (
        ". A laboratory may report more than 1 (edge effect, ISO 354): with above_one = "
        '"clip" the room uses such a value as 1. If the coefficients are in percent, '
        "divide them by 100"
    )


def fingerprint(kind: str, values: Mapping[str, float]) -> str:
    """Return a text that identifies measured data in a `CalibrationRecord`: their kind and values.

    ``kind`` is the name of the quantity, such as "T" or "t20". ``values`` are by band in Hz, or by pair
    and band; NaN is left out.

    Examples
    --------
    >>> fingerprint("T", {"500": 1.92, "1000": 1.8801})
    'T:500=1.92000,1000=1.88010'
    """
    return f"{kind}:" + ",".join(f"{k}={v:.5f}" for k, v in values.items() if math.isfinite(v))


def of_pairs(
    parameter: str, pairs: Sequence[tuple[str, str]], values: Array, centre_frequencies: Array
) -> str:
    """Return the `fingerprint` of a parameter's values at source-receiver pairs.

    ``parameter`` is its key, such as "t20", and ``pairs`` are (source, receiver). ``values`` are
    (n_pairs, n_bands), NaN where missing, and ``centre_frequencies`` (n_bands,) are in Hz.
    """
    cells = {
        f"{'>'.join(quote(name, safe='') for name in pair)}@{f:g}": value
        for pair, row in zip(pairs, values.tolist(), strict=True)
        for f, value in zip(centre_frequencies.tolist(), row, strict=True)
    }
    return fingerprint(parameter, cells)


def is_calibrated(room: Room) -> bool:
    """Return whether a room's coefficients come from a calibration of this room."""
    return room.calibration is not None and room.calibration.method not in (ARCHIVE, CHANGED)


def refuse_other_equation(room: Room, name: str) -> None:
    """Raise DataError if a room was calibrated by another equation than the one of this name.

    By the other equation its coefficients do not give the T to which it was calibrated.
    """
    record = room.calibration
    if record is not None and is_calibrated(room) and record.equation not in ("", name):
        raise DataError(
            f'room "{room.name}" was calibrated with the equation {record.equation}, and has another '
            f"T by {name}. Use the equation {record.equation}, or the room before its calibration"
        )


def times_of(room: Room) -> Array:
    """Return T in s to which a room was calibrated, (n_bands,), from its record; NaN where unknown.

    T is unknown if the record has several T, such as those of several configurations, or if the room
    was changed after the calibration.
    """
    record = room.calibration
    every = [] if record is None or record.method == CHANGED else record.measured.split()
    names = [name for name in every if name.partition(":")[0] not in OBSERVABLES]
    cells = _cells(names[0]) if len(names) == 1 and names[0].startswith("T:") else {}
    return np.array([cells.get(f"{f:g}", np.nan) for f in room.centre_frequencies.tolist()])


def _cells(name: str) -> dict[str, float]:
    """Return the values of a name of data by their labels; what is no number there is left out."""
    cells = {}
    for cell in name.partition(":")[2].split(","):
        label, _, value = cell.partition("=")
        with suppress(ValueError):  # a record that was written by hand
            cells[label] = float(value)
    return cells


def _shared(one: str, other: str) -> list[str]:
    """Return the labels of the values that two names of the same data share; [] for other data.

    Names are of the same data if all values that both have are equal to 1e-4, relative above 1, and
    these are at least two, or all that either has. Data that were rounded anew in between, or of which
    a value was replaced, are other data.
    """
    if one.partition(":")[0] != other.partition(":")[0]:
        return []
    first, second = _cells(one), _cells(other)
    if one == other:
        return [*first] or [one]
    both = [label for label in first if label in second]
    equal = all(np.isclose(first[k], second[k], rtol=_SAME, atol=_SAME) for k in both)
    return both if equal and len(both) >= (1 if first.keys() == second.keys() else 2) else []


def refuse_repeated_data(room: Room, *names: str) -> None:
    """Raise DataError if the room was already calibrated to some of the same measured data.

    ``names`` identify the data: each is a text that `fingerprint` returns, or several such texts
    separated by blanks. The error's message has the values that would count twice.
    """
    record = room.calibration
    before = [] if record is None else record.measured.split()
    anew = [one for name in names for one in name.split()]
    found = ((new, _shared(new, old)) for old in before for new in anew)
    name, shared = next((each for each in found if each[1]), ("", []))
    if record is None or not shared:
        return
    what = first_of([_value_in_words(name.partition(":")[0], label) for label in shared], 3)
    how, instead = "was already calibrated on", "Use the room as it was before, or other data"
    if record.method == ARCHIVE:
        how, instead = "is of an archive that contains", "Learn the archive without this room"
    raise DataError(
        f'room "{room.name}" {how} these data ({what}); calibrating to them again would count them '
        f"twice. {instead}"
    )


def _value_in_words(kind: str, label: str) -> str:
    """Return a value's label in a name of data as a message names it.

    >>> _value_in_words("t20", "S1>R1@500"), _value_in_words("T", "500")
    ('T20 of S1 to R1 at 500 Hz', 'T at 500 Hz')
    """
    pair, _, band = label.rpartition("@")
    if pair:
        places = " to ".join(unquote(name) for name in pair.split(">"))
        return f"{parameter_label(kind)} of {places} at {band} Hz"
    if kind == "pairs":
        parameter, _, band = label.rpartition("-")
        return f"mean {parameter_label(parameter)} at {band} Hz"
    return f"{'mode' if kind == 'modes' else kind} at {band} Hz"


MAX_BYTES = 2**18
"""Largest size of a room's file in bytes, thirty times a usual one."""


@dataclass(frozen=True, kw_only=True)
class PriorTable(SigmaRule):
    """Rule of a file for the sigma of materials that state none; what it leaves out is 0."""

    relative: Share = 0.0
    minimum: Share = 0.0
    band_correlation: Number = 0.0


class SurfaceTable(FileTable):
    """Table ``surface`` of a room's file. The second surface is named "surface 2" if it has no name."""

    material: str
    area: Number
    name: str = ""
    axis: str | None = None


class Correlation(FileTable):
    """Correlation of the errors of two materials' coefficients in the same band."""

    materials: tuple[str, str]
    value: Number


class RoomFile(SceneTables, kw_only=True):
    """Tables of a room's file, with those of its scene."""

    name: str = "room"
    author: str = ""
    volume: Number
    centre_frequencies: list[Number]
    scattering_model: str = "random"
    air: Air | None = None
    dimensions: list[Number] | None = None
    calibration: CalibrationRecord | None = None
    above_one: str = "refuse"
    clipped: tuple[str, ...] = ()
    volume_sigma: Number = 0.0
    common_area_sigma: Number = 0.0
    common_alpha_sigma: Number = 0.0
    climate_sigma: tuple[Number, Number] = (0.0, 0.0)
    material: Annotated[list[Material], msgspec.Meta(max_length=500)] = []
    object: Annotated[list[Piece], msgspec.Meta(max_length=500)] = []
    surface: Annotated[list[SurfaceTable], msgspec.Meta(max_length=5000)] = []
    correlation: Annotated[list[Correlation], msgspec.Meta(max_length=5000)] = []
    prior: PriorTable | None = None
    area_sigma: Number | str | dict[str, Number | str] = 0.0
