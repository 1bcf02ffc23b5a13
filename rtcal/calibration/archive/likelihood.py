"""The Gaussian model of an archive: what rooms have in common, and what each tells the others.

In room r, material i has in band k the coefficient, in all states of the room,

    alpha_rik = mu_ik + d_ik + h mu_ik + e_rik + g_r mu_ik,

with the table's entry mu and its sigma. d is how far the entry is off in all rooms, h how far all
tables are off together, e how far the material in this room differs from others of its name, and g_r a
factor of this room. The absorption area b_rsk that the T of its state s asks for is
sum S_rsi alpha_rik, with an error of the equation relative to b, and the errors of T, volume and areas.
All are normal, so the means follow in one linear step, and the marginal likelihood in closed form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from rtcal.support.types import Array

_USUAL = {
    "table": (1.0, 0.5),
    "between": (0.5, 0.7),
    "room": (0.1, 0.7),
    "together": (0.1, 0.7),
    "equation": (0.03, 0.7),
}
"""Prior of each standard deviation: its median, and the standard deviation of its logarithm."""
_LOGIT = (0.85, 1.0)
"""Prior of the band correlation's logit, as mean and standard deviation: about 0.7."""
_CENTRE, _WIDTH = np.array(
    [*((np.log(median), width) for median, width in _USUAL.values()), _LOGIT]
).T
_STEP = 0.05
"""Step of the cost's second differences, in logarithms."""
_MEDIANS = {name: median for name, (median, _) in _USUAL.items()} | {"correlation": 0.7}


@dataclass(frozen=True, kw_only=True)
class Spread:
    """The spread of coefficients, found by marginal likelihood.

    Attributes
    ----------
    table, between : float
        In units of the stated sigma: how far an entry is off in all rooms, and how far a material of
        one name differs between rooms.
    room, together : float
        Relative: the factor of a room, and of all tables together.
    equation : float
        Relative error of b, of each state and band on its own.
    correlation : float
        Of one material's errors an octave apart.
    """

    table: float
    between: float
    room: float
    together: float
    equation: float
    correlation: float


def _spread(x: Array) -> Spread:
    """The spread of its logarithms, and of the logit of its correlation.

    Each is at least 0.001: rooms without any noise would leave the covariance singular.
    """
    values = np.exp(np.clip(x[:-1], np.log(1e-3), 3)).tolist()
    correlation = float(1 / (1 + np.exp(-np.clip(x[-1], -8, 4))))
    return Spread(**dict(zip(_USUAL, values, strict=True)), correlation=correlation)


def _point(spread: Spread) -> Array:
    """The inverse of `_spread`."""
    logit = np.log(spread.correlation / (1 - spread.correlation))
    return np.append(np.log([getattr(spread, name) for name in _USUAL]), logit)


@dataclass(frozen=True, eq=False)
class RoomData:
    """The evidence of a room: its absorption area by state and band, and how sure it is.

    Attributes
    ----------
    areas : array (n_states, n_materials)
        m² of each of the archive's materials.
    target : array (n_states, n_bands)
        b in m², NaN where there is no T.
    covariance : array (n_states n_bands, n_states n_bands)
        Of b through T, volume, areas and climate, in m⁴, the bands last.
    weight : float
        Above 0; 1 counts in full. With a weight w, what the room has of its own has 1 / w times its
        usual variance.
    """

    areas: Array
    target: Array
    covariance: Array
    weight: float = 1.0


class Evidence:
    """The rows b_rsk of all rooms, and the model's covariance of them."""

    def __init__(self, rooms: Sequence[RoomData], mu: Array, sigma: Array, octaves: Array) -> None:
        self.mu, self.sigma, self.rooms = mu, sigma, rooms
        place = [(r, *at) for r, d in enumerate(rooms) for at in np.argwhere(d.target > 0).tolist()]
        self.room, state, self.band = np.array(place, dtype=int).reshape(-1, 3).T
        self.distance = np.abs(octaves[:, np.newaxis] - octaves)
        self.areas = np.array([rooms[r].areas[s] for r, s, _ in place])
        self.target = np.array([rooms[r].target[s, k] for r, s, k in place])
        self.weight = np.array([rooms[r].weight for r in self.room])
        self.same_room = self.room[:, np.newaxis] == self.room
        self.noise = np.zeros_like(self.same_room, dtype=float)
        for r, data in enumerate(rooms):
            rows = np.flatnonzero(self.room == r)
            used = state[rows] * len(octaves) + self.band[rows]
            self.noise[np.ix_(rows, rows)] = data.covariance[np.ix_(used, used)]
        self.expected = self.total(mu)
        self.miss = self.target - self.expected
        self.spreads = self.areas * sigma.T[self.band]  # S sigma of each row and material
        self.shared = self.spreads @ self.spreads.T
        # Noise that does not depend on the spread: else a room of little weight would still shape it.
        self.noise = self.noise + (1 / self.weight - 1) * self.own(Spread(**_MEDIANS))

    def total(self, alpha: Array) -> Array:
        """Return S'alpha of each row in m²."""
        return np.asarray(np.sum(self.areas * alpha.T[self.band], axis=1))

    def covariance(self, spread: Spread) -> Array:
        """Return the covariance of the rows about S'mu, in m⁴."""
        together = np.outer(self.expected, self.expected)
        shared = self.shared * self.correlation(spread)[np.ix_(self.band, self.band)]
        common = spread.table**2 * shared + spread.together**2 * together
        return np.asarray(common + self.own(spread))

    def own(self, spread: Spread) -> Array:
        """Return the part of the covariance that each room has of its own, in m⁴."""
        shared = self.shared * self.correlation(spread)[np.ix_(self.band, self.band)]
        of_room = spread.between**2 * shared
        of_room = of_room + spread.room**2 * np.outer(self.expected, self.expected)
        equation = np.diag((spread.equation * self.target) ** 2)
        return np.asarray(np.where(self.same_room, of_room, 0.0) + equation + self.noise)

    def correlation(self, spread: Spread) -> Array:
        """Return that of one material's errors in two bands, (n_bands, n_bands)."""
        return np.asarray(spread.correlation**self.distance)

    def fitted(self, rows: NDArray[np.bool_] | None = None, start: Spread | None = None) -> Spread:
        """Return the spread of the largest marginal likelihood of ``rows`` times `_USUAL`."""
        first = _CENTRE if start is None else _point(start)
        return _spread(minimize(self._cost, first, (rows,), method="L-BFGS-B").x)

    def plausible(self, spread: Spread) -> list[Spread]:
        """Return spreads of equal weight about the fitted one, as uncertain as the rows leave it.

        Two along each axis of the normal density that has the cost's curvature there, so that mean and
        covariance are its own (Julier & Uhlmann 1997, Proc. SPIE 3068, Eq. 12).
        """
        centre, size = _point(spread), len(_CENTRE)
        steps = _STEP * np.eye(size)
        curvature = np.array(
            [
                [
                    sum(
                        s * t * self._cost(centre + s * a + t * b, None)
                        for s in (-1, 1)
                        for t in (-1, 1)
                    )
                    for b in steps
                ]
                for a in steps
            ]
        ) / (4 * _STEP**2)
        values, axes = np.linalg.eigh(curvature)
        # Where the cost is flat, or rounds, the prior of the spread bounds it.
        reach = np.sqrt(size / np.maximum(values, 1 / np.max(_WIDTH) ** 2))
        ends = [sign * r * axis for r, axis in zip(reach, axes.T, strict=True) for sign in (-1, 1)]
        return [_spread(centre + end) for end in ends]

    def _cost(self, x: Array, rows: NDArray[np.bool_] | None) -> float:
        """The negative logarithm of the marginal likelihood times the spread's prior."""
        used = np.s_[:, :] if rows is None else np.ix_(rows, rows)
        miss = self.miss if rows is None else self.miss[rows]
        factor, low = cho_factor(self.covariance(_spread(x))[used], lower=True)
        quadratic = miss @ cho_solve((factor, low), miss)
        penalty = np.sum(((x - _CENTRE) / _WIDTH) ** 2)
        return float(np.sum(np.log(np.diag(factor))) + 0.5 * quadratic + 0.5 * penalty)

    def posterior(self, spread: Spread, rows: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return the entries' means (n_materials, n_bands) from ``rows``, and their covariance.

        An entry is mu + d + h mu: what all rooms have in common. Its covariance has shape
        (n_materials n_bands, n_materials n_bands), the bands last.
        """
        n, k = self.mu.shape
        correlation = self.correlation(spread)
        sigma, mu = self.sigma.ravel(), self.mu.ravel()
        same = np.kron(np.eye(n), np.ones((k, k)))
        prior = spread.table**2 * same * np.tile(correlation, (n, n)) * np.outer(sigma, sigma)
        prior = prior + spread.together**2 * np.outer(mu, mu)
        matrix = self.matrix(self.areas[rows], self.band[rows])
        whole = self.covariance(spread)[np.ix_(rows, rows)]
        cross = prior @ matrix.T
        factor = cho_factor(whole, lower=True)
        mean = mu + cross @ cho_solve(factor, self.miss[rows])
        return mean.reshape(n, k), prior - cross @ cho_solve(factor, cross.T)

    def together(self, spread: Spread) -> tuple[float, float]:
        """Return the mean and the variance of h, by which all tables are off together."""
        cross = spread.together**2 * self.expected
        gain = cho_solve(cho_factor(self.covariance(spread), lower=True), cross)
        return float(gain @ self.miss), float(spread.together**2 - gain @ cross)

    def matrix(self, areas: Array, band: NDArray[np.int_]) -> Array:
        """Return areas over the entries, (n_rows, n_materials n_bands), from those of rows, in m²."""
        out = np.zeros((len(areas), *self.mu.shape))
        out[np.arange(len(out)), :, band] = areas
        return out.reshape(len(out), -1)


MISNAMED = 0.01
"""Prior probability that one material of a room is another than it is named."""


@dataclass(frozen=True, eq=False)
class Judged:
    """One room beside all others.

    Attributes
    ----------
    miss, covariance : array
        b less what the other rooms predict, in m², and its covariance: the room's rows.
    sigma : array (n_materials, n_bands)
        Of the entries without this room.
    factor, factor_sigma : float
        The room's factor g, and its standard deviation.
    suspicion : array (n_materials, n_materials + 1)
        Probability that the first is the second; the last column is none of the archive's.
    """

    miss: Array
    covariance: Array
    sigma: Array
    factor: float
    factor_sigma: float
    suspicion: Array


def judged(evidence: Evidence, spread: Spread, room: int) -> Judged:
    """Return what the other rooms say of one room.

    Their spread is found without it: a room that does not fit would excuse itself. ``spread`` is that
    of all rooms, with which the search begins.
    """
    own = evidence.room == room
    n = len(evidence.mu)
    # With the spread of all rooms, so that the difference is what this room taught of the means.
    less = np.diag(evidence.posterior(spread, ~own)[1])
    spread = evidence.fitted(~own, spread)
    mean, covariance = evidence.posterior(spread, ~own)
    band, stated = evidence.band[own], evidence.areas[own]
    correlation = evidence.correlation(spread)[np.ix_(band, band)]
    target = evidence.target[own]
    noise = evidence.noise[np.ix_(own, own)] + np.diag((spread.equation * target) ** 2)
    # A material that the archive lacks: like one of its entries, but nobody knows which.
    other = mean.mean(axis=0)[band]
    width = np.sqrt(mean.var(axis=0) + np.mean(evidence.sigma**2, axis=0))[band]

    def predicted(covered: Array, alien: Array) -> tuple[Array, Array]:
        """b and its covariance with ``covered`` m² of each entry and ``alien`` m² of none of them."""
        matrix = evidence.matrix(covered, band)
        total = matrix @ mean.ravel() + alien * other
        sigma = evidence.sigma.T[band] * covered
        between = spread.between**2 * (sigma @ sigma.T) + np.outer(alien * width, alien * width)
        factor = spread.room**2 * np.outer(total, total)
        return total, matrix @ covariance @ matrix.T + between * correlation + factor + noise

    none = np.zeros(len(band))
    total, whole = predicted(stated, none)
    base = _log_density(target - total, whole)
    found = np.flatnonzero(stated.any(axis=0))
    ratio = np.full((n, n + 1), -np.inf)
    for i in found:
        without = np.where(np.arange(n) == i, 0.0, stated)
        area = stated[:, i]
        for j in range(n + 1):
            if j == i:
                continue
            covered = without + np.where(np.arange(n) == j, area[:, np.newaxis], 0.0)
            total_j, whole_j = predicted(covered, area if j == n else none)
            ratio[i, j] = _log_density(target - total_j, whole_j) - base
    odds = MISNAMED / n * np.exp(np.minimum(ratio, 600.0))
    rest = 1 - MISNAMED * len(found)
    pull = spread.room**2 * total
    gain = np.linalg.solve(whole, pull)
    return Judged(
        miss=target - total,
        covariance=whole,
        sigma=np.sqrt(np.maximum(less, 0.0)).reshape(n, -1),
        factor=float(gain @ (target - total)),
        factor_sigma=float(np.sqrt(np.maximum(spread.room**2 - gain @ pull, 0.0))),
        suspicion=odds / (rest + odds.sum()),
    )


def _log_density(miss: Array, covariance: Array) -> float:
    factor, low = cho_factor(covariance, lower=True)
    quadratic = miss @ cho_solve((factor, low), miss)
    return float(-0.5 * quadratic - np.sum(np.log(np.diag(factor))))
