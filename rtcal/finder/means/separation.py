"""Which effects the data can distinguish: distances between their predictions.

The information that a measurement is expected to give about the effects, in nats.

It is the mutual information of what is not measured yet and the set of effects (Lindley 1956): the
entropy of the sets' probabilities, less its mean after the measurement, over measurements drawn from
the hypotheses themselves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from rtcal.finder.case import Case
from rtcal.finder.claim import DISTINCT_NATS
from rtcal.finder.means.features import Observed
from rtcal.finder.means.hypotheses import Hypotheses
from rtcal.finder.means.likelihood import alpha_covariance, student
from rtcal.finder.means.model_error import ModelDiscrepancy
from rtcal.finder.means.sets import Moments
from rtcal.finder.model import FEATURES
from rtcal.finder.prior import NONE
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


USUAL = np.array([0.015, 0.03, 0.02, 0.5, 0.5])
"""Standard uncertainty of a mean over four positions that is not measured yet, by feature."""
Pairs = list[tuple[str, str]]
Separations = Mapping[tuple[str, str], float]
"""Expected evidence in nats against the second effect if the first is true."""


def separation(
    predicted: Hypotheses, covariance: Array, mask: Array, first: int, second: str
) -> float:
    """Return the expected evidence in nats against effect ``second`` if ``first`` is true.

    It is ½ min d' C⁻¹ d over the parameters of ``second``, with the masked features.
    """
    rows = [i for i, n in enumerate(predicted.names) if n == second]
    inverse = np.linalg.inv(covariance[np.ix_(mask, mask)])
    d = predicted.features[rows].reshape(len(rows), -1)[:, mask]
    d = d - predicted.features[first].ravel()[mask]
    return float(0.5 * np.einsum("ni,ij,nj->n", d, inverse, d).min())


def covariance_with(
    predicted: Hypotheses, discrepancy: ModelDiscrepancy, measured: Array, i: int
) -> Array:
    """Return the covariance of all features under hypothesis ``i``, ``measured`` their variances."""
    return np.asarray(alpha_covariance(predicted, i) + discrepancy.covariance + np.diag(measured))


def variances_of(observed: Observed) -> Array:
    """Measurement variance of every feature, also of features that were not measured."""
    shape = observed.used.shape
    table = np.broadcast_to(USUAL[None, :, None] ** 2, shape).copy()
    table[observed.used] = np.diag(observed.covariance)
    return np.asarray(table.ravel())


def separations(
    case: Case,
    observed: Observed,
    predicted: Hypotheses,
    discrepancy: ModelDiscrepancy,
    change: float,
) -> tuple[dict[str, float], dict[str, Separations]]:
    """Return each effect's change of T, and the evidence between effects, by what is measured more.

    Each effect has the size whose largest relative change of T, over configurations (it may be taken
    away in some) and bands, is nearest to ``change``. The evidence of the data as they are is that of
    "".
    """
    used, variances, base = observed.used, variances_of(observed), predicted.features[0]
    names = [n for n in dict.fromkeys(predicted.names) if n != NONE]
    masks = {"": used}
    for label, features in (
        ("EDT and T30", ("edt", "t30")),
        ("C80 and G", ("c80", "g")),
    ):
        more = with_features(used, features)
        if more.sum() > used.sum():
            lacking = [i for i in range(len(case.configurations)) if (more[i] & ~used[i]).any()]
            where = [f'"{case.configurations[i].name}"' for i in lacking]
            there = len(where) < len(case.configurations)
            masks[label + (f" of {' and '.join(where)}" if there else "")] = more
    tables: dict[str, dict[tuple[str, str], float]] = {m: {} for m in masks}
    reached: dict[str, float] = {}
    for a in names:
        rows = [i for i, n in enumerate(predicted.names) if n == a]
        moved = np.abs(np.expm1(predicted.features[rows][:, :, 0] - base[:, 0])).max((1, 2))
        nearest = int(np.argmin(np.abs(moved - change)))
        first, reached[a] = rows[nearest], float(moved[nearest])
        covariance = covariance_with(predicted, discrepancy, variances, first)
        for label, mask in masks.items():
            for b in (NONE, *names):
                if a != b:
                    tables[label][a, b] = separation(predicted, covariance, mask.ravel(), first, b)
    return reached, dict(tables)


def with_features(used: Array, features: Sequence[str]) -> Array:
    """Return which features are in use, (n_configurations, n_features, n_bands), with further ones."""
    more = used.copy()
    more[:, [FEATURES.index(f) for f in features]] = True
    return more


def blind(separations: Separations, pairs: Pairs) -> tuple[Pairs, Pairs]:
    """Pairs indistinguishable both ways, and pairs where only the first can pass for the second."""
    both, one_sided = [], []
    for a, b in pairs:
        weak = (separations[a, b] < DISTINCT_NATS, separations[b, a] < DISTINCT_NATS)
        if all(weak):
            both.append((a, b))
        elif any(weak):
            one_sided.append((a, b) if weak[0] else (b, a))
    return both, one_sided
