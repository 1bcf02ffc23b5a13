"""The information that a measurement is expected to give about the effects, in nats.

It is the mutual information of what is not measured yet and the set of effects (Lindley 1956): the
entropy of the sets' probabilities, less its mean after the measurement, over measurements drawn from
the hypotheses themselves.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtcal.finder.means.likelihood import student
from rtcal.finder.means.sets import Moments
from rtcal.support.types import Array

Mask = NDArray[np.bool_]
_DRAWS = 128
_TRACE = 1e-9  # of the mean variance, on a diagonal: two of several features may be nearly one


class Information:
    """Expected information about which set of effects is there.

    Parameters
    ----------
    moments : Moments
        Of n hypotheses, over all features that are or could be measured.
    weights : array (n,)
        Their probabilities.
    groups : int array (n,)
        The set of effects that each belongs to.
    measured : bool array (m,)
        Which of the features are measured already.
    values : array (n_measured,), optional
        Their values, which the weights have in them; without them only the kind of the measurement is
        known.
    """

    def __init__(
        self,
        moments: Moments,
        weights: Array,
        groups: NDArray[np.intp],
        measured: Mask,
        values: Array | None = None,
    ) -> None:
        covariance = moments.covariance.copy()
        diagonal = np.arange(covariance.shape[1])
        covariance[:, diagonal, diagonal] *= 1 + _TRACE
        mean = moments.mean
        self._known = measured if values is not None else np.zeros_like(measured)
        self._measured = measured
        if values is not None:
            across = covariance[:, measured]
            solved = np.linalg.solve(across[:, :, measured], across)  # (n, n_measured, m)
            residual = values - mean[:, measured]
            mean = mean + np.einsum("nu,num->nm", residual, solved)
            covariance = covariance - across.swapaxes(1, 2) @ solved
        self._mean, self._covariance = mean, covariance
        self._weights, self._groups = weights, groups
        places = (np.arange(_DRAWS) + 0.5) / _DRAWS
        self._drawn = np.minimum(np.searchsorted(np.cumsum(weights), places), len(weights) - 1)
        self._normal = np.random.default_rng(0).standard_normal((_DRAWS, covariance.shape[1]))

    def entropy(self) -> float:
        """Return the entropy of the sets before any further measurement, in nats."""
        return float(_entropy(self._by_group(self._weights[None]))[0])

    def of(self, further: Mask) -> float:
        """Return the information of measuring these features as well, in nats."""
        if self._known.any():
            return self._information(further & ~self._known)
        return self._information(further | self._measured) - self._information(self._measured)

    def _information(self, mask: Mask) -> float:
        if not mask.any():
            return 0.0
        mean, m = self._mean[:, mask], int(mask.sum())
        factor = np.linalg.cholesky(self._covariance[:, mask][:, :, mask])
        half = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(1)
        noise = np.einsum("dij,dj->di", factor[self._drawn], self._normal[:, mask])
        values = mean[self._drawn] + noise
        residual = (values[None] - mean[:, None]).swapaxes(1, 2)  # (n, m, draws)
        square = (np.linalg.solve(factor, residual) ** 2).sum(1)
        with np.errstate(divide="ignore"):
            log = student(square, half[:, None], m, coarsened=False)
            log += np.log(self._weights)[:, None]
        log -= log.max(0)
        after = np.exp(log)
        after /= after.sum(0)
        return max(self.entropy() - float(_entropy(self._by_group(after.T)).mean()), 0.0)

    def _by_group(self, weights: Array) -> Array:
        """Return the probabilities of the sets, (draws, n_groups)."""
        out = np.zeros((len(weights), int(self._groups.max()) + 1))
        np.add.at(out.T, self._groups, weights.T)
        return out


def _entropy(probabilities: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(-np.nansum(probabilities * np.log(probabilities), axis=1))
