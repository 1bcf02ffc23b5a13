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
    n, k = evidence.mu.shape
    # With the spread of all rooms, so that the difference is what this room taught of the means.
    less = np.diag(evidence.posterior(spread, ~own)[1])
    spread = evidence.fitted(~own, spread)
    mean, covariance = evidence.posterior(spread, ~own)
    band, areas = evidence.band[own], evidence.areas[own]
    correlation = evidence.correlation(spread)[np.ix_(band, band)]
    target = evidence.target[own]
    noise = evidence.noise[np.ix_(own, own)] + np.diag((spread.equation * target) ** 2)
    # A material that the archive lacks: like one of its entries, but nobody knows which.
    other = mean.mean(axis=0)[band]
    width = np.sqrt(mean.var(axis=0) + np.mean(evidence.sigma**2, axis=0))[band]
    places = np.arange(n)[:, np.newaxis] * k + band  # of each entry in the room's bands

    def predicted(covered: Array, alien: float = 0.0) -> tuple[Array, Array]:
        """b and its covariance with ``covered`` m² of each entry and ``alien`` m² of none of them."""
        total = covered @ mean[:, band] + alien * other
        shared = np.zeros((len(band), len(band)))
        used = np.flatnonzero(covered)
        for i in used:
            for j in used:
                shared += covered[i] * covered[j] * covariance[np.ix_(places[i], places[j])]
        sigma = evidence.sigma[:, band] * covered[:, np.newaxis]
        between = spread.between**2 * (sigma.T @ sigma) + alien**2 * np.outer(width, width)
        factor = spread.room**2 * np.outer(total, total)
        return total, shared + between * correlation + factor + noise

    stated = areas[0]
    total, whole = predicted(stated)
    base = _log_density(target - total, whole)
    found = np.flatnonzero(stated)
    ratio = np.full((n, n + 1), -np.inf)
    for i in found:
        without = np.where(np.arange(n) == i, 0.0, stated)
        for j in range(n + 1):
            if j == i:
                continue
            covered = without + np.where(np.arange(n) == j, stated[i], 0.0)
            total_j, whole_j = predicted(covered, stated[i] if j == n else 0.0)
            ratio[i, j] = _log_density(target - total_j, whole_j) - base
    odds = MISNAMED / n * np.exp(np.minimum(ratio, 600.0))
    rest = 1 - MISNAMED * len(found)
    pull = spread.room**2 * total
    gain = np.linalg.solve(whole, pull)
    return Judged(
        miss=target - total,
        covariance=whole,
        sigma=np.sqrt(np.maximum(less, 0.0)).reshape(n, k),
        factor=float(gain @ (target - total)),
        factor_sigma=float(np.sqrt(np.maximum(spread.room**2 - gain @ pull, 0.0))),
        suspicion=odds / (rest + odds.sum()),
    )


def _log_density(miss: Array, covariance: Array) -> float:
    factor, low = cho_factor(covariance, lower=True)
    quadratic = miss @ cho_solve((factor, low), miss)
    return float(-0.5 * quadratic - np.sum(np.log(np.diag(factor))))
