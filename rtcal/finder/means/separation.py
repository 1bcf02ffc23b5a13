"""Which effects the data can distinguish: distances between their predictions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rtcal.finder.case import Case
from rtcal.finder.claim import DISTINCT_NATS
from rtcal.finder.means.features import Observed
from rtcal.finder.means.hypotheses import Hypotheses
from rtcal.finder.means.likelihood import alpha_covariance
from rtcal.finder.means.model_error import ModelDiscrepancy
from rtcal.finder.model import FEATURES
from rtcal.finder.prior import NONE
from rtcal.support.types import Array

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
