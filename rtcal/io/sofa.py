"""Room impulse responses and positions of SOFA files (AES69), by sofar (``rtcal[sofa]``).

Read are the conventions of responses in a room: `ROOM_CONVENTIONS`, and the general ones whose
``RoomType`` is no free field. All others are refused by name: head-related transfer functions and
headphones are no measurements of a room. `read_directivity` reads a loudspeaker's balloon.

Equal positions have one name: S1, S2 and so on, R1, R2 and so on, in the order of the file.

Reference: AES69-2022, "AES standard for file exchange - Spatial acoustic data file format".
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.directivity import Directivity
from rtcal.acoustics.repeats import SAME_PLACE
from rtcal.errors import DataError, MissingDependencyError
from rtcal.io.wav import MAX_CHANNEL_SAMPLES
from rtcal.support.arguments import checked
from rtcal.support.types import Array

__all__ = ["Responses", "claims", "read", "read_directivity"]
__dir__ = __all__.copy

ROOM_CONVENTIONS = ("SingleRoomSRIR", "SingleRoomMIMOSRIR", "SingleRoomDRIR")
GENERAL_CONVENTIONS = ("GeneralFIR", "GeneralFIR-E")
DIRECTIVITY_CONVENTION = "FreeFieldDirectivityTF"
_ON_AXIS = float(np.cos(np.radians(10)))
_DIRECTIONS = 12
"""Fewest directions of a balloon."""
_LARGEST_SHARE = 0.15
"""Largest share of the sphere that one direction stands for."""
_LEAST_INDEX = 1.0
"""By how many dB the axis may be below the mean."""
MAX_BYTES = 2**28
MAX_RESPONSES = 2000

_HDF5 = b"\x89HDF\r\n\x1a\n"
Point = tuple[float, float, float]


@dataclass(frozen=True)
class Responses:
    """The responses of a SOFA file.

    Parameters
    ----------
    pairs : sequence of (str, str)
        Source and receiver of each measurement, (n_measurements,); a pair may occur several times.
    samples : array (n_measurements, n_channels, n_samples)
        One channel per receiver of the listener (microphone array), and per emitter.
    sampling_rate : float
        In Hz.
    sources, receivers : mapping of str to (x, y, z)
        Positions in m, in the coordinates of the file.
    convention : str
    """

    pairs: tuple[tuple[str, str], ...]
    samples: Array
    sampling_rate: float
    sources: dict[str, Point]
    receivers: dict[str, Point]
    convention: str

    def positions_text(self) -> str:
        """Return the positions as the tables of a room's file."""
        rows = []
        for table, points in (("sources", self.sources), ("receivers", self.receivers)):
            rows += [
                f"[{table}]",
                *(f"{n} = {[float(x) for x in p]}" for n, p in points.items()),
                "",
            ]
        return "\n".join(rows)


def claims(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is HDF5, as SOFA files are."""
    if not Path(path).is_file():
        return False
    with open(path, "rb") as stream:
        return stream.read(len(_HDF5)) == _HDF5


@checked
def read(path: str | os.PathLike[str]) -> Responses:
    """Return the responses and positions of a SOFA file.

    Raises
    ------
    DataError
        For a file that sofar cannot read, a convention that is no room response, several sampling
        rates, and positions that are no numbers.
    MissingDependencyError
        Without sofar.
    """
    return _responses(_opened(path), os.fspath(path))


def _opened(path: str | os.PathLike[str]) -> Any:
    """Return sofar's object of a file; raises as `read`."""
    sofar = _library()
    size = Path(path).stat().st_size if Path(path).exists() else 0
    if not claims(path):
        raise DataError(f"{path}, byte 0: not a SOFA (HDF5) file")
    if size > MAX_BYTES:
        raise DataError(f"{path}: {size} bytes; at most {MAX_BYTES}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of preliminary conventions, which are read as well
        try:
            return sofar.read_sofa(os.fspath(path), verify=False, verbose=False)
        except Exception as error:  # sofar and netCDF4 raise what they meet
            raise DataError(f"{path}: cannot be read as SOFA: {error}") from error


@checked
def read_directivity(
    path: str | os.PathLike[str], frequencies: Sequence[float] | Array, aim: Sequence[float]
) -> Directivity:
    """Return the lobe of a measured loudspeaker, of a balloon of the convention FreeFieldDirectivityTF.

    The index of each octave is the energy on the axis, the file's ``SourceView``, over the mean over
    the sphere. Each direction counts by the area of the sphere that is nearest to it. An index of down
    to -1 dB, of a woofer that radiates to all sides, is 0. Side lobes are lost: the result radiates the
    index's lobe (`rtcal.Directivity`).

    Parameters
    ----------
    path : path
    frequencies : sequence of float (n_bands,)
        Octave bands in Hz.
    aim : (x, y, z)
        Direction of the axis in the room's coordinates.

    Raises
    ------
    DataError
        As `read` does; for another convention, directions that leave a gap in the sphere or on the
        axis, or a band without a frequency of the file.
    MissingDependencyError
        Without sofar.

    Examples
    --------
    >>> speaker = read_directivity("speaker.sofa", [500, 1000], (1, 0, 0))  # doctest: +SKIP
    """
    sofa, place = _opened(path), os.fspath(path)
    convention = str(getattr(sofa, "GLOBAL_SOFAConventions", ""))
    if convention != DIRECTIVITY_CONVENTION:
        raise DataError(
            f"{place}: convention {convention or 'not stated'} is no {DIRECTIVITY_CONVENTION}"
        )
    energy = _numbers(sofa, "Data_Real", place) ** 2 + _numbers(sofa, "Data_Imag", place) ** 2
    points = np.atleast_2d(_numbers(sofa, "ReceiverPosition", place)).reshape(-1, 3)
    if energy.ndim != 3 or energy.shape[1] != len(points):
        raise DataError(
            f"{place}: Data.Real has shape {energy.shape}; (measurements, {len(points)}, frequencies) "
            "is needed, one receiver for each direction"
        )
    directions = _unit(_cartesian(sofa, "ReceiverPosition", points, place))
    view = np.atleast_2d(_numbers(sofa, "SourceView", place))[:1]
    axis = _unit(_cartesian(sofa, "SourceView", view, place))[0]
    weight, on_axis = _solid_angles(directions, axis, place)
    lines = _numbers(sofa, "N", place).reshape(-1)
    ratios = []
    for f in np.asarray(frequencies, dtype=float):
        inside = (lines >= f / np.sqrt(2)) & (lines < f * np.sqrt(2))
        if not inside.any():
            raise DataError(f"{place}: no frequency in the octave of {bands.label(float(f))}")
        of_band = energy[0][:, inside].mean(axis=1)
        ratios.append(of_band[on_axis] / max(weight @ of_band, np.finfo(float).tiny))
    if min(ratios) < 10 ** (-_LEAST_INDEX / 10):
        raise DataError(
            f"{place}: the energy on the axis is {min(ratios):.2g} times the mean over the sphere: "
            "SourceView is not where it radiates"
        )
    index = np.maximum(10 * np.log10(ratios), 0.0)
    return Directivity(index=index, aim=aim)


def _unit(points: Array) -> Array:
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def _solid_angles(directions: Array, axis: Array, path: str) -> tuple[Array, int]:
    """Return each direction's share of the sphere, which sum to 1, and the one on the axis."""
    from scipy.spatial import SphericalVoronoi

    _, first = np.unique(np.round(directions, 5), axis=0, return_index=True)
    cosine = directions @ axis
    on_axis = int(np.argmax(cosine))
    if cosine[on_axis] < _ON_AXIS:
        raise DataError(f"{path}: no direction within 10 degrees of the axis (SourceView)")
    if len(first) < _DIRECTIONS:
        raise DataError(f"{path}: {len(first)} directions; at least {_DIRECTIONS} are needed")
    try:
        areas = SphericalVoronoi(directions[first], threshold=1e-6).calculate_areas()
    except ValueError as error:
        raise DataError(f"{path}: the directions do not cover the sphere: {error}") from error
    if areas.max() > _LARGEST_SHARE * areas.sum():
        gap = 100 * areas.max() / areas.sum()
        raise DataError(f"{path}: the directions leave a gap of {gap:.0f} % of the sphere")
    weight = np.zeros(len(directions))
    weight[first] = areas / areas.sum()
    return weight, on_axis


def _responses(sofa: Any, path: str) -> Responses:
    convention = str(getattr(sofa, "GLOBAL_SOFAConventions", ""))
    room = str(getattr(sofa, "GLOBAL_RoomType", "")).lower()
    if convention not in ROOM_CONVENTIONS + GENERAL_CONVENTIONS:
        raise DataError(
            f"{path}: convention {convention or 'not stated'} is no response in a room; read are "
            f"{', '.join(ROOM_CONVENTIONS + GENERAL_CONVENTIONS)}"
        )
    if room == "free field" and convention in GENERAL_CONVENTIONS:
        raise DataError(f"{path}: {convention} in the free field is no response in a room")
    samples = _numbers(sofa, "Data_IR", path)
    if samples.ndim == 4:  # (measurement, receiver, sample, emitter) of FIR-E
        samples = np.moveaxis(samples, 3, 2).reshape(samples.shape[0], -1, samples.shape[2])
    if samples.ndim != 3:
        raise DataError(f"{path}: Data.IR has shape {samples.shape}; three axes are needed")
    n, _, length = samples.shape
    if length > MAX_CHANNEL_SAMPLES:
        raise DataError(f"{path}: {length} samples; at most {MAX_CHANNEL_SAMPLES}")
    if n > MAX_RESPONSES:
        raise DataError(f"{path}: {n} measurements; at most {MAX_RESPONSES}")
    rates = np.unique(_numbers(sofa, "Data_SamplingRate", path))
    if rates.size != 1 or not rates[0] > 0:
        raise DataError(
            f"{path}: sampling rates {', '.join(map(str, rates))} Hz; one above 0 is needed"
        )
    sources = _positions(sofa, "SourcePosition", n, path)
    listeners = _positions(sofa, "ListenerPosition", n, path)
    of_source, source_points = _named("S", sources)
    of_listener, listener_points = _named("R", listeners)
    return Responses(
        pairs=tuple(zip(of_source, of_listener, strict=True)),
        samples=samples,
        sampling_rate=float(rates[0]),
        sources=source_points,
        receivers=listener_points,
        convention=convention,
    )


def _positions(sofa: Any, name: str, n: int, path: str) -> Array:
    """Return positions in m as (n, 3), by their stated coordinates."""
    points = np.atleast_2d(_numbers(sofa, name, path))
    if points.ndim != 2 or points.shape[1] != 3 or len(points) not in (1, n):
        raise DataError(f"{path}: {name} has shape {points.shape}; (1, 3) or ({n}, 3) is needed")
    return np.broadcast_to(_cartesian(sofa, name, points, path), (n, 3))


def _cartesian(sofa: Any, name: str, points: Array, path: str) -> Array:
    """Return points (n, 3) in m, of the coordinates that the file states for them."""
    kind = str(getattr(sofa, f"{name}_Type", "cartesian")).lower()
    if kind == "spherical":  # azimuth and elevation in degrees, radius in m
        azimuth, elevation, radius = (
            np.radians(points[:, 0]),
            np.radians(points[:, 1]),
            points[:, 2],
        )
        flat = radius * np.cos(elevation)
        points = np.stack(
            [flat * np.cos(azimuth), flat * np.sin(azimuth), radius * np.sin(elevation)], axis=1
        )
    elif kind != "cartesian":
        raise DataError(f'{path}: {name} has the type "{kind}"; cartesian or spherical is needed')
    return points


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


def _numbers(sofa: Any, name: str, path: str) -> Array:
    try:
        values = np.asarray(getattr(sofa, name), dtype=float)
    except (AttributeError, TypeError, ValueError) as error:
        raise DataError(f"{path}: {name.replace('_', '.')} is missing or no number") from error
    if values.size == 0 or not np.isfinite(values).all():
        raise DataError(f"{path}: {name.replace('_', '.')} has a value that is not finite")
    return values


def _library() -> Any:
    try:
        import sofar
    except ImportError as error:
        raise MissingDependencyError("SOFA files need sofar: pip install 'rtcal[sofa]'") from error
    return sofar
