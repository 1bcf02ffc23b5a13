"""The shares of observations and of materials in a linear estimate without bounds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.room import Room
from rtcal.support.types import Array


def gain(prior: Array, matrix: Array, covariance: Array) -> Array:
    """Return K J' (J K J' + C)⁻¹, (n_unknowns, n_values): the change of the estimate by each value.

    Parameters
    ----------
    prior : array (n_unknowns, n_unknowns)
        K, the prior's covariance.
    matrix : array (n_values, n_unknowns)
        J, the derivatives of the values.
    covariance : array (n_values, n_values)
        C, of the values' errors.

    References
    ----------
    Tarantola (2005), Inverse Problem Theory, Sect. 3.2.

    Examples
    --------
    >>> print(gain(np.eye(1), np.ones((1, 1)), np.eye(1)))
    [[0.5]]
    """
    across = prior @ matrix.T
    return np.asarray(across @ np.linalg.solve(matrix @ across + covariance, np.eye(len(matrix))))


def learned_materials(
    room: Room, sigma: Array, of_bands: NDArray[np.bool_] | None = None
) -> tuple[tuple[str, float, float], ...]:
    """Return materials with prior and posterior sigma (rms over some bands), most learned first.

    ``sigma`` (n_materials, n_bands) is the posterior's; all bands count where none are named.
    """
    used = slice(None) if of_bands is None else of_bands
    before, after = (np.sqrt(np.mean(s[:, used] ** 2, axis=1)) for s in (room.sigma, sigma))
    share = np.divide(after, before, out=np.ones_like(after), where=before > 0)
    return tuple(
        (room.materials[i], float(before[i]), float(after[i]))
        for i in np.argsort(share, kind="stable")
    )
