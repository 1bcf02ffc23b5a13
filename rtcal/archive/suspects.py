"""The contribution of each room to the others, and its materials that are likely another one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from rtcal.archive.likelihood import Evidence, Spread
from rtcal.support.types import Array

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
