"""Coefficients of a material between and below its bands: smooth over frequency.

The error of a stated coefficient in prior sigmas, x(f) = (alpha(f) - mu(f)) / sigma(f), is a Gaussian
process over frequency whose correlation is r ** octaves. Between the bands mu and sigma are
interpolated over log f; outside they are those of the nearest band. Given x in the bands, x(f) has the
mean W x and a remainder of covariance R (kriging; Rasmussen & Williams 2006, Eq. 2.19). So a mode's
decay is an observation of the bands' own coefficients, and the remainder is an error of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rtcal.acoustics.room import Room
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False)
class AtFrequencies:
    """The coefficients of a room's materials at single frequencies.

    Attributes
    ----------
    mean, sigma : array (n_materials, n_frequencies)
        Prior of alpha there.
    weights : array (n_frequencies, n_bands)
        W of the errors in prior sigmas.
    remainder : array (n_frequencies, n_frequencies)
        R in prior variances.
    prior : Room
    """

    mean: Array
    sigma: Array
    weights: Array
    remainder: Array
    prior: Room

    @classmethod
    def of(cls, room: Room, frequencies: Array, correlation: float) -> AtFrequencies:
        """Return a room's coefficients at these frequencies in Hz, (n_frequencies,).

        Examples
        --------
        >>> room = Room(name="box", volume=60, materials=["wall"], areas=[94], alpha=[[0.1, 0.2]],
        ...             sigma=[[0.1, 0.1]], centre_frequencies=[63, 125])
        >>> at = AtFrequencies.of(room, np.array([31.25, 88.4]), 0.7)
        >>> print(at.mean.round(3), at.weights.round(3).tolist())
        [[0.1   0.149]] [[0.697, 0.0], [0.498, 0.487]]
        """
        bands, places = np.log2(room.centre_frequencies), np.log2(frequencies)

        def between(a: Array, b: Array) -> Array:
            return np.asarray(correlation ** np.abs(a[:, np.newaxis] - b))

        across = between(places, bands)
        weights: Array = np.asarray(np.linalg.solve(between(bands, bands), across.T).T)
        mean, sigma = (
            np.asarray([np.interp(places, bands, row) for row in rows])
            for rows in (room.alpha, room.sigma)
        )
        remainder: Array = np.asarray(between(places, places) - weights @ across.T)
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
