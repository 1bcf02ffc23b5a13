"""Third-octaves to octaves and back: the one rule for every format, table and measurement.

An octave consists of its three thirds, each with the same weight:

- Absorption coefficients and areas average.
- Decay times average by their rate: 1/T_octave = mean of 1/T_third, since T is the inverse of an
  absorption area.
- C50 and C80 average as the early share of the energy, D50 and Ts as they are, G as energy.

A third takes the value of its octave, so that the thirds average to the octave again. An octave
with a missing value in one of its thirds is missing. An octave without all of its three thirds is
refused.

Standard deviations follow from what the errors share. The errors of the tabulated coefficients of a
material are fully correlated within an octave, so sigma averages like alpha. The errors of measured
values are independent between thirds, since their variance is inversely proportional to the
bandwidth (ISO 3382-2:2008, Eqs. 4 and 5): a third has sqrt(3) times the octave's uncertainty.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import ITSELF, TARGET, Scale, observable
from rtcal.acoustics.room import Room
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

__all__ = [
    "absorption",
    "measurement",
    "measurement_in_room_bands",
    "obtainable",
    "parameter",
    "parameter_uncertainty",
    "room",
    "rule",
    "unused",
]
__dir__ = __all__.copy


def obtainable(frequencies: Iterable[float], wanted: Iterable[float]) -> Array:
    """Return the ``wanted`` bands in Hz that can be converted from the bands ``frequencies``.

    Examples
    --------
    >>> print(obtainable([400, 500, 630, 800], [250, 500, 1000]))
    [500.]
    """
    old, new = bands.as_bands(frequencies), bands.as_bands(wanted)
    centres = set(old.tolist())
    parts = _parts(old, new)
    return np.array([f for f, part in zip(new, parts, strict=True) if set(part) <= centres])


def unused(frequencies: Iterable[float], wanted: Iterable[float]) -> Array:
    """Return the bands in Hz of ``frequencies`` that no band of ``wanted`` is made from.

    Examples
    --------
    >>> print(unused([400, 500, 630, 800], [250, 500, 1000]))
    [800.]
    """
    old = bands.as_bands(frequencies)
    new = obtainable(old, wanted)
    used = {f for part in _parts(old, new) for f in part} if new.size else set()
    return np.array([f for f in old if f not in used])


def rule(frequencies: Iterable[float], wanted: Iterable[float], quantity: str) -> str:
    """Return in a sentence how a quantity is converted; empty where the bands are of one width.

    Examples
    --------
    >>> rule([400, 500, 630], [500], "alpha")
    'alpha is converted from third-octaves to octaves: the mean of the three thirds'
    """
    was_thirds, are_thirds = (
        _in_thirds(bands.as_bands(frequencies)),
        _in_thirds(bands.as_bands(wanted)),
    )
    if was_thirds == are_thirds:
        return ""
    if are_thirds:
        return f"{quantity} is converted from octaves to third-octaves: that of the octave"
    average = (
        "the mean of 1/T over the three thirds"
        if quantity == "T"
        else "the mean of the three thirds"
    )
    return f"{quantity} is converted from third-octaves to octaves: {average}"


def notes(measured: Iterable[float], wanted: Iterable[float], quantity: str = "T") -> list[str]:
    """Return how a measurement is taken to a room's bands, and the bands that the room lacks.

    Examples
    --------
    >>> notes([500, 1000], [500])
    ['left out, not in the room: 1000 Hz']
    """
    stated = bands.as_bands(measured)
    said = [rule(stated, wanted, quantity)]
    if (left := unused(stated, wanted)).size:
        said.append(f"left out, not in the room: {', '.join(bands.labels(left))}")
    return [note for note in said if note]


def absorption(values: Array, frequencies: Iterable[float], wanted: Iterable[float]) -> Array:
    """Return absorption coefficients or areas, or their sigma, in other bands.

    Parameters
    ----------
    values : array (..., n_bands)
        Bands last; NaN where missing.
    frequencies : sequence (n_bands,)
        Their centre frequencies in Hz, thirds or octaves.
    wanted : sequence (n_wanted,)
        The centre frequencies in Hz to convert to, thirds or octaves.

    Returns
    -------
    array (..., n_wanted)

    Raises
    ------
    DataError
        If an octave lacks one of its thirds, or a third its octave. `obtainable` returns the bands
        that lack none.

    Examples
    --------
    >>> print(absorption([0.1, 0.2, 0.6], [400, 500, 630], [500]))
    [0.3]
    >>> print(absorption([0.3], [500], [400, 500, 630]))
    [0.3 0.3 0.3]
    """
    return _averaged(ITSELF, values, _Columns(frequencies, wanted))


def parameter(
    values: Array, frequencies: Iterable[float], wanted: Iterable[float], name: str = TARGET.key
) -> Array:
    """Return a measured or simulated parameter in other bands, (..., n_wanted).

    Parameters
    ----------
    values : array (..., n_bands)
        In the unit of `Measurement`, bands last; NaN where missing.
    frequencies, wanted : sequence
        Centre frequencies in Hz, thirds or octaves.
    name : str
        A key of `rtcal.acoustics.observables.OBSERVABLES`.

    Raises
    ------
    DataError
        For an unknown parameter or a value that it cannot have; if an octave lacks one of its
        thirds, or a third its octave.

    Examples
    --------
    >>> print(parameter([1.0, 2.0, 2.0], [400, 500, 630], [500]))
    [1.5]
    """
    kind, values = observable(name), checks.array("values", values)
    if (broken := kind.broken(values)).any():
        raise DataError(f"{name} = {values[broken][0]:g} is not {kind.value_rule}")
    return _averaged(kind.averaging, values, _Columns(frequencies, wanted))


def parameter_uncertainty(
    uncertainty: Array,
    values: Array,
    frequencies: Iterable[float],
    wanted: Iterable[float],
    name: str = TARGET.key,
) -> Array:
    """Return the standard uncertainty of a measured parameter in other bands, (..., n_wanted).

    Parameters
    ----------
    uncertainty, values : array (..., n_bands)
        Of the parameter ``name`` and in its unit, bands last; NaN where missing or unknown.
    frequencies, wanted : sequence
        Centre frequencies in Hz, thirds or octaves.

    Raises
    ------
    DataError
        As `parameter`, and for two arrays of different shapes.

    Examples
    --------
    >>> u = parameter_uncertainty([0.03, 0.03, 0.03], [1.0, 1.0, 1.0], [400, 500, 630], [500])
    >>> print(u.round(4))
    [0.0173]
    """
    scale, columns = observable(name).averaging, _Columns(frequencies, wanted)
    spread, centre = checks.array("uncertainty", uncertainty), checks.array("values", values)
    if spread.shape != centre.shape:
        raise DataError(f"uncertainty has shape {spread.shape}; values has {centre.shape}")
    return _uncertainty(scale, spread, centre, columns)


def room(stated: Room, wanted: Iterable[float]) -> Room:
    """Return the room in other bands: alpha, sigma, alpha_min and scattering by `absorption`.

    The air is the same; its attenuation is that of the new bands.

    Raises
    ------
    DataError
        If an octave lacks one of its thirds, or a third its octave.
    """
    checks.instance("room", stated, Room)
    centres = bands.as_bands(wanted)
    tables = {n: getattr(stated, n) for n in ("alpha", "sigma", "alpha_min", "scattering")}
    return stated.replace(
        centre_frequencies=centres,
        **{
            name: absorption(table, stated.centre_frequencies, centres)
            for name, table in tables.items()
            if table is not None
        },
    )


def measurement(
    measured: Measurement, wanted: Iterable[float], *, missing: bool = False
) -> Measurement:
    """Return the measurement in other bands, each parameter by `parameter`.

    The standard deviation over pairs converts like an uncertainty.

    Raises
    ------
    DataError
        If an octave lacks one of its thirds, or a third its octave, unless bands may be ``missing``.
    """
    checks.instance("measured", measured, Measurement)
    columns = _Columns(measured.centre_frequencies, wanted, missing)
    of: dict[str, Callable[[str], Array]] = {
        "uncertainty": lambda p: measured.values[p],
        "common_uncertainty": measured.mean,
        "standard_deviation": lambda p: measured.values[p][0],
    }
    tables: dict[str, Any] = {
        name: {
            p: _uncertainty(observable(p).averaging, u, centre(p), columns)
            for p, u in getattr(measured, name).items()
        }
        for name, centre in of.items()
    }
    tables["values"] = {
        p: _averaged(observable(p).averaging, v, columns) for p, v in measured.values.items()
    }
    return replace(measured, centre_frequencies=columns.new, **tables)


def measurement_in_room_bands(measured: Measurement, wanted: Iterable[float]) -> Measurement:
    """Return the measurement in exactly the ``wanted`` bands, with missing values where it has none.

    Bands of the room's width are selected, others are converted by `measurement`. Everything that
    compares a measurement with a room uses this rule.

    Raises
    ------
    DataError
        If no band can be selected or converted.
    """
    centres = bands.as_bands(wanted)
    if not obtainable(measured.centre_frequencies, centres).size:
        raise DataError(
            f"the measurement ({_listed(measured.centre_frequencies.tolist())}) and the room "
            f"({_listed(centres.tolist())}) have no band in common"
        )
    return measurement(measured, centres, missing=True)


def _uncertainty(scale: Scale, uncertainty: Array, values: Array, columns: _Columns) -> Array:
    if columns.to_thirds:
        return np.asarray(np.sqrt(3) * columns.take(uncertainty)[..., 0])
    by_third = columns.take(scale.slope(values) * uncertainty)
    total = np.sqrt((by_third**2).sum(-1)) / by_third.shape[-1]
    return np.asarray(total / np.abs(scale.slope(_averaged(scale, values, columns))))


def _averaged(scale: Scale, values: Array, columns: _Columns) -> Array:
    parts = columns.take(checks.array("values", values))
    if parts.shape[-1] == 1:
        return parts[..., 0]
    return np.asarray(scale.inverse(scale.forward(parts).mean(-1)))


class _Columns:
    """Which columns of the old bands make up each new band, (n_wanted, 1 or 3)."""

    def __init__(
        self, frequencies: Iterable[float], wanted: Iterable[float], missing: bool = False
    ) -> None:
        self.old = bands.as_bands(frequencies, "frequencies")
        self.new = new = bands.as_bands(wanted, "wanted")
        self.to_thirds = _in_thirds(new) and not _in_thirds(self.old)
        parts = _parts(self.old, new)
        place = {f: i for i, f in enumerate(self.old.tolist())}
        for frequency, part in zip(new.tolist(), parts, strict=True):
            lacking = [f for f in part if f not in place]
            if lacking and not missing:
                raise DataError(
                    f"the band {bands.label(frequency)} cannot be had: it needs "
                    f"{_listed(part)}, and {_listed(lacking)} {'are' if lacking[1:] else 'is'} "
                    f"missing in {_listed(self.old.tolist())}"
                )
        self._index = np.array([[place.get(f, -1) for f in part] for part in parts])

    def take(self, values: Array) -> Array:
        """Return (..., n_wanted, 1 or 3)."""
        if values.ndim == 0 or values.shape[-1] != len(self.old):
            raise DataError(
                f"values has shape {values.shape}; its last axis has {len(self.old)} bands"
            )
        return np.where(self._index < 0, np.nan, values[..., self._index])


def _parts(old: Array, new: Array) -> list[list[float]]:
    """Return for each new band the old bands that it is made from, present or not."""
    is_thirds, are_thirds = _in_thirds(old), _in_thirds(new)
    if are_thirds and not is_thirds:
        octave = {f: float(o) for o in bands.OCTAVES for f in _thirds_of(o)}
        return [[octave.get(f, f)] for f in new.tolist()]
    if is_thirds and not are_thirds:
        return [_thirds_of(f) for f in new.tolist()]
    return [[f] for f in new.tolist()]


def _in_thirds(centres: Array) -> bool:
    """Whether bands are third-octaves: one of them is no octave's centre."""
    return any(f in bands.THIRD_OCTAVES and f not in bands.OCTAVES for f in centres.tolist())


def _thirds_of(octave: float) -> list[float]:
    if octave not in bands.OCTAVES:
        return [octave]
    place = bands.THIRD_OCTAVES.index(octave)
    return [float(f) for f in bands.THIRD_OCTAVES[place - 1 : place + 2]]


def _listed(frequencies: list[float]) -> str:
    return f"{', '.join(f'{f:g}' for f in frequencies)} Hz"
