"""The next measurement, and which effects the data can distinguish: distances between predictions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtcal.finder.case import Case
from rtcal.finder.means.evidence import Evidence
from rtcal.finder.means.features import Observed
from rtcal.finder.means.hypotheses import Hypotheses
from rtcal.finder.means.likelihood import alpha_covariance
from rtcal.finder.means.measurements import USUAL
from rtcal.finder.means.model_error import ModelDiscrepancy
from rtcal.finder.model import FEATURES
from rtcal.finder.prior import COEFFICIENTS, UNKNOWN
from rtcal.support.types import Array

DISTINCT_NATS = 2.3
"""Evidence in nats from which two effects can be told apart: odds of ten to one."""


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


def next_measurement(
    case: Case,
    observed: Observed,
    predicted: Hypotheses,
    discrepancy: ModelDiscrepancy,
    evidence: Evidence,
    candidates: Sequence[str],
) -> str:
    """Return the measurement that would decide between the candidates."""
    named = [c for c in candidates if c not in (UNKNOWN, COEFFICIENTS)]
    if candidates and candidates[0] == COEFFICIENTS:
        return (
            "look for another source of the coefficients, first for the material with the largest "
            "product of area and sigma; or measure with and without a known absorber"
        )
    if not named:
        return (
            "these data leave nothing to tell apart. That does not confirm the model"
            if not candidates
            else "see in the residuals which band and parameter disagree, and measure these again"
        )
    best = named[0]
    rows = [i for i, n in enumerate(predicted.names) if n == best]
    first = rows[int(np.argmax(evidence.by_hypothesis()[rows]))]
    if len(named) == 1:
        if predicted.effects[best].removable:
            return f"confirm it: measure once without the {best}"
        return f"confirm it: check the {best} where it can be looked up or measured by itself"
    rival = named[1]
    variances = variances_of(observed)
    covariance = covariance_with(predicted, discrepancy, variances, first)
    used = observed.used
    now = separation(predicted, covariance, used.ravel(), first, rival)
    options = []
    for label, features in (
        ("EDT and T30", ("edt", "t30")),
        ("C80", ("c80",)),
        ("G, with a calibrated source", ("g",)),
    ):
        rows_f = [FEATURES.index(f) for f in features]
        more = used.copy()
        more[:, rows_f] = True
        if more.sum() > used.sum():
            options.append((separation(predicted, covariance, more.ravel(), first, rival), label))
    removable = {n: predicted.effects[n].removable for n in (best, rival)}
    if len(set(removable.values())) == 2:
        suspect = best if removable[best] else rival
        return (
            f"measure with and without the {suspect}. If it is that, T changes, and the uncertainty of "
            "alpha cancels in the difference"
        )
    if options and max(options)[0] > now + 1:
        gain, label = max(options)
        return (
            f"measure {label}: with it {best} and {rival} would differ by {gain:.1f} nats instead of "
            f"{now:.1f}"
        )
    if all(removable.values()):
        return (
            f"measure without the {best} and without the {rival}, one at a time. The uncertainty of "
            "alpha cancels in the difference"
        )
    return (
        f"look at the room: {best} and {rival} predict the same in every parameter, and one of them "
        "can be seen, or measured with a rule"
    )
