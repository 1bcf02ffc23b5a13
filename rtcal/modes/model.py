"""The poles of a room as functions of its coefficients, and what positions hear of them.

A coefficient is smooth over frequency. Its error in prior sigmas, x(f) = (alpha(f) - mu(f)) / sigma(f),
is a Gaussian process whose correlation is r ** octaves. Between the bands mu and sigma are interpolated
over log f; outside they are those of the nearest band. Given x in the bands, x(f) has the mean W x and
a remainder of covariance R (kriging; Rasmussen & Williams 2006, Eq. 2.19). So a mode's decay is an
observation of the bands' own coefficients, and the remainder is an error of it.

A pole is moved by the walls' specific admittance beta = 1 / z. A locally reacting wall absorbs, at the
angle of incidence t,

    alpha(t) = 4 Re(beta) cos t / |cos t + beta|²,

and Paris' integral of alpha(t) sin 2t over t from 0 to 90° is the random-incidence coefficient. A real
beta reaches at most 0.951, at beta = 0.638; `admittance` returns the smaller of the two that have an
alpha.

References
----------
Paris 1928, Phil. Mag. 5; Kuttruff 2009, Room Acoustics, Eq. 2.41 and 2.42.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.air import Air
from rtcal.acoustics.room import Room
from rtcal.io import geometry_files
from rtcal.modes.room_modes import Admittances, Complex, Integers, Poles, RoomModes, modes_of
from rtcal.simulators.geometry import Polyhedron
from rtcal.simulators.path_tracing import area_doubt, check_walls
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

LARGEST = 0.856
"""alpha above which beta follows its tangent, nine tenths of the largest: beta says nothing of alpha
there."""
_NEWTON = 8
"""Steps: the last ones change no digit, at `LARGEST` either."""


def absorption(beta: Complex | Array) -> Array:
    """Return the random-incidence absorption coefficient of specific admittances, same shape.

    Raises DataError for an admittance that is not finite or whose real part is below 0.

    Examples
    --------
    >>> print(absorption([0.01, 0.638, 0.02 + 0.05j]).round(3))
    [0.073 0.951 0.133]
    """
    value = np.asarray(beta, dtype=complex)
    if not np.isfinite(value).all() or (value.real < 0).any():
        raise DataError(f"beta = {checks.shown(beta)} is not finite with a real part of 0 or more")
    # The integral is even in b, and has its limit where b is 0.
    g, b = value.real, np.maximum(np.abs(value.imag), 1e-12)
    # With cos t = x it is 8 g times that of x² / ((x + g)² + b²) over x from 0 to 1.
    log = np.log(((1 + g) ** 2 + b**2) / (g**2 + b**2))
    arc = np.arctan2(b, g * (1 + g) + b**2) / b
    return np.asarray(8 * g * (1 - g * log + (g**2 - b**2) * arc))


def admittance(alpha: Array) -> Array:
    """Return the real specific admittance of this random-incidence absorption coefficient, same shape.

    ``alpha`` is from 0 to 1. Above `LARGEST` beta follows its tangent. Raises DataError for an alpha
    outside.

    Examples
    --------
    >>> print(admittance(0.1).round(4), absorption(admittance(0.5)).round(6))
    0.014 0.5
    """
    value = checks.array("alpha", alpha)
    if not ((value >= 0) & (value <= 1)).all():
        raise DataError(f"alpha = {checks.shown(alpha)} is not within 0 and 1")
    return _with_slope(value)[0]


def admittance_slope(alpha: Array) -> Array:
    """Return d beta / d alpha, same shape; errors as `admittance`."""
    return _with_slope(np.asarray(alpha, dtype=float))[1]


def _with_slope(alpha: Array) -> tuple[Array, Array]:
    """Return beta and its slope over alpha.

    The slope of alpha(beta) falls from 8: Newton's steps from alpha / 8 do not overshoot.
    """
    inside = np.minimum(alpha, LARGEST)
    beta = inside / 8
    for _ in range(_NEWTON):
        beta = beta - (absorption(beta) - inside) / _rise(beta)
    slope = 1 / _rise(beta)
    return beta + (alpha - inside) * slope, slope


def _rise(beta: Array) -> Array:
    """Return d alpha / d beta of a real admittance."""
    share, log = beta / (1 + beta), np.log1p(1 / np.maximum(beta, 1e-300))
    return np.asarray(8 * (1 + share * (4 - share) - 4 * beta * log))


CORRELATION = 0.8
"""Correlation of a coefficient's error an octave apart, where the ``band_correlation`` stated is 0."""
ABOVE = 1.08
"""Modes are calculated up to this times the highest frequency that is asked of them."""
_STEP = 10.0
_MOST_KEPT = 12


@dataclass(frozen=True, eq=False)
class AtFrequencies:
    """The coefficients of a room's materials at single frequencies.

    ``mean`` and ``sigma`` (n_materials, n_frequencies) are alpha's prior there, ``weights``
    (n_frequencies, n_bands) W of the errors in prior sigmas, and ``remainder`` (n_frequencies,
    n_frequencies) R in prior variances.
    """

    mean: Array
    sigma: Array
    weights: Array
    remainder: Array
    prior: Room

    @classmethod
    def of(cls, room: Room, frequencies: Array) -> AtFrequencies:
        """Return the coefficients of a room with correlated bands at these frequencies in Hz."""
        n, places = room.n_bands, np.log2(frequencies)
        every = np.concatenate([room.centre_frequencies, frequencies])
        correlation = bands.correlation(every, room.band_correlation)
        across = correlation[n:, :n]
        weights: Array = np.asarray(np.linalg.solve(correlation[:n, :n], across.T).T)
        mean, sigma = (
            np.asarray([np.interp(places, np.log2(room.centre_frequencies), row) for row in rows])
            for rows in (room.alpha, room.sigma)
        )
        remainder: Array = np.asarray(correlation[n:, n:] - weights @ across.T)
        return cls(mean, sigma, weights, remainder, room)

    def alpha(self, alpha: Array) -> Array:
        """Return alpha there, (n_materials, n_frequencies), of alpha in the bands."""
        room = self.prior
        shift = np.divide(
            alpha - room.alpha, room.sigma, out=np.zeros_like(alpha), where=room.sigma > 0
        )
        # A Gaussian process knows no bounds; alpha has them.
        return np.asarray(np.clip(self.mean + self.sigma * (shift @ self.weights.T), 0.0, 1.0))

    def slope(self) -> Array:
        """Return d alpha(f) / d alpha(band), (n_materials, n_frequencies, n_bands)."""
        sigma = self.prior.sigma
        inverse = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0)
        return np.asarray(self.sigma[:, :, np.newaxis] * self.weights * inverse[:, np.newaxis, :])


@dataclass(frozen=True, eq=False)
class RoomPoles:
    """The room's poles as functions of alpha in its bands.

    ``room`` states the correlation of its bands.
    """

    room: Room
    modes: RoomModes

    @classmethod
    def of(cls, room: Room, largest: float, geometry: Polyhedron | None = None) -> RoomPoles:
        """Return the poles of a room's modes up to at least ``largest`` in Hz.

        Errors as `rtcal.calibrate_modes`.
        """
        geometry = geometry_files.read(room) if geometry is None else geometry
        check_walls(geometry, room)
        if doubt := area_doubt(geometry, room):
            raise DataError(doubt)
        # In steps, so that another measurement of the room needs the same modes.
        top = _STEP * float(np.ceil(largest / _STEP - 1e-9))
        modes = modes_of(geometry, top, (room.air or Air()).speed_of_sound)
        if not modes.wanted:
            raise DataError(f"the room has no mode up to {modes.largest:g} Hz")
        return cls(room.replace(band_correlation=room.band_correlation or CORRELATION), modes)

    @cached_property
    def at(self) -> AtFrequencies:
        """The coefficients at the modes' frequencies, those that complete the shapes as well."""
        return AtFrequencies.of(self.room, self.modes.frequencies)

    @cached_property
    def rows(self) -> list[int]:
        """The material of each wall."""
        return [self.room.material_index(m) for m in self.modes.materials]

    @cached_property
    def calculated(self) -> Poles:
        """All poles with the room's own coefficients."""
        return self.poles(self.room.alpha)

    def poles(self, alpha: Array) -> Poles:
        """Return all poles, with the shapes of those `calculated`; the modes keep the last ones."""
        own = np.array_equal(alpha, self.room.alpha)
        walls = [of[self.rows].tobytes() for of in (self.at.mean, self.at.alpha(alpha))]
        known, key = self.modes.known, walls[0] if own else b"".join(walls)
        if key not in known:
            like = None if own else self.calculated.mixtures
            if len(known) >= _MOST_KEPT:
                known.pop(next(iter(known)))
            known[key] = self.modes.poles(self._admittances(alpha), like)
        return known[key]

    def _admittances(self, alpha: Array) -> Admittances:
        """Return the walls' admittances; between the modes' frequencies they are interpolated."""
        f = self.modes.frequencies
        beta = admittance(self.at.alpha(alpha))
        return lambda frequency: np.array([np.interp(frequency, f, row) for row in beta])[self.rows]

    def amplitudes(self, pairs: Sequence[tuple[str, str]]) -> Complex:
        """Return what each pair of positions hears of each pole, (n_poles, n_pairs).

        Of a source of the same strength at all frequencies, with the room's own coefficients.
        """
        scene, poles = self.room.scene, self.calculated
        for source, receiver in pairs:
            if source not in scene.sources or receiver not in scene.receivers:
                raise DataError(
                    f"pairs: {source} to {receiver} has no place; the room's scene has sources "
                    f"{', '.join(scene.sources) or 'none'} and receivers "
                    f"{', '.join(scene.receivers) or 'none'}"
                )
        heard = {}
        for side, of in enumerate((scene.sources, scene.receivers)):
            for name in {pair[side] for pair in pairs}:
                try:
                    shapes = self.modes.shapes(np.array([of[name]], dtype=float))
                except DataError as error:
                    place = ", ".join(f"{x:g}" for x in of[name])
                    raise DataError(f"{name} at ({place}) m: {error}") from error
                heard[side, name] = shapes[0] @ poles.mixtures
        at = [np.array([heard[side, pair[side]] for pair in pairs]) for side in (0, 1)]
        return np.asarray((at[0] * at[1] / poles.norms).T)

    def linear(self, alpha: Array, chosen: Integers) -> tuple[Array, Array, Array]:
        """Return chosen modes' decays, their slopes by alpha in the bands, and the remainder.

        (n_modes,), (n_modes, n_materials * n_bands) and (n_modes, n_modes), in 1/s.
        """
        poles, columns = self.poles(alpha), chosen.tolist()
        beta_slope = admittance_slope(self.at.alpha(alpha)[:, columns])
        by_material = np.zeros((len(columns), self.room.n_materials), dtype=complex)
        for wall, row in enumerate(self.rows):
            by_material[:, row] += poles.slopes[columns, wall]
        # Of delta by alpha at the mode's own frequency.
        slope = -(by_material * beta_slope.T).real
        matrix = slope[:, :, np.newaxis] * self.at.slope()[:, columns].transpose(1, 0, 2)
        in_sigmas = slope * self.at.sigma[:, columns].T
        remainder = (in_sigmas @ in_sigmas.T) * self.at.remainder[np.ix_(columns, columns)]
        air = self.room.air_attenuation * self.modes.speed_of_sound / 2
        air = np.interp(poles.frequencies, self.room.centre_frequencies, air)
        return (poles.decays + air)[columns], matrix.reshape(len(columns), -1), remainder
