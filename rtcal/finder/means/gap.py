"""The gap where alpha cannot close it: in closed form, before and after the effect is in the model.

Plain calibration meets T20 of the first configuration whatever the model lacks. What is left of the
other features is what alpha cannot absorb. The linear model of `evidence` gives it without a QP;
`verify` gives it with one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rtcal.acoustics.observables import observable
from rtcal.finder.means.features import Observed
from rtcal.finder.means.hypotheses import Hypotheses
from rtcal.finder.means.likelihood import covariance_of, log_density
from rtcal.finder.means.model_error import ModelDiscrepancy
from rtcal.finder.model import FEATURES
from rtcal.support.types import Array

LITTLE = 0.1
"""Change of the mean gap in JND that is little, whatever its uncertainty."""
CONTRADICTED = -3.0
"""Evidence in nats under which the features that alpha cannot fit contradict the effect."""
_DRAWS = 64


@dataclass(frozen=True)
class GapCheck:
    """Mean absolute gap in JND over what alpha cannot absorb; NaN where nothing of it was measured.

    ``uncertainty`` is the standard deviation of ``after - before`` by measurement and model error,
    ``predictive`` the evidence of the effect over "none" in those features, given the fitted T20.
    """

    before: float
    after: float
    uncertainty: float
    predictive: float

    @property
    def shrinks(self) -> bool:
        """Whether the gap shrinks by more than its uncertainty, and the prediction gets better."""
        return self.before - self.after > self.uncertainty and self.predictive > 0

    @property
    def grows(self) -> bool:
        """Whether the gap grows by more than its uncertainty and more than a little."""
        return self.after - self.before > max(LITTLE, self.uncertainty)

    @property
    def contradicts(self) -> bool:
        """Whether what alpha cannot fit contradicts the effect."""
        return self.predictive < CONTRADICTED


def gap_check(
    observed: Observed, predicted: Hypotheses, discrepancy: ModelDiscrepancy, i: int, scale: float
) -> GapCheck:
    """Return the gap under "none" and under hypothesis ``i``.

    With a ``scale`` other than 1, hypothesis ``i`` has coefficients that are off together.
    """
    c, f, _ = np.nonzero(observed.used)
    fitted = (c == 0) & (f == 0)
    if fitted.all():
        return GapCheck(np.nan, np.nan, np.nan, 0.0)
    jnd = np.array([observable(FEATURES[k]).jnd for k in f])[~fitted]
    mask = observed.used.ravel()
    gaps, moves, density = [], [], []
    for row, factor, exact in ((0, 1.0, True), (i, scale, False)):
        alpha, other = covariance_of(observed, predicted, discrepancy, row, factor)
        whole = alpha + other
        against = alpha if exact else whole
        gain = np.linalg.solve(
            _plus(against[np.ix_(fitted, fitted)]), alpha[np.ix_(fitted, ~fitted)]
        ).T
        residual = observed.values - predicted.features[row].ravel()[mask] - discrepancy.bias[mask]
        gaps.append((residual[~fitted] - gain @ residual[fitted]) / jnd)
        moves.append(np.concatenate([-gain, np.eye(int((~fitted).sum()))], axis=1) / jnd[:, None])
        kept = np.flatnonzero(fitted)
        density.append(
            log_density(residual, whole) - log_density(residual[kept], whole[np.ix_(kept, kept)])
        )
        noise = other
    order = np.concatenate([np.flatnonzero(fitted), np.flatnonzero(~fitted)])
    root = np.linalg.cholesky(_plus(noise[np.ix_(order, order)]))
    drawn = np.random.default_rng(0).standard_normal((_DRAWS, len(order))) @ root.T
    before, after = (np.abs(g + drawn @ m.T).mean(1) for g, m in zip(gaps, moves, strict=True))
    return GapCheck(
        float(np.abs(gaps[0]).mean()),
        float(np.abs(gaps[1]).mean()),
        float(np.std(after - before)),
        float(density[1] - density[0]),
    )


def _plus(covariance: Array) -> Array:
    """Return the matrix with a trace on its diagonal, so that it can be inverted where sigma is 0."""
    size = len(covariance)
    return np.asarray(covariance + 1e-9 * (1.0 + np.trace(covariance) / size) * np.eye(size))
