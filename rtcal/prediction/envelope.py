"""The probability that T is in a range, and the largest allowed sd of the absorption at each mean.

The absorption area A of the surfaces is normal with mean m and standard deviation s, and

    ln T = f(A) + offset + r,  r normal with standard deviation tau,

f the equation's ln T. P(m, s) is the probability that T is in its range. g(m), the largest s at which
P(m, s) is at least p, is concave for p from 0.8 on, but for rounding. Its chords are linear
constraints on s: below them, the probability is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.acoustics.targets import Target
from rtcal.support.types import Array

CHORDS = 16
_POINTS = 49
_HALVINGS = 20
# A trapezium rule: for a smooth function times the normal density it converges exponentially, also
# where r is a few times narrower than A's spread. Gauss-Hermite nodes are too far apart there.
_NODES = np.linspace(-4.2, 4.2, 43)
_WEIGHTS = np.exp(-(_NODES**2) / 2) / np.exp(-(_NODES**2) / 2).sum()
_EDGE = 1e-9
"""Share of the whole surface by which A keeps off 0 and the equation's largest absorption."""
_NARROWEST = 1e-6
"""Least width of the means that are allowed, in shares of the surface: below, there is no design."""
_LOOSE = 10.0
"""Largest sd, in shares of the surface, of a band without a range."""


@dataclass(frozen=True, eq=False)
class Ranges:
    """Ranges of T of one room, in terms of the absorption area of its surfaces.

    Attributes
    ----------
    room : Room
        Its volume, air and total area count.
    equation : LinearEquation
    target : Target
    offset, tau : array (n_bands,)
        Mean and standard deviation of ln T less that of the equation.
    """

    room: Room
    equation: LinearEquation
    target: Target
    offset: Array
    tau: Array

    def probability(self, mean: Array, sigma: Array) -> Array:
        """Return P that T is in range for A of mean and standard deviation in m², (..., n_bands)."""
        area = mean[..., np.newaxis, :] + sigma[..., np.newaxis, :] * _NODES[:, np.newaxis]
        whole = self.room.total_area
        top = min(self.equation.largest_mean, 1.0) - _EDGE
        area = np.clip(area, _EDGE * whole, top * whole)
        log_time = np.log(self.equation.time(self.room, area)) + self.offset
        tau = np.maximum(self.tau, 1e-9)
        high = ndtr((np.log(self.target.high) - log_time) / tau)
        low = ndtr((np.log(self.target.low) - log_time) / tau)
        inside = np.where(np.isnan(high), 1.0, high) - np.where(np.isnan(low), 0.0, low)
        return np.asarray(np.einsum("...qk,q->...k", inside, _WEIGHTS))

    def best(self) -> tuple[Array, Array]:
        """Return the mean at which a known A would be most probably in range, and that probability."""
        whole = self.room.total_area
        means = np.linspace(0.001, 0.999, 400)[:, np.newaxis] * np.full(len(self.tau), whole)
        found = self.probability(means, np.zeros_like(means))
        at = np.argmax(found, axis=0)
        bands = np.arange(len(self.tau))
        return means[at, bands], found[at, bands]

    def chords(self, probability: float) -> tuple[Array, Array] | None:
        """Return intercepts in m² and slopes of the chords of g, each (n_bands, CHORDS).

        None if a band cannot be in range with this probability, whatever A is.
        """
        whole, n_bands = self.room.total_area, len(self.tau)
        peak, best = self.best()
        bounded = np.asarray(self.target.bounded)
        if (best[bounded] < probability).any():
            return None
        first = self._edge(probability, peak, np.full(n_bands, _EDGE * whole))
        last = self._edge(probability, peak, np.full(n_bands, (1 - _EDGE) * whole))
        if ((last - first)[bounded] < _NARROWEST * whole).any():
            return None
        means = first + (last - first) * _denser_at_the_ends(_POINTS)[:, np.newaxis]
        sigmas = self._largest(probability, means)
        intercept, slope = np.full((n_bands, CHORDS), _LOOSE * whole), np.zeros((n_bands, CHORDS))
        for k in np.flatnonzero(bounded):
            intercept[k], slope[k] = _chords(means[:, k], sigmas[:, k])
        return intercept, slope

    def _edge(self, probability: float, inside: Array, outside: Array) -> Array:
        """Return the mean nearest ``outside`` at which a known A is in range with the probability."""
        kept = self.probability(outside, np.zeros_like(outside)) >= probability
        for _ in range(2 * _HALVINGS):
            middle = (inside + outside) / 2
            good = self.probability(middle, np.zeros_like(middle)) >= probability
            inside, outside = np.where(good, middle, inside), np.where(good, outside, middle)
        return np.where(kept, outside, inside)

    def _largest(self, probability: float, means: Array) -> Array:
        low, high = np.zeros_like(means), np.full_like(means, self.room.total_area)
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            good = self.probability(means, middle) >= probability
            low, high = np.where(good, middle, low), np.where(good, high, middle)
        return low


def _chords(means: Array, sigmas: Array) -> tuple[Array, Array]:
    """Return the chords of the concave hull of points, (CHORDS,) each."""
    hull: list[int] = []
    for i in range(len(means)):
        while len(hull) > 1 and _turns_up(means, sigmas, hull[-2], hull[-1], i):
            hull.pop()
        hull.append(i)
    knots = np.linspace(means[0], means[-1], CHORDS + 1)
    heights = np.interp(knots, means[hull], sigmas[hull])
    slope = np.diff(heights) / np.diff(knots)
    return heights[:-1] - slope * knots[:-1], slope


def _denser_at_the_ends(number: int) -> Array:
    """Return places from 0 to 1, closer towards both ends, where g rises most steeply."""
    return np.asarray((1 - np.cos(np.pi * np.linspace(0, 1, number))) / 2)


def _turns_up(x: Array, y: Array, a: int, b: int, c: int) -> bool:
    return bool((y[b] - y[a]) * (x[c] - x[b]) <= (y[c] - y[b]) * (x[b] - x[a]))
