"""The coefficients that the data leave, averaged over sets of effects.

Under each set, features and coefficients are jointly normal, with the moments that the evidence has:

    E[alpha | y] = mu + Sigma G' C^-1 (y - mean)

G is d features / d alpha. Each set has its probability as its weight (Hoeting et al. 1999). So
T bends the coefficients only as far as neither an effect nor the model's error explains it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtcal.acoustics.bands import correlation
from rtcal.finder.means.sets import Comparison, Rows, moments, states_of
from rtcal.finder.means.states import distances
from rtcal.finder.model import predict, sensitivities
from rtcal.support.types import Array


def averaged_alpha(compared: Comparison, likely: Sequence[tuple[Rows, float]]) -> Array:
    """Return the posterior mean of alpha over sets with these probabilities, (n_materials, n_bands).

    Coefficients stay within 0 and 1.
    """
    sets = [rows for rows, _ in likely]
    of = moments(compared, sets)
    across = covariance_with_alpha(compared, sets)
    weights = np.array([p for _, p in likely]) * of.possible
    out = np.array(compared.case.room.alpha)
    for k in np.flatnonzero(weights):
        explained = np.linalg.solve(of.covariance[k], compared.observed.values - of.mean[k])
        out += weights[k] / weights.sum() * np.tensordot(explained, across[k], axes=1)
    return np.clip(out, 0.0, 1.0)


def covariance_with_alpha(compared: Comparison, sets: Sequence[Rows]) -> Array:
    """Return G Sigma, the prior's covariance of the features in use and alpha, under each set.

    (n_sets, n_used, n_materials, n_bands).
    """
    case, observed = compared.case, compared.observed
    room = case.room
    jacobian = np.zeros((*observed.used.shape, len(sets), *room.alpha.shape))
    for i, (configuration, states) in enumerate(
        zip(case.configurations, states_of(compared, sets), strict=True)
    ):
        with np.errstate(all="ignore"):  # sets that are not possible have no weight
            made = predict(states, distances(case, configuration))
            per_alpha = -sensitivities(states) * made.reverberation_time[:, None] / (6 * np.log(10))
        changed = [m in configuration.changes for m in room.materials]
        per_alpha[:, changed] = 0.0  # what stands there is another material
        for band in range(room.n_bands):
            slopes = made.slopes[:, :, band].T[..., None]
            jacobian[i, :, band, :, :, band] = slopes * per_alpha[:, :, band]
    rho = correlation(room.centre_frequencies, room.band_correlation)
    across = (jacobian[observed.used] * room.sigma) @ rho * room.sigma
    return np.asarray(across.swapaxes(0, 1))
