"""Room impulse responses and positions of SOFA files (AES69), by sofar (``rtcal[sofa]``).

Read are the conventions of responses in a room: `ROOM_CONVENTIONS`, and the general ones whose
``RoomType`` is no free field. All others are refused by name: head-related transfer functions and
headphones are no measurements of a room. `balloon` reads what a loudspeaker radiates.

Equal positions have one name: S1, S2 and so on, R1, R2 and so on, in the order of the file.

Reference: AES69-2022, "AES standard for file exchange - Spatial acoustic data file format".
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics.measurement import SAME_PLACE
from rtcal.acoustics.scene import Scene
from rtcal.io import budget
from rtcal.support import checks, library
from rtcal.support.errors import DataError
from rtcal.support.types import Array

__all__ = ["Responses", "claims", "read"]
__dir__ = __all__.copy

ROOM_CONVENTIONS = ("SingleRoomSRIR", "SingleRoomMIMOSRIR", "SingleRoomDRIR")
GENERAL_CONVENTIONS = ("GeneralFIR", "GeneralFIR-E")
DIRECTIVITY_CONVENTIONS = ("FreeFieldDirectivityTF", "GeneralTF")
NEAR = 0.1
"""Distance in m within which a position of a file is one of the room."""
_NEEDED = "SOFA files need sofar: pip install 'rtcal[sofa]'"
_PARALLEL = 1e-3
MAX_BYTES = 2**28
MAX_RESPONSES = 2000

_DAMAGED = "cannot be read as SOFA: it is damaged, or not as AES69 has it"
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

    def placed(self, scene: Scene) -> tuple[Responses, str]:
        """Return the responses with the names that a room's scene gives their positions.

        And a sentence that says which names changed, else "". Raises DataError for a position that is
        not within `NEAR` of one of the scene's.
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
                        f"{kind} {name} of the SOFA file is at ({there}) m, {far}; positions of file "
                        f"and room may differ by {NEAR:g} m: are they in the same coordinates?"
                    )
                if own[name] != name:
                    changed.append(f"{kind} {name} is {own[name]}")
            names.append(own)
        pairs = tuple((names[0][s], names[1][r]) for s, r in self.pairs)
        note = f"By their positions in the file, {', '.join(changed)}." if changed else ""
        return replace(self, pairs=pairs), note

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
    if not checks.path("path", path).is_file():
        return False
    with open(path, "rb") as stream:
        return stream.read(len(_HDF5)) == _HDF5


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
    if not claims(path):
        raise DataError(f"{path}, byte 0: not a SOFA (HDF5) file")
    if (size := Path(path).stat().st_size) > MAX_BYTES:
        raise DataError(f"{path}: {size} bytes; at most {MAX_BYTES}")
    _require_shapes(os.fspath(path))
    sofar = library(_NEEDED, "sofar")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of preliminary conventions, which are read as well
        try:
            return sofar.read_sofa(os.fspath(path), verify=False, verbose=False)
        except Exception as error:  # sofar and netCDF4 raise what they meet
            raise DataError(f"{path}: {_DAMAGED}") from error


def _require_shapes(path: str) -> None:
    """Raise DataError if the arrays of a file have more values than the budget, by their shapes."""
    netcdf = library(_NEEDED, "netCDF4")
    try:
        with netcdf.Dataset(path) as data:
            total = sum(
                float(np.prod([float(n) for n in v.shape])) for v in data.variables.values()
            )
    except Exception as error:  # netCDF4 raises what it meets
        raise DataError(f"{path}: {_DAMAGED}") from error
    budget.require(total, budget.MAX_SAMPLES, "values", path, "export fewer responses to a file")


def balloon(path: str | os.PathLike[str]) -> tuple[Array, Array, Array]:
    """Return a source's energy by direction; `rtcal.io.balloon.read` makes use of it.

    Returns
    -------
    directions : array (n_directions, 3)
        Unit vectors: along the axis (``SourceView``), above it (``SourceUp``) and to its left.
    energy : array (n_directions, n_frequencies)
        In any unit.
    frequencies : array (n_frequencies,)
        Hz.

    Raises
    ------
    DataError
        As `read` does; for a convention that is no `DIRECTIVITY_CONVENTIONS`, several measurements, or
        a source whose top is along its axis.
    MissingDependencyError
        Without sofar.
    """
    sofa, place = _opened(path), os.fspath(path)
    convention = str(getattr(sofa, "GLOBAL_SOFAConventions", ""))
    if convention not in DIRECTIVITY_CONVENTIONS:
        raise DataError(
            f"{place}: convention {convention or 'not stated'} is no directivity; read are "
            f"{', '.join(DIRECTIVITY_CONVENTIONS)}"
        )
    energy = _numbers(sofa, "Data_Real", place) ** 2 + _numbers(sofa, "Data_Imag", place) ** 2
    points = np.atleast_2d(_numbers(sofa, "ReceiverPosition", place)).reshape(-1, 3)
    if energy.ndim != 3 or energy.shape[:2] != (1, len(points)):
        raise DataError(
            f"{place}: Data.Real has shape {energy.shape}; (1, {len(points)}, frequencies) is needed: "
            "one measurement, and one receiver for each direction"
        )
    axis = _one(sofa, "SourceView", "SourceView", place)
    up = _one(sofa, "SourceUp", "SourceView", place)
    above = up - (up @ axis) * axis
    if np.linalg.norm(above) < _PARALLEL:
        raise DataError(f"{place}: SourceUp is along SourceView")
    above = above / np.linalg.norm(above)
    axes = np.array([axis, above, np.cross(above, axis)])
    directions = _unit(_cartesian(sofa, "ReceiverPosition", points, place))
    return directions @ axes.T, energy[0], _numbers(sofa, "N", place).reshape(-1)


def _one(sofa: Any, name: str, typed: str, place: str) -> Array:
    """Return the unit vector of a direction, whose coordinates are of the type of another entry."""
    stated = np.atleast_2d(_numbers(sofa, name, place))[:1]
    vector = _cartesian(sofa, typed, stated, place)
    if not np.linalg.norm(vector) > 0:
        raise DataError(f"{place}: {name} is no direction")
    return np.asarray(_unit(vector)[0])


def _unit(points: Array) -> Array:
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


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
    budget.require(length, budget.MAX_CHANNEL_SAMPLES, "samples of a response", path)
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
