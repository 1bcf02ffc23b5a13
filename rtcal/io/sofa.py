"""Room impulse responses and positions of SOFA files (AES69), by netCDF4 (``rtcal[sofa]``).

Read are the conventions of responses in a room: `ROOM_CONVENTIONS`, and the general ones whose
``RoomType`` is no free field. All others are refused by name: head-related transfer functions and
headphones are no measurements of a room. `balloon` reads what a loudspeaker radiates.

Equal positions have one name: S1, S2 and so on, R1, R2 and so on, in the order of the file.

Reference: AES69-2022, "AES standard for file exchange - Spatial acoustic data file format".
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rtcal.acoustics.measurement import SAME_PLACE
from rtcal.acoustics.room import Scene
from rtcal.files.schema import toml_text
from rtcal.io import budget
from rtcal.support import checks, library
from rtcal.support.errors import DataError
from rtcal.support.types import Array

__all__ = ["read"]
__dir__ = __all__.copy

ROOM_CONVENTIONS = ("SingleRoomSRIR", "SingleRoomMIMOSRIR", "SingleRoomDRIR")
GENERAL_CONVENTIONS = ("GeneralFIR", "GeneralFIR-E")
DIRECTIVITY_CONVENTIONS = ("FreeFieldDirectivityTF", "GeneralTF")
NEAR = 0.1
"""Distance in m within which a position in a file is taken for a position of the room."""
_PARALLEL = 1e-3
MAX_BYTES = 2**28
MAX_RESPONSES = 2000
_HDF5 = b"\x89HDF\r\n\x1a\n"
Point = tuple[float, float, float]


@dataclass(frozen=True)
class Responses:
    """Hold the impulse responses of a SOFA file, with their positions.

    ``samples`` are (n_measurements, n_channels, n_samples), and ``sampling_rate`` is in Hz. A channel
    is a microphone of an array, or an emitter. ``pairs`` are the source and receiver of each
    measurement; a pair may occur several times. ``sources`` and ``receivers`` are positions in m, in
    the coordinates of the file. ``convention`` is the SOFA convention.
    """

    pairs: tuple[tuple[str, str], ...]
    samples: Array
    sampling_rate: float
    sources: dict[str, Point]
    receivers: dict[str, Point]
    convention: str

    def placed(self, scene: Scene) -> tuple[Responses, str]:
        """Return the responses with a room's names of the positions, and a note on changed names.

        ``scene`` has the room's sources and receivers. The note is "" if no name changed. Raises
        DataError for a position that is not within `NEAR` of a source or receiver of the scene.
        """
        names, changed = [], []
        for kind, points, known in (
            ("source", self.sources, scene.sources),
            ("receiver", self.receivers, scene.receivers),
        ):
            own = {}
            for name, point in points.items():
                off = {n: float(np.linalg.norm(np.subtract(p, point))) for n, p in known.items()}
                nearest = min(off, key=lambda n: off[n], default="")
                own[name] = name if off.get(name, np.inf) <= NEAR else nearest
                if not off or off[own[name]] > NEAR:
                    there = ", ".join(f"{x:g}" for x in point)
                    far = f"{off[nearest]:.2f} m from {nearest}" if off else "and the room has none"
                    raise DataError(
                        f"{kind} {name} of the SOFA file is at ({there}) m, {far}; positions in "
                        f"the file and the room may differ by {NEAR:g} m. Check that both use "
                        "the same coordinates"
                    )
                if own[name] != name:
                    changed.append(f"{kind} {name} is {own[name]}")
            names.append(own)
        pairs = tuple((names[0][s], names[1][r]) for s, r in self.pairs)
        note = f"By their positions in the file, {', '.join(changed)}." if changed else ""
        return replace(self, pairs=pairs), note

    def positions_text(self) -> str:
        """Return the positions as text for a room's file."""
        return toml_text({"sources": self.sources, "receivers": self.receivers})


def recognises(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is HDF5, as SOFA files are."""
    if not checks.path("path", path).is_file():
        return False
    with open(path, "rb") as stream:
        return stream.read(len(_HDF5)) == _HDF5


class _File:
    """The variables and attributes of a SOFA file; raises as `read`."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = os.fspath(checks.path("path", path))
        if not recognises(path):
            raise DataError(f"{path}, byte 0: is not a SOFA (HDF5) file")
        budget.require(Path(path).stat().st_size, MAX_BYTES, "bytes", self.path)
        netcdf = library("SOFA files need netCDF4: pip install 'rtcal[sofa]'", "netCDF4")
        with (
            budget.parsing(self.path, "SOFA (AES69)", "Export it again"),
            netcdf.Dataset(self.path) as data,
        ):
            shapes = [[float(n) for n in v.shape] for v in data.variables.values()]
            # Before anything is loaded: a file of kilobytes can declare gigabytes.
            declared = sum(float(np.prod(shape)) for shape in shapes)
            few = "export fewer responses to a file"
            budget.require(declared, budget.MAX_SAMPLES, "values", self.path, few)
            self.attributes = {name: str(data.getncattr(name)) for name in data.ncattrs()}
            self.types = {n: getattr(v, "Type", "") for n, v in data.variables.items()}
            self.variables = {
                name: np.ma.filled(v[:].astype(float), np.nan)
                for name, v in data.variables.items()
                if getattr(v.dtype, "kind", "") in "fiu"
            }
        self.convention = self.attributes.get("SOFAConventions", "")

    def numbers(self, name: str) -> Array:
        """Return a variable; DataError for one that is missing, empty or not finite."""
        values = self.variables.get(name, np.empty(0))
        if values.size == 0:
            raise DataError(f"{self.path}: {name} is missing or not a number")
        if not np.isfinite(values).all():
            raise DataError(f"{self.path}: {name} has a value that is not finite")
        return np.asarray(values)

    def points(self, name: str, typed: str = "") -> Array:
        """Return points in m, (n, 3), by the coordinates that the file states for them."""
        points = np.atleast_2d(np.squeeze(self.numbers(name)))
        if points.ndim != 2 or points.shape[1] != 3:
            raise DataError(f"{self.path}: {name} has shape {points.shape}; it must be (n, 3)")
        kind = (self.types.get(typed or name) or "cartesian").lower()
        if kind == "cartesian":
            return points
        if kind != "spherical":
            raise DataError(
                f'{self.path}: {name} has the type "{kind}"; it must be cartesian or spherical'
            )
        azimuth, elevation = np.radians(points[:, :2]).T  # in degrees, and the radius in m
        flat = np.cos(elevation)
        unit = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
        return np.asarray(points[:, 2] * unit).T


def balloon(path: str | os.PathLike[str]) -> tuple[Array, Array, Array]:
    """Return the directions, radiated energies and frequencies of a directivity in a SOFA file.

    The directions (n_directions, 3) are unit vectors along the source's axis, to its top and to its
    left. The energies are (n_directions, n_frequencies), the frequencies in Hz.
    """
    file = _File(path)
    place, convention = file.path, file.convention
    if convention not in DIRECTIVITY_CONVENTIONS:
        raise DataError(
            f"{place}: convention {convention or 'not stated'} is not a directivity; rtcal reads "
            f"{', '.join(DIRECTIVITY_CONVENTIONS)}"
        )
    energy = file.numbers("Data.Real") ** 2 + file.numbers("Data.Imag") ** 2
    points = file.points("ReceiverPosition")
    if energy.ndim != 3 or energy.shape[:2] != (1, len(points)):
        raise DataError(
            f"{place}: Data.Real has shape {energy.shape}; it must be (1, {len(points)}, "
            "frequencies): one measurement, and one receiver for each direction"
        )
    axis, up = (file.points(name, "SourceView")[0] for name in ("SourceView", "SourceUp"))
    for name, vector in (("SourceView", axis), ("SourceUp", up)):
        if not np.linalg.norm(vector) > 0:
            raise DataError(
                f"{place}: {name} must be a direction (three finite numbers, not all 0)"
            )
    axis, up = axis / np.linalg.norm(axis), up / np.linalg.norm(up)
    above = up - (up @ axis) * axis
    if np.linalg.norm(above) < _PARALLEL:
        raise DataError(
            f"{place}: SourceUp is parallel to SourceView; it must point to the top of the source"
        )
    above = above / np.linalg.norm(above)
    axes = np.array([axis, above, np.cross(above, axis)])
    directions = points / np.linalg.norm(points, axis=1, keepdims=True)
    return directions @ axes.T, energy[0], file.numbers("N").reshape(-1)


def read(path: str | os.PathLike[str]) -> Responses:
    """Return the impulse responses in a SOFA file (AES69), with their sources and receivers.

    The `Responses` have the samples, the sampling rate, the pairs, and the positions in m.

    Raises DataError for a file that netCDF4 cannot read, a convention for other data than room
    responses, several sampling rates, and positions that are not numbers. Raises MissingDependencyError
    if netCDF4 is not installed.
    """
    file = _File(path)
    place, convention = file.path, file.convention
    room = file.attributes.get("RoomType", "").lower()
    if convention not in ROOM_CONVENTIONS + GENERAL_CONVENTIONS:
        raise DataError(
            f"{place}: convention {convention or 'not stated'} is not a response in a room; "
            f"rtcal reads {', '.join(ROOM_CONVENTIONS + GENERAL_CONVENTIONS)}"
        )
    if room == "free field" and convention in GENERAL_CONVENTIONS:
        raise DataError(f"{place}: {convention} in the free field is not a response in a room")
    samples = file.numbers("Data.IR")
    if samples.ndim == 4:  # (measurement, receiver, sample, emitter) of FIR-E
        samples = np.moveaxis(samples, 3, 2).reshape(samples.shape[0], -1, samples.shape[2])
    if samples.ndim != 3:
        raise DataError(f"{place}: Data.IR has shape {samples.shape}; it must have three axes")
    n, _, length = samples.shape
    budget.require(length, budget.MAX_CHANNEL_SAMPLES, "samples of a response", place)
    budget.require(n, MAX_RESPONSES, "measurements", place)
    rates = np.unique(file.numbers("Data.SamplingRate"))
    if rates.size != 1 or not rates[0] > 0:
        raise DataError(
            f"{place}: sampling rates {', '.join(map(str, rates))} Hz; there must be exactly "
            "one, above 0"
        )
    named = []
    for letter, name in (("S", "SourcePosition"), ("R", "ListenerPosition")):
        points = file.points(name)
        if len(points) not in (1, n):
            raise DataError(
                f"{place}: {name} has shape {points.shape}; it must be (1, 3) or ({n}, 3)"
            )
        named.append(_named(letter, np.broadcast_to(points, (n, 3))))
    (of_source, sources), (of_listener, receivers) = named
    return Responses(
        pairs=tuple(zip(of_source, of_listener, strict=True)),
        samples=samples,
        sampling_rate=float(rates[0]),
        sources=sources,
        receivers=receivers,
        convention=convention,
    )


def _named(letter: str, points: Array) -> tuple[list[str], dict[str, Point]]:
    """Return the name of each point, equal ones alike, and the point of each name."""
    named: dict[str, Point] = {}
    names = []
    for point in points:
        near = (k for k, p in named.items() if np.linalg.norm(point - np.array(p)) <= SAME_PLACE)
        name = next(near, None) or f"{letter}{len(named) + 1}"
        if name not in named:
            x, y, z = (round(float(c), 6) + 0.0 for c in point)
            named[name] = (x, y, z)
        names.append(name)
    return names, named
